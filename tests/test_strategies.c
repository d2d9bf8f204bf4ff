/* Each strategy shows the behaviour that defines it, in closed loop with the simulated robot. */
#include "strategy.h"

#include "plant.h"
#include "run.h"
#include "strategy_adaptive.h"
#include "strategy_common.h"

#include "unity.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define SEED 271828u
#define PERIOD_S 0.05
#define PI 3.14159265358979323846
#define ROWS_MAX 4000

/* What happened in one period. */
typedef struct {
    double x_m, y_m, theta_rad; /* at its start */
    double error_m;             /* distance from the reference, at its start */
    double clearance_m;         /* least during it */
    strategy_output_t output;
} row_t;

static row_t rows[ROWS_MAX];
static long row_count;
static strategy_adaptive_estimates_t estimates;
static run_plan_t plan;

void setUp(void) {
    row_count = 0;
    plan = (run_plan_t){.samples = NULL, .gains = NULL};
}

void tearDown(void) {
    run_plan_free(&plan);
}

/* The experiments' robot and weights, no obstacles, ideal drives, start on the path. */
static scenario_t scenario_of(shape_t shape, double duration_s) {
    scenario_t scenario = {
        .period_s = PERIOD_S,
        .duration_s = duration_s,
        .mpc = {.horizon = 20, .q = {10.0, 40.0, 1.0}, .r = {0.5, 0.1}},
    };
    scenario.reference.shape = shape;
    scenario.robot.wheel_radius_m = 0.05;
    scenario.robot.track_m = 0.3;
    scenario.robot.v_max_mps = 0.8;
    scenario.robot.omega_max_radps = 3.0;
    scenario.avoidance.skirt_m = 0.02;
    scenario.avoidance.v_creep_mps = 0.05;
    scenario.plant.radius_scale = 1.0;
    scenario.plant.track_scale = 1.0;
    scenario.start.x_m = shape == SHAPE_CIRCLE ? 1.0 : 0.0;
    scenario.start.theta_rad = shape == SHAPE_CIRCLE ? 0.5 * PI : atan2(0.36, 0.27);
    return scenario;
}

/* An obstacle at a direction on the unit circle, off it by a little; C = R + 0.1, G = R + 0.3. */
static void add_obstacle(scenario_t *scenario, double direction_rad, double distance_m,
                         double hard_m) {
    scenario->obstacles[scenario->obstacle_count++] = (scenario_obstacle_t){
        .x_m = distance_m * cos(direction_rad),
        .y_m = distance_m * sin(direction_rad),
        .hard_m = hard_m,
        .conservative_m = hard_m + 0.1,
        .regulated_m = hard_m + 0.3,
    };
}

/* Runs a strategy in closed loop and keeps every period in rows. */
static void run(const char *name, const scenario_t *scenario, uint64_t seed) {
    const strategy_t *strategy = strategy_find(name);
    TEST_ASSERT_NOT_NULL(strategy);
    scenario_error_t error = {.text = ""};
    run_plan_free(&plan);
    TEST_ASSERT_TRUE_MESSAGE(run_plan_make(scenario, &plan, &error), error.text);
    const strategy_scene_t scene = {scenario, &plan.plan};
    void *self = strategy->create(&scene, &error);
    TEST_ASSERT_NOT_NULL_MESSAGE(self, error.text);
    plant_disc_t discs[SCENARIO_OBSTACLES_MAX];
    for (size_t i = 0; i < scenario->obstacle_count; i++) {
        const scenario_obstacle_t *obstacle = &scenario->obstacles[i];
        discs[i] = (plant_disc_t){obstacle->x_m, obstacle->y_m, obstacle->hard_m};
    }
    plant_t plant;
    plant_init(&plant, scenario, seed);
    row_count = lround(scenario->duration_s / PERIOD_S);
    TEST_ASSERT_TRUE(row_count <= ROWS_MAX);
    for (long k = 0; k < row_count; k++) {
        row_t *row = &rows[k];
        const berth_sample_t sample = berth_plan_sample(&plan.plan, (uint32_t)k);
        *row = (row_t){.x_m = plant.x_m, .y_m = plant.y_m, .theta_rad = plant.theta_rad};
        row->error_m = hypot((double)sample.x_m - plant.x_m, (double)sample.y_m - plant.y_m);
        const berth_pose_t pose = plant_measure(&plant);
        strategy->step(self, k, &pose, &row->output);
        row->clearance_m = plant_step(&plant, row->output.v_mps, row->output.omega_radps, PERIOD_S,
                                      discs, scenario->obstacle_count);
    }
    if (strcmp(name, "adaptive") == 0) {
        estimates = strategy_adaptive_estimates(self);
    }
    strategy->destroy(self);
}

