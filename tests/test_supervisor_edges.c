/* The supervisor at its edges: the last value that is good and the first that is not, times that do
 * not begin at zero, and each fault with its text. */
#include "supervisor_rig.h"

#include <math.h>

#define START_US INT64_C(5000000) /* when the robot was switched on does not matter */

static void expect_step(berth_supervisor_state_t state, int64_t now_us) {
    TEST_ASSERT_EQUAL_STRING(
        berth_supervisor_state_text(state),
        berth_supervisor_state_text(berth_supervisor_step(&supervisor, &inputs, now_us)));
}

static void expect_fault(uint8_t fault, int64_t now_us) {
    expect_step(BERTH_SUPERVISOR_FAULT, now_us);
    TEST_ASSERT_EQUAL_STRING(berth_fault_text(fault), berth_fault_text(supervisor.fault));
    TEST_ASSERT_EQUAL_INT64(now_us, supervisor.since_us);
}

/* --- times ------------------------------------------------------------------------------------ */

static void test_arming_times_out_from_when_it_began(void) {
    inputs.drives_enabled = false;
    command(BERTH_COMMAND_ARM, START_US);
    expect_step(BERTH_SUPERVISOR_ARMING, START_US + 1000000);
    expect_fault(BERTH_FAULT_ARM_TIMEOUT, START_US + 1000001);
}

static void test_stopping_times_out_from_when_it_began(void) {
    command(BERTH_COMMAND_ARM, START_US);
    expect_step(BERTH_SUPERVISOR_ARMED, START_US + 10);
    command(BERTH_COMMAND_START, START_US + 20);
    command(BERTH_COMMAND_STOP, START_US + 30);
    inputs.standing = false;
    expect_step(BERTH_SUPERVISOR_STOPPING, START_US + 30 + 500000);
    expect_fault(BERTH_FAULT_STOP_TIMEOUT, START_US + 30 + 500001);
}

/* What the wheels did in an earlier state is no reason: each state has the whole time. */
static void test_following_counts_from_the_beginning_of_the_state(void) {
    command(BERTH_COMMAND_ARM, START_US);
    expect_step(BERTH_SUPERVISOR_ARMED, START_US + 10);
    inputs.following_radps = 2.5f;
    expect_step(BERTH_SUPERVISOR_ARMED, START_US + 10 + 200000);
    command(BERTH_COMMAND_START, START_US + 20 + 200000);
    expect_step(BERTH_SUPERVISOR_RUNNING, START_US + 20 + 400000);
    expect_fault(BERTH_FAULT_FOLLOWING, START_US + 20 + 400001);
}

static void test_just_the_difference_allowed_may_last(void) {
    command(BERTH_COMMAND_ARM, START_US);
    expect_step(BERTH_SUPERVISOR_ARMED, START_US);
    inputs.following_radps = 2.0f;
    expect_step(BERTH_SUPERVISOR_ARMED, START_US + 1000000000);
    inputs.following_radps = nextafterf(2.0f, 3.0f);
    expect_step(BERTH_SUPERVISOR_ARMED, START_US + 1000000000 + 200000);
    expect_fault(BERTH_FAULT_FOLLOWING, START_US + 1000000000 + 200001);
}

/* --- configuration ---------------------------------------------------------------------------- */

static void expect_refused(berth_field_t field, float value, float minimum, float maximum) {
    refusal = (berth_refusal_t){.field = BERTH_FIELD_NONE, .index = 77};
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_CONFIG,
                          berth_supervisor_init(&supervisor, &config, &refusal));
    TEST_ASSERT_EQUAL_INT(field, refusal.field);
    TEST_ASSERT_EQUAL_UINT32(0, refusal.index);
    TEST_ASSERT_EQUAL_FLOAT(value, refusal.value);
    TEST_ASSERT_EQUAL_FLOAT(minimum, refusal.minimum);
    TEST_ASSERT_EQUAL_FLOAT(maximum, refusal.maximum);
}

