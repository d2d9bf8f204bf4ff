/* The simulated robot: arcs, clearances, drives and noise against independent mathematics. */
#include "plant.h"
#include "pose_delay.h"

#include "unity.h"

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define SEED 314159u
#define PERIOD_S 0.05
#define PI 3.14159265358979323846

void setUp(void) {}

void tearDown(void) {}

static int runs(int full) {
    const char *effort = getenv("BERTH_TEST_EFFORT");
    return effort != NULL && strcmp(effort, "short") == 0 ? full / 10 : full;
}

static scenario_t ideal_scenario(void) {
    scenario_t scenario = {.period_s = PERIOD_S};
    scenario.robot.track_m = 0.3;
    scenario.plant.radius_scale = 1.0;
    scenario.plant.track_scale = 1.0;
    return scenario;
}

static plant_t plant_of(const scenario_t *scenario, uint64_t seed) {
    plant_t plant;
    plant_init(&plant, scenario, seed);
    return plant;
}

/* A velocity of one of the kinds that need care: none, tiny, usual, large, of either sign. */
static double any_velocity(rng_t *rng, double usual, double large) {
    switch (rng_u64(rng) % 8) {
    case 0:
        return 0.0;
    case 1:
        return rng_uniform(rng, -1.0, 1.0) * 1.0e-7;
    case 2:
        return rng_uniform(rng, -1.0, 1.0) * 1.0e-14;
    case 3:
        return rng_uniform(rng, -large, large);
    default:
        return rng_uniform(rng, -usual, usual);
    }
}

#define RUNGE_KUTTA_STEPS 1000

/* Runge-Kutta of fourth order; theta is linear in time, so the middle slopes are one. */
static void integrate(double pose[3], double v, double omega, double t) {
    const double dt = t / RUNGE_KUTTA_STEPS;
    for (int i = 0; i < RUNGE_KUTTA_STEPS; i++) {
        const double a = pose[2];
        const double b = a + 0.5 * omega * dt;
        const double c = a + omega * dt;
        pose[0] += v * dt / 6.0 * (cos(a) + 4.0 * cos(b) + cos(c));
        pose[1] += v * dt / 6.0 * (sin(a) + 4.0 * sin(b) + sin(c));
        pose[2] = c;
    }
}

static void test_arcs_against_fine_integration(void) {
    const scenario_t scenario = ideal_scenario();
    plant_t plant = plant_of(&scenario, 0);
    rng_t rng;
    rng_seed(&rng, SEED);
    for (int i = 0; i < runs(2000); i++) {
        double pose[3] = {rng_uniform(&rng, -5.0, 5.0), rng_uniform(&rng, -5.0, 5.0),
                          rng_uniform(&rng, -PI, PI)};
        const double v = any_velocity(&rng, 1.0, 10.0);
        const double omega = any_velocity(&rng, 3.0, 40.0);
        const double t = rng_uniform(&rng, 0.01, 1.0);
        plant_set_pose(&plant, pose[0], pose[1], pose[2]);
        (void)plant_step(&plant, v, omega, t, NULL, 0);
        integrate(pose, v, omega, t);
        /* Simpson's rule is off by (omega dt)^4 / 2880 of the way */
        const double off = fabs(v * t) * pow(omega * t / RUNGE_KUTTA_STEPS, 4.0) / 2880.0;
        TEST_ASSERT_DOUBLE_WITHIN(off + 1.0e-12, pose[0], plant.x_m);
        TEST_ASSERT_DOUBLE_WITHIN(off + 1.0e-12, pose[1], plant.y_m);
        TEST_ASSERT_DOUBLE_WITHIN(1.0e-11, 0.0, remainder(pose[2] - plant.theta_rad, 2.0 * PI));
        TEST_ASSERT_TRUE(plant.theta_rad >= -PI && plant.theta_rad < PI);
        TEST_ASSERT_EQUAL_DOUBLE(v, plant.v_mps);
        TEST_ASSERT_EQUAL_DOUBLE(omega, plant.omega_radps);
    }
}

static void test_straight_and_on_the_spot_are_exact(void) {
    const scenario_t scenario = ideal_scenario();
    plant_t plant = plant_of(&scenario, 0);
    plant_set_pose(&plant, 1.0, -2.0, 0.0);
    (void)plant_step(&plant, 0.5, 0.0, 0.25, NULL, 0);
    TEST_ASSERT_EQUAL_DOUBLE(1.125, plant.x_m);
    TEST_ASSERT_EQUAL_DOUBLE(-2.0, plant.y_m);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, plant.theta_rad);
    (void)plant_step(&plant, 0.0, 4.0, 0.5, NULL, 0);
    TEST_ASSERT_EQUAL_DOUBLE(1.125, plant.x_m);
    TEST_ASSERT_EQUAL_DOUBLE(-2.0, plant.y_m);
    TEST_ASSERT_EQUAL_DOUBLE(2.0, plant.theta_rad);
    TEST_ASSERT_DOUBLE_WITHIN(4.0e-16, cos(2.0), plant.cosine);
    TEST_ASSERT_DOUBLE_WITHIN(4.0e-16, sin(2.0), plant.sine);
}

