#include "drive_sim_rig.h"

#include "support.h"

#include "unity.h"

#include <string.h>

drive_sim_t *rig_sim;
int64_t rig_now_us;

void rig_create(const drive_sim_config_t *config) {
    rig_now_us = 0;
    rig_sim = drive_sim_create(config, rig_now_us);
    TEST_ASSERT_NOT_NULL(rig_sim);
}

void rig_destroy(void) {
    drive_sim_destroy(rig_sim);
    rig_sim = NULL;
}

static bool give(berth_can_frame_t frame, const uint8_t *data) {
    if (frame.length > 0 && data != NULL) {
        memcpy(frame.data, data, frame.length);
    }
    return drive_sim_receive(rig_sim, &frame, rig_now_us);
}

bool rig_standard(uint32_t id, const uint8_t *data, uint8_t length) {
    return give((berth_can_frame_t){.id = id, .length = length}, data);
}

bool rig_extended(uint32_t id, const uint8_t *data, uint8_t length) {
    return give((berth_can_frame_t){.id = id, .extended = true, .length = length}, data);
}

bool rig_remote(uint32_t id, bool extended, uint8_t length) {
    return give(
        (berth_can_frame_t){.id = id, .extended = extended, .remote = true, .length = length},
        NULL);
}

void rig_run(int64_t time_us) {
    const int64_t end_us = rig_now_us + time_us;
    while (drive_sim_deadline(rig_sim) <= end_us) {
        const int64_t due_us = drive_sim_deadline(rig_sim);
        rig_now_us = due_us > rig_now_us ? due_us : rig_now_us;
        drive_sim_step(rig_sim, rig_now_us);
        TEST_ASSERT_TRUE_MESSAGE(drive_sim_deadline(rig_sim) > rig_now_us, "a step makes progress");
    }
    rig_now_us = end_us;
    drive_sim_step(rig_sim, rig_now_us);
}

static void expect(uint32_t id, bool extended, const uint8_t *data, uint8_t length) {
    const berth_can_frame_t *frame = drive_sim_front(rig_sim);
    TEST_ASSERT_NOT_NULL_MESSAGE(frame, "a frame waits");
    TEST_ASSERT_EQUAL_HEX32(id, frame->id);
    TEST_ASSERT_EQUAL(extended, frame->extended);
    TEST_ASSERT_FALSE(frame->remote);
    TEST_ASSERT_EQUAL_UINT8(length, frame->length);
    if (length > 0) {
        TEST_ASSERT_EQUAL_HEX8_ARRAY(data, frame->data, length);
    }
    drive_sim_sent(rig_sim);
}

void rig_expect_standard(uint32_t id, const uint8_t *data, uint8_t length) {
    expect(id, false, data, length);
}

void rig_expect_extended(uint32_t id, const uint8_t *data, uint8_t length) {
    expect(id, true, data, length);
}

void rig_expect_nothing(void) {
    TEST_ASSERT_NULL(drive_sim_front(rig_sim));
}

unsigned rig_drop(void) {
    unsigned count = 0;
    for (; drive_sim_front(rig_sim) != NULL; count++) {
        drive_sim_sent(rig_sim);
    }
    return count;
}

void rig_wheel(double turns, double turns_per_s) {
    drive_sim_motion(rig_sim, turns * RIG_TWO_PI, turns_per_s * RIG_TWO_PI);
}

void rig_trouble(drive_sim_trouble_t trouble) {
    drive_sim_trouble(rig_sim, &trouble);
}

static uint8_t random_byte(void) {
    static const uint8_t extremes[] = {0x00, 0x01, 0x7f, 0x80, 0xff};
    return support_index(2) == 0 ? extremes[support_index(5)] : (uint8_t)support_index(256);
}

void rig_hostile(uint32_t frames) {
    for (uint32_t i = 0; i < frames; i++) {
        berth_can_frame_t frame = {.extended = support_index(3) == 0,
                                   .remote = support_index(8) == 0,
                                   .length = (uint8_t)support_index(9)};
        frame.id = support_index(frame.extended ? 0x2000u : 0x800u);
        for (unsigned k = 0; k < BERTH_CAN_DATA_MAX; k++) {
            frame.data[k] = random_byte();
        }
        /* Time may seem to go back: a frame's stamp is older than the last step. */
        (void)drive_sim_receive(rig_sim, &frame, rig_now_us - (int64_t)support_index(2000));
        if (support_index(10) == 0) {
            rig_run((int64_t)support_index(5000));
        }
        if (support_index(3) == 0) {
            (void)rig_drop();
        }
        const double target = drive_sim_target_radps(rig_sim);
        TEST_ASSERT_TRUE_MESSAGE(target - target == 0.0, "the target is finite");
    }
}
