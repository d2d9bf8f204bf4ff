/* Dead reckoning against exact arcs in double, and what fixes from outside do to it. */
#include "support.h"

#include "unity.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define RADIUS_M 0.05f
#define TRACK_M 0.3f

static const double pi = 3.14159265358979323846;
static const float not_finite[] = {NAN, -NAN, INFINITY, -INFINITY};
#define NOT_FINITE_COUNT (sizeof not_finite / sizeof not_finite[0])

static berth_odometry_config_t config;
static berth_odometry_t odometry;

void setUp(void) {
    berth_refusal_t refusal;
    config = (berth_odometry_config_t){RADIUS_M, TRACK_M, 0.25f, 0.5f, 0.5f};
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_odometry_init(&odometry, &config, &refusal));
}

void tearDown(void) {}

static void init(void) {
    berth_refusal_t refusal;
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_odometry_init(&odometry, &config, &refusal));
}

static void set(float x_m, float y_m, float theta_rad) {
    const berth_pose_t pose = {x_m, y_m, theta_rad};
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_odometry_set(&odometry, &pose, 0));
}

static void fix(float x_m, float y_m, float theta_rad, int64_t now_us) {
    const berth_pose_t pose = {x_m, y_m, theta_rad};
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_odometry_fix(&odometry, &pose, now_us));
}

/* Exact in double, from the wheels' travel as given. */
static support_pose_t exact_move(support_pose_t pose, float left_rad, float right_rad) {
    const double forward = 0.5 * (double)RADIUS_M * ((double)left_rad + (double)right_rad);
    const double turn = (double)RADIUS_M * ((double)right_rad - (double)left_rad) / (double)TRACK_M;
    return support_move(pose, forward, turn, 1.0);
}

static support_pose_t as_double(const berth_pose_t *pose) {
    return (support_pose_t){(double)pose->x_m, (double)pose->y_m, (double)pose->theta_rad};
}

static double position_error(support_pose_t exact) {
    return hypot((double)odometry.pose.x_m - exact.x_m, (double)odometry.pose.y_m - exact.y_m);
}

static double heading_error(support_pose_t exact) {
    return fabs(support_wrap((double)odometry.pose.theta_rad - exact.theta_rad));
}

static void expect_same_bits(float expected, float actual) {
    TEST_ASSERT_TRUE_MESSAGE(support_same_bits(expected, actual), "bits differ");
}

static void expect_wrapped(void) {
    TEST_ASSERT_TRUE(odometry.pose.theta_rad >= -3.1415926f &&
                     odometry.pose.theta_rad <= 3.1415926f);
}

/* What 100,000 steps of a few centimetres add up to. */
static void test_random_steps_against_exact_arcs(void) {
    support_random_start();
    set(0.0f, 0.0f, 0.0f);
    support_pose_t exact = {0.0, 0.0, 0.0};
    double worst_m = 0.0;
    double worst_rad = 0.0;
    double way_m = 0.0;
    const uint32_t steps = support_runs(100000);
    for (uint32_t i = 0; i < steps; i++) {
        const float left = (float)support_uniform(-0.4, 1.0);
        const float right = (float)support_uniform(-0.4, 1.0);
        exact = exact_move(exact, left, right);
        way_m += fabs(0.5 * (double)RADIUS_M * ((double)left + (double)right));
        berth_odometry_advance(&odometry, left, right);
        expect_wrapped();
        worst_m = fmax(worst_m, position_error(exact));
        worst_rad = fmax(worst_rad, heading_error(exact));
    }
    printf("%u steps, %.1f m: off by at most %.3g m and %.3g rad\n", (unsigned)steps, way_m,
           worst_m, worst_rad);
    TEST_ASSERT_DOUBLE_WITHIN(3.0e-7 * way_m, 0.0, worst_m);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-5, 0.0, worst_rad);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-2 + 1.0e-4 * way_m, way_m, (double)odometry.distance_m);
}