/* Hours on a circle: position, heading and the rotated direction all stay where they belong. */
static void test_long_runs_do_not_drift(void) {
    scenario_t scenario = ideal_scenario();
    scenario.start.x_m = 1.0;
    scenario.start.theta_rad = 0.5 * PI;
    plant_t plant = plant_of(&scenario, 0);
    const long steps = runs(4000000); /* 55 hours */
    const double turn = 0.3 * PERIOD_S;
    for (long i = 0; i < steps; i++) {
        (void)plant_step(&plant, 0.3, 0.3, PERIOD_S, NULL, 0);
    }
    const long double turns_rad = (long double)turn * steps;
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-8, (double)cosl(turns_rad), plant.x_m);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-8, (double)sinl(turns_rad), plant.y_m);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-12, cos(plant.theta_rad), plant.cosine);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-12, sin(plant.theta_rad), plant.sine);
}

/* Position on an arc from libm's sine, and its distance from a point. */
static double distance_at(const double arc[3], const double pose[3], const double point[2],
                          double t) {
    const double h = 0.5 * arc[1] * t;
    const double chord = arc[0] * t * (h != 0.0 ? sin(h) / h : 1.0);
    return hypot(pose[0] + chord * cos(pose[2] + h) - point[0],
                 pose[1] + chord * sin(pose[2] + h) - point[1]);
}

#define SAMPLES 400

/* Ternary search for the least distance between two times with one minimum between them. */
static double refine(const double arc[3], const double pose[3], const double point[2], double low,
                     double high) {
    for (int i = 0; i < 60; i++) {
        const double a = low + (high - low) / 3.0;
        const double b = high - (high - low) / 3.0;
        if (distance_at(arc, pose, point, a) < distance_at(arc, pose, point, b)) {
            high = b;
        } else {
            low = a;
        }
    }
    return distance_at(arc, pose, point, 0.5 * (low + high));
}

/* Least distance by sampling, and by a search about each sample that is less than its neighbours.
 */
static double sampled_distance(const double arc[3], const double pose[3], const double point[2]) {
    double d[SAMPLES + 1];
    double least = HUGE_VAL;
    for (int i = 0; i <= SAMPLES; i++) {
        d[i] = distance_at(arc, pose, point, arc[2] * i / SAMPLES);
        least = fmin(least, d[i]);
    }
    for (int i = 0; i <= SAMPLES; i++) {
        const int low = i > 0 ? i - 1 : 0;
        const int high = i < SAMPLES ? i + 1 : SAMPLES;
        /* on ways shorter than the tolerance the samples are all that there is to know */
        if (d[i] <= d[low] && d[i] <= d[high] && fabs(arc[0] * arc[2]) > 1.0e-9) {
            least = fmin(least,
                         refine(arc, pose, point, arc[2] * low / SAMPLES, arc[2] * high / SAMPLES));
        }
    }
    return least;
}

/* Anywhere about the arc, on it, or at the centre of its circle. */
static void any_point(rng_t *rng, const double arc[3], const double pose[3], double point[2]) {
    const uint64_t kind = rng_u64(rng) % 8;
    const double along = rng_uniform(rng, 0.0, 1.0) * arc[2];
    const double h = 0.5 * arc[1] * along;
    const double chord = arc[0] * along * (h != 0.0 ? sin(h) / h : 1.0);
    if (kind == 0) {
        point[0] = pose[0] + chord * cos(pose[2] + h);
        point[1] = pose[1] + chord * sin(pose[2] + h);
    } else if (kind == 1 && fabs(arc[1]) > 0.1) {
        point[0] = pose[0] - arc[0] / arc[1] * sin(pose[2]);
        point[1] = pose[1] + arc[0] / arc[1] * cos(pose[2]);
    } else {
        const double spread = kind == 2 ? 0.02 : 1.0;
        point[0] = pose[0] + rng_uniform(rng, -spread, spread);
        point[1] = pose[1] + rng_uniform(rng, -spread, spread);
    }
}

static void test_arc_distance_against_dense_sampling(void) {
    rng_t rng;
    rng_seed(&rng, SEED + 1);
    int whole_circles = 0;
    for (int i = 0; i < runs(10000); i++) {
        const double pose[3] = {rng_uniform(&rng, -2.0, 2.0), rng_uniform(&rng, -2.0, 2.0),
                                rng_uniform(&rng, -PI, PI)};
        const double arc[3] = {any_velocity(&rng, 1.0, 3.0), any_velocity(&rng, 3.0, 12.0),
                               rng_uniform(&rng, 0.01, 1.0)};
        double point[2];
        any_point(&rng, arc, pose, point);
        whole_circles += fabs(arc[1] * arc[2]) > 2.0 * PI ? 1 : 0;
        const double expected = sampled_distance(arc, pose, point);
        const double actual = plant_arc_distance(
            &(plant_arc_t){pose[0], pose[1], pose[2], arc[0], arc[1], arc[2]}, point[0], point[1]);
        TEST_ASSERT_DOUBLE_WITHIN(2.0e-9, expected, actual);
    }
    TEST_ASSERT_GREATER_THAN(10, whole_circles);
}

