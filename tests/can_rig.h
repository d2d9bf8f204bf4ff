/* A loop bus with some nodes and a record of all that was on the wire, for the tests of the bus. */
#ifndef BERTH_TESTS_CAN_RIG_H
#define BERTH_TESTS_CAN_RIG_H

#include "can_loop.h"
#include "can_text.h"

#include "unity.h"

#include <string.h>

#define RIG_EVENTS_MAX 20000u
#define RIG_BIT_NS 1000

typedef struct {
    can_loop_t loop;
    berth_can_t can[CAN_LOOP_NODES_MAX];
    can_loop_event_t events[RIG_EVENTS_MAX];
    uint32_t event_count;
} rig_t;

static inline void rig_observe(void *context, const can_loop_event_t *event) {
    rig_t *rig = context;
    TEST_ASSERT_TRUE(rig->event_count < RIG_EVENTS_MAX);
    rig->events[rig->event_count++] = *event;
}

static inline void rig_start_at(rig_t *rig, uint32_t nodes, uint32_t bit_rate, int64_t now_us) {
    TEST_ASSERT_TRUE(can_loop_init(&rig->loop, bit_rate, now_us, 7));
    for (uint32_t i = 0; i < nodes; i++) {
        TEST_ASSERT_TRUE(can_loop_attach(&rig->loop, &rig->can[i]));
    }
    rig->event_count = 0;
    can_loop_observe(&rig->loop, rig_observe, rig);
}

static inline void rig_start(rig_t *rig, uint32_t nodes) {
    rig_start_at(rig, nodes, CAN_LOOP_BIT_RATE, 0);
}

static inline berth_can_outcome_t rig_send(rig_t *rig, uint32_t node,
                                           const berth_can_frame_t *frame) {
    return rig->can[node].api->send(rig->can[node].context, frame);
}

static inline void rig_sends(rig_t *rig, uint32_t node, uint32_t id) {
    const berth_can_frame_t frame = {.id = id, .length = 2, .data = {(uint8_t)node, 0x5a}};
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, rig_send(rig, node, &frame));
}

/* The bit times of such a frame, without the intermission. */
static inline uint32_t rig_bits(uint32_t node, uint32_t id) {
    const berth_can_frame_t frame = {.id = id, .length = 2, .data = {(uint8_t)node, 0x5a}};
    return can_text_bits(&frame);
}

static inline berth_can_outcome_t rig_receive(rig_t *rig, uint32_t node, berth_can_frame_t *frame) {
    return rig->can[node].api->receive(rig->can[node].context, frame);
}

static inline void rig_gets(rig_t *rig, uint32_t node, uint32_t id) {
    berth_can_frame_t frame;
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, rig_receive(rig, node, &frame));
    TEST_ASSERT_EQUAL_HEX32(id, frame.id);
}

static inline void rig_gets_nothing(rig_t *rig, uint32_t node) {
    berth_can_frame_t frame;
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, rig_receive(rig, node, &frame));
}

static inline berth_can_state_t rig_state(rig_t *rig, uint32_t node) {
    berth_can_state_t state;
    memset(&state, 0x55, sizeof state);
    rig->can[node].api->state(rig->can[node].context, &state);
    return state;
}

static inline void rig_expect_same_events(const rig_t *a, const rig_t *b) {
    TEST_ASSERT_EQUAL_UINT32(a->event_count, b->event_count);
    for (uint32_t i = 0; i < a->event_count; i++) {
        const can_loop_event_t *ea = &a->events[i];
        const can_loop_event_t *eb = &b->events[i];
        TEST_ASSERT_EQUAL_UINT64(ea->index, eb->index);
        TEST_ASSERT_EQUAL_UINT32(ea->node, eb->node);
        TEST_ASSERT_EQUAL_INT64(ea->start_ns, eb->start_ns);
        TEST_ASSERT_EQUAL_INT64(ea->end_ns, eb->end_ns);
        TEST_ASSERT_EQUAL_INT(ea->error, eb->error);
        TEST_ASSERT_EQUAL_INT64(ea->frame.time_us, eb->frame.time_us);
        TEST_ASSERT_EQUAL_HEX32(ea->frame.id, eb->frame.id);
        TEST_ASSERT_EQUAL_MEMORY(ea->frame.data, eb->frame.data, 8);
    }
}

/* Every frame taken and every frame on the wire is accounted for (see can_loop_counters_t). taken:
 * frames that send took, per node. Nothing may still be held back. */
static inline void rig_expect_conserved(const rig_t *rig, const uint64_t *taken) {
    uint64_t all = 0;
    for (uint32_t i = 0; i < rig->loop.node_count; i++) {
        const can_loop_counters_t *c = can_loop_counters(&rig->loop, i);
        TEST_ASSERT_EQUAL_UINT64(taken[i], c->sent - c->copies - c->babbled + c->dropped +
                                               can_loop_waiting(&rig->loop, i));
        all += c->sent;
    }
    TEST_ASSERT_EQUAL_UINT64(all, can_loop_frames(&rig->loop));
    for (uint32_t i = 0; i < rig->loop.node_count; i++) {
        const can_loop_counters_t *c = can_loop_counters(&rig->loop, i);
        TEST_ASSERT_EQUAL_UINT64(all - c->sent, c->received + c->filtered + c->overflow +
                                                    c->absent + c->deafened + c->late_lost);
    }
}

#endif
