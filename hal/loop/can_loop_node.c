/* The nodes' side: queues, filters, the HAL's functions, and faults of an interface. */
#include "can_loop.h"
#include "can_loop_private.h"
#include "can_wire.h"

#define DELAY_MAX_US INT64_C(1000000000000000)

bool can_loop_present(const can_loop_node_t *node) {
    return node->mode == BERTH_CAN_ERROR_ACTIVE && !node->cut;
}

uint32_t can_loop_node_tec(const can_loop_node_t *node) {
    const bool unheard = node->cut && node->mode == BERTH_CAN_ERROR_ACTIVE && node->tx_count > 0u;
    return unheard && node->tec < CAN_LOOP_PASSIVE_AT ? CAN_LOOP_PASSIVE_AT : node->tec;
}

static bool wanted(const can_loop_node_t *node, const berth_can_frame_t *frame) {
    for (uint32_t i = 0; i < node->filter_count; i++) {
        const berth_can_filter_t *f = &node->filters[i];
        if (f->extended == frame->extended && ((frame->id ^ f->id) & f->mask) == 0u) {
            return true;
        }
    }
    return node->filter_count == 0u;
}

void can_loop_take(can_loop_node_t *node, const berth_can_frame_t *frame) {
    if (!wanted(node, frame)) {
        node->counters.filtered++;
    } else if (node->rx_count >= node->rx_depth) {
        node->counters.overflow++;
    } else {
        node->rx[(node->rx_first + node->rx_count) % CAN_LOOP_RX_MAX] = *frame;
        node->rx_count++;
        node->counters.received++;
    }
}

static void drop_oldest(can_loop_node_t *node) {
    if (!node->tx[node->tx_first].is_copy) {
        node->counters.dropped++;
    }
    node->tx_first = (node->tx_first + 1u) % CAN_LOOP_TX_MAX;
    node->tx_count--;
}

void can_loop_withdraw(can_loop_node_t *node, berth_can_mode_t mode) {
    while (node->tx_count > 0u) {
        drop_oldest(node);
    }
    node->mode = mode;
    node->recover_ns = CAN_LOOP_NEVER;
}

void can_loop_return(can_loop_node_t *node, int64_t at_ns) {
    node->mode = BERTH_CAN_ERROR_ACTIVE;
    node->tec = 0;
    node->rec = 0;
    node->since_ns = at_ns;
    node->recover_ns = CAN_LOOP_NEVER;
    node->counters.restarts++;
}

static can_loop_waiting_t waiting(const berth_can_frame_t *frame, int64_t now_ns) {
    return (can_loop_waiting_t){
        .frame = *frame,
        .queued_ns = now_ns,
        .rank = can_wire_rank(frame),
        .bits = can_wire_bits(frame),
    };
}

static berth_can_outcome_t node_send(void *context, const berth_can_frame_t *frame) {
    can_loop_node_t *node = context;
    if (node->mode != BERTH_CAN_ERROR_ACTIVE || !can_wire_valid(frame)) {
        return BERTH_CAN_FAILED;
    }
    if (node->tx_count >= node->tx_depth) {
        node->counters.refused++;
        return BERTH_CAN_AGAIN;
    }
    node->tx[(node->tx_first + node->tx_count) % CAN_LOOP_TX_MAX] =
        waiting(frame, node->loop->now_ns);
    node->tx_count++;
    return BERTH_CAN_DONE;
}

static berth_can_outcome_t node_receive(void *context, berth_can_frame_t *frame) {
    can_loop_node_t *node = context;
    if (node->mode != BERTH_CAN_ERROR_ACTIVE) {
        return BERTH_CAN_FAILED;
    }
    if (node->rx_count == 0u) {
        return BERTH_CAN_AGAIN;
    }
    *frame = node->rx[node->rx_first];
    node->rx_first = (node->rx_first + 1u) % CAN_LOOP_RX_MAX;
    node->rx_count--;
    return BERTH_CAN_DONE;
}

static uint32_t narrow(uint64_t count) {
    return count < UINT32_MAX ? (uint32_t)count : UINT32_MAX;
}

static void node_state(void *context, berth_can_state_t *state) {
    const can_loop_node_t *node = context;
    const can_loop_counters_t *c = &node->counters;
    const bool passive =
        can_loop_node_tec(node) >= CAN_LOOP_PASSIVE_AT || node->rec >= CAN_LOOP_PASSIVE_AT;
    *state = (berth_can_state_t){
        .mode = node->mode,
        .rx_lost = narrow(c->overflow),
        .tx_dropped = narrow(c->dropped),
        .error_frames = narrow(c->errors),
        .restarts = narrow(c->restarts),
    };
    if (node->mode == BERTH_CAN_ERROR_ACTIVE && passive) {
        state->mode = BERTH_CAN_ERROR_PASSIVE;
    }
}

static const berth_can_api_t node_api = {node_send, node_receive, node_state};

bool can_loop_attach(can_loop_t *loop, berth_can_t *can) {
    if (loop->node_count >= CAN_LOOP_NODES_MAX) {
        return false;
    }
    can_loop_node_t *node = &loop->nodes[loop->node_count];
    *node = (can_loop_node_t){
        .loop = loop,
        .number = loop->node_count,
        .mode = BERTH_CAN_ERROR_ACTIVE,
        .since_ns = loop->now_ns,
        .recover_ns = CAN_LOOP_NEVER,
        .auto_ns = CAN_LOOP_NEVER,
        .tx_depth = CAN_LOOP_TX_MAX,
        .rx_depth = CAN_LOOP_RX_MAX,
    };
    loop->node_count++;
    *can = (berth_can_t){&node_api, node};
    return true;
}

