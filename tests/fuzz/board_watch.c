#include "board_watch.h"

#include "drive_says.h"
#include "fuzz.h"
#include "input.h"

#define TWO_PI 6.2831853f

static uint32_t le(const uint8_t *data, uint32_t count) {
    uint32_t value = 0;
    for (uint32_t i = 0; i < count; i++) {
        value |= (uint32_t)data[i] << (8 * i);
    }
    return value;
}

static bool moves(berth_supervisor_state_t state) {
    return state == BERTH_SUPERVISOR_RUNNING || state == BERTH_SUPERVISOR_STOPPING;
}

static bool under_torque(berth_supervisor_state_t state) {
    return state == BERTH_SUPERVISOR_ARMED || moves(state);
}

void watch_begin(watch_t *watch, const berth_board_t *board, const berth_board_config_t *config,
                 int64_t now_us) {
    const berth_limits_config_t *limits = &config->controller.limits;
    float most = (limits->v_max_mps + 0.5f * limits->track_m * limits->omega_max_radps) /
                 limits->wheel_radius_m;
    if (limits->wheel_speed_max_radps > 0.0f && limits->wheel_speed_max_radps < most) {
        most = limits->wheel_speed_max_radps;
    }
    *watch = (watch_t){.board = board,
                       .config = *config,
                       .begin_us = now_us,
                       .wheel_max_radps = most,
                       .digest = DIGEST_START};
    watch_call(watch);
}

void watch_given(watch_t *watch, const berth_can_frame_t *frame) {
    watch->given++;
    watch->reset =
        watch->reset ||
        (frame->extended && frame->id == (BERTH_MESSAGE_COMMAND << 8 | watch->config.address) &&
         frame->length == 2 && frame->data[0] == BERTH_COMMAND_RESET);
}

void watch_command(watch_t *watch, berth_command_code_t command) {
    watch->reset = watch->reset || command == BERTH_COMMAND_RESET;
}

static void check_fault(watch_t *watch, const berth_board_status_t *status) {
    const bool fault = status->state == BERTH_SUPERVISOR_FAULT;
    FUZZ_CHECK(fault == (status->fault != BERTH_FAULT_NONE), "a fault has its reason");
    if (watch->latched && fault && !watch->reset) {
        FUZZ_CHECK(status->fault == watch->fault, "the first reason is kept");
    }
    if (watch->latched && !fault) {
        FUZZ_CHECK(watch->reset && status->state == BERTH_SUPERVISOR_IDLE,
                   "only a reset leads out of a fault");
    }
    watch->latched = fault;
    watch->fault = status->fault;
}

static void check_numbers(const watch_t *watch, const berth_board_status_t *status) {
    const berth_limits_config_t *limits = &watch->config.controller.limits;
    const berth_status_t *control = berth_board_control(watch->board);
    const float values[] = {
        status->pose.x_m,
        status->pose.y_m,
        status->pose.theta_rad,
        status->command.twist.v_mps,
        status->command.twist.omega_radps,
        status->command.wheels.left_radps,
        status->command.wheels.right_radps,
        berth_board_drive(watch->board, BERTH_LEFT)->velocity_radps,
        berth_board_drive(watch->board, BERTH_RIGHT)->velocity_radps,
        watch->board->drives[0].command_radps,
        watch->board->drives[1].command_radps,
        watch->board->odometry.pose.x_m,
        watch->board->odometry.pose.y_m,
        watch->board->odometry.pose.theta_rad,
        control->clearance_m,
        control->tracking_error.e1_m,
        control->tracking_error.e2_m,
        control->tracking_error.e3_rad,
    };
    FUZZ_CHECK(finite_all(values, sizeof values / sizeof values[0]), "all numbers are finite");
    const berth_command_t *command = &status->command;
    const float most = watch->wheel_max_radps * 1.0001f;
    FUZZ_CHECK(fabsf(command->twist.v_mps) <= limits->v_max_mps * 1.00001f &&
                   fabsf(command->twist.omega_radps) <= limits->omega_max_radps * 1.00001f &&
                   fabsf(command->wheels.left_radps) <= most &&
                   fabsf(command->wheels.right_radps) <= most,
               "commands are within the limits");
    if (!moves(status->state)) {
        FUZZ_CHECK(command->wheels.left_radps == 0.0f && command->wheels.right_radps == 0.0f,
                   "nothing but RUNNING and STOPPING commands a speed");
    }
}

