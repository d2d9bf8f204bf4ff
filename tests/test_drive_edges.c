/* What all wheel drives share, and ODrive and VESC, at their edges: the last value that is good and
 * the first that is not, what a refusal says, and what must not be sent any more. */
#include "support.h"

#include "../firmware/src/drive_protocol.h"
#include "berth/drive_odrive.h"
#include "berth/drive_vesc.h"

#include "unity.h"

#include <math.h>
#include <string.h>

#define TURN_RAD 6.283185307179586
#define FEEDBACK_TIMEOUT_US 10000000
#define ENABLE_TIMEOUT_US 1000000
#define RETRY_US 250000

static berth_drive_t drive;
static berth_outbox_t outbox;
static berth_drive_config_t config;

static void init(void) {
    berth_refusal_t refusal;
    memset(&drive, 0xa5, sizeof drive);
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_drive_init(&drive, &config, &refusal));
    berth_outbox_reset(&outbox);
}

/* An ODrive whose motor turns once for a wheel turn. */
void setUp(void) {
    config = (berth_drive_config_t){
        .protocol = &berth_drive_odrive,
        .node = 3,
        .sign = 1,
        .gear_ratio = 1.0f,
        .pole_pairs = 7,
        .period_us = 10000,
        .feedback_timeout_us = FEEDBACK_TIMEOUT_US,
        .heartbeat_timeout_us = FEEDBACK_TIMEOUT_US,
        .enable_timeout_us = ENABLE_TIMEOUT_US,
    };
    init();
}

void tearDown(void) {}

static void say_heartbeat(uint32_t error, uint8_t state, int64_t at_us) {
    berth_can_frame_t frame = {.id = 0x061, .length = 8};
    put_u32_le(frame.data, error);
    frame.data[4] = state;
    TEST_ASSERT_TRUE(berth_drive_receive(&drive, &frame, at_us));
}

static void say_estimates(float turns, float rps, int64_t at_us) {
    berth_can_frame_t frame = {.id = 0x069, .length = 8};
    put_u32_le(frame.data, bits_from_float(turns));
    put_u32_le(frame.data + 4, bits_from_float(rps));
    TEST_ASSERT_TRUE(berth_drive_receive(&drive, &frame, at_us));
}

static void step_at(int64_t now_us) {
    berth_drive_step(&drive, now_us, &outbox);
}

static void expect_nothing(void) {
    TEST_ASSERT_NULL(berth_outbox_front(&outbox));
}

static void expect_state(berth_drive_state_t state, berth_drive_fault_t fault, uint32_t code) {
    TEST_ASSERT_EQUAL_STRING(berth_drive_state_text(state),
                             berth_drive_state_text(berth_drive_status(&drive)->state));
    TEST_ASSERT_EQUAL_STRING(berth_drive_fault_text(fault),
                             berth_drive_fault_text(berth_drive_status(&drive)->fault));
    TEST_ASSERT_EQUAL_HEX32(code, berth_drive_status(&drive)->code);
}

/* Asks for closed loop at 10 ms. */
static void ask(void) {
    berth_drive_enable(&drive, 0);
    step_at(0);
    step_at(10000);
    berth_outbox_clear(&outbox);
}

static void make_enabled(void) {
    ask();
    say_estimates(0.0f, 0.0f, 11000);
    say_heartbeat(0, 8, 12000);
    expect_state(BERTH_DRIVE_ENABLED, BERTH_DRIVE_FAULT_NONE, 0);
}

/* --- configuration ---------------------------------------------------------------------------- */

static void expect_refused(berth_field_t field, float value, float minimum, float maximum) {
    berth_refusal_t refusal = {0};
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_CONFIG, berth_drive_init(&drive, &config, &refusal));
    TEST_ASSERT_EQUAL_INT(field, refusal.field);
    TEST_ASSERT_EQUAL_FLOAT(value, refusal.value);
    TEST_ASSERT_EQUAL_FLOAT(minimum, refusal.minimum);
    TEST_ASSERT_EQUAL_FLOAT(maximum, refusal.maximum);
}

