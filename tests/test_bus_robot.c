/* The robot on the bus by itself: frames by hand on one side, the true motion on the other. */
#include "berth/message.h"
#include "berth/supervisor.h"
#include "robot.h"
#include "support.h"

#include "unity.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#define LEFT_NODE 1u
#define RIGHT_NODE 2u
#define ADDRESS 7u
#define BEGIN_US 1000000
#define PERIOD_US 50000
#define ROWS_MAX 1000
#define TWO_PI 6.283185307179586

static scenario_t scenario;
static run_plan_t plan;
static bus_robot_t *robot;
static int64_t now_us;
static run_row_t rows[ROWS_MAX];
static size_t row_count;

/* What the robot has put on the bus. */
static unsigned long frames[4]; /* drives' left and right, fixes, obstacles */
static berth_pose_t last_fix;
static int64_t last_fix_us, first_fix_us;
static double last_turns[2];
static berth_message_obstacle_t told[SCENARIO_OBSTACLES_MAX];

void setUp(void) {
    robot = NULL;
    plan = (run_plan_t){.samples = NULL};
    now_us = BEGIN_US;
    row_count = 0;
    first_fix_us = last_fix_us = -1;
    memset(frames, 0, sizeof frames);
}

void tearDown(void) {
    bus_robot_destroy(robot);
    run_plan_free(&plan);
}

static void on_row(void *context, const run_row_t *row) {
    (void)context;
    TEST_ASSERT_LESS_THAN_size_t(ROWS_MAX, row_count);
    rows[row_count++] = *row;
}

static const run_sink_t sink = {on_row, NULL};

static drive_sim_config_t drive(uint8_t node) {
    return (drive_sim_config_t){.kind = DRIVE_SIM_ODRIVE,
                                .node = node,
                                .sign = 1,
                                .gear_ratio = 1.0,
                                .feedback_us = 10000,
                                .heartbeat_us = 100000,
                                .watchdog_us = 200000};
}

static bus_robot_config_t robot_config(void) {
    return (bus_robot_config_t){
        .scenario = &scenario,
        .plan = &plan.plan,
        .seed = 1,
        .drives = {drive(LEFT_NODE), drive(RIGHT_NODE)},
        .address = ADDRESS,
        .fix_period_us = BUS_ROBOT_FIX_PERIOD_US,
        .silence_us = BUS_ROBOT_SILENCE_US,
        .sink = &sink,
    };
}

static void create_with(const bus_robot_config_t *config) {
    scenario_error_t error;
    TEST_ASSERT_TRUE_MESSAGE(run_plan_make(&scenario, &plan, &error), error.text);
    robot = bus_robot_create(config, BEGIN_US, &error);
    TEST_ASSERT_NOT_NULL_MESSAGE(robot, error.text);
}

static void create(void) {
    const bus_robot_config_t config = robot_config();
    create_with(&config);
}

static void circle(void) {
    TEST_ASSERT_TRUE(scenario_builtin("circle", &scenario));
}

/* --- the other side's frames ------------------------------------------------------------- */

static void take_frame(const berth_can_frame_t *frame) {
    if (berth_message_is(frame, BERTH_MESSAGE_POSE_FIX, ADDRESS)) {
        frames[2]++;
        TEST_ASSERT_TRUE(berth_message_decode_pose(frame, &last_fix));
        first_fix_us = first_fix_us < 0 ? now_us : first_fix_us;
        last_fix_us = now_us;
    } else if (berth_message_is(frame, BERTH_MESSAGE_OBSTACLE, ADDRESS)) {
        berth_message_obstacle_t obstacle;
        frames[3]++;
        TEST_ASSERT_TRUE(berth_message_decode_obstacle(frame, &obstacle));
        TEST_ASSERT_LESS_THAN_UINT8(SCENARIO_OBSTACLES_MAX, obstacle.id);
        told[obstacle.id] = obstacle;
    } else {
        TEST_ASSERT_FALSE(frame->extended);
        const unsigned side = frame->id >> 5 == LEFT_NODE ? 0u : 1u;
        frames[side]++;
        if ((frame->id & 0x1fu) == 0x09u) {
            float turns = 0.0f;
            memcpy(&turns, frame->data, sizeof turns);
            last_turns[side] = (double)turns;
        }
    }
}

static void take_frames(void) {
    const berth_can_frame_t *front;
    while ((front = bus_robot_front(robot)) != NULL) {
        take_frame(front);
        bus_robot_sent(robot);
    }
}

/* Lets time pass, from deadline to deadline. */
static void run_until(int64_t until_us) {
    while (now_us < until_us) {
        const int64_t due_us = bus_robot_deadline(robot);
        TEST_ASSERT_GREATER_THAN_INT64(now_us - 1, due_us);
        now_us = due_us < until_us ? due_us : until_us;
        bus_robot_step(robot, now_us);
        take_frames();
    }
}

static void receive(berth_can_frame_t frame) {
    frame.time_us = now_us;
    bus_robot_receive(robot, &frame);
    take_frames();
}

static void odrive(uint32_t node, uint32_t command, const void *data, uint8_t length) {
    berth_can_frame_t frame = {.id = node << 5 | command, .length = length};
    memcpy(frame.data, data, length);
    receive(frame);
}

static void command_wheel(uint32_t node, double radps) {
    const float values[2] = {(float)(radps / TWO_PI), 0.0f};
    odrive(node, 0x0d, values, 8);
}

static void command_wheels(double left_radps, double right_radps) {
    command_wheel(LEFT_NODE, left_radps);
    command_wheel(RIGHT_NODE, right_radps);
}

