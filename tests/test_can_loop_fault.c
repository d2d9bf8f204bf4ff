/* The loop bus with faults: each kind alone, and all of them at random with the books kept. */
#include "can_rig.h"
#include "can_wire.h"
#include "support.h"

#include <math.h>

static rig_t rig;
static rig_t twin;

void setUp(void) {
    rig_start(&rig, 3);
}

void tearDown(void) {}

/* A hook that does one action to one frame. */
typedef struct {
    uint64_t index;
    can_loop_action_t action;
    uint64_t asked;
} one_t;

static can_loop_action_t one_fault(void *context, uint64_t index, uint32_t node,
                                   const berth_can_frame_t *frame) {
    one_t *one = context;
    TEST_ASSERT_EQUAL_UINT64(one->asked, index); /* each start once, in order */
    TEST_ASSERT_TRUE(node < rig.loop.node_count && can_wire_valid(frame));
    one->asked++;
    return index == one->index ? one->action : (can_loop_action_t){0};
}

static void run_to_the_end(rig_t *on) {
    while (can_loop_deadline(&on->loop) != CAN_LOOP_NEVER) {
        can_loop_run(&on->loop, can_loop_deadline(&on->loop));
    }
}

static void order_rule(uint32_t node, uint64_t skip, uint64_t count, can_loop_action_t action) {
    const can_loop_rule_t rule = {
        .node = node, .skip = skip, .count = count, .probability = 1.0, .action = action};
    TEST_ASSERT_TRUE(can_loop_rule(&rig.loop, &rule));
}

/* For each k: frame k and no other is lost; it takes its time, and its sender believes in it. */
static void test_each_frame_lost(void) {
    for (uint64_t k = 0; k < 10; k++) {
        setUp();
        one_t one = {.index = k, .action = {.deaf = CAN_LOOP_EVERYBODY}};
        can_loop_fault(&rig.loop, one_fault, &one);
        for (uint32_t id = 0; id < 10; id++) {
            rig_sends(&rig, 0, id);
        }
        run_to_the_end(&rig);
        TEST_ASSERT_EQUAL_UINT64(10, one.asked);
        for (uint32_t id = 0; id < 10; id++) {
            if (id != k) {
                rig_gets(&rig, 1, id);
                rig_gets(&rig, 2, id);
            }
        }
        rig_gets_nothing(&rig, 1);
        TEST_ASSERT_EQUAL_UINT64(10, can_loop_counters(&rig.loop, 0)->sent);
        TEST_ASSERT_EQUAL_UINT64(1, can_loop_counters(&rig.loop, 1)->deafened);
        TEST_ASSERT_EQUAL_UINT32(0, rig_state(&rig, 0).tx_dropped);
        const uint64_t taken[] = {10, 0, 0};
        rig_expect_conserved(&rig, taken);
    }
}

static void test_one_receiver_is_deaf(void) {
    order_rule(0, 0, 0, (can_loop_action_t){.deaf = 1u << 2});
    rig_sends(&rig, 0, 5);
    rig_sends(&rig, 1, 6);
    run_to_the_end(&rig);
    rig_gets(&rig, 1, 5);
    rig_gets_nothing(&rig, 1);
    rig_gets(&rig, 2, 6);
    rig_gets_nothing(&rig, 2);
}

/* Late by d: there at its end plus d, not before, stamped then; a later frame overtakes it. */
static void test_late_frame(void) {
    order_rule(0, 0, 1, (can_loop_action_t){.delay_us = 5000});
    rig_sends(&rig, 0, 1);
    rig_sends(&rig, 0, 2);
    const int64_t due_us = rig_bits(0, 1) + 5000;
    can_loop_run(&rig.loop, 4000);
    TEST_ASSERT_EQUAL_UINT32(2, can_loop_held(&rig.loop));
    TEST_ASSERT_EQUAL_INT64(due_us, can_loop_deadline(&rig.loop));
    rig_gets(&rig, 1, 2);
    can_loop_run(&rig.loop, due_us - 1);
    rig_gets_nothing(&rig, 1);
    can_loop_run(&rig.loop, due_us);
    berth_can_frame_t f;
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, rig_receive(&rig, 1, &f));
    TEST_ASSERT_EQUAL_HEX32(1, f.id);
    TEST_ASSERT_EQUAL_INT64(due_us, f.time_us);
    TEST_ASSERT_EQUAL_UINT32(0, can_loop_held(&rig.loop));
}

static void test_late_frame_stamped_on_the_wire(void) {
    order_rule(0, 0, 1, (can_loop_action_t){.delay_us = 5000, .stamp_on_wire = true});
    rig_sends(&rig, 0, 1);
    run_to_the_end(&rig);
    berth_can_frame_t f;
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, rig_receive(&rig, 1, &f));
    TEST_ASSERT_EQUAL_INT64(rig_bits(0, 1), f.time_us);
    TEST_ASSERT_EQUAL_INT64(rig_bits(0, 1) + 5000, can_loop_now_us(&rig.loop));
}

static void test_too_many_late_frames(void) {
    rig_start(&rig, 2);
    order_rule(0, 0, 0, (can_loop_action_t){.delay_us = INT64_MAX});
    uint64_t taken[] = {0, 0};
    for (uint32_t i = 0; i < CAN_LOOP_LATE_MAX + 10; i++) {
        rig_sends(&rig, 0, i);
        taken[0]++;
        can_loop_run(&rig.loop, can_loop_now_us(&rig.loop) + 200);
    }
    TEST_ASSERT_EQUAL_UINT32(CAN_LOOP_LATE_MAX, can_loop_held(&rig.loop));
    TEST_ASSERT_EQUAL_UINT64(10, can_loop_counters(&rig.loop, 1)->late_lost);
    can_loop_down(&rig.loop, 1); /* what comes now finds nobody */
    run_to_the_end(&rig);
    TEST_ASSERT_EQUAL_UINT64(CAN_LOOP_LATE_MAX, can_loop_counters(&rig.loop, 1)->absent);
    rig_expect_conserved(&rig, taken);
}

