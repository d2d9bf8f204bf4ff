/* Whole runs: mirrored scenes give mirrored runs, seeds repeat, campaigns do not depend on their
 * threads, and without obstacles the robot gets to its path from anywhere near.
 */
#include "campaign.h"
#include "plant.h"
#include "support.h"

#include "unity.h"

#include "berth/riccati.h"

#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define ROWS_MAX 1000u
#define SEED 20240917u

typedef struct {
    run_row_t rows[ROWS_MAX];
    size_t count;
    run_summary_t summary;
} log_t;

static campaign_options_t options;
static run_plan_t plans[2]; /* circle, eight */
static log_t first, second;

/* The experiments of DESIGN's section 5, without their obstacles. */
static scenario_t base(shape_t shape) {
    scenario_t s = {.period_s = 0.05,
                    .duration_s = shape == SHAPE_CIRCLE ? 30.0 : 45.0,
                    .reference = {.shape = shape},
                    .robot = {.wheel_radius_m = 0.05,
                              .track_m = 0.30,
                              .v_max_mps = 0.8,
                              .omega_max_radps = 3.0},
                    .mpc = {.horizon = 20, .q = {10.0, 40.0, 1.0}, .r = {0.5, 0.1}},
                    .avoidance = {.strategy = "combined", .skirt_m = 0.02, .v_creep_mps = 0.05},
                    .plant = {.radius_scale = 1.0, .track_scale = 1.0}};
    return s;
}

static void use_drives_with_lag(scenario_t *s) {
    s->robot.v_max_mps = 0.6;
    s->plant.tau_s = 0.05;
    s->plant.a_max_mps2 = 3.0;
    s->plant.alpha_max_radps2 = 30.0;
}

static void use_noise(scenario_t *s) {
    s->plant.pose_noise_m = 0.003;
    s->plant.heading_noise_rad = 0.003;
}

static void use_strategy(const char *strategy) {
    (void)snprintf(options.circle.avoidance.strategy, sizeof options.circle.avoidance.strategy,
                   "%s", strategy);
    (void)snprintf(options.eight.avoidance.strategy, sizeof options.eight.avoidance.strategy, "%s",
                   strategy);
}

static void make_plan(const scenario_t *scenario, run_plan_t *plan) {
    scenario_error_t error = {""};
    TEST_ASSERT_TRUE_MESSAGE(run_plan_make(scenario, plan, &error), error.text);
}

void setUp(void) {
    options = (campaign_options_t){.runs = 1,
                                   .seed = SEED,
                                   .jobs = 1,
                                   .circle = base(SHAPE_CIRCLE),
                                   .eight = base(SHAPE_EIGHT)};
    make_plan(&options.circle, &plans[0]);
    make_plan(&options.eight, &plans[1]);
}

void tearDown(void) {
    run_plan_free(&plans[0]);
    run_plan_free(&plans[1]);
}

static void keep_row(void *context, const run_row_t *row) {
    log_t *log = context;
    TEST_ASSERT_LESS_THAN_size_t(ROWS_MAX, log->count);
    log->rows[log->count++] = *row;
}

static void run(const scenario_t *scenario, const run_plan_t *plan, uint64_t seed, log_t *log) {
    scenario_error_t error = {""};
    const run_sink_t sink = {keep_row, log};
    log->count = 0;
    const bool good = run_scenario(scenario, plan, seed, &sink, &log->summary, &error);
    TEST_ASSERT_TRUE_MESSAGE(good, error.text);
}

static void draw_scene(uint64_t seed, scenario_t *scene) {
    scenario_error_t error = {""};
    TEST_ASSERT_TRUE_MESSAGE(campaign_scene(&options, seed, scene, &error), error.text);
}

static const run_plan_t *plan_of(const scenario_t *scene) {
    return &plans[scene->reference.shape == SHAPE_CIRCLE ? 0 : 1];
}

static void mirror_scene(scenario_t *scene) {
    scene->start.y_m = -scene->start.y_m;
    scene->start.theta_rad = -scene->start.theta_rad;
    for (size_t i = 0; i < scene->obstacle_count; i++) {
        scene->obstacles[i].y_m = -scene->obstacles[i].y_m;
    }
}

