#include "laps.h"

#include <math.h>

static const double pi = 3.14159265358979323846;
static berth_sample_t samples[LAPS_COUNT_MAX];
static berth_plan_t plan;

#define KICKED(kind, shape, pace, laps)                                                            \
    {kind, shape, pace, 0, 1, laps, true}, {kind, shape, pace, 0, 2, laps, true}, {                \
        kind, shape, pace, 0, 3, laps, true                                                        \
    }

const laps_case_t laps_cases[LAPS_CASES] = {
    {"calm", LAPS_CIRCLE, 1.0, 0, 1, 1, false}, {"calm", LAPS_EIGHT, 1.0, 0, 1, 1, false},
    KICKED("kicked", LAPS_CIRCLE, 1.0, 1),      KICKED("kicked", LAPS_EIGHT, 1.0, 1),
    KICKED("saturating", LAPS_CIRCLE, 2.55, 2), KICKED("saturating", LAPS_EIGHT, 2.1, 2),
};

const char *laps_shape_name(laps_shape_t shape) {
    return shape == LAPS_EIGHT ? "eight" : "circle";
}

/* x = a sin(w t + shift), y = b sin(h w t). */
static berth_sample_t sample_at(laps_shape_t shape, double w, double t) {
    const int eight = shape == LAPS_EIGHT;
    const double a = eight ? 1.8 : 1.0;
    const double b = eight ? 1.2 : 1.0;
    const double h = eight ? 2.0 : 1.0;
    const double at = w * t + (eight ? 0.0 : pi / 2.0);
    const double xdot = a * w * cos(at);
    const double ydot = b * h * w * cos(h * w * t);
    const double xddot = -a * w * w * sin(at);
    const double yddot = -b * h * w * h * w * sin(h * w * t);
    const double square = xdot * xdot + ydot * ydot;
    return (berth_sample_t){(float)(a * sin(at)), (float)(b * sin(h * w * t)),
                            (float)atan2(ydot, xdot), (float)sqrt(square),
                            (float)((xdot * yddot - ydot * xddot) / square)};
}

const berth_plan_t *laps_plan(const laps_case_t *chosen) {
    const double pace = chosen->pace * (chosen->shape == LAPS_EIGHT ? 0.15 : 0.3);
    const double period_s = LAPS_PERIOD_US / 1.0e6;
    const uint32_t count = (uint32_t)(2.0 * pi / (pace * period_s) + 0.5);
    const uint32_t held = count < LAPS_COUNT_MAX ? count : LAPS_COUNT_MAX;
    for (uint32_t k = 0; k < held; k++) {
        samples[k] = sample_at(chosen->shape, 2.0 * pi / (held * period_s), k * period_s);
    }
    plan = (berth_plan_t){
        .samples = samples,
        .count = held,
        .period_us = LAPS_PERIOD_US,
        .mpc = {{10.0f, 40.0f, 1.0f}, {0.5f, 0.1f}, chosen->horizon, BERTH_DISCRETIZATION_EULER},
        .closed = true,
        .gain_source = BERTH_GAIN_ONLINE,
    };
    return &plan;
}

berth_limits_config_t laps_limits(void) {
    return (berth_limits_config_t){.wheel_radius_m = LAPS_WHEEL_RADIUS_M,
                                   .track_m = LAPS_TRACK_M,
                                   .v_max_mps = 2.0f,
                                   .omega_max_radps = 10.0f,
                                   .wheel_speed_max_radps = LAPS_WHEEL_MAX_RADPS};
}

laps_robot_t laps_start(const laps_case_t *chosen) {
    const berth_sample_t *first = &samples[0];
    return (laps_robot_t){(double)first->x_m, (double)first->y_m, (double)first->theta_rad,
                          2463534242u + 7919u * chosen->seed};
}

static double uniform(laps_robot_t *robot) {
    robot->random ^= robot->random << 13;
    robot->random ^= robot->random >> 17;
    robot->random ^= robot->random << 5;
    return (double)robot->random / 2147483648.0 - 1.0;
}

void laps_kick(laps_robot_t *robot, const laps_case_t *chosen, int step) {
    if (chosen->kicks && step % LAPS_KICK_EACH == LAPS_KICK_EACH - 1) {
        robot->x += 0.25 * uniform(robot);
        robot->y += 0.25 * uniform(robot);
        robot->theta += 0.6 * uniform(robot);
    }
}

