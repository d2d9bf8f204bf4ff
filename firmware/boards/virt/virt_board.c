#include "start.h"

#define UART_DATA (*(volatile uint8_t *)0x10000000u)
#define UART_LINE_STATUS (*(volatile uint8_t *)0x10000005u)
#define UART_TX_EMPTY 0x20u

/* Machine timer: 10 MHz. */
#define MTIME_LOW (*(volatile uint32_t *)0x0200bff8u)
#define MTIME_HIGH (*(volatile uint32_t *)0x0200bffcu)
#define MTIME_PER_US 10

void board_open(void) {}

void board_write(const char *text, size_t length) {
    for (size_t i = 0; i < length; i++) {
        while ((UART_LINE_STATUS & UART_TX_EMPTY) == 0) {
        }
        UART_DATA = (uint8_t)text[i];
    }
}

int64_t board_now_us(void) {
    uint32_t high, low;
    do {
        high = MTIME_HIGH;
        low = MTIME_LOW;
    } while (high != MTIME_HIGH);
    return (int64_t)(((uint64_t)high << 32 | low) / MTIME_PER_US);
}
