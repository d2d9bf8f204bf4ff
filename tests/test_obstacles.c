/* Obstacles that come and go: the list against a naive model, and the robot among them. */
#include "plant.h"
#include "support.h"

#include "unity.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#define PERIOD_US INT64_C(50000)
#define PERIOD_S 0.05
#define PI 3.14159265358979323846
#define FOREVER BERTH_OBSTACLE_FOREVER

static const berth_obstacle_t disc = {1.0f, 2.0f, 0.1f, 0.2f, 0.4f};
static berth_obstacles_t list;
static support_plan_t shape;
static berth_config_t config;
static berth_controller_t controller;

void setUp(void) {
    memset(&list, 0x55, sizeof list); /* what is not cleared must not matter */
    berth_obstacles_clear(&list);
    support_plan(&shape, SUPPORT_CIRCLE, 419, true);
    support_fill_gains(&shape);
    config = berth_config_default(0.05f, 0.3f);
}

void tearDown(void) {}

static void put(uint16_t id, const berth_obstacle_t *obstacle, int64_t expires_us) {
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_obstacles_put(&list, id, obstacle, expires_us));
}

static void add(const berth_obstacle_t *obstacle) {
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_obstacles_add(&list, obstacle));
}

static berth_obstacle_t disc_at(float x_m, float y_m) {
    return (berth_obstacle_t){x_m, y_m, 0.1f, 0.2f, 0.4f};
}

static void expect_ids(const uint16_t *ids, uint32_t count) {
    TEST_ASSERT_EQUAL_UINT32(count, list.count);
    for (uint32_t i = 0; i < count; i++) {
        TEST_ASSERT_EQUAL_UINT16(ids[i], list.slots[i].id);
    }
}

/* ---- The list ---- */

static void test_capacity(void) {
    for (uint32_t i = 0; i < BERTH_OBSTACLES_MAX; i++) {
        if (i % 2 == 0) {
            put((uint16_t)i, &disc, 100);
        } else {
            add(&disc);
        }
    }
    const berth_obstacles_t full = list;
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_CAPACITY, berth_obstacles_put(&list, 200, &disc, 5));
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_CAPACITY, berth_obstacles_add(&list, &disc));
    TEST_ASSERT_EQUAL_MEMORY(&full, &list, sizeof list);
    const berth_obstacle_t other = disc_at(7.0f, 8.0f);
    put(4, &other, 200); /* in place of the old one, full or not */
    TEST_ASSERT_EQUAL_UINT32(BERTH_OBSTACLES_MAX, list.count);
    TEST_ASSERT_EQUAL_MEMORY(&other, &list.slots[4].obstacle, sizeof other);
    TEST_ASSERT_EQUAL_INT64(200, list.slots[4].expires_us);
    berth_obstacles_remove(&list, 0);
    put(200, &disc, 5); /* room again */
}

static void test_ids_out_of_range(void) {
    static const uint16_t ids[] = {256, 1000, 0xfffe, BERTH_OBSTACLE_STATIC};
    add(&disc);
    put(255, &disc, 100);
    const berth_obstacles_t before = list;
    for (uint32_t i = 0; i < sizeof ids / sizeof ids[0]; i++) {
        TEST_ASSERT_EQUAL_INT(BERTH_ERROR_ARGUMENT, berth_obstacles_put(&list, ids[i], &disc, 5));
        berth_obstacles_remove(&list, ids[i]);
        TEST_ASSERT_EQUAL_MEMORY(&before, &list, sizeof list);
    }
}

static void test_static_ones_stay(void) {
    add(&disc);
    for (uint16_t id = 0; id <= BERTH_OBSTACLE_ID_MAX; id++) {
        put(id, &disc, id);
        TEST_ASSERT_EQUAL_UINT32(2, list.count);
        berth_obstacles_remove(&list, id);
        expect_ids((const uint16_t[]){BERTH_OBSTACLE_STATIC}, 1);
    }
    TEST_ASSERT_EQUAL_UINT32(0, berth_obstacles_expire(&list, INT64_MAX));
    expect_ids((const uint16_t[]){BERTH_OBSTACLE_STATIC}, 1);
    TEST_ASSERT_EQUAL_INT64(FOREVER, list.slots[0].expires_us);
}

