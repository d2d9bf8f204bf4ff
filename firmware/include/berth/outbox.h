/* berth/outbox.h - frames that wait to be sent.
 *
 * The firmware's modules put frames in; whoever owns the bus takes them out and sends them, oldest
 * first. A frame that tells the latest value of something (a speed command, a status) replaces the
 * one with the same id that still waits, so that a slow bus never carries stale commands.
 *
 * One outbox belongs to one context; nothing here may be shared with an interrupt.
 */
#ifndef BERTH_OUTBOX_H
#define BERTH_OUTBOX_H

#include "berth/types.h"
#include "berth_hal/can.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Capacity in frames, 8 to 255. Part of the layout of the structs, like BERTH_OBSTACLES_MAX. */
#ifndef BERTH_OUTBOX_MAX
#define BERTH_OUTBOX_MAX 24u
#endif

typedef enum {
    BERTH_OUTBOX_EACH = 0,  /* each such frame counts: commands, requests */
    BERTH_OUTBOX_LATEST = 1 /* only the latest frame with this id counts */
} berth_outbox_policy_t;

typedef struct {
    berth_can_frame_t frames[BERTH_OUTBOX_MAX]; /* a ring */
    uint8_t first;
    uint8_t count;
    uint32_t dropped; /* frames for which there was no room */
} berth_outbox_t;

/* Forgets all waiting frames and the count of dropped ones. */
void berth_outbox_reset(berth_outbox_t *outbox);

/* Forgets all waiting frames: before a stop, so that nothing older comes after it. */
void berth_outbox_clear(berth_outbox_t *outbox);

/* Appends a frame, or replaces the waiting one with the same id (policy LATEST; it keeps its
 * place). False when it is full: the frame is dropped and counted. O(capacity). */
bool berth_outbox_put(berth_outbox_t *outbox, const berth_can_frame_t *frame,
                      berth_outbox_policy_t policy);

/* The frame to send next, or NULL when none waits. Constant cost. */
const berth_can_frame_t *berth_outbox_front(const berth_outbox_t *outbox);

/* Removes the frame that berth_outbox_front gave, once it is sent. Nothing happens when none waits.
 */
void berth_outbox_pop(berth_outbox_t *outbox);

#ifdef __cplusplus
}
#endif

#endif
