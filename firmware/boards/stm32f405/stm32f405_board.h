/* stm32f405_board.h - what a main() finds on an STM32F405 drive board.
 *
 *     crystal    8 MHz (STM32F405_CRYSTAL_HZ)
 *     USART1     PA9 out, PA10 in, 115200 baud: console
 *     CAN1       PB8 in, PB9 out, to a transceiver: 1 Mbit/s
 *
 * Interrupts all have the reset's priority, so that none interrupts another: SysTick (time), CAN1
 * FIFO 0 and status change, USART1. The longest is FIFO 0's, with up to 8 frames at once.
 */
#ifndef BERTH_BOARDS_STM32F405_BOARD_H
#define BERTH_BOARDS_STM32F405_BOARD_H

#include "berth_hal/can.h"
#include "berth_hal/clock.h"
#include "board.h"
#include "byte_stream.h"
#include "stm32_can.h"
#include "stm32f4_clocks.h"

#include <stdbool.h>

#ifndef STM32F405_CRYSTAL_HZ
#define STM32F405_CRYSTAL_HZ 8000000u
#endif

const stm32f4_clocks_t *stm32f405_clocks(void);

/* The last reset was the watchdog's. */
bool stm32f405_was_reset_by_watchdog(void);

/* The clock wakes from sleep when a frame or a character has come. */
berth_clock_t stm32f405_clock(void);
byte_stream_t stm32f405_console(void);

/* To be called in the main loop: moves the console's bytes where the emulator has no interrupt for
 * it. Costs a few instructions on the board. */
void stm32f405_console_poll(void);

/* The CAN bus: DOWN until it is opened. Without the crystal it is not to be opened: the internal
 * oscillator is too far off. */
berth_can_t stm32f405_can(void);
stm32_can_result_t stm32f405_can_open(const berth_can_filter_t *filters, uint32_t filter_count);

/* False when the watchdog does not start. timeout_us: see stm32_iwdg.h. */
bool stm32f405_watchdog_start(uint32_t timeout_us);
void stm32f405_watchdog_feed(void);

#endif
