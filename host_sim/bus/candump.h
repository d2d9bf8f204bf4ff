/* Lines of candump's log format (can-utils), one frame each:
 *
 *     (1436509053.850870) vcan0 1E5#0102 R
 *
 * seconds and microseconds; the channel; an identifier of three (11 bits) or eight hexadecimal
 * digits (29 bits); the data, or R and a length for a remote frame; and, with candump -x, whether
 * the frame was received or sent.
 */
#ifndef HOST_SIM_BUS_CANDUMP_H
#define HOST_SIM_BUS_CANDUMP_H

#include "berth_hal/can.h"

#include <stdio.h>

#define CANDUMP_CHANNEL_MAX 32
#define CANDUMP_WHY_MAX 96

typedef enum { CANDUMP_UNKNOWN, CANDUMP_RECEIVED, CANDUMP_SENT } candump_direction_t;

typedef struct {
    char channel[CANDUMP_CHANNEL_MAX];
    berth_can_frame_t frame; /* time_us: of the line */
    candump_direction_t direction;
} candump_line_t;

/* Reads one line, with or without its end. False with why filled: what is wrong, and what is
 * allowed. *out is only written to on success. */
bool candump_parse(const char *line, candump_line_t *out, char why[CANDUMP_WHY_MAX]);

/* Writes one line. The frame's time_us must not be negative. What cannot be written shows in
 * ferror. */
void candump_print(FILE *file, const char *channel, const berth_can_frame_t *frame,
                   candump_direction_t direction);

/* Identifier and data alone, as in a line: "1E5#0102". Returns out. */
#define CANDUMP_FRAME_MAX 32
const char *candump_frame_text(const berth_can_frame_t *frame, char out[CANDUMP_FRAME_MAX]);

/* Equal in all that goes over the wire. */
bool candump_same(const berth_can_frame_t *a, const berth_can_frame_t *b);

#endif
