#include "status_line.h"

#include "can_wire.h"

#include <math.h>
#include <unistd.h>

#define BIT_RATE 1.0e6

void status_line_init(status_line_t *line, FILE *file, int64_t now_us) {
    *line = (status_line_t){.next_us = now_us, .since_us = now_us};
    if (file != NULL && isatty(fileno(file)) == 1) {
        line->file = file;
    }
}

void status_line_frame(status_line_t *line, const berth_can_frame_t *frame) {
    if (can_wire_valid(frame)) {
        line->bits += can_wire_bits(frame) + CAN_WIRE_INTERMISSION;
    }
}

void status_line_text(const status_line_t *line, const berth_board_t *board,
                      char out[STATUS_LINE_MAX]) {
    const berth_board_status_t *status = berth_board_status(board);
    const berth_status_t *control = berth_board_control(board);
    char clearance[16] = "-";
    const double e1 = (double)control->tracking_error.e1_m;
    const double e2 = (double)control->tracking_error.e2_m;
    if (control->active > 0) {
        (void)snprintf(clearance, sizeof clearance, "%.3f m", (double)control->clearance_m);
    }
    if (status->fault != BERTH_FAULT_NONE) {
        (void)snprintf(out, STATUS_LINE_MAX, "%-8s %s%s | bus %4.1f %%",
                       berth_supervisor_state_text(status->state),
                       berth_fault_side_text(status->fault), berth_fault_text(status->fault),
                       100.0 * line->load);
        return;
    }
    (void)snprintf(out, STATUS_LINE_MAX,
                   "%-8s %-17s error %.3f m | clearance %s | bus %4.1f %% | late %u",
                   berth_supervisor_state_text(status->state), berth_mode_text(control->mode),
                   sqrt(e1 * e1 + e2 * e2), clearance, 100.0 * line->load, (unsigned)status->late);
}

void status_line_show(status_line_t *line, const berth_board_t *board, int64_t now_us) {
    if (now_us < line->next_us) {
        return;
    }
    const double window_s = 1.0e-6 * (double)(now_us - line->since_us);
    line->load = window_s > 0.0 ? (double)line->bits / (BIT_RATE * window_s) : 0.0;
    line->bits = 0;
    line->since_us = now_us;
    line->next_us = now_us + STATUS_LINE_US;
    if (line->file != NULL) {
        char text[STATUS_LINE_MAX];
        status_line_text(line, board, text);
        fprintf(line->file, "\r\033[K%s", text);
        (void)fflush(line->file);
        line->shown = true;
    }
}

void status_line_end(status_line_t *line) {
    if (line->shown) {
        fputc('\n', line->file);
        line->shown = false;
    }
}
