#include "remote_board.h"

#include "berth/digest.h"
#include "refusal.h"

#include <poll.h>
#include <string.h>

/* Between two looks for a peer that is not there yet. */
#define LOOK_MS 20

static bool lose(remote_board_t *board, const char *what) {
    if (!board->lost) {
        (void)refuse(&board->error, "--board: %s (at %s)", what, board->stream.path);
    }
    board->lost = true;
    return false;
}

/* --- bytes -------------------------------------------------------------------------------- */

/* Waits until the line can be read or written. False: there is nobody, or nothing for too long. */
static bool wait_for(remote_board_t *board, short events, int *left_ms) {
    struct pollfd poll_fd = {.fd = stream_fd(&board->stream), .events = events};
    const int wait_ms = poll_fd.fd < 0 || board->stream.fd < 0 ? LOOK_MS : *left_ms;
    const int ready = poll(&poll_fd, poll_fd.fd < 0 ? 0 : 1, wait_ms);
    if (ready == 0) {
        *left_ms -= wait_ms;
    }
    return *left_ms > 0;
}

static bool flush(remote_board_t *board) {
    const byte_stream_t stream = stream_bytes(&board->stream);
    int left_ms = REMOTE_BOARD_PATIENCE_MS;
    size_t at = 0;
    while (at < board->out_length) {
        size_t count = 0;
        const byte_stream_outcome_t outcome = stream.api->write(
            stream.context, (const uint8_t *)board->out + at, board->out_length - at, &count);
        if (outcome == BYTE_STREAM_FAILED && board->counts.received > 0) {
            return lose(board, "the line was lost");
        }
        if (outcome != BYTE_STREAM_DONE && !wait_for(board, POLLOUT, &left_ms)) {
            return lose(board, board->stream.fd < 0 ? "there is nobody at the other end"
                                                    : "the board takes no bytes");
        }
        at += count;
    }
    board->counts.sent += board->out_length;
    board->out_length = 0;
    return true;
}

/* At least one byte. */
static bool refill(remote_board_t *board) {
    const byte_stream_t stream = stream_bytes(&board->stream);
    int left_ms = REMOTE_BOARD_PATIENCE_MS;
    board->in_at = board->in_end = 0;
    while (board->in_end == 0) {
        const byte_stream_outcome_t outcome =
            stream.api->read(stream.context, board->in, sizeof board->in, &board->in_end);
        if (outcome == BYTE_STREAM_FAILED) {
            return lose(board, "the line was lost");
        }
        if (outcome == BYTE_STREAM_AGAIN && !wait_for(board, POLLIN, &left_ms)) {
            return lose(board, "no answer from the board");
        }
    }
    board->counts.received += board->in_end;
    return true;
}

/* --- frames ------------------------------------------------------------------------------- */

static void put_frame(remote_board_t *board, const berth_can_frame_t *frame) {
    char text[SLCAN_LINE_MAX];
    const size_t length = slcan_encode(frame, text);
    if (board->out_length + length <= sizeof board->out) { /* holds a run's most, by far */
        memcpy(board->out + board->out_length, text, length);
        board->out_length += length;
    } else {
        (void)lose(board, "more to say than there is room for");
    }
}

static void put(remote_board_t *board, lockstep_kind_t kind, uint64_t value) {
    berth_can_frame_t frame;
    lockstep_encode(&frame, kind, value);
    put_frame(board, &frame);
}

static void put_time(remote_board_t *board, int64_t time_us) {
    if (board->time_us != time_us) {
        board->time_us = time_us;
        put(board, LOCKSTEP_TIME, (uint64_t)time_us);
    }
}

/* The next line that is a frame. */
static bool get_frame(remote_board_t *board, berth_can_frame_t *frame) {
    for (;;) {
        while (board->in_at < board->in_end) {
            const lockstep_take_t taken =
                lockstep_take(&board->line, board->in[board->in_at++], frame);
            if (taken == LOCKSTEP_FRAME) {
                return true;
            }
            if (taken == LOCKSTEP_GARBAGE && board->counts.trips > 0) {
                return lose(board, "the board's answer is not understood");
            }
        }
        if (!refill(board)) {
            return false;
        }
    }
}

/* --- answers ------------------------------------------------------------------------------ */

static void take_state(remote_board_t *board, uint64_t value) {
    berth_board_status_t *status = &board->parts->board.status;
    status->state = (berth_supervisor_state_t)(value & 0xffu);
    status->fault = (uint8_t)((value >> 8) & 0xffu);
    board->waiting = ((value >> 16) & 1u) != 0;
}

