/* pil_clock.h - real time for an emulated board.
 *
 * SysTick's interrupts are counted, and an emulator that the machine does not let run for more than
 * a millisecond loses some of them: its seconds become longer. The board's timer 0 counts on its
 * own. It is read here, 32 bits at 25 MHz: at least once in 170 s, or time is lost.
 */
#ifndef BERTH_BOARDS_PIL_CLOCK_H
#define BERTH_BOARDS_PIL_CLOCK_H

#include "berth_hal/clock.h"

/* Starts it at 0. There is one; one context. */
berth_clock_t pil_clock_start(void);

#endif
