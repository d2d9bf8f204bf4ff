#include "blank.h"

#include <stddef.h>

/* ---- CAN ---------------------------------------------------------------------------------------
 */

/* Fill in: write the frame to a free transmit buffer of the controller, or to a queue in front of
 * it that its transmit interrupt empties.
 *
 *  - DONE once it is in; AGAIN if there is no free buffer, and then nothing may have been taken;
 *  - FAILED if the id or the length is out of range, if the controller is bus-off or not set up;
 *  - frames in the queue when the controller goes bus-off are dropped and counted in tx_dropped:
 * old commands must not go out when the bus is back;
 *  - frames of the same id leave in the order in which they came;
 *  - switch the transmit interrupt off around the queue's indices, and nothing longer. */
static berth_can_outcome_t send(void *context, const berth_can_frame_t *frame) {
    (void)context;
    (void)frame;
    return BERTH_CAN_FAILED;
}

/* Fill in: take the oldest frame from the queue that the receive interrupt fills.
 *
 *  - the interrupt stamps each frame with the time at its start, with the clock below;
 *  - a queue that is full keeps the old frames or the new ones, as you like, and counts in rx_lost
 *    those it loses; the controller's own overrun flag counts too;
 *  - set the acceptance filters to the ids in use, so that a flooded bus does not fill the queue;
 *  - AGAIN when the queue is empty, FAILED when it is and the controller is not on the bus. */
static berth_can_outcome_t receive(void *context, berth_can_frame_t *frame) {
    (void)context;
    (void)frame;
    return BERTH_CAN_FAILED;
}

/* Fill in: the controller's error state, and the counters that the interrupts keep.
 *
 *  - ERROR_PASSIVE from the controller's flag (an error counter at 128 or more), BUS_OFF likewise;
 *  - leave bus-off the way the controller demands it (128 times 11 recessive bits are waited for by
 *    hardware), at most once a second or so, and count it in restarts;
 *  - counters only grow, and stay at their largest value. */
static void state(void *context, berth_can_state_t *out) {
    (void)context;
    *out = (berth_can_state_t){.mode = BERTH_CAN_DOWN};
}

berth_can_t blank_can(void) {
    static const berth_can_api_t api = {send, receive, state};
    return (berth_can_t){&api, NULL}; /* the context: your struct, with registers and queues */
}

/* ---- Clock -------------------------------------------------------------------------------------
 */

/* Fill in: microseconds from a timer that runs on. Extend a counter of 32 bits to 64, with the
 * overflow interrupt or, if this is called more often than it wraps, by the difference to the last
 * value (switch interrupts off around that). */
static int64_t now_us(void *context) {
    (void)context;
    return 0;
}

/* Fill in: wait for the next interrupt (WFI) until the deadline, or until there is something to
 * receive. The timer must wake the processor at the deadline. */
static void sleep_until_us(void *context, int64_t deadline_us) {
    (void)context;
    (void)deadline_us;
}

berth_clock_t blank_clock(void) {
    static const berth_clock_api_t api = {now_us, sleep_until_us};
    return (berth_clock_t){&api, NULL};
}

/* ---- Log ---------------------------------------------------------------------------------------
 */

/* Fill in: write the line and its end to a serial port. Or leave the log out: .api = NULL. */
static void log_line(void *context, const char *text) {
    (void)context;
    (void)text;
}

berth_log_t blank_log(void) {
    static const berth_log_api_t api = {log_line};
    return (berth_log_t){&api, NULL};
}
