#include "slcan.h"

/* MISRA D14 in this file. */

/* A type letter, the longest id, the length, 8 bytes, a stamp, the return. */
_Static_assert(SLCAN_LINE_MAX == 1u + 8u + 1u + 2u * BERTH_CAN_DATA_MAX + 4u + 1u,
               "the longest line has this many characters");

#define STAMP_DIGITS 4u

static char digit(uint32_t value) {
    return "0123456789ABCDEF"[value & 0xfu];
}

static size_t put_hex(char *to, uint32_t value, uint32_t digits) {
    for (uint32_t i = 0; i < digits; i++) {
        to[i] = digit(value >> (4u * (digits - 1u - i)));
    }
    return digits;
}

static char type_letter(const berth_can_frame_t *frame) {
    if (frame->remote) {
        return frame->extended ? 'R' : 'r';
    }
    return frame->extended ? 'T' : 't';
}

size_t slcan_encode(const berth_can_frame_t *frame, char line[SLCAN_LINE_MAX]) {
    size_t at = 0;
    line[at] = type_letter(frame);
    at++;
    at += put_hex(&line[at], frame->id, frame->extended ? 8u : 3u);
    line[at] = digit(frame->length);
    at++;
    if (!frame->remote) {
        for (uint32_t i = 0; i < frame->length && i < BERTH_CAN_DATA_MAX; i++) {
            at += put_hex(&line[at], frame->data[i], 2u);
        }
    }
    line[at] = '\r';
    return at + 1u;
}

/* A digit's value, or 16. */
static uint32_t value_of(char c) {
    if (c >= '0' && c <= '9') {
        return (uint32_t)(c - '0');
    }
    if (c >= 'A' && c <= 'F') {
        return (uint32_t)(c - 'A') + 10u;
    }
    if (c >= 'a' && c <= 'f') {
        return (uint32_t)(c - 'a') + 10u;
    }
    return 16u;
}

/* The caller has checked that there are so many characters. */
static bool get_hex(const char *from, uint32_t digits, uint32_t *value) {
    uint32_t sum = 0;
    for (uint32_t i = 0; i < digits; i++) {
        const uint32_t next = value_of(from[i]);
        if (next > 15u) {
            return false;
        }
        sum = (sum << 4u) | next;
    }
    *value = sum;
    return true;
}

static bool get_type(char letter, berth_can_frame_t *frame) {
    frame->extended = letter == 'T' || letter == 'R';
    frame->remote = letter == 'r' || letter == 'R';
    return frame->extended || frame->remote || letter == 't';
}

/* Letter, id and length; *at is then where the data begins. */
static bool get_head(const char *line, size_t length, berth_can_frame_t *frame, size_t *at) {
    if (length == 0u || !get_type(line[0], frame)) {
        return false;
    }
    const uint32_t id_digits = frame->extended ? 8u : 3u;
    uint32_t data_length = 0;
    if (length < 1u + id_digits + 1u || !get_hex(&line[1], id_digits, &frame->id) ||
        !get_hex(&line[1u + id_digits], 1u, &data_length)) {
        return false;
    }
    if (frame->id > (frame->extended ? BERTH_CAN_EXTENDED_MAX : BERTH_CAN_STANDARD_MAX) ||
        data_length > BERTH_CAN_DATA_MAX) {
        return false;
    }
    frame->length = (uint8_t)data_length;
    *at = (size_t)id_digits + 2u;
    return true;
}

bool slcan_decode(const char *line, size_t length, berth_can_frame_t *frame) {
    berth_can_frame_t found = {0};
    size_t at = 0;
    if (!get_head(line, length, &found, &at)) {
        return false;
    }
    const size_t data_digits = found.remote ? 0u : 2u * (size_t)found.length;
    const size_t rest = length - at;
    if (rest != data_digits && rest != data_digits + STAMP_DIGITS) {
        return false;
    }
    for (size_t i = 0; i < data_digits / 2u; i++) {
        uint32_t byte = 0;
        if (!get_hex(&line[at], 2u, &byte)) {
            return false;
        }
        found.data[i] = (uint8_t)byte;
        at += 2u;
    }
    uint32_t stamp = 0;
    if (rest != data_digits && !get_hex(&line[at], STAMP_DIGITS, &stamp)) {
        return false;
    }
    *frame = found;
    return true;
}
