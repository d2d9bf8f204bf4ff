/* Plans that berth-gen wrote during the build: the same bits as the recursion at run time, and the
 * same samples as the simulator's. */
#include "berth/riccati.h"
#include "plan_circle_euler_closed.h"
#include "plan_circle_euler_open.h"
#include "plan_circle_zoh_closed.h"
#include "plan_circle_zoh_open.h"
#include "plan_eight_euler_closed.h"
#include "plan_eight_euler_open.h"
#include "plan_eight_zoh_closed.h"
#include "plan_eight_zoh_open.h"
#include "reference_source.h"
#include "unity.h"

#include <string.h>

void setUp(void) {}

void tearDown(void) {}

typedef struct {
    const berth_plan_t *plan;
    shape_t shape;
    bool closed;
    berth_discretization_t discretization;
    const char *name;
} case_t;

static const case_t cases[] = {
    {&plan_circle_euler_open, SHAPE_CIRCLE, false, BERTH_DISCRETIZATION_EULER, "circle euler open"},
    {&plan_circle_euler_closed, SHAPE_CIRCLE, true, BERTH_DISCRETIZATION_EULER,
     "circle euler closed"},
    {&plan_circle_zoh_open, SHAPE_CIRCLE, false, BERTH_DISCRETIZATION_ZOH, "circle zoh open"},
    {&plan_circle_zoh_closed, SHAPE_CIRCLE, true, BERTH_DISCRETIZATION_ZOH, "circle zoh closed"},
    {&plan_eight_euler_open, SHAPE_EIGHT, false, BERTH_DISCRETIZATION_EULER, "eight euler open"},
    {&plan_eight_euler_closed, SHAPE_EIGHT, true, BERTH_DISCRETIZATION_EULER, "eight euler closed"},
    {&plan_eight_zoh_open, SHAPE_EIGHT, false, BERTH_DISCRETIZATION_ZOH, "eight zoh open"},
    {&plan_eight_zoh_closed, SHAPE_EIGHT, true, BERTH_DISCRETIZATION_ZOH, "eight zoh closed"},
};
#define CASES (sizeof cases / sizeof cases[0])

static void test_plans_pass_the_firmware_check(void) {
    for (size_t i = 0; i < CASES; i++) {
        berth_refusal_t refusal;
        TEST_ASSERT_EQUAL_MESSAGE(BERTH_OK, berth_plan_check(cases[i].plan, &refusal),
                                  cases[i].name);
    }
}

static void test_plans_say_what_was_asked_for(void) {
    for (size_t i = 0; i < CASES; i++) {
        const berth_plan_t *plan = cases[i].plan;
        const char *name = cases[i].name;
        const uint32_t open_count = cases[i].shape == SHAPE_CIRCLE ? 600 : 900;
        const uint32_t lap_count = cases[i].shape == SHAPE_CIRCLE ? 419 : 838;
        TEST_ASSERT_EQUAL_UINT32_MESSAGE(cases[i].closed ? lap_count : open_count, plan->count,
                                         name);
        TEST_ASSERT_EQUAL_UINT32_MESSAGE(50000, plan->period_us, name);
        TEST_ASSERT_EQUAL_MESSAGE(cases[i].closed, plan->closed, name);
        TEST_ASSERT_EQUAL_MESSAGE(cases[i].discretization, plan->mpc.discretization, name);
        TEST_ASSERT_EQUAL_MESSAGE(BERTH_GAIN_TABLE, plan->gain_source, name);
        TEST_ASSERT_EQUAL_MESSAGE(20, plan->mpc.horizon, name);
        const float q[] = {10.0f, 40.0f, 1.0f};
        const float r[] = {0.5f, 0.1f};
        TEST_ASSERT_EQUAL_MEMORY_MESSAGE(q, plan->mpc.q, sizeof q, name);
        TEST_ASSERT_EQUAL_MEMORY_MESSAGE(r, plan->mpc.r, sizeof r, name);
    }
}

static void test_gains_have_the_bits_of_the_recursion_at_run_time(void) {
    for (size_t i = 0; i < CASES; i++) {
        berth_plan_t online = *cases[i].plan;
        online.gains = NULL;
        online.gain_source = BERTH_GAIN_ONLINE;
        for (uint32_t k = 0; k < online.count; k++) {
            berth_gain_t gain;
            berth_riccati_gain(&online, k, &gain);
            TEST_ASSERT_EQUAL_MEMORY_MESSAGE(&gain, &cases[i].plan->gains[k], sizeof gain,
                                             cases[i].name);
        }
    }
}

static void test_samples_have_the_bits_of_the_simulator(void) {
    for (size_t i = 0; i < CASES; i++) {
        const berth_plan_t *plan = cases[i].plan;
        reference_samples_t samples;
        scenario_error_t error;
        TEST_ASSERT_TRUE(
            reference_from_shape(cases[i].shape, 0.05, plan->count * 0.05, &samples, &error));
        TEST_ASSERT_EQUAL_UINT32(samples.count, plan->count);
        TEST_ASSERT_EQUAL_MEMORY_MESSAGE(samples.samples, plan->samples,
                                         samples.count * sizeof *samples.samples, cases[i].name);
        reference_samples_free(&samples);
    }
}

/* Otherwise the comparisons above might compare a combination with itself. */
static void test_the_combinations_differ(void) {
    const size_t row = sizeof(berth_gain_t);
    TEST_ASSERT_NOT_EQUAL(0, memcmp(plan_eight_euler_open.gains, plan_eight_zoh_open.gains, row));
    TEST_ASSERT_NOT_EQUAL(0,
                          memcmp(plan_eight_euler_open.gains, plan_circle_euler_open.gains, row));
    /* near the end of an open plan the horizon sees the robot stand */
    const uint32_t last = plan_circle_euler_open.count - 1;
    TEST_ASSERT_NOT_EQUAL(
        0, memcmp(&plan_circle_euler_open.gains[last], &plan_circle_euler_open.gains[0], row));
    const uint32_t lap = plan_circle_euler_closed.count - 1;
    TEST_ASSERT_EQUAL_MEMORY(&plan_circle_euler_closed.gains[lap],
                             &plan_circle_euler_closed.gains[0], row);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_plans_pass_the_firmware_check);
    RUN_TEST(test_plans_say_what_was_asked_for);
    RUN_TEST(test_gains_have_the_bits_of_the_recursion_at_run_time);
    RUN_TEST(test_samples_have_the_bits_of_the_simulator);
    RUN_TEST(test_the_combinations_differ);
    return UNITY_END();
}
