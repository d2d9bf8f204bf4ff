#include "berth/digest.h"
#include "berth/link.h"
#include "lockstep.h"
#include "mps2_board.h"
#include "pil.h"

#include <string.h>

#define WAIT_US 1000000
#define OUT_BYTES 2048u
#define STATE_UNTOLD UINT32_MAX

typedef struct {
    const pil_options_t *options;
    berth_board_t board;
    berth_link_t link;
    bool ready;
    int64_t time_us;
    float x_m, y_m;
    berth_can_mode_t mode;
    uint32_t room, room_left; /* told, and of it in this run */
    uint32_t state;           /* told last */
    int64_t deadline_us;      /* likewise */
    uint32_t received_count, received_at;
    berth_can_frame_t received[LOCKSTEP_FRAMES_MAX];
    lockstep_line_t line;
    uint32_t out_length;
    uint8_t out[OUT_BYTES];
} lockstep_t;

/* --- what goes out ------------------------------------------------------------------------ */

static void flush(lockstep_t *lockstep) {
    const byte_stream_t bus = board_bus();
    uint32_t at = 0;
    while (at < lockstep->out_length) {
        size_t count = 0;
        (void)bus.api->write(bus.context, lockstep->out + at, lockstep->out_length - at, &count);
        at += (uint32_t)count;
    }
    lockstep->out_length = 0;
}

static void put_frame(lockstep_t *lockstep, const berth_can_frame_t *frame) {
    if (lockstep->out_length > OUT_BYTES - SLCAN_LINE_MAX) {
        flush(lockstep);
    }
    char text[SLCAN_LINE_MAX];
    const size_t length = slcan_encode(frame, text);
    memcpy(lockstep->out + lockstep->out_length, text, length);
    lockstep->out_length += (uint32_t)length;
}

static void put(lockstep_t *lockstep, lockstep_kind_t kind, uint64_t value) {
    berth_can_frame_t frame;
    lockstep_encode(&frame, kind, value);
    put_frame(lockstep, &frame);
}

static void put_done(lockstep_t *lockstep) {
    const berth_board_status_t *status = berth_board_status(&lockstep->board);
    const uint32_t waiting = berth_board_front(&lockstep->board) != NULL ? 1u : 0u;
    const uint32_t state = (uint32_t)status->state | (uint32_t)status->fault << 8 | waiting << 16;
    if (state != lockstep->state) {
        lockstep->state = state;
        put(lockstep, LOCKSTEP_STATE, state);
    }
    const int64_t deadline_us = berth_link_deadline(&lockstep->link);
    put(lockstep, LOCKSTEP_DONE, deadline_us != lockstep->deadline_us ? (uint64_t)deadline_us : 0u);
    lockstep->deadline_us = deadline_us;
    flush(lockstep);
}

static void put_lost(lockstep_t *lockstep) {
    put(lockstep, LOCKSTEP_LOST, 0);
    flush(lockstep);
}

static void put_counts(lockstep_t *lockstep) {
    const berth_board_t *board = &lockstep->board;
    const berth_board_status_t *status = berth_board_status(board);
    const uint32_t counts[LOCKSTEP_COUNTS] = {
        [LOCKSTEP_COUNT_STEPS] = status->steps,
        [LOCKSTEP_COUNT_LATE] = status->late,
        [LOCKSTEP_COUNT_MISSED] = status->missed,
        [LOCKSTEP_COUNT_LATEST_US] = (uint32_t)status->latest_us,
        [LOCKSTEP_COUNT_RECEIVED] = status->received,
        [LOCKSTEP_COUNT_MALFORMED] = status->malformed,
        [LOCKSTEP_COUNT_FOREIGN] = status->foreign,
        [LOCKSTEP_COUNT_COMMANDS_REFUSED] = status->commands_refused,
        [LOCKSTEP_COUNT_OBSTACLES_REFUSED] = status->obstacles_refused,
        [LOCKSTEP_COUNT_OUTBOX_DROPPED] = board->outbox.dropped,
        [LOCKSTEP_COUNT_SEND_AGAIN] = lockstep->link.send_again,
        [LOCKSTEP_COUNT_FAILURES] = lockstep->link.failures,
        [LOCKSTEP_COUNT_SATURATED_LEFT] = berth_board_drive(board, BERTH_LEFT)->saturated,
        [LOCKSTEP_COUNT_SATURATED_RIGHT] = berth_board_drive(board, BERTH_RIGHT)->saturated,
    };
    for (uint32_t i = 0; i < LOCKSTEP_COUNTS; i++) {
        put(lockstep, LOCKSTEP_COUNT, i | (uint64_t)counts[i] << 8);
    }
}

/* --- the bus that the host describes ------------------------------------------------------ */

static bool is_usable(const lockstep_t *lockstep) {
    return lockstep->mode == BERTH_CAN_ERROR_ACTIVE || lockstep->mode == BERTH_CAN_ERROR_PASSIVE;
}

static berth_can_outcome_t bus_send(void *context, const berth_can_frame_t *frame) {
    lockstep_t *lockstep = context;
    if (!is_usable(lockstep)) {
        return BERTH_CAN_FAILED;
    }
    if (lockstep->room_left == 0) {
        return BERTH_CAN_AGAIN;
    }
    lockstep->room_left--;
    put_frame(lockstep, frame);
    return BERTH_CAN_DONE;
}

