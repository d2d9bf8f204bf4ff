/* Tracking error and tracking law against double precision, and the closed loop that they make. */
#include "support.h"

#include "unity.h"

#include <float.h>
#include <math.h>
#include <stdio.h>

/* What angle.h promises for sine, cosine and wrap; a unit in the last place for each rounding. */
#define ANGLE_ERROR 2.0e-6
#define ULP ((double)FLT_EPSILON)

static const double pi = 3.14159265358979323846;

static support_plan_t table;
static support_plan_t online;

void setUp(void) {}

void tearDown(void) {}

/* ---- Tracking error ---- */

typedef struct {
    double e1, e2, e3;
} error_t;

static error_t error_in_double(const berth_pose_t *pose, const berth_sample_t *sample) {
    const double theta = (double)pose->theta_rad;
    const double dx = (double)sample->x_m - (double)pose->x_m;
    const double dy = (double)sample->y_m - (double)pose->y_m;
    return (error_t){
        .e1 = cos(theta) * dx + sin(theta) * dy,
        .e2 = -sin(theta) * dx + cos(theta) * dy,
        .e3 = support_wrap((double)sample->theta_rad - theta),
    };
}

static berth_pose_t random_pose(double range_m) {
    return (berth_pose_t){
        (float)support_uniform(-range_m, range_m),
        (float)support_uniform(-range_m, range_m),
        (float)support_uniform(-pi, pi),
    };
}

static berth_sample_t random_sample(double range_m) {
    const berth_pose_t pose = random_pose(range_m);
    return (berth_sample_t){pose.x_m, pose.y_m, pose.theta_rad, (float)support_uniform(-1.0, 1.0),
                            (float)support_uniform(-3.0, 3.0)};
}

/* Of the largest component: sine and cosine times the distance, and three roundings. */
static double position_tolerance(const berth_pose_t *pose, const berth_sample_t *sample) {
    const double distance =
        hypot((double)sample->x_m - (double)pose->x_m, (double)sample->y_m - (double)pose->y_m);
    return (1.5 * ANGLE_ERROR + 3.0 * ULP) * distance;
}

static void check_error(const error_t *expected, const berth_tracking_error_t *error,
                        double position_m, double angle_rad) {
    TEST_ASSERT_DOUBLE_WITHIN(position_m, expected->e1, (double)error->e1_m);
    TEST_ASSERT_DOUBLE_WITHIN(position_m, expected->e2, (double)error->e2_m);
    const double e3 = (double)error->e3_rad;
    TEST_ASSERT_DOUBLE_WITHIN(angle_rad, 0.0, support_wrap(e3 - expected->e3));
    TEST_ASSERT_TRUE(fabs(e3) <= (double)BERTH_PI);
}

static void test_error_against_double(void) {
    support_random_start();
    const double ranges[] = {1.0e-3, 1.0, 30.0, 1000.0};
    for (uint32_t run = 0; run < support_runs(400000); run++) {
        const double range_m = ranges[run % 4];
        const berth_pose_t pose = random_pose(range_m);
        const berth_sample_t sample = random_sample(range_m);
        const error_t expected = error_in_double(&pose, &sample);
        berth_tracking_error_t error;
        berth_tracking_error(&pose, &sample, &error);
        check_error(&expected, &error, position_tolerance(&pose, &sample), ANGLE_ERROR + 2.0 * ULP);
    }
}

static void test_error_by_hand(void) {
    static const struct {
        berth_pose_t pose;
        berth_sample_t sample;
        float e1, e2, e3;
    } cases[] = {
        {{0.0f, 0.0f, 0.0f}, {1.0f, 2.0f, 0.5f, 0.0f, 0.0f}, 1.0f, 2.0f, 0.5f},
        {{1.0f, 1.0f, 1.57079633f}, {1.0f, 3.0f, 1.57079633f, 0.0f, 0.0f}, 2.0f, 0.0f, 0.0f},
        {{1.0f, 1.0f, 1.57079633f}, {0.0f, 1.0f, 0.0f, 0.0f, 0.0f}, 0.0f, 1.0f, -1.57079633f},
        {{0.0f, 0.0f, 3.0f}, {0.0f, 0.0f, -3.0f, 0.0f, 0.0f}, 0.0f, 0.0f, 0.283185307f},
        {{0.0f, 0.0f, -3.0f}, {0.0f, 0.0f, 3.0f, 0.0f, 0.0f}, 0.0f, 0.0f, -0.283185307f},
    };
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        berth_tracking_error_t error;
        berth_tracking_error(&cases[i].pose, &cases[i].sample, &error);
        TEST_ASSERT_FLOAT_WITHIN(5.0e-6f, cases[i].e1, error.e1_m);
        TEST_ASSERT_FLOAT_WITHIN(5.0e-6f, cases[i].e2, error.e2_m);
        TEST_ASSERT_FLOAT_WITHIN(5.0e-6f, cases[i].e3, error.e3_rad);
    }
}

