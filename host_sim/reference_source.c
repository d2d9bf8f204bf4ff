#include "reference_source.h"

#include "refusal.h"

#include <math.h>
#include <stdlib.h>

#define CIRCLE_RATE 0.3
#define EIGHT_RATE 0.15 /* along x; twice that along y */
#define EIGHT_X_M 1.8
#define EIGHT_Y_M 1.2
#define PI 3.14159265358979323846

/* Position on a plane curve and its derivatives in time. */
typedef struct {
    double x, y, xd, yd, xdd, ydd;
} curve_t;

static curve_t circle_at(double t) {
    const double w = CIRCLE_RATE;
    const double c = cos(w * t);
    const double s = sin(w * t);
    return (curve_t){c, s, -w * s, w * c, -w * w * c, -w * w * s};
}

static curve_t eight_at(double t) {
    const double w = EIGHT_RATE;
    const double w2 = 2.0 * EIGHT_RATE;
    const double s = sin(w * t);
    const double s2 = sin(w2 * t);
    return (curve_t){
        .x = EIGHT_X_M * s,
        .y = EIGHT_Y_M * s2,
        .xd = EIGHT_X_M * w * cos(w * t),
        .yd = EIGHT_Y_M * w2 * cos(w2 * t),
        .xdd = -EIGHT_X_M * w * w * s,
        .ydd = -EIGHT_Y_M * w2 * w2 * s2,
    };
}

/* A unicycle on the curve: heading along the velocity, yaw rate = curvature times speed. */
static berth_sample_t sample_of(curve_t at) {
    const double v = hypot(at.xd, at.yd);
    const double theta = atan2(at.yd, at.xd);
    return (berth_sample_t){
        .x_m = (float)at.x,
        .y_m = (float)at.y,
        .theta_rad = (float)(theta < PI ? theta : -PI),
        .v_mps = (float)v,
        .omega_radps = (float)((at.xd * at.ydd - at.yd * at.xdd) / (v * v)),
    };
}

static curve_t shape_at(shape_t shape, double t_s) {
    return shape == SHAPE_CIRCLE ? circle_at(t_s) : eight_at(t_s);
}

void reference_shape_pose(shape_t shape, double t_s, double *x_m, double *y_m, double *theta_rad) {
    const curve_t at = shape_at(shape, t_s);
    *x_m = at.x;
    *y_m = at.y;
    *theta_rad = atan2(at.yd, at.xd);
}

double reference_lap_s(shape_t shape) {
    return 2.0 * PI / (shape == SHAPE_CIRCLE ? CIRCLE_RATE : EIGHT_RATE);
}

bool reference_from_shape(shape_t shape, double period_s, double duration_s,
                          reference_samples_t *out, scenario_error_t *error) {
    const double count = round(duration_s / period_s);
    *out = (reference_samples_t){NULL, 0, 0.0};
    /* the negated form refuses NaN as well */
    if (!(count >= 1.0 && count <= (double)BERTH_PLAN_COUNT_MAX)) {
        return refuse(error,
                      "duration_s: %.9g s, at a period of %.9g s, gives %.9g samples "
                      "(allowed: 1 to %u samples)",
                      duration_s, period_s, count, BERTH_PLAN_COUNT_MAX);
    }
    berth_sample_t *samples = calloc((size_t)count, sizeof *samples);
    if (samples == NULL) {
        return refuse(error, "duration_s: out of memory for %.0f samples", count);
    }
    for (size_t k = 0; k < (size_t)count; k++) {
        const double t = (double)k * period_s;
        samples[k] = sample_of(shape_at(shape, t));
    }
    *out = (reference_samples_t){samples, (size_t)count, period_s};
    return true;
}

void reference_samples_free(reference_samples_t *samples) {
    free(samples->samples);
    *samples = (reference_samples_t){NULL, 0, 0.0};
}