/* The mirrored plan has its gains computed from its own samples. */
static void mirror_plan(const run_plan_t *plan, support_plan_t *mirrored) {
    TEST_ASSERT_LESS_OR_EQUAL_UINT32(SUPPORT_PLAN_MAX, plan->plan.count);
    mirrored->plan = plan->plan;
    for (uint32_t k = 0; k < plan->plan.count; k++) {
        mirrored->samples[k] = plan->plan.samples[k];
        mirrored->samples[k].y_m = -mirrored->samples[k].y_m;
        mirrored->samples[k].theta_rad = -mirrored->samples[k].theta_rad;
        mirrored->samples[k].omega_radps = -mirrored->samples[k].omega_radps;
    }
    mirrored->plan.samples = mirrored->samples;
    support_fill_gains(mirrored);
}

/* Exactly equal, but for the sign of a zero. */
static void expect_mirrored_row(const run_row_t *a, const run_row_t *b) {
    TEST_ASSERT_EQUAL_INT(a->mode, b->mode);
    TEST_ASSERT_TRUE(a->v_cmd_mps == b->v_cmd_mps);
    TEST_ASSERT_TRUE(a->omega_cmd_radps == -b->omega_cmd_radps);
    TEST_ASSERT_TRUE(a->x_m == b->x_m);
    TEST_ASSERT_TRUE(a->y_m == -b->y_m);
    TEST_ASSERT_TRUE(a->theta_rad == -b->theta_rad);
    TEST_ASSERT_TRUE(a->v_mps == b->v_mps);
    TEST_ASSERT_TRUE(a->omega_radps == -b->omega_radps);
    TEST_ASSERT_TRUE(a->clearance_m == b->clearance_m);
}

static void expect_mirrored_run(uint64_t seed) {
    static support_plan_t mirrored;
    scenario_t scene;
    draw_scene(seed, &scene);
    const run_plan_t *plan = plan_of(&scene);
    run(&scene, plan, seed, &first);
    mirror_plan(plan, &mirrored);
    const run_plan_t mirrored_plan = {.plan = mirrored.plan};
    mirror_scene(&scene);
    run(&scene, &mirrored_plan, seed, &second);
    TEST_ASSERT_EQUAL_size_t(first.count, second.count);
    for (size_t i = 0; i < first.count; i++) {
        expect_mirrored_row(&first.rows[i], &second.rows[i]);
    }
}

static void test_mirrored_scenes_give_mirrored_runs(void) {
    static const char *const strategies_of_berth[] = {"none", "conservative", "combined",
                                                      "kanayama_avoid"};
    const uint32_t runs = support_runs(200);
    uint32_t avoiding = 0;
    for (size_t i = 0; i < sizeof strategies_of_berth / sizeof strategies_of_berth[0]; i++) {
        use_strategy(strategies_of_berth[i]);
        for (uint32_t k = 0; k < runs; k++) {
            expect_mirrored_run(SEED + k);
            avoiding += first.summary.avoidance_time_s > 0.0;
        }
    }
    printf("seeds from %u: %u runs, %u with avoidance\n", SEED, 4 * runs, avoiding);
    TEST_ASSERT_GREATER_THAN_UINT32(2 * runs, avoiding);
}

static void test_mirrored_runs_of_drives_with_lag(void) {
    use_drives_with_lag(&options.circle);
    use_drives_with_lag(&options.eight);
    options.overlap = OVERLAP_DEMAND;
    for (uint32_t k = 0; k < support_runs(200); k++) {
        expect_mirrored_run(SEED + k);
    }
}

/* All but the padding about the mode. */
static bool same_row(const run_row_t *a, const run_row_t *b) {
    const size_t before = offsetof(run_row_t, mode);
    const size_t after = offsetof(run_row_t, e1_m);
    return memcmp(a, b, before) == 0 && a->mode == b->mode &&
           memcmp((const char *)a + after, (const char *)b + after, sizeof *a - after) == 0;
}

static bool same_log(const log_t *a, const log_t *b) {
    bool same = a->count == b->count;
    for (size_t i = 0; same && i < a->count; i++) {
        same = same_row(&a->rows[i], &b->rows[i]);
    }
    return same;
}

