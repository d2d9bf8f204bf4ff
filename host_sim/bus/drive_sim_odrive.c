/* ODrive's CANSimple, as firmware 0.6 speaks it: 11-bit id = node << 5 | command, numbers little
 * endian.
 *
 * Payloads that are longer than the command needs are taken, since masters built from the older
 * message lists pad to 8 bytes. The input velocity outlives the closed loop, so a master that
 * enters it without a fresh command sets the wheel moving at the old speed.
 */
#include "drive_sim_inner.h"

#include <math.h>
#include <string.h>

enum {
    HEARTBEAT = 0x01,
    ESTOP = 0x02,
    GET_ERROR = 0x03,
    SET_AXIS_STATE = 0x07,
    ENCODER_ESTIMATES = 0x09,
    SET_CONTROLLER_MODE = 0x0b,
    SET_INPUT_VELOCITY = 0x0d,
    CLEAR_ERRORS = 0x18
};

enum { STATE_IDLE = 1, STATE_CLOSED_LOOP = 8 };
enum { RESULT_SUCCESS = 0, RESULT_BUSY = 1, RESULT_DISARMED = 3 };
enum { CONTROL_VELOCITY = 2, CONTROL_POSITION = 3 };
enum { INPUT_PASSTHROUGH = 1, INPUT_VELOCITY_RAMP = 2, INPUT_MODE_MAX = 8 };

#define ERROR_WATCHDOG UINT32_C(0x01000000)
#define ERROR_ESTOP UINT32_C(0x02000000)

static void power_on(drive_sim_t *sim) {
    drive_sim_odrive_state_t *axis = &sim->state.odrive;
    *axis = (drive_sim_odrive_state_t){.axis_state = STATE_IDLE,
                                       .control_mode = CONTROL_POSITION,
                                       .input_mode = INPUT_PASSTHROUGH};
    drive_sim_timer_start(&axis->heartbeat, sim->config.heartbeat_us, sim->now_us);
    drive_sim_timer_start(&axis->feedback, sim->config.feedback_us, sim->now_us);
}

static void put_float(uint8_t *data, double value) {
    const float rounded = (float)value;
    uint32_t bits;
    memcpy(&bits, &rounded, sizeof bits);
    drive_sim_put_le(data, bits, 4);
}

