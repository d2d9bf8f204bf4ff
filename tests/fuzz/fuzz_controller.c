/* The control loop with any plan, configuration, obstacles, poses and times. What must hold: what
 * is refused stays unusable; an error stops the robot and is kept; commands are finite and within
 * the limits; and a robot that does exactly what it is told, and started outside all hard radii,
 * stays outside, along its arcs too.
 */
#include "berth/controller.h"
#include "fuzz.h"
#include "input.h"
#include "plan_input.h"
#include "plant.h"

#define STEPS_MAX 600
#define TIGHT_M 16.0 /* the proof's tolerance is stated within this distance of the origin */

typedef struct {
    input_t in;
    plan_input_t plan;
    berth_config_t config;
    berth_controller_t controller;
    berth_constrained_t workspace;
    double x_m, y_m, theta_rad; /* the robot's true pose */
    int64_t now_us;
    bool started;
    bool proven; /* the clearance theorem speaks of this run */
    bool failed; /* an error is kept */
    berth_error_t error;
    int steps;
} world_t;

static double distance_m(const world_t *world, uint32_t i) {
    const berth_obstacle_t *o = &world->controller.obstacles.slots[i].obstacle;
    return hypot((double)o->x_m - world->x_m, (double)o->y_m - world->y_m);
}

/* What rounding and the tolerance of "free" may cost: see avoid.h. */
static double tolerance_m(const world_t *world, double distance) {
    const double travel =
        (double)world->config.limits.v_max_mps * 1.0e-6 * world->plan.plan.period_us;
    return travel * (double)BERTH_FREE_TOLERANCE_RAD + (double)BERTH_RADIUS_SLACK_M +
           3.0e-7 * (TIGHT_M + distance);
}

/* Is the robot where the theorem begins to hold? */
static bool outside_all(const world_t *world) {
    const berth_obstacles_t *obstacles = &world->controller.obstacles;
    for (uint32_t i = 0; i < obstacles->count; i++) {
        const berth_obstacle_t *o = &obstacles->slots[i].obstacle;
        if (distance_m(world, i) < (double)o->hard_m || fabs((double)o->x_m) > TIGHT_M ||
            fabs((double)o->y_m) > TIGHT_M) {
            return false;
        }
    }
    return fabs(world->x_m) <= TIGHT_M && fabs(world->y_m) <= TIGHT_M;
}

static bool within(float value, float most, float slack) {
    return fabsf(value) <= most * (1.0f + slack);
}

static void check_command(const world_t *world, const berth_command_t *command) {
    const berth_limits_config_t *limits = &world->config.limits;
    const float values[] = {command->twist.v_mps, command->twist.omega_radps,
                            command->wheels.left_radps, command->wheels.right_radps};
    FUZZ_CHECK(finite_all(values, 4), "a command is finite");
    FUZZ_CHECK(within(command->twist.v_mps, limits->v_max_mps, 1.0e-6f) &&
                   within(command->twist.omega_radps, limits->omega_max_radps, 1.0e-6f),
               "a command is within the robot's limits");
    if (limits->wheel_speed_max_radps > 0.0f) {
        FUZZ_CHECK(within(command->wheels.left_radps, limits->wheel_speed_max_radps, 1.0e-5f) &&
                       within(command->wheels.right_radps, limits->wheel_speed_max_radps, 1.0e-5f),
                   "a command is within the wheels' limits");
    }
}

static bool is_zero(const berth_command_t *command) {
    return command->twist.v_mps == 0.0f && command->twist.omega_radps == 0.0f &&
           command->wheels.left_radps == 0.0f && command->wheels.right_radps == 0.0f;
}

static void check_status(const world_t *world) {
    const berth_status_t *status = berth_controller_status(&world->controller);
    FUZZ_CHECK(status->active <= world->controller.obstacles.count &&
                   status->mode <= BERTH_MODE_BLOCKED && isfinite(status->clearance_m) &&
                   isfinite(status->tracking_error.e1_m) && isfinite(status->tracking_error.e2_m) &&
                   isfinite(status->tracking_error.e3_rad),
               "the status is in range");
    FUZZ_CHECK(status->index <= world->plan.plan.count &&
                   (status->finished ==
                    (!world->plan.plan.closed && status->index == world->plan.plan.count)),
               "the index is of the plan");
}