static void check_counters(const watch_t *watch, const berth_board_status_t *status) {
    const berth_board_t *board = watch->board;
    const uint32_t sum = status->received + status->malformed + status->foreign;
    FUZZ_CHECK(sum == watch->given, "received, malformed and foreign add up to the frames given");
    const berth_drive_status_t *left = &board->drives[0].status;
    const berth_drive_status_t *right = &board->drives[1].status;
    FUZZ_CHECK(status->received >= left->received + right->received &&
                   status->malformed >= left->malformed + right->malformed,
               "the drives' frames are among the board's");
    FUZZ_CHECK(status->late <= status->steps, "late steps are steps");
    if (status->missed < UINT32_MAX) {
        const int64_t periods = (int64_t)status->steps + status->missed;
        FUZZ_CHECK(board->tick_us - watch->begin_us == periods * (int64_t)board->period_us,
                   "steps and missed ones add up to the time");
    }
    const berth_board_status_t *last = &watch->last;
    FUZZ_CHECK(status->received >= last->received && status->malformed >= last->malformed &&
                   status->foreign >= last->foreign && status->steps >= last->steps &&
                   status->late >= last->late && status->missed >= last->missed &&
                   status->latest_us >= last->latest_us &&
                   status->commands_refused >= last->commands_refused &&
                   status->obstacles_refused >= last->obstacles_refused,
               "counters only grow");
}

static void check_drives(const watch_t *watch, const berth_board_status_t *status) {
    const berth_board_t *board = watch->board;
    for (int side = 0; side < 2; side++) {
        const berth_drive_t *drive = &board->drives[side];
        if (under_torque(status->state)) {
            FUZZ_CHECK(drive->status.state == BERTH_DRIVE_ENABLED, "both drives are enabled");
        }
        if (status->state == BERTH_SUPERVISOR_FAULT) {
            FUZZ_CHECK(drive->status.state != BERTH_DRIVE_ENABLED &&
                           drive->status.state != BERTH_DRIVE_STARTING,
                       "no drive is enabled in a fault");
        }
        if (!moves(status->state)) {
            FUZZ_CHECK(drive->command_radps == 0.0f, "a drive's command is zero but in motion");
        }
        FUZZ_CHECK((drive->status.state == BERTH_DRIVE_FAULT) ==
                       (drive->status.fault != BERTH_DRIVE_FAULT_NONE),
                   "a drive's fault has its reason");
    }
    if (under_torque(status->state)) {
        FUZZ_CHECK(!board->bus_failed && status->bus != BERTH_CAN_BUS_OFF &&
                       status->bus != BERTH_CAN_DOWN,
                   "the bus is good");
    }
}

void watch_call(watch_t *watch) {
    const berth_board_status_t *status = berth_board_status(watch->board);
    FUZZ_CHECK(status->state == watch->board->supervisor.state &&
                   status->state <= BERTH_SUPERVISOR_FAULT,
               "the status tells the state");
    check_fault(watch, status);
    check_numbers(watch, status);
    check_counters(watch, status);
    check_drives(watch, status);
    watch->last = *status;
    watch->reset = false;
}

/* Nothing of what a watchdog is there for goes unseen by a step. */
static void check_watchdogs(const watch_t *watch, int64_t now_us) {
    const berth_board_t *board = watch->board;
    const berth_supervisor_config_t *config = &watch->config.supervisor;
    for (int side = 0; side < 2; side++) {
        const berth_drive_t *drive = &board->drives[side];
        const int64_t feedback_us = now_us - drive->status.feedback_us;
        const int64_t heartbeat_us = now_us - drive->status.heartbeat_us;
        FUZZ_CHECK(drive->status.feedback_us >= 0 &&
                       feedback_us <= (int64_t)drive->config.feedback_timeout_us &&
                       drive->status.heartbeat_us >= 0 &&
                       heartbeat_us <= (int64_t)drive->config.heartbeat_timeout_us,
                   "drives under torque are heard of in time");
    }
    FUZZ_CHECK(board->waiting_us < 0 ||
                   now_us - board->waiting_us <= (int64_t)config->transmit_timeout_us,
               "frames leave in time");
    FUZZ_CHECK(board->supervisor.state != BERTH_SUPERVISOR_STOPPING ||
                   now_us - board->supervisor.since_us <=
                       (int64_t)config->stop_timeout_us + (int64_t)board->period_us,
               "a stop takes no longer than it may");
}

