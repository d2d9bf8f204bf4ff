/* The whole board in virtual time: the way to running and back, every reason to stop, what it
 * tells, and that nothing but RUNNING ever moves a wheel.
 */
#include "board_rig.h"

#include "unity.h"

#include <stdio.h>

static rig_t rig;
static berth_refusal_t refusal;

static void begin(void) {
    TEST_ASSERT_EQUAL_INT(BERTH_OK, rig_init(&rig, &refusal));
    rig_set_pose(&rig, 0.95f, 0.0f, 1.5f);
}

void setUp(void) {
    rig_prepare(&rig);
    begin();
}

void tearDown(void) {}

static berth_supervisor_state_t state(void) {
    return berth_board_status(&rig.board)->state;
}

static void expect_state(berth_supervisor_state_t expected) {
    TEST_ASSERT_EQUAL_STRING(berth_supervisor_state_text(expected),
                             berth_supervisor_state_text(state()));
}

static void run_for(int64_t time_us) {
    rig_run(&rig, rig.now_us + time_us);
}

static void arm(void) {
    rig_command(&rig, BERTH_COMMAND_ARM);
    run_for(200000);
    expect_state(BERTH_SUPERVISOR_ARMED);
}

static void start_running(void) {
    arm();
    rig_command(&rig, BERTH_COMMAND_START);
    run_for(1000000);
    expect_state(BERTH_SUPERVISOR_RUNNING);
    TEST_ASSERT_TRUE(rig.wheels[0].rps > 0.1 && rig.wheels[1].rps > 0.1);
}

static double distance_to_reference(void) {
    const berth_status_t *control = berth_board_control(&rig.board);
    return (double)fabsf(control->tracking_error.e1_m) +
           (double)fabsf(control->tracking_error.e2_m);
}

static void test_from_idle_to_running_and_back(void) {
    run_for(1000000);
    expect_state(BERTH_SUPERVISOR_IDLE);
    TEST_ASSERT_EQUAL_INT(0, rig.wheels[0].commands + rig.wheels[1].commands);
    arm();
    TEST_ASSERT_TRUE(rig.wheels[0].commands > 0);
    TEST_ASSERT_EQUAL_INT(0, (int)rig.moving);
    rig_command(&rig, BERTH_COMMAND_START);
    run_for(8000000);
    expect_state(BERTH_SUPERVISOR_RUNNING);
    TEST_ASSERT_TRUE(distance_to_reference() < 0.005);
    rig_command(&rig, BERTH_COMMAND_STOP);
    run_for(200000);
    expect_state(BERTH_SUPERVISOR_IDLE);
    TEST_ASSERT_TRUE(rig.wheels[0].rps == 0.0 && rig.wheels[1].rps == 0.0);
    TEST_ASSERT_EQUAL_INT(1, rig.wheels[0].lets);
    TEST_ASSERT_EQUAL_INT(1, rig.wheels[1].lets);
    TEST_ASSERT_EQUAL_UINT8(BERTH_FAULT_NONE, berth_board_status(&rig.board)->fault);
    TEST_ASSERT_EQUAL_UINT32(0, berth_board_status(&rig.board)->late);
    TEST_ASSERT_EQUAL_UINT32(0, berth_board_status(&rig.board)->malformed);
    /* and once more */
    start_running();
}

static void test_a_configured_braking_slows_the_stop(void) {
    rig_prepare(&rig);
    rig.config.controller.limits.a_max_mps2 = 0.5f;
    rig.config.controller.avoid.a_brake_mps2 = 0.5f;
    rig.config.regions.conservative_m = 1.0f;
    begin();
    start_running();
    const double before = rig.wheels[0].rps + rig.wheels[1].rps;
    rig_command(&rig, BERTH_COMMAND_STOP);
    run_for(2 * RIG_PERIOD_US);
    expect_state(BERTH_SUPERVISOR_STOPPING);
    const double after = rig.wheels[0].rps + rig.wheels[1].rps;
    TEST_ASSERT_TRUE(after < 0.95 * before && after > 0.5 * before);
    run_for(1500000);
    expect_state(BERTH_SUPERVISOR_IDLE);
}

/* A wheel that turns through zero while it is still driven does not stand. */
static void test_a_stop_takes_its_time_to_act(void) {
    start_running();
    rig.wheels[0].rps = rig.wheels[1].rps = 0.0;
    rig_feedback(&rig);
    rig_command(&rig, BERTH_COMMAND_STOP);
    const int commands = rig.wheels[0].commands;
    run_for(RIG_PERIOD_US);
    expect_state(BERTH_SUPERVISOR_STOPPING);
    TEST_ASSERT_EQUAL_INT(commands + 1, rig.wheels[0].commands);
    TEST_ASSERT_TRUE(rig.wheels[0].rps == 0.0 && rig.wheels[1].rps == 0.0);
    run_for(2 * RIG_PERIOD_US);
    expect_state(BERTH_SUPERVISOR_IDLE);
}

/* --- every reason to stop --------------------------------------------------------------------- */

static void bus(berth_can_mode_t mode, bool failed) {
    berth_board_bus(&rig.board, mode, failed, rig.now_us);
    rig_send_all(&rig);
}

