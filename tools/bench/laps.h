/* Laps with kicks: closed references, a robot that obeys, and poses that jump now and then. Shared
 * by the programs that count what one step of a tracker costs.
 *
 * The instruction counter is the target's (mps2_count.c): laps_since(mark) is the number of
 * instructions executed since laps_mark() gave the mark, what the two calls take included.
 */
#ifndef BERTH_TOOLS_LAPS_H
#define BERTH_TOOLS_LAPS_H

#include "berth/berth.h"

#include <stdint.h>

#define LAPS_COUNT_MAX 900
#define LAPS_TRACK_M 0.30f
#define LAPS_WHEEL_RADIUS_M 0.05f
#define LAPS_WHEEL_MAX_RADPS 16.0f /* 0.8 m/s at the rim */
#define LAPS_PERIOD_US 50000u
#define LAPS_KICK_EACH 40

typedef enum { LAPS_CIRCLE, LAPS_EIGHT } laps_shape_t;

typedef struct {
    const char *kind;
    laps_shape_t shape;
    double pace; /* 1: 0.3 rad/s round the circle, 0.15 rad/s round the eight */
    uint16_t horizon;
    uint32_t seed;
    int laps;
    bool kicks;
} laps_case_t;

/* The cases that are run for each horizon (theirs is 0): calm, kicked, and kicked on references
 * faster than the wheels. */
#define LAPS_CASES 14
extern const laps_case_t laps_cases[LAPS_CASES];

const char *laps_shape_name(laps_shape_t shape);

void laps_open(void); /* first of all */
uint32_t laps_mark(void);
uint32_t laps_since(uint32_t mark);

/* The closed plan of a case, with online gains. It stays valid until the next call. */
const berth_plan_t *laps_plan(const laps_case_t *chosen);

berth_limits_config_t laps_limits(void);

/* The robot and what kicks it. */
typedef struct {
    double x, y, theta;
    uint32_t random;
} laps_robot_t;

laps_robot_t laps_start(const laps_case_t *chosen);

/* Moves the robot through one period, and kicks it before every LAPS_KICK_EACH-th step. */
void laps_kick(laps_robot_t *robot, const laps_case_t *chosen, int step);
void laps_move(laps_robot_t *robot, berth_twist_t command);
double laps_distance2(const laps_robot_t *robot, const berth_sample_t *sample);
berth_tracking_error_t laps_error(const laps_robot_t *robot, const berth_sample_t *sample);

/* How far from optimal inputs u (N pairs) are: the farthest that a rim would move, alone, to lower
 * the cost, m/s, in double precision. */
double laps_residual(const berth_tracker_input_t *input, float rim_mps, const double *u);

#endif
