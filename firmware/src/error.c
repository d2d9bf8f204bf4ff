#include "berth/error.h"

#include "error_inline.h"

void berth_tracking_error(const berth_pose_t *pose, const berth_sample_t *sample,
                          berth_tracking_error_t *error) {
    *error = tracking_error_inline(pose, sample);
}
