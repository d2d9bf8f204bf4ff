/* Laps of the constrained tracker, and of the gain with its command clipped.
 *
 * Prints one line a case: "case NAME HORIZON STEPS rms_constrained rms_clipped residual", and
 * before it one line a step of the constrained tracker: "step INSTRUCTIONS PASSES LIMITED STOPPED".
 */
#include "laps.h"

#include <math.h>
#include <stdio.h>

static berth_constrained_t workspace;

typedef struct {
    double square, residual;
} outcome_t;

/* Counter around nothing, to be taken off. */
static uint32_t overhead(void) {
    const uint32_t mark = laps_mark();
    return laps_since(mark);
}

static outcome_t run_constrained(const laps_case_t *chosen) {
    const berth_plan_t *plan = laps_plan(chosen);
    const berth_limits_config_t limits = laps_limits();
    berth_refusal_t refusal;
    outcome_t outcome = {0.0, 0.0};
    berth_limits_t memory;
    laps_robot_t robot = laps_start(chosen);
    berth_reference_t reference = {0};
    berth_limits_reset(&memory);
    if (berth_constrained_init(&workspace, plan, &limits, 0.0f, &refusal) != BERTH_OK) {
        return (outcome_t){-1.0, -1.0};
    }
    const int steps = (int)plan->count * chosen->laps;
    for (int k = 0; k < steps; k++) {
        laps_kick(&robot, chosen, k);
        reference.index = (uint32_t)k % plan->count;
        reference.total = (uint32_t)k;
        const berth_sample_t sample = berth_plan_sample(plan, reference.index);
        const berth_tracking_error_t error = laps_error(&robot, &sample);
        const berth_tracker_input_t input = {plan, &reference, &sample, NULL, &error, memory.last};
        const uint32_t mark = laps_mark();
        berth_twist_t command = berth_constrained_step(&workspace, &input);
        const uint32_t spent = laps_since(mark);
        if (workspace.limited) {
            double u[2 * BERTH_CONSTRAINED_HORIZON_MAX];
            for (int i = 0; i < plan->mpc.horizon; i++) {
                u[2 * i] = (double)(workspace.stages[i].u[0] * workspace.frequency_hz);
                u[2 * i + 1] = (double)(workspace.stages[i].u[1] * workspace.frequency_hz);
            }
            const float rim = workspace.rim_m * workspace.frequency_hz;
            outcome.residual = fmax(outcome.residual, laps_residual(&input, rim, u));
        }
        printf("step %u %u %d %d\n", (unsigned)(spent - overhead()), workspace.passes,
               workspace.limited, workspace.stopped);
        (void)berth_limits_apply(&memory, &limits, 0.05f, false, &command);
        laps_move(&robot, command);
        outcome.square += laps_distance2(&robot, &plan->samples[(k + 1) % (int)plan->count]);
    }
    outcome.square /= steps;
    return outcome;
}

static double run_clipped(const laps_case_t *chosen) {
    const berth_plan_t *plan = laps_plan(chosen);
    const berth_limits_config_t limits = laps_limits();
    double square = 0.0;
    berth_limits_t memory;
    laps_robot_t robot = laps_start(chosen);
    berth_limits_reset(&memory);
    const int steps = (int)plan->count * chosen->laps;
    for (int k = 0; k < steps; k++) {
        laps_kick(&robot, chosen, k);
        const uint32_t index = (uint32_t)k % plan->count;
        const berth_sample_t sample = berth_plan_sample(plan, index);
        const berth_tracking_error_t error = laps_error(&robot, &sample);
        berth_gain_t gain;
        berth_riccati_gain(plan, index, &gain);
        berth_twist_t command = berth_tracker_law(&sample, &gain, &error);
        (void)berth_limits_apply(&memory, &limits, 0.05f, false, &command);
        laps_move(&robot, command);
        square += laps_distance2(&robot, &plan->samples[(k + 1) % (int)plan->count]);
    }
    return square / steps;
}

int main(void) {
    static const uint16_t horizons[] = {10, 20, 40};
    laps_open();
    for (size_t n = 0; n < sizeof horizons / sizeof *horizons; n++) {
        for (int i = 0; i < LAPS_CASES; i++) {
            laps_case_t chosen = laps_cases[i];
            chosen.horizon = horizons[n];
            const outcome_t outcome = run_constrained(&chosen);
            if (outcome.square < 0.0) {
                printf("failed\n");
                return 1;
            }
            printf("case %s %s %u %u %.9g %.9g %.9g\n", chosen.kind, laps_shape_name(chosen.shape),
                   (unsigned)chosen.horizon, (unsigned)chosen.seed, sqrt(outcome.square),
                   sqrt(run_clipped(&chosen)), outcome.residual);
        }
    }
    return 0;
}