static double least_clearance(void) {
    double least = HUGE_VAL;
    for (long k = 0; k < row_count; k++) {
        least = fmin(least, rows[k].clearance_m);
    }
    return least;
}

/* Largest position error from a time on. */
static double peak_error_from(double time_s) {
    double peak = 0.0;
    for (long k = lround(time_s / PERIOD_S); k < row_count; k++) {
        peak = fmax(peak, rows[k].error_m);
    }
    return peak;
}

static long steps_in_mode(berth_mode_t mode) {
    long count = 0;
    for (long k = 0; k < row_count; k++) {
        count += rows[k].output.mode == mode ? 1 : 0;
    }
    return count;
}

static void check_limits(const scenario_t *scenario) {
    for (long k = 0; k < row_count; k++) {
        const strategy_output_t *output = &rows[k].output;
        TEST_ASSERT_TRUE(isfinite(output->v_mps) && isfinite(output->omega_radps));
        TEST_ASSERT_TRUE(fabs(output->v_mps) <= scenario->robot.v_max_mps + 1.0e-6);
        TEST_ASSERT_TRUE(fabs(output->omega_radps) <= scenario->robot.omega_max_radps + 1.0e-6);
    }
}

/* Registry */

static void test_registry_has_all_by_name(void) {
    static const char *const names[] = {"none",     "conservative", "combined",      "normal",
                                        "adaptive", "kanayama",     "kanayama_avoid"};
    size_t count = 0;
    while (strategies[count] != NULL) {
        TEST_ASSERT_TRUE(strlen(strategies[count]->summary) > 10);
        count++;
    }
    TEST_ASSERT_EQUAL_size_t(sizeof names / sizeof names[0], count);
    for (size_t i = 0; i < count; i++) {
        const strategy_t *strategy = strategy_find(names[i]);
        TEST_ASSERT_NOT_NULL(strategy);
        TEST_ASSERT_EQUAL_STRING(names[i], strategy->name);
    }
    TEST_ASSERT_NULL(strategy_find("None"));
    TEST_ASSERT_NULL(strategy_find(""));
}

static void test_all_track_both_shapes_without_obstacles(void) {
    for (size_t i = 0; strategies[i] != NULL; i++) {
        for (int shape = SHAPE_CIRCLE; shape <= SHAPE_EIGHT; shape++) {
            scenario_t scenario = scenario_of((shape_t)shape, 30.0);
            scenario.start.x_m -= 0.2;
            scenario.start.y_m -= 0.1;
            run(strategies[i]->name, &scenario, 0);
            check_limits(&scenario);
            TEST_ASSERT_TRUE_MESSAGE(peak_error_from(15.0) < 0.01, strategies[i]->name);
            TEST_ASSERT_EQUAL_INT(row_count, steps_in_mode(BERTH_MODE_TRACK));
        }
    }
}

