#include "run.h"

#include "berth/riccati.h"
#include "plant.h"
#include "pose_delay.h"
#include "reference_source.h"
#include "run_meter.h"

#include <math.h>
#include <stdlib.h>
#include <time.h>

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
    run_meter_t meter;
    plant_t plant;
    pose_delay_t delay;
} run_t;

static void run_step(run_t *run, const strategy_t *strategy, void *self, long number,
                     run_row_t *row) {
    strategy_output_t output = {0.0, 0.0, BERTH_MODE_TRACK};
    run_meter_row(&run->meter, &run->plant, number, row);
    const berth_pose_t pose = pose_delay_measure(&run->delay, &run->plant);
    strategy->step(self, number, &pose, &output);
    run_meter_move(&run->meter, &run->plant, output.v_mps, output.omega_radps,
                   run->meter.scenario->period_s);
    run_meter_period(&run->meter, &output, row);
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
    run_meter_begin(&run.meter, scenario, &plan->plan, summary);
    plant_init(&run.plant, scenario, seed);
    pose_delay_init(&run.delay, scenario);
    for (long number = 0; number < steps; number++) {
        run_row_t row;
        run_step(&run, strategy, self, number, sink != NULL ? &row : NULL);
        if (sink != NULL) {
            sink->on_row(sink->context, &row);
        }
    }
    run_meter_finish(&run.meter);
    summary->wall_s = now_s() - begin_s;
    strategy->destroy(self);
    return true;
}
