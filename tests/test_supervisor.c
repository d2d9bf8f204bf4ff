/* The supervisor by itself: every state with every command, every reason to stop, and time. */
#include "supervisor_rig.h"
#include "support.h"

#include <math.h>
#include <stdio.h>

static berth_supervisor_state_t step(int64_t now_us) {
    return berth_supervisor_step(&supervisor, &inputs, now_us);
}

/* Brings the supervisor into a state from init. */
static void reach(berth_supervisor_state_t state) {
    setUp();
    if (state == BERTH_SUPERVISOR_FAULT) {
        command(BERTH_COMMAND_EMERGENCY_STOP, 0);
    }
    if (state >= BERTH_SUPERVISOR_ARMING && state <= BERTH_SUPERVISOR_STOPPING) {
        command(BERTH_COMMAND_ARM, 0);
    }
    if (state >= BERTH_SUPERVISOR_ARMED && state <= BERTH_SUPERVISOR_STOPPING) {
        (void)step(0);
    }
    if (state >= BERTH_SUPERVISOR_RUNNING && state <= BERTH_SUPERVISOR_STOPPING) {
        command(BERTH_COMMAND_START, 0);
    }
    if (state == BERTH_SUPERVISOR_STOPPING) {
        command(BERTH_COMMAND_STOP, 0);
    }
    TEST_ASSERT_EQUAL_INT(state, supervisor.state);
}

static void test_each_state_takes_each_command_as_the_table_says(void) {
    enum { I, A, D, R, S, F, N }; /* idle, arming, armed, running, stopping, fault; N: refused */
    static const int table[6][BERTH_COMMAND_COUNT + 1] = {
        /* none arm start stop estop reset, beyond */
        {N, A, N, I, F, N, N}, {N, N, N, I, F, N, N}, {N, N, R, I, F, N, N},
        {N, N, N, S, F, N, N}, {N, N, N, S, F, N, N}, {N, N, N, N, F, I, N},
    };
    for (int state = 0; state < 6; state++) {
        for (int code = 0; code <= BERTH_COMMAND_COUNT; code++) {
            reach((berth_supervisor_state_t)state);
            const uint32_t refused = supervisor.refused;
            command((berth_command_code_t)code, 7);
            const int expected = table[state][code];
            TEST_ASSERT_EQUAL_INT(expected == N ? state : expected, supervisor.state);
            TEST_ASSERT_EQUAL_UINT32(refused + (expected == N ? 1u : 0u), supervisor.refused);
        }
    }
}

/* Numbers that are no command at all: from a program with other headers, or a bad byte. */
static void test_what_is_no_command_is_refused_in_each_state(void) {
    for (int state = 0; state < 6; state++) {
        reach((berth_supervisor_state_t)state);
        const berth_supervisor_t before = supervisor;
        command((berth_command_code_t)99, 7);
        TEST_ASSERT_EQUAL_INT(before.state, supervisor.state);
        TEST_ASSERT_EQUAL_INT64(before.since_us, supervisor.since_us);
        TEST_ASSERT_EQUAL_UINT32(before.refused + 1, supervisor.refused);
    }
}

static void test_reset_waits_until_the_cause_is_gone(void) {
    reach(BERTH_SUPERVISOR_FAULT);
    berth_supervisor_command(&supervisor, BERTH_COMMAND_RESET, false, 1);
    TEST_ASSERT_EQUAL_INT(BERTH_SUPERVISOR_FAULT, supervisor.state);
    TEST_ASSERT_EQUAL_UINT8(BERTH_FAULT_EMERGENCY_STOP, supervisor.fault);
    command(BERTH_COMMAND_RESET, 2);
    TEST_ASSERT_EQUAL_INT(BERTH_SUPERVISOR_IDLE, supervisor.state);
    TEST_ASSERT_EQUAL_UINT8(BERTH_FAULT_NONE, supervisor.fault);
}

