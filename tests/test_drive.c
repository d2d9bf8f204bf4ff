/* What all wheel drives share, under a protocol made for the test: states, watchdogs, commands, and
 * travel from speeds and positions. */
#include "support.h"

#include "../firmware/src/drive_protocol.h"

#include "unity.h"

#include <float.h>
#include <math.h>
#include <string.h>

#define RAD_PER_TURN 6.283185307179586
#define FEEDBACK_TIMEOUT_US 100000
#define HEARTBEAT_TIMEOUT_US 70000
#define ENABLE_TIMEOUT_US 500000

/* Which call of the protocol put it is in the id of the frame. */
enum { PUT_DISABLE = 1, PUT_STOP, PUT_EMERGENCY, PUT_CYCLE, PUT_SYNC };

static berth_drive_t drive;
static berth_outbox_t outbox;
static int64_t fake_deadline_us;
static uint32_t steps_done;

static void put(uint32_t id, berth_outbox_t *box) {
    const berth_can_frame_t frame = drive_frame(id, false, 0);
    TEST_ASSERT_TRUE(berth_outbox_put(box, &frame, BERTH_OUTBOX_EACH));
}

static berth_error_t fake_check(const berth_drive_config_t *config, berth_refusal_t *refusal) {
    return drive_check_node(config, 1.0f, 100.0f, refusal);
}

static void fake_enable(berth_drive_t *self, int64_t now_us) {
    self->state.odrive.retry_us = now_us;
    self->state.odrive.step = 200;
}

static void fake_disable(berth_drive_t *self, berth_outbox_t *box) {
    (void)self;
    put(PUT_DISABLE, box);
}

static void fake_stop(berth_drive_t *self, berth_outbox_t *box) {
    (void)self;
    put(PUT_STOP, box);
}

static void fake_emergency(berth_drive_t *self, berth_outbox_t *box) {
    (void)self;
    put(PUT_EMERGENCY, box);
}

static void fake_cycle(berth_drive_t *self, int64_t now_us, berth_outbox_t *box) {
    (void)self;
    (void)now_us;
    put(PUT_CYCLE, box);
}

static void fake_step(berth_drive_t *self, int64_t now_us, berth_outbox_t *box) {
    (void)self;
    (void)now_us;
    (void)box;
    steps_done++;
}

static drive_frame_t fake_receive(berth_drive_t *self, const berth_can_frame_t *frame,
                                  int64_t at_us) {
    (void)self;
    (void)at_us;
    return (drive_frame_t)frame->id;
}

static int64_t fake_deadline(const berth_drive_t *self) {
    (void)self;
    return fake_deadline_us;
}

static uint32_t fake_filters(const berth_drive_t *self, berth_can_filter_t *filters) {
    filters[0] = (berth_can_filter_t){self->config.node, 0x7ff, false};
    return 1;
}

static uint32_t fake_progress(const berth_drive_t *self) {
    return self->state.odrive.step;
}

static const berth_drive_protocol_t fake = {
    .check = fake_check,
    .enable = fake_enable,
    .disable = fake_disable,
    .stop = fake_stop,
    .emergency_stop = fake_emergency,
    .cycle = fake_cycle,
    .receive = fake_receive,
    .step = fake_step,
    .deadline = fake_deadline,
    .filters = fake_filters,
    .progress = fake_progress,
};

static berth_drive_config_t good_config(void) {
    return (berth_drive_config_t){
        .protocol = &fake,
        .node = 5,
        .sign = 1,
        .gear_ratio = 1.0f,
        .period_us = 10000,
        .feedback_timeout_us = FEEDBACK_TIMEOUT_US,
        .heartbeat_timeout_us = HEARTBEAT_TIMEOUT_US,
        .enable_timeout_us = ENABLE_TIMEOUT_US,
    };
}

static void init_with(const berth_drive_config_t *config) {
    berth_refusal_t refusal;
    memset(&drive, 0xa5, sizeof drive); /* nothing may rest on what was there */
    TEST_ASSERT_EQUAL(BERTH_OK, berth_drive_init(&drive, config, &refusal));
}

/* A drive whose motor turns once for a wheel turn: speeds in rad/s of the wheel. */
static void say_speed(double radps, int64_t at_us) {
    const double rps =
        radps / RAD_PER_TURN * (double)drive.config.gear_ratio * (double)drive.config.sign;
    drive_velocity(&drive, (float)rps, at_us);
}

static void expect_frames(const uint32_t *ids, uint32_t count) {
    for (uint32_t i = 0; i < count; i++) {
        const berth_can_frame_t *front = berth_outbox_front(&outbox);
        TEST_ASSERT_NOT_NULL(front);
        TEST_ASSERT_EQUAL(ids[i], front->id);
        berth_outbox_pop(&outbox);
    }
    TEST_ASSERT_NULL(berth_outbox_front(&outbox));
}

static void expect_state(berth_drive_state_t state, berth_drive_fault_t fault, uint32_t code) {
    TEST_ASSERT_EQUAL(state, berth_drive_status(&drive)->state);
    TEST_ASSERT_EQUAL(fault, berth_drive_status(&drive)->fault);
    TEST_ASSERT_EQUAL_HEX32(code, berth_drive_status(&drive)->code);
}