static void test_the_same_seed_gives_the_same_log(void) {
    static const char *const names[] = {"none",     "conservative", "combined",      "normal",
                                        "adaptive", "kanayama",     "kanayama_avoid"};
    use_drives_with_lag(&options.circle);
    use_drives_with_lag(&options.eight);
    use_noise(&options.circle);
    use_noise(&options.eight);
    for (size_t i = 0; i < sizeof names / sizeof names[0]; i++) {
        use_strategy(names[i]);
        for (uint64_t seed = SEED; seed < SEED + support_runs(20); seed++) {
            scenario_t scene;
            draw_scene(seed, &scene);
            run(&scene, plan_of(&scene), seed, &first);
            run(&scene, plan_of(&scene), seed, &second);
            TEST_ASSERT_TRUE(same_log(&first, &second));
            run(&scene, plan_of(&scene), seed + 1, &second);
            TEST_ASSERT_FALSE(same_log(&first, &second));
        }
    }
}

/* Without noise the seed of a run plays no part; that of the scene does. */
static void test_seeds_of_ideal_runs(void) {
    scenario_t scene;
    scenario_t other;
    draw_scene(SEED, &scene);
    run(&scene, plan_of(&scene), 1, &first);
    run(&scene, plan_of(&scene), 2, &second);
    TEST_ASSERT_TRUE(same_log(&first, &second));
    draw_scene(SEED + 1, &other);
    TEST_ASSERT_TRUE(scene.start.x_m != other.start.x_m);
    draw_scene(SEED, &other);
    TEST_ASSERT_TRUE(scene.start.x_m == other.start.x_m);
    TEST_ASSERT_EQUAL_size_t(scene.obstacle_count, other.obstacle_count);
    TEST_ASSERT_EQUAL_MEMORY(scene.obstacles, other.obstacles,
                             scene.obstacle_count * sizeof scene.obstacles[0]);
}

static campaign_result_t campaign(long runs, uint64_t seed, int jobs) {
    campaign_options_t chosen = options;
    scenario_error_t error = {""};
    campaign_result_t result;
    chosen.runs = runs;
    chosen.seed = seed;
    chosen.jobs = jobs;
    TEST_ASSERT_TRUE_MESSAGE(campaign_run(&chosen, NULL, NULL, &result, &error), error.text);
    return result;
}

static void expect_same_totals(const campaign_result_t *a, const campaign_result_t *b) {
    TEST_ASSERT_EQUAL_INT64(a->runs, b->runs);
    TEST_ASSERT_EQUAL_INT64(a->collisions, b->collisions);
    TEST_ASSERT_EQUAL_INT64(a->recovered, b->recovered);
    TEST_ASSERT_EQUAL_INT64(a->blocked, b->blocked);
    TEST_ASSERT_EQUAL_INT64(a->steps, b->steps);
    TEST_ASSERT_TRUE(a->worst_clearance_m == b->worst_clearance_m);
    for (int mode = 0; mode < RUN_MODES; mode++) {
        TEST_ASSERT_TRUE(a->mode_time_s[mode] == b->mode_time_s[mode]);
    }
    TEST_ASSERT_EQUAL_size_t(a->bad_count, b->bad_count);
    for (size_t i = 0; i < a->bad_count; i++) {
        TEST_ASSERT_EQUAL_UINT64(a->bad[i].seed, b->bad[i].seed);
        TEST_ASSERT_EQUAL_INT(a->bad[i].collided, b->bad[i].collided);
        TEST_ASSERT_EQUAL_INT(a->bad[i].unrecovered, b->bad[i].unrecovered);
        TEST_ASSERT_EQUAL_INT(a->bad[i].blocked, b->bad[i].blocked);
    }
}

