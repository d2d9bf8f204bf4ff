#include "berth/drive_cia402.h"

#include "berth/reference.h"
#include "check.h"
#include "cia402.h"

/* MISRA D9 in this file. */

_Static_assert(BERTH_PERIOD_MAX_US / BERTH_CIA402_SYNC_US < UINT8_MAX, "SYNCs left are a byte");

/* Largest float32 below 2^31. */
#define VELOCITY_LIMIT 2147483520.0f

static berth_error_t check(const berth_drive_config_t *config, berth_refusal_t *refusal) {
    const uint32_t periods_us = 2u * config->period_us;
    const float shortest_us = periods_us > 3000u ? (float)periods_us : 3000.0f;
    const bool good =
        drive_check_node(config, 1.0f, 127.0f, refusal) == BERTH_OK &&
        (config->mode == 9u ||
         check_value(BERTH_FIELD_DRIVE_MODE, (float)config->mode, 3.0f, 3.0f, refusal)) &&
        check_value(BERTH_FIELD_MASTER_NODE,
                    config->master_node == config->node ? 0.0f : (float)config->master_node, 1.0f,
                    127.0f, refusal) &&
        (!config->has_position ||
         check_value(BERTH_FIELD_COUNTS_PER_TURN, (float)config->counts_per_turn, 1.0f, 16777216.0f,
                     refusal)) &&
        check_value(BERTH_FIELD_VELOCITY_UNITS, config->velocity_units_per_rps, 1.0e-3f, 1.0e8f,
                    refusal) &&
        check_value(BERTH_FIELD_HEARTBEAT_TIMEOUT, (float)config->heartbeat_timeout_us, shortest_us,
                    1.0e7f, refusal);
    return good ? BERTH_OK : BERTH_ERROR_CONFIG;
}

/* --- frames to the drive -------------------------------------------------------------------- */

static void put_command(const berth_drive_t *drive, uint16_t word, int32_t velocity,
                        berth_outbox_t *outbox) {
    berth_can_frame_t frame = drive_frame(CIA402_ID_RPDO1 + (uint32_t)drive->config.node, false, 6);
    put_u16_le(frame.data, word);
    put_u32_le(&frame.data[2], (uint32_t)velocity);
    (void)berth_outbox_put(outbox, &frame, BERTH_OUTBOX_LATEST);
}

static void put_sync(berth_outbox_t *outbox, berth_outbox_policy_t policy) {
    const berth_can_frame_t frame = drive_frame(CIA402_ID_SYNC, false, 0);
    (void)berth_outbox_put(outbox, &frame, policy);
}

/* By PDO with a SYNC behind it, and by SDO, which works in every NMT state but stopped. */
static void put_word_at_once(const berth_drive_t *drive, uint16_t word, berth_outbox_t *outbox) {
    if (drive->state.cia402.stage >= CIA402_NODE) {
        put_command(drive, word, 0, outbox);
        put_sync(outbox, BERTH_OUTBOX_EACH);
    }
    cia402_put_word_by_sdo(drive, word, outbox);
}

static void disable(berth_drive_t *drive, berth_outbox_t *outbox) {
    put_word_at_once(drive, CIA402_WORD_DISABLE_VOLTAGE, outbox);
    cia402_put_nmt(drive, CIA402_NMT_ENTER_PREOPERATIONAL, outbox);
    drive->state.cia402.stage = CIA402_NONE;
    drive->state.cia402.syncs = 0;
}

static void stop(berth_drive_t *drive, berth_outbox_t *outbox) {
    put_word_at_once(drive, CIA402_WORD_QUICK_STOP, outbox);
}

static void emergency_stop(berth_drive_t *drive, berth_outbox_t *outbox) {
    drive->state.cia402.emergency = true;
    stop(drive, outbox);
}

static void cycle(berth_drive_t *drive, int64_t now_us, berth_outbox_t *outbox) {
    berth_drive_cia402_state_t *state = &drive->state.cia402;
    const uint16_t word = cia402_word(drive, now_us);
    const bool ours = state->stage >= CIA402_NODE;
    const bool moving =
        drive->status.state == BERTH_DRIVE_STARTING || drive->status.state == BERTH_DRIVE_ENABLED;
    if (ours) {
        const float target = drive_motor_rps(drive) * drive->config.velocity_units_per_rps;
        put_command(drive, word, drive_to_int(drive, target, VELOCITY_LIMIT), outbox);
        state->syncs = (uint8_t)(cia402_syncs(&drive->config) - 1u);
        state->sync_us = now_us + cia402_sync_period_us(&drive->config);
    }
    if (!moving && (!ours || state->nmt_state != CIA402_NMT_OPERATIONAL)) {
        cia402_put_word_by_sdo(drive, word, outbox);
    }
}

