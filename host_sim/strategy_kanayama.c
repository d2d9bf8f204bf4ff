/* The classical tracker of Kanayama, Kimura, Miyazaki & Noguchi ("A stable tracking control method
 * for an autonomous mobile robot", ICRA 1990), alone and with Berth's avoidance behind it:
 *
 *     v = v_r cos(e3) + kx e1,    omega = omega_r + v_r (ky e2 + ktheta sin(e3)).
 *
 * Gains. About the reference e2 obeys e2'' + ktheta v_r e2' + ky v_r^2 e2 = 0, so ktheta^2 = 4 ky
 * damps it critically at any speed and makes it decay by e in a distance of 1 / sqrt(ky). The
 * authors' ky = 64 /m^2 does so in 0.125 m, but turns on the spot once ky e2 exceeds ktheta, that
 * is from 0.25 m on, which an obstacle in the way easily causes. ky = 10 /m^2 decays in 0.32 m and
 * turns like that from 0.63 m on only. kx = 2 1/s decays as fast as that at 0.6 m/s. */
#include "strategy_common.h"
#include "strategy_list.h"

#include "berth/angle.h"

#include <stdlib.h>

#define KX_PER_S 2.0f
#define KY_PER_M2 10.0f
#define KTHETA_PER_M 6.3245553f /* 2 sqrt(ky) */

typedef struct {
    strategy_drive_t drive;
    bool avoids;
    berth_avoid_t avoid;
    berth_obstacles_t obstacles;
    berth_reference_t reference;
} kanayama_t;

static berth_twist_t law(const berth_sample_t *sample, const berth_tracking_error_t *error) {
    float sine;
    float cosine;
    berth_sincos(error->e3_rad, &sine, &cosine);
    return (berth_twist_t){
        sample->v_mps * cosine + KX_PER_S * error->e1_m,
        sample->omega_radps + sample->v_mps * (KY_PER_M2 * error->e2_m + KTHETA_PER_M * sine),
    };
}

static void step(void *context, long number, const berth_pose_t *pose, strategy_output_t *out) {
    kanayama_t *self = context;
    const berth_sample_t sample = strategy_drive_sample(&self->drive, number);
    berth_tracking_error_t error;
    berth_tracking_error(pose, &sample, &error);
    berth_twist_t command = law(&sample, &error);
    berth_mode_t mode = BERTH_MODE_TRACK;
    if (self->avoids) {
        const int64_t now_us = (int64_t)number * self->drive.plan->period_us;
        berth_reference_advance(&self->reference, self->drive.plan, now_us);
        mode = berth_avoid_step(&self->avoid, &self->obstacles, self->drive.plan, &self->reference,
                                pose, &command);
    }
    (void)strategy_drive_output(&self->drive, command, mode != BERTH_MODE_TRACK, mode, out);
}

static bool add_obstacle(kanayama_t *self, const scenario_t *scenario, size_t index,
                         scenario_error_t *error) {
    const berth_obstacle_t obstacle = strategy_obstacle(scenario, &scenario->obstacles[index]);
    berth_refusal_t refusal = {.field = BERTH_FIELD_NONE};
    berth_error_t result = berth_obstacle_check(&obstacle, &refusal);
    if (result == BERTH_OK) {
        result = berth_avoid_check_obstacle(&self->avoid, &obstacle, &refusal);
    }
    if (result == BERTH_OK) {
        result = berth_obstacles_add(&self->obstacles, &obstacle);
    }
    if (result != BERTH_OK) {
        refusal.index = (uint32_t)index;
        strategy_refusal_text(result, &refusal, error);
    }
    return result == BERTH_OK;
}

static bool init_avoidance(kanayama_t *self, const strategy_scene_t *scene,
                           scenario_error_t *error) {
    const berth_config_t config = strategy_config(scene->scenario);
    berth_refusal_t refusal = {.field = BERTH_FIELD_NONE};
    const berth_error_t result = berth_avoid_init(&self->avoid, &config.avoid, &config.limits,
                                                  scene->plan->period_us, &refusal);
    if (result != BERTH_OK) {
        strategy_refusal_text(result, &refusal, error);
        return false;
    }
    berth_obstacles_clear(&self->obstacles);
    for (size_t i = 0; i < scene->scenario->obstacle_count; ++i) {
        if (!add_obstacle(self, scene->scenario, i, error)) {
            return false;
        }
    }
    berth_reference_start(&self->reference, scene->plan, 0);
    self->avoids = true;
    return true;
}

static void *create(const strategy_scene_t *scene, bool avoids, scenario_error_t *error) {
    kanayama_t *self = calloc(1, sizeof *self);
    if (self == NULL) {
        strategy_memory_text(error);
        return NULL;
    }
    if (!strategy_drive_init(&self->drive, scene, error) ||
        (avoids && !init_avoidance(self, scene, error))) {
        free(self);
        return NULL;
    }
    return self;
}

static void *create_alone(const strategy_scene_t *scene, scenario_error_t *error) {
    return create(scene, false, error);
}

static void *create_avoiding(const strategy_scene_t *scene, scenario_error_t *error) {
    return create(scene, true, error);
}

const strategy_t strategy_kanayama = {
    .name = "kanayama",
    .summary = "the classical tracker (Kanayama et al. 1990), obstacles ignored",
    .create = create_alone,
    .step = step,
    .destroy = free,
};

const strategy_t strategy_kanayama_avoid = {
    .name = "kanayama_avoid",
    .summary = "the classical tracker with Berth's avoidance behind it",
    .create = create_avoiding,
    .step = step,
    .destroy = free,
};