static void take_count(remote_board_t *board, uint64_t value) {
    const uint64_t index = value & 0xffu;
    if (index < LOCKSTEP_COUNTS) {
        board->counters[index] = (uint32_t)(value >> 8);
    }
}

static bool send_on(remote_board_t *board, const berth_can_frame_t *frame) {
    const berth_can_t *can = &board->parts->can;
    return can->api->send(can->context, frame) == BERTH_CAN_DONE ||
           lose(board, "the bus did not take a frame for which it had room");
}

/* One line of an answer. */
static bool take_line(remote_board_t *board, lockstep_kind_t kind, uint64_t value) {
    switch (kind) {
    case LOCKSTEP_READY:
        board->ready = value;
        return true;
    case LOCKSTEP_STATE:
        take_state(board, value);
        return true;
    case LOCKSTEP_COUNT:
        take_count(board, value);
        return true;
    case LOCKSTEP_DONE:
        board->deadline_us = value != 0 ? (int64_t)value : board->deadline_us;
        return true;
    default:
        return lose(board, "the board did not understand a line");
    }
}

/* Says what was put and takes the answer, up to a line of this kind. */
static bool ask(remote_board_t *board, lockstep_kind_t last) {
    lockstep_kind_t kind = LOCKSTEP_BEGIN;
    if (board->lost || !flush(board)) {
        return false;
    }
    while (kind != last) {
        berth_can_frame_t frame;
        uint64_t value = 0;
        if (!get_frame(board, &frame)) {
            return false;
        }
        if (!lockstep_decode(&frame, &kind, &value)) {
            /* before the begin's answer: the rest of a run that was broken off */
            if (last != LOCKSTEP_READY && !send_on(board, &frame)) {
                return false;
            }
        } else if ((last != LOCKSTEP_READY || kind == last) && !take_line(board, kind, value)) {
            return false;
        }
    }
    board->counts.trips++;
    return true;
}

/* --- the session's calls ------------------------------------------------------------------ */

static bool begin(void *context, session_parts_t *parts, int64_t now_us) {
    remote_board_t *board = context;
    char text[160];
    board->parts = parts;
    board->deadline_us = now_us;
    board->time_us = -1;
    board->mode = BERTH_CAN_ERROR_ACTIVE;
    board->room = LOCKSTEP_ROOM_MAX;
    board->waiting = false;
    board->counts = (remote_board_counts_t){0};
    board->out[0] = '\r'; /* ends a line that was broken off */
    board->out_length = 1;
    put(board, LOCKSTEP_BEGIN, (uint64_t)now_us);
    if (!ask(board, LOCKSTEP_READY)) {
        return false;
    }
    const uint32_t plan_crc = (uint32_t)(board->ready & UINT32_MAX);
    const uint32_t digest = (uint32_t)(board->ready >> 32);
    const uint32_t here = berth_board_digest(&parts->board);
    if (board->ready == 0) {
        return lose(board, "the board has refused its own configuration");
    }
    if (plan_crc != parts->board.plan_crc) {
        (void)snprintf(text, sizeof text, "the board has another plan: its CRC is %08lx, not %08lx",
                       (unsigned long)plan_crc, (unsigned long)parts->board.plan_crc);
        return lose(board, text);
    }
    if (digest != here) {
        (void)snprintf(text, sizeof text,
                       "the board has another configuration or other obstacles: its digest is "
                       "%08lx, not %08lx",
                       (unsigned long)digest, (unsigned long)here);
        return lose(board, text);
    }
    return true;
}