static void enable(void) {
    static const uint8_t velocity_mode[8] = {2, 0, 0, 0, 1, 0, 0, 0};
    static const uint8_t closed_loop[4] = {8, 0, 0, 0};
    for (uint32_t node = LEFT_NODE; node <= RIGHT_NODE; node++) {
        odrive(node, 0x0b, velocity_mode, 8);
        odrive(node, 0x07, closed_loop, 4);
    }
}

static void status(berth_supervisor_state_t state, berth_mode_t mode, uint8_t fault,
                   uint32_t total) {
    const berth_message_status_t message = {.state = (uint8_t)state,
                                            .mode = (uint8_t)mode,
                                            .fault = fault,
                                            .total = total,
                                            .clearance_m = -1.0f};
    berth_can_frame_t frame;
    berth_message_encode_status(&frame, ADDRESS, &message);
    receive(frame);
}

/* A board that commands both wheels alike for one period after the other. */
static void drive_periods(uint32_t first, uint32_t count, double left_radps, double right_radps) {
    for (uint32_t k = first; k < first + count; k++) {
        command_wheels(left_radps, right_radps);
        status(BERTH_SUPERVISOR_RUNNING, BERTH_MODE_TRACK, 0, k);
        run_until(now_us + PERIOD_US);
    }
}

static const bus_robot_result_t *result(void) {
    return bus_robot_result(robot);
}

/* --- motion ------------------------------------------------------------------------------ */

static void check_pose(double x_m, double y_m, double theta_rad) {
    const berth_pose_t pose = bus_robot_pose(robot);
    TEST_ASSERT_DOUBLE_WITHIN(2.0e-6, x_m, (double)pose.x_m);
    TEST_ASSERT_DOUBLE_WITHIN(2.0e-6, y_m, (double)pose.y_m);
    TEST_ASSERT_DOUBLE_WITHIN(2.0e-6, 0.0, support_wrap((double)pose.theta_rad - theta_rad));
}

static void test_wheels_move_the_robot_along_the_arc(void) {
    circle();
    create();
    enable();
    const support_pose_t start = {scenario.start.x_m, scenario.start.y_m, scenario.start.theta_rad};
    const double left = 0.25 * TWO_PI; /* turns/s that float32 holds exactly */
    const double right = 0.5 * TWO_PI;
    command_wheels(left, right);
    run_until(BEGIN_US + 150000);
    const support_pose_t end =
        support_move(start, 0.5 * 0.05 * (left + right), 0.05 * (right - left) / 0.3, 0.15);
    check_pose(end.x_m, end.y_m, end.theta_rad);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-6, 0.25 * 0.15, last_turns[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-6, 0.5 * 0.15, last_turns[1]);
}

static void test_wheels_are_told(void) {
    circle();
    scenario.plant.tau_s = 0.1;
    create();
    enable();
    command_wheels(4.0, -2.0);
    run_until(now_us + 1000);
    bus_robot_wheels_t wheels = bus_robot_wheels(robot);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-6, 4.0, wheels.wanted_radps[BERTH_LEFT]);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-6, -2.0, wheels.wanted_radps[BERTH_RIGHT]);
    TEST_ASSERT_TRUE(wheels.speed_radps[BERTH_LEFT] > 0.0);
    TEST_ASSERT_TRUE(wheels.speed_radps[BERTH_LEFT] < 1.0);
    TEST_ASSERT_TRUE(wheels.speed_radps[BERTH_RIGHT] < 0.0);
    bus_robot_limit(robot, 3.0);
    wheels = bus_robot_wheels(robot);
    TEST_ASSERT_EQUAL_DOUBLE(3.0, wheels.wanted_radps[BERTH_LEFT]);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-6, -2.0, wheels.wanted_radps[BERTH_RIGHT]);
    command_wheels(1.0e9, -1.0e9);
    wheels = bus_robot_wheels(robot);
    TEST_ASSERT_EQUAL_DOUBLE(-3.0, wheels.wanted_radps[BERTH_RIGHT]);
    bus_robot_limit(robot, 0.0);
    wheels = bus_robot_wheels(robot);
    TEST_ASSERT_EQUAL_DOUBLE(1.0e4, wheels.wanted_radps[BERTH_LEFT]);
}

static void test_a_wheel_without_torque_stands(void) {
    static const uint8_t idle[4] = {1, 0, 0, 0};
    circle();
    create();
    command_wheels(5.0, 5.0); /* not enabled: nothing happens */
    run_until(BEGIN_US + 100000);
    check_pose(scenario.start.x_m, scenario.start.y_m, scenario.start.theta_rad);
    enable();
    command_wheels(5.0, 5.0);
    run_until(now_us + 100000);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-6, 0.25, result()->speed_mps);
    odrive(LEFT_NODE, 0x07, idle, 4);
    run_until(now_us + 10000);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-6, 0.125, result()->speed_mps);
    odrive(RIGHT_NODE, 0x07, idle, 4);
    run_until(now_us + 10000);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, result()->speed_mps);
}

/* Without commands the drives' own watchdogs stop the wheels, at their time. */
static void test_watchdogs_stop_the_wheels(void) {
    circle();
    create();
    enable();
    command_wheels(TWO_PI, TWO_PI);
    run_until(BEGIN_US + 1000000);
    const double way_m = 0.05 * TWO_PI * 0.2; /* the watchdog's 200 ms */
    check_pose(scenario.start.x_m + way_m * cos(scenario.start.theta_rad),
               scenario.start.y_m + way_m * sin(scenario.start.theta_rad),
               scenario.start.theta_rad);
    TEST_ASSERT_EQUAL_UINT(1, result()->drives[0].watchdog_stops);
    TEST_ASSERT_EQUAL_UINT(1, result()->drives[1].watchdog_stops);
}

