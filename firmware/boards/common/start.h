/* start.h - between the start-up code of a processor and that of a board. */
#ifndef BERTH_BOARDS_START_H
#define BERTH_BOARDS_START_H

#include "board.h"

#include <stdbool.h>
#include <stdint.h>

/* Set by the linker script. */
extern uint32_t board_stack_start[], board_stack_end[];
extern uint32_t board_handler_stack_start[], board_handler_stack_end[];
extern uint32_t board_data_start[], board_data_end[], board_data_load[];
extern uint32_t board_bss_start[], board_bss_end[];
extern char board_heap_start[], board_heap_end[];

/* A board's own: opens console and clock. */
void board_open(void);

/* Paints the main stack below the given address; then .data and .bss. No function that is called
 * earlier may use either. */
void board_prepare_memory(uint32_t *stack_pointer);

/* All that follows once memory and stack are there. */
_Noreturn void board_run(void);

/* One register of a fault's print. */
void board_print_register(const char *name, uint32_t value);

/* True when a fault has come up or the program has ended; what comes after that must not print. */
bool board_is_stopping(void);
_Noreturn void board_stop_after_fault(void);

#endif
