/* mps2_clock.h - Berth's clock over SysTick, for any Cortex-M that has one.
 *
 *     mps2_clock_start(&clock, 25000000);
 *     void SysTick's handler: mps2_clock_tick(&clock);
 *
 * SysTick interrupts once a millisecond; the time is the number of interrupts and SysTick's own
 * count, so it is exact to the microsecond. It is right as long as no interrupt is held off for a
 * millisecond. now_us may be called from any interrupt. One clock a processor.
 *
 * sleep_until_us waits for interrupts until the last millisecond, which it spends looking at the
 * time, so it is late by a few instructions only.
 */
#ifndef BERTH_HAL_MPS2_CLOCK_H
#define BERTH_HAL_MPS2_CLOCK_H

#include "berth_hal/clock.h"
#include "mps2_uart.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    volatile int64_t milliseconds;
    uint32_t ticks_per_us;
    const mps2_uart_t *wakes;
} mps2_clock_t;

/* clock_hz: the processor's, a multiple of 1 MHz up to 4 GHz. Starts at 0. */
void mps2_clock_start(mps2_clock_t *clock, uint32_t clock_hz);

/* Sleeping ends early when this port has received something; NULL: when nothing has. */
void mps2_clock_wake_by(mps2_clock_t *clock, const mps2_uart_t *uart);

/* To be called by SysTick's handler. */
void mps2_clock_tick(mps2_clock_t *clock);

berth_clock_t mps2_clock(mps2_clock_t *clock);

#ifdef __cplusplus
}
#endif

#endif