static void hear_error_of_right(void) {
    berth_can_frame_t frame = drive_frame(0x212, false, 1);
    frame.data[0] = 9;
    rig_hear(&rig, &frame);
}

static void hear_command(berth_command_code_t code) {
    berth_can_frame_t frame;
    berth_message_encode_command(&frame, 5, code);
    rig_hear(&rig, &frame);
}

static void hear_obstacle(uint8_t id, float x_m, float y_m, uint16_t ttl_ms) {
    const berth_message_obstacle_t obstacle = {id, x_m, y_m, 0.1f, ttl_ms};
    berth_can_frame_t frame;
    berth_message_encode_obstacle(&frame, 5, &obstacle);
    rig_hear(&rig, &frame);
}

/* Wheels that stand by chance while they are told to turn on the spot, or to stand for another
 * reason: the stop has its period to act in either case. */
static void test_standing_wheels_do_not_end_a_stop_before_it_acts(void) {
    hear_obstacle(1, 0.95f, 0.45f, 60000); /* straight ahead, in its conservative region */
    arm();
    rig_command(&rig, BERTH_COMMAND_START);
    run_for(RIG_PERIOD_US);
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_CONSERVATIVE_TURN, berth_board_control(&rig.board)->mode);
    TEST_ASSERT_TRUE(berth_board_status(&rig.board)->command.twist.v_mps == 0.0f);
    rig.wheels[0].rps = rig.wheels[1].rps = 0.0;
    rig_feedback(&rig);
    rig_command(&rig, BERTH_COMMAND_STOP);
    run_for(RIG_PERIOD_US);
    expect_state(BERTH_SUPERVISOR_STOPPING);
    run_for(2 * RIG_PERIOD_US);
    expect_state(BERTH_SUPERVISOR_IDLE);

    hear_obstacle(2, 0.65f, 0.2f, 60000); /* and all around */
    hear_obstacle(3, 1.25f, 0.2f, 60000);
    hear_obstacle(4, 0.95f, -0.25f, 60000);
    arm();
    rig_command(&rig, BERTH_COMMAND_START);
    run_for(RIG_PERIOD_US + 10000);
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_BLOCKED, berth_board_control(&rig.board)->mode);
    rig_command(&rig, BERTH_COMMAND_STOP);
    run_for(RIG_PERIOD_US);
    expect_state(BERTH_SUPERVISOR_STOPPING);
    run_for(RIG_PERIOD_US);
    expect_state(BERTH_SUPERVISOR_IDLE);
}

static void cause_left_silence(void) {
    rig.wheels[0].mute = true;
}
static void cause_right_silence(void) {
    rig.wheels[1].mute = true;
}
static void cause_bus_off(void) {
    bus(BERTH_CAN_BUS_OFF, false);
}
static void cause_bus_down(void) {
    bus(BERTH_CAN_DOWN, false);
}
static void cause_bus_failure(void) {
    bus(BERTH_CAN_ERROR_ACTIVE, true);
}
static void cause_blocked_bus(void) {
    rig.blocked = true;
}
static void cause_emergency_frame(void) {
    hear_command(BERTH_COMMAND_EMERGENCY_STOP);
}
static void cause_emergency_call(void) {
    rig_command(&rig, BERTH_COMMAND_EMERGENCY_STOP);
}
static void cause_late_step(void) {
    rig.now_us += 5 * RIG_PERIOD_US;
    rig_feedback(&rig);
    berth_board_step(&rig.board, rig.now_us);
    rig_send_all(&rig);
}
/* The board itself has slept: the drives are not to blame, though nothing was heard of them. */
static void cause_late_step_unheard(void) {
    rig.now_us += 5 * RIG_PERIOD_US;
    berth_board_step(&rig.board, rig.now_us);
    rig_send_all(&rig);
}
static void cause_time_backwards(void) {
    berth_board_step(&rig.board, rig.now_us - 1);
    rig_send_all(&rig);
}
static void cause_time_beyond_its_range(void) {
    berth_board_step(&rig.board, BERTH_TIME_MAX_US + 1);
    rig_send_all(&rig);
}
static void cause_impossible_travel(void) {
    rig.board.drives[0].travel_rad += 2.0e4f; /* jumps of the position are no travel */
}
static void cause_pose_out_of_range(void) {
    rig.board.odometry.pose.x_m = 2000.0f;
}
static void cause_crowd(void) {
    for (uint8_t i = 0; i <= BERTH_OBSTACLES_MAX; i++) {
        hear_obstacle(i, 20.0f, (float)i, 60000);
    }
}

typedef struct {
    const char *what;
    void (*cause)(void);
    uint8_t fault;
    int64_t within_us; /* of the cause */
} cause_t;

