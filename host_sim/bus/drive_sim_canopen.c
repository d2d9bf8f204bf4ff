/* The simulated CiA 402 drive as a node of a CANopen network: NMT, heartbeats, emergency messages,
 * and who gets which frame.
 */
#include "drive_sim_inner.h"

#define BOOT_US INT64_C(10000)        /* power-on and reset node */
#define BOOT_NETWORK_US INT64_C(1000) /* reset communication */
#define EMERGENCY_HEARTBEAT UINT16_C(0x8130)
#define EMERGENCY_COMMUNICATION UINT16_C(0x8100)

enum { NMT = 0x000, SYNC = 0x080, EMERGENCY = 0x080, SDO = 0x600, HEARTBEAT = 0x700 };
enum {
    COMMAND_START = 1,
    COMMAND_STOP = 2,
    COMMAND_PRE_OPERATIONAL = 128,
    COMMAND_RESET_NODE = 129,
    COMMAND_RESET_COMMUNICATION = 130
};

static void start_network(drive_sim_t *sim, int64_t boot_us) {
    drive_sim_cia402_state_t *state = &sim->state.cia402;
    state->nmt = CANOPEN_INITIALISING;
    state->boot_us = sim->now_us + boot_us;
    state->producer = (drive_sim_timer_t){0, 0};
    state->consumer_heard = false;
    state->consumer_lost = false;
    state->pdo_error = false;
    state->error_told = false;
    state->uploading = false;
}

static void power_on(drive_sim_t *sim) {
    sim->state.cia402 = (drive_sim_cia402_state_t){0};
    start_network(sim, BOOT_US);
    canopen_objects_reset(sim, false);
    cia402_reset(sim);
}

static void reset_communication(drive_sim_t *sim) {
    (void)cia402_connection_lost(sim, EMERGENCY_COMMUNICATION);
    start_network(sim, BOOT_NETWORK_US);
    canopen_objects_reset(sim, true);
}

/* Emergency messages. */

static uint8_t error_register(const drive_sim_t *sim) {
    const drive_sim_cia402_state_t *state = &sim->state.cia402;
    const uint8_t network = state->consumer_lost || state->pdo_error ? 0x11 : 0x00;
    return (uint8_t)(network | cia402_error_register(sim));
}

static void remember(drive_sim_t *sim, uint16_t code) {
    uint32_t *values = sim->state.cia402.objects;
    for (unsigned i = OBJECT_HISTORY_4; i > OBJECT_HISTORY_1; i--) {
        values[i] = values[i - 1];
    }
    values[OBJECT_HISTORY_1] = code;
    if (values[OBJECT_HISTORY] < OBJECT_HISTORY_4 - OBJECT_HISTORY) {
        values[OBJECT_HISTORY]++;
    }
}

static void send_emergency(drive_sim_t *sim, uint16_t code) {
    const canopen_nmt_t nmt = sim->state.cia402.nmt;
    if (nmt != CANOPEN_PRE_OPERATIONAL && nmt != CANOPEN_OPERATIONAL) {
        return;
    }
    berth_can_frame_t frame = {.id = EMERGENCY + (uint32_t)sim->config.node, .length = 8};
    drive_sim_put_le(&frame.data[0], code, 2);
    frame.data[2] = error_register(sim);
    drive_sim_put(sim, &frame);
}

void canopen_emergency(drive_sim_t *sim, uint16_t code) {
    sim->state.cia402.error_told = true;
    remember(sim, code);
    send_emergency(sim, code);
}

void canopen_check_errors(drive_sim_t *sim) {
    drive_sim_cia402_state_t *state = &sim->state.cia402;
    state->objects[OBJECT_ERROR_REGISTER] = error_register(sim);
    if (state->error_told && error_register(sim) == 0) {
        state->error_told = false;
        send_emergency(sim, 0);
    }
}

/* Heartbeats. */

static void send_heartbeat(drive_sim_t *sim) {
    berth_can_frame_t frame = {.id = HEARTBEAT + (uint32_t)sim->config.node, .length = 1};
    frame.data[0] = (uint8_t)sim->state.cia402.nmt;
    drive_sim_put(sim, &frame);
}

static int64_t consumer_period_us(const drive_sim_t *sim) {
    return (sim->state.cia402.objects[OBJECT_CONSUMER] & 0xffffu) * INT64_C(1000);
}

static uint32_t consumer_node(const drive_sim_t *sim) {
    return sim->state.cia402.objects[OBJECT_CONSUMER] >> 16 & 0x7fu;
}

void canopen_heartbeat_written(drive_sim_t *sim, canopen_object_t object) {
    drive_sim_cia402_state_t *state = &sim->state.cia402;
    if (object == OBJECT_PRODUCER) {
        drive_sim_timer_start(&state->producer, state->objects[OBJECT_PRODUCER] * INT64_C(1000),
                              sim->now_us);
    } else if (object == OBJECT_CONSUMER) {
        state->consumer_heard = false;
        state->consumer_lost = false;
        canopen_check_errors(sim);
    } else if (object == OBJECT_HISTORY) {
        for (unsigned i = OBJECT_HISTORY_1; i <= OBJECT_HISTORY_4; i++) {
            state->objects[i] = 0;
        }
    }
}

static bool hear_heartbeat(drive_sim_t *sim, const berth_can_frame_t *frame) {
    drive_sim_cia402_state_t *state = &sim->state.cia402;
    const uint32_t node = consumer_node(sim);
    if (node == 0 || consumer_period_us(sim) == 0 || frame->id != HEARTBEAT + node) {
        return false;
    }
    if (frame->remote || frame->length != 1) {
        sim->counters.malformed++;
        return true;
    }
    state->consumer_heard = true;
    state->consumer_us = sim->now_us;
    state->consumer_lost = false;
    canopen_check_errors(sim);
    return true;
}

