/* rig_clock.h - a clock that a test sets. */
#ifndef BERTH_TESTS_RIG_CLOCK_H
#define BERTH_TESTS_RIG_CLOCK_H

#include "berth_hal/clock.h"

#include <stddef.h>
#include <stdint.h>

typedef struct {
    int64_t now_us;
    int64_t step_us; /* by which each look at it advances it */
} rig_clock_t;

static rig_clock_t rig_time;

static int64_t rig_now_us(void *context) {
    rig_clock_t *clock = context;
    clock->now_us += clock->step_us;
    return clock->now_us;
}

static inline berth_clock_t rig_clock(void) {
    static const berth_clock_api_t api = {rig_now_us, NULL};
    return (berth_clock_t){&api, &rig_time};
}

#endif
