/* board.h - what the start-up code of every board gives a main().
 *
 * The start-up code sets up the processor, paints the main stack, fills in .data and .bss, opens
 * the board's console and clock, calls main() and ends the program with its result.
 *
 * Memory: handlers (interrupts, faults) have a small stack of their own. The main stack lies at the
 * very start of RAM, so that an overflow leaves the memory instead of running into data, and ends
 * in a fault.
 *
 * A fault (memory, bus, usage, illegal instruction) is not left: registers are printed on the
 * console, one "name value" a line after the line "FAULT name", and the program ends with
 * BOARD_STATUS_FAULT. All wheels must have been told to stop by then, or stop by the drives' own
 * watchdogs: no code of the program runs any more.
 *
 * Ends of the program reach an emulator or debugger by semihosting; without one the processor
 * stands.
 */
#ifndef BERTH_BOARDS_BOARD_H
#define BERTH_BOARDS_BOARD_H

#include <stddef.h>
#include <stdint.h>

/* Exit status after a fault. */
#define BOARD_STATUS_FAULT 128

/* Writes text to the console. Blocks until it is written; any context. */
void board_write(const char *text, size_t length);
void board_puts(const char *text);
void board_put_hex(uint32_t value); /* 0x and eight digits */

/* Microseconds since the start; never goes backwards. Any context. */
int64_t board_now_us(void);

/* The main stack: its size, and how much of it has been used at most since the start, in bytes. */
size_t board_stack_size(void);
size_t board_stack_used(void);

/* Ends the program. */
_Noreturn void board_exit(int status);

/* Called before and after main(). They do nothing unless an image defines them, as one with the C
 * library's streams does. */
void board_before_main(void);
void board_after_main(void);

int main(void);

#endif
