/* berth/riccati.h - the optimal feedback gain K_k of one reference sample.
 *
 * The backward Riccati recursion over the horizon, specialised to the structure of the tracking
 * error's A and B: P is kept as its six distinct entries and B picks two rows (Euler) or has five
 * entries (zero-order hold). The generator calls it for the table, the board for a plan that
 * arrives at run time; both get the same bits.
 *
 * Method: finite-horizon linear quadratic regulator by dynamic programming; the input's two columns
 * are eliminated one after the other, as in sequential measurement updates (Anderson & Moore,
 * "Optimal Filtering", 1979).
 */
#ifndef BERTH_RICCATI_H
#define BERTH_RICCATI_H

#include "berth/reference.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Accuracy: in float32 within 1e-4 of the double-precision optimum, relative to the gain's row, as
 * long as max(q) / min(r) is at most 1e3; at 1e5 it is some 1e-2, and weights further apart are
 * beyond float32.
 *
 * Gain of sample k of a checked plan, over the plan's horizon. For k beyond the end of an open plan
 * it is the gain that holds the last pose. Pure; O(horizon), about 80 instructions a stage with
 * Euler and 350 with the zero-order hold; no dependence on the data beyond that. */
/*@ requires checked: 1 <= plan->count <= BERTH_PLAN_COUNT_MAX;
  @ requires checked: 1 <= plan->mpc.horizon <= BERTH_HORIZON_MAX; */
void berth_riccati_gain(const berth_plan_t *plan, uint32_t k, berth_gain_t *gain);

#ifdef __cplusplus
}
#endif

#endif