/* With tracking alone many runs collide, so that there is a list of bad ones to compare. */
static void test_campaign_totals_do_not_depend_on_threads(void) {
    static const int jobs[] = {2, 3, 7};
    use_strategy("none");
    use_noise(&options.circle);
    use_noise(&options.eight);
    const long runs = (long)support_runs(500);
    campaign_result_t one = campaign(runs, SEED, 1);
    TEST_ASSERT_EQUAL_INT64(runs, one.runs);
    TEST_ASSERT_GREATER_THAN_size_t((size_t)runs / 10, one.bad_count);
    for (size_t i = 0; i < sizeof jobs / sizeof jobs[0]; i++) {
        campaign_result_t many = campaign(runs, SEED, jobs[i]);
        expect_same_totals(&one, &many);
        campaign_result_free(&many);
    }
    campaign_result_free(&one);
}

/* A campaign from seed s is the runs s, s + 1, ... one by one. */
static void test_each_run_of_a_campaign_stands_alone(void) {
    use_noise(&options.circle);
    use_noise(&options.eight);
    use_strategy("none");
    const long runs = (long)support_runs(40);
    campaign_result_t whole = campaign(runs, SEED, 2);
    campaign_result_t sum = {.runs = runs, .worst_clearance_m = HUGE_VAL};
    size_t bad = 0;
    for (long i = 0; i < runs; i++) {
        campaign_result_t one = campaign(1, SEED + (uint64_t)i, 1);
        sum.collisions += one.collisions;
        sum.recovered += one.recovered;
        sum.blocked += one.blocked;
        sum.steps += one.steps;
        sum.worst_clearance_m = fmin(sum.worst_clearance_m, one.worst_clearance_m);
        if (one.bad_count > 0) {
            TEST_ASSERT_LESS_THAN_size_t(whole.bad_count, bad);
            TEST_ASSERT_EQUAL_UINT64(SEED + (uint64_t)i, whole.bad[bad++].seed);
        }
        campaign_result_free(&one);
    }
    TEST_ASSERT_EQUAL_size_t(whole.bad_count, bad);
    TEST_ASSERT_EQUAL_INT64(whole.collisions, sum.collisions);
    TEST_ASSERT_EQUAL_INT64(whole.recovered, sum.recovered);
    TEST_ASSERT_EQUAL_INT64(whole.blocked, sum.blocked);
    TEST_ASSERT_EQUAL_INT64(whole.steps, sum.steps);
    TEST_ASSERT_TRUE(whole.worst_clearance_m == sum.worst_clearance_m);
    campaign_result_free(&whole);
}

/* What a campaign says of a run is what that run says of itself. */
static void test_campaign_of_one_agrees_with_the_run(void) {
    for (uint64_t seed = SEED; seed < SEED + support_runs(40); seed++) {
        scenario_t scene;
        campaign_result_t one = campaign(1, seed, 1);
        draw_scene(seed, &scene);
        run(&scene, plan_of(&scene), seed, &first);
        TEST_ASSERT_EQUAL_INT64(first.summary.collisions > 0, one.collisions);
        TEST_ASSERT_EQUAL_INT64(first.summary.final_position_error_m < RUN_RECOVERED_M,
                                one.recovered);
        TEST_ASSERT_EQUAL_INT64((int64_t)first.count, one.steps);
        TEST_ASSERT_TRUE(first.summary.min_clearance_m == one.worst_clearance_m);
        for (int mode = 0; mode < RUN_MODES; mode++) {
            TEST_ASSERT_DOUBLE_WITHIN(1.0e-9, first.summary.mode_time_s[mode],
                                      one.mode_time_s[mode]);
        }
        campaign_result_free(&one);
    }
}

/* The distribution of scenes, as far as it is promised. */
static void expect_scene_as_promised(const scenario_t *scene) {
    const size_t n = scene->obstacle_count;
    const berth_plan_t *plan = &plan_of(scene)->plan;
    const berth_sample_t *start = &plan->samples[0];
    const berth_sample_t *end = &plan->samples[plan->count - 1];
    TEST_ASSERT_TRUE(n == 1 || n == 3 || n == 6);
    for (size_t i = 0; i < n; i++) {
        const scenario_obstacle_t *o = &scene->obstacles[i];
        const double to_start = hypot(o->x_m - (double)start->x_m, o->y_m - (double)start->y_m);
        const double to_end = hypot(o->x_m - (double)end->x_m, o->y_m - (double)end->y_m);
        const double to_robot = hypot(o->x_m - scene->start.x_m, o->y_m - scene->start.y_m);
        TEST_ASSERT_TRUE(o->hard_m >= 0.05 && o->hard_m <= 0.25);
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, o->hard_m + 0.8 * 0.05 + 0.01, o->conservative_m);
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, o->conservative_m + 0.2, o->regulated_m);
        TEST_ASSERT_TRUE(to_start > o->hard_m + 0.5 - 1e-6);
        TEST_ASSERT_TRUE(to_end > o->hard_m + 0.4 - 1e-6);
        TEST_ASSERT_TRUE(to_robot > o->conservative_m);
    }
}

