#include "replay.h"

#include "berth/link.h"
#include "board_host.h"
#include "candump.h"
#include "record.h"
#include "refusal.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>

#define SETUP_MAX 65536

/* The record is read line by line; one line is looked at ahead. */
typedef struct {
    FILE *file;
    const char *path;
    char *text; /* of the line ahead */
    size_t text_size;
    unsigned long number; /* of the line ahead */
    candump_line_t ahead;
    bool ended;
    bool broken; /* *error is filled */
    scenario_error_t *error;
    berth_can_mode_t mode; /* told last */
    replay_result_t *result;
} reader_t;

static void break_off(reader_t *reader, const char *what) {
    if (!reader->broken) {
        reader->broken = true;
        (void)refuse(reader->error, "%s:%lu: %s", reader->path, reader->number, what);
    }
    reader->ended = true;
}

static void advance(reader_t *reader) {
    char why[CANDUMP_WHY_MAX];
    do {
        errno = 0;
        if (reader->ended || getline(&reader->text, &reader->text_size, reader->file) < 0) {
            /* NOLINTNEXTLINE(clang-analyzer-unix.Stream): replay_file closes it */
            if (!reader->ended && ferror(reader->file) != 0) {
                break_off(reader, strerror(errno));
            }
            reader->ended = true;
            return;
        }
        reader->number++;
    } while (reader->text[0] == '\n');
    if (strchr(reader->text, '\n') == NULL) {
        reader->ended = true; /* the last line of a board that lost its power is half of one */
    } else if (!candump_parse(reader->text, &reader->ahead, why)) {
        /* NOLINTNEXTLINE(clang-analyzer-unix.Malloc): replay_file frees it */
        break_off(reader, why);
    }
}

static bool ahead_is(const reader_t *reader, uint32_t id) {
    return !reader->ended && strcmp(reader->ahead.channel, RECORD_CHANNEL) == 0 &&
           reader->ahead.frame.id == id && !reader->ahead.frame.extended;
}

static bool ahead_is_frame(const reader_t *reader, candump_direction_t direction) {
    return !reader->ended && strcmp(reader->ahead.channel, RECORD_CHANNEL) != 0 &&
           reader->ahead.direction == direction;
}

/* --- a bus that answers as it did ------------------------------------------------------------- */

static void differ(reader_t *reader, const berth_can_frame_t *firmware) {
    replay_result_t *result = reader->result;
    char recorded[CANDUMP_FRAME_MAX];
    char now[CANDUMP_FRAME_MAX] = "nothing";
    if (!result->same) {
        return;
    }
    result->same = false;
    result->frame = result->sent + 1;
    result->line = reader->number;
    const bool was = ahead_is_frame(reader, CANDUMP_SENT);
    (void)snprintf(result->difference, sizeof result->difference,
                   "recorded %s, the firmware now sends %s",
                   was ? candump_frame_text(&reader->ahead.frame, recorded) : "nothing",
                   firmware != NULL ? candump_frame_text(firmware, now) : now);
    reader->ended = true;
}

static berth_can_outcome_t send(void *context, const berth_can_frame_t *frame) {
    reader_t *reader = context;
    if (reader->ended) {
        reader->result->cut = reader->result->same;
        return BERTH_CAN_AGAIN;
    }
    if (ahead_is(reader, RECORD_SEND_AGAIN) || ahead_is(reader, RECORD_SEND_FAILED)) {
        const bool again = ahead_is(reader, RECORD_SEND_AGAIN);
        advance(reader);
        return again ? BERTH_CAN_AGAIN : BERTH_CAN_FAILED;
    }
    if (!ahead_is_frame(reader, CANDUMP_SENT) || !candump_same(frame, &reader->ahead.frame)) {
        differ(reader, frame);
        return BERTH_CAN_AGAIN;
    }
    reader->result->sent++;
    advance(reader);
    return BERTH_CAN_DONE;
}

static berth_can_outcome_t receive(void *context, berth_can_frame_t *frame) {
    reader_t *reader = context;
    if (ahead_is(reader, RECORD_RECEIVE_FAILED)) {
        advance(reader);
        return BERTH_CAN_FAILED;
    }
    if (!ahead_is_frame(reader, CANDUMP_RECEIVED)) {
        return BERTH_CAN_AGAIN;
    }
    *frame = reader->ahead.frame;
    reader->result->received++;
    advance(reader);
    return BERTH_CAN_DONE;
}

static void state(void *context, berth_can_state_t *out) {
    reader_t *reader = context;
    if (ahead_is(reader, RECORD_MODE)) {
        if (reader->ahead.frame.length != 1 || reader->ahead.frame.data[0] > BERTH_CAN_DOWN) {
            break_off(reader, "no mode of a bus (allowed: one byte, 0 to 3)");
            return;
        }
        reader->mode = (berth_can_mode_t)reader->ahead.frame.data[0];
        advance(reader);
    }
    *out = (berth_can_state_t){.mode = reader->mode};
}

static const berth_can_api_t api = {send, receive, state};

/* --- the record's own events ------------------------------------------------------------------ */

