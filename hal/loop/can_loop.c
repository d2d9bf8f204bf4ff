/* The bus's side: what happens when, arbitration, faults, delivery. */
#include "can_loop.h"
#include "can_loop_private.h"
#include "can_wire.h"

#include <stddef.h>

#define NS_PER_US 1000
#define SECOND_NS 1000000000u
#define BIT_RATE_MIN 1000u
#define DELAY_MAX_US INT64_C(1000000000000000)
#define COUNTER_MAX 255u

_Static_assert(CAN_LOOP_NODES_MAX >= 1u && CAN_LOOP_NODES_MAX <= 32u,
               "deaf has a bit for each node");
_Static_assert(CAN_LOOP_TX_MAX >= 1u && CAN_LOOP_RX_MAX >= 1u, "queues hold something");

/* What happens next, and when. */
typedef enum { NOTHING, WIRE_END, LATE_DUE, NODE_BACK, FRAME_START } kind_t;

typedef struct {
    kind_t kind;
    int64_t at_ns;
    uint32_t index; /* of the node, or of the late delivery */
} next_t;

static int64_t up_to_us(int64_t ns) {
    return (ns + NS_PER_US - 1) / NS_PER_US;
}

static int64_t later(int64_t a, int64_t b) {
    return a > b ? a : b;
}

bool can_loop_init(can_loop_t *loop, uint32_t bit_rate, int64_t now_us, uint64_t seed) {
    if (bit_rate < BIT_RATE_MIN || bit_rate > CAN_LOOP_BIT_RATE || SECOND_NS % bit_rate != 0u ||
        now_us < 0 || now_us > CAN_LOOP_TIME_MAX_US) {
        return false;
    }
    static const can_loop_t empty = {0};
    *loop = empty;
    loop->now_ns = now_us * NS_PER_US;
    loop->idle_ns = loop->now_ns;
    loop->bit_ns = (int64_t)SECOND_NS / (int64_t)bit_rate;
    loop->random = seed;
    return true;
}

static bool babbles(const can_loop_node_t *node, int64_t at_ns) {
    return at_ns < node->babble_until_ns;
}

/* The earliest start of a frame, and who wins the arbitration then. */
static next_t next_start(const can_loop_t *loop) {
    next_t first = {NOTHING, CAN_LOOP_NEVER, 0};
    uint32_t best = 0;
    for (uint32_t i = 0; i < loop->node_count; i++) {
        const can_loop_node_t *node = &loop->nodes[i];
        if (!can_loop_present(node)) {
            continue;
        }
        const int64_t free_ns =
            later(later(loop->idle_ns, loop->now_ns), later(node->suspend_ns, node->since_ns));
        const can_loop_waiting_t *w = &node->tx[node->tx_first];
        if (babbles(node, free_ns)) {
            w = &node->babble;
        } else if (node->tx_count == 0u) {
            continue;
        } else {
            /* its first frame */
        }
        const int64_t at_ns = later(free_ns, w->queued_ns);
        if (at_ns < first.at_ns || (at_ns == first.at_ns && w->rank < best)) {
            first = (next_t){FRAME_START, at_ns, i};
            best = w->rank;
        }
    }
    return first;
}

/* a, unless b is earlier. */
static next_t earlier(next_t a, next_t b) {
    return b.at_ns < a.at_ns ? b : a;
}

static next_t next_event(const can_loop_t *loop) {
    next_t next = {NOTHING, CAN_LOOP_NEVER, 0};
    if (loop->wire.active) {
        next = (next_t){WIRE_END, loop->wire.event.end_ns, 0};
    }
    for (uint32_t i = 0; i < loop->late_count; i++) {
        next = earlier(next, (next_t){LATE_DUE, loop->late[i].due_ns, i});
    }
    for (uint32_t i = 0; i < loop->node_count; i++) {
        next = earlier(next, (next_t){NODE_BACK, loop->nodes[i].recover_ns, i});
    }
    return loop->wire.active ? next : earlier(next, next_start(loop));
}

/* splitmix64 */
static double draw(can_loop_t *loop) {
    loop->random += 0x9e3779b97f4a7c15u;
    uint64_t z = loop->random;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    z ^= z >> 31;
    return (double)(z >> 11) * 0x1p-53;
}

