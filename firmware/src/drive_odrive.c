#include "berth/drive_odrive.h"

#include "berth/reference.h"
#include "check.h"
#include "drive_protocol.h"

/* MISRA D9 in this file. */

#define NODE_MAX 62.0f /* 63 addresses drives without a number */
#define PREPARE_US 10000
#define RETRY_US 250000

enum {
    HEARTBEAT = 0x01,
    EMERGENCY_STOP = 0x02,
    AXIS_STATE = 0x07,
    ENCODER_ESTIMATES = 0x09,
    CONTROLLER_MODE = 0x0B,
    INPUT_VELOCITY = 0x0D,
    CLEAR_ERRORS = 0x18
};

enum { STATE_IDLE = 1, STATE_CLOSED_LOOP = 8 };
enum { CONTROL_VELOCITY = 2, INPUT_PASSTHROUGH = 1 };

enum {
    STEP_PREPARE = 1, /* errors, mode and speed, so that nothing old is in force in closed loop */
    STEP_ASK,         /* mode and speed once more, in case a frame was lost; then closed loop */
    STEP_WAIT,        /* for closed loop, then all over again */
    STEP_DONE         /* ENABLED as soon as there is feedback */
};

static berth_error_t check(const berth_drive_config_t *config, berth_refusal_t *refusal) {
    return drive_check_node(config, 0.0f, NODE_MAX, refusal);
}

static uint32_t id_of(const berth_drive_t *drive, uint32_t command) {
    return ((uint32_t)drive->config.node << 5) | command;
}

static bool put_empty(const berth_drive_t *drive, uint32_t command, berth_outbox_t *outbox) {
    const berth_can_frame_t frame = drive_frame(id_of(drive, command), false, 0);
    return berth_outbox_put(outbox, &frame, BERTH_OUTBOX_EACH);
}

static bool put_axis_state(const berth_drive_t *drive, uint32_t state, berth_outbox_t *outbox) {
    berth_can_frame_t frame = drive_frame(id_of(drive, AXIS_STATE), false, 4);
    put_u32_le(frame.data, state);
    return berth_outbox_put(outbox, &frame, BERTH_OUTBOX_EACH);
}

static bool put_mode(const berth_drive_t *drive, berth_outbox_t *outbox) {
    berth_can_frame_t frame = drive_frame(id_of(drive, CONTROLLER_MODE), false, 8);
    put_u32_le(frame.data, CONTROL_VELOCITY);
    put_u32_le(&frame.data[4], INPUT_PASSTHROUGH);
    return berth_outbox_put(outbox, &frame, BERTH_OUTBOX_EACH);
}

static bool put_velocity(const berth_drive_t *drive, float motor_rps, berth_outbox_t *outbox) {
    berth_can_frame_t frame = drive_frame(id_of(drive, INPUT_VELOCITY), false, 8);
    put_u32_le(frame.data, bits_from_float(motor_rps)); /* the torque stays 0 */
    return berth_outbox_put(outbox, &frame, BERTH_OUTBOX_LATEST);
}

static void enable(berth_drive_t *drive, int64_t now_us) {
    drive->state.odrive = (berth_drive_odrive_state_t){
        .step = STEP_PREPARE,
        .asked_us = INT64_MAX,
        .retry_us = now_us,
    };
}

static void disable(berth_drive_t *drive, berth_outbox_t *outbox) {
    (void)put_axis_state(drive, STATE_IDLE, outbox); /* a full outbox counts what it drops */
}

static void stop(berth_drive_t *drive, berth_outbox_t *outbox) {
    (void)put_velocity(drive, 0.0f, outbox);
}

static void emergency_stop(berth_drive_t *drive, berth_outbox_t *outbox) {
    drive->state.odrive.stopped_hard = true;
    (void)put_velocity(drive, 0.0f, outbox);
    (void)put_empty(drive, EMERGENCY_STOP, outbox);
}

static void cycle(berth_drive_t *drive, int64_t now_us, berth_outbox_t *outbox) {
    (void)now_us;
    const float motor_rps = drive_clamp(drive, drive_motor_rps(drive), BERTH_ODRIVE_SPEED_MAX_RPS);
    (void)put_velocity(drive, motor_rps, outbox);
}

/* --- receiving ---------------------------------------------------------------------------------
 */

static void starting(berth_drive_t *drive, int64_t at_us) {
    berth_drive_odrive_state_t *state = &drive->state.odrive;
    const bool good = state->error == 0u && state->axis_state == STATE_CLOSED_LOOP;
    if (good && at_us >= state->asked_us) {
        state->step = STEP_DONE;
        drive_enabled(drive);
    } else if (!good && state->step == STEP_DONE) {
        state->step = STEP_WAIT; /* it fell out again */
        state->retry_us = at_us + RETRY_US;
    } else {
        /* still on its way */
    }
}

static drive_frame_t heartbeat(berth_drive_t *drive, const berth_can_frame_t *frame,
                               int64_t at_us) {
    if (frame->remote || frame->length < 5u || frame->length > BERTH_CAN_DATA_MAX) {
        return DRIVE_FRAME_MALFORMED;
    }
    berth_drive_odrive_state_t *state = &drive->state.odrive;
    state->error = get_u32_le(frame->data);
    state->axis_state = frame->data[4];
    drive_alive(drive, at_us);
    if (drive->status.state == BERTH_DRIVE_STARTING) {
        starting(drive, at_us);
    } else if (!state->stopped_hard && state->error != 0u) {
        drive_fail(drive, BERTH_DRIVE_FAULT_DEVICE, state->error);
    } else if (!state->stopped_hard && state->axis_state != STATE_CLOSED_LOOP) {
        drive_fail(drive, BERTH_DRIVE_FAULT_DISABLED, state->axis_state);
    } else {
        /* as it should be */
    }
    return DRIVE_FRAME_GOOD;
}

