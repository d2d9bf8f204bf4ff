/* The constrained tracker: what it shares with the gain, warm and cold starts, its box, its bounds,
 * and what it is worth in closed loop. Its optimum itself is held against another solver in
 * tracker/test_constrained.py. */
#include "support.h"

#include "unity.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#define PERIOD_US 50000
#define RIM_MPS 0.8

static support_plan_t shape;
static berth_constrained_t workspace;
static berth_constrained_t fresh;
static berth_controller_t controller;
static berth_controller_t with_gain;
static berth_config_t config;
static berth_refusal_t refusal;

void setUp(void) {
    config = berth_config_default(0.05f, 0.30f);
    config.limits.wheel_speed_max_radps = 16.0f;
    config.limits.v_max_mps = 2.0f;
    config.limits.omega_max_radps = 10.0f;
    support_plan(&shape, SUPPORT_EIGHT, 600, false);
    memset(&workspace, 0xA5, sizeof workspace);
    memset(&fresh, 0x5A, sizeof fresh);
}

void tearDown(void) {}

static void init(berth_constrained_t *w, float change) {
    TEST_ASSERT_EQUAL_INT(BERTH_OK,
                          berth_constrained_init(w, &shape.plan, &config.limits, change, &refusal));
}

static berth_twist_t step_from(berth_constrained_t *w, uint32_t index, uint32_t total,
                               berth_tracking_error_t error, berth_twist_t last) {
    const berth_reference_t reference = {.index = index, .total = total};
    const berth_sample_t sample = berth_plan_sample(&shape.plan, index);
    const berth_tracker_input_t input = {.plan = &shape.plan,
                                         .reference = &reference,
                                         .sample = &sample,
                                         .error = &error,
                                         .last = last};
    return berth_constrained_step(w, &input);
}

static berth_twist_t step_at(berth_constrained_t *w, uint32_t index, berth_tracking_error_t error) {
    return step_from(w, index, index, error, (berth_twist_t){0.0f, 0.0f});
}

static berth_tracking_error_t draw_error(double scale) {
    return (berth_tracking_error_t){(float)support_uniform(-scale, scale),
                                    (float)support_uniform(-scale, scale),
                                    (float)support_uniform(-scale, scale)};
}

static double faster_rim(berth_twist_t twist) {
    return fabs((double)twist.v_mps) + 0.15 * fabs((double)twist.omega_radps);
}

static void expect_same_twist(berth_twist_t a, berth_twist_t b) {
    TEST_ASSERT_TRUE(support_same_bits(a.v_mps, b.v_mps));
    TEST_ASSERT_TRUE(support_same_bits(a.omega_radps, b.omega_radps));
}

/* ---- Without a limit ---- */

static void test_without_a_limit_the_command_is_the_gains_to_the_bit(void) {
    support_random_start();
    uint32_t unlimited = 0;
    for (uint32_t i = 0; i < support_runs(2000); i++) {
        const uint32_t index = support_index(620);
        const berth_tracking_error_t error = draw_error(support_log_uniform(1e-4, 0.5));
        const berth_sample_t sample = berth_plan_sample(&shape.plan, index);
        berth_gain_t gain;
        berth_riccati_gain(&shape.plan, index, &gain);
        init(&workspace, 0.0f);
        const berth_twist_t twist = step_at(&workspace, index, error);
        if (!workspace.limited) {
            unlimited++;
            expect_same_twist(berth_tracker_law(&sample, &gain, &error), twist);
            TEST_ASSERT_EQUAL_UINT8(1, workspace.passes);
        }
        TEST_ASSERT_FALSE(workspace.stopped);
    }
    TEST_ASSERT_GREATER_THAN_UINT32(support_runs(2000) / 3, unlimited);
    TEST_ASSERT_LESS_THAN_UINT32(support_runs(2000), unlimited);
}

