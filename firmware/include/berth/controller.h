/* berth/controller.h - one control loop: pose and time in, wheel speeds out.
 *
 *     berth_controller_init(&controller, &plan, &config, &refusal);
 *     berth_controller_add_obstacle(&controller, &obstacle, &refusal);    as often as needed
 *     berth_controller_start(&controller, now_us);
 *     each period: berth_controller_step(&controller, now_us, &pose, &command);
 *
 * Obstacles that are seen on the way come and go with berth_controller_put_obstacle, before or
 * after the start.
 *
 * All state is in the caller's struct; nothing is allocated and no clock is read. A controller is
 * not thread safe: all calls for one controller belong to one context (a task or one interrupt
 * level). Different controllers are independent.
 *
 * Safety: whatever goes wrong in a step, the command is zero, the reason is returned and kept, and
 * every later step gives zero and the same reason until berth_controller_start is called again.
 */
#ifndef BERTH_CONTROLLER_H
#define BERTH_CONTROLLER_H

#include "berth/avoid.h"
#include "berth/constrained.h"
#include "berth/error.h"
#include "berth/limits.h"
#include "berth/obstacles.h"
#include "berth/reference.h"
#include "berth/riccati.h"
#include "berth/tracker.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    berth_limits_config_t limits;
    berth_avoid_config_t avoid;
    berth_tracker_t tracker; /* all zero: the gain; or what berth_constrained_tracker returns */
} berth_config_t;

/* Reasonable start for a small indoor robot: fill in the wheels, and the limits that differ. */
berth_config_t berth_config_default(float wheel_radius_m, float track_m);

typedef struct {
    berth_twist_t twist;
    berth_wheels_t wheels;
} berth_command_t;

/* What the last step saw and did. */
typedef struct {
    berth_error_t error; /* why the robot stands, or BERTH_OK; kept until the next start */
    berth_mode_t mode;
    berth_tracking_error_t tracking_error;
    berth_sample_t sample; /* the reference that was tracked */
    float clearance_m;     /* least d - R over the active obstacles; BERTH_RADIUS_MAX_M with none */
    uint32_t index;        /* of the sample; plan->count past the end of an open plan */
    uint32_t skipped;      /* periods passed over since the start because steps came late */
    uint8_t active;        /* obstacles within their regulated radius */
    uint8_t limited;       /* BERTH_LIMITED_* that acted */
    uint8_t passes;        /* of the constrained tracker; 0 with the gain */
    bool suboptimal;       /* the constrained tracker stopped before its optimum */
    bool braking;          /* the braking cap took speed away */
    bool finished;         /* past the end of an open plan, holding its last pose */
} berth_status_t;

typedef struct {
    const berth_plan_t *plan;
    berth_limits_config_t limits_config;
    berth_limits_t limits;
    berth_avoid_t avoid;
    berth_obstacles_t obstacles;
    berth_reference_t reference;
    berth_gain_t hold_gain; /* for the last pose of an open plan */
    berth_tracker_t tracker;
    int64_t last_us;
    bool started;
    berth_status_t status;
} berth_controller_t;

/* Validates plan and configuration and prepares the controller, with no obstacles and not started.
 * plan stays referenced and must outlive the controller's use. Cost: O(plan->count).
 * Returns BERTH_OK; BERTH_ERROR_ARGUMENT; BERTH_ERROR_PLAN or BERTH_ERROR_CONFIG with *refusal
 * filled. After an error the controller is unusable: its steps give BERTH_ERROR_STATE. */
BERTH_MUST_USE berth_error_t berth_controller_init(berth_controller_t *controller,
                                                   const berth_plan_t *plan,
                                                   const berth_config_t *config,
                                                   berth_refusal_t *refusal);

/* Checks an obstacle, the clearance condition included, and adds it. Returns BERTH_OK;
 * BERTH_ERROR_CONFIG or BERTH_ERROR_CLEARANCE with *refusal filled (index: the number that the
 * obstacle would have had); BERTH_ERROR_CAPACITY; BERTH_ERROR_STATE before a successful init. */
BERTH_MUST_USE berth_error_t berth_controller_add_obstacle(berth_controller_t *controller,
                                                           const berth_obstacle_t *obstacle,
                                                           berth_refusal_t *refusal);

/* Checks an obstacle as berth_controller_add_obstacle does, and puts it under an id until
 * expires_us: see berth_obstacles_put. It is dropped by the first step at that time or later
 * (BERTH_OBSTACLE_FOREVER: by none). May be called while running. The clearance theorem holds from
 * the moment on that the robot is outside its hard radius; an obstacle that appears around the
 * robot makes it stand, turn away and leave.
 * Returns BERTH_OK; BERTH_ERROR_CONFIG or BERTH_ERROR_CLEARANCE with *refusal filled (index: the
 * id); BERTH_ERROR_CAPACITY; BERTH_ERROR_ARGUMENT (a pointer is missing, or an id above
 * BERTH_OBSTACLE_ID_MAX); BERTH_ERROR_STATE before a successful init. After an error nothing has
 * changed: an old obstacle with that id stays. */
BERTH_MUST_USE berth_error_t berth_controller_put_obstacle(berth_controller_t *controller,
                                                           uint16_t id,
                                                           const berth_obstacle_t *obstacle,
                                                           int64_t expires_us,
                                                           berth_refusal_t *refusal);

/* Removes the obstacle that was put under this id, if there is one; those that were added stay. May
 * be called while running. */
void berth_controller_remove_obstacle(berth_controller_t *controller, uint16_t id);

/* Starts (or restarts) at sample 0 with the robot taken to stand, and clears a kept error.
 * Returns BERTH_OK, BERTH_ERROR_STATE before a successful init, or BERTH_ERROR_TIME. Cost: the
 * look-ahead for each obstacle, up to BERTH_SCAN_AHEAD samples. */
BERTH_MUST_USE berth_error_t berth_controller_start(berth_controller_t *controller, int64_t now_us);

/* One period: drops the obstacles that have expired, advances the reference, computes error, law,
 * avoidance and limits.
 * now_us: monotonic time. pose: measured pose at that time; theta may be any finite angle.
 * *command is always written: zero on any error. A step without a command to write stops the robot
 * like any other error.
 * Returns BERTH_OK, or the kept reason: BERTH_ERROR_POSE (not finite, or |x| or |y| above
 * BERTH_POSITION_MAX_M), BERTH_ERROR_TIME (now_us before the last step's, or
 * outside 0 to BERTH_TIME_MAX_US), BERTH_ERROR_STATE (not
 * started), BERTH_ERROR_ARGUMENT (a pointer is missing).
 * Cost: see the README's table; bounded, no loop depends on anything but the number of obstacles,
 * with online gains the horizon, and with the constrained tracker its passes. */
BERTH_MUST_USE berth_error_t berth_controller_step(berth_controller_t *controller, int64_t now_us,
                                                   const berth_pose_t *pose,
                                                   berth_command_t *command);

/* The last step's status; valid until the next call. controller must not be NULL. */
const berth_status_t *berth_controller_status(const berth_controller_t *controller);

#ifdef __cplusplus
}
#endif

#endif
