#include "berth/message.h"

#include "angle_inline.h"
#include "berth/avoid.h"
#include "berth/supervisor.h"
#include "bytes.h"

#include <math.h>

/* Units in a metre, radian or metre a second. */
#define TENTHS_OF_A_MILLI 10000u
#define MILLIS 1000u
#define CENTIS 100u

/* Largest magnitudes; one less than the most negative number of the field, which is NOT_FINITE. */
#define INT16_MOST 32767
#define INT24_MOST 8388607

#define HEADING_MOST 31416
#define CLEARANCE_NONE 65535u
#define CLEARANCE_MOST 65534
#define RADIUS_MOST 255
#define STATE_UNKNOWN 15u
#define ACTIVE_MOST 31u

static bool is_finite(float value) {
    return fabsf(value) <= 0x1.fffffep+127f;
}

/* value * per_unit rounded to the nearest integer, ties to even, and limited to +-most. In
 * integers, because the product has up to 38 bits. value must be finite, per_unit at least 2. */
static int32_t to_units(float value, uint32_t per_unit, int32_t most) {
    const uint32_t bits = angle_bits_of(value);
    const uint32_t exponent = (bits >> 23) & 0xffu; /* value = mantissa * 2^(exponent - 150) */
    if (exponent >= 149u) {
        return value < 0.0f ? -most : most; /* 2^22 or more */
    }
    const uint32_t shift = 150u - exponent;
    uint64_t whole = 0;
    if (shift < 63u) {
        const uint32_t mantissa = (bits & 0x7fffffu) | 0x800000u;
        const uint64_t product = (uint64_t)mantissa * per_unit;
        const uint64_t half = (uint64_t)1 << (shift - 1u); /* MISRA T5 */
        const uint64_t rest = product & (2u * half - 1u);
        whole = product >> shift;
        if (rest > half || (rest == half && (whole & 1u) != 0u)) {
            whole++;
        }
    }
    const int32_t magnitude = whole < (uint64_t)most ? (int32_t)whole : most;
    return value < 0.0f ? -magnitude : magnitude;
}

/* A signed field: what is not finite becomes the number below -most. */
static int32_t to_signed(float value, uint32_t per_unit, int32_t most) {
    return is_finite(value) ? to_units(value, per_unit, most) : -most - 1;
}

/* An unsigned field: 0 for what is below zero. value must be finite. */
static uint32_t to_unsigned(float value, uint32_t per_unit, int32_t most) {
    return value > 0.0f ? (uint32_t)to_units(value, per_unit, most) : 0u;
}

static int32_t heading_to_units(float angle_rad) {
    return to_signed(berth_wrap(angle_rad), TENTHS_OF_A_MILLI, INT16_MOST);
}

static int32_t get_i16(const uint8_t *in) {
    return signed_u16(get_u16_le(in));
}

static int32_t get_i24(const uint8_t *in) {
    return signed_u24(get_u24_le(in));
}

/* Division, because it rounds once: the fields are exact in float32, and their units are not. */
static float from_units(int32_t units, float per_unit) {
    return (float)units / per_unit;
}

static bool within(int32_t value, int32_t most) {
    return value >= -most && value <= most;
}

static void begin(berth_can_frame_t *frame, uint32_t kind, uint8_t address, uint8_t length) {
    *frame = (berth_can_frame_t){
        .id = ((kind << 8) | address) & BERTH_CAN_EXTENDED_MAX,
        .extended = true,
        .length = length,
    };
}

static bool well_formed(const berth_can_frame_t *frame, uint8_t length) {
    return !frame->remote && frame->length == length;
}

bool berth_message_is(const berth_can_frame_t *frame, uint32_t kind, uint8_t address) {
    return frame->extended && frame->id == ((kind << 8) | address);
}

void berth_message_encode_command(berth_can_frame_t *frame, uint8_t address,
                                  berth_command_code_t command) {
    const unsigned number = (unsigned)command;
    const uint8_t code =
        number < (unsigned)BERTH_COMMAND_COUNT ? (uint8_t)number : (uint8_t)BERTH_COMMAND_NONE;
    begin(frame, BERTH_MESSAGE_COMMAND, address, 2);
    frame->data[0] = code;
    frame->data[1] = (uint8_t)(code ^ 0xffu);
}

bool berth_message_decode_command(const berth_can_frame_t *frame, berth_command_code_t *out) {
    const uint8_t code = frame->data[0];
    if (!well_formed(frame, 2) || (frame->data[1] ^ code) != 0xffu ||
        code >= (uint8_t)BERTH_COMMAND_COUNT) {
        return false;
    }
    *out = (berth_command_code_t)code;
    return true;
}

void berth_message_encode_pose(berth_can_frame_t *frame, uint32_t kind, uint8_t address,
                               const berth_pose_t *pose) {
    begin(frame, kind, address, 8);
    put_u24_le(&frame->data[0], (uint32_t)to_signed(pose->x_m, TENTHS_OF_A_MILLI, INT24_MOST));
    put_u24_le(&frame->data[3], (uint32_t)to_signed(pose->y_m, TENTHS_OF_A_MILLI, INT24_MOST));
    put_u16_le(&frame->data[6], (uint16_t)heading_to_units(pose->theta_rad));
}

bool berth_message_decode_pose(const berth_can_frame_t *frame, berth_pose_t *out) {
    const int32_t x = get_i24(&frame->data[0]);
    const int32_t y = get_i24(&frame->data[3]);
    const int32_t theta = get_i16(&frame->data[6]);
    if (!well_formed(frame, 8) || !within(x, INT24_MOST - 1) || !within(y, INT24_MOST - 1) ||
        !within(theta, HEADING_MOST)) {
        return false;
    }
    *out = (berth_pose_t){
        .x_m = from_units(x, (float)TENTHS_OF_A_MILLI),
        .y_m = from_units(y, (float)TENTHS_OF_A_MILLI),
        .theta_rad = from_units(theta, (float)TENTHS_OF_A_MILLI),
    };
    return true;
}