/* The pose along which both controllers are stepped is the first one's. */
static void expect_same_runs(uint32_t steps) {
    berth_config_t constrained = config;
    constrained.tracker = berth_constrained_tracker(&workspace);
    TEST_ASSERT_EQUAL_INT(BERTH_OK,
                          berth_controller_init(&with_gain, &shape.plan, &config, &refusal));
    TEST_ASSERT_EQUAL_INT(BERTH_OK,
                          berth_controller_init(&controller, &shape.plan, &constrained, &refusal));
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_controller_start(&with_gain, 0));
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_controller_start(&controller, 0));
    const berth_sample_t *first = &shape.samples[0];
    support_pose_t pose = {(double)first->x_m - 0.01, (double)first->y_m + 0.01,
                           (double)first->theta_rad + 0.02};
    for (uint32_t k = 0; k < steps; k++) {
        const berth_pose_t measured = support_measure(pose);
        berth_command_t a;
        berth_command_t b;
        TEST_ASSERT_EQUAL_INT(BERTH_OK,
                              berth_controller_step(&with_gain, k * PERIOD_US, &measured, &a));
        TEST_ASSERT_EQUAL_INT(BERTH_OK,
                              berth_controller_step(&controller, k * PERIOD_US, &measured, &b));
        TEST_ASSERT_EQUAL_MEMORY(&a, &b, sizeof a);
        TEST_ASSERT_EQUAL_UINT8(1, berth_controller_status(&controller)->passes);
        TEST_ASSERT_EQUAL_UINT8(0, berth_controller_status(&with_gain)->passes);
        pose = support_move(pose, (double)a.twist.v_mps, (double)a.twist.omega_radps, 0.05);
    }
}

static void test_whole_runs_without_limits_are_the_same(void) {
    static const support_shape_t shapes[] = {SUPPORT_CIRCLE, SUPPORT_EIGHT};
    for (int i = 0; i < 2; i++) {
        for (int closed = 0; closed < 2; closed++) {
            support_plan(&shape, shapes[i], 900, closed != 0);
            if (closed) { /* laps that the wheels can follow easily */
                expect_same_runs(2000);
            } else {
                expect_same_runs(899); /* the end itself is a jump of speed */
            }
            support_fill_gains(&shape);
            expect_same_runs(899);
        }
    }
}

/* ---- Warm and cold ---- */

/* A lap with jumps of the pose. Returns the passes that it took. */
static uint32_t lap(bool warm, uint32_t *limited, berth_twist_t *commands, uint32_t steps) {
    uint32_t passes = 0;
    *limited = 0;
    init(&workspace, 0.0f);
    support_random_start();
    support_pose_t pose = {(double)shape.samples[0].x_m, (double)shape.samples[0].y_m,
                           (double)shape.samples[0].theta_rad};
    for (uint32_t k = 0; k < steps; k++) {
        if (k % 30 == 29) {
            pose.x_m += support_uniform(-0.3, 0.3);
            pose.y_m += support_uniform(-0.3, 0.3);
            pose.theta_rad += support_uniform(-0.7, 0.7);
        }
        const uint32_t index = k % shape.plan.count;
        const berth_pose_t measured = support_measure(pose);
        const berth_sample_t sample = berth_plan_sample(&shape.plan, index);
        berth_tracking_error_t error;
        berth_tracking_error(&measured, &sample, &error);
        if (!warm) {
            berth_constrained_reset(&workspace);
        }
        commands[k] = step_from(&workspace, index, k, error, (berth_twist_t){0.0f, 0.0f});
        TEST_ASSERT_FALSE(workspace.stopped);
        TEST_ASSERT_TRUE(faster_rim(commands[k]) <= RIM_MPS || !workspace.limited);
        passes += workspace.passes;
        *limited += workspace.limited;
        pose = support_move(pose, (double)commands[k].v_mps, (double)commands[k].omega_radps, 0.05);
    }
    return passes;
}

