/* berth/limits.h - what the wheels can do: speed, yaw rate, wheel speed and acceleration limits.
 *
 * The last stage before the wheels. While tracking, a command outside the limits is scaled so that
 * the path's curvature is kept; while avoiding, the yaw rate is kept and the speed gives way.
 * Acceleration limits come last and bound every command but the stop after an error.
 */
#ifndef BERTH_LIMITS_H
#define BERTH_LIMITS_H

#include "berth/result.h"
#include "berth/types.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    float wheel_radius_m;        /* r: 0.001 to 10 */
    float track_m;               /* b, between the wheels' contact points: 0.01 to 10 */
    float v_max_mps;             /* 0.001 to 100 */
    float omega_max_radps;       /* 0.001 to 100 */
    float wheel_speed_max_radps; /* 0 (no further limit), or 0.001 to 10000 */
    float a_max_mps2;            /* 0 (none), or 0.001 to 1000: change of v */
    float alpha_max_radps2; /* 0 (none), or 0.001 to 1000: change of omega. See avoid.h: it adds to
                          the delay that the clearance condition is about */
} berth_limits_config_t;

/* Limits that acted in a step. */
#define BERTH_LIMITED_V 0x01u
#define BERTH_LIMITED_OMEGA 0x02u
#define BERTH_LIMITED_WHEEL 0x04u
#define BERTH_LIMITED_A 0x08u
#define BERTH_LIMITED_ALPHA 0x10u

/* Memory of the acceleration limits: the command given last. */
typedef struct {
    berth_twist_t last;
} berth_limits_t;

/* Validates the configuration. Returns BERTH_OK, or BERTH_ERROR_CONFIG with *refusal filled. */
BERTH_MUST_USE berth_error_t berth_limits_check(const berth_limits_config_t *config,
                                                berth_refusal_t *refusal);

/* Forgets the last command: the robot is taken to stand. */
void berth_limits_reset(berth_limits_t *limits);

/* Limits *command in place. keep_omega selects the avoiding form (see above). period_s > 0.
 * Returns the BERTH_LIMITED_* bits of the limits that acted. Constant cost. */
uint8_t berth_limits_apply(berth_limits_t *limits, const berth_limits_config_t *config,
                           float period_s, bool keep_omega, berth_twist_t *command);

/* v = r (wR + wL) / 2, omega = r (wR - wL) / b, and its inverse. Pure; constant cost. */
berth_wheels_t berth_wheels_from_twist(const berth_limits_config_t *config, berth_twist_t twist);
berth_twist_t berth_twist_from_wheels(const berth_limits_config_t *config, berth_wheels_t wheels);

#ifdef __cplusplus
}
#endif

#endif