/* Doubled: on the wire again, arbitrating like any other. */
static void test_doubled_frame(void) {
    order_rule(0, 1, 1, (can_loop_action_t){.copies = 2});
    rig_sends(&rig, 0, 1);
    rig_sends(&rig, 0, 0x20);
    rig_sends(&rig, 0, 3);
    rig_sends(&rig, 1, 0x10);
    run_to_the_end(&rig);
    static const uint32_t expected[] = {1, 0x10, 0x20, 0x20, 0x20, 3};
    TEST_ASSERT_EQUAL_UINT32(6, rig.event_count);
    for (uint32_t i = 0; i < 6; i++) {
        TEST_ASSERT_EQUAL_HEX32(expected[i], rig.events[i].frame.id);
        rig_gets(&rig, 2, expected[i]);
    }
    TEST_ASSERT_EQUAL_UINT64(2, can_loop_counters(&rig.loop, 0)->copies);
    const uint64_t taken[] = {3, 1, 0};
    rig_expect_conserved(&rig, taken);
}

/* An order to double each frame ends all the same. */
static void test_every_frame_doubled(void) {
    order_rule(CAN_LOOP_ANY_NODE, 0, 0, (can_loop_action_t){.copies = 1});
    for (uint32_t id = 0; id < 5; id++) {
        rig_sends(&rig, 0, id);
    }
    run_to_the_end(&rig);
    TEST_ASSERT_EQUAL_UINT32(10, rig.event_count);
}

static void test_altered_data(void) {
    order_rule(0, 0, 1, (can_loop_action_t){.flip = {0x01, 0x80, 0xff}});
    rig_sends(&rig, 0, 1);
    rig_sends(&rig, 0, 1);
    run_to_the_end(&rig);
    berth_can_frame_t f;
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, rig_receive(&rig, 2, &f));
    TEST_ASSERT_EQUAL_HEX8(0x01, f.data[0]);
    TEST_ASSERT_EQUAL_HEX8(0x5a ^ 0x80, f.data[1]);
    TEST_ASSERT_EQUAL_HEX8(0x00, f.data[2]); /* beyond the length */
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, rig_receive(&rig, 2, &f));
    TEST_ASSERT_EQUAL_HEX8(0x5a, f.data[1]);
    TEST_ASSERT_EQUAL_HEX8(0x5a, rig.events[0].frame.data[1]); /* the record is what was sent */
}

/* A bit error: an error frame after it, the counters, and the frame again. */
static void test_corrupted_frame(void) {
    const int64_t bits = rig_bits(0, 0x44);
    const uint32_t asked[] = {0, 1, 40, (uint32_t)bits - 1, (uint32_t)bits, 1000};
    for (size_t i = 0; i < 6; i++) {
        setUp();
        order_rule(0, 0, 1, (can_loop_action_t){.corrupt = true, .error_bit = asked[i]});
        rig_sends(&rig, 0, 0x44);
        run_to_the_end(&rig);
        const int64_t at = asked[i] > 0 && asked[i] < bits ? asked[i] : bits - 7;
        TEST_ASSERT_EQUAL_UINT32(2, rig.event_count);
        TEST_ASSERT_TRUE(rig.events[0].error && !rig.events[1].error);
        TEST_ASSERT_EQUAL_INT64((at + 20) * RIG_BIT_NS, rig.events[0].end_ns);
        TEST_ASSERT_EQUAL_INT64((at + 23) * RIG_BIT_NS, rig.events[1].start_ns);
        TEST_ASSERT_EQUAL_INT64((at + 23 + bits) * RIG_BIT_NS, rig.events[1].end_ns);
        TEST_ASSERT_EQUAL_UINT32(7, can_loop_tec(&rig.loop, 0)); /* +8 -1 */
        TEST_ASSERT_EQUAL_UINT32(0, can_loop_rec(&rig.loop, 1)); /* +1 -1 */
        for (uint32_t n = 0; n < 3; n++) {
            TEST_ASSERT_EQUAL_UINT32(1, rig_state(&rig, n).error_frames);
        }
        rig_gets(&rig, 1, 0x44);
        rig_gets_nothing(&rig, 1);
        can_loop_run(&rig.loop, 100000);
        TEST_ASSERT_EQUAL_INT64((at + 23 + bits + 3) * RIG_BIT_NS, can_loop_busy_ns(&rig.loop));
    }
}

/* TEC: passive from 128, off above 255, and down by one with each success. */
static void test_error_counters_of_the_sender(void) {
    order_rule(0, 0, 16, (can_loop_action_t){.corrupt = true});
    rig_sends(&rig, 0, 1);
    for (uint32_t k = 1; k <= 16; k++) {
        while (rig.event_count < k) {
            can_loop_run(&rig.loop, can_loop_deadline(&rig.loop));
        }
        TEST_ASSERT_EQUAL_UINT32(8 * k, can_loop_tec(&rig.loop, 0));
        TEST_ASSERT_EQUAL_UINT32(k, can_loop_rec(&rig.loop, 1));
        TEST_ASSERT_EQUAL_INT(k < 16 ? BERTH_CAN_ERROR_ACTIVE : BERTH_CAN_ERROR_PASSIVE,
                              rig_state(&rig, 0).mode);
    }
    run_to_the_end(&rig);
    TEST_ASSERT_EQUAL_UINT32(127, can_loop_tec(&rig.loop, 0));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, rig_state(&rig, 0).mode);
    rig_gets(&rig, 1, 1);
    for (uint32_t i = 1; i <= 127; i++) {
        rig_sends(&rig, 0, 1);
        run_to_the_end(&rig);
        TEST_ASSERT_EQUAL_UINT32(127 - i, can_loop_tec(&rig.loop, 0));
    }
    rig_sends(&rig, 0, 1);
    run_to_the_end(&rig);
    TEST_ASSERT_EQUAL_UINT32(0, can_loop_tec(&rig.loop, 0));
}

/* 255 is not yet above 255. */
static void test_bus_off_is_above_255(void) {
    order_rule(0, 0, 1, (can_loop_action_t){.corrupt = true});
    order_rule(0, 2, 32, (can_loop_action_t){.corrupt = true});
    rig_sends(&rig, 0, 1);
    rig_sends(&rig, 0, 2);
    while (rig.event_count < 33) {
        can_loop_run(&rig.loop, can_loop_deadline(&rig.loop));
    }
    TEST_ASSERT_EQUAL_UINT32(8 - 1 + 31 * 8, can_loop_tec(&rig.loop, 0));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_PASSIVE, rig_state(&rig, 0).mode);
    run_to_the_end(&rig);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_BUS_OFF, rig_state(&rig, 0).mode);
}

