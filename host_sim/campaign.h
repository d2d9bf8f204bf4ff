/* Campaigns: many runs in random scenes, each drawn from its own seed.
 *
 * Run i of a campaign with seed s is drawn from s + i alone, so a campaign of one run with that
 * seed is that run again. The totals do not depend on the number of threads.
 */
#ifndef HOST_SIM_CAMPAIGN_H
#define HOST_SIM_CAMPAIGN_H

#include "run.h"

typedef enum { OVERLAP_ANY, OVERLAP_DEMAND, OVERLAP_FORBID } campaign_overlap_t;

/* Whose plant a scene has: that of the scenarios that it is made from; one drawn for each run, with
 * the ranges in campaign.c; such a one of which the firmware is told a part only, drawn too, from
 * all to nothing: its clearance condition is then met for a better robot than the one there is; or
 * one whose poses come very late. */
typedef enum {
    CAMPAIGN_PLANT_BASE,
    CAMPAIGN_PLANT_DRAWN,
    CAMPAIGN_PLANT_UNTOLD,
    CAMPAIGN_PLANT_LATE
} campaign_plant_t;

/* What a run came to. */
typedef struct {
    uint64_t seed;
    shape_t shape;
    size_t obstacles;
    bool overlap; /* of conservative circles */
    scenario_plant_t plant;
    double needed_m; /* C - R that the clearance condition demands with the plant as it is */
    double given_m;  /* C - R that there is */
    run_summary_t summary;
    bool collided;
    bool recovered; /* ended within RUN_RECOVERED_M of the reference, and nothing stopped it */
    bool blocked;   /* was ever without a free heading */

    /* On the bus. Texts are static; NULL without a bus. */
    const char *drive;
    const char *fault;    /* what went wrong there; "none" */
    double fault_s;       /* since the session's begin */
    double fault_lasts_s; /* 0: for ever */
    const char *end;      /* of the session */
    uint8_t reason;       /* berth_fault_t of the stop; BERTH_FAULT_NONE: it carried on */
    double stopped_s;     /* when, since the session's begin; NAN: it carried on */
    const char *wrong;    /* what was not as it must be; NULL: nothing */
} campaign_row_t;

/* Runs one scene otherwise than plainly: fills in the row's summary, collided and what is of the
 * bus. Called from many threads. False with *error filled when the scene is refused. */
typedef bool (*campaign_run_fn)(const void *context, const scenario_t *scene,
                                const run_plan_t *plan, campaign_row_t *row,
                                scenario_error_t *error);

typedef struct {
    long runs;
    uint64_t seed;
    int jobs;
    campaign_overlap_t overlap; /* of conservative circles */
    campaign_plant_t plant;
    scenario_t circle, eight; /* what the scenes are made from: robot, weights, plant, strategy */
    campaign_run_fn run;      /* NULL: the plain run */
    const void *run_context;
    campaign_row_t *rows; /* gets a row for each run, in the order of seeds; NULL: not wanted */
} campaign_options_t;

/* A run that collided, was not as it must be, or did not recover though nothing stopped it. */
typedef struct {
    uint64_t seed;
    bool collided, unrecovered, blocked;
    const char *wrong;
} campaign_bad_t;

typedef struct {
    long runs;
    long collisions; /* runs that entered a hard disc */
    double worst_clearance_m;
    long recovered; /* runs that ended within RUN_RECOVERED_M of the reference */
    long blocked;   /* runs that were ever without a free heading */
    long stopped;   /* on the bus: runs that a fault ended */
    long wrong;     /* on the bus: runs that were not as they must be */
    long steps;
    double wall_s;
    double mode_time_s[RUN_MODES];
    campaign_bad_t *bad; /* by seed; on the heap */
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
