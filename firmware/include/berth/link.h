/* berth/link.h - moves frames between a board and a CAN bus. The whole of a main loop's body:
 *
 *     for (;;) {
 *         berth_link_run(&link, clock.api->now_us(clock.context));
 *         clock.api->sleep_until_us(clock.context, berth_link_deadline(&link));
 *     }
 *
 * One struct, one context. Never blocks, since the bus does not.
 */
#ifndef BERTH_LINK_H
#define BERTH_LINK_H

#include "berth/board.h"
#include "berth_hal/can.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Frames received in one run at most, so that a flooded bus cannot keep the board from its control
 * step: the rest waits in the platform's queue for the next run. */
#ifndef BERTH_LINK_RECEIVE_MAX
#define BERTH_LINK_RECEIVE_MAX 64u
#endif

/* While frames wait for room, a run is due this soon; while the bus fails, that soon. */
#define BERTH_LINK_RETRY_US 500
#define BERTH_LINK_FAILED_US 5000

typedef struct {
    berth_board_t *board;
    berth_can_t can;
    bool failed;         /* the last send or receive answered FAILED */
    bool more;           /* the last run left frames to receive */
    uint32_t send_again; /* sends that found no room */
    uint32_t failures;   /* sends and receives that answered FAILED */
    int64_t run_us;      /* time of the last run */
} berth_link_t;

void berth_link_init(berth_link_t *link, berth_board_t *board, const berth_can_t *can);

/* Tells the board how the bus is, hands it what was received (BERTH_LINK_RECEIVE_MAX at most), runs
 * what is due, and sends what waits until there is no room. */
void berth_link_run(berth_link_t *link, int64_t now_us);

/* When the next run is due, at the latest. */
int64_t berth_link_deadline(const berth_link_t *link);

#ifdef __cplusplus
}
#endif

#endif
