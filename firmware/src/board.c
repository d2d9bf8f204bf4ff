#include "berth/board.h"

#include "board_parts.h"
#include "check.h"
#include "count.h"
#include "small.h"

#include <math.h>

/* MISRA D9 in this file. */

/* A frame's own time counts when it is at most this old. */
#define FRAME_AGE_MAX_US 1000000

#define REGION_MAX_M BERTH_RADIUS_MAX_M

static uint32_t larger(uint32_t a, uint32_t b) {
    return a > b ? a : b;
}

berth_board_config_t berth_board_config_default(float wheel_radius_m, float track_m,
                                                uint32_t period_us) {
    const berth_drive_config_t drive = {
        .sign = 1,
        .gear_ratio = 1.0f,
        .pole_pairs = 7,
        .mode = 3,
        .master_node = 127,
        .has_position = true,
        .counts_per_turn = 4096,
        .velocity_units_per_rps = 4096.0f,
        .period_us = period_us,
        .feedback_timeout_us = larger(3u * period_us, 100000u),
        .heartbeat_timeout_us = larger(3u * period_us, 500000u),
        .enable_timeout_us = 5000000,
    };
    return (berth_board_config_t){
        .controller = berth_config_default(wheel_radius_m, track_m),
        .drives = {drive, drive},
        .odometry = {.wheel_radius_m = wheel_radius_m,
                     .track_m = track_m,
                     .fix_gain = 0.2f,
                     .fix_jump_m = 0.5f,
                     .fix_jump_rad = 0.5f},
        .supervisor = {.fix_timeout_us = 0,
                       .period_late_us = 3u * period_us,
                       .transmit_timeout_us = larger(2u * period_us, 20000u),
                       .arm_timeout_us = 10000000,
                       .stop_timeout_us = 2000000,
                       .standing_radps = 0.2f,
                       .following_radps = 0.0f,
                       .following_us = 500000},
        .regions = {.body_m = 0.25f, .conservative_m = 0.1f, .regulated_m = 0.3f},
        .telemetry_periods = 1,
    };
}

/* --- setting up ------------------------------------------------------------------------------- */

static berth_error_t check_regions(const berth_board_t *board, const berth_board_regions_t *regions,
                                   berth_refusal_t *refusal) {
    const berth_avoid_t *avoid = &board->controller.avoid;
    const bool good =
        check_value(BERTH_FIELD_REGION_BODY, regions->body_m, 0.0f, REGION_MAX_M, refusal) &&
        check_value(BERTH_FIELD_REGION_CONSERVATIVE, regions->conservative_m,
                    avoid->clearance_min_m, REGION_MAX_M, refusal) &&
        check_value(BERTH_FIELD_REGION_REGULATED, regions->regulated_m, avoid->config.skirt_m,
                    REGION_MAX_M, refusal);
    return good ? BERTH_OK : BERTH_ERROR_CONFIG;
}

static berth_error_t init_drives(berth_board_t *board, const berth_board_config_t *config,
                                 berth_refusal_t *refusal) {
    for (uint32_t side = 0; side < 2u; side++) {
        berth_drive_config_t drive = config->drives[side];
        drive.period_us = board->period_us;
        const berth_error_t error = berth_drive_init(&board->drives[side], &drive, refusal);
        if (error != BERTH_OK) {
            refusal->index = side;
            return error;
        }
    }
    const berth_drive_config_t *left = &config->drives[BERTH_LEFT];
    const berth_drive_config_t *right = &config->drives[BERTH_RIGHT];
    if (left->protocol == right->protocol && left->node == right->node) {
        /* both wheels would obey the same commands */
        *refusal = (berth_refusal_t){.field = BERTH_FIELD_DRIVE_NODE,
                                     .index = BERTH_RIGHT,
                                     .value = (float)right->node,
                                     .minimum = 0.0f,
                                     .maximum = (float)UINT8_MAX};
        return BERTH_ERROR_CONFIG;
    }
    return BERTH_OK;
}

static berth_error_t init_parts(berth_board_t *board, const berth_board_config_t *config,
                                berth_refusal_t *refusal) {
    berth_error_t error = check_regions(board, &config->regions, refusal);
    if (error == BERTH_OK) {
        error = init_drives(board, config, refusal);
    }
    if (error == BERTH_OK) {
        berth_odometry_config_t odometry = config->odometry;
        odometry.wheel_radius_m = config->controller.limits.wheel_radius_m;
        odometry.track_m = config->controller.limits.track_m;
        error = berth_odometry_init(&board->odometry, &odometry, refusal);
    }
    if (error == BERTH_OK) {
        error = berth_supervisor_init(&board->supervisor, &config->supervisor, refusal);
    }
    return error;
}