/* The text in pieces at the record's beginning. On the heap; NULL when there is none. */
static char *read_setup(reader_t *reader) {
    char *text = calloc(1, SETUP_MAX + BERTH_CAN_DATA_MAX + 1);
    size_t used = 0;
    while (text != NULL && ahead_is(reader, RECORD_SETUP) && used < SETUP_MAX) {
        memcpy(text + used, reader->ahead.frame.data, reader->ahead.frame.length);
        used += reader->ahead.frame.length;
        advance(reader);
    }
    if (used == 0 && !reader->broken) {
        break_off(reader, "no record of berth-board (allowed: a file from berth-board --record)");
    }
    if (reader->broken) {
        free(text);
        return NULL;
    }
    return text;
}

static bool make_board(reader_t *reader, board_host_t *host) {
    board_recipe_t recipe;
    /* NOLINTNEXTLINE(clang-analyzer-unix.Malloc): replay_file frees it */
    char *text = read_setup(reader);
    if (text == NULL) {
        return false;
    }
    const bool parsed = board_recipe_parse(reader->path, text, &recipe, reader->error);
    free(text);
    if (!parsed) {
        reader->broken = true;
        return false;
    }
    if (!ahead_is(reader, RECORD_INIT) || reader->ahead.frame.length != 4) {
        break_off(reader, "no set-up event (allowed: 008 with four bytes)");
        return false;
    }
    if (!board_host_make(host, &recipe, reader->ahead.frame.time_us, reader->error)) {
        reader->broken = true;
        return false;
    }
    uint32_t crc = 0;
    memcpy(&crc, reader->ahead.frame.data, sizeof crc);
    if (crc != host->board.plan_crc) {
        board_host_free(host);
        break_off(reader, "the plan is not the one that was recorded: the reference's file or the "
                          "generator has changed");
        return false;
    }
    advance(reader);
    return true;
}

static void put_robot(reader_t *reader, berth_board_t *board) {
    berth_pose_t pose;
    const int64_t now_us = reader->ahead.frame.time_us;
    float place[2];
    memcpy(place, reader->ahead.frame.data, sizeof place);
    advance(reader);
    if (!ahead_is(reader, RECORD_PUT_HEADING)) {
        break_off(reader, "half a pose (allowed: 006, then 007)");
        return;
    }
    memcpy(&pose.theta_rad, reader->ahead.frame.data, sizeof pose.theta_rad);
    pose.x_m = place[0];
    pose.y_m = place[1];
    if (berth_board_set_pose(board, &pose, now_us) != BERTH_OK) {
        break_off(reader, "the board refuses this pose");
        return;
    }
    advance(reader);
}

/* One event and all that belongs to it. */
static void replay_event(reader_t *reader, berth_board_t *board, berth_link_t *link) {
    const int64_t now_us = reader->ahead.frame.time_us;
    if (ahead_is(reader, RECORD_RUN)) {
        advance(reader);
        reader->result->runs++;
        berth_link_run(link, now_us);
        if (ahead_is_frame(reader, CANDUMP_SENT)) { /* which the firmware has not sent */
            differ(reader, NULL);
        }
    } else if (ahead_is(reader, RECORD_COMMAND)) {
        const uint8_t code = reader->ahead.frame.data[0];
        advance(reader);
        berth_board_command(board, (berth_command_code_t)code, now_us);
    } else if (ahead_is(reader, RECORD_PUT)) {
        put_robot(reader, board);
    } else {
        break_off(reader, "an event out of place (allowed: run, command or pose)");
    }
}

static void replay(reader_t *reader, board_host_t *host) {
    const berth_can_t can = {&api, reader};
    berth_link_t link;
    berth_link_init(&link, &host->board, &can);
    while (!reader->ended) {
        replay_event(reader, &host->board, &link);
    }
    const berth_board_status_t *status = berth_board_status(&host->board);
    const char *side = berth_fault_side_text(status->fault);
    const char *fault = status->fault != BERTH_FAULT_NONE ? berth_fault_text(status->fault) : "";
    (void)snprintf(reader->result->state, sizeof reader->result->state, "%s%s%s%s",
                   berth_supervisor_state_text(status->state), fault[0] != '\0' ? ": " : "", side,
                   fault);
}

bool replay_file(const char *path, replay_result_t *result, scenario_error_t *error) {
    *result = (replay_result_t){.same = true};
    reader_t reader = {.path = path, .error = error, .mode = BERTH_CAN_DOWN, .result = result};
    board_host_t *host = malloc(sizeof *host);
    reader.file = fopen(path, "r");
    if (reader.file == NULL || host == NULL) {
        (void)refuse(error, "%s: cannot read: %s", path,
                     host == NULL ? "out of memory" : strerror(errno));
        reader.broken = true;
    } else {
        advance(&reader);
        if (!reader.broken && make_board(&reader, host)) {
            replay(&reader, host);
            board_host_free(host);
        }
    }
    if (reader.file != NULL) {
        (void)fclose(reader.file);
    }
    free(reader.text);
    free(host);
    return !reader.broken;
}