/* An error passive sender waits 8 bits after its frame, and somebody else may use them. */
static void test_passive_sender_waits(void) {
    order_rule(0, 0, 17, (can_loop_action_t){.corrupt = true});
    rig_sends(&rig, 0, 1);
    rig_sends(&rig, 0, 2);
    rig_sends(&rig, 0, 3);
    run_to_the_end(&rig);
    const can_loop_event_t *e = rig.events;
    TEST_ASSERT_EQUAL_UINT32(20, rig.event_count);
    TEST_ASSERT_EQUAL_INT64(e[14].end_ns + 3 * RIG_BIT_NS, e[15].start_ns); /* 120: active */
    TEST_ASSERT_EQUAL_INT64(e[15].end_ns + 11 * RIG_BIT_NS, e[16].start_ns);
    TEST_ASSERT_EQUAL_INT64(e[17].end_ns + 11 * RIG_BIT_NS, e[18].start_ns);
    setUp();
    order_rule(0, 0, 17, (can_loop_action_t){.corrupt = true});
    rig_sends(&rig, 0, 1);
    rig_sends(&rig, 1, 0x700);
    run_to_the_end(&rig);
    TEST_ASSERT_EQUAL_UINT32(1, e[16].node);
    TEST_ASSERT_EQUAL_INT64(e[15].end_ns + 3 * RIG_BIT_NS, e[16].start_ns);
}

/* Receivers become passive by others' errors, and stay on the bus; one success shows them active.
 */
static void test_error_counters_of_receivers(void) {
    can_loop_auto_recover(&rig.loop, 0, 0);
    order_rule(0, 0, 300, (can_loop_action_t){.corrupt = true});
    while (can_loop_counters(&rig.loop, 1)->errors < 260) {
        if (rig_state(&rig, 0).mode != BERTH_CAN_BUS_OFF && can_loop_waiting(&rig.loop, 0) == 0) {
            rig_sends(&rig, 0, 1);
        }
        const uint32_t rec = can_loop_rec(&rig.loop, 1);
        TEST_ASSERT_EQUAL_INT(rec >= 128 ? BERTH_CAN_ERROR_PASSIVE : BERTH_CAN_ERROR_ACTIVE,
                              rig_state(&rig, 1).mode);
        can_loop_run(&rig.loop, can_loop_deadline(&rig.loop));
    }
    TEST_ASSERT_EQUAL_UINT32(255, can_loop_rec(&rig.loop, 1)); /* counts no further */
    can_loop_rules_clear(&rig.loop);
    rig_sends(&rig, 2, 2);
    while (can_loop_frames(&rig.loop) == 0) {
        can_loop_run(&rig.loop, can_loop_deadline(&rig.loop));
    }
    TEST_ASSERT_EQUAL_UINT32(127, can_loop_rec(&rig.loop, 1));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, rig_state(&rig, 1).mode);
}

/* Passive as a receiver, it waits after its own frames too; a recovery clears both counters. */
static void test_receiver_passive_sends(void) {
    can_loop_auto_recover(&rig.loop, 0, 0);
    order_rule(0, 0, 0, (can_loop_action_t){.corrupt = true});
    while (can_loop_rec(&rig.loop, 1) < 140) {
        if (rig_state(&rig, 0).mode != BERTH_CAN_BUS_OFF && can_loop_waiting(&rig.loop, 0) == 0) {
            rig_sends(&rig, 0, 1);
        }
        can_loop_run(&rig.loop, can_loop_deadline(&rig.loop));
    }
    can_loop_down(&rig.loop, 0);
    can_loop_run(&rig.loop, can_loop_now_us(&rig.loop) + 10000);
    const uint32_t before = rig.event_count;
    rig_sends(&rig, 1, 1);
    rig_sends(&rig, 1, 2);
    run_to_the_end(&rig);
    const can_loop_event_t *e = &rig.events[before];
    TEST_ASSERT_EQUAL_INT64(e[0].end_ns + 11 * RIG_BIT_NS, e[1].start_ns);
    TEST_ASSERT_EQUAL_UINT32(140, can_loop_rec(&rig.loop, 1));
    can_loop_bus_off(&rig.loop, 1);
    can_loop_recover(&rig.loop, 1);
    run_to_the_end(&rig);
    TEST_ASSERT_EQUAL_UINT32(0, can_loop_rec(&rig.loop, 1));
}

static void test_bus_off_by_errors(void) {
    order_rule(0, 0, 0, (can_loop_action_t){.corrupt = true});
    for (uint32_t i = 0; i < 5; i++) {
        rig_sends(&rig, 0, i);
    }
    run_to_the_end(&rig);
    TEST_ASSERT_EQUAL_UINT32(32, rig.event_count);
    berth_can_state_t s = rig_state(&rig, 0);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_BUS_OFF, s.mode);
    TEST_ASSERT_EQUAL_UINT32(5, s.tx_dropped);
    TEST_ASSERT_EQUAL_UINT32(32, s.error_frames);
    berth_can_frame_t f = {.id = 1};
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, rig_send(&rig, 0, &f));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, rig_receive(&rig, 0, &f));
    /* not by itself */
    can_loop_run(&rig.loop, can_loop_now_us(&rig.loop) + 1000000);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_BUS_OFF, rig_state(&rig, 0).mode);
    can_loop_rules_clear(&rig.loop);
    const int64_t asked_us = can_loop_now_us(&rig.loop);
    can_loop_recover(&rig.loop, 0);
    TEST_ASSERT_EQUAL_INT64(asked_us + 128 * 11, can_loop_deadline(&rig.loop));
    can_loop_run(&rig.loop, asked_us + 128 * 11 - 1);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_BUS_OFF, rig_state(&rig, 0).mode);
    can_loop_recover(&rig.loop, 0); /* asking again does not begin again */
    can_loop_run(&rig.loop, asked_us + 128 * 11);
    s = rig_state(&rig, 0);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, s.mode);
    TEST_ASSERT_EQUAL_UINT32(1, s.restarts);
    TEST_ASSERT_EQUAL_UINT32(0, can_loop_tec(&rig.loop, 0));
    rig_sends(&rig, 0, 9);
    run_to_the_end(&rig);
    rig_gets(&rig, 1, 9);
}

