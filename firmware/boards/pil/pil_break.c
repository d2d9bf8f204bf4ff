#include "board.h"
#include "pil.h"

#include <string.h>

#define AFTER_STEPS 16u
#define STANDSTILL_US 1000000
#define STANDSTILL_PATIENT_US 4000000
#define COPY_MAX 1024u

static berth_sample_t samples[COPY_MAX];
static berth_gain_t gains[COPY_MAX];
static berth_plan_t copy;

const berth_plan_t *pil_break_plan_copy(const berth_plan_t *plan) {
    copy = *plan;
    memcpy(samples, plan->samples, plan->count * sizeof samples[0]);
    memcpy(gains, plan->gains, plan->count * sizeof gains[0]);
    copy.samples = samples;
    copy.gains = gains;
    return &copy;
}

/* One bit, as a failing memory would. */
void pil_break_plan(void) {
    uint32_t word;
    memcpy(&word, &samples[copy.count / 2].y_m, sizeof word);
    word ^= 1u << 9;
    memcpy(&samples[copy.count / 2].y_m, &word, sizeof word);
}

/* Without an end, but for the compiler, which sees that. */
__attribute__((noinline)) static uint32_t descend(volatile uint32_t *above) {
    volatile uint32_t here[64];
    here[0] = *above + 1u;
    here[63] = here[0] != 0 ? descend(here) : 0u;
    return here[63];
}

static void stand_still(int64_t duration_us) {
    const int64_t end_us = board_now_us() + duration_us;
    while (board_now_us() < end_us) {
    }
}

void pil_break(const pil_options_t *options, const berth_board_t *board) {
    static bool done;
    const berth_status_t *control = berth_board_control(board);
    if (done || berth_board_status(board)->state != BERTH_SUPERVISOR_RUNNING ||
        control->index < AFTER_STEPS) {
        return;
    }
    if (options->breaks == PIL_BREAK_STACK) {
        volatile uint32_t depth = 1;
        (void)descend(&depth);
    } else if (options->breaks == PIL_BREAK_LATE) {
        done = true;
        stand_still(options->patient ? STANDSTILL_PATIENT_US : STANDSTILL_US);
    }
}