static void test_a_warm_start_changes_the_passes_alone(void) {
    static berth_twist_t warm[900];
    static berth_twist_t cold[900];
    uint32_t limited;
    support_plan(&shape, SUPPORT_EIGHT, 420, true); /* twice the usual pace: beyond the wheels */
    const uint32_t warm_passes = lap(true, &limited, warm, 900);
    TEST_ASSERT_GREATER_THAN_UINT32(200, limited);
    const uint32_t cold_passes = lap(false, &limited, cold, 900);
    for (uint32_t k = 0; k < 900; k++) {
        TEST_ASSERT_FLOAT_WITHIN(1e-4f, cold[k].v_mps, warm[k].v_mps);
        TEST_ASSERT_FLOAT_WITHIN(1e-3f, cold[k].omega_radps, warm[k].omega_radps);
    }
    printf("900 steps, %u limited: %u passes warm, %u cold\n", (unsigned)limited,
           (unsigned)warm_passes, (unsigned)cold_passes);
    TEST_ASSERT_LESS_THAN_UINT32(cold_passes, warm_passes);
}

/* After one limited step, each of these begins as cold as a workspace that has never been used. */
static void expect_cold(uint32_t index, uint32_t total, berth_tracking_error_t error, bool reset) {
    const berth_tracking_error_t large = {0.4f, 0.3f, 0.5f};
    init(&workspace, 0.0f);
    (void)step_at(&workspace, 100, large);
    TEST_ASSERT_TRUE(workspace.limited);
    if (reset) {
        berth_constrained_reset(&workspace);
    }
    init(&fresh, 0.0f);
    const berth_twist_t expected =
        step_from(&fresh, index, total, error, (berth_twist_t){0.0f, 0.0f});
    const berth_twist_t twist =
        step_from(&workspace, index, total, error, (berth_twist_t){0.0f, 0.0f});
    TEST_ASSERT_TRUE(fresh.limited);
    expect_same_twist(expected, twist);
    TEST_ASSERT_EQUAL_UINT8(fresh.passes, workspace.passes);
    TEST_ASSERT_EQUAL_MEMORY(fresh.stages[0].u, workspace.stages[0].u, sizeof fresh.stages[0].u);
}

static void test_jumps_begin_cold(void) {
    init(&workspace, 0.0f);
    const berth_tracking_error_t large = {0.4f, 0.3f, 0.5f};
    (void)step_at(&workspace, 100, large);
    const berth_tracking_error_t next = {workspace.expected[0], workspace.expected[1],
                                         workspace.expected[2]};
    berth_tracking_error_t jumped = next;
    expect_cold(101, 101, next, true);  /* told so */
    expect_cold(0, 0, next, false);     /* a restart */
    expect_cold(103, 103, next, false); /* samples skipped */
    jumped.e2_m += 0.11f;
    expect_cold(101, 101, jumped, false); /* another pose */
    jumped = next;
    jumped.e3_rad -= 0.11f;
    expect_cold(101, 101, jumped, false);
    jumped = next;
    jumped.e1_m -= 0.11f;
    expect_cold(101, 101, jumped, false);
}

static void test_the_next_period_begins_warm(void) {
    uint32_t fewer = 0;
    support_random_start();
    for (uint32_t i = 0; i < 200; i++) {
        const berth_tracking_error_t error = draw_error(0.6);
        init(&workspace, 0.0f);
        (void)step_at(&workspace, 100, error);
        const berth_tracking_error_t next = {workspace.expected[0], workspace.expected[1],
                                             workspace.expected[2]};
        if (workspace.limited) {
            init(&fresh, 0.0f);
            (void)step_at(&fresh, 101, next);
            (void)step_at(&workspace, 101, next);
            fewer += workspace.passes < fresh.passes;
            TEST_ASSERT_LESS_OR_EQUAL_UINT8(fresh.passes + 1, workspace.passes);
        }
    }
    TEST_ASSERT_GREATER_THAN_UINT32(50, fewer);
}

/* ---- The box ---- */

static void expect_iterates_in_box(berth_tracking_error_t error, uint32_t index) {
    for (uint8_t passes = 1; passes <= BERTH_CONSTRAINED_PASSES_MAX; passes++) {
        init(&fresh, 0.0f);
        fresh.passes_max = passes;
        (void)step_at(&fresh, index, error);
        if (!fresh.limited) {
            return;
        }
        for (uint32_t i = 0; i < fresh.horizon; i++) {
            const berth_sample_t s = berth_plan_sample(&shape.plan, index + i);
            const double face = i == 0 ? cos((double)error.e3_rad) : 1.0;
            const double f = (double)fresh.frequency_hz;
            const double v = (double)s.v_mps * face - (double)fresh.stages[i].u[0] * f;
            const double omega = (double)s.omega_radps - (double)fresh.stages[i].u[1] * f;
            TEST_ASSERT_TRUE(fabs(v) + 0.15 * fabs(omega) <= RIM_MPS);
        }
    }
}

