/* One closed-loop run: plant, strategy, log and figures of merit. */
#ifndef HOST_SIM_RUN_H
#define HOST_SIM_RUN_H

#include "scenario.h"
#include "strategy.h"

#include <stdint.h>
#include <stdio.h>

#define RUN_MODES 5
/* A run has recovered when it ends within this distance of the reference, and the time to recover
 * is when it comes within it for good. */
#define RUN_RECOVERED_M 0.05

/* One period, as in the log. */
typedef struct {
    double t_s;
    double x_m, y_m, theta_rad; /* true pose at its start */
    double v_mps, omega_radps;  /* true velocity at its start */
    berth_mode_t mode;
    double e1_m, e2_m, e3_rad; /* from the true pose */
    double x_r_m, y_r_m, theta_r_rad, v_r_mps, omega_r_radps;
    double v_cmd_mps, omega_cmd_radps; /* held during it */
    double clearance_m;                /* least during it; INFINITY without obstacles */
} run_row_t;

typedef struct {
    int collisions;         /* obstacles whose hard disc was entered */
    double min_clearance_m; /* INFINITY without obstacles */
    double rms_position_error_m, peak_position_error_m, final_position_error_m;
    double avoidance_time_s;       /* mode other than track */
    double mode_time_s[RUN_MODES]; /* by berth_mode_t */
    double recovery_time_s; /* from the end of the last avoidance until the position error is below
                               RUN_RECOVERED_M for good; 0 without avoidance; NAN if never */
    double control_effort;  /* integral of (v_cmd - v_r)^2 + (omega_cmd - omega_r)^2 */
    double stopped_time_s;  /* commanded |v| < 1 mm/s while the reference moves */
    long steps;
    double wall_s;
} run_summary_t;

/* The plan of a scenario: samples, gain table, weights. Shared by runs, read only. */
typedef struct {
    berth_plan_t plan;
    berth_sample_t *samples;
    berth_gain_t *gains;
} run_plan_t;

bool run_plan_make(const scenario_t *scenario, run_plan_t *out, scenario_error_t *error);
void run_plan_free(run_plan_t *plan);

/* Where the rows go: on_row is called once a period. */
typedef struct {
    void (*on_row)(void *context, const run_row_t *row);
    void *context;
} run_sink_t;

/* Runs the scenario with its strategy from the seed; sink may be NULL. False when the strategy
 * refuses it. */
bool run_scenario(const scenario_t *scenario, const run_plan_t *plan, uint64_t seed,
                  const run_sink_t *sink, run_summary_t *summary, scenario_error_t *error);

#endif