static bool rule_fits(const can_loop_rule_t *rule, uint32_t node, const berth_can_frame_t *frame) {
    const berth_can_filter_t *f = &rule->filter;
    if (rule->node != CAN_LOOP_ANY_NODE && rule->node != node) {
        return false;
    }
    return !rule->filtered ||
           (f->extended == frame->extended && ((frame->id ^ f->id) & f->mask) == 0u);
}

static bool rule_acts(can_loop_t *loop, can_loop_ordered_t *ordered) {
    const uint64_t number = ordered->seen;
    ordered->seen++;
    if (number < ordered->rule.skip ||
        (ordered->rule.count != 0u && number - ordered->rule.skip >= ordered->rule.count)) {
        return false;
    }
    return ordered->rule.probability >= 1.0 || draw(loop) < ordered->rule.probability;
}

static void combine(can_loop_action_t *sum, const can_loop_action_t *more) {
    sum->deaf |= more->deaf;
    sum->delay_us = later(sum->delay_us, more->delay_us);
    sum->stamp_on_wire = sum->stamp_on_wire || more->stamp_on_wire;
    sum->copies = sum->copies > more->copies ? sum->copies : more->copies;
    for (uint32_t i = 0; i < BERTH_CAN_DATA_MAX; i++) {
        sum->flip[i] ^= more->flip[i];
    }
    sum->corrupt = sum->corrupt || more->corrupt;
    sum->error_bit = sum->error_bit > more->error_bit ? sum->error_bit : more->error_bit;
}

static can_loop_action_t decide(can_loop_t *loop, const can_loop_event_t *event) {
    can_loop_action_t sum = {0};
    for (uint32_t i = 0; i < loop->rule_count; i++) {
        can_loop_ordered_t *ordered = &loop->rules[i];
        if (rule_fits(&ordered->rule, event->node, &event->frame) && rule_acts(loop, ordered)) {
            combine(&sum, &ordered->rule.action);
        }
    }
    if (loop->fault != NULL) {
        const can_loop_action_t hooked =
            loop->fault(loop->fault_context, event->index, event->node, &event->frame);
        combine(&sum, &hooked);
    }
    return sum;
}

/* Was the node there from the frame's first bit? */
static bool hears(const can_loop_t *loop, uint32_t number) {
    const can_loop_node_t *node = &loop->nodes[number];
    return can_loop_present(node) && node->since_ns <= loop->wire.event.start_ns;
}

static bool acknowledged(const can_loop_t *loop) {
    for (uint32_t i = 0; i < loop->node_count; i++) {
        if (i != loop->wire.event.node && hears(loop, i)) {
            return true;
        }
    }
    return false;
}

/* The wire is taken until end_ns, and free an intermission later. */
static void occupy(can_loop_t *loop, int64_t end_ns) {
    const int64_t idle_ns = end_ns + loop->bit_ns * (int64_t)CAN_WIRE_INTERMISSION;
    loop->busy_ns += idle_ns - loop->idle_ns;
    loop->idle_ns = idle_ns;
    loop->wire.event.end_ns = end_ns;
}

static void start_frame(can_loop_t *loop, const next_t *next) {
    const can_loop_node_t *node = &loop->nodes[next->index];
    const bool babble = babbles(node, next->at_ns);
    const can_loop_waiting_t *w = babble ? &node->babble : &node->tx[node->tx_first];
    loop->wire = (can_loop_wire_t){
        .active = true,
        .babble = babble,
        .event = {.index = loop->started,
                  .node = next->index,
                  .start_ns = next->at_ns,
                  .frame = w->frame},
    };
    loop->started++;
    can_loop_wire_t *wire = &loop->wire;
    wire->action = decide(loop, &wire->event);
    wire->acknowledged = acknowledged(loop);
    uint32_t bits = w->bits;
    if (wire->action.corrupt) {
        const uint32_t ordered = wire->action.error_bit;
        bits = ordered > 0u && ordered < w->bits ? ordered : w->bits - CAN_WIRE_EOF;
    } else if (!wire->acknowledged) {
        bits = w->bits - CAN_WIRE_EOF - 1u;
    } else {
        /* the whole frame */
    }
    wire->event.error = wire->action.corrupt || !wire->acknowledged;
    if (wire->event.error) {
        bits += CAN_WIRE_ERROR_FRAME;
    }
    loop->idle_ns = next->at_ns;
    occupy(loop, next->at_ns + loop->bit_ns * (int64_t)bits);
}

