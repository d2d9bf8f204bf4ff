/* Do v and omega of a CSV reference fit its poses? The rule is in reference_source.h.
 *
 * It asks nothing about how the file was made: for a sampled smooth curve, for rows that are held
 * over a period, for differences of the poses and for jumps of curvature between two samples, means
 * and values interlace. A wrong column breaks the second half of the rule, a jump of the pose the
 * first. */
#include "reference_csv.h"

#include <math.h>

#define TURN 6.283185307179586

#define RELATIVE 0.02
#define V_TOLERANCE_MPS 0.005
#define OMEGA_TOLERANCE_RADPS 0.01

/* From one row to the next along the arc through both poses. */
typedef struct {
    double v;     /* mean speed */
    double omega; /* mean yaw rate */
    double slip;  /* displacement across the mean heading */
} step_t;

/* One quantity with its column and tolerance. */
typedef struct {
    int column;
    double tolerance;
    const char *unit;
} quantity_t;

static const quantity_t speed = {COLUMN_V, V_TOLERANCE_MPS, "m/s"};
static const quantity_t yaw_rate = {COLUMN_OMEGA, OMEGA_TOLERANCE_RADPS, "rad/s"};

static step_t step_between(const reference_row_t *from, const reference_row_t *to, double period) {
    const double turn = remainder(to->value[COLUMN_THETA] - from->value[COLUMN_THETA], TURN);
    const double half = 0.5 * turn;
    const double heading = from->value[COLUMN_THETA] + half;
    const double dx = to->value[COLUMN_X] - from->value[COLUMN_X];
    const double dy = to->value[COLUMN_Y] - from->value[COLUMN_Y];
    /* chord / arc; at half a turn and less it is at least 2 / pi */
    const double chord = fabs(half) < 1e-6 ? 1.0 : sin(half) / half;
    return (step_t){
        .v = (dx * cos(heading) + dy * sin(heading)) / (period * chord),
        .omega = turn / period,
        .slip = dy * cos(heading) - dx * sin(heading),
    };
}

/* Step k leads from row k to row k + 1. */
static step_t step_at(const reference_rows_t *rows, size_t k) {
    return step_between(&rows->rows[k], &rows->rows[k + 1], rows->period_s);
}

static double mean_of(step_t step, quantity_t quantity) {
    return quantity.column == COLUMN_V ? step.v : step.omega;
}

static double mean_at(const reference_rows_t *rows, size_t k, quantity_t quantity) {
    return mean_of(step_at(rows, k), quantity);
}

typedef struct {
    double low, high;
} band_t;

static band_t band_of(double value) {
    return (band_t){value, value};
}

static void widen(band_t *band, double value) {
    band->low = fmin(band->low, value);
    band->high = fmax(band->high, value);
}

static void add_tolerance(band_t *band, quantity_t quantity) {
    const double slack = quantity.tolerance + RELATIVE * fmax(fabs(band->low), fabs(band->high));
    band->low -= slack;
    band->high += slack;
}

static bool inside(double value, band_t band) {
    return value >= band.low && value <= band.high;
}

/* At the first and last rows there is no mean on the other side: where the line, and where the
 * parabola, through the nearest means lead is what it may have been. */
static void widen_beyond_end(band_t *band, const reference_rows_t *rows, bool first,
                             quantity_t quantity) {
    const size_t steps = rows->count - 1;
    double near[3];
    for (size_t i = 0; i < 3 && i < steps; i++) {
        near[i] = mean_at(rows, first ? i : steps - 1 - i, quantity);
    }
    if (steps >= 2) {
        widen(band, 2.0 * near[0] - near[1]);
    }
    if (steps >= 3) {
        widen(band, 3.0 * near[0] - 3.0 * near[1] + near[2]);
    }
}

/* The mean from row k to row k + 1 lies between the two rows' values. */
static bool check_mean(const reference_rows_t *rows, size_t k, quantity_t quantity,
                       scenario_error_t *error) {
    const double mean = mean_at(rows, k, quantity);
    band_t band = band_of(rows->rows[k].value[quantity.column]);
    widen(&band, rows->rows[k + 1].value[quantity.column]);
    add_tolerance(&band, quantity);
    return inside(mean, band) ||
           reference_refuse(rows, k + 1, quantity.column, error,
                            "the poses give %.6g %s from the row before to this one, "
                            "unlike the rows' own values (allowed: %.6g to %.6g)",
                            mean, quantity.unit, band.low, band.high);
}

