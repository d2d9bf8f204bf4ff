/* The simulated ODrive and VESC against their protocols' documents: what they say, what they obey
 * and what stops them. Float32 bytes: 1.0 = 00 00 80 3f, 2.5 = 00 00 20 40, -1.5 = 00 00 c0 bf.
 */
#include "drive_sim_rig.h"
#include "support.h"

#include "unity.h"

#include <math.h>

#define ODRIVE_ID(command) (3u << 5 | (command))
#define VESC_ID(packet) ((uint32_t)(packet) << 8 | 0x2au)

static const drive_sim_config_t odrive = {.kind = DRIVE_SIM_ODRIVE,
                                          .node = 3,
                                          .sign = 1,
                                          .gear_ratio = 5.0,
                                          .feedback_us = 10000,
                                          .heartbeat_us = 100000,
                                          .watchdog_us = 50000};

static const drive_sim_config_t vesc = {.kind = DRIVE_SIM_VESC,
                                        .node = 0x2a,
                                        .sign = -1,
                                        .gear_ratio = 3.0,
                                        .pole_pairs = 7,
                                        .feedback_us = 20000,
                                        .watchdog_us = 500000};

void setUp(void) {}

void tearDown(void) {
    rig_destroy();
}

static double target_turns_per_s(void) {
    return drive_sim_target_radps(rig_sim) / RIG_TWO_PI;
}

static unsigned long malformed(void) {
    return drive_sim_counters(rig_sim).malformed;
}

/* ODrive */

static void odrive_create(void) {
    rig_create(&odrive);
}

static void odrive_state(uint8_t state) {
    TEST_ASSERT_TRUE(rig_standard(ODRIVE_ID(0x07), RIG_BYTES(state, 0, 0, 0)));
}

static void odrive_velocity_mode(void) {
    TEST_ASSERT_TRUE(rig_standard(ODRIVE_ID(0x0b), RIG_BYTES(2, 0, 0, 0, 1, 0, 0, 0)));
}

/* 2.5 motor turns/s, no torque: half a wheel turn/s behind a gear of 5. */
static void odrive_velocity(void) {
    TEST_ASSERT_TRUE(rig_standard(ODRIVE_ID(0x0d), RIG_BYTES(0, 0, 0x20, 0x40, 0, 0, 0, 0)));
}

static void odrive_run_velocity(void) {
    odrive_velocity_mode();
    odrive_state(8);
    odrive_velocity();
    TEST_ASSERT_TRUE(drive_sim_enabled(rig_sim));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.5, target_turns_per_s());
}

/* Asks for the heartbeat, which must say this. */
static void odrive_expect_heartbeat(const uint8_t *data, uint8_t length) {
    (void)rig_drop();
    TEST_ASSERT_TRUE(rig_remote(ODRIVE_ID(0x01), false, 8));
    rig_expect_standard(0x061, data, length);
}

static void test_odrive_speaks_cyclically(void) {
    odrive_create();
    /* Minus 0.3 wheel turns are -1.5 motor turns; 0.2 wheel turns/s are 1. */
    rig_wheel(-0.3, 0.2);
    rig_run(9999);
    rig_expect_nothing();
    rig_run(1);
    rig_expect_standard(0x069, RIG_BYTES(0, 0, 0xc0, 0xbf, 0, 0, 0x80, 0x3f));
    rig_expect_nothing();
    rig_run(80000);
    TEST_ASSERT_EQUAL_UINT(8, rig_drop());
    rig_run(10000);
    rig_expect_standard(0x061, RIG_BYTES(0, 0, 0, 0, 1, 0, 0, 0));
    TEST_ASSERT_EQUAL_UINT(1, rig_drop());
}

static void test_odrive_late_step_does_not_repeat_itself(void) {
    odrive_create();
    rig_now_us = 1005000;
    drive_sim_step(rig_sim, rig_now_us);
    TEST_ASSERT_EQUAL_UINT(2, rig_drop());
    TEST_ASSERT_EQUAL_INT64(1010000, drive_sim_deadline(rig_sim));
    /* Time that goes back is no reason to speak. */
    drive_sim_step(rig_sim, 5);
    rig_expect_nothing();
}

