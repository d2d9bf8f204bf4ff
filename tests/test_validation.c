/* Every value that validation looks at, pushed to and past its bounds: the refusal names the field,
 * the index, the value and the range, and what was refused cannot be used.
 */
#include "support.h"

#include "unity.h"

#include <float.h>
#include <limits.h>
#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define PERIOD_US 50000u
#define HALF_PI (0.5f * BERTH_PI)

static support_plan_t plan;
static support_plan_t table;

void setUp(void) {
    support_plan(&plan, SUPPORT_EIGHT, 30, false);
    support_plan(&table, SUPPORT_EIGHT, 30, false);
    support_fill_gains(&table);
}

void tearDown(void) {}

/* ---- Pushing one float ---- */

/* One value and what is promised of it. */
typedef struct {
    berth_field_t field;
    size_t offset; /* in the struct that is pushed */
    float minimum, maximum;
    bool zero_allowed; /* 0 switches the thing off */
} rule_t;

/* Validates the struct that is being pushed. */
typedef berth_error_t (*check_t)(const void *subject, berth_refusal_t *refusal);

typedef struct {
    void *subject;
    check_t check;
    berth_error_t error; /* that a refusal gives */
    uint32_t index;      /* that a refusal names */
} push_t;

static berth_refusal_t unfilled(void) {
    berth_refusal_t refusal;
    memset(&refusal, 0x5a, sizeof refusal);
    return refusal;
}

static void check_refusal(const berth_refusal_t *refusal, berth_field_t field, uint32_t index,
                          float value, float minimum, float maximum) {
    const char *what = berth_field_text(field);
    TEST_ASSERT_EQUAL_MESSAGE(field, refusal->field, what);
    TEST_ASSERT_EQUAL_UINT32_MESSAGE(index, refusal->index, what);
    TEST_ASSERT_TRUE_MESSAGE(support_same_bits(value, refusal->value), what);
    TEST_ASSERT_EQUAL_FLOAT_MESSAGE(minimum, refusal->minimum, what);
    TEST_ASSERT_EQUAL_FLOAT_MESSAGE(maximum, refusal->maximum, what);
}

static void refuses(const push_t *push, const rule_t *rule, float value) {
    float *place = (float *)(void *)((char *)push->subject + rule->offset);
    const float kept = *place;
    *place = value;
    berth_refusal_t refusal = unfilled();
    TEST_ASSERT_EQUAL_MESSAGE(push->error, push->check(push->subject, &refusal),
                              berth_field_text(rule->field));
    check_refusal(&refusal, rule->field, push->index, value, rule->minimum, rule->maximum);
    *place = kept;
}

static void accepts(const push_t *push, const rule_t *rule, float value) {
    float *place = (float *)(void *)((char *)push->subject + rule->offset);
    const float kept = *place;
    *place = value;
    berth_refusal_t refusal = unfilled();
    TEST_ASSERT_EQUAL_MESSAGE(BERTH_OK, push->check(push->subject, &refusal),
                              berth_field_text(rule->field));
    *place = kept;
}

/* Both bounds are in; their neighbours, the infinities and NaN are out; so is what lies between 0
 * and the minimum where 0 is a value of its own. */
static void push_all(const push_t *push, const rule_t *rules, size_t count) {
    for (size_t i = 0; i < count; i++) {
        const rule_t *rule = &rules[i];
        accepts(push, rule, rule->minimum);
        accepts(push, rule, rule->maximum);
        refuses(push, rule, nextafterf(rule->minimum, -INFINITY));
        refuses(push, rule, nextafterf(rule->maximum, INFINITY));
        refuses(push, rule, -FLT_MAX);
        refuses(push, rule, FLT_MAX);
        refuses(push, rule, -INFINITY);
        refuses(push, rule, INFINITY);
        refuses(push, rule, NAN);
        if (rule->zero_allowed) {
            accepts(push, rule, 0.0f);
            accepts(push, rule, -0.0f);
            refuses(push, rule, FLT_TRUE_MIN);
            refuses(push, rule, -FLT_TRUE_MIN);
        } else if (rule->minimum > 0.0f) {
            refuses(push, rule, 0.0f);
        }
    }
}

#define COUNT(array) (sizeof(array) / sizeof((array)[0]))

/* ---- Limits ---- */

#define LIMITS_RULE(field, member, minimum, maximum, zero)                                         \
    {field, offsetof(berth_limits_config_t, member), minimum, maximum, zero}

static const rule_t limits_rules[] = {
    LIMITS_RULE(BERTH_FIELD_WHEEL_RADIUS, wheel_radius_m, 0.001f, 10.0f, false),
    LIMITS_RULE(BERTH_FIELD_TRACK, track_m, 0.01f, 10.0f, false),
    LIMITS_RULE(BERTH_FIELD_V_MAX, v_max_mps, 0.001f, 100.0f, false),
    LIMITS_RULE(BERTH_FIELD_OMEGA_MAX, omega_max_radps, 0.001f, 100.0f, false),
    LIMITS_RULE(BERTH_FIELD_WHEEL_SPEED_MAX, wheel_speed_max_radps, 0.001f, 10000.0f, true),
    LIMITS_RULE(BERTH_FIELD_A_MAX, a_max_mps2, 0.001f, 1000.0f, true),
    LIMITS_RULE(BERTH_FIELD_ALPHA_MAX, alpha_max_radps2, 0.001f, 1000.0f, true),
};

