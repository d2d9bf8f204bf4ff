/* Shared by the C tests: seeded random numbers, plans of the two shapes, references in double.
 *
 * Random draws come from one stream. Its seed is SUPPORT_SEED unless BERTH_TEST_SEED is set, and
 * support_random_start prints it, so that a failure can be repeated with the same numbers.
 */
#ifndef BERTH_TESTS_SUPPORT_H
#define BERTH_TESTS_SUPPORT_H

#include "berth/berth.h"

#include <stdbool.h>
#include <stdint.h>

#define SUPPORT_SEED 20240917u
#define SUPPORT_PLAN_MAX 1000u

/* Starts the stream and prints its seed. Call it first in every test that draws. */
void support_random_start(void);
double support_uniform(double low, double high);     /* in [low, high) */
double support_log_uniform(double low, double high); /* its logarithm is uniform */
uint32_t support_index(uint32_t count);              /* 0 to count - 1 */

/* How often to repeat: full; where BERTH_TEST_EFFORT is short a tenth of it, where it is a number n
 * the n-th part, at least 1. */
uint32_t support_runs(uint32_t full);

/* A plan with the memory for it. Not to be copied: the plan points into it. */
typedef struct {
    berth_sample_t samples[SUPPORT_PLAN_MAX];
    berth_gain_t gains[SUPPORT_PLAN_MAX];
    berth_plan_t plan;
} support_plan_t;

typedef enum { SUPPORT_CIRCLE, SUPPORT_EIGHT } support_shape_t;

/* The experiments' weights: N = 20, Q = diag(10, 40, 1), R = diag(0.5, 0.1), Euler. */
berth_mpc_t support_mpc(void);

/* A shape sampled each 50 ms, with the experiments' weights and online gains. Open: the first count
 * samples at the experiments' pace. Closed: count samples are one lap. */
void support_plan(support_plan_t *out, support_shape_t shape, uint32_t count, bool closed);

/* Computes the gain table from plan.samples and plan.mpc, and switches the plan to it. */
void support_fill_gains(support_plan_t *out);

/* In double: angle wrapped to [-pi, pi), and the pose after a held command (exact arc). */
typedef struct {
    double x_m, y_m, theta_rad;
} support_pose_t;

double support_wrap(double angle_rad);
support_pose_t support_move(support_pose_t pose, double v_mps, double omega_radps, double time_s);
berth_pose_t support_measure(support_pose_t pose); /* rounded to float32 */

/* The same bits; 0.0 and -0.0 differ, a NaN equals itself. */
bool support_same_bits(float a, float b);

#endif
