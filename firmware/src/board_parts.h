/* The parts of the board that tell others about it. Private to board*.c. */
#ifndef BERTH_SRC_BOARD_PARTS_H
#define BERTH_SRC_BOARD_PARTS_H

#include "berth/board.h"
#include "scalar.h"

/* Puts the status frame now. */
void board_put_status(berth_board_t *board);

/* Puts status, pose and tracking error when they are due. Once a control step. */
void board_put_telemetry(berth_board_t *board);

#endif
