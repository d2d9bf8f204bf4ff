/* The controller as its caller sees it: what stops the robot, what starts it again, time, the end
 * of a plan, and the same commands whatever way the gains come.
 */
#include "support.h"

#include "unity.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#define PERIOD_US INT64_C(50000)
#define PERIOD_S 0.05

static support_plan_t shape;
static berth_config_t config;
static berth_controller_t controller;
static berth_command_t command;

void setUp(void) {
    support_plan(&shape, SUPPORT_CIRCLE, 419, true);
    support_fill_gains(&shape);
    config = berth_config_default(0.05f, 0.3f);
    command = (berth_command_t){{NAN, NAN}, {NAN, NAN}};
}

void tearDown(void) {}

static void init(berth_controller_t *c) {
    berth_refusal_t refusal;
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_controller_init(c, &shape.plan, &config, &refusal));
}

static void start(berth_controller_t *c, int64_t now_us) {
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_controller_start(c, now_us));
}

static void add(berth_controller_t *c, float x_m, float y_m) {
    const berth_obstacle_t obstacle = {x_m, y_m, 0.1f, 0.15f, 0.4f};
    berth_refusal_t refusal;
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_controller_add_obstacle(c, &obstacle, &refusal));
}

static void init_and_start(void) {
    init(&controller);
    start(&controller, 0);
}

/* Off the circle's first sample (1, 0, pi/2), so that a working controller moves the robot. */
static berth_pose_t good_pose(void) {
    return (berth_pose_t){1.05f, 0.1f, 1.2f};
}

static bool zero(const berth_command_t *c) {
    return c->twist.v_mps == 0.0f && c->twist.omega_radps == 0.0f && c->wheels.left_radps == 0.0f &&
           c->wheels.right_radps == 0.0f;
}

static void expect_moves(int64_t now_us) {
    const berth_pose_t pose = good_pose();
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_controller_step(&controller, now_us, &pose, &command));
    TEST_ASSERT_TRUE(command.twist.v_mps != 0.0f && command.twist.omega_radps != 0.0f);
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_controller_status(&controller)->error);
}

/* The robot stands for that reason. */
static void expect_stands(berth_error_t reason, int64_t now_us, const berth_pose_t *pose) {
    memset(&command, 0x55, sizeof command);
    TEST_ASSERT_EQUAL_STRING(berth_error_text(reason), berth_error_text(berth_controller_step(
                                                           &controller, now_us, pose, &command)));
    TEST_ASSERT_TRUE(zero(&command));
    TEST_ASSERT_EQUAL_INT(reason, berth_controller_status(&controller)->error);
}

/* Good steps do not clear the reason; a start does. */
static void expect_kept_until_start(berth_error_t reason, int64_t now_us) {
    const berth_pose_t pose = good_pose();
    for (int i = 1; i <= 3; i++) {
        expect_stands(reason, now_us + i * PERIOD_US, &pose);
    }
    start(&controller, now_us);
    expect_moves(now_us);
}

static void expect_pose_refused(float x_m, float y_m, float theta_rad) {
    const berth_pose_t bad = {x_m, y_m, theta_rad};
    init_and_start();
    expect_moves(0);
    expect_moves(PERIOD_US);
    expect_stands(BERTH_ERROR_POSE, 2 * PERIOD_US, &bad);
    expect_kept_until_start(BERTH_ERROR_POSE, 2 * PERIOD_US);
}

static void test_pose_that_is_not_finite(void) {
    static const float values[] = {NAN, -NAN, INFINITY, -INFINITY};
    for (size_t i = 0; i < sizeof values / sizeof values[0]; i++) {
        expect_pose_refused(values[i], 0.1f, 1.2f);
        expect_pose_refused(1.0f, values[i], 1.2f);
        expect_pose_refused(1.0f, 0.1f, values[i]);
    }
    expect_pose_refused(NAN, NAN, NAN);
}