/* Radii of a kilometre and more must not cost digits. */
static void test_nearly_straight_arcs_lose_nothing(void) {
    for (int i = 3; i < 300; i += 3) {
        const double omega = pow(10.0, -i);
        const double actual =
            plant_arc_distance(&(plant_arc_t){0.0, 0.0, 0.0, 1.0, omega, 1.0}, 0.5, 0.01);
        /* the arc rises by omega / 8 at half its length */
        const double expected = 0.01 - 0.125 * omega;
        TEST_ASSERT_DOUBLE_WITHIN(omega * omega + 1.0e-17, expected, actual);
    }
}

static void test_clearance_without_discs_is_infinite(void) {
    const scenario_t scenario = ideal_scenario();
    plant_t plant = plant_of(&scenario, 0);
    TEST_ASSERT_TRUE(isinf(plant_step(&plant, 0.5, 1.0, PERIOD_S, NULL, 0)));
}

/* A step's clearance is the least over all discs, whichever are passed over on the way. */
static void test_step_clearance_is_the_least_of_all_discs(void) {
    const scenario_t scenario = ideal_scenario();
    plant_t plant = plant_of(&scenario, 0);
    rng_t rng;
    rng_seed(&rng, SEED + 2);
    plant_disc_t discs[6];
    for (int i = 0; i < runs(20000); i++) {
        const double span = i % 2 == 0 ? 3.0 : 0.3;
        for (int k = 0; k < 6; k++) {
            discs[k] = (plant_disc_t){plant.x_m + rng_uniform(&rng, -span, span),
                                      plant.y_m + rng_uniform(&rng, -span, span),
                                      rng_uniform(&rng, 0.05, 0.5)};
        }
        const double v = rng_uniform(&rng, -2.0, 2.0);
        const double omega = any_velocity(&rng, 4.0, 80.0);
        double expected = HUGE_VAL;
        for (int k = 0; k < 6; k++) {
            const double distance = plant_arc_distance(
                &(plant_arc_t){plant.x_m, plant.y_m, plant.theta_rad, v, omega, PERIOD_S},
                discs[k].x_m, discs[k].y_m);
            expected = fmin(expected, distance - discs[k].radius_m);
        }
        const double actual = plant_step(&plant, v, omega, PERIOD_S, discs, 6);
        TEST_ASSERT_DOUBLE_WITHIN(1.0e-12, expected, actual);
    }
}

/* With dynamics it is the least along the way too: no more than at either end, no
 * less than the length of the way allows. */
static void test_clearance_with_dynamics(void) {
    scenario_t scenario = ideal_scenario();
    scenario.plant.tau_s = 0.1;
    scenario.plant.a_max_mps2 = 2.0;
    rng_t rng;
    rng_seed(&rng, SEED + 3);
    plant_t plant = plant_of(&scenario, 0);
    for (int i = 0; i < runs(20000); i++) {
        const plant_disc_t disc = {plant.x_m + rng_uniform(&rng, -0.1, 0.1),
                                   plant.y_m + rng_uniform(&rng, -0.1, 0.1), 0.05};
        const double before = hypot(disc.x_m - plant.x_m, disc.y_m - plant.y_m) - 0.05;
        const double speed_before = fabs(plant.v_mps);
        const double clearance = plant_step(&plant, rng_uniform(&rng, -1.0, 1.0),
                                            rng_uniform(&rng, -3.0, 3.0), PERIOD_S, &disc, 1);
        const double after = hypot(disc.x_m - plant.x_m, disc.y_m - plant.y_m) - 0.05;
        const double way = fmax(speed_before, fabs(plant.v_mps)) * PERIOD_S;
        TEST_ASSERT_TRUE(clearance <= fmin(before, after) + 1.0e-12);
        /* nowhere on a way of this length can it be nearer than this */
        TEST_ASSERT_TRUE(clearance >= 0.5 * (before + after - way) - 1.0e-12);
    }
}

static void test_lag_follows_the_analytic_step_response(void) {
    scenario_t scenario = ideal_scenario();
    scenario.plant.tau_s = 0.08;
    plant_t plant = plant_of(&scenario, 0);
    for (int i = 1; i <= 40; i++) {
        (void)plant_step(&plant, 0.5, 0.0, PERIOD_S, NULL, 0);
        const double t = i * PERIOD_S;
        const double risen = 1.0 - exp(-t / 0.08);
        TEST_ASSERT_DOUBLE_WITHIN(1.0e-13, 0.5 * risen, plant.v_mps);
        TEST_ASSERT_EQUAL_DOUBLE(0.0, plant.omega_radps);
        /* the trapezoid's error: v dt^2 / (12 tau) with dt = 5 ms */
        const double bound = 1.01 * 0.5 * 0.005 * 0.005 / (12.0 * 0.08);
        TEST_ASSERT_DOUBLE_WITHIN(bound, 0.5 * (t - 0.08 * risen), plant.x_m);
    }
    plant = plant_of(&scenario, 0);
    for (int i = 1; i <= 40; i++) {
        (void)plant_step(&plant, 0.0, 2.0, PERIOD_S, NULL, 0);
        const double risen = 1.0 - exp(-i * PERIOD_S / 0.08);
        TEST_ASSERT_DOUBLE_WITHIN(1.0e-13, 2.0 * risen, plant.omega_radps);
    }
}

