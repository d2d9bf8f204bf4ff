/* berth/avoid.h - two-region obstacle avoidance: tracking command in, safe command out.
 *
 * Around each obstacle, from the inside: the hard radius R (entering it is a collision), the
 * conservative radius C, the skirt S = C + delta that the robot steers to pass, and the regulated
 * radius G. An obstacle is active while the robot is within G. A heading is free of an obstacle
 * when driving along it never comes nearer than the skirt (or than now, inside the skirt).
 *
 *   heading free of all active obstacles: the turn is clamped so that it stays free; when that took
 *     nothing away the tracking command passes (TRACK), else the robot skirts (REGULATED, or
 *     CONSERVATIVE_GO within some C);
 *   heading not free: turn to a free edge, driving (REGULATED) or, within some C, standing
 *     (CONSERVATIVE_TURN);
 *   no free heading: stop (BLOCKED), for as long as that holds.
 *
 * Delay. Drives, or poses, that are late by tau make the robot overshoot a turn that is meant to
 * end within one period: it swings about the edge and, within C, comes a little nearer each time,
 * which no C - R counts. So a turn that keeps the heading free is clamped to reach the edge in T +
 * tau.
 *
 * Pace. Turns to a free heading overshoot as well, and the robot dips into C. And a tracking error
 * that is as large as the obstacle says nothing about the speed: a robot that has come round too
 * early turns back to a reference that is still inside. With paced set and tau > 0, while no active
 * obstacle is within its C,
 *   - turns to a cone's edge are planned over T + tau instead of T, too;
 *   - the robot skirts with the speed that brings it to the reference's first sample beyond the
 *     obstacle (see BERTH_SCAN_AHEAD), as the crow flies, in 4/5 of the time that the reference
 *     still needs, and with v_max once the reference is there. Where no such sample is known, the
 *     speed is the one without pace.
 * Compiled with BERTH_WITHOUT_PACE the flag has no effect, which saves some 200 bytes of flash.
 *
 * Clearance theorem. Let obstacles stand still, commands be executed exactly, |v| <= v_max,
 * omega_max T <= pi/2 and C - R >= v_max T for each obstacle. If the robot starts outside all hard
 * radii, it stays outside, between the control instants too, however many obstacles there are and
 * however they overlap. With delay tau, braking a_brake and pose noise sigma the condition is
 *
 *     C - R >= v_max (T + tau) + v_max^2 / (2 a_brake) + 3 sigma
 *
 * and the speed towards an obstacle ahead is capped so that the robot can still stop at R. A
 * configuration that breaks the condition is refused.
 *
 * Proof. Within one period let phi run over the headings relative to the obstacle's direction at
 * the period's start; the turn is at most pi/2.
 *  (a) Heading free. All phi lie in [alpha, 2 pi - alpha]. When they lie in [alpha, pi + alpha],
 * each has a component >= 0 away from the tangent to the skirt, so the robot stays in the half
 * plane beyond it; likewise for the other tangent when they lie in [pi - alpha, 2 pi - alpha]. In
 * no other case does a turn of at most pi/2 leave [pi/2, 3 pi/2], where each phi points away from
 *      the obstacle and the distance cannot shrink. So it ends no nearer than min(d, S). Within the
 *      skirt alpha = pi/2, and the distance does not shrink at all.
 *  (b) Heading not free. The robot stands, or starts above C and covers at most v_max T.
 *  (c) The obstacle is not active: it is further away than G >= C, and the robot covers at most
 *      v_max T.
 * In (b) and (c) it ends at C - v_max T >= R or further; in (a) it comes no nearer than it was, or
 * than S. By induction d >= R always. None of this depends on how far towards the edge of the free
 * interval a turn goes, nor, up to v_max, on the speed: pace chooses only these. Speed limits
 * applied afterwards shrink the turn, which keeps it within the free interval, and the speed.
 * Acceleration limits are outside the proof, as all delay is: a_max belongs into a_brake
 * (demanded), and where alpha_max is set the time from full turn one way to full turn the other, 2
 * omega_max / alpha_max, is added to tau in the condition.
 *
 * Tolerance. The angles carry rounding errors of up to 5e-6 rad within 16 m of the origin. A turn
 * is clamped BERTH_EDGE_MARGIN_RAD short of a cone's edge and a turn to an edge goes that much
 * beyond it, so a heading that avoidance chose is free in exact arithmetic too. "Free" is then
 * tested as gap >= -BERTH_FREE_TOLERANCE_RAD, which admits such headings in spite of the rounding.
 * A heading that is free by the tolerance alone (the robot was started so) costs at most v_max T
 * times the tolerance: 1.2 micrometres at 0.8 m/s and 50 ms, once, since moving on by s turns the
 * obstacle's direction away by s / d and the clamp does not let the robot turn back. Against a
 * skirt seen at nearly pi/2 the rounding of S / d gives larger errors of the angle, but errors of
 * the passing distance below 1e-7 S.
 */
