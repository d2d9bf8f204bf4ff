#include "pose_delay.h"

#include <math.h>

void pose_delay_init(pose_delay_t *delay, const scenario_t *scenario) {
    /* a run without delay need not touch the ring */
    delay->periods = scenario->plant.pose_delay_s / scenario->period_s;
    delay->count = 0;
}

/* The pose of so many periods ago. */
static const pose_delay_pose_t *ago(const pose_delay_t *delay, long periods) {
    const long number = delay->count - 1 - periods;
    return &delay->poses[(number > 0 ? number : 0) % POSE_DELAY_ROOM];
}

berth_pose_t pose_delay_measure(pose_delay_t *delay, plant_t *plant) {
    if (delay->periods <= 0.0) {
        return plant_measure(plant);
    }
    delay->poses[delay->count % POSE_DELAY_ROOM] =
        (pose_delay_pose_t){plant->x_m, plant->y_m, plant->theta_rad};
    delay->count++;
    const double whole = floor(delay->periods);
    const double part = delay->periods - whole;
    const pose_delay_pose_t *late = ago(delay, (long)whole);
    const pose_delay_pose_t *early = part > 0.0 ? ago(delay, (long)whole + 1) : late;
    const double turn = plant_wrap(early->theta_rad - late->theta_rad);
    return plant_measure_at(plant, late->x_m + part * (early->x_m - late->x_m),
                            late->y_m + part * (early->y_m - late->y_m),
                            plant_wrap(late->theta_rad + part * turn));
}