/* Full speed from standstill and back: the rims change by a_max T a period, no more, no less. */
static void test_rim_acceleration_is_bounded(void) {
    scenario_t scenario = ideal_scenario();
    scenario.plant.a_max_mps2 = 2.0;
    plant_t plant = plant_of(&scenario, 0);
    for (int i = 1; i <= 10; i++) {
        (void)plant_step(&plant, 5.0, 0.0, PERIOD_S, NULL, 0);
        TEST_ASSERT_DOUBLE_WITHIN(1.0e-12, 2.0 * PERIOD_S * i, plant.v_mps);
    }
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-12, 0.5 * 2.0 * 0.25, plant.x_m); /* a t^2 / 2 */
    for (int i = 1; i <= 10; i++) {
        (void)plant_step(&plant, 0.0, 0.0, PERIOD_S, NULL, 0);
    }
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-12, 0.0, plant.v_mps);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-12, 0.5, plant.x_m);
}

static void test_accelerations_stay_bounded_for_any_commands(void) {
    scenario_t scenario = ideal_scenario();
    scenario.plant = (scenario_plant_t){.tau_s = 0.03,
                                        .a_max_mps2 = 3.0,
                                        .alpha_max_radps2 = 8.0,
                                        .radius_scale = 1.1,
                                        .track_scale = 0.9};
    rng_t rng;
    rng_seed(&rng, SEED + 4);
    plant_t plant = plant_of(&scenario, 0);
    int rims_at_limit = 0;
    int turns_at_limit = 0;
    for (int i = 0; i < runs(50000); i++) {
        const plant_t before = plant;
        (void)plant_step(&plant, rng_uniform(&rng, -1.0, 1.0), rng_uniform(&rng, -4.0, 4.0),
                         PERIOD_S, NULL, 0);
        const double left = fabs(plant.left_mps - before.left_mps);
        const double right = fabs(plant.right_mps - before.right_mps);
        const double turn = fabs(plant.omega_radps - before.omega_radps);
        TEST_ASSERT_TRUE(fmax(left, right) <= 3.0 * PERIOD_S + 1.0e-12);
        TEST_ASSERT_TRUE(turn <= 8.0 * PERIOD_S + 1.0e-12);
        rims_at_limit += fmax(left, right) > 3.0 * PERIOD_S - 1.0e-9 ? 1 : 0;
        turns_at_limit += turn > 8.0 * PERIOD_S - 1.0e-9 ? 1 : 0;
    }
    TEST_ASSERT_GREATER_THAN(10, rims_at_limit);
    TEST_ASSERT_GREATER_THAN(10, turns_at_limit);
}

/* Where the yaw acceleration is what binds, the speed ahead changes as if it did not. */
static void test_yaw_limit_leaves_the_speed_alone(void) {
    scenario_t scenario = ideal_scenario();
    scenario.plant.tau_s = 0.1;
    plant_t free_plant = plant_of(&scenario, 0);
    scenario.plant.alpha_max_radps2 = 1.0;
    plant_t bound_plant = plant_of(&scenario, 0);
    for (int i = 1; i <= 5; i++) {
        (void)plant_step(&free_plant, 0.5, 3.0, PERIOD_S, NULL, 0);
        (void)plant_step(&bound_plant, 0.5, 3.0, PERIOD_S, NULL, 0);
        TEST_ASSERT_DOUBLE_WITHIN(1.0e-14, free_plant.v_mps, bound_plant.v_mps);
        TEST_ASSERT_DOUBLE_WITHIN(1.0e-13, 1.0 * PERIOD_S * i, bound_plant.omega_radps);
    }
}

static void test_scales_of_wheel_radius_and_track(void) {
    scenario_t scenario = ideal_scenario();
    scenario.plant.radius_scale = 1.2;
    scenario.plant.track_scale = 0.8;
    plant_t plant = plant_of(&scenario, 0);
    (void)plant_step(&plant, 0.5, 0.4, PERIOD_S, NULL, 0);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-15, 0.6, plant.v_mps);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-15, 0.6, plant.omega_radps);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-15, 0.03, plant.theta_rad);
    /* drives with lag come to the same velocities */
    scenario.plant.tau_s = 0.05;
    scenario.plant.a_max_mps2 = 3.0;
    plant = plant_of(&scenario, 0);
    for (int i = 0; i < 100; i++) {
        (void)plant_step(&plant, 0.5, 0.4, PERIOD_S, NULL, 0);
    }
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-13, 0.6, plant.v_mps);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-13, 0.6, plant.omega_radps);
}