static void make_enabled(int64_t now_us) {
    berth_drive_enable(&drive, now_us);
    say_speed(0.0, now_us);
    drive_alive(&drive, now_us);
    drive_enabled(&drive);
    expect_state(BERTH_DRIVE_ENABLED, BERTH_DRIVE_FAULT_NONE, 0);
}

void setUp(void) {
    const berth_drive_config_t config = good_config();
    init_with(&config);
    berth_outbox_reset(&outbox);
    fake_deadline_us = BERTH_TIME_MAX_US;
    steps_done = 0;
}

void tearDown(void) {}

/* --- configuration --------------------------------------------------------------------------- */

static void refuse(const berth_drive_config_t *config, berth_field_t field) {
    berth_refusal_t refusal = {0};
    TEST_ASSERT_EQUAL(BERTH_ERROR_CONFIG, berth_drive_init(&drive, config, &refusal));
    TEST_ASSERT_EQUAL(field, refusal.field);
}

static void test_missing_pointers_are_refused(void) {
    berth_drive_config_t config = good_config();
    berth_refusal_t refusal;
    TEST_ASSERT_EQUAL(BERTH_ERROR_ARGUMENT, berth_drive_init(NULL, &config, &refusal));
    TEST_ASSERT_EQUAL(BERTH_ERROR_ARGUMENT, berth_drive_init(&drive, NULL, &refusal));
    TEST_ASSERT_EQUAL(BERTH_ERROR_ARGUMENT, berth_drive_init(&drive, &config, NULL));
    config.protocol = NULL;
    TEST_ASSERT_EQUAL(BERTH_ERROR_ARGUMENT, berth_drive_init(&drive, &config, &refusal));
}

static void test_sign_and_gear_out_of_range_are_refused(void) {
    const int8_t signs[] = {0, 2, -2, 127, -128};
    for (size_t i = 0; i < sizeof signs; i++) {
        berth_drive_config_t config = good_config();
        config.sign = signs[i];
        refuse(&config, BERTH_FIELD_DRIVE_SIGN);
    }
    const float gears[] = {0.0f, 0.00099f, 1000.1f, -1.0f, NAN, INFINITY};
    for (size_t i = 0; i < sizeof gears / sizeof gears[0]; i++) {
        berth_drive_config_t config = good_config();
        config.gear_ratio = gears[i];
        refuse(&config, BERTH_FIELD_GEAR_RATIO);
    }
}

static void test_times_and_node_out_of_range_are_refused(void) {
    const uint32_t times[] = {0, 999, 60000010, UINT32_MAX};
    for (size_t i = 0; i < sizeof times / sizeof times[0]; i++) {
        berth_drive_config_t config = good_config();
        config.feedback_timeout_us = times[i];
        refuse(&config, BERTH_FIELD_FEEDBACK_TIMEOUT);
        config = good_config();
        config.heartbeat_timeout_us = times[i];
        refuse(&config, BERTH_FIELD_HEARTBEAT_TIMEOUT);
        config = good_config();
        config.enable_timeout_us = times[i];
        refuse(&config, BERTH_FIELD_ENABLE_TIMEOUT);
        config = good_config();
        config.period_us = times[i] > 1000 ? times[i] : 0;
        refuse(&config, BERTH_FIELD_PLAN_PERIOD);
    }
    berth_drive_config_t config = good_config();
    config.node = 101; /* the protocol's own check */
    refuse(&config, BERTH_FIELD_DRIVE_NODE);
}

static void test_extremes_of_the_configuration_are_good(void) {
    berth_drive_config_t config = good_config();
    config.sign = -1;
    config.gear_ratio = 0.001f;
    config.feedback_timeout_us = 1000;
    config.heartbeat_timeout_us = 1000;
    config.enable_timeout_us = 1000;
    init_with(&config);
    config.gear_ratio = 1000.0f;
    config.feedback_timeout_us = 10000000;
    config.heartbeat_timeout_us = 10000000;
    config.enable_timeout_us = 60000000;
    init_with(&config);
    expect_state(BERTH_DRIVE_OFF, BERTH_DRIVE_FAULT_NONE, 0);
    TEST_ASSERT_EQUAL(-1, berth_drive_status(&drive)->feedback_us);
    TEST_ASSERT_EQUAL(-1, berth_drive_status(&drive)->heartbeat_us);
}

/* --- states ------------------------------------------------------------------------------------
 */

static void test_a_protocols_state_starts_as_zero(void) {
    unsigned char bytes[sizeof drive.state];
    memcpy(bytes, &drive.state, sizeof bytes);
    for (size_t i = 0; i < sizeof bytes; i++) {
        TEST_ASSERT_EQUAL_HEX8(0, bytes[i]);
    }
}

static void test_enabling_needs_feedback_and_a_sign_of_life(void) {
    berth_drive_enable(&drive, 1000);
    drive_enabled(&drive);
    expect_state(BERTH_DRIVE_STARTING, BERTH_DRIVE_FAULT_NONE, 0);
    say_speed(1.0, 2000);
    drive_enabled(&drive);
    expect_state(BERTH_DRIVE_STARTING, BERTH_DRIVE_FAULT_NONE, 0);
    drive_alive(&drive, 2000);
    expect_state(BERTH_DRIVE_STARTING, BERTH_DRIVE_FAULT_NONE, 0);
    drive_enabled(&drive);
    expect_state(BERTH_DRIVE_ENABLED, BERTH_DRIVE_FAULT_NONE, 0);

    setUp();
    berth_drive_enable(&drive, 1000);
    drive_alive(&drive, 2000);
    drive_enabled(&drive);
    expect_state(BERTH_DRIVE_STARTING, BERTH_DRIVE_FAULT_NONE, 0);
}

