/* Plans and configurations for the proofs: all that validation accepts, and more. */
#ifndef BERTH_TESTS_PROOF_SCENE_H
#define BERTH_TESTS_PROOF_SCENE_H

#include "proof.h"

#ifndef ROWS
#define ROWS BERTH_PLAN_COUNT_MAX
#endif

static berth_sample_t samples[ROWS];
static berth_gain_t gains[ROWS];

/* Any plan that berth_plan_check accepts, and more: the rows may be any bits. */
static berth_plan_t any_plan(void) {
    ANY_BYTES(samples);
    berth_plan_t plan = {.samples = samples,
                         .count = u32_from(1, ROWS),
                         .period_us = u32_from(BERTH_PERIOD_MIN_US, BERTH_PERIOD_MAX_US),
                         .closed = any_bool(),
                         .gain_source = BERTH_GAIN_ONLINE};
    ANY_BYTES(plan.mpc);
    plan.mpc.horizon = Frama_C_unsigned_short_interval(1, BERTH_HORIZON_MAX);
    plan.mpc.discretization = Frama_C_unsigned_char_interval(0, BERTH_DISCRETIZATION_ZOH);
    return plan;
}

/* With a table of gains. */
static void give_gains(berth_plan_t *plan) {
    ANY_BYTES(gains);
    plan->gains = gains;
    plan->gain_source = BERTH_GAIN_TABLE;
}

/* A drive's configuration: of what berth_drive_init checks, only the period is put to use here. */
static berth_drive_config_t any_drive_config(const berth_drive_protocol_t *protocol) {
    berth_drive_config_t config;
    ANY_BYTES(config);
    config.protocol = protocol;
    config.has_position = any_bool();
    config.period_us = u32_from(BERTH_PERIOD_MIN_US, BERTH_PERIOD_MAX_US);
    return config;
}

#endif