static void check_same_bits(double a, double b) {
    TEST_ASSERT_EQUAL_MEMORY(&a, &b, sizeof a);
}

/* Adding 0 makes -0 into 0: a mirrored 0 may have either sign. */
static void check_mirrored(const plant_t *plant, const plant_t *mirrored) {
    check_same_bits(plant->x_m, mirrored->x_m);
    check_same_bits(0.0 + plant->y_m, 0.0 - mirrored->y_m);
    check_same_bits(0.0 + plant->theta_rad, 0.0 - mirrored->theta_rad);
    check_same_bits(plant->v_mps, mirrored->v_mps);
    check_same_bits(0.0 + plant->omega_radps, 0.0 - mirrored->omega_radps);
}

static void mirror_run(scenario_t *scenario, double omega_large, uint64_t seed) {
    rng_t rng;
    rng_seed(&rng, seed);
    scenario->start.x_m = 0.1;
    scenario->start.y_m = 0.2;
    scenario->start.theta_rad = 0.3;
    plant_t plant = plant_of(scenario, 0);
    scenario->start.y_m = -0.2;
    scenario->start.theta_rad = -0.3;
    plant_t mirrored = plant_of(scenario, 0);
    for (int i = 0; i < runs(20000); i++) {
        plant_disc_t discs[3];
        plant_disc_t mirrored_discs[3];
        for (int k = 0; k < 3; k++) {
            discs[k] = (plant_disc_t){plant.x_m + rng_uniform(&rng, -0.5, 0.5),
                                      plant.y_m + rng_uniform(&rng, -0.5, 0.5), 0.1};
            mirrored_discs[k] = discs[k];
            mirrored_discs[k].y_m = -discs[k].y_m;
        }
        const double v = any_velocity(&rng, 1.0, 3.0);
        const double omega = any_velocity(&rng, 3.0, omega_large);
        const double clearance = plant_step(&plant, v, omega, PERIOD_S, discs, 3);
        check_same_bits(clearance, plant_step(&mirrored, v, -omega, PERIOD_S, mirrored_discs, 3));
        check_mirrored(&plant, &mirrored);
    }
}

static void test_mirrored_commands_give_the_mirrored_motion(void) {
    scenario_t scenario = ideal_scenario();
    mirror_run(&scenario, 150.0, SEED + 5);
    scenario.plant.tau_s = 0.05;
    scenario.plant.a_max_mps2 = 3.0;
    scenario.plant.alpha_max_radps2 = 9.0;
    mirror_run(&scenario, 150.0, SEED + 6);
}

/* An ideal robot's wheels turn as told, whatever their true radius and track. */
static void test_ideal_wheels_turn_as_told(void) {
    const double radius_m = 0.05;
    rng_t rng;
    rng_seed(&rng, SEED);
    for (int i = 0; i < runs(100); i++) {
        scenario_t scenario = ideal_scenario();
        scenario.plant.radius_scale = rng_uniform(&rng, 0.5, 2.0);
        scenario.plant.track_scale = rng_uniform(&rng, 0.5, 2.0);
        plant_t plant = plant_of(&scenario, 0);
        double expected[2] = {0.0, 0.0};
        for (int k = 0; k < 200; k++) {
            const double left = any_velocity(&rng, 20.0, 100.0);
            const double right = any_velocity(&rng, 20.0, 100.0);
            const double t = rng_uniform(&rng, 0.0001, 0.05);
            plant_step(&plant, 0.5 * radius_m * (right + left),
                       radius_m * (right - left) / scenario.robot.track_m, t, NULL, 0);
            expected[0] += left * t;
            expected[1] += right * t;
        }
        double turned[2];
        plant_wheels(&plant, radius_m, &turned[0], &turned[1]);
        TEST_ASSERT_DOUBLE_WITHIN(1.0e-9, expected[0], turned[0]);
        TEST_ASSERT_DOUBLE_WITHIN(1.0e-9, expected[1], turned[1]);
    }
}

/* With dynamics, the wheels' travel is that of the body's motion, and a lag tau at constant speed
 * is w tau behind. */
static void test_lagging_wheels_fall_behind_by_the_lag(void) {
    scenario_t scenario = ideal_scenario();
    scenario.plant.tau_s = 0.1;
    plant_t plant = plant_of(&scenario, 0);
    for (int k = 0; k < 2000; k++) {
        plant_step(&plant, 0.2, 0.4, 0.001, NULL, 0);
    }
    double left = 0.0;
    double right = 0.0;
    plant_wheels(&plant, 0.05, &left, &right);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-4, (0.2 - 0.4 * 0.15) / 0.05 * (2.0 - 0.1), left);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-4, (0.2 + 0.4 * 0.15) / 0.05 * (2.0 - 0.1), right);
}