/* Steps from tiny to several turns: one step from a known pose is exact to float32's own grain. */
static void test_single_steps_of_any_size(void) {
    support_random_start();
    const uint32_t runs = support_runs(200000);
    double worst = 0.0;
    for (uint32_t i = 0; i < runs; i++) {
        const float forward = (float)support_log_uniform(1.0e-6, 300.0);
        const float turn = (float)support_log_uniform(1.0e-6, 60.0);
        const float sign = support_index(2) == 0 ? 1.0f : -1.0f;
        const float left = forward - sign * turn;
        const float right = forward + sign * turn;
        set(0.0f, 0.0f, (float)support_uniform(-3.14, 3.14));
        const support_pose_t exact = exact_move(as_double(&odometry.pose), left, right);
        berth_odometry_advance(&odometry, left, right);
        expect_wrapped();
        /* the turn of the arc is r (right - left) / b: its own rounding swings the chord */
        const double way = (double)RADIUS_M * fabs((double)forward);
        const double swing = (double)RADIUS_M * 2.0 * (double)turn / (double)TRACK_M;
        const double bound = way * (1.2e-6 + 2.0e-7 * swing) + 1.0e-9;
        worst = fmax(worst, position_error(exact) / bound);
        TEST_ASSERT_TRUE(position_error(exact) <= bound);
        TEST_ASSERT_TRUE(heading_error(exact) <=
                         1.0e-6 + (swing > pi ? 2.0e-6 : 0.0) + 2.0e-7 * swing);
    }
    printf("worst of %u steps: %.2f of the bound\n", (unsigned)runs, worst);
}

/* sin(h)/h must not cancel: an arc of a hair's curvature is as long as the straight line. */
static void test_chord_through_the_seam_of_series_and_sine(void) {
    for (int i = 1; i <= 4000; i++) {
        const float half = (float)i * 0.0005f; /* up to 2, across 1 */
        const float swing = half * TRACK_M / RADIUS_M;
        set(0.0f, 0.0f, -half); /* so that the chord lies on the x axis */
        berth_odometry_advance(&odometry, 20.0f - swing, 20.0f + swing);
        const double exact = sin((double)half) / (double)half;
        TEST_ASSERT_DOUBLE_WITHIN(1.0e-6, exact, (double)odometry.pose.x_m);
        TEST_ASSERT_DOUBLE_WITHIN(1.0e-6, 0.0, (double)odometry.pose.y_m);
    }
    const float tiny[] = {1.0e-3f, 1.0e-5f, 1.0e-8f, 1.0e-20f, 1.0e-38f, 1.0e-45f, 0.0f};
    for (uint32_t i = 0; i < sizeof tiny / sizeof tiny[0]; i++) {
        set(0.0f, 0.0f, 0.0f);
        berth_odometry_advance(&odometry, 20.0f - tiny[i], 20.0f + tiny[i]);
        TEST_ASSERT_DOUBLE_WITHIN(1.2e-7, 1.0, (double)odometry.pose.x_m);
    }
}

static void test_straight_line(void) {
    set(1.0f, -2.0f, 0.0f);
    for (int i = 0; i < 1000; i++) {
        berth_odometry_advance(&odometry, 0.25f, 0.25f);
    }
    TEST_ASSERT_DOUBLE_WITHIN(2.0e-6, 1.0 + 1000.0 * 0.25 * 0.05, (double)odometry.pose.x_m);
    expect_same_bits(-2.0f, odometry.pose.y_m);
    expect_same_bits(0.0f, odometry.pose.theta_rad);
    for (int i = 0; i < 1000; i++) {
        berth_odometry_advance(&odometry, -0.25f, -0.25f);
    }
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-6, 1.0, (double)odometry.pose.x_m);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-3, 25.0, (double)odometry.distance_m);
}

static void test_turn_on_the_spot(void) {
    set(3.0f, 4.0f, 0.5f);
    support_pose_t exact = {3.0, 4.0, 0.5};
    for (int i = 0; i < 5000; i++) {
        exact = exact_move(exact, -0.3f, 0.3f);
        berth_odometry_advance(&odometry, -0.3f, 0.3f);
        expect_wrapped();
    }
    expect_same_bits(3.0f, odometry.pose.x_m);
    expect_same_bits(4.0f, odometry.pose.y_m);
    expect_same_bits(0.0f, odometry.distance_m);
    TEST_ASSERT_DOUBLE_WITHIN(5000 * 6.0e-9 + 3.0e-7, 0.0, heading_error(exact));
}

