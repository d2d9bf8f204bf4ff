/* What went on on the bus, for people (a table) and for scripts (JSON): beside a run's summary. */
#ifndef HOST_SIM_BUS_BUS_REPORT_H
#define HOST_SIM_BUS_BUS_REPORT_H

#include "session.h"

#include <jansson.h>
#include <stdio.h>

/* The figures of a session, or NULL when out of memory. The caller owns the object. */
json_t *bus_report_session_json(const bus_setup_t *setup, const session_result_t *result);
void bus_report_print_session(FILE *file, const bus_setup_t *setup, const session_result_t *result);

/* What a robot alone can tell. */
json_t *bus_report_robot_json(const bus_setup_t *setup, const bus_robot_result_t *result);
void bus_report_print_robot(FILE *file, const bus_setup_t *setup, const bus_robot_result_t *result);

#endif