static void test_pose_far_outside(void) {
    const float beyond = nextafterf(BERTH_POSITION_MAX_M, INFINITY);
    const float values[] = {beyond, -beyond, 1.0e30f, -FLT_MAX};
    for (size_t i = 0; i < sizeof values / sizeof values[0]; i++) {
        expect_pose_refused(values[i], 0.1f, 1.2f);
        expect_pose_refused(1.0f, values[i], 1.2f);
    }
    init_and_start();
    const berth_pose_t corner = {BERTH_POSITION_MAX_M, -BERTH_POSITION_MAX_M, 0.0f};
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_controller_step(&controller, 0, &corner, &command));
}

static void expect_time_refused(int64_t bad_us) {
    const berth_pose_t pose = good_pose();
    init(&controller);
    start(&controller, 1000000);
    expect_moves(1000000);
    expect_moves(1000000 + PERIOD_US);
    expect_stands(BERTH_ERROR_TIME, bad_us, &pose);
    expect_kept_until_start(BERTH_ERROR_TIME, 1000000 + 2 * PERIOD_US);
}

static void test_time_that_is_wrong(void) {
    expect_time_refused(1000000 + PERIOD_US - 1); /* backwards by a microsecond */
    expect_time_refused(0);
    expect_time_refused(-1);
    expect_time_refused(INT64_MIN);
    expect_time_refused(BERTH_TIME_MAX_US + 1);
    expect_time_refused(INT64_MAX);
}

static void test_time_before_the_start(void) {
    const berth_pose_t pose = good_pose();
    init(&controller);
    start(&controller, 1000000);
    expect_stands(BERTH_ERROR_TIME, 999999, &pose);
    expect_kept_until_start(BERTH_ERROR_TIME, 1000000);
}

static void test_two_steps_at_one_time(void) {
    init_and_start();
    expect_moves(PERIOD_US);
    const berth_command_t first = command;
    expect_moves(PERIOD_US);
    TEST_ASSERT_EQUAL_MEMORY(&first, &command, sizeof first);
}

static void test_the_largest_times(void) {
    init(&controller);
    start(&controller, BERTH_TIME_MAX_US - PERIOD_US);
    expect_moves(BERTH_TIME_MAX_US - PERIOD_US);
    expect_moves(BERTH_TIME_MAX_US);
    TEST_ASSERT_EQUAL_UINT32(1, berth_controller_status(&controller)->index);
    start(&controller, BERTH_TIME_MAX_US);
    expect_moves(BERTH_TIME_MAX_US);
    init_and_start();
    expect_moves(BERTH_TIME_MAX_US); /* some 146,000 years late */
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, berth_controller_status(&controller)->skipped);
}

static void test_missing_pointers(void) {
    const berth_pose_t pose = good_pose();
    init_and_start();
    expect_moves(0);
    expect_stands(BERTH_ERROR_ARGUMENT, PERIOD_US, NULL);
    expect_kept_until_start(BERTH_ERROR_ARGUMENT, PERIOD_US);
    memset(&command, 0x55, sizeof command);
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_ARGUMENT,
                          berth_controller_step(NULL, PERIOD_US, &pose, &command));
    TEST_ASSERT_TRUE(zero(&command));
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_ARGUMENT, berth_controller_step(NULL, PERIOD_US, NULL, NULL));
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_ARGUMENT, berth_controller_start(NULL, 0));
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_ARGUMENT, berth_controller_add_obstacle(NULL, NULL, NULL));
}

/* The caller has nothing to send: like all else that goes wrong, it stays so until a start. */
static void test_missing_command(void) {
    const berth_pose_t pose = good_pose();
    init_and_start();
    expect_moves(0);
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_ARGUMENT,
                          berth_controller_step(&controller, PERIOD_US, &pose, NULL));
    expect_kept_until_start(BERTH_ERROR_ARGUMENT, PERIOD_US);
}

