#include "strategy.h"

#include "strategy_list.h"

#include <string.h>

const strategy_t *const strategies[] = {
    &strategy_none,     &strategy_conservative, &strategy_combined,       &strategy_normal,
    &strategy_adaptive, &strategy_kanayama,     &strategy_kanayama_avoid, NULL,
};

const strategy_t *strategy_find(const char *name) {
    for (size_t i = 0; strategies[i] != NULL; ++i) {
        if (strcmp(strategies[i]->name, name) == 0) {
            return strategies[i];
        }
    }
    return NULL;
}
