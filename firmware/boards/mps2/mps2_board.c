#include "mps2_board.h"

#include "mps2_numbers.h"
#include "start.h"
#include "vectors.h"

#define NVIC_ISER(line) (*(volatile uint32_t *)(uintptr_t)(0xe000e100u + 4u * ((line) / 32u)))

static mps2_clock_t system_clock;
static mps2_uart_t console;
static mps2_uart_t bus;

void board_open(void) {
    mps2_uart_open(&console, MPS2_CONSOLE, MPS2_CLOCK_HZ, MPS2_BAUD, false);
    mps2_uart_open(&bus, MPS2_BUS, MPS2_CLOCK_HZ, MPS2_BAUD, true);
    NVIC_ISER(MPS2_BUS_LINE) = 3u << (MPS2_BUS_LINE % 32u);
    mps2_clock_start(&system_clock, MPS2_CLOCK_HZ);
    mps2_clock_wake_by(&system_clock, &bus);
}

void cortex_m_tick(void) {
    mps2_clock_tick(&system_clock);
}

static void bus_interrupt(void) {
    mps2_uart_interrupt(&bus);
}

__attribute__((section(".vectors"), used))
const cortex_m_vector_t mps2_vectors[16 + MPS2_BUS_LINE + 2] = {
    CORTEX_M_VECTORS,
    [16 + MPS2_BUS_LINE] = {.handler = bus_interrupt},
    [16 + MPS2_BUS_LINE + 1] = {.handler = bus_interrupt},
};

void board_write(const char *text, size_t length) {
    for (size_t i = 0; i < length; i++) {
        mps2_uart_put(&console, text[i]);
    }
}

berth_clock_t board_clock(void) {
    return mps2_clock(&system_clock);
}

int64_t board_now_us(void) {
    const berth_clock_t clock = board_clock();
    return clock.api->now_us(clock.context);
}

berth_log_t board_log(void) {
    return mps2_uart_log(&console);
}

byte_stream_t board_bus(void) {
    return mps2_uart_stream(&bus);
}
