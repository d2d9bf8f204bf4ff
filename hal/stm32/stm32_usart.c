#include "stm32_usart.h"

#include <stdatomic.h>
#include <string.h>

_Static_assert((STM32_USART_RING & (STM32_USART_RING - 1u)) == 0u && STM32_USART_RING >= 2u,
               "the counts wrap, so the size must divide them");

#define DIVIDER_MIN 16u
#define DIVIDER_MAX 0xffffu

static bool is_empty(const stm32_usart_ring_t *ring) {
    return ring->head == ring->tail;
}

static uint32_t room_of(const stm32_usart_ring_t *ring) {
    return STM32_USART_RING - (ring->head - ring->tail);
}

static bool put_byte(stm32_usart_ring_t *ring, uint8_t byte) {
    const uint32_t head = ring->head;
    if (room_of(ring) == 0u) {
        return false;
    }
    ring->bytes[head % STM32_USART_RING] = byte;
    atomic_signal_fence(memory_order_release);
    ring->head = head + 1u;
    return true;
}

/* Not from an empty ring. */
static uint8_t take_byte(stm32_usart_ring_t *ring) {
    const uint32_t tail = ring->tail;
    atomic_signal_fence(memory_order_acquire);
    const uint8_t byte = ring->bytes[tail % STM32_USART_RING];
    atomic_signal_fence(memory_order_release);
    ring->tail = tail + 1u;
    return byte;
}

bool stm32_usart_open(stm32_usart_t *usart, stm32f4_usart_t *regs, uint32_t clock_hz,
                      uint32_t baud) {
    *usart = (stm32_usart_t){.regs = regs};
    if (baud == 0u) {
        return false;
    }
    const uint32_t divider = clock_hz / baud + (clock_hz % baud >= baud - baud / 2u ? 1u : 0u);
    if (divider < DIVIDER_MIN || divider > DIVIDER_MAX) {
        return false;
    }
    const uint32_t made = clock_hz / divider;
    const uint32_t off = made > baud ? made - baud : baud - made;
    if (off > baud / 50u) {
        return false;
    }
    stm32_write(&regs->cr1, 0);
    stm32_write(&regs->cr2, 0);
    stm32_write(&regs->cr3, 0);
    stm32_write(&regs->brr, divider); /* oversampling by 16: in sixteenths, as it is */
    stm32_write(&regs->cr1, USART_CR1_UE | USART_CR1_TE | USART_CR1_RE | USART_CR1_RXNEIE);
    return true;
}

static void lose(stm32_usart_t *usart) {
    usart->losing = true;
    if (usart->lost < UINT32_MAX) {
        usart->lost = usart->lost + 1u;
    }
}

void stm32_usart_interrupt(stm32_usart_t *usart) {
    stm32f4_usart_t *regs = usart->regs;
    const uint32_t status = stm32_read(&regs->sr);
    if ((status & (USART_SR_RXNE | USART_SR_ORE)) != 0u) {
        /* Reading the data after the status clears an overrun too. */
        const uint8_t byte = (uint8_t)(stm32_read(&regs->dr) & 0xffu);
        const bool good = (status & USART_SR_RXNE) != 0u;
        if (good && (usart->losing || !put_byte(&usart->received, byte))) {
            lose(usart);
        }
        if ((status & USART_SR_ORE) != 0u) {
            lose(usart);
        }
    }
    if ((status & USART_SR_TXE) != 0u) {
        if (!is_empty(&usart->waiting)) {
            stm32_write(&regs->dr, take_byte(&usart->waiting));
        } else {
            stm32_change(&regs->cr1, USART_CR1_TXEIE, 0);
        }
    }
}

void stm32_usart_poll(stm32_usart_t *usart) {
    const uint32_t before = stm32_io_mask();
    stm32_usart_interrupt(usart);
    stm32_io_unmask(before);
}

bool stm32_usart_has_input(const stm32_usart_t *usart) {
    return usart->losing || !is_empty(&usart->received);
}

/* The interrupt switches itself off when it finds nothing. Should it do so between the read and the
 * write here, it is on once more than needed; never off while something waits. */
static void start_sending(const stm32_usart_t *usart) {
    stm32_change(&usart->regs->cr1, 0, USART_CR1_TXEIE);
}

static byte_stream_outcome_t stream_read(void *context, uint8_t *bytes, size_t room,
                                         size_t *count) {
    stm32_usart_t *usart = context;
    const bool losing = usart->losing;
    *count = 0;
    while (*count < room && !is_empty(&usart->received)) {
        bytes[*count] = take_byte(&usart->received);
        (*count)++;
    }
    if (*count > 0) {
        return BYTE_STREAM_DONE;
    }
    /* Once it loses, the interrupt puts nothing in: the ring that was empty after that stays so. */
    if (losing) {
        usart->losing = false;
        return BYTE_STREAM_FAILED;
    }
    return BYTE_STREAM_AGAIN;
}

static byte_stream_outcome_t stream_write(void *context, const uint8_t *bytes, size_t length,
                                          size_t *count) {
    stm32_usart_t *usart = context;
    *count = 0;
    while (*count < length && put_byte(&usart->waiting, bytes[*count])) {
        (*count)++;
    }
    start_sending(usart);
    return *count > 0 ? BYTE_STREAM_DONE : BYTE_STREAM_AGAIN;
}

byte_stream_t stm32_usart_stream(stm32_usart_t *usart) {
    static const byte_stream_api_t api = {stream_read, stream_write};
    return (byte_stream_t){&api, usart};
}

static void log_line(void *context, const char *text) {
    stm32_usart_t *usart = context;
    const size_t length = strlen(text);
    if (length + 2u > room_of(&usart->waiting)) {
        if (usart->lines_dropped < UINT32_MAX) {
            usart->lines_dropped++;
        }
        return;
    }
    for (size_t i = 0; i < length; i++) {
        (void)put_byte(&usart->waiting, (uint8_t)text[i]);
    }
    (void)put_byte(&usart->waiting, (uint8_t)'\r');
    (void)put_byte(&usart->waiting, (uint8_t)'\n');
    start_sending(usart);
}

berth_log_t stm32_usart_log(stm32_usart_t *usart) {
    static const berth_log_api_t api = {log_line};
    return (berth_log_t){&api, usart};
}

void stm32_usart_put(const stm32_usart_t *usart, uint8_t byte) {
    for (uint32_t looks = 0; looks < STM32_USART_PUT_LOOKS; looks++) {
        if ((stm32_read(&usart->regs->sr) & USART_SR_TXE) != 0u) {
            stm32_write(&usart->regs->dr, byte);
            return;
        }
    }
}
