/* What the proofs' drivers share: values about which nothing is known but their type or range. */
#ifndef BERTH_TESTS_PROOF_PROOF_H
#define BERTH_TESTS_PROOF_PROOF_H

#include "berth/berth.h"

#include <__fc_builtin.h>

/* Where the analyser's search for bounds is to stop on the way: bounds that hold are among these.
 */
#define HINTS                                                                                      \
    -1000000000, -1, 0, 1, BERTH_OBSTACLES_MAX - 1, BERTH_OBSTACLES_MAX, BERTH_OUTBOX_MAX - 1,     \
        BERTH_OUTBOX_MAX, 31, 39, 40, 200, 999999, 1000000, 4611686018627387904

/* Any bits whatever, NaN, infinities and negative zero included. */
#define ANY_BYTES(object) Frama_C_make_unknown((char *)&(object), sizeof(object))

static inline bool any_bool(void) {
    return Frama_C_interval(0, 1) != 0;
}

static inline uint8_t any_u8(void) {
    return Frama_C_unsigned_char_interval(0, UINT8_MAX);
}

static inline uint16_t any_u16(void) {
    return Frama_C_unsigned_short_interval(0, UINT16_MAX);
}

static inline uint32_t any_u32(void) {
    uint32_t value;
    ANY_BYTES(value);
    return value;
}

static inline int64_t any_i64(void) {
    int64_t value;
    ANY_BYTES(value);
    return value;
}

static inline float any_float(void) {
    float value;
    ANY_BYTES(value);
    return value;
}

static inline uint32_t u32_from(uint32_t least, uint32_t most) {
    return Frama_C_unsigned_int_interval(least, most);
}

static inline int64_t i64_from(int64_t least, int64_t most) {
    return Frama_C_long_long_interval(least, most);
}

/* What the headers allow for a time. */
static inline int64_t any_time(void) {
    return i64_from(0, BERTH_TIME_MAX_US);
}

/* An enum's value may be any int. */
#define ANY_ENUM(type) ((type)Frama_C_int_interval(INT32_MIN, INT32_MAX))

static inline berth_can_frame_t any_frame(void) {
    berth_can_frame_t frame = {.time_us = any_i64(),
                               .id = any_u32(),
                               .extended = any_bool(),
                               .remote = any_bool(),
                               .length = any_u8()};
    ANY_BYTES(frame.data);
    return frame;
}

static inline berth_pose_t any_pose(void) {
    berth_pose_t pose;
    ANY_BYTES(pose);
    return pose;
}

#endif
