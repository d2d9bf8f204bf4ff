/* CAN frames as text of 0 and 1, for the tests: written bit by bit from the standard, sharing
 * nothing with hal/loop.
 */
#ifndef BERTH_TESTS_CAN_TEXT_H
#define BERTH_TESTS_CAN_TEXT_H

#include "berth_hal/can.h"

#include <string.h>

typedef struct {
    char text[256];
} can_text_t;

static inline void can_text_add(can_text_t *to, uint32_t value, int width) {
    size_t n = strlen(to->text);
    for (int bit = width - 1; bit >= 0; bit--) {
        to->text[n++] = (value & (1u << bit)) != 0 ? '1' : '0';
    }
    to->text[n] = '\0';
}

/* The bits that decide an arbitration. */
static inline can_text_t can_text_arbitration(const berth_can_frame_t *frame) {
    can_text_t t = {""};
    if (frame->extended) {
        can_text_add(&t, frame->id >> 18, 11);
        strcat(t.text, "11");
        can_text_add(&t, frame->id % (1u << 18), 18);
        strcat(t.text, frame->remote ? "1" : "0");
    } else {
        can_text_add(&t, frame->id, 11);
        strcat(t.text, frame->remote ? "1" : "0");
        strcat(t.text, "0");
    }
    return t;
}

/* The remainder of text times x^15 by the polynomial, by long division. */
static inline uint32_t can_text_crc(const can_text_t *of) {
    static const char polynomial[] = "1100010110011001";
    can_text_t t = *of;
    const size_t n = strlen(t.text);
    strcat(t.text, "000000000000000");
    for (size_t i = 0; i < n; i++) {
        for (size_t k = 0; t.text[i] == '1' && k < sizeof polynomial - 1; k++) {
            /* from the back, so that bit i is cleared last */
            const size_t at = sizeof polynomial - 2 - k;
            t.text[i + at] = t.text[i + at] == polynomial[at] ? '0' : '1';
        }
    }
    uint32_t crc = 0;
    for (size_t i = n; t.text[i] != '\0'; i++) {
        crc = crc * 2 + (t.text[i] == '1' ? 1u : 0u);
    }
    return crc;
}

/* SOF to the last data bit. */
static inline can_text_t can_text_head(const berth_can_frame_t *frame) {
    can_text_t t = {"0"};
    strcat(t.text, can_text_arbitration(frame).text);
    strcat(t.text, frame->extended ? "00" : "0");
    can_text_add(&t, frame->length, 4);
    for (int i = 0; i < frame->length && !frame->remote; i++) {
        can_text_add(&t, frame->data[i], 8);
    }
    return t;
}

/* SOF to CRC, stuffed: wherever five equal characters stand, the other one goes in behind. */
static inline can_text_t can_text_stuffed(const berth_can_frame_t *frame) {
    can_text_t t = can_text_head(frame);
    can_text_add(&t, can_text_crc(&t), 15);
    for (size_t i = 0; i + 5 <= strlen(t.text); i++) {
        const bool zeros = memcmp(&t.text[i], "00000", 5) == 0;
        const bool ones = memcmp(&t.text[i], "11111", 5) == 0;
        if (zeros || ones) {
            memmove(&t.text[i + 6], &t.text[i + 5], strlen(&t.text[i + 5]) + 1);
            t.text[i + 5] = zeros ? '1' : '0';
            i += 4; /* the next run may begin with the bit put in */
        }
    }
    return t;
}

/* SOF to the end of EOF. */
static inline uint32_t can_text_bits(const berth_can_frame_t *frame) {
    can_text_t t = can_text_stuffed(frame);
    strcat(t.text, "1"
                   "01"
                   "1111111");
    return (uint32_t)strlen(t.text);
}

#endif
