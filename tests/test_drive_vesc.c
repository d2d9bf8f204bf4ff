/* The VESC protocol against frames written out by hand from its documents. */
#include "support.h"

#include "berth/drive_vesc.h"

#include "unity.h"

#include <math.h>
#include <string.h>

#define RAD_PER_TURN 6.2831853f
#define NODE 0x0Bu
#define POLE_PAIRS 7

static berth_drive_t drive;
static berth_outbox_t outbox;

static berth_drive_config_t good_config(void) {
    return (berth_drive_config_t){
        .protocol = &berth_drive_vesc,
        .node = NODE,
        .sign = 1,
        .gear_ratio = 1.0f,
        .pole_pairs = POLE_PAIRS,
        .period_us = 10000,
        .feedback_timeout_us = 100000,
        .heartbeat_timeout_us = 100000,
        .enable_timeout_us = 1000000,
    };
}

static void init_with(const berth_drive_config_t *config) {
    berth_refusal_t refusal;
    memset(&drive, 0xa5, sizeof drive);
    TEST_ASSERT_EQUAL(BERTH_OK, berth_drive_init(&drive, config, &refusal));
    berth_outbox_reset(&outbox);
}

void setUp(void) {
    const berth_drive_config_t config = good_config();
    init_with(&config);
}

void tearDown(void) {}

static void expect(uint32_t id, const uint8_t data[4]) {
    const berth_can_frame_t *front = berth_outbox_front(&outbox);
    TEST_ASSERT_NOT_NULL(front);
    TEST_ASSERT_EQUAL_HEX32(id, front->id);
    TEST_ASSERT_TRUE(front->extended);
    TEST_ASSERT_FALSE(front->remote);
    TEST_ASSERT_EQUAL(4, front->length);
    TEST_ASSERT_EQUAL_HEX8_ARRAY(data, front->data, 4);
    berth_outbox_pop(&outbox);
}

static void expect_nothing(void) {
    TEST_ASSERT_NULL(berth_outbox_front(&outbox));
}

static const uint8_t zero[] = {0, 0, 0, 0};

static berth_can_frame_t status_frame(uint32_t id, uint32_t value) {
    return (berth_can_frame_t){
        .id = id,
        .extended = true,
        .length = 8,
        .data = {(uint8_t)(value >> 24), (uint8_t)(value >> 16), (uint8_t)(value >> 8),
                 (uint8_t)value},
    };
}

static bool say_erpm(int32_t erpm, int64_t at_us) {
    const berth_can_frame_t frame = status_frame(0x90B, (uint32_t)erpm);
    return berth_drive_receive(&drive, &frame, at_us);
}

static bool say_tachometer(uint32_t steps, int64_t at_us) {
    const berth_can_frame_t frame = status_frame(0x1B0B, steps);
    return berth_drive_receive(&drive, &frame, at_us);
}

static void expect_state(berth_drive_state_t state, berth_drive_fault_t fault, uint32_t code) {
    TEST_ASSERT_EQUAL(state, berth_drive_status(&drive)->state);
    TEST_ASSERT_EQUAL(fault, berth_drive_status(&drive)->fault);
    TEST_ASSERT_EQUAL_HEX32(code, berth_drive_status(&drive)->code);
}

static void make_enabled(int64_t now_us) {
    berth_drive_enable(&drive, now_us);
    TEST_ASSERT_TRUE(say_erpm(0, now_us));
    expect_state(BERTH_DRIVE_ENABLED, BERTH_DRIVE_FAULT_NONE, 0);
}

static void command_and_cycle(float radps) {
    berth_drive_command(&drive, radps);
    berth_drive_cycle(&drive, 2000, &outbox);
}

/* --- enabling ----------------------------------------------------------------------------------
 */

static void test_a_status_enables(void) {
    berth_drive_enable(&drive, 1000);
    expect_nothing(); /* there is nothing to ask of it */
    TEST_ASSERT_EQUAL(1001001, berth_drive_deadline(&drive));
    berth_drive_cycle(&drive, 1000, &outbox);
    expect(0x30B, zero); /* feeds the drive's time-out */
    TEST_ASSERT_TRUE(say_tachometer(5, 1500));
    expect_state(BERTH_DRIVE_STARTING, BERTH_DRIVE_FAULT_NONE, 0);
    TEST_ASSERT_TRUE(say_erpm(0, 999)); /* sent before enabling began */
    expect_state(BERTH_DRIVE_STARTING, BERTH_DRIVE_FAULT_NONE, 0);
    TEST_ASSERT_TRUE(say_erpm(0, 2000));
    expect_state(BERTH_DRIVE_ENABLED, BERTH_DRIVE_FAULT_NONE, 0);
}

