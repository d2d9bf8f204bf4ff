/* VESC's own CAN protocol: 29-bit id = command << 8 | node, numbers big endian. Node 255 addresses
 * all.
 *
 * A VESC has no armed state: any command sets the motor going, and it is released when none comes
 * for the time-out. Only the speed command is of use to a robot. Current and duty move the motor by
 * a simple model of an unloaded one, so that a master which sends them by mistake sees it.
 */
#include "drive_sim_inner.h"

#include <math.h>

enum {
    SET_DUTY = 0,
    SET_CURRENT = 1,
    SET_CURRENT_BRAKE = 2,
    SET_ERPM = 3,
    STATUS_1 = 9,
    STATUS_5 = 27
};

#define NODE_ALL 255u
#define ERPM_MAX 100000.0      /* the default limit of the speed */
#define NO_LOAD_ERPM 100000.0  /* at full duty */
#define ERPM_PER_AMPERE 1000.0 /* unloaded, where friction takes the current up */
#define FAULT_STOP_US INT64_C(500000)
#define SUPPLY_V 24.0
#define TACHOMETER_STEPS 6.0 /* per electrical turn */

static void power_on(drive_sim_t *sim) {
    sim->state.vesc = (drive_sim_vesc_state_t){.fault_until_us = INT64_MIN};
    drive_sim_timer_start(&sim->state.vesc.feedback, sim->config.feedback_us, sim->now_us);
}

static void run(drive_sim_t *sim, double erpm) {
    sim->state.vesc.running = true;
    sim->state.vesc.erpm = fmin(fmax(erpm, -ERPM_MAX), ERPM_MAX);
}

static void release(drive_sim_t *sim) {
    sim->state.vesc.running = false;
    sim->state.vesc.erpm = 0.0;
}

static void obey(drive_sim_t *sim, uint32_t command, int32_t value) {
    switch (command) {
    case SET_DUTY:
        run(sim, value * 1e-5 * NO_LOAD_ERPM);
        return;
    case SET_ERPM:
        run(sim, value);
        sim->counters.commands++;
        return;
    default:
        if (value == 0) {
            release(sim);
        } else {
            run(sim, command == SET_CURRENT ? value * 1e-3 * ERPM_PER_AMPERE : 0.0);
        }
        return;
    }
}

/* A current may carry the time for which the controller stays on at zero, in two bytes more. */
static bool well_formed(uint32_t command, const berth_can_frame_t *frame) {
    return !frame->remote && (frame->length == 4 || (command == SET_CURRENT && frame->length == 6));
}

static bool receive(drive_sim_t *sim, const berth_can_frame_t *frame) {
    const uint32_t node = frame->id & 0xffu;
    if (!frame->extended || (node != sim->config.node && node != NODE_ALL)) {
        return false;
    }
    const uint32_t command = frame->id >> 8;
    if (command > SET_ERPM) {
        /* Other commands of the protocol are no errors; a status under this node's number is. */
        if (command == STATUS_1 || command == STATUS_5) {
            sim->counters.malformed++;
        }
    } else if (!well_formed(command, frame)) {
        sim->counters.malformed++;
    } else {
        sim->state.vesc.fed_us = sim->now_us;
        if (sim->now_us >= sim->state.vesc.fault_until_us) {
            obey(sim, command, (int32_t)drive_sim_get_be(frame->data, 4));
        }
    }
    return true;
}

static double electrical_turns(const drive_sim_t *sim, double motor_turns) {
    return motor_turns * sim->config.pole_pairs;
}

static double limited(double value, double limit) {
    return fmin(fmax(trunc(value), -limit), limit);
}

static void send_status(drive_sim_t *sim) {
    if (sim->trouble.mute_feedback) {
        return;
    }
    const double erpm = electrical_turns(sim, sim->motor_rps) * 60.0;
    berth_can_frame_t frame = {.extended = true, .length = 8};
    frame.id = (uint32_t)STATUS_1 << 8 | sim->config.node;
    drive_sim_put_be(&frame.data[0], (uint32_t)(int32_t)limited(erpm, 2147483647.0), 4);
    /* The current, in 0.1 A, stays zero: the model has no load. */
    const double duty = sim->state.vesc.running ? erpm / NO_LOAD_ERPM : 0.0;
    const int16_t duty_permille = (int16_t)limited(duty * 1000.0, 1000.0);
    drive_sim_put_be(&frame.data[6], (uint16_t)duty_permille, 2);
    drive_sim_put(sim, &frame);

    frame = (berth_can_frame_t){.extended = true, .length = 8};
    frame.id = (uint32_t)STATUS_5 << 8 | sim->config.node;
    const int32_t tachometer =
        drive_sim_wrap(electrical_turns(sim, sim->motor_turns) * TACHOMETER_STEPS);
    drive_sim_put_be(&frame.data[0], (uint32_t)tachometer, 4);
    drive_sim_put_be(&frame.data[4], (uint32_t)(SUPPLY_V * 10.0), 2);
    drive_sim_put(sim, &frame);
}

static bool watched(const drive_sim_t *sim) {
    return sim->config.watchdog_us > 0 && sim->state.vesc.running;
}

static void expire(drive_sim_t *sim) {
    if (watched(sim) && sim->now_us - sim->state.vesc.fed_us >= sim->config.watchdog_us) {
        sim->counters.watchdog_stops++;
        release(sim);
    }
}

static void step(drive_sim_t *sim) {
    if (drive_sim_timer_take(&sim->state.vesc.feedback, sim->now_us)) {
        send_status(sim);
    }
}

static int64_t deadline(const drive_sim_t *sim) {
    const int64_t watchdog_us =
        watched(sim) ? sim->state.vesc.fed_us + sim->config.watchdog_us : INT64_MAX;
    return drive_sim_timer_deadline(&sim->state.vesc.feedback, watchdog_us);
}

static bool enabled(const drive_sim_t *sim) {
    return sim->state.vesc.running;
}

static double target_rps(const drive_sim_t *sim) {
    return sim->config.pole_pairs == 0 ? 0.0 : sim->state.vesc.erpm / 60.0 / sim->config.pole_pairs;
}

/* A fault's code travels in no message of this protocol that is simulated here. */
static void fail(drive_sim_t *sim, uint32_t code) {
    (void)code;
    release(sim);
    sim->state.vesc.fault_until_us = sim->now_us + FAULT_STOP_US;
}

const drive_sim_protocol_t drive_sim_vesc = {power_on, expire,  receive,    step,
                                             deadline, enabled, target_rps, fail};