static void test_bus_off_ordered_and_automatic_recovery(void) {
    can_loop_auto_recover(&rig.loop, 1, 100);
    rig_sends(&rig, 0, 3);
    can_loop_run(&rig.loop, 500);
    can_loop_bus_off(&rig.loop, 1);
    berth_can_frame_t f;
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, rig_receive(&rig, 1, &f));
    rig_sends(&rig, 0, 4); /* missed */
    can_loop_run(&rig.loop, 500 + 100 + 1407);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_BUS_OFF, rig_state(&rig, 1).mode);
    can_loop_run(&rig.loop, 500 + 100 + 1408);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, rig_state(&rig, 1).mode);
    rig_gets(&rig, 1, 3); /* kept from before */
    rig_gets_nothing(&rig, 1);
    TEST_ASSERT_EQUAL_UINT64(1, can_loop_counters(&rig.loop, 1)->absent);
    /* recovery is nothing for a node that is not off; a negative delay is never */
    can_loop_recover(&rig.loop, 1);
    TEST_ASSERT_EQUAL_INT64(CAN_LOOP_NEVER, can_loop_deadline(&rig.loop));
    can_loop_auto_recover(&rig.loop, 1, INT64_MAX); /* clamped, not wrapped */
    can_loop_bus_off(&rig.loop, 1);
    TEST_ASSERT_TRUE(can_loop_deadline(&rig.loop) > INT64_C(1000000000000));
    can_loop_down(&rig.loop, 1);
    can_loop_up(&rig.loop, 1);
    can_loop_auto_recover(&rig.loop, 1, -1);
    can_loop_bus_off(&rig.loop, 1);
    TEST_ASSERT_EQUAL_INT64(CAN_LOOP_NEVER, can_loop_deadline(&rig.loop));
    can_loop_down(&rig.loop, 1);
    can_loop_recover(&rig.loop, 1);
    can_loop_bus_off(&rig.loop, 1);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DOWN, rig_state(&rig, 1).mode);
}

/* Down in the middle of its own frame: an error frame, and the bus is free soon after. */
static void test_down_while_sending(void) {
    rig_sends(&rig, 0, 1);
    rig_sends(&rig, 0, 2);
    rig_sends(&rig, 1, 3);
    can_loop_run(&rig.loop, 30);
    can_loop_down(&rig.loop, 0);
    berth_can_state_t s = rig_state(&rig, 0);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DOWN, s.mode);
    TEST_ASSERT_EQUAL_UINT32(2, s.tx_dropped);
    run_to_the_end(&rig);
    TEST_ASSERT_TRUE(rig.events[0].error);
    TEST_ASSERT_EQUAL_INT64(50 * RIG_BIT_NS, rig.events[0].end_ns);
    TEST_ASSERT_EQUAL_INT64(53 * RIG_BIT_NS, rig.events[1].start_ns);
    TEST_ASSERT_EQUAL_UINT32(1, rig_state(&rig, 2).error_frames);
    rig_gets(&rig, 2, 3);
    rig_gets_nothing(&rig, 2);
    const berth_can_frame_t f = {.id = 1};
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, rig_send(&rig, 0, &f));
    can_loop_up(&rig.loop, 0);
    can_loop_up(&rig.loop, 0);
    s = rig_state(&rig, 0);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, s.mode);
    TEST_ASSERT_EQUAL_UINT32(1, s.restarts);
    rig_sends(&rig, 0, 7);
    run_to_the_end(&rig);
    rig_gets(&rig, 2, 7);
    can_loop_run(&rig.loop, 10000);
    TEST_ASSERT_EQUAL_INT64((53 + rig_bits(1, 3) + 3 + rig_bits(0, 7) + 3) * RIG_BIT_NS,
                            can_loop_busy_ns(&rig.loop));
}

/* A wire mended in the middle of a frame is too late for it. */
static void test_mended_in_the_middle_of_a_frame(void) {
    can_loop_cut(&rig.loop, 1, true);
    rig_sends(&rig, 0, 1);
    can_loop_run(&rig.loop, 30);
    can_loop_cut(&rig.loop, 1, false);
    run_to_the_end(&rig);
    rig_gets_nothing(&rig, 1);
    TEST_ASSERT_EQUAL_UINT64(1, can_loop_counters(&rig.loop, 1)->absent);
}

/* Who comes in the middle of a frame does not get it. */
static void test_up_in_the_middle_of_a_frame(void) {
    can_loop_down(&rig.loop, 1);
    rig_sends(&rig, 0, 1);
    can_loop_run(&rig.loop, 30);
    can_loop_up(&rig.loop, 1);
    rig_sends(&rig, 0, 2);
    run_to_the_end(&rig);
    rig_gets(&rig, 1, 2);
    rig_gets_nothing(&rig, 1);
    rig_gets(&rig, 2, 1);
}

/* Nobody there to acknowledge: the frame is repeated, TEC stops at 128, and the frame gets through
 * as soon as somebody is there. */
static void test_alone_on_the_bus(void) {
    rig_start(&rig, 2);
    can_loop_down(&rig.loop, 1);
    rig_sends(&rig, 0, 0x31);
    can_loop_run(&rig.loop, 50000);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_PASSIVE, rig_state(&rig, 0).mode);
    TEST_ASSERT_EQUAL_UINT32(128, can_loop_tec(&rig.loop, 0));
    TEST_ASSERT_EQUAL_UINT64(0, can_loop_counters(&rig.loop, 0)->sent);
    TEST_ASSERT_TRUE(rig.event_count > 300);
    /* the error frame follows the ACK slot, 8 bits before the end of the frame */
    TEST_ASSERT_EQUAL_INT64((rig_bits(0, 0x31) - 8 + 20) * RIG_BIT_NS, rig.events[0].end_ns);
    can_loop_up(&rig.loop, 1);
    can_loop_run(&rig.loop, 51000);
    rig_gets(&rig, 1, 0x31);
    rig_gets_nothing(&rig, 1);
    TEST_ASSERT_EQUAL_UINT32(127, can_loop_tec(&rig.loop, 0));
    TEST_ASSERT_EQUAL_INT64(CAN_LOOP_NEVER, can_loop_deadline(&rig.loop));
}

