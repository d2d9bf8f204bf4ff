/* Campaigns: many runs in random scenes, each drawn from its own seed.
 *
 * Run i of a campaign with seed s is drawn from s + i alone, so a campaign of one run with that
 * seed is that run again. The totals do not depend on the number of threads.
 */
#ifndef HOST_SIM_CAMPAIGN_H
#define HOST_SIM_CAMPAIGN_H

#include "run.h"

typedef enum { OVERLAP_ANY, OVERLAP_DEMAND, OVERLAP_FORBID } campaign_overlap_t;

typedef struct {
    long runs;
    uint64_t seed;
    int jobs;
    campaign_overlap_t overlap; /* of conservative circles */
    scenario_t circle, eight;   /* what the scenes are made from: robot, weights, plant, strategy */
} campaign_options_t;

typedef struct {
    uint64_t seed;
    bool collided, unrecovered, blocked;
} campaign_bad_t;

typedef struct {
    long runs;
    long collisions; /* runs that entered a hard disc */
    double worst_clearance_m;
    long recovered; /* runs that ended within RUN_RECOVERED_M of the reference */
    long blocked;   /* runs that were ever without a free heading */
    long steps;
    double wall_s;
    double mode_time_s[RUN_MODES];
    campaign_bad_t *bad; /* runs that collided or did not recover, by seed; on the heap */
    size_t bad_count;
} campaign_result_t;

/* The scene of one seed. False when no scene fits the options within many tries (obstacles too wide
 * for the overlap that is demanded or forbidden). */
bool campaign_scene(const campaign_options_t *options, uint64_t seed, scenario_t *scene,
                    scenario_error_t *error);

/* Called some ten times a second from the calling thread; may be NULL. */
typedef void (*campaign_progress_fn)(void *context, long done, long total);

/* Runs the campaign. False on an infeasible configuration or lack of memory, with *error filled. */
bool campaign_run(const campaign_options_t *options, campaign_progress_fn progress, void *context,
                  campaign_result_t *result, scenario_error_t *error);

void campaign_result_free(campaign_result_t *result);

#endif
