/* can_fault.h - makes chosen calls to any CAN bus answer in another way that its contract allows.
 *
 * Put it around a berth_can_t and hand out its own instead. It counts the calls, passes them on,
 * and answers those that an order picks itself, without passing them on: send with AGAIN or FAILED,
 * receive with AGAIN or FAILED (the frame untouched), state with any mode and the counters of the
 * last answer that was passed on (zeros before the first). So for each k one can ask what happens
 * when the k-th call fails.
 *
 * One plain struct, the caller's, no heap; not to be moved once it is in use. Same context as the
 * bus around which it is. Constant cost.
 */
#ifndef CAN_FAULT_H
#define CAN_FAULT_H

#include "berth_hal/can.h"

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* The calls, as bits of a set. */
#define CAN_FAULT_SEND 1u
#define CAN_FAULT_RECEIVE 2u
#define CAN_FAULT_STATE 4u
#define CAN_FAULT_ANY (CAN_FAULT_SEND | CAN_FAULT_RECEIVE | CAN_FAULT_STATE)

#define CAN_FAULT_FOREVER UINT64_MAX

/* Of the calls in the set, counted together from 0 since can_fault_init, those from first on, count
 * of them, are answered: send and receive with outcome, state with mode. */
typedef struct {
    uint32_t calls;
    uint64_t first;
    uint64_t count;              /* 0: none */
    berth_can_outcome_t outcome; /* AGAIN or FAILED */
    berth_can_mode_t mode;
} can_fault_order_t;

/* Private: read it through the functions. */
typedef struct {
    berth_can_t inner;
    can_fault_order_t order;
    bool ordered;
    uint64_t counts[8]; /* calls, by set: each call counts in every set that has it */
    uint64_t answered;
    berth_can_state_t last;
} can_fault_t;

/* Counts from 0, nothing ordered. Returns the bus to hand out. */
berth_can_t can_fault_init(can_fault_t *fault, const berth_can_t *inner);

/* Replaces the order in force. False, and nothing changed, for a set that is empty or has other
 * bits, for an outcome that is neither AGAIN nor FAILED, or for a mode that there is not. */
bool can_fault_order(can_fault_t *fault, const can_fault_order_t *order);

/* Nothing ordered any more; the counts go on. */
void can_fault_clear(can_fault_t *fault);

/* How many calls of a set there were, answered ones included. 0 for a set with other bits. */
uint64_t can_fault_calls(const can_fault_t *fault, uint32_t calls);

/* How many calls were answered instead of passed on. */
uint64_t can_fault_answered(const can_fault_t *fault);

#ifdef __cplusplus
}
#endif

#endif