/* The error is the robot's own view: turning and moving the whole scene changes nothing. */
static void test_error_does_not_see_where_the_scene_lies(void) {
    support_random_start();
    for (uint32_t run = 0; run < support_runs(100000); run++) {
        const berth_pose_t pose = random_pose(5.0);
        const berth_sample_t sample = random_sample(5.0);
        const double turn = support_uniform(-pi, pi);
        const double shift_x = support_uniform(-5.0, 5.0);
        const double shift_y = support_uniform(-5.0, 5.0);
        const double s = sin(turn);
        const double c = cos(turn);
        const double px = (double)pose.x_m;
        const double py = (double)pose.y_m;
        const double qx = (double)sample.x_m;
        const double qy = (double)sample.y_m;
        const berth_pose_t other = {(float)(c * px - s * py + shift_x),
                                    (float)(s * px + c * py + shift_y),
                                    (float)support_wrap((double)pose.theta_rad + turn)};
        const berth_sample_t other_sample = {
            (float)(c * qx - s * qy + shift_x), (float)(s * qx + c * qy + shift_y),
            (float)support_wrap((double)sample.theta_rad + turn), sample.v_mps, sample.omega_radps};
        berth_tracking_error_t first;
        berth_tracking_error_t second;
        berth_tracking_error(&pose, &sample, &first);
        berth_tracking_error(&other, &other_sample, &second);
        const error_t expected = {(double)first.e1_m, (double)first.e2_m, (double)first.e3_rad};
        /* positions up to 13 m and headings up to pi were rounded on the way */
        const double heading = 2.0 * ANGLE_ERROR + 4.0 * ULP;
        check_error(&expected, &second, 15.0 * heading + 4.0 * 13.0 * ULP, heading);
    }
}

static void test_error_of_bad_input_is_nan(void) {
    const float bad[] = {NAN, INFINITY, -INFINITY};
    for (size_t i = 0; i < 3; i++) {
        const berth_sample_t sample = {1.0f, 2.0f, 0.5f, 0.3f, 0.1f};
        berth_pose_t pose = {0.0f, 0.0f, bad[i]};
        berth_tracking_error_t error;
        berth_tracking_error(&pose, &sample, &error);
        TEST_ASSERT_TRUE(isnan(error.e1_m) && isnan(error.e2_m) && isnan(error.e3_rad));
        pose = (berth_pose_t){bad[i], 0.0f, 0.0f};
        berth_tracking_error(&pose, &sample, &error);
        TEST_ASSERT_FALSE(isfinite(error.e1_m));
    }
}

/* ---- Tracking law ---- */

static void test_law_against_double(void) {
    support_random_start();
    for (uint32_t run = 0; run < support_runs(400000); run++) {
        const berth_sample_t sample = random_sample(1.0);
        berth_gain_t gain;
        for (int i = 0; i < 6; i++) {
            gain.k[i / 3][i % 3] = (float)support_uniform(-30.0, 30.0);
        }
        const berth_tracking_error_t error = {(float)support_uniform(-10.0, 10.0),
                                              (float)support_uniform(-10.0, 10.0),
                                              (float)support_uniform(-pi, pi)};
        const double e[3] = {(double)error.e1_m, (double)error.e2_m, (double)error.e3_rad};
        double v = (double)sample.v_mps * cos(e[2]);
        double omega = (double)sample.omega_radps;
        double v_size = fabs((double)sample.v_mps);
        double omega_size = fabs(omega);
        for (int j = 0; j < 3; j++) {
            v += (double)gain.k[0][j] * e[j];
            omega += (double)gain.k[1][j] * e[j];
            v_size += fabs((double)gain.k[0][j] * e[j]);
            omega_size += fabs((double)gain.k[1][j] * e[j]);
        }
        const berth_twist_t twist = berth_tracker_law(&sample, &gain, &error);
        TEST_ASSERT_DOUBLE_WITHIN(ANGLE_ERROR * fabs((double)sample.v_mps) + 3.0 * ULP * v_size, v,
                                  (double)twist.v_mps);
        TEST_ASSERT_DOUBLE_WITHIN(3.0 * ULP * omega_size, omega, (double)twist.omega_radps);
    }
}