static void test_only_a_starting_drive_becomes_enabled(void) {
    say_speed(1.0, 1000);
    drive_alive(&drive, 1000);
    drive_enabled(&drive);
    expect_state(BERTH_DRIVE_OFF, BERTH_DRIVE_FAULT_NONE, 0);
    make_enabled(2000);
    berth_drive_stop(&drive, &outbox);
    drive_enabled(&drive);
    expect_state(BERTH_DRIVE_STOPPED, BERTH_DRIVE_FAULT_NONE, 0);
    drive_fail(&drive, BERTH_DRIVE_FAULT_DEVICE, 77);
    drive_enabled(&drive);
    expect_state(BERTH_DRIVE_FAULT, BERTH_DRIVE_FAULT_DEVICE, 77);
}

static void test_enabling_forgets_what_was_measured_before(void) {
    make_enabled(1000);
    say_speed(3.0, 2000);
    TEST_ASSERT_TRUE(drive_position(&drive, 0.0f, 0.0f, 2000));
    berth_drive_disable(&drive, &outbox);
    say_speed(3.0, 3000);
    berth_drive_enable(&drive, 4000);
    const berth_drive_status_t *status = berth_drive_status(&drive);
    TEST_ASSERT_EQUAL(-1, status->feedback_us);
    TEST_ASSERT_EQUAL(-1, status->heartbeat_us);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, status->velocity_radps);
    TEST_ASSERT_FALSE(status->position_used);
    drive_enabled(&drive);
    expect_state(BERTH_DRIVE_STARTING, BERTH_DRIVE_FAULT_NONE, 0);
}

static void test_enable_in_other_states_changes_nothing(void) {
    make_enabled(1000);
    berth_drive_command(&drive, 2.0f);
    berth_drive_enable(&drive, 2000);
    expect_state(BERTH_DRIVE_ENABLED, BERTH_DRIVE_FAULT_NONE, 0);
    TEST_ASSERT_TRUE(drive_motor_rps(&drive) > 0.0f);
    drive_fail(&drive, BERTH_DRIVE_FAULT_DEVICE, 1);
    berth_drive_enable(&drive, 3000);
    expect_state(BERTH_DRIVE_FAULT, BERTH_DRIVE_FAULT_DEVICE, 1);
}

static void test_stops_and_what_they_put(void) {
    const uint32_t stop[] = {PUT_STOP};
    const uint32_t emergency[] = {PUT_EMERGENCY};
    berth_drive_stop(&drive, &outbox); /* off: told all the same */
    expect_state(BERTH_DRIVE_OFF, BERTH_DRIVE_FAULT_NONE, 0);
    expect_frames(stop, 1);

    berth_drive_enable(&drive, 1000);
    berth_drive_emergency_stop(&drive, &outbox);
    expect_state(BERTH_DRIVE_STOPPED, BERTH_DRIVE_FAULT_NONE, 0);
    expect_frames(emergency, 1);

    make_enabled(2000);
    berth_drive_command(&drive, 2.0f);
    berth_drive_stop(&drive, &outbox);
    expect_state(BERTH_DRIVE_STOPPED, BERTH_DRIVE_FAULT_NONE, 0);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, drive_motor_rps(&drive));
    berth_drive_command(&drive, 2.0f);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, drive_motor_rps(&drive));
    expect_frames(stop, 1);

    make_enabled(3000); /* enabled anew: the old command is gone */
    TEST_ASSERT_EQUAL_FLOAT(0.0f, drive_motor_rps(&drive));
}

static void test_a_fault_is_kept_until_reset(void) {
    drive_fail(&drive, BERTH_DRIVE_FAULT_DEVICE, 5);
    expect_state(BERTH_DRIVE_OFF, BERTH_DRIVE_FAULT_NONE, 0); /* off has no faults */
    make_enabled(1000);
    berth_drive_command(&drive, 2.0f);
    drive_fail(&drive, BERTH_DRIVE_FAULT_DISABLED, 3);
    drive_fail(&drive, BERTH_DRIVE_FAULT_DEVICE, 9);
    expect_state(BERTH_DRIVE_FAULT, BERTH_DRIVE_FAULT_DISABLED, 3);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, drive_motor_rps(&drive));
    berth_drive_stop(&drive, &outbox);
    berth_drive_disable(&drive, &outbox);
    expect_state(BERTH_DRIVE_FAULT, BERTH_DRIVE_FAULT_DISABLED, 3);
    berth_drive_reset(&drive);
    expect_state(BERTH_DRIVE_OFF, BERTH_DRIVE_FAULT_NONE, 0);
    berth_drive_reset(&drive);
    expect_state(BERTH_DRIVE_OFF, BERTH_DRIVE_FAULT_NONE, 0);
    make_enabled(2000);
    berth_drive_reset(&drive); /* nothing to reset */
    expect_state(BERTH_DRIVE_ENABLED, BERTH_DRIVE_FAULT_NONE, 0);
}