/* Status frames come again and again: whichever is lost, the next one does it. */
static void test_whichever_status_is_lost_the_next_enables(void) {
    for (int64_t lost = 0; lost < 50; lost++) {
        setUp();
        berth_drive_enable(&drive, 0);
        for (int64_t frame = 0; frame < lost; frame++) {
            berth_drive_step(&drive, frame * 10000, &outbox);
            expect_state(BERTH_DRIVE_STARTING, BERTH_DRIVE_FAULT_NONE, 0);
        }
        TEST_ASSERT_TRUE(say_erpm(0, lost * 10000));
        expect_state(BERTH_DRIVE_ENABLED, BERTH_DRIVE_FAULT_NONE, 0);
    }
}

static void test_no_status_is_a_fault(void) {
    berth_drive_enable(&drive, 0);
    berth_drive_step(&drive, 1000000, &outbox);
    expect_state(BERTH_DRIVE_STARTING, BERTH_DRIVE_FAULT_NONE, 0);
    berth_drive_step(&drive, 1000001, &outbox);
    expect_state(BERTH_DRIVE_FAULT, BERTH_DRIVE_FAULT_ENABLE, BERTH_VESC_NO_STATUS);
}

static void test_silence_is_a_fault_and_brakes(void) {
    make_enabled(5000);
    berth_drive_command(&drive, 3.0f);
    berth_drive_step(&drive, 105000, &outbox);
    expect_state(BERTH_DRIVE_ENABLED, BERTH_DRIVE_FAULT_NONE, 0);
    TEST_ASSERT_TRUE(say_tachometer(0, 105000)); /* no sign of a speed */
    berth_drive_step(&drive, 105001, &outbox);
    expect_state(BERTH_DRIVE_FAULT, BERTH_DRIVE_FAULT_FEEDBACK, 0);
    berth_drive_cycle(&drive, 106000, &outbox);
    expect(0x00B, zero);
    expect_nothing();
}

static void test_a_shorter_heartbeat_timeout_bites_first(void) {
    berth_drive_config_t config = good_config();
    config.heartbeat_timeout_us = 50000;
    init_with(&config);
    make_enabled(0);
    berth_drive_step(&drive, 50001, &outbox);
    expect_state(BERTH_DRIVE_FAULT, BERTH_DRIVE_FAULT_HEARTBEAT, 0);
}

/* --- commands ----------------------------------------------------------------------------------
 */

static void test_the_speed_command(void) {
    const uint8_t erpm_420[] = {0x00, 0x00, 0x01, 0xA4};
    const uint8_t erpm_minus_420[] = {0xFF, 0xFF, 0xFE, 0x5C};
    make_enabled(0);
    command_and_cycle(RAD_PER_TURN); /* 60 rpm of the motor, times 7 */
    expect(0x30B, erpm_420);
    command_and_cycle(-RAD_PER_TURN);
    expect(0x30B, erpm_minus_420);
    command_and_cycle(0.0f);
    expect(0x30B, zero);
}

static void test_gear_sign_and_pole_pairs_of_the_command(void) {
    const uint8_t erpm_minus_30000[] = {0xFF, 0xFF, 0x8A, 0xD0};
    berth_drive_config_t config = good_config();
    config.node = 254;
    config.sign = -1;
    config.gear_ratio = 12.5f;
    config.pole_pairs = 20;
    init_with(&config);
    berth_drive_enable(&drive, 0);
    const berth_can_frame_t frame = status_frame(0x9FE, 15000);
    TEST_ASSERT_TRUE(berth_drive_receive(&drive, &frame, 0));
    TEST_ASSERT_FLOAT_WITHIN(1.0e-5f, -RAD_PER_TURN, berth_drive_status(&drive)->velocity_radps);
    command_and_cycle(2.0f * RAD_PER_TURN);
    expect(0x3FE, erpm_minus_30000);
}

static void test_speeds_saturate_and_are_counted(void) {
    const uint8_t most[] = {0x00, 0x06, 0x68, 0xA0};  /* 60000 * 7 */
    const uint8_t least[] = {0xFF, 0xF9, 0x97, 0x60}; /* -60000 * 7 */
    make_enabled(0);
    command_and_cycle(3.4e38f);
    expect(0x30B, most);
    command_and_cycle(-7.0e3f);
    expect(0x30B, least);
    TEST_ASSERT_EQUAL(2, berth_drive_status(&drive)->saturated);
    command_and_cycle(NAN);
    expect(0x30B, zero);
    TEST_ASSERT_EQUAL(1, berth_drive_status(&drive)->refused);
}