static void test_arming_waits_for_every_check(void) {
    for (int missing = 0; missing < 4; missing++) {
        reach(BERTH_SUPERVISOR_ARMING);
        inputs.drives_enabled = missing != 0;
        inputs.standing = missing != 1;
        inputs.pose_known = missing != 2;
        inputs.fix_age_us = missing == 3 ? 300001 : 300000;
        TEST_ASSERT_EQUAL_INT(BERTH_SUPERVISOR_ARMING, step(1000000));
        TEST_ASSERT_EQUAL_INT(BERTH_SUPERVISOR_FAULT, step(1000001));
        TEST_ASSERT_EQUAL_UINT8(BERTH_FAULT_ARM_TIMEOUT, supervisor.fault);
    }
    reach(BERTH_SUPERVISOR_ARMING);
    TEST_ASSERT_EQUAL_INT(BERTH_SUPERVISOR_ARMED, step(10));
    TEST_ASSERT_EQUAL_INT64(10, supervisor.since_us);
}

static void test_dead_reckoning_needs_no_fix(void) {
    config.fix_timeout_us = 0;
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_supervisor_init(&supervisor, &config, &refusal));
    inputs.fix_age_us = INT64_MAX;
    command(BERTH_COMMAND_ARM, 0);
    TEST_ASSERT_EQUAL_INT(BERTH_SUPERVISOR_ARMED, step(1));
    command(BERTH_COMMAND_START, 2);
    TEST_ASSERT_EQUAL_INT(BERTH_SUPERVISOR_RUNNING, step(1000000000));
}

/* What goes wrong, the reason, and in which states it counts (bit per state). */
typedef struct {
    const char *what;
    uint8_t fault;
    unsigned states;
} trouble_t;

#define IN(state) (1u << (state))
#define TORQUE                                                                                     \
    (IN(BERTH_SUPERVISOR_ARMING) | IN(BERTH_SUPERVISOR_ARMED) | IN(BERTH_SUPERVISOR_RUNNING) |     \
     IN(BERTH_SUPERVISOR_STOPPING))
#define READY (IN(BERTH_SUPERVISOR_ARMED) | IN(BERTH_SUPERVISOR_RUNNING))

static const trouble_t troubles[] = {
    {"problem", (int)BERTH_FAULT_LEFT + BERTH_DRIVE_FAULT_DEVICE, TORQUE},
    {"late", BERTH_FAULT_PERIOD, TORQUE},
    {"transmit", BERTH_FAULT_TRANSMIT, TORQUE},
    {"no pose", BERTH_FAULT_POSE_UNKNOWN, READY},
    {"old fix", BERTH_FAULT_POSE_AGE, READY},
};

static void make_trouble(int which) {
    switch (which) {
    case 0:
        inputs.problem = troubles[0].fault;
        break;
    case 1:
        inputs.late_us = 150001;
        break;
    case 2:
        inputs.transmit_wait_us = 100001;
        break;
    case 3:
        inputs.pose_known = false;
        break;
    default:
        inputs.fix_age_us = 300001;
        break;
    }
}

static void test_each_trouble_stops_the_states_it_concerns_and_is_kept(void) {
    for (int which = 0; which < 5; which++) {
        for (int state = 0; state < 5; state++) {
            reach((berth_supervisor_state_t)state);
            inputs.standing = state != BERTH_SUPERVISOR_STOPPING;
            make_trouble(which);
            const bool stops = (troubles[which].states & IN(state)) != 0;
            TEST_ASSERT_EQUAL_INT_MESSAGE(stops ? BERTH_SUPERVISOR_FAULT : state, step(1),
                                          troubles[which].what);
            if (stops) {
                TEST_ASSERT_EQUAL_UINT8(troubles[which].fault, supervisor.fault);
                inputs.problem = BERTH_FAULT_RIGHT; /* a later one does not replace it */
                TEST_ASSERT_EQUAL_INT(BERTH_SUPERVISOR_FAULT, step(2));
                berth_supervisor_fail(&supervisor, BERTH_FAULT_BUS_OFF, 3);
                TEST_ASSERT_EQUAL_UINT8(troubles[which].fault, supervisor.fault);
                TEST_ASSERT_EQUAL_UINT32(1, supervisor.faults);
            }
        }
    }
}

static void test_limits_themselves_are_good(void) {
    reach(BERTH_SUPERVISOR_RUNNING);
    inputs.late_us = 150000;
    inputs.transmit_wait_us = 100000;
    inputs.fix_age_us = 300000;
    inputs.following_radps = 2.0f;
    TEST_ASSERT_EQUAL_INT(BERTH_SUPERVISOR_RUNNING, step(1));
}