static void test_same_seed_same_run(void) {
    static row_t first[ROWS_MAX];
    for (size_t i = 0; strategies[i] != NULL; i++) {
        scenario_t scenario = scenario_of(SHAPE_CIRCLE, 20.0);
        scenario.plant.pose_noise_m = 0.003;
        scenario.plant.heading_noise_rad = 0.01;
        add_obstacle(&scenario, 2.0, 1.02, 0.1);
        run(strategies[i]->name, &scenario, 7);
        memcpy(first, rows, (size_t)row_count * sizeof rows[0]);
        run(strategies[i]->name, &scenario, 7);
        for (long k = 0; k < row_count; k++) {
            TEST_ASSERT_EQUAL_DOUBLE(first[k].output.v_mps, rows[k].output.v_mps);
            TEST_ASSERT_EQUAL_DOUBLE(first[k].output.omega_radps, rows[k].output.omega_radps);
            TEST_ASSERT_EQUAL_DOUBLE(first[k].clearance_m, rows[k].clearance_m);
        }
        run(strategies[i]->name, &scenario, 8);
        TEST_ASSERT_TRUE(first[0].output.v_mps != rows[0].output.v_mps);
    }
}

/* After the end of an open plan each strategy stays at its last pose. */
static void test_all_stay_at_the_end_of_the_plan(void) {
    for (size_t i = 0; strategies[i] != NULL; i++) {
        const scenario_t scenario = scenario_of(SHAPE_CIRCLE, 5.0);
        scenario_error_t error = {.text = ""};
        run_plan_free(&plan);
        TEST_ASSERT_TRUE_MESSAGE(run_plan_make(&scenario, &plan, &error), error.text);
        const strategy_scene_t scene = {&scenario, &plan.plan};
        void *self = strategies[i]->create(&scene, &error);
        TEST_ASSERT_NOT_NULL_MESSAGE(self, error.text);
        plant_t plant;
        plant_init(&plant, &scenario, 0);
        strategy_output_t output = {.v_mps = 1.0};
        for (long k = 0; k < 400; k++) {
            const berth_pose_t pose = plant_measure(&plant);
            strategies[i]->step(self, k, &pose, &output);
            (void)plant_step(&plant, output.v_mps, output.omega_radps, PERIOD_S, NULL, 0);
        }
        strategies[i]->destroy(self);
        const berth_sample_t last = plan.samples[plan.plan.count - 1];
        TEST_ASSERT_DOUBLE_WITHIN_MESSAGE(0.02, (double)last.x_m, plant.x_m, strategies[i]->name);
        TEST_ASSERT_DOUBLE_WITHIN_MESSAGE(0.02, (double)last.y_m, plant.y_m, strategies[i]->name);
        TEST_ASSERT_DOUBLE_WITHIN_MESSAGE(0.01, 0.0, output.v_mps, strategies[i]->name);
        TEST_ASSERT_DOUBLE_WITHIN_MESSAGE(0.01, 0.0, output.omega_radps, strategies[i]->name);
    }
}

/* Refusals */

static void check_refused(const char *name, const scenario_t *scenario, const char *key) {
    scenario_error_t error = {.text = ""};
    const scenario_t good = scenario_of(SHAPE_CIRCLE, 5.0);
    run_plan_free(&plan);
    TEST_ASSERT_TRUE(run_plan_make(&good, &plan, &error));
    const strategy_scene_t scene = {scenario, &plan.plan};
    TEST_ASSERT_NULL_MESSAGE(strategy_find(name)->create(&scene, &error), name);
    TEST_ASSERT_NOT_NULL_MESSAGE(strstr(error.text, key), error.text);
    TEST_ASSERT_NOT_NULL_MESSAGE(strstr(error.text, "allowed: "), error.text);
}

