/* Stack that calls take, by painting what lies below it before. */
#include "cost.h"

#if defined(__riscv)
#define MOVE_SP "mv %0, sp"
#else
#define MOVE_SP "mov %0, sp"
#endif

#define PAINT 0x5aa5c33cu
#define DEPTH_WORDS 1024u

static support_plan_t shape;
static berth_controller_t controller;
static int64_t now_us;
static berth_config_t config;
static berth_refusal_t refusal;
static berth_pose_t pose;
static berth_command_t command;
static berth_error_t result;

/* Nothing else may be called from here while the paint is wet. */
__attribute__((noinline)) uint32_t cost_stack_of(void (*work)(void)) {
    volatile uint32_t *here;
    __asm volatile(MOVE_SP : "=r"(here));
    for (uint32_t i = 1; i <= DEPTH_WORDS; i++) {
        here[-(int32_t)i] = PAINT;
    }
    work();
    uint32_t deepest = DEPTH_WORDS;
    while (deepest > 0 && here[-(int32_t)deepest] == PAINT) {
        deepest--;
    }
    if (deepest == DEPTH_WORDS) {
        cost_fail("more stack than was painted");
    }
    return 4u * deepest;
}

static void keep_most(uint32_t *most, uint32_t bytes) {
    *most = bytes > *most ? bytes : *most;
}

static void init_controller(void) {
    result = berth_controller_init(&controller, &shape.plan, &config, &refusal);
}

static void step_controller(void) {
    result = berth_controller_step(&controller, now_us, &pose, &command);
}

static void stack_of_controller(void) {
    uint32_t most = 0;
    config = berth_config_default(0.05f, 0.3f);
    cost_print("stack.controller.init", cost_stack_of(init_controller));
    cost_require(result, "controller");
    for (int i = 0; i < 8; i++) {
        cost_require(
            berth_controller_add_obstacle(&controller, &cost_experiments[1].obstacles[i], &refusal),
            "obstacle");
    }
    cost_require(berth_controller_start(&controller, 0), "start");
    support_pose_t robot = cost_experiments[1].start;
    for (now_us = 0; now_us < 45000000; now_us += 50000) {
        pose = support_measure(robot);
        keep_most(&most, cost_stack_of(step_controller));
        cost_require(result, "step");
        robot = support_move(robot, (double)command.twist.v_mps, (double)command.twist.omega_radps,
                             0.05);
    }
    cost_print("stack.controller.step", most);
}

void cost_stack(void) {
    support_plan(&shape, cost_experiments[1].shape, cost_experiments[1].count, false);
    support_fill_gains(&shape);
    stack_of_controller();
}
