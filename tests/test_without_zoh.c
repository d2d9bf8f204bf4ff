/* The library without the zero-order hold (BERTH_WITHOUT_ZOH). */
#include "support.h"
#include "unity.h"

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

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_refuses_plans_with_it);
    RUN_TEST(test_computes_gains_without_it);
    return UNITY_END();
}
