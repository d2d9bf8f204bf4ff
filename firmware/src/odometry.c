#include "berth/odometry.h"

#include "angle_inline.h"
#include "check.h"
#include "count.h"

#include <math.h>

/* Largest travel of a wheel in one update. */
#define TRAVEL_MAX_RAD 1.0e4f

#define RULE(field, zero_allowed, member, minimum, maximum)                                        \
    {(field), (zero_allowed), CHECK_AT(berth_odometry_config_t, member), (minimum), (maximum)}

berth_error_t berth_odometry_init(berth_odometry_t *odometry, const berth_odometry_config_t *config,
                                  berth_refusal_t *refusal) {
    static const check_rule_t rules[] = {
        RULE(BERTH_FIELD_WHEEL_RADIUS, false, wheel_radius_m, 0.001f, 10.0f),
        RULE(BERTH_FIELD_TRACK, false, track_m, 0.01f, 10.0f),
        RULE(BERTH_FIELD_FIX_GAIN, false, fix_gain, 0.001f, 1.0f),
        RULE(BERTH_FIELD_FIX_JUMP_POSITION, true, fix_jump_m, 0.001f, 1000.0f),
        RULE(BERTH_FIELD_FIX_JUMP_HEADING, true, fix_jump_rad, 0.001f, BERTH_PI),
    };
    if (!check_rules(config, rules, CHECK_COUNT(rules), refusal)) {
        return BERTH_ERROR_CONFIG;
    }
    *odometry = (berth_odometry_t){.config = *config, .fix_us = -1};
    return BERTH_OK;
}

/* Adds to a sum that carries what its rounding lost. The error of the addition is found exactly
 * whichever of the two is larger (Knuth's two-sum): a heading near zero is smaller than its turn.
 */
static void add(float *sum, float *lost, float term) {
    const float before = *sum;
    const float after = before + term;
    const float taken = after - before;
    const float rest = ((before - (after - taken)) + (term - taken)) + *lost;
    *sum = after + rest;
    *lost = rest - (*sum - after);
}

/* Adds a turn of at most pi and wraps. A turn's worth is taken off in two parts, the larger one
 * exactly, so that laps do not add up a rounding error each. */
static void add_heading(berth_odometry_t *odometry, float turn_rad) {
    float *heading = &odometry->pose.theta_rad;
    float *lost = &odometry->lost_theta_rad;
    add(heading, lost, turn_rad);
    if (fabsf(*heading) <= ANGLE_WRAPPED_MAX) {
        return;
    }
    const bool left = *heading > 0.0f;
    *heading -= left ? ANGLE_TURN_HIGH : -ANGLE_TURN_HIGH;
    add(heading, lost, left ? -ANGLE_TURN_LOW : ANGLE_TURN_LOW);
    if (fabsf(*heading) > ANGLE_WRAPPED_MAX) {
        const float nearest = angle_with_sign(ANGLE_WRAPPED_MAX, *heading);
        *lost += *heading - nearest;
        *heading = nearest;
    }
}

/* sin(h) / h. The series' next term is below 3e-8 at 1. */
static float chord_share(float half_rad) {
    if (fabsf(half_rad) <= 1.0f) {
        const float z = half_rad * half_rad;
        return 1.0f + z * (-1.0f / 6.0f +
                           z * (1.0f / 120.0f + z * (-1.0f / 5040.0f + z * (1.0f / 362880.0f))));
    }
    float sine;
    float cosine;
    berth_sincos(half_rad, &sine, &cosine);
    return sine / half_rad;
}

static bool good_travel(float travel_rad) {
    return fabsf(travel_rad) <= TRAVEL_MAX_RAD;
}

void berth_odometry_advance(berth_odometry_t *odometry, float left_rad, float right_rad) {
    if (!good_travel(left_rad) || !good_travel(right_rad)) {
        odometry->known = false;
        count(&odometry->refused);
        return;
    }
    const float radius = odometry->config.wheel_radius_m;
    const float forward = 0.5f * radius * (left_rad + right_rad);
    const float turn = radius * (right_rad - left_rad) / odometry->config.track_m;
    const float half = 0.5f * turn;
    const float chord = forward * chord_share(half);
    float sine;
    float cosine;
    berth_sincos(odometry->pose.theta_rad + half, &sine, &cosine);
    add(&odometry->pose.x_m, &odometry->lost_x_m, chord * cosine);
    add(&odometry->pose.y_m, &odometry->lost_y_m, chord * sine);
    add_heading(odometry, berth_wrap(turn));
    odometry->distance_m += fabsf(forward);
}

/* Counts a pose from outside, good or not. */
static bool take(berth_odometry_t *odometry, const berth_pose_t *pose, int64_t now_us) {
    if (!(fabsf(pose->x_m) <= BERTH_POSITION_MAX_M && fabsf(pose->y_m) <= BERTH_POSITION_MAX_M &&
          fabsf(pose->theta_rad) <= CHECK_FLOAT_MAX)) {
        count(&odometry->refused);
        return false;
    }
    count(&odometry->fixes);
    odometry->distance_m = 0.0f;
    odometry->fix_us = now_us > 0 ? now_us : 0;
    return true;
}

static void take_over(berth_odometry_t *odometry, const berth_pose_t *pose) {
    odometry->pose = (berth_pose_t){pose->x_m, pose->y_m, berth_wrap(pose->theta_rad)};
    odometry->lost_x_m = 0.0f;
    odometry->lost_y_m = 0.0f;
    odometry->lost_theta_rad = 0.0f;
    odometry->known = true;
}

berth_error_t berth_odometry_set(berth_odometry_t *odometry, const berth_pose_t *pose,
                                 int64_t now_us) {
    if (!take(odometry, pose, now_us)) {
        return BERTH_ERROR_POSE;
    }
    take_over(odometry, pose);
    return BERTH_OK;
}

/* The fix is too far off to be noise. */
static bool jumps(const berth_odometry_config_t *config, float dx, float dy, float turn) {
    const float limit = config->fix_jump_m;
    return (limit > 0.0f && dx * dx + dy * dy > limit * limit) ||
           (config->fix_jump_rad > 0.0f && fabsf(turn) > config->fix_jump_rad);
}

berth_error_t berth_odometry_fix(berth_odometry_t *odometry, const berth_pose_t *pose,
                                 int64_t now_us) {
    if (!take(odometry, pose, now_us)) {
        return BERTH_ERROR_POSE;
    }
    if (!odometry->known) {
        take_over(odometry, pose);
        return BERTH_OK;
    }
    const float gain = odometry->config.fix_gain;
    const float dx = (pose->x_m - odometry->pose.x_m) - odometry->lost_x_m;
    const float dy = (pose->y_m - odometry->pose.y_m) - odometry->lost_y_m;
    const float turn = berth_wrap((berth_wrap(pose->theta_rad) - odometry->pose.theta_rad) -
                                  odometry->lost_theta_rad);
    if (jumps(&odometry->config, dx, dy, turn)) {
        count(&odometry->jumps);
        take_over(odometry, pose);
        return BERTH_OK;
    }
    add(&odometry->pose.x_m, &odometry->lost_x_m, gain * dx);
    add(&odometry->pose.y_m, &odometry->lost_y_m, gain * dy);
    add_heading(odometry, gain * turn);
    return BERTH_OK;
}

int64_t berth_odometry_fix_age_us(const berth_odometry_t *odometry, int64_t now_us) {
    if (odometry->fix_us < 0) {
        return INT64_MAX;
    }
    return now_us > odometry->fix_us ? now_us - odometry->fix_us : 0;
}
