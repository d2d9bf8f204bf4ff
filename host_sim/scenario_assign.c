/* Texts into the values of a scenario. */
#include "number.h"
#include "refusal.h"
#include "scenario_keys.h"
#include "strategy.h"

#include <math.h>
#include <stdarg.h>
#include <string.h>

/* Fills what and returns false. */
static bool explain(char what[KEY_WHAT_MAX], const char *format, ...)
    __attribute__((format(printf, 2, 3)));

static bool explain(char what[KEY_WHAT_MAX], const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    (void)vsnprintf(what, KEY_WHAT_MAX, format, arguments);
    va_end(arguments);
    return false;
}

static bool explain_text(char what[KEY_WHAT_MAX], const char *text, const char *reason) {
    char excerpt[REFUSAL_EXCERPT_MAX];
    refusal_excerpt(text, excerpt, sizeof excerpt);
    return explain(what, "'%s' %s", excerpt, reason);
}

static bool explain_choice(char what[KEY_WHAT_MAX], const char *text) {
    return explain_text(what, text, "is not known");
}

bool scenario_text_printable(const char *text) {
    for (const unsigned char *at = (const unsigned char *)text; *at != '\0'; at++) {
        if (*at < 0x20u || *at == 0x7Fu) {
            return false;
        }
        /* what YAML takes for a line break or for control characters: U+0080 to U+009F, U+2028,
         * U+2029, and the byte order mark */
        if ((at[0] == 0xC2u && at[1] < 0xA0u) ||
            (at[0] == 0xE2u && at[1] == 0x80u && (at[2] == 0xA8u || at[2] == 0xA9u)) ||
            (at[0] == 0xEFu && at[1] == 0xBBu && at[2] == 0xBFu)) {
            return false;
        }
    }
    return true;
}

static bool assign_text(char *target, const char *text, char what[KEY_WHAT_MAX]) {
    if (text[0] == '\0') {
        return explain(what, "is empty");
    }
    if (strlen(text) >= SCENARIO_TEXT_MAX) {
        return explain(what, "has %zu bytes", strlen(text));
    }
    if (!scenario_text_printable(text)) {
        return explain_text(what, text, "has a control character or a line break");
    }
    strcpy(target, text);
    return true;
}

static bool whole_microseconds(double value) {
    return fabs(value * 1e6 - round(value * 1e6)) <= 1e-6;
}

static bool number_good(const scenario_key_t *key, double value, const char *text,
                        char what[KEY_WHAT_MAX]) {
    if (key->kind == KIND_NUMBER_OR_ZERO && value == 0.0) {
        return true;
    }
    if (!(value >= key->minimum && value <= key->maximum)) {
        return explain_text(what, text, "is out of range");
    }
    if (key->kind == KIND_INTEGER && value != floor(value)) {
        return explain_text(what, text, "is not a whole number");
    }
    if (key->kind == KIND_PERIOD && !whole_microseconds(value)) {
        return explain_text(what, text, "is not a whole number of microseconds");
    }
    return true;
}

static bool assign_number(const scenario_key_t *key, void *target, size_t element,
                          key_value_t value, char what[KEY_WHAT_MAX]) {
    double number = 0.0;
    if (value.quoted) {
        return explain_text(what, value.text, "is a quoted text, not a number");
    }
    if (value.text[0] == '\0') {
        return explain(what, "is empty");
    }
    if (!number_parse(value.text, &number)) {
        return explain_text(what, value.text, NUMBER_REFUSED);
    }
    if (!number_good(key, number, value.text, what)) {
        return false;
    }
    if (key->kind == KIND_INTEGER) {
        *(int *)target = (int)number;
    } else {
        ((double *)target)[element] = number;
    }
    return true;
}

static bool assign_bool(bool *target, key_value_t value, char what[KEY_WHAT_MAX]) {
    const bool yes = strcmp(value.text, "true") == 0;
    if (value.quoted || (!yes && strcmp(value.text, "false") != 0)) {
        return explain_text(what, value.text, "is neither true nor false");
    }
    *target = yes;
    return true;
}