berth_error_t berth_board_init(berth_board_t *board, const berth_plan_t *plan,
                               const berth_board_config_t *config, int64_t now_us,
                               berth_refusal_t *refusal) {
    if (board == NULL) {
        return BERTH_ERROR_ARGUMENT;
    }
    *board = (berth_board_t){.waiting_us = -1}; /* without a plan it is unusable */
    if (plan == NULL || config == NULL || refusal == NULL) {
        return BERTH_ERROR_ARGUMENT;
    }
    if (now_us < 0 || now_us > BERTH_TIME_MAX_US) {
        return BERTH_ERROR_TIME;
    }
    berth_error_t error =
        berth_controller_init(&board->controller, plan, &config->controller, refusal);
    if (error == BERTH_OK) {
        board->period_us = plan->period_us;
        error = init_parts(board, config, refusal);
    }
    if (error != BERTH_OK) {
        return error;
    }
    board->regions = config->regions;
    board->address = config->address;
    board->telemetry_periods = config->telemetry_periods;
    board->telemetry_left = 0;
    board->plan_crc = berth_plan_crc(plan);
    board->tick_us = now_us;
    board->last_us = now_us;
    berth_outbox_reset(&board->outbox);
    board->ready = true;
    return BERTH_OK;
}

berth_error_t berth_board_add_obstacle(berth_board_t *board, const berth_obstacle_t *obstacle,
                                       berth_refusal_t *refusal) {
    return board->ready ? berth_controller_add_obstacle(&board->controller, obstacle, refusal)
                        : BERTH_ERROR_STATE;
}

static bool moving(const berth_board_t *board) {
    return board->supervisor.state == BERTH_SUPERVISOR_RUNNING ||
           board->supervisor.state == BERTH_SUPERVISOR_STOPPING;
}

berth_error_t berth_board_set_pose(berth_board_t *board, const berth_pose_t *pose, int64_t now_us) {
    if (!board->ready || moving(board)) {
        return BERTH_ERROR_STATE;
    }
    return berth_odometry_set(&board->odometry, pose, now_us);
}

/* --- what the state demands of the drives ----------------------------------------------------- */

static bool standing(const berth_board_t *board) {
    for (int side = 0; side < 2; side++) {
        const berth_drive_t *drive = &board->drives[side];
        const berth_drive_status_t *status = &drive->status;
        const bool off = status->state == BERTH_DRIVE_OFF || drive->released;
        const bool heard = status->feedback_us >= 0 && board->last_us - status->feedback_us <=
                                                           drive->config.feedback_timeout_us;
        if (!off &&
            (!heard || fabsf(status->velocity_radps) >= board->supervisor.config.standing_radps)) {
            return false;
        }
    }
    return true;
}

/* Where both drives speak the same protocol, one synchronisation serves both. */
static void synchronise(berth_board_t *board, int64_t now_us) {
    const berth_drive_t *left = &board->drives[BERTH_LEFT];
    const berth_drive_t *right = &board->drives[BERTH_RIGHT];
    berth_drive_sync(left, now_us, &board->outbox);
    if (left->config.protocol != right->config.protocol) {
        berth_drive_sync(right, now_us, &board->outbox);
    }
}

static void release(berth_board_t *board, int64_t now_us) {
    for (int side = 0; side < 2; side++) {
        berth_drive_disable(&board->drives[side], &board->outbox);
    }
    synchronise(board, now_us);
    board->released = true;
}

/* Nothing that waited may leave after the stop. */
static void stop_wheels(berth_board_t *board, int64_t now_us) {
    const bool hard = board->supervisor.fault == BERTH_FAULT_EMERGENCY_STOP;
    berth_outbox_clear(&board->outbox);
    for (int side = 0; side < 2; side++) {
        if (hard) {
            berth_drive_emergency_stop(&board->drives[side], &board->outbox);
        } else {
            berth_drive_stop(&board->drives[side], &board->outbox);
        }
    }
    synchronise(board, now_us);
    board->status.command = (berth_command_t){{0.0f, 0.0f}, {0.0f, 0.0f}};
}

static void enable_drives(berth_board_t *board, int64_t now_us) {
    const uint32_t crc = berth_plan_crc(board->controller.plan);
    if (crc != board->plan_crc) {
        berth_supervisor_fail(&board->supervisor, BERTH_FAULT_PLAN, now_us);
        return;
    }
    board->released = false;
    for (int side = 0; side < 2; side++) {
        berth_drive_enable(&board->drives[side], now_us);
    }
}

