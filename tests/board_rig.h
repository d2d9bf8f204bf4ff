/* A board with two drives of a protocol made up for the tests, and wheels that obey at once.
 *
 * The made-up protocol: frame 0x100 + node commands a speed (float32 turns/s), 0x110 + node lets
 * go, 0x120 + node stops, 0x130 + node is the emergency stop, 0x80 synchronises; 0x200 + node is
 * feedback (float32 turns/s, float32 turns) and sign of life; 0x210 + node reports an error (its
 * code).
 */
#ifndef BERTH_TESTS_BOARD_RIG_H
#define BERTH_TESTS_BOARD_RIG_H

#include "../firmware/src/drive_protocol.h"
#include "berth/board.h"
#include "support.h"

#include <math.h>
#include <string.h>

#define RIG_PERIOD_US 50000
#define RIG_FEEDBACK_US 5000

typedef struct {
    double rps;                             /* commanded speed in force */
    double turns;                           /* wheel angle */
    bool mute;                              /* no feedback */
    bool backwards;                         /* the encoder counts the other way */
    int lets, stops, emergencies, commands; /* frames seen */
} rig_wheel_t;

typedef struct {
    support_plan_t shape;
    berth_board_config_t config;
    berth_board_t board;
    rig_wheel_t wheels[2];
    int64_t now_us;
    int64_t feedback_us;
    bool blocked; /* no frame leaves */
    int syncs;
    long moving;                   /* commands other than zero seen */
    berth_message_status_t status; /* last one told */
    int statuses, poses, errors;
} rig_t;

static inline drive_frame_t rig_receive(berth_drive_t *drive, const berth_can_frame_t *frame,
                                        int64_t at_us) {
    if (!frame->extended && frame->id == 0x210u + drive->config.node) {
        drive_fail(drive, BERTH_DRIVE_FAULT_DEVICE, frame->data[0]);
        return DRIVE_FRAME_GOOD;
    }
    if (frame->extended || frame->id != 0x200u + drive->config.node) {
        return DRIVE_FRAME_FOREIGN;
    }
    const float rps = float_from_bits(get_u32_le(frame->data));
    if (!drive_frame_has(frame, 8) || !(fabsf(rps) < 1.0e6f)) {
        return DRIVE_FRAME_MALFORMED;
    }
    const float turns = float_from_bits(get_u32_le(frame->data + 4));
    drive_alive(drive, at_us);
    drive_velocity(drive, rps, at_us);
    drive_position(drive, turns - drive->state.odrive.turns, 0.0f, at_us);
    drive->state.odrive.turns = turns;
    return DRIVE_FRAME_GOOD;
}

static inline void rig_put(berth_drive_t *drive, berth_outbox_t *outbox, uint32_t base,
                           float value) {
    berth_can_frame_t frame = drive_frame(base + drive->config.node, false, 4);
    put_u32_le(frame.data, bits_from_float(value));
    (void)berth_outbox_put(outbox, &frame, BERTH_OUTBOX_LATEST);
}

static inline void rig_disable(berth_drive_t *drive, berth_outbox_t *outbox) {
    rig_put(drive, outbox, 0x110, 0.0f);
}
static inline void rig_stop(berth_drive_t *drive, berth_outbox_t *outbox) {
    rig_put(drive, outbox, 0x120, 0.0f);
}
static inline void rig_emergency(berth_drive_t *drive, berth_outbox_t *outbox) {
    rig_put(drive, outbox, 0x130, 0.0f);
}
static inline void rig_cycle(berth_drive_t *drive, int64_t now_us, berth_outbox_t *outbox) {
    (void)now_us;
    rig_put(drive, outbox, 0x100, drive_motor_rps(drive));
}
static inline void rig_sync(const berth_drive_t *drive, int64_t now_us, berth_outbox_t *outbox) {
    (void)drive;
    (void)now_us;
    const berth_can_frame_t frame = drive_frame(0x80, false, 0);
    (void)berth_outbox_put(outbox, &frame, BERTH_OUTBOX_EACH);
}
static inline berth_error_t rig_check(const berth_drive_config_t *config,
                                      berth_refusal_t *refusal) {
    return drive_check_node(config, 0.0f, 15.0f, refusal);
}
static inline void rig_enable(berth_drive_t *drive, int64_t now_us) {
    (void)drive;
    (void)now_us;
}
static inline void rig_drive_step(berth_drive_t *drive, int64_t now_us, berth_outbox_t *outbox) {
    (void)now_us;
    (void)outbox;
    drive_enabled(drive);
}
static inline int64_t rig_never(const berth_drive_t *drive) {
    (void)drive;
    return BERTH_TIME_MAX_US;
}
static inline uint32_t rig_filters(const berth_drive_t *drive, berth_can_filter_t *filters) {
    filters[0] = (berth_can_filter_t){0x200u + drive->config.node, BERTH_CAN_STANDARD_MAX, false};
    filters[1] = (berth_can_filter_t){0x210u + drive->config.node, BERTH_CAN_STANDARD_MAX, false};
    return 2;
}
static inline uint32_t rig_progress(const berth_drive_t *drive) {
    (void)drive;
    return 1;
}