static void test_refusals_name_the_key_and_the_range(void) {
    scenario_t scenario = scenario_of(SHAPE_CIRCLE, 5.0);
    scenario.robot.v_max_mps = -1.0;
    for (size_t i = 0; strategies[i] != NULL; i++) {
        check_refused(strategies[i]->name, &scenario, "robot.v_max_mps");
    }
    scenario = scenario_of(SHAPE_CIRCLE, 5.0);
    add_obstacle(&scenario, 0.0, 2.0, 0.1);
    add_obstacle(&scenario, 1.0, 2.0, 0.1);
    scenario.obstacles[1].conservative_m = 0.13; /* 0.03 is less than 0.8 m/s * 0.05 s */
    check_refused("combined", &scenario, "obstacles.1.conservative_m");
    check_refused("conservative", &scenario, "obstacles.1.conservative_m");
    check_refused("kanayama_avoid", &scenario, "obstacles.1.conservative_m");
    check_refused("kanayama_avoid", &scenario, "at least 0.04 m");
    scenario.obstacles[1].conservative_m = 0.2;
    scenario.obstacles[1].hard_m = (double)NAN;
    check_refused("kanayama_avoid", &scenario, "obstacles.1.hard_m");
    scenario = scenario_of(SHAPE_CIRCLE, 5.0);
    scenario.avoidance.v_creep_mps = 5.0;
    check_refused("kanayama_avoid", &scenario, "avoidance.v_creep_mps");
}

static void test_regulated_radius_covers_the_skirt(void) {
    scenario_t scenario = scenario_of(SHAPE_CIRCLE, 5.0);
    add_obstacle(&scenario, 0.0, 2.0, 0.1);
    scenario.obstacles[0].regulated_m = 0.21;
    const berth_obstacle_t obstacle = strategy_obstacle(&scenario, &scenario.obstacles[0]);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-7f, 0.22f, obstacle.regulated_m);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-7f, 0.2f, obstacle.conservative_m);
}

/* normal */

/* Direction of the obstacle off the heading. */
static double bearing(const scenario_obstacle_t *obstacle, const row_t *row) {
    const double direction = atan2(obstacle->y_m - row->y_m, obstacle->x_m - row->x_m);
    return remainder(direction - row->theta_rad, 2.0 * PI);
}

static double distance(const scenario_obstacle_t *obstacle, const row_t *row) {
    return hypot(obstacle->x_m - row->x_m, obstacle->y_m - row->y_m);
}

/* The first avoidance of the run: turn on the spot, then straight, from the first row of it. */
static void check_normal_manoeuvre(const scenario_t *scenario, long k) {
    const scenario_obstacle_t *obstacle = &scenario->obstacles[0];
    const double first = bearing(obstacle, &rows[k]);
    TEST_ASSERT_TRUE(distance(obstacle, &rows[k]) <= obstacle->conservative_m);
    TEST_ASSERT_TRUE(distance(obstacle, &rows[k - 1]) > obstacle->conservative_m);
    for (; rows[k].output.mode == BERTH_MODE_CONSERVATIVE_TURN; k++) {
        TEST_ASSERT_EQUAL_DOUBLE(0.0, rows[k].output.v_mps);
        /* the nearer side: away from the obstacle, so that its bearing grows */
        TEST_ASSERT_TRUE(rows[k].output.omega_radps * first <= 0.0);
    }
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_CONSERVATIVE_GO, rows[k].output.mode);
    TEST_ASSERT_DOUBLE_WITHIN(0.01, 0.5 * PI, fabs(bearing(obstacle, &rows[k])));
    TEST_ASSERT_TRUE(bearing(obstacle, &rows[k]) * first > 0.0);
    for (; rows[k].output.mode == BERTH_MODE_CONSERVATIVE_GO; k++) {
        TEST_ASSERT_EQUAL_DOUBLE(0.0, rows[k].output.omega_radps);
        TEST_ASSERT_DOUBLE_WITHIN(1.0e-6, 0.3, rows[k].output.v_mps); /* the circle's v_r */
        TEST_ASSERT_TRUE(distance(obstacle, &rows[k]) <= obstacle->conservative_m);
    }
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_TRACK, rows[k].output.mode);
    TEST_ASSERT_TRUE(distance(obstacle, &rows[k]) > obstacle->conservative_m);
}

/* One obstacle on the circle at 1.5 rad: the reference gets there after 5 s. */
static scenario_t scenario_with_one_in_the_way(void) {
    scenario_t scenario = scenario_of(SHAPE_CIRCLE, 15.0);
    add_obstacle(&scenario, 1.5, 1.02, 0.1);
    return scenario;
}