void can_loop_abort(can_loop_t *loop, uint32_t node) {
    can_loop_wire_t *wire = &loop->wire;
    if (wire->active && wire->event.node == node && !wire->event.error) {
        wire->event.error = true;
        occupy(loop, loop->now_ns + loop->bit_ns * (int64_t)CAN_WIRE_ERROR_FRAME);
    }
}

static void hold_back(can_loop_t *loop, uint32_t node, const berth_can_frame_t *frame) {
    const int64_t wish_us = loop->wire.action.delay_us;
    const int64_t delay_us = wish_us < DELAY_MAX_US ? wish_us : DELAY_MAX_US;
    if (loop->late_count >= CAN_LOOP_LATE_MAX) {
        loop->nodes[node].counters.late_lost++;
        return;
    }
    can_loop_late_t *late = &loop->late[loop->late_count];
    *late = (can_loop_late_t){
        .frame = *frame, .due_ns = loop->wire.event.end_ns + delay_us * NS_PER_US, .node = node};
    if (!loop->wire.action.stamp_on_wire) {
        late->frame.time_us = up_to_us(late->due_ns);
    }
    loop->late_count++;
}

/* The list stays in the order of the frames, so that of two due together the older comes first. */
static void deliver_late(can_loop_t *loop, uint32_t index) {
    can_loop_node_t *node = &loop->nodes[loop->late[index].node];
    if (can_loop_present(node)) {
        can_loop_take(node, &loop->late[index].frame);
    } else {
        node->counters.absent++;
    }
    loop->late_count--;
    for (uint32_t i = index; i < loop->late_count; i++) {
        loop->late[i] = loop->late[i + 1u];
    }
}

static void deliver(can_loop_t *loop) {
    const can_loop_wire_t *wire = &loop->wire;
    berth_can_frame_t frame = wire->event.frame;
    for (uint32_t i = 0; !frame.remote && i < frame.length; i++) {
        frame.data[i] ^= wire->action.flip[i];
    }
    for (uint32_t i = 0; i < loop->node_count; i++) {
        can_loop_node_t *node = &loop->nodes[i];
        if (i == wire->event.node) {
            continue;
        }
        if (!hears(loop, i)) {
            node->counters.absent++;
            continue;
        }
        if (node->rec > 0u) {
            node->rec = node->rec < CAN_LOOP_PASSIVE_AT ? node->rec - 1u : CAN_LOOP_PASSIVE_AT - 1u;
        }
        if (((wire->action.deaf >> i) & 1u) != 0u) {
            node->counters.deafened++;
        } else if (wire->action.delay_us > 0) {
            hold_back(loop, i, &frame);
        } else {
            can_loop_take(node, &frame);
        }
    }
}

/* The sender's books after a frame that got through. */
static void sent(can_loop_t *loop) {
    can_loop_node_t *node = &loop->nodes[loop->wire.event.node];
    node->counters.sent++;
    if (node->tec > 0u) {
        node->tec--;
    }
    if (loop->wire.babble) {
        node->counters.babbled++;
        return;
    }
    can_loop_waiting_t *w = &node->tx[node->tx_first];
    if (w->is_copy) {
        node->counters.copies++;
    } else {
        w->copies = loop->wire.action.copies;
    }
    if (w->copies > 0u) {
        w->copies--;
        w->is_copy = true;
        return;
    }
    node->tx_first = (node->tx_first + 1u) % CAN_LOOP_TX_MAX;
    node->tx_count--;
}

static void failed(can_loop_t *loop) {
    const can_loop_wire_t *wire = &loop->wire;
    for (uint32_t i = 0; i < loop->node_count; i++) {
        can_loop_node_t *node = &loop->nodes[i];
        if (!hears(loop, i)) {
            continue;
        }
        node->counters.errors++;
        if (i != wire->event.node) {
            node->rec += node->rec < COUNTER_MAX ? 1u : 0u;
            continue;
        }
        /* An error passive node that merely gets no acknowledgement counts no further. */
        if (wire->action.corrupt || node->tec < CAN_LOOP_PASSIVE_AT) {
            node->tec += 8u;
        }
        if (node->tec > COUNTER_MAX) {
            can_loop_bus_off(loop, i);
        }
    }
}