/* One long stride gives what many short ones give. */
static void test_strides_do_not_matter(void) {
    berth_pose_t ends[2];
    for (int i = 0; i < 2; i++) {
        setUp();
        circle();
        scenario.plant.tau_s = i == 0 ? 0.0 : 0.08;
        berth_pose_t poses[2];
        for (int j = 0; j < 2; j++) {
            setUp();
            create();
            enable();
            command_wheels(3.0, 4.0);
            for (int64_t at_us = 0; j == 1 && at_us < 190000; at_us += 700) {
                bus_robot_step(robot, BEGIN_US + at_us);
            }
            bus_robot_step(robot, BEGIN_US + 190000);
            poses[j] = bus_robot_pose(robot);
            tearDown();
        }
        TEST_ASSERT_FLOAT_WITHIN(2.0e-5f, poses[0].x_m, poses[1].x_m);
        TEST_ASSERT_FLOAT_WITHIN(2.0e-5f, poses[0].y_m, poses[1].y_m);
        TEST_ASSERT_FLOAT_WITHIN(2.0e-5f, poses[0].theta_rad, poses[1].theta_rad);
        ends[i] = poses[0];
    }
    TEST_ASSERT_TRUE(hypotf(ends[0].x_m - ends[1].x_m, ends[0].y_m - ends[1].y_m) > 0.005f);
    setUp();
}

/* With nothing to do for long the plant is moved in short pieces all the same. */
static void test_lag_is_exact_between_events_far_apart(void) {
    circle();
    scenario.plant.tau_s = 0.01;
    bus_robot_config_t config = robot_config();
    config.fix_period_us = 0;
    for (int side = 0; side < 2; side++) {
        config.drives[side].feedback_us = 10000000;
        config.drives[side].heartbeat_us = 10000000;
        config.drives[side].watchdog_us = 0;
    }
    create_with(&config);
    enable();
    command_wheels(TWO_PI, TWO_PI);
    now_us += 1000000;
    bus_robot_step(robot, now_us);
    const double way_m = 0.05 * TWO_PI * (1.0 - 0.01);
    check_pose(scenario.start.x_m + way_m * cos(scenario.start.theta_rad),
               scenario.start.y_m + way_m * sin(scenario.start.theta_rad),
               scenario.start.theta_rad);
}

/* On a bus with little room neither drive waits for the other to fall silent. */
static void test_drives_take_turns(void) {
    circle();
    bus_robot_config_t config = robot_config();
    config.fix_period_us = 0;
    create_with(&config);
    now_us += 95000; /* nine frames each */
    bus_robot_step(robot, now_us);
    for (int i = 0; i < 10; i++) {
        const berth_can_frame_t *front = bus_robot_front(robot);
        TEST_ASSERT_NOT_NULL(front);
        take_frame(front);
        bus_robot_sent(robot);
    }
    TEST_ASSERT_EQUAL_UINT(5, frames[0]);
    TEST_ASSERT_EQUAL_UINT(5, frames[1]);
}

/* A lagging plant's encoders tell where the true wheels are, not where they were told to be. */
static void test_encoders_tell_the_true_wheels(void) {
    circle();
    scenario.plant.tau_s = 0.1;
    create();
    enable();
    for (int i = 0; i < 20; i++) {
        command_wheels(TWO_PI, TWO_PI);
        run_until(now_us + 100000);
    }
    /* 2 s at one turn a second, less the lag's 0.1 s */
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-3, 1.9, last_turns[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-3, 1.9, last_turns[1]);
    const berth_pose_t pose = bus_robot_pose(robot);
    const double way_m =
        hypot((double)pose.x_m - scenario.start.x_m, (double)pose.y_m - scenario.start.y_m);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-3, 1.9 * TWO_PI * 0.05, way_m);
}

/* --- localisation ------------------------------------------------------------------------ */

static void test_fixes_come_at_once_and_then_cyclically(void) {
    circle();
    create();
    bus_robot_step(robot, BEGIN_US);
    take_frames();
    TEST_ASSERT_EQUAL_UINT(1, frames[2]);
    TEST_ASSERT_EQUAL_INT64(BEGIN_US, first_fix_us);
    TEST_ASSERT_FLOAT_WITHIN(6.0e-5f, (float)scenario.start.x_m, last_fix.x_m);
    TEST_ASSERT_FLOAT_WITHIN(6.0e-5f, (float)scenario.start.y_m, last_fix.y_m);
    TEST_ASSERT_FLOAT_WITHIN(6.0e-5f, (float)scenario.start.theta_rad, last_fix.theta_rad);
    run_until(BEGIN_US + 1000000);
    TEST_ASSERT_EQUAL_UINT(11, frames[2]);
    TEST_ASSERT_EQUAL_UINT(11, result()->fixes);
}

static void test_a_late_fix_tells_where_the_robot_was(void) {
    circle();
    bus_robot_config_t config = robot_config();
    config.fix_latency_us = 250000;
    create_with(&config);
    enable();
    command_wheels(4.0, 4.0);
    run_until(BEGIN_US + 249999);
    TEST_ASSERT_EQUAL_UINT(0, frames[2]);
    run_until(BEGIN_US + 450000); /* that of 200 ms */
    TEST_ASSERT_EQUAL_UINT(3, frames[2]);
    TEST_ASSERT_EQUAL_INT64(BEGIN_US + 450000, last_fix_us);
    /* until the watchdog stops it at 200 ms: */
    const double way_m = 0.05 * 4.0 * 0.2;
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-4, scenario.start.x_m + way_m * cos(1.2), (double)last_fix.x_m);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-4, scenario.start.y_m + way_m * sin(1.2), (double)last_fix.y_m);
}

