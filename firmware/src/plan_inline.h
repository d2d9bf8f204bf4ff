/* Rows of the plan, inlined into the control step. Private to firmware/src. */
#ifndef BERTH_SRC_PLAN_INLINE_H
#define BERTH_SRC_PLAN_INLINE_H

#include "berth/angle.h"
#include "berth/reference.h"

/* Board code and tables rely on these layouts: 44 bytes of plan a sample. */
_Static_assert(sizeof(berth_sample_t) == 20, "a sample is five floats without padding");
_Static_assert(sizeof(berth_gain_t) == 24, "a gain is six floats without padding");

static inline float plan_period_s(const berth_plan_t *plan) {
    return (float)plan->period_us / 1.0e6f;
}

static inline berth_sample_t plan_sample_inline(const berth_plan_t *plan, uint32_t k) {
    if (k < plan->count) {
        return plan->samples[k];
    }
    if (plan->closed) {
        return plan->samples[k % plan->count];
    }
    berth_sample_t hold = plan->samples[plan->count - 1];
    hold.v_mps = 0.0f;
    hold.omega_radps = 0.0f;
    return hold;
}

#endif
