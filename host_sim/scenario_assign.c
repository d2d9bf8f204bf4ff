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

/* Length of the character of UTF-8 that begins at text, and the character; 0: there is none. */
static size_t take_character(const unsigned char *text, uint32_t *character) {
    static const uint32_t least[] = {0, 0, 0x80, 0x800, 0x10000};
    const unsigned char first = text[0];
    size_t length = 0;
    if (first < 0x80u) {
        length = 1;
    } else if (first >= 0xC0u && first < 0xF8u) {
        length = first < 0xE0u ? 2 : first < 0xF0u ? 3 : 4;
    }
    uint32_t sum = length > 1 ? first & (0x7Fu >> length) : first;
    for (size_t i = 1; i < length; i++) {
        if ((text[i] & 0xC0u) != 0x80u) { /* the end of the text too */
            return 0;
        }
        sum = sum << 6 | (text[i] & 0x3Fu);
    }
    *character = sum;
    return length > 0 && sum >= least[length] ? length : 0;
}

/* Not what YAML takes for a control character, a line break or the byte order mark, nor what is no
 * character at all. */
static bool printable(uint32_t c) {
    return c >= 0x20 && !(c >= 0x7F && c < 0xA0) && c != 0x2028 && c != 0x2029 &&
           !(c >= 0xD800 && c < 0xE000) && c != 0xFEFF && c != 0xFFFE && c != 0xFFFF &&
           c <= 0x10FFFF;
}

bool scenario_text_printable(const char *text) {
    const unsigned char *at = (const unsigned char *)text;
    while (*at != '\0') {
        uint32_t character;
        const size_t length = take_character(at, &character);
        if (length == 0 || !printable(character)) {
            return false;
        }
        at += length;
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
        return explain_text(what, text, "has a control character, a line break or no UTF-8");
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
        /* NOLINTNEXTLINE(bugprone-casting-through-void): the table of keys has doubles there */
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
