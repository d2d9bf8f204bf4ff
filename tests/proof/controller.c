/* One control loop, from init on, in any order of calls. */
#include "scene.h"

static berth_plan_t plan;
static berth_constrained_t workspace;
static berth_controller_t controller;
static berth_refusal_t refusal;
static berth_command_t command;

static void call_any(void) {
    const int64_t now_us = any_i64();
    const berth_pose_t pose = any_pose();
    berth_obstacle_t obstacle;
    ANY_BYTES(obstacle);
    switch (Frama_C_interval(0, 5)) {
    case 0:
        (void)berth_controller_add_obstacle(&controller, any_bool() ? &obstacle : NULL, &refusal);
        break;
    case 1:
        (void)berth_controller_put_obstacle(&controller, any_u16(), any_bool() ? &obstacle : NULL,
                                            any_i64(), any_bool() ? &refusal : NULL);
        break;
    case 2:
        berth_controller_remove_obstacle(&controller, any_u16());
        break;
    case 3:
        (void)berth_controller_start(&controller, now_us);
        break;
    case 4:
        (void)berth_controller_step(&controller, now_us, any_bool() ? &pose : NULL,
                                    any_bool() ? &command : NULL);
        break;
    default:
        (void)berth_controller_status(&controller);
        (void)berth_mode_text(ANY_ENUM(berth_mode_t));
        break;
    }
}

static void call_all(void) {
    /*@ widen_hints global:"all", HINTS; */
    while (any_bool()) {
        call_any();
    }
}

int main(void) {
    berth_config_t config;
    plan = any_plan();
    if (any_bool()) {
        give_gains(&plan);
    }
    ANY_BYTES(config);
    config.avoid.paced = any_bool();
    config.tracker = (berth_tracker_t){0};
    if (any_bool()) {
        config.tracker = berth_constrained_tracker(&workspace);
        plan.mpc.horizon = Frama_C_unsigned_short_interval(1, BERTH_CONSTRAINED_HORIZON_MAX);
    }
    config.tracker.rim_change_max_mps2 = any_float();
    if (berth_controller_init(&controller, &plan, &config, &refusal) == BERTH_OK) {
        call_all();
    }
    return 0;
}