static berth_can_outcome_t bus_receive(void *context, berth_can_frame_t *frame) {
    lockstep_t *lockstep = context;
    if (!is_usable(lockstep)) {
        return BERTH_CAN_FAILED;
    }
    if (lockstep->received_at == lockstep->received_count) {
        return BERTH_CAN_AGAIN;
    }
    *frame = lockstep->received[lockstep->received_at];
    lockstep->received_at++;
    return BERTH_CAN_DONE;
}

static void bus_state(void *context, berth_can_state_t *state) {
    const lockstep_t *lockstep = context;
    *state = (berth_can_state_t){.mode = lockstep->mode};
}

/* --- what comes in ------------------------------------------------------------------------ */

static void begin(lockstep_t *lockstep, int64_t now_us) {
    static const berth_can_api_t api = {bus_send, bus_receive, bus_state};
    const berth_can_t can = {&api, lockstep};
    lockstep->mode = BERTH_CAN_ERROR_ACTIVE;
    lockstep->room = LOCKSTEP_ROOM_MAX;
    lockstep->state = STATE_UNTOLD;
    lockstep->deadline_us = 0;
    lockstep->received_count = lockstep->received_at = 0;
    lockstep->ready =
        pil_setup(&lockstep->board, lockstep->options, pil_plan(lockstep->options), now_us);
    berth_link_init(&lockstep->link, &lockstep->board, &can);
    const uint64_t digest = berth_board_digest(&lockstep->board);
    put(lockstep, LOCKSTEP_READY, lockstep->ready ? lockstep->board.plan_crc | digest << 32 : 0u);
    flush(lockstep);
}

static void run(lockstep_t *lockstep) {
    lockstep->room_left = lockstep->room;
    berth_link_run(&lockstep->link, lockstep->time_us);
    lockstep->received_count = lockstep->received_at = 0;
    put_done(lockstep);
}

static float float_of(uint64_t bits) {
    const uint32_t word = (uint32_t)bits;
    float value;
    memcpy(&value, &word, sizeof value);
    return value;
}

static void place(lockstep_t *lockstep, uint64_t heading) {
    const berth_pose_t pose = {lockstep->x_m, lockstep->y_m, float_of(heading)};
    (void)!berth_board_set_pose(&lockstep->board, &pose, lockstep->time_us);
    put_done(lockstep);
}

static void take_frame(lockstep_t *lockstep, const berth_can_frame_t *frame) {
    if (lockstep->received_count == LOCKSTEP_FRAMES_MAX) {
        put_lost(lockstep);
        return;
    }
    berth_can_frame_t *slot = &lockstep->received[lockstep->received_count];
    *slot = *frame;
    slot->time_us = lockstep->time_us;
    lockstep->received_count++;
}

static void take_control(lockstep_t *lockstep, lockstep_kind_t kind, uint64_t value) {
    switch (kind) {
    case LOCKSTEP_TIME:
        lockstep->time_us = (int64_t)value;
        break;
    case LOCKSTEP_BUS:
        lockstep->mode = (berth_can_mode_t)(value & 0xffu);
        lockstep->room = (uint32_t)(value >> 8) & 0xffu;
        break;
    case LOCKSTEP_POSE:
        lockstep->x_m = float_of(value);
        lockstep->y_m = float_of(value >> 32);
        break;
    case LOCKSTEP_PUT:
        place(lockstep, value);
        break;
    case LOCKSTEP_COMMAND:
        berth_board_command(&lockstep->board, (berth_command_code_t)value, lockstep->time_us);
        put_done(lockstep);
        break;
    case LOCKSTEP_RUN:
        run(lockstep);
        break;
    case LOCKSTEP_ASK:
        put_counts(lockstep);
        put_done(lockstep);
        break;
    default:
        put_lost(lockstep);
        break;
    }
}

static void take_line(lockstep_t *lockstep, const berth_can_frame_t *frame) {
    lockstep_kind_t kind;
    uint64_t value;
    const bool control = lockstep_decode(frame, &kind, &value);
    if (control && kind == LOCKSTEP_BEGIN) {
        begin(lockstep, (int64_t)value);
    } else if (!lockstep->ready) {
        put_lost(lockstep);
    } else if (control) {
        take_control(lockstep, kind, value);
    } else {
        take_frame(lockstep, frame);
    }
}

/* The clock is for waiting alone: nothing that is computed knows of it. */
int pil_lockstep(const pil_options_t *options) {
    static lockstep_t lockstep;
    const byte_stream_t bus = board_bus();
    const berth_clock_t clock = board_clock();
    lockstep.options = options;
    board_puts("lock-step\n");
    for (;;) {
        uint8_t bytes[64];
        size_t count = 0;
        if (bus.api->read(bus.context, bytes, sizeof bytes, &count) == BYTE_STREAM_FAILED) {
            put_lost(&lockstep);
        }
        for (size_t i = 0; i < count; i++) {
            berth_can_frame_t frame;
            const lockstep_take_t taken = lockstep_take(&lockstep.line, bytes[i], &frame);
            if (taken == LOCKSTEP_FRAME) {
                take_line(&lockstep, &frame);
            } else if (taken == LOCKSTEP_GARBAGE && lockstep.ready) {
                put_lost(&lockstep);
            }
        }
        if (count == 0) {
            clock.api->sleep_until_us(clock.context, board_now_us() + WAIT_US);
        }
    }
}
