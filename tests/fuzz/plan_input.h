/* A plan of a few samples and a controller's configuration from an input: sensible values, or any
 * bits, as the input has it. */
#ifndef BERTH_TESTS_FUZZ_PLAN_INPUT_H
#define BERTH_TESTS_FUZZ_PLAN_INPUT_H

#include "berth/controller.h"
#include "input.h"

#define PLAN_INPUT_MAX 12u

typedef struct {
    berth_sample_t samples[PLAN_INPUT_MAX];
    berth_gain_t gains[PLAN_INPUT_MAX];
    berth_plan_t plan;
} plan_input_t;

static inline void in_samples(input_t *in, plan_input_t *out) {
    for (uint32_t k = 0; k < out->plan.count; k++) {
        berth_sample_t *sample = &out->samples[k];
        sample->x_m = in_some_float(in, -2.0f, 2.0f);
        sample->y_m = in_some_float(in, -2.0f, 2.0f);
        sample->theta_rad = in_some_float(in, -3.14159f, 3.14159f);
        sample->v_mps = in_some_float(in, -1.0f, 2.0f);
        sample->omega_radps = in_some_float(in, -3.0f, 3.0f);
    }
}

static inline void in_gains(input_t *in, plan_input_t *out) {
    for (uint32_t k = 0; k < out->plan.count; k++) {
        for (int i = 0; i < 6; i++) {
            out->gains[k].k[i / 3][i % 3] = in_some_float(in, -20.0f, 20.0f);
        }
    }
}

static inline void in_mpc(input_t *in, berth_mpc_t *mpc) {
    for (int i = 0; i < 3; i++) {
        mpc->q[i] = in_some_float(in, 0.0f, 50.0f);
    }
    mpc->r[0] = in_some_float(in, 0.01f, 2.0f);
    mpc->r[1] = in_some_float(in, 0.01f, 2.0f);
    mpc->horizon = in_u8(in);
    mpc->discretization = in_u8(in) % 3u;
}

/* flags: 1 closed, 2 a table of gains, 4 weights and horizon from the input too. */
static inline void in_plan(input_t *in, uint8_t flags, plan_input_t *out) {
    const uint8_t shape = in_u8(in);
    out->plan = (berth_plan_t){
        .samples = out->samples,
        .gains = (flags & 2u) != 0 ? out->gains : NULL,
        .count = 1u + shape % PLAN_INPUT_MAX,
        .period_us = 50000,
        .mpc = {.q = {10.0f, 40.0f, 1.0f}, .r = {0.5f, 0.1f}, .horizon = 10},
        .closed = (flags & 1u) != 0,
        .gain_source = (flags & 2u) != 0 ? BERTH_GAIN_TABLE : BERTH_GAIN_ONLINE,
    };
    if ((flags & 4u) != 0) {
        in_mpc(in, &out->plan.mpc);
        out->plan.period_us = in_u8(in) == 255 ? in_u32(in) : 1000u * in_u8(in);
    }
    in_samples(in, out);
    if ((flags & 2u) != 0) {
        in_gains(in, out);
    }
}

/* The named values with other bits, as many as the input says. */
static inline void in_config(input_t *in, berth_config_t *config) {
    float *const values[] = {
        &config->limits.wheel_radius_m,
        &config->limits.track_m,
        &config->limits.v_max_mps,
        &config->limits.omega_max_radps,
        &config->limits.a_max_mps2,
        &config->limits.alpha_max_radps2,
        &config->avoid.skirt_m,
        &config->avoid.v_creep_mps,
        &config->avoid.tau_s,
        &config->avoid.a_brake_mps2,
        &config->avoid.sigma_pose_m,
        &config->limits.wheel_speed_max_radps,
        &config->tracker.rim_change_max_mps2,
    };
    for (uint32_t count = in_u8(in) % 5u; count > 0; count--) {
        float *value = values[in_u8(in) % (sizeof values / sizeof values[0])];
        *value = in_some_float(in, 0.0f, 4.0f);
    }
}

#endif