/* The first reason is the one that is kept. */
static void test_later_trouble_does_not_hide_the_first(void) {
    const berth_pose_t bad = {NAN, 0.0f, 0.0f};
    init_and_start();
    expect_moves(PERIOD_US);
    expect_stands(BERTH_ERROR_POSE, 2 * PERIOD_US, &bad);
    expect_stands(BERTH_ERROR_POSE, -1, NULL);
    expect_kept_until_start(BERTH_ERROR_POSE, 2 * PERIOD_US);
}

static void test_step_before_start(void) {
    const berth_pose_t pose = good_pose();
    init(&controller);
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_STATE, berth_controller_status(&controller)->error);
    expect_stands(BERTH_ERROR_STATE, 0, &pose);
    expect_kept_until_start(BERTH_ERROR_STATE, 0);
}

static void test_start_at_a_wrong_time_does_not_start(void) {
    const berth_pose_t pose = good_pose();
    init(&controller);
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_TIME, berth_controller_start(&controller, -1));
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_TIME,
                          berth_controller_start(&controller, BERTH_TIME_MAX_US + 1));
    expect_stands(BERTH_ERROR_STATE, 0, &pose);
    expect_kept_until_start(BERTH_ERROR_STATE, 0);
}

static void test_before_init(void) {
    const berth_pose_t pose = good_pose();
    const berth_obstacle_t obstacle = {5.0f, 5.0f, 0.1f, 0.2f, 0.4f};
    berth_refusal_t refusal;
    memset(&controller, 0, sizeof controller);
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_STATE, berth_controller_start(&controller, 0));
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_STATE,
                          berth_controller_add_obstacle(&controller, &obstacle, &refusal));
    expect_stands(BERTH_ERROR_STATE, 0, &pose);
}

/* Also of one that was running, and whatever the struct held before. */
static void test_after_a_refused_init(void) {
    const berth_pose_t pose = good_pose();
    berth_refusal_t refusal;
    for (int was_running = 0; was_running < 2; was_running++) {
        memset(&controller, 0x55, sizeof controller);
        if (was_running != 0) {
            init_and_start();
            expect_moves(0);
        }
        berth_config_t bad = config;
        bad.limits.v_max_mps = NAN;
        TEST_ASSERT_EQUAL_INT(BERTH_ERROR_CONFIG,
                              berth_controller_init(&controller, &shape.plan, &bad, &refusal));
        TEST_ASSERT_EQUAL_INT(BERTH_ERROR_STATE, berth_controller_start(&controller, 0));
        expect_stands(BERTH_ERROR_STATE, PERIOD_US, &pose);
        expect_stands(BERTH_ERROR_STATE, 2 * PERIOD_US, &pose);
        init_and_start();
        expect_moves(0);
    }
}

/* A robot that obeys at once. */
static support_pose_t robot;

static void put_robot(const berth_sample_t *sample, double ahead_m, double left_m) {
    const double theta = (double)sample->theta_rad;
    robot =
        (support_pose_t){(double)sample->x_m + ahead_m * cos(theta) - left_m * sin(theta),
                         (double)sample->y_m + ahead_m * sin(theta) + left_m * cos(theta), theta};
}

static void step_robot(berth_controller_t *c, int64_t now_us) {
    const berth_pose_t pose = support_measure(robot);
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_controller_step(c, now_us, &pose, &command));
    robot = support_move(robot, (double)command.twist.v_mps, (double)command.twist.omega_radps,
                         PERIOD_S);
}

static double distance_to(const berth_sample_t *sample) {
    return hypot((double)sample->x_m - robot.x_m, (double)sample->y_m - robot.y_m);
}