static void test_fixes_can_be_off(void) {
    circle();
    bus_robot_config_t config = robot_config();
    config.fix_period_us = 0;
    create_with(&config);
    run_until(BEGIN_US + 2000000);
    TEST_ASSERT_EQUAL_UINT(0, frames[2]);
    TEST_ASSERT_GREATER_THAN_UINT(100, frames[0]);
}

/* Standard deviation as the scenario says, and the same numbers from the same seed. */
static void test_fixes_have_the_scenarios_noise(void) {
    circle();
    scenario.plant.pose_noise_m = 0.02;
    float first[3] = {0.0f, 0.0f, 0.0f};
    for (uint64_t seed = 1; seed <= 3; seed++) {
        setUp();
        bus_robot_config_t config = robot_config();
        config.seed = seed == 3 ? 1 : seed;
        config.fix_period_us = 1000;
        create_with(&config);
        double sum = 0.0;
        unsigned long count = 0;
        for (int i = 0; i < 2000; i++) {
            run_until(now_us + 1000);
            const double error_m = (double)last_fix.x_m - scenario.start.x_m;
            first[seed - 1] = i == 0 ? last_fix.x_m : first[seed - 1];
            sum += error_m * error_m;
            count++;
        }
        TEST_ASSERT_DOUBLE_WITHIN(0.002, 0.02, sqrt(sum / (double)count));
        tearDown();
    }
    setUp();
    TEST_ASSERT_TRUE(first[0] != first[1]);
    TEST_ASSERT_TRUE(first[0] == first[2]);
}

static void test_impossible_fixes_are_refused(void) {
    circle();
    scenario_error_t error;
    TEST_ASSERT_TRUE(run_plan_make(&scenario, &plan, &error));
    bus_robot_config_t config = robot_config();
    config.fix_latency_us = BUS_ROBOT_LATENCY_PERIODS * config.fix_period_us + 1;
    TEST_ASSERT_NULL(bus_robot_create(&config, BEGIN_US, &error));
    TEST_ASSERT_NOT_NULL(strstr(error.text, "latency"));
    config = robot_config();
    config.fix_period_us = -1;
    TEST_ASSERT_NULL(bus_robot_create(&config, BEGIN_US, &error));
    TEST_ASSERT_NOT_NULL(strstr(error.text, "period"));
}

/* Discs on the centimetre grid that hold the true ones, and live longer than they are apart. */
static void test_obstacles_are_announced(void) {
    circle();
    bus_robot_config_t config = robot_config();
    config.announced = true;
    config.body_m = 0.04;
    create_with(&config);
    bus_robot_step(robot, BEGIN_US);
    take_frames();
    TEST_ASSERT_EQUAL_UINT(3, frames[3]);
    run_until(BEGIN_US + 1000000);
    TEST_ASSERT_EQUAL_UINT(18, frames[3]);
    for (size_t i = 0; i < 3; i++) {
        const scenario_obstacle_t *obstacle = &scenario.obstacles[i];
        const double off_m =
            hypot((double)told[i].x_m - obstacle->x_m, (double)told[i].y_m - obstacle->y_m);
        const double covered_m = (double)told[i].radius_m + config.body_m - off_m;
        TEST_ASSERT_TRUE(covered_m >= obstacle->hard_m - 1.0e-6);
        TEST_ASSERT_TRUE(covered_m < obstacle->hard_m + 0.011);
        TEST_ASSERT_GREATER_THAN_UINT16(BUS_ROBOT_ANNOUNCE_US / 1000, told[i].ttl_ms);
    }
}

static void test_obstacles_are_not_announced_unasked(void) {
    circle();
    create();
    run_until(BEGIN_US + 1000000);
    TEST_ASSERT_EQUAL_UINT(0, frames[3]);
}

/* --- the run ----------------------------------------------------------------------------- */

static void test_the_run_begins_with_the_boards(void) {
    circle();
    create();
    enable();
    run_until(BEGIN_US + 20000);
    status(BERTH_SUPERVISOR_ARMED, BERTH_MODE_TRACK, 0, 0);
    TEST_ASSERT_EQUAL_INT(BUS_ROBOT_WAITING, result()->phase);
    run_until(BEGIN_US + 70000);
    status(BERTH_SUPERVISOR_RUNNING, BERTH_MODE_REGULATED, 0, 3); /* three went unheard */
    TEST_ASSERT_EQUAL_INT(BUS_ROBOT_RUNNING, result()->phase);
    TEST_ASSERT_EQUAL_INT64(BEGIN_US + 70000 - 3 * PERIOD_US, result()->run_us);
    command_wheels(2.0, 3.0);
    run_until(BEGIN_US + 70000 + PERIOD_US - 1);
    TEST_ASSERT_EQUAL_size_t(0, row_count);
    run_until(BEGIN_US + 70000 + PERIOD_US);
    TEST_ASSERT_EQUAL_size_t(1, row_count);
    const berth_sample_t sample = berth_plan_sample(&plan.plan, 3);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-12, 0.15, rows[0].t_s);
    TEST_ASSERT_EQUAL_DOUBLE(scenario.start.x_m, rows[0].x_m);
    TEST_ASSERT_EQUAL_DOUBLE((double)sample.x_m, rows[0].x_r_m);
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_REGULATED, rows[0].mode);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-6, 0.125, rows[0].v_cmd_mps);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-6, 0.05 / 0.3, rows[0].omega_cmd_radps);
}