static void test_law_without_error_is_the_reference(void) {
    support_plan(&online, SUPPORT_EIGHT, 900, false);
    const berth_tracking_error_t none = {0.0f, 0.0f, 0.0f};
    for (uint32_t k = 0; k < 900; k += 9) {
        berth_gain_t gain;
        berth_riccati_gain(&online.plan, k, &gain);
        const berth_twist_t twist = berth_tracker_law(&online.samples[k], &gain, &none);
        TEST_ASSERT_TRUE(support_same_bits(online.samples[k].v_mps, twist.v_mps));
        TEST_ASSERT_TRUE(support_same_bits(online.samples[k].omega_radps, twist.omega_radps));
    }
}

/* Behind: faster. To the right of the path (e2 > 0) or turned too far right (e3 > 0): to the left.
 */
static void test_law_steers_towards_the_reference(void) {
    support_plan(&online, SUPPORT_EIGHT, 900, false);
    for (uint32_t k = 0; k < 800; k += 7) {
        berth_gain_t gain;
        berth_riccati_gain(&online.plan, k, &gain);
        TEST_ASSERT_TRUE(gain.k[0][0] > 0.0f);
        TEST_ASSERT_TRUE(gain.k[1][1] > 0.0f);
        TEST_ASSERT_TRUE(gain.k[1][2] > 0.0f);
    }
}

/* ---- Closed loop with the ideal robot ---- */

typedef struct {
    double position_m, heading_rad;
} distance_t;

static distance_t distance(const support_pose_t *pose, const berth_sample_t *sample) {
    return (distance_t){
        hypot((double)sample->x_m - pose->x_m, (double)sample->y_m - pose->y_m),
        fabs(support_wrap((double)sample->theta_rad - pose->theta_rad)),
    };
}

static void start(berth_controller_t *controller, const support_plan_t *plan) {
    const berth_config_t config = berth_config_default(0.05f, 0.30f);
    berth_refusal_t refusal;
    TEST_ASSERT_EQUAL(BERTH_OK, berth_controller_init(controller, &plan->plan, &config, &refusal));
    TEST_ASSERT_EQUAL(BERTH_OK, berth_controller_start(controller, 0));
}

/* Uniform in the disc of 1 m around the first sample, and within 1 rad of its heading. */
static support_pose_t random_start(const support_plan_t *plan) {
    const berth_sample_t *first = &plan->samples[0];
    const double radius = sqrt(support_uniform(0.0, 1.0));
    const double direction = support_uniform(-pi, pi);
    return (support_pose_t){
        (double)first->x_m + radius * cos(direction),
        (double)first->y_m + radius * sin(direction),
        support_wrap((double)first->theta_rad + support_uniform(-1.0, 1.0)),
    };
}

/* One run with table and online gains side by side: the same bits in every command. Returns the
 * largest distance over the last lap's quarter. */
static distance_t run_both(support_pose_t pose) {
    berth_controller_t with_table;
    berth_controller_t with_online;
    start(&with_table, &table);
    start(&with_online, &online);
    const uint32_t count = table.plan.count;
    distance_t worst = {0.0, 0.0};
    for (uint32_t k = 0; k < count; k++) {
        const berth_pose_t measured = support_measure(pose);
        berth_command_t command;
        berth_command_t other;
        const int64_t now_us = (int64_t)k * table.plan.period_us;
        TEST_ASSERT_EQUAL(BERTH_OK,
                          berth_controller_step(&with_table, now_us, &measured, &command));
        TEST_ASSERT_EQUAL(BERTH_OK, berth_controller_step(&with_online, now_us, &measured, &other));
        TEST_ASSERT_EQUAL_MEMORY(&command, &other, sizeof command);
        if (k >= count - count / 4) {
            const distance_t now = distance(&pose, &table.samples[k]);
            worst.position_m = fmax(worst.position_m, now.position_m);
            worst.heading_rad = fmax(worst.heading_rad, now.heading_rad);
        }
        pose = support_move(pose, (double)command.twist.v_mps, (double)command.twist.omega_radps,
                            table.plan.period_us / 1.0e6);
    }
    return worst;
}