void laps_move(laps_robot_t *robot, berth_twist_t command) {
    const double period_s = LAPS_PERIOD_US / 1.0e6;
    const double half = 0.5 * period_s * (double)command.omega_radps;
    const double chord =
        period_s * (double)command.v_mps * (fabs(half) > 1e-9 ? sin(half) / half : 1.0);
    robot->x += chord * cos(robot->theta + half);
    robot->y += chord * sin(robot->theta + half);
    robot->theta = remainder(robot->theta + 2.0 * half, 2.0 * pi);
}

double laps_distance2(const laps_robot_t *robot, const berth_sample_t *sample) {
    const double dx = (double)sample->x_m - robot->x;
    const double dy = (double)sample->y_m - robot->y;
    return dx * dx + dy * dy;
}

berth_tracking_error_t laps_error(const laps_robot_t *robot, const berth_sample_t *sample) {
    const berth_pose_t pose = {(float)robot->x, (float)robot->y, (float)robot->theta};
    berth_tracking_error_t error;
    berth_tracking_error(&pose, sample, &error);
    return error;
}

/* ---- Optimality ---- */

typedef struct {
    double way, turn;
} stage_t;

static stage_t stage_of(const berth_plan_t *of, uint32_t k) {
    const double period_s = of->period_us / 1.0e6;
    const berth_sample_t sample = berth_plan_sample(of, k);
    return (stage_t){period_s * (double)sample.v_mps, period_s * (double)sample.omega_radps};
}

double laps_residual(const berth_tracker_input_t *input, float rim_mps, const double *u) {
    static double e[BERTH_CONSTRAINED_HORIZON_MAX + 1][3];
    const berth_plan_t *of = input->plan;
    const int n = of->mpc.horizon;
    const double period_s = of->period_us / 1.0e6;
    const double half = (double)LAPS_TRACK_M / 2.0;
    const double q[3] = {(double)of->mpc.q[0], (double)of->mpc.q[1], (double)of->mpc.q[2]};
    const double r[2] = {(double)of->mpc.r[0], (double)of->mpc.r[1]};
    double worst = 0.0;
    e[0][0] = (double)input->error->e1_m;
    e[0][1] = (double)input->error->e2_m;
    e[0][2] = (double)input->error->e3_rad;
    for (int i = 0; i < n; i++) {
        const stage_t s = stage_of(of, input->reference->index + (uint32_t)i);
        e[i + 1][0] = e[i][0] + s.turn * e[i][1] + period_s * u[2 * i];
        e[i + 1][1] = e[i][1] - s.turn * e[i][0] + s.way * e[i][2];
        e[i + 1][2] = e[i][2] + period_s * u[2 * i + 1];
    }
    double l[3] = {0.0, 0.0, 0.0};
    for (int i = n - 1; i >= 0; i--) {
        const stage_t s = stage_of(of, input->reference->index + (uint32_t)i);
        for (int j = 0; j < 3; j++) {
            l[j] += q[j] * e[i + 1][j];
        }
        const double g1 = r[0] * u[2 * i] + period_s * l[0];
        const double g2 = (r[1] * u[2 * i + 1] + period_s * l[2]) / half;
        /* curvature of one rim alone, from its effort: a lower bound, so the move is the longer */
        const double curvature = 0.25 * (r[0] + r[1] / (half * half));
        const double face = i == 0 ? cos((double)input->error->e3_rad) : 1.0;
        for (int side = -1; side <= 1; side += 2) {
            const double base = (s.way * face + side * half * s.turn) / period_s;
            const double z = u[2 * i] + side * half * u[2 * i + 1];
            const double step = 0.5 * (g1 + side * g2) / curvature;
            const double moved =
                fmin(fmax(z - step, base - (double)rim_mps), base + (double)rim_mps);
            worst = fmax(worst, fabs(moved - z));
        }
        const double back[3] = {l[0] - s.turn * l[1], s.turn * l[0] + l[1], s.way * l[1] + l[2]};
        l[0] = back[0];
        l[1] = back[1];
        l[2] = back[2];
    }
    return worst;
}
