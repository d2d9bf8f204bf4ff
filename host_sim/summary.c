#include "summary.h"

#include <math.h>
#include <string.h>

json_t *summary_number(double value) {
    return isfinite(value) ? json_real(value) : json_null();
}

static json_t *mode_times(const run_summary_t *summary) {
    json_t *times = json_object();
    for (int mode = 0; mode < RUN_MODES; ++mode) {
        json_object_set_new(times, berth_mode_text((berth_mode_t)mode),
                            summary_number(summary->mode_time_s[mode]));
    }
    return times;
}

json_t *summary_json(const run_summary_t *summary) {
    return json_pack("{si, so, so, so, so, so, so, so, so, sI, so}", "collisions",
                     summary->collisions, "min_clearance_m",
                     summary_number(summary->min_clearance_m), "rms_position_error_m",
                     summary_number(summary->rms_position_error_m), "peak_position_error_m",
                     summary_number(summary->peak_position_error_m), "final_position_error_m",
                     summary_number(summary->final_position_error_m), "avoidance_time_s",
                     summary_number(summary->avoidance_time_s), "mode_time_s", mode_times(summary),
                     "recovery_time_s", summary_number(summary->recovery_time_s), "control_effort",
                     summary_number(summary->control_effort), "steps", (json_int_t)summary->steps,
                     "wall_s", summary_number(summary->wall_s));
}

bool summary_write_json(FILE *file, json_t *document) {
    const bool ok = document != NULL &&
                    json_dumpf(document, file, JSON_INDENT(2) | JSON_REAL_PRECISION(17)) == 0;
    json_decref(document);
    return ok && fputc('\n', file) != EOF && fflush(file) == 0;
}

/* One row of the table. */
typedef struct {
    const char *label;
    const char *format;
    double (*value)(const run_summary_t *summary);
    const char *otherwise; /* printed for a value that is not finite */
} table_row_t;

static double collisions(const run_summary_t *s) {
    return s->collisions;
}
static double min_clearance(const run_summary_t *s) {
    return s->min_clearance_m;
}
static double rms_error(const run_summary_t *s) {
    return s->rms_position_error_m;
}
static double peak_error(const run_summary_t *s) {
    return s->peak_position_error_m;
}
static double final_error(const run_summary_t *s) {
    return s->final_position_error_m;
}
static double avoidance_time(const run_summary_t *s) {
    return s->avoidance_time_s;
}
static double regulated_time(const run_summary_t *s) {
    return s->mode_time_s[BERTH_MODE_REGULATED];
}
static double turn_time(const run_summary_t *s) {
    return s->mode_time_s[BERTH_MODE_CONSERVATIVE_TURN];
}
static double go_time(const run_summary_t *s) {
    return s->mode_time_s[BERTH_MODE_CONSERVATIVE_GO];
}
static double blocked_time(const run_summary_t *s) {
    return s->mode_time_s[BERTH_MODE_BLOCKED];
}
static double stopped_time(const run_summary_t *s) {
    return s->stopped_time_s;
}
static double recovery_time(const run_summary_t *s) {
    return s->recovery_time_s;
}
static double control_effort(const run_summary_t *s) {
    return s->control_effort;
}

static const table_row_t table_rows[] = {
    {"collisions", "%.0f", collisions, "-"},
    {"minimum clearance, m", "%.4f", min_clearance, "no obstacle"},
    {"position error, RMS, m", "%.4f", rms_error, "-"},
    {"position error, peak, m", "%.4f", peak_error, "-"},
    {"position error, final, m", "%.4f", final_error, "-"},
    {"avoidance in control, s", "%.2f", avoidance_time, "-"},
    {"  regulated, s", "%.2f", regulated_time, "-"},
    {"  conservative, turning, s", "%.2f", turn_time, "-"},
    {"  conservative, going, s", "%.2f", go_time, "-"},
    {"  blocked, s", "%.2f", blocked_time, "-"},
    {"standing, s", "%.2f", stopped_time, "-"},
    {"recovery after avoidance, s", "%.2f", recovery_time, "never"},
    {"control effort", "%.4f", control_effort, "-"},
};

static int column_width(const summary_column_t *column) {
    const int length = (int)strlen(column->title);
    return (length > 12 ? length : 12) + 2;
}

void summary_print_table(FILE *file, const summary_column_t *columns, size_t count) {
    fprintf(file, "%-28s", "");
    for (size_t i = 0; i < count; ++i) {
        fprintf(file, "%*s", column_width(&columns[i]), columns[i].title);
    }
    fputc('\n', file);
    for (size_t row = 0; row < sizeof table_rows / sizeof table_rows[0]; ++row) {
        fprintf(file, "%-28s", table_rows[row].label);
        for (size_t i = 0; i < count; ++i) {
            char text[32];
            const double value = table_rows[row].value(&columns[i].summary);
            snprintf(text, sizeof text, table_rows[row].format, value);
            fprintf(file, "%*s", column_width(&columns[i]),
                    isfinite(value) ? text : table_rows[row].otherwise);
        }
        fputc('\n', file);
    }
}
