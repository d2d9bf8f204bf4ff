/* rig.h - what the tests of both CAN drivers share: frames, and the contract's calls. */
#ifndef BERTH_TESTS_STM32_RIG_H
#define BERTH_TESTS_STM32_RIG_H

#include "berth_hal/can.h"
#include "support.h"

#include "unity.h"

#include <string.h>

static inline berth_can_outcome_t send(const berth_can_t *can, const berth_can_frame_t *frame) {
    return can->api->send(can->context, frame);
}

static inline berth_can_outcome_t receive(const berth_can_t *can, berth_can_frame_t *frame) {
    return can->api->receive(can->context, frame);
}

static inline berth_can_state_t state_of(const berth_can_t *can) {
    berth_can_state_t state;
    memset(&state, 0x5a, sizeof state);
    can->api->state(can->context, &state);
    return state;
}

static inline berth_can_frame_t frame_with(uint32_t id, uint8_t mark) {
    return (berth_can_frame_t){.id = id, .length = 1, .data = {mark}};
}

static inline berth_can_outcome_t sends(const berth_can_t *can, uint32_t id, uint8_t mark) {
    const berth_can_frame_t frame = frame_with(id, mark);
    return send(can, &frame);
}

static inline bool chance(double probability) {
    return support_uniform(0, 1) < probability;
}

static inline berth_can_frame_t random_frame(void) {
    berth_can_frame_t frame = {.extended = chance(0.5), .remote = chance(0.2)};
    frame.id = support_index(frame.extended ? BERTH_CAN_EXTENDED_MAX + 1u : 0x800u);
    frame.length = (uint8_t)support_index(9);
    for (int i = 0; i < frame.length && !frame.remote; i++) {
        frame.data[i] = (uint8_t)support_index(256);
    }
    return frame;
}

static inline void expect_frame(const berth_can_frame_t *expected,
                                const berth_can_frame_t *actual) {
    TEST_ASSERT_EQUAL_HEX32(expected->id, actual->id);
    TEST_ASSERT_EQUAL_INT(expected->extended, actual->extended);
    TEST_ASSERT_EQUAL_INT(expected->remote, actual->remote);
    TEST_ASSERT_EQUAL_UINT8(expected->length, actual->length);
    TEST_ASSERT_EQUAL_HEX8_ARRAY(expected->data, actual->data, 8);
}

/* The contract of a filter, word for word. */
static inline bool wanted(const berth_can_filter_t *filters, uint32_t count,
                          const berth_can_frame_t *frame) {
    for (uint32_t i = 0; i < count; i++) {
        if (filters[i].extended == frame->extended &&
            (frame->id & filters[i].mask) == (filters[i].id & filters[i].mask)) {
            return true;
        }
    }
    return count == 0;
}

/* A filter that a fair part of random ids passes. */
static inline berth_can_filter_t random_filter(void) {
    berth_can_filter_t filter = {.extended = chance(0.5)};
    const uint32_t max = filter.extended ? BERTH_CAN_EXTENDED_MAX : BERTH_CAN_STANDARD_MAX;
    filter.id = support_index(max + 1u);
    filter.mask = support_index(max + 1u) & support_index(max + 1u);
    if (chance(0.2)) {
        filter.mask = chance(0.5) ? 0 : UINT32_MAX;
    }
    return filter;
}

/* A frame near a filter: its id with few bits changed, of either format. */
static inline berth_can_frame_t frame_near(const berth_can_filter_t *filter) {
    berth_can_frame_t frame = random_frame();
    frame.extended = chance(0.9) ? filter->extended : !filter->extended;
    frame.id = filter->id ^ (chance(0.5) ? 1u << support_index(29) : 0u) ^
               (chance(0.3) ? support_index(1u << 29) & ~filter->mask : 0u);
    frame.id &= frame.extended ? BERTH_CAN_EXTENDED_MAX : BERTH_CAN_STANDARD_MAX;
    return frame;
}

/* What the model saw that the manual forbids. */
#define RIG_VIOLATIONS(rig)                                                                        \
    TEST_ASSERT_EQUAL_UINT32_MESSAGE(0, (rig)->model.violations, (rig)->model.violation)

#endif
