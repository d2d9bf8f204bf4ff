#include "mps2_uart.h"

#include <stddef.h>

/* MISRA D13, T4 in this file. */

_Static_assert(MPS2_UART_RING <= 32768u && (MPS2_UART_RING & (MPS2_UART_RING - 1u)) == 0u,
               "positions wrap by masking");

/* The port's registers. */
typedef struct {
    volatile uint32_t data;
    volatile uint32_t state;
    volatile uint32_t control;
    volatile uint32_t interrupt; /* read: which; write 1: clear */
    volatile uint32_t divider;
} port_t;

#define STATE_TX_FULL 0x1u
#define STATE_RX_FULL 0x2u
#define STATE_RX_OVERRUN 0x8u
#define CONTROL_TX_RX 0x03u
#define CONTROL_INTERRUPTS 0x2cu /* transmit, receive, receive overrun */
#define INTERRUPT_ALL 0xfu
#define DIVIDER_MIN 16u

static port_t *port(const mps2_uart_t *uart) {
    return (port_t *)uart->base;
}

static uint16_t after(uint16_t position) {
    return (uint16_t)((position + 1u) & (MPS2_UART_RING - 1u));
}

static bool is_empty(const mps2_ring_t *ring) {
    return ring->head == ring->tail;
}

static bool ring_put(mps2_ring_t *ring, uint8_t byte) {
    const uint16_t next = after(ring->head);
    if (next == ring->tail) {
        return false;
    }
    ring->bytes[ring->head] = byte;
    ring->head = next;
    return true;
}

static uint8_t ring_take(mps2_ring_t *ring) {
    const uint8_t byte = ring->bytes[ring->tail];
    ring->tail = after(ring->tail);
    return byte;
}

/* The compiler keeps accesses to the rings on their side of it. */
static uint32_t mask_interrupts(void) {
    uint32_t before;
    __asm volatile("mrs %0, primask\n\tcpsid i" : "=r"(before)::"memory");
    return before;
}

static void restore_interrupts(uint32_t before) {
    __asm volatile("msr primask, %0" ::"r"(before) : "memory");
}

/* Hands over what the transmitter has room for. Interrupts are masked, or this is one. */
static void transmit(mps2_uart_t *uart) {
    while (!is_empty(&uart->waiting) && (port(uart)->state & STATE_TX_FULL) == 0u) {
        port(uart)->data = ring_take(&uart->waiting);
    }
}

static void lose(mps2_uart_t *uart) {
    uart->losing = true;
    if (uart->lost < UINT32_MAX) {
        uart->lost++;
    }
}

static void take_received(mps2_uart_t *uart) {
    while ((port(uart)->state & STATE_RX_FULL) != 0u) {
        const uint8_t byte = (uint8_t)port(uart)->data;
        if ((port(uart)->state & STATE_RX_OVERRUN) != 0u) {
            port(uart)->state = STATE_RX_OVERRUN;
            lose(uart);
        }
        if (uart->losing || !ring_put(&uart->received, byte)) {
            lose(uart);
        }
    }
}

void mps2_uart_interrupt(mps2_uart_t *uart) {
    port(uart)->interrupt = INTERRUPT_ALL;
    take_received(uart);
    transmit(uart);
}

bool mps2_uart_has_input(const mps2_uart_t *uart) {
    return uart->losing || !is_empty(&uart->received);
}

static byte_stream_outcome_t stream_read(void *context, uint8_t *bytes, size_t room,
                                         size_t *count) {
    mps2_uart_t *uart = context;
    *count = 0;
    while (*count < room && !is_empty(&uart->received)) {
        bytes[*count] = ring_take(&uart->received);
        (*count)++;
    }
    if (*count > 0) {
        return BYTE_STREAM_DONE;
    }
    if (uart->losing) {
        /* What came between the last look at the ring and this is from before the loss. */
        if (!is_empty(&uart->received)) {
            return BYTE_STREAM_AGAIN;
        }
        uart->losing = false;
        return BYTE_STREAM_FAILED;
    }
    return BYTE_STREAM_AGAIN;
}

static byte_stream_outcome_t stream_write(void *context, const uint8_t *bytes, size_t length,
                                          size_t *count) {
    mps2_uart_t *uart = context;
    const uint32_t before = mask_interrupts();
    *count = 0;
    transmit(uart);
    while (*count < length && ring_put(&uart->waiting, bytes[*count])) {
        (*count)++;
    }
    transmit(uart);
    restore_interrupts(before);
    return *count > 0 ? BYTE_STREAM_DONE : BYTE_STREAM_AGAIN;
}

byte_stream_t mps2_uart_stream(mps2_uart_t *uart) {
    static const byte_stream_api_t api = {stream_read, stream_write};
    return (byte_stream_t){&api, uart};
}

void mps2_uart_put(const mps2_uart_t *uart, char byte) {
    while ((port(uart)->state & STATE_TX_FULL) != 0u) {
    }
    port(uart)->data = (uint8_t)byte;
}

static void log_line(void *context, const char *text) {
    const mps2_uart_t *uart = context;
    for (; *text != '\0'; text++) {
        mps2_uart_put(uart, *text);
    }
    mps2_uart_put(uart, '\n');
}

berth_log_t mps2_uart_log(mps2_uart_t *uart) {
    static const berth_log_api_t api = {log_line};
    return (berth_log_t){&api, uart};
}

void mps2_uart_open(mps2_uart_t *uart, uintptr_t base, uint32_t clock_hz, uint32_t baud,
                    bool interrupts) {
    *uart = (mps2_uart_t){.base = base};
    const uint32_t divider = clock_hz / baud;
    port(uart)->control = 0;
    port(uart)->divider = divider < DIVIDER_MIN ? DIVIDER_MIN : divider;
    port(uart)->interrupt = INTERRUPT_ALL;
    const uint32_t interrupt_bits = interrupts ? CONTROL_INTERRUPTS : 0u;
    port(uart)->control = CONTROL_TX_RX | interrupt_bits;
}