static const berth_drive_protocol_t rig_protocol = {
    rig_check, rig_enable,  rig_disable,    rig_stop,  rig_emergency, rig_cycle,
    rig_sync,  rig_receive, rig_drive_step, rig_never, rig_filters,   rig_progress,
};

/* A circle of 419 samples, the robot on its first one. Call rig_init after changing rig->config. */
static inline void rig_prepare(rig_t *rig) {
    memset(rig, 0, sizeof *rig);
    support_plan(&rig->shape, SUPPORT_CIRCLE, 419, true);
    support_fill_gains(&rig->shape);
    rig->config = berth_board_config_default(0.05f, 0.3f, RIG_PERIOD_US);
    rig->config.address = 5;
    for (int side = 0; side < 2; side++) {
        rig->config.drives[side].protocol = &rig_protocol;
        rig->config.drives[side].node = (uint8_t)(1 + side);
    }
}

static inline berth_error_t rig_init(rig_t *rig, berth_refusal_t *refusal) {
    return berth_board_init(&rig->board, &rig->shape.plan, &rig->config, 0, refusal);
}

/* What a frame of the board's does to the wheels. */
static inline void rig_obey(rig_t *rig, const berth_can_frame_t *frame) {
    berth_message_status_t status;
    if (frame->extended) {
        if (berth_message_is(frame, BERTH_MESSAGE_STATUS, 5) &&
            berth_message_decode_status(frame, &status)) {
            rig->status = status;
            rig->statuses++;
        }
        rig->poses += berth_message_is(frame, BERTH_MESSAGE_POSE, 5);
        rig->errors += berth_message_is(frame, BERTH_MESSAGE_ERROR, 5);
        return;
    }
    if (frame->id == 0x80) {
        rig->syncs++;
        return;
    }
    rig_wheel_t *wheel = &rig->wheels[(frame->id & 15u) == 2];
    switch (frame->id & 0x1f0u) {
    case 0x100:
        wheel->rps = (double)float_from_bits(get_u32_le(frame->data));
        wheel->commands++;
        rig->moving += wheel->rps != 0.0;
        break;
    case 0x110:
        wheel->lets++;
        wheel->rps = 0.0;
        break;
    case 0x120:
        wheel->stops++;
        wheel->rps = 0.0;
        break;
    case 0x130:
        wheel->emergencies++;
        wheel->rps = 0.0;
        break;
    default:
        break;
    }
}

static inline void rig_send_all(rig_t *rig) {
    const berth_can_frame_t *frame;
    while (!rig->blocked && (frame = berth_board_front(&rig->board)) != NULL) {
        rig_obey(rig, frame);
        berth_board_sent(&rig->board, rig->now_us);
    }
}

static inline void rig_hear(rig_t *rig, const berth_can_frame_t *frame) {
    berth_can_frame_t heard = *frame;
    heard.time_us = rig->now_us;
    berth_board_receive(&rig->board, &heard, rig->now_us);
    rig_send_all(rig);
}

static inline void rig_feedback(rig_t *rig) {
    for (int side = 0; side < 2; side++) {
        if (!rig->wheels[side].mute) {
            berth_can_frame_t frame = drive_frame(0x201u + (uint32_t)side, false, 8);
            const double sign = rig->wheels[side].backwards ? -1.0 : 1.0;
            put_u32_le(frame.data, bits_from_float((float)(sign * rig->wheels[side].rps)));
            put_u32_le(frame.data + 4, bits_from_float((float)(sign * rig->wheels[side].turns)));
            rig_hear(rig, &frame);
        }
    }
}

/* Goes on to a time: wheels turn, feedback comes each 5 ms, the board is run at its deadlines. */
static inline void rig_run(rig_t *rig, int64_t until_us) {
    while (rig->now_us < until_us) {
        int64_t next_us = berth_board_deadline(&rig->board);
        next_us = next_us < rig->feedback_us ? next_us : rig->feedback_us;
        next_us = next_us > rig->now_us ? next_us : rig->now_us;
        next_us = next_us < until_us ? next_us : until_us;
        for (int side = 0; side < 2; side++) {
            rig->wheels[side].turns +=
                rig->wheels[side].rps * 1.0e-6 * (double)(next_us - rig->now_us);
        }
        rig->now_us = next_us;
        if (rig->now_us >= rig->feedback_us) {
            rig->feedback_us = rig->now_us + RIG_FEEDBACK_US;
            rig_feedback(rig);
        }
        berth_board_step(&rig->board, rig->now_us);
        rig_send_all(rig);
    }
}

static inline void rig_command(rig_t *rig, berth_command_code_t code) {
    berth_board_command(&rig->board, code, rig->now_us);
    rig_send_all(rig);
}

static inline void rig_set_pose(rig_t *rig, float x_m, float y_m, float theta_rad) {
    const berth_pose_t pose = {x_m, y_m, theta_rad};
    const berth_error_t error = berth_board_set_pose(&rig->board, &pose, rig->now_us);
    rig->now_us +=
        error == BERTH_OK ? 0 : BERTH_TIME_MAX_US; /* a test that goes on would show it */
}

#endif
