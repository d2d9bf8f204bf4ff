/* Files that appear whole or not at all: written beside their place and renamed into it. */
#ifndef HOST_SIM_OUTPUT_FILE_H
#define HOST_SIM_OUTPUT_FILE_H

#include "scenario.h"

#include <stdio.h>

typedef struct {
    FILE *file;      /* to write to; NULL when closed */
    char *path;      /* where it will be */
    char *temporary; /* where it is until then; NULL when path is a device or a pipe */
} output_file_t;

/* A path that exists and is no regular file (a pipe, /dev/stdout) is written in place. On false
 * nothing was created and *error names the path and the reason. */
bool output_file_open(output_file_t *out, const char *path, scenario_error_t *error);

/* Puts the file in its place. On false (the disk is full, say) nothing is left behind. */
bool output_file_commit(output_file_t *out, scenario_error_t *error);

/* Removes what was written. Safe after a commit and on a zeroed struct. */
void output_file_discard(output_file_t *out);

#endif