static bool assign_shape(shape_t *target, const char *text, char what[KEY_WHAT_MAX]) {
    const bool circle = strcmp(text, "circle") == 0;
    if (!circle && strcmp(text, "eight") != 0) {
        return explain_choice(what, text);
    }
    *target = circle ? SHAPE_CIRCLE : SHAPE_EIGHT;
    return true;
}

static bool assign_discretization(bool *zoh, const char *text, char what[KEY_WHAT_MAX]) {
    const bool yes = strcmp(text, "zoh") == 0;
    if (!yes && strcmp(text, "euler") != 0) {
        return explain_choice(what, text);
    }
    *zoh = yes;
    return true;
}

static bool assign_strategy(scenario_t *scenario, const char *text, char what[KEY_WHAT_MAX]) {
    if (strategy_find(text) == NULL || strlen(text) >= sizeof scenario->avoidance.strategy) {
        return explain_choice(what, text);
    }
    strcpy(scenario->avoidance.strategy, text);
    return true;
}

static bool assign_file(scenario_t *scenario, const char *text, char what[KEY_WHAT_MAX]) {
    if (!assign_text(scenario->reference.file, text, what)) {
        return false;
    }
    scenario->reference.shape = SHAPE_FILE;
    return true;
}

bool scenario_key_assign(const scenario_key_t *key, scenario_t *scenario, size_t index,
                         size_t element, key_value_t value, char what[KEY_WHAT_MAX]) {
    char *base =
        key->section == SECTION_OBSTACLES ? (char *)&scenario->obstacles[index] : (char *)scenario;
    void *target = base + key->offset;
    switch (key->kind) {
    case KIND_BOOL:
        return assign_bool(target, value, what);
    case KIND_NAME:
        return assign_text(target, value.text, what);
    case KIND_SHAPE:
        return assign_shape(target, value.text, what);
    case KIND_FILE:
        return assign_file(scenario, value.text, what);
    case KIND_DISCRETIZATION:
        return assign_discretization(target, value.text, what);
    case KIND_STRATEGY:
        return assign_strategy(scenario, value.text, what);
    case KIND_NUMBER:
    case KIND_PERIOD:
    case KIND_NUMBER_OR_ZERO:
    case KIND_INTEGER:
    default:
        return assign_number(key, target, element, value, what);
    }
}

/* [1, 2, 3] */
static bool assign_list(const scenario_key_t *key, double *target, const char *text,
                        char what[KEY_WHAT_MAX]) {
    char inner[KEY_WHAT_MAX];
    double numbers[NUMBER_LIST_MAX];
    const size_t length = strlen(text);
    if (length < 2 || length >= sizeof inner || text[0] != '[' || text[length - 1] != ']') {
        return explain_text(what, text, "is not a list in brackets");
    }
    (void)snprintf(inner, sizeof inner, "%.*s", (int)length - 2, text + 1);
    if (!number_parse_list(inner, numbers, key->count)) {
        return explain(what, "'%.100s' is not a list of %zu numbers", text, key->count);
    }
    for (size_t i = 0; i < key->count; i++) {
        if (!number_good(key, numbers[i], text, what)) {
            return false;
        }
    }
    memcpy(target, numbers, key->count * sizeof *target);
    return true;
}

bool scenario_key_assign_text(const scenario_key_t *key, scenario_t *scenario, size_t index,
                              const char *text, char what[KEY_WHAT_MAX]) {
    if (key->count > 1) {
        return assign_list(key, (double *)(void *)((char *)scenario + key->offset), text, what);
    }
    return scenario_key_assign(key, scenario, index, 0, (key_value_t){text, false}, what);
}

void scenario_defaults(scenario_t *scenario) {
    char what[KEY_WHAT_MAX];
    *scenario = (scenario_t){.plant = {.radius_scale = 1.0, .track_scale = 1.0}};
    for (size_t i = 0; i < SCENARIO_KEY_COUNT; i++) {
        const scenario_key_t *key = &scenario_keys[i];
        if (key->fallback != NULL) {
            /* the table's own texts are good: the tests load a scenario of nothing else */
            (void)scenario_key_assign_text(key, scenario, 0, key->fallback, what);
        }
    }
}
