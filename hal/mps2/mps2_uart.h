/* mps2_uart.h - the serial ports of Arm's MPS2 boards (the CMSDK's APB UART): a byte stream for
 * slcan, and a log.
 *
 *     mps2_uart_open(&uart, base, 25000000, 115200);
 *     the port's receive and transmit interrupts: mps2_uart_interrupt(&uart);
 *     slcan over mps2_uart_stream(&uart)
 *
 * The stream goes through two rings that the interrupt fills and empties, so no byte is lost while
 * the caller computes for less than MPS2_UART_RING bytes' time. When bytes are lost all the same,
 * what came before them can still be read, then read answers FAILED once, and what came in between
 * is thrown away. The stream's functions belong to one context; the interrupt may come at any time.
 *
 * A log blocks until its line is out, and does not use the rings: give it a port of its own.
 * Source: Arm, "Cortex-M System Design Kit", APB UART.
 */
#ifndef BERTH_HAL_MPS2_UART_H
#define BERTH_HAL_MPS2_UART_H

#include "berth_hal/log.h"
#include "byte_stream.h"

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Bytes of each ring, a power of two up to 32768; holds one less. */
#ifndef MPS2_UART_RING
#define MPS2_UART_RING 512u
#endif

typedef struct {
    uint8_t bytes[MPS2_UART_RING];
    volatile uint16_t head; /* next to be filled */
    volatile uint16_t tail; /* next to be taken */
} mps2_ring_t;

typedef struct {
    uintptr_t base;
    mps2_ring_t received;
    mps2_ring_t waiting;
    volatile bool losing;   /* bytes are thrown away until the stream has said so */
    volatile uint32_t lost; /* received bytes that were thrown away, since it was opened */
} mps2_uart_t;

/* clock_hz: the port's. interrupts: for the stream; without them only log and put work. */
void mps2_uart_open(mps2_uart_t *uart, uintptr_t base, uint32_t clock_hz, uint32_t baud,
                    bool interrupts);

/* To be called by the handlers of the port's interrupts, in any number. */
void mps2_uart_interrupt(mps2_uart_t *uart);

/* Something can be read, or a loss be told. Any context. */
bool mps2_uart_has_input(const mps2_uart_t *uart);

byte_stream_t mps2_uart_stream(mps2_uart_t *uart);

/* Writes one byte, past the ring. Blocks; any context. */
void mps2_uart_put(const mps2_uart_t *uart, char byte);

berth_log_t mps2_uart_log(mps2_uart_t *uart);

#ifdef __cplusplus
}
#endif

#endif
