/* The plan that the board's fuzz targets share: a small circle, closed or open, made once. */
#ifndef BERTH_TESTS_FUZZ_PLAN_H
#define BERTH_TESTS_FUZZ_PLAN_H

#include "berth/reference.h"
#include "berth/riccati.h"

#include <math.h>

#define FUZZ_PLAN_COUNT 60u
#define FUZZ_PERIOD_US 50000u
#define FUZZ_PLAN_RADIUS_M 0.3

static inline const berth_plan_t *fuzz_plan(bool closed) {
    static berth_sample_t samples[FUZZ_PLAN_COUNT];
    static berth_gain_t gains[2][FUZZ_PLAN_COUNT];
    static berth_plan_t plans[2];
    berth_plan_t *plan = &plans[closed];
    if (plan->samples != NULL) {
        return plan;
    }
    const double step = 2.0 * 3.14159265358979323846 / FUZZ_PLAN_COUNT;
    for (uint32_t k = 0; k < FUZZ_PLAN_COUNT; k++) {
        samples[k] = (berth_sample_t){
            .x_m = (float)(FUZZ_PLAN_RADIUS_M * cos(k * step)),
            .y_m = (float)(FUZZ_PLAN_RADIUS_M * sin(k * step)),
            .theta_rad = (float)remainder(k * step + 1.5707963267948966, 60 * step),
            .v_mps = (float)(FUZZ_PLAN_RADIUS_M * step * 20.0),
            .omega_radps = (float)(step * 20.0)};
    }
    *plan = (berth_plan_t){
        .samples = samples,
        .count = FUZZ_PLAN_COUNT,
        .period_us = FUZZ_PERIOD_US,
        .mpc = {.q = {10.0f, 40.0f, 1.0f}, .r = {0.5f, 0.1f}, .horizon = 20},
        .closed = closed,
        .gain_source = BERTH_GAIN_ONLINE,
    };
    for (uint32_t k = 0; k < FUZZ_PLAN_COUNT; k++) {
        berth_riccati_gain(plan, k, &gains[closed][k]);
    }
    plan->gains = gains[closed];
    plan->gain_source = BERTH_GAIN_TABLE;
    return plan;
}

#endif
