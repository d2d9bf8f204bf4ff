#include "start.h"

#include "semihosting.h"

#include <string.h>

#define PAINT 0xc5c5c5c5u

static volatile bool stopping;

void board_prepare_memory(uint32_t *stack_pointer) {
    for (volatile uint32_t *word = board_stack_start; word < stack_pointer; word++) {
        *word = PAINT;
    }
    const volatile uint32_t *from = board_data_load;
    for (volatile uint32_t *to = board_data_start; to < board_data_end; to++) {
        *to = *from++;
    }
    for (volatile uint32_t *word = board_bss_start; word < board_bss_end; word++) {
        *word = 0;
    }
}

size_t board_stack_size(void) {
    return (size_t)((uintptr_t)board_stack_end - (uintptr_t)board_stack_start);
}

size_t board_stack_used(void) {
    const uint32_t *word = board_stack_start;
    while (word < board_stack_end && *word == PAINT) {
        word++;
    }
    return (size_t)((uintptr_t)board_stack_end - (uintptr_t)word);
}

__attribute__((weak)) void board_before_main(void) {}

__attribute__((weak)) void board_after_main(void) {}

_Noreturn void board_run(void) {
    board_open();
    board_before_main();
    const int status = main();
    board_after_main();
    board_exit(status);
}

bool board_is_stopping(void) {
    return stopping;
}

/* Without an emulator or debugger the call itself is a fault, whose handler then finds stopping. */
_Noreturn void board_exit(int status) {
    if (!stopping) {
        stopping = true;
        semihosting_exit(status);
    }
    for (;;) {
        __asm volatile("wfi");
    }
}

_Noreturn void board_stop_after_fault(void) {
    board_puts("END OF FAULT\n");
    board_exit(BOARD_STATUS_FAULT);
}

void board_puts(const char *text) {
    board_write(text, strlen(text));
}

void board_put_hex(uint32_t value) {
    char text[10] = "0x";
    for (int i = 0; i < 8; i++) {
        text[2 + i] = "0123456789abcdef"[(value >> (28 - 4 * i)) & 0xfu];
    }
    board_write(text, sizeof text);
}

void board_print_register(const char *name, uint32_t value) {
    board_puts(name);
    board_puts(" ");
    board_put_hex(value);
    board_puts("\n");
}
