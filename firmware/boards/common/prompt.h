/* prompt.h - a prompt for people on a serial line: shows how the board is, and commands it.
 *
 *     prompt_init(&prompt, &board, &can, stream);
 *     each time round the main loop: prompt_run(&prompt, now_us);
 *
 * Commands, a line each: help, status, arm, start, stop, estop, reset, and pose X Y THETA in
 * millimetres and milliradians. What is typed is echoed; backspace works; lines longer than
 * PROMPT_LINE_MAX are refused. Changes of the board's state are told as they come.
 *
 * Never blocks, and does a bounded amount each time: PROMPT_BYTES bytes of input and one command.
 * While its answers wait to be written, no further command is taken. After a loss of input the line
 * that it was in is dropped.
 */
#ifndef BERTH_BOARDS_PROMPT_H
#define BERTH_BOARDS_PROMPT_H

#include "berth/board.h"
#include "berth_hal/can.h"
#include "byte_stream.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define PROMPT_LINE_MAX 48u
#define PROMPT_OUT_MAX 1024u
#define PROMPT_BYTES 16u

typedef struct {
    berth_board_t *board;
    berth_can_t can;
    byte_stream_t stream;
    char line[PROMPT_LINE_MAX + 1u];
    size_t length;
    bool too_long; /* the line was; what follows up to its end is thrown away */
    char out[PROMPT_OUT_MAX];
    size_t out_start;
    size_t out_end;
    berth_supervisor_state_t told_state;
    uint8_t told_fault;
} prompt_t;

/* board stays referenced. Writes the first prompt. */
void prompt_init(prompt_t *prompt, berth_board_t *board, const berth_can_t *can,
                 byte_stream_t stream);

void prompt_run(prompt_t *prompt, int64_t now_us);

/* A line of the program's own, "what: text", told as the state's changes are; cut off where there
 * is no room. */
void prompt_say(prompt_t *prompt, const char *what, const char *text);

#endif