static void sync(const berth_drive_t *drive, int64_t now_us, berth_outbox_t *outbox) {
    (void)now_us;
    put_sync(outbox, BERTH_OUTBOX_LATEST);
    berth_can_frame_t frame =
        drive_frame(CIA402_ID_HEARTBEAT + (uint32_t)drive->config.master_node, false, 1);
    frame.data[0] = CIA402_NMT_OPERATIONAL;
    (void)berth_outbox_put(outbox, &frame, BERTH_OUTBOX_LATEST);
}

/* --- frames from the drive ------------------------------------------------------------------ */

static drive_frame_t receive_emergency(berth_drive_t *drive, const berth_can_frame_t *frame) {
    if (!drive_frame_has(frame, 8)) {
        return DRIVE_FRAME_MALFORMED;
    }
    berth_drive_cia402_state_t *state = &drive->state.cia402;
    state->error_code = get_u16_le(frame->data);
    const bool old = drive->status.state == BERTH_DRIVE_STARTING && !state->healthy;
    if (state->error_code != 0u && !old) {
        drive_fail(drive, BERTH_DRIVE_FAULT_EMERGENCY, state->error_code);
    }
    return DRIVE_FRAME_GOOD;
}

static drive_frame_t receive_position(berth_drive_t *drive, const berth_can_frame_t *frame,
                                      int64_t at_us) {
    berth_drive_cia402_state_t *state = &drive->state.cia402;
    if (state->stage < CIA402_NODE) {
        return DRIVE_FRAME_GOOD;
    }
    if (!drive_frame_has(frame, 4)) {
        return DRIVE_FRAME_MALFORMED;
    }
    const uint32_t counts = get_u32_le(frame->data);
    const float quantum = 1.0f / (float)drive->config.counts_per_turn;
    const int32_t moved = signed_u32(counts - state->counts);
    state->counts = counts;
    return drive_position(drive, (float)moved * quantum, quantum, at_us) ? DRIVE_FRAME_GOOD
                                                                         : DRIVE_FRAME_MALFORMED;
}

/* The drive has lost all that it was told. */
static void booted(berth_drive_t *drive, int64_t at_us) {
    if (drive->status.state == BERTH_DRIVE_STARTING) {
        drive_position_lost(drive);
        cia402_setup_start(drive, at_us);
        return;
    }
    drive->state.cia402.stage = CIA402_NONE;
    drive_fail(drive, BERTH_DRIVE_FAULT_DISABLED, BERTH_CIA402_CODE_NMT + CIA402_NMT_BOOT_UP);
}

static void nmt_state_told(berth_drive_t *drive, uint8_t told, int64_t at_us) {
    berth_drive_cia402_state_t *state = &drive->state.cia402;
    if (drive->status.state == BERTH_DRIVE_STARTING) {
        if (state->stage == CIA402_HALT && told == CIA402_NMT_PREOPERATIONAL) {
            state->stage = CIA402_SETUP;
            state->due_us = at_us;
        } else if (state->stage == CIA402_NODE && told == CIA402_NMT_OPERATIONAL) {
            state->stage = CIA402_RUN;
            state->due_us = at_us;
        } else if (state->stage >= CIA402_RUN && told != CIA402_NMT_OPERATIONAL) {
            state->stage = CIA402_NODE;
            state->waiting = false;
            state->due_us = at_us;
        } else {
            /* still on its way */
        }
    } else if (state->stage >= CIA402_RUN && told != CIA402_NMT_OPERATIONAL) {
        drive_fail(drive, BERTH_DRIVE_FAULT_DISABLED, BERTH_CIA402_CODE_NMT + told);
    } else {
        /* as it should be */
    }
}

static drive_frame_t receive_heartbeat(berth_drive_t *drive, const berth_can_frame_t *frame,
                                       int64_t at_us) {
    const uint8_t told = frame->data[0];
    if (!drive_frame_has(frame, 1) ||
        (told != CIA402_NMT_BOOT_UP && told != CIA402_NMT_STOPPED &&
         told != CIA402_NMT_OPERATIONAL && told != CIA402_NMT_PREOPERATIONAL)) {
        return DRIVE_FRAME_MALFORMED;
    }
    drive->state.cia402.nmt_state = told;
    if (told == CIA402_NMT_BOOT_UP) {
        booted(drive, at_us);
    } else {
        drive_alive(drive, at_us);
        nmt_state_told(drive, told, at_us);
    }
    return DRIVE_FRAME_GOOD;
}