static void test_cut_wire(void) {
    rig_sends(&rig, 0, 1);
    can_loop_run(&rig.loop, 10);
    can_loop_cut(&rig.loop, 0, true); /* in the middle of its frame */
    rig_sends(&rig, 1, 2);
    can_loop_run(&rig.loop, 10000);
    rig_gets(&rig, 2, 2);
    rig_gets_nothing(&rig, 2);
    rig_gets_nothing(&rig, 0);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_PASSIVE, rig_state(&rig, 0).mode);
    TEST_ASSERT_EQUAL_UINT32(1, can_loop_waiting(&rig.loop, 0));
    TEST_ASSERT_EQUAL_INT64(CAN_LOOP_NEVER, can_loop_deadline(&rig.loop));
    const berth_can_frame_t f = {.id = 1};
    while (rig_send(&rig, 0, &f) == BERTH_CAN_DONE) {
    }
    TEST_ASSERT_EQUAL_UINT32(CAN_LOOP_TX_MAX, can_loop_waiting(&rig.loop, 0));
    can_loop_cut(&rig.loop, 0, false);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_PASSIVE, rig_state(&rig, 0).mode);
    run_to_the_end(&rig);
    TEST_ASSERT_EQUAL_UINT32(128 - CAN_LOOP_TX_MAX, can_loop_tec(&rig.loop, 0));
    TEST_ASSERT_EQUAL_UINT64(CAN_LOOP_TX_MAX, can_loop_counters(&rig.loop, 2)->received - 1);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, rig_state(&rig, 0).mode);
    /* cut without anything to send: it does not notice */
    can_loop_cut(&rig.loop, 1, true);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, rig_state(&rig, 1).mode);
}

/* The best identifier at full rate starves everybody; the worst one only fills what is free. */
static void test_babbling_node(void) {
    const berth_can_frame_t best = {.id = 0, .length = 8};
    TEST_ASSERT_TRUE(can_loop_babble(&rig.loop, 2, &best, 10000));
    rig_sends(&rig, 0, 0x10);
    rig_sends(&rig, 2, 0x11); /* its own waits too */
    can_loop_run(&rig.loop, 10000);
    rig_gets_nothing(&rig, 2);
    const int64_t frame_us = can_text_bits(&best) + 3;
    const uint64_t babbled = (uint64_t)((10000 + frame_us - 1) / frame_us);
    TEST_ASSERT_TRUE(can_loop_load(&rig.loop, 0, 0) == 1.0);
    run_to_the_end(&rig);
    TEST_ASSERT_EQUAL_UINT64(babbled, can_loop_counters(&rig.loop, 2)->babbled);
    rig_gets(&rig, 2, 0x10);
    TEST_ASSERT_EQUAL_HEX32(0x11, rig.events[rig.event_count - 1].frame.id);
    const uint64_t taken[] = {1, 0, 1};
    rig_expect_conserved(&rig, taken);

    setUp();
    const berth_can_frame_t worst = {.id = 0x7ff, .length = 8};
    TEST_ASSERT_TRUE(can_loop_babble(&rig.loop, 2, &worst, INT64_MAX));
    for (int64_t at_us = 0; at_us < 50000; at_us += 1000) {
        can_loop_run(&rig.loop, at_us);
        rig_sends(&rig, 0, 0x10);
        can_loop_run(&rig.loop, at_us + can_text_bits(&worst) + 3 + rig_bits(0, 0x10));
        rig_gets(&rig, 2, 0x10); /* no more than one frame in front of it */
    }
    TEST_ASSERT_TRUE(can_loop_load(&rig.loop, 0, 0) > 0.999);
    can_loop_down(&rig.loop, 2); /* and that ends it */
    run_to_the_end(&rig);
    const berth_can_frame_t bad = {.id = 0x800};
    TEST_ASSERT_FALSE(can_loop_babble(&rig.loop, 1, &bad, 1));

    setUp();
    TEST_ASSERT_TRUE(can_loop_babble(&rig.loop, 2, &worst, INT64_MIN)); /* is over already */
    TEST_ASSERT_EQUAL_INT64(CAN_LOOP_NEVER, can_loop_deadline(&rig.loop));
    TEST_ASSERT_TRUE(can_loop_babble(&rig.loop, 2, &worst, 1000));
    TEST_ASSERT_EQUAL_INT64(can_text_bits(&worst), can_loop_deadline(&rig.loop));
}

static void test_rules_pick_frames(void) {
    const can_loop_rule_t rule = {.node = 1,
                                  .filtered = true,
                                  .filter = {.id = 0x100, .mask = 0x700},
                                  .skip = 2,
                                  .count = 3,
                                  .probability = 1.0,
                                  .action = {.deaf = CAN_LOOP_EVERYBODY}};
    TEST_ASSERT_TRUE(can_loop_rule(&rig.loop, &rule));
    for (uint32_t i = 0; i < 8; i++) {
        rig_sends(&rig, 1, 0x100 + i);
        rig_sends(&rig, 1, 0x200 + i); /* does not pass the filter */
        rig_sends(&rig, 0, 0x180 + i); /* another node */
    }
    run_to_the_end(&rig);
    uint32_t from_1 = 0;
    berth_can_frame_t f;
    while (rig_receive(&rig, 2, &f) == BERTH_CAN_DONE) {
        TEST_ASSERT_FALSE(f.id >= 0x102 && f.id <= 0x104);
        from_1 += f.data[0] == 1 ? 1u : 0u;
    }
    TEST_ASSERT_EQUAL_UINT32(16 - 3, from_1);
    TEST_ASSERT_EQUAL_UINT64(3, can_loop_counters(&rig.loop, 2)->deafened);
}

