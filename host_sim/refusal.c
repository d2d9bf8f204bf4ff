#include "refusal.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

bool refuse(scenario_error_t *error, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    (void)vsnprintf(error->text, sizeof error->text, format, arguments);
    va_end(arguments);
    return false;
}

const char *refusal_excerpt(const char *text, char *out, size_t size) {
    size_t length = strlen(text);
    const bool cut = length >= size;
    if (cut) {
        length = size - 4;
        /* do not cut a UTF-8 sequence in two */
        while (length > 0 && ((unsigned char)text[length] & 0xC0u) == 0x80u) {
            length--;
        }
    }
    for (size_t i = 0; i < length; i++) {
        const unsigned char c = (unsigned char)text[i];
        out[i] = text[i];
        if (c < 0x20u || c == 0x7Fu) {
            out[i] = '?';
        }
    }
    memcpy(out + length, cut ? "..." : "", cut ? 4 : 1);
    return out;
}
