/* The strategies, one by one, for the registry. */
#ifndef HOST_SIM_STRATEGY_LIST_H
#define HOST_SIM_STRATEGY_LIST_H

#include "strategy.h"

extern const strategy_t strategy_none;
extern const strategy_t strategy_conservative;
extern const strategy_t strategy_combined;
extern const strategy_t strategy_normal;
extern const strategy_t strategy_adaptive;
extern const strategy_t strategy_kanayama;
extern const strategy_t strategy_kanayama_avoid;

#endif