/* Laps end where they began, and many laps as well as one. */
static void test_full_circles(void) {
    const uint32_t laps = 500;
    const uint32_t steps = 128;
    const double turn = 2.0 * pi / steps; /* of a step */
    const float swing = (float)(0.5 * turn * (double)TRACK_M / (double)RADIUS_M);
    const float left = 0.5f - swing;
    const float right = 0.5f + swing;
    set(2.0f, 1.0f, 0.0f);
    support_pose_t exact = {2.0, 1.0, 0.0};
    double worst_m = 0.0;
    for (uint32_t i = 0; i < laps * steps; i++) {
        exact = exact_move(exact, left, right);
        berth_odometry_advance(&odometry, left, right);
        worst_m = fmax(worst_m, position_error(exact));
    }
    printf("%u laps: off by at most %.3g m, %.3g rad at the end\n", (unsigned)laps, worst_m,
           heading_error(exact));
    /* each step's turn is rounded to float32, and always alike: 3e-8 of it */
    TEST_ASSERT_DOUBLE_WITHIN(6.0e-8 * 2.0 * pi * laps + 3.0e-7, 0.0, heading_error(exact));
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-4, 0.0, worst_m);
}

/* A square with turns on the spot, there and back. */
static void test_closed_loop(void) {
    const float quarter = (float)(0.25 * pi * (double)TRACK_M / (double)RADIUS_M / 100.0);
    set(0.0f, 0.0f, 0.0f);
    for (int side = 0; side < 4; side++) {
        for (int i = 0; i < 100; i++) {
            berth_odometry_advance(&odometry, 0.4f, 0.4f);
        }
        for (int i = 0; i < 100; i++) {
            berth_odometry_advance(&odometry, -quarter, quarter);
        }
    }
    TEST_ASSERT_DOUBLE_WITHIN(3.0e-6, 0.0, (double)odometry.pose.x_m);
    TEST_ASSERT_DOUBLE_WITHIN(3.0e-6, 0.0, (double)odometry.pose.y_m);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-6, 0.0, (double)odometry.pose.theta_rad);
}

/* Far out one step is below half the grain of a float32: a plain sum would not move at all. */
static void test_small_steps_far_from_the_origin(void) {
    const float step_rad = 0.0004f; /* 20 um; the grain at 900 m is 61 um */
    const int steps = 100000;
    float plain = 900.0f;
    set(900.0f, -900.0f, 0.0f);
    for (int i = 0; i < steps; i++) {
        plain += RADIUS_M * step_rad;
        berth_odometry_advance(&odometry, step_rad, step_rad);
    }
    const double exact = 900.0 + steps * (double)RADIUS_M * (double)step_rad;
    printf("2 m in steps of 20 um: off by %.3g m, plain sum by %.3g m\n",
           fabs((double)odometry.pose.x_m - exact), fabs((double)plain - exact));
    TEST_ASSERT_DOUBLE_WITHIN(4.0e-5, exact, (double)odometry.pose.x_m);
    TEST_ASSERT_TRUE(fabs((double)plain - exact) > 1.9);
}

static void test_mirrored_drive_gives_mirrored_bits(void) {
    support_random_start();
    berth_odometry_t mirrored = odometry;
    set(1.5f, 2.5f, 3.0f);
    const berth_pose_t start = {1.5f, -2.5f, -3.0f};
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_odometry_set(&mirrored, &start, 0));
    const uint32_t steps = support_runs(50000);
    for (uint32_t i = 0; i < steps; i++) {
        const float most = support_index(50) == 0 ? 100.0f : 0.5f;
        const float left = (float)support_uniform(-(double)most, (double)most);
        const float right = (float)support_uniform(-(double)most, (double)most);
        berth_odometry_advance(&odometry, left, right);
        berth_odometry_advance(&mirrored, right, left);
        if (support_index(20) == 0) {
            const berth_pose_t there = {odometry.pose.x_m + (float)support_uniform(-0.6, 0.6),
                                        odometry.pose.y_m + (float)support_uniform(-0.6, 0.6),
                                        (float)support_uniform(-10.0, 10.0)};
            const berth_pose_t mirror = {there.x_m, -there.y_m, -there.theta_rad};
            TEST_ASSERT_EQUAL_INT(berth_odometry_fix(&odometry, &there, i),
                                  berth_odometry_fix(&mirrored, &mirror, i));
        }
        expect_same_bits(odometry.pose.x_m, mirrored.pose.x_m);
        expect_same_bits(odometry.pose.y_m, -mirrored.pose.y_m);
        expect_same_bits(odometry.pose.theta_rad, -mirrored.pose.theta_rad);
    }
    TEST_ASSERT_GREATER_THAN_UINT32(0, odometry.jumps);
    TEST_ASSERT_GREATER_THAN_UINT32(odometry.jumps, odometry.fixes);
}

