#include "number.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char *skip_digits(const char *text, size_t *count) {
    const char *end = text;
    while (*end >= '0' && *end <= '9') {
        end++;
    }
    *count += (size_t)(end - text);
    return end;
}

static const char *skip_sign(const char *text) {
    return *text == '+' || *text == '-' ? text + 1 : text;
}

static bool is_decimal(const char *text) {
    size_t digits = 0;
    const char *at = skip_digits(skip_sign(text), &digits);
    if (*at == '.') {
        at = skip_digits(at + 1, &digits);
    }
    if (digits > 0 && (*at == 'e' || *at == 'E')) {
        digits = 0;
        at = skip_digits(skip_sign(at + 1), &digits);
    }
    return digits > 0 && *at == '\0';
}

bool number_parse(const char *text, double *value) {
    if (!is_decimal(text)) {
        return false;
    }
    char *end = NULL;
    const double parsed = strtod(text, &end);
    if (*end != '\0' || !isfinite(parsed)) {
        return false;
    }
    *value = parsed;
    return true;
}

/* One element of a list, without the blanks around it. */
static bool parse_element(const char *text, size_t length, double *value) {
    char element[64];
    while (length > 0 && *text == ' ') {
        text++;
        length--;
    }
    while (length > 0 && text[length - 1] == ' ') {
        length--;
    }
    if (length >= sizeof element) {
        return false;
    }
    memcpy(element, text, length);
    element[length] = '\0';
    return number_parse(element, value);
}

bool number_parse_count(const char *text, uint64_t maximum, uint64_t *value) {
    uint64_t number = 0;
    if (*text == '\0') {
        return false;
    }
    for (; *text >= '0' && *text <= '9'; text++) {
        const uint64_t digit = (uint64_t)(*text - '0');
        if (digit > maximum || number > (maximum - digit) / 10) {
            return false;
        }
        number = number * 10 + digit;
    }
    if (*text != '\0') {
        return false;
    }
    *value = number;
    return true;
}

bool number_parse_list(const char *text, double *values, size_t count) {
    double parsed[NUMBER_LIST_MAX];
    for (size_t i = 0; i < count; i++) {
        const size_t length = strcspn(text, ",");
        const bool last = i + 1 == count;
        if (!parse_element(text, length, &parsed[i]) || (text[length] == '\0') != last) {
            return false;
        }
        text += length + 1;
    }
    memcpy(values, parsed, count * sizeof *values);
    return true;
}

void number_text(double value, char *out, size_t size) {
    for (int digits = 15; digits <= 17; digits++) {
        (void)snprintf(out, size, "%.*g", digits, value);
        if (strtod(out, NULL) == value) {
            return;
        }
    }
}

void number_range_text(double minimum, double maximum, char *out, size_t size) {
    if (isinf(maximum)) {
        (void)snprintf(out, size, "at least %.9g", minimum);
    } else {
        (void)snprintf(out, size, "%.9g to %.9g", minimum, maximum);
    }
}