static void heartbeat_missed(drive_sim_t *sim) {
    drive_sim_cia402_state_t *state = &sim->state.cia402;
    state->consumer_heard = false; /* watched again from the next one on */
    state->consumer_lost = true;
    if (cia402_enabled(sim) && state->objects[OBJECT_ABORT_CONNECTION] != 0) {
        sim->counters.watchdog_stops++;
    }
    if (!cia402_connection_lost(sim, EMERGENCY_HEARTBEAT)) {
        canopen_emergency(sim, EMERGENCY_HEARTBEAT);
    }
    const uint32_t behaviour = state->objects[OBJECT_BEHAVIOUR];
    if (behaviour == 2) {
        state->nmt = CANOPEN_STOPPED;
    } else if (behaviour == 0 && state->nmt == CANOPEN_OPERATIONAL) {
        state->nmt = CANOPEN_PRE_OPERATIONAL;
    }
}

/* Frames and time. */

static void command(drive_sim_t *sim, uint8_t code) {
    drive_sim_cia402_state_t *state = &sim->state.cia402;
    switch (code) {
    case COMMAND_START:
        if (state->nmt != CANOPEN_OPERATIONAL) {
            state->nmt = CANOPEN_OPERATIONAL;
            canopen_pdo_start(sim);
        }
        return;
    case COMMAND_STOP:
        (void)cia402_connection_lost(sim, EMERGENCY_COMMUNICATION);
        state->nmt = CANOPEN_STOPPED;
        return;
    case COMMAND_PRE_OPERATIONAL:
        state->nmt = CANOPEN_PRE_OPERATIONAL;
        return;
    case COMMAND_RESET_NODE:
        power_on(sim);
        return;
    case COMMAND_RESET_COMMUNICATION:
        reset_communication(sim);
        return;
    default:
        sim->counters.malformed++;
        return;
    }
}

static bool hear_nmt(drive_sim_t *sim, const berth_can_frame_t *frame) {
    if (frame->remote || frame->length != 2) {
        sim->counters.malformed++;
        return true;
    }
    if (frame->data[1] != 0 && frame->data[1] != sim->config.node) {
        return false;
    }
    command(sim, frame->data[0]);
    return true;
}

static bool hear_sync(drive_sim_t *sim, const berth_can_frame_t *frame) {
    if (frame->remote || frame->length > 1) {
        sim->counters.malformed++;
    } else {
        canopen_pdo_sync(sim);
    }
    return true;
}

static bool dispatch(drive_sim_t *sim, const berth_can_frame_t *frame) {
    if (frame->id == NMT) {
        return hear_nmt(sim, frame);
    }
    if (frame->id == SYNC) {
        return hear_sync(sim, frame);
    }
    if (frame->id == SDO + (uint32_t)sim->config.node) {
        if (sim->state.cia402.nmt != CANOPEN_STOPPED) {
            canopen_sdo_receive(sim, frame);
        }
        return true;
    }
    return hear_heartbeat(sim, frame) || canopen_pdo_receive(sim, frame);
}

static bool receive(drive_sim_t *sim, const berth_can_frame_t *frame) {
    if (frame->extended || sim->state.cia402.nmt == CANOPEN_INITIALISING) {
        return false;
    }
    const bool ours = dispatch(sim, frame);
    if (ours) {
        cia402_advance(sim);
        canopen_pdo_events(sim);
    }
    return ours;
}

static void expire(drive_sim_t *sim) {
    drive_sim_cia402_state_t *state = &sim->state.cia402;
    if (state->nmt == CANOPEN_INITIALISING && sim->now_us >= state->boot_us) {
        send_heartbeat(sim); /* the boot-up message: a heartbeat that says initialising */
        state->nmt = CANOPEN_PRE_OPERATIONAL;
    }
    cia402_advance(sim);
    if (state->consumer_heard && sim->now_us - state->consumer_us >= consumer_period_us(sim)) {
        heartbeat_missed(sim);
    }
}

static void step(drive_sim_t *sim) {
    if (drive_sim_timer_take(&sim->state.cia402.producer, sim->now_us) &&
        !sim->trouble.mute_heartbeat) {
        send_heartbeat(sim);
    }
    canopen_pdo_events(sim);
}

static int64_t earlier(int64_t a, int64_t b) {
    return a < b ? a : b;
}

static int64_t deadline(const drive_sim_t *sim) {
    const drive_sim_cia402_state_t *state = &sim->state.cia402;
    int64_t deadline_us = earlier(cia402_deadline(sim), canopen_pdo_deadline(sim));
    if (state->nmt == CANOPEN_INITIALISING) {
        deadline_us = earlier(deadline_us, state->boot_us);
    }
    if (state->consumer_heard) {
        deadline_us = earlier(deadline_us, state->consumer_us + consumer_period_us(sim));
    }
    return drive_sim_timer_deadline(&state->producer, deadline_us);
}

static void fail(drive_sim_t *sim, uint32_t code) {
    const uint16_t emergency = (uint16_t)(code & 0xffffu);
    cia402_fault(sim, emergency == 0 ? UINT16_C(0x1000) : emergency);
    canopen_pdo_events(sim);
}

const drive_sim_protocol_t drive_sim_cia402 = {power_on, expire,         receive,           step,
                                               deadline, cia402_enabled, cia402_target_rps, fail};
