#include "berth/limits.h"

#include "check.h"
#include "scalar.h"
#include "small.h"

#include <math.h>

#define RULE(field, zero_allowed, member, minimum, maximum)                                        \
    {(field), (zero_allowed), CHECK_AT(berth_limits_config_t, member), (minimum), (maximum)}

berth_error_t berth_limits_check(const berth_limits_config_t *config, berth_refusal_t *refusal) {
    /* where 0 switches a limit off, tiny values that are not 0 would be mistakes of unit */
    static const check_rule_t rules[] = {
        RULE(BERTH_FIELD_WHEEL_RADIUS, false, wheel_radius_m, 0.001f, 10.0f),
        RULE(BERTH_FIELD_TRACK, false, track_m, 0.01f, 10.0f),
        RULE(BERTH_FIELD_V_MAX, false, v_max_mps, 0.001f, 100.0f),
        RULE(BERTH_FIELD_OMEGA_MAX, false, omega_max_radps, 0.001f, 100.0f),
        RULE(BERTH_FIELD_WHEEL_SPEED_MAX, true, wheel_speed_max_radps, 0.001f, 10000.0f),
        RULE(BERTH_FIELD_A_MAX, true, a_max_mps2, 0.001f, 1000.0f),
        RULE(BERTH_FIELD_ALPHA_MAX, true, alpha_max_radps2, 0.001f, 1000.0f),
    };
    return check_rules(config, rules, CHECK_COUNT(rules), refusal) ? BERTH_OK : BERTH_ERROR_CONFIG;
}

void berth_limits_reset(berth_limits_t *limits) {
    limits->last = (berth_twist_t){0.0f, 0.0f};
}

SMALL static float clamp(float value, float magnitude) {
    if (value > magnitude) {
        return magnitude;
    }
    return value < -magnitude ? -magnitude : value;
}

/* Clamps and reports. */
SMALL static float limit(float value, float magnitude, uint8_t bit, uint8_t *limited) {
    const float result = clamp(value, magnitude);
    if (result != value) {
        *limited |= bit;
    }
    return result;
}

/* Scales v and omega alike, which keeps the curvature omega / v. */
static uint8_t scale_to_limits(const berth_limits_config_t *config, berth_twist_t *command) {
    const float v = fabsf(command->v_mps);
    const float omega = fabsf(command->omega_radps);
    const float rim_max = config->wheel_radius_m * config->wheel_speed_max_radps;
    const float rim = v + omega * (0.5f * config->track_m); /* of the faster wheel */
    float scale = 1.0f;
    uint8_t limited = 0;
    if (v > config->v_max_mps) {
        scale = config->v_max_mps / v;
        limited |= BERTH_LIMITED_V;
    }
    if (omega * scale > config->omega_max_radps) {
        scale = config->omega_max_radps / omega;
        limited |= BERTH_LIMITED_OMEGA;
    }
    if (rim_max > 0.0f && rim * scale > rim_max) {
        scale = rim_max / rim;
        limited |= BERTH_LIMITED_WHEEL;
    }
    if (limited != 0u) {
        /* the product may round to one unit above the limit */
        command->v_mps = clamp(command->v_mps * scale, config->v_max_mps);
        command->omega_radps = clamp(command->omega_radps * scale, config->omega_max_radps);
    }
    return limited;
}

/* Keeps omega as far as the robot can turn at all; v takes what is left of the wheels' speed. */
static uint8_t give_way_in_v(const berth_limits_config_t *config, berth_twist_t *command) {
    const float half_track = 0.5f * config->track_m;
    const float rim_max = config->wheel_radius_m * config->wheel_speed_max_radps;
    uint8_t limited = 0;
    float omega =
        limit(command->omega_radps, config->omega_max_radps, BERTH_LIMITED_OMEGA, &limited);
    float v = limit(command->v_mps, config->v_max_mps, BERTH_LIMITED_V, &limited);
    if (rim_max > 0.0f) {
        omega = limit(omega, rim_max / half_track, BERTH_LIMITED_WHEEL, &limited);
        const float left = rim_max - fabsf(omega) * half_track;
        v = limit(v, left > 0.0f ? left : 0.0f, BERTH_LIMITED_WHEEL, &limited);
    }
    *command = (berth_twist_t){v, omega};
    return limited;
}

/* Goes from the last command towards the new one by at most step; a step that suffices leaves the
 * new one as it is, to the bit. */
SMALL static float approach(float last, float target, float step, uint8_t bit, uint8_t *limited) {
    const float change = target - last;
    if (fabsf(change) <= step) {
        return target;
    }
    *limited |= bit;
    return change > 0.0f ? last + step : last - step;
}

/* On the way from one command to another at different rates the faster wheel may be asked for more
 * than it has. What grew gives way, the turn first, so that braking is never slowed; what it gives
 * way to is at most what it was, which the wheels could do. */
static void fit_wheels(const berth_twist_t *last, const berth_limits_config_t *config,
                       berth_twist_t *command, uint8_t *limited) {
    const float half_track = 0.5f * config->track_m;
    const float rim_max = config->wheel_radius_m * config->wheel_speed_max_radps;
    const float v = fabsf(command->v_mps);
    const float omega = fabsf(command->omega_radps);
    if (rim_max <= 0.0f || v + omega * half_track <= rim_max) {
        return;
    }
    const float turn = maximum((rim_max - v) / half_track, fabsf(last->omega_radps));
    command->omega_radps = clamp(command->omega_radps, minimum(omega, turn));
    const float left = rim_max - fabsf(command->omega_radps) * half_track;
    command->v_mps = clamp(command->v_mps, minimum(v, maximum(left, fabsf(last->v_mps))));
    *limited |= BERTH_LIMITED_WHEEL;
}

uint8_t berth_limits_apply(berth_limits_t *limits, const berth_limits_config_t *config,
                           float period_s, bool keep_omega, berth_twist_t *command) {
    uint8_t limited =
        keep_omega ? give_way_in_v(config, command) : scale_to_limits(config, command);
    const berth_twist_t last = limits->last;
    uint8_t slowed = 0;
    if (config->a_max_mps2 > 0.0f) {
        command->v_mps = approach(last.v_mps, command->v_mps, config->a_max_mps2 * period_s,
                                  BERTH_LIMITED_A, &slowed);
    }
    if (config->alpha_max_radps2 > 0.0f) {
        command->omega_radps =
            approach(last.omega_radps, command->omega_radps, config->alpha_max_radps2 * period_s,
                     BERTH_LIMITED_ALPHA, &slowed);
    }
    if (slowed != 0u) {
        limited |= slowed;
        fit_wheels(&last, config, command, &limited);
    }
    limits->last = *command;
    return limited;
}

berth_wheels_t berth_wheels_from_twist(const berth_limits_config_t *config, berth_twist_t twist) {
    const float turn_mps = 0.5f * config->track_m * twist.omega_radps;
    return (berth_wheels_t){
        .left_radps = (twist.v_mps - turn_mps) / config->wheel_radius_m,
        .right_radps = (twist.v_mps + turn_mps) / config->wheel_radius_m,
    };
}

berth_twist_t berth_twist_from_wheels(const berth_limits_config_t *config, berth_wheels_t wheels) {
    return (berth_twist_t){
        .v_mps = config->wheel_radius_m * (wheels.right_radps + wheels.left_radps) * 0.5f,
        .omega_radps =
            config->wheel_radius_m * (wheels.right_radps - wheels.left_radps) / config->track_m,
    };
}