static void end_frame(can_loop_t *loop) {
    can_loop_wire_t *wire = &loop->wire;
    can_loop_node_t *node = &loop->nodes[wire->event.node];
    wire->active = false;
    wire->event.frame.time_us = up_to_us(wire->event.end_ns);
    if (wire->event.error) {
        failed(loop);
    } else {
        loop->frames++;
        deliver(loop);
        sent(loop);
    }
    if (node->tec >= CAN_LOOP_PASSIVE_AT || node->rec >= CAN_LOOP_PASSIVE_AT) {
        node->suspend_ns = loop->idle_ns + loop->bit_ns * (int64_t)CAN_WIRE_SUSPEND;
    }
    if (loop->observer != NULL) {
        loop->observer(loop->observer_context, &wire->event);
    }
}

void can_loop_run(can_loop_t *loop, int64_t until_us) {
    if (until_us > CAN_LOOP_TIME_MAX_US || until_us < loop->now_ns / NS_PER_US) {
        return;
    }
    const int64_t until_ns = until_us * NS_PER_US;
    for (;;) {
        const next_t next = next_event(loop);
        const bool due = next.kind == FRAME_START ? next.at_ns < until_ns : next.at_ns <= until_ns;
        if (next.kind == NOTHING || !due) {
            break;
        }
        loop->now_ns = next.at_ns;
        switch (next.kind) {
        case WIRE_END:
            end_frame(loop);
            break;
        case LATE_DUE:
            deliver_late(loop, next.index);
            break;
        case NODE_BACK:
            can_loop_return(&loop->nodes[next.index], next.at_ns);
            break;
        default: /* FRAME_START */
            start_frame(loop, &next);
            break;
        }
    }
    loop->now_ns = until_ns;
}

int64_t can_loop_deadline(const can_loop_t *loop) {
    const next_t next = next_event(loop);
    if (next.kind == NOTHING) {
        return CAN_LOOP_NEVER;
    }
    if (next.kind != FRAME_START) {
        return up_to_us(next.at_ns);
    }
    const can_loop_node_t *node = &loop->nodes[next.index];
    const can_loop_waiting_t *w =
        babbles(node, next.at_ns) ? &node->babble : &node->tx[node->tx_first];
    int64_t end_ns = next.at_ns + loop->bit_ns * (int64_t)w->bits;
    for (uint32_t i = 0; i < loop->late_count; i++) {
        end_ns = loop->late[i].due_ns < end_ns ? loop->late[i].due_ns : end_ns;
    }
    for (uint32_t i = 0; i < loop->node_count; i++) {
        end_ns = loop->nodes[i].recover_ns < end_ns ? loop->nodes[i].recover_ns : end_ns;
    }
    return up_to_us(end_ns);
}

int64_t can_loop_now_us(const can_loop_t *loop) {
    return up_to_us(loop->now_ns);
}

static int64_t clock_now_us(void *context) {
    return can_loop_now_us(context);
}

static void clock_sleep_until_us(void *context, int64_t deadline_us) {
    (void)context;
    (void)deadline_us;
}

berth_clock_t can_loop_clock(can_loop_t *loop) {
    static const berth_clock_api_t api = {clock_now_us, clock_sleep_until_us};
    return (berth_clock_t){&api, loop};
}

bool can_loop_rule(can_loop_t *loop, const can_loop_rule_t *rule) {
    if (loop->rule_count >= CAN_LOOP_RULES_MAX || !(rule->probability >= 0.0) ||
        !(rule->probability <= 1.0)) {
        return false;
    }
    loop->rules[loop->rule_count] = (can_loop_ordered_t){.rule = *rule};
    loop->rule_count++;
    return true;
}

void can_loop_rules_clear(can_loop_t *loop) {
    loop->rule_count = 0;
}

void can_loop_fault(can_loop_t *loop, can_loop_fault_t fault, void *context) {
    loop->fault = fault;
    loop->fault_context = context;
}

void can_loop_observe(can_loop_t *loop, can_loop_observer_t observer, void *context) {
    loop->observer = observer;
    loop->observer_context = context;
}

uint32_t can_loop_held(const can_loop_t *loop) {
    return loop->late_count;
}

uint64_t can_loop_frames(const can_loop_t *loop) {
    return loop->frames;
}

int64_t can_loop_busy_ns(const can_loop_t *loop) {
    return loop->busy_ns - later(loop->idle_ns - loop->now_ns, 0);
}

double can_loop_load(const can_loop_t *loop, int64_t since_us, int64_t busy_ns) {
    const int64_t span_ns = loop->now_ns - since_us * NS_PER_US;
    const int64_t used_ns = can_loop_busy_ns(loop) - busy_ns;
    return span_ns > 0 ? (double)used_ns / (double)span_ns : 0.0;
}