static const cause_t causes[] = {
    {"left silent", cause_left_silence, (int)BERTH_FAULT_LEFT + BERTH_DRIVE_FAULT_FEEDBACK, 156000},
    {"right silent", cause_right_silence, (int)BERTH_FAULT_RIGHT + BERTH_DRIVE_FAULT_FEEDBACK,
     156000},
    {"drive error", hear_error_of_right, (int)BERTH_FAULT_RIGHT + BERTH_DRIVE_FAULT_DEVICE, 0},
    {"bus-off", cause_bus_off, BERTH_FAULT_BUS_OFF, 0},
    {"bus down", cause_bus_down, BERTH_FAULT_BUS_DOWN, 0},
    {"bus fails", cause_bus_failure, BERTH_FAULT_BUS_DOWN, 0},
    {"blocked", cause_blocked_bus, BERTH_FAULT_TRANSMIT, 151000},
    {"emergency stop, frame", cause_emergency_frame, BERTH_FAULT_EMERGENCY_STOP, 0},
    {"emergency stop, call", cause_emergency_call, BERTH_FAULT_EMERGENCY_STOP, 0},
    {"late", cause_late_step, BERTH_FAULT_PERIOD, 0},
    {"late, unheard", cause_late_step_unheard, BERTH_FAULT_PERIOD, 0},
    {"time backwards", cause_time_backwards, BERTH_FAULT_PERIOD, 0},
    {"time beyond its range", cause_time_beyond_its_range, BERTH_FAULT_PERIOD, 0},
    {"impossible travel", cause_impossible_travel, BERTH_FAULT_POSE_UNKNOWN, 56000},
    {"pose out of range", cause_pose_out_of_range, BERTH_FAULT_CONTROLLER, 51000},
    {"crowd", cause_crowd, BERTH_FAULT_OBSTACLES, 0},
};

/* The fault is there within its time, both wheels have been told to stop by then, nothing moves
 * afterwards, the reason stays, and only a reset with the cause gone leads on. */
static void check_cause(const cause_t *cause) {
    rig_prepare(&rig);
    begin();
    start_running();
    const int stops[2] = {rig.wheels[0].stops + rig.wheels[0].emergencies,
                          rig.wheels[1].stops + rig.wheels[1].emergencies};
    cause->cause();
    run_for(cause->within_us);
    TEST_ASSERT_EQUAL_INT_MESSAGE(BERTH_SUPERVISOR_FAULT, state(), cause->what);
    TEST_ASSERT_EQUAL_UINT8_MESSAGE(cause->fault, berth_board_status(&rig.board)->fault,
                                    cause->what);
    rig.blocked = false;
    rig_send_all(&rig);
    const long moving = rig.moving;
    for (int side = 0; side < 2; side++) {
        TEST_ASSERT_GREATER_THAN_INT(stops[side],
                                     rig.wheels[side].stops + rig.wheels[side].emergencies);
        TEST_ASSERT_TRUE(rig.wheels[side].rps == 0.0);
    }
    TEST_ASSERT_EQUAL_UINT8(cause->fault, rig.status.fault);
    rig_command(&rig, BERTH_COMMAND_ARM);
    rig_command(&rig, BERTH_COMMAND_START);
    run_for(3000000);
    expect_state(BERTH_SUPERVISOR_FAULT);
    TEST_ASSERT_EQUAL_UINT8(cause->fault, berth_board_status(&rig.board)->fault);
    TEST_ASSERT_EQUAL_INT64(moving, rig.moving);
    TEST_ASSERT_EQUAL_INT_MESSAGE(1, rig.wheels[0].lets, "torque is taken off once");
    TEST_ASSERT_EQUAL_INT(1, rig.wheels[1].lets);
    /* the cause goes away */
    rig.wheels[0].mute = rig.wheels[1].mute = false;
    bus(BERTH_CAN_ERROR_ACTIVE, false);
    rig_command(&rig, BERTH_COMMAND_RESET);
    expect_state(BERTH_SUPERVISOR_IDLE);
    rig_set_pose(&rig, 0.95f, 0.0f, 1.5f);
    run_for(100000);
    TEST_ASSERT_EQUAL_UINT8(BERTH_FAULT_NONE, rig.status.fault);
    start_running();
}

static void test_every_cause_stops_both_wheels_and_is_kept(void) {
    for (size_t i = 0; i < sizeof causes / sizeof causes[0]; i++) {
        check_cause(&causes[i]);
    }
}

static void test_reset_is_refused_while_the_bus_is_down_or_a_wheel_turns(void) {
    start_running();
    cause_bus_down();
    rig_command(&rig, BERTH_COMMAND_RESET);
    expect_state(BERTH_SUPERVISOR_FAULT);
    bus(BERTH_CAN_ERROR_ACTIVE, false);
    rig.wheels[0].rps = 1.0; /* runs out */
    rig_feedback(&rig);
    rig_command(&rig, BERTH_COMMAND_RESET);
    expect_state(BERTH_SUPERVISOR_FAULT);
    rig.wheels[0].rps = 0.0;
    rig_feedback(&rig);
    rig_command(&rig, BERTH_COMMAND_RESET);
    expect_state(BERTH_SUPERVISOR_IDLE);
}

static void test_an_emergency_stop_is_harder_than_the_fault_in_force(void) {
    start_running();
    cause_bus_failure();
    TEST_ASSERT_EQUAL_INT(0, rig.wheels[0].emergencies);
    rig_command(&rig, BERTH_COMMAND_EMERGENCY_STOP);
    TEST_ASSERT_EQUAL_INT(1, rig.wheels[0].emergencies);
    TEST_ASSERT_EQUAL_INT(1, rig.wheels[1].emergencies);
    TEST_ASSERT_EQUAL_UINT8(BERTH_FAULT_BUS_DOWN, berth_board_status(&rig.board)->fault);
}