static berth_error_t check_limits(const void *subject, berth_refusal_t *refusal) {
    return berth_limits_check(subject, refusal);
}

static void test_limits(void) {
    berth_limits_config_t config = berth_config_default(0.05f, 0.30f).limits;
    const push_t push = {&config, check_limits, BERTH_ERROR_CONFIG, 0};
    push_all(&push, limits_rules, COUNT(limits_rules));
}

/* Who sets avoidance up gets the limits checked too, with the same refusals. */
static berth_error_t check_limits_of_avoid(const void *subject, berth_refusal_t *refusal) {
    const berth_config_t config = berth_config_default(0.05f, 0.30f);
    berth_avoid_t avoid;
    return berth_avoid_init(&avoid, &config.avoid, subject, PERIOD_US, refusal);
}

static void test_limits_through_avoidance(void) {
    berth_limits_config_t config = berth_config_default(0.05f, 0.30f).limits;
    const push_t push = {&config, check_limits_of_avoid, BERTH_ERROR_CONFIG, 0};
    for (size_t i = 0; i < COUNT(limits_rules); i++) {
        refuses(&push, &limits_rules[i], nextafterf(limits_rules[i].minimum, 0.0f));
        refuses(&push, &limits_rules[i], NAN);
    }
}

/* ---- Avoidance ---- */

static berth_limits_config_t avoid_limits;

static berth_error_t check_avoid(const void *subject, berth_refusal_t *refusal) {
    berth_avoid_t avoid;
    berth_avoid_t before;
    memset(&avoid, 0x33, sizeof avoid);
    memset(&before, 0x33, sizeof before);
    const berth_error_t error =
        berth_avoid_init(&avoid, subject, &avoid_limits, PERIOD_US, refusal);
    if (error != BERTH_OK) {
        TEST_ASSERT_EQUAL_MEMORY(&before, &avoid, sizeof avoid);
    }
    return error;
}

static void test_avoid(void) {
    static const rule_t rules[] = {
        {BERTH_FIELD_SKIRT, offsetof(berth_avoid_config_t, skirt_m), 0.0f, 10.0f, false},
        {BERTH_FIELD_V_CREEP, offsetof(berth_avoid_config_t, v_creep_mps), 0.001f, 0.8f, false},
        {BERTH_FIELD_TAU, offsetof(berth_avoid_config_t, tau_s), 0.0f, 10.0f, false},
        {BERTH_FIELD_A_BRAKE, offsetof(berth_avoid_config_t, a_brake_mps2), 0.001f, 1000.0f, true},
        {BERTH_FIELD_SIGMA_POSE, offsetof(berth_avoid_config_t, sigma_pose_m), 0.0f, 1.0f, false},
    };
    const berth_config_t base = berth_config_default(0.05f, 0.30f);
    berth_avoid_config_t config = base.avoid;
    avoid_limits = base.limits;
    const push_t push = {&config, check_avoid, BERTH_ERROR_CONFIG, 0};
    push_all(&push, rules, COUNT(rules));
}

/* Where the limits bound braking, avoidance cannot count on more, nor on an unlimited one. */
static void test_a_brake_within_a_max(void) {
    static const rule_t rule = {BERTH_FIELD_A_BRAKE, offsetof(berth_avoid_config_t, a_brake_mps2),
                                0.001f, 2.0f, false};
    const berth_config_t base = berth_config_default(0.05f, 0.30f);
    berth_avoid_config_t config = base.avoid;
    config.a_brake_mps2 = 1.0f;
    avoid_limits = base.limits;
    avoid_limits.a_max_mps2 = 2.0f;
    const push_t push = {&config, check_avoid, BERTH_ERROR_CONFIG, 0};
    accepts(&push, &rule, 0.001f);
    accepts(&push, &rule, 2.0f);
    refuses(&push, &rule, 0.0f);
    refuses(&push, &rule, nextafterf(2.0f, 3.0f));
}

static void test_avoid_period(void) {
    const berth_config_t config = berth_config_default(0.05f, 0.30f);
    const uint32_t bad[] = {0, 999, 1000001, UINT32_MAX};
    berth_avoid_t avoid;
    for (size_t i = 0; i < COUNT(bad); i++) {
        berth_refusal_t refusal = unfilled();
        TEST_ASSERT_EQUAL(BERTH_ERROR_CONFIG, berth_avoid_init(&avoid, &config.avoid,
                                                               &config.limits, bad[i], &refusal));
        check_refusal(&refusal, BERTH_FIELD_PLAN_PERIOD, 0, (float)bad[i], 1000.0f, 1.0e6f);
    }
    berth_refusal_t refusal;
    TEST_ASSERT_EQUAL(BERTH_OK,
                      berth_avoid_init(&avoid, &config.avoid, &config.limits, 1000, &refusal));
}

