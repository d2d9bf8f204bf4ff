/* berth-gen: a plan as text. */
#ifndef TOOLS_GEN_WRITE_H
#define TOOLS_GEN_WRITE_H

#include "berth/reference.h"
#include "scenario.h"

#include <stdio.h>

/* Room for a symbol, and for the name that a plan gets from its source. */
#define GEN_SYMBOL_MAX 64

/* Names the plan and says where it comes from. */
typedef struct {
    const char *symbol; /* passed gen_symbol_good */
    const char *source;
} gen_name_t;

/* A C identifier of at most GEN_SYMBOL_MAX - 1 characters that is neither a keyword nor reserved
 * (a leading underscore, a trailing _t). */
bool gen_symbol_good(const char *symbol);

/* berth_plan_circle; of a path, its file name without extension, with '_' for what C forbids. */
void gen_symbol_default(const char *source, char out[GEN_SYMBOL_MAX]);

/* k,x,y,theta,v,omega,k11,...,k23, one row a sample. */
void gen_write_csv(FILE *file, const berth_plan_t *plan);

/* Writes path (which ends in .c) and the header beside it, both or none. */
bool gen_write_c(const char *path, const berth_plan_t *plan, gen_name_t name,
                 scenario_error_t *error);

#endif