static void become_idle(berth_board_t *board, int64_t now_us) {
    board->status.command = (berth_command_t){{0.0f, 0.0f}, {0.0f, 0.0f}};
    if (!board->released) {
        release(board, now_us);
    }
    for (int side = 0; side < 2; side++) {
        berth_drive_reset(&board->drives[side]);
    }
}

/* Acts on a change of state, at once and once. The plan's check may turn arming into a fault, hence
 * the second look. */
static void act(berth_board_t *board, int64_t now_us) {
    for (int i = 0; i < 2 && board->supervisor.state != board->acted; i++) {
        board->acted = board->supervisor.state;
        board->telemetry_left = 0;
        switch (board->acted) {
        case BERTH_SUPERVISOR_ARMING:
            enable_drives(board, now_us);
            break;
        case BERTH_SUPERVISOR_RUNNING:
            board->starting = true;
            break;
        case BERTH_SUPERVISOR_FAULT:
            stop_wheels(board, now_us);
            if (board->telemetry_periods > 0u) {
                board_put_status(board);
            }
            break;
        case BERTH_SUPERVISOR_IDLE:
            become_idle(board, now_us);
            break;
        default: /* ARMED, STOPPING: the control step does what is needed */
            break;
        }
    }
    board->status.state = board->supervisor.state;
    board->status.fault = board->supervisor.fault;
    board->status.commands_refused = board->supervisor.refused;
    if (board->waiting_us < 0 && berth_outbox_front(&board->outbox) != NULL) {
        board->waiting_us = now_us;
    }
}

/* --- what comes in ---------------------------------------------------------------------------- */

static bool bus_good(const berth_board_t *board) {
    return !board->bus_failed && board->status.bus != BERTH_CAN_BUS_OFF &&
           board->status.bus != BERTH_CAN_DOWN;
}

/* False for a time that cannot be: a clock that cannot be trusted stops the robot, at the last good
 * time. */
static bool timely(berth_board_t *board, int64_t earliest_us, int64_t now_us) {
    if (now_us >= earliest_us && now_us <= BERTH_TIME_MAX_US) {
        return true;
    }
    berth_supervisor_fail(&board->supervisor, BERTH_FAULT_PERIOD, board->last_us);
    act(board, board->last_us);
    return false;
}

static void obey(berth_board_t *board, berth_command_code_t command, int64_t now_us) {
    const bool again = command == BERTH_COMMAND_EMERGENCY_STOP &&
                       board->supervisor.state == BERTH_SUPERVISOR_FAULT;
    berth_supervisor_command(&board->supervisor, command, standing(board) && bus_good(board),
                             now_us);
    if (again) { /* a harder stop than the one in force */
        for (int side = 0; side < 2; side++) {
            berth_drive_emergency_stop(&board->drives[side], &board->outbox);
        }
        synchronise(board, now_us);
    }
    act(board, now_us);
}

void berth_board_command(berth_board_t *board, berth_command_code_t command, int64_t now_us) {
    if (!board->ready) {
        return;
    }
    if (timely(board, 0, now_us)) {
        obey(board, command, now_us);
    } else if (command == BERTH_COMMAND_EMERGENCY_STOP) {
        obey(board, command, board->last_us);
    } else {
        /* the time that cannot be has stopped the board */
    }
}

/* Brings the odometry to a time, which a late frame may put a little before the last step. */
static void advance_odometry(berth_board_t *board, int64_t to_us) {
    const float left = berth_drive_travel(&board->drives[BERTH_LEFT], to_us);
    const float right = berth_drive_travel(&board->drives[BERTH_RIGHT], to_us);
    berth_odometry_advance(&board->odometry, left, right);
}

static bool take_fix(berth_board_t *board, const berth_can_frame_t *frame, int64_t at_us) {
    berth_pose_t pose;
    if (!berth_message_decode_pose(frame, &pose)) {
        return false;
    }
    advance_odometry(board, at_us);
    return berth_odometry_fix(&board->odometry, &pose, at_us) == BERTH_OK;
}