/* Exactly what was told, for one period. */
static void move(world_t *world, berth_twist_t twist) {
    const double time_s = 1.0e-6 * world->plan.plan.period_us;
    const plant_arc_t arc = {
        world->x_m, world->y_m, world->theta_rad, (double)twist.v_mps, (double)twist.omega_radps,
        time_s};
    const berth_obstacles_t *obstacles = &world->controller.obstacles;
    for (uint32_t i = 0; world->proven && i < obstacles->count; i++) {
        const berth_obstacle_t *o = &obstacles->slots[i].obstacle;
        const double nearest = plant_arc_distance(&arc, (double)o->x_m, (double)o->y_m);
        FUZZ_CHECK(nearest >= (double)o->hard_m - tolerance_m(world, distance_m(world, i)),
                   "a robot that does what it is told stays clear");
    }
    const double half = 0.5 * arc.omega_radps * time_s;
    const double chord = arc.v_mps * time_s * (fabs(half) > 1e-9 ? sin(half) / half : 1.0);
    world->x_m += chord * cos(world->theta_rad + half);
    world->y_m += chord * sin(world->theta_rad + half);
    world->theta_rad = remainder(world->theta_rad + 2.0 * half, 2.0 * 3.14159265358979323846);
    world->proven = world->proven && fabs(world->x_m) <= TIGHT_M && fabs(world->y_m) <= TIGHT_M;
}

static berth_command_t step(world_t *world, const berth_pose_t *pose, int64_t now_us) {
    berth_command_t command;
    memset(&command, 0xA5, sizeof command);
    const berth_error_t error = berth_controller_step(&world->controller, now_us, pose, &command);
    world->steps++;
    if (error != BERTH_OK) {
        FUZZ_CHECK(is_zero(&command), "an error stops the robot");
        FUZZ_CHECK(!world->failed || error == world->error, "the first error is kept");
        FUZZ_CHECK(berth_controller_status(&world->controller)->error == error,
                   "the status tells the error");
        world->failed = world->started;
        world->error = error;
        return command;
    }
    FUZZ_CHECK(world->started && !world->failed, "an error is kept until the next start");
    check_command(world, &command);
    check_status(world);
    return command;
}

static void op_steps(world_t *world, uint8_t count) {
    for (uint8_t i = 0; i < count && world->steps < STEPS_MAX; i++) {
        const berth_pose_t pose = {(float)world->x_m, (float)world->y_m, (float)world->theta_rad};
        if (world->plan.plan.period_us > BERTH_TIME_MAX_US - world->now_us) {
            return;
        }
        world->now_us += world->plan.plan.period_us;
        const berth_command_t command = step(world, &pose, world->now_us);
        move(world, command.twist);
    }
}

/* A step with anything in it. The robot does not move. */
static void op_any_step(world_t *world) {
    berth_pose_t pose;
    pose.x_m = in_some_float(&world->in, -3.0f, 3.0f);
    pose.y_m = in_some_float(&world->in, -3.0f, 3.0f);
    pose.theta_rad = in_some_float(&world->in, -4.0f, 4.0f);
    const uint8_t how = in_u8(&world->in);
    int64_t now_us = world->now_us;
    if ((how & 1u) != 0) {
        now_us = (int64_t)in_u64(&world->in);
    } else if ((how & 2u) != 0) {
        const int64_t span_us = in_span(&world->in);
        now_us += span_us <= BERTH_TIME_MAX_US - now_us ? span_us : 0;
    }
    (void)step(world, (how & 4u) != 0 ? NULL : &pose, now_us);
    if (now_us >= world->now_us && now_us <= BERTH_TIME_MAX_US) {
        world->now_us = now_us;
    }
}

static void op_start(world_t *world) {
    world->started = berth_controller_start(&world->controller, world->now_us) == BERTH_OK;
    FUZZ_CHECK(world->started, "a checked controller starts");
    world->failed = false;
    const berth_limits_config_t *limits = &world->config.limits;
    world->proven =
        limits->a_max_mps2 == 0.0f && limits->alpha_max_radps2 == 0.0f && outside_all(world);
}

static void op_place(world_t *world) {
    world->x_m = (double)in_float(&world->in, -3.0f, 3.0f);
    world->y_m = (double)in_float(&world->in, -3.0f, 3.0f);
    world->theta_rad = (double)in_float(&world->in, -3.14159f, 3.14159f);
    world->proven = world->proven && outside_all(world);
}

