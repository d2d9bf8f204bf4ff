/* What the adaptive strategy has learned of the wheels, for tests and reports. */
#ifndef HOST_SIM_STRATEGY_ADAPTIVE_H
#define HOST_SIM_STRATEGY_ADAPTIVE_H

typedef struct {
    double radius_scale; /* true wheel radius / nominal */
    double track_scale;  /* true track width / nominal */
} strategy_adaptive_estimates_t;

/* self as strategy_adaptive.create returned it. Both are 1 at the start. */
strategy_adaptive_estimates_t strategy_adaptive_estimates(const void *self);

#endif