static void test_frames_that_waited_do_not_follow_the_stop(void) {
    start_running();
    rig.blocked = true;
    run_for(RIG_PERIOD_US);
    TEST_ASSERT_TRUE(rig.board.outbox.count > 0);
    rig_command(&rig, BERTH_COMMAND_EMERGENCY_STOP);
    const long moving = rig.moving;
    rig.blocked = false;
    rig_send_all(&rig);
    TEST_ASSERT_EQUAL_INT64(moving, rig.moving);
}

static void test_arming_needs_the_plan_that_was_checked(void) {
    rig.shape.samples[100].x_m += 0.001f;
    rig_command(&rig, BERTH_COMMAND_ARM);
    expect_state(BERTH_SUPERVISOR_FAULT);
    TEST_ASSERT_EQUAL_UINT8(BERTH_FAULT_PLAN, berth_board_status(&rig.board)->fault);
    rig.shape.samples[100].x_m = rig.shape.plan.samples[100].x_m;
}

static void test_arming_needs_a_pose_and_a_fresh_fix(void) {
    rig_prepare(&rig);
    rig.config.supervisor.fix_timeout_us = 300000;
    TEST_ASSERT_EQUAL_INT(BERTH_OK, rig_init(&rig, &refusal));
    rig_command(&rig, BERTH_COMMAND_ARM);
    run_for(500000);
    expect_state(BERTH_SUPERVISOR_ARMING);
    const berth_pose_t pose = {0.95f, 0.0f, 1.5f};
    berth_can_frame_t frame;
    berth_message_encode_pose(&frame, BERTH_MESSAGE_POSE_FIX, 5, &pose);
    rig_hear(&rig, &frame);
    run_for(60000);
    expect_state(BERTH_SUPERVISOR_ARMED);
    rig_command(&rig, BERTH_COMMAND_START);
    run_for(200000);
    expect_state(BERTH_SUPERVISOR_RUNNING);
    run_for(100000);
    TEST_ASSERT_EQUAL_UINT8(BERTH_FAULT_POSE_AGE, berth_board_status(&rig.board)->fault);
}

static void test_a_wheel_that_turns_the_wrong_way_is_noticed(void) {
    rig_prepare(&rig);
    rig.config.supervisor.following_radps = 3.0f;
    rig.config.supervisor.following_us = 200000;
    begin();
    start_running();
    rig.wheels[1].backwards = true;
    run_for(300000);
    TEST_ASSERT_EQUAL_UINT8(BERTH_FAULT_FOLLOWING, berth_board_status(&rig.board)->fault);
}

static void test_arming_needs_both_drives(void) {
    for (int side = 0; side < 2; side++) {
        rig_prepare(&rig);
        begin();
        rig.wheels[side].mute = true;
        rig_command(&rig, BERTH_COMMAND_ARM);
        run_for(300000);
        expect_state(BERTH_SUPERVISOR_ARMING);
        TEST_ASSERT_EQUAL_INT(BERTH_DRIVE_ENABLED, berth_board_drive(&rig.board, 1 - side)->state);
        TEST_ASSERT_EQUAL_INT(BERTH_DRIVE_STARTING, berth_board_drive(&rig.board, side)->state);
        rig.wheels[side].mute = false;
        run_for(100000);
        expect_state(BERTH_SUPERVISOR_ARMED);
    }
}

/* --- what comes in and what goes out ---------------------------------------------------------- */

static void test_commands_come_as_frames_too(void) {
    run_for(20000);
    hear_command(BERTH_COMMAND_ARM);
    run_for(200000);
    hear_command(BERTH_COMMAND_START);
    run_for(200000);
    expect_state(BERTH_SUPERVISOR_RUNNING);
    hear_command(BERTH_COMMAND_START);
    TEST_ASSERT_EQUAL_UINT32(1, berth_board_status(&rig.board)->commands_refused);
    hear_command(BERTH_COMMAND_STOP);
    run_for(200000);
    expect_state(BERTH_SUPERVISOR_IDLE);
}

static void test_malformed_and_foreign_frames_are_counted_and_change_nothing(void) {
    start_running();
    const berth_board_status_t before = *berth_board_status(&rig.board);
    berth_can_frame_t frame;
    berth_message_encode_command(&frame, 5, BERTH_COMMAND_STOP);
    frame.data[1] ^= 1;
    rig_hear(&rig, &frame); /* its check byte is wrong */
    berth_message_encode_command(&frame, 5, BERTH_COMMAND_STOP);
    frame.length = 1;
    rig_hear(&rig, &frame);
    frame = drive_frame(0x201, false, 7);
    rig_hear(&rig, &frame);
    frame = drive_frame(0x201, false, 8);
    put_u32_le(frame.data, 0x7fc00000u); /* NaN */
    rig_hear(&rig, &frame);
    TEST_ASSERT_EQUAL_UINT32(before.malformed + 4, berth_board_status(&rig.board)->malformed);
    berth_message_encode_command(&frame, 6, BERTH_COMMAND_STOP); /* another robot's */
    rig_hear(&rig, &frame);
    frame = drive_frame(0x7ff, false, 8);
    rig_hear(&rig, &frame);
    TEST_ASSERT_EQUAL_UINT32(before.foreign + 2, berth_board_status(&rig.board)->foreign);
    expect_state(BERTH_SUPERVISOR_RUNNING);
}