static void test_cycle_speaks_in_every_state_but_off_and_released(void) {
    const uint32_t cycle[] = {PUT_CYCLE};
    const uint32_t released[] = {PUT_DISABLE};
    berth_drive_cycle(&drive, 0, &outbox);
    expect_frames(NULL, 0);
    berth_drive_enable(&drive, 1000);
    berth_drive_cycle(&drive, 1000, &outbox);
    expect_frames(cycle, 1);
    make_enabled(1000);
    berth_drive_cycle(&drive, 1000, &outbox);
    expect_frames(cycle, 1);
    drive_fail(&drive, BERTH_DRIVE_FAULT_DEVICE, 1);
    berth_drive_cycle(&drive, 1000, &outbox);
    expect_frames(cycle, 1);
    berth_drive_disable(&drive, &outbox);
    expect_frames(released, 1);
    berth_drive_cycle(&drive, 1000, &outbox);
    expect_frames(NULL, 0);
    berth_drive_reset(&drive);
    make_enabled(2000); /* no longer released */
    berth_drive_cycle(&drive, 2000, &outbox);
    expect_frames(cycle, 1);
}

/* --- watchdogs ---------------------------------------------------------------------------------
 */

static void step_at(int64_t now_us) {
    berth_drive_step(&drive, now_us, &outbox);
}

static void test_no_feedback_is_a_fault_at_its_microsecond(void) {
    make_enabled(1000);
    say_speed(0.0, 5000);
    drive_alive(&drive, 50000);
    const int64_t bites_us = 5000 + FEEDBACK_TIMEOUT_US + 1;
    TEST_ASSERT_EQUAL(bites_us, berth_drive_deadline(&drive));
    step_at(bites_us - 1);
    expect_state(BERTH_DRIVE_ENABLED, BERTH_DRIVE_FAULT_NONE, 0);
    step_at(bites_us);
    expect_state(BERTH_DRIVE_FAULT, BERTH_DRIVE_FAULT_FEEDBACK, 0);
    TEST_ASSERT_EQUAL(BERTH_TIME_MAX_US, berth_drive_deadline(&drive));
}

static void test_no_heartbeat_is_a_fault_at_its_microsecond(void) {
    make_enabled(1000);
    drive_alive(&drive, 4000);
    drive_alive(&drive, 3000); /* an older one takes nothing back */
    say_speed(0.0, 50000);
    const int64_t bites_us = 4000 + HEARTBEAT_TIMEOUT_US + 1;
    TEST_ASSERT_EQUAL(bites_us, berth_drive_deadline(&drive));
    step_at(bites_us - 1);
    expect_state(BERTH_DRIVE_ENABLED, BERTH_DRIVE_FAULT_NONE, 0);
    step_at(bites_us);
    expect_state(BERTH_DRIVE_FAULT, BERTH_DRIVE_FAULT_HEARTBEAT, 0);
}

static void test_not_enabled_in_time_is_a_fault_at_its_microsecond(void) {
    berth_drive_enable(&drive, 1000);
    say_speed(0.0, 2000); /* starting is not watched otherwise */
    const int64_t bites_us = 1000 + ENABLE_TIMEOUT_US + 1;
    TEST_ASSERT_EQUAL(bites_us, berth_drive_deadline(&drive));
    step_at(bites_us - 1);
    expect_state(BERTH_DRIVE_STARTING, BERTH_DRIVE_FAULT_NONE, 0);
    step_at(bites_us);
    expect_state(BERTH_DRIVE_FAULT, BERTH_DRIVE_FAULT_ENABLE, 200);
}

static void test_a_stopped_drive_is_watched_too(void) {
    make_enabled(1000);
    berth_drive_stop(&drive, &outbox);
    TEST_ASSERT_EQUAL(1000 + HEARTBEAT_TIMEOUT_US + 1, berth_drive_deadline(&drive));
    step_at(1000 + HEARTBEAT_TIMEOUT_US + 1);
    expect_state(BERTH_DRIVE_FAULT, BERTH_DRIVE_FAULT_HEARTBEAT, 0);
}

/* Stopped while starting: there never was a sign of life. */
static void test_watchdogs_count_from_enabling_where_nothing_was_heard(void) {
    berth_drive_enable(&drive, 7000);
    berth_drive_stop(&drive, &outbox);
    step_at(7000 + HEARTBEAT_TIMEOUT_US);
    expect_state(BERTH_DRIVE_STOPPED, BERTH_DRIVE_FAULT_NONE, 0);
    step_at(7000 + HEARTBEAT_TIMEOUT_US + 1);
    expect_state(BERTH_DRIVE_FAULT, BERTH_DRIVE_FAULT_HEARTBEAT, 0);
}

static void test_the_protocols_deadline_counts_and_off_has_none(void) {
    fake_deadline_us = 1234;
    TEST_ASSERT_EQUAL(BERTH_TIME_MAX_US, berth_drive_deadline(&drive));
    step_at(1234);
    TEST_ASSERT_EQUAL(0, steps_done);
    berth_drive_enable(&drive, 1000);
    TEST_ASSERT_EQUAL(1234, berth_drive_deadline(&drive));
    step_at(1234);
    TEST_ASSERT_EQUAL(1, steps_done);
}

