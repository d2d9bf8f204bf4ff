#include "berth/tracker.h"

#include "tracker_inline.h"

berth_twist_t berth_tracker_law(const berth_sample_t *sample, const berth_gain_t *gain,
                                const berth_tracking_error_t *error) {
    return tracker_law_inline(sample, gain, error);
}