static uint32_t bits_of(float value) {
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

static bool set_pose(void *context, const berth_pose_t *pose, int64_t now_us) {
    remote_board_t *board = context;
    put_time(board, now_us);
    put(board, LOCKSTEP_POSE, bits_of(pose->x_m) | (uint64_t)bits_of(pose->y_m) << 32);
    put(board, LOCKSTEP_PUT, bits_of(pose->theta_rad));
    return ask(board, LOCKSTEP_DONE);
}

static bool command(void *context, berth_command_code_t code, int64_t now_us) {
    remote_board_t *board = context;
    put_time(board, now_us);
    put(board, LOCKSTEP_COMMAND, (uint64_t)code);
    return ask(board, LOCKSTEP_DONE);
}

/* How many frames the bus would take now; enough is as good as all. */
static uint32_t room_of(const session_parts_t *parts) {
    const uint32_t waiting = can_loop_waiting(&parts->loop, SESSION_NODE_BOARD);
    const uint32_t room = waiting < CAN_LOOP_TX_MAX ? CAN_LOOP_TX_MAX - waiting : 0u;
    return room < BERTH_OUTBOX_MAX ? room : LOCKSTEP_ROOM_MAX;
}

/* True when it is not as the board was told last. */
static bool put_bus(remote_board_t *board) {
    const berth_can_t *can = &board->parts->can;
    berth_can_state_t state = {.mode = BERTH_CAN_DOWN};
    can->api->state(can->context, &state);
    const uint32_t room = room_of(board->parts);
    const bool mode_changed = state.mode != board->mode;
    if (mode_changed || room != board->room) {
        board->mode = state.mode;
        board->room = room;
        put(board, LOCKSTEP_BUS, (uint64_t)state.mode | (uint64_t)room << 8);
    }
    return mode_changed;
}

static bool put_received(remote_board_t *board) {
    const berth_can_t *can = &board->parts->can;
    berth_can_frame_t frame;
    uint32_t count = 0;
    while (count < BERTH_LINK_RECEIVE_MAX &&
           can->api->receive(can->context, &frame) == BERTH_CAN_DONE) {
        put_time(board, frame.time_us);
        put_frame(board, &frame);
        count++;
    }
    return count > 0;
}

_Static_assert(BERTH_LINK_RECEIVE_MAX <= LOCKSTEP_FRAMES_MAX, "the board has room for a run");

/* A run before the deadline without news does nothing but try again to send. */
static bool run(void *context, int64_t now_us) {
    remote_board_t *board = context;
    const bool received = put_received(board);
    const bool changed = put_bus(board);
    if (!received && !changed && !board->waiting && now_us < board->deadline_us) {
        board->counts.skipped++;
        return !board->lost;
    }
    put_time(board, now_us);
    put(board, LOCKSTEP_RUN, 0);
    return ask(board, LOCKSTEP_DONE);
}

static int64_t deadline(const void *context) {
    const remote_board_t *board = context;
    return board->deadline_us;
}

static void fill_in(remote_board_t *board) {
    const uint32_t *counters = board->counters;
    berth_board_t *twin = &board->parts->board;
    berth_board_status_t *status = &twin->status;
    status->steps = counters[LOCKSTEP_COUNT_STEPS];
    status->late = counters[LOCKSTEP_COUNT_LATE];
    status->missed = counters[LOCKSTEP_COUNT_MISSED];
    status->latest_us = counters[LOCKSTEP_COUNT_LATEST_US];
    status->received = counters[LOCKSTEP_COUNT_RECEIVED];
    status->malformed = counters[LOCKSTEP_COUNT_MALFORMED];
    status->foreign = counters[LOCKSTEP_COUNT_FOREIGN];
    status->commands_refused = counters[LOCKSTEP_COUNT_COMMANDS_REFUSED];
    status->obstacles_refused = counters[LOCKSTEP_COUNT_OBSTACLES_REFUSED];
    twin->outbox.dropped = counters[LOCKSTEP_COUNT_OUTBOX_DROPPED];
    twin->drives[BERTH_LEFT].status.saturated = counters[LOCKSTEP_COUNT_SATURATED_LEFT];
    twin->drives[BERTH_RIGHT].status.saturated = counters[LOCKSTEP_COUNT_SATURATED_RIGHT];
    board->parts->link.send_again = counters[LOCKSTEP_COUNT_SEND_AGAIN];
    board->parts->link.failures = counters[LOCKSTEP_COUNT_FAILURES];
}

static bool end(void *context, scenario_error_t *error) {
    remote_board_t *board = context;
    if (!board->lost) {
        put(board, LOCKSTEP_ASK, 0);
        if (ask(board, LOCKSTEP_DONE)) {
            fill_in(board);
        }
    }
    if (board->lost) {
        *error = board->error;
    }
    return !board->lost;
}

/* --- opening ------------------------------------------------------------------------------ */

bool remote_board_open(remote_board_t *board, const char *path, scenario_error_t *error) {
    char why[256];
    memset(board, 0, sizeof *board);
    if (!stream_open(&board->stream, path, why, sizeof why)) {
        return refuse(error, "--board: %s", why);
    }
    return true;
}

session_remote_t remote_board(remote_board_t *board) {
    static const session_remote_api_t api = {begin, set_pose, command, run, deadline, end};
    return (session_remote_t){&api, board};
}

const remote_board_counts_t *remote_board_counts(const remote_board_t *board) {
    return &board->counts;
}

void remote_board_close(remote_board_t *board) {
    stream_close(&board->stream);
}