static bool take_obstacle(berth_board_t *board, const berth_can_frame_t *frame, int64_t at_us,
                          int64_t now_us) {
    berth_message_obstacle_t message;
    berth_refusal_t refusal;
    if (!berth_message_decode_obstacle(frame, &message)) {
        return false;
    }
    if (message.ttl_ms == 0u) {
        berth_controller_remove_obstacle(&board->controller, message.id);
        return true;
    }
    const berth_board_regions_t *regions = &board->regions;
    const float hard_m = maximum(message.radius_m + regions->body_m, BERTH_RADIUS_MIN_M);
    const float conservative_m = hard_m + regions->conservative_m;
    const berth_obstacle_t obstacle = {message.x_m, message.y_m, hard_m, conservative_m,
                                       conservative_m + regions->regulated_m};
    const int64_t expires_us = at_us + (int64_t)message.ttl_ms * 1000;
    const berth_error_t error = berth_controller_put_obstacle(&board->controller, message.id,
                                                              &obstacle, expires_us, &refusal);
    if (error != BERTH_OK) {
        /* something is there that cannot be avoided */
        count(&board->status.obstacles_refused);
        if (moving(board)) {
            berth_supervisor_fail(&board->supervisor, BERTH_FAULT_OBSTACLES, now_us);
        }
    }
    return true;
}

static bool take_command(berth_board_t *board, const berth_can_frame_t *frame, int64_t now_us) {
    berth_command_code_t command;
    if (!berth_message_decode_command(frame, &command)) {
        return false;
    }
    berth_board_command(board, command, now_us);
    return true;
}

/* One of Berth's own frames. False: it was none. */
static bool take_message(berth_board_t *board, const berth_can_frame_t *frame, int64_t at_us,
                         int64_t now_us) {
    bool good;
    if (!frame->extended) {
        return false;
    }
    if (berth_message_is(frame, BERTH_MESSAGE_COMMAND, board->address)) {
        good = take_command(board, frame, now_us);
    } else if (berth_message_is(frame, BERTH_MESSAGE_POSE_FIX, board->address)) {
        good = take_fix(board, frame, at_us);
    } else if (berth_message_is(frame, BERTH_MESSAGE_OBSTACLE, board->address)) {
        good = take_obstacle(board, frame, at_us, now_us);
    } else {
        return false;
    }
    count(good ? &board->status.received : &board->status.malformed);
    return true;
}

static uint8_t drive_problem(const berth_board_t *board) {
    const berth_drive_status_t *left = &board->drives[BERTH_LEFT].status;
    const berth_drive_status_t *right = &board->drives[BERTH_RIGHT].status;
    if (left->state == BERTH_DRIVE_FAULT) {
        return (uint8_t)(BERTH_FAULT_LEFT + (int)left->fault);
    }
    if (right->state == BERTH_DRIVE_FAULT) {
        return (uint8_t)(BERTH_FAULT_RIGHT + (int)right->fault);
    }
    return BERTH_FAULT_NONE;
}

/* A faulty drive stops the other one in the same call. In IDLE both are off, and have no fault. */
static void watch_drives(berth_board_t *board, int64_t now_us) {
    const uint8_t problem = drive_problem(board);
    if (problem != BERTH_FAULT_NONE) {
        berth_supervisor_fail(&board->supervisor, problem, now_us);
    }
}

/* True when it was one of the drives'; their own counters tell good from bad. */
static bool take_feedback(berth_board_t *board, const berth_can_frame_t *frame, int64_t at_us) {
    for (int side = 0; side < 2; side++) {
        berth_drive_t *drive = &board->drives[side];
        const uint32_t malformed = drive->status.malformed;
        if (berth_drive_receive(drive, frame, at_us)) {
            count(drive->status.malformed == malformed ? &board->status.received
                                                       : &board->status.malformed);
            return true;
        }
    }
    return false;
}

void berth_board_receive(berth_board_t *board, const berth_can_frame_t *frame, int64_t now_us) {
    if (!board->ready || !timely(board, 0, now_us)) {
        return;
    }
    const bool timed = frame->time_us >= 0 && frame->time_us <= now_us &&
                       frame->time_us > now_us - FRAME_AGE_MAX_US;
    const int64_t at_us = timed ? frame->time_us : now_us;
    if (take_feedback(board, frame, at_us)) {
        watch_drives(board, now_us);
    } else if (!take_message(board, frame, at_us, now_us)) {
        count(&board->status.foreign);
        return;
    } else {
        /* a message, and it was taken */
    }
    act(board, now_us);
}

static uint8_t bus_problem(const berth_board_t *board) {
    if (bus_good(board)) {
        return BERTH_FAULT_NONE;
    }
    return board->status.bus == BERTH_CAN_BUS_OFF ? BERTH_FAULT_BUS_OFF : BERTH_FAULT_BUS_DOWN;
}

