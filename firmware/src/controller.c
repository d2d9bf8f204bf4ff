#include "berth/controller.h"

#include "check.h"
#include "error_inline.h"
#include "lookahead.h"
#include "plan_inline.h"
#include "tracker_inline.h"

#include <math.h>

/* MISRA D9 in this file. */

/* On a 32-bit target, with the default capacity: the state has to leave room on small boards. */
_Static_assert(sizeof(void *) > 4u || BERTH_OBSTACLES_MAX > 16u ||
                   sizeof(berth_controller_t) <= 1024u,
               "RAM budget of the controller");

berth_config_t berth_config_default(float wheel_radius_m, float track_m) {
    return (berth_config_t){
        .limits =
            {
                .wheel_radius_m = wheel_radius_m,
                .track_m = track_m,
                .v_max_mps = 0.8f,
                .omega_max_radps = 3.0f,
            },
        .avoid =
            {
                .skirt_m = 0.02f,
                .v_creep_mps = 0.05f,
                .paced = true,
            },
    };
}

/* The workspace for this plan. Without one there is nothing that a rim's change could limit. */
static berth_error_t init_tracker(const berth_config_t *config, const berth_plan_t *plan,
                                  berth_refusal_t *refusal) {
    const berth_tracker_t *tracker = &config->tracker;
    if (tracker->api == NULL) {
        return check_value(BERTH_FIELD_RIM_CHANGE_MAX, tracker->rim_change_max_mps2, 0.0f, 0.0f,
                           refusal)
                   ? BERTH_OK
                   : BERTH_ERROR_CONFIG;
    }
    if (tracker->workspace == NULL) {
        return BERTH_ERROR_ARGUMENT;
    }
    return tracker->api->init(tracker->workspace, plan, &config->limits,
                              tracker->rim_change_max_mps2, refusal);
}

static void reset_tracker(const berth_tracker_t *tracker) {
    if (tracker->api != NULL) {
        tracker->api->reset(tracker->workspace);
    }
}

berth_error_t berth_controller_init(berth_controller_t *controller, const berth_plan_t *plan,
                                    const berth_config_t *config, berth_refusal_t *refusal) {
    if (controller == NULL) {
        return BERTH_ERROR_ARGUMENT;
    }
    controller->plan = NULL; /* unusable until all is checked */
    controller->started = false;
    berth_obstacles_clear(&controller->obstacles);
    if (plan == NULL || config == NULL || refusal == NULL) {
        return BERTH_ERROR_ARGUMENT;
    }
    berth_error_t error = berth_plan_check(plan, refusal);
    if (error != BERTH_OK) {
        return error;
    }
    error = berth_avoid_init(&controller->avoid, &config->avoid, &config->limits, plan->period_us,
                             refusal);
    if (error != BERTH_OK) {
        return error;
    }
    error = init_tracker(config, plan, refusal);
    if (error != BERTH_OK) {
        return error;
    }
    controller->tracker = config->tracker;
    controller->limits_config = config->limits;
    berth_limits_reset(&controller->limits);
    if (plan->closed) {
        controller->hold_gain = (berth_gain_t){{{0.0f, 0.0f, 0.0f}, {0.0f, 0.0f, 0.0f}}};
    } else {
        berth_riccati_gain(plan, plan->count, &controller->hold_gain);
    }
    controller->plan = plan;
    controller->status =
        (berth_status_t){.error = BERTH_ERROR_STATE, .clearance_m = BERTH_RADIUS_MAX_M};
    return BERTH_OK;
}

/* Whether the obstacle may be taken in. A refusal names it by index. */
static berth_error_t check_obstacle(const berth_controller_t *controller,
                                    const berth_obstacle_t *obstacle, uint32_t index,
                                    berth_refusal_t *refusal) {
    if (controller == NULL || obstacle == NULL || refusal == NULL) {
        return BERTH_ERROR_ARGUMENT;
    }
    if (controller->plan == NULL) {
        return BERTH_ERROR_STATE;
    }
    berth_error_t error = berth_obstacle_check(obstacle, refusal);
    if (error == BERTH_OK) {
        error = berth_avoid_check_obstacle(&controller->avoid, obstacle, refusal);
    }
    if (error != BERTH_OK) {
        refusal->index = index;
    }
    return error;
}

berth_error_t berth_controller_add_obstacle(berth_controller_t *controller,
                                            const berth_obstacle_t *obstacle,
                                            berth_refusal_t *refusal) {
    const uint32_t index = controller != NULL ? controller->obstacles.count : 0u;
    const berth_error_t error = check_obstacle(controller, obstacle, index, refusal);
    return error == BERTH_OK ? berth_obstacles_add(&controller->obstacles, obstacle) : error;
}

berth_error_t berth_controller_put_obstacle(berth_controller_t *controller, uint16_t id,
                                            const berth_obstacle_t *obstacle, int64_t expires_us,
                                            berth_refusal_t *refusal) {
    const berth_error_t error = check_obstacle(controller, obstacle, id, refusal);
    return error == BERTH_OK ? berth_obstacles_put(&controller->obstacles, id, obstacle, expires_us)
                             : error;
}

void berth_controller_remove_obstacle(berth_controller_t *controller, uint16_t id) {
    if (controller != NULL && controller->plan != NULL) {
        berth_obstacles_remove(&controller->obstacles, id);
    }
}