static uint32_t depth(uint32_t wish, uint32_t most) {
    if (wish < 1u) {
        return 1;
    }
    return wish < most ? wish : most;
}

void can_loop_depths(can_loop_t *loop, uint32_t number, uint32_t tx, uint32_t rx) {
    if (number >= loop->node_count) {
        return;
    }
    can_loop_node_t *node = &loop->nodes[number];
    node->tx_depth = depth(tx, CAN_LOOP_TX_MAX);
    node->rx_depth = depth(rx, CAN_LOOP_RX_MAX);
}

bool can_loop_filter(can_loop_t *loop, uint32_t number, const berth_can_filter_t *filter) {
    if (number >= loop->node_count || loop->nodes[number].filter_count >= CAN_LOOP_FILTERS_MAX) {
        return false;
    }
    can_loop_node_t *node = &loop->nodes[number];
    node->filters[node->filter_count] = *filter;
    node->filter_count++;
    return true;
}

void can_loop_filter_clear(can_loop_t *loop, uint32_t number) {
    if (number < loop->node_count) {
        loop->nodes[number].filter_count = 0;
    }
}

void can_loop_down(can_loop_t *loop, uint32_t number) {
    if (number < loop->node_count && loop->nodes[number].mode != BERTH_CAN_DOWN) {
        can_loop_abort(loop, number);
        can_loop_withdraw(&loop->nodes[number], BERTH_CAN_DOWN);
    }
}

void can_loop_up(can_loop_t *loop, uint32_t number) {
    if (number < loop->node_count && loop->nodes[number].mode == BERTH_CAN_DOWN) {
        can_loop_return(&loop->nodes[number], loop->now_ns);
    }
}

static int64_t recovery_ns(const can_loop_t *loop) {
    const uint32_t bits = CAN_WIRE_RECOVERY;
    return loop->bit_ns * (int64_t)bits;
}

void can_loop_bus_off(can_loop_t *loop, uint32_t number) {
    if (number >= loop->node_count || loop->nodes[number].mode != BERTH_CAN_ERROR_ACTIVE) {
        return;
    }
    can_loop_node_t *node = &loop->nodes[number];
    can_loop_abort(loop, number);
    can_loop_withdraw(node, BERTH_CAN_BUS_OFF);
    if (node->auto_ns != CAN_LOOP_NEVER) {
        node->recover_ns = loop->now_ns + node->auto_ns + recovery_ns(loop);
    }
}

void can_loop_recover(can_loop_t *loop, uint32_t number) {
    if (number >= loop->node_count || loop->nodes[number].mode != BERTH_CAN_BUS_OFF) {
        return;
    }
    can_loop_node_t *node = &loop->nodes[number];
    const int64_t at_ns = loop->now_ns + recovery_ns(loop);
    if (at_ns < node->recover_ns) {
        node->recover_ns = at_ns;
    }
}

void can_loop_auto_recover(can_loop_t *loop, uint32_t number, int64_t delay_us) {
    if (number >= loop->node_count) {
        return;
    }
    const int64_t most_us = delay_us < DELAY_MAX_US ? delay_us : DELAY_MAX_US;
    loop->nodes[number].auto_ns = delay_us < 0 ? CAN_LOOP_NEVER : most_us * 1000;
}

void can_loop_cut(can_loop_t *loop, uint32_t number, bool cut) {
    if (number >= loop->node_count || loop->nodes[number].cut == cut) {
        return;
    }
    can_loop_node_t *node = &loop->nodes[number];
    if (cut) {
        can_loop_abort(loop, number);
    } else {
        node->tec = can_loop_node_tec(node);
        node->since_ns = loop->now_ns;
    }
    node->cut = cut;
}

bool can_loop_babble(can_loop_t *loop, uint32_t number, const berth_can_frame_t *frame,
                     int64_t until_us) {
    if (number >= loop->node_count || !can_wire_valid(frame)) {
        return false;
    }
    const int64_t last_us = until_us < CAN_LOOP_TIME_MAX_US ? until_us : CAN_LOOP_TIME_MAX_US;
    loop->nodes[number].babble = waiting(frame, loop->now_ns);
    loop->nodes[number].babble_until_ns = last_us > 0 ? last_us * 1000 : 0;
    return true;
}

const can_loop_counters_t *can_loop_counters(const can_loop_t *loop, uint32_t node) {
    return &loop->nodes[node].counters;
}

uint32_t can_loop_waiting(const can_loop_t *loop, uint32_t node) {
    const can_loop_node_t *n = &loop->nodes[node];
    return n->tx_count > 0u && n->tx[n->tx_first].is_copy ? n->tx_count - 1u : n->tx_count;
}

uint32_t can_loop_tec(const can_loop_t *loop, uint32_t node) {
    return can_loop_node_tec(&loop->nodes[node]);
}

uint32_t can_loop_rec(const can_loop_t *loop, uint32_t node) {
    return loop->nodes[node].rec;
}
