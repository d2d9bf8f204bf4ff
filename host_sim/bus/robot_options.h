/* The command line of berth-robot. */
#ifndef HOST_SIM_BUS_ROBOT_OPTIONS_H
#define HOST_SIM_BUS_ROBOT_OPTIONS_H

#include "bus_setup.h"

#include <stdint.h>

/* Exit status. */
#define ROBOT_OK 0
#define ROBOT_FAILED 1
#define ROBOT_USAGE 2

/* Strings point into argv. */
typedef struct {
    const char *can;      /* see can_open.h */
    const char *scenario; /* the argument */
    const char *log_path; /* NULL: none */
    const char **sets;
    size_t set_count;
    bool json;
    uint64_t seed;
    uint64_t timeout_s; /* without a board before the run */
    bus_setup_t setup;
} robot_options_t;

/* Bad usage ends the process with ROBOT_USAGE. False: it has complained. */
bool robot_options_parse(robot_options_t *options, int argc, char **argv);
void robot_options_free(robot_options_t *options);

/* "berth-robot: " and the message, as one line on stderr. */
void robot_complain(const char *format, ...) __attribute__((format(printf, 1, 2)));

#endif
