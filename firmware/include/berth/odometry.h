/* berth/odometry.h - wheel motion in, pose out; pose fixes from outside.
 *
 * Between two updates each wheel is taken to turn at a constant rate, so the robot moves along an
 * arc of a circle; the pose at its end is exact up to rounding (arc integration; see Borenstein,
 * Everett & Feng, "Where am I?", 1996). A fix from outside (a camera, a beacon, a lidar's scan
 * match) corrects the pose: a share of the difference, or all of it when it is the first or too far
 * off to be noise.
 *
 * One struct, one context. Positions and heading add up with compensated sums (Kahan 1965; the
 * error of each addition by Knuth's two-sum), so that small steps are not lost far from the origin
 * and laps do not turn the heading. A mirrored drive gives mirrored bits.
 */
#ifndef BERTH_ODOMETRY_H
#define BERTH_ODOMETRY_H

#include "berth/result.h"
#include "berth/types.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    float wheel_radius_m; /* as in berth_limits_config_t */
    float track_m;
    float fix_gain;     /* share of a fix's difference that is taken: 0.001 to 1 */
    float fix_jump_m;   /* 0 (never), or 0.001 to 1000: a fix further off is taken over whole */
    float fix_jump_rad; /* 0 (never), or 0.001 to pi */
} berth_odometry_config_t;

typedef struct {
    berth_odometry_config_t config;
    berth_pose_t pose;
    float lost_x_m; /* what rounding took from the sums: they mean pose + lost */
    float lost_y_m;
    float lost_theta_rad;
    float distance_m; /* driven since the last fix, forward and backward added up */
    int64_t fix_us;   /* time of the last fix; -1: none yet */
    bool known;       /* the pose means something: set, or a fix was taken */
    uint32_t fixes;   /* taken */
    uint32_t jumps;   /* of these, too far off: taken over whole though a pose was known */
    uint32_t refused; /* fixes and travel: not finite or out of range */
} berth_odometry_t;

/* Validates the configuration and sets the odometry up with no known pose. Returns BERTH_OK or
 * BERTH_ERROR_CONFIG with *refusal filled. */
BERTH_MUST_USE berth_error_t berth_odometry_init(berth_odometry_t *odometry,
                                                 const berth_odometry_config_t *config,
                                                 berth_refusal_t *refusal);

/* Moves the pose by the wheels' travel, in rad, positive forward. Travel that is not finite or
 * above 1e4 rad is refused, and counted: then the pose is no longer known. theta stays within
 * [-pi, pi). A turn beyond pi in one update is wrapped to 2e-6 rad first. Constant cost. */
void berth_odometry_advance(berth_odometry_t *odometry, float left_rad, float right_rad);

/* Takes the pose over, as by a fix that is not blended, and counts as one. now_us: 0 to
 * BERTH_TIME_MAX_US. Returns BERTH_OK, or BERTH_ERROR_POSE (not finite, or |x| or |y| above
 * BERTH_POSITION_MAX_M; counted, nothing changes). */
BERTH_MUST_USE berth_error_t berth_odometry_set(berth_odometry_t *odometry,
                                                const berth_pose_t *pose, int64_t now_us);

/* A pose measured outside, for the present moment: taken over when none is known or when it is
 * further off than fix_jump_*, else blended with fix_gain. Errors as berth_odometry_set. */
BERTH_MUST_USE berth_error_t berth_odometry_fix(berth_odometry_t *odometry,
                                                const berth_pose_t *pose, int64_t now_us);

/* Age of the last fix in microseconds, 0 when now_us is before it; INT64_MAX when there was none.
 */
int64_t berth_odometry_fix_age_us(const berth_odometry_t *odometry, int64_t now_us);

#ifdef __cplusplus
}
#endif

#endif
