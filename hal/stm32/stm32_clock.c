#include "stm32_clock.h"

#include "stm32_io.h"

#include <stddef.h>

#define CSR_ENABLE STM32_BIT(0)
#define CSR_TICKINT STM32_BIT(1)
#define CSR_CLKSOURCE STM32_BIT(2)
#define ICSR_PENDSTSET STM32_BIT(26)

#define MHZ 1000000u
#define MILLISECOND_US 1000
#define RELOAD_MAX 0xffffffu

_Static_assert(UINT32_MAX / MHZ <= RELOAD_MAX / (uint32_t)MILLISECOND_US,
               "a millisecond of any clock fits the counter");

typedef struct {
    uint32_t low;
    uint32_t high;
} count_t;

static count_t read_count(const stm32_clock_t *clock) {
    count_t count;
    do {
        count.high = clock->high;
        count.low = clock->low;
    } while (count.high != clock->high);
    return count;
}

/* At 0 the interrupt has just come up, and the reload is the next tick's. */
static uint32_t ticks_since_reload(const stm32_clock_t *clock) {
    const uint32_t left = stm32_read(&clock->config.systick->cvr);
    return left == 0u ? 0u : clock->ticks_per_us * (uint32_t)MILLISECOND_US - left;
}

/* The handler may run between any two reads here, or be held off while its interrupt pends. */
static int64_t now_us(void *context) {
    const stm32_clock_t *clock = context;
    count_t count;
    uint32_t ticks;
    bool pending;
    do {
        count = read_count(clock);
        ticks = ticks_since_reload(clock);
        pending = (stm32_read(clock->config.icsr) & ICSR_PENDSTSET) != 0u;
        if (pending) {
            ticks = ticks_since_reload(clock);
        }
    } while (count.low != clock->low);
    const uint64_t milliseconds = (((uint64_t)count.high << 32) | count.low) + (pending ? 1u : 0u);
    const uint32_t us = ticks / clock->ticks_per_us;
    return (int64_t)milliseconds * MILLISECOND_US + (int64_t)us;
}

static bool is_woken(const stm32_clock_t *clock) {
    return clock->config.wakes != NULL && clock->config.wakes(clock->config.wakes_context);
}

static void sleep_until_us(void *context, int64_t deadline_us) {
    const stm32_clock_t *clock = context;
    for (;;) {
        /* deadline - now would overflow for deadlines at the ends of the range. */
        const int64_t now = now_us(context);
        if (deadline_us <= now || is_woken(clock)) {
            return;
        }
        if (deadline_us - MILLISECOND_US > now) {
            const uint32_t before = stm32_io_mask();
            if (!is_woken(clock)) {
                stm32_io_wait();
            }
            stm32_io_unmask(before);
        }
    }
}

bool stm32_clock_start(stm32_clock_t *clock, const stm32_clock_config_t *config) {
    const uint32_t ticks_per_us = config->clock_hz / MHZ;
    *clock = (stm32_clock_t){.config = *config, .ticks_per_us = ticks_per_us};
    if (ticks_per_us == 0u || config->clock_hz % MHZ != 0u) {
        clock->ticks_per_us = 1;
        return false;
    }
    stm32_write(&config->systick->csr, 0);
    stm32_write(&config->systick->rvr, ticks_per_us * (uint32_t)MILLISECOND_US - 1u);
    stm32_write(&config->systick->cvr, 0);
    stm32_write(&config->systick->csr, CSR_ENABLE | CSR_TICKINT | CSR_CLKSOURCE);
    return true;
}

void stm32_clock_tick(stm32_clock_t *clock) {
    const uint32_t low = clock->low + 1u;
    if (low == 0u) { /* MISRA T6: it wraps */
        clock->high = clock->high + 1u;
    }
    clock->low = low;
}

berth_clock_t stm32_clock(stm32_clock_t *clock) {
    static const berth_clock_api_t api = {now_us, sleep_until_us};
    return (berth_clock_t){&api, clock};
}
