/* Campaigns over the virtual bus: board, drives, odometry and frames between, and one thing that
 * goes wrong in each run, drawn from its seed.
 *
 * What must come of a run: no collision; either it carries on to the end and nothing says that it
 * must not, or it stops, after the fault and not before, with a reason that fits, and stands when
 * the drives' watchdogs have bitten. What goes wrong costs no more than one watchdog, so the scenes
 * count that as delay (plant.watchdog_s). What the condition cannot count is left to other tests:
 * frames altered unnoticed, and drives that fail without a word (a vesc's own error).
 */
#ifndef HOST_SIM_BUS_BUS_CAMPAIGN_H
#define HOST_SIM_BUS_BUS_CAMPAIGN_H

#include "bus_setup.h"
#include "campaign.h"

/* The simulated drives' own watchdog. */
#define BUS_CAMPAIGN_WATCHDOG_S 0.25

typedef struct {
    bus_setup_t setups[3]; /* by drive_sim_kind_t */
    bool drawn;            /* each run draws its drive; else it is that of setups[0] */
    bool faults;
} bus_campaign_t;

/* With the options as given; without --drive among them each run draws one of the three. False with
 * *error filled. */
bool bus_campaign_init(bus_campaign_t *campaign, const bus_setup_t *given, bool faults,
                       scenario_error_t *error);

/* A campaign_run_fn; context is a bus_campaign_t. */
bool bus_campaign_run(const void *context, const scenario_t *scene, const run_plan_t *plan,
                      campaign_row_t *row, scenario_error_t *error);

#endif
