#include "bus_report.h"

#include "berth/supervisor.h"
#include "summary.h"

#include <math.h>

/* --- JSON -------------------------------------------------------------------------------- */

static json_t *count(unsigned long long value) {
    return json_integer((json_int_t)value);
}

static json_t *drive_json(const drive_sim_counters_t *drive) {
    return json_pack("{so, so, so, so, so, so}", "commands", count(drive->commands), "received",
                     count(drive->received), "sent", count(drive->sent), "malformed",
                     count(drive->malformed), "overruns", count(drive->overruns), "watchdog_stops",
                     count(drive->watchdog_stops));
}

static char *fault_text(uint8_t fault, char *out, size_t size) {
    snprintf(out, size, "%s%s", berth_fault_side_text(fault), berth_fault_text(fault));
    return out;
}

json_t *bus_report_robot_json(const bus_setup_t *setup, const bus_robot_result_t *result) {
    char fault[96];
    const char *state = berth_supervisor_state_text((berth_supervisor_state_t)result->state);
    return json_pack("{ss, ss, ss, si, ss, so, so, so, so, so, so, so, s[oo]}", "drive",
                     bus_setup_drive_name(setup->drive), "run", bus_robot_phase_text(result->phase),
                     "state", state, "fault", (int)result->fault, "fault_text",
                     fault_text(result->fault, fault, sizeof fault), "clearance_m",
                     summary_number(result->clearance_m), "pose_error_m",
                     summary_number(result->pose_error_m), "statuses", count(result->statuses),
                     "malformed", count(result->malformed), "fixes", count(result->fixes),
                     "announcements", count(result->announcements), "lost", count(result->lost),
                     "drives", drive_json(&result->drives[BERTH_LEFT]),
                     drive_json(&result->drives[BERTH_RIGHT]));
}

static json_t *board_json(const session_result_t *result) {
    const berth_board_status_t *board = &result->board;
    const berth_drive_status_t *left = &result->drives[BERTH_LEFT];
    const berth_drive_status_t *right = &result->drives[BERTH_RIGHT];
    return json_pack("{so, so, so, so, so, so, so, so, so, so, so, so}", "steps",
                     count(board->steps), "late", count(board->late), "missed",
                     count(board->missed), "latest_us", json_integer(board->latest_us), "received",
                     count(board->received), "malformed", count(board->malformed), "foreign",
                     count(board->foreign), "commands_refused", count(board->commands_refused),
                     "obstacles_refused", count(board->obstacles_refused), "saturated",
                     count((unsigned long long)left->saturated + right->saturated), "send_again",
                     count(result->send_again), "failures", count(result->failures));
}

json_t *bus_report_session_json(const bus_setup_t *setup, const session_result_t *result) {
    json_t *robot = bus_report_robot_json(setup, &result->robot);
    json_t *bus = json_pack(
        "{ss, so, so, so, so, so, so, so, so}", "end", session_end_text(result->end), "frames",
        count(result->frames), "sent", count(result->nodes[SESSION_NODE_BOARD].sent), "received",
        count(result->nodes[SESSION_NODE_BOARD].received), "dropped",
        count(session_dropped(result)), "load", summary_number(result->load), "load_peak",
        summary_number(result->load_peak), "armed_s",
        summary_number(result->armed_us < 0 ? (double)NAN : 1.0e-6 * (double)result->armed_us),
        "board", board_json(result));
    if (robot == NULL || bus == NULL || json_object_update_new(bus, robot) != 0) {
        json_decref(bus);
        return NULL;
    }
    return bus;
}

/* --- for people -------------------------------------------------------------------------- */

static void print_text(FILE *file, const char *label, const char *text) {
    fprintf(file, "%-28s%14s\n", label, text);
}

static void print_count(FILE *file, const char *label, unsigned long long value) {
    fprintf(file, "%-28s%14llu\n", label, value);
}

static void print_number(FILE *file, const char *label, const char *format, double value) {
    char text[32];
    snprintf(text, sizeof text, format, value);
    print_text(file, label, text);
}

static void print_fault(FILE *file, uint8_t fault) {
    char text[96];
    if (fault != BERTH_FAULT_NONE) {
        fprintf(file, "fault: %s\n", fault_text(fault, text, sizeof text));
    }
}

static unsigned long watchdog_stops(const bus_robot_result_t *result) {
    return result->drives[BERTH_LEFT].watchdog_stops + result->drives[BERTH_RIGHT].watchdog_stops;
}

void bus_report_print_robot(FILE *file, const bus_setup_t *setup,
                            const bus_robot_result_t *result) {
    fputc('\n', file);
    print_text(file, "drives", bus_setup_drive_name(setup->drive));
    print_text(file, "run", bus_robot_phase_text(result->phase));
    print_text(file, "board", berth_supervisor_state_text((berth_supervisor_state_t)result->state));
    print_fault(file, result->run_fault != BERTH_FAULT_NONE ? result->run_fault : result->fault);
    if (isfinite(result->clearance_m)) {
        print_number(file, "clearance, all the time, m", "%.4f", result->clearance_m);
    }
    print_number(file, "board's pose error, peak, m", "%.4f", result->pose_error_m);
    print_count(file, "status frames heard", result->statuses);
    print_count(file, "drives' own watchdog stops", watchdog_stops(result));
}

void bus_report_print_session(FILE *file, const bus_setup_t *setup,
                              const session_result_t *result) {
    bus_report_print_robot(file, setup, &result->robot);
    print_text(file, "session ended", session_end_text(result->end));
    print_count(file, "frames on the bus", result->frames);
    print_count(file, "  sent by the board", result->nodes[SESSION_NODE_BOARD].sent);
    print_count(file, "  dropped", session_dropped(result));
    print_number(file, "bus load at 1 Mbit/s, %", "%.2f", 100.0 * result->load);
    print_number(file, "  peak over 100 ms, %", "%.2f", 100.0 * result->load_peak);
    print_count(file, "control steps", result->board.steps);
    print_count(file, "  late or missed", result->board.late + result->board.missed);
    print_number(file, "  latest, ms", "%.3f", 1.0e-3 * (double)result->board.latest_us);
}
