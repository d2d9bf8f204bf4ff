/* Rows of a CSV reference, before they become samples. Private to reference_*.c. */
#ifndef HOST_SIM_REFERENCE_CSV_H
#define HOST_SIM_REFERENCE_CSV_H

#include "scenario.h"

enum { COLUMN_T, COLUMN_X, COLUMN_Y, COLUMN_THETA, COLUMN_V, COLUMN_OMEGA, COLUMN_COUNT };

typedef struct {
    double value[COLUMN_COUNT];
} reference_row_t;

/* All rows of one file. Row k stands in line k + 2. */
typedef struct {
    const char *path;
    reference_row_t *rows;
    size_t count;
    double period_s;
} reference_rows_t;

/* "FILE:LINE: column N (NAME): what (allowed: ...)", for the row with index k; always false. */
bool reference_refuse(const reference_rows_t *rows, size_t k, int column, scenario_error_t *error,
                      const char *format, ...) __attribute__((format(printf, 5, 6)));

/* Do headings, v and omega fit the poses? */
bool reference_consistent(const reference_rows_t *rows, bool closed, scenario_error_t *error);

#endif
