#include "campaign_rows.h"

#include "berth/supervisor.h"
#include "number.h"
#include "output_file.h"

#include <math.h>

static void put_count(FILE *file, long value) {
    fprintf(file, ",%ld", value);
}

static void put_text(FILE *file, const char *text) {
    fprintf(file, ",%s", text != NULL ? text : "");
}

static void put_number(FILE *file, double value) {
    char text[NUMBER_TEXT_MAX];
    fputc(',', file);
    if (isfinite(value)) {
        number_text(value, text, sizeof text);
        fputs(text, file);
    }
}

static const char *const scene_columns = "seed,shape,obstacles,overlap,tau_s,a_max_mps2,pose_noise_"
                                         "m,heading_noise_rad,slip,pose_delay_s,"
                                         "watchdog_s,untold,needed_m,given_m,violation";

/* The part of what the condition demands that is missing. */
static double violation(const campaign_row_t *row) {
    return (row->needed_m - row->given_m) / row->needed_m;
}

static void put_scene(FILE *file, const campaign_row_t *row) {
    const scenario_plant_t *plant = &row->plant;
    const double numbers[] = {
        plant->tau_s,  plant->a_max_mps2,   plant->pose_noise_m, plant->heading_noise_rad,
        plant->slip,   plant->pose_delay_s, plant->watchdog_s,   plant->untold,
        row->needed_m, row->given_m,        violation(row)};
    fprintf(file, "%llu", (unsigned long long)row->seed);
    put_text(file, row->shape == SHAPE_CIRCLE ? "circle" : "eight");
    put_count(file, (long)row->obstacles);
    put_count(file, row->overlap);
    for (size_t i = 0; i < sizeof numbers / sizeof numbers[0]; i++) {
        put_number(file, numbers[i]);
    }
}

static void put_header(FILE *file) {
    fputs(scene_columns, file);
    fputs(",collisions,min_clearance_m,rms_position_error_m,peak_position_error_m,"
          "final_position_error_m,avoidance_time_s",
          file);
    for (int mode = 0; mode < RUN_MODES; mode++) {
        fprintf(file, ",%s_s", berth_mode_text((berth_mode_t)mode));
    }
    fputs(",standing_s,recovery_time_s,control_effort,steps,recovered,blocked,drive,fault,fault_s,"
          "fault_lasts_s,end,stopped_s,reason,wrong\n",
          file);
}

static void put_figures(FILE *file, const campaign_row_t *row) {
    const run_summary_t *summary = &row->summary;
    put_count(file, summary->collisions > 0 ? summary->collisions : row->collided);
    put_number(file, summary->min_clearance_m);
    put_number(file, summary->rms_position_error_m);
    put_number(file, summary->peak_position_error_m);
    put_number(file, summary->final_position_error_m);
    put_number(file, summary->avoidance_time_s);
    for (int mode = 0; mode < RUN_MODES; mode++) {
        put_number(file, summary->mode_time_s[mode]);
    }
    put_number(file, summary->stopped_time_s);
    put_number(file, summary->recovery_time_s);
    put_number(file, summary->control_effort);
    put_count(file, summary->steps);
    put_count(file, row->recovered);
    put_count(file, row->blocked);
}

static void put_bus(FILE *file, const campaign_row_t *row) {
    const bool lasts = row->fault_lasts_s > 0.0;
    put_text(file, row->drive);
    put_text(file, row->fault);
    put_number(file, row->fault_s);
    put_number(file, lasts ? row->fault_lasts_s : (double)NAN);
    put_text(file, row->end);
    put_number(file, row->stopped_s);
    put_text(file, NULL);
    if (row->reason != BERTH_FAULT_NONE) {
        fprintf(file, "%s%s", berth_fault_side_text(row->reason), berth_fault_text(row->reason));
    }
    put_text(file, row->wrong);
}

bool campaign_rows_write(const char *path, const campaign_row_t *rows, long count,
                         scenario_error_t *error) {
    output_file_t out;
    if (!output_file_open(&out, path, error)) {
        return false;
    }
    put_header(out.file);
    for (long i = 0; i < count; i++) {
        put_scene(out.file, &rows[i]);
        put_figures(out.file, &rows[i]);
        put_bus(out.file, &rows[i]);
        fputc('\n', out.file);
    }
    return output_file_commit(&out, error);
}