static void test_noise_has_the_deviation_asked_for(void) {
    scenario_t scenario = ideal_scenario();
    scenario.start.x_m = 1.0;
    scenario.start.y_m = -2.0;
    scenario.start.theta_rad = 0.5;
    scenario.plant.pose_noise_m = 0.003;
    scenario.plant.heading_noise_rad = 0.02;
    plant_t plant = plant_of(&scenario, SEED);
    const int count = runs(200000);
    double sums[3] = {0.0};
    double squares[3] = {0.0};
    double products = 0.0;
    for (int i = 0; i < count; i++) {
        const berth_pose_t pose = plant_measure(&plant);
        const double off[3] = {((double)pose.x_m - 1.0) / 0.003, ((double)pose.y_m + 2.0) / 0.003,
                               ((double)pose.theta_rad - 0.5) / 0.02};
        for (int k = 0; k < 3; k++) {
            sums[k] += off[k];
            squares[k] += off[k] * off[k];
        }
        products += off[0] * off[1];
    }
    for (int k = 0; k < 3; k++) {
        TEST_ASSERT_DOUBLE_WITHIN(5.0 / sqrt(count), 0.0, sums[k] / count);
        TEST_ASSERT_DOUBLE_WITHIN(5.0 * sqrt(2.0 / count), 1.0, squares[k] / count);
    }
    TEST_ASSERT_DOUBLE_WITHIN(5.0 / sqrt(count), 0.0, products / count);
    TEST_ASSERT_EQUAL_DOUBLE(1.0, plant.x_m); /* measuring does not move the robot */
}

static void test_noise_is_seeded_and_absent_when_off(void) {
    scenario_t scenario = ideal_scenario();
    scenario.plant.pose_noise_m = 0.01;
    plant_t a = plant_of(&scenario, 5);
    plant_t b = plant_of(&scenario, 5);
    plant_t c = plant_of(&scenario, 6);
    const berth_pose_t pose_a = plant_measure(&a);
    const berth_pose_t pose_b = plant_measure(&b);
    const berth_pose_t pose_c = plant_measure(&c);
    TEST_ASSERT_EQUAL_MEMORY(&pose_a, &pose_b, sizeof pose_a);
    TEST_ASSERT_TRUE(pose_a.x_m != pose_c.x_m);
    TEST_ASSERT_TRUE(pose_a.theta_rad == 0.0f); /* no noise on the heading was asked for */

    scenario.plant.pose_noise_m = 0.0;
    scenario.start.x_m = 0.1;
    scenario.start.theta_rad = -3.0;
    plant_t quiet = plant_of(&scenario, 5);
    const rng_t before = quiet.rng;
    const berth_pose_t pose = plant_measure(&quiet);
    TEST_ASSERT_EQUAL_MEMORY(before.state, quiet.rng.state, sizeof before.state);
    TEST_ASSERT_TRUE(pose.x_m == 0.1f && pose.y_m == 0.0f && pose.theta_rad == -3.0f);
}

/* Ground and rims of one wheel, from the body's velocities. */
static double wheel_mps(double v_mps, double omega_radps, double half_track_m) {
    return v_mps + half_track_m * omega_radps;
}

/* Each wheel's way over the ground is its rim's, more or less by up to the slip, to either end of
 * it, and even on average; it stays for its time, and the encoders see the rims alone. */
static void test_slip_is_between_rims_and_ground(void) {
    const double slip = 0.05;
    scenario_t scenario = ideal_scenario();
    scenario.plant.slip = slip;
    plant_t plant = plant_of(&scenario, SEED);
    double least[2] = {1.0, 1.0};
    double most[2] = {-1.0, -1.0};
    double sums[2] = {0.0, 0.0};
    const int count = runs(20000);
    const int hold = (int)lround(PLANT_SLIP_HOLD_S / PERIOD_S);
    double held[2] = {0.0, 0.0};
    for (int i = 0; i < count; i++) {
        (void)plant_step(&plant, 0.5, 0.4, PERIOD_S, NULL, 0);
        for (int side = 0; side < 2; side++) {
            const double half_m = side == 0 ? -0.15 : 0.15;
            const double rim = wheel_mps(0.5, 0.4, half_m);
            const double s = wheel_mps(plant.v_mps, plant.omega_radps, half_m) / rim - 1.0;
            if (i % hold != 0) {
                TEST_ASSERT_DOUBLE_WITHIN(1.0e-12, held[side], s);
            }
            held[side] = s;
            least[side] = fmin(least[side], s);
            most[side] = fmax(most[side], s);
            sums[side] += s;
        }
    }
    const double deviation = slip / sqrt(3.0) / sqrt((double)count / hold);
    for (int side = 0; side < 2; side++) {
        TEST_ASSERT_TRUE(least[side] >= -slip && least[side] < -0.99 * slip);
        TEST_ASSERT_TRUE(most[side] <= slip && most[side] > 0.99 * slip);
        TEST_ASSERT_DOUBLE_WITHIN(5.0 * deviation, 0.0, sums[side] / count);
    }
    double left = 0.0;
    double right = 0.0;
    plant_wheels(&plant, 0.05, &left, &right);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-6, (0.5 - 0.15 * 0.4) * PERIOD_S * count / 0.05, left);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-6, (0.5 + 0.15 * 0.4) * PERIOD_S * count / 0.05, right);
    plant_wheel_speeds(&plant, 0.05, &left, &right);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-12, (0.5 - 0.15 * 0.4) / 0.05, left);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-12, (0.5 + 0.15 * 0.4) / 0.05, right);
}