/* A quarter turn per period is the most; in float32 it is exactly HALF_PI. */
static void test_turn_per_period(void) {
    const uint32_t periods[] = {50000, 125000, 500000, 1000000};
    for (size_t i = 0; i < COUNT(periods); i++) {
        const float period_s = (float)periods[i] / 1.0e6f;
        berth_config_t config = berth_config_default(0.05f, 0.30f);
        berth_avoid_t avoid;
        berth_refusal_t refusal = unfilled();
        config.limits.omega_max_radps = HALF_PI / period_s * (1.0f - FLT_EPSILON);
        TEST_ASSERT_EQUAL(BERTH_OK, berth_avoid_init(&avoid, &config.avoid, &config.limits,
                                                     periods[i], &refusal));
        config.limits.omega_max_radps = HALF_PI / period_s * (1.0f + 2.0f * FLT_EPSILON);
        TEST_ASSERT_EQUAL(
            BERTH_ERROR_CONFIG,
            berth_avoid_init(&avoid, &config.avoid, &config.limits, periods[i], &refusal));
        check_refusal(&refusal, BERTH_FIELD_TURN_PER_PERIOD, 0,
                      config.limits.omega_max_radps * period_s, 0.0f, HALF_PI);
    }
}

/* ---- Obstacles ---- */

static berth_error_t check_obstacle(const void *subject, berth_refusal_t *refusal) {
    const berth_error_t error = berth_obstacle_check(subject, refusal);
    refusal->index = 0; /* is left to the caller */
    return error;
}

static void test_obstacle(void) {
    static const rule_t rules[] = {
        {BERTH_FIELD_OBSTACLE_X, offsetof(berth_obstacle_t, x_m), -1000.0f, 1000.0f, false},
        {BERTH_FIELD_OBSTACLE_Y, offsetof(berth_obstacle_t, y_m), -1000.0f, 1000.0f, false},
        {BERTH_FIELD_OBSTACLE_HARD, offsetof(berth_obstacle_t, hard_m), 0.001f, 100.0f, false},
    };
    static const rule_t conservative = {BERTH_FIELD_OBSTACLE_CONSERVATIVE,
                                        offsetof(berth_obstacle_t, conservative_m), 0.25f, 100.0f,
                                        false};
    static const rule_t regulated = {BERTH_FIELD_OBSTACLE_REGULATED,
                                     offsetof(berth_obstacle_t, regulated_m), 0.5f, 100.0f, false};
    berth_obstacle_t obstacle = {1.0f, 2.0f, 0.25f, 100.0f, 100.0f};
    const push_t push = {&obstacle, check_obstacle, BERTH_ERROR_CONFIG, 0};
    push_all(&push, rules, COUNT(rules));
    push_all(&push, &conservative, 1);
    obstacle.conservative_m = 0.5f;
    push_all(&push, &regulated, 1);
}

static berth_avoid_t avoid_with(berth_config_t config) {
    berth_avoid_t avoid;
    berth_refusal_t refusal;
    TEST_ASSERT_EQUAL(BERTH_OK,
                      berth_avoid_init(&avoid, &config.avoid, &config.limits, PERIOD_US, &refusal));
    return avoid;
}

/* v_max T = 0.03125, and all radii, are exact in float32: equality is in, a step of ten
 * micrometres below is out. */
static void test_clearance_bound_exactly(void) {
    berth_config_t config = berth_config_default(0.05f, 0.30f);
    config.limits.v_max_mps = 0.5f;
    berth_avoid_t avoid;
    berth_refusal_t refusal = unfilled();
    TEST_ASSERT_EQUAL(BERTH_OK,
                      berth_avoid_init(&avoid, &config.avoid, &config.limits, 62500, &refusal));
    berth_obstacle_t obstacle = {0.0f, 0.0f, 0.125f, 0.15625f, 0.5f};
    TEST_ASSERT_EQUAL(BERTH_OK, berth_avoid_check_obstacle(&avoid, &obstacle, &refusal));
    obstacle.conservative_m -= 1.0e-5f;
    TEST_ASSERT_EQUAL(BERTH_ERROR_CLEARANCE,
                      berth_avoid_check_obstacle(&avoid, &obstacle, &refusal));
    TEST_ASSERT_EQUAL(BERTH_FIELD_CLEARANCE, refusal.field);
    TEST_ASSERT_EQUAL_FLOAT(obstacle.conservative_m - obstacle.hard_m, refusal.value);
    TEST_ASSERT_EQUAL_FLOAT(0.03125f, refusal.minimum);
    TEST_ASSERT_EQUAL_FLOAT(BERTH_RADIUS_MAX_M - 0.125f, refusal.maximum);
}

/* C = R + v_max T and G = C + skirt, rounded to float32 as whoever writes them down would: the
 * slack covers the rounding of radii below 16 m. */
