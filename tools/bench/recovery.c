/* How soon the robot is back on its path after obstacles, in random scenes on closed laps.
 *
 *     bench_recovery SHAPE OBSTACLES TAU RULE SEED RUNS    one line of CSV for each encounter
 *     bench_recovery SHAPE OBSTACLES TAU RULE SEED trace   one run, a line for each period
 *
 * SHAPE: circle or eight. OBSTACLES: 1 or 3, spread over the lap, with R from 0.2 to 0.4 m, C = R +
 * 0.2 m and G = C + 0.2 m, so that three fill most of a lap. TAU: lag of the drives in seconds;
 * they accelerate with at most 2 m/s2, and the pose is measured with 3 mm and 3 mrad of noise.
 * RULE:
 *
 *     paced     avoidance as it is
 *     plain     without pace (avoidance.paced)
 *     before    without pace, and with a firmware that is told nothing of the drives
 * (plant.untold): turns end within a period, as they did before avoidance reckoned with the delay.
 * The braking cap that goes with it acts nowhere in these scenes
 *
 * Run i is drawn from SEED + i. A lap is gone round LAPS times and once more: encounters that begin
 * in the last lap do not count, so that each that counts has the time to end. An encounter lasts
 * while the robot is within some regulated radius (which it leaves by 10 cm), and is one when
 * avoidance acts in it. Its columns, times in seconds:
 *
 *  - seed, and begin: of avoidance's first action
 *  - avoiding: from there to the end of its last
 *  - recovery: from there until the position error is below 5 cm for good, or till avoidance acts
 *    the next time; nan when that comes first
 *  - regulated, turning, going, blocked: modes, until the next encounter
 *  - behind: standing although the reference is ahead of the robot
 *  - distance driven, m, and largest position error, m
 *  - collided: 1 when the run had collided by then
 *  - RMS of the whole run's position error, m
 */
#include "reference_source.h"
#include "rng.h"
#include "run.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define LAPS 4
#define OBSTACLES_MAX 3
#define ENCOUNTERS_MAX 256
#define LEAVE_M 0.10
#define STANDING_MPS 1.0e-3

typedef struct {
    double begin_s, end_s, far_s; /* far_s: end of the last period with an error of 5 cm or more */
    double next_s;                /* avoidance acts again, or the run ends */
    double mode_s[RUN_MODES];
    double behind_s, distance_m, peak_m;
    bool collided;
} encounter_t;

typedef struct {
    const scenario_t *scene;
    bool inside, acted, collided;
    encounter_t encounters[ENCOUNTERS_MAX];
    size_t count;
} watch_t;

static bool is_inside(const watch_t *watch, const run_row_t *row) {
    for (size_t i = 0; i < watch->scene->obstacle_count; i++) {
        const scenario_obstacle_t *o = &watch->scene->obstacles[i];
        const double reach_m = o->regulated_m + (watch->inside ? LEAVE_M : 0.0);
        if (hypot(o->x_m - row->x_m, o->y_m - row->y_m) <= reach_m) {
            return true;
        }
    }
    return false;
}

static void begin_encounter(watch_t *watch, const run_row_t *row) {
    if (watch->count == ENCOUNTERS_MAX) {
        (void)fprintf(stderr, "bench_recovery: too many encounters\n");
        exit(1);
    }
    if (watch->count > 0) {
        watch->encounters[watch->count - 1].next_s = row->t_s;
    }
    watch->encounters[watch->count] = (encounter_t){.begin_s = row->t_s};
    watch->count++;
    watch->acted = true;
}

/* Along the reference's heading. */
static bool is_behind(const run_row_t *row) {
    return cos(row->theta_r_rad) * (row->x_r_m - row->x_m) +
               sin(row->theta_r_rad) * (row->y_r_m - row->y_m) >
           0.0;
}

static void watch_row(void *context, const run_row_t *row) {
    watch_t *watch = context;
    const double period_s = watch->scene->period_s;
    const double error_m = hypot(row->e1_m, row->e2_m);
    /* noise lets the firmware see an obstacle from a little outside */
    watch->inside = is_inside(watch, row) || row->mode != BERTH_MODE_TRACK;
    watch->acted = watch->acted && watch->inside;
    watch->collided = watch->collided || row->clearance_m < 0.0;
    if (row->mode != BERTH_MODE_TRACK && !watch->acted) {
        begin_encounter(watch, row);
    }
    if (watch->count == 0) {
        return;
    }
    encounter_t *encounter = &watch->encounters[watch->count - 1];
    if (row->mode != BERTH_MODE_TRACK) {
        encounter->end_s = row->t_s + period_s;
    }
    if (error_m >= RUN_RECOVERED_M) {
        encounter->far_s = row->t_s + period_s;
    }
    if (row->v_cmd_mps < STANDING_MPS && is_behind(row) && error_m >= RUN_RECOVERED_M) {
        encounter->behind_s += period_s;
    }
    encounter->mode_s[row->mode] += period_s;
    encounter->peak_m = fmax(encounter->peak_m, error_m);
    if (error_m >= RUN_RECOVERED_M || row->mode != BERTH_MODE_TRACK) {
        encounter->distance_m += fabs(row->v_mps) * period_s;
    }
    encounter->collided = watch->collided;
}

