/* Berth's own controller: without obstacles (none), with the conservative strategy alone, and with
 * both regions (combined). */
#include "strategy_common.h"
#include "strategy_list.h"

#include <stdlib.h>

typedef struct {
    berth_controller_t controller;
    berth_constrained_t workspace; /* used where the scenario asks for it */
    int64_t period_us;
    bool started;
} berth_strategy_t;

typedef enum { REGIONS_NONE, REGIONS_CONSERVATIVE, REGIONS_COMBINED } regions_t;

static bool add_obstacles(berth_strategy_t *self, const scenario_t *scenario, regions_t regions,
                          scenario_error_t *error) {
    for (size_t i = 0; i < scenario->obstacle_count; i++) {
        berth_obstacle_t obstacle = strategy_obstacle(scenario, &scenario->obstacles[i]);
        if (regions == REGIONS_CONSERVATIVE) {
            obstacle.regulated_m = obstacle.conservative_m + self->controller.avoid.config.skirt_m;
        }
        berth_refusal_t refusal;
        const berth_error_t result =
            berth_controller_add_obstacle(&self->controller, &obstacle, &refusal);
        if (result != BERTH_OK) {
            strategy_refusal_text(result, &refusal, error);
            return false;
        }
    }
    return true;
}

static void *create(const strategy_scene_t *scene, regions_t regions, scenario_error_t *error) {
    berth_strategy_t *self = calloc(1, sizeof *self);
    if (self == NULL) {
        strategy_memory_text(error);
        return NULL;
    }
    berth_config_t config = strategy_config(scene->scenario);
    strategy_constrain(&config, scene->scenario, &self->workspace);
    berth_refusal_t refusal;
    const berth_error_t result =
        berth_controller_init(&self->controller, scene->plan, &config, &refusal);
    if (result != BERTH_OK) {
        strategy_refusal_text(result, &refusal, error);
        free(self);
        return NULL;
    }
    if (regions != REGIONS_NONE && !add_obstacles(self, scene->scenario, regions, error)) {
        free(self);
        return NULL;
    }
    self->period_us = scene->plan->period_us;
    return self;
}

static void *create_none(const strategy_scene_t *scene, scenario_error_t *error) {
    return create(scene, REGIONS_NONE, error);
}

static void *create_conservative(const strategy_scene_t *scene, scenario_error_t *error) {
    return create(scene, REGIONS_CONSERVATIVE, error);
}

static void *create_combined(const strategy_scene_t *scene, scenario_error_t *error) {
    return create(scene, REGIONS_COMBINED, error);
}

static void step(void *context, long number, const berth_pose_t *pose, strategy_output_t *out) {
    berth_strategy_t *self = context;
    const int64_t now_us = number * self->period_us;
    berth_command_t command = {{0.0f, 0.0f}, {0.0f, 0.0f}};
    berth_error_t result = BERTH_OK;
    if (!self->started) {
        result = berth_controller_start(&self->controller, now_us);
        self->started = true;
    }
    if (result == BERTH_OK) {
        result = berth_controller_step(&self->controller, now_us, pose, &command);
    }
    const berth_status_t *status = berth_controller_status(&self->controller);
    /* the command is zero after an error, and the controller stays stopped */
    *out = (strategy_output_t){
        .v_mps = (double)command.twist.v_mps,
        .omega_radps = (double)command.twist.omega_radps,
        .mode = result == BERTH_OK ? status->mode : BERTH_MODE_BLOCKED,
    };
}

const strategy_t strategy_none = {
    .name = "none",
    .summary = "Berth's tracking alone, obstacles ignored",
    .create = create_none,
    .step = step,
    .destroy = free,
};

const strategy_t strategy_conservative = {
    .name = "conservative",
    .summary = "Berth with the conservative region alone (G = S): turn and go",
    .create = create_conservative,
    .step = step,
    .destroy = free,
};

const strategy_t strategy_combined = {
    .name = "combined",
    .summary = "Berth with the conservative and the regulated region",
    .create = create_combined,
    .step = step,
    .destroy = free,
};