static void test_odrive_answers_requests(void) {
    odrive_create();
    rig_wheel(-0.3, 0.2);
    TEST_ASSERT_TRUE(rig_remote(ODRIVE_ID(0x09), false, 8));
    rig_expect_standard(0x069, RIG_BYTES(0, 0, 0xc0, 0xbf, 0, 0, 0x80, 0x3f));
    TEST_ASSERT_TRUE(rig_remote(ODRIVE_ID(0x01), false, 0));
    rig_expect_standard(0x061, RIG_BYTES(0, 0, 0, 0, 1, 0, 0, 0));
    TEST_ASSERT_TRUE(rig_remote(ODRIVE_ID(0x03), false, 8));
    rig_expect_standard(0x063, RIG_BYTES(0, 0, 0, 0, 0, 0, 0, 0));
    TEST_ASSERT_EQUAL_UINT(0, malformed());
}

static void test_odrive_obeys_velocity_only_in_closed_loop_and_velocity_mode(void) {
    odrive_create();
    odrive_velocity();
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, target_turns_per_s());

    odrive_state(8); /* still in position mode: torque, but it stands */
    odrive_velocity();
    TEST_ASSERT_TRUE(drive_sim_enabled(rig_sim));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, target_turns_per_s());
    TEST_ASSERT_EQUAL_UINT(0, drive_sim_counters(rig_sim).commands);

    /* Velocity with the input switched off. */
    TEST_ASSERT_TRUE(rig_standard(ODRIVE_ID(0x0b), RIG_BYTES(2, 0, 0, 0, 0, 0, 0, 0)));
    odrive_velocity();
    TEST_ASSERT_EQUAL_DOUBLE(0.0, target_turns_per_s());

    /* Velocity behind its ramp, then modes that are none of this robot's. */
    TEST_ASSERT_TRUE(rig_standard(ODRIVE_ID(0x0b), RIG_BYTES(2, 0, 0, 0, 2, 0, 0, 0)));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.5, target_turns_per_s());
    TEST_ASSERT_TRUE(rig_standard(ODRIVE_ID(0x0b), RIG_BYTES(3, 0, 0, 0, 8, 0, 0, 0)));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, target_turns_per_s());
    TEST_ASSERT_TRUE(rig_standard(ODRIVE_ID(0x0b), RIG_BYTES(1, 0, 0, 0, 1, 0, 0, 0)));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, target_turns_per_s());
    TEST_ASSERT_EQUAL_UINT(0, malformed());

    odrive_velocity_mode();
    odrive_velocity();
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.5, target_turns_per_s());
    TEST_ASSERT_EQUAL_UINT(1, drive_sim_counters(rig_sim).commands);
    odrive_expect_heartbeat(RIG_BYTES(0, 0, 0, 0, 8, 1, 0, 0));

    odrive_state(1);
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, target_turns_per_s());
    odrive_expect_heartbeat(RIG_BYTES(0, 0, 0, 0, 1, 0, 0, 0));
}

static void test_odrive_mounted_the_other_way_round(void) {
    drive_sim_config_t config = odrive;
    config.sign = -1;
    rig_create(&config);
    odrive_velocity_mode();
    odrive_state(8);
    odrive_velocity();
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, -0.5, target_turns_per_s());
    rig_wheel(0.3, -0.2);
    TEST_ASSERT_TRUE(rig_remote(ODRIVE_ID(0x09), false, 8));
    rig_expect_standard(0x069, RIG_BYTES(0, 0, 0xc0, 0xbf, 0, 0, 0x80, 0x3f));
}

