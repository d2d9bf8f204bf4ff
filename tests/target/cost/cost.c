/* Prints what the firmware costs on this board: executed instructions, stack and RAM. Read by
 * tools/lib/target_cost.py. */
#include "cost.h"

#include "counter.h"

#include <stdio.h>
#include <stdlib.h>

/* The first three of each are the experiment's own. */
const cost_experiment_t cost_experiments[2] = {
    {
        .name = "circle",
        .shape = SUPPORT_CIRCLE,
        .count = 600,
        .start = {0.8, -0.2, 1.2},
        .obstacles =
            {
                {0.073f, 1.027f, 0.10f, 0.20f, 0.40f},
                {-0.947f, -0.250f, 0.10f, 0.20f, 0.40f},
                {0.492f, -0.928f, 0.10f, 0.20f, 0.40f},
                {0.45f, 1.25f, 0.10f, 0.20f, 0.40f},
                {0.0f, 0.0f, 0.10f, 0.20f, 0.40f},
                {1.6f, 1.6f, 0.10f, 0.20f, 0.40f},
                {-1.6f, 1.6f, 0.10f, 0.20f, 0.40f},
                {-1.6f, -1.6f, 0.10f, 0.20f, 0.40f},
            },
    },
    {
        .name = "eight",
        .shape = SUPPORT_EIGHT,
        .count = 900,
        .start = {-0.2, -0.15, 0.3},
        .obstacles =
            {
                {1.706f, 0.821f, 0.10f, 0.18f, 0.38f},
                {1.025f, -1.077f, 0.12f, 0.20f, 0.40f},
                {-1.730f, -0.545f, 0.15f, 0.23f, 0.43f},
                {1.62f, 1.30f, 0.10f, 0.18f, 0.38f},
                {0.0f, 1.6f, 0.10f, 0.18f, 0.38f},
                {0.0f, -1.6f, 0.10f, 0.18f, 0.38f},
                {2.4f, 0.0f, 0.10f, 0.18f, 0.38f},
                {-2.4f, 0.0f, 0.10f, 0.18f, 0.38f},
            },
    },
};

void cost_print(const char *name, uint32_t value) {
    printf("%s %lu\n", name, (unsigned long)value);
}

void cost_add(cost_series_t *series, uint32_t instructions) {
    if (series->count == series->room) {
        series->room = 2u * series->room + 1024u;
        series->values = realloc(series->values, series->room * sizeof *series->values);
        if (series->values == NULL) {
            cost_fail("out of memory");
        }
    }
    series->values[series->count] = instructions;
    series->count++;
}

static int compare(const void *a, const void *b) {
    const uint32_t left = *(const uint32_t *)a;
    const uint32_t right = *(const uint32_t *)b;
    return (left > right) - (left < right);
}

static void print_part(const char *name, const char *part, uint32_t value) {
    printf("%s.%s %lu\n", name, part, (unsigned long)value);
}

void cost_print_series(const char *name, cost_series_t *series) {
    if (series->count == 0) {
        cost_fail(name);
    }
    qsort(series->values, series->count, sizeof series->values[0], compare);
    print_part(name, "median", series->values[series->count / 2u]);
    print_part(name, "max", series->values[series->count - 1u]);
    print_part(name, "count", (uint32_t)series->count);
    series->count = 0;
}

void cost_fail(const char *what) {
    printf("failed: %s\n", what);
    exit(1);
}

void cost_require(berth_error_t error, const char *what) {
    if (error != BERTH_OK) {
        printf("%s: %s\n", what, berth_error_text(error));
        exit(1);
    }
}

int main(void) {
    counter_open();
    cost_counter();
    cost_controller();
    cost_gain();
    cost_messages();
    cost_board();
    cost_stack();
    cost_memory();
    printf("end 1\n");
    return 0;
}