static void test_the_run_ends_after_the_scenarios_periods(void) {
    circle();
    scenario.duration_s = 1.0;
    create();
    enable();
    drive_periods(0, 19, 1.0, 1.0);
    TEST_ASSERT_EQUAL_INT(BUS_ROBOT_RUNNING, result()->phase);
    drive_periods(19, 3, 1.0, 1.0);
    TEST_ASSERT_EQUAL_INT(BUS_ROBOT_DONE, result()->phase);
    TEST_ASSERT_EQUAL_size_t(20, row_count);
    TEST_ASSERT_EQUAL_INT(20, result()->summary.steps);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-9, 1.0, result()->summary.mode_time_s[BERTH_MODE_TRACK]);
    /* each row starts where the one before has led */
    for (size_t k = 0; k + 1 < row_count; k++) {
        const double way_m = hypot(rows[k + 1].x_m - rows[k].x_m, rows[k + 1].y_m - rows[k].y_m);
        TEST_ASSERT_DOUBLE_WITHIN(1.0e-7, 0.05 * 0.05, way_m);
    }
    double sum = 0.0;
    for (size_t k = 0; k < row_count; k++) {
        sum += rows[k].e1_m * rows[k].e1_m + rows[k].e2_m * rows[k].e2_m;
    }
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-9, sqrt(sum / 20.0), result()->summary.rms_position_error_m);
}

static void test_the_run_ends_when_the_board_leaves_it(void) {
    circle();
    create();
    enable();
    drive_periods(0, 5, 1.0, 1.0);
    run_until(now_us + 10000);
    status(BERTH_SUPERVISOR_FAULT, BERTH_MODE_TRACK, BERTH_FAULT_BUS_OFF, 5);
    TEST_ASSERT_EQUAL_INT(BUS_ROBOT_LEFT, result()->phase);
    TEST_ASSERT_EQUAL_UINT8(BERTH_FAULT_BUS_OFF, result()->run_fault);
    TEST_ASSERT_EQUAL_INT(5, result()->summary.steps);
    status(BERTH_SUPERVISOR_IDLE, BERTH_MODE_TRACK, 0, 0);
    run_until(now_us + 1000000);
    TEST_ASSERT_EQUAL_UINT8(BERTH_FAULT_BUS_OFF, result()->run_fault); /* kept */
    TEST_ASSERT_EQUAL_size_t(5, row_count);
}

/* A board that counts the periods itself stops about when the last one ends here. */
static void test_a_board_that_stops_at_the_end_has_done_it_all(void) {
    for (int i = 0; i < 3; i++) {
        const bool soon = i == 1; /* half a period is too soon */
        const bool faulty = i == 2;
        setUp();
        circle();
        scenario.duration_s = 1.0;
        create();
        enable();
        drive_periods(0, 19, 1.0, 1.0);
        command_wheels(1.0, 1.0);
        status(BERTH_SUPERVISOR_RUNNING, BERTH_MODE_TRACK, 0, 19);
        run_until(now_us + PERIOD_US - (soon ? PERIOD_US / 2 + 1 : 1));
        status(faulty ? BERTH_SUPERVISOR_FAULT : BERTH_SUPERVISOR_STOPPING, BERTH_MODE_TRACK,
               faulty ? BERTH_FAULT_TRANSMIT : BERTH_FAULT_NONE, 20);
        const bool done = !soon && !faulty;
        TEST_ASSERT_EQUAL_INT(done ? BUS_ROBOT_DONE : BUS_ROBOT_LEFT, result()->phase);
        TEST_ASSERT_EQUAL_INT(done ? 20 : 19, result()->summary.steps);
        tearDown();
    }
    setUp();
}

/* A frame on the bus, and which kinds of robot want it: odrive, vesc, cia402. */
typedef struct {
    uint32_t id;
    bool extended;
    bool wanted[3];
} heard_t;

static bool passes(const berth_can_filter_t *filters, uint32_t count, const heard_t *heard) {
    for (uint32_t i = 0; i < count; i++) {
        if (filters[i].extended == heard->extended &&
            (heard->id & filters[i].mask) == (filters[i].id & filters[i].mask)) {
            return true;
        }
    }
    return false;
}

static void test_filters_let_through_what_is_heard(void) {
    static const drive_sim_kind_t kinds[] = {DRIVE_SIM_ODRIVE, DRIVE_SIM_VESC, DRIVE_SIM_CIA402};
    static const heard_t list[] = {
        {40u << 5 | 0x0du, false, {true, false, false}},
        {41u << 5 | 0x07u, false, {true, false, false}},
        {42u << 5 | 0x0du, false, {false, false, false}},
        {3u << 8 | 40u, true, {false, true, false}},
        {4u << 8 | 41u, true, {false, true, false}},
        {3u << 8 | 42u, true, {false, false, false}},
        {0x000, false, {false, false, true}}, /* NMT */
        {0x080, false, {false, false, true}}, /* SYNC */
        {0x200 | 41u, false, {false, false, true}},
        {0x600 | 40u, false, {false, false, true}},
        {0x600 | 42u, false, {false, false, false}},
        {0x77f, false, {false, false, true}}, /* the board's heartbeat */
        {BERTH_MESSAGE_STATUS << 8 | ADDRESS, true, {true, true, true}},
        {BERTH_MESSAGE_POSE << 8 | ADDRESS, true, {true, true, true}},
        {BERTH_MESSAGE_ERROR << 8 | ADDRESS, true, {true, true, true}},
        {BERTH_MESSAGE_STATUS << 8 | (ADDRESS + 1u), true, {false, false, false}},
        {BERTH_MESSAGE_POSE_FIX << 8 | ADDRESS, true, {false, false, false}},
    };
    for (size_t k = 0; k < 3; k++) {
        drive_sim_config_t drives[2] = {drive(40), drive(41)};
        drives[0].kind = drives[1].kind = kinds[k];
        berth_can_filter_t filters[BUS_ROBOT_FILTERS_MAX];
        const uint32_t count = bus_robot_filters(drives, ADDRESS, filters);
        TEST_ASSERT_LESS_OR_EQUAL_UINT32(BUS_ROBOT_FILTERS_MAX, count);
        for (size_t i = 0; i < sizeof list / sizeof list[0]; i++) {
            char what[48];
            snprintf(what, sizeof what, "id %x, kind %u", (unsigned)list[i].id, (unsigned)k);
            TEST_ASSERT_EQUAL_MESSAGE(list[i].wanted[k], passes(filters, count, &list[i]), what);
        }
    }
}