/* Every float around +-pi, reached by turning. */
static void test_heading_at_half_a_turn(void) {
    for (int i = -60; i <= 60; i++) {
        for (int j = 1; j <= 20; j++) {
            float edge = BERTH_PI;
            for (int k = 0; k < abs(i); k++) {
                edge = nextafterf(edge, i < 0 ? 0.0f : 10.0f);
            }
            const float start = 1.0f / (float)j;
            const float swing = 0.5f * (edge - start) * TRACK_M / RADIUS_M;
            set(0.0f, 0.0f, start);
            const support_pose_t exact = exact_move(as_double(&odometry.pose), -swing, swing);
            berth_odometry_advance(&odometry, -swing, swing);
            expect_wrapped();
            TEST_ASSERT_TRUE(heading_error(exact) <= 6.0e-7);
            set(0.0f, 0.0f, -start);
            berth_odometry_advance(&odometry, swing, -swing);
            expect_wrapped();
        }
    }
}

/* What the pose and its rest tell together is finer than the grain at pi, 2.4e-7, by far. */
static void test_headings_around_half_a_turn_keep_their_rest(void) {
    for (int j = 0; j < 40; j++) {
        const float start = 3.0f + 0.0035f * (float)j;
        float swing = 0.5f * (BERTH_PI - start) * TRACK_M / RADIUS_M;
        for (int k = 0; k < 60; k++) {
            swing = nextafterf(swing, 0.0f);
        }
        for (int k = 0; k < 120; k++) { /* from a little below pi to a little above */
            set(0.0f, 0.0f, start);
            const support_pose_t exact = exact_move(as_double(&odometry.pose), -swing, swing);
            berth_odometry_advance(&odometry, -swing, swing);
            expect_wrapped();
            const double told = (double)odometry.pose.theta_rad + (double)odometry.lost_theta_rad;
            TEST_ASSERT_DOUBLE_WITHIN(3.0e-8, 0.0, support_wrap(told - exact.theta_rad));
            swing = nextafterf(swing, 1.0f);
        }
    }
}

/* There and back again: nothing is lost, although the sum is first the smaller of the two. */
static void test_large_steps_from_small_sums(void) {
    for (int i = 1; i <= 100; i++) {
        const float tiny = 1.23456789e-6f * (float)i;
        set(tiny, tiny, 0.0f);
        berth_odometry_advance(&odometry, 20.0f, 20.0f);
        berth_odometry_advance(&odometry, -20.0f, -20.0f);
        TEST_ASSERT_DOUBLE_WITHIN(1.0e-11, (double)tiny,
                                  (double)odometry.pose.x_m + (double)odometry.lost_x_m);
        set(0.0f, 0.0f, tiny);
        berth_odometry_advance(&odometry, -3.0f, 3.0f);
        berth_odometry_advance(&odometry, 3.0f, -3.0f);
        TEST_ASSERT_DOUBLE_WITHIN(1.0e-11, (double)tiny,
                                  (double)odometry.pose.theta_rad +
                                      (double)odometry.lost_theta_rad);
    }
}