static void test_expiry(void) {
    put(1, &disc, 300);
    add(&disc);
    put(2, &disc, 100);
    put(3, &disc, 200);
    put(4, &disc, 100);
    put(5, &disc, FOREVER);
    TEST_ASSERT_EQUAL_UINT32(0, berth_obstacles_expire(&list, INT64_MIN));
    TEST_ASSERT_EQUAL_UINT32(0, berth_obstacles_expire(&list, 99));
    TEST_ASSERT_EQUAL_UINT32(6, list.count);
    TEST_ASSERT_EQUAL_UINT32(2, berth_obstacles_expire(&list, 100));
    expect_ids((const uint16_t[]){1, BERTH_OBSTACLE_STATIC, 3, 5}, 4);
    TEST_ASSERT_EQUAL_INT64(200, list.earliest_us);
    put(3, &disc, 400); /* seen again */
    TEST_ASSERT_EQUAL_UINT32(0, berth_obstacles_expire(&list, 299));
    TEST_ASSERT_EQUAL_INT64(300, list.earliest_us);
    put(3, &disc, 350); /* and sooner gone */
    TEST_ASSERT_EQUAL_UINT32(2, berth_obstacles_expire(&list, 1000));
    expect_ids((const uint16_t[]){BERTH_OBSTACLE_STATIC, 5}, 2);
    TEST_ASSERT_EQUAL_UINT32(0, berth_obstacles_expire(&list, INT64_MAX));
    put(6, &disc, INT64_MIN);
    TEST_ASSERT_EQUAL_UINT32(1, berth_obstacles_expire(&list, INT64_MIN));
    berth_obstacles_remove(&list, 5);
    berth_obstacles_remove(&list, 5);
    expect_ids((const uint16_t[]){BERTH_OBSTACLE_STATIC}, 1);
}

/* What avoidance remembers outlives a jitter, and no move of a hard radius or more. */
static void test_memory_of_a_moved_obstacle(void) {
    static const struct {
        float dx_m, dy_m, hard_m;
        bool kept;
    } cases[] = {{0.0f, 0.0f, 0.25f, true},      {0.125f, 0.125f, 0.25f, true},
                 {0.249f, 0.0f, 0.25f, true},    {0.25f, 0.0f, 0.25f, false},
                 {0.0f, -0.25f, 0.25f, false},   {0.1875f, 0.1875f, 0.25f, false},
                 {100.0f, 100.0f, 0.25f, false}, {0.2f, 0.0f, 0.125f, false}};
    for (uint32_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        berth_obstacle_t obstacle = {3.0f, 4.0f, 0.25f, 0.5f, 1.0f};
        const berth_obstacle_memory_t memory = {.cursor = 77, .scan = 3, .side = -1};
        berth_obstacles_clear(&list);
        put(9, &obstacle, 100);
        TEST_ASSERT_EQUAL_UINT32(0, list.slots[0].memory.cursor);
        TEST_ASSERT_EQUAL_UINT8(0, list.slots[0].memory.scan);
        TEST_ASSERT_EQUAL_INT8(0, list.slots[0].memory.side);
        list.slots[0].memory = memory;
        obstacle.x_m += cases[i].dx_m;
        obstacle.y_m += cases[i].dy_m;
        obstacle.hard_m = cases[i].hard_m;
        put(9, &obstacle, 200);
        TEST_ASSERT_EQUAL_UINT32(1, list.count);
        TEST_ASSERT_EQUAL_UINT32(cases[i].kept ? 77 : 0, list.slots[0].memory.cursor);
        TEST_ASSERT_EQUAL_UINT8(cases[i].kept ? 3 : 0, list.slots[0].memory.scan);
        TEST_ASSERT_EQUAL_INT8(cases[i].kept ? -1 : 0, list.slots[0].memory.side);
        TEST_ASSERT_EQUAL_MEMORY(&obstacle, &list.slots[0].obstacle, sizeof obstacle);
    }
}

/* The list as one would write it without a thought for cost. */
static struct {
    uint32_t count;
    struct {
        uint16_t id;
        int64_t expires_us;
        float x_m;
    } items[BERTH_OBSTACLES_MAX];
} model;

static void model_drop(uint32_t place) {
    memmove(&model.items[place], &model.items[place + 1],
            (BERTH_OBSTACLES_MAX - 1 - place) * sizeof model.items[0]);
    model.count--;
}