static void test_following_needs_time_and_forgets(void) {
    reach(BERTH_SUPERVISOR_RUNNING);
    inputs.following_radps = 2.1f;
    TEST_ASSERT_EQUAL_INT(BERTH_SUPERVISOR_RUNNING, step(200000));
    inputs.following_radps = 1.9f;
    TEST_ASSERT_EQUAL_INT(BERTH_SUPERVISOR_RUNNING, step(200001));
    inputs.following_radps = 2.1f;
    TEST_ASSERT_EQUAL_INT(BERTH_SUPERVISOR_RUNNING, step(400001));
    TEST_ASSERT_EQUAL_INT(BERTH_SUPERVISOR_FAULT, step(400002));
    TEST_ASSERT_EQUAL_UINT8(BERTH_FAULT_FOLLOWING, supervisor.fault);
    reach(BERTH_SUPERVISOR_RUNNING);
    inputs.following_radps = NAN; /* what is no number does not follow */
    TEST_ASSERT_EQUAL_INT(BERTH_SUPERVISOR_FAULT, step(200001));
    config.following_radps = 0.0f;
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_supervisor_init(&supervisor, &config, &refusal));
    command(BERTH_COMMAND_ARM, 0);
    (void)step(0);
    command(BERTH_COMMAND_START, 0);
    inputs.following_radps = 100.0f;
    TEST_ASSERT_EQUAL_INT(BERTH_SUPERVISOR_RUNNING, step(1000000000));
}

static void test_stopping_ends_when_the_wheels_stand_or_in_fault(void) {
    reach(BERTH_SUPERVISOR_STOPPING);
    inputs.standing = false;
    inputs.pose_known = false; /* to stop it needs no pose */
    TEST_ASSERT_EQUAL_INT(BERTH_SUPERVISOR_STOPPING, step(500000));
    inputs.standing = true;
    TEST_ASSERT_EQUAL_INT(BERTH_SUPERVISOR_IDLE, step(500001));
    reach(BERTH_SUPERVISOR_STOPPING);
    inputs.standing = false;
    TEST_ASSERT_EQUAL_INT(BERTH_SUPERVISOR_FAULT, step(500001));
    TEST_ASSERT_EQUAL_UINT8(BERTH_FAULT_STOP_TIMEOUT, supervisor.fault);
}

/* Any order of commands and inputs: moving needs arming and a start since the last fault or idle.
 */
static void test_random_walks_never_run_without_arm_and_start(void) {
    support_random_start();
    setUp();
    bool armed = false;
    uint32_t running = 0;
    for (uint32_t i = 0; i < support_runs(200000); i++) {
        inputs.drives_enabled = support_index(4) > 0;
        inputs.standing = support_index(4) > 0;
        inputs.pose_known = support_index(50) > 0;
        inputs.late_us = support_index(100) == 0 ? 200000 : 0;
        inputs.problem = support_index(100) == 0 ? BERTH_FAULT_LEFT : BERTH_FAULT_NONE;
        const berth_supervisor_state_t before = supervisor.state;
        if (support_index(3) == 0) {
            const berth_command_code_t code = (berth_command_code_t)support_index(7);
            berth_supervisor_command(&supervisor, code, support_index(2) == 0, (int64_t)i * 1000);
            if (supervisor.state == BERTH_SUPERVISOR_RUNNING &&
                before != BERTH_SUPERVISOR_RUNNING) {
                TEST_ASSERT_TRUE(armed && code == BERTH_COMMAND_START);
            }
        } else {
            TEST_ASSERT_TRUE(step((int64_t)i * 1000) != BERTH_SUPERVISOR_RUNNING ||
                             before == BERTH_SUPERVISOR_RUNNING);
        }
        armed = supervisor.state == BERTH_SUPERVISOR_ARMED;
        running += supervisor.state == BERTH_SUPERVISOR_RUNNING;
        TEST_ASSERT_EQUAL_INT(supervisor.state == BERTH_SUPERVISOR_FAULT,
                              supervisor.fault != BERTH_FAULT_NONE);
    }
    TEST_ASSERT_GREATER_THAN_UINT32(10, running);
}

