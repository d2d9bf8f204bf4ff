/* The injector around a bus: which calls it answers, with what, and that it does nothing else. */
#include "can_fault.h"
#include "can_loop.h"
#include "support.h"

#include "unity.h"

#include <string.h>

/* A bus that counts what reaches it and answers in its own way. */
typedef struct {
    unsigned sends, receives, states;
    berth_can_outcome_t outcome;
} inner_t;

static inner_t inner;
static can_fault_t fault;
static berth_can_t can;
static const berth_can_frame_t frame = {.id = 0x123, .length = 2, .data = {1, 2}};

static berth_can_outcome_t inner_send(void *context, const berth_can_frame_t *f) {
    inner_t *bus = context;
    TEST_ASSERT_EQUAL_PTR(&frame, f);
    bus->sends++;
    return bus->outcome;
}

static berth_can_outcome_t inner_receive(void *context, berth_can_frame_t *f) {
    inner_t *bus = context;
    f->id = 0x456;
    bus->receives++;
    return bus->outcome;
}

static void inner_state(void *context, berth_can_state_t *state) {
    inner_t *bus = context;
    bus->states++;
    *state = (berth_can_state_t){BERTH_CAN_ERROR_ACTIVE, bus->states, 2, 3, 4};
}

static const berth_can_api_t inner_api = {inner_send, inner_receive, inner_state};

void setUp(void) {
    inner = (inner_t){.outcome = BERTH_CAN_DONE};
    const berth_can_t bus = {&inner_api, &inner};
    can = can_fault_init(&fault, &bus);
}

void tearDown(void) {}

static berth_can_outcome_t send(void) {
    return can.api->send(can.context, &frame);
}

static berth_can_outcome_t receive(berth_can_frame_t *f) {
    return can.api->receive(can.context, f);
}

static berth_can_state_t state(void) {
    berth_can_state_t s;
    memset(&s, 0x55, sizeof s);
    can.api->state(can.context, &s);
    return s;
}

static void order(uint32_t calls, uint64_t first, uint64_t count, berth_can_outcome_t outcome,
                  berth_can_mode_t mode) {
    const can_fault_order_t o = {calls, first, count, outcome, mode};
    TEST_ASSERT_TRUE(can_fault_order(&fault, &o));
}

static void test_passes_everything_on(void) {
    static const berth_can_outcome_t outcomes[] = {BERTH_CAN_DONE, BERTH_CAN_AGAIN,
                                                   BERTH_CAN_FAILED};
    for (unsigned i = 0; i < 3; i++) {
        berth_can_frame_t f = {0};
        inner.outcome = outcomes[i];
        TEST_ASSERT_EQUAL_INT(outcomes[i], send());
        TEST_ASSERT_EQUAL_INT(outcomes[i], receive(&f));
        TEST_ASSERT_EQUAL_HEX32(0x456, f.id);
        const berth_can_state_t s = state();
        TEST_ASSERT_EQUAL_UINT32(i + 1, s.rx_lost);
        TEST_ASSERT_EQUAL_UINT32(4, s.restarts);
    }
    TEST_ASSERT_EQUAL_UINT64(3, can_fault_calls(&fault, CAN_FAULT_SEND));
    TEST_ASSERT_EQUAL_UINT64(6, can_fault_calls(&fault, CAN_FAULT_SEND | CAN_FAULT_RECEIVE));
    TEST_ASSERT_EQUAL_UINT64(9, can_fault_calls(&fault, CAN_FAULT_ANY));
    TEST_ASSERT_EQUAL_UINT64(0, can_fault_calls(&fault, 8));
    TEST_ASSERT_EQUAL_UINT64(0, can_fault_answered(&fault));
}

/* For each k: just the k-th send fails, in both ways, and does not reach the bus. */
static void test_kth_send(void) {
    static const berth_can_outcome_t ways[] = {BERTH_CAN_AGAIN, BERTH_CAN_FAILED};
    for (unsigned way = 0; way < 2; way++) {
        for (uint64_t k = 0; k < 20; k++) {
            setUp();
            order(CAN_FAULT_SEND, k, 1, ways[way], BERTH_CAN_ERROR_ACTIVE);
            for (uint64_t i = 0; i < 20; i++) {
                berth_can_frame_t f;
                TEST_ASSERT_EQUAL_INT(i == k ? ways[way] : BERTH_CAN_DONE, send());
                TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, receive(&f)); /* not in the set */
            }
            TEST_ASSERT_EQUAL_UINT(19, inner.sends);
            TEST_ASSERT_EQUAL_UINT(20, inner.receives);
            TEST_ASSERT_EQUAL_UINT64(1, can_fault_answered(&fault));
        }
    }
}

static void test_receive_range_leaves_frame_alone(void) {
    order(CAN_FAULT_RECEIVE, 2, 3, BERTH_CAN_AGAIN, BERTH_CAN_ERROR_ACTIVE);
    for (unsigned i = 0; i < 8; i++) {
        berth_can_frame_t f;
        berth_can_frame_t before;
        memset(&f, 0x77, sizeof f);
        memcpy(&before, &f, sizeof f);
        const bool picked = i >= 2 && i < 5;
        TEST_ASSERT_EQUAL_INT(picked ? BERTH_CAN_AGAIN : BERTH_CAN_DONE, receive(&f));
        TEST_ASSERT_EQUAL_INT(picked, memcmp(&f, &before, sizeof f) == 0);
    }
    TEST_ASSERT_EQUAL_UINT(5, inner.receives);
}