/* False when it jumped. */
static bool position(berth_drive_t *drive, float turns, int64_t at_us) {
    berth_drive_odrive_state_t *state = &drive->state.odrive;
    if (!check_range(turns, -BERTH_ODRIVE_TURNS_MAX, BERTH_ODRIVE_TURNS_MAX)) {
        drive_position_lost(drive);
        return true;
    }
    const float turned = turns - state->turns;
    const float quantum = (turns < 0.0f ? -turns : turns) * 0x1p-23f; /* at least float32's step */
    state->turns = turns;
    return drive_position(drive, turned, quantum, at_us);
}

static drive_frame_t encoder_estimates(berth_drive_t *drive, const berth_can_frame_t *frame,
                                       int64_t at_us) {
    if (!drive_frame_has(frame, 8)) {
        return DRIVE_FRAME_MALFORMED;
    }
    const float turns = float_from_bits(get_u32_le(frame->data));
    const float rps = float_from_bits(get_u32_le(&frame->data[4]));
    if (!check_range(turns, -CHECK_FLOAT_MAX, CHECK_FLOAT_MAX) ||
        !check_range(rps, -BERTH_ODRIVE_SPEED_MAX_RPS, BERTH_ODRIVE_SPEED_MAX_RPS)) {
        return DRIVE_FRAME_MALFORMED;
    }
    drive_velocity(drive, rps, at_us);
    const bool good = position(drive, turns, at_us);
    if (drive->state.odrive.step == STEP_DONE) {
        drive_enabled(drive);
    }
    return good ? DRIVE_FRAME_GOOD : DRIVE_FRAME_MALFORMED;
}

static drive_frame_t receive(berth_drive_t *drive, const berth_can_frame_t *frame, int64_t at_us) {
    if (frame->extended) {
        return DRIVE_FRAME_FOREIGN;
    }
    if (frame->id == id_of(drive, HEARTBEAT)) {
        return heartbeat(drive, frame, at_us);
    }
    if (frame->id == id_of(drive, ENCODER_ESTIMATES)) {
        return encoder_estimates(drive, frame, at_us);
    }
    return DRIVE_FRAME_FOREIGN;
}

/* --- timers --------------------------------------------------------------------------------------
 */

static void prepare(berth_drive_t *drive, int64_t now_us, berth_outbox_t *outbox) {
    const bool put = put_empty(drive, CLEAR_ERRORS, outbox) && put_mode(drive, outbox) &&
                     put_velocity(drive, 0.0f, outbox);
    drive->state.odrive.step = put ? STEP_ASK : STEP_PREPARE;
    drive->state.odrive.retry_us = now_us + PREPARE_US;
}

static void ask(berth_drive_t *drive, int64_t now_us, berth_outbox_t *outbox) {
    berth_drive_odrive_state_t *state = &drive->state.odrive;
    const bool put = put_mode(drive, outbox) && put_velocity(drive, 0.0f, outbox) &&
                     put_axis_state(drive, STATE_CLOSED_LOOP, outbox);
    if (put && state->asked_us == INT64_MAX) {
        state->asked_us = now_us;
    }
    state->step = put ? STEP_WAIT : STEP_ASK;
    state->retry_us = now_us + (put ? RETRY_US : PREPARE_US);
}

static void step(berth_drive_t *drive, int64_t now_us, berth_outbox_t *outbox) {
    const berth_drive_odrive_state_t *state = &drive->state.odrive;
    if (drive->status.state != BERTH_DRIVE_STARTING) {
        return;
    }
    if (now_us > drive->enabling_us + drive->config.enable_timeout_us) {
        if (state->error != 0u) {
            drive_fail(drive, BERTH_DRIVE_FAULT_DEVICE, state->error);
        }
        return; /* no torque is asked for any more: drive.c says that enabling took too long */
    }
    if (state->step == STEP_DONE || now_us < state->retry_us) {
        return;
    }
    if (state->step == STEP_ASK) {
        ask(drive, now_us, outbox);
    } else {
        prepare(drive, now_us, outbox);
    }
}

static int64_t deadline(const berth_drive_t *drive) {
    const bool busy =
        drive->status.state == BERTH_DRIVE_STARTING && drive->state.odrive.step != STEP_DONE;
    return busy ? drive->state.odrive.retry_us : BERTH_TIME_MAX_US;
}

static uint32_t filters(const berth_drive_t *drive, berth_can_filter_t *filters) {
    filters[0] = (berth_can_filter_t){id_of(drive, HEARTBEAT), BERTH_CAN_STANDARD_MAX, false};
    filters[1] =
        (berth_can_filter_t){id_of(drive, ENCODER_ESTIMATES), BERTH_CAN_STANDARD_MAX, false};
    return 2;
}

static uint32_t progress(const berth_drive_t *drive) {
    if (drive->status.heartbeat_us < 0) {
        return BERTH_ODRIVE_NO_HEARTBEAT;
    }
    return drive->state.odrive.step == STEP_DONE ? BERTH_ODRIVE_NO_FEEDBACK
                                                 : BERTH_ODRIVE_NOT_IN_CLOSED_LOOP;
}

const berth_drive_protocol_t berth_drive_odrive = {
    .check = check,
    .enable = enable,
    .disable = disable,
    .stop = stop,
    .emergency_stop = emergency_stop,
    .cycle = cycle,
    .receive = receive,
    .step = step,
    .deadline = deadline,
    .filters = filters,
    .progress = progress,
};