static void test_odrive_watchdog_disarms_until_errors_are_cleared(void) {
    odrive_create();
    odrive_run_velocity();
    rig_run(40000);
    odrive_velocity(); /* feeds it */
    rig_run(49999);
    TEST_ASSERT_TRUE(drive_sim_enabled(rig_sim));
    rig_run(1);
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
    TEST_ASSERT_EQUAL_UINT(1, drive_sim_counters(rig_sim).watchdog_stops);
    odrive_expect_heartbeat(RIG_BYTES(0, 0, 0, 1, 1, 3, 0, 0)); /* 0x01000000 */
    TEST_ASSERT_TRUE(rig_remote(ODRIVE_ID(0x03), false, 8));
    rig_expect_standard(0x063, RIG_BYTES(0, 0, 0, 1, 0, 0, 0, 1));

    odrive_velocity(); /* too late */
    odrive_state(8);
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
    odrive_expect_heartbeat(RIG_BYTES(0, 0, 0, 1, 1, 3, 0, 0));

    TEST_ASSERT_TRUE(rig_standard(ODRIVE_ID(0x18), RIG_BYTES(0)));
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
    odrive_state(8);
    TEST_ASSERT_TRUE(drive_sim_enabled(rig_sim));
    odrive_expect_heartbeat(RIG_BYTES(0, 0, 0, 0, 8, 1, 0, 0));
    /* The old input is still there: it is the master's to give a new one first. */
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.5, target_turns_per_s());
}

static void test_odrive_watchdog_looks_before_a_late_frame(void) {
    odrive_create();
    odrive_run_velocity();
    rig_now_us += 60000; /* nobody called step in between */
    odrive_velocity();
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
}

static void test_odrive_watchdog_begins_with_the_closed_loop(void) {
    odrive_create();
    rig_run(1000000);
    odrive_state(8);
    TEST_ASSERT_TRUE(drive_sim_deadline(rig_sim) <= rig_now_us + 50000);
    rig_run(40000);
    odrive_state(8); /* again: feeds nothing */
    rig_run(9999);
    TEST_ASSERT_TRUE(drive_sim_enabled(rig_sim));
    rig_run(1);
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
}

static void test_odrive_watchdog_sleeps_when_idle_or_not_wanted(void) {
    odrive_create();
    rig_run(1000000);
    odrive_expect_heartbeat(RIG_BYTES(0, 0, 0, 0, 1, 0, 0, 0));
    rig_destroy();
    drive_sim_config_t config = odrive;
    config.watchdog_us = 0;
    rig_create(&config);
    odrive_run_velocity();
    rig_run(60000000);
    TEST_ASSERT_TRUE(drive_sim_enabled(rig_sim));
}

static void test_odrive_emergency_stop(void) {
    odrive_create();
    odrive_run_velocity();
    TEST_ASSERT_TRUE(rig_standard(ODRIVE_ID(0x02), NULL, 0));
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
    odrive_expect_heartbeat(RIG_BYTES(0, 0, 0, 2, 1, 3, 0, 0)); /* 0x02000000 */
    odrive_state(8);
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
    TEST_ASSERT_TRUE(rig_standard(ODRIVE_ID(0x18), NULL, 0));
    odrive_state(8);
    TEST_ASSERT_TRUE(drive_sim_enabled(rig_sim));
}

static void test_odrive_own_error(void) {
    odrive_create();
    odrive_run_velocity();
    drive_sim_fail(rig_sim, 0x00000200); /* DC bus undervoltage */
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
    drive_sim_fail(rig_sim, 0x00002000); /* and a hot motor, when it is idle already */
    odrive_expect_heartbeat(RIG_BYTES(0, 0x22, 0, 0, 1, 3, 0, 0));
    TEST_ASSERT_TRUE(rig_remote(ODRIVE_ID(0x03), false, 8));
    rig_expect_standard(0x063, RIG_BYTES(0, 0x22, 0, 0, 0, 0x02, 0, 0));
}

