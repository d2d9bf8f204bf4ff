/* vectors.h - the handlers of the core, and the first sixteen entries of a vector table.
 *
 *     __attribute__((section(".vectors"), used))
 *     const cortex_m_vector_t vectors[16 + N] = {CORTEX_M_VECTORS, [16 + LINE] = handler};
 */
#ifndef BERTH_BOARDS_CORTEX_M_VECTORS_H
#define BERTH_BOARDS_CORTEX_M_VECTORS_H

#include <stdint.h>

typedef union {
    uint32_t *stack;
    void (*handler)(void);
} cortex_m_vector_t;

extern uint32_t board_handler_stack_end[];

void board_reset(void);
void cortex_m_fault(void);

/* A board's own, or none. */
void cortex_m_tick(void);

#define CORTEX_M_VECTORS                                                                           \
    [0] = {.stack = board_handler_stack_end}, [1] = {.handler = board_reset},                      \
    [2] = {.handler = cortex_m_fault}, [3] = {.handler = cortex_m_fault},                          \
    [4] = {.handler = cortex_m_fault}, [5] = {.handler = cortex_m_fault},                          \
    [6] = {.handler = cortex_m_fault}, [7] = {.handler = cortex_m_fault},                          \
    [11] = {.handler = cortex_m_fault}, [12] = {.handler = cortex_m_fault},                        \
    [14] = {.handler = cortex_m_fault}, [15] = {.handler = cortex_m_tick}

#endif
