/* stream.h - a byte_stream_t at a path: a tty or pty, or a unix socket at either end.
 *
 * What is at the path when it is opened decides, once:
 *
 *  - a character device must be a tty. Raw mode, 8 bits, no flow control, its speed as it is (set
 * it before, with stty). Unplugged or hung up, it is opened again when it returns.
 *  - a socket is connected to, and again after a loss. One that nobody listens on any more, left
 *    behind by a process that died, is replaced as if nothing was there.
 *  - nothing: a listening socket is made there. It takes one peer at a time, and the next one after
 *    a loss. Removed by stream_close.
 *
 * Nothing blocks, but stream_open for the moment in which another process opens a stream in the
 * same folder: they lock it, so that two that start at once agree on who listens. While there is no
 * peer, read and write answer FAILED; a lost peer is looked for in them, at most every 100 ms. A
 * socket's send queue is kept short (some 40 frames). One context.
 */
#ifndef BERTH_HAL_STREAM_H
#define BERTH_HAL_STREAM_H

#include "byte_stream.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define STREAM_PATH_MAX 96u /* characters; what a socket's address can hold, less a suffix */
#define STREAM_RETRY_US 100000

typedef enum { STREAM_CLOSED, STREAM_TTY, STREAM_CONNECT, STREAM_LISTEN } stream_kind_t;

/* The fields are stream.c's own. */
typedef struct {
    stream_kind_t kind;
    int fd;                 /* the peer, or -1 */
    int listener;           /* or -1 */
    int64_t retry_us;       /* not to be looked for before */
    uint32_t losses;        /* peers lost so far */
    uint64_t device, inode; /* of the listening socket: what stream_close may remove */
    char path[STREAM_PATH_MAX + 1u];
} stream_t;

/* False if the path cannot be used, with a sentence in error: what, where and why. A listening
 * socket without a peer yet is no failure. */
bool stream_open(stream_t *stream, const char *path, char *error, size_t error_size);

/* The stream; its context is stream. */
byte_stream_t stream_bytes(stream_t *stream);

/* The descriptor to wait on: the peer's, else the listener's, else -1. It changes with the peer. */
int stream_fd(const stream_t *stream);

/* Closes, and removes a socket that was made. Harmless when repeated. */
void stream_close(stream_t *stream);

#ifdef __cplusplus
}
#endif

#endif