static long steps_standing(void) {
    long count = 0;
    for (long k = 0; k < row_count; k++) {
        count += fabs(rows[k].output.v_mps) < 1.0e-3 ? 1 : 0;
    }
    return count;
}

static void test_none_tracks_through_the_obstacle(void) {
    const scenario_t scenario = scenario_with_one_in_the_way();
    run("none", &scenario, SEED);
    TEST_ASSERT_EQUAL(row_count, steps_in_mode(BERTH_MODE_TRACK));
    TEST_ASSERT_TRUE(least_clearance() < -0.05);
    TEST_ASSERT_TRUE(peak_error_from(0.0) < 0.01);
}

/* Stands while it turns, then goes, and never regulates. */
static void test_conservative_turns_and_goes(void) {
    const scenario_t scenario = scenario_with_one_in_the_way();
    run("conservative", &scenario, SEED);
    TEST_ASSERT_TRUE(least_clearance() > 0.06); /* C - R - v_max T */
    TEST_ASSERT_TRUE(steps_in_mode(BERTH_MODE_CONSERVATIVE_TURN) > 0);
    TEST_ASSERT_TRUE(steps_in_mode(BERTH_MODE_CONSERVATIVE_GO) > 0);
    TEST_ASSERT_EQUAL(0, steps_in_mode(BERTH_MODE_REGULATED));
    for (long k = 0; k < row_count; k++) {
        const strategy_output_t *output = &rows[k].output;
        if (output->mode == BERTH_MODE_CONSERVATIVE_TURN) {
            TEST_ASSERT_TRUE(output->v_mps == 0.0 && output->omega_radps != 0.0);
        } else if (output->mode == BERTH_MODE_CONSERVATIVE_GO) {
            TEST_ASSERT_TRUE(output->v_mps >= 0.3 - 1.0e-6); /* the reference's speed */
        }
    }
    TEST_ASSERT_TRUE(peak_error_from(12.0) < 0.01);
}

/* Steers round on the skirt without standing, and acts before the conservative radius. */
static void test_combined_steers_round_without_standing(void) {
    const scenario_t scenario = scenario_with_one_in_the_way();
    run("combined", &scenario, SEED);
    TEST_ASSERT_TRUE(least_clearance() > 0.1); /* C - R: it does not enter C here */
    TEST_ASSERT_TRUE(least_clearance() < 0.13);
    TEST_ASSERT_TRUE(steps_in_mode(BERTH_MODE_REGULATED) > 0);
    TEST_ASSERT_EQUAL(0, steps_in_mode(BERTH_MODE_CONSERVATIVE_TURN));
    TEST_ASSERT_EQUAL(0, steps_standing());
    TEST_ASSERT_TRUE(peak_error_from(12.0) < 0.01);
}

static void test_normal_stops_turns_a_right_angle_and_drives_straight(void) {
    for (int outside = 0; outside < 2; outside++) {
        scenario_t scenario = scenario_of(SHAPE_CIRCLE, 20.0);
        add_obstacle(&scenario, 1.5, outside != 0 ? 1.05 : 0.95, 0.1);
        run("normal", &scenario, 0);
        check_limits(&scenario);
        long k = 0;
        while (k < row_count && rows[k].output.mode == BERTH_MODE_TRACK) {
            k++;
        }
        TEST_ASSERT_TRUE(k > 1 && k < row_count);
        check_normal_manoeuvre(&scenario, k);
        TEST_ASSERT_TRUE(least_clearance() > 0.1 - 0.8 * PERIOD_S);
        TEST_ASSERT_EQUAL_INT(0, steps_in_mode(BERTH_MODE_REGULATED));
        TEST_ASSERT_TRUE(peak_error_from(18.0) < 0.01); /* it is back on its path */
    }
}

/* Two conservative discs that overlap across the path: it never drives towards either. */
static void test_normal_keeps_clear_of_overlapping_obstacles(void) {
    scenario_t scenario = scenario_of(SHAPE_CIRCLE, 30.0);
    add_obstacle(&scenario, 1.5, 0.88, 0.1);
    add_obstacle(&scenario, 1.5, 1.12, 0.1);
    run("normal", &scenario, 0);
    TEST_ASSERT_TRUE(least_clearance() > 0.0);
    TEST_ASSERT_TRUE(steps_in_mode(BERTH_MODE_CONSERVATIVE_TURN) > 0);
}

