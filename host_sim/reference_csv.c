/* CSV references: strict reading of every cell, then the checks between the rows. */
#include "reference_csv.h"

#include "berth/angle.h"
#include "number.h"
#include "reference_source.h"
#include "refusal.h"

#include <errno.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define HEADER "t,x,y,theta,v,omega"
#define LINE_MAX_BYTES 512
#define TIME_TOLERANCE_S 1e-6
#define TURN 6.283185307179586

static const struct {
    const char *name;
    double minimum, maximum;
} columns[COLUMN_COUNT] = {
    {"t", 0.0, 1e6},
    {"x", -(double)BERTH_POSITION_MAX_M, (double)BERTH_POSITION_MAX_M},
    {"y", -(double)BERTH_POSITION_MAX_M, (double)BERTH_POSITION_MAX_M},
    /* headings may count turns; samples get them wrapped */
    {"theta", -1000.0, 1000.0},
    {"v", -(double)BERTH_SAMPLE_V_MAX_MPS, (double)BERTH_SAMPLE_V_MAX_MPS},
    {"omega", -(double)BERTH_SAMPLE_OMEGA_MAX_RADPS, (double)BERTH_SAMPLE_OMEGA_MAX_RADPS},
};

bool reference_refuse(const reference_rows_t *rows, size_t k, int column, scenario_error_t *error,
                      const char *format, ...) {
    char text[256];
    va_list arguments;
    va_start(arguments, format);
    (void)vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    return refuse(error, "%s:%zu: column %d (%s): %s", rows->path, k + 2, column + 1,
                  columns[column].name, text);
}

typedef enum { LINE_READ, LINE_END, LINE_TOO_LONG, LINE_ZERO_BYTE } line_t;

/* One line without its end (LF or CR LF). */
static line_t read_line(FILE *file, char line[LINE_MAX_BYTES]) {
    size_t length = 0;
    /* NOLINTNEXTLINE(clang-analyzer-unix.Stream): past the end it is EOF again */
    int c = fgetc(file);
    if (c == EOF) {
        return LINE_END;
    }
    /* NOLINTNEXTLINE(clang-analyzer-unix.Stream): EOF ends the loop */
    for (; c != EOF && c != '\n'; c = fgetc(file)) {
        if (c == '\0') {
            return LINE_ZERO_BYTE;
        }
        if (length + 1 == LINE_MAX_BYTES) {
            return LINE_TOO_LONG;
        }
        line[length++] = (char)c;
    }
    if (length > 0 && line[length - 1] == '\r') {
        length--;
    }
    line[length] = '\0';
    return LINE_READ;
}

/* --- cells ------------------------------------------------------------------------------- */

static bool parse_cell(const reference_rows_t *rows, int column, const char *cell, double *value,
                       scenario_error_t *error) {
    char excerpt[REFUSAL_EXCERPT_MAX];
    char range[NUMBER_RANGE_TEXT_MAX];
    number_range_text(columns[column].minimum, columns[column].maximum, range, sizeof range);
    refusal_excerpt(cell, excerpt, sizeof excerpt);
    if (!number_parse(cell, value)) {
        return reference_refuse(rows, rows->count, column, error,
                                "'%s' " NUMBER_REFUSED " (allowed: %s)", excerpt, range);
    }
    if (!(*value >= columns[column].minimum && *value <= columns[column].maximum)) {
        return reference_refuse(rows, rows->count, column, error,
                                "'%s' is out of range (allowed: %s)", excerpt, range);
    }
    return true;
}

/* Splits the line in place. */
static bool parse_row(const reference_rows_t *rows, char *line, reference_row_t *row,
                      scenario_error_t *error) {
    char *cell = line;
    for (int column = 0; column < COLUMN_COUNT; column++) {
        if (cell == NULL) {
            return reference_refuse(rows, rows->count, column, error,
                                    "missing (allowed: %d columns, " HEADER ")", COLUMN_COUNT);
        }
        char *comma = strchr(cell, ',');
        if (comma != NULL) {
            *comma = '\0';
        }
        if (!parse_cell(rows, column, cell, &row->value[column], error)) {
            return false;
        }
        cell = comma == NULL ? NULL : comma + 1;
    }
    return cell == NULL ||
           refuse(error, "%s:%zu: column %d: more than %d columns (allowed: " HEADER ")",
                  rows->path, rows->count + 2, COLUMN_COUNT + 1, COLUMN_COUNT);
}

/* --- rows -------------------------------------------------------------------------------- */

static bool append(reference_rows_t *rows, size_t *capacity, reference_row_t row,
                   scenario_error_t *error) {
    if (rows->count == (size_t)BERTH_PLAN_COUNT_MAX) {
        return refuse(error, "%s:%zu: column 1 (t): too many rows (allowed: 1 to %u)", rows->path,
                      rows->count + 2, BERTH_PLAN_COUNT_MAX);
    }
    if (rows->count == *capacity) {
        const size_t larger = *capacity == 0 ? 1024 : *capacity * 2;
        reference_row_t *grown = realloc(rows->rows, larger * sizeof *grown);
        if (grown == NULL) {
            return refuse(error, "%s: out of memory", rows->path);
        }
        rows->rows = grown;
        *capacity = larger;
    }
    rows->rows[rows->count++] = row;
    return true;
}

static bool refuse_line(const reference_rows_t *rows, line_t line, scenario_error_t *error) {
    return refuse(error,
                  "%s:%zu: column 1 (t): the line has %s (allowed: up to %d printable bytes)",
                  rows->path, rows->count + 2,
                  line == LINE_ZERO_BYTE ? "a zero byte" : "too many bytes", LINE_MAX_BYTES - 1);
}

