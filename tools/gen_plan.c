#include "gen_plan.h"

#include "berth/riccati.h"
#include "reference_source.h"
#include "refusal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

void gen_request_defaults(gen_request_t *request) {
    *request = (gen_request_t){.source = NULL};
    (void)scenario_builtin("circle", &request->settings);
}

/* Duration of a shape: what was asked for, else one lap when closed, else the experiment's. */
static bool shape_duration(const gen_request_t *request, shape_t shape, double *duration_s,
                           scenario_error_t *error) {
    const double period = request->settings.period_s;
    const double lap = reference_lap_s(shape);
    scenario_t experiment;
    if (!request->settings.reference.closed) {
        (void)scenario_builtin(request->source, &experiment);
        *duration_s =
            request->duration_given ? request->settings.duration_s : experiment.duration_s;
        return true;
    }
    *duration_s = request->duration_given ? request->settings.duration_s : lap;
    const double sampled = round(*duration_s / period) * period;
    const double laps = fmax(1.0, round(sampled / lap));
    if (fabs(sampled - laps * lap) <= 0.5 * period * (1.0 + 1e-9)) {
        return true;
    }
    return refuse(
        error,
        "--duration: %.9g s is not a whole number of laps of %s, %.9g s each, as --closed "
        "needs (allowed: %.9g within half a period)",
        *duration_s, request->source, lap, laps * lap);
}

static bool make_samples(const gen_request_t *request, reference_samples_t *samples,
                         scenario_error_t *error) {
    const bool circle = strcmp(request->source, "circle") == 0;
    if (circle || strcmp(request->source, "eight") == 0) {
        const shape_t shape = circle ? SHAPE_CIRCLE : SHAPE_EIGHT;
        double duration_s = 0.0;
        return shape_duration(request, shape, &duration_s, error) &&
               reference_from_shape(shape, request->settings.period_s, duration_s, samples, error);
    }
    if (request->duration_given) {
        return refuse(error, "--duration: a file has its own (allowed: with circle and eight)");
    }
    return reference_from_csv(request->source,
                              request->period_given ? request->settings.period_s : 0.0,
                              request->settings.reference.closed, samples, error);
}

static void describe(const gen_request_t *request, const reference_samples_t *samples,
                     berth_plan_t *plan) {
    const scenario_t *settings = &request->settings;
    *plan = (berth_plan_t){
        .samples = samples->samples,
        .gains = NULL,
        .count = (uint32_t)samples->count,
        .period_us = (uint32_t)lround(samples->period_s * 1e6),
        .mpc =
            {
                .horizon = (uint16_t)settings->mpc.horizon,
                .discretization = (uint8_t)(settings->mpc.zoh ? BERTH_DISCRETIZATION_ZOH
                                                              : BERTH_DISCRETIZATION_EULER),
            },
        .closed = settings->reference.closed,
        .gain_source = BERTH_GAIN_ONLINE,
    };
    for (size_t i = 0; i < 3; i++) {
        plan->mpc.q[i] = (float)settings->mpc.q[i];
    }
    for (size_t i = 0; i < 2; i++) {
        plan->mpc.r[i] = (float)settings->mpc.r[i];
    }
}

static bool check(const berth_plan_t *plan, scenario_error_t *error) {
    berth_refusal_t refusal = {.field = BERTH_FIELD_NONE};
    if (berth_plan_check(plan, &refusal) == BERTH_OK) {
        return true;
    }
    return refuse(error, "sample %u: %s is %.9g (allowed: %.9g to %.9g)", (unsigned)refusal.index,
                  berth_field_text(refusal.field), (double)refusal.value, (double)refusal.minimum,
                  (double)refusal.maximum);
}

/* The gains belong to a plan that passed its check, and are then checked themselves. */
static bool make_gains(gen_plan_t *out, scenario_error_t *error) {
    if (!check(&out->plan, error)) {
        return false;
    }
    out->gains = calloc(out->plan.count, sizeof *out->gains);
    if (out->gains == NULL) {
        return refuse(error, "out of memory");
    }
    for (uint32_t k = 0; k < out->plan.count; k++) {
        berth_riccati_gain(&out->plan, k, &out->gains[k]);
    }
    out->plan.gains = out->gains;
    out->plan.gain_source = BERTH_GAIN_TABLE;
    return check(&out->plan, error);
}

bool gen_plan_make(const gen_request_t *request, gen_plan_t *out, scenario_error_t *error) {
    reference_samples_t samples = {NULL, 0, 0.0};
    *out = (gen_plan_t){.samples = NULL, .gains = NULL};
    if (!make_samples(request, &samples, error)) {
        return false;
    }
    out->samples = samples.samples;
    describe(request, &samples, &out->plan);
    if (!make_gains(out, error)) {
        gen_plan_free(out);
        return false;
    }
    return true;
}

void gen_plan_free(gen_plan_t *plan) {
    free(plan->samples);
    free(plan->gains);
    *plan = (gen_plan_t){.samples = NULL, .gains = NULL};
}