static void test_odrive_malformed_frames_change_nothing(void) {
    odrive_create();
    odrive_run_velocity();
    unsigned long expected = 0;
    const uint8_t nan_velocity[] = {0, 0, 0xc0, 0x7f, 0, 0, 0, 0};
    const uint8_t infinite_torque[] = {0, 0, 0x80, 0x3f, 0, 0, 0x80, 0xff};
    const uint8_t zeros[8] = {0};
    TEST_ASSERT_TRUE(rig_standard(ODRIVE_ID(0x0d), nan_velocity, 8));
    TEST_ASSERT_TRUE(rig_standard(ODRIVE_ID(0x0d), infinite_torque, 8));
    expected += 2;
    for (uint8_t length = 0; length < 8; length++) {
        TEST_ASSERT_TRUE(rig_standard(ODRIVE_ID(0x0d), zeros, length));
        TEST_ASSERT_TRUE(rig_standard(ODRIVE_ID(0x0b), zeros, length));
        expected += 2;
    }
    for (uint8_t length = 0; length < 4; length++) {
        const uint8_t idle[4] = {1, 0, 0, 0};
        TEST_ASSERT_TRUE(rig_standard(ODRIVE_ID(0x07), idle, length));
        expected += 1;
    }
    TEST_ASSERT_TRUE(rig_standard(ODRIVE_ID(0x07), RIG_BYTES(3, 0, 0, 0))); /* calibrate */
    TEST_ASSERT_TRUE(rig_standard(ODRIVE_ID(0x07), RIG_BYTES(1, 0, 0, 1))); /* 0x01000001 */
    TEST_ASSERT_TRUE(rig_standard(ODRIVE_ID(0x0b), RIG_BYTES(9, 0, 0, 0, 1, 0, 0, 0)));
    TEST_ASSERT_TRUE(rig_standard(ODRIVE_ID(0x0b), RIG_BYTES(2, 0, 0, 0, 9, 0, 0, 0)));
    TEST_ASSERT_TRUE(rig_standard(ODRIVE_ID(0x0b), RIG_BYTES(4, 0, 0, 0, 1, 0, 0, 0)));
    TEST_ASSERT_TRUE(rig_standard(ODRIVE_ID(0x01), zeros, 8));
    TEST_ASSERT_TRUE(rig_standard(ODRIVE_ID(0x09), zeros, 8));
    TEST_ASSERT_TRUE(rig_remote(ODRIVE_ID(0x0d), false, 8));
    TEST_ASSERT_TRUE(rig_remote(ODRIVE_ID(0x02), false, 0));
    expected += 9;
    TEST_ASSERT_EQUAL_UINT(expected, malformed());
    TEST_ASSERT_TRUE(drive_sim_enabled(rig_sim));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.5, target_turns_per_s());
    rig_expect_nothing();
}

static void test_odrive_ignores_other_nodes_and_extended_frames(void) {
    odrive_create();
    TEST_ASSERT_FALSE(rig_standard(2u << 5 | 0x02, NULL, 0));
    TEST_ASSERT_FALSE(rig_standard(0x000, RIG_BYTES(1, 0)));
    TEST_ASSERT_FALSE(rig_extended(ODRIVE_ID(0x02), NULL, 0));
    TEST_ASSERT_EQUAL_UINT(0, drive_sim_counters(rig_sim).received);
    /* A command of the protocol that has no effect here is no error. */
    TEST_ASSERT_TRUE(rig_standard(ODRIVE_ID(0x0f), RIG_BYTES(0, 0, 0, 0, 0, 0, 0, 0)));
    TEST_ASSERT_EQUAL_UINT(0, malformed());
    odrive_expect_heartbeat(RIG_BYTES(0, 0, 0, 0, 1, 0, 0, 0));
    TEST_ASSERT_EQUAL_UINT(2, drive_sim_counters(rig_sim).received);
    TEST_ASSERT_EQUAL_UINT(1, drive_sim_counters(rig_sim).sent);
}

static void test_odrive_trouble(void) {
    odrive_create();
    odrive_run_velocity();
    rig_trouble((drive_sim_trouble_t){.mute_feedback = true});
    for (int i = 0; i < 5; i++) {
        odrive_velocity();
        rig_run(20000);
    }
    rig_expect_standard(0x061, RIG_BYTES(0, 0, 0, 0, 8, 1, 0, 0));
    rig_expect_nothing();
    rig_trouble((drive_sim_trouble_t){.mute_heartbeat = true});
    for (int i = 0; i < 5; i++) {
        odrive_velocity();
        rig_run(20000);
    }
    TEST_ASSERT_EQUAL_UINT(10, rig_drop()); /* without the heartbeat at 200 ms */
    rig_trouble((drive_sim_trouble_t){.dead = true});
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, target_turns_per_s());
    TEST_ASSERT_FALSE(rig_standard(ODRIVE_ID(0x02), NULL, 0));
    TEST_ASSERT_EQUAL_INT64(INT64_MAX, drive_sim_deadline(rig_sim));
    rig_run(1000000);
    rig_expect_nothing();
    /* Powered again, it starts from scratch. */
    rig_trouble((drive_sim_trouble_t){0});
    odrive_expect_heartbeat(RIG_BYTES(0, 0, 0, 0, 1, 0, 0, 0));
    odrive_state(8);
    odrive_velocity();
    TEST_ASSERT_EQUAL_DOUBLE(0.0, target_turns_per_s());
}

