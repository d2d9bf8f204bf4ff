/* What a run amounted to, for people (a table) and for scripts (JSON). */
#ifndef HOST_SIM_SUMMARY_H
#define HOST_SIM_SUMMARY_H

#include "run.h"

#include <jansson.h>
#include <stdio.h>

/* One run in a table. */
typedef struct {
    const char *title;
    run_summary_t summary;
} summary_column_t;

/* The summary under its stable keys, in a fixed order; values that are not finite are null. The
 * caller owns the object. NULL: out of memory. */
json_t *summary_json(const run_summary_t *summary);

/* A number, or null when it is not finite. */
json_t *summary_number(double value);

/* Writes a JSON document with full precision and a final newline, and releases it. False when it is
 * NULL or cannot be written. */
bool summary_write_json(FILE *file, json_t *document);

/* Runs side by side, one column each. */
void summary_print_table(FILE *file, const summary_column_t *columns, size_t count);

#endif