static void test_clearance_bound_of_rounded_radii(void) {
    support_random_start();
    for (uint32_t run = 0; run < support_runs(100000); run++) {
        berth_config_t config = berth_config_default(0.05f, 0.30f);
        config.limits.v_max_mps = (float)support_log_uniform(0.05, 3.0);
        config.avoid.skirt_m = (float)support_uniform(0.0, 0.1);
        const berth_avoid_t avoid = avoid_with(config);
        const float step = config.limits.v_max_mps * 0.05f;
        berth_obstacle_t obstacle = {.hard_m = (float)support_log_uniform(0.001, 15.0)};
        obstacle.conservative_m = obstacle.hard_m + step;
        obstacle.regulated_m = obstacle.conservative_m + config.avoid.skirt_m;
        berth_refusal_t refusal;
        TEST_ASSERT_EQUAL(BERTH_OK, berth_avoid_check_obstacle(&avoid, &obstacle, &refusal));
        const float wide = obstacle.conservative_m;
        obstacle.conservative_m = wide - 4.0e-6f;
        TEST_ASSERT_EQUAL(BERTH_ERROR_CLEARANCE,
                          berth_avoid_check_obstacle(&avoid, &obstacle, &refusal));
        obstacle.conservative_m = wide;
        obstacle.regulated_m -= 4.0e-6f;
        TEST_ASSERT_EQUAL(BERTH_ERROR_CONFIG,
                          berth_avoid_check_obstacle(&avoid, &obstacle, &refusal));
        check_refusal(&refusal, BERTH_FIELD_OBSTACLE_REGULATED, 0, obstacle.regulated_m,
                      wide + config.avoid.skirt_m, BERTH_RADIUS_MAX_M);
    }
}

/* C - R >= v_max (T + tau) + v_max^2 / (2 a_brake) + 3 sigma, with each term in turn. */
static void test_clearance_condition_with_delay(void) {
    static const struct {
        float tau, brake, sigma, alpha;
    } cases[] = {
        {0.0f, 0.0f, 0.0f, 0.0f},     {0.1f, 0.0f, 0.0f, 0.0f},    {0.0f, 2.0f, 0.0f, 0.0f},
        {0.0f, 0.0f, 0.01f, 0.0f},    {0.0f, 0.0f, 0.0f, 20.0f},   {0.05f, 3.0f, 0.003f, 0.0f},
        {0.05f, 3.0f, 0.003f, 12.0f}, {10.0f, 0.001f, 1.0f, 0.0f},
    };
    for (size_t i = 0; i < COUNT(cases); i++) {
        berth_config_t config = berth_config_default(0.05f, 0.30f);
        config.avoid.tau_s = cases[i].tau;
        config.avoid.a_brake_mps2 = cases[i].brake;
        config.avoid.sigma_pose_m = cases[i].sigma;
        config.limits.alpha_max_radps2 = cases[i].alpha;
        const double alpha = (double)cases[i].alpha;
        const double yaw = alpha > 0.0 ? 2.0 * 3.0 / alpha : 0.0; /* from -omega_max to omega_max */
        const double brake = (double)cases[i].brake;
        const double least = 0.8 * (0.05 + (double)cases[i].tau + yaw) +
                             (brake > 0.0 ? 0.8 * 0.8 / (2.0 * brake) : 0.0) +
                             3.0 * (double)cases[i].sigma;
        const berth_avoid_t avoid = avoid_with(config);
        berth_obstacle_t obstacle = {0.0f, 0.0f, 0.5f, (float)(0.5 + least - 1.0e-4), 100.0f};
        berth_refusal_t refusal = unfilled();
        TEST_ASSERT_EQUAL(BERTH_ERROR_CLEARANCE,
                          berth_avoid_check_obstacle(&avoid, &obstacle, &refusal));
        TEST_ASSERT_EQUAL(BERTH_FIELD_CLEARANCE, refusal.field);
        TEST_ASSERT_DOUBLE_WITHIN(1.0e-6 * least, least, (double)refusal.minimum);
        TEST_ASSERT_EQUAL_FLOAT(obstacle.conservative_m - 0.5f, refusal.value);
        if (least < 90.0) {
            obstacle.conservative_m = (float)(0.5 + least + 1.0e-4);
            TEST_ASSERT_EQUAL(BERTH_OK, berth_avoid_check_obstacle(&avoid, &obstacle, &refusal));
        }
    }
}

/* ---- Plan ---- */

static berth_error_t check_plan(const void *subject, berth_refusal_t *refusal) {
    return berth_plan_check(subject, refusal);
}

static void test_plan_weights(void) {
    for (uint32_t i = 0; i < 3; i++) {
        const rule_t rule = {BERTH_FIELD_PLAN_Q, offsetof(berth_plan_t, mpc.q) + i * sizeof(float),
                             0.0f, 1.0e6f, false};
        const push_t push = {&plan.plan, check_plan, BERTH_ERROR_PLAN, i};
        push_all(&push, &rule, 1);
    }
    for (uint32_t i = 0; i < 2; i++) {
        const rule_t rule = {BERTH_FIELD_PLAN_R, offsetof(berth_plan_t, mpc.r) + i * sizeof(float),
                             1.0e-6f, 1.0e6f, false};
        const push_t push = {&plan.plan, check_plan, BERTH_ERROR_PLAN, i};
        push_all(&push, &rule, 1);
    }
}

/* The push changes samples and gains behind the plan's back; the check looks at the plan. */
static berth_error_t check_table_plan(const void *subject, berth_refusal_t *refusal) {
    (void)subject;
    return berth_plan_check(&table.plan, refusal);
}

