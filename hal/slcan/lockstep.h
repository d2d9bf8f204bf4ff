/* lockstep.h - a board at the other end of an slcan line that lives in virtual time: the host says
 * when it is, and the board computes and answers. Nothing depends on how long that takes, so a run
 * is the same each time, to the bit.
 *
 * All is lines of slcan's form, a return after each. Frames of the bus stand as they are. What else
 * there is to say goes by data frames with the extended ids LOCKSTEP_ID | kind, which the bus must
 * not have. Their data is one unsigned number, little endian, without the zero bytes at its end.
 * Times are microseconds; float32 stand as their bits.
 *
 *     to the board                          what
 *     BEGIN    time                         be set up anew, as at this time. Answer: READY
 *     TIME     time                         of all that follows, until the next TIME
 *     BUS      mode | room << 8             how the bus is from here on, and how many frames it
 *                                           would take in one run (LOCKSTEP_ROOM_MAX: all)
 *     POSE     x | y << 32                  first part
 *     PUT      theta                        the robot is put there. Answer: DONE
 *     COMMAND  berth_command_code_t         Answer: DONE
 *     a frame                               received at TIME; LOCKSTEP_FRAMES_MAX in one run
 *     RUN                                   do all that is due at TIME. Answer: frames, then DONE
 *     ASK                                   for the counters. Answer: COUNTs, then DONE
 *
 *     from the board
 *     READY    plan's CRC | digest << 32    0: the board has refused its configuration
 *     a frame                               sent in this run
 *     STATE    state | fault << 8 | waiting << 16, where it is not as told before: waiting, frames
 *                                           have found no room
 *     DONE     time                         when it wants to run again, at the latest; 0: as told
 *                                           before
 *     COUNT    index | number << 8          LOCKSTEP_COUNT_ in order
 *     LOST                                  a line was not understood: the run is worth nothing
 *
 * Portable C11: no heap, no I/O. One context.
 */
#ifndef BERTH_HAL_LOCKSTEP_H
#define BERTH_HAL_LOCKSTEP_H

#include "berth_hal/can.h"
#include "slcan.h"

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define LOCKSTEP_ID 0x1fff0000u
#define LOCKSTEP_FRAMES_MAX 64u
#define LOCKSTEP_ROOM_MAX 255u

typedef enum {
    LOCKSTEP_BEGIN = 0x01,
    LOCKSTEP_TIME = 0x02,
    LOCKSTEP_BUS = 0x03,
    LOCKSTEP_POSE = 0x04,
    LOCKSTEP_PUT = 0x05,
    LOCKSTEP_COMMAND = 0x06,
    LOCKSTEP_RUN = 0x07,
    LOCKSTEP_ASK = 0x08,
    LOCKSTEP_READY = 0x81,
    LOCKSTEP_STATE = 0x82,
    LOCKSTEP_DONE = 0x83,
    LOCKSTEP_COUNT = 0x84,
    LOCKSTEP_LOST = 0x85
} lockstep_kind_t;

typedef enum {
    LOCKSTEP_COUNT_STEPS,
    LOCKSTEP_COUNT_LATE,
    LOCKSTEP_COUNT_MISSED,
    LOCKSTEP_COUNT_LATEST_US,
    LOCKSTEP_COUNT_RECEIVED,
    LOCKSTEP_COUNT_MALFORMED,
    LOCKSTEP_COUNT_FOREIGN,
    LOCKSTEP_COUNT_COMMANDS_REFUSED,
    LOCKSTEP_COUNT_OBSTACLES_REFUSED,
    LOCKSTEP_COUNT_OUTBOX_DROPPED,
    LOCKSTEP_COUNT_SEND_AGAIN,
    LOCKSTEP_COUNT_FAILURES,
    LOCKSTEP_COUNT_SATURATED_LEFT,
    LOCKSTEP_COUNT_SATURATED_RIGHT,
    LOCKSTEP_COUNTS
} lockstep_count_t;

/* A control frame. */
void lockstep_encode(berth_can_frame_t *frame, lockstep_kind_t kind, uint64_t value);

/* True if it is one, of whatever kind and length up to 8. */
bool lockstep_decode(const berth_can_frame_t *frame, lockstep_kind_t *kind, uint64_t *value);

/* Lines from bytes. Zeroed at first. */
typedef struct {
    char text[SLCAN_LINE_MAX];
    uint32_t length; /* so far; SLCAN_LINE_MAX: too long */
} lockstep_line_t;

typedef enum {
    LOCKSTEP_MORE,   /* the line goes on, or was empty */
    LOCKSTEP_FRAME,  /* *frame is filled */
    LOCKSTEP_GARBAGE /* a line ended that was no frame */
} lockstep_take_t;

/* Takes the next byte. */
lockstep_take_t lockstep_take(lockstep_line_t *line, uint8_t byte, berth_can_frame_t *frame);

#ifdef __cplusplus
}
#endif

#endif
