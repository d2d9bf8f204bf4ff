/* berth/result.h - how functions fail, and what a refused configuration says.
 *
 * Functions that can fail return a berth_error_t: 0 is success, every error is negative. Functions
 * that validate also fill a berth_refusal_t when they refuse: which field, of which element, the
 * value found and the range allowed, so that a caller can print one clear line.
 */
#ifndef BERTH_RESULT_H
#define BERTH_RESULT_H

#include "berth/types.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum {
    BERTH_OK = 0,
    BERTH_ERROR_ARGUMENT = -1,  /* a required pointer is missing */
    BERTH_ERROR_CONFIG = -2,    /* a configuration value is not finite or out of range */
    BERTH_ERROR_PLAN = -3,      /* a value of the plan is not finite or out of range */
    BERTH_ERROR_CLEARANCE = -4, /* an obstacle's regions are too narrow for the clearance proof */
    BERTH_ERROR_CAPACITY = -5,  /* no room for one more obstacle */
    BERTH_ERROR_POSE = -6,      /* the pose is not finite or outside BERTH_POSITION_MAX_M */
    BERTH_ERROR_TIME = -7,      /* the time went backwards */
    BERTH_ERROR_STATE = -8      /* called before berth_controller_start, or with no plan */
} berth_error_t;

/* The values that validation can refuse. */
typedef enum {
    BERTH_FIELD_NONE = 0,
    BERTH_FIELD_PLAN_COUNT,
    BERTH_FIELD_PLAN_PERIOD,
    BERTH_FIELD_PLAN_HORIZON,
    BERTH_FIELD_PLAN_DISCRETIZATION,
    BERTH_FIELD_PLAN_Q,
    BERTH_FIELD_PLAN_R,
    BERTH_FIELD_PLAN_GAIN_SOURCE,
    BERTH_FIELD_SAMPLE_X,
    BERTH_FIELD_SAMPLE_Y,
    BERTH_FIELD_SAMPLE_THETA,
    BERTH_FIELD_SAMPLE_V,
    BERTH_FIELD_SAMPLE_OMEGA,
    BERTH_FIELD_GAIN,
    BERTH_FIELD_WHEEL_RADIUS,
    BERTH_FIELD_TRACK,
    BERTH_FIELD_V_MAX,
    BERTH_FIELD_OMEGA_MAX,
    BERTH_FIELD_WHEEL_SPEED_MAX,
    BERTH_FIELD_A_MAX,
    BERTH_FIELD_ALPHA_MAX,
    BERTH_FIELD_SKIRT,
    BERTH_FIELD_V_CREEP,
    BERTH_FIELD_TAU,
    BERTH_FIELD_A_BRAKE,
    BERTH_FIELD_SIGMA_POSE,
    BERTH_FIELD_TURN_PER_PERIOD, /* omega_max T */
    BERTH_FIELD_OBSTACLE_X,
    BERTH_FIELD_OBSTACLE_Y,
    BERTH_FIELD_OBSTACLE_HARD,
    BERTH_FIELD_OBSTACLE_CONSERVATIVE,
    BERTH_FIELD_OBSTACLE_REGULATED,
    BERTH_FIELD_CLEARANCE,  /* C - R of one obstacle */
    BERTH_FIELD_DRIVE_NODE, /* of a drive: index 0 left, 1 right */
    BERTH_FIELD_DRIVE_SIGN,
    BERTH_FIELD_GEAR_RATIO,
    BERTH_FIELD_POLE_PAIRS,
    BERTH_FIELD_DRIVE_MODE,
    BERTH_FIELD_MASTER_NODE,
    BERTH_FIELD_COUNTS_PER_TURN,
    BERTH_FIELD_VELOCITY_UNITS,
    BERTH_FIELD_FEEDBACK_TIMEOUT,
    BERTH_FIELD_HEARTBEAT_TIMEOUT,
    BERTH_FIELD_ENABLE_TIMEOUT,
    BERTH_FIELD_FIX_GAIN,
    BERTH_FIELD_FIX_JUMP_POSITION,
    BERTH_FIELD_FIX_JUMP_HEADING,
    BERTH_FIELD_FIX_TIMEOUT,
    BERTH_FIELD_PERIOD_LATE,
    BERTH_FIELD_TRANSMIT_TIMEOUT,
    BERTH_FIELD_ARM_TIMEOUT,
    BERTH_FIELD_STOP_TIMEOUT,
    BERTH_FIELD_STANDING,
    BERTH_FIELD_FOLLOWING,
    BERTH_FIELD_FOLLOWING_TIME,
    BERTH_FIELD_REGION_BODY,
    BERTH_FIELD_REGION_CONSERVATIVE,
    BERTH_FIELD_REGION_REGULATED,
    BERTH_FIELD_RIM_CHANGE_MAX,
    BERTH_FIELD_COUNT
} berth_field_t;

/* Why something was refused. minimum and maximum are the allowed range, both included; the range
 * may depend on other values (the clearance condition does). */
typedef struct {
    berth_field_t field;
    uint32_t index; /* of the sample, obstacle or vector element; 0 where there is only one */
    float value;
    float minimum;
    float maximum;
} berth_refusal_t;

/* Short English text of an error or a field; never NULL, also for values outside the enum.
 * Cost: a table look-up. May be called from an interrupt. */
const char *berth_error_text(berth_error_t error);
const char *berth_field_text(berth_field_t field);

#ifdef __cplusplus
}
#endif

#endif
