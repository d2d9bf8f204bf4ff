/* mps2_board.h - what an MPS2 board has beyond board.h: a clock that can wait, a log on the
 * console, and a second serial port for a bus. All are open when main() begins. */
#ifndef BERTH_BOARDS_MPS2_BOARD_H
#define BERTH_BOARDS_MPS2_BOARD_H

#include "board.h"
#include "mps2_clock.h"
#include "mps2_uart.h"

/* Waiting ends early when the bus port has received something. */
berth_clock_t board_clock(void);
berth_log_t board_log(void);
byte_stream_t board_bus(void);

#endif
