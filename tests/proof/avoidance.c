/* Obstacles and avoidance on their own, without a controller that orders the calls. */
#include "scene.h"

static berth_plan_t plan;
static berth_avoid_t avoid;
static berth_obstacles_t obstacles;

static void change_list(const berth_obstacle_t *obstacle) {
    switch (Frama_C_interval(0, 4)) {
    case 0:
        (void)berth_obstacles_add(&obstacles, obstacle);
        break;
    case 1:
        (void)berth_obstacles_put(&obstacles, any_u16(), obstacle, any_i64());
        break;
    case 2:
        berth_obstacles_remove(&obstacles, any_u16());
        break;
    case 3:
        (void)berth_obstacles_expire(&obstacles, any_i64());
        break;
    default:
        berth_obstacles_clear(&obstacles);
        break;
    }
}

static void call_any(void) {
    const berth_pose_t pose = any_pose();
    const berth_reference_t reference = {
        .next_us = any_i64(), .index = any_u32(), .total = any_u32()};
    berth_obstacle_t obstacle;
    berth_refusal_t refusal;
    berth_twist_t command;
    ANY_BYTES(obstacle);
    ANY_BYTES(command);
    if (any_bool()) {
        change_list(&obstacle);
    } else if (any_bool()) {
        (void)berth_obstacle_check(&obstacle, &refusal);
        (void)berth_avoid_check_obstacle(&avoid, &obstacle, &refusal);
    } else {
        (void)berth_avoid_step(&avoid, &obstacles, &plan, &reference, &pose, &command);
    }
}

static void call_all(void) {
    /*@ widen_hints global:"all", HINTS; */
    while (any_bool()) {
        call_any();
    }
}

int main(void) {
    berth_avoid_config_t config;
    berth_limits_config_t limits;
    berth_refusal_t refusal;
    ANY_BYTES(config);
    config.paced = any_bool();
    ANY_BYTES(limits);
    plan = any_plan();
    berth_obstacles_clear(&obstacles);
    if (berth_avoid_init(&avoid, &config, &limits, any_u32(), &refusal) == BERTH_OK) {
        call_all();
    }
    return 0;
}
