/* The figures of merit of a run, taken period by period: who moves the robot does not matter, the
 * plain run or a robot on the bus.
 *
 *     run_meter_begin(&meter, scenario, plan, &summary);
 *     for each period:
 *         run_meter_row(&meter, &plant, number, &row);     the robot at the period's start
 *         run_meter_move(&meter, &plant, v, omega, time)   once or in pieces, which add up to it
 *         run_meter_period(&meter, &output, &row);         the command held, the mode
 *     run_meter_finish(&meter);
 */
#ifndef HOST_SIM_RUN_METER_H
#define HOST_SIM_RUN_METER_H

#include "plant.h"
#include "run.h"
#include "strategy.h"

typedef struct {
    const scenario_t *scenario;
    const berth_plan_t *plan;
    plant_disc_t discs[SCENARIO_OBSTACLES_MAX];
    bool hit[SCENARIO_OBSTACLES_MAX];
    berth_sample_t sample; /* of the period that began last */
    double position_error_m;
    double clearance_m; /* least since the period began */
    long number;
    long periods;
    long last; /* number of the period that ended last */
    long mode_steps[RUN_MODES];
    long stopped_steps;
    long last_avoiding; /* period; -1: none */
    long last_far;      /* last period with an error of RUN_RECOVERED_M or more; -1: none */
    double error_square_sum;
    double effort_sum;
    run_summary_t *summary;
} run_meter_t;

/* scenario, plan and summary must outlive the meter's use. Clears *summary. */
void run_meter_begin(run_meter_t *meter, const scenario_t *scenario, const berth_plan_t *plan,
                     run_summary_t *summary);

/* A period begins with the robot as it is; number counts from 0, the first sample of the plan. Row
 * may be NULL. */
void run_meter_row(run_meter_t *meter, const plant_t *plant, long number, run_row_t *row);

/* Moves the robot with a command for a time > 0, and counts clearance and collisions. */
void run_meter_move(run_meter_t *meter, plant_t *plant, double v_cmd_mps, double omega_cmd_radps,
                    double time_s);

/* The period ends: the command that was held during it. row: as given to run_meter_row. */
void run_meter_period(run_meter_t *meter, const strategy_output_t *output, run_row_t *row);

/* Fills in what is known only at the end. Without a period all figures but the clearance are 0. */
void run_meter_finish(run_meter_t *meter);

#endif