void berth_board_bus(berth_board_t *board, berth_can_mode_t mode, bool failed, int64_t now_us) {
    if (!board->ready || !timely(board, 0, now_us)) {
        return;
    }
    board->status.bus = mode;
    board->bus_failed = failed;
    const uint8_t problem = bus_problem(board);
    if (problem != BERTH_FAULT_NONE && board->supervisor.state != BERTH_SUPERVISOR_IDLE) {
        berth_supervisor_fail(&board->supervisor, problem, now_us);
        act(board, now_us);
    }
}

/* --- the control step ------------------------------------------------------------------------- */

static int64_t transmit_wait_us(const berth_board_t *board, int64_t now_us) {
    return board->waiting_us < 0 ? 0 : now_us - board->waiting_us;
}

static float following_error(const berth_board_t *board) {
    float most = 0.0f;
    for (int side = 0; side < 2; side++) {
        const berth_drive_t *drive = &board->drives[side];
        most = maximum(most, fabsf(drive->command_radps - drive->status.velocity_radps));
    }
    return most;
}

/* While stopping, a wheel that happens to turn through zero does not stand: zero must have been
 * commanded, and have had a period to act. */
static bool stop_in_force(const berth_board_t *board, int64_t now_us) {
    if (board->supervisor.state != BERTH_SUPERVISOR_STOPPING) {
        return true;
    }
    const berth_twist_t *twist = &board->status.command.twist;
    return twist->v_mps == 0.0f && twist->omega_radps == 0.0f &&
           now_us - board->supervisor.since_us > (int64_t)board->period_us;
}

static void supervise(berth_board_t *board, int64_t late_us, int64_t now_us) {
    const berth_drive_status_t *left = &board->drives[BERTH_LEFT].status;
    const berth_drive_status_t *right = &board->drives[BERTH_RIGHT].status;
    const uint8_t drive = drive_problem(board);
    const berth_supervisor_inputs_t inputs = {
        .drives_enabled = left->state == BERTH_DRIVE_ENABLED && right->state == BERTH_DRIVE_ENABLED,
        .standing = standing(board) && stop_in_force(board, now_us),
        .pose_known = board->odometry.known,
        .fix_age_us = berth_odometry_fix_age_us(&board->odometry, now_us),
        .late_us = late_us,
        .transmit_wait_us = transmit_wait_us(board, now_us),
        .following_radps = following_error(board),
        .problem = drive != BERTH_FAULT_NONE ? drive : bus_problem(board),
    };
    (void)berth_supervisor_step(&board->supervisor, &inputs, now_us);
    act(board, now_us);
}

/* The tracking and avoidance step; its own errors are faults. */
static void control(berth_board_t *board, int64_t now_us) {
    berth_error_t error = BERTH_OK;
    if (board->starting) {
        board->starting = false;
        error = berth_controller_start(&board->controller, now_us);
    }
    if (error == BERTH_OK) {
        error = berth_controller_step(&board->controller, now_us, &board->odometry.pose,
                                      &board->status.command);
    }
    if (error != BERTH_OK) {
        berth_supervisor_fail(&board->supervisor, BERTH_FAULT_CONTROLLER, now_us);
        act(board, now_us);
    }
}

/* To a stand, as quickly as the configured acceleration limits allow. */
static void slow_down(berth_board_t *board) {
    berth_controller_t *controller = &board->controller;
    berth_twist_t twist = {0.0f, 0.0f};
    (void)berth_limits_apply(&controller->limits, &controller->limits_config,
                             controller->avoid.period_s, true, &twist);
    board->status.command =
        (berth_command_t){twist, berth_wheels_from_twist(&controller->limits_config, twist)};
}

static void command_wheels(berth_board_t *board, int64_t now_us) {
    const berth_wheels_t *wheels = &board->status.command.wheels;
    berth_drive_command(&board->drives[BERTH_LEFT], wheels->left_radps);
    berth_drive_command(&board->drives[BERTH_RIGHT], wheels->right_radps);
    for (int side = 0; side < 2; side++) {
        berth_drive_cycle(&board->drives[side], now_us, &board->outbox);
    }
    synchronise(board, now_us);
}

/* A stop with torque, then without it: when the wheels stand, or have had their time to. */
static void release_when_stopped(berth_board_t *board, int64_t now_us) {
    const int64_t stopping_us = now_us - board->supervisor.since_us;
    if (board->released || stopping_us < (int64_t)board->period_us) {
        return;
    }
    if (standing(board) || stopping_us > board->supervisor.config.stop_timeout_us) {
        release(board, now_us);
    }
}