void berth_message_encode_obstacle(berth_can_frame_t *frame, uint8_t address,
                                   const berth_message_obstacle_t *obstacle) {
    const float radius = obstacle->radius_m;
    begin(frame, BERTH_MESSAGE_OBSTACLE, address, 8);
    frame->data[0] = obstacle->id;
    put_u16_le(&frame->data[1], (uint16_t)to_signed(obstacle->x_m, CENTIS, INT16_MOST));
    put_u16_le(&frame->data[3], (uint16_t)to_signed(obstacle->y_m, CENTIS, INT16_MOST));
    frame->data[5] = is_finite(radius) ? (uint8_t)to_unsigned(radius, CENTIS, RADIUS_MOST)
                                       : (uint8_t)RADIUS_MOST;
    put_u16_le(&frame->data[6], obstacle->ttl_ms);
}

bool berth_message_decode_obstacle(const berth_can_frame_t *frame, berth_message_obstacle_t *out) {
    const int32_t x = get_i16(&frame->data[1]);
    const int32_t y = get_i16(&frame->data[3]);
    if (!well_formed(frame, 8) || !within(x, INT16_MOST - 1) || !within(y, INT16_MOST - 1)) {
        return false;
    }
    *out = (berth_message_obstacle_t){
        .id = frame->data[0],
        .x_m = from_units(x, (float)CENTIS),
        .y_m = from_units(y, (float)CENTIS),
        .radius_m = from_units(frame->data[5], (float)CENTIS),
        .ttl_ms = get_u16_le(&frame->data[6]),
    };
    return true;
}

static uint32_t at_most(uint32_t value, uint32_t most) {
    return value < most ? value : most;
}

static uint32_t clearance_to_units(const berth_message_status_t *status) {
    if (status->active == 0u) {
        return CLEARANCE_NONE;
    }
    const float clearance = status->clearance_m;
    return is_finite(clearance) ? to_unsigned(clearance, MILLIS, CLEARANCE_MOST) : 0u;
}

void berth_message_encode_status(berth_can_frame_t *frame, uint8_t address,
                                 const berth_message_status_t *status) {
    const uint32_t state = at_most(status->state, STATE_UNKNOWN);
    const uint32_t mode = at_most(status->mode, STATE_UNKNOWN);
    const uint32_t flags = (status->finished ? 0x20u : 0u) | (status->braking ? 0x40u : 0u) |
                           (status->limited ? 0x80u : 0u);
    begin(frame, BERTH_MESSAGE_STATUS, address, 8);
    frame->data[0] = (uint8_t)(state | (mode << 4));
    frame->data[1] = status->fault;
    put_u24_le(&frame->data[2], status->total);
    frame->data[5] = (uint8_t)(at_most(status->active, ACTIVE_MOST) | flags);
    put_u16_le(&frame->data[6], (uint16_t)clearance_to_units(status));
}

bool berth_message_decode_status(const berth_can_frame_t *frame, berth_message_status_t *out) {
    const uint8_t state = frame->data[0] & 0x0fu;
    const uint8_t mode = frame->data[0] >> 4;
    const uint8_t flags = frame->data[5];
    const uint32_t clearance = get_u16_le(&frame->data[6]);
    if (!well_formed(frame, 8) || state > (uint8_t)BERTH_SUPERVISOR_FAULT ||
        mode > (uint8_t)BERTH_MODE_BLOCKED) {
        return false;
    }
    *out = (berth_message_status_t){
        .state = state,
        .mode = mode,
        .fault = frame->data[1],
        .total = get_u24_le(&frame->data[2]),
        .active = flags & ACTIVE_MOST,
        .finished = (flags & 0x20u) != 0u,
        .braking = (flags & 0x40u) != 0u,
        .limited = (flags & 0x80u) != 0u,
        .clearance_m =
            clearance == CLEARANCE_NONE ? -1.0f : from_units((int32_t)clearance, (float)MILLIS),
    };
    return true;
}

void berth_message_encode_error(berth_can_frame_t *frame, uint8_t address,
                                const berth_message_error_t *error) {
    begin(frame, BERTH_MESSAGE_ERROR, address, 8);
    put_u16_le(&frame->data[0], (uint16_t)to_signed(error->error.e1_m, MILLIS, INT16_MOST));
    put_u16_le(&frame->data[2], (uint16_t)to_signed(error->error.e2_m, MILLIS, INT16_MOST));
    put_u16_le(&frame->data[4], (uint16_t)heading_to_units(error->error.e3_rad));
    put_u16_le(&frame->data[6], (uint16_t)to_signed(error->v_mps, MILLIS, INT16_MOST));
}

bool berth_message_decode_error(const berth_can_frame_t *frame, berth_message_error_t *out) {
    const int32_t e1 = get_i16(&frame->data[0]);
    const int32_t e2 = get_i16(&frame->data[2]);
    const int32_t e3 = get_i16(&frame->data[4]);
    const int32_t v = get_i16(&frame->data[6]);
    if (!well_formed(frame, 8) || !within(e1, INT16_MOST) || !within(e2, INT16_MOST) ||
        !within(e3, HEADING_MOST) || !within(v, INT16_MOST)) {
        return false;
    }
    *out = (berth_message_error_t){
        .error = {.e1_m = from_units(e1, (float)MILLIS),
                  .e2_m = from_units(e2, (float)MILLIS),
                  .e3_rad = from_units(e3, (float)TENTHS_OF_A_MILLI)},
        .v_mps = from_units(v, (float)MILLIS),
    };
    return true;
}