static void test_plan_samples_and_gains(void) {
    static const rule_t rules[] = {
        {BERTH_FIELD_SAMPLE_X, offsetof(berth_sample_t, x_m), -1000.0f, 1000.0f, false},
        {BERTH_FIELD_SAMPLE_Y, offsetof(berth_sample_t, y_m), -1000.0f, 1000.0f, false},
        {BERTH_FIELD_SAMPLE_THETA, offsetof(berth_sample_t, theta_rad), -BERTH_PI, BERTH_PI, false},
        {BERTH_FIELD_SAMPLE_V, offsetof(berth_sample_t, v_mps), -100.0f, 100.0f, false},
        {BERTH_FIELD_SAMPLE_OMEGA, offsetof(berth_sample_t, omega_radps), -100.0f, 100.0f, false},
    };
    const uint32_t rows[] = {0, 13, 29};
    for (size_t i = 0; i < COUNT(rows); i++) {
        const uint32_t k = rows[i];
        const push_t push = {&table.samples[k], check_table_plan, BERTH_ERROR_PLAN, k};
        push_all(&push, rules, COUNT(rules));
        for (uint32_t j = 0; j < 6; j++) {
            const rule_t rule = {BERTH_FIELD_GAIN, j * sizeof(float), -1.0e6f, 1.0e6f, false};
            const push_t gain_push = {&table.gains[k], check_table_plan, BERTH_ERROR_PLAN, k};
            push_all(&gain_push, &rule, 1);
        }
    }
}

static void refuses_header(berth_field_t field, float value, float minimum, float maximum) {
    berth_refusal_t refusal = unfilled();
    TEST_ASSERT_EQUAL_MESSAGE(BERTH_ERROR_PLAN, berth_plan_check(&plan.plan, &refusal),
                              berth_field_text(field));
    check_refusal(&refusal, field, 0, value, minimum, maximum);
    setUp();
}

static void accepts_header(void) {
    berth_refusal_t refusal = unfilled();
    TEST_ASSERT_EQUAL(BERTH_OK, berth_plan_check(&plan.plan, &refusal));
    setUp();
}

static void test_plan_count(void) {
    const uint32_t bad[] = {0, 1000001, UINT32_MAX};
    for (size_t i = 0; i < COUNT(bad); i++) {
        plan.plan.count = bad[i];
        refuses_header(BERTH_FIELD_PLAN_COUNT, (float)bad[i], 1.0f, 1.0e6f);
    }
    plan.plan.count = 1;
    accepts_header();
    berth_sample_t *many = calloc(1000000, sizeof *many);
    if (many == NULL) {
        TEST_IGNORE_MESSAGE("no room for the longest plan (20 MB) on this board");
    }
    plan.plan.samples = many;
    plan.plan.count = 1000000;
    accepts_header();
    free(many);
}

static void test_plan_period(void) {
    const uint32_t bad[] = {0, 999, 1000001, UINT32_MAX};
    for (size_t i = 0; i < COUNT(bad); i++) {
        plan.plan.period_us = bad[i];
        refuses_header(BERTH_FIELD_PLAN_PERIOD, (float)bad[i], 1000.0f, 1.0e6f);
    }
    plan.plan.period_us = 1000;
    accepts_header();
    plan.plan.period_us = 1000000;
    accepts_header();
}

static void test_plan_horizon(void) {
    const uint16_t bad[] = {0, 201, UINT16_MAX};
    for (size_t i = 0; i < COUNT(bad); i++) {
        plan.plan.mpc.horizon = bad[i];
        refuses_header(BERTH_FIELD_PLAN_HORIZON, (float)bad[i], 1.0f, 200.0f);
    }
    plan.plan.mpc.horizon = 1;
    accepts_header();
    plan.plan.mpc.horizon = 200;
    accepts_header();
}

static void test_plan_discretization(void) {
    const uint8_t bad[] = {2, 255};
    for (size_t i = 0; i < COUNT(bad); i++) {
        plan.plan.mpc.discretization = bad[i];
        refuses_header(BERTH_FIELD_PLAN_DISCRETIZATION, (float)bad[i], 0.0f, 1.0f);
    }
    plan.plan.mpc.discretization = BERTH_DISCRETIZATION_ZOH;
    accepts_header();
}

static void test_plan_gain_source(void) {
    const uint8_t bad[] = {2, 255};
    for (size_t i = 0; i < COUNT(bad); i++) {
        plan.plan.gain_source = bad[i];
        refuses_header(BERTH_FIELD_PLAN_GAIN_SOURCE, (float)bad[i], 0.0f, 1.0f);
    }
    berth_refusal_t refusal;
    TEST_ASSERT_EQUAL(BERTH_OK, berth_plan_check(&table.plan, &refusal));
}

static void test_plan_without_its_arrays(void) {
    berth_refusal_t refusal;
    berth_plan_t bad = table.plan;
    bad.gains = NULL;
    TEST_ASSERT_EQUAL(BERTH_ERROR_ARGUMENT, berth_plan_check(&bad, &refusal));
    bad = table.plan;
    bad.samples = NULL;
    TEST_ASSERT_EQUAL(BERTH_ERROR_ARGUMENT, berth_plan_check(&bad, &refusal));
    bad = plan.plan;
    bad.gains = table.gains;
    TEST_ASSERT_EQUAL(BERTH_ERROR_ARGUMENT, berth_plan_check(&bad, &refusal));
}

