/* berth_hal/clock.h - what Berth's loops need of a clock: the time, and to wait for it.
 *
 * The firmware itself reads no clock; time is an argument of its functions. The loop around it
 * takes the time from here.
 */
#ifndef BERTH_HAL_CLOCK_H
#define BERTH_HAL_CLOCK_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    /* Microseconds since some fixed instant: never negative, never goes backwards, does not follow
     * changes of the wall clock. Received frames are stamped with the same clock. Does not block;
     * may be called from an interrupt. */
    int64_t (*now_us)(void *context);

    /* Blocks until now_us() >= deadline_us, or until there may be something to receive on the bus
     * that the platform ties to this clock, whichever is first. A deadline in the past returns at
     * once. May return early for other reasons too (a signal): the caller looks at now_us(). Never
     * from an interrupt. */
    void (*sleep_until_us)(void *context, int64_t deadline_us);
} berth_clock_api_t;

typedef struct {
    const berth_clock_api_t *api;
    void *context;
} berth_clock_t;

#ifdef __cplusplus
}
#endif

#endif