static bool model_put(uint16_t id, float x_m, int64_t expires_us) {
    uint32_t place = model.count;
    for (uint32_t i = 0; i < model.count; i++) {
        if (id != BERTH_OBSTACLE_STATIC && model.items[i].id == id) {
            place = i;
        }
    }
    if (place == BERTH_OBSTACLES_MAX) {
        return false;
    }
    model.items[place].id = id;
    model.items[place].expires_us = expires_us;
    model.items[place].x_m = x_m;
    model.count += place == model.count;
    return true;
}

static uint32_t model_expire(int64_t now_us) {
    uint32_t dropped = 0;
    for (uint32_t i = 0; i < model.count;) {
        if (model.items[i].expires_us != FOREVER && model.items[i].expires_us <= now_us) {
            model_drop(i);
            dropped++;
        } else {
            i++;
        }
    }
    return dropped;
}

static void model_remove(uint16_t id) {
    for (uint32_t i = 0; i < model.count; i++) {
        if (model.items[i].id == id) {
            model_drop(i);
            return;
        }
    }
}

static void compare_with_model(void) {
    TEST_ASSERT_EQUAL_UINT32(model.count, list.count);
    for (uint32_t i = 0; i < list.count; i++) {
        TEST_ASSERT_EQUAL_UINT16(model.items[i].id, list.slots[i].id);
        TEST_ASSERT_EQUAL_INT64(model.items[i].expires_us, list.slots[i].expires_us);
        TEST_ASSERT_TRUE(model.items[i].x_m == list.slots[i].obstacle.x_m);
        TEST_ASSERT_TRUE(list.earliest_us <= list.slots[i].expires_us);
    }
}

static void random_operation(int64_t *now_us) {
    const uint16_t id = (uint16_t)support_index(24);
    const berth_obstacle_t obstacle = disc_at((float)support_uniform(-9.0, 9.0), 0.0f);
    const int64_t expires_us =
        support_index(8) == 0 ? FOREVER : *now_us + (int64_t)support_index(2000) - 100;
    switch (support_index(12)) {
    case 0:
        berth_obstacles_remove(&list, id);
        model_remove(id);
        break;
    case 1:
        if (model.count < BERTH_OBSTACLES_MAX / 2) { /* leave room for the others */
            add(&obstacle);
            (void)model_put(BERTH_OBSTACLE_STATIC, obstacle.x_m, FOREVER);
        }
        break;
    case 2:
    case 3:
    case 4:
    case 5:
        *now_us += support_index(200);
        TEST_ASSERT_EQUAL_UINT32(model_expire(*now_us), berth_obstacles_expire(&list, *now_us));
        break;
    default:
        TEST_ASSERT_EQUAL_INT(model_put(id, obstacle.x_m, expires_us) ? BERTH_OK
                                                                      : BERTH_ERROR_CAPACITY,
                              berth_obstacles_put(&list, id, &obstacle, expires_us));
        break;
    }
}

static void test_random_operations_against_a_naive_model(void) {
    support_random_start();
    int64_t now_us = 0;
    uint32_t full = 0;
    const uint32_t runs = support_runs(300000);
    for (uint32_t i = 0; i < runs; i++) {
        if (i % 500 == 0) {
            berth_obstacles_clear(&list);
            model.count = 0;
        }
        random_operation(&now_us);
        compare_with_model();
        full += list.count == BERTH_OBSTACLES_MAX;
    }
    TEST_ASSERT_GREATER_THAN_UINT32(runs / 100, full);
    TEST_ASSERT_LESS_THAN_UINT32(runs / 2, full);
}

/* ---- The controller ---- */

static void start(berth_controller_t *c) {
    berth_refusal_t refusal;
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_controller_init(c, &shape.plan, &config, &refusal));
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_controller_start(c, 0));
}

static void controller_put(berth_controller_t *c, uint16_t id, const berth_obstacle_t *obstacle,
                           int64_t expires_us) {
    berth_refusal_t refusal;
    TEST_ASSERT_EQUAL_INT(BERTH_OK,
                          berth_controller_put_obstacle(c, id, obstacle, expires_us, &refusal));
}

