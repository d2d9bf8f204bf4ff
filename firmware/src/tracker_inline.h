/* The tracking law, inlined into the control step. Private to firmware/src. */
#ifndef BERTH_SRC_TRACKER_INLINE_H
#define BERTH_SRC_TRACKER_INLINE_H

#include "angle_inline.h"
#include "berth/tracker.h"

static inline berth_twist_t tracker_law_inline(const berth_sample_t *sample,
                                               const berth_gain_t *gain,
                                               const berth_tracking_error_t *error) {
    const float *k1 = gain->k[0];
    const float *k2 = gain->k[1];
    const float feedback_v = k1[0] * error->e1_m + k1[1] * error->e2_m + k1[2] * error->e3_rad;
    const float feedback_omega = k2[0] * error->e1_m + k2[1] * error->e2_m + k2[2] * error->e3_rad;
    return (berth_twist_t){
        .v_mps = sample->v_mps * berth_cos_inline(error->e3_rad) + feedback_v,
        .omega_radps = sample->omega_radps + feedback_omega,
    };
}

#endif
