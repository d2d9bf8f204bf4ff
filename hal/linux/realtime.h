/* realtime.h - Linux's monotonic clock, waiting for a deadline or a frame, and how late the waits
 * end.
 *
 *     realtime_t timer;
 *     realtime_init(&timer, &wait);                    // wait: where frames come in, or NULL
 *     realtime_rights_t rights = realtime_ask(80, true); // optional; refusals are not fatal
 *     berth_clock_t clock = realtime_clock(&timer);
 *
 * One thread. now_us is CLOCK_MONOTONIC in microseconds, and may be called from any thread.
 */
#ifndef BERTH_HAL_REALTIME_H
#define BERTH_HAL_REALTIME_H

#include "berth_hal/clock.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

#ifdef __cplusplus
extern "C" {
#endif

/* ---- How late: a histogram with fixed bins
 * --------------------------------------------------------
 *
 * 0 to 15 us have a bin each; above, each octave has 8, so a bin is at most an eighth as wide as
 * its values are large. The last one takes everything from 2^24 us (17 s) on.
 */
#define REALTIME_BINS 177u

typedef struct {
    uint64_t count;
    int64_t max_us;
    uint64_t bins[REALTIME_BINS];
} realtime_histogram_t;

/* Adds a value; a negative one counts as 0. */
void realtime_histogram_add(realtime_histogram_t *histogram, int64_t late_us);

/* The largest value of the bin in which the quantile lies (never above max_us): at least the true
 * quantile, and at most an eighth more. share is from 0 to 1: 0.5 the median. 0 without values. */
int64_t realtime_histogram_quantile(const realtime_histogram_t *histogram, double share);

/* A bin's smallest value. */
int64_t realtime_bin_low_us(uint32_t bin);

/* One line of count, median, p99 and max, then a line a bin that has values. */
void realtime_histogram_print(const realtime_histogram_t *histogram, FILE *out);

/* ---- The clock
 * ------------------------------------------------------------------------------------ */

/* Where frames come in: tells the descriptor to wait on now, or -1 for none (no peer yet). Asked at
 * each wait, since a bus that comes back may have another one. */
typedef struct {
    int (*fd)(void *context);
    void *context;
} realtime_wait_t;

typedef struct {
    realtime_wait_t wait;      /* fd NULL: none */
    realtime_histogram_t late; /* of waits that lasted to their deadline */
    uint64_t early;            /* waits cut short by something to receive */
    uint64_t past;             /* deadlines that had passed when the wait was asked for */
    int64_t past_max_us;       /* by how much, at worst */
} realtime_t;

/* wait may be NULL. */
void realtime_init(realtime_t *timer, const realtime_wait_t *wait);

/* The clock; its context is the timer. Its sleep_until_us waits for the descriptor to be readable
 * until 100 us before the deadline, then for the absolute time alone. A descriptor that only
 * reports an error cuts the wait short too, but not before 1 ms has passed, so that a caller who
 * does not clear it does not spin. A signal may end a wait early. */
berth_clock_t realtime_clock(realtime_t *timer);

/* The time alone: CLOCK_MONOTONIC in microseconds. */
int64_t realtime_now_us(void);

/* count, median, p99 and max of the waits, and the deadlines that had passed. */
void realtime_print(const realtime_t *timer, FILE *out);

/* ---- Rights
 * ----------------------------------------------------------------------------------------
 *
 * What the system allows a process depends on its user and limits (CAP_SYS_NICE, RLIMIT_RTPRIO,
 * CAP_IPC_LOCK, RLIMIT_MEMLOCK). Whatever is refused is said, and the loop runs without it.
 */
typedef struct {
    int priority;       /* SCHED_FIFO priority in force; 0: none */
    int priority_errno; /* why it was refused; 0: granted, or not asked for */
    bool locked;        /* memory is locked */
    int locked_errno;   /* why not; 0: granted, or not asked for */
} realtime_rights_t;

/* priority: SCHED_FIFO's 1 to 99 for the calling thread, 0 not to ask. lock: all memory, now and
 * later. Also sets the thread's timer slack to the least, so that waits end as exactly as they can.
 */
realtime_rights_t realtime_ask(int priority, bool lock);

/* In words, for people. */
void realtime_rights_print(const realtime_rights_t *rights, FILE *out);

#ifdef __cplusplus
}
#endif

#endif