static void note_time(berth_board_t *board, int64_t late_us, int64_t now_us) {
    berth_board_status_t *status = &board->status;
    const int64_t period_us = board->period_us;
    const int64_t missed = late_us / period_us;
    board->tick_us = now_us - (late_us % period_us) + period_us;
    count(&status->steps);
    if (late_us > status->latest_us) {
        status->latest_us = late_us;
    }
    if (late_us > period_us / 2) {
        count(&status->late);
    }
    const uint32_t room = UINT32_MAX - status->missed;
    status->missed += missed < (int64_t)room ? (uint32_t)missed : room;
}

SMALL static void tick(berth_board_t *board, int64_t now_us) {
    const int64_t late_us = now_us - board->tick_us;
    note_time(board, late_us, now_us);
    advance_odometry(board, now_us);
    supervise(board, late_us, now_us);
    if (board->supervisor.state == BERTH_SUPERVISOR_RUNNING) {
        control(board, now_us);
    } else if (board->supervisor.state == BERTH_SUPERVISOR_STOPPING) {
        slow_down(board);
    } else {
        /* the command is zero */
    }
    if (board->supervisor.state != BERTH_SUPERVISOR_IDLE) {
        command_wheels(board, now_us);
    }
    if (board->supervisor.state == BERTH_SUPERVISOR_FAULT) {
        release_when_stopped(board, now_us);
    }
    board->status.pose = board->odometry.pose;
    board->status.pose_known = board->odometry.known;
    board_put_telemetry(board);
}

void berth_board_step(berth_board_t *board, int64_t now_us) {
    if (!board->ready || !timely(board, board->last_us, now_us)) {
        return;
    }
    board->last_us = now_us;
    if (board->supervisor.state != BERTH_SUPERVISOR_IDLE &&
        now_us - board->tick_us > board->supervisor.config.period_late_us) {
        /* before the drives' watchdogs, which would blame the drives for our own silence */
        berth_supervisor_fail(&board->supervisor, BERTH_FAULT_PERIOD, now_us);
    }
    for (int side = 0; side < 2; side++) {
        berth_drive_step(&board->drives[side], now_us, &board->outbox);
    }
    watch_drives(board, now_us);
    if (board->supervisor.state != BERTH_SUPERVISOR_IDLE &&
        transmit_wait_us(board, now_us) > board->supervisor.config.transmit_timeout_us) {
        berth_supervisor_fail(&board->supervisor, BERTH_FAULT_TRANSMIT, now_us);
    }
    act(board, now_us);
    if (now_us >= board->tick_us) {
        tick(board, now_us);
        act(board, now_us);
    }
}

/* --- what goes out ---------------------------------------------------------------------------- */

static int64_t earlier(int64_t a, int64_t b) {
    return a < b ? a : b;
}

int64_t berth_board_deadline(const berth_board_t *board) {
    if (!board->ready) {
        return BERTH_TIME_MAX_US;
    }
    int64_t deadline_us = board->tick_us;
    for (int side = 0; side < 2; side++) {
        deadline_us = earlier(deadline_us, berth_drive_deadline(&board->drives[side]));
    }
    if (board->waiting_us >= 0 && board->supervisor.state != BERTH_SUPERVISOR_IDLE &&
        board->supervisor.state != BERTH_SUPERVISOR_FAULT) {
        deadline_us = earlier(deadline_us,
                              board->waiting_us + board->supervisor.config.transmit_timeout_us + 1);
    }
    return deadline_us;
}

const berth_can_frame_t *berth_board_front(const berth_board_t *board) {
    return berth_outbox_front(&board->outbox);
}

void berth_board_sent(berth_board_t *board, int64_t now_us) {
    berth_outbox_pop(&board->outbox);
    board->waiting_us = -1;
    if (berth_outbox_front(&board->outbox) != NULL && timely(board, 0, now_us)) {
        board->waiting_us = now_us;
    }
}

const berth_board_status_t *berth_board_status(const berth_board_t *board) {
    return &board->status;
}

const berth_status_t *berth_board_control(const berth_board_t *board) {
    return berth_controller_status(&board->controller);
}

const berth_drive_status_t *berth_board_drive(const berth_board_t *board, int side) {
    return berth_drive_status(&board->drives[side == BERTH_RIGHT ? BERTH_RIGHT : BERTH_LEFT]);
}
