#include "support.h"

#include "rng.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define PERIOD_US 50000u

static const double pi = 3.14159265358979323846;

static rng_t rng;

void support_random_start(void) {
    const char *text = getenv("BERTH_TEST_SEED");
    const uint64_t seed = text != NULL ? strtoull(text, NULL, 10) : SUPPORT_SEED;
    printf("seed %llu (BERTH_TEST_SEED)\n", (unsigned long long)seed);
    rng_seed(&rng, seed);
}

double support_uniform(double low, double high) {
    return rng_uniform(&rng, low, high);
}

double support_log_uniform(double low, double high) {
    return exp(support_uniform(log(low), log(high)));
}

uint32_t support_index(uint32_t count) {
    return (uint32_t)(rng_u64(&rng) % count);
}

uint32_t support_runs(uint32_t full) {
    const char *effort = getenv("BERTH_TEST_EFFORT");
    uint32_t part = 1;
    if (effort != NULL && strcmp(effort, "full") != 0) {
        part = strcmp(effort, "short") == 0 ? 10 : (uint32_t)strtoul(effort, NULL, 10);
    }
    if (part == 0) {
        abort();
    }
    return full > part ? full / part : 1;
}

berth_mpc_t support_mpc(void) {
    return (berth_mpc_t){
        .q = {10.0f, 40.0f, 1.0f},
        .r = {0.5f, 0.1f},
        .horizon = 20,
        .discretization = BERTH_DISCRETIZATION_EULER,
    };
}

/* x = a sin(w t + shift), y = b sin(h w t): velocity and curvature by differentiation. */
static berth_sample_t shape_sample(support_shape_t shape, double w, double t) {
    const bool eight = shape == SUPPORT_EIGHT;
    const double a = eight ? 1.8 : 1.0;
    const double b = eight ? 1.2 : 1.0;
    const double h = eight ? 2.0 : 1.0;
    const double shift = eight ? 0.0 : pi / 2.0;
    const double xdot = a * w * cos(w * t + shift);
    const double ydot = b * h * w * cos(h * w * t);
    const double xddot = -a * w * w * sin(w * t + shift);
    const double yddot = -b * h * w * h * w * sin(h * w * t);
    const double square = xdot * xdot + ydot * ydot;
    return (berth_sample_t){
        .x_m = (float)(a * sin(w * t + shift)),
        .y_m = (float)(b * sin(h * w * t)),
        .theta_rad = (float)atan2(ydot, xdot),
        .v_mps = (float)sqrt(square),
        .omega_radps = (float)((xdot * yddot - ydot * xddot) / square),
    };
}

void support_plan(support_plan_t *out, support_shape_t shape, uint32_t count, bool closed) {
    if (count > SUPPORT_PLAN_MAX) {
        abort();
    }
    const double period_s = PERIOD_US / 1.0e6;
    const double pace = shape == SUPPORT_EIGHT ? 0.15 : 0.3;
    const double w = closed ? 2.0 * pi / (count * period_s) : pace;
    for (uint32_t k = 0; k < count; k++) {
        out->samples[k] = shape_sample(shape, w, k * period_s);
    }
    out->plan = (berth_plan_t){
        .samples = out->samples,
        .count = count,
        .period_us = PERIOD_US,
        .mpc = support_mpc(),
        .closed = closed,
        .gain_source = BERTH_GAIN_ONLINE,
    };
}

void support_fill_gains(support_plan_t *out) {
    for (uint32_t k = 0; k < out->plan.count; k++) {
        berth_riccati_gain(&out->plan, k, &out->gains[k]);
    }
    out->plan.gains = out->gains;
    out->plan.gain_source = BERTH_GAIN_TABLE;
}

double support_wrap(double angle_rad) {
    const double wrapped = remainder(angle_rad, 2.0 * pi);
    return wrapped >= pi ? -pi : wrapped;
}

support_pose_t support_move(support_pose_t pose, double v_mps, double omega_radps, double time_s) {
    const double turn = omega_radps * time_s;
    const double half = 0.5 * turn;
    /* chord of the arc, and its direction */
    const double chord = v_mps * time_s * (fabs(half) > 1e-9 ? sin(half) / half : 1.0);
    return (support_pose_t){
        .x_m = pose.x_m + chord * cos(pose.theta_rad + half),
        .y_m = pose.y_m + chord * sin(pose.theta_rad + half),
        .theta_rad = support_wrap(pose.theta_rad + turn),
    };
}

berth_pose_t support_measure(support_pose_t pose) {
    return (berth_pose_t){(float)pose.x_m, (float)pose.y_m, (float)pose.theta_rad};
}

bool support_same_bits(float a, float b) {
    return memcmp(&a, &b, sizeof a) == 0;
}
