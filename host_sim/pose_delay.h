/* A localisation that takes time: the pose that the robot measures is so old. Put around
 * plant_measure where control steps are all that happens; on the bus the delay is the pose fixes'.
 *
 *     pose_delay_init(&delay, scenario);
 *     for each period: pose = pose_delay_measure(&delay, &plant);    at its start
 */
#ifndef HOST_SIM_POSE_DELAY_H
#define HOST_SIM_POSE_DELAY_H

#include "plant.h"

#define POSE_DELAY_MAX_S 0.5
#define POSE_DELAY_ROOM 512 /* periods: those of the longest delay at the shortest period */

typedef struct {
    double x_m, y_m, theta_rad;
} pose_delay_pose_t;

typedef struct {
    double periods;                           /* the delay */
    long count;                               /* poses noted so far */
    pose_delay_pose_t poses[POSE_DELAY_ROOM]; /* the last ones, as a ring */
} pose_delay_t;

/* The robot has stood for longer than the delay where it is when first measured. */
void pose_delay_init(pose_delay_t *delay, const scenario_t *scenario);

/* The pose of the delay ago, plus noise, in float32. Between two periods' starts it is on the
 * straight line between them. */
berth_pose_t pose_delay_measure(pose_delay_t *delay, plant_t *plant);

#endif