/* Both formats have such an identifier; the rule is about one of them. */
static void test_a_rule_tells_the_formats_apart(void) {
    const berth_can_frame_t extended = {.id = 0x123, .extended = true};
    const berth_can_frame_t standard = {.id = 0x123};
    const can_loop_rule_t rule = {.node = CAN_LOOP_ANY_NODE,
                                  .filtered = true,
                                  .filter = {.id = 0x123, .mask = 0x7ff, .extended = true},
                                  .probability = 1.0,
                                  .action = {.deaf = CAN_LOOP_EVERYBODY}};
    TEST_ASSERT_TRUE(can_loop_rule(&rig.loop, &rule));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, rig_send(&rig, 0, &extended));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, rig_send(&rig, 0, &standard));
    run_to_the_end(&rig);
    berth_can_frame_t f;
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, rig_receive(&rig, 1, &f));
    TEST_ASSERT_EQUAL_HEX32(0x123, f.id);
    TEST_ASSERT_FALSE(f.extended);
    rig_gets_nothing(&rig, 1);
    TEST_ASSERT_EQUAL_UINT64(1, can_loop_counters(&rig.loop, 1)->deafened);
}

/* In whichever order they were made, one rule's fault is not taken back by the next. */
static void test_either_of_two_rules_is_enough(void) {
    for (int first = 0; first < 2; first++) {
        setUp();
        for (int i = 0; i < 2; i++) {
            order_rule(0, 0, 1, (can_loop_action_t){.delay_us = 500, .stamp_on_wire = i == first});
        }
        rig_sends(&rig, 0, 1);
        run_to_the_end(&rig);
        berth_can_frame_t f;
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, rig_receive(&rig, 1, &f));
        TEST_ASSERT_EQUAL_INT64(rig_bits(0, 1), f.time_us);

        setUp();
        for (int i = 0; i < 2; i++) {
            order_rule(
                0, 0, 1,
                (can_loop_action_t){.corrupt = i == first, .error_bit = i == first ? 20 : 10});
        }
        rig_sends(&rig, 0, 1);
        run_to_the_end(&rig);
        TEST_ASSERT_EQUAL_UINT32(2, rig.event_count);
        TEST_ASSERT_TRUE(rig.events[0].error);
        TEST_ASSERT_EQUAL_INT64((20 + 20) * RIG_BIT_NS, rig.events[0].end_ns);
        rig_gets(&rig, 1, 1);
    }
}

/* A copy that a fault has ordered is not a frame that waits. */
static void test_copies_do_not_wait(void) {
    TEST_ASSERT_EQUAL_UINT32(0, can_loop_waiting(&rig.loop, 0));
    order_rule(0, 0, 1, (can_loop_action_t){.copies = 2});
    rig_sends(&rig, 0, 1);
    rig_sends(&rig, 0, 2);
    TEST_ASSERT_EQUAL_UINT32(2, can_loop_waiting(&rig.loop, 0));
    can_loop_run(&rig.loop, rig_bits(0, 1) + 1);
    TEST_ASSERT_EQUAL_UINT32(1, can_loop_waiting(&rig.loop, 0));
    can_loop_run(&rig.loop, 2 * (rig_bits(0, 1) + 3));
    TEST_ASSERT_EQUAL_UINT32(1, can_loop_waiting(&rig.loop, 0));
    run_to_the_end(&rig);
    TEST_ASSERT_EQUAL_UINT32(0, can_loop_waiting(&rig.loop, 0));
    /* and once the wire is empty, what is left of a copy counts no more */
    TEST_ASSERT_EQUAL_UINT64(2, can_loop_counters(&rig.loop, 0)->copies);
}

/* A node whose counter is above the passive limit already keeps it while its wire is cut. */
static void test_a_cut_wire_does_not_lower_the_counter(void) {
    order_rule(0, 0, 20, (can_loop_action_t){.corrupt = true});
    rig_sends(&rig, 0, 1);
    while (can_loop_tec(&rig.loop, 0) < 160) {
        can_loop_run(&rig.loop, can_loop_deadline(&rig.loop));
    }
    TEST_ASSERT_EQUAL_UINT32(160, can_loop_tec(&rig.loop, 0));
    can_loop_cut(&rig.loop, 0, true);
    const uint32_t tec = can_loop_tec(&rig.loop, 0);
    TEST_ASSERT_TRUE(tec >= 160);
    can_loop_cut(&rig.loop, 0, false);
    TEST_ASSERT_EQUAL_UINT32(tec, can_loop_tec(&rig.loop, 0));
}

/* The HAL's counters have 32 bits, and stay at their largest value. */
static void test_large_counts_are_told_as_the_largest(void) {
    can_loop_counters_t *counters = &rig.loop.nodes[0].counters;
    counters->overflow = UINT64_C(1) << 32;
    counters->dropped = UINT32_MAX;
    counters->errors = UINT64_MAX;
    counters->restarts = UINT32_MAX - 1u;
    const berth_can_state_t state = rig_state(&rig, 0);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, state.rx_lost);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, state.tx_dropped);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, state.error_frames);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX - 1u, state.restarts);
}

/* Several rules and the hook at once: their actions add up. */
static void test_rules_and_hook_add_up(void) {
    rig_start(&rig, 5);
    one_t one = {.index = 0, .action = {.deaf = 1u << 2, .delay_us = 500, .flip = {0x0f}}};
    can_loop_fault(&rig.loop, one_fault, &one);
    order_rule(0, 0, 1, (can_loop_action_t){.deaf = 1u << 1, .copies = 2, .delay_us = 700});
    order_rule(0, 0, 1, (can_loop_action_t){.deaf = 1u << 3, .copies = 1, .flip = {0xff}});
    rig_sends(&rig, 0, 1);
    run_to_the_end(&rig);
    TEST_ASSERT_EQUAL_UINT32(3, rig.event_count);
    for (uint32_t n = 1; n < 4; n++) {
        TEST_ASSERT_EQUAL_UINT64(1, can_loop_counters(&rig.loop, n)->deafened);
        TEST_ASSERT_EQUAL_UINT64(2, can_loop_counters(&rig.loop, n)->received);
    }
    berth_can_frame_t f;
    TEST_ASSERT_EQUAL_UINT64(3, can_loop_counters(&rig.loop, 4)->received);
    for (int i = 0; i < 3; i++) {
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, rig_receive(&rig, 4, &f));
    }
    TEST_ASSERT_EQUAL_INT64(rig_bits(0, 1) + 700, f.time_us); /* the late one comes last */
    TEST_ASSERT_EQUAL_HEX8(0xf0, f.data[0]);
}

