/* berth_hal/can.h - what Berth needs of a CAN bus: send a frame, receive a frame, tell how it is.
 *
 * A platform fills in one constant berth_can_api_t and hands it out with its context. Classical CAN
 * 2.0 frames only. No function blocks, allocates, or calls back. All functions of one bus belong to
 * one context (a task or one interrupt level); the platform protects what it shares with its own
 * interrupts.
 */
#ifndef BERTH_HAL_CAN_H
#define BERTH_HAL_CAN_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define BERTH_CAN_DATA_MAX 8u
#define BERTH_CAN_STANDARD_MAX 0x7ffu
#define BERTH_CAN_EXTENDED_MAX 0x1fffffffu

typedef struct {
    int64_t time_us; /* received: when, on the platform's monotonic clock, as near to the wire as
                        the platform can tell. To be sent: not looked at. */
    uint32_t id;     /* 11 bits, or 29 where extended */
    bool extended;
    bool remote;    /* a request without data; length is the length asked for */
    uint8_t length; /* 0 to BERTH_CAN_DATA_MAX */
    uint8_t data[BERTH_CAN_DATA_MAX];
} berth_can_frame_t;

/* Which received frames are wanted: those with (frame id & mask) == (id & mask), of that format. */
typedef struct {
    uint32_t id;
    uint32_t mask;
    bool extended;
} berth_can_filter_t;

/* The three outcomes of send and receive, and what each obliges the caller to.
 *
 *   DONE    send: the bus has taken the frame and will put it on the wire, or count it in
 *           tx_dropped. It is not on the wire yet. receive: *frame is filled. A good platform
 *           takes no more frames ahead than leave within a control period: what waits with the
 *           caller can still be replaced by what is newer, or by a stop, and the caller sees that
 *           it waits; what the bus has taken leaves, however old it is by then.
 *   AGAIN   send: no room now. Nothing was taken; the caller keeps the frame or drops it, and tries
 *           again later, not in a loop. receive: nothing there; *frame is as it was.
 *   FAILED  the bus cannot be used now (down, unplugged, bus-off). Nothing was taken or received.
 *           state() says how it is. The caller stops what it controls, and may go on calling:
 *           the platform recovers by itself where it can.
 */
typedef enum { BERTH_CAN_DONE = 0, BERTH_CAN_AGAIN = 1, BERTH_CAN_FAILED = -1 } berth_can_outcome_t;

typedef enum {
    BERTH_CAN_ERROR_ACTIVE = 0,  /* all is well */
    BERTH_CAN_ERROR_PASSIVE = 1, /* an error counter is at 128 or more; frames still get through */
    BERTH_CAN_BUS_OFF = 2,       /* the controller has withdrawn from the bus */
    BERTH_CAN_DOWN = 3           /* no interface: not configured, switched off or unplugged */
} berth_can_mode_t;

/* Counters since the bus was opened; they only grow, and stay at their largest value. */
typedef struct {
    berth_can_mode_t mode;
    uint32_t rx_lost;      /* frames lost because nobody fetched them in time */
    uint32_t tx_dropped;   /* frames taken by send that never got onto the wire */
    uint32_t error_frames; /* bus errors seen */
    uint32_t restarts;     /* returns from bus-off or from down */
} berth_can_state_t;

typedef struct {
    /* Hands a frame over. frame->length at most 8, frame->id within its range; the platform answers
     * FAILED to a frame that breaks this. */
    berth_can_outcome_t (*send)(void *context, const berth_can_frame_t *frame);

    /* Fetches the oldest frame received. The bus's own frames are not among them. */
    berth_can_outcome_t (*receive)(void *context, berth_can_frame_t *frame);

    /* Tells the present state. Never fails; constant cost. */
    void (*state)(void *context, berth_can_state_t *state);
} berth_can_api_t;

typedef struct {
    const berth_can_api_t *api;
    void *context;
} berth_can_t;

#ifdef __cplusplus
}
#endif

#endif