/* The motion is the arc of the ground's velocities, with dynamics as without. */
static void test_slip_moves_along_the_grounds_arc(void) {
    scenario_t scenario = ideal_scenario();
    scenario.plant.slip = 0.3;
    plant_t plant = plant_of(&scenario, SEED + 1);
    rng_t rng;
    rng_seed(&rng, SEED + 2);
    for (int i = 0; i < 100; i++) {
        double pose[3] = {plant.x_m, plant.y_m, plant.theta_rad};
        (void)plant_step(&plant, rng_uniform(&rng, -1.0, 1.0), rng_uniform(&rng, -3.0, 3.0),
                         PERIOD_S, NULL, 0);
        integrate(pose, plant.v_mps, plant.omega_radps, PERIOD_S);
        TEST_ASSERT_DOUBLE_WITHIN(1.0e-12, pose[0], plant.x_m);
        TEST_ASSERT_DOUBLE_WITHIN(1.0e-12, pose[1], plant.y_m);
        TEST_ASSERT_DOUBLE_WITHIN(1.0e-11, 0.0, remainder(pose[2] - plant.theta_rad, 2.0 * PI));
    }
    scenario.plant.tau_s = 0.02;
    plant = plant_of(&scenario, SEED + 1);
    for (int i = 0; i < 100; i++) { /* the lag has died out, the slip has not */
        (void)plant_step(&plant, 0.5, 0.0, PERIOD_S, NULL, 0);
    }
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-12, 0.5, plant.rim_mps);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-12, 0.5 * (1.0 + 0.5 * (plant.slips[0] + plant.slips[1])),
                              plant.v_mps);
    TEST_ASSERT_TRUE(plant.v_mps != plant.rim_mps);
}

static void test_without_slip_nothing_is_drawn(void) {
    const scenario_t scenario = ideal_scenario();
    plant_t plant = plant_of(&scenario, SEED);
    const rng_t before = plant.rng;
    (void)plant_step(&plant, 0.5, 1.0, PERIOD_S, NULL, 0);
    TEST_ASSERT_EQUAL_MEMORY(before.state, plant.rng.state, sizeof before.state);
    TEST_ASSERT_EQUAL_DOUBLE(0.5, plant.v_mps);
    TEST_ASSERT_EQUAL_DOUBLE(1.0, plant.omega_radps);
}

/* --- a pose that is late ------------------------------------------------------------------- */

static void test_late_pose_of_a_straight_way(void) {
    static const double delays_s[] = {0.0, 0.01, 0.05, 0.12, 0.15, 0.5};
    for (size_t d = 0; d < sizeof delays_s / sizeof delays_s[0]; d++) {
        scenario_t scenario = ideal_scenario();
        scenario.start.x_m = 1.0;
        scenario.plant.pose_delay_s = delays_s[d];
        plant_t plant = plant_of(&scenario, 0);
        pose_delay_t delay;
        pose_delay_init(&delay, &scenario);
        for (int i = 0; i < 1200; i++) {
            const double past_s = fmax(0.0, i * PERIOD_S - delays_s[d]);
            const berth_pose_t pose = pose_delay_measure(&delay, &plant);
            TEST_ASSERT_DOUBLE_WITHIN(1.0e-5, 1.0 + 0.5 * past_s, (double)pose.x_m);
            TEST_ASSERT_TRUE(pose.y_m == 0.0f && pose.theta_rad == 0.0f);
            (void)plant_step(&plant, 0.5, 0.0, PERIOD_S, NULL, 0);
        }
    }
}

/* Whole periods: the very pose of then. Parts of one: between two headings the short way round. */
static void test_late_pose_of_a_turn(void) {
    scenario_t scenario = ideal_scenario();
    scenario.plant.pose_delay_s = 3.0 * PERIOD_S;
    plant_t plant = plant_of(&scenario, 0);
    pose_delay_t whole;
    pose_delay_init(&whole, &scenario);
    scenario.plant.pose_delay_s = 0.5 * PERIOD_S;
    pose_delay_t half;
    pose_delay_init(&half, &scenario);
    berth_pose_t past[200];
    for (int i = 0; i < 200; i++) {
        past[i] = plant_measure(&plant);
        const berth_pose_t pose = pose_delay_measure(&whole, &plant);
        TEST_ASSERT_EQUAL_MEMORY(&past[i > 3 ? i - 3 : 0], &pose, sizeof pose);
        const berth_pose_t between = pose_delay_measure(&half, &plant);
        const double turned = i > 0 ? (i - 0.5) * 2.5 * PERIOD_S : 0.0;
        TEST_ASSERT_DOUBLE_WITHIN(1.0e-5, 0.0,
                                  remainder((double)between.theta_rad - turned, 2.0 * PI));
        TEST_ASSERT_TRUE(fabs((double)between.theta_rad) <= PI + 1.0e-6);
        (void)plant_step(&plant, 0.4, 2.5, PERIOD_S, NULL, 0);
    }
}