/* ---- The controller ---- */

static const berth_pose_t origin = {0.0f, 0.0f, 0.5f};

/* A controller that was refused stands, whatever is asked of it, however it was before. */
static void check_unusable(berth_controller_t *controller) {
    const berth_obstacle_t obstacle = {5.0f, 5.0f, 0.1f, 0.2f, 0.4f};
    berth_refusal_t refusal;
    TEST_ASSERT_EQUAL(BERTH_ERROR_STATE, berth_controller_start(controller, 0));
    TEST_ASSERT_EQUAL(BERTH_ERROR_STATE,
                      berth_controller_add_obstacle(controller, &obstacle, &refusal));
    for (int i = 0; i < 3; i++) {
        const berth_command_t zero = {{0.0f, 0.0f}, {0.0f, 0.0f}};
        berth_command_t command = {{1.0f, 1.0f}, {1.0f, 1.0f}};
        TEST_ASSERT_EQUAL(BERTH_ERROR_STATE,
                          berth_controller_step(controller, 50000 * i, &origin, &command));
        TEST_ASSERT_EQUAL_MEMORY(&zero, &command, sizeof command);
        TEST_ASSERT_EQUAL(BERTH_ERROR_STATE, berth_controller_status(controller)->error);
    }
}

static void start_well(berth_controller_t *controller) {
    const berth_config_t config = berth_config_default(0.05f, 0.30f);
    berth_refusal_t refusal;
    berth_command_t command;
    memset(controller, 0xff, sizeof *controller); /* init must not read what was there */
    TEST_ASSERT_EQUAL(BERTH_OK, berth_controller_init(controller, &plan.plan, &config, &refusal));
    TEST_ASSERT_EQUAL(BERTH_OK, berth_controller_start(controller, 0));
    TEST_ASSERT_EQUAL(BERTH_OK, berth_controller_step(controller, 0, &origin, &command));
    TEST_ASSERT_TRUE(command.twist.v_mps != 0.0f);
}

static void test_controller_refused_is_unusable(void) {
    berth_controller_t controller;
    berth_refusal_t refusal = unfilled();
    berth_config_t config = berth_config_default(0.05f, 0.30f);
    config.limits.v_max_mps = -1.0f;
    start_well(&controller);
    TEST_ASSERT_EQUAL(BERTH_ERROR_CONFIG,
                      berth_controller_init(&controller, &plan.plan, &config, &refusal));
    check_refusal(&refusal, BERTH_FIELD_V_MAX, 0, -1.0f, 0.001f, 100.0f);
    check_unusable(&controller);
    config = berth_config_default(0.05f, 0.30f);
    config.avoid.tau_s = NAN;
    start_well(&controller);
    TEST_ASSERT_EQUAL(BERTH_ERROR_CONFIG,
                      berth_controller_init(&controller, &plan.plan, &config, &refusal));
    TEST_ASSERT_EQUAL(BERTH_FIELD_TAU, refusal.field);
    check_unusable(&controller);
    config = berth_config_default(0.05f, 0.30f);
    start_well(&controller);
    plan.samples[29].y_m = INFINITY;
    TEST_ASSERT_EQUAL(BERTH_ERROR_PLAN,
                      berth_controller_init(&controller, &plan.plan, &config, &refusal));
    check_refusal(&refusal, BERTH_FIELD_SAMPLE_Y, 29, INFINITY, -1000.0f, 1000.0f);
    check_unusable(&controller);
}

static void test_controller_without_its_arguments(void) {
    const berth_config_t config = berth_config_default(0.05f, 0.30f);
    berth_controller_t controller;
    berth_refusal_t refusal;
    TEST_ASSERT_EQUAL(BERTH_ERROR_ARGUMENT,
                      berth_controller_init(NULL, &plan.plan, &config, &refusal));
    start_well(&controller);
    TEST_ASSERT_EQUAL(BERTH_ERROR_ARGUMENT,
                      berth_controller_init(&controller, NULL, &config, &refusal));
    check_unusable(&controller);
    start_well(&controller);
    TEST_ASSERT_EQUAL(BERTH_ERROR_ARGUMENT,
                      berth_controller_init(&controller, &plan.plan, NULL, &refusal));
    check_unusable(&controller);
    start_well(&controller);
    TEST_ASSERT_EQUAL(BERTH_ERROR_ARGUMENT,
                      berth_controller_init(&controller, &plan.plan, &config, NULL));
    check_unusable(&controller);
    TEST_ASSERT_EQUAL(BERTH_ERROR_ARGUMENT, berth_controller_start(NULL, 0));
}