static void test_every_time_from_its_least_to_its_most(void) {
    const struct {
        uint32_t *value;
        uint32_t least, most, over; /* over: the next that float32 tells apart */
        berth_field_t field;
    } times[] = {
        {&config.period_us, 1000, 1000000, 1000001, BERTH_FIELD_PLAN_PERIOD},
        {&config.feedback_timeout_us, 1000, 10000000, 10000001, BERTH_FIELD_FEEDBACK_TIMEOUT},
        {&config.heartbeat_timeout_us, 1000, 10000000, 10000001, BERTH_FIELD_HEARTBEAT_TIMEOUT},
        {&config.enable_timeout_us, 1000, 60000000, 60000004, BERTH_FIELD_ENABLE_TIMEOUT},
    };
    const berth_drive_config_t good = config;
    for (size_t i = 0; i < sizeof times / sizeof times[0]; i++) {
        const float least = (float)times[i].least;
        const float most = (float)times[i].most;
        *times[i].value = times[i].least;
        init();
        *times[i].value = times[i].most;
        init();
        *times[i].value = times[i].least - 1;
        expect_refused(times[i].field, least - 1.0f, least, most);
        *times[i].value = times[i].over;
        expect_refused(times[i].field, (float)times[i].over, least, most);
        config = good;
    }
}

static void test_pole_pairs_from_one_to_a_hundred(void) {
    config.protocol = &berth_drive_vesc;
    config.pole_pairs = 1;
    init();
    config.pole_pairs = 100;
    init();
    config.pole_pairs = 0;
    expect_refused(BERTH_FIELD_POLE_PAIRS, 0.0f, 1.0f, 100.0f);
    config.pole_pairs = 101;
    expect_refused(BERTH_FIELD_POLE_PAIRS, 101.0f, 1.0f, 100.0f);
}

/* --- commands --------------------------------------------------------------------------------- */

/* A command from before is none: the wheel stands until it is told to turn. */
static void test_enabling_stopping_and_a_fault_forget_the_command(void) {
    berth_drive_command(&drive, 4.0f);
    make_enabled();
    TEST_ASSERT_EQUAL_FLOAT(0.0f, drive.command_radps);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, drive_motor_rps(&drive));
    berth_drive_command(&drive, 4.0f);
    berth_drive_stop(&drive, &outbox);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, drive.command_radps); /* what the board holds the wheel against */
    setUp();
    make_enabled();
    berth_drive_command(&drive, 4.0f);
    berth_drive_emergency_stop(&drive, &outbox);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, drive.command_radps);
    setUp();
    make_enabled();
    berth_drive_command(&drive, 4.0f);
    say_heartbeat(0x20, 8, 13000);
    expect_state(BERTH_DRIVE_FAULT, BERTH_DRIVE_FAULT_DEVICE, 0x20);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, drive.command_radps);
}

static void test_halves_go_away_from_zero(void) {
    TEST_ASSERT_EQUAL_INT32(1, drive_to_int(&drive, 0.5f, 100.0f));
    TEST_ASSERT_EQUAL_INT32(3, drive_to_int(&drive, 2.5f, 100.0f));
    TEST_ASSERT_EQUAL_INT32(-1, drive_to_int(&drive, -0.5f, 100.0f));
    TEST_ASSERT_EQUAL_INT32(-3, drive_to_int(&drive, -2.5f, 100.0f));
    TEST_ASSERT_EQUAL_INT32(2, drive_to_int(&drive, nextafterf(2.5f, 0.0f), 100.0f));
}

/* --- travel ----------------------------------------------------------------------------------- */

static void test_no_time_is_known_before_the_first_feedback(void) {
    TEST_ASSERT_EQUAL_INT64(-1, drive.travel_us);
    TEST_ASSERT_EQUAL_INT64(-1, berth_drive_status(&drive)->feedback_us);
    drive_velocity(&drive, 1.0f, 0); /* time 0 is a time */
    TEST_ASSERT_EQUAL_INT64(0, berth_drive_status(&drive)->feedback_us);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-6f, (float)(0.01 * TURN_RAD), berth_drive_travel(&drive, 10000));
}

static void stand_with_a_position(int64_t at_us) {
    drive_velocity(&drive, 0.0f, at_us);
    TEST_ASSERT_TRUE(drive_position(&drive, 0.0f, 0.0f, at_us));
}

/* At rest, in no time: a quarter of a motor turn. */
static void test_a_quarter_turn_is_just_no_jump(void) {
    stand_with_a_position(0);
    TEST_ASSERT_TRUE(drive_position(&drive, 0.25f, 0.0f, 0));
    TEST_ASSERT_TRUE(drive_position(&drive, -0.25f, 0.0f, 0));
    TEST_ASSERT_FALSE(drive_position(&drive, 0.250001f, 0.0f, 0));
    TEST_ASSERT_FALSE(drive_position(&drive, -0.250001f, 0.0f, 0));
}