/* The rest counts as part of the pose when a fix is compared with it, and goes when it is set. */
static void test_fix_knows_the_rest_of_the_sums(void) {
    config.fix_gain = 1.0f;
    init();
    set(900.0f, 900.0f, 0.7853982f);
    berth_odometry_advance(&odometry, 0.0004f, 0.00041f);
    TEST_ASSERT_TRUE(odometry.lost_x_m != 0.0f && odometry.lost_y_m != 0.0f);
    TEST_ASSERT_TRUE(odometry.lost_theta_rad != 0.0f);
    const berth_pose_t there = odometry.pose;
    berth_odometry_t blended = odometry;
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_odometry_fix(&blended, &there, 1));
    expect_same_bits(there.x_m, blended.pose.x_m);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-11, 0.0, (double)blended.lost_x_m);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-11, 0.0, (double)blended.lost_y_m);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-12, 0.0, (double)blended.lost_theta_rad);
    set(1.0f, 2.0f, 3.0f);
    TEST_ASSERT_TRUE(odometry.lost_x_m == 0.0f && odometry.lost_y_m == 0.0f);
    TEST_ASSERT_TRUE(odometry.lost_theta_rad == 0.0f);
}

static void expect_travel_refused(float left_rad, float right_rad) {
    set(1.0f, 2.0f, 0.5f);
    const uint32_t refused = odometry.refused;
    berth_odometry_advance(&odometry, left_rad, right_rad);
    TEST_ASSERT_FALSE(odometry.known);
    TEST_ASSERT_EQUAL_UINT32(refused + 1, odometry.refused);
    expect_same_bits(1.0f, odometry.pose.x_m);
    expect_same_bits(2.0f, odometry.pose.y_m);
    expect_same_bits(0.5f, odometry.pose.theta_rad);
    berth_odometry_advance(&odometry, 0.1f, 0.1f); /* good travel does not make it known */
    TEST_ASSERT_FALSE(odometry.known);
    fix(100.0f, 100.0f, 1.0f, 1); /* a fix does, and is taken over, which is no jump */
    TEST_ASSERT_TRUE(odometry.known);
    expect_same_bits(100.0f, odometry.pose.x_m);
    TEST_ASSERT_EQUAL_UINT32(0, odometry.jumps);
}

static void test_travel_that_cannot_be(void) {
    for (uint32_t i = 0; i < NOT_FINITE_COUNT; i++) {
        expect_travel_refused(not_finite[i], 0.0f);
        expect_travel_refused(0.0f, not_finite[i]);
        expect_travel_refused(not_finite[i], not_finite[NOT_FINITE_COUNT - 1 - i]);
    }
    const float beyond = nextafterf(1.0e4f, INFINITY);
    expect_travel_refused(beyond, 0.0f);
    expect_travel_refused(0.0f, -beyond);
    expect_travel_refused(FLT_MAX, FLT_MAX);
    set(0.0f, 0.0f, 0.0f);
    berth_odometry_advance(&odometry, 1.0e4f, -1.0e4f);
    berth_odometry_advance(&odometry, -1.0e4f, -1.0e4f);
    TEST_ASSERT_TRUE(odometry.known);
    expect_wrapped();
    TEST_ASSERT_TRUE(isfinite(odometry.pose.x_m) && isfinite(odometry.pose.y_m));
}

static void test_nothing_is_known_at_first(void) {
    TEST_ASSERT_FALSE(odometry.known);
    TEST_ASSERT_EQUAL_INT64(INT64_MAX, berth_odometry_fix_age_us(&odometry, 0));
    TEST_ASSERT_EQUAL_INT64(INT64_MAX, berth_odometry_fix_age_us(&odometry, INT64_MAX));
    berth_odometry_advance(&odometry, 1.0f, 1.0f);
    TEST_ASSERT_FALSE(odometry.known);
    fix(500.0f, -300.0f, 7.0f, 1000);
    TEST_ASSERT_TRUE(odometry.known);
    expect_same_bits(500.0f, odometry.pose.x_m);
    expect_same_bits(-300.0f, odometry.pose.y_m);
    TEST_ASSERT_FLOAT_WITHIN(3.0e-6f, (float)(7.0 - 2.0 * pi), odometry.pose.theta_rad);
    expect_same_bits(0.0f, odometry.distance_m);
    TEST_ASSERT_EQUAL_UINT32(1, odometry.fixes);
    TEST_ASSERT_EQUAL_UINT32(0, odometry.jumps);
}