static void test_the_run_ends_when_nothing_is_heard(void) {
    circle();
    create();
    enable();
    drive_periods(0, 5, 1.0, 1.0);
    const int64_t heard_us = result()->status_us;
    run_until(heard_us + BUS_ROBOT_SILENCE_US - 1);
    TEST_ASSERT_EQUAL_INT(BUS_ROBOT_RUNNING, result()->phase);
    run_until(heard_us + BUS_ROBOT_SILENCE_US);
    TEST_ASSERT_EQUAL_INT(BUS_ROBOT_SILENT, result()->phase);
    TEST_ASSERT_EQUAL_INT((4 * PERIOD_US + BUS_ROBOT_SILENCE_US) / PERIOD_US,
                          result()->summary.steps);
}

/* The first status was 30 ms late: the next ones tell when the reference really began. */
static void test_the_reference_is_aligned_by_the_punctual_statuses(void) {
    circle();
    scenario.duration_s = 0.5;
    create();
    enable();
    now_us += 30000;
    bus_robot_step(robot, now_us);
    status(BERTH_SUPERVISOR_RUNNING, BERTH_MODE_TRACK, 0, 0);
    TEST_ASSERT_EQUAL_INT64(BEGIN_US + 30000, result()->run_us);
    run_until(BEGIN_US + PERIOD_US); /* 20 ms into what is taken for the first period */
    status(BERTH_SUPERVISOR_RUNNING, BERTH_MODE_TRACK, 0, 1);
    TEST_ASSERT_EQUAL_INT64(BEGIN_US, result()->run_us);
    run_until(BEGIN_US + PERIOD_US + 1);
    TEST_ASSERT_EQUAL_size_t(1, row_count); /* it ended there and then */
    for (uint32_t k = 2; k < 10; k++) {
        run_until(BEGIN_US + k * PERIOD_US + 2000 * (k % 3)); /* late again: no matter */
        status(BERTH_SUPERVISOR_RUNNING, BERTH_MODE_TRACK, 0, k);
        TEST_ASSERT_EQUAL_INT64(BEGIN_US, result()->run_us);
        TEST_ASSERT_EQUAL_size_t(k, row_count);
    }
    run_until(BEGIN_US + 10 * PERIOD_US + 1);
    TEST_ASSERT_EQUAL_INT(BUS_ROBOT_DONE, result()->phase);
    TEST_ASSERT_EQUAL_INT(10, result()->summary.steps);
}

/* A status that another has overtaken tells what was. */
static void test_a_status_from_before_is_not_heard(void) {
    circle();
    create();
    run_until(BEGIN_US + 100000);
    status(BERTH_SUPERVISOR_RUNNING, BERTH_MODE_TRACK, 0, 0);
    const berth_message_status_t message = {.state = BERTH_SUPERVISOR_ARMED, .clearance_m = -1.0f};
    berth_can_frame_t frame;
    berth_message_encode_status(&frame, ADDRESS, &message);
    frame.time_us = now_us - 1;
    bus_robot_receive(robot, &frame);
    TEST_ASSERT_EQUAL_INT(BUS_ROBOT_RUNNING, result()->phase);
    frame.time_us = now_us;
    bus_robot_receive(robot, &frame);
    TEST_ASSERT_EQUAL_INT(BUS_ROBOT_LEFT, result()->phase);
}

static void test_a_run_begun_long_ago_is_none(void) {
    circle();
    create();
    status(BERTH_SUPERVISOR_RUNNING, BERTH_MODE_TRACK, 0, 600);
    TEST_ASSERT_EQUAL_INT(BUS_ROBOT_WAITING, result()->phase);
}

/* Straight into an obstacle and out again: counted once, with the depth; the same after the run. */
static void test_collisions_are_counted_by_the_true_robot(void) {
    circle();
    scenario.start.x_m = -1.0;
    scenario.start.y_m = 1.027;
    scenario.start.theta_rad = 0.0;
    create();
    enable();
    drive_periods(0, 80, 8.0, 8.0); /* 1.6 m through the obstacle at x = 0.073, R = 0.1 */
    TEST_ASSERT_EQUAL_INT(1, result()->summary.collisions);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-6, -0.1, result()->summary.min_clearance_m);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-6, -0.1, result()->clearance_m);
    double least_m = HUGE_VAL;
    for (size_t k = 0; k < row_count; k++) {
        least_m = fmin(least_m, rows[k].clearance_m);
    }
    TEST_ASSERT_EQUAL_DOUBLE(result()->summary.min_clearance_m, least_m);
    TEST_ASSERT_TRUE(rows[0].clearance_m > 0.5); /* each row has its own */
    TEST_ASSERT_TRUE(rows[79].clearance_m > 0.3);
}

static void test_clearance_counts_outside_the_run_too(void) {
    circle();
    scenario.start.x_m = -0.2;
    scenario.start.y_m = 1.027;
    scenario.start.theta_rad = 0.0;
    create();
    enable();
    command_wheels(20.0, 20.0); /* 1 m/s for the watchdog's 200 ms: 0.027 m into the disc */
    run_until(BEGIN_US + 500000);
    TEST_ASSERT_EQUAL_INT(BUS_ROBOT_WAITING, result()->phase);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-6, 0.073 - 0.1, result()->clearance_m);
}

