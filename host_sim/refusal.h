/* How refused input is worded. */
#ifndef HOST_SIM_REFUSAL_H
#define HOST_SIM_REFUSAL_H

#include "scenario.h"

/* Writes the message and returns false, so that a check can end in `return refuse(...)`. */
bool refuse(scenario_error_t *error, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* The beginning of a text from outside, fit for one line of a message: control characters become
 * '?', and what does not fit becomes "...". size must be at least 4. Returns out. */
#define REFUSAL_EXCERPT_MAX 48
const char *refusal_excerpt(const char *text, char *out, size_t size);

#endif