static void test_age_of_a_fix(void) {
    fix(0.0f, 0.0f, 0.0f, 1000000);
    TEST_ASSERT_EQUAL_INT64(0, berth_odometry_fix_age_us(&odometry, 1000000));
    TEST_ASSERT_EQUAL_INT64(250000, berth_odometry_fix_age_us(&odometry, 1250000));
    TEST_ASSERT_EQUAL_INT64(0, berth_odometry_fix_age_us(&odometry, 999999));
    TEST_ASSERT_EQUAL_INT64(0, berth_odometry_fix_age_us(&odometry, INT64_MIN));
    TEST_ASSERT_EQUAL_INT64(INT64_MAX - 1000000, berth_odometry_fix_age_us(&odometry, INT64_MAX));
    fix(0.0f, 0.0f, 0.0f, 2000000);
    TEST_ASSERT_EQUAL_INT64(5, berth_odometry_fix_age_us(&odometry, 2000005));
    const berth_pose_t bad = {NAN, 0.0f, 0.0f}; /* is no news */
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_POSE, berth_odometry_fix(&odometry, &bad, 3000000));
    TEST_ASSERT_EQUAL_INT64(1000000, berth_odometry_fix_age_us(&odometry, 3000000));
    fix(0.0f, 0.0f, 0.0f, -5); /* a fix before time began is still one */
    TEST_ASSERT_EQUAL_INT64(7, berth_odometry_fix_age_us(&odometry, 7));
    fix(0.0f, 0.0f, 0.0f, 0);
    TEST_ASSERT_EQUAL_INT64(7, berth_odometry_fix_age_us(&odometry, 7));
}

static void test_blending(void) {
    set(1.0f, 2.0f, 0.25f);
    berth_odometry_advance(&odometry, 0.0f, 0.0f);
    fix(1.4f, 1.8f, 0.05f, 10);
    TEST_ASSERT_FLOAT_WITHIN(3.0e-7f, 1.1f, odometry.pose.x_m);
    TEST_ASSERT_FLOAT_WITHIN(3.0e-7f, 1.95f, odometry.pose.y_m);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-7f, 0.2f, odometry.pose.theta_rad);
    TEST_ASSERT_EQUAL_UINT32(2, odometry.fixes);
    TEST_ASSERT_EQUAL_UINT32(0, odometry.jumps);
    TEST_ASSERT_EQUAL_INT64(10, odometry.fix_us);
    for (int i = 0; i < 100; i++) { /* the same fix again and again draws the pose to itself */
        fix(1.4f, 1.8f, 0.05f, 10 + i);
    }
    TEST_ASSERT_FLOAT_WITHIN(1.0e-6f, 1.4f, odometry.pose.x_m);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-6f, 1.8f, odometry.pose.y_m);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-6f, 0.05f, odometry.pose.theta_rad);
}

static void test_gain_of_one_takes_all(void) {
    config.fix_gain = 1.0f;
    config.fix_jump_m = 0.0f;
    config.fix_jump_rad = 0.0f;
    init();
    set(100.0f, -7.0f, 3.0f);
    fix(-300.5f, 8.25f, -3.0f, 10);
    TEST_ASSERT_FLOAT_WITHIN(4.0e-5f, -300.5f, odometry.pose.x_m);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-6f, 8.25f, odometry.pose.y_m);
    TEST_ASSERT_FLOAT_WITHIN(5.0e-7f, -3.0f, odometry.pose.theta_rad);
    TEST_ASSERT_EQUAL_UINT32(0, odometry.jumps); /* switched off */
}

/* Between 3 and -3 rad there are 0.283 rad, not 6. */
static void test_blending_across_half_a_turn(void) {
    static const float headings[][3] = {{3.0f, -3.0f, 3.0707963f},
                                        {-3.0f, 3.0f, -3.0707963f},
                                        {3.1f, -3.05f, -3.1499997f},
                                        {3.1415925f, -3.1415925f, 3.1415925f}};
    for (uint32_t i = 0; i < sizeof headings / sizeof headings[0]; i++) {
        set(0.0f, 0.0f, headings[i][0]);
        fix(0.0f, 0.0f, headings[i][1], 10);
        const double turn = support_wrap((double)headings[i][1] - (double)headings[i][0]);
        const double expected = (double)headings[i][0] + 0.25 * turn;
        TEST_ASSERT_TRUE(fabs(turn) < 0.5);
        TEST_ASSERT_DOUBLE_WITHIN(5.0e-7, 0.0,
                                  support_wrap((double)odometry.pose.theta_rad - expected));
        expect_wrapped();
        TEST_ASSERT_EQUAL_UINT32(0, odometry.jumps);
    }
    set(0.0f, 0.0f, 3.1f);
    fix(0.0f, 0.0f, -3.1f + 62.831853f, 10); /* ten turns further on */
    TEST_ASSERT_EQUAL_UINT32(0, odometry.jumps);
    TEST_ASSERT_FLOAT_WITHIN(5.0e-6f, 3.1207963f, odometry.pose.theta_rad);
}