/* What a fresh controller does from here on, a restarted one does too. */
static void expect_like_a_fresh_one(berth_pose_t pose, int64_t now_us) {
    static berth_controller_t fresh;
    berth_command_t expected;
    init(&fresh);
    for (uint32_t i = 0; i < controller.obstacles.count; i++) {
        const berth_obstacle_t obstacle = controller.obstacles.slots[i].obstacle;
        berth_refusal_t refusal;
        TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_controller_add_obstacle(&fresh, &obstacle, &refusal));
    }
    start(&fresh, 0);
    start(&controller, now_us);
    for (int i = 0; i < 20; i++) {
        TEST_ASSERT_EQUAL_INT(BERTH_OK,
                              berth_controller_step(&fresh, i * PERIOD_US, &pose, &expected));
        TEST_ASSERT_EQUAL_INT(
            BERTH_OK, berth_controller_step(&controller, now_us + i * PERIOD_US, &pose, &command));
        TEST_ASSERT_EQUAL_MEMORY(&expected, &command, sizeof expected);
        pose.theta_rad += 0.02f;
    }
}

/* Stopped in the middle of a turn to the right; seen anew, the left is nearer. */
static void test_restart_forgets_a_turn(void) {
    init(&controller);
    add(&controller, -3.0f, 0.0f);
    start(&controller, 0);
    const berth_pose_t turning = {-3.3f, 0.0f, -0.1f};
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_controller_step(&controller, 0, &turning, &command));
    TEST_ASSERT_TRUE(command.twist.omega_radps < 0.0f);
    expect_like_a_fresh_one((berth_pose_t){-3.3f, 0.0f, 0.1f}, 123456789);
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_REGULATED, berth_controller_status(&controller)->mode);
}

static void test_restart_forgets_speed_and_lateness(void) {
    config.limits.a_max_mps2 = 0.5f;
    config.limits.alpha_max_radps2 = 1.0f;
    config.avoid.a_brake_mps2 = 0.5f;
    init_and_start();
    for (int i = 0; i < 10; i++) {
        expect_moves(3 * i * PERIOD_US);
    }
    TEST_ASSERT_EQUAL_UINT32(18, berth_controller_status(&controller)->skipped);
    expect_like_a_fresh_one(good_pose(), 77);
    TEST_ASSERT_EQUAL_UINT32(0, berth_controller_status(&controller)->skipped);
}

static void test_late_steps_skip_samples(void) {
    init_and_start();
    static const struct {
        int64_t now_us;
        uint32_t index, skipped;
    } steps[] = {
        {0, 0, 0},      {24999, 0, 0},      {50000, 1, 0},      {124999, 2, 0},
        {150000, 3, 0}, {340000, 7, 3},     {350000, 7, 3},     {374999, 7, 3},
        {375000, 8, 3}, {20950000, 0, 413}, {41900000, 0, 831},
    };
    for (size_t i = 0; i < sizeof steps / sizeof steps[0]; i++) {
        expect_moves(steps[i].now_us);
        const berth_status_t *status = berth_controller_status(&controller);
        TEST_ASSERT_EQUAL_UINT32(steps[i].index, status->index);
        TEST_ASSERT_EQUAL_UINT32(steps[i].skipped, status->skipped);
        TEST_ASSERT_EQUAL_MEMORY(&shape.samples[steps[i].index], &status->sample,
                                 sizeof status->sample);
        TEST_ASSERT_FALSE(status->finished);
    }
}

static void test_end_of_an_open_plan_holds_the_pose(void) {
    support_plan(&shape, SUPPORT_EIGHT, 300, false);
    support_fill_gains(&shape);
    init_and_start();
    put_robot(&shape.samples[0], 0.05, 0.05);
    for (int64_t i = 0; i < 600; i++) {
        step_robot(&controller, i * PERIOD_US);
        const berth_status_t *status = berth_controller_status(&controller);
        TEST_ASSERT_EQUAL_INT(i >= 300, status->finished);
        TEST_ASSERT_EQUAL_UINT32(i < 300 ? i : 300, status->index);
    }
    TEST_ASSERT_TRUE(distance_to(&shape.samples[299]) < 0.01);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-3f, 0.0f, command.twist.v_mps);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-3f, 0.0f, command.twist.omega_radps);
    const berth_sample_t held = berth_controller_status(&controller)->sample;
    TEST_ASSERT_EQUAL_FLOAT(shape.samples[299].x_m, held.x_m);
    TEST_ASSERT_EQUAL_FLOAT(shape.samples[299].theta_rad, held.theta_rad);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, held.v_mps);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, held.omega_radps);
}

