/* The plain rule that two-region avoidance is compared with: at a conservative radius stop, turn to
 * a right angle off the obstacle on the nearer side, drive straight at the reference's speed until
 * out of the radius, then track again. It tracks with the plan's own gains.
 *
 * Where several conservative radii overlap, the robot turns to the nearest of their right angles
 * that leads towards none of them, and stands if there is none. */
#include "strategy_common.h"
#include "strategy_list.h"

#include "berth/angle.h"

#include <math.h>
#include <stdlib.h>

#define RIGHT_ANGLE_RAD (0.5f * BERTH_PI)

/* The turn ends within this of the heading asked for: noise lets no measured heading be exact. */
#define TURNED_RAD 0.01f

/* A heading leads towards an obstacle if it is nearer to it than a right angle by more than this.
 * Such a heading comes nearer to it by 0.2 % of the distance at most. */
#define TOWARDS_RAD 0.05f

typedef enum { PHASE_TRACK, PHASE_TURN, PHASE_STRAIGHT } phase_t;

typedef struct {
    strategy_drive_t drive;
    const scenario_t *scenario;
    berth_gain_t hold_gain; /* for the last pose of an open plan */
    phase_t phase;
    float heading_rad; /* that the turn goes to */
} normal_t;

/* Directions to the obstacles within whose conservative radius the robot is. */
typedef struct {
    float direction_rad[SCENARIO_OBSTACLES_MAX];
    size_t count;
} near_t;

static near_t look(const normal_t *self, const berth_pose_t *pose) {
    near_t near = {.count = 0};
    for (size_t i = 0; i < self->scenario->obstacle_count; ++i) {
        const scenario_obstacle_t *obstacle = &self->scenario->obstacles[i];
        const float dx = (float)obstacle->x_m - pose->x_m;
        const float dy = (float)obstacle->y_m - pose->y_m;
        const float radius = (float)obstacle->conservative_m;
        if (dx * dx + dy * dy <= radius * radius) {
            near.direction_rad[near.count++] = berth_atan2(dy, dx);
        }
    }
    return near;
}

static bool leads_away(const near_t *near, float heading_rad) {
    for (size_t i = 0; i < near->count; ++i) {
        const float off = fabsf(berth_wrap(heading_rad - near->direction_rad[i]));
        if (off < RIGHT_ANGLE_RAD - TOWARDS_RAD) {
            return false;
        }
    }
    return true;
}

/* The nearest right angle off a near obstacle that leads towards none; false if there is none. */
static bool choose_heading(const near_t *near, float theta_rad, float *heading_rad) {
    float least = INFINITY;
    for (size_t i = 0; i < 2 * near->count; ++i) {
        const float side = i % 2 == 0 ? RIGHT_ANGLE_RAD : -RIGHT_ANGLE_RAD;
        const float heading = near->direction_rad[i / 2] + side;
        const float turn = fabsf(berth_wrap(heading - theta_rad));
        if (turn < least && leads_away(near, heading)) {
            least = turn;
            *heading_rad = heading;
        }
    }
    return least < INFINITY;
}

static berth_twist_t track(const normal_t *self, long number, const berth_sample_t *sample,
                           const berth_pose_t *pose) {
    const berth_plan_t *plan = self->drive.plan;
    const long count = (long)plan->count;
    berth_gain_t gain = self->hold_gain;
    if (plan->closed || number < count) {
        const uint32_t k = (uint32_t)(number % count);
        if (plan->gains != NULL) {
            gain = plan->gains[k];
        } else {
            berth_riccati_gain(plan, k, &gain);
        }
    }
    berth_tracking_error_t error;
    berth_tracking_error(pose, sample, &error);
    return berth_tracker_law(sample, &gain, &error);
}

/* Which phase the robot is in, from where it is and where it looks. False: no way out. */
static bool update_phase(normal_t *self, const near_t *near, float theta_rad) {
    if (near->count == 0) {
        self->phase = PHASE_TRACK;
        return true;
    }
    const float left_to_turn = fabsf(berth_wrap(self->heading_rad - theta_rad));
    if (self->phase == PHASE_TURN && left_to_turn > TURNED_RAD) {
        return true;
    }
    self->phase = PHASE_STRAIGHT;
    if (leads_away(near, theta_rad)) {
        return true;
    }
    if (!choose_heading(near, theta_rad, &self->heading_rad)) {
        return false;
    }
    self->phase = PHASE_TURN;
    return true;
}

static void step(void *context, long number, const berth_pose_t *pose, strategy_output_t *out) {
    normal_t *self = context;
    strategy_drive_t *drive = &self->drive;
    const berth_sample_t sample = strategy_drive_sample(drive, number);
    const near_t near = look(self, pose);
    berth_twist_t command = {0.0f, 0.0f};
    berth_mode_t mode = BERTH_MODE_BLOCKED;
    if (update_phase(self, &near, pose->theta_rad)) {
        if (self->phase == PHASE_TRACK) {
            mode = BERTH_MODE_TRACK;
            command = track(self, number, &sample, pose);
        } else if (self->phase == PHASE_TURN) {
            mode = BERTH_MODE_CONSERVATIVE_TURN;
            command.omega_radps = berth_wrap(self->heading_rad - pose->theta_rad) / drive->period_s;
        } else {
            /* A reference that stands, or has ended, must not leave the robot where it is. */
            mode = BERTH_MODE_CONSERVATIVE_GO;
            command.v_mps = fmaxf(sample.v_mps, (float)self->scenario->avoidance.v_creep_mps);
        }
    }
    (void)strategy_drive_output(drive, command, mode != BERTH_MODE_TRACK, mode, out);
}

static void *create(const strategy_scene_t *scene, scenario_error_t *error) {
    normal_t *self = calloc(1, sizeof *self);
    if (self == NULL) {
        strategy_memory_text(error);
        return NULL;
    }
    if (!strategy_drive_init(&self->drive, scene, error)) {
        free(self);
        return NULL;
    }
    self->scenario = scene->scenario;
    if (!scene->plan->closed) {
        berth_riccati_gain(scene->plan, scene->plan->count, &self->hold_gain);
    }
    return self;
}

const strategy_t strategy_normal = {
    .name = "normal",
    .summary = "the plain rule: stop, turn a right angle off, drive straight until clear",
    .create = create,
    .step = step,
    .destroy = free,
};