/* kanayama */

static void test_kanayama_converges_from_many_starts(void) {
    rng_t rng;
    rng_seed(&rng, SEED);
    for (int i = 0; i < 40; i++) {
        const shape_t shape = i % 2 == 0 ? SHAPE_CIRCLE : SHAPE_EIGHT;
        scenario_t scenario = scenario_of(shape, 30.0);
        scenario.start.x_m += rng_uniform(&rng, -0.7, 0.7);
        scenario.start.y_m += rng_uniform(&rng, -0.7, 0.7);
        scenario.start.theta_rad += rng_uniform(&rng, -1.5, 1.5);
        run("kanayama", &scenario, 0);
        check_limits(&scenario);
        TEST_ASSERT_TRUE(peak_error_from(20.0) < 0.01);
    }
}

/* The law itself, on one pose: v_r cos e3 + kx e1 and omega_r + v_r (ky e2 + ktheta sin e3). */
static void test_kanayama_law(void) {
    scenario_t scenario = scenario_of(SHAPE_CIRCLE, PERIOD_S);
    scenario.start.x_m = 1.02;
    scenario.start.y_m = -0.03;
    scenario.start.theta_rad = 0.5 * PI - 0.1;
    run("kanayama", &scenario, 0);
    const double theta = scenario.start.theta_rad;
    const double e1 = cos(theta) * -0.02 + sin(theta) * 0.03;
    const double e2 = -sin(theta) * -0.02 + cos(theta) * 0.03;
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-5, 0.3 * cos(0.1) + 2.0 * e1, rows[0].output.v_mps);
    const double feedback = 0.3 * (10.0 * e2 + 2.0 * sqrt(10.0) * sin(0.1));
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-5, 0.3 + feedback, rows[0].output.omega_radps);
}

static void test_kanayama_avoid_keeps_clear_where_kanayama_collides(void) {
    scenario_t scenario = scenario_of(SHAPE_CIRCLE, 24.0);
    add_obstacle(&scenario, 1.5, 1.03, 0.1);
    add_obstacle(&scenario, 3.5, 0.96, 0.12);
    add_obstacle(&scenario, 5.5, 1.0, 0.15);
    run("kanayama", &scenario, 0);
    TEST_ASSERT_TRUE(least_clearance() < 0.0);
    TEST_ASSERT_EQUAL_INT(row_count, steps_in_mode(BERTH_MODE_TRACK));
    run("kanayama_avoid", &scenario, 0);
    check_limits(&scenario);
    TEST_ASSERT_TRUE(least_clearance() >= 0.0);
    TEST_ASSERT_TRUE(steps_in_mode(BERTH_MODE_REGULATED) > 10);
    TEST_ASSERT_TRUE(peak_error_from(23.0) < 0.05);
}

/* A metre behind the reference and heading for an obstacle, it wants more speed than it has: the
 * turn away from the obstacle must not be scaled down with it. */
static void test_kanayama_avoid_keeps_the_turn_at_the_speed_limit(void) {
    scenario_t scenario = scenario_of(SHAPE_CIRCLE, PERIOD_S);
    scenario.start.y_m = -1.0;
    add_obstacle(&scenario, 0.0, 1.0, 0.1);
    scenario.obstacles[0].y_m = -0.65;
    run("kanayama_avoid", &scenario, 0);
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_REGULATED, rows[0].output.mode);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-6, 0.8, rows[0].output.v_mps);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-6, 3.0, fabs(rows[0].output.omega_radps));
}

/* adaptive */