static void test_jumps(void) {
    set(0.0f, 0.0f, 0.0f);
    fix(0.3f, 0.39f, 0.0f, 1); /* 0.492 m */
    TEST_ASSERT_EQUAL_UINT32(0, odometry.jumps);
    set(0.0f, 0.0f, 0.0f);
    fix(0.3f, 0.41f, 0.0f, 2); /* 0.508 m */
    TEST_ASSERT_EQUAL_UINT32(1, odometry.jumps);
    expect_same_bits(0.3f, odometry.pose.x_m);
    expect_same_bits(0.41f, odometry.pose.y_m);
    set(0.0f, 0.0f, 0.0f);
    fix(0.0f, 0.0f, 0.499f, 3);
    TEST_ASSERT_EQUAL_UINT32(1, odometry.jumps);
    set(0.0f, 0.0f, 0.0f);
    fix(0.1f, 0.0f, -0.501f, 4);
    TEST_ASSERT_EQUAL_UINT32(2, odometry.jumps);
    expect_same_bits(0.1f, odometry.pose.x_m);
    expect_same_bits(-0.501f, odometry.pose.theta_rad);
    set(0.0f, 0.0f, 3.0f);
    fix(0.0f, 0.0f, -2.7f, 5); /* 0.583 rad across half a turn */
    TEST_ASSERT_EQUAL_UINT32(3, odometry.jumps);
    set(0.0f, 0.0f, 0.0f); /* where somebody puts the robot is no jump */
    TEST_ASSERT_EQUAL_UINT32(3, odometry.jumps);
}

/* 0 switches one check off and leaves the other one. */
static void test_jumps_with_one_check_off(void) {
    odometry.config.fix_jump_rad = 0.0f;
    set(0.0f, 0.0f, 0.0f);
    fix(0.1f, 0.0f, 3.0f, 1);
    TEST_ASSERT_EQUAL_UINT32(0, odometry.jumps);
    fix(9.0f, 0.0f, 0.0f, 2);
    TEST_ASSERT_EQUAL_UINT32(1, odometry.jumps);
    init();
    odometry.config.fix_jump_m = 0.0f;
    set(0.0f, 0.0f, 0.0f);
    fix(900.0f, 0.0f, 0.4f, 3);
    TEST_ASSERT_EQUAL_UINT32(0, odometry.jumps);
    fix(0.0f, 0.0f, 3.0f, 4);
    TEST_ASSERT_EQUAL_UINT32(1, odometry.jumps);
}

static void expect_pose_refused(float x_m, float y_m, float theta_rad) {
    const berth_pose_t bad = {x_m, y_m, theta_rad};
    berth_odometry_t expected = odometry;
    expected.refused++;
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_POSE, berth_odometry_fix(&odometry, &bad, 99));
    TEST_ASSERT_EQUAL_MEMORY(&expected, &odometry, sizeof odometry);
    expected.refused++;
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_POSE, berth_odometry_set(&odometry, &bad, 99));
    TEST_ASSERT_EQUAL_MEMORY(&expected, &odometry, sizeof odometry);
}

static void expect_all_bad_refused(void) {
    for (uint32_t i = 0; i < NOT_FINITE_COUNT; i++) {
        expect_pose_refused(not_finite[i], 0.0f, 0.0f);
        expect_pose_refused(0.0f, not_finite[i], 0.0f);
        expect_pose_refused(0.0f, 0.0f, not_finite[i]);
    }
    const float beyond = nextafterf(BERTH_POSITION_MAX_M, INFINITY);
    expect_pose_refused(beyond, 0.0f, 0.0f);
    expect_pose_refused(0.0f, -beyond, 0.0f);
    expect_pose_refused(FLT_MAX, FLT_MAX, 0.0f);
}