/* However long ago the last position was, 1 s of speeding up explains 250 turns and no more. */
static void test_what_a_second_explains_is_the_most(void) {
    const struct {
        float turned;
        int64_t span_us;
        bool good;
    } cases[] = {
        {62.0f, 500000, true},    {63.0f, 500000, false},  {250.0f, 1000000, true},
        {251.0f, 1000000, false}, {250.0f, 5000000, true}, {251.0f, 5000000, false},
    };
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        setUp();
        stand_with_a_position(0);
        drive_velocity(&drive, 0.0f, cases[i].span_us);
        TEST_ASSERT_EQUAL_INT(cases[i].good,
                              drive_position(&drive, cases[i].turned, 0.0f, cases[i].span_us));
    }
}

/* --- odrive ----------------------------------------------------------------------------------- */

static void test_a_wheel_that_stands_does_not_travel_at_all(void) {
    const float places[] = {0.0f, 0.3f, 0.9f, 1.0f, 1000.5f, -0.3f, -0.9f, -1000.5f};
    for (size_t i = 0; i < sizeof places / sizeof places[0]; i++) {
        setUp();
        for (int64_t now_us = 0; now_us < 100000; now_us += 10000) {
            say_estimates(places[i], 0.0f, now_us);
            TEST_ASSERT_EQUAL_FLOAT(0.0f, berth_drive_travel(&drive, now_us));
        }
    }
}

/* A wheel that was stopped while it was being enabled is not enabled after all. */
static void test_nothing_is_asked_of_a_stopped_drive(void) {
    for (int asked = 0; asked < 2; asked++) {
        setUp();
        berth_drive_enable(&drive, 0);
        if (asked != 0) {
            step_at(0);
        }
        berth_drive_stop(&drive, &outbox);
        berth_outbox_clear(&outbox);
        for (int64_t now_us = 0; now_us < ENABLE_TIMEOUT_US; now_us += 10000) {
            step_at(now_us);
            expect_nothing();
        }
        expect_state(BERTH_DRIVE_STOPPED, BERTH_DRIVE_FAULT_NONE, 0);
        TEST_ASSERT_EQUAL_INT64(FEEDBACK_TIMEOUT_US + 1, berth_drive_deadline(&drive));
    }
}

/* Its error follows from the emergency stop, however long it lasts. */
static void test_a_hard_stop_is_no_fault_after_the_enable_timeout_either(void) {
    make_enabled();
    berth_drive_emergency_stop(&drive, &outbox);
    berth_outbox_clear(&outbox);
    say_heartbeat(0x20, 1, 13000);
    step_at(ENABLE_TIMEOUT_US + 1);
    expect_state(BERTH_DRIVE_STOPPED, BERTH_DRIVE_FAULT_NONE, 0);
    expect_nothing();
}

static void test_an_error_that_stays_ends_the_asking(void) {
    ask();
    say_heartbeat(0x01000000, 1, 11000);
    step_at(ENABLE_TIMEOUT_US + 1); /* it is time to try again as well */
    expect_state(BERTH_DRIVE_FAULT, BERTH_DRIVE_FAULT_DEVICE, 0x01000000);
    expect_nothing();
}

static void test_a_heartbeat_at_time_zero_is_one(void) {
    berth_drive_enable(&drive, 0);
    say_heartbeat(0, 1, 0);
    TEST_ASSERT_EQUAL_INT64(0, berth_drive_status(&drive)->heartbeat_us);
    step_at(ENABLE_TIMEOUT_US + 1);
    expect_state(BERTH_DRIVE_FAULT, BERTH_DRIVE_FAULT_ENABLE, BERTH_ODRIVE_NOT_IN_CLOSED_LOOP);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_every_time_from_its_least_to_its_most);
    RUN_TEST(test_pole_pairs_from_one_to_a_hundred);
    RUN_TEST(test_enabling_stopping_and_a_fault_forget_the_command);
    RUN_TEST(test_halves_go_away_from_zero);
    RUN_TEST(test_no_time_is_known_before_the_first_feedback);
    RUN_TEST(test_a_quarter_turn_is_just_no_jump);
    RUN_TEST(test_what_a_second_explains_is_the_most);
    RUN_TEST(test_a_wheel_that_stands_does_not_travel_at_all);
    RUN_TEST(test_nothing_is_asked_of_a_stopped_drive);
    RUN_TEST(test_a_hard_stop_is_no_fault_after_the_enable_timeout_either);
    RUN_TEST(test_an_error_that_stays_ends_the_asking);
    RUN_TEST(test_a_heartbeat_at_time_zero_is_one);
    return UNITY_END();
}
