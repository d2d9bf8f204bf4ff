#include "strategy_common.h"

#include <math.h>
#include <stdio.h>

/* The firmware takes no more; a drive of which it is told so little brakes at once. */
#define A_BRAKE_MAX_MPS2 1000.0

strategy_told_t strategy_told(const scenario_t *scenario) {
    const scenario_plant_t *plant = &scenario->plant;
    const double delay_s = plant->tau_s + plant->pose_delay_s + plant->watchdog_s;
    const double told = 1.0 - plant->untold;
    const double slowness = (1.0 + plant->slip) * told;
    const double a_brake_mps2 = slowness > 0.0 ? plant->a_max_mps2 / slowness : 0.0;
    return (strategy_told_t){
        .tau_s = told * (delay_s + plant->slip * (scenario->period_s + delay_s)),
        .a_brake_mps2 = a_brake_mps2 > A_BRAKE_MAX_MPS2 && told < 1.0 ? 0.0 : a_brake_mps2,
        .sigma_pose_m = told * plant->pose_noise_m,
    };
}

double strategy_clearance_told(const scenario_t *scenario) {
    const strategy_told_t told = strategy_told(scenario);
    const double v = scenario->robot.v_max_mps;
    const double a = told.a_brake_mps2;
    return v * (scenario->period_s + told.tau_s) + (a > 0.0 ? v * v / (2.0 * a) : 0.0) +
           3.0 * told.sigma_pose_m;
}

double strategy_clearance(const scenario_t *scenario) {
    scenario_t known = *scenario;
    known.plant.untold = 0.0;
    return strategy_clearance_told(&known);
}

berth_config_t strategy_config(const scenario_t *scenario) {
    const strategy_told_t told = strategy_told(scenario);
    berth_config_t config = {0};
    config.limits = (berth_limits_config_t){
        .wheel_radius_m = (float)scenario->robot.wheel_radius_m,
        .track_m = (float)scenario->robot.track_m,
        .v_max_mps = (float)scenario->robot.v_max_mps,
        .omega_max_radps = (float)scenario->robot.omega_max_radps,
        .wheel_speed_max_radps = (float)scenario->robot.wheel_speed_max_radps,
        .a_max_mps2 = 0.0f,
        .alpha_max_radps2 = 0.0f,
    };
    config.avoid = (berth_avoid_config_t){
        .skirt_m = (float)scenario->avoidance.skirt_m,
        .v_creep_mps = (float)scenario->avoidance.v_creep_mps,
        .tau_s = (float)told.tau_s,
        .a_brake_mps2 = (float)told.a_brake_mps2,
        .sigma_pose_m = (float)told.sigma_pose_m,
        .paced = scenario->avoidance.paced,
    };
    return config;
}

void strategy_constrain(berth_config_t *config, const scenario_t *scenario,
                        berth_constrained_t *workspace) {
    if (scenario->mpc.constrained) {
        config->tracker = berth_constrained_tracker(workspace);
    }
}

berth_obstacle_t strategy_obstacle(const scenario_t *scenario,
                                   const scenario_obstacle_t *obstacle) {
    double least_m = obstacle->conservative_m + scenario->avoidance.skirt_m;
    return (berth_obstacle_t){
        .x_m = (float)obstacle->x_m,
        .y_m = (float)obstacle->y_m,
        .hard_m = (float)obstacle->hard_m,
        .conservative_m = (float)obstacle->conservative_m,
        .regulated_m = (float)fmax(obstacle->regulated_m, least_m),
    };
}