static void test_a_fix_moves_the_pose_by_its_share(void) {
    run_for(100000);
    const berth_pose_t pose = {0.95f + 0.1f, 0.0f, 1.5f};
    berth_can_frame_t frame;
    berth_message_encode_pose(&frame, BERTH_MESSAGE_POSE_FIX, 5, &pose);
    rig_hear(&rig, &frame);
    run_for(RIG_PERIOD_US);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-4f, 0.95f + 0.02f, berth_board_status(&rig.board)->pose.x_m);
}

/* A frame's own time counts within the last second, else the time at which it was fetched. */
static void test_a_frame_from_the_future_or_long_ago_counts_as_now(void) {
    static const struct {
        int64_t time_us, taken_us;
    } cases[] = {{1999000, 1999000}, {2000000, 2000000}, {2000001, 2000000},
                 {1000001, 1000001}, {1000000, 2000000}, {INT64_MIN, 2000000}};
    const berth_pose_t pose = {0.95f, 0.0f, 1.5f};
    berth_can_frame_t frame;
    berth_message_encode_pose(&frame, BERTH_MESSAGE_POSE_FIX, 5, &pose);
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        frame.time_us = cases[i].time_us;
        berth_board_receive(&rig.board, &frame, 2000000);
        TEST_ASSERT_EQUAL_INT64(cases[i].taken_us, rig.board.odometry.fix_us);
    }
}

static void test_an_obstacle_without_time_to_live_is_taken_back(void) {
    hear_obstacle(7, 5.0f, 5.0f, 1000);
    hear_obstacle(8, 6.0f, 5.0f, 1000);
    TEST_ASSERT_EQUAL_UINT32(2, rig.board.controller.obstacles.count);
    hear_obstacle(7, 5.0f, 5.0f, 0);
    TEST_ASSERT_EQUAL_UINT32(1, rig.board.controller.obstacles.count);
    TEST_ASSERT_EQUAL_FLOAT(6.0f, rig.board.controller.obstacles.slots[0].obstacle.x_m);
    TEST_ASSERT_EQUAL_UINT32(3, berth_board_status(&rig.board)->received);
}

/* While the robot does not move, an obstacle too many is counted but stops nothing. */
static void test_a_crowd_at_a_stand_is_counted(void) {
    arm();
    cause_crowd();
    TEST_ASSERT_EQUAL_UINT32(1, berth_board_status(&rig.board)->obstacles_refused);
    expect_state(BERTH_SUPERVISOR_ARMED);
}

static void test_drives_of_two_protocols_are_synchronised_each(void) {
    rig_command(&rig, BERTH_COMMAND_EMERGENCY_STOP);
    TEST_ASSERT_EQUAL_INT(1, rig.syncs);
    const berth_drive_protocol_t other = rig_protocol;
    rig_prepare(&rig);
    rig.config.drives[1].protocol = &other;
    begin();
    rig_command(&rig, BERTH_COMMAND_EMERGENCY_STOP);
    TEST_ASSERT_EQUAL_INT(2, rig.syncs);
}

static void test_telemetry_comes_each_so_many_periods(void) {
    rig_prepare(&rig);
    rig.config.telemetry_periods = 4;
    begin();
    run_for(8 * RIG_PERIOD_US - 1);
    TEST_ASSERT_EQUAL_INT(2, rig.statuses);
    TEST_ASSERT_EQUAL_INT(2, rig.poses);
    run_for(1);
    TEST_ASSERT_EQUAL_INT(3, rig.statuses);
    rig_command(&rig, BERTH_COMMAND_EMERGENCY_STOP); /* told at once */
    TEST_ASSERT_EQUAL_INT(4, rig.statuses);
}

static void test_telemetry_tells_what_is(void) {
    start_running();
    TEST_ASSERT_EQUAL_UINT8(BERTH_SUPERVISOR_RUNNING, rig.status.state);
    TEST_ASSERT_EQUAL_UINT32(rig.board.controller.reference.total, rig.status.total);
    TEST_ASSERT_TRUE(rig.poses > 10 && rig.errors > 10 && rig.errors < rig.poses);
    rig_prepare(&rig);
    rig.config.telemetry_periods = 0;
    begin();
    start_running();
    rig_command(&rig, BERTH_COMMAND_EMERGENCY_STOP);
    TEST_ASSERT_EQUAL_INT(0, rig.statuses + rig.poses + rig.errors);
}

static void test_late_steps_are_counted_and_not_made_up_for(void) {
    start_running();
    const berth_board_status_t before = *berth_board_status(&rig.board);
    rig.now_us = rig.board.tick_us + RIG_PERIOD_US * 2 + 30000;
    rig_feedback(&rig);
    berth_board_step(&rig.board, rig.now_us);
    rig_send_all(&rig);
    const berth_board_status_t *after = berth_board_status(&rig.board);
    TEST_ASSERT_EQUAL_UINT32(before.steps + 1, after->steps);
    TEST_ASSERT_EQUAL_UINT32(before.missed + 2, after->missed);
    TEST_ASSERT_EQUAL_UINT32(before.late + 1, after->late);
    TEST_ASSERT_EQUAL_INT64(130000, after->latest_us);
    TEST_ASSERT_EQUAL_INT64(rig.now_us + 20000, rig.board.tick_us);
    expect_state(BERTH_SUPERVISOR_RUNNING);
}