static void print_encounters(const watch_t *watch, uint64_t seed, double until_s, double rms_m) {
    for (size_t i = 0; i < watch->count; i++) {
        const encounter_t *e = &watch->encounters[i];
        const double back_s = fmax(e->far_s, e->end_s);
        if (e->begin_s >= until_s) {
            continue;
        }
        const bool never = back_s > e->next_s - 0.5 * watch->scene->period_s;
        printf("%llu,%.2f,%.2f,%.2f,%.2f,%.2f,%.2f,%.2f,%.2f,%.3f,%.3f,%d,%.4f\n",
               (unsigned long long)seed, e->begin_s, e->end_s - e->begin_s,
               never ? (double)NAN : back_s - e->end_s, e->mode_s[BERTH_MODE_REGULATED],
               e->mode_s[BERTH_MODE_CONSERVATIVE_TURN], e->mode_s[BERTH_MODE_CONSERVATIVE_GO],
               e->mode_s[BERTH_MODE_BLOCKED], e->behind_s, e->distance_m, e->peak_m, e->collided,
               rms_m);
    }
}

/* One of three places on the lap, not at its start. */
static void draw_obstacle(scenario_t *scene, rng_t *rng, double lap_s, double at) {
    scenario_obstacle_t *o = &scene->obstacles[scene->obstacle_count++];
    double x;
    double y;
    double theta;
    reference_shape_pose(scene->reference.shape, at * lap_s, &x, &y, &theta);
    o->x_m = x + 0.1 * rng_normal(rng);
    o->y_m = y + 0.1 * rng_normal(rng);
    o->hard_m = rng_uniform(rng, 0.2, 0.4);
    o->conservative_m = o->hard_m + 0.2;
    o->regulated_m = o->conservative_m + 0.2;
}

/* The start lies outside all, and there is a way between any two. */
static bool is_fair(const scenario_t *scene) {
    for (size_t i = 0; i < scene->obstacle_count; i++) {
        const scenario_obstacle_t *o = &scene->obstacles[i];
        if (hypot(o->x_m - scene->start.x_m, o->y_m - scene->start.y_m) <= o->regulated_m) {
            return false;
        }
        for (size_t j = 0; j < i; j++) {
            const scenario_obstacle_t *p = &scene->obstacles[j];
            if (hypot(o->x_m - p->x_m, o->y_m - p->y_m) <=
                o->conservative_m + p->conservative_m + 0.1) {
                return false;
            }
        }
    }
    return true;
}

static void draw_scene(scenario_t *scene, uint64_t seed, size_t obstacles) {
    rng_t rng;
    rng_seed(&rng, seed);
    const double lap_s = reference_lap_s(scene->reference.shape);
    reference_shape_pose(scene->reference.shape, 0.0, &scene->start.x_m, &scene->start.y_m,
                         &scene->start.theta_rad);
    do {
        const double first = rng_uniform(&rng, 0.12, 0.30);
        scene->obstacle_count = 0;
        while (scene->obstacle_count < obstacles) {
            const double at = first + 0.31 * (double)scene->obstacle_count;
            draw_obstacle(scene, &rng, lap_s, at + rng_uniform(&rng, -0.04, 0.04));
        }
    } while (!is_fair(scene));
}

static void print_row(void *context, const run_row_t *row) {
    (void)context;
    printf("%.2f,%.5f,%.5f,%.5f,%.4f,%d,%.5f,%.5f\n", row->t_s, row->x_m, row->y_m, row->theta_rad,
           row->v_mps, (int)row->mode, row->x_r_m, row->y_r_m);
}

static int usage(void) {
    (void)fprintf(
        stderr, "usage: bench_recovery circle|eight 1|3 TAU paced|plain|before SEED RUNS|trace\n");
    return 2;
}

/* The lag, or -1. */
static double parse_lag(const char *text) {
    char *end = NULL;
    const double value = strtod(text, &end);
    return *text != '\0' && *end == '\0' && value >= 0.0 && value <= 0.1 ? value : -1.0;
}