static drive_frame_t receive(berth_drive_t *drive, const berth_can_frame_t *frame, int64_t at_us) {
    if (frame->extended) {
        return DRIVE_FRAME_FOREIGN;
    }
    switch (frame->id - drive->config.node) {
    case CIA402_ID_EMERGENCY:
        return receive_emergency(drive, frame);
    case CIA402_ID_TPDO1:
        return cia402_status(drive, frame, at_us);
    case CIA402_ID_TPDO2:
        return drive->config.has_position ? receive_position(drive, frame, at_us)
                                          : DRIVE_FRAME_FOREIGN;
    case CIA402_ID_ANSWER:
        return cia402_answer(drive, frame, at_us);
    case CIA402_ID_HEARTBEAT:
        return receive_heartbeat(drive, frame, at_us);
    default:
        return DRIVE_FRAME_FOREIGN;
    }
}

/* --- time ----------------------------------------------------------------------------------- */

/* Late ones are not made up for. One that would come with the next period's commands is left out:
 * in the outbox it would stand before them, and they would wait for another. */
static void sync_between(berth_drive_t *drive, int64_t now_us, berth_outbox_t *outbox) {
    berth_drive_cia402_state_t *state = &drive->state.cia402;
    const int64_t period_us = cia402_sync_period_us(&drive->config);
    bool put = false;
    while (state->syncs > 0u && now_us >= state->sync_us) {
        put = now_us - state->sync_us <= period_us / 2;
        state->syncs--;
        state->sync_us += period_us;
    }
    if (put) {
        put_sync(outbox, BERTH_OUTBOX_LATEST);
    }
}

static void step(berth_drive_t *drive, int64_t now_us, berth_outbox_t *outbox) {
    sync_between(drive, now_us, outbox);
    if (drive->status.state != BERTH_DRIVE_STARTING) {
        return;
    }
    if (now_us > drive->enabling_us + drive->config.enable_timeout_us) {
        /* drive.c would say that enabling took too long: this is why */
        if (cia402_fault_told(drive)) {
            drive_fail(drive, BERTH_DRIVE_FAULT_DEVICE, drive->state.cia402.error_code);
        }
        return;
    }
    cia402_setup_step(drive, now_us, outbox);
}

static int64_t deadline(const berth_drive_t *drive) {
    const berth_drive_cia402_state_t *state = &drive->state.cia402;
    const bool timed = drive->status.state == BERTH_DRIVE_STARTING && state->stage != CIA402_RUN;
    const int64_t due_us = timed ? state->due_us : BERTH_TIME_MAX_US;
    return state->syncs > 0u && state->sync_us < due_us ? state->sync_us : due_us;
}

static uint32_t progress(const berth_drive_t *drive) {
    const berth_drive_cia402_state_t *state = &drive->state.cia402;
    if (state->stage == CIA402_SETUP || state->stage == CIA402_CHECK) {
        return cia402_setup_object(drive);
    }
    return state->stage == CIA402_RUN ? BERTH_CIA402_CODE_STATUS + state->statusword
                                      : BERTH_CIA402_CODE_NMT + state->nmt_state;
}

static uint32_t filters(const berth_drive_t *drive, berth_can_filter_t *out) {
    static const uint16_t ids[] = {CIA402_ID_EMERGENCY, CIA402_ID_TPDO1, CIA402_ID_ANSWER,
                                   CIA402_ID_HEARTBEAT, CIA402_ID_TPDO2};
    const uint32_t count = drive->config.has_position ? 5 : 4;
    for (uint32_t i = 0; i < count; i++) {
        out[i] = (berth_can_filter_t){.id = (uint32_t)ids[i] + drive->config.node,
                                      .mask = BERTH_CAN_STANDARD_MAX};
    }
    return count;
}

const berth_drive_protocol_t berth_drive_cia402 = {
    .check = check,
    .enable = cia402_setup_start,
    .disable = disable,
    .stop = stop,
    .emergency_stop = emergency_stop,
    .cycle = cycle,
    .sync = sync,
    .receive = receive,
    .step = step,
    .deadline = deadline,
    .filters = filters,
    .progress = progress,
};