/* Pushed off the pose that it holds, the robot comes back along its heading. */
static void test_the_held_pose_is_controlled(void) {
    support_plan(&shape, SUPPORT_CIRCLE, 100, false);
    support_fill_gains(&shape);
    init_and_start();
    const berth_sample_t *last = &shape.samples[99];
    put_robot(last, -0.2, 0.0);
    robot.theta_rad += 0.3;
    for (int64_t i = 0; i < 400; i++) {
        step_robot(&controller, (1000 + i) * PERIOD_US);
        TEST_ASSERT_TRUE(berth_controller_status(&controller)->finished);
    }
    TEST_ASSERT_TRUE(distance_to(last) < 0.1);
    TEST_ASSERT_DOUBLE_WITHIN(0.05, 0.0, support_wrap(robot.theta_rad - (double)last->theta_rad));
}

static void test_ten_laps_of_a_closed_plan(void) {
    init_and_start();
    put_robot(&shape.samples[0], -0.1, 0.2);
    double worst = 0.0;
    for (int64_t i = 0; i < 4190; i++) {
        const double error = distance_to(&shape.samples[i % 419]);
        worst = i > 419 && error > worst ? error : worst;
        step_robot(&controller, i * PERIOD_US);
        const berth_status_t *status = berth_controller_status(&controller);
        TEST_ASSERT_EQUAL_UINT32(i % 419, status->index);
        TEST_ASSERT_FALSE(status->finished);
    }
    TEST_ASSERT_EQUAL_UINT32(0, berth_controller_status(&controller)->skipped);
    TEST_ASSERT_TRUE(worst < 1.0e-3);
}

static void test_without_obstacles(void) {
    init_and_start();
    for (int i = 0; i < 100; i++) {
        expect_moves(i * PERIOD_US);
        const berth_status_t *status = berth_controller_status(&controller);
        TEST_ASSERT_EQUAL_INT(BERTH_MODE_TRACK, status->mode);
        TEST_ASSERT_EQUAL_UINT8(0, status->active);
        TEST_ASSERT_EQUAL_FLOAT(BERTH_RADIUS_MAX_M, status->clearance_m);
        TEST_ASSERT_FALSE(status->braking);
    }
}

static void test_room_for_so_many_obstacles(void) {
    const berth_obstacle_t one_more = {5.0f, 5.0f, 0.1f, 0.2f, 0.4f};
    berth_refusal_t refusal;
    init(&controller);
    for (uint32_t i = 0; i < BERTH_OBSTACLES_MAX; i++) {
        add(&controller, 1.2f + 0.01f * (float)i, 0.1f);
    }
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_CAPACITY,
                          berth_controller_add_obstacle(&controller, &one_more, &refusal));
    start(&controller, 0);
    const berth_pose_t pose = good_pose();
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_controller_step(&controller, 0, &pose, &command));
    TEST_ASSERT_EQUAL_UINT8(BERTH_OBSTACLES_MAX, berth_controller_status(&controller)->active);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-6f, 0.05f, berth_controller_status(&controller)->clearance_m);
}

/* Far off the path both v and omega are beyond the limits. */
static void test_limits_keep_the_curvature_while_tracking(void) {
    init_and_start();
    const berth_pose_t pose = {-3.0f, -2.0f, 0.7f};
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_controller_step(&controller, 0, &pose, &command));
    const berth_status_t *status = berth_controller_status(&controller);
    const berth_twist_t law =
        berth_tracker_law(&status->sample, &shape.gains[0], &status->tracking_error);
    TEST_ASSERT_TRUE(law.v_mps > 0.8f && fabsf(law.omega_radps) > 3.0f);
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_TRACK, status->mode);
    TEST_ASSERT_TRUE((status->limited & BERTH_LIMITED_V) != 0);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-5f, law.omega_radps / law.v_mps,
                             command.twist.omega_radps / command.twist.v_mps);
}

