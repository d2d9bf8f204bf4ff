#include "campaign.h"

#include "berth/angle.h"
#include "berth/supervisor.h"
#include "reference_source.h"
#include "refusal.h"
#include "rng.h"
#include "strategy_common.h"

#include <math.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <time.h>

/* The distribution of scenes. */
#define HARD_MIN_M 0.05
#define HARD_MAX_M 0.25
#define CENTRE_AFTER_START_S 3.0
#define CENTRE_BEFORE_END_S 7.5
#define CENTRE_SPREAD_M 0.1
#define START_FREE_M 0.5
#define END_FREE_M 0.4
#define CONSERVATIVE_SLACK_M 0.01
#define REGULATED_WIDTH_M 0.2
#define START_SPREAD_M 0.1
#define START_SPREAD_RAD 0.5

#define TRIES 100000
#define RUNS_PER_CLAIM 16

/* Plants that are drawn: from drives that obey at once and an exact pose to what the least of these
 * allow. */
#define TAU_MAX_S 0.1
#define A_MIN_MPS2 2.0
#define A_MAX_MPS2 5.0
#define POSE_NOISE_MAX_M 0.005
#define HEADING_NOISE_MAX_RAD 0.005
#define SLIP_MAX 0.05
#define POSE_DELAY_MAX 0.1
#define LATE_POSE_DELAY_MAX 0.2

static void draw_plant(const campaign_options_t *options, rng_t *rng, scenario_plant_t *plant) {
    if (options->plant == CAMPAIGN_PLANT_BASE) {
        return;
    }
    plant->tau_s = rng_uniform(rng, 0.0, TAU_MAX_S);
    plant->a_max_mps2 = rng_uniform(rng, A_MIN_MPS2, A_MAX_MPS2);
    plant->pose_noise_m = rng_uniform(rng, 0.0, POSE_NOISE_MAX_M);
    plant->heading_noise_rad = rng_uniform(rng, 0.0, HEADING_NOISE_MAX_RAD);
    plant->slip = rng_uniform(rng, 0.0, SLIP_MAX);
    plant->pose_delay_s = rng_uniform(
        rng, 0.0, options->plant == CAMPAIGN_PLANT_LATE ? LATE_POSE_DELAY_MAX : POSE_DELAY_MAX);
    if (options->plant == CAMPAIGN_PLANT_UNTOLD) {
        plant->untold = rng_uniform(rng, 0.0, 1.0);
    }
}

/* One obstacle near the reference, away from both of its ends. */
static bool draw_obstacle(const scenario_t *scene, rng_t *rng, scenario_obstacle_t *obstacle) {
    const shape_t shape = scene->reference.shape;
    const double last_s = scene->duration_s - scene->period_s;
    obstacle->hard_m = rng_uniform(rng, HARD_MIN_M, HARD_MAX_M);
    obstacle->conservative_m =
        obstacle->hard_m + strategy_clearance_told(scene) + CONSERVATIVE_SLACK_M;
    obstacle->regulated_m =
        obstacle->conservative_m + fmax(REGULATED_WIDTH_M, scene->avoidance.skirt_m);
    for (int i = 0; i < TRIES; i++) {
        double x;
        double y;
        double theta;
        const double t_s =
            rng_uniform(rng, CENTRE_AFTER_START_S, scene->duration_s - CENTRE_BEFORE_END_S);
        reference_shape_pose(shape, floor(t_s / scene->period_s) * scene->period_s, &x, &y, &theta);
        obstacle->x_m = x + CENTRE_SPREAD_M * rng_normal(rng);
        obstacle->y_m = y + CENTRE_SPREAD_M * rng_normal(rng);
        reference_shape_pose(shape, 0.0, &x, &y, &theta);
        const double to_start = hypot(obstacle->x_m - x, obstacle->y_m - y) - obstacle->hard_m;
        reference_shape_pose(shape, last_s, &x, &y, &theta);
        const double to_end = hypot(obstacle->x_m - x, obstacle->y_m - y) - obstacle->hard_m;
        if (to_start > START_FREE_M && to_end > END_FREE_M) {
            return true;
        }
    }
    return false;
}