static void test_every_time_from_its_least_to_its_most(void) {
    const struct {
        uint32_t *value;
        uint32_t most, over; /* the next that float32 tells apart */
        berth_field_t field;
    } times[] = {
        {&config.fix_timeout_us, 3600000000u, 3600000256u, BERTH_FIELD_FIX_TIMEOUT},
        {&config.period_late_us, 10000000u, 10000001u, BERTH_FIELD_PERIOD_LATE},
        {&config.transmit_timeout_us, 10000000u, 10000001u, BERTH_FIELD_TRANSMIT_TIMEOUT},
        {&config.arm_timeout_us, 60000000u, 60000004u, BERTH_FIELD_ARM_TIMEOUT},
        {&config.stop_timeout_us, 60000000u, 60000004u, BERTH_FIELD_STOP_TIMEOUT},
        {&config.following_us, 10000000u, 10000001u, BERTH_FIELD_FOLLOWING_TIME},
    };
    const berth_supervisor_config_t good = config;
    for (size_t i = 0; i < sizeof times / sizeof times[0]; i++) {
        *times[i].value = 1000;
        init();
        *times[i].value = times[i].most;
        init();
        *times[i].value = 999;
        expect_refused(times[i].field, 999.0f, 1000.0f, (float)times[i].most);
        *times[i].value = times[i].over;
        expect_refused(times[i].field, (float)times[i].over, 1000.0f, (float)times[i].most);
        config = good;
    }
    config.fix_timeout_us = 1; /* only 0 switches it off */
    expect_refused(BERTH_FIELD_FIX_TIMEOUT, 1.0f, 1000.0f, 3.6e9f);
}

static void test_speeds_from_their_least_to_their_most(void) {
    const struct {
        float *value;
        float least, most;
        berth_field_t field;
    } speeds[] = {
        {&config.standing_radps, 0.001f, 10.0f, BERTH_FIELD_STANDING},
        {&config.following_radps, 0.01f, 1000.0f, BERTH_FIELD_FOLLOWING},
    };
    const berth_supervisor_config_t good = config;
    for (size_t i = 0; i < sizeof speeds / sizeof speeds[0]; i++) {
        *speeds[i].value = speeds[i].least;
        init();
        *speeds[i].value = speeds[i].most;
        init();
        const float under = nextafterf(speeds[i].least, 0.0f);
        *speeds[i].value = under;
        expect_refused(speeds[i].field, under, speeds[i].least, speeds[i].most);
        const float over = nextafterf(speeds[i].most, INFINITY);
        *speeds[i].value = over;
        expect_refused(speeds[i].field, over, speeds[i].least, speeds[i].most);
        config = good;
    }
}

/* --- texts ------------------------------------------------------------------------------------ */

static void test_a_drives_fault_has_the_drives_text_and_a_side(void) {
    for (int fault = 0; fault < BERTH_DRIVE_FAULT_COUNT; fault++) {
        const char *const text = berth_drive_fault_text((berth_drive_fault_t)fault);
        const uint8_t left = (uint8_t)((int)BERTH_FAULT_LEFT + fault);
        const uint8_t right = (uint8_t)((int)BERTH_FAULT_RIGHT + fault);
        TEST_ASSERT_EQUAL_STRING(text, berth_fault_text(left));
        TEST_ASSERT_EQUAL_STRING(text, berth_fault_text(right));
        TEST_ASSERT_EQUAL_STRING("left drive: ", berth_fault_side_text(left));
        TEST_ASSERT_EQUAL_STRING("right drive: ", berth_fault_side_text(right));
    }
    TEST_ASSERT_EQUAL_STRING("?", berth_fault_text(BERTH_FAULT_LEFT - 1));
    TEST_ASSERT_EQUAL_STRING("?", berth_fault_text(BERTH_FAULT_RIGHT - 1));
    TEST_ASSERT_EQUAL_STRING("?", berth_fault_text(UINT8_MAX));
    TEST_ASSERT_EQUAL_STRING("", berth_fault_side_text(BERTH_FAULT_LEFT - 1));
    TEST_ASSERT_EQUAL_STRING("left drive: ", berth_fault_side_text(BERTH_FAULT_RIGHT - 1));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_arming_times_out_from_when_it_began);
    RUN_TEST(test_stopping_times_out_from_when_it_began);
    RUN_TEST(test_following_counts_from_the_beginning_of_the_state);
    RUN_TEST(test_just_the_difference_allowed_may_last);
    RUN_TEST(test_every_time_from_its_least_to_its_most);
    RUN_TEST(test_speeds_from_their_least_to_their_most);
    RUN_TEST(test_a_drives_fault_has_the_drives_text_and_a_side);
    return UNITY_END();
}