/* A refused obstacle is not in the list, and the controller goes on without it. */
static void test_controller_without_the_refused_obstacle(void) {
    static const berth_obstacle_t good = {5.0f, 5.0f, 0.1f, 0.2f, 0.4f};
    static const struct {
        berth_obstacle_t obstacle;
        berth_error_t error;
        berth_field_t field;
    } bad[] = {
        {{NAN, 5.0f, 0.1f, 0.2f, 0.4f}, BERTH_ERROR_CONFIG, BERTH_FIELD_OBSTACLE_X},
        {{5.0f, 5.0f, 0.1f, 0.05f, 0.4f}, BERTH_ERROR_CONFIG, BERTH_FIELD_OBSTACLE_CONSERVATIVE},
        {{5.0f, 5.0f, 0.1f, 0.1f, 0.4f}, BERTH_ERROR_CLEARANCE, BERTH_FIELD_CLEARANCE},
        {{5.0f, 5.0f, 0.1f, 0.13f, 0.4f}, BERTH_ERROR_CLEARANCE, BERTH_FIELD_CLEARANCE},
        {{5.0f, 5.0f, 0.1f, 0.2f, 0.21f}, BERTH_ERROR_CONFIG, BERTH_FIELD_OBSTACLE_REGULATED},
        {{0.0f, 0.0f, 0.0f, 0.0f, 0.0f}, BERTH_ERROR_CONFIG, BERTH_FIELD_OBSTACLE_HARD},
    };
    berth_controller_t controller;
    start_well(&controller);
    for (size_t i = 0; i < COUNT(bad); i++) {
        berth_refusal_t refusal = unfilled();
        TEST_ASSERT_EQUAL(bad[i].error,
                          berth_controller_add_obstacle(&controller, &bad[i].obstacle, &refusal));
        TEST_ASSERT_EQUAL(bad[i].field, refusal.field);
        TEST_ASSERT_EQUAL_UINT32(i, refusal.index); /* the number that it would have had */
        TEST_ASSERT_EQUAL_UINT32(i, controller.obstacles.count);
        TEST_ASSERT_EQUAL(BERTH_OK, berth_controller_add_obstacle(&controller, &good, &refusal));
    }
    berth_command_t command;
    TEST_ASSERT_EQUAL(BERTH_OK, berth_controller_step(&controller, 50000, &origin, &command));
}

static void test_controller_capacity(void) {
    const berth_obstacle_t obstacle = {5.0f, 5.0f, 0.1f, 0.2f, 0.4f};
    berth_controller_t controller;
    berth_refusal_t refusal;
    start_well(&controller);
    for (uint32_t i = 0; i < BERTH_OBSTACLES_MAX; i++) {
        TEST_ASSERT_EQUAL(BERTH_OK,
                          berth_controller_add_obstacle(&controller, &obstacle, &refusal));
    }
    const berth_controller_t before = controller;
    TEST_ASSERT_EQUAL(BERTH_ERROR_CAPACITY,
                      berth_controller_add_obstacle(&controller, &obstacle, &refusal));
    TEST_ASSERT_EQUAL_MEMORY(&before.obstacles, &controller.obstacles, sizeof before.obstacles);
}

/* Forgetting to fill a struct in is an error, not a robot with odd limits. */
static void test_zero_initialised_is_refused(void) {
    const berth_limits_config_t no_limits = {0};
    const berth_avoid_config_t no_avoid = {0};
    const berth_obstacle_t no_obstacle = {0};
    const berth_plan_t no_plan = {0};
    const berth_config_t no_config = {0};
    const berth_limits_config_t limits = berth_config_default(0.05f, 0.30f).limits;
    berth_avoid_t avoid;
    berth_controller_t controller = {0};
    berth_refusal_t refusal = unfilled();
    check_unusable(&controller);
    TEST_ASSERT_EQUAL(BERTH_ERROR_CONFIG, berth_limits_check(&no_limits, &refusal));
    TEST_ASSERT_EQUAL(BERTH_FIELD_WHEEL_RADIUS, refusal.field);
    TEST_ASSERT_EQUAL(BERTH_ERROR_CONFIG,
                      berth_avoid_init(&avoid, &no_avoid, &limits, PERIOD_US, &refusal));
    TEST_ASSERT_EQUAL(BERTH_FIELD_V_CREEP, refusal.field);
    TEST_ASSERT_EQUAL(BERTH_ERROR_CONFIG, berth_obstacle_check(&no_obstacle, &refusal));
    TEST_ASSERT_EQUAL(BERTH_FIELD_OBSTACLE_HARD, refusal.field);
    TEST_ASSERT_EQUAL(BERTH_ERROR_ARGUMENT, berth_plan_check(&no_plan, &refusal));
    berth_plan_t only_samples = {.samples = plan.samples, .gains = table.gains};
    TEST_ASSERT_EQUAL(BERTH_ERROR_PLAN, berth_plan_check(&only_samples, &refusal));
    TEST_ASSERT_EQUAL(BERTH_FIELD_PLAN_COUNT, refusal.field);
    TEST_ASSERT_EQUAL(BERTH_ERROR_CONFIG,
                      berth_controller_init(&controller, &plan.plan, &no_config, &refusal));
    TEST_ASSERT_EQUAL(BERTH_FIELD_WHEEL_RADIUS, refusal.field);
}

/* The documented defaults are a valid configuration for ordinary wheels. */
static void test_defaults_are_accepted(void) {
    const float radii[] = {0.01f, 0.05f, 0.3f};
    for (size_t i = 0; i < COUNT(radii); i++) {
        const berth_config_t config = berth_config_default(radii[i], 6.0f * radii[i]);
        berth_controller_t controller;
        berth_refusal_t refusal;
        TEST_ASSERT_EQUAL(BERTH_OK,
                          berth_controller_init(&controller, &plan.plan, &config, &refusal));
    }
}

