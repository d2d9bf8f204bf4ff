/* The library without the zero-order hold (BERTH_WITHOUT_ZOH) and without pace
 * (BERTH_WITHOUT_PACE). */
#include "support.h"
#include "unity.h"

#include <math.h>

static support_plan_t shape;
static berth_refusal_t refusal;

void setUp(void) {
    support_plan(&shape, SUPPORT_CIRCLE, 100, false);
}

void tearDown(void) {}

static void test_refuses_plans_with_it(void) {
    berth_controller_t controller;
    const berth_config_t config = berth_config_default(0.05f, 0.3f);
    shape.plan.mpc.discretization = BERTH_DISCRETIZATION_ZOH;
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_PLAN, berth_plan_check(&shape.plan, &refusal));
    TEST_ASSERT_EQUAL_INT(BERTH_FIELD_PLAN_DISCRETIZATION, refusal.field);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, refusal.maximum);
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_PLAN,
                          berth_controller_init(&controller, &shape.plan, &config, &refusal));
}

/* A gain of the Euler form: on a straight part the two inputs do not mix. */
static void test_computes_gains_without_it(void) {
    berth_gain_t gain;
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_plan_check(&shape.plan, &refusal));
    for (uint32_t k = 0; k < shape.plan.count; k++) {
        shape.samples[k].omega_radps = 0.0f;
    }
    berth_riccati_gain(&shape.plan, 0, &gain);
    TEST_ASSERT_TRUE(gain.k[0][0] > 0.5f);
    TEST_ASSERT_TRUE(gain.k[1][1] > 0.5f);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, gain.k[0][1]);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, gain.k[1][0]);
}

/* Towards an obstacle beside the robot the turn ends in one period, paced or not. */
static void test_keeps_no_pace(void) {
    for (int paced = 0; paced < 2; paced++) {
        berth_controller_t controller;
        berth_command_t command;
        berth_config_t config = berth_config_default(0.05f, 0.3f);
        const berth_obstacle_t obstacle = {0.9f, 0.15f, 0.1f, 0.4f, 2.0f};
        const berth_pose_t pose = {.x_m = 0.0f};
        config.avoid.tau_s = 0.2f;
        config.avoid.paced = paced != 0;
        TEST_ASSERT_EQUAL_INT(BERTH_OK,
                              berth_controller_init(&controller, &shape.plan, &config, &refusal));
        TEST_ASSERT_EQUAL_INT(BERTH_OK,
                              berth_controller_add_obstacle(&controller, &obstacle, &refusal));
        TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_controller_start(&controller, 0));
        TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_controller_step(&controller, 0, &pose, &command));
        TEST_ASSERT_EQUAL_INT(BERTH_MODE_REGULATED, berth_controller_status(&controller)->mode);
        TEST_ASSERT_EQUAL_FLOAT(3.0f, fabsf(command.twist.omega_radps));
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_refuses_plans_with_it);
    RUN_TEST(test_computes_gains_without_it);
    RUN_TEST(test_keeps_no_pace);
    return UNITY_END();
}
