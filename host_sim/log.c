#include "log.h"

static const char header[] = "t,x,y,theta,v,omega,mode,e1,e2,e3,x_r,y_r,theta_r,v_r,omega_r,"
                             "v_cmd,omega_cmd,clearance\n";

bool run_log_open(run_log_t *log, const char *path, scenario_error_t *error) {
    if (!output_file_open(&log->out, path, error)) {
        return false;
    }
    fputs(header, log->out.file);
    return true;
}

void run_log_row(void *log, const run_row_t *row) {
    FILE *file = ((run_log_t *)log)->out.file;
    fprintf(file, "%.9g,%.9g,%.9g,%.9g,%.9g,%.9g,%s,", row->t_s, row->x_m, row->y_m, row->theta_rad,
            row->v_mps, row->omega_radps, berth_mode_text(row->mode));
    fprintf(file, "%.9g,%.9g,%.9g,", row->e1_m, row->e2_m, row->e3_rad);
    fprintf(file, "%.9g,%.9g,%.9g,%.9g,%.9g,", row->x_r_m, row->y_r_m, row->theta_r_rad,
            row->v_r_mps, row->omega_r_radps);
    fprintf(file, "%.9g,%.9g,%.9g\n", row->v_cmd_mps, row->omega_cmd_radps, row->clearance_m);
}

bool run_log_commit(run_log_t *log, scenario_error_t *error) {
    return output_file_commit(&log->out, error);
}

void run_log_discard(run_log_t *log) {
    output_file_discard(&log->out);
}