static void test_the_count_of_missed_periods_does_not_wrap(void) {
    run_for(RIG_PERIOD_US);
    rig.board.status.missed = UINT32_MAX - 2;
    berth_board_step(&rig.board, rig.board.tick_us + 2 * RIG_PERIOD_US);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, berth_board_status(&rig.board)->missed);
    berth_board_step(&rig.board, rig.board.tick_us + 3 * RIG_PERIOD_US);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, berth_board_status(&rig.board)->missed);
}

/* From the smallest time to the largest: nothing overflows. */
static void test_a_step_may_come_as_late_as_can_be(void) {
    berth_board_step(&rig.board, 0);
    const berth_board_status_t before = *berth_board_status(&rig.board);
    berth_board_step(&rig.board, BERTH_TIME_MAX_US);
    const berth_board_status_t *after = berth_board_status(&rig.board);
    TEST_ASSERT_EQUAL_UINT32(before.late + 1, after->late);
    TEST_ASSERT_EQUAL_INT64(BERTH_TIME_MAX_US - RIG_PERIOD_US, after->latest_us);
    TEST_ASSERT_TRUE(rig.board.tick_us > BERTH_TIME_MAX_US);
    TEST_ASSERT_TRUE(rig.board.tick_us <= BERTH_TIME_MAX_US + RIG_PERIOD_US);
    TEST_ASSERT_EQUAL_INT64(0, rig.board.tick_us % RIG_PERIOD_US);
}

static void test_a_frame_from_before_the_first_instant_counts_as_now(void) {
    const berth_pose_t pose = {0.95f, 0.0f, 1.5f};
    berth_can_frame_t frame;
    berth_message_encode_pose(&frame, BERTH_MESSAGE_POSE_FIX, 5, &pose);
    frame.time_us = -1;
    berth_board_receive(&rig.board, &frame, 500000);
    TEST_ASSERT_EQUAL_INT64(500000, rig.board.odometry.fix_us);
}

static void command_stop_at(int64_t time_us) {
    berth_board_command(&rig.board, BERTH_COMMAND_STOP, time_us);
}

static void command_emergency_at(int64_t time_us) {
    berth_board_command(&rig.board, BERTH_COMMAND_EMERGENCY_STOP, time_us);
}

static void receive_at(int64_t time_us) {
    const berth_can_frame_t frame = {.id = 0x7f0, .time_us = time_us};
    berth_board_receive(&rig.board, &frame, time_us);
}

static void bus_at(int64_t time_us) {
    berth_board_bus(&rig.board, BERTH_CAN_ERROR_ACTIVE, false, time_us);
}

/* Two frames wait: the time of the second counts from when the first has left. */
static void sent_at(int64_t time_us) {
    const berth_can_frame_t frame = {.id = 0x7f1};
    (void)berth_outbox_put(&rig.board.outbox, &frame, BERTH_OUTBOX_EACH);
    (void)berth_outbox_put(&rig.board.outbox, &frame, BERTH_OUTBOX_EACH);
    berth_board_sent(&rig.board, time_us);
}

/* In whatever call a time is told that cannot be, it stops the robot. */
static void test_a_time_that_cannot_be_stops_the_robot(void) {
    static void (*const calls[])(int64_t time_us) = {command_stop_at, command_emergency_at,
                                                     receive_at, bus_at, sent_at};
    static const int64_t times[] = {-1, INT64_MIN, BERTH_TIME_MAX_US + 1, INT64_MAX};
    for (size_t i = 0; i < sizeof calls / sizeof calls[0]; i++) {
        for (size_t j = 0; j < sizeof times / sizeof times[0]; j++) {
            setUp();
            start_running();
            const int stops = rig.wheels[0].stops;
            calls[i](times[j]);
            rig_send_all(&rig);
            expect_state(BERTH_SUPERVISOR_FAULT);
            TEST_ASSERT_EQUAL_UINT8(BERTH_FAULT_PERIOD, berth_board_status(&rig.board)->fault);
            TEST_ASSERT_EQUAL_INT(stops + 1, rig.wheels[0].stops);
            TEST_ASSERT_EQUAL_INT(calls[i] == command_emergency_at, rig.wheels[1].emergencies);
        }
    }
}

/* --- properties ------------------------------------------------------------------------------- */

static void random_event(void) {
    berth_can_frame_t frame = {.time_us = rig.now_us};
    switch (support_index(8)) {
    case 0:
        hear_command((berth_command_code_t)(1 + support_index(5)));
        break;
    case 1:
        rig_command(&rig, (berth_command_code_t)support_index(7));
        break;
    case 2:
        bus((berth_can_mode_t)support_index(4), support_index(8) == 0);
        break;
    case 3:
        rig.wheels[support_index(2)].mute = support_index(3) == 0;
        break;
    case 4:
        rig.blocked = support_index(3) == 0;
        break;
    case 5:
        hear_obstacle((uint8_t)support_index(20), (float)support_uniform(-2, 2),
                      (float)support_uniform(-2, 2), (uint16_t)support_index(3000));
        break;
    default: /* any bits under ids that are ours or near them */
        frame.id = support_index(2) == 0 ? 0x1fcu + support_index(32)
                                         : 0x04b20000u + (support_index(4) << 8) + 5u;
        frame.extended = frame.id > 0x7ffu;
        frame.length = (uint8_t)support_index(9);
        frame.remote = support_index(8) == 0;
        for (int i = 0; i < 8; i++) {
            frame.data[i] = (uint8_t)support_index(256);
        }
        rig_hear(&rig, &frame);
        break;
    }
}