static void test_what_comes_after_the_run_does_not_count_in_its_summary(void) {
    circle();
    scenario.duration_s = 1.0;
    scenario.start.x_m = -0.6;
    scenario.start.y_m = 1.027;
    scenario.start.theta_rad = 0.0;
    create();
    enable();
    drive_periods(0, 20, 1.0, 1.0);
    TEST_ASSERT_EQUAL_INT(BUS_ROBOT_DONE, result()->phase);
    const run_summary_t at_end = result()->summary;
    drive_periods(20, 60, 8.0, 8.0);
    TEST_ASSERT_EQUAL_DOUBLE(at_end.min_clearance_m, result()->summary.min_clearance_m);
    TEST_ASSERT_TRUE(at_end.min_clearance_m > 0.3);
    TEST_ASSERT_EQUAL_INT(0, result()->summary.collisions);
    TEST_ASSERT_EQUAL_INT(20, result()->summary.steps);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-6, -0.1, result()->clearance_m);
    TEST_ASSERT_EQUAL_size_t(20, row_count);
}

/* Avoiding and far away when the board leaves in the middle of a period: not recovered. */
static void test_a_run_cut_short_has_not_recovered(void) {
    circle();
    create();
    enable();
    command_wheels(0.0, 0.0);
    for (uint32_t k = 0; k < 5; k++) {
        status(BERTH_SUPERVISOR_RUNNING, BERTH_MODE_CONSERVATIVE_TURN, 0, k);
        run_until(now_us + PERIOD_US);
    }
    run_until(now_us + PERIOD_US / 3);
    status(BERTH_SUPERVISOR_STOPPING, BERTH_MODE_TRACK, 0, 5);
    TEST_ASSERT_EQUAL_INT(5, result()->summary.steps);
    TEST_ASSERT_TRUE(isnan(result()->summary.recovery_time_s));
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-9, 0.25, result()->summary.avoidance_time_s);
}

static void test_the_boards_pose_is_held_against_the_true_one(void) {
    circle();
    create();
    const berth_pose_t pose = {(float)scenario.start.x_m + 0.03f, (float)scenario.start.y_m - 0.04f,
                               0.0f};
    berth_can_frame_t frame;
    berth_message_encode_pose(&frame, BERTH_MESSAGE_POSE, ADDRESS, &pose);
    receive(frame);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, result()->pose_error_m); /* during the run alone */
    status(BERTH_SUPERVISOR_RUNNING, BERTH_MODE_TRACK, 0, 0);
    receive(frame);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-4, 0.05, result()->pose_error_m);
    TEST_ASSERT_EQUAL_UINT(2, result()->poses);
}

/* --- trouble ----------------------------------------------------------------------------- */

static void test_ordered_trouble_comes_at_its_time(void) {
    circle();
    create();
    enable();
    const bus_robot_order_t later = {
        .at_us = BEGIN_US + 100000, .side = 1, .trouble = {.dead = true}};
    const bus_robot_order_t sooner = {.at_us = BEGIN_US + 50000, .side = 0, .fail = 0x100};
    TEST_ASSERT_TRUE(bus_robot_order(robot, &later));
    TEST_ASSERT_TRUE(bus_robot_order(robot, &sooner));
    command_wheels(4.0, 4.0);
    run_until(BEGIN_US + 49999);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-6, 0.2, result()->speed_mps);
    run_until(BEGIN_US + 60000);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-6, 0.1, result()->speed_mps);
    run_until(BEGIN_US + 99999);
    const unsigned long said = frames[1];
    run_until(BEGIN_US + 1100000);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, result()->speed_mps);
    TEST_ASSERT_EQUAL_UINT(said, frames[1]);
    TEST_ASSERT_GREATER_THAN_UINT(100, frames[0]);
}

static void test_orders_have_an_end(void) {
    circle();
    create();
    const bus_robot_order_t order = {.at_us = BEGIN_US + 1, .side = 0, .fail = 1};
    for (int i = 0; i < BUS_ROBOT_ORDERS_MAX; i++) {
        TEST_ASSERT_TRUE(bus_robot_order(robot, &order));
    }
    TEST_ASSERT_FALSE(bus_robot_order(robot, &order));
    run_until(BEGIN_US + 10);
    TEST_ASSERT_TRUE(bus_robot_order(robot, &order));
}

/* A bus that takes nothing for a while: what has no room is counted, and all goes on. */
static void test_frames_without_room_are_counted(void) {
    circle();
    bus_robot_config_t config = robot_config();
    config.announced = true;
    create_with(&config);
    for (int64_t at_us = BEGIN_US; at_us < BEGIN_US + 10000000; at_us += 10000) {
        bus_robot_step(robot, at_us);
    }
    now_us = BEGIN_US + 10000000;
    TEST_ASSERT_GREATER_THAN_UINT(50, result()->lost);
    TEST_ASSERT_GREATER_THAN_UINT(0, result()->drives[0].overruns);
    take_frames();
    const unsigned long before = frames[2];
    run_until(now_us + 1000000);
    TEST_ASSERT_UINT_WITHIN(1, 10, frames[2] - before);
}

/* A robot that was not run for a long time does not make up for what it would have said. */
static void test_a_long_pause_is_not_made_up_for(void) {
    circle();
    create();
    bus_robot_step(robot, BEGIN_US);
    take_frames();
    now_us = BEGIN_US + 60000000;
    bus_robot_step(robot, now_us);
    take_frames();
    TEST_ASSERT_LESS_THAN_UINT(4, frames[2]);
    TEST_ASSERT_GREATER_THAN_INT64(now_us, bus_robot_deadline(robot));
}