static void test_each_mode_with_the_last_counters(void) {
    static const berth_can_mode_t modes[] = {BERTH_CAN_ERROR_ACTIVE, BERTH_CAN_ERROR_PASSIVE,
                                             BERTH_CAN_BUS_OFF, BERTH_CAN_DOWN};
    for (unsigned i = 0; i < 4; i++) {
        setUp();
        order(CAN_FAULT_STATE, 0, 1, BERTH_CAN_FAILED, modes[i]);
        berth_can_state_t s = state();
        TEST_ASSERT_EQUAL_INT(modes[i], s.mode);
        TEST_ASSERT_EQUAL_UINT32(0, s.rx_lost);
        TEST_ASSERT_EQUAL_UINT(0, inner.states);
        s = state();
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, s.mode);
        order(CAN_FAULT_STATE, 2, CAN_FAULT_FOREVER, BERTH_CAN_FAILED, modes[i]);
        for (int n = 0; n < 5; n++) {
            s = state();
            TEST_ASSERT_EQUAL_INT(modes[i], s.mode);
            TEST_ASSERT_EQUAL_UINT32(1, s.rx_lost); /* counters never fall */
            TEST_ASSERT_EQUAL_UINT32(3, s.error_frames);
        }
        TEST_ASSERT_EQUAL_UINT(1, inner.states);
    }
}

/* Numbers count the calls of the set together, whatever their kind. */
static void test_any_call_counts(void) {
    order(CAN_FAULT_ANY, 4, 2, BERTH_CAN_FAILED, BERTH_CAN_DOWN);
    berth_can_frame_t f = {.id = 1};
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, send());
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, receive(&f));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, state().mode);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, send());
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, receive(&f));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DOWN, state().mode);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, receive(&f));
    TEST_ASSERT_EQUAL_UINT64(2, can_fault_answered(&fault));
}

static void test_clear_and_late_orders(void) {
    order(CAN_FAULT_SEND, 0, CAN_FAULT_FOREVER, BERTH_CAN_FAILED, BERTH_CAN_DOWN);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, send());
    can_fault_clear(&fault);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, send());
    /* 2 sends so far: an order for the past does nothing, one of no calls neither */
    order(CAN_FAULT_SEND, 0, 2, BERTH_CAN_FAILED, BERTH_CAN_DOWN);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, send());
    order(CAN_FAULT_SEND, 0, 0, BERTH_CAN_FAILED, BERTH_CAN_DOWN);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, send());
    /* a range that ends beyond the last number */
    order(CAN_FAULT_SEND, 4, UINT64_MAX, BERTH_CAN_AGAIN, BERTH_CAN_DOWN);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, send());
    TEST_ASSERT_EQUAL_UINT(3, inner.sends);
}

static void test_refused_orders_change_nothing(void) {
    order(CAN_FAULT_SEND, 0, CAN_FAULT_FOREVER, BERTH_CAN_AGAIN, BERTH_CAN_DOWN);
    const can_fault_order_t bad[] = {
        {0, 0, 1, BERTH_CAN_FAILED, BERTH_CAN_DOWN},
        {8, 0, 1, BERTH_CAN_FAILED, BERTH_CAN_DOWN},
        {UINT32_MAX, 0, 1, BERTH_CAN_FAILED, BERTH_CAN_DOWN},
        {CAN_FAULT_SEND, 0, 1, BERTH_CAN_DONE, BERTH_CAN_DOWN},
        {CAN_FAULT_SEND, 0, 1, (berth_can_outcome_t)2, BERTH_CAN_DOWN},
        {CAN_FAULT_SEND, 0, 1, BERTH_CAN_FAILED, (berth_can_mode_t)4},
    };
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        TEST_ASSERT_FALSE(can_fault_order(&fault, &bad[i]));
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, send());
    }
}

/* Around a node of the loop bus: what was refused is not on the wire, the rest is. */
static void test_around_the_loop(void) {
    static can_loop_t loop;
    TEST_ASSERT_TRUE(can_loop_init(&loop, CAN_LOOP_BIT_RATE, 0, 1));
    berth_can_t a;
    berth_can_t b;
    TEST_ASSERT_TRUE(can_loop_attach(&loop, &a));
    TEST_ASSERT_TRUE(can_loop_attach(&loop, &b));
    can = can_fault_init(&fault, &a);
    order(CAN_FAULT_SEND, 3, 2, BERTH_CAN_AGAIN, BERTH_CAN_ERROR_ACTIVE);
    unsigned taken = 0;
    for (unsigned i = 0; i < 10; i++) {
        taken += send() == BERTH_CAN_DONE ? 1u : 0u;
    }
    can_loop_run(&loop, 10000);
    TEST_ASSERT_EQUAL_UINT(8, taken);
    TEST_ASSERT_EQUAL_UINT64(8, can_loop_counters(&loop, 1)->received);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_passes_everything_on);
    RUN_TEST(test_kth_send);
    RUN_TEST(test_receive_range_leaves_frame_alone);
    RUN_TEST(test_each_mode_with_the_last_counters);
    RUN_TEST(test_any_call_counts);
    RUN_TEST(test_clear_and_late_orders);
    RUN_TEST(test_refused_orders_change_nothing);
    RUN_TEST(test_around_the_loop);
    return UNITY_END();
}
