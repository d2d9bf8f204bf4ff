#include "pil_clock.h"

#include "mps2_board.h"

#define REGISTER(address) (*(volatile uint32_t *)(uintptr_t)(address))
#define TIMER_CONTROL REGISTER(0x40000000u)
#define TIMER_VALUE REGISTER(0x40000004u) /* counts down */
#define TIMER_RELOAD REGISTER(0x40000008u)
#define CONTROL_ENABLE 1u
#define TICKS_PER_US 25u

/* By the board's own clock, which may be slow: not for longer than this at once. */
#define SLEEP_MAX_US 2000

typedef struct {
    uint32_t last;
    uint64_t ticks;
} pil_clock_t;

static int64_t now_us(void *context) {
    pil_clock_t *clock = context;
    const uint32_t value = TIMER_VALUE;
    clock->ticks += (uint32_t)(clock->last - value);
    clock->last = value;
    return (int64_t)(clock->ticks / TICKS_PER_US);
}

static void sleep_until_us(void *context, int64_t deadline_us) {
    const berth_clock_t board = board_clock();
    const int64_t left_us = deadline_us - now_us(context);
    if (left_us > 0) {
        board.api->sleep_until_us(
            board.context, board_now_us() + (left_us < SLEEP_MAX_US ? left_us : SLEEP_MAX_US));
    }
}

berth_clock_t pil_clock_start(void) {
    static const berth_clock_api_t api = {now_us, sleep_until_us};
    static pil_clock_t clock;
    TIMER_CONTROL = 0;
    TIMER_RELOAD = UINT32_MAX;
    TIMER_VALUE = UINT32_MAX;
    TIMER_CONTROL = CONTROL_ENABLE;
    clock = (pil_clock_t){.last = TIMER_VALUE};
    return (berth_clock_t){&api, &clock};
}
