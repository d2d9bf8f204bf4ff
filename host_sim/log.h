/* The log of a run: CSV, one row a period, numbers as %.9g. */
#ifndef HOST_SIM_LOG_H
#define HOST_SIM_LOG_H

#include "output_file.h"
#include "run.h"

typedef struct {
    output_file_t out;
} run_log_t;

/* Writes the header line. The log appears at path with run_log_commit, whole or not at all. */
bool run_log_open(run_log_t *log, const char *path, scenario_error_t *error);

/* The on_row of a run_sink_t whose context is the run_log_t. Trouble shows in run_log_commit. */
void run_log_row(void *log, const run_row_t *row);

bool run_log_commit(run_log_t *log, scenario_error_t *error);

/* Safe after a commit and on a zeroed struct. */
void run_log_discard(run_log_t *log);

#endif