#ifndef BERTH_AVOID_H
#define BERTH_AVOID_H

#include "berth/limits.h"
#include "berth/obstacles.h"
#include "berth/reference.h"
#include "berth/result.h"
#include "berth/types.h"

#ifdef __cplusplus
extern "C" {
#endif

/* See "Tolerance" above. */
#define BERTH_EDGE_MARGIN_RAD 1.0e-5f
#define BERTH_FREE_TOLERANCE_RAD 3.0e-5f

/* Slack of the clearance condition and of G >= C + skirt, for radii that are sums rounded to
 * float32: one micrometre. */
#define BERTH_RADIUS_SLACK_M 1.0e-6f

/* Look-ahead for the choice of side: how far along the reference, and how many samples a step. A
 * step serves one obstacle, each in turn, with two samples for each obstacle that there is: one
 * keeps up with the reference and one gains on it; never fewer than the least nor more than the
 * most. While two or more obstacles are active, and during a turn, it stands and spends what it is
 * ahead, unless there is one that it has never looked at. */
#ifndef BERTH_SCAN_AHEAD
#define BERTH_SCAN_AHEAD 400u
#endif
#define BERTH_SCAN_PER_STEP_MIN 16u
#define BERTH_SCAN_PER_STEP_MAX 32u

typedef enum {
    BERTH_MODE_TRACK = 0,
    BERTH_MODE_REGULATED = 1,
    BERTH_MODE_CONSERVATIVE_TURN = 2,
    BERTH_MODE_CONSERVATIVE_GO = 3,
    BERTH_MODE_BLOCKED = 4
} berth_mode_t;

typedef struct {
    float skirt_m;      /* delta: 0 to 10 */
    float v_creep_mps;  /* least speed while skirting: 0.001 to v_max */
    float tau_s;        /* delay of the drives: 0 to 10 */
    float a_brake_mps2; /* braking that the drives are sure of: 0 (unlimited), or 0.001 to 1000;
                             with limits.a_max_mps2 set: 0.001 to that */
    float sigma_pose_m; /* standard deviation of the measured position: 0 to 1 */
    bool paced;         /* see "Pace" above; without delay, tau_s = 0, it changes nothing */
} berth_avoid_config_t;

/* Configuration with what follows from it, and the state that is not one obstacle's. */
typedef struct {
    berth_avoid_config_t config;
    float period_s;
    float v_max_mps;
    float omega_max_radps;
    float clearance_min_m; /* least C - R */
    /* of the last step: */
    float clearance_m; /* least d - R over the active obstacles; BERTH_RADIUS_MAX_M with none */
    uint8_t active;    /* number of active obstacles */
    bool braking;      /* the braking cap took speed away */
    uint8_t scan_next; /* slot whose look-ahead runs next */
    int8_t turning;    /* direction of the turn to a free heading, kept until it is free; 0 none */
} berth_avoid_t;

/* Validates the configuration together with the robot's limits and the period, and sets *avoid up
 * with it. Returns BERTH_OK, or BERTH_ERROR_CONFIG with *refusal filled. */
BERTH_MUST_USE berth_error_t berth_avoid_init(berth_avoid_t *avoid,
                                              const berth_avoid_config_t *config,
                                              const berth_limits_config_t *limits,
                                              uint32_t period_us, berth_refusal_t *refusal);

/* The clearance condition and G >= C + skirt for one obstacle that passed berth_obstacle_check.
 * Returns BERTH_OK; BERTH_ERROR_CLEARANCE with the numbers (value = C - R, minimum = what the
 * condition demands); or BERTH_ERROR_CONFIG. */
BERTH_MUST_USE berth_error_t berth_avoid_check_obstacle(const berth_avoid_t *avoid,
                                                        const berth_obstacle_t *obstacle,
                                                        berth_refusal_t *refusal);

/* One period. *command is the tracking command on entry and the safe one on return; limits that
 * keep the yaw rate must be applied after it (berth_limits_apply with keep_omega) unless the mode
 * is BERTH_MODE_TRACK. The pose must be finite. A robot exactly on an obstacle's centre has no free
 * heading: BLOCKED. Cost: constant per obstacle, some 20 instructions for one that is not active
 * and some 150 for one that is; when the heading is not free, at most (active + 1) passes over the
 * active ones for either side; and the look-ahead's samples. */
/*@ requires checked: 1 <= plan->count <= BERTH_PLAN_COUNT_MAX; */
berth_mode_t berth_avoid_step(berth_avoid_t *avoid, berth_obstacles_t *obstacles,
                              const berth_plan_t *plan, const berth_reference_t *reference,
                              const berth_pose_t *pose, berth_twist_t *command);

/* Lower-case name of a mode, as in the log; "?" outside the enum. */
const char *berth_mode_text(berth_mode_t mode);

#ifdef __cplusplus
}
#endif

#endif
