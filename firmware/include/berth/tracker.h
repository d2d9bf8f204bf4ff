/* berth/tracker.h - the tracking law: error, reference sample and gain in, body velocity out.
 *
 * Model predictive tracking without constraints is a linear feedback whose gain depends on the
 * reference alone, u = -K_k e, so all that is left to do here is to multiply. Limits come later.
 */
#ifndef BERTH_TRACKER_H
#define BERTH_TRACKER_H

#include "berth/types.h"

#ifdef __cplusplus
extern "C" {
#endif

/* v = v_r cos(e3) + (K e)_1,  omega = omega_r + (K e)_2. Pure; constant cost. */
berth_twist_t berth_tracker_law(const berth_sample_t *sample, const berth_gain_t *gain,
                                const berth_tracking_error_t *error);

#ifdef __cplusplus
}
#endif

#endif