/* Regions that just satisfy the condition, or any. */
static berth_obstacle_t some_obstacle(world_t *world) {
    berth_obstacle_t obstacle;
    const berth_avoid_t *avoid = &world->controller.avoid;
    obstacle.x_m = in_some_float(&world->in, -3.0f, 3.0f);
    obstacle.y_m = in_some_float(&world->in, -3.0f, 3.0f);
    obstacle.hard_m = in_some_float(&world->in, 0.001f, 1.0f);
    obstacle.conservative_m =
        obstacle.hard_m + avoid->clearance_min_m + in_some_float(&world->in, 0.0f, 0.2f);
    obstacle.regulated_m =
        obstacle.conservative_m + avoid->config.skirt_m + in_some_float(&world->in, 0.0f, 0.5f);
    return obstacle;
}

static void op_obstacle(world_t *world, bool stays) {
    const berth_obstacle_t obstacle = some_obstacle(world);
    const uint32_t count = world->controller.obstacles.count;
    berth_refusal_t refusal = {0};
    berth_error_t error;
    if (stays) {
        error = berth_controller_add_obstacle(&world->controller, &obstacle, &refusal);
    } else {
        const uint16_t id = in_u8(&world->in);
        const int64_t ttl_us = (int64_t)in_u16(&world->in) * 1000;
        const int64_t room_us = BERTH_TIME_MAX_US - world->now_us;
        error = berth_controller_put_obstacle(&world->controller, id, &obstacle,
                                              world->now_us + (ttl_us < room_us ? ttl_us : 0),
                                              &refusal);
    }
    const uint32_t now = world->controller.obstacles.count;
    FUZZ_CHECK(now <= BERTH_OBSTACLES_MAX && (error == BERTH_OK || now == count),
               "what is refused changes nothing");
    FUZZ_CHECK(error == BERTH_OK || error == BERTH_ERROR_CAPACITY ||
                   refusal.field != BERTH_FIELD_NONE,
               "a refusal names the field");
    world->proven = world->proven && outside_all(world);
}

static void operate(world_t *world) {
    const uint8_t op = in_u8(&world->in);
    switch (op % 8u) {
    case 0:
    case 1:
    case 2:
        op_steps(world, op / 8u);
        break;
    case 3:
        op_any_step(world);
        break;
    case 4:
        op_start(world);
        break;
    case 5:
        op_place(world);
        break;
    case 6:
        op_obstacle(world, (op & 128u) != 0);
        break;
    default:
        berth_controller_remove_obstacle(&world->controller, in_u8(&world->in));
        break;
    }
}

static bool begin(world_t *world) {
    const uint8_t flags = in_u8(&world->in);
    berth_refusal_t refusal = {0};
    in_plan(&world->in, flags, &world->plan);
    world->config = berth_config_default(0.05f, 0.3f);
    if ((flags & 8u) != 0) {
        world->config.tracker = berth_constrained_tracker(&world->workspace);
    }
    if ((flags & 16u) != 0) {
        in_config(&world->in, &world->config);
    }
    world->now_us = (flags & 32u) != 0 ? BERTH_TIME_MAX_US - 20000000 : 0;
    memset(&world->controller, 0xA5, sizeof world->controller);
    const berth_error_t error =
        berth_controller_init(&world->controller, &world->plan.plan, &world->config, &refusal);
    if (error == BERTH_OK) {
        return true;
    }
    FUZZ_CHECK(refusal.field != BERTH_FIELD_NONE, "a refusal names the field");
    FUZZ_CHECK(!(refusal.value >= refusal.minimum && refusal.value <= refusal.maximum) ||
                   refusal.field == BERTH_FIELD_NONE,
               "what is refused is out of the range told");
    const berth_pose_t pose = {0.0f, 0.0f, 0.0f};
    berth_command_t command;
    FUZZ_CHECK(berth_controller_step(&world->controller, 0, &pose, &command) == BERTH_ERROR_STATE &&
                   is_zero(&command),
               "a controller that was refused stands");
    return false;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static world_t world;
    world = (world_t){.in = {data, size}};
    if (begin(&world)) {
        while (world.in.left > 0 && world.steps < STEPS_MAX) {
            operate(&world);
        }
    }
    return 0;
}