static void test_put_checks_as_add_does(void) {
    static const struct {
        berth_obstacle_t obstacle;
        berth_error_t error;
        berth_field_t field;
    } bad[] = {
        {{NAN, 5.0f, 0.1f, 0.2f, 0.4f}, BERTH_ERROR_CONFIG, BERTH_FIELD_OBSTACLE_X},
        {{5.0f, INFINITY, 0.1f, 0.2f, 0.4f}, BERTH_ERROR_CONFIG, BERTH_FIELD_OBSTACLE_Y},
        {{5.0f, 5.0f, 0.0f, 0.2f, 0.4f}, BERTH_ERROR_CONFIG, BERTH_FIELD_OBSTACLE_HARD},
        {{5.0f, 5.0f, 0.1f, 0.13f, 0.4f}, BERTH_ERROR_CLEARANCE, BERTH_FIELD_CLEARANCE},
        {{5.0f, 5.0f, 0.1f, 0.2f, 0.21f}, BERTH_ERROR_CONFIG, BERTH_FIELD_OBSTACLE_REGULATED},
    };
    berth_refusal_t refusal;
    start(&controller);
    controller_put(&controller, 42, &disc, 1000);
    for (uint32_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        const berth_controller_t before = controller;
        memset(&refusal, 0x5a, sizeof refusal);
        TEST_ASSERT_EQUAL_INT(bad[i].error, berth_controller_put_obstacle(
                                                &controller, 42, &bad[i].obstacle, 9, &refusal));
        TEST_ASSERT_EQUAL_INT(bad[i].field, refusal.field);
        TEST_ASSERT_EQUAL_UINT32(42, refusal.index);
        TEST_ASSERT_EQUAL_MEMORY(&before, &controller, sizeof controller);
    }
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_ARGUMENT,
                          berth_controller_put_obstacle(&controller, 256, &disc, 9, &refusal));
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_ARGUMENT,
                          berth_controller_put_obstacle(NULL, 1, &disc, 9, &refusal));
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_ARGUMENT,
                          berth_controller_put_obstacle(&controller, 1, NULL, 9, &refusal));
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_ARGUMENT,
                          berth_controller_put_obstacle(&controller, 1, &disc, 9, NULL));
    TEST_ASSERT_EQUAL_UINT32(1, controller.obstacles.count);
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_ARGUMENT,
                          berth_controller_init(&controller, NULL, &config, &refusal));
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_STATE,
                          berth_controller_put_obstacle(&controller, 1, &disc, 9, &refusal));
    berth_controller_remove_obstacle(&controller, 1);
    berth_controller_remove_obstacle(NULL, 1);
}

static void test_full_controller_keeps_what_it_has(void) {
    berth_refusal_t refusal;
    start(&controller);
    for (uint16_t id = 0; id < BERTH_OBSTACLES_MAX; id++) {
        controller_put(&controller, id, &disc, 1000);
    }
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_CAPACITY,
                          berth_controller_put_obstacle(&controller, 99, &disc, 9, &refusal));
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_CAPACITY,
                          berth_controller_add_obstacle(&controller, &disc, &refusal));
    berth_controller_remove_obstacle(&controller, 3);
    controller_put(&controller, 99, &disc, 1000);
}

/* ---- The robot among obstacles that come and go ---- */

/* One robot with exact drives. */
typedef struct {
    berth_controller_t controller;
    support_pose_t pose;
    int64_t now_us;
    berth_command_t command;
    double least_m; /* clearance so far */
} robot_t;

static robot_t robot;

static void robot_start(robot_t *r, double x_m, double y_m, double theta_rad) {
    start(&r->controller);
    r->pose = (support_pose_t){x_m, y_m, theta_rad};
    r->now_us = 0;
    r->least_m = HUGE_VAL;
}

/* Least clearance along the arc of this period, over the obstacles in force. */
static double arc_clearance(const robot_t *r) {
    const plant_arc_t arc = {r->pose.x_m,
                             r->pose.y_m,
                             r->pose.theta_rad,
                             (double)r->command.twist.v_mps,
                             (double)r->command.twist.omega_radps,
                             PERIOD_S};
    const berth_obstacles_t *obstacles = &r->controller.obstacles;
    double least = HUGE_VAL;
    for (uint32_t i = 0; i < obstacles->count; i++) {
        const berth_obstacle_t *o = &obstacles->slots[i].obstacle;
        const double d = plant_arc_distance(&arc, (double)o->x_m, (double)o->y_m);
        least = fmin(least, d - (double)o->hard_m);
    }
    return least;
}