static void test_time_at_its_end_and_going_backwards(void) {
    make_enabled(BERTH_TIME_MAX_US - 10);
    step_at(0);
    step_at(BERTH_TIME_MAX_US);
    expect_state(BERTH_DRIVE_ENABLED, BERTH_DRIVE_FAULT_NONE, 0);
    say_speed(1.0, 0);
    TEST_ASSERT_EQUAL(BERTH_TIME_MAX_US - 10, berth_drive_status(&drive)->feedback_us);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, berth_drive_travel(&drive, BERTH_TIME_MAX_US - 10));
}

/* --- commands ----------------------------------------------------------------------------------
 */

static void test_commands_that_are_no_numbers_stand_and_are_counted(void) {
    const float bad[] = {NAN, INFINITY, -INFINITY};
    make_enabled(1000);
    for (uint32_t i = 0; i < 3; i++) {
        berth_drive_command(&drive, 1.0f);
        TEST_ASSERT_TRUE(drive_motor_rps(&drive) > 0.0f);
        berth_drive_command(&drive, bad[i]);
        TEST_ASSERT_EQUAL_FLOAT(0.0f, drive_motor_rps(&drive));
        TEST_ASSERT_EQUAL(i + 1, berth_drive_status(&drive)->refused);
    }
}

static void test_sign_and_gear_of_the_command(void) {
    berth_drive_config_t config = good_config();
    config.sign = -1;
    config.gear_ratio = 12.5f;
    init_with(&config);
    make_enabled(1000);
    berth_drive_command(&drive, (float)RAD_PER_TURN); /* one wheel turn a second */
    TEST_ASSERT_FLOAT_WITHIN(1.0e-5f, -12.5f, drive_motor_rps(&drive));
    say_speed(2.0, 2000);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-6f, 2.0f, berth_drive_status(&drive)->velocity_radps);
}

static void test_integers_are_the_nearest_and_saturate(void) {
    const float most = 2147483520.0f;
    support_random_start();
    for (uint32_t run = 0; run < support_runs(200000); run++) {
        const double sign = support_index(2) == 0 ? -1.0 : 1.0;
        const float value = (float)(sign * support_log_uniform(1.0e-3, 2.0e9));
        const double error = (double)drive_to_int(&drive, value, most) - (double)value;
        TEST_ASSERT_TRUE(fabs(error) <= 0.5);
    }
    TEST_ASSERT_EQUAL(8388609, drive_to_int(&drive, 8388609.0f, most));
    TEST_ASSERT_EQUAL(0, drive_to_int(&drive, nextafterf(0.5f, 0.0f), most));
    TEST_ASSERT_EQUAL(-1, drive_to_int(&drive, -0.5f, most));
    TEST_ASSERT_EQUAL(2147483520, drive_to_int(&drive, most, most));
    TEST_ASSERT_EQUAL(0, berth_drive_status(&drive)->saturated);
    TEST_ASSERT_EQUAL(2147483520, drive_to_int(&drive, 2147483648.0f, most));
    TEST_ASSERT_EQUAL(-2147483520, drive_to_int(&drive, -INFINITY, most));
    TEST_ASSERT_EQUAL(0, drive_to_int(&drive, NAN, most));
    TEST_ASSERT_EQUAL(3, berth_drive_status(&drive)->saturated);
    TEST_ASSERT_EQUAL_FLOAT(-2.0f, drive_clamp(&drive, -3.0f, 2.0f));
    TEST_ASSERT_EQUAL(4, berth_drive_status(&drive)->saturated);
}

static void test_frames_are_counted_by_kind_and_counters_stay_at_their_end(void) {
    const berth_can_frame_t foreign = {.id = DRIVE_FRAME_FOREIGN};
    const berth_can_frame_t good = {.id = DRIVE_FRAME_GOOD};
    const berth_can_frame_t bad = {.id = DRIVE_FRAME_MALFORMED};
    TEST_ASSERT_FALSE(berth_drive_receive(&drive, &foreign, 0));
    TEST_ASSERT_TRUE(berth_drive_receive(&drive, &good, 0));
    TEST_ASSERT_TRUE(berth_drive_receive(&drive, &bad, 0));
    TEST_ASSERT_TRUE(berth_drive_receive(&drive, &bad, 0));
    TEST_ASSERT_EQUAL(1, berth_drive_status(&drive)->received);
    TEST_ASSERT_EQUAL(2, berth_drive_status(&drive)->malformed);
    drive.status.received = UINT32_MAX;
    TEST_ASSERT_TRUE(berth_drive_receive(&drive, &good, 0));
    TEST_ASSERT_EQUAL_HEX32(UINT32_MAX, berth_drive_status(&drive)->received);
    berth_can_filter_t filters[BERTH_DRIVE_FILTERS_MAX];
    TEST_ASSERT_EQUAL(1, berth_drive_filters(&drive, filters));
    TEST_ASSERT_EQUAL(5, filters[0].id);
}

/* --- travel ------------------------------------------------------------------------------------
 */

static void expect_travel(double rad, int64_t now_us) {
    TEST_ASSERT_FLOAT_WITHIN(2.0e-6f, (float)rad, berth_drive_travel(&drive, now_us));
}

static void test_travel_is_nothing_before_the_first_feedback(void) {
    expect_travel(0.0, 1000000);
    TEST_ASSERT_TRUE(drive_position(&drive, 100.0f, 0.01f, 1000000));
    expect_travel(0.0, 2000000);
    say_speed(1.0, 2000000);
    expect_travel(0.0, 2000000);
    expect_travel(0.05, 2050000);
}

