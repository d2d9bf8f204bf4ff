/* What the parts of the cost image share: the experiments, and figures to print. */
#ifndef BERTH_TESTS_TARGET_COST_H
#define BERTH_TESTS_TARGET_COST_H

#include "support.h"

#include <stddef.h>

/* One of the two experiments, its three obstacles and five more, of which one stands so close to
 * another that the robot has two to avoid at once. */
typedef struct {
    const char *name;
    support_shape_t shape;
    uint32_t count;
    support_pose_t start;
    berth_obstacle_t obstacles[8];
} cost_experiment_t;

extern const cost_experiment_t cost_experiments[2];

/* Figures are printed one a line: "name value". */
void cost_print(const char *name, uint32_t value);

/* Instructions of the same work over a run. */
typedef struct {
    uint32_t *values; /* on the heap */
    size_t count;
    size_t room;
} cost_series_t;

void cost_add(cost_series_t *series, uint32_t instructions);
void cost_print_series(const char *name, cost_series_t *series); /* median, max; empties it */

/* Ends the program with a line that says why. */
_Noreturn void cost_fail(const char *what);
void cost_require(berth_error_t error, const char *what);

/* Calls work, and returns how many bytes of stack were written below here. */
uint32_t cost_stack_of(void (*work)(void));

/* The parts. */
void cost_counter(void);    /* the counter itself, against a loop counted by hand */
void cost_controller(void); /* the control step and what it is made of */
void cost_gain(void);
void cost_messages(void);
void cost_board(void);
void cost_stack(void);
void cost_memory(void);

#endif
