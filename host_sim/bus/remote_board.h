/* A board at the other end of a line that takes part in a session in lock-step: hal/slcan's
 * lockstep.h. What is there runs the same firmware, on an emulated microcontroller or a real one,
 * and makes the same run, to the bit.
 *
 *     remote_board_t board;
 *     remote_board_open(&board, "/tmp/line", &error)
 *     const session_remote_t remote = remote_board(&board);
 *     session_config_t config = {..., .remote = &remote};
 *     session_run(&config, ...)
 *     remote_board_close(&board);
 *
 * The board has its own plan, configuration and obstacles. At the begin they are compared by their
 * digest with those of the session, and the session is refused when they differ.
 */
#ifndef HOST_SIM_BUS_REMOTE_BOARD_H
#define HOST_SIM_BUS_REMOTE_BOARD_H

#include "lockstep.h"
#include "session.h"
#include "stream.h"

/* Without an answer for so long the board is lost. */
#define REMOTE_BOARD_PATIENCE_MS 10000

#define REMOTE_BOARD_OUT_MAX 8192u
#define REMOTE_BOARD_IN_MAX 4096u

typedef struct {
    unsigned long long trips;          /* questions answered */
    unsigned long long skipped;        /* runs at which the board had nothing to do */
    unsigned long long sent, received; /* bytes */
} remote_board_counts_t;

/* The fields are remote_board.c's own. Large, and must not move. */
typedef struct {
    stream_t stream;
    session_parts_t *parts;
    scenario_error_t error;
    bool lost; /* error is filled */
    remote_board_counts_t counts;
    int64_t deadline_us;
    int64_t time_us;       /* TIME told last */
    bool waiting;          /* frames of the board wait for room */
    berth_can_mode_t mode; /* told last */
    uint32_t room;
    uint64_t ready; /* value of the last READY */
    uint32_t counters[LOCKSTEP_COUNTS];
    lockstep_line_t line;
    size_t out_length, in_at, in_end;
    char out[REMOTE_BOARD_OUT_MAX];
    uint8_t in[REMOTE_BOARD_IN_MAX];
} remote_board_t;

/* path: as stream.h. False with *error filled. Nothing is said yet. */
bool remote_board_open(remote_board_t *board, const char *path, scenario_error_t *error);

session_remote_t remote_board(remote_board_t *board);

const remote_board_counts_t *remote_board_counts(const remote_board_t *board);

void remote_board_close(remote_board_t *board);

#endif
