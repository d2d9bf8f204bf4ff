/* The virtual bus: nodes that send, receive, fail and come back, and every fault that can be
 * ordered. What must hold: each frame is accounted for, at the sender and at every other node; time
 * does not go back; what is received is what somebody sent, or what a fault made of it.
 */
#include "can_loop.h"
#include "fuzz.h"
#include "input.h"

#define NODES 4u

typedef struct {
    input_t in;
    can_loop_t loop;
    berth_can_t can[NODES];
    uint64_t taken[NODES];   /* sends answered DONE */
    uint64_t refused[NODES]; /* AGAIN */
    uint64_t fetched[NODES];
    uint64_t seen;      /* frames without error, by the observer */
    uint64_t by[NODES]; /* of these, each node's */
    int64_t end_ns;
    int64_t begin_us;
} world_t;

static void observe(void *context, const can_loop_event_t *event) {
    world_t *world = context;
    FUZZ_CHECK(event->node < NODES && event->start_ns < event->end_ns, "an event has its time");
    FUZZ_CHECK(event->start_ns >= world->end_ns, "one frame at a time is on the wire");
    FUZZ_CHECK(event->end_ns <= world->loop.now_ns, "an event is told when it is over");
    world->end_ns = event->end_ns;
    if (!event->error) {
        world->seen++;
        world->by[event->node]++;
    }
}

static void check_node(const world_t *world, uint32_t node) {
    const can_loop_counters_t *counters = can_loop_counters(&world->loop, node);
    const can_loop_node_t *inner = &world->loop.nodes[node];
    FUZZ_CHECK(counters->refused == world->refused[node], "refused sends are counted");
    FUZZ_CHECK(counters->sent == world->by[node], "sent frames are those on the wire");
    const uint64_t own = counters->sent - counters->copies - counters->babbled;
    FUZZ_CHECK(own + counters->dropped + can_loop_waiting(&world->loop, node) == world->taken[node],
               "each frame taken is sent, dropped or waits");
    const uint64_t heard = counters->received + counters->filtered + counters->overflow +
                           counters->absent + counters->deafened + counters->late_lost;
    uint64_t held = 0;
    for (uint32_t i = 0; i < world->loop.late_count; i++) {
        held += world->loop.late[i].node == node ? 1u : 0u;
    }
    FUZZ_CHECK(heard + held == world->seen - world->by[node],
               "each frame of another is received, or it is told why not");
    FUZZ_CHECK(world->fetched[node] + inner->rx_count == counters->received,
               "what is received waits until it is fetched");
}

static void check(const world_t *world) {
    FUZZ_CHECK(can_loop_frames(&world->loop) == world->seen, "frames are counted");
    FUZZ_CHECK(can_loop_deadline(&world->loop) >= can_loop_now_us(&world->loop),
               "nothing is due in the past");
    const double load = can_loop_load(&world->loop, world->begin_us, 0);
    FUZZ_CHECK(load >= 0.0 && load <= 1.0, "the load is a share");
    for (uint32_t node = 0; node < NODES; node++) {
        check_node(world, node);
    }
}

static can_loop_action_t some_action(world_t *world) {
    const uint8_t what = in_u8(&world->in);
    can_loop_action_t action = {0};
    action.deaf = (what & 1u) != 0 ? in_u32(&world->in) : 0;
    action.delay_us = (what & 2u) != 0 ? (int64_t)in_u16(&world->in) : 0;
    action.stamp_on_wire = (what & 4u) != 0;
    action.copies = (what & 8u) != 0 ? in_u8(&world->in) % 4u : 0;
    action.corrupt = (what & 16u) != 0;
    action.error_bit = (what & 32u) != 0 ? in_u8(&world->in) : 0;
    if ((what & 64u) != 0) {
        action.flip[in_u8(&world->in) % BERTH_CAN_DATA_MAX] = in_u8(&world->in);
    }
    return action;
}

static void op_rule(world_t *world) {
    can_loop_rule_t rule = {0};
    const uint8_t shape = in_u8(&world->in);
    rule.node = (shape & 1u) != 0 ? CAN_LOOP_ANY_NODE : (shape >> 1) % NODES;
    rule.skip = in_u8(&world->in) % 8u;
    rule.count = in_u8(&world->in);
    rule.filtered = (shape & 16u) != 0;
    if (rule.filtered) {
        rule.filter.mask = in_u32(&world->in);
        rule.filter.id = in_u32(&world->in);
        rule.filter.extended = (shape & 32u) != 0;
    }
    rule.probability = (shape & 64u) != 0 ? (double)in_any_float(&world->in) : 1.0;
    rule.action = some_action(world);
    const bool sane = rule.probability >= 0.0 && rule.probability <= 1.0;
    const bool room = world->loop.rule_count < CAN_LOOP_RULES_MAX;
    FUZZ_CHECK(can_loop_rule(&world->loop, &rule) == (sane && room), "rules are checked");
}