static bool stands(const reference_row_t *row) {
    return row->value[COLUMN_V] == 0.0 && row->value[COLUMN_OMEGA] == 0.0;
}

/* The value of row k lies between the means before and after it. */
static bool check_value(const reference_rows_t *rows, size_t k, quantity_t quantity,
                        scenario_error_t *error) {
    const double value = rows->rows[k].value[quantity.column];
    const bool first = k == 0;
    const bool last = k + 1 == rows->count;
    if ((first || last) && stands(&rows->rows[k])) {
        return true; /* it starts or stops there at once */
    }
    band_t band = band_of(mean_at(rows, first ? 0 : k - 1, quantity));
    if (first || last) {
        widen_beyond_end(&band, rows, first, quantity);
    } else {
        widen(&band, mean_at(rows, k, quantity));
    }
    add_tolerance(&band, quantity);
    return inside(value, band) || reference_refuse(rows, k, quantity.column, error,
                                                   "%.6g %s disagrees with the poses "
                                                   "(allowed: %.6g to %.6g)",
                                                   value, quantity.unit, band.low, band.high);
}

/* The robot cannot move sideways. */
static bool check_slip(const reference_rows_t *rows, size_t k, scenario_error_t *error) {
    const step_t step = step_at(rows, k);
    const double period = rows->period_s;
    const double bend =
        fabs(rows->rows[k + 1].value[COLUMN_OMEGA] - rows->rows[k].value[COLUMN_OMEGA]) * period;
    const double most = period * (V_TOLERANCE_MPS + (RELATIVE + bend / 8.0) * fabs(step.v));
    return fabs(step.slip) <= most ||
           reference_refuse(rows, k + 1, COLUMN_THETA, error,
                            "the poses slip sideways by %.6g m from the row before "
                            "(allowed: %.6g to %.6g)",
                            step.slip, -most, most);
}

/* The step from the last row to the first may be half a period too long or too short, because a
 * lap is seldom a whole number of periods. */
static bool check_closing(const reference_rows_t *rows, scenario_error_t *error) {
    const reference_row_t *last = &rows->rows[rows->count - 1];
    const reference_row_t *first = &rows->rows[0];
    const double period = rows->period_s;
    const step_t step = step_between(last, first, period);
    const double v = 0.5 * (last->value[COLUMN_V] + first->value[COLUMN_V]);
    const double omega = 0.5 * (last->value[COLUMN_OMEGA] + first->value[COLUMN_OMEGA]);
    const double turn_off = fabs(remainder((step.omega - omega) * period, TURN));
    const double turn_most =
        period * (OMEGA_TOLERANCE_RADPS + (0.5 + RELATIVE) * fabs(omega)) +
        period * 0.5 * fabs(last->value[COLUMN_OMEGA] - first->value[COLUMN_OMEGA]);
    const double way_off = hypot((step.v - v) * period, step.slip);
    const double way_most = period * (V_TOLERANCE_MPS + (0.5 + RELATIVE) * fabs(v)) +
                            period * 0.5 * fabs(last->value[COLUMN_V] - first->value[COLUMN_V]);
    if (!(way_off <= way_most)) {
        return reference_refuse(rows, rows->count - 1, COLUMN_X, error,
                                "the first row is %.6g m off where a closed reference goes on "
                                "(allowed: 0 to %.6g)",
                                way_off, way_most);
    }
    return turn_off <= turn_most ||
           reference_refuse(rows, rows->count - 1, COLUMN_THETA, error,
                            "the first row is turned by %.6g rad from where a closed reference "
                            "goes on (allowed: 0 to %.6g)",
                            turn_off, turn_most);
}

bool reference_consistent(const reference_rows_t *rows, bool closed, scenario_error_t *error) {
    if (rows->count < 2) {
        return true;
    }
    for (size_t k = 0; k < rows->count; k++) {
        const bool good =
            (k == 0 || (check_mean(rows, k - 1, yaw_rate, error) &&
                        check_slip(rows, k - 1, error) && check_mean(rows, k - 1, speed, error))) &&
            check_value(rows, k, speed, error) && check_value(rows, k, yaw_rate, error);
        if (!good) {
            return false;
        }
    }
    return !closed || check_closing(rows, error);
}
