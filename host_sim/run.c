#include "run.h"

#include "berth/riccati.h"
#include "plant.h"
#include "reference_source.h"

#include <math.h>
#include <stdlib.h>
#include <time.h>

/* Below this the robot counts as standing. */
#define STANDING_MPS 1.0e-3

static bool make_samples(const scenario_t *scenario, reference_samples_t *samples,
                         scenario_error_t *error) {
    if (scenario->reference.shape == SHAPE_FILE) {
        return reference_from_csv(scenario->reference.file, scenario->period_s,
                                  scenario->reference.closed, samples, error);
    }
    /* a closed shape is one lap, gone round for as long as the run lasts */
    const double duration = scenario->reference.closed ? reference_lap_s(scenario->reference.shape)
                                                       : scenario->duration_s;
    return reference_from_shape(scenario->reference.shape, scenario->period_s, duration, samples,
                                error);
}

bool run_plan_make(const scenario_t *scenario, run_plan_t *out, scenario_error_t *error) {
    reference_samples_t samples = {NULL, 0, 0.0};
    if (!make_samples(scenario, &samples, error)) {
        return false;
    }
    berth_gain_t *gains = calloc(samples.count, sizeof *gains);
    if (gains == NULL) {
        reference_samples_free(&samples);
        (void)snprintf(error->text, sizeof error->text, "out of memory for the plan");
        return false;
    }
    berth_plan_t plan = {
        .samples = samples.samples,
        .gains = gains,
        .count = (uint32_t)samples.count,
        .period_us = (uint32_t)lround(scenario->period_s * 1.0e6),
        .closed = scenario->reference.closed,
        .gain_source = BERTH_GAIN_TABLE,
        .mpc =
            {
                .horizon = (uint16_t)scenario->mpc.horizon,
                .discretization = (uint8_t)(scenario->mpc.zoh ? BERTH_DISCRETIZATION_ZOH
                                                              : BERTH_DISCRETIZATION_EULER),
            },
    };
    for (int i = 0; i < 3; i++) {
        plan.mpc.q[i] = (float)scenario->mpc.q[i];
    }
    for (int i = 0; i < 2; i++) {
        plan.mpc.r[i] = (float)scenario->mpc.r[i];
    }
    for (uint32_t k = 0; k < plan.count; k++) {
        berth_riccati_gain(&plan, k, &gains[k]);
    }
    *out = (run_plan_t){.plan = plan, .samples = samples.samples, .gains = gains};
    return true;
}

void run_plan_free(run_plan_t *plan) {
    reference_samples_t samples = {.samples = plan->samples};
    reference_samples_free(&samples);
    free(plan->gains);
    *plan = (run_plan_t){.samples = NULL, .gains = NULL};
}

/* A run in progress. */
typedef struct {
    const scenario_t *scenario;
    const berth_plan_t *plan;
    plant_t plant;
    plant_disc_t discs[SCENARIO_OBSTACLES_MAX];
    bool hit[SCENARIO_OBSTACLES_MAX];
    long mode_steps[RUN_MODES];
    long stopped_steps;
    long last_avoiding; /* step; -1: none */
    long last_far;      /* last step with an error of RUN_RECOVERED_M or more; -1: none */
    double error_square_sum;
    double effort_sum;
    run_summary_t *summary;
} run_t;

static void run_init(run_t *run, const scenario_t *scenario, const berth_plan_t *plan,
                     uint64_t seed, run_summary_t *summary) {
    *summary = (run_summary_t){.min_clearance_m = HUGE_VAL};
    *run = (run_t){
        .scenario = scenario,
        .plan = plan,
        .last_avoiding = -1,
        .last_far = -1,
        .summary = summary,
    };
    for (size_t i = 0; i < scenario->obstacle_count; i++) {
        const scenario_obstacle_t *obstacle = &scenario->obstacles[i];
        run->discs[i] = (plant_disc_t){obstacle->x_m, obstacle->y_m, obstacle->hard_m};
    }
    plant_init(&run->plant, scenario, seed);
}

/* Which discs a step went into: the step again from where it began, with one disc at a time. */
static void count_collisions(run_t *run, const plant_t *before, const strategy_output_t *output) {
    for (size_t i = 0; i < run->scenario->obstacle_count; i++) {
        plant_t again = *before;
        const double clearance = plant_step(&again, output->v_mps, output->omega_radps,
                                            run->scenario->period_s, &run->discs[i], 1);
        if (clearance < 0.0 && !run->hit[i]) {
            run->hit[i] = true;
            run->summary->collisions++;
        }
    }
}

static void fill_row(run_row_t *row, const plant_t *plant, const berth_sample_t *sample,
                     const strategy_output_t *output, double t_s) {
    const double pi = 3.14159265358979323846;
    const double dx = (double)sample->x_m - plant->x_m;
    const double dy = (double)sample->y_m - plant->y_m;
    const double sine = sin(plant->theta_rad);
    const double cosine = cos(plant->theta_rad);
    *row = (run_row_t){
        .t_s = t_s,
        .x_m = plant->x_m,
        .y_m = plant->y_m,
        .theta_rad = plant->theta_rad,
        .v_mps = plant->v_mps,
        .omega_radps = plant->omega_radps,
        .mode = output->mode,
        .e1_m = cosine * dx + sine * dy,
        .e2_m = cosine * dy - sine * dx,
        .e3_rad = remainder((double)sample->theta_rad - plant->theta_rad, 2.0 * pi),
        .x_r_m = (double)sample->x_m,
        .y_r_m = (double)sample->y_m,
        .theta_r_rad = (double)sample->theta_rad,
        .v_r_mps = (double)sample->v_mps,
        .omega_r_radps = (double)sample->omega_radps,
        .v_cmd_mps = output->v_mps,
        .omega_cmd_radps = output->omega_radps,
    };
}