static void test_a_newer_command_takes_the_place_of_one_that_waits(void) {
    const uint8_t erpm_420[] = {0x00, 0x00, 0x01, 0xA4};
    make_enabled(0);
    command_and_cycle(3.0f);
    command_and_cycle(RAD_PER_TURN);
    expect(0x30B, erpm_420);
    expect_nothing();
}

static void test_stops_brake_and_leave_no_speed_waiting(void) {
    void (*const stops[])(berth_drive_t *, berth_outbox_t *) = {berth_drive_stop,
                                                                berth_drive_emergency_stop};
    for (uint32_t i = 0; i < 2; i++) {
        setUp();
        make_enabled(0);
        command_and_cycle(3.0f);
        stops[i](&drive, &outbox);
        expect_state(BERTH_DRIVE_STOPPED, BERTH_DRIVE_FAULT_NONE, 0);
        expect(0x30B, zero); /* in place of the one that waited */
        expect(0x00B, zero);
        expect_nothing();
        command_and_cycle(3.0f);
        expect(0x00B, zero);
        expect_nothing();
        make_enabled(5000);
        command_and_cycle(0.0f);
        expect(0x30B, zero);
    }
}

static void test_disabling_releases_the_motor(void) {
    make_enabled(0);
    command_and_cycle(3.0f);
    berth_drive_disable(&drive, &outbox);
    expect(0x30B, zero);
    expect(0x10B, zero);
    expect_nothing();
    expect_state(BERTH_DRIVE_OFF, BERTH_DRIVE_FAULT_NONE, 0);
    command_and_cycle(3.0f);
    expect_nothing();
}

/* --- feedback ----------------------------------------------------------------------------------
 */

static void test_status_1_bytes(void) {
    /* -4200 ERPM, -12.3 A, duty -0.456 */
    const berth_can_frame_t frame = {
        .id = 0x90B,
        .extended = true,
        .length = 8,
        .data = {0xFF, 0xFF, 0xEF, 0x98, 0xFF, 0x85, 0xFE, 0x38},
    };
    TEST_ASSERT_TRUE(berth_drive_receive(&drive, &frame, 777));
    const berth_drive_status_t *status = berth_drive_status(&drive);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-4f, -10.0f * RAD_PER_TURN, status->velocity_radps);
    TEST_ASSERT_EQUAL(777, status->feedback_us);
    TEST_ASSERT_EQUAL(777, status->heartbeat_us);
    TEST_ASSERT_FALSE(status->position_used);
}

static void expect_malformed(const berth_can_frame_t *frame) {
    const uint32_t before = berth_drive_status(&drive)->malformed;
    TEST_ASSERT_TRUE(berth_drive_receive(&drive, frame, 5000));
    TEST_ASSERT_EQUAL(before + 1, berth_drive_status(&drive)->malformed);
    TEST_ASSERT_EQUAL(0, berth_drive_status(&drive)->feedback_us);
    TEST_ASSERT_EQUAL(0, berth_drive_status(&drive)->heartbeat_us);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, berth_drive_status(&drive)->velocity_radps);
    TEST_ASSERT_FALSE(berth_drive_status(&drive)->position_used);
}

static void test_bad_frames_change_nothing(void) {
    make_enabled(0);
    for (unsigned length = 0; length < 256; length++) {
        berth_can_frame_t frame = status_frame(0x90B, 420);
        frame.length = (uint8_t)length;
        if (length != 8) {
            expect_malformed(&frame);
        }
        frame.id = 0x1B0B;
        if (length != 8 && length != 6) {
            expect_malformed(&frame);
        }
    }
    berth_can_frame_t frame = status_frame(0x90B, 420);
    frame.remote = true;
    expect_malformed(&frame);
    frame.id = 0x1B0B;
    expect_malformed(&frame);
    const int32_t fast[] = {INT32_MAX, INT32_MIN, 420001, -420001};
    for (uint32_t i = 0; i < 4; i++) {
        frame = status_frame(0x90B, (uint32_t)fast[i]);
        expect_malformed(&frame);
    }
}

static void test_frames_of_others_are_left_alone(void) {
    make_enabled(0);
    for (uint32_t id = 0; id < 0x4000; id++) {
        berth_can_frame_t frame = status_frame(id, 420);
        if (id != 0x90B && id != 0x1B0B) {
            TEST_ASSERT_FALSE(berth_drive_receive(&drive, &frame, 2000));
        }
        frame.extended = false;
        TEST_ASSERT_FALSE(berth_drive_receive(&drive, &frame, 2000));
    }
    TEST_ASSERT_EQUAL(1, berth_drive_status(&drive)->received);
    TEST_ASSERT_EQUAL(0, berth_drive_status(&drive)->malformed);
}