void watch_step(watch_t *watch, int64_t now_us) {
    const berth_board_t *board = watch->board;
    if (now_us < board->last_us || now_us > BERTH_TIME_MAX_US) {
        return; /* a step at no good time does nothing but stop */
    }
    FUZZ_CHECK(board->tick_us - now_us <= (int64_t)board->period_us,
               "the next control step is at most a period ahead");
    if (under_torque(board->supervisor.state)) {
        check_watchdogs(watch, now_us);
    }
    if (board->supervisor.state == BERTH_SUPERVISOR_RUNNING && board->tick_us > now_us &&
        watch->last.state == BERTH_SUPERVISOR_RUNNING) {
        FUZZ_CHECK(watch->last.steps == 0 || watch->last.pose_known || board->starting,
                   "a robot that runs knows its pose");
    }
}

/* --- frames ----------------------------------------------------------------------------------- */

static bool in_fault(const watch_t *watch) {
    return watch->board->supervisor.state == BERTH_SUPERVISOR_FAULT;
}

/* A wheel's speed as a frame tells it, checked. */
static void check_speed(const watch_t *watch, const berth_drive_t *drive, double motor_rps,
                        double quantum_rps) {
    const double gear = (double)drive->config.gear_ratio;
    const double most = gear * (double)watch->wheel_max_radps / (double)TWO_PI * 1.0002;
    FUZZ_CHECK(isfinite(motor_rps), "a commanded speed is finite");
    FUZZ_CHECK(fabs(motor_rps) <= most + quantum_rps, "a commanded speed is within the limits");
    if (motor_rps != 0.0) {
        FUZZ_CHECK(!in_fault(watch), "no speed is commanded after a fault");
        FUZZ_CHECK(moves(watch->board->supervisor.state),
                   "no speed is commanded but in RUNNING and STOPPING");
    }
}

static bool drive_frame_known(const watch_t *watch, const berth_can_frame_t *frame) {
    for (int side = 0; side < 2; side++) {
        const berth_drive_t *drive = &watch->board->drives[side];
        said_t said;
        if (drive_says(drive, frame, &said)) {
            FUZZ_CHECK(!said.enables || !in_fault(watch), "no torque is asked for after a fault");
            if (said.speed) {
                check_speed(watch, drive, said.motor_rps, said.quantum_rps);
            }
            return true;
        }
    }
    return false;
}

static bool own_frame(const watch_t *watch, const berth_can_frame_t *frame) {
    const uint8_t address = watch->config.address;
    berth_message_status_t status;
    berth_message_error_t error;
    if (berth_message_is(frame, BERTH_MESSAGE_STATUS, address)) {
        FUZZ_CHECK(berth_message_decode_status(frame, &status), "the status is well formed");
        FUZZ_CHECK(!in_fault(watch) || status.state == BERTH_SUPERVISOR_FAULT,
                   "no older status follows a fault");
        return true;
    }
    if (berth_message_is(frame, BERTH_MESSAGE_ERROR, address)) {
        FUZZ_CHECK(berth_message_decode_error(frame, &error), "the tracking error is finite");
        return true;
    }
    if (berth_message_is(frame, BERTH_MESSAGE_POSE, address)) {
        /* -8388608, -8388608, -32768: what is not finite */
        FUZZ_CHECK(le(frame->data, 3) != 0x800000u && le(frame->data + 3, 3) != 0x800000u &&
                       le(frame->data + 6, 2) != 0x8000u,
                   "the pose is finite");
        return true;
    }
    return false;
}

void watch_sent(watch_t *watch, const berth_can_frame_t *frame, int64_t now_us) {
    const uint32_t id_max = frame->extended ? BERTH_CAN_EXTENDED_MAX : BERTH_CAN_STANDARD_MAX;
    FUZZ_CHECK(frame->id <= id_max && frame->length <= BERTH_CAN_DATA_MAX && !frame->remote,
               "a frame that a bus can carry");
    FUZZ_CHECK(own_frame(watch, frame) || drive_frame_known(watch, frame),
               "every frame is one that a board sends");
    digest_bytes(&watch->digest, &frame->id, sizeof frame->id);
    digest_bytes(&watch->digest, frame->data, frame->length);
    digest_bytes(&watch->digest, &now_us, sizeof now_us);
}
