/* The controllers that the simulator compares, under one interface and chosen by name. */
#ifndef HOST_SIM_STRATEGY_H
#define HOST_SIM_STRATEGY_H

#include "berth/avoid.h"
#include "berth/reference.h"
#include "scenario.h"

/* What every strategy is given: the same plan, robot and obstacles. The plan's gains are Berth's
 * table; strategies with their own law use its samples alone. */
typedef struct {
    const scenario_t *scenario;
    const berth_plan_t *plan;
} strategy_scene_t;

/* What a step decides. */
typedef struct {
    double v_mps, omega_radps; /* the command for this period, within the robot's limits */
    berth_mode_t mode;         /* avoidance state; BERTH_MODE_TRACK while tracking alone */
} strategy_output_t;

typedef struct {
    const char *name;
    const char *summary; /* one line for --help */
    /* A controller on the heap, or NULL with *error filled (an infeasible configuration). */
    void *(*create)(const strategy_scene_t *scene, scenario_error_t *error);
    /* One period. step 0 is the first; the time is step * period. pose is the measured one. */
    void (*step)(void *self, long step, const berth_pose_t *pose, strategy_output_t *out);
    void (*destroy)(void *self);
} strategy_t;

/* NULL-terminated list of all strategies, and look-up by name (NULL if unknown). */
extern const strategy_t *const strategies[];
const strategy_t *strategy_find(const char *name);

#endif
