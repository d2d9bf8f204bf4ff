/* Rows of the plan, inlined into the control step. Private to firmware/src. */
#ifndef BERTH_SRC_PLAN_INLINE_H
#define BERTH_SRC_PLAN_INLINE_H

#include "berth/angle.h"
#include "berth/reference.h"

/* Board code and tables rely on these layouts: 44 bytes of plan a sample. */
_Static_assert(sizeof(berth_sample_t) == 20u, "a sample is five floats without padding");
_Static_assert(sizeof(berth_gain_t) == 24u, "a gain is six floats without padding");

static inline float plan_period_s(uint32_t period_us) {
    return (float)period_us / 1.0e6f;
}

/* berth_plan_sample into *sample. */
static inline void plan_sample_inline(const berth_plan_t *plan, uint32_t k,
                                      berth_sample_t *sample) {
    const bool held = k >= plan->count && !plan->closed;
    if (k >= plan->count) {
        k = plan->closed ? k % plan->count : plan->count - 1u;
    }
    *sample = plan->samples[k];
    if (held) {
        sample->v_mps = 0.0f;
        sample->omega_radps = 0.0f;
    }
}

#endif