static void test_refused_fixes_change_nothing(void) {
    expect_all_bad_refused();
    set(1.0f, 2.0f, 3.0f);
    berth_odometry_advance(&odometry, 0.1f, 0.2f);
    expect_all_bad_refused();
    TEST_ASSERT_TRUE(odometry.known);
    fix(BERTH_POSITION_MAX_M, -BERTH_POSITION_MAX_M, FLT_MAX, 1);
    TEST_ASSERT_EQUAL_UINT32(1, odometry.jumps);
    expect_wrapped();
}

static void test_configuration(void) {
    static const struct {
        berth_field_t field;
        size_t offset;
        float minimum, maximum;
        bool zero_allowed;
    } rules[] = {
        {BERTH_FIELD_WHEEL_RADIUS, offsetof(berth_odometry_config_t, wheel_radius_m), 0.001f, 10.0f,
         false},
        {BERTH_FIELD_TRACK, offsetof(berth_odometry_config_t, track_m), 0.01f, 10.0f, false},
        {BERTH_FIELD_FIX_GAIN, offsetof(berth_odometry_config_t, fix_gain), 0.001f, 1.0f, false},
        {BERTH_FIELD_FIX_JUMP_POSITION, offsetof(berth_odometry_config_t, fix_jump_m), 0.001f,
         1000.0f, true},
        {BERTH_FIELD_FIX_JUMP_HEADING, offsetof(berth_odometry_config_t, fix_jump_rad), 0.001f,
         BERTH_PI, true},
    };
    for (uint32_t i = 0; i < sizeof rules / sizeof rules[0]; i++) {
        const float values[] = {rules[i].minimum,
                                rules[i].maximum,
                                0.0f,
                                nextafterf(rules[i].minimum, -1.0f),
                                nextafterf(rules[i].maximum, INFINITY),
                                -1.0f,
                                NAN,
                                INFINITY};
        for (uint32_t j = 0; j < sizeof values / sizeof values[0]; j++) {
            berth_odometry_config_t tried = config;
            memcpy((char *)&tried + rules[i].offset, &values[j], sizeof values[j]);
            berth_refusal_t refusal = {.field = BERTH_FIELD_NONE};
            const bool good = j < 2 || (j == 2 && rules[i].zero_allowed);
            TEST_ASSERT_EQUAL_INT(good ? BERTH_OK : BERTH_ERROR_CONFIG,
                                  berth_odometry_init(&odometry, &tried, &refusal));
            TEST_ASSERT_EQUAL_INT(good ? BERTH_FIELD_NONE : rules[i].field, refusal.field);
            if (!good) {
                expect_same_bits(values[j], refusal.value);
                expect_same_bits(rules[i].minimum, refusal.minimum);
                expect_same_bits(rules[i].maximum, refusal.maximum);
            }
        }
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_random_steps_against_exact_arcs);
    RUN_TEST(test_single_steps_of_any_size);
    RUN_TEST(test_chord_through_the_seam_of_series_and_sine);
    RUN_TEST(test_straight_line);
    RUN_TEST(test_turn_on_the_spot);
    RUN_TEST(test_full_circles);
    RUN_TEST(test_closed_loop);
    RUN_TEST(test_small_steps_far_from_the_origin);
    RUN_TEST(test_mirrored_drive_gives_mirrored_bits);
    RUN_TEST(test_heading_at_half_a_turn);
    RUN_TEST(test_headings_around_half_a_turn_keep_their_rest);
    RUN_TEST(test_large_steps_from_small_sums);
    RUN_TEST(test_fix_knows_the_rest_of_the_sums);
    RUN_TEST(test_travel_that_cannot_be);
    RUN_TEST(test_nothing_is_known_at_first);
    RUN_TEST(test_age_of_a_fix);
    RUN_TEST(test_blending);
    RUN_TEST(test_gain_of_one_takes_all);
    RUN_TEST(test_blending_across_half_a_turn);
    RUN_TEST(test_jumps);
    RUN_TEST(test_jumps_with_one_check_off);
    RUN_TEST(test_refused_fixes_change_nothing);
    RUN_TEST(test_configuration);
    return UNITY_END();
}
