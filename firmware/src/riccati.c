#include "berth/riccati.h"

#include "berth/angle.h"

#define REAL float
#define REAL_SINCOS berth_sincos
#include "riccati_core.h"

void berth_riccati_gain(const berth_plan_t *plan, uint32_t k, berth_gain_t *gain) {
    riccati_gain(plan, k, gain->k);
}
