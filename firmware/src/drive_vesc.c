#include "berth/drive_vesc.h"

#include "berth/reference.h"
#include "check.h"
#include "drive_protocol.h"

#define NODE_MAX 254.0f /* 255 addresses all drives */
#define POLE_PAIRS_MAX 100.0f
#define STEPS_PER_ELECTRICAL_TURN 6.0f

enum { SET_DUTY = 0, SET_CURRENT = 1, SET_ERPM = 3, STATUS_1 = 9, STATUS_5 = 27 };

static berth_error_t check(const berth_drive_config_t *config, berth_refusal_t *refusal) {
    const berth_error_t error = drive_check_node(config, 0.0f, NODE_MAX, refusal);
    if (error != BERTH_OK) {
        return error;
    }
    return check_value(BERTH_FIELD_POLE_PAIRS, (float)config->pole_pairs, 1.0f, POLE_PAIRS_MAX,
                       refusal)
               ? BERTH_OK
               : BERTH_ERROR_CONFIG;
}

static uint32_t id_of(const berth_drive_t *drive, uint32_t packet) {
    return (packet << 8) | drive->config.node;
}

static float erpm_per_rps(const berth_drive_t *drive) {
    return 60.0f * (float)drive->config.pole_pairs;
}

/* A full outbox counts what it drops; the next cycle says it again. */
static void put(const berth_drive_t *drive, uint32_t packet, int32_t value,
                berth_outbox_t *outbox) {
    berth_can_frame_t frame = drive_frame(id_of(drive, packet), true, 4);
    put_u32_be(frame.data, (uint32_t)value);
    (void)berth_outbox_put(outbox, &frame, BERTH_OUTBOX_LATEST);
}

static void enable(berth_drive_t *drive, int64_t now_us) {
    (void)drive; /* nothing to set up */
    (void)now_us;
}

/* Speed 0 takes the place of a speed that still waits to be sent, here and in stop: otherwise it
 * could win the bus after the frame that is to end it. */
static void disable(berth_drive_t *drive, berth_outbox_t *outbox) {
    put(drive, SET_ERPM, 0, outbox);
    put(drive, SET_CURRENT, 0, outbox);
}

static void stop(berth_drive_t *drive, berth_outbox_t *outbox) {
    put(drive, SET_ERPM, 0, outbox);
    put(drive, SET_DUTY, 0, outbox);
}

static void cycle(berth_drive_t *drive, int64_t now_us, berth_outbox_t *outbox) {
    (void)now_us;
    const berth_drive_state_t state = drive->status.state;
    if (state == BERTH_DRIVE_ENABLED || state == BERTH_DRIVE_STARTING) {
        const float scale = erpm_per_rps(drive);
        const float erpm = drive_motor_rps(drive) * scale;
        put(drive, SET_ERPM, drive_to_int(drive, erpm, BERTH_VESC_SPEED_MAX_RPS * scale), outbox);
    } else {
        put(drive, SET_DUTY, 0, outbox);
    }
}

static drive_frame_t status_1(berth_drive_t *drive, const berth_can_frame_t *frame, int64_t at_us) {
    if (!drive_frame_has(frame, 8)) {
        return DRIVE_FRAME_MALFORMED;
    }
    const float rps = (float)signed_u32(get_u32_be(frame->data)) / erpm_per_rps(drive);
    if (!check_range(rps, -BERTH_VESC_SPEED_MAX_RPS, BERTH_VESC_SPEED_MAX_RPS)) {
        return DRIVE_FRAME_MALFORMED;
    }
    drive_velocity(drive, rps, at_us);
    drive_alive(drive, at_us);
    if (at_us >= drive->enabling_us) {
        drive_enabled(drive);
    }
    return DRIVE_FRAME_GOOD;
}

static drive_frame_t status_5(berth_drive_t *drive, const berth_can_frame_t *frame, int64_t at_us) {
    if (!drive_frame_has(frame, 8) && !drive_frame_has(frame, 6)) {
        return DRIVE_FRAME_MALFORMED;
    }
    berth_drive_vesc_state_t *state = &drive->state.vesc;
    const uint32_t tachometer = get_u32_be(frame->data);
    const int32_t steps = signed_u32(tachometer - state->tachometer);
    state->tachometer = tachometer;
    const float quantum = 1.0f / (STEPS_PER_ELECTRICAL_TURN * (float)drive->config.pole_pairs);
    return drive_position(drive, (float)steps * quantum, quantum, at_us) ? DRIVE_FRAME_GOOD
                                                                         : DRIVE_FRAME_MALFORMED;
}

static drive_frame_t receive(berth_drive_t *drive, const berth_can_frame_t *frame, int64_t at_us) {
    if (!frame->extended) {
        return DRIVE_FRAME_FOREIGN;
    }
    if (frame->id == id_of(drive, STATUS_1)) {
        return status_1(drive, frame, at_us);
    }
    if (frame->id == id_of(drive, STATUS_5)) {
        return status_5(drive, frame, at_us);
    }
    return DRIVE_FRAME_FOREIGN;
}

static void step(berth_drive_t *drive, int64_t now_us, berth_outbox_t *outbox) {
    (void)drive; /* no timers but the common watchdogs */
    (void)now_us;
    (void)outbox;
}

static int64_t deadline(const berth_drive_t *drive) {
    (void)drive;
    return BERTH_TIME_MAX_US;
}

static uint32_t filters(const berth_drive_t *drive, berth_can_filter_t *filters) {
    filters[0] = (berth_can_filter_t){id_of(drive, STATUS_1), BERTH_CAN_EXTENDED_MAX, true};
    filters[1] = (berth_can_filter_t){id_of(drive, STATUS_5), BERTH_CAN_EXTENDED_MAX, true};
    return 2;
}

static uint32_t progress(const berth_drive_t *drive) {
    (void)drive;
    return BERTH_VESC_NO_STATUS;
}

const berth_drive_protocol_t berth_drive_vesc = {
    .check = check,
    .enable = enable,
    .disable = disable,
    .stop = stop,
    .emergency_stop = stop,
    .cycle = cycle,
    .receive = receive,
    .step = step,
    .deadline = deadline,
    .filters = filters,
    .progress = progress,
};
