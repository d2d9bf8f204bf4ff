/* One line on a terminal that tells how a board is while it runs, written over and over. */
#ifndef HOST_SIM_BUS_STATUS_LINE_H
#define HOST_SIM_BUS_STATUS_LINE_H

#include "berth/board.h"

#include <stdio.h>

#define STATUS_LINE_MAX 160
#define STATUS_LINE_US 200000 /* between two lines */

typedef struct {
    FILE *file; /* a terminal; NULL: nothing is shown */
    int64_t next_us;
    int64_t since_us; /* of the window that the bus load is of */
    uint64_t bits;    /* on the wire in it */
    double load;      /* of the last window, 0 to 1 */
    bool shown;
} status_line_t;

/* Shows lines on file when it is a terminal. */
void status_line_init(status_line_t *line, FILE *file, int64_t now_us);

/* A frame that was sent or received, for the bus load: its bits with stuffing, at 1 Mbit/s. */
void status_line_frame(status_line_t *line, const berth_can_frame_t *frame);

/* The text: state, mode, tracking error, clearance, bus load, and the fault if there is one. */
void status_line_text(const status_line_t *line, const berth_board_t *board,
                      char out[STATUS_LINE_MAX]);

/* Shows it when its time has come. Not from within the control path. */
void status_line_show(status_line_t *line, const berth_board_t *board, int64_t now_us);

/* Ends the line, so that what follows stands on its own. */
void status_line_end(status_line_t *line);

#endif
