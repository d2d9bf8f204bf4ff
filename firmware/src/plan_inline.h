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

/* Row of a sample that is within the plan or, in a closed one, laps beyond it; the last row past
 * the end of an open plan, whose velocities do not hold there. */
static inline const berth_sample_t *plan_row_inline(const berth_plan_t *plan, uint32_t k) {
    if (k < plan->count) {
        return &plan->samples[k];
    }
    return &plan->samples[plan->closed ? k % plan->count : plan->count - 1];
}

static inline void plan_sample_inline(const berth_plan_t *plan, uint32_t k,
                                      berth_sample_t *sample) {
    *sample = *plan_row_inline(plan, k);
    if (k >= plan->count && !plan->closed) {
        sample->v_mps = 0.0f;
        sample->omega_radps = 0.0f;
    }
}

#endif