/* The same with an obstacle straight ahead, which it must not turn away from any slower. */
static void test_limits_keep_the_turn_while_avoiding(void) {
    init(&controller);
    add(&controller, -3.0f + 0.3f * cosf(0.7f), -2.0f + 0.3f * sinf(0.7f));
    start(&controller, 0);
    const berth_pose_t pose = {-3.0f, -2.0f, 0.7f};
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_controller_step(&controller, 0, &pose, &command));
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_REGULATED, berth_controller_status(&controller)->mode);
    TEST_ASSERT_EQUAL_FLOAT(3.0f, fabsf(command.twist.omega_radps));
    TEST_ASSERT_EQUAL_FLOAT(0.8f, command.twist.v_mps);
    TEST_ASSERT_EQUAL_HEX8(BERTH_LIMITED_V, berth_controller_status(&controller)->limited);
}

static void test_on_an_obstacle_the_robot_stands(void) {
    init(&controller);
    add(&controller, 1.05f, 0.1f);
    start(&controller, 0);
    const berth_pose_t pose = good_pose();
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_controller_step(&controller, 0, &pose, &command));
    TEST_ASSERT_TRUE(zero(&command));
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_BLOCKED, berth_controller_status(&controller)->mode);
}

/* The heading may be any finite angle: it is the same as the wrapped one, to the bit. */
static void test_headings_of_any_size(void) {
    static const float headings[] = {3.2f, -7.0f, 100.0f, -1.0e6f, 1.0e30f, -1.0e30f, FLT_MAX};
    init(&controller);
    add(&controller, 1.3f, 0.3f);
    for (size_t i = 0; i < sizeof headings / sizeof headings[0]; i++) {
        berth_command_t wrapped;
        berth_pose_t pose = good_pose();
        pose.theta_rad = headings[i];
        start(&controller, 0);
        TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_controller_step(&controller, 0, &pose, &command));
        pose.theta_rad = berth_wrap(headings[i]);
        start(&controller, 0);
        TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_controller_step(&controller, 0, &pose, &wrapped));
        TEST_ASSERT_EQUAL_MEMORY(&wrapped, &command, sizeof wrapped);
        TEST_ASSERT_TRUE(isfinite(command.twist.v_mps) && isfinite(command.twist.omega_radps));
    }
}

/* One closed-loop run with the gain table and one with gains computed in each step. */
static void expect_same_run_without_table(void) {
    static support_plan_t online;
    static berth_controller_t other;
    online = shape;
    online.plan.samples = online.samples;
    online.plan.gains = NULL;
    online.plan.gain_source = BERTH_GAIN_ONLINE;
    berth_refusal_t refusal;
    uint32_t avoiding = 0;
    init(&controller);
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_controller_init(&other, &online.plan, &config, &refusal));
    for (uint32_t i = 1; i < 4; i++) {
        const berth_sample_t *near = &shape.samples[i * shape.plan.count / 4];
        add(&controller, near->x_m + 0.05f, near->y_m);
        add(&other, near->x_m + 0.05f, near->y_m);
    }
    start(&controller, 0);
    start(&other, 0);
    put_robot(&shape.samples[0], 0.1, 0.1);
    for (int64_t i = 0; i < (int64_t)shape.plan.count + 100; i++) {
        berth_command_t computed;
        const berth_pose_t pose = support_measure(robot);
        TEST_ASSERT_EQUAL_INT(BERTH_OK,
                              berth_controller_step(&other, i * PERIOD_US, &pose, &computed));
        step_robot(&controller, i * PERIOD_US);
        TEST_ASSERT_EQUAL_MEMORY(&command, &computed, sizeof computed);
        avoiding += berth_controller_status(&controller)->mode != BERTH_MODE_TRACK;
    }
    TEST_ASSERT_GREATER_THAN_UINT32(20, avoiding);
}

