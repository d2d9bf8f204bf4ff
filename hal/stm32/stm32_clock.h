/* stm32_clock.h - Berth's clock over SysTick, the core's own timer (any Cortex-M with SysTick).
 *
 *     stm32_clock_start(&clock, &config);
 *     SysTick's handler: stm32_clock_tick(&clock), before anything else in it
 *
 * SysTick interrupts once a millisecond; the time is the number of interrupts, in 64 bits, and
 * SysTick's count since the last one. It is exact to the microsecond and right as long as no
 * interrupt or masking holds SysTick's handler off for a millisecond. now_us may be called with
 * interrupts masked and from interrupts, except those that can interrupt SysTick's handler: an
 * interrupt that is pending is counted in. One clock a core.
 *
 * sleep_until_us waits for interrupts until the last millisecond, which it spends looking at the
 * time. It also ends when wakes() says that there is something to do (frames received); that is
 * looked at with interrupts masked, so that none slips in between the look and the sleep.
 */
#ifndef BERTH_HAL_STM32_CLOCK_H
#define BERTH_HAL_STM32_CLOCK_H

#include "berth_hal/clock.h"

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* SysTick (Arm, "ARMv7-M Architecture Reference Manual"), at STM32_SYSTICK_ADDRESS. */
typedef struct {
    volatile uint32_t csr;
    volatile uint32_t rvr;
    volatile uint32_t cvr;
} stm32_systick_t;

#define STM32_SYSTICK_ADDRESS 0xe000e010u
#define STM32_ICSR_ADDRESS 0xe000ed04u

typedef struct {
    stm32_systick_t *systick;
    volatile uint32_t *icsr;      /* the core's interrupt control and state register */
    uint32_t clock_hz;            /* of the core: a multiple of 1 MHz up to 4 GHz */
    bool (*wakes)(void *context); /* NULL: nothing but the time */
    void *wakes_context;
} stm32_clock_config_t;

typedef struct {
    stm32_clock_config_t config;
    uint32_t ticks_per_us;
    volatile uint32_t low;  /* milliseconds: written by the handler alone */
    volatile uint32_t high; /* of these, multiples of 2^32 */
} stm32_clock_t;

/* Starts at 0. False when clock_hz is not a multiple of 1 MHz, or 0, or too large. */
bool stm32_clock_start(stm32_clock_t *clock, const stm32_clock_config_t *config);

void stm32_clock_tick(stm32_clock_t *clock);

berth_clock_t stm32_clock(stm32_clock_t *clock);

#ifdef __cplusplus
}
#endif

#endif
