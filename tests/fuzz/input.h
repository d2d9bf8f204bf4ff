/* Reads an input as a program: numbers one after the other, zeros after its end. */
#ifndef BERTH_TESTS_FUZZ_INPUT_H
#define BERTH_TESTS_FUZZ_INPUT_H

#include "berth_hal/can.h"

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

typedef struct {
    const uint8_t *data;
    size_t left;
} input_t;

static inline uint8_t in_u8(input_t *in) {
    if (in->left == 0) {
        return 0;
    }
    in->left--;
    return *in->data++;
}

static inline uint16_t in_u16(input_t *in) {
    const uint32_t low = in_u8(in);
    return (uint16_t)(low | (uint32_t)in_u8(in) << 8);
}

static inline uint32_t in_u32(input_t *in) {
    const uint32_t low = in_u16(in);
    return low | (uint32_t)in_u16(in) << 16;
}

static inline uint64_t in_u64(input_t *in) {
    const uint64_t low = in_u32(in);
    return low | (uint64_t)in_u32(in) << 32;
}

/* Any bits. */
static inline float in_any_float(input_t *in) {
    const uint32_t bits = in_u32(in);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* From low to high, in 65536 steps. */
static inline float in_float(input_t *in, float low, float high) {
    return low + (high - low) * ((float)in_u16(in) / 65535.0f);
}

/* Mostly from low to high; after a byte of 255 any bits. */
static inline float in_some_float(input_t *in, float low, float high) {
    return in_u8(in) == 255 ? in_any_float(in) : in_float(in, low, high);
}

/* A number with as many bits as the first byte says, up to 2^62. */
static inline int64_t in_span(input_t *in) {
    const uint32_t bits = in_u8(in) % 63u;
    const uint64_t mask = ((uint64_t)1 << bits) - 1u;
    return (int64_t)(((uint64_t)1 << bits) + (in_u16(in) & mask));
}

/* Length and data of a frame: low four bits of a byte for the length, bit 4 remote. */
static inline void in_body(input_t *in, berth_can_frame_t *frame) {
    const uint8_t shape = in_u8(in);
    frame->length = (shape & 15u) > BERTH_CAN_DATA_MAX ? BERTH_CAN_DATA_MAX : shape & 15u;
    frame->remote = (shape & 16u) != 0;
    for (uint32_t i = 0; i < frame->length; i++) {
        frame->data[i] = in_u8(in);
    }
}

/* Any frame that a bus can carry. */
static inline berth_can_frame_t in_frame(input_t *in) {
    berth_can_frame_t frame = {0};
    const uint32_t id = in_u32(in);
    frame.extended = (id & 0x80000000u) != 0;
    frame.id = id & (frame.extended ? BERTH_CAN_EXTENDED_MAX : BERTH_CAN_STANDARD_MAX);
    in_body(in, &frame);
    return frame;
}

/* FNV-1a, to compare two runs. */
static inline void digest_bytes(uint32_t *digest, const void *bytes, size_t count) {
    const unsigned char *at = bytes;
    uint64_t sum = *digest;
    for (size_t i = 0; i < count; i++) {
        sum = ((sum ^ at[i]) * 16777619u) & 0xffffffffu;
    }
    *digest = (uint32_t)sum;
}

#define DIGEST_START 2166136261u

static inline bool finite_all(const float *values, size_t count) {
    for (size_t i = 0; i < count; i++) {
        if (!isfinite(values[i])) {
            return false;
        }
    }
    return true;
}

#endif
