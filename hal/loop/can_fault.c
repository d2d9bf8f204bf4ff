#include "can_fault.h"

/* MISRA T2 in this file. */

#define SETS 8u

/* Counts a call; true when the order picks it. */
static bool picked(can_fault_t *fault, uint32_t call) {
    bool pick = false;
    if (fault->ordered && (fault->order.calls & call) != 0u) {
        const uint64_t number = fault->counts[fault->order.calls];
        pick = number >= fault->order.first && number - fault->order.first < fault->order.count;
    }
    for (uint32_t set = 1; set < SETS; set++) {
        if ((set & call) != 0u) {
            fault->counts[set]++;
        }
    }
    fault->answered += pick ? 1u : 0u;
    return pick;
}

static berth_can_outcome_t fault_send(void *context, const berth_can_frame_t *frame) {
    can_fault_t *fault = context;
    if (picked(fault, CAN_FAULT_SEND)) {
        return fault->order.outcome;
    }
    return fault->inner.api->send(fault->inner.context, frame);
}

static berth_can_outcome_t fault_receive(void *context, berth_can_frame_t *frame) {
    can_fault_t *fault = context;
    if (picked(fault, CAN_FAULT_RECEIVE)) {
        return fault->order.outcome;
    }
    return fault->inner.api->receive(fault->inner.context, frame);
}

static void fault_state(void *context, berth_can_state_t *state) {
    can_fault_t *fault = context;
    if (picked(fault, CAN_FAULT_STATE)) {
        *state = fault->last;
        state->mode = fault->order.mode;
        return;
    }
    fault->inner.api->state(fault->inner.context, state);
    fault->last = *state;
}

berth_can_t can_fault_init(can_fault_t *fault, const berth_can_t *inner) {
    static const berth_can_api_t api = {fault_send, fault_receive, fault_state};
    *fault = (can_fault_t){.inner = *inner};
    return (berth_can_t){&api, fault};
}

bool can_fault_order(can_fault_t *fault, const can_fault_order_t *order) {
    const bool outcome = order->outcome == BERTH_CAN_AGAIN || order->outcome == BERTH_CAN_FAILED;
    const bool mode = order->mode == BERTH_CAN_ERROR_ACTIVE ||
                      order->mode == BERTH_CAN_ERROR_PASSIVE || order->mode == BERTH_CAN_BUS_OFF ||
                      order->mode == BERTH_CAN_DOWN;
    if (order->calls == 0u || order->calls > CAN_FAULT_ANY || !outcome || !mode) {
        return false;
    }
    fault->order = *order;
    fault->ordered = true;
    return true;
}

void can_fault_clear(can_fault_t *fault) {
    fault->ordered = false;
}

uint64_t can_fault_calls(const can_fault_t *fault, uint32_t calls) {
    return calls < SETS ? fault->counts[calls] : 0u;
}

uint64_t can_fault_answered(const can_fault_t *fault) {
    return fault->answered;
}