static void test_every_iterate_of_every_stage_is_in_the_box(void) {
    support_random_start();
    support_plan(&shape, SUPPORT_EIGHT, 420, true);
    for (uint32_t i = 0; i < support_runs(1000); i++) {
        expect_iterates_in_box(draw_error(support_log_uniform(0.01, 2.0)), support_index(420));
    }
}

static void test_the_first_stage_stays_near_the_last_command(void) {
    support_random_start();
    uint32_t held = 0;
    for (uint32_t i = 0; i < support_runs(1000); i++) {
        const float change = (float)support_log_uniform(0.1, 20.0);
        const double right = support_uniform(-0.8, 0.8);
        const double left = support_uniform(-0.8, 0.8);
        const berth_twist_t last = {(float)(0.5 * (right + left)), (float)((right - left) / 0.30)};
        init(&workspace, change);
        const berth_twist_t twist = step_from(&workspace, 50, 50, draw_error(0.5), last);
        const double most = 0.05 * (double)change + 1e-6;
        const double right_now = (double)twist.v_mps + 0.15 * (double)twist.omega_radps;
        const double left_now = (double)twist.v_mps - 0.15 * (double)twist.omega_radps;
        TEST_ASSERT_TRUE(fabs(right_now - right) <= most);
        TEST_ASSERT_TRUE(fabs(left_now - left) <= most);
        TEST_ASSERT_TRUE(faster_rim(twist) <= RIM_MPS + 1e-6);
        held += workspace.limited_now;
    }
    TEST_ASSERT_GREATER_THAN_UINT32(support_runs(1000) / 3, held);
}

static void test_without_wheel_limits_the_rims_have_what_v_max_and_omega_max_ask(void) {
    config.limits.wheel_speed_max_radps = 0.0f;
    config.limits.v_max_mps = 0.5f;
    config.limits.omega_max_radps = 2.0f;
    init(&workspace, 0.0f);
    const berth_twist_t twist = step_at(&workspace, 0, (berth_tracking_error_t){5.0f, 0.0f, 0.0f});
    TEST_ASSERT_FLOAT_WITHIN(1e-4f, 0.8f, (float)faster_rim(twist));
    config.limits.wheel_speed_max_radps = 1000.0f; /* more than those two can ask for */
    init(&fresh, 0.0f);
    expect_same_twist(twist, step_at(&fresh, 0, (berth_tracking_error_t){5.0f, 0.0f, 0.0f}));
}

/* ---- Whatever the numbers ---- */

static float draw_finite(void) {
    const double magnitude = support_log_uniform(1e-38, (double)FLT_MAX);
    const float value = (float)(support_uniform(0.0, 1.0) < 0.5 ? -magnitude : magnitude);
    return support_uniform(0.0, 1.0) < 0.2 ? 0.0f : value;
}

static float draw_extreme(double low, double high) {
    const double chosen = support_uniform(0.0, 1.0);
    return (float)(chosen < 0.3 ? low : chosen < 0.6 ? high : support_uniform(low, high));
}