/* Keys of the scenario that a field of the firmware comes from; NULL: it has no key of its own. */
static const char *const field_keys[BERTH_FIELD_COUNT] = {
    [BERTH_FIELD_PLAN_COUNT] = "duration_s",
    [BERTH_FIELD_PLAN_PERIOD] = "period_s",
    [BERTH_FIELD_PLAN_HORIZON] = "mpc.horizon",
    [BERTH_FIELD_PLAN_DISCRETIZATION] = "mpc.discretization",
    [BERTH_FIELD_PLAN_Q] = "mpc.q",
    [BERTH_FIELD_PLAN_R] = "mpc.r",
    [BERTH_FIELD_SAMPLE_X] = "reference",
    [BERTH_FIELD_SAMPLE_Y] = "reference",
    [BERTH_FIELD_SAMPLE_THETA] = "reference",
    [BERTH_FIELD_SAMPLE_V] = "reference",
    [BERTH_FIELD_SAMPLE_OMEGA] = "reference",
    [BERTH_FIELD_GAIN] = "mpc",
    [BERTH_FIELD_WHEEL_RADIUS] = "robot.wheel_radius_m",
    [BERTH_FIELD_TRACK] = "robot.track_m",
    [BERTH_FIELD_V_MAX] = "robot.v_max_mps",
    [BERTH_FIELD_OMEGA_MAX] = "robot.omega_max_radps",
    [BERTH_FIELD_WHEEL_SPEED_MAX] = "robot.wheel_speed_max_radps",
    [BERTH_FIELD_SKIRT] = "avoidance.skirt_m",
    [BERTH_FIELD_V_CREEP] = "avoidance.v_creep_mps",
    [BERTH_FIELD_TAU] = "plant.tau_s",
    [BERTH_FIELD_A_BRAKE] = "plant.a_max_mps2",
    [BERTH_FIELD_SIGMA_POSE] = "plant.pose_noise_m",
    [BERTH_FIELD_TURN_PER_PERIOD] = "robot.omega_max_radps",
    [BERTH_FIELD_OBSTACLE_X] = ".x_m",
    [BERTH_FIELD_OBSTACLE_Y] = ".y_m",
    [BERTH_FIELD_OBSTACLE_HARD] = ".hard_m",
    [BERTH_FIELD_OBSTACLE_CONSERVATIVE] = ".conservative_m",
    [BERTH_FIELD_OBSTACLE_REGULATED] = ".regulated_m",
    [BERTH_FIELD_CLEARANCE] = ".conservative_m",
};

static void key_text(const berth_refusal_t *refusal, char *out, size_t size) {
    const char *key = refusal->field < BERTH_FIELD_COUNT ? field_keys[refusal->field] : NULL;
    if (key == NULL) {
        key = "scenario";
    }
    if (key[0] == '.') {
        (void)snprintf(out, size, "obstacles.%u%s", (unsigned)refusal->index, key);
    } else {
        (void)snprintf(out, size, "%s", key);
    }
}

void strategy_refusal_text(berth_error_t error, const berth_refusal_t *refusal,
                           scenario_error_t *out) {
    if (error != BERTH_ERROR_CONFIG && error != BERTH_ERROR_PLAN &&
        error != BERTH_ERROR_CLEARANCE) {
        (void)snprintf(out->text, sizeof out->text, "%s", berth_error_text(error));
        return;
    }
    char key[64];
    key_text(refusal, key, sizeof key);
    if (error == BERTH_ERROR_CLEARANCE) {
        (void)snprintf(out->text, sizeof out->text,
                       "%s: conservative_m - hard_m is %.6g m, too little for the robot to be "
                       "kept clear (allowed: at least %.6g m)",
                       key, (double)refusal->value, (double)refusal->minimum);
        return;
    }
    (void)snprintf(out->text, sizeof out->text, "%s: %s is %.6g (allowed: %.6g to %.6g)", key,
                   berth_field_text(refusal->field), (double)refusal->value,
                   (double)refusal->minimum, (double)refusal->maximum);
}

void strategy_memory_text(scenario_error_t *out) {
    (void)snprintf(out->text, sizeof out->text, "out of memory");
}

bool strategy_drive_init(strategy_drive_t *drive, const strategy_scene_t *scene,
                         scenario_error_t *error) {
    *drive = (strategy_drive_t){.plan = scene->plan,
                                .limits_config = strategy_config(scene->scenario).limits,
                                .period_s = (float)scene->plan->period_us / 1.0e6f};
    berth_limits_reset(&drive->limits);
    berth_refusal_t refusal = {.field = BERTH_FIELD_NONE};
    berth_error_t result = berth_plan_check(scene->plan, &refusal);
    if (result == BERTH_OK) {
        result = berth_limits_check(&drive->limits_config, &refusal);
    }
    if (result != BERTH_OK) {
        strategy_refusal_text(result, &refusal, error);
    }
    return result == BERTH_OK;
}

berth_sample_t strategy_drive_sample(const strategy_drive_t *drive, long step) {
    const berth_plan_t *plan = drive->plan;
    const long count = (long)plan->count;
    const long k = plan->closed ? step % count : (step < count ? step : count);
    return berth_plan_sample(plan, (uint32_t)k);
}

uint8_t strategy_drive_output(strategy_drive_t *drive, berth_twist_t command, bool keep_omega,
                              berth_mode_t mode, strategy_output_t *out) {
    const uint8_t limited = berth_limits_apply(&drive->limits, &drive->limits_config,
                                               drive->period_s, keep_omega, &command);
    *out = (strategy_output_t){(double)command.v_mps, (double)command.omega_radps, mode};
    return limited;
}
