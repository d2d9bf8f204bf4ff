/* The control step, and the parts that it is made of, through both experiments. */
#include "cost.h"
#include "counter.h"

#include <stdio.h>

#define PERIOD_US 50000

static support_plan_t shape;
static berth_controller_t controller;
static cost_series_t step, step_two, step_decided, law, reference_part, avoid_part, limits_part;

static void begin(const cost_experiment_t *experiment) {
    const berth_config_t config = berth_config_default(0.05f, 0.3f);
    berth_refusal_t refusal;
    support_plan(&shape, experiment->shape, experiment->count, false);
    support_fill_gains(&shape);
    cost_require(berth_controller_init(&controller, &shape.plan, &config, &refusal), "controller");
    for (size_t i = 0; i < 8; i++) {
        cost_require(
            berth_controller_add_obstacle(&controller, &experiment->obstacles[i], &refusal),
            "obstacle");
    }
    cost_require(berth_controller_start(&controller, 0), "start");
}

/* Each part by itself, on copies of what the step to come will find. */
static void count_parts(int64_t now_us, const berth_pose_t *pose) {
    static berth_avoid_t avoid;
    static berth_obstacles_t obstacles;
    avoid = controller.avoid;
    obstacles = controller.obstacles;
    berth_reference_t reference = controller.reference;
    berth_limits_t limits = controller.limits;

    uint32_t start = counter_now();
    berth_reference_advance(&reference, &shape.plan, now_us);
    cost_add(&reference_part, counter_since(start));

    berth_tracking_error_t error;
    berth_sample_t sample = berth_plan_sample(&shape.plan, reference.index);
    const berth_gain_t *gain =
        &shape.plan
             .gains[reference.index < shape.plan.count ? reference.index : shape.plan.count - 1];
    start = counter_now();
    berth_tracking_error(pose, &sample, &error);
    berth_twist_t twist = berth_tracker_law(&sample, gain, &error);
    cost_add(&law, counter_since(start));

    start = counter_now();
    const berth_mode_t mode =
        berth_avoid_step(&avoid, &obstacles, &shape.plan, &reference, pose, &twist);
    cost_add(&avoid_part, counter_since(start));

    start = counter_now();
    (void)berth_limits_apply(&limits, &controller.limits_config, avoid.period_s,
                             mode != BERTH_MODE_TRACK, &twist);
    (void)berth_wheels_from_twist(&controller.limits_config, twist);
    cost_add(&limits_part, counter_since(start));
}

static bool turning(const berth_status_t *status) {
    return status->mode == BERTH_MODE_CONSERVATIVE_TURN || status->mode == BERTH_MODE_REGULATED;
}

static void run(const cost_experiment_t *experiment) {
    support_pose_t robot = experiment->start;
    begin(experiment);
    const berth_status_t *status = berth_controller_status(&controller);
    for (uint32_t k = 0; k < experiment->count; k++) {
        const int64_t now_us = (int64_t)k * PERIOD_US;
        const berth_pose_t pose = support_measure(robot);
        berth_command_t command;
        count_parts(now_us, &pose);
        const bool before = turning(status);
        const uint32_t start = counter_now();
        const berth_error_t error = berth_controller_step(&controller, now_us, &pose, &command);
        const uint32_t instructions = counter_since(start);
        cost_require(error, "step");
        cost_add(&step, instructions);
        if (status->active >= 2) {
            cost_add(&step_two, instructions);
        }
        if (turning(status) && !before) {
            cost_add(&step_decided, instructions);
        }
        robot = support_move(robot, (double)command.twist.v_mps, (double)command.twist.omega_radps,
                             PERIOD_US * 1.0e-6);
    }
}

/* Avoidance by itself with the first count of some obstacles: instructions, mean of 64 steps.
 * ended: the reference has come to its end. */
static uint32_t avoid_with(const berth_obstacle_t *obstacles, uint32_t count, bool ended,
                           uint32_t *most) {
    const berth_config_t config = berth_config_default(0.05f, 0.3f);
    berth_refusal_t refusal;
    cost_require(berth_controller_init(&controller, &shape.plan, &config, &refusal), "controller");
    for (uint32_t i = 0; i < count; i++) {
        cost_require(berth_controller_add_obstacle(&controller, &obstacles[i], &refusal), "place");
    }
    cost_require(berth_controller_start(&controller, 0), "start");
    if (ended) {
        berth_reference_advance(&controller.reference, &shape.plan,
                                (int64_t)shape.plan.count * PERIOD_US);
    }
    const berth_pose_t pose = {0.0f, 0.0f, 0.0f};
    uint32_t sum = 0;
    *most = 0;
    for (uint32_t k = 0; k < 64; k++) {
        if (!ended) {
            berth_reference_advance(&controller.reference, &shape.plan, (int64_t)k * PERIOD_US);
        }
        berth_twist_t twist = {0.3f, 0.0f};
        const uint32_t start = counter_now();
        (void)berth_avoid_step(&controller.avoid, &controller.obstacles, &shape.plan,
                               &controller.reference, &pose, &twist);
        const uint32_t instructions = counter_since(start);
        sum += instructions;
        *most = instructions > *most ? instructions : *most;
    }
    if (controller.avoid.active != 0 && controller.avoid.active != count) {
        cost_fail("obstacles must be active all, or none");
    }
    return (sum + 32u) / 64u;
}

static void print_avoid(const char *name, const berth_obstacle_t *obstacles, bool ended) {
    for (uint32_t count = 0; count <= 8; count++) {
        char line[40];
        uint32_t most;
        const uint32_t mean = avoid_with(obstacles, count, ended, &most);
        snprintf(line, sizeof line, "avoid.%s.%lu.mean", name, (unsigned long)count);
        cost_print(line, mean);
        snprintf(line, sizeof line, "avoid.%s.%lu.max", name, (unsigned long)count);
        cost_print(line, most);
    }
}

void cost_controller(void) {
    for (int i = 0; i < 2; i++) {
        run(&cost_experiments[i]);
    }
    cost_print_series("step", &step);
    cost_print_series("step.two", &step_two);
    cost_print_series("step.decided", &step_decided);
    cost_print_series("law", &law);
    cost_print_series("reference", &reference_part);
    cost_print_series("avoid", &avoid_part);
    cost_print_series("limits", &limits_part);

    berth_obstacle_t far[8], near[8], ahead[8];
    for (int i = 0; i < 8; i++) {
        const float y = 0.31f * (i % 2 == 0 ? 1.0f : -1.0f);
        far[i] = (berth_obstacle_t){5.0f + (float)i, 5.0f, 0.1f, 0.2f, 0.4f};
        near[i] = (berth_obstacle_t){-0.02f * (float)i, y, 0.1f, 0.2f, 0.4f};
        ahead[i] = (berth_obstacle_t){0.31f, 0.02f * (float)i, 0.1f, 0.2f, 0.4f};
    }
    print_avoid("inactive", far, false);
    print_avoid("resting", far, true); /* the look-ahead has nothing to look at */
    print_avoid("active", near, false);
    print_avoid("turning", ahead, false);
}
