/* berth/error.h - the tracking error: pose and reference sample in, error in the robot's frame out.
 */
#ifndef BERTH_ERROR_H
#define BERTH_ERROR_H

#include "berth/types.h"

#ifdef __cplusplus
extern "C" {
#endif

/* e1 =  cos(theta) (x_r - x) + sin(theta) (y_r - y)
 * e2 = -sin(theta) (x_r - x) + cos(theta) (y_r - y)
 * e3 =  wrap(theta_r - theta)
 * Pure; constant cost; may be called from an interrupt. Bad input gives NaN, which the controller
 * refuses before it gets here. A pose angle far outside [-pi, pi] costs e3 the digits that it has
 * too many; the controller wraps it first. (Kanayama et al., ICRA 1990.) */
void berth_tracking_error(const berth_pose_t *pose, const berth_sample_t *sample,
                          berth_tracking_error_t *error);

#ifdef __cplusplus
}
#endif

#endif