static void test_too_many_waiting_frames_are_lost_and_counted(void) {
    odrive_create();
    rig_run(1000000); /* 100 estimates, 10 heartbeats */
    TEST_ASSERT_EQUAL_UINT(32, rig_drop());
    TEST_ASSERT_EQUAL_UINT(78, drive_sim_counters(rig_sim).overruns);
    TEST_ASSERT_EQUAL_UINT(32, drive_sim_counters(rig_sim).sent);
    drive_sim_sent(rig_sim); /* nothing waits: no effect */
    TEST_ASSERT_EQUAL_UINT(32, drive_sim_counters(rig_sim).sent);
}

/* VESC */

static void vesc_create(void) {
    rig_create(&vesc);
}

/* 12600 ERPM = 210 electrical turns/s = 30 motor turns/s; the wheel turns 10 backwards. */
static void vesc_speed(void) {
    TEST_ASSERT_TRUE(rig_extended(VESC_ID(3), RIG_BYTES(0, 0, 0x31, 0x38)));
}

static void test_vesc_speaks_cyclically(void) {
    vesc_create();
    /* 1 wheel turn = -3 motor turns = -21 electrical turns = -126 steps. 2 wheel turns/s =
     * -42 electrical turns/s = -2520 ERPM. The supply is 24.0 V. */
    rig_wheel(1.0, 2.0);
    rig_run(20000);
    rig_expect_extended(0x92a, RIG_BYTES(0xff, 0xff, 0xf6, 0x28, 0, 0, 0, 0));
    rig_expect_extended(0x1b2a, RIG_BYTES(0xff, 0xff, 0xff, 0x82, 0, 0xf0, 0, 0));
    rig_expect_nothing();
    rig_run(40000);
    TEST_ASSERT_EQUAL_UINT(4, rig_drop());
}

static void vesc_expect_tachometer(double steps, const uint8_t *data, uint8_t length) {
    rig_wheel(-steps / 126.0, 0.0);
    rig_run(20000);
    rig_expect_extended(0x92a, RIG_BYTES(0, 0, 0, 0, 0, 0, 0, 0));
    rig_expect_extended(0x1b2a, data, length);
}

static void test_vesc_tachometer_counts_whole_steps_and_wraps(void) {
    vesc_create();
    vesc_expect_tachometer(0.75, RIG_BYTES(0, 0, 0, 0, 0, 0xf0, 0, 0));
    vesc_expect_tachometer(1.25, RIG_BYTES(0, 0, 0, 1, 0, 0xf0, 0, 0));
    vesc_expect_tachometer(-0.25, RIG_BYTES(0xff, 0xff, 0xff, 0xff, 0, 0xf0, 0, 0));
    vesc_expect_tachometer(-1.25, RIG_BYTES(0xff, 0xff, 0xff, 0xfe, 0, 0xf0, 0, 0));
    vesc_expect_tachometer(2147483647.5, RIG_BYTES(0x7f, 0xff, 0xff, 0xff, 0, 0xf0, 0, 0));
    vesc_expect_tachometer(2147483648.5, RIG_BYTES(0x80, 0, 0, 0, 0, 0xf0, 0, 0));
    vesc_expect_tachometer(-2147483648.5, RIG_BYTES(0x7f, 0xff, 0xff, 0xff, 0, 0xf0, 0, 0));
    vesc_expect_tachometer(4294967298.5, RIG_BYTES(0, 0, 0, 2, 0, 0xf0, 0, 0));
}