static void draw_extreme_plan(void) {
    shape.plan.period_us = support_index(2) ? BERTH_PERIOD_MIN_US : BERTH_PERIOD_MAX_US;
    shape.plan.count = 1 + support_index(60);
    shape.plan.closed = support_index(2) != 0;
    shape.plan.mpc.horizon = (uint16_t)(1 + support_index(BERTH_CONSTRAINED_HORIZON_MAX));
    for (int i = 0; i < 3; i++) {
        shape.plan.mpc.q[i] = draw_extreme(0.0, (double)BERTH_WEIGHT_MAX);
    }
    for (int i = 0; i < 2; i++) {
        shape.plan.mpc.r[i] = draw_extreme((double)BERTH_WEIGHT_R_MIN, (double)BERTH_WEIGHT_MAX);
    }
    for (uint32_t k = 0; k < shape.plan.count; k++) {
        shape.samples[k].v_mps = draw_extreme(-100.0, 100.0);
        shape.samples[k].omega_radps = draw_extreme(-100.0, 100.0);
    }
    config.limits.track_m = draw_extreme(0.01, 10.0);
    config.limits.wheel_radius_m = draw_extreme(0.001, 10.0);
    config.limits.v_max_mps = draw_extreme(0.001, 100.0);
    config.limits.omega_max_radps = draw_extreme(0.001, 100.0);
    config.limits.wheel_speed_max_radps = draw_extreme(0.001, 10000.0);
}

static void expect_sane(const berth_constrained_t *w, berth_twist_t twist) {
    const double rim = (double)w->rim_m * (double)w->frequency_hz;
    const double half = (double)w->half_track_m;
    TEST_ASSERT_TRUE(isfinite(twist.v_mps) && isfinite(twist.omega_radps));
    TEST_ASSERT_TRUE(w->passes >= 1 && w->passes <= BERTH_CONSTRAINED_PASSES_MAX);
    if (w->limited) {
        const double now = fabs((double)twist.v_mps) + half * fabs((double)twist.omega_radps);
        /* speeds of the reference far beyond the rims' leave their rounding in the difference */
        TEST_ASSERT_TRUE(now <= rim * (1.0 + 1e-5) + 1e-4 * (100.0 + 100.0 * half) * 0.1);
    }
}

static void test_every_finite_input_gives_a_finite_command(void) {
    support_random_start();
    uint32_t stopped = 0;
    for (uint32_t i = 0; i < support_runs(20000); i++) {
        draw_extreme_plan();
        TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_plan_check(&shape.plan, &refusal));
        TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_limits_check(&config.limits, &refusal));
        init(&workspace, support_index(2) ? 0.0f : draw_extreme(0.001, 10000.0));
        for (uint32_t k = 0; k < 3; k++) {
            const bool wild = support_index(2) != 0;
            const berth_tracking_error_t error =
                wild ? (berth_tracking_error_t){draw_finite(), draw_finite(), draw_finite()}
                     : draw_error(100.0);
            const berth_twist_t last = {draw_extreme(-100.0, 100.0), draw_extreme(-100.0, 100.0)};
            const berth_twist_t twist =
                step_from(&workspace, k % (shape.plan.count + 1), k, error, last);
            expect_sane(&workspace, twist);
            stopped += workspace.stopped;
        }
    }
    printf("%u of %u steps stopped before the optimum\n", (unsigned)stopped,
           (unsigned)(3 * support_runs(20000)));
}

static void test_the_last_pass_is_reported(void) {
    support_plan(&shape, SUPPORT_EIGHT, 420, true);
    support_random_start();
    uint32_t stopped = 0;
    for (uint32_t i = 0; i < 200; i++) {
        const berth_tracking_error_t error = draw_error(1.0);
        init(&workspace, 0.0f);
        workspace.passes_max = 1;
        (void)step_at(&workspace, 10, error);
        TEST_ASSERT_EQUAL_UINT8(1, workspace.passes);
        init(&fresh, 0.0f);
        (void)step_at(&fresh, 10, error);
        TEST_ASSERT_FALSE(fresh.stopped);
        TEST_ASSERT_EQUAL_INT(fresh.passes > 1, workspace.stopped);
        stopped += workspace.stopped;
    }
    TEST_ASSERT_GREATER_THAN_UINT32(50, stopped);
}

/* ---- Refusals ---- */

static void expect_refused(berth_error_t error, berth_field_t field) {
    TEST_ASSERT_EQUAL_INT(error,
                          berth_controller_init(&controller, &shape.plan, &config, &refusal));
    TEST_ASSERT_EQUAL_INT(field, refusal.field);
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_STATE, berth_controller_start(&controller, 0));
}