static void test_speeds_change_evenly_between_two_feedbacks(void) {
    say_speed(1.0, 0);
    say_speed(3.0, 10000);
    expect_travel(0.02, 10000);
    say_speed(-1.0, 20000);
    expect_travel(0.01, 20000);
}

static void test_extrapolation_and_its_correction(void) {
    say_speed(1.0, 0);
    expect_travel(0.01, 10000);   /* as if the speed stayed */
    say_speed(2.0, 20000);        /* it did not */
    expect_travel(0.02, 20000);   /* in all: 1.5 * 0.02 */
    expect_travel(0.01, 25000);   /* and on with the new one */
    expect_travel(-0.006, 22000); /* asked for an earlier time: goes back */
}

/* The frame was on the wire before the last step. */
static void test_a_late_frame_corrects_from_its_own_time_on(void) {
    say_speed(1.0, 0);
    expect_travel(0.1, 100000);
    say_speed(2.0, 90000);
    expect_travel(0.155 - 0.1, 100000); /* 1.5 * 0.09 + 2 * 0.01 in all */
}

static void test_a_frame_older_than_the_last_moves_no_time_back(void) {
    say_speed(1.0, 50000);
    say_speed(2.0, 40000); /* came later, so it is newer, whatever its stamp */
    TEST_ASSERT_EQUAL(50000, berth_drive_status(&drive)->feedback_us);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-6f, 2.0f, berth_drive_status(&drive)->velocity_radps);
    expect_travel(0.02, 60000);
    TEST_ASSERT_TRUE(drive_position(&drive, 0.0f, 0.0f, 10000));
    expect_travel(0.02, 70000);
}

static void test_extrapolation_ends_with_the_feedback_timeout(void) {
    say_speed(1.0, 0);
    expect_travel(0.08, 80000);
    expect_travel(0.02, 500000);
    expect_travel(0.0, 900000);
    say_speed(1.0, 1000000); /* what happened in between nobody knows */
    expect_travel(0.0, 1000000);
    expect_travel(0.01, 1010000);
}

static void test_longer_than_the_feedback_timeout_no_speed_counts(void) {
    say_speed(1.0, 0);
    expect_travel(0.1, 1000000);
    say_speed(3.0, 1000000);
    expect_travel(0.1, 1000000); /* half of 2 rad/s, for the timeout */
    expect_travel(-0.3, 0);
}

static void test_a_position_without_speeds_is_not_taken_back(void) {
    say_speed(1.0, 0);
    TEST_ASSERT_TRUE(drive_position(&drive, 0.0f, 0.0f, 0));
    const float tenth = (float)(0.2 / RAD_PER_TURN);
    TEST_ASSERT_TRUE(drive_position(&drive, tenth, 0.0f, 200000)); /* beyond the timeout */
    expect_travel(0.2, 200000);
    expect_travel(0.0, 300000);
    expect_travel(0.0, 150000 + 150000);
}

static void test_within_a_quantum_the_speed_counts_beyond_it_the_position(void) {
    const float quantum = (float)(0.1 / RAD_PER_TURN); /* 0.1 rad */
    say_speed(1.0, 0);
    TEST_ASSERT_FALSE(berth_drive_status(&drive)->position_used);
    TEST_ASSERT_TRUE(drive_position(&drive, 0.0f, quantum, 0));
    TEST_ASSERT_TRUE(berth_drive_status(&drive)->position_used);
    TEST_ASSERT_TRUE(drive_position(&drive, quantum, quantum, 50000)); /* 0.05 by the speed */
    expect_travel(0.05, 50000);
    TEST_ASSERT_TRUE(drive_position(&drive, 2.0f * quantum, quantum, 100000));
    expect_travel(0.15, 100000); /* 0.3 in all by the position, less 0.1 */
    say_speed(0.0, 100000);
    expect_travel(0.0 - 0.05, 100000); /* it slowed down: 0.05 less than extrapolated */
    TEST_ASSERT_TRUE(drive_position(&drive, 0.0f, quantum, 110000));
    expect_travel(0.05, 110000); /* the position holds it */
}

static void test_a_jump_is_no_travel_and_positions_go_on_from_there(void) {
    const float jumps[] = {0.4f, -0.4f, 50.0f, -50.0f, 1.0e9f, -3.0e38f};
    for (size_t i = 0; i < sizeof jumps / sizeof jumps[0]; i++) {
        setUp();
        say_speed(1.0, 0);
        TEST_ASSERT_TRUE(drive_position(&drive, 0.0f, 1.0e-4f, 0));
        say_speed(1.0, 10000);
        TEST_ASSERT_FALSE(drive_position(&drive, jumps[i], 1.0e-4f, 10000));
        expect_travel(0.01, 10000);
        say_speed(1.0, 20000);
        const float turned = (float)(0.012 / RAD_PER_TURN);
        TEST_ASSERT_TRUE(drive_position(&drive, turned, 0.0f, 20000));
        expect_travel(0.012, 20000);
    }
}

/* What explained a step before explains none now: neither a long time nor a high speed. */
static void test_each_step_needs_its_own_explanation(void) {
    say_speed(100.0, 0);
    TEST_ASSERT_TRUE(drive_position(&drive, 0.0f, 0.0f, 0));
    say_speed(0.0, 90000);
    TEST_ASSERT_TRUE(drive_position(&drive, 0.5f, 0.0f, 90000));
    say_speed(0.0, 100000);
    TEST_ASSERT_FALSE(drive_position(&drive, 0.3f, 0.0f, 100000));
    say_speed(0.0, 110000);
    TEST_ASSERT_TRUE(drive_position(&drive, 0.27f, 0.0f, 110000));
}

