/* berth/types.h - the plain values that the modules exchange.
 *
 * Everything is in SI units; angles are radians, counter-clockwise positive. Floats are IEEE 754
 * single precision. A value that is not finite is bad input wherever it is given.
 *
 * A comment that begins with "@ requires" is a precondition in ACSL: the caller keeps it, nothing
 * checks it at run time. The controller and the board are proved to keep it in all that they call,
 * and check what they are given themselves.
 */
#ifndef BERTH_TYPES_H
#define BERTH_TYPES_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* The compiler warns when a result that may be an error is dropped. */
#if defined(__GNUC__)
#define BERTH_MUST_USE __attribute__((warn_unused_result))
#else
#define BERTH_MUST_USE
#endif

/* Largest time: sums of times and periods stay within int64. */
#define BERTH_TIME_MAX_US INT64_C(0x4000000000000000)

/* Largest |x| and |y| of a pose, a reference sample or an obstacle. At 1 km a float32 resolves
 * 61 micrometres, which is what the clearance tolerance of avoid.h is stated for. */
#define BERTH_POSITION_MAX_M 1000.0f

/* Pose of the robot's centre in the world frame. theta may be any finite angle. */
typedef struct {
    float x_m;
    float y_m;
    float theta_rad;
} berth_pose_t;

/* Velocity of the robot's body: forward speed and yaw rate. */
typedef struct {
    float v_mps;
    float omega_radps;
} berth_twist_t;

/* Angular speeds of the two wheels, positive forward. */
typedef struct {
    float left_radps;
    float right_radps;
} berth_wheels_t;

/* One sample of the reference, valid for one control period. theta in [-pi, pi]. */
typedef struct {
    float x_m;
    float y_m;
    float theta_rad;
    float v_mps;
    float omega_radps;
} berth_sample_t;

/* Feedback gain K of one sample, u = -K e: row 0 gives u1 (m/s), row 1 gives u2 (rad/s);
 * columns belong to e1 (m), e2 (m) and e3 (rad). */
typedef struct {
    float k[2][3];
} berth_gain_t;

/* Tracking error in the robot's frame: ahead, to the left, and in heading (in [-pi, pi)). */
typedef struct {
    float e1_m;
    float e2_m;
    float e3_rad;
} berth_tracking_error_t;

#ifdef __cplusplus
}
#endif

#endif
