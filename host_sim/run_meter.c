#include "run_meter.h"

#include <math.h>

/* Below this the robot counts as standing. */
#define STANDING_MPS 1.0e-3

void run_meter_begin(run_meter_t *meter, const scenario_t *scenario, const berth_plan_t *plan,
                     run_summary_t *summary) {
    *summary = (run_summary_t){.min_clearance_m = HUGE_VAL};
    *meter = (run_meter_t){
        .scenario = scenario,
        .plan = plan,
        .clearance_m = HUGE_VAL,
        .last_avoiding = -1,
        .last_far = -1,
        .summary = summary,
    };
    for (size_t i = 0; i < scenario->obstacle_count; i++) {
        const scenario_obstacle_t *obstacle = &scenario->obstacles[i];
        meter->discs[i] = (plant_disc_t){obstacle->x_m, obstacle->y_m, obstacle->hard_m};
    }
}

static void fill_row(const run_meter_t *meter, const plant_t *plant, run_row_t *row) {
    const double pi = 3.14159265358979323846;
    const berth_sample_t *sample = &meter->sample;
    const double dx = (double)sample->x_m - plant->x_m;
    const double dy = (double)sample->y_m - plant->y_m;
    const double sine = sin(plant->theta_rad);
    const double cosine = cos(plant->theta_rad);
    *row = (run_row_t){
        .t_s = (double)meter->number * meter->scenario->period_s,
        .x_m = plant->x_m,
        .y_m = plant->y_m,
        .theta_rad = plant->theta_rad,
        .v_mps = plant->v_mps,
        .omega_radps = plant->omega_radps,
        .e1_m = cosine * dx + sine * dy,
        .e2_m = cosine * dy - sine * dx,
        .e3_rad = remainder((double)sample->theta_rad - plant->theta_rad, 2.0 * pi),
        .x_r_m = (double)sample->x_m,
        .y_r_m = (double)sample->y_m,
        .theta_r_rad = (double)sample->theta_rad,
        .v_r_mps = (double)sample->v_mps,
        .omega_r_radps = (double)sample->omega_radps,
    };
}

void run_meter_row(run_meter_t *meter, const plant_t *plant, long number, run_row_t *row) {
    const berth_plan_t *plan = meter->plan;
    const uint32_t k = plan->closed ? (uint32_t)((uint64_t)number % plan->count) : (uint32_t)number;
    meter->number = number;
    meter->sample = berth_plan_sample(plan, k);
    meter->clearance_m = HUGE_VAL;
    const double dx = (double)meter->sample.x_m - plant->x_m;
    const double dy = (double)meter->sample.y_m - plant->y_m;
    meter->position_error_m = sqrt(dx * dx + dy * dy);
    if (row != NULL) {
        fill_row(meter, plant, row);
    }
}

/* Which discs a motion went into: the motion again from where it began, with one disc at a time. */
static void count_collisions(run_meter_t *meter, const plant_t *before, double v_cmd_mps,
                             double omega_cmd_radps, double time_s) {
    for (size_t i = 0; i < meter->scenario->obstacle_count; i++) {
        plant_t again = *before;
        const double clearance =
            plant_step(&again, v_cmd_mps, omega_cmd_radps, time_s, &meter->discs[i], 1);
        if (clearance < 0.0 && !meter->hit[i]) {
            meter->hit[i] = true;
            meter->summary->collisions++;
        }
    }
}

void run_meter_move(run_meter_t *meter, plant_t *plant, double v_cmd_mps, double omega_cmd_radps,
                    double time_s) {
    const plant_t before = *plant;
    const double clearance = plant_step(plant, v_cmd_mps, omega_cmd_radps, time_s, meter->discs,
                                        meter->scenario->obstacle_count);
    if (clearance < meter->clearance_m) {
        meter->clearance_m = clearance;
    }
    if (clearance < meter->summary->min_clearance_m) {
        meter->summary->min_clearance_m = clearance;
    }
    if (clearance < 0.0) {
        count_collisions(meter, &before, v_cmd_mps, omega_cmd_radps, time_s);
    }
}

void run_meter_period(run_meter_t *meter, const strategy_output_t *output, run_row_t *row) {
    run_summary_t *summary = meter->summary;
    const berth_sample_t *sample = &meter->sample;
    const double position_error = meter->position_error_m;
    const double dv = output->v_mps - (double)sample->v_mps;
    const double domega = output->omega_radps - (double)sample->omega_radps;
    meter->error_square_sum += position_error * position_error;
    meter->effort_sum += dv * dv + domega * domega;
    meter->periods++;
    meter->last = meter->number;
    summary->final_position_error_m = position_error;
    if (position_error > summary->peak_position_error_m) {
        summary->peak_position_error_m = position_error;
    }
    if (!(position_error < RUN_RECOVERED_M)) {
        meter->last_far = meter->number;
    }
    meter->mode_steps[output->mode]++;
    if (output->mode != BERTH_MODE_TRACK) {
        meter->last_avoiding = meter->number;
    }
    if (fabs(output->v_mps) < STANDING_MPS && fabs((double)sample->v_mps) >= STANDING_MPS) {
        meter->stopped_steps++;
    }
    if (row != NULL) {
        row->mode = output->mode;
        row->v_cmd_mps = output->v_mps;
        row->omega_cmd_radps = output->omega_radps;
        row->clearance_m = meter->clearance_m;
    }
}

void run_meter_finish(run_meter_t *meter) {
    run_summary_t *summary = meter->summary;
    const double period_s = meter->scenario->period_s;
    const long periods = meter->periods;
    summary->steps = periods;
    summary->rms_position_error_m =
        periods > 0 ? sqrt(meter->error_square_sum / (double)periods) : 0.0;
    summary->control_effort = meter->effort_sum * period_s;
    summary->stopped_time_s = (double)meter->stopped_steps * period_s;
    for (int mode = 0; mode < RUN_MODES; mode++) {
        summary->mode_time_s[mode] = (double)meter->mode_steps[mode] * period_s;
    }
    summary->avoidance_time_s = (double)(periods - meter->mode_steps[BERTH_MODE_TRACK]) * period_s;
    if (meter->last_avoiding < 0) {
        summary->recovery_time_s = 0.0;
    } else if (meter->last_far == meter->last) {
        summary->recovery_time_s = (double)NAN;
    } else {
        const long late = meter->last_far - meter->last_avoiding;
        summary->recovery_time_s = late > 0 ? (double)late * period_s : 0.0;
    }
}