/* Frames were lost while the wheel sped up and slowed down again; time stamps are 20 ms off. */
static void test_what_a_wheel_can_do_is_no_jump(void) {
    say_speed(0.0, 0);
    TEST_ASSERT_TRUE(drive_position(&drive, 0.0f, 0.0f, 0));
    say_speed(0.0, 100000);
    TEST_ASSERT_TRUE(drive_position(&drive, 2.5f, 0.0f, 100000));
    expect_travel(2.5 * RAD_PER_TURN, 100000);
    say_speed(100.0, 110000);
    TEST_ASSERT_TRUE(drive_position(&drive, 0.5f, 0.0f, 110000));
    say_speed(0.0, 120000);
    TEST_ASSERT_TRUE(drive_position(&drive, 0.6f, 0.0f, 120000));
}

static void test_a_position_that_is_lost_starts_anew(void) {
    say_speed(1.0, 0);
    TEST_ASSERT_TRUE(drive_position(&drive, 0.0f, 0.0f, 0));
    drive_position_lost(&drive);
    TEST_ASSERT_FALSE(berth_drive_status(&drive)->position_used);
    say_speed(1.0, 10000);
    TEST_ASSERT_TRUE(drive_position(&drive, 1.0e9f, 0.0f, 10000)); /* counts as a first one */
    expect_travel(0.01, 10000);
}

/* --- travel as a property -----------------------------------------------------------------------
 */

/* A wheel with piecewise constant acceleration, in double. */
typedef struct {
    double angle_rad, speed_radps, acceleration_radps2;
} wheel_t;

static void turn(wheel_t *wheel, int64_t time_us) {
    const double t = (double)time_us * 1.0e-6;
    wheel->angle_rad += wheel->speed_radps * t + 0.5 * wheel->acceleration_radps2 * t * t;
    wheel->speed_radps += wheel->acceleration_radps2 * t;
}

static void choose_acceleration(wheel_t *wheel) {
    wheel->acceleration_radps2 = support_uniform(-20.0, 20.0);
    if (fabs(wheel->speed_radps) > 20.0) {
        wheel->acceleration_radps2 = -wheel->speed_radps;
    }
}

typedef struct {
    double gear;
    double quantum; /* motor turns */
    double scale;   /* what the drive makes of its speed */
    double counts;  /* last position, in quanta */
    double travelled;
} walk_t;

static walk_t random_walk(void) {
    berth_drive_config_t config = good_config();
    config.sign = support_index(2) == 0 ? 1 : -1;
    config.gear_ratio = (float)support_log_uniform(0.1, 50.0);
    init_with(&config);
    return (walk_t){
        .gear = (double)config.gear_ratio * (double)config.sign,
        .quantum = support_log_uniform(1.0e-5, 0.1),
        .scale = support_uniform(0.95, 1.05),
    };
}

static void say_position(walk_t *walk, const wheel_t *wheel, int64_t at_us) {
    const double turns = wheel->angle_rad / RAD_PER_TURN * walk->gear;
    const double counts = floor(turns / walk->quantum);
    const float turned = (float)((counts - walk->counts) * walk->quantum);
    walk->counts = counts;
    TEST_ASSERT_TRUE(drive_position(&drive, turned, (float)walk->quantum, at_us));
}

/* Feedback at random times, taken in late, travel taken at random times in between, speeds that are
 * off by a factor: after each position the sum is the wheel's angle within two quanta. */
static void walk_with_positions(void) {
    walk_t walk = random_walk();
    wheel_t wheel = {0};
    int64_t now_us = 0;
    say_speed(0.0, 0);
    say_position(&walk, &wheel, 0);
    const double slack = 2.0 * walk.quantum / fabs(walk.gear) * RAD_PER_TURN;
    for (uint32_t frame = 0; frame < 300; frame++) {
        choose_acceleration(&wheel);
        const int64_t span_us = 1 + (int64_t)support_index(30000);
        turn(&wheel, span_us);
        const int64_t at_us = now_us + span_us;
        const int64_t taken_us = now_us + (int64_t)support_index((uint32_t)span_us + 20000);
        walk.travelled += (double)berth_drive_travel(&drive, taken_us);
        say_speed(wheel.speed_radps * walk.scale, at_us);
        if (support_index(4) != 0) {
            say_position(&walk, &wheel, at_us);
            walk.travelled += (double)berth_drive_travel(&drive, at_us);
            TEST_ASSERT_TRUE(fabs(walk.travelled - wheel.angle_rad) <= slack + 5.0e-4);
        }
        now_us = at_us;
    }
}

static void test_the_sum_of_travel_is_the_wheels_angle(void) {
    support_random_start();
    for (uint32_t run = 0; run < support_runs(500); run++) {
        walk_with_positions();
    }
}