static void test_table_and_online_gains_give_the_same_bits(void) {
    for (int i = 0; i < 8; i++) {
        support_plan(&shape, (i & 1) != 0 ? SUPPORT_EIGHT : SUPPORT_CIRCLE, 600, (i & 2) != 0);
        shape.plan.mpc.discretization =
            (i & 4) != 0 ? BERTH_DISCRETIZATION_ZOH : BERTH_DISCRETIZATION_EULER;
        support_fill_gains(&shape);
        expect_same_run_without_table();
    }
}

static float draw(double low, double high) {
    return (float)support_uniform(low, high);
}

/* Any sign, and any size up to the limit. */
static float draw_any(double limit) {
    const double size = support_index(4) == 0 ? limit : support_log_uniform(1.0e-30, limit);
    return (float)(support_index(2) == 0 ? size : -size);
}

static void draw_extreme_plan(void) {
    shape.plan.count = 5;
    for (uint32_t k = 0; k < shape.plan.count; k++) {
        shape.samples[k] = (berth_sample_t){draw_any(1000.0), draw_any(1000.0), draw(-3.14, 3.14),
                                            draw_any(100.0), draw_any(100.0)};
        for (int i = 0; i < 6; i++) {
            shape.gains[k].k[i / 3][i % 3] = draw_any((double)BERTH_GAIN_MAX);
        }
    }
    const uint32_t periods_us[] = {BERTH_PERIOD_MIN_US, 50000, BERTH_PERIOD_MAX_US};
    shape.plan.period_us = periods_us[support_index(3)];
    shape.plan.closed = support_index(2) == 0;
}

static void draw_extreme_config(void) {
    const double turn_max = 1.57 / (1.0e-6 * shape.plan.period_us);
    config = berth_config_default((float)support_log_uniform(0.001, 10.0),
                                  (float)support_log_uniform(0.01, 10.0));
    config.limits.v_max_mps = (float)support_log_uniform(0.001, 100.0);
    config.limits.omega_max_radps = (float)support_log_uniform(0.001, fmin(100.0, turn_max));
    config.limits.wheel_speed_max_radps =
        support_index(2) == 0 ? 0.0f : (float)support_log_uniform(0.001, 10000.0);
    config.avoid.skirt_m = draw(0.0, 1.0);
    config.avoid.v_creep_mps = config.limits.v_max_mps * draw(0.5, 1.0);
    config.avoid.v_creep_mps = fmaxf(config.avoid.v_creep_mps, 0.001f);
    if (support_index(2) == 0) {
        config.limits.a_max_mps2 = (float)support_log_uniform(0.001, 1000.0);
        config.limits.alpha_max_radps2 = (float)support_log_uniform(0.001, 1000.0);
        config.avoid.a_brake_mps2 = config.limits.a_max_mps2;
        config.avoid.tau_s = draw(0.0, 10.0);
    }
}

static void add_extreme_obstacles(const berth_pose_t *pose) {
    for (uint32_t i = support_index(4); i > 0; i--) {
        const float hard = draw(0.001, 1.0);
        const float conservative = hard + controller.avoid.clearance_min_m + 0.01f;
        const berth_obstacle_t obstacle = {pose->x_m + draw(-1.0, 1.0), pose->y_m + draw(-1.0, 1.0),
                                           hard, conservative,
                                           conservative + config.avoid.skirt_m + 1.0f};
        berth_refusal_t refusal;
        /* slow brakes may ask for more room than there is: then it is refused */
        (void)!berth_controller_add_obstacle(&controller, &obstacle, &refusal);
    }
}

