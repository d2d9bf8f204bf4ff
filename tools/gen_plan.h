/* berth-gen: what the command line asks for, and the plan that follows from it. */
#ifndef TOOLS_GEN_PLAN_H
#define TOOLS_GEN_PLAN_H

#include "berth/reference.h"
#include "scenario.h"

typedef struct {
    const char *source;  /* circle, eight, or the path of a CSV file */
    scenario_t settings; /* period, duration, reference and mpc; the rest is not used */
    bool period_given;
    bool duration_given;
} gen_request_t;

/* A plan with its arrays on the heap; release with gen_plan_free. */
typedef struct {
    berth_plan_t plan;
    berth_sample_t *samples;
    berth_gain_t *gains;
} gen_plan_t;

/* Fills in what the shapes' experiments and the default weights are. */
void gen_request_defaults(gen_request_t *request);

/* Samples and gains. On false nothing is kept and *error says why. */
bool gen_plan_make(const gen_request_t *request, gen_plan_t *out, scenario_error_t *error);

void gen_plan_free(gen_plan_t *plan);

#endif