/* Whatever happens: a command other than zero goes out in RUNNING and STOPPING alone, none is
 * beyond the limits or not a number, and counters add up. */
static void test_nothing_but_running_moves_a_wheel(void) {
    support_random_start();
    uint32_t runs = 0;
    for (uint32_t i = 0; i < support_runs(60000); i++) {
        if (i % 200 == 0) {
            rig_prepare(&rig);
            begin();
            start_running();
        }
        const berth_supervisor_state_t before = state();
        const long moving = rig.moving;
        if (support_index(6) == 0) {
            random_event();
        } else {
            run_for((int64_t)support_index(20000));
        }
        const bool may_move =
            before == BERTH_SUPERVISOR_RUNNING || before == BERTH_SUPERVISOR_STOPPING ||
            state() == BERTH_SUPERVISOR_RUNNING || state() == BERTH_SUPERVISOR_STOPPING;
        TEST_ASSERT_TRUE(may_move || rig.moving == moving);
        runs += state() == BERTH_SUPERVISOR_RUNNING;
        for (int side = 0; side < 2; side++) {
            const double most = (0.8 + 3.0 * 0.15) / 0.05 / (2.0 * 3.14159);
            TEST_ASSERT_TRUE(fabs(rig.wheels[side].rps) <= most * 1.0001);
        }
        TEST_ASSERT_TRUE(berth_board_deadline(&rig.board) <= rig.board.tick_us);
        TEST_ASSERT_EQUAL_INT(state() == BERTH_SUPERVISOR_FAULT,
                              berth_board_status(&rig.board)->fault != BERTH_FAULT_NONE);
    }
    TEST_ASSERT_GREATER_THAN_UINT32(support_runs(1000), runs);
}

/* --- bad configuration ------------------------------------------------------------------------ */

static void expect_refused(berth_error_t error, berth_field_t field, uint32_t index) {
    TEST_ASSERT_EQUAL_INT(error, rig_init(&rig, &refusal));
    TEST_ASSERT_EQUAL_INT(field, refusal.field);
    TEST_ASSERT_EQUAL_UINT32(index, refusal.index);
    /* unusable: nothing is put, nothing is taken */
    rig_command(&rig, BERTH_COMMAND_ARM);
    berth_board_step(&rig.board, 1000000);
    berth_board_bus(&rig.board, BERTH_CAN_BUS_OFF, true, 1000000);
    hear_command(BERTH_COMMAND_EMERGENCY_STOP);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, berth_board_status(&rig.board)->bus);
    TEST_ASSERT_EQUAL_UINT32(0, berth_board_status(&rig.board)->received);
    const berth_pose_t pose = {0.0f, 0.0f, 0.0f};
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_STATE, berth_board_set_pose(&rig.board, &pose, 0));
    const berth_obstacle_t obstacle = {5.0f, 5.0f, 0.1f, 0.3f, 0.5f};
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_STATE,
                          berth_board_add_obstacle(&rig.board, &obstacle, &refusal));
    TEST_ASSERT_NULL(berth_board_front(&rig.board));
    TEST_ASSERT_EQUAL_INT64(BERTH_TIME_MAX_US, berth_board_deadline(&rig.board));
    rig_prepare(&rig);
}

static void test_bad_configurations_are_refused_whole(void) {
    rig_prepare(&rig);
    rig.config.drives[1].node = 1;
    expect_refused(BERTH_ERROR_CONFIG, BERTH_FIELD_DRIVE_NODE, 1);
    rig.config.drives[1].node = 16;
    expect_refused(BERTH_ERROR_CONFIG, BERTH_FIELD_DRIVE_NODE, 1);
    rig.config.drives[0].gear_ratio = NAN;
    expect_refused(BERTH_ERROR_CONFIG, BERTH_FIELD_GEAR_RATIO, 0);
    rig.config.drives[1].sign = 0;
    expect_refused(BERTH_ERROR_CONFIG, BERTH_FIELD_DRIVE_SIGN, 1);
    rig.config.regions.conservative_m = 0.03f; /* v_max T is 0.04 m */
    expect_refused(BERTH_ERROR_CONFIG, BERTH_FIELD_REGION_CONSERVATIVE, 0);
    rig.config.regions.regulated_m = 0.01f; /* less than the skirt */
    expect_refused(BERTH_ERROR_CONFIG, BERTH_FIELD_REGION_REGULATED, 0);
    rig.config.regions.body_m = -0.1f;
    expect_refused(BERTH_ERROR_CONFIG, BERTH_FIELD_REGION_BODY, 0);
    rig.config.odometry.fix_gain = 0.0f;
    expect_refused(BERTH_ERROR_CONFIG, BERTH_FIELD_FIX_GAIN, 0);
    rig.config.supervisor.stop_timeout_us = 0;
    expect_refused(BERTH_ERROR_CONFIG, BERTH_FIELD_STOP_TIMEOUT, 0);
    rig.config.controller.limits.track_m = INFINITY;
    expect_refused(BERTH_ERROR_CONFIG, BERTH_FIELD_TRACK, 0);
    rig.config.drives[0].protocol = NULL;
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_ARGUMENT, rig_init(&rig, &refusal));
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_TIME,
                          berth_board_init(&rig.board, &rig.shape.plan, &rig.config, -1, &refusal));
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_TIME,
                          berth_board_init(&rig.board, &rig.shape.plan, &rig.config,
                                           BERTH_TIME_MAX_US + 1, &refusal));
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_ARGUMENT,
                          berth_board_init(NULL, &rig.shape.plan, &rig.config, 0, &refusal));
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_ARGUMENT,
                          berth_board_init(&rig.board, NULL, &rig.config, 0, &refusal));
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_ARGUMENT,
                          berth_board_init(&rig.board, &rig.shape.plan, NULL, 0, &refusal));
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_ARGUMENT,
                          berth_board_init(&rig.board, &rig.shape.plan, &rig.config, 0, NULL));
}