static bool parse_count(const char *text, unsigned long *out) {
    char *end = NULL;
    *out = strtoul(text, &end, 10);
    return *text >= '0' && *text <= '9' && *end == '\0' && *out <= 100000000;
}

static scenario_t make_base(shape_t shape, double tau_s) {
    return (scenario_t){
        .name = "recovery",
        .period_s = 0.05,
        .duration_s = (LAPS + 1) * reference_lap_s(shape),
        .reference = {.shape = shape, .closed = true},
        .robot = {.wheel_radius_m = 0.05,
                  .track_m = 0.30,
                  .v_max_mps = 0.6,
                  .omega_max_radps = 3.0},
        .mpc = {.horizon = 20, .q = {10.0, 40.0, 1.0}, .r = {0.5, 0.1}},
        .avoidance = {.strategy = "combined", .skirt_m = 0.02, .v_creep_mps = 0.05},
        .plant = {.tau_s = tau_s,
                  .a_max_mps2 = 2.0,
                  .pose_noise_m = 0.003,
                  .heading_noise_rad = 0.003,
                  .radius_scale = 1.0,
                  .track_scale = 1.0},
    };
}

static bool run_one(const scenario_t *base, const run_plan_t *plan, uint64_t seed, size_t obstacles,
                    bool trace) {
    static watch_t watch;
    scenario_t scene = *base;
    run_summary_t summary;
    scenario_error_t error;
    draw_scene(&scene, seed, obstacles);
    watch = (watch_t){.scene = &scene};
    const run_sink_t sink = {trace ? print_row : watch_row, &watch};
    if (trace) {
        for (size_t i = 0; i < scene.obstacle_count; i++) {
            const scenario_obstacle_t *o = &scene.obstacles[i];
            printf("obstacle,%.5f,%.5f,%.5f,%.5f,%.5f\n", o->x_m, o->y_m, o->hard_m,
                   o->conservative_m, o->regulated_m);
        }
    }
    if (!run_scenario(&scene, plan, seed, &sink, &summary, &error)) {
        (void)fprintf(stderr, "bench_recovery: %s\n", error.text);
        return false;
    }
    if (watch.count > 0) {
        watch.encounters[watch.count - 1].next_s = scene.duration_s;
    }
    const double lap_s = reference_lap_s(scene.reference.shape);
    print_encounters(&watch, seed, LAPS * lap_s, summary.rms_position_error_m);
    return true;
}

typedef struct {
    scenario_t base;
    size_t obstacles;
    unsigned long seed, runs;
    bool trace;
} options_t;

/* One of two words; which one. */
static bool parse_word(const char *text, const char *first, const char *second, bool *is_first) {
    *is_first = strcmp(text, first) == 0;
    return *is_first || strcmp(text, second) == 0;
}

static bool parse_rule(const char *text, scenario_t *base) {
    base->avoidance.paced = strcmp(text, "paced") == 0;
    base->plant.untold = strcmp(text, "before") == 0 ? 1.0 : 0.0;
    return base->avoidance.paced || base->plant.untold > 0.0 || strcmp(text, "plain") == 0;
}

static bool parse(int argc, char **argv, options_t *options) {
    bool circle = false;
    bool one = false;
    if (argc != 7 || !parse_word(argv[1], "circle", "eight", &circle) ||
        !parse_word(argv[2], "1", "3", &one)) {
        return false;
    }
    const double tau_s = parse_lag(argv[3]);
    options->base = make_base(circle ? SHAPE_CIRCLE : SHAPE_EIGHT, tau_s);
    options->obstacles = one ? 1 : OBSTACLES_MAX;
    options->trace = strcmp(argv[6], "trace") == 0;
    options->runs = 1;
    return tau_s >= 0.0 && parse_rule(argv[4], &options->base) &&
           parse_count(argv[5], &options->seed) &&
           (options->trace || parse_count(argv[6], &options->runs));
}

int main(int argc, char **argv) {
    options_t options;
    run_plan_t plan;
    scenario_error_t error;
    if (!parse(argc, argv, &options)) {
        return usage();
    }
    if (!run_plan_make(&options.base, &plan, &error)) {
        (void)fprintf(stderr, "bench_recovery: %s\n", error.text);
        return 1;
    }
    bool good = true;
    for (unsigned long i = 0; good && i < options.runs; i++) {
        good = run_one(&options.base, &plan, options.seed + i, options.obstacles, options.trace);
    }
    run_plan_free(&plan);
    return good ? 0 : 1;
}
