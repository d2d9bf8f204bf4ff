/* A program that uses all of the controller, so that the linker shows what it takes: plan check,
 * tracking by a table of gains or by gains computed on the board, avoidance, limits. FLASH_FIXED:
 * without obstacles that are put and removed while it runs, as frames do. */
#include "board.h"

#include "berth/controller.h"

/* Nothing of it is known to the compiler. */
static berth_controller_t controller;
static berth_plan_t plan;
static berth_config_t config;
static berth_obstacle_t obstacle;
static berth_pose_t pose;
static berth_command_t command;
static berth_refusal_t refusal;

int main(void) {
    int failed = 0;
    __asm volatile("" : "+m"(plan), "+m"(config), "+m"(obstacle), "+m"(pose));
    failed += berth_controller_init(&controller, &plan, &config, &refusal) != BERTH_OK;
    failed += berth_controller_add_obstacle(&controller, &obstacle, &refusal) != BERTH_OK;
#ifndef FLASH_FIXED
    failed += berth_controller_put_obstacle(&controller, 1, &obstacle, 1, &refusal) != BERTH_OK;
    berth_controller_remove_obstacle(&controller, 1);
#endif
    failed += berth_controller_start(&controller, 0) != BERTH_OK;
    failed += berth_controller_step(&controller, board_now_us(), &pose, &command) != BERTH_OK;
    failed += berth_controller_status(&controller)->active;
    return failed;
}