static void test_what_is_refused(void) {
    config.tracker = berth_constrained_tracker(&workspace);
    TEST_ASSERT_EQUAL_INT(BERTH_OK,
                          berth_controller_init(&controller, &shape.plan, &config, &refusal));
    shape.plan.mpc.horizon = BERTH_CONSTRAINED_HORIZON_MAX;
    TEST_ASSERT_EQUAL_INT(BERTH_OK,
                          berth_controller_init(&controller, &shape.plan, &config, &refusal));
    shape.plan.mpc.horizon = BERTH_CONSTRAINED_HORIZON_MAX + 1;
    expect_refused(BERTH_ERROR_PLAN, BERTH_FIELD_PLAN_HORIZON);
    TEST_ASSERT_EQUAL_FLOAT((float)BERTH_CONSTRAINED_HORIZON_MAX, refusal.maximum);
    shape.plan.mpc.horizon = 20;
    shape.plan.mpc.discretization = BERTH_DISCRETIZATION_ZOH;
    expect_refused(BERTH_ERROR_PLAN, BERTH_FIELD_PLAN_DISCRETIZATION);
    shape.plan.mpc.discretization = BERTH_DISCRETIZATION_EULER;

    static const float bad[] = {-1.0f, 0.0009f, 10001.0f, NAN, INFINITY, -INFINITY};
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        config.tracker.rim_change_max_mps2 = bad[i];
        expect_refused(BERTH_ERROR_CONFIG, BERTH_FIELD_RIM_CHANGE_MAX);
    }
    config.tracker.rim_change_max_mps2 = 10000.0f;
    TEST_ASSERT_EQUAL_INT(BERTH_OK,
                          berth_controller_init(&controller, &shape.plan, &config, &refusal));
    config.tracker.workspace = NULL;
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_ARGUMENT,
                          berth_controller_init(&controller, &shape.plan, &config, &refusal));
    config.tracker.api = NULL; /* a rim's change without what it belongs to */
    expect_refused(BERTH_ERROR_CONFIG, BERTH_FIELD_RIM_CHANGE_MAX);
}

/* ---- In the controller ---- */

/* Mean square of the position error over two laps that are too fast for the wheels. */
static double fast_laps(bool constrained, uint32_t *limited) {
    if (constrained) {
        config.tracker = berth_constrained_tracker(&workspace);
    } else {
        config.tracker = (berth_tracker_t){0};
    }
    TEST_ASSERT_EQUAL_INT(BERTH_OK,
                          berth_controller_init(&controller, &shape.plan, &config, &refusal));
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_controller_start(&controller, 0));
    const uint32_t steps = 2 * shape.plan.count;
    support_pose_t pose = {(double)shape.samples[0].x_m, (double)shape.samples[0].y_m,
                           (double)shape.samples[0].theta_rad};
    double sum = 0.0;
    *limited = 0;
    for (uint32_t k = 0; k < steps; k++) {
        const berth_pose_t measured = support_measure(pose);
        const berth_status_t *status = berth_controller_status(&controller);
        berth_command_t command;
        TEST_ASSERT_EQUAL_INT(
            BERTH_OK, berth_controller_step(&controller, k * PERIOD_US, &measured, &command));
        TEST_ASSERT_TRUE(faster_rim(command.twist) <= RIM_MPS + 1e-6);
        TEST_ASSERT_FALSE(status->suboptimal);
        *limited += (status->limited & BERTH_LIMITED_WHEEL) != 0;
        sum += (double)status->tracking_error.e1_m * (double)status->tracking_error.e1_m +
               (double)status->tracking_error.e2_m * (double)status->tracking_error.e2_m;
        pose = support_move(pose, (double)command.twist.v_mps, (double)command.twist.omega_radps,
                            0.05);
    }
    return sum / steps;
}