/* A frame that waits does not hide what ends before it. */
static void test_deadline_is_the_earliest(void) {
    order_rule(0, 0, 1, (can_loop_action_t){.delay_us = 60});
    rig_sends(&rig, 0, 1);
    const int64_t due_us = rig_bits(0, 1) + 60;
    can_loop_run(&rig.loop, rig_bits(0, 1) + 20);
    rig_sends(&rig, 0, 2);
    TEST_ASSERT_EQUAL_INT64(due_us, can_loop_deadline(&rig.loop));
    can_loop_run(&rig.loop, 10000);
    can_loop_bus_off(&rig.loop, 2);
    can_loop_recover(&rig.loop, 2);
    can_loop_run(&rig.loop, 10000 + 1400);
    rig_sends(&rig, 0, 3);
    TEST_ASSERT_EQUAL_INT64(10000 + 1408, can_loop_deadline(&rig.loop));
    can_loop_run(&rig.loop, 10000 + 1408);
    TEST_ASSERT_EQUAL_INT64(10000 + 1400 + rig_bits(0, 3), can_loop_deadline(&rig.loop));
}

static void test_rules_with_probability(void) {
    static const double p[] = {0.0, 0.3, 1.0};
    for (size_t k = 0; k < 3; k++) {
        setUp();
        const can_loop_rule_t rule = {
            .node = CAN_LOOP_ANY_NODE, .probability = p[k], .action = {.deaf = CAN_LOOP_EVERYBODY}};
        TEST_ASSERT_TRUE(can_loop_rule(&rig.loop, &rule));
        for (int i = 0; i < 5000; i++) {
            rig_sends(&rig, 0, 1);
            run_to_the_end(&rig);
        }
        const double lost = (double)can_loop_counters(&rig.loop, 1)->deafened / 5000.0;
        TEST_ASSERT_TRUE(fabs(lost - p[k]) <= (k == 1 ? 0.03 : 0.0));
    }
}

static void test_refused_rules(void) {
    static const double bad[] = {-0.1, 1.1, (double)NAN, (double)INFINITY};
    can_loop_rule_t rule = {.node = CAN_LOOP_ANY_NODE};
    for (size_t i = 0; i < 4; i++) {
        rule.probability = bad[i];
        TEST_ASSERT_FALSE(can_loop_rule(&rig.loop, &rule));
    }
    rule.probability = 0.5;
    for (uint32_t i = 0; i < CAN_LOOP_RULES_MAX; i++) {
        TEST_ASSERT_TRUE(can_loop_rule(&rig.loop, &rule));
    }
    TEST_ASSERT_FALSE(can_loop_rule(&rig.loop, &rule));
    can_loop_rules_clear(&rig.loop);
    TEST_ASSERT_TRUE(can_loop_rule(&rig.loop, &rule));
}

/* Orders for nodes that there are not do nothing. */
static void test_no_such_node(void) {
    const berth_can_frame_t f = {.id = 1};
    can_loop_down(&rig.loop, 3);
    can_loop_up(&rig.loop, 3);
    can_loop_bus_off(&rig.loop, UINT32_MAX);
    can_loop_recover(&rig.loop, 3);
    can_loop_auto_recover(&rig.loop, 3, 0);
    can_loop_cut(&rig.loop, 3, true);
    can_loop_depths(&rig.loop, 3, 1, 1);
    can_loop_filter_clear(&rig.loop, 3);
    TEST_ASSERT_FALSE(can_loop_babble(&rig.loop, 3, &f, 1000));
    TEST_ASSERT_EQUAL_INT64(CAN_LOOP_NEVER, can_loop_deadline(&rig.loop));
    TEST_ASSERT_TRUE(can_loop_attach(&rig.loop, &rig.can[3]));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, rig_state(&rig, 3).mode);
}

/* Everything at random. */
#define STORM_NODES 6u

static can_loop_action_t random_fault(void *context, uint64_t index, uint32_t node,
                                      const berth_can_frame_t *frame) {
    uint64_t *state = context;
    (void)node;
    (void)frame;
    *state = *state * 6364136223846793005u + 1442695040888963407u + index;
    const uint32_t draw = (uint32_t)(*state >> 33);
    switch (draw % 16) {
    case 0:
        return (can_loop_action_t){.deaf = draw >> 4};
    case 1:
        return (can_loop_action_t){.delay_us = draw >> 12, .stamp_on_wire = draw % 32 == 1};
    case 2:
        return (can_loop_action_t){.copies = (uint8_t)(draw >> 4 & 3u)};
    case 3:
    case 4:
    case 5:
        return (can_loop_action_t){.corrupt = true, .error_bit = draw >> 4 & 127u};
    case 6:
        return (can_loop_action_t){.flip = {(uint8_t)(draw >> 4)}};
    default:
        return (can_loop_action_t){0};
    }
}

static void random_trouble(rig_t *on, uint32_t kind, uint32_t node, uint32_t value) {
    const berth_can_frame_t noise = {.id = value % 2048, .length = 8};
    switch (kind) {
    case 0:
        can_loop_down(&on->loop, node);
        break;
    case 1:
    case 2:
        can_loop_up(&on->loop, node);
        break;
    case 3:
        can_loop_bus_off(&on->loop, node);
        break;
    case 4:
        can_loop_recover(&on->loop, node);
        break;
    case 5:
        can_loop_cut(&on->loop, node, value % 4 == 0);
        break;
    case 6:
        TEST_ASSERT_TRUE(can_loop_babble(&on->loop, node, &noise,
                                         can_loop_now_us(&on->loop) + (int64_t)(value % 2000)));
        break;
    default:
        can_loop_auto_recover(&on->loop, node, (int64_t)(value % 3000) - 500);
        break;
    }
}

/* Drawn once, so that it can be played again. */
typedef struct {
    int64_t wait_us;
    uint32_t node, kind, value;
} storm_step_t;

#define STORM_STEPS 1500u

static storm_step_t storm[STORM_STEPS];