static void test_vesc_speed_is_cut_to_whole_erpm(void) {
    vesc_create();
    rig_wheel(0.0, -1.9 / 1260.0); /* 1.9 ERPM */
    rig_run(20000);
    rig_expect_extended(0x92a, RIG_BYTES(0, 0, 0, 1, 0, 0, 0, 0));
    (void)rig_drop();
    rig_wheel(0.0, 1.9 / 1260.0);
    rig_run(20000);
    rig_expect_extended(0x92a, RIG_BYTES(0xff, 0xff, 0xff, 0xff, 0, 0, 0, 0));
    (void)rig_drop();
    rig_wheel(0.0, -1e12); /* beyond what the number can hold */
    rig_run(20000);
    rig_expect_extended(0x92a, RIG_BYTES(0x7f, 0xff, 0xff, 0xff, 0, 0, 0, 0));
}

static void test_vesc_obeys_speed_and_times_out(void) {
    vesc_create();
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
    vesc_speed();
    TEST_ASSERT_TRUE(drive_sim_enabled(rig_sim));
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, -10.0, target_turns_per_s());
    rig_run(499999);
    TEST_ASSERT_TRUE(drive_sim_enabled(rig_sim));
    rig_run(1);
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, target_turns_per_s());
    TEST_ASSERT_EQUAL_UINT(1, drive_sim_counters(rig_sim).watchdog_stops);
    vesc_speed(); /* the next command sets it going again */
    TEST_ASSERT_TRUE(drive_sim_enabled(rig_sim));
    TEST_ASSERT_EQUAL_UINT(2, drive_sim_counters(rig_sim).commands);
    /* Node 255 is everybody; minus 12600 ERPM. */
    TEST_ASSERT_TRUE(rig_extended(0x3ff, RIG_BYTES(0xff, 0xff, 0xce, 0xc8)));
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 10.0, target_turns_per_s());
    TEST_ASSERT_TRUE(rig_extended(VESC_ID(3), RIG_BYTES(0x80, 0, 0, 0)));
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 100000.0 / 1260.0, target_turns_per_s()); /* its limit */
}

static void test_vesc_current_brake_and_duty(void) {
    vesc_create();
    vesc_speed();
    TEST_ASSERT_TRUE(rig_extended(VESC_ID(2), RIG_BYTES(0, 0, 0x13, 0x88))); /* brake with 5 A */
    TEST_ASSERT_TRUE(drive_sim_enabled(rig_sim));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, target_turns_per_s());
    TEST_ASSERT_TRUE(rig_extended(VESC_ID(1), RIG_BYTES(0, 0, 0, 0))); /* released */
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
    TEST_ASSERT_TRUE(rig_extended(VESC_ID(1), RIG_BYTES(0, 0, 0x03, 0xe8))); /* 1 A */
    TEST_ASSERT_TRUE(drive_sim_enabled(rig_sim));
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, -1000.0 / 1260.0, target_turns_per_s());
    TEST_ASSERT_TRUE(rig_extended(VESC_ID(1), RIG_BYTES(0, 0, 0, 0, 0, 100)));
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
    TEST_ASSERT_TRUE(rig_extended(VESC_ID(0), RIG_BYTES(0, 0, 0x27, 0x10))); /* a tenth */
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, -10000.0 / 1260.0, target_turns_per_s());
    rig_wheel(0.0, -10.0); /* 12600 ERPM: duty 0.126 */
    rig_run(20000);
    rig_expect_extended(0x92a, RIG_BYTES(0, 0, 0x31, 0x38, 0, 0, 0, 126));
    TEST_ASSERT_TRUE(rig_extended(VESC_ID(2), RIG_BYTES(0, 0, 0, 0)));
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
    TEST_ASSERT_EQUAL_UINT(1, drive_sim_counters(rig_sim).commands);
    TEST_ASSERT_EQUAL_UINT(0, malformed());
}