/* What the step adds to the figures of merit. */
static void account(run_t *run, long number, double position_error, const berth_sample_t *sample,
                    const strategy_output_t *output) {
    run_summary_t *summary = run->summary;
    const double dv = output->v_mps - (double)sample->v_mps;
    const double domega = output->omega_radps - (double)sample->omega_radps;
    run->error_square_sum += position_error * position_error;
    run->effort_sum += dv * dv + domega * domega;
    summary->final_position_error_m = position_error;
    if (position_error > summary->peak_position_error_m) {
        summary->peak_position_error_m = position_error;
    }
    if (!(position_error < RUN_RECOVERED_M)) {
        run->last_far = number;
    }
    run->mode_steps[output->mode]++;
    if (output->mode != BERTH_MODE_TRACK) {
        run->last_avoiding = number;
    }
    if (fabs(output->v_mps) < STANDING_MPS && fabs((double)sample->v_mps) >= STANDING_MPS) {
        run->stopped_steps++;
    }
}

static void finish(const run_t *run, long steps) {
    run_summary_t *summary = run->summary;
    const double period_s = run->scenario->period_s;
    summary->steps = steps;
    summary->rms_position_error_m = sqrt(run->error_square_sum / (double)steps);
    summary->control_effort = run->effort_sum * period_s;
    summary->stopped_time_s = (double)run->stopped_steps * period_s;
    for (int mode = 0; mode < RUN_MODES; mode++) {
        summary->mode_time_s[mode] = (double)run->mode_steps[mode] * period_s;
    }
    summary->avoidance_time_s = (double)(steps - run->mode_steps[BERTH_MODE_TRACK]) * period_s;
    if (run->last_avoiding < 0) {
        summary->recovery_time_s = 0.0;
    } else if (run->last_far == steps - 1) {
        summary->recovery_time_s = (double)NAN;
    } else {
        const long late = run->last_far - run->last_avoiding;
        summary->recovery_time_s = late > 0 ? (double)late * period_s : 0.0;
    }
}

static void run_step(run_t *run, const strategy_t *strategy, void *self, long number,
                     run_row_t *row) {
    const berth_plan_t *plan = run->plan;
    const uint32_t k = plan->closed ? (uint32_t)((uint64_t)number % plan->count) : (uint32_t)number;
    const berth_sample_t sample = berth_plan_sample(plan, k);
    const berth_pose_t pose = plant_measure(&run->plant);
    strategy_output_t output = {0.0, 0.0, BERTH_MODE_TRACK};
    strategy->step(self, number, &pose, &output);
    const double dx = (double)sample.x_m - run->plant.x_m;
    const double dy = (double)sample.y_m - run->plant.y_m;
    account(run, number, sqrt(dx * dx + dy * dy), &sample, &output);
    if (row != NULL) {
        fill_row(row, &run->plant, &sample, &output, (double)number * run->scenario->period_s);
    }
    const plant_t before = run->plant;
    const double clearance =
        plant_step(&run->plant, output.v_mps, output.omega_radps, run->scenario->period_s,
                   run->discs, run->scenario->obstacle_count);
    if (clearance < run->summary->min_clearance_m) {
        run->summary->min_clearance_m = clearance;
    }
    if (clearance < 0.0) {
        count_collisions(run, &before, &output);
    }
    if (row != NULL) {
        row->clearance_m = clearance;
    }
}

static double now_s(void) {
    struct timespec now;
    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1.0e-9 * (double)now.tv_nsec;
}

bool run_scenario(const scenario_t *scenario, const run_plan_t *plan, uint64_t seed,
                  const run_sink_t *sink, run_summary_t *summary, scenario_error_t *error) {
    const strategy_t *strategy = strategy_find(scenario->avoidance.strategy);
    if (strategy == NULL) {
        (void)snprintf(error->text, sizeof error->text, "avoidance.strategy: unknown: \"%s\"",
                       scenario->avoidance.strategy);
        return false;
    }
    const strategy_scene_t scene = {scenario, &plan->plan};
    void *self = strategy->create(&scene, error);
    if (self == NULL) {
        return false;
    }
    const double begin_s = now_s();
    const long steps = lround(scenario->duration_s / scenario->period_s);
    run_t run;
    run_init(&run, scenario, &plan->plan, seed, summary);
    for (long number = 0; number < steps; number++) {
        run_row_t row;
        run_step(&run, strategy, self, number, sink != NULL ? &row : NULL);
        if (sink != NULL) {
            sink->on_row(sink->context, &row);
        }
    }
    finish(&run, steps);
    summary->wall_s = now_s() - begin_s;
    strategy->destroy(self);
    return true;
}
