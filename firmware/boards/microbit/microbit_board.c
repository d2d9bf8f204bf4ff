#include "start.h"
#include "vectors.h"

/* Source: Nordic, "nRF51 Series Reference Manual": UART and TIMER. This part has no SysTick. */
#define REGISTER(address) (*(volatile uint32_t *)(uintptr_t)(address))
#define UART_START_TX REGISTER(0x40002008u)
#define UART_TX_READY REGISTER(0x4000211cu)
#define UART_ENABLE REGISTER(0x40002500u)
#define UART_PIN_TX REGISTER(0x4000250cu)
#define UART_TX REGISTER(0x4000251cu)
#define UART_BAUD REGISTER(0x40002524u)
#define TIMER_START REGISTER(0x40008000u)
#define TIMER_CAPTURE_0 REGISTER(0x40008040u)
#define TIMER_BIT_MODE REGISTER(0x40008508u)
#define TIMER_PRESCALER REGISTER(0x40008510u)
#define TIMER_CC_0 REGISTER(0x40008540u)

#define UART_ON 4u
#define UART_115200 0x01d7e000u
#define PIN_TX 24u
#define TIMER_32_BITS 3u
#define TIMER_1_MHZ 4u /* 16 MHz / 2^4 */

void board_open(void) {
    UART_PIN_TX = PIN_TX;
    UART_BAUD = UART_115200;
    UART_ENABLE = UART_ON;
    UART_START_TX = 1;
    TIMER_BIT_MODE = TIMER_32_BITS;
    TIMER_PRESCALER = TIMER_1_MHZ;
    TIMER_START = 1;
}

void board_write(const char *text, size_t length) {
    for (size_t i = 0; i < length; i++) {
        UART_TX_READY = 0;
        UART_TX = (uint8_t)text[i];
        while (UART_TX_READY == 0) {
        }
    }
}

/* Capturing and counting the wraps must not be torn apart. Asked at least once in 71 minutes, it
 * sees every wrap of the timer. */
int64_t board_now_us(void) {
    static int64_t wraps_us;
    static uint32_t last;
    uint32_t masked;
    __asm volatile("mrs %0, primask\n\tcpsid i" : "=r"(masked)::"memory");
    TIMER_CAPTURE_0 = 1;
    const uint32_t now = TIMER_CC_0;
    if (now < last) {
        wraps_us += (int64_t)1 << 32;
    }
    last = now;
    const int64_t time_us = wraps_us + now;
    __asm volatile("msr primask, %0" ::"r"(masked) : "memory");
    return time_us;
}

__attribute__((section(".vectors"), used))
const cortex_m_vector_t microbit_vectors[16] = {CORTEX_M_VECTORS};