static void test_without_status_5_the_speed_tells_the_travel(void) {
    make_enabled(0);
    TEST_ASSERT_TRUE(say_erpm(4200, 10000)); /* from 0 to 10 turns/s */
    TEST_ASSERT_FLOAT_WITHIN(1.0e-5f, 0.05f * RAD_PER_TURN, berth_drive_travel(&drive, 10000));
    TEST_ASSERT_FLOAT_WITHIN(1.0e-5f, 0.1f * RAD_PER_TURN, berth_drive_travel(&drive, 20000));
    TEST_ASSERT_FALSE(berth_drive_status(&drive)->position_used);
}

/* From one end of int32 to the other, forwards and backwards. */
static void test_the_tachometer_wraps(void) {
    const uint32_t starts[] = {0x7FFFFFF0u, 0xFFFFFFF0u, 0x80000010u, 0x00000010u};
    for (uint32_t i = 0; i < 4; i++) {
        const bool forward = i < 2;
        setUp();
        make_enabled(0);
        TEST_ASSERT_TRUE(say_tachometer(starts[i], 0));
        uint32_t steps = starts[i];
        float travel = 0.0f;
        for (int64_t now_us = 10000; now_us <= 60000; now_us += 10000) {
            steps = forward ? steps + 7 : steps - 7;
            TEST_ASSERT_TRUE(say_tachometer(steps, now_us));
            travel += berth_drive_travel(&drive, now_us);
        }
        /* 42 steps are a motor turn; the speed said 0 all the time, so it lags by a step */
        const float expected = (forward ? 1.0f : -1.0f) * (41.0f / 42.0f) * RAD_PER_TURN;
        TEST_ASSERT_FLOAT_WITHIN(1.0e-5f, expected, travel);
        TEST_ASSERT_TRUE(berth_drive_status(&drive)->position_used);
        TEST_ASSERT_EQUAL(0, berth_drive_status(&drive)->malformed);
    }
}

static void test_status_5_bytes_and_its_short_form(void) {
    /* 0x00010203 steps, 24.6 V */
    berth_can_frame_t frame = {
        .id = 0x1B0B,
        .extended = true,
        .length = 8,
        .data = {0x00, 0x01, 0x02, 0x03, 0x00, 0xF6, 0, 0},
    };
    make_enabled(0);
    TEST_ASSERT_TRUE(berth_drive_receive(&drive, &frame, 1000));
    frame.length = 6;
    frame.data[3] = 0x03 + 5;
    TEST_ASSERT_TRUE(berth_drive_receive(&drive, &frame, 11000));
    TEST_ASSERT_EQUAL(0, berth_drive_status(&drive)->malformed);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-5f, 4.0f / 42.0f * RAD_PER_TURN,
                             berth_drive_travel(&drive, 11000));
}

static void test_a_tachometer_that_was_reset_is_counted_and_no_travel(void) {
    make_enabled(0);
    TEST_ASSERT_TRUE(say_tachometer(1000000, 0));
    TEST_ASSERT_TRUE(say_tachometer(0, 10000));
    TEST_ASSERT_EQUAL(1, berth_drive_status(&drive)->malformed);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, berth_drive_travel(&drive, 10000));
    TEST_ASSERT_TRUE(say_tachometer(3, 20000));
    TEST_ASSERT_EQUAL(1, berth_drive_status(&drive)->malformed);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-5f, 2.0f / 42.0f * RAD_PER_TURN,
                             berth_drive_travel(&drive, 20000));
}

/* Enabled again: what the tachometer said before counts no more. */
static void test_disable_and_enable_again(void) {
    make_enabled(0);
    TEST_ASSERT_TRUE(say_tachometer(100, 0));
    berth_drive_disable(&drive, &outbox);
    berth_drive_enable(&drive, 1000000);
    TEST_ASSERT_TRUE(say_erpm(0, 1000000));
    TEST_ASSERT_TRUE(say_tachometer(110, 1000000));
    TEST_ASSERT_EQUAL_FLOAT(0.0f, berth_drive_travel(&drive, 1000000));
    TEST_ASSERT_EQUAL(0, berth_drive_status(&drive)->malformed);
}

/* --- the rest ----------------------------------------------------------------------------------
 */

