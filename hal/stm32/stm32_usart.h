/* stm32_usart.h - a serial port of an STM32F4: a byte stream (a console, slcan) and a log.
 *
 *     stm32_usart_open(&port, registers, 84000000, 115200);
 *     the port's interrupt: stm32_usart_interrupt(&port);
 *     stm32_usart_stream(&port), stm32_usart_log(&port)
 *
 * 8 data bits, no parity, one stop bit. The caller switches the peripheral's clock on, sets up its
 * pins, and enables the interrupt in the NVIC.
 *
 * Bytes go through two rings between the stream's context and the interrupt; each index has one
 * writer, so nothing is masked. Received bytes that find no room, and overruns of the port, are
 * counted; what came before can still be read, then read answers FAILED once, and what came in
 * between is thrown away. Written bytes that find no room are not taken (AGAIN).
 *
 * The log puts whole lines into the ring, or drops them: it never waits.
 */
#ifndef BERTH_HAL_STM32_USART_H
#define BERTH_HAL_STM32_USART_H

#include "berth_hal/log.h"
#include "byte_stream.h"
#include "stm32f4_regs.h"

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Bytes of each ring: a power of two. */
#ifndef STM32_USART_RING
#define STM32_USART_RING 512u
#endif

typedef struct {
    uint8_t bytes[STM32_USART_RING];
    volatile uint32_t head; /* bytes put in so far */
    volatile uint32_t tail; /* bytes taken out so far */
} stm32_usart_ring_t;

typedef struct {
    stm32f4_usart_t *regs;
    stm32_usart_ring_t received;
    stm32_usart_ring_t waiting;
    volatile bool losing;   /* received bytes are thrown away until the stream has said so */
    volatile uint32_t lost; /* received bytes thrown away */
    uint32_t lines_dropped; /* by the log */
} stm32_usart_t;

/* False when the baud rate cannot be made within 2 %; nothing is touched then. */
bool stm32_usart_open(stm32_usart_t *usart, stm32f4_usart_t *regs, uint32_t clock_hz,
                      uint32_t baud);

void stm32_usart_interrupt(stm32_usart_t *usart);

/* Does what the interrupt would do, with interrupts masked for that long. Only for ports whose
 * interrupts do not all come: an emulator's has none for sending. From the stream's context. */
void stm32_usart_poll(stm32_usart_t *usart);

byte_stream_t stm32_usart_stream(stm32_usart_t *usart);
berth_log_t stm32_usart_log(stm32_usart_t *usart);

/* Something can be read, or a loss be told. Any context. */
bool stm32_usart_has_input(const stm32_usart_t *usart);

/* Writes one byte past the ring, for the last words before the end: any context, waits for the port
 * at most STM32_USART_PUT_LOOKS times. */
#define STM32_USART_PUT_LOOKS 100000u
void stm32_usart_put(const stm32_usart_t *usart, uint8_t byte);

#ifdef __cplusplus
}
#endif

#endif