static void expect_refused(berth_field_t field) {
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_CONFIG,
                          berth_supervisor_init(&supervisor, &config, &refusal));
    TEST_ASSERT_EQUAL_INT(field, refusal.field);
}

static void test_configuration_is_checked_field_by_field(void) {
    const berth_supervisor_config_t good = config;
    struct {
        uint32_t *value;
        uint32_t over;
        berth_field_t field;
    } times[] = {
        {&config.fix_timeout_us, 3700000000u, BERTH_FIELD_FIX_TIMEOUT},
        {&config.period_late_us, 10000032u, BERTH_FIELD_PERIOD_LATE},
        {&config.transmit_timeout_us, 10000032u, BERTH_FIELD_TRANSMIT_TIMEOUT},
        {&config.arm_timeout_us, 60000064u, BERTH_FIELD_ARM_TIMEOUT},
        {&config.stop_timeout_us, 60000064u, BERTH_FIELD_STOP_TIMEOUT},
        {&config.following_us, 10000032u, BERTH_FIELD_FOLLOWING_TIME},
    };
    for (size_t i = 0; i < sizeof times / sizeof times[0]; i++) {
        *times[i].value = 999;
        expect_refused(times[i].field);
        *times[i].value = times[i].over;
        expect_refused(times[i].field);
        config = good;
    }
    const float bad[] = {-1.0f, NAN, INFINITY, -INFINITY, 1.0e6f};
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        config.standing_radps = bad[i];
        expect_refused(BERTH_FIELD_STANDING);
        config = good;
        config.following_radps = bad[i];
        expect_refused(BERTH_FIELD_FOLLOWING);
        config = good;
    }
    config.standing_radps = 0.0f;
    expect_refused(BERTH_FIELD_STANDING);
}

static void test_texts(void) {
    TEST_ASSERT_EQUAL_STRING("running", berth_supervisor_state_text(BERTH_SUPERVISOR_RUNNING));
    TEST_ASSERT_EQUAL_STRING("?", berth_supervisor_state_text((berth_supervisor_state_t)6));
    TEST_ASSERT_EQUAL_STRING("no room for an obstacle from the bus",
                             berth_fault_text(BERTH_FAULT_OBSTACLES));
    TEST_ASSERT_EQUAL_STRING("?", berth_fault_text(BERTH_FAULT_OBSTACLES + 1));
    TEST_ASSERT_EQUAL_STRING("no speed feedback in time",
                             berth_fault_text((int)BERTH_FAULT_RIGHT + BERTH_DRIVE_FAULT_FEEDBACK));
    TEST_ASSERT_EQUAL_STRING(berth_drive_fault_text(BERTH_DRIVE_FAULT_DEVICE),
                             berth_fault_text((int)BERTH_FAULT_LEFT + BERTH_DRIVE_FAULT_DEVICE));
    TEST_ASSERT_EQUAL_STRING("right drive: ", berth_fault_side_text(BERTH_FAULT_RIGHT + 1));
    TEST_ASSERT_EQUAL_STRING("left drive: ", berth_fault_side_text(BERTH_FAULT_LEFT + 1));
    TEST_ASSERT_EQUAL_STRING("", berth_fault_side_text(BERTH_FAULT_PERIOD));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_each_state_takes_each_command_as_the_table_says);
    RUN_TEST(test_what_is_no_command_is_refused_in_each_state);
    RUN_TEST(test_reset_waits_until_the_cause_is_gone);
    RUN_TEST(test_arming_waits_for_every_check);
    RUN_TEST(test_dead_reckoning_needs_no_fix);
    RUN_TEST(test_each_trouble_stops_the_states_it_concerns_and_is_kept);
    RUN_TEST(test_limits_themselves_are_good);
    RUN_TEST(test_following_needs_time_and_forgets);
    RUN_TEST(test_stopping_ends_when_the_wheels_stand_or_in_fault);
    RUN_TEST(test_random_walks_never_run_without_arm_and_start);
    RUN_TEST(test_configuration_is_checked_field_by_field);
    RUN_TEST(test_texts);
    return UNITY_END();
}