static berth_mode_t robot_step(robot_t *r) {
    const berth_pose_t measured = support_measure(r->pose);
    TEST_ASSERT_EQUAL_INT(BERTH_OK,
                          berth_controller_step(&r->controller, r->now_us, &measured, &r->command));
    r->least_m = fmin(r->least_m, arc_clearance(r));
    r->pose = support_move(r->pose, (double)r->command.twist.v_mps,
                           (double)r->command.twist.omega_radps, PERIOD_S);
    r->now_us += PERIOD_US;
    return berth_controller_status(&r->controller)->mode;
}

static double robot_off_path(const robot_t *r) {
    return fabs(hypot(r->pose.x_m, r->pose.y_m) - 1.0);
}

static void robot_on_the_circle(robot_t *r) {
    robot_start(r, 1.0, 0.0, 0.5 * PI);
}

/* The obstacle appears 0.3 m ahead, well within its regulated radius, in the middle of a run. */
static void test_obstacle_that_appears_is_avoided(void) {
    robot_on_the_circle(&robot);
    for (int i = 0; i < 60; i++) {
        TEST_ASSERT_EQUAL_INT(BERTH_MODE_TRACK, robot_step(&robot));
    }
    const double ahead = atan2(robot.pose.y_m, robot.pose.x_m) + 0.3;
    const berth_obstacle_t obstacle = disc_at((float)cos(ahead), (float)sin(ahead));
    controller_put(&robot.controller, 7, &obstacle, FOREVER);
    uint32_t avoiding = 0;
    for (int i = 0; i < 150; i++) {
        avoiding += robot_step(&robot) != BERTH_MODE_TRACK;
    }
    printf("clearance %.4f m, %u periods of avoidance\n", robot.least_m, (unsigned)avoiding);
    TEST_ASSERT_GREATER_THAN_UINT32(10, avoiding);
    TEST_ASSERT_TRUE(robot.least_m > 0.0);
    TEST_ASSERT_TRUE(robot_off_path(&robot) < 0.02); /* past it, and back */
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_TRACK, berth_controller_status(&robot.controller)->mode);
}

/* A robot shut in stands until the ring expires, at its time and not before. */
static void test_obstacles_that_expire_free_the_way(void) {
    robot_on_the_circle(&robot);
    const int64_t expires_us = 40 * PERIOD_US;
    for (uint16_t id = 0; id < 6; id++) {
        const double direction = PI / 3.0 * id;
        const berth_obstacle_t o =
            disc_at((float)(1.0 + 0.25 * cos(direction)), (float)(0.25 * sin(direction)));
        controller_put(&robot.controller, id, &o, expires_us + id % 2);
    }
    for (int i = 0; i < 40; i++) {
        TEST_ASSERT_EQUAL_INT(BERTH_MODE_BLOCKED, robot_step(&robot));
        TEST_ASSERT_TRUE(robot.command.twist.v_mps == 0.0f);
        TEST_ASSERT_EQUAL_UINT32(6, robot.controller.obstacles.count);
    }
    (void)robot_step(&robot); /* at 40 periods three are gone */
    TEST_ASSERT_EQUAL_UINT32(3, robot.controller.obstacles.count);
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_TRACK, (robot_step(&robot), robot_step(&robot)));
    TEST_ASSERT_EQUAL_UINT32(0, robot.controller.obstacles.count);
    for (int i = 0; i < 200; i++) {
        (void)robot_step(&robot);
    }
    TEST_ASSERT_TRUE(robot_off_path(&robot) < 0.01);
}

static void test_removed_obstacle_frees_the_way(void) {
    robot_on_the_circle(&robot);
    const berth_obstacle_t around = disc_at(1.0f, 0.25f);
    controller_put(&robot.controller, 1, &around, FOREVER);
    TEST_ASSERT_TRUE(robot_step(&robot) != BERTH_MODE_TRACK);
    berth_controller_remove_obstacle(&robot.controller, 1);
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_TRACK, robot_step(&robot));
}

/* The look-ahead of an obstacle that comes later ends like that of one that was there before. */
static void expect_same_runs(robot_t *later, robot_t *before, int steps) {
    uint32_t avoiding = 0;
    for (int i = 0; i < steps; i++) {
        avoiding += robot_step(before) != BERTH_MODE_TRACK;
        (void)robot_step(later);
        TEST_ASSERT_TRUE(
            support_same_bits(before->command.twist.v_mps, later->command.twist.v_mps));
        TEST_ASSERT_TRUE(
            support_same_bits(before->command.twist.omega_radps, later->command.twist.omega_radps));
    }
    TEST_ASSERT_GREATER_THAN_UINT32(10, avoiding);
    TEST_ASSERT_TRUE(before->least_m > 0.0);
}