static bool check_header(FILE *file, const char *path, scenario_error_t *error) {
    char line[LINE_MAX_BYTES];
    char excerpt[REFUSAL_EXCERPT_MAX];
    const line_t status = read_line(file, line);
    if (status == LINE_READ && strcmp(line, HEADER) == 0) {
        return true;
    }
    if (status != LINE_READ) {
        strcpy(line, "");
    }
    return refuse(error, "%s:1: column 1 (t): the header is '%s' (allowed: " HEADER ")", path,
                  refusal_excerpt(line, excerpt, sizeof excerpt));
}

/* Only the last line may be blank. */
static bool refuse_blank(const reference_rows_t *rows, FILE *file, scenario_error_t *error) {
    /* NOLINTNEXTLINE(clang-analyzer-unix.Stream): past the end it is EOF again */
    return fgetc(file) == EOF || refuse(error,
                                        "%s:%zu: column 1 (t): blank line between rows "
                                        "(allowed: " HEADER ")",
                                        rows->path, rows->count + 2);
}

static bool read_rows(FILE *file, reference_rows_t *rows, scenario_error_t *error) {
    char line[LINE_MAX_BYTES];
    size_t capacity = 0;
    for (;;) {
        reference_row_t row;
        const line_t status = read_line(file, line);
        if (status == LINE_END) {
            return true;
        }
        if (status != LINE_READ) {
            return refuse_line(rows, status, error);
        }
        if (line[0] == '\0') {
            return refuse_blank(rows, file, error);
        }
        if (!parse_row(rows, line, &row, error) || !append(rows, &capacity, row, error)) {
            return false;
        }
    }
}

static bool read_file(reference_rows_t *rows, scenario_error_t *error) {
    FILE *file = fopen(rows->path, "rb");
    if (file == NULL) {
        return refuse(error, "%s: cannot read: %s (allowed: a CSV file)", rows->path,
                      strerror(errno));
    }
    errno = 0;
    bool good = check_header(file, rows->path, error) && read_rows(file, rows, error);
    if (ferror(file) != 0) {
        good =
            refuse(error, "%s: cannot read: %s (allowed: a CSV file)", rows->path, strerror(errno));
    }
    (void)fclose(file);
    if (good && rows->count == 0) {
        good = reference_refuse(rows, 0, COLUMN_T, error, "no rows (allowed: 1 to %u)",
                                BERTH_PLAN_COUNT_MAX);
    }
    return good;
}

/* --- times ------------------------------------------------------------------------------- */

/* The period that the caller demands, or that of the first two rows to the microsecond. */
static bool find_period(reference_rows_t *rows, double period_s, scenario_error_t *error) {
    if (period_s > 0.0) {
        rows->period_s = period_s;
        return true;
    }
    if (rows->count < 2) {
        return reference_refuse(rows, rows->count, COLUMN_T, error,
                                "one row has no period (allowed: at least 2 rows)");
    }
    const double second = rows->rows[1].value[COLUMN_T];
    rows->period_s = round(second * 1e6) / 1e6;
    if (!(rows->period_s >= 0.001 && rows->period_s <= 1.0)) {
        return reference_refuse(rows, 1, COLUMN_T, error, "%.9g is no period (allowed: 0.001 to 1)",
                                second);
    }
    return true;
}

static bool check_times(const reference_rows_t *rows, scenario_error_t *error) {
    for (size_t k = 0; k < rows->count; k++) {
        const double t = rows->rows[k].value[COLUMN_T];
        const double due = (double)k * rows->period_s;
        if (!(fabs(t - due) <= TIME_TOLERANCE_S)) {
            return reference_refuse(rows, k, COLUMN_T, error,
                                    "%.9g is not the time of row %zu at a period of %.9g s "
                                    "(allowed: %.9g within 1e-06)",
                                    t, k, rows->period_s, due);
        }
    }
    return true;
}

/* --- samples ----------------------------------------------------------------------------- */

static float wrapped(double theta) {
    return (float)(fabs(theta) <= (double)BERTH_PI ? theta : remainder(theta, TURN));
}

static bool make_samples(const reference_rows_t *rows, reference_samples_t *out,
                         scenario_error_t *error) {
    /* NOLINTNEXTLINE(clang-analyzer-optin.portability.UnixAPI): there are rows, else refused */
    berth_sample_t *samples = calloc(rows->count, sizeof *samples);
    if (samples == NULL) {
        return refuse(error, "%s: out of memory", rows->path);
    }
    for (size_t k = 0; k < rows->count; k++) {
        const double *value = rows->rows[k].value;
        samples[k] = (berth_sample_t){
            .x_m = (float)value[COLUMN_X],
            .y_m = (float)value[COLUMN_Y],
            .theta_rad = wrapped(value[COLUMN_THETA]),
            .v_mps = (float)value[COLUMN_V],
            .omega_radps = (float)value[COLUMN_OMEGA],
        };
    }
    *out = (reference_samples_t){samples, rows->count, rows->period_s};
    return true;
}

bool reference_from_csv(const char *path, double period_s, bool closed, reference_samples_t *out,
                        scenario_error_t *error) {
    reference_rows_t rows = {.path = path};
    *out = (reference_samples_t){NULL, 0, 0.0};
    const bool good = read_file(&rows, error) && find_period(&rows, period_s, error) &&
                      check_times(&rows, error) && reference_consistent(&rows, closed, error) &&
                      make_samples(&rows, out, error);
    free(rows.rows);
    return good;
}