static void test_malformed_frames_of_the_board_are_counted(void) {
    circle();
    create();
    status(BERTH_SUPERVISOR_RUNNING, BERTH_MODE_TRACK, 0, 0);
    const uint32_t kinds[] = {BERTH_MESSAGE_STATUS, BERTH_MESSAGE_POSE, BERTH_MESSAGE_ERROR};
    for (size_t i = 0; i < 3; i++) {
        for (uint8_t length = 0; length < 8; length++) {
            const berth_can_frame_t frame = {
                .id = kinds[i] << 8 | ADDRESS, .extended = true, .length = length};
            receive(frame);
        }
        const berth_can_frame_t remote = {
            .id = kinds[i] << 8 | ADDRESS, .extended = true, .remote = true, .length = 8};
        receive(remote);
    }
    TEST_ASSERT_EQUAL_UINT(27, result()->malformed);
    TEST_ASSERT_EQUAL_UINT(1, result()->statuses);
    TEST_ASSERT_EQUAL_INT(BUS_ROBOT_RUNNING, result()->phase);
}

/* Frames of another robot on the same bus do not concern this one. */
static void test_another_robots_board_is_not_heard(void) {
    circle();
    create();
    berth_can_frame_t frame;
    const berth_message_status_t message = {.state = BERTH_SUPERVISOR_RUNNING};
    berth_message_encode_status(&frame, ADDRESS + 1, &message);
    receive(frame);
    TEST_ASSERT_EQUAL_UINT(0, result()->statuses);
    TEST_ASSERT_EQUAL_INT(BUS_ROBOT_WAITING, result()->phase);
}

static berth_can_frame_t any_frame(void) {
    static const uint32_t kinds[] = {BERTH_MESSAGE_STATUS, BERTH_MESSAGE_POSE, BERTH_MESSAGE_ERROR,
                                     BERTH_MESSAGE_COMMAND};
    berth_can_frame_t frame = {.extended = support_index(2) == 0,
                               .remote = support_index(8) == 0,
                               .length = (uint8_t)support_index(9)};
    frame.id = frame.extended ? kinds[support_index(4)] << 8 | ADDRESS : support_index(0x60);
    for (int i = 0; i < 8; i++) {
        frame.data[i] = (uint8_t)support_index(256);
    }
    return frame;
}

/* Anything at all, with times that go back and forth: the true robot stays finite, time passes. */
static void test_hostile_frames(void) {
    support_random_start();
    for (uint32_t run = 0; run < support_runs(20); run++) {
        setUp();
        circle();
        scenario.plant.tau_s = run % 2 == 0 ? 0.0 : 0.05;
        create();
        enable();
        for (int i = 0; i < 2000; i++) {
            berth_can_frame_t frame = any_frame();
            frame.time_us = now_us - (int64_t)support_index(2000) + 500;
            bus_robot_receive(robot, &frame);
            now_us = frame.time_us > now_us ? frame.time_us : now_us;
            bus_robot_step(robot, now_us);
            take_frames();
        }
        const berth_pose_t pose = bus_robot_pose(robot);
        TEST_ASSERT_TRUE(isfinite(pose.x_m) && isfinite(pose.y_m) && isfinite(pose.theta_rad));
        tearDown();
    }
    setUp();
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_wheels_move_the_robot_along_the_arc);
    RUN_TEST(test_wheels_are_told);
    RUN_TEST(test_a_wheel_without_torque_stands);
    RUN_TEST(test_watchdogs_stop_the_wheels);
    RUN_TEST(test_strides_do_not_matter);
    RUN_TEST(test_lag_is_exact_between_events_far_apart);
    RUN_TEST(test_drives_take_turns);
    RUN_TEST(test_encoders_tell_the_true_wheels);
    RUN_TEST(test_fixes_come_at_once_and_then_cyclically);
    RUN_TEST(test_a_late_fix_tells_where_the_robot_was);
    RUN_TEST(test_fixes_can_be_off);
    RUN_TEST(test_fixes_have_the_scenarios_noise);
    RUN_TEST(test_impossible_fixes_are_refused);
    RUN_TEST(test_obstacles_are_announced);
    RUN_TEST(test_obstacles_are_not_announced_unasked);
    RUN_TEST(test_the_run_begins_with_the_boards);
    RUN_TEST(test_the_run_ends_after_the_scenarios_periods);
    RUN_TEST(test_the_run_ends_when_the_board_leaves_it);
    RUN_TEST(test_a_board_that_stops_at_the_end_has_done_it_all);
    RUN_TEST(test_filters_let_through_what_is_heard);
    RUN_TEST(test_the_run_ends_when_nothing_is_heard);
    RUN_TEST(test_the_reference_is_aligned_by_the_punctual_statuses);
    RUN_TEST(test_a_status_from_before_is_not_heard);
    RUN_TEST(test_a_run_begun_long_ago_is_none);
    RUN_TEST(test_collisions_are_counted_by_the_true_robot);
    RUN_TEST(test_clearance_counts_outside_the_run_too);
    RUN_TEST(test_what_comes_after_the_run_does_not_count_in_its_summary);
    RUN_TEST(test_a_run_cut_short_has_not_recovered);
    RUN_TEST(test_the_boards_pose_is_held_against_the_true_one);
    RUN_TEST(test_ordered_trouble_comes_at_its_time);
    RUN_TEST(test_orders_have_an_end);
    RUN_TEST(test_frames_without_room_are_counted);
    RUN_TEST(test_a_long_pause_is_not_made_up_for);
    RUN_TEST(test_malformed_frames_of_the_board_are_counted);
    RUN_TEST(test_another_robots_board_is_not_heard);
    RUN_TEST(test_hostile_frames);
    return UNITY_END();
}
