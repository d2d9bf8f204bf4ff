/* blank.h - a template for a port: every function that a platform gives Berth, with what to put
 * in. It compiles, and it is safe as it is: a board on it never moves.
 *
 * To port Berth to a new board: copy this folder, rename its three functions, and fill in the
 * bodies in blank.c, which say at each place what is expected. The contract is in berth_hal/can.h,
 * clock.h and log.h. A start-up file then does
 *
 *     berth_can_t can = blank_can();
 *     berth_clock_t clock = blank_clock();
 *     berth_link_init(&link, &board, &can);
 *     for (;;) {
 *         berth_link_run(&link, clock.api->now_us(clock.context));
 *         clock.api->sleep_until_us(clock.context, berth_link_deadline(&link));
 *     }
 *
 * As it is: send and receive answer FAILED, the mode is DOWN and all counters are 0; the time
 * stands at 0 and waiting returns at once, so that a board's loop spins instead of hanging; log
 * lines go nowhere.
 */
#ifndef BERTH_HAL_BLANK_H
#define BERTH_HAL_BLANK_H

#include "berth_hal/can.h"
#include "berth_hal/clock.h"
#include "berth_hal/log.h"

#ifdef __cplusplus
extern "C" {
#endif

berth_can_t blank_can(void);
berth_clock_t blank_clock(void);
berth_log_t blank_log(void);

#ifdef __cplusplus
}
#endif

#endif
