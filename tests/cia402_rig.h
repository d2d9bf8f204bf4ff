/* One CANopen wheel drive with its outbox and its time, and frames written as ID#DATA in
 * hexadecimal digits, as candump writes them.
 */
#ifndef BERTH_TESTS_CIA402_RIG_H
#define BERTH_TESTS_CIA402_RIG_H

#include "berth/drive.h"

#include "unity.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    berth_drive_t drive;
    berth_outbox_t outbox;
    int64_t now_us;
    int64_t enabled_us; /* when enabling began */
} rig_t;

static inline berth_drive_config_t rig_config(void) {
    return (berth_drive_config_t){
        .protocol = &berth_drive_cia402,
        .node = 5,
        .sign = 1,
        .gear_ratio = 10.0f,
        .mode = 9,
        .master_node = 127,
        .has_position = true,
        .counts_per_turn = 4096,
        .velocity_units_per_rps = 4096.0f,
        .period_us = 10000,
        .feedback_timeout_us = 50000,
        .heartbeat_timeout_us = 300000,
        .enable_timeout_us = 5000000,
    };
}

static inline void rig_init(rig_t *rig, berth_drive_config_t config) {
    berth_refusal_t refusal;
    memset(rig, 0, sizeof *rig);
    rig->now_us = 1000000;
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_drive_init(&rig->drive, &config, &refusal));
    berth_outbox_reset(&rig->outbox);
}

static inline const berth_drive_status_t *rig_status(const rig_t *rig) {
    return berth_drive_status(&rig->drive);
}

static inline void rig_enable(rig_t *rig) {
    rig->enabled_us = rig->now_us;
    berth_drive_enable(&rig->drive, rig->now_us);
    TEST_ASSERT_EQUAL_INT(BERTH_DRIVE_STARTING, rig_status(rig)->state);
}

static inline void rig_step(rig_t *rig) {
    berth_drive_step(&rig->drive, rig->now_us, &rig->outbox);
}

static inline berth_can_frame_t rig_frame(const char *text) {
    char *end = NULL;
    berth_can_frame_t frame = {.id = (uint32_t)strtoul(text, &end, 16)};
    TEST_ASSERT_EQUAL_CHAR('#', *end);
    const char *digits = end + 1;
    for (; digits[0] != '\0' && frame.length < 8; digits += 2) {
        const char byte[3] = {digits[0], digits[1], '\0'};
        frame.data[frame.length++] = (uint8_t)strtoul(byte, NULL, 16);
    }
    TEST_ASSERT_EQUAL_CHAR('\0', *digits);
    return frame;
}

static inline void rig_text(const berth_can_frame_t *frame, char text[32]) {
    int used = snprintf(text, 32, "%03X#", (unsigned)frame->id);
    for (uint8_t i = 0; i < frame->length; i++) {
        used += snprintf(text + used, 32 - (size_t)used, "%02X", frame->data[i]);
    }
}

/* The next frame is this one; takes it. */
static inline void rig_expect(rig_t *rig, const char *expected) {
    const berth_can_frame_t *frame = berth_outbox_front(&rig->outbox);
    TEST_ASSERT_NOT_NULL_MESSAGE(frame, expected);
    TEST_ASSERT_FALSE(frame->extended || frame->remote);
    char text[32];
    rig_text(frame, text);
    TEST_ASSERT_EQUAL_STRING(expected, text);
    berth_outbox_pop(&rig->outbox);
}

static inline void rig_expect_silence(const rig_t *rig) {
    TEST_ASSERT_NULL(berth_outbox_front(&rig->outbox));
    TEST_ASSERT_EQUAL_UINT32(0, rig->outbox.dropped);
}

static inline void rig_drop(rig_t *rig) {
    berth_outbox_clear(&rig->outbox);
}

/* The drive on the bus says this, now. */
static inline void rig_take(rig_t *rig, const berth_can_frame_t *frame) {
    TEST_ASSERT_TRUE(berth_drive_receive(&rig->drive, frame, rig->now_us));
}

static inline void rig_say(rig_t *rig, const char *text) {
    const berth_can_frame_t frame = rig_frame(text);
    rig_take(rig, &frame);
}

static inline void rig_expect_state(const rig_t *rig, berth_drive_state_t state) {
    TEST_ASSERT_EQUAL_STRING(berth_drive_state_text(state),
                             berth_drive_state_text(rig_status(rig)->state));
}

static inline void rig_expect_fault(const rig_t *rig, berth_drive_fault_t fault, uint32_t code) {
    rig_expect_state(rig, BERTH_DRIVE_FAULT);
    TEST_ASSERT_EQUAL_STRING(berth_drive_fault_text(fault),
                             berth_drive_fault_text(rig_status(rig)->fault));
    TEST_ASSERT_EQUAL_HEX32(code, rig_status(rig)->code);
}

#endif