/* ---- Texts ---- */

static void test_error_texts(void) {
    for (int i = BERTH_ERROR_STATE; i <= BERTH_OK; i++) {
        const char *text = berth_error_text((berth_error_t)i);
        TEST_ASSERT_TRUE(strlen(text) > 0);
        for (int j = BERTH_ERROR_STATE; j < i; j++) {
            TEST_ASSERT_NOT_EQUAL(0, strcmp(text, berth_error_text((berth_error_t)j)));
        }
    }
    TEST_ASSERT_EQUAL_STRING("ok", berth_error_text(BERTH_OK));
    TEST_ASSERT_NOT_NULL(strstr(berth_error_text(BERTH_ERROR_POSE), "pose"));
    TEST_ASSERT_NOT_NULL(strstr(berth_error_text(BERTH_ERROR_CLEARANCE), "clearance"));
    const int outside[] = {1, 2, BERTH_ERROR_STATE - 1, -128, -1000, INT_MAX, INT_MIN, INT_MIN + 1};
    for (size_t i = 0; i < COUNT(outside); i++) {
        /* An enum may be one byte wide: what it cannot hold does not arrive. */
        if ((int)(berth_error_t)outside[i] != outside[i]) {
            continue;
        }
        TEST_ASSERT_EQUAL_STRING("unknown error", berth_error_text((berth_error_t)outside[i]));
    }
}

static void test_field_texts(void) {
    for (unsigned i = 0; i < BERTH_FIELD_COUNT; i++) {
        const char *text = berth_field_text((berth_field_t)i);
        TEST_ASSERT_TRUE(strlen(text) > 0);
        for (unsigned j = 0; j < i; j++) {
            TEST_ASSERT_NOT_EQUAL(0, strcmp(text, berth_field_text((berth_field_t)j)));
        }
    }
    TEST_ASSERT_NOT_NULL(strstr(berth_field_text(BERTH_FIELD_TRACK), "track"));
    TEST_ASSERT_NOT_NULL(strstr(berth_field_text(BERTH_FIELD_SIGMA_POSE), "sigma"));
    TEST_ASSERT_NOT_NULL(strstr(berth_field_text(BERTH_FIELD_CLEARANCE), "C - R"));
    const unsigned outside[] = {BERTH_FIELD_COUNT, BERTH_FIELD_COUNT + 1, 255, INT_MAX, UINT_MAX};
    for (size_t i = 0; i < COUNT(outside); i++) {
        TEST_ASSERT_EQUAL_STRING("unknown field", berth_field_text((berth_field_t)outside[i]));
    }
}

static void test_mode_texts(void) {
    TEST_ASSERT_EQUAL_STRING("track", berth_mode_text(BERTH_MODE_TRACK));
    TEST_ASSERT_EQUAL_STRING("regulated", berth_mode_text(BERTH_MODE_REGULATED));
    TEST_ASSERT_EQUAL_STRING("conservative_turn", berth_mode_text(BERTH_MODE_CONSERVATIVE_TURN));
    TEST_ASSERT_EQUAL_STRING("conservative_go", berth_mode_text(BERTH_MODE_CONSERVATIVE_GO));
    TEST_ASSERT_EQUAL_STRING("blocked", berth_mode_text(BERTH_MODE_BLOCKED));
    const unsigned outside[] = {5, 6, 255, INT_MAX, UINT_MAX};
    for (size_t i = 0; i < COUNT(outside); i++) {
        TEST_ASSERT_EQUAL_STRING("?", berth_mode_text((berth_mode_t)outside[i]));
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_limits);
    RUN_TEST(test_limits_through_avoidance);
    RUN_TEST(test_avoid);
    RUN_TEST(test_a_brake_within_a_max);
    RUN_TEST(test_avoid_period);
    RUN_TEST(test_turn_per_period);
    RUN_TEST(test_obstacle);
    RUN_TEST(test_clearance_bound_exactly);
    RUN_TEST(test_clearance_bound_of_rounded_radii);
    RUN_TEST(test_clearance_condition_with_delay);
    RUN_TEST(test_plan_weights);
    RUN_TEST(test_plan_samples_and_gains);
    RUN_TEST(test_plan_count);
    RUN_TEST(test_plan_period);
    RUN_TEST(test_plan_horizon);
    RUN_TEST(test_plan_discretization);
    RUN_TEST(test_plan_gain_source);
    RUN_TEST(test_plan_without_its_arrays);
    RUN_TEST(test_controller_refused_is_unusable);
    RUN_TEST(test_controller_without_its_arguments);
    RUN_TEST(test_controller_without_the_refused_obstacle);
    RUN_TEST(test_controller_capacity);
    RUN_TEST(test_zero_initialised_is_refused);
    RUN_TEST(test_defaults_are_accepted);
    RUN_TEST(test_error_texts);
    RUN_TEST(test_field_texts);
    RUN_TEST(test_mode_texts);
    return UNITY_END();
}
