/* What the strategies share: a scenario in the firmware's terms, and its refusals in words. */
#ifndef HOST_SIM_STRATEGY_COMMON_H
#define HOST_SIM_STRATEGY_COMMON_H

#include "berth/controller.h"
#include "scenario.h"
#include "strategy.h"

/* What avoidance is told of the plant. The pose's delay counts as delay of the drives, and so does
 * their watchdog, where it is to count: the robot moves on by v_max times each. A wheel that slips
 * by s makes the robot faster by 1 + s than it is told to be, while it drives and while it brakes,
 * so the condition's (1 + s) (v_max (T + tau) + v_max^2 / (2 a)) is told as tau + s (T + tau) and a
 * / (1 + s). Of all this and the noise the part 1 - untold is told, so that the condition demands
 *
 *     v_max T + (1 - untold) (strategy_clearance(scenario) - v_max T). */
typedef struct {
    double tau_s;
    double a_brake_mps2; /* 0: unlimited */
    double sigma_pose_m;
} strategy_told_t;
strategy_told_t strategy_told(const scenario_t *scenario);

/* What the clearance condition demands of C - R with the plant as it is, and as it is told. */
double strategy_clearance(const scenario_t *scenario);
double strategy_clearance_told(const scenario_t *scenario);

/* The firmware's configuration for a scenario. Delay, braking and pose noise of the simulated robot
 * are what avoidance is told; the firmware's own acceleration limits stay off, because the
 * simulated drives have theirs. */
berth_config_t strategy_config(const scenario_t *scenario);

/* Has the configuration use the constrained tracker where the scenario asks for it. The workspace
 * must outlive the controller. */
void strategy_constrain(berth_config_t *config, const scenario_t *scenario,
                        berth_constrained_t *workspace);

/* An obstacle in float32. The regulated radius is at least C + skirt, which the doubles may miss by
 * their rounding. */
berth_obstacle_t strategy_obstacle(const scenario_t *scenario, const scenario_obstacle_t *obstacle);

/* One line: the key in the scenario, what it is, and the allowed range. */
void strategy_refusal_text(berth_error_t error, const berth_refusal_t *refusal,
                           scenario_error_t *out);

/* Out of memory, in the same form. */
void strategy_memory_text(scenario_error_t *out);

/* What every strategy with a law of its own has: the plan, and the robot's limits as the last
 * stage. The plan belongs to the scene and outlives the strategy. */
typedef struct {
    const berth_plan_t *plan;
    berth_limits_config_t limits_config;
    berth_limits_t limits;
    float period_s;
} strategy_drive_t;

/* Checks plan and limits. False with *error filled. */
bool strategy_drive_init(strategy_drive_t *drive, const strategy_scene_t *scene,
                         scenario_error_t *error);

/* Sample of a step, which a closed plan may go round for as long as it likes. */
berth_sample_t strategy_drive_sample(const strategy_drive_t *drive, long step);

/* Limits the command and hands it out. keep_omega as in berth_limits_apply. Returns the limits that
 * acted. */
uint8_t strategy_drive_output(strategy_drive_t *drive, berth_twist_t command, bool keep_omega,
                              berth_mode_t mode, strategy_output_t *out);

#endif