/* Wheels 15 % too large on a track 10 % too narrow, which the strategy is not told. */
static void learn(shape_t shape, double noise_m) {
    scenario_t scenario = scenario_of(shape, 120.0);
    scenario.start.x_m -= 0.15;
    scenario.start.y_m -= 0.15;
    scenario.plant.radius_scale = 1.15;
    scenario.plant.track_scale = 0.9;
    scenario.plant.pose_noise_m = noise_m;
    run("adaptive", &scenario, SEED);
    check_limits(&scenario);
    TEST_ASSERT_DOUBLE_WITHIN(0.02 * 1.15, 1.15, estimates.radius_scale);
    TEST_ASSERT_DOUBLE_WITHIN(0.02 * 0.9, 0.9, estimates.track_scale);
}

static void test_adaptive_learns_the_wheels_on_the_circle(void) {
    learn(SHAPE_CIRCLE, 0.0);
    TEST_ASSERT_TRUE(peak_error_from(60.0) < 0.001);
}

static void test_adaptive_learns_the_wheels_on_the_eight(void) {
    learn(SHAPE_EIGHT, 0.0);
    TEST_ASSERT_TRUE(peak_error_from(60.0) < 0.005);
}

static void test_adaptive_learns_with_noise_too(void) {
    learn(SHAPE_CIRCLE, 0.003);
    learn(SHAPE_EIGHT, 0.003);
    TEST_ASSERT_TRUE(peak_error_from(60.0) < 0.01);
}

/* With the truth known from the start the estimates stay there, but for the start's transient. */
static void test_adaptive_leaves_right_estimates_alone(void) {
    const scenario_t scenario = scenario_of(SHAPE_CIRCLE, 60.0);
    run("adaptive", &scenario, 0);
    TEST_ASSERT_DOUBLE_WITHIN(0.005, 1.0, estimates.radius_scale);
    TEST_ASSERT_DOUBLE_WITHIN(0.005, 1.0, estimates.track_scale);
    TEST_ASSERT_TRUE(peak_error_from(0.0) < 0.005);
}

/* Wheels far out of the range that estimates may take: they stay in it, and the robot moves on. */
static void test_adaptive_projects_its_estimates(void) {
    scenario_t scenario = scenario_of(SHAPE_CIRCLE, 60.0);
    scenario.plant.radius_scale = 0.4;
    run("adaptive", &scenario, 0);
    check_limits(&scenario);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-9, 0.5, estimates.radius_scale);
    TEST_ASSERT_TRUE(peak_error_from(30.0) < 0.1);
}

static void test_adaptive_potential_keeps_clear(void) {
    scenario_t scenario = scenario_of(SHAPE_CIRCLE, 24.0);
    add_obstacle(&scenario, 2.0, 1.05, 0.1);
    add_obstacle(&scenario, 4.5, 0.94, 0.12);
    run("none", &scenario, 0);
    TEST_ASSERT_TRUE(least_clearance() < 0.0);
    run("adaptive", &scenario, 0);
    check_limits(&scenario);
    TEST_ASSERT_TRUE(least_clearance() > 0.05);
    TEST_ASSERT_TRUE(steps_in_mode(BERTH_MODE_REGULATED) > 10);
    TEST_ASSERT_TRUE(peak_error_from(22.0) < 0.02);
}

/* On the hard radius, inside it and on the very centre the command is finite, within limits, and
 * off the centre it leads away. */
static void test_adaptive_is_finite_at_the_singularity(void) {
    static const double off[] = {0.0, 1.0e-12, 0.05, 0.1 - 1.0e-9, 0.1, 0.1 + 1.0e-9, 0.11, 0.39};
    for (size_t i = 0; i < sizeof off / sizeof off[0]; i++) {
        scenario_t scenario = scenario_of(SHAPE_CIRCLE, 1.0);
        add_obstacle(&scenario, 0.0, 1.0 + off[i], 0.1);
        scenario.start.theta_rad = 0.0;
        run("adaptive", &scenario, 0);
        check_limits(&scenario);
        if (i > 1 && i < 7) {
            TEST_ASSERT_TRUE(rows[0].output.v_mps < -0.5);
        }
    }
}

