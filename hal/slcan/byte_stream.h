/* byte_stream.h - what slcan needs of a line of bytes: read some, write some, neither blocks.
 *
 * A serial port of a microcontroller, a tty, a socket. Both functions belong to one context.
 */
#ifndef BERTH_HAL_BYTE_STREAM_H
#define BERTH_HAL_BYTE_STREAM_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* The outcomes, and what each obliges the caller to.
 *
 *   DONE    at least one byte was read or written; *count says how many.
 *   AGAIN   nothing now: nothing to read, or no room. Try again later, not in a loop. *count is 0.
 *   FAILED  there is nobody at the other end. *count is 0. The stream recovers by itself where it
 *           can; the caller goes on calling. Between the bytes before a loss and those after it at
 *           least one call answers FAILED, so that no two halves of different lines are joined.
 */
typedef enum {
    BYTE_STREAM_DONE = 0,
    BYTE_STREAM_AGAIN = 1,
    BYTE_STREAM_FAILED = -1
} byte_stream_outcome_t;

typedef struct {
    /* At most room bytes, room >= 1. */
    byte_stream_outcome_t (*read)(void *context, uint8_t *bytes, size_t room, size_t *count);

    /* At most length bytes, length >= 1, from the front. */
    byte_stream_outcome_t (*write)(void *context, const uint8_t *bytes, size_t length,
                                   size_t *count);
} byte_stream_api_t;

typedef struct {
    const byte_stream_api_t *api;
    void *context;
} byte_stream_t;

#ifdef __cplusplus
}
#endif

#endif