static void test_filters_are_the_ids_in_use(void) {
    berth_can_filter_t filters[BERTH_BOARD_FILTERS_MAX];
    TEST_ASSERT_EQUAL_UINT32(7, berth_board_filters(&rig.board, filters));
    TEST_ASSERT_EQUAL_HEX32(0x04b20005, filters[0].id);
    TEST_ASSERT_TRUE(filters[0].extended);
    TEST_ASSERT_EQUAL_HEX32(0x202, filters[5].id);
}

static void test_a_pose_is_not_set_under_way(void) {
    start_running();
    const berth_pose_t pose = {0.0f, 0.0f, 0.0f};
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_STATE, berth_board_set_pose(&rig.board, &pose, rig.now_us));
    rig_command(&rig, BERTH_COMMAND_STOP);
    expect_state(BERTH_SUPERVISOR_STOPPING);
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_STATE, berth_board_set_pose(&rig.board, &pose, rig.now_us));
    run_for(200000);
    expect_state(BERTH_SUPERVISOR_IDLE);
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_board_set_pose(&rig.board, &pose, rig.now_us));
}

static void test_size(void) {
    printf("a board: %u bytes, of these the controller %u, the outbox %u\n",
           (unsigned)sizeof(berth_board_t), (unsigned)sizeof(berth_controller_t),
           (unsigned)sizeof(berth_outbox_t));
    TEST_ASSERT_LESS_THAN_UINT(4096, (unsigned)sizeof(berth_board_t));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_from_idle_to_running_and_back);
    RUN_TEST(test_a_configured_braking_slows_the_stop);
    RUN_TEST(test_a_stop_takes_its_time_to_act);
    RUN_TEST(test_standing_wheels_do_not_end_a_stop_before_it_acts);
    RUN_TEST(test_every_cause_stops_both_wheels_and_is_kept);
    RUN_TEST(test_reset_is_refused_while_the_bus_is_down_or_a_wheel_turns);
    RUN_TEST(test_an_emergency_stop_is_harder_than_the_fault_in_force);
    RUN_TEST(test_frames_that_waited_do_not_follow_the_stop);
    RUN_TEST(test_arming_needs_the_plan_that_was_checked);
    RUN_TEST(test_arming_needs_a_pose_and_a_fresh_fix);
    RUN_TEST(test_a_wheel_that_turns_the_wrong_way_is_noticed);
    RUN_TEST(test_arming_needs_both_drives);
    RUN_TEST(test_commands_come_as_frames_too);
    RUN_TEST(test_malformed_and_foreign_frames_are_counted_and_change_nothing);
    RUN_TEST(test_a_fix_moves_the_pose_by_its_share);
    RUN_TEST(test_a_frame_from_the_future_or_long_ago_counts_as_now);
    RUN_TEST(test_an_obstacle_without_time_to_live_is_taken_back);
    RUN_TEST(test_a_crowd_at_a_stand_is_counted);
    RUN_TEST(test_drives_of_two_protocols_are_synchronised_each);
    RUN_TEST(test_telemetry_comes_each_so_many_periods);
    RUN_TEST(test_telemetry_tells_what_is);
    RUN_TEST(test_late_steps_are_counted_and_not_made_up_for);
    RUN_TEST(test_the_count_of_missed_periods_does_not_wrap);
    RUN_TEST(test_a_step_may_come_as_late_as_can_be);
    RUN_TEST(test_a_frame_from_before_the_first_instant_counts_as_now);
    RUN_TEST(test_a_time_that_cannot_be_stops_the_robot);
    RUN_TEST(test_nothing_but_running_moves_a_wheel);
    RUN_TEST(test_bad_configurations_are_refused_whole);
    RUN_TEST(test_filters_are_the_ids_in_use);
    RUN_TEST(test_a_pose_is_not_set_under_way);
    RUN_TEST(test_size);
    return UNITY_END();
}