static void test_fast_laps_are_followed_better_than_by_clipping(void) {
    static const struct {
        support_shape_t shape;
        uint32_t lap;
        const char *name;
    } laps[] = {{SUPPORT_EIGHT, 420, "eight"},
                {SUPPORT_EIGHT, 380, "eight, faster"},
                {SUPPORT_CIRCLE, 170, "circle"}};
    for (size_t i = 0; i < sizeof laps / sizeof *laps; i++) {
        uint32_t limited;
        support_plan(&shape, laps[i].shape, laps[i].lap, true);
        const double clipped = sqrt(fast_laps(false, &limited));
        TEST_ASSERT_GREATER_THAN_UINT32(50, limited);
        const double constrained = sqrt(fast_laps(true, &limited));
        TEST_ASSERT_GREATER_THAN_UINT32(50, limited);
        printf("%s: RMS error %.4f m constrained, %.4f m clipped\n", laps[i].name, constrained,
               clipped);
        TEST_ASSERT_TRUE(constrained < clipped);
    }
}

/* Around the end of an open plan, late steps, a restart, and a stop after an error. */
static void test_a_controllers_life(void) {
    support_plan(&shape, SUPPORT_EIGHT, 60, false);
    config.tracker = berth_constrained_tracker(&workspace);
    TEST_ASSERT_EQUAL_INT(BERTH_OK,
                          berth_controller_init(&controller, &shape.plan, &config, &refusal));
    for (int round = 0; round < 2; round++) {
        TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_controller_start(&controller, 0));
        support_pose_t pose = {(double)shape.samples[0].x_m - 0.5, (double)shape.samples[0].y_m,
                               (double)shape.samples[0].theta_rad + 0.5};
        const int64_t skip = round == 0 ? 0 : 7;
        berth_command_t command;
        for (int64_t k = 0; k < 300; k++) {
            const int64_t late = k >= 20 ? skip : 0;
            const berth_pose_t measured = support_measure(pose);
            TEST_ASSERT_EQUAL_INT(
                BERTH_OK,
                berth_controller_step(&controller, (k + late) * PERIOD_US, &measured, &command));
            TEST_ASSERT_TRUE(faster_rim(command.twist) <= RIM_MPS + 1e-6);
            pose = support_move(pose, (double)command.twist.v_mps,
                                (double)command.twist.omega_radps, 0.05);
        }
        const berth_sample_t *last = &shape.samples[59];
        TEST_ASSERT_TRUE(berth_controller_status(&controller)->finished);
        TEST_ASSERT_DOUBLE_WITHIN(0.01, (double)last->x_m, pose.x_m);
        const berth_pose_t lost = {NAN, 0.0f, 0.0f};
        TEST_ASSERT_EQUAL_INT(BERTH_ERROR_POSE,
                              berth_controller_step(&controller, 400 * PERIOD_US, &lost, &command));
        TEST_ASSERT_TRUE(command.twist.v_mps == 0.0f && command.twist.omega_radps == 0.0f);
    }
}

static void test_a_workspace_is_as_large_as_it_says(void) {
    printf("workspace for %d stages: %zu bytes\n", BERTH_CONSTRAINED_HORIZON_MAX,
           sizeof(berth_constrained_t));
    TEST_ASSERT_EQUAL_size_t(108, sizeof(berth_constrained_stage_t));
    TEST_ASSERT_LESS_OR_EQUAL_size_t(108 * BERTH_CONSTRAINED_HORIZON_MAX + 128,
                                     sizeof(berth_constrained_t));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_without_a_limit_the_command_is_the_gains_to_the_bit);
    RUN_TEST(test_whole_runs_without_limits_are_the_same);
    RUN_TEST(test_a_warm_start_changes_the_passes_alone);
    RUN_TEST(test_jumps_begin_cold);
    RUN_TEST(test_the_next_period_begins_warm);
    RUN_TEST(test_every_iterate_of_every_stage_is_in_the_box);
    RUN_TEST(test_the_first_stage_stays_near_the_last_command);
    RUN_TEST(test_without_wheel_limits_the_rims_have_what_v_max_and_omega_max_ask);
    RUN_TEST(test_every_finite_input_gives_a_finite_command);
    RUN_TEST(test_the_last_pass_is_reported);
    RUN_TEST(test_what_is_refused);
    RUN_TEST(test_fast_laps_are_followed_better_than_by_clipping);
    RUN_TEST(test_a_controllers_life);
    RUN_TEST(test_a_workspace_is_as_large_as_it_says);
    return UNITY_END();
}