static void expect_within_limits(void) {
    const double slack = 1.0 + 1.0e-6;
    const double v = fabs((double)command.twist.v_mps);
    const double omega = fabs((double)command.twist.omega_radps);
    TEST_ASSERT_TRUE(isfinite(command.wheels.left_radps) && isfinite(command.wheels.right_radps));
    TEST_ASSERT_TRUE(v <= (double)config.limits.v_max_mps * slack);
    TEST_ASSERT_TRUE(omega <= (double)config.limits.omega_max_radps * slack);
    if (config.limits.wheel_speed_max_radps > 0.0f && config.limits.a_max_mps2 == 0.0f) {
        const double limit = (double)config.limits.wheel_speed_max_radps * (1.0 + 1.0e-5);
        TEST_ASSERT_TRUE(fabs((double)command.wheels.left_radps) <= limit);
        TEST_ASSERT_TRUE(fabs((double)command.wheels.right_radps) <= limit);
    }
}

static void test_extreme_inputs_give_finite_commands_within_the_limits(void) {
    support_random_start();
    for (uint32_t run = 0; run < support_runs(20000); run++) {
        berth_pose_t pose = {draw_any(999.0), draw_any(999.0), draw_any((double)FLT_MAX)};
        draw_extreme_plan();
        draw_extreme_config();
        init(&controller);
        add_extreme_obstacles(&pose);
        start(&controller, 0);
        int64_t now_us = 0;
        for (int i = 0; i < 8; i++) {
            TEST_ASSERT_EQUAL_INT(BERTH_OK,
                                  berth_controller_step(&controller, now_us, &pose, &command));
            expect_within_limits();
            now_us += support_index(2) == 0 ? shape.plan.period_us : support_index(1u << 31);
            pose.theta_rad = draw_any((double)FLT_MAX);
        }
    }
}

/* All the memory that a robot's control takes. */
static void test_ram_is_within_its_budget(void) {
    printf("controller: %u bytes, room for %u obstacles, %u-bit pointers\n",
           (unsigned)sizeof(berth_controller_t), (unsigned)BERTH_OBSTACLES_MAX,
           (unsigned)(8 * sizeof(void *)));
    TEST_ASSERT_TRUE(sizeof(berth_controller_t) <= 1024);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_ram_is_within_its_budget);
    RUN_TEST(test_pose_that_is_not_finite);
    RUN_TEST(test_pose_far_outside);
    RUN_TEST(test_time_that_is_wrong);
    RUN_TEST(test_time_before_the_start);
    RUN_TEST(test_two_steps_at_one_time);
    RUN_TEST(test_the_largest_times);
    RUN_TEST(test_missing_pointers);
    RUN_TEST(test_missing_command);
    RUN_TEST(test_later_trouble_does_not_hide_the_first);
    RUN_TEST(test_step_before_start);
    RUN_TEST(test_start_at_a_wrong_time_does_not_start);
    RUN_TEST(test_before_init);
    RUN_TEST(test_after_a_refused_init);
    RUN_TEST(test_restart_forgets_a_turn);
    RUN_TEST(test_restart_forgets_speed_and_lateness);
    RUN_TEST(test_late_steps_skip_samples);
    RUN_TEST(test_end_of_an_open_plan_holds_the_pose);
    RUN_TEST(test_the_held_pose_is_controlled);
    RUN_TEST(test_ten_laps_of_a_closed_plan);
    RUN_TEST(test_without_obstacles);
    RUN_TEST(test_room_for_so_many_obstacles);
    RUN_TEST(test_limits_keep_the_curvature_while_tracking);
    RUN_TEST(test_limits_keep_the_turn_while_avoiding);
    RUN_TEST(test_on_an_obstacle_the_robot_stands);
    RUN_TEST(test_headings_of_any_size);
    RUN_TEST(test_table_and_online_gains_give_the_same_bits);
    RUN_TEST(test_extreme_inputs_give_finite_commands_within_the_limits);
    return UNITY_END();
}