/* Beside the path, on either side, so that the plan's side is not always the nearest one's. */
static berth_obstacle_t beside_the_path(double angle_rad, double radius_m) {
    return disc_at((float)(radius_m * cos(angle_rad)), (float)(radius_m * sin(angle_rad)));
}

static void test_look_ahead_begins_while_running(void) {
    static robot_t before;
    for (int k = -4; k <= 4; k++) {
        const berth_obstacle_t o = beside_the_path(2.5, 1.0 + 0.03 * k);
        berth_refusal_t refusal;
        robot_on_the_circle(&robot);
        robot_on_the_circle(&before);
        TEST_ASSERT_EQUAL_INT(BERTH_OK,
                              berth_controller_add_obstacle(&before.controller, &o, &refusal));
        TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_controller_start(&before.controller, 0));
        for (int i = 0; i < 20; i++) {
            (void)robot_step(&robot);
            (void)robot_step(&before);
        }
        controller_put(&robot.controller, 3, &o, FOREVER);
        expect_same_runs(&robot, &before, 300);
    }
}

/* Moved far along the path, its exit is sought anew: the old one would ask for another side. */
static void test_look_ahead_follows_a_moved_obstacle(void) {
    static robot_t before;
    for (int k = -4; k <= 4; k++) {
        const berth_obstacle_t first = beside_the_path(-1.0, 1.0);
        const berth_obstacle_t then = beside_the_path(2.5, 1.0 + 0.03 * k);
        robot_on_the_circle(&robot);
        robot_on_the_circle(&before);
        controller_put(&robot.controller, 3, &first, FOREVER);
        controller_put(&before.controller, 3, &then, FOREVER);
        for (int i = 0; i < 40; i++) {
            (void)robot_step(&robot);
            (void)robot_step(&before);
        }
        controller_put(&robot.controller, 3, &then, FOREVER);
        expect_same_runs(&robot, &before, 300);
    }
}

/* A detection that wavers by a few centimetres does not make the robot change sides. */
static void test_jittering_obstacle_is_passed_on_one_side(void) {
    support_random_start();
    const uint32_t runs = support_runs(200);
    for (uint32_t run = 0; run < runs; run++) {
        robot_on_the_circle(&robot);
        const double radius = support_uniform(0.97, 1.03);
        int8_t side = 0;
        uint32_t avoiding = 0;
        for (int i = 0; i < 200; i++) {
            const berth_obstacle_t o = beside_the_path(1.2 + support_uniform(-0.01, 0.01),
                                                       radius + support_uniform(-0.01, 0.01));
            controller_put(&robot.controller, 3, &o, robot.now_us + 5 * PERIOD_US);
            avoiding += robot_step(&robot) != BERTH_MODE_TRACK;
            const int8_t now = robot.controller.obstacles.slots[0].memory.side;
            TEST_ASSERT_FALSE_MESSAGE(side != 0 && now == -side, "changed sides");
            side = now != 0 ? now : side;
        }
        TEST_ASSERT_GREATER_THAN_UINT32(5, avoiding);
        TEST_ASSERT_TRUE(robot.least_m > -0.05);
    }
}

/* ---- The clearance theorem ---- */

#define THEOREM_STEPS 300u

static double outside_m(const berth_obstacle_t *o, support_pose_t pose) {
    return hypot((double)o->x_m - pose.x_m, (double)o->y_m - pose.y_m) - (double)o->hard_m;
}

/* With the narrowest regions that the condition allows, close to the robot or anywhere near. */
static berth_obstacle_t draw_obstacle(const robot_t *r) {
    const double hard = support_uniform(0.02, 0.3);
    const double narrow = (double)r->controller.avoid.clearance_min_m;
    const double conservative =
        hard + narrow + (support_index(2) == 0 ? 0.0 : support_uniform(0.0, 0.1));
    const double regulated = conservative + (double)r->controller.avoid.config.skirt_m +
                             (support_index(3) == 0 ? 0.0 : support_uniform(0.0, 0.5));
    const double direction = support_uniform(-PI, PI);
    const double distance = hard + (support_index(3) == 0 ? support_log_uniform(1.0e-5, 0.1)
                                                          : support_uniform(0.0, 1.5));
    return (berth_obstacle_t){(float)(r->pose.x_m + distance * cos(direction)),
                              (float)(r->pose.y_m + distance * sin(direction)), (float)hard,
                              (float)conservative, (float)regulated};
}