/* The longest delay at the shortest period has room. */
static void test_late_pose_has_room(void) {
    scenario_t scenario = ideal_scenario();
    scenario.period_s = 0.001;
    scenario.plant.pose_delay_s = POSE_DELAY_MAX_S - 1.0e-4;
    plant_t plant = plant_of(&scenario, 0);
    pose_delay_t delay;
    pose_delay_init(&delay, &scenario);
    for (int i = 0; i < 3000; i++) {
        const double past_s = fmax(0.0, i * 0.001 - scenario.plant.pose_delay_s);
        const berth_pose_t pose = pose_delay_measure(&delay, &plant);
        TEST_ASSERT_DOUBLE_WITHIN(1.0e-6, past_s, (double)pose.x_m);
        (void)plant_step(&plant, 1.0, 0.0, 0.001, NULL, 0);
    }
}

static void test_late_pose_has_noise(void) {
    scenario_t scenario = ideal_scenario();
    scenario.plant.pose_delay_s = 0.1;
    scenario.plant.pose_noise_m = 0.01;
    plant_t plant = plant_of(&scenario, 3);
    plant_t same = plant_of(&scenario, 3);
    pose_delay_t delay;
    pose_delay_init(&delay, &scenario);
    const berth_pose_t late = pose_delay_measure(&delay, &plant);
    const berth_pose_t now = plant_measure(&same); /* of a robot that has not moved */
    TEST_ASSERT_EQUAL_MEMORY(&now, &late, sizeof now);
    TEST_ASSERT_TRUE(late.x_m != 0.0f);
}

static double units_off(double expected, double actual) {
    const double magnitude = fabs(expected);
    return fabs(actual - expected) / (nextafter(magnitude, HUGE_VAL) - magnitude);
}

static void test_own_functions_against_libm(void) {
    rng_t rng;
    rng_seed(&rng, SEED + 7);
    for (int i = 0; i < runs(500000); i++) {
        const double x = rng_uniform(&rng, -1.0, 1.0) * pow(10.0, rng_uniform(&rng, -3.0, 5.0));
        double sine;
        double cosine;
        plant_sincos(x, &sine, &cosine);
        TEST_ASSERT_TRUE(units_off(sin(x), sine) <= 3.5 && units_off(cos(x), cosine) <= 3.5);
        TEST_ASSERT_DOUBLE_WITHIN(1.0e-10, 0.0, remainder(plant_wrap(x) - x, 2.0 * PI));
        TEST_ASSERT_TRUE(plant_wrap(x) >= -PI && plant_wrap(x) < PI);
        const double y = fabs(x);
        if (y < 708.0) {
            const double expected = exp(-y);
            TEST_ASSERT_DOUBLE_WITHIN(4.0e-16 * expected, expected, plant_exp_minus(y));
        }
    }
    TEST_ASSERT_EQUAL_DOUBLE(1.0, plant_exp_minus(0.0));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, plant_exp_minus(709.0));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, plant_exp_minus(1.0e300));
    check_same_bits(-PI, plant_wrap(PI));
    check_same_bits(-PI, plant_wrap(-PI));
}

int main(void) {
    printf("seed %u\n", SEED);
    UNITY_BEGIN();
    RUN_TEST(test_arcs_against_fine_integration);
    RUN_TEST(test_straight_and_on_the_spot_are_exact);
    RUN_TEST(test_long_runs_do_not_drift);
    RUN_TEST(test_arc_distance_against_dense_sampling);
    RUN_TEST(test_nearly_straight_arcs_lose_nothing);
    RUN_TEST(test_clearance_without_discs_is_infinite);
    RUN_TEST(test_step_clearance_is_the_least_of_all_discs);
    RUN_TEST(test_clearance_with_dynamics);
    RUN_TEST(test_lag_follows_the_analytic_step_response);
    RUN_TEST(test_rim_acceleration_is_bounded);
    RUN_TEST(test_accelerations_stay_bounded_for_any_commands);
    RUN_TEST(test_yaw_limit_leaves_the_speed_alone);
    RUN_TEST(test_scales_of_wheel_radius_and_track);
    RUN_TEST(test_mirrored_commands_give_the_mirrored_motion);
    RUN_TEST(test_ideal_wheels_turn_as_told);
    RUN_TEST(test_lagging_wheels_fall_behind_by_the_lag);
    RUN_TEST(test_noise_has_the_deviation_asked_for);
    RUN_TEST(test_noise_is_seeded_and_absent_when_off);
    RUN_TEST(test_slip_is_between_rims_and_ground);
    RUN_TEST(test_slip_moves_along_the_grounds_arc);
    RUN_TEST(test_without_slip_nothing_is_drawn);
    RUN_TEST(test_late_pose_of_a_straight_way);
    RUN_TEST(test_late_pose_of_a_turn);
    RUN_TEST(test_late_pose_has_room);
    RUN_TEST(test_late_pose_has_noise);
    RUN_TEST(test_own_functions_against_libm);
    return UNITY_END();
}
