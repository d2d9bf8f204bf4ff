#include "candump.h"

#include <ctype.h>
#include <inttypes.h>
#include <string.h>

#define SECONDS_MAX INT64_C(4611686018427) /* 2^62 microseconds, BERTH_TIME_MAX_US */

static bool wrong(char why[CANDUMP_WHY_MAX], const char *what) {
    (void)snprintf(why, CANDUMP_WHY_MAX, "%s", what);
    return false;
}

static int hex_digit(char c) {
    if (c >= '0' && c <= '9') {
        return c - '0';
    }
    if (c >= 'A' && c <= 'F') {
        return c - 'A' + 10;
    }
    return c >= 'a' && c <= 'f' ? c - 'a' + 10 : -1;
}

/* "(SECONDS.MICROSECONDS) ", exactly six digits of the latter. */
static bool parse_time(const char **at, int64_t *time_us) {
    const char *text = *at;
    int64_t seconds = 0;
    int64_t micros = 0;
    if (text[0] != '(' || !isdigit((unsigned char)text[1])) {
        return false;
    }
    for (text++; isdigit((unsigned char)*text); text++) {
        seconds = seconds * 10 + (*text - '0');
        if (seconds >= SECONDS_MAX) {
            return false;
        }
    }
    if (*text++ != '.') {
        return false;
    }
    for (int i = 0; i < 6; i++, text++) {
        if (!isdigit((unsigned char)*text)) {
            return false;
        }
        micros = micros * 10 + (*text - '0');
    }
    if (text[0] != ')' || text[1] != ' ') {
        return false;
    }
    *time_us = seconds * 1000000 + micros;
    *at = text + 2;
    return true;
}

static bool parse_channel(const char **at, char channel[CANDUMP_CHANNEL_MAX]) {
    const size_t length = strcspn(*at, " \n");
    if (length == 0 || length >= CANDUMP_CHANNEL_MAX || (*at)[length] != ' ') {
        return false;
    }
    memcpy(channel, *at, length);
    channel[length] = '\0';
    *at += length + 1;
    return true;
}

static bool parse_id(const char **at, berth_can_frame_t *frame) {
    const char *text = *at;
    uint32_t id = 0;
    int digits = 0;
    for (; digits < 9 && hex_digit(*text) >= 0; digits++, text++) {
        id = id << 4 | (uint32_t)hex_digit(*text);
    }
    frame->extended = digits == 8;
    frame->id = id;
    *at = text + 1;
    return (digits == 3 || digits == 8) && *text == '#' &&
           id <= (frame->extended ? BERTH_CAN_EXTENDED_MAX : BERTH_CAN_STANDARD_MAX);
}

static bool parse_data(const char **at, berth_can_frame_t *frame) {
    const char *text = *at;
    if (*text == 'R') {
        text++;
        frame->remote = true;
        if (*text >= '0' && *text <= '8') {
            frame->length = (uint8_t)(*text++ - '0');
        }
        *at = text;
        return true;
    }
    while (hex_digit(text[0]) >= 0) {
        if (frame->length >= BERTH_CAN_DATA_MAX || hex_digit(text[1]) < 0) {
            return false;
        }
        frame->data[frame->length++] = (uint8_t)(hex_digit(text[0]) << 4 | hex_digit(text[1]));
        text += 2;
    }
    *at = text;
    return true;
}

static bool parse_end(const char *text, candump_direction_t *direction) {
    *direction = CANDUMP_UNKNOWN;
    if (text[0] == ' ' && (text[1] == 'R' || text[1] == 'T')) {
        *direction = text[1] == 'R' ? CANDUMP_RECEIVED : CANDUMP_SENT;
        text += 2;
    }
    return text[0] == '\0' || strcmp(text, "\n") == 0;
}

bool candump_parse(const char *line, candump_line_t *out, char why[CANDUMP_WHY_MAX]) {
    candump_line_t parsed = {.direction = CANDUMP_UNKNOWN};
    int64_t time_us = 0;
    if (!parse_time(&line, &time_us)) {
        return wrong(why, "no time (allowed: (SECONDS.MICROSECONDS), six digits of the latter)");
    }
    parsed.frame.time_us = time_us;
    if (!parse_channel(&line, parsed.channel)) {
        return wrong(why, "no channel (allowed: a name of at most 31 characters)");
    }
    if (!parse_id(&line, &parsed.frame)) {
        return wrong(why, "no identifier (allowed: 000# to 7FF#, 00000000# to 1FFFFFFF#)");
    }
    if (!parse_data(&line, &parsed.frame)) {
        return wrong(why,
                     "bad data (allowed: at most 8 bytes of two hexadecimal digits, or R0 to R8)");
    }
    if (!parse_end(line, &parsed.direction)) {
        return wrong(why, "something behind the data (allowed: R, T or nothing)");
    }
    *out = parsed;
    return true;
}

const char *candump_frame_text(const berth_can_frame_t *frame, char out[CANDUMP_FRAME_MAX]) {
    int used =
        snprintf(out, CANDUMP_FRAME_MAX, frame->extended ? "%08X#" : "%03X#", (unsigned)frame->id);
    if (frame->remote) {
        (void)snprintf(out + used, (size_t)(CANDUMP_FRAME_MAX - used), "R%u",
                       (unsigned)frame->length);
        return out;
    }
    for (uint32_t i = 0; i < frame->length && i < BERTH_CAN_DATA_MAX; i++) {
        used += snprintf(out + used, (size_t)(CANDUMP_FRAME_MAX - used), "%02X",
                         (unsigned)frame->data[i]);
    }
    return out;
}

void candump_print(FILE *file, const char *channel, const berth_can_frame_t *frame,
                   candump_direction_t direction) {
    static const char *const ends[] = {
        [CANDUMP_UNKNOWN] = "", [CANDUMP_RECEIVED] = " R", [CANDUMP_SENT] = " T"};
    char text[CANDUMP_FRAME_MAX];
    (void)fprintf(file, "(%010" PRId64 ".%06" PRId64 ") %s %s%s\n", frame->time_us / 1000000,
                  frame->time_us % 1000000, channel, candump_frame_text(frame, text),
                  ends[direction]);
}

bool candump_same(const berth_can_frame_t *a, const berth_can_frame_t *b) {
    const bool head = a->id == b->id && a->extended == b->extended && a->remote == b->remote &&
                      a->length == b->length && a->length <= BERTH_CAN_DATA_MAX;
    return head && (a->remote || memcmp(a->data, b->data, a->length) == 0);
}