static void test_vesc_malformed_frames_change_nothing(void) {
    vesc_create();
    vesc_speed();
    const uint8_t zeros[8] = {0};
    unsigned long expected = 0;
    for (uint8_t length = 0; length <= 8; length++) {
        for (uint32_t packet = 0; packet <= 3; packet++) {
            if (length != 4 && !(packet == 1 && length == 6)) {
                TEST_ASSERT_TRUE(rig_extended(VESC_ID(packet), zeros, length));
                expected++;
            }
        }
    }
    TEST_ASSERT_TRUE(rig_remote(VESC_ID(3), true, 4));
    TEST_ASSERT_TRUE(rig_extended(VESC_ID(9), zeros, 8));
    TEST_ASSERT_TRUE(rig_extended(VESC_ID(27), zeros, 8));
    expected += 3;
    TEST_ASSERT_EQUAL_UINT(expected, malformed());
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, -10.0, target_turns_per_s());
    TEST_ASSERT_FALSE(rig_standard(0x32a, zeros, 4)); /* 11 bits are not its protocol */
    TEST_ASSERT_FALSE(rig_extended(0x32b, zeros, 4));
    /* The upper bits of the id belong to the command. */
    TEST_ASSERT_TRUE(rig_extended(0x1000032a, zeros, 4));
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, -10.0, target_turns_per_s());
}

static void test_vesc_without_a_time_out(void) {
    drive_sim_config_t config = vesc;
    config.watchdog_us = 0;
    rig_create(&config);
    vesc_speed();
    rig_run(60000000);
    TEST_ASSERT_TRUE(drive_sim_enabled(rig_sim));
}

static void test_vesc_failing_stops_and_is_deaf_for_half_a_second(void) {
    vesc_create();
    vesc_speed();
    drive_sim_fail(rig_sim, 4);
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
    rig_run(499999);
    vesc_speed();
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
    rig_run(1);
    vesc_speed();
    TEST_ASSERT_TRUE(drive_sim_enabled(rig_sim));
}

static void test_vesc_trouble(void) {
    vesc_create();
    rig_trouble((drive_sim_trouble_t){.mute_feedback = true});
    rig_run(100000);
    rig_expect_nothing();
    rig_trouble((drive_sim_trouble_t){.mute_heartbeat = true});
    rig_run(20000);
    TEST_ASSERT_EQUAL_UINT(2, rig_drop());
    vesc_speed();
    rig_trouble((drive_sim_trouble_t){.dead = true});
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
    rig_trouble((drive_sim_trouble_t){0});
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
}

static void test_hostile_frames(void) {
    support_random_start();
    odrive_create();
    rig_hostile(support_runs(100000));
    rig_destroy();
    vesc_create();
    rig_hostile(support_runs(100000));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_odrive_speaks_cyclically);
    RUN_TEST(test_odrive_late_step_does_not_repeat_itself);
    RUN_TEST(test_odrive_answers_requests);
    RUN_TEST(test_odrive_obeys_velocity_only_in_closed_loop_and_velocity_mode);
    RUN_TEST(test_odrive_mounted_the_other_way_round);
    RUN_TEST(test_odrive_watchdog_disarms_until_errors_are_cleared);
    RUN_TEST(test_odrive_watchdog_looks_before_a_late_frame);
    RUN_TEST(test_odrive_watchdog_begins_with_the_closed_loop);
    RUN_TEST(test_odrive_watchdog_sleeps_when_idle_or_not_wanted);
    RUN_TEST(test_odrive_emergency_stop);
    RUN_TEST(test_odrive_own_error);
    RUN_TEST(test_odrive_malformed_frames_change_nothing);
    RUN_TEST(test_odrive_ignores_other_nodes_and_extended_frames);
    RUN_TEST(test_odrive_trouble);
    RUN_TEST(test_too_many_waiting_frames_are_lost_and_counted);
    RUN_TEST(test_vesc_speaks_cyclically);
    RUN_TEST(test_vesc_tachometer_counts_whole_steps_and_wraps);
    RUN_TEST(test_vesc_speed_is_cut_to_whole_erpm);
    RUN_TEST(test_vesc_obeys_speed_and_times_out);
    RUN_TEST(test_vesc_current_brake_and_duty);
    RUN_TEST(test_vesc_malformed_frames_change_nothing);
    RUN_TEST(test_vesc_without_a_time_out);
    RUN_TEST(test_vesc_failing_stops_and_is_deaf_for_half_a_second);
    RUN_TEST(test_vesc_trouble);
    RUN_TEST(test_hostile_frames);
    return UNITY_END();
}