static bool conservative_circles_overlap(const scenario_t *scene) {
    for (size_t i = 0; i < scene->obstacle_count; i++) {
        for (size_t j = 0; j < i; j++) {
            const scenario_obstacle_t *a = &scene->obstacles[i];
            const scenario_obstacle_t *b = &scene->obstacles[j];
            if (hypot(a->x_m - b->x_m, a->y_m - b->y_m) < a->conservative_m + b->conservative_m) {
                return true;
            }
        }
    }
    return false;
}

static void test_scenes_are_drawn_as_promised(void) {
    static const campaign_overlap_t wishes[] = {OVERLAP_ANY, OVERLAP_DEMAND, OVERLAP_FORBID};
    const uint32_t runs = support_runs(3000);
    for (size_t i = 0; i < 3; i++) {
        uint32_t overlapping = 0;
        uint32_t eights = 0;
        options.overlap = wishes[i];
        for (uint32_t k = 0; k < runs; k++) {
            scenario_t scene;
            draw_scene(SEED + k, &scene);
            expect_scene_as_promised(&scene);
            overlapping += conservative_circles_overlap(&scene);
            eights += scene.reference.shape == SHAPE_EIGHT;
        }
        TEST_ASSERT_UINT32_WITHIN(runs / 10, runs / 2, eights);
        if (wishes[i] == OVERLAP_ANY) {
            TEST_ASSERT_UINT32_WITHIN(4 * runs / 10, runs / 2, overlapping);
        } else {
            TEST_ASSERT_EQUAL_UINT32(wishes[i] == OVERLAP_DEMAND ? runs : 0, overlapping);
        }
    }
}

/* From 100 random starts within 1 m and 1 rad the robot gets onto each path and stays there. */
static void test_convergence_without_obstacles(void) {
    double worst = 0.0;
    support_random_start();
    for (uint32_t i = 0; i < support_runs(100); i++) {
        for (int k = 0; k < 2; k++) {
            scenario_t scene = k == 0 ? options.circle : options.eight;
            const berth_sample_t *sample = &plans[k].plan.samples[0];
            const double distance = sqrt(support_uniform(0.0, 1.0));
            const double direction = support_uniform(-3.2, 3.2);
            scene.start.x_m = (double)sample->x_m + distance * cos(direction);
            scene.start.y_m = (double)sample->y_m + distance * sin(direction);
            scene.start.theta_rad = (double)sample->theta_rad + support_uniform(-1.0, 1.0);
            run(&scene, &plans[k], 0, &first);
            for (size_t row = first.count / 2; row < first.count; row++) {
                worst = fmax(worst, hypot(first.rows[row].e1_m, first.rows[row].e2_m));
            }
        }
    }
    printf("largest error in the second half of any run: %.3g m\n", worst);
    TEST_ASSERT_TRUE(worst < 1.0e-3);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_mirrored_scenes_give_mirrored_runs);
    RUN_TEST(test_mirrored_runs_of_drives_with_lag);
    RUN_TEST(test_the_same_seed_gives_the_same_log);
    RUN_TEST(test_seeds_of_ideal_runs);
    RUN_TEST(test_campaign_totals_do_not_depend_on_threads);
    RUN_TEST(test_each_run_of_a_campaign_stands_alone);
    RUN_TEST(test_campaign_of_one_agrees_with_the_run);
    RUN_TEST(test_scenes_are_drawn_as_promised);
    RUN_TEST(test_convergence_without_obstacles);
    return UNITY_END();
}
