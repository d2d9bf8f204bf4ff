/* What must hold of a board whatever is done to it, checked after each call and for each frame.
 *
 *     watch_begin      after berth_board_init
 *     watch_given      before each berth_board_receive
 *     watch_call       after each call
 *     watch_step       after berth_board_step, besides
 *     watch_sent       for each frame taken out
 */
#ifndef BERTH_TESTS_FUZZ_BOARD_WATCH_H
#define BERTH_TESTS_FUZZ_BOARD_WATCH_H

#include "berth/board.h"

typedef struct {
    const berth_board_t *board;
    berth_board_config_t config;
    int64_t begin_us;
    float wheel_max_radps; /* what the configured limits leave */
    bool latched;          /* in FAULT */
    uint8_t fault;         /* and why */
    bool reset;            /* the next call may be a reset */
    uint32_t given;        /* frames */
    uint32_t digest;       /* of all that went out */
    berth_board_status_t last;
} watch_t;

void watch_begin(watch_t *watch, const berth_board_t *board, const berth_board_config_t *config,
                 int64_t now_us);

/* A frame is about to be given, or a command: a reset is the only way out of a fault. */
void watch_given(watch_t *watch, const berth_can_frame_t *frame);
void watch_command(watch_t *watch, berth_command_code_t command);

void watch_call(watch_t *watch);
void watch_step(watch_t *watch, int64_t now_us);
void watch_sent(watch_t *watch, const berth_can_frame_t *frame, int64_t now_us);

#endif