static void check_convergence(support_shape_t shape, uint32_t count, uint8_t discretization,
                              distance_t limit, const char *what) {
    support_random_start();
    support_plan(&online, shape, count, false);
    online.plan.mpc.discretization = discretization;
    support_plan(&table, shape, count, false);
    table.plan.mpc.discretization = discretization;
    support_fill_gains(&table);
    distance_t worst = {0.0, 0.0};
    for (uint32_t run = 0; run < support_runs(100); run++) {
        const distance_t now = run_both(random_start(&table));
        worst.position_m = fmax(worst.position_m, now.position_m);
        worst.heading_rad = fmax(worst.heading_rad, now.heading_rad);
    }
    printf("%s, last quarter: %.2e m, %.2e rad\n", what, worst.position_m, worst.heading_rad);
    TEST_ASSERT_TRUE(worst.position_m <= limit.position_m);
    TEST_ASSERT_TRUE(worst.heading_rad <= limit.heading_rad);
}

/* A circle's samples are joined by exact arcs of its held speeds: nothing but rounding is left. On
 * the figure eight v_r and omega_r change within a period in which the command is held, some
 * omegadot T^2 / 2 = 1e-4 rad a step, and the loop carries what adds up over its time constant. */
static const distance_t circle_limit = {1.0e-6, 2.0e-6};
static const distance_t eight_limit = {1.0e-3, 3.0e-3};

static void test_circle_converges_with_euler(void) {
    check_convergence(SUPPORT_CIRCLE, 600, BERTH_DISCRETIZATION_EULER, circle_limit,
                      "circle, euler");
}

static void test_circle_converges_with_zero_order_hold(void) {
    check_convergence(SUPPORT_CIRCLE, 600, BERTH_DISCRETIZATION_ZOH, circle_limit, "circle, zoh");
}

static void test_eight_converges_with_euler(void) {
    check_convergence(SUPPORT_EIGHT, 900, BERTH_DISCRETIZATION_EULER, eight_limit, "eight, euler");
}

static void test_eight_converges_with_zero_order_hold(void) {
    check_convergence(SUPPORT_EIGHT, 900, BERTH_DISCRETIZATION_ZOH, eight_limit, "eight, zoh");
}

/* After the end of an open plan the robot holds the last pose, whatever the gains come from. */
static void test_holds_the_last_pose(void) {
    support_plan(&online, SUPPORT_CIRCLE, 100, false);
    support_plan(&table, SUPPORT_CIRCLE, 100, false);
    support_fill_gains(&table);
    berth_controller_t with_table;
    berth_controller_t with_online;
    start(&with_table, &table);
    start(&with_online, &online);
    const berth_sample_t *last = &table.samples[99];
    support_pose_t pose = {(double)table.samples[0].x_m, (double)table.samples[0].y_m,
                           (double)table.samples[0].theta_rad};
    berth_command_t command = {0};
    for (uint32_t k = 0; k < 300; k++) {
        const berth_pose_t measured = support_measure(pose);
        berth_command_t other;
        const int64_t now_us = (int64_t)k * table.plan.period_us;
        TEST_ASSERT_EQUAL(BERTH_OK,
                          berth_controller_step(&with_table, now_us, &measured, &command));
        TEST_ASSERT_EQUAL(BERTH_OK, berth_controller_step(&with_online, now_us, &measured, &other));
        TEST_ASSERT_EQUAL_MEMORY(&command, &other, sizeof command);
        TEST_ASSERT_EQUAL(k >= 100, berth_controller_status(&with_table)->finished);
        pose = support_move(pose, (double)command.twist.v_mps, (double)command.twist.omega_radps,
                            table.plan.period_us / 1.0e6);
    }
    const distance_t off = distance(&pose, last);
    TEST_ASSERT_TRUE(off.position_m < 1.0e-3);
    TEST_ASSERT_TRUE(off.heading_rad < 1.0e-3);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-5f, 0.0f, command.twist.v_mps);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-5f, 0.0f, command.twist.omega_radps);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_error_against_double);
    RUN_TEST(test_error_by_hand);
    RUN_TEST(test_error_does_not_see_where_the_scene_lies);
    RUN_TEST(test_error_of_bad_input_is_nan);
    RUN_TEST(test_law_against_double);
    RUN_TEST(test_law_without_error_is_the_reference);
    RUN_TEST(test_law_steers_towards_the_reference);
    RUN_TEST(test_circle_converges_with_euler);
    RUN_TEST(test_circle_converges_with_zero_order_hold);
    RUN_TEST(test_eight_converges_with_euler);
    RUN_TEST(test_eight_converges_with_zero_order_hold);
    RUN_TEST(test_holds_the_last_pose);
    return UNITY_END();
}