/* What the firmware demands of C - R with what it is told of a plant. */
static double demanded_m(const scenario_t *scenario) {
    const berth_config_t config = strategy_config(scenario);
    const uint32_t period_us = (uint32_t)lround(1.0e6 * scenario->period_s);
    berth_avoid_t avoid;
    berth_refusal_t refusal;
    TEST_ASSERT_EQUAL_INT(
        BERTH_OK, berth_avoid_init(&avoid, &config.avoid, &config.limits, period_us, &refusal));
    return (double)avoid.clearance_min_m;
}

/* Delays of drives, poses and watchdogs count alike, slip makes the robot faster, and of what the
 * plant demands beyond v_max T the firmware is told the part that it is to know. */
static void test_the_firmware_is_told_of_the_plant(void) {
    scenario_t scenario = scenario_of(SHAPE_EIGHT, 45.0);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-7, 0.8 * 0.05, demanded_m(&scenario));
    scenario.plant.tau_s = 0.03;
    scenario.plant.pose_delay_s = 0.07;
    scenario.plant.watchdog_s = 0.2;
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-7, 0.8 * 0.35, demanded_m(&scenario));
    scenario.plant.a_max_mps2 = 2.0;
    scenario.plant.slip = 0.1;
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-6, 1.1 * (0.8 * 0.35 + 0.16), demanded_m(&scenario));
    scenario.plant.pose_noise_m = 0.01;
    const double whole = 1.1 * (0.8 * 0.35 + 0.16) + 0.03;
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-6, whole, demanded_m(&scenario));
    for (int i = 0; i <= 10; i++) {
        scenario.plant.untold = 0.1 * i;
        const double told = 0.04 + (1.0 - 0.1 * i) * (whole - 0.04);
        TEST_ASSERT_DOUBLE_WITHIN(1.0e-6, told, demanded_m(&scenario));
        TEST_ASSERT_DOUBLE_WITHIN(1.0e-6, told, strategy_clearance_told(&scenario));
        TEST_ASSERT_DOUBLE_WITHIN(1.0e-12, whole, strategy_clearance(&scenario));
    }
    scenario.plant.untold = 0.9999; /* braking beyond what the firmware takes: told as none */
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-4, 0.04, demanded_m(&scenario));
}

int main(void) {
    printf("seed %u\n", SEED);
    UNITY_BEGIN();
    RUN_TEST(test_registry_has_all_by_name);
    RUN_TEST(test_all_track_both_shapes_without_obstacles);
    RUN_TEST(test_same_seed_same_run);
    RUN_TEST(test_all_stay_at_the_end_of_the_plan);
    RUN_TEST(test_refusals_name_the_key_and_the_range);
    RUN_TEST(test_regulated_radius_covers_the_skirt);
    RUN_TEST(test_none_tracks_through_the_obstacle);
    RUN_TEST(test_conservative_turns_and_goes);
    RUN_TEST(test_combined_steers_round_without_standing);
    RUN_TEST(test_normal_stops_turns_a_right_angle_and_drives_straight);
    RUN_TEST(test_normal_keeps_clear_of_overlapping_obstacles);
    RUN_TEST(test_kanayama_converges_from_many_starts);
    RUN_TEST(test_kanayama_law);
    RUN_TEST(test_kanayama_avoid_keeps_clear_where_kanayama_collides);
    RUN_TEST(test_kanayama_avoid_keeps_the_turn_at_the_speed_limit);
    RUN_TEST(test_the_firmware_is_told_of_the_plant);
    RUN_TEST(test_adaptive_learns_the_wheels_on_the_circle);
    RUN_TEST(test_adaptive_learns_the_wheels_on_the_eight);
    RUN_TEST(test_adaptive_learns_with_noise_too);
    RUN_TEST(test_adaptive_leaves_right_estimates_alone);
    RUN_TEST(test_adaptive_projects_its_estimates);
    RUN_TEST(test_adaptive_potential_keeps_clear);
    RUN_TEST(test_adaptive_is_finite_at_the_singularity);
    return UNITY_END();
}