static bool overlaps(const scenario_t *scene) {
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

static bool draw_start(scenario_t *scene, rng_t *rng) {
    double x;
    double y;
    double theta;
    reference_shape_pose(scene->reference.shape, 0.0, &x, &y, &theta);
    for (int i = 0; i < TRIES; i++) {
        scene->start.x_m = x + START_SPREAD_M * rng_normal(rng);
        scene->start.y_m = y + START_SPREAD_M * rng_normal(rng);
        scene->start.theta_rad =
            (double)berth_wrap((float)(theta + START_SPREAD_RAD * rng_normal(rng)));
        bool clear = true;
        for (size_t j = 0; j < scene->obstacle_count; j++) {
            const scenario_obstacle_t *o = &scene->obstacles[j];
            clear = clear &&
                    hypot(o->x_m - scene->start.x_m, o->y_m - scene->start.y_m) > o->conservative_m;
        }
        if (clear) {
            return true;
        }
    }
    return false;
}

/* Obstacles stand between two times, in either scenario. */
static bool long_enough(const campaign_options_t *options, scenario_error_t *error) {
    const double least_s = CENTRE_AFTER_START_S + CENTRE_BEFORE_END_S;
    if (options->circle.duration_s > least_s && options->eight.duration_s > least_s) {
        return true;
    }
    return refuse(error, "duration_s: too short to put obstacles in (allowed: more than %g s)",
                  least_s);
}

bool campaign_scene(const campaign_options_t *options, uint64_t seed, scenario_t *scene,
                    scenario_error_t *error) {
    if (!long_enough(options, error)) {
        return false;
    }
    static const size_t counts[] = {1, 3, 6};
    rng_t rng;
    rng_seed(&rng, seed);
    *scene = rng_u64(&rng) >> 63 ? options->eight : options->circle;
    (void)snprintf(scene->name, sizeof scene->name, "campaign_%llu", (unsigned long long)seed);
    draw_plant(options, &rng, &scene->plant);
    for (int i = 0; i < TRIES; i++) {
        scene->obstacle_count = counts[(size_t)rng_uniform(&rng, 0.0, 3.0)];
        bool drawn = true;
        for (size_t j = 0; drawn && j < scene->obstacle_count; j++) {
            drawn = draw_obstacle(scene, &rng, &scene->obstacles[j]);
        }
        if (!drawn) {
            break;
        }
        const bool overlap = overlaps(scene);
        if (options->overlap == OVERLAP_ANY || overlap == (options->overlap == OVERLAP_DEMAND)) {
            if (draw_start(scene, &rng)) {
                return true;
            }
            break;
        }
    }
    (void)snprintf(error->text, sizeof error->text,
                   "seed %llu: no scene fits (the regions are too wide for the shapes)",
                   (unsigned long long)seed);
    return false;
}

/* What a thread has gathered; whole numbers, so that the order of adding does not matter. */
typedef struct {
    long collisions, recovered, blocked, stopped, wrong, steps;
    long mode_steps[RUN_MODES];
    double worst_clearance_m;
    campaign_bad_t *bad;
    size_t bad_count, bad_room;
} tally_t;

typedef struct {
    const campaign_options_t *options;
    const run_plan_t *circle, *eight;
    atomic_long next, done;
    atomic_bool failed;
    pthread_mutex_t lock; /* guards error and finished */
    pthread_cond_t all_finished;
    int finished;
    scenario_error_t error;
} shared_t;

typedef struct {
    shared_t *shared;
    tally_t tally;
    pthread_t thread;
} worker_t;

static bool add_bad(tally_t *tally, const campaign_bad_t *bad) {
    if (tally->bad_count == tally->bad_room) {
        const size_t room = tally->bad_room == 0 ? 64 : 2 * tally->bad_room;
        campaign_bad_t *grown = realloc(tally->bad, room * sizeof *grown);
        if (grown == NULL) {
            return false;
        }
        tally->bad = grown;
        tally->bad_room = room;
    }
    tally->bad[tally->bad_count++] = *bad;
    return true;
}

static void describe(const scenario_t *scene, uint64_t seed, campaign_row_t *row) {
    *row = (campaign_row_t){
        .seed = seed,
        .shape = scene->reference.shape,
        .obstacles = scene->obstacle_count,
        .overlap = overlaps(scene),
        .plant = scene->plant,
        .needed_m = strategy_clearance(scene),
        .given_m = scene->obstacles[0].conservative_m - scene->obstacles[0].hard_m,
        .fault_s = (double)NAN,
        .stopped_s = (double)NAN,
    };
}

static bool run_row(const shared_t *shared, uint64_t seed, campaign_row_t *row,
                    scenario_error_t *error) {
    const campaign_options_t *options = shared->options;
    scenario_t scene;
    if (!campaign_scene(options, seed, &scene, error)) {
        return false;
    }
    const run_plan_t *plan = scene.reference.shape == SHAPE_CIRCLE ? shared->circle : shared->eight;
    describe(&scene, seed, row);
    const bool good = options->run != NULL
                          ? options->run(options->run_context, &scene, plan, row, error)
                          : run_scenario(&scene, plan, seed, NULL, &row->summary, error);
    row->collided = row->collided || row->summary.collisions > 0;
    row->recovered = row->summary.final_position_error_m < RUN_RECOVERED_M &&
                     row->summary.steps > 0 && row->reason == BERTH_FAULT_NONE;
    row->blocked = row->summary.mode_time_s[BERTH_MODE_BLOCKED] > 0.0;
    return good;
}

static bool run_one(const shared_t *shared, tally_t *tally, long number, scenario_error_t *error) {
    campaign_row_t here;
    campaign_row_t *row = shared->options->rows != NULL ? &shared->options->rows[number] : &here;
    const uint64_t seed = shared->options->seed + (uint64_t)number;
    if (!run_row(shared, seed, row, error)) {
        return false;
    }
    const run_summary_t *summary = &row->summary;
    const bool stopped = row->reason != BERTH_FAULT_NONE;
    const campaign_bad_t bad = {
        .seed = seed,
        .collided = row->collided,
        .unrecovered = !row->recovered && !stopped,
        .blocked = row->blocked,
        .wrong = row->wrong,
    };
    tally->collisions += bad.collided;
    tally->recovered += row->recovered;
    tally->blocked += bad.blocked;
    tally->stopped += stopped;
    tally->wrong += bad.wrong != NULL;
    tally->steps += summary->steps;
    tally->worst_clearance_m = fmin(tally->worst_clearance_m, summary->min_clearance_m);
    for (int mode = 0; mode < RUN_MODES; mode++) {
        tally->mode_steps[mode] +=
            lround(summary->mode_time_s[mode] / shared->options->circle.period_s);
    }
    if ((bad.collided || bad.unrecovered || bad.wrong != NULL) && !add_bad(tally, &bad)) {
        (void)snprintf(error->text, sizeof error->text, "out of memory");
        return false;
    }
    return true;
}

static void *work(void *context) {
    worker_t *worker = context;
    shared_t *shared = worker->shared;
    const long runs = shared->options->runs;
    scenario_error_t error = {.text = ""};
    bool good = true;
    while (good && !atomic_load(&shared->failed)) {
        const long first = atomic_fetch_add(&shared->next, RUNS_PER_CLAIM);
        const long end = first + RUNS_PER_CLAIM < runs ? first + RUNS_PER_CLAIM : runs;
        if (first >= runs) {
            break;
        }
        for (long i = first; good && i < end; i++) {
            good = run_one(shared, &worker->tally, i, &error);
            atomic_fetch_add(&shared->done, 1);
        }
    }
    (void)pthread_mutex_lock(&shared->lock);
    if (!good && !atomic_exchange(&shared->failed, true)) {
        shared->error = error;
    }
    shared->finished++;
    (void)pthread_cond_signal(&shared->all_finished);
    (void)pthread_mutex_unlock(&shared->lock);
    return NULL;
}

static int by_seed(const void *a, const void *b) {
    const campaign_bad_t *left = a;
    const campaign_bad_t *right = b;
    return (left->seed > right->seed) - (left->seed < right->seed);
}

static void merge(campaign_result_t *result, tally_t *total, tally_t *tally) {
    result->collisions += tally->collisions;
    result->recovered += tally->recovered;
    result->blocked += tally->blocked;
    result->stopped += tally->stopped;
    result->wrong += tally->wrong;
    result->steps += tally->steps;
    result->worst_clearance_m = fmin(result->worst_clearance_m, tally->worst_clearance_m);
    for (int mode = 0; mode < RUN_MODES; mode++) {
        total->mode_steps[mode] += tally->mode_steps[mode];
    }
    for (size_t i = 0; i < tally->bad_count; i++) {
        /* room was found for each of these once; losing one must not go unseen */
        if (!add_bad(total, &tally->bad[i])) {
            abort();
        }
    }
    free(tally->bad);
}

/* Waits for the threads and shows progress meanwhile. */
static void wait_for_workers(shared_t *shared, int workers, campaign_progress_fn progress,
                             void *context) {
    (void)pthread_mutex_lock(&shared->lock);
    while (shared->finished < workers) {
        struct timespec until;
        (void)clock_gettime(CLOCK_REALTIME, &until);
        until.tv_nsec += 100000000;
        if (until.tv_nsec >= 1000000000) {
            until.tv_nsec -= 1000000000;
            until.tv_sec++;
        }
        (void)pthread_cond_timedwait(&shared->all_finished, &shared->lock, &until);
        if (progress != NULL) {
            progress(context, atomic_load(&shared->done), shared->options->runs);
        }
    }
    (void)pthread_mutex_unlock(&shared->lock);
}

static bool run_workers(shared_t *shared, worker_t *workers, int jobs,
                        campaign_progress_fn progress, void *context) {
    int started = 0;
    for (; started < jobs; started++) {
        workers[started] = (worker_t){.shared = shared, .tally.worst_clearance_m = HUGE_VAL};
        if (pthread_create(&workers[started].thread, NULL, work, &workers[started]) != 0) {
            break;
        }
    }
    if (started == 0) {
        (void)snprintf(shared->error.text, sizeof shared->error.text, "cannot start a thread");
        return false;
    }
    wait_for_workers(shared, started, progress, context);
    for (int i = 0; i < started; i++) {
        (void)pthread_join(workers[i].thread, NULL);
    }
    return !atomic_load(&shared->failed);
}

static void gather(const campaign_options_t *options, worker_t *workers, double begin_s,
                   campaign_result_t *result) {
    tally_t total = {.bad = NULL};
    *result = (campaign_result_t){.runs = options->runs, .worst_clearance_m = HUGE_VAL};
    for (int i = 0; i < options->jobs; i++) {
        merge(result, &total, &workers[i].tally);
    }
    for (int mode = 0; mode < RUN_MODES; mode++) {
        result->mode_time_s[mode] = (double)total.mode_steps[mode] * options->circle.period_s;
    }
    if (total.bad_count > 0) {
        qsort(total.bad, total.bad_count, sizeof *total.bad, by_seed);
    }
    result->bad = total.bad;
    result->bad_count = total.bad_count;
    struct timespec now;
    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    result->wall_s = (double)now.tv_sec + 1.0e-9 * (double)now.tv_nsec - begin_s;
}

bool campaign_run(const campaign_options_t *options, campaign_progress_fn progress, void *context,
                  campaign_result_t *result, scenario_error_t *error) {
    struct timespec begin;
    (void)clock_gettime(CLOCK_MONOTONIC, &begin);
    const double begin_s = (double)begin.tv_sec + 1.0e-9 * (double)begin.tv_nsec;
    run_plan_t circle;
    run_plan_t eight;
    if (!run_plan_make(&options->circle, &circle, error)) {
        return false;
    }
    if (!run_plan_make(&options->eight, &eight, error)) {
        run_plan_free(&circle);
        return false;
    }
    shared_t shared = {.options = options, .circle = &circle, .eight = &eight};
    (void)pthread_mutex_init(&shared.lock, NULL);
    (void)pthread_cond_init(&shared.all_finished, NULL);
    worker_t *workers = calloc((size_t)options->jobs, sizeof *workers);
    bool good = false;
    if (workers == NULL) {
        (void)snprintf(shared.error.text, sizeof shared.error.text, "out of memory");
    } else {
        for (int i = 0; i < options->jobs; i++) {
            workers[i].tally.worst_clearance_m = HUGE_VAL;
        }
        good = run_workers(&shared, workers, options->jobs, progress, context);
        gather(options, workers, begin_s, result);
        if (!good) {
            campaign_result_free(result);
        }
    }
    if (!good) {
        *error = shared.error;
    }
    free(workers);
    (void)pthread_cond_destroy(&shared.all_finished);
    (void)pthread_mutex_destroy(&shared.lock);
    run_plan_free(&circle);
    run_plan_free(&eight);
    return good;
}

void campaign_result_free(campaign_result_t *result) {
    free(result->bad);
    result->bad = NULL;
    result->bad_count = 0;
}