static void play_storm(rig_t *on, uint64_t *taken) {
    static uint64_t state;
    state = 42;
    rig_start(on, STORM_NODES);
    memset(taken, 0, STORM_NODES * sizeof taken[0]);
    can_loop_fault(&on->loop, random_fault, &state);
    const berth_can_filter_t some = {.id = 0, .mask = 3};
    TEST_ASSERT_TRUE(can_loop_filter(&on->loop, 0, &some));
    for (uint32_t i = 0; i < STORM_STEPS; i++) {
        const storm_step_t *s = &storm[i];
        can_loop_run(&on->loop, can_loop_now_us(&on->loop) + s->wait_us);
        const berth_can_frame_t f = {.id = s->value % 2048, .length = (uint8_t)(s->value % 9)};
        if (s->kind < 8) {
            random_trouble(on, s->kind, s->node, s->value);
        } else if (s->kind < 40) {
            berth_can_frame_t got;
            (void)rig_receive(on, s->node, &got);
        } else if (rig_send(on, s->node, &f) == BERTH_CAN_DONE) {
            taken[s->node]++;
        }
    }
    can_loop_fault(&on->loop, NULL, NULL);
    can_loop_run(&on->loop, can_loop_now_us(&on->loop) + 1000000);
}

static void test_storm_keeps_the_books(void) {
    support_random_start();
    const uint32_t runs = support_runs(200);
    uint64_t seen[STORM_NODES] = {0};
    for (uint32_t run = 0; run < runs; run++) {
        for (uint32_t i = 0; i < STORM_STEPS; i++) {
            storm[i] =
                (storm_step_t){(int64_t)support_index(100), support_index(STORM_NODES),
                               support_index(run % 2 == 0 ? 100 : 200), support_index(1u << 20)};
        }
        uint64_t taken[STORM_NODES];
        uint64_t again[STORM_NODES];
        play_storm(&rig, taken);
        TEST_ASSERT_EQUAL_UINT32(0, can_loop_held(&rig.loop));
        rig_expect_conserved(&rig, taken);
        play_storm(&twin, again);
        rig_expect_same_events(&rig, &twin);
        TEST_ASSERT_EQUAL_MEMORY(taken, again, sizeof taken);
        for (uint32_t n = 0; n < STORM_NODES; n++) {
            const can_loop_counters_t *c = can_loop_counters(&rig.loop, n);
            seen[0] += c->dropped;
            seen[1] += c->absent;
            seen[2] += c->deafened;
            seen[3] += c->copies;
            seen[4] += c->overflow;
            seen[5] += c->babbled;
        }
    }
    for (uint32_t i = 0; i < 6; i++) { /* the storm has all of it */
        TEST_ASSERT_TRUE(seen[i] > 0);
    }
}

/* Without faults: every frame taken is with each other node exactly once, in its sender's order. */
static void test_each_frame_exactly_once(void) {
    support_random_start();
    rig_start(&rig, 4);
    uint64_t taken[4] = {0};
    uint32_t next[4][4] = {{0}};
    for (int i = 0; i < 5000; i++) {
        const uint32_t node = support_index(4);
        berth_can_frame_t f = {.id = support_index(2048), .length = 8, .data = {(uint8_t)node}};
        for (int b = 0; b < 4; b++) {
            f.data[1 + b] = (uint8_t)(taken[node] >> 8 * b);
        }
        taken[node] += rig_send(&rig, node, &f) == BERTH_CAN_DONE ? 1u : 0u;
        can_loop_run(&rig.loop, can_loop_now_us(&rig.loop) + (int64_t)support_index(250));
        for (uint32_t n = 0; n < 4; n++) {
            while (rig_receive(&rig, n, &f) == BERTH_CAN_DONE) {
                const uint32_t from = f.data[0];
                TEST_ASSERT_TRUE(from < 4 && from != n);
                TEST_ASSERT_EQUAL_UINT8(next[n][from] & 0xff, f.data[1]);
                TEST_ASSERT_EQUAL_UINT8(next[n][from] >> 8, f.data[2]);
                next[n][from]++;
            }
        }
    }
    for (uint32_t n = 0; n < 4; n++) {
        for (uint32_t from = 0; from < 4; from++) {
            const uint64_t sent = can_loop_counters(&rig.loop, from)->sent;
            TEST_ASSERT_EQUAL_UINT64(n == from ? 0 : sent, next[n][from]);
        }
    }
    rig_expect_conserved(&rig, taken);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_each_frame_lost);
    RUN_TEST(test_one_receiver_is_deaf);
    RUN_TEST(test_late_frame);
    RUN_TEST(test_late_frame_stamped_on_the_wire);
    RUN_TEST(test_too_many_late_frames);
    RUN_TEST(test_doubled_frame);
    RUN_TEST(test_every_frame_doubled);
    RUN_TEST(test_altered_data);
    RUN_TEST(test_corrupted_frame);
    RUN_TEST(test_error_counters_of_the_sender);
    RUN_TEST(test_bus_off_is_above_255);
    RUN_TEST(test_passive_sender_waits);
    RUN_TEST(test_error_counters_of_receivers);
    RUN_TEST(test_receiver_passive_sends);
    RUN_TEST(test_bus_off_by_errors);
    RUN_TEST(test_bus_off_ordered_and_automatic_recovery);
    RUN_TEST(test_down_while_sending);
    RUN_TEST(test_mended_in_the_middle_of_a_frame);
    RUN_TEST(test_up_in_the_middle_of_a_frame);
    RUN_TEST(test_alone_on_the_bus);
    RUN_TEST(test_cut_wire);
    RUN_TEST(test_babbling_node);
    RUN_TEST(test_rules_pick_frames);
    RUN_TEST(test_deadline_is_the_earliest);
    RUN_TEST(test_a_rule_tells_the_formats_apart);
    RUN_TEST(test_either_of_two_rules_is_enough);
    RUN_TEST(test_copies_do_not_wait);
    RUN_TEST(test_a_cut_wire_does_not_lower_the_counter);
    RUN_TEST(test_large_counts_are_told_as_the_largest);
    RUN_TEST(test_rules_and_hook_add_up);
    RUN_TEST(test_rules_with_probability);
    RUN_TEST(test_refused_rules);
    RUN_TEST(test_no_such_node);
    RUN_TEST(test_storm_keeps_the_books);
    RUN_TEST(test_each_frame_exactly_once);
    return UNITY_END();
}