static float get_float(const uint8_t *data) {
    const uint32_t bits = drive_sim_get_le(data, 4);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static berth_can_frame_t message(const drive_sim_t *sim, uint32_t command) {
    return (berth_can_frame_t){.id = (uint32_t)sim->config.node << 5 | command, .length = 8};
}

static void send_heartbeat(drive_sim_t *sim) {
    const drive_sim_odrive_state_t *axis = &sim->state.odrive;
    if (sim->trouble.mute_heartbeat) {
        return;
    }
    berth_can_frame_t frame = message(sim, HEARTBEAT);
    drive_sim_put_le(&frame.data[0], axis->errors, 4);
    frame.data[4] = axis->axis_state;
    frame.data[5] = axis->procedure_result;
    /* Trajectory done, then one reserved byte: both zero here. */
    drive_sim_put(sim, &frame);
}

static void send_estimates(drive_sim_t *sim) {
    if (sim->trouble.mute_feedback) {
        return;
    }
    berth_can_frame_t frame = message(sim, ENCODER_ESTIMATES);
    put_float(&frame.data[0], sim->motor_turns);
    put_float(&frame.data[4], sim->motor_rps);
    drive_sim_put(sim, &frame);
}

static void send_errors(drive_sim_t *sim) {
    berth_can_frame_t frame = message(sim, GET_ERROR);
    drive_sim_put_le(&frame.data[0], sim->state.odrive.errors, 4);
    drive_sim_put_le(&frame.data[4], sim->state.odrive.disarm_reason, 4);
    drive_sim_put(sim, &frame);
}

static void disarm(drive_sim_t *sim, uint32_t errors) {
    drive_sim_odrive_state_t *axis = &sim->state.odrive;
    axis->errors |= errors;
    if (axis->axis_state == STATE_CLOSED_LOOP) {
        axis->axis_state = STATE_IDLE;
        axis->procedure_result = RESULT_DISARMED;
        axis->disarm_reason = errors;
    }
}

static bool request_state(drive_sim_t *sim, uint32_t wanted) {
    drive_sim_odrive_state_t *axis = &sim->state.odrive;
    if (wanted == STATE_IDLE) {
        axis->axis_state = STATE_IDLE;
        axis->procedure_result = RESULT_SUCCESS;
        return true;
    }
    if (wanted != STATE_CLOSED_LOOP) {
        return false; /* calibrations and the like: not on a bus with a robot on it */
    }
    if (axis->errors != 0) {
        axis->procedure_result = RESULT_DISARMED;
    } else if (axis->axis_state != STATE_CLOSED_LOOP) {
        axis->axis_state = STATE_CLOSED_LOOP;
        axis->procedure_result = RESULT_BUSY;
        axis->fed_us = sim->now_us;
    }
    return true;
}

static bool set_mode(drive_sim_t *sim, uint32_t control, uint32_t input) {
    if (control > CONTROL_POSITION || input > INPUT_MODE_MAX) {
        return false;
    }
    sim->state.odrive.control_mode = control;
    sim->state.odrive.input_mode = input;
    return true;
}

static bool obeys_velocity(const drive_sim_odrive_state_t *axis) {
    return axis->axis_state == STATE_CLOSED_LOOP && axis->control_mode == CONTROL_VELOCITY &&
           (axis->input_mode == INPUT_PASSTHROUGH || axis->input_mode == INPUT_VELOCITY_RAMP);
}

static bool set_velocity(drive_sim_t *sim, const uint8_t *data) {
    drive_sim_odrive_state_t *axis = &sim->state.odrive;
    const float velocity_rps = get_float(&data[0]);
    if (!isfinite(velocity_rps) || !isfinite(get_float(&data[4]))) {
        return false;
    }
    axis->input_velocity_rps = velocity_rps;
    axis->fed_us = sim->now_us;
    if (obeys_velocity(axis)) {
        sim->counters.commands++;
    }
    return true;
}

static bool answer(drive_sim_t *sim, uint32_t command) {
    switch (command) {
    case HEARTBEAT:
        send_heartbeat(sim);
        return true;
    case GET_ERROR:
        send_errors(sim);
        return true;
    case ENCODER_ESTIMATES:
        send_estimates(sim);
        return true;
    default:
        return false;
    }
}

static bool obey(drive_sim_t *sim, uint32_t command, const berth_can_frame_t *frame) {
    switch (command) {
    case ESTOP:
        disarm(sim, ERROR_ESTOP);
        return true;
    case CLEAR_ERRORS:
        sim->state.odrive.errors = 0;
        return true;
    case SET_AXIS_STATE:
        return frame->length >= 4 && request_state(sim, drive_sim_get_le(frame->data, 4));
    case SET_CONTROLLER_MODE:
        return frame->length >= 8 && set_mode(sim, drive_sim_get_le(&frame->data[0], 4),
                                              drive_sim_get_le(&frame->data[4], 4));
    case SET_INPUT_VELOCITY:
        return frame->length >= 8 && set_velocity(sim, frame->data);
    case HEARTBEAT:
    case ENCODER_ESTIMATES:
        return false; /* somebody else under this node's number */
    default:
        return true; /* the protocol has more commands than are of use here */
    }
}

static bool receive(drive_sim_t *sim, const berth_can_frame_t *frame) {
    if (frame->extended || frame->id >> 5 != sim->config.node) {
        return false;
    }
    const uint32_t command = frame->id & 0x1fu;
    if (!(frame->remote ? answer(sim, command) : obey(sim, command, frame))) {
        sim->counters.malformed++;
    }
    return true;
}

static bool watched(const drive_sim_t *sim) {
    return sim->config.watchdog_us > 0 && sim->state.odrive.axis_state == STATE_CLOSED_LOOP;
}

static void expire(drive_sim_t *sim) {
    if (watched(sim) && sim->now_us - sim->state.odrive.fed_us >= sim->config.watchdog_us) {
        sim->counters.watchdog_stops++;
        disarm(sim, ERROR_WATCHDOG);
    }
}

static void step(drive_sim_t *sim) {
    drive_sim_odrive_state_t *axis = &sim->state.odrive;
    if (drive_sim_timer_take(&axis->heartbeat, sim->now_us)) {
        send_heartbeat(sim);
    }
    if (drive_sim_timer_take(&axis->feedback, sim->now_us)) {
        send_estimates(sim);
    }
}

static int64_t deadline(const drive_sim_t *sim) {
    const drive_sim_odrive_state_t *axis = &sim->state.odrive;
    const int64_t watchdog_us = watched(sim) ? axis->fed_us + sim->config.watchdog_us : INT64_MAX;
    return drive_sim_timer_deadline(&axis->heartbeat,
                                    drive_sim_timer_deadline(&axis->feedback, watchdog_us));
}

static bool enabled(const drive_sim_t *sim) {
    return sim->state.odrive.axis_state == STATE_CLOSED_LOOP;
}

static double target_rps(const drive_sim_t *sim) {
    const drive_sim_odrive_state_t *axis = &sim->state.odrive;
    return obeys_velocity(axis) ? (double)axis->input_velocity_rps : 0.0;
}

const drive_sim_protocol_t drive_sim_odrive = {power_on, expire,  receive,    step,
                                               deadline, enabled, target_rps, disarm};