berth_error_t berth_controller_start(berth_controller_t *controller, int64_t now_us) {
    if (controller == NULL) {
        return BERTH_ERROR_ARGUMENT;
    }
    if (controller->plan == NULL) {
        return BERTH_ERROR_STATE;
    }
    if (now_us < 0 || now_us > BERTH_TIME_MAX_US) {
        return BERTH_ERROR_TIME;
    }
    berth_reference_start(&controller->reference, controller->plan, now_us);
    berth_limits_reset(&controller->limits);
    reset_tracker(&controller->tracker);
    lookahead_start(&controller->avoid, &controller->obstacles, controller->plan,
                    &controller->reference);
    controller->last_us = now_us;
    controller->started = true;
    controller->status = (berth_status_t){.clearance_m = BERTH_RADIUS_MAX_M};
    return BERTH_OK;
}

/* Why this step must not move the robot, or BERTH_OK. */
static berth_error_t check_step(const berth_controller_t *controller, int64_t now_us,
                                const berth_pose_t *pose, const berth_command_t *command) {
    if (controller->plan == NULL || !controller->started) {
        return BERTH_ERROR_STATE;
    }
    if (controller->status.error != BERTH_OK) {
        return controller->status.error;
    }
    if (pose == NULL || command == NULL) {
        return BERTH_ERROR_ARGUMENT;
    }
    if (now_us < controller->last_us || now_us > BERTH_TIME_MAX_US) {
        return BERTH_ERROR_TIME;
    }
    const bool good = fabsf(pose->x_m) <= BERTH_POSITION_MAX_M &&
                      fabsf(pose->y_m) <= BERTH_POSITION_MAX_M &&
                      fabsf(pose->theta_rad) <= CHECK_FLOAT_MAX;
    return good ? BERTH_OK : BERTH_ERROR_POSE;
}

/* The gain of the current sample where it is known: in the table, or the one that holds the last
 * pose. */
static const berth_gain_t *known_gain(const berth_controller_t *controller) {
    const berth_plan_t *plan = controller->plan;
    const uint32_t index = controller->reference.index;
    if (index >= plan->count) {
        return &controller->hold_gain;
    }
    return plan->gain_source == BERTH_GAIN_TABLE ? &plan->gains[index] : NULL;
}

/* The constrained optimum. Returns whether a wheel is at its limit. */
static bool track_constrained(berth_controller_t *controller, const berth_gain_t *gain,
                              berth_twist_t *twist) {
    berth_status_t *status = &controller->status;
    berth_constrained_t *workspace = controller->tracker.workspace;
    const berth_tracker_input_t input = {
        .plan = controller->plan,
        .reference = &controller->reference,
        .sample = &status->sample,
        .gain = gain,
        .error = &status->tracking_error,
        .last = controller->limits.last,
    };
    *twist = controller->tracker.api->step(workspace, &input);
    status->passes = workspace->passes;
    status->suboptimal = workspace->stopped;
    return workspace->limited_now;
}

/* Error, law, avoidance and limits, for a step that may move the robot. */
static void control(berth_controller_t *controller, const berth_pose_t *measured,
                    berth_command_t *command) {
    berth_status_t *status = &controller->status;
    const berth_plan_t *plan = controller->plan;
    const berth_reference_t *reference = &controller->reference;
    const berth_pose_t pose = {measured->x_m, measured->y_m,
                               berth_wrap_inline(measured->theta_rad)};
    const berth_gain_t *gain = known_gain(controller);
    bool held = false;
    plan_sample_inline(plan, reference->index, &status->sample);
    status->tracking_error = tracking_error_inline(&pose, &status->sample);
    if (controller->tracker.api != NULL) {
        held = track_constrained(controller, gain, &command->twist);
    } else {
        berth_gain_t computed;
        if (gain == NULL) {
            berth_riccati_gain(plan, reference->index, &computed);
            gain = &computed;
        }
        command->twist = tracker_law_inline(&status->sample, gain, &status->tracking_error);
    }
    status->mode = berth_avoid_step(&controller->avoid, &controller->obstacles, plan, reference,
                                    &pose, &command->twist);
    status->limited = berth_limits_apply(&controller->limits, &controller->limits_config,
                                         controller->avoid.period_s,
                                         status->mode != BERTH_MODE_TRACK, &command->twist);
    status->limited |= held ? BERTH_LIMITED_WHEEL : 0u;
    command->wheels = berth_wheels_from_twist(&controller->limits_config, command->twist);
    status->clearance_m = controller->avoid.clearance_m;
    status->active = controller->avoid.active;
    status->braking = controller->avoid.braking;
    status->index = reference->index;
    status->skipped = reference->skipped;
    status->finished = reference->finished;
}

berth_error_t berth_controller_step(berth_controller_t *controller, int64_t now_us,
                                    const berth_pose_t *pose, berth_command_t *command) {
    if (command != NULL) {
        *command = (berth_command_t){{0.0f, 0.0f}, {0.0f, 0.0f}};
    }
    if (controller == NULL) {
        return BERTH_ERROR_ARGUMENT;
    }
    const berth_error_t error = check_step(controller, now_us, pose, command);
    if (error != BERTH_OK) {
        controller->status.error = error;
        berth_limits_reset(&controller->limits);
        if (controller->plan != NULL) {
            reset_tracker(&controller->tracker);
        }
        return error;
    }
    controller->last_us = now_us;
    if (now_us >= controller->obstacles.earliest_us) {
        (void)berth_obstacles_expire(&controller->obstacles, now_us);
    }
    berth_reference_advance(&controller->reference, controller->plan, now_us);
    control(controller, pose, command);
    return BERTH_OK;
}

const berth_status_t *berth_controller_status(const berth_controller_t *controller) {
    return &controller->status;
}