static void op_send(world_t *world, uint32_t node) {
    const berth_can_frame_t frame = in_frame(&world->in);
    const berth_can_outcome_t outcome =
        world->can[node].api->send(world->can[node].context, &frame);
    world->taken[node] += outcome == BERTH_CAN_DONE ? 1u : 0u;
    world->refused[node] += outcome == BERTH_CAN_AGAIN ? 1u : 0u;
}

static void op_receive(world_t *world, uint32_t node) {
    for (uint32_t i = 0; i <= CAN_LOOP_RX_MAX; i++) {
        berth_can_frame_t frame;
        if (world->can[node].api->receive(world->can[node].context, &frame) != BERTH_CAN_DONE) {
            return;
        }
        world->fetched[node]++;
        FUZZ_CHECK(frame.length <= BERTH_CAN_DATA_MAX &&
                       frame.time_us <= can_loop_now_us(&world->loop),
                   "a frame has been on the wire");
    }
    FUZZ_CHECK(false, "the receive queue has an end");
}

static void op_node(world_t *world, uint32_t node) {
    can_loop_t *loop = &world->loop;
    switch (in_u8(&world->in) % 9u) {
    case 0:
        can_loop_down(loop, node);
        break;
    case 1:
        can_loop_up(loop, node);
        break;
    case 2:
        can_loop_bus_off(loop, node);
        break;
    case 3:
        can_loop_recover(loop, node);
        break;
    case 4:
        can_loop_auto_recover(loop, node, (int64_t)in_u16(&world->in) - 1000);
        break;
    case 5:
        can_loop_cut(loop, node, (in_u8(&world->in) & 1u) != 0);
        break;
    case 6: {
        const berth_can_frame_t frame = in_frame(&world->in);
        (void)can_loop_babble(loop, node, &frame,
                              can_loop_now_us(loop) + in_u16(&world->in) % 4096);
        break;
    }
    case 7:
        can_loop_depths(loop, node, in_u8(&world->in), in_u8(&world->in));
        break;
    default: {
        const berth_can_filter_t filter = {in_u32(&world->in), in_u32(&world->in),
                                           (in_u8(&world->in) & 1u) != 0};
        if (!can_loop_filter(loop, node, &filter)) {
            can_loop_filter_clear(loop, node);
        }
        break;
    }
    }
}

static void op_run(world_t *world) {
    const int64_t before_us = can_loop_now_us(&world->loop);
    const int64_t until_us = before_us + in_u16(&world->in) % 8192;
    can_loop_run(&world->loop, until_us);
    FUZZ_CHECK(can_loop_now_us(&world->loop) >= before_us, "time does not go back");
}

static void operate(world_t *world) {
    const uint8_t op = in_u8(&world->in);
    const uint32_t node = op / 8u % NODES;
    switch (op % 8u) {
    case 0:
    case 1:
    case 2:
        op_send(world, node);
        break;
    case 3:
        op_receive(world, node);
        break;
    case 4:
    case 5:
        op_run(world);
        break;
    case 6:
        op_node(world, node);
        break;
    default:
        if ((op & 128u) != 0) {
            can_loop_rules_clear(&world->loop);
        } else {
            op_rule(world);
        }
        break;
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static world_t world;
    static const uint32_t rates[] = {1000000, 500000, 125000, 10000};
    world = (world_t){.in = {data, size}};
    const uint8_t head = in_u8(&world.in);
    world.begin_us = (head & 4u) != 0 ? CAN_LOOP_TIME_MAX_US - 1000000 : (head & 8u) * 1000;
    if (!can_loop_init(&world.loop, rates[head & 3u], world.begin_us, head)) {
        return 0;
    }
    for (uint32_t i = 0; i < NODES; i++) {
        FUZZ_CHECK(can_loop_attach(&world.loop, &world.can[i]), "there is room for the nodes");
    }
    can_loop_observe(&world.loop, observe, &world);
    for (int i = 0; world.in.left > 0 && i < 400; i++) {
        operate(&world);
        check(&world);
    }
    return 0;
}
