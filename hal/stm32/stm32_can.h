/* stm32_can.h - what the CAN drivers of this folder share: bit timing, results, and the queue
 * between the receive interrupt and receive().
 */
#ifndef BERTH_HAL_STM32_CAN_H
#define BERTH_HAL_STM32_CAN_H

#include "berth_hal/can.h"

#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Why a controller could not be opened. */
typedef enum {
    STM32_CAN_OK = 0,
    STM32_CAN_ERROR_ARGUMENT = -1,  /* a pointer is missing, or a number is out of its range */
    STM32_CAN_ERROR_TIMING = -2,    /* this bit rate cannot be made from this clock */
    STM32_CAN_ERROR_FILTERS = -3,   /* more filters than the controller has, or an id too large */
    STM32_CAN_ERROR_SILENT = -4,    /* the controller does not answer: no clock, or not there */
    STM32_CAN_ERROR_NOT_JOINED = -5 /* set up, but the bus has not been idle for 11 bits: no
                                       transceiver, or held dominant. The mode is DOWN; it becomes
                                       active by itself once the bus is idle */
} stm32_can_result_t;

/* Short English text; never NULL. */
const char *stm32_can_result_text(stm32_can_result_t result);

/* How bus-off is left. In each case the controller then waits for 128 times 11 recessive bits. */
typedef enum {
    STM32_CAN_RECOVER_AFTER = 0,   /* by the driver, a set time after it was noticed */
    STM32_CAN_RECOVER_AT_ONCE = 1, /* as soon as possible: by hardware where it can */
    STM32_CAN_RECOVER_ORDERED = 2  /* only when the program calls for it */
} stm32_can_recovery_t;

/* ---- Bit timing -------------------------------------------------------------------------------
 */

/* A controller's limits, in time quanta; each minimum is 1. */
typedef struct {
    uint32_t prescaler_max;
    uint32_t segment1_max; /* propagation and phase segment 1 together */
    uint32_t segment2_max;
    uint32_t jump_max;
} stm32_can_limits_t;

/* One bit is 1 + segment1 + segment2 quanta of prescaler clocks each. */
typedef struct {
    uint32_t prescaler;
    uint32_t segment1;
    uint32_t segment2;
    uint32_t jump;
} stm32_can_timing_t;

#define STM32_CAN_QUANTA_MIN 8u
#define STM32_CAN_QUANTA_MAX 80u

/* The timing whose bit rate is exact, with 8 to 80 quanta a bit and the sample point between 75 and
 * 87.5 %, as near to 80 % as can be, and among those with the most quanta. The jump width is
 * the largest allowed: segment 2, or jump_max. False when there is none, and *out is then as it
 * was. Cost: some 10,000 instructions. */
bool stm32_can_timing(uint32_t clock_hz, uint32_t bit_rate, const stm32_can_limits_t *limits,
                      stm32_can_timing_t *out);

/* ---- Queue ------------------------------------------------------------------------------------
 *
 * One producer, the receive interrupt, and one consumer, receive(), on one processor. head is
 * written by the producer alone, tail by the consumer alone; each writes its frame (or is done with
 * reading it) before it moves its own index, and the compiler is kept from turning that around. A
 * processor sees its own accesses in program order, interrupts included, so neither masks
 * interrupts nor needs a barrier instruction.
 */

/* Frames that wait for receive(): a power of two. 64 are 7 ms of the shortest frames with data at
 * 1 Mbit/s without a gap. */
#ifndef STM32_CAN_RX_MAX
#define STM32_CAN_RX_MAX 64u
#endif

typedef struct {
    berth_can_frame_t frames[STM32_CAN_RX_MAX];
    volatile uint32_t head; /* frames put in so far */
    volatile uint32_t tail; /* frames taken out so far */
} stm32_can_ring_t;

_Static_assert((STM32_CAN_RX_MAX & (STM32_CAN_RX_MAX - 1u)) == 0u && STM32_CAN_RX_MAX >= 2u,
               "the counts wrap, so the size must divide them");

/* Where the producer may write the next frame; NULL when the queue is full. */
static inline berth_can_frame_t *stm32_can_ring_place(stm32_can_ring_t *ring) {
    const uint32_t head = ring->head;
    return head - ring->tail < STM32_CAN_RX_MAX ? &ring->frames[head % STM32_CAN_RX_MAX] : NULL;
}

/* The frame there is whole. */
static inline void stm32_can_ring_put(stm32_can_ring_t *ring) {
    atomic_signal_fence(memory_order_release);
    ring->head = ring->head + 1u;
}

static inline bool stm32_can_ring_is_empty(const stm32_can_ring_t *ring) {
    return ring->head == ring->tail;
}

static inline bool stm32_can_ring_take(stm32_can_ring_t *ring, berth_can_frame_t *frame) {
    if (stm32_can_ring_is_empty(ring)) {
        return false;
    }
    atomic_signal_fence(memory_order_acquire);
    *frame = ring->frames[ring->tail % STM32_CAN_RX_MAX];
    atomic_signal_fence(memory_order_release);
    ring->tail = ring->tail + 1u;
    return true;
}

/* ---- Small things -----------------------------------------------------------------------------
 */

/* A counter stays at its largest value. */
static inline void stm32_can_count(volatile uint32_t *counter) {
    const uint32_t value = *counter;
    if (value < UINT32_MAX) {
        *counter = value + 1u;
    }
}

/* id and length within their ranges. Of a filter's mask, bits beyond the id's do no harm. */
bool stm32_can_frame_is_good(const berth_can_frame_t *frame);
bool stm32_can_filter_is_good(const berth_can_filter_t *filter);

/* Data bytes as two little-endian words, and back. Bytes beyond length become 0. */
void stm32_can_pack(const berth_can_frame_t *frame, uint32_t words[2]);
void stm32_can_unpack(berth_can_frame_t *frame, const uint32_t words[2]);

#ifdef __cplusplus
}
#endif

#endif
