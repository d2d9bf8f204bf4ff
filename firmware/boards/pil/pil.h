/* pil.h - an image that is a whole drive board with two ODrives, nodes 1 and 2: plan in flash,
 * SLCAN on the board's second serial port, events as lines on its console. To be run with the robot
 * simulated on the other end of the line. What it does comes from the command line:
 *
 *     PLAN=circle|eight        which of the built-in experiments (circle)
 *     OBSTACLES=plan|bus       its obstacles are in flash too, or come over the bus (plan)
 *     MODE=live|lockstep       by the board's timer, or by the host's word: hal/slcan's lockstep.h
 *                              (live)
 *     SELF=1                   live: arms and starts by itself, and stops at the plan's end; else
 *                              all commands come as frames
 *     PATIENT=1                time-outs of seconds, for an emulator on a busy machine
 *     BREAK=stack|late|plan    live, for tests: what goes wrong 0.8 s after the start: the
 *                              stack overflows, the loop stands still for a second (PATIENT: four);
 *                              or before: the plan, copied into RAM, changes before it is armed
 */
#ifndef BERTH_BOARDS_PIL_H
#define BERTH_BOARDS_PIL_H

#include "berth/board.h"

#include <stdbool.h>
#include <stdint.h>

typedef enum { PIL_BREAK_NOTHING, PIL_BREAK_STACK, PIL_BREAK_LATE, PIL_BREAK_PLAN } pil_break_t;

typedef struct {
    bool eight;
    bool announced; /* OBSTACLES=bus */
    bool lockstep;
    bool self;
    bool patient;
    pil_break_t breaks;
} pil_options_t;

/* False when a word is not known: it is named on the console. */
bool pil_options(pil_options_t *options);

/* Sets a board up. plan: pil_plan's, or a copy. False when the firmware refuses. */
const berth_plan_t *pil_plan(const pil_options_t *options);
bool pil_setup(berth_board_t *board, const pil_options_t *options, const berth_plan_t *plan,
               int64_t now_us);

/* Both run until the end of the program and return its exit status. */
int pil_lockstep(const pil_options_t *options);
int pil_live(const pil_options_t *options);

/* What goes wrong on purpose; called in each round of the live loop. */
const berth_plan_t *pil_break_plan_copy(const berth_plan_t *plan);
void pil_break_plan(void);
void pil_break(const pil_options_t *options, const berth_board_t *board);

#endif
