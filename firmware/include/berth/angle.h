/* berth/angle.h - angles in float32 without libm: wrap, sine and cosine, arctangent, arcsine.
 *
 * Pure functions without state: any thread or interrupt may call them. All are odd or even to the
 * bit (sin(-x) == -sin(x), wrap(-x) == -wrap(x), atan2(-y, x) == -atan2(y, x)), so a mirrored scene
 * gives a mirrored run. Every result is the same on every target, because only + - * / and sqrt in
 * float32 are used, none of them fused.
 */
#ifndef BERTH_ANGLE_H
#define BERTH_ANGLE_H

#include "berth/types.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The float32 nearest to pi lies 8.7e-8 above pi; no float32 equals pi or -pi. */
#define BERTH_PI 3.14159265358979f

/* Wraps any finite angle to [-pi, pi), exact to 2e-6 rad however large the angle is: large angles
 * are reduced with enough bits of 1/(2 pi), in bounded time and without a loop over turns.
 * NaN and infinity give NaN. Cost: some 6 instructions up to pi,
 * 20 up to 3 pi, 40 up to 1.6e4 rad, 65 beyond. */
float berth_wrap(float angle_rad);

/* Sine and cosine of any finite angle, each within 2e-6. NaN and infinity give NaN in both. */
void berth_sincos(float angle_rad, float *sine, float *cosine);

/* Direction of the vector (x, y), in [-pi, pi] (float32 pi), within 2e-6 rad. (0, 0) gives 0.
 * NaN in either gives NaN. Finite arguments of any magnitude are good; infinite ones give NaN. */
float berth_atan2(float y, float x);

/* Arcsine within 2e-6 rad. Arguments outside [-1, 1] are taken as -1 or 1, because they arise from
 * rounding of quotients that are 1 in exact arithmetic. NaN gives NaN. */
float berth_asin(float x);

#ifdef __cplusplus
}
#endif

#endif