/* With true speeds and constant acceleration in between nothing of a coarse position shows. */
static void test_true_speeds_are_not_spoilt_by_a_coarse_position(void) {
    support_random_start();
    for (uint32_t run = 0; run < support_runs(100); run++) {
        walk_t walk = random_walk();
        walk.quantum = 0.3;
        wheel_t wheel = {0};
        int64_t now_us = 0;
        say_speed(0.0, 0);
        say_position(&walk, &wheel, 0);
        for (uint32_t frame = 0; frame < 300; frame++) {
            choose_acceleration(&wheel);
            const int64_t span_us = 1 + (int64_t)support_index(30000);
            turn(&wheel, span_us);
            now_us += span_us;
            say_speed(wheel.speed_radps, now_us);
            say_position(&walk, &wheel, now_us);
            walk.travelled += (double)berth_drive_travel(&drive, now_us);
            TEST_ASSERT_TRUE(fabs(walk.travelled - wheel.angle_rad) <= 1.0e-3);
        }
    }
}

static void test_texts(void) {
    TEST_ASSERT_EQUAL_STRING("off", berth_drive_state_text(BERTH_DRIVE_OFF));
    TEST_ASSERT_EQUAL_STRING("fault", berth_drive_state_text(BERTH_DRIVE_FAULT));
    TEST_ASSERT_EQUAL_STRING("?", berth_drive_state_text((berth_drive_state_t)5));
    for (int fault = 0; fault < BERTH_DRIVE_FAULT_COUNT; fault++) {
        TEST_ASSERT_TRUE(strlen(berth_drive_fault_text((berth_drive_fault_t)fault)) > 3);
    }
    TEST_ASSERT_EQUAL_STRING("?", berth_drive_fault_text(BERTH_DRIVE_FAULT_COUNT));
}

static void fake_sync(const berth_drive_t *self, int64_t now_us, berth_outbox_t *box) {
    TEST_ASSERT_EQUAL_PTR(&drive, self);
    TEST_ASSERT_EQUAL(4711, now_us);
    put(PUT_SYNC, box);
}

static void test_sync_is_the_protocols(void) {
    const uint32_t sync[] = {PUT_SYNC};
    berth_drive_protocol_t protocol = fake;
    berth_drive_config_t config = good_config();
    berth_drive_sync(&drive, 4711, &outbox); /* has none */
    expect_frames(NULL, 0);
    protocol.sync = fake_sync;
    config.protocol = &protocol;
    init_with(&config);
    berth_drive_sync(&drive, 4711, &outbox);
    expect_frames(sync, 1);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_missing_pointers_are_refused);
    RUN_TEST(test_sign_and_gear_out_of_range_are_refused);
    RUN_TEST(test_times_and_node_out_of_range_are_refused);
    RUN_TEST(test_extremes_of_the_configuration_are_good);
    RUN_TEST(test_a_protocols_state_starts_as_zero);
    RUN_TEST(test_enabling_needs_feedback_and_a_sign_of_life);
    RUN_TEST(test_only_a_starting_drive_becomes_enabled);
    RUN_TEST(test_enabling_forgets_what_was_measured_before);
    RUN_TEST(test_enable_in_other_states_changes_nothing);
    RUN_TEST(test_stops_and_what_they_put);
    RUN_TEST(test_a_fault_is_kept_until_reset);
    RUN_TEST(test_cycle_speaks_in_every_state_but_off_and_released);
    RUN_TEST(test_no_feedback_is_a_fault_at_its_microsecond);
    RUN_TEST(test_no_heartbeat_is_a_fault_at_its_microsecond);
    RUN_TEST(test_not_enabled_in_time_is_a_fault_at_its_microsecond);
    RUN_TEST(test_a_stopped_drive_is_watched_too);
    RUN_TEST(test_watchdogs_count_from_enabling_where_nothing_was_heard);
    RUN_TEST(test_the_protocols_deadline_counts_and_off_has_none);
    RUN_TEST(test_time_at_its_end_and_going_backwards);
    RUN_TEST(test_commands_that_are_no_numbers_stand_and_are_counted);
    RUN_TEST(test_sign_and_gear_of_the_command);
    RUN_TEST(test_integers_are_the_nearest_and_saturate);
    RUN_TEST(test_frames_are_counted_by_kind_and_counters_stay_at_their_end);
    RUN_TEST(test_travel_is_nothing_before_the_first_feedback);
    RUN_TEST(test_speeds_change_evenly_between_two_feedbacks);
    RUN_TEST(test_extrapolation_and_its_correction);
    RUN_TEST(test_a_late_frame_corrects_from_its_own_time_on);
    RUN_TEST(test_a_frame_older_than_the_last_moves_no_time_back);
    RUN_TEST(test_extrapolation_ends_with_the_feedback_timeout);
    RUN_TEST(test_longer_than_the_feedback_timeout_no_speed_counts);
    RUN_TEST(test_a_position_without_speeds_is_not_taken_back);
    RUN_TEST(test_within_a_quantum_the_speed_counts_beyond_it_the_position);
    RUN_TEST(test_a_jump_is_no_travel_and_positions_go_on_from_there);
    RUN_TEST(test_each_step_needs_its_own_explanation);
    RUN_TEST(test_what_a_wheel_can_do_is_no_jump);
    RUN_TEST(test_a_position_that_is_lost_starts_anew);
    RUN_TEST(test_the_sum_of_travel_is_the_wheels_angle);
    RUN_TEST(test_true_speeds_are_not_spoilt_by_a_coarse_position);
    RUN_TEST(test_sync_is_the_protocols);
    RUN_TEST(test_texts);
    return UNITY_END();
}