static void test_configuration(void) {
    berth_drive_config_t config = good_config();
    berth_refusal_t refusal;
    config.node = 0;
    config.pole_pairs = 100;
    TEST_ASSERT_EQUAL(BERTH_OK, berth_drive_init(&drive, &config, &refusal));
    config.pole_pairs = 101;
    TEST_ASSERT_EQUAL(BERTH_ERROR_CONFIG, berth_drive_init(&drive, &config, &refusal));
    TEST_ASSERT_EQUAL(BERTH_FIELD_POLE_PAIRS, refusal.field);
    config.pole_pairs = 0;
    TEST_ASSERT_EQUAL(BERTH_ERROR_CONFIG, berth_drive_init(&drive, &config, &refusal));
    TEST_ASSERT_EQUAL(BERTH_FIELD_POLE_PAIRS, refusal.field);
    config = good_config();
    config.node = 255;
    TEST_ASSERT_EQUAL(BERTH_ERROR_CONFIG, berth_drive_init(&drive, &config, &refusal));
    TEST_ASSERT_EQUAL(BERTH_FIELD_DRIVE_NODE, refusal.field);
}

static void test_filters_are_exactly_the_ids_in_use(void) {
    berth_can_filter_t filters[BERTH_DRIVE_FILTERS_MAX];
    TEST_ASSERT_EQUAL(2, berth_drive_filters(&drive, filters));
    TEST_ASSERT_EQUAL_HEX32(0x90B, filters[0].id);
    TEST_ASSERT_EQUAL_HEX32(0x1B0B, filters[1].id);
    for (uint32_t i = 0; i < 2; i++) {
        TEST_ASSERT_EQUAL_HEX32(0x1FFFFFFF, filters[i].mask);
        TEST_ASSERT_TRUE(filters[i].extended);
    }
}

static void test_any_frames_at_any_time_never_break_it(void) {
    const uint32_t ids[] = {0x90B, 0x1B0B, 0x30B, 0x90C};
    support_random_start();
    make_enabled(0);
    for (uint32_t run = 0; run < support_runs(200000); run++) {
        berth_can_frame_t frame = {
            .id = ids[support_index(4)],
            .extended = support_index(8) != 0,
            .remote = support_index(8) == 0,
            .length = (uint8_t)(support_index(2) == 0 ? 8 : support_index(10)),
        };
        for (uint32_t i = support_index(4); i < 8; i++) {
            frame.data[i] = (uint8_t)support_index(256);
        }
        const int64_t now_us = (int64_t)support_index(1000000);
        (void)berth_drive_receive(&drive, &frame, now_us);
        berth_drive_step(&drive, now_us, &outbox);
        TEST_ASSERT_TRUE(isfinite(berth_drive_travel(&drive, now_us)));
        TEST_ASSERT_TRUE(isfinite(berth_drive_status(&drive)->velocity_radps));
        berth_drive_cycle(&drive, now_us, &outbox);
        if (berth_drive_status(&drive)->state == BERTH_DRIVE_FAULT) {
            berth_drive_reset(&drive);
            berth_drive_enable(&drive, now_us);
        }
        berth_outbox_clear(&outbox);
    }
    TEST_ASSERT_TRUE(berth_drive_status(&drive)->received > 0);
    TEST_ASSERT_TRUE(berth_drive_status(&drive)->malformed > 0);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_a_status_enables);
    RUN_TEST(test_whichever_status_is_lost_the_next_enables);
    RUN_TEST(test_no_status_is_a_fault);
    RUN_TEST(test_silence_is_a_fault_and_brakes);
    RUN_TEST(test_a_shorter_heartbeat_timeout_bites_first);
    RUN_TEST(test_the_speed_command);
    RUN_TEST(test_gear_sign_and_pole_pairs_of_the_command);
    RUN_TEST(test_speeds_saturate_and_are_counted);
    RUN_TEST(test_a_newer_command_takes_the_place_of_one_that_waits);
    RUN_TEST(test_stops_brake_and_leave_no_speed_waiting);
    RUN_TEST(test_disabling_releases_the_motor);
    RUN_TEST(test_status_1_bytes);
    RUN_TEST(test_bad_frames_change_nothing);
    RUN_TEST(test_frames_of_others_are_left_alone);
    RUN_TEST(test_without_status_5_the_speed_tells_the_travel);
    RUN_TEST(test_the_tachometer_wraps);
    RUN_TEST(test_status_5_bytes_and_its_short_form);
    RUN_TEST(test_a_tachometer_that_was_reset_is_counted_and_no_travel);
    RUN_TEST(test_disable_and_enable_again);
    RUN_TEST(test_configuration);
    RUN_TEST(test_filters_are_exactly_the_ids_in_use);
    RUN_TEST(test_any_frames_at_any_time_never_break_it);
    return UNITY_END();
}
