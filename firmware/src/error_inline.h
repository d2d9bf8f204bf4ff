/* The tracking error, inlined into the control step. Private to firmware/src. */
#ifndef BERTH_SRC_ERROR_INLINE_H
#define BERTH_SRC_ERROR_INLINE_H

#include "angle_inline.h"
#include "berth/error.h"

static inline berth_tracking_error_t tracking_error_inline(const berth_pose_t *pose,
                                                           const berth_sample_t *sample) {
    float sine;
    float cosine;
    berth_sincos(pose->theta_rad, &sine, &cosine); /* a call: another copy costs 150 bytes */
    const float dx = sample->x_m - pose->x_m;
    const float dy = sample->y_m - pose->y_m;
    return (berth_tracking_error_t){
        .e1_m = cosine * dx + sine * dy,
        .e2_m = cosine * dy - sine * dx,
        .e3_rad = berth_wrap_inline(sample->theta_rad - pose->theta_rad),
    };
}

#endif
