/* Where references come from: the built-in shapes, and CSV files with the header
 * t,x,y,theta,v,omega. Both give float32 samples, ready for a plan. */
#ifndef HOST_SIM_REFERENCE_SOURCE_H
#define HOST_SIM_REFERENCE_SOURCE_H

#include "berth/reference.h"
#include "scenario.h"

/* Samples on the heap; release with reference_samples_free. */
typedef struct {
    berth_sample_t *samples;
    size_t count;
    double period_s;
} reference_samples_t;

/* round(duration / period) samples of x_r = cos(0.3 t), y_r = sin(0.3 t) (circle) or
 * x_r = 1.8 sin(0.15 t), y_r = 1.2 sin(0.30 t) (eight), evaluated in double precision.
 * shape is SHAPE_CIRCLE or SHAPE_EIGHT. False: out of memory or a bad count, *error says which. */
bool reference_from_shape(shape_t shape, double period_s, double duration_s,
                          reference_samples_t *out, scenario_error_t *error);

/* Position and heading of a shape at a time, in double precision. */
void reference_shape_pose(shape_t shape, double t_s, double *x_m, double *y_m, double *theta_rad);

/* Time for one lap of SHAPE_CIRCLE or SHAPE_EIGHT. */
double reference_lap_s(shape_t shape);

/* Reads a CSV reference. period_s > 0 demands that period; 0 takes the file's own.
 * Refused, with file, line and column: a wrong header, a wrong number of columns, anything that is
 * not a finite number in range, times that do not start at 0 or are not uniform within 1e-6 s, and
 * v or omega that disagree with the poses.
 *
 * What agreement means: let m_k be the mean speed from row k to row k + 1 along the circular arc
 * through both poses (its length / T; beyond the first and last rows the means go on along a line
 * or a parabola, and these two rows may also have v = omega = 0). Values and means must interlace,
 * each with a tolerance of 0.005 m/s + 2 %:
 *
 *     m_k between v_k and v_k+1        (a gap or a wrong pose breaks this)
 *     v_k between m_k-1 and m_k        (a wrong v breaks this)
 *
 * and likewise omega and the mean yaw rate, with 0.01 rad/s + 2 %. Across its mean heading a step
 * may deviate by T (0.005 m/s + (0.02 + |omega_k+1 - omega_k| T / 8) |m_k|). An error of 10 % is
 * caught from 0.07 m/s and 0.13 rad/s on where the motion is steady. Headings may count turns; the
 * robot must turn by less than half a turn a period. When closed, the step from the last row to the
 * first may be up to half a period longer or shorter: a lap is seldom a whole number of periods. */
bool reference_from_csv(const char *path, double period_s, bool closed, reference_samples_t *out,
                        scenario_error_t *error);

void reference_samples_free(reference_samples_t *samples);

#endif
