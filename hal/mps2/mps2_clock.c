#include "mps2_clock.h"

#include <stdbool.h>
#include <stddef.h>

/* MISRA D13, T4 in this file. */

#define REGISTER(address) (*(volatile uint32_t *)(uintptr_t)(address))
#define SYST_CSR REGISTER(0xe000e010u)
#define SYST_RVR REGISTER(0xe000e014u)
#define SYST_CVR REGISTER(0xe000e018u)
#define SCB_ICSR REGISTER(0xe000ed04u)

#define CSR_ENABLE_INTERRUPT_PROCESSOR 7u
#define ICSR_PENDSTSET ((uint32_t)1u << 26)

#define MILLISECOND_US 1000

/* The count since the last reload: at 0 the interrupt has just come up. */
static uint32_t ticks_since_reload(void) {
    const uint32_t left = SYST_CVR;
    return left == 0u ? 0u : SYST_RVR + 1u - left;
}

/* The handler may run between any two reads here, or be held off, when its interrupt is pending. */
static int64_t now_us(void *context) {
    const mps2_clock_t *clock = context;
    int64_t milliseconds;
    uint32_t ticks;
    bool pending;
    do {
        milliseconds = clock->milliseconds;
        ticks = ticks_since_reload();
        pending = (SCB_ICSR & ICSR_PENDSTSET) != 0u;
        if (pending) {
            ticks = ticks_since_reload();
        }
    } while (milliseconds != clock->milliseconds);
    const uint32_t us = ticks / clock->ticks_per_us;
    return (milliseconds + (pending ? 1 : 0)) * MILLISECOND_US + (int64_t)us;
}

static void sleep_until_us(void *context, int64_t deadline_us) {
    const mps2_clock_t *clock = context;
    for (;;) {
        const int64_t left_us = deadline_us - now_us(context);
        if (left_us <= 0 || (clock->wakes != NULL && mps2_uart_has_input(clock->wakes))) {
            return;
        }
        if (left_us > MILLISECOND_US) {
            __asm volatile("wfi" ::: "memory");
        }
    }
}

void mps2_clock_start(mps2_clock_t *clock, uint32_t clock_hz) {
    clock->milliseconds = 0;
    clock->ticks_per_us = clock_hz / 1000000u;
    clock->wakes = NULL;
    SYST_RVR = clock->ticks_per_us * 1000u - 1u;
    SYST_CVR = 0;
    SYST_CSR = CSR_ENABLE_INTERRUPT_PROCESSOR;
}

void mps2_clock_wake_by(mps2_clock_t *clock, const mps2_uart_t *uart) {
    clock->wakes = uart;
}

void mps2_clock_tick(mps2_clock_t *clock) {
    clock->milliseconds++;
}

berth_clock_t mps2_clock(mps2_clock_t *clock) {
    static const berth_clock_api_t api = {now_us, sleep_until_us};
    return (berth_clock_t){&api, clock};
}
