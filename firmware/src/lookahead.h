/* Look-ahead along the reference for the choice of side. Private to firmware/src.
 *
 * For each obstacle: the reference's first sample outside the regulated radius after one inside, at
 * most BERTH_SCAN_AHEAD samples ahead. The scan rolls along with the reference, a few samples a
 * step. It touches only the side on which an obstacle is passed, never whether a heading is free.
 */
#ifndef BERTH_SRC_LOOKAHEAD_H
#define BERTH_SRC_LOOKAHEAD_H

#include "berth/avoid.h"

/* Forgets sides and turns, starts the scan of every obstacle at the current sample and runs it to
 * its end. */
void lookahead_start(berth_avoid_t *avoid, berth_obstacles_t *obstacles, const berth_plan_t *plan,
                     const berth_reference_t *reference);

/* One step: a bounded number of samples for one obstacle, each in turn. An exit that the
 * reference has passed is dropped once the robot is outside the regulated radius too. */
void lookahead_advance(berth_avoid_t *avoid, berth_obstacles_t *obstacles, const berth_plan_t *plan,
                       const berth_reference_t *reference, const berth_pose_t *pose);

/* The sample beyond the obstacle; NULL while none is known. */
const berth_sample_t *lookahead_exit(const berth_obstacle_slot_t *slot, const berth_plan_t *plan,
                                     const berth_reference_t *reference);

#endif