/* Appears, moves elsewhere under its id, or goes: never onto the robot. */
static void draw_event(robot_t *r, uint32_t *appeared) {
    const uint16_t id = (uint16_t)support_index(20);
    if (support_index(10) == 0) {
        berth_controller_remove_obstacle(&r->controller, id);
        return;
    }
    const berth_obstacle_t o = draw_obstacle(r);
    berth_refusal_t refusal;
    const int64_t expires_us = r->now_us + (int64_t)support_index(60) * PERIOD_US / 2;
    if (outside_m(&o, r->pose) >= 0.0) {
        const berth_error_t error =
            berth_controller_put_obstacle(&r->controller, id, &o, expires_us, &refusal);
        TEST_ASSERT_TRUE(error == BERTH_OK || error == BERTH_ERROR_CAPACITY);
        *appeared += error == BERTH_OK;
    }
}

static void draw_robot(robot_t *r) {
    config.limits.v_max_mps = (float)support_log_uniform(0.2, 2.0);
    config.limits.omega_max_radps = (float)support_uniform(1.0, 0.49 * PI / PERIOD_S);
    config.avoid.skirt_m = (float)support_uniform(0.0, 0.05);
    support_plan(&shape, support_index(2) == 0 ? SUPPORT_CIRCLE : SUPPORT_EIGHT,
                 300 + support_index(200), support_index(2) == 0);
    support_fill_gains(&shape);
    robot_start(r, support_uniform(-2.0, 2.0), support_uniform(-2.0, 2.0),
                support_uniform(-PI, PI));
}

/* Float32's share, as in test_clearance.c, for each obstacle while it is in force. */
static double tolerance_m(void) {
    return (double)config.limits.v_max_mps * PERIOD_S * (double)BERTH_FREE_TOLERANCE_RAD +
           (double)BERTH_RADIUS_SLACK_M + 5.0e-7;
}

static void test_obstacles_that_come_and_go_are_never_hit(void) {
    support_random_start();
    const uint32_t runs = support_runs(4000);
    uint32_t appeared = 0;
    uint32_t modes[5] = {0};
    double worst = HUGE_VAL;
    for (uint32_t run = 0; run < runs; run++) {
        draw_robot(&robot);
        const uint32_t rare = 1 + support_index(10);
        for (uint32_t i = 0; i < THEOREM_STEPS; i++) {
            while (support_index(rare + 1) == 0) {
                draw_event(&robot, &appeared);
            }
            modes[robot_step(&robot)]++;
        }
        worst = fmin(worst, robot.least_m);
        TEST_ASSERT_TRUE_MESSAGE(robot.least_m >= -tolerance_m(), "collision");
    }
    printf("%u runs, %u obstacles: track %u regulated %u turn %u go %u blocked %u; "
           "least clearance %.3g m\n",
           (unsigned)runs, (unsigned)appeared, (unsigned)modes[0], (unsigned)modes[1],
           (unsigned)modes[2], (unsigned)modes[3], (unsigned)modes[4], worst);
    for (int mode = 0; mode < 5; mode++) {
        TEST_ASSERT_GREATER_THAN_UINT32(runs * THEOREM_STEPS / 500, modes[mode]);
    }
    TEST_ASSERT_GREATER_THAN_UINT32(runs * 10, appeared);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_capacity);
    RUN_TEST(test_ids_out_of_range);
    RUN_TEST(test_static_ones_stay);
    RUN_TEST(test_expiry);
    RUN_TEST(test_memory_of_a_moved_obstacle);
    RUN_TEST(test_random_operations_against_a_naive_model);
    RUN_TEST(test_put_checks_as_add_does);
    RUN_TEST(test_full_controller_keeps_what_it_has);
    RUN_TEST(test_obstacle_that_appears_is_avoided);
    RUN_TEST(test_obstacles_that_expire_free_the_way);
    RUN_TEST(test_removed_obstacle_frees_the_way);
    RUN_TEST(test_look_ahead_begins_while_running);
    RUN_TEST(test_look_ahead_follows_a_moved_obstacle);
    RUN_TEST(test_jittering_obstacle_is_passed_on_one_side);
    RUN_TEST(test_obstacles_that_come_and_go_are_never_hit);
    return UNITY_END();
}
