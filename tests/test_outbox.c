/* Frames that wait to be sent: their order, what replaces what, and a full outbox. */
#include "berth/outbox.h"
#include "support.h"

#include "unity.h"

static berth_outbox_t outbox;

void setUp(void) {
    outbox.dropped = 77;
    outbox.count = 3;
    outbox.first = 5;
    berth_outbox_reset(&outbox);
}

void tearDown(void) {}

static bool put(uint32_t id, bool extended, uint8_t value, berth_outbox_policy_t policy) {
    const berth_can_frame_t frame = {.id = id, .extended = extended, .length = 1, .data = {value}};
    return berth_outbox_put(&outbox, &frame, policy);
}

/* Takes the next frame out, which must be this one. */
static void expect_next(uint32_t id, bool extended, uint8_t value) {
    const berth_can_frame_t *front = berth_outbox_front(&outbox);
    TEST_ASSERT_NOT_NULL(front);
    TEST_ASSERT_EQUAL_HEX32(id, front->id);
    TEST_ASSERT_EQUAL_INT(extended, front->extended);
    TEST_ASSERT_EQUAL_UINT8(value, front->data[0]);
    berth_outbox_pop(&outbox);
}

static void expect_empty(void) {
    TEST_ASSERT_NULL(berth_outbox_front(&outbox));
    TEST_ASSERT_EQUAL_UINT8(0, outbox.count);
}

static void test_frames_leave_in_the_order_in_which_they_came(void) {
    for (uint32_t round = 0; round < 3 * BERTH_OUTBOX_MAX; round++) {
        TEST_ASSERT_TRUE(put(round, false, 1, BERTH_OUTBOX_EACH));
        TEST_ASSERT_TRUE(put(round, false, 2, BERTH_OUTBOX_EACH));
        TEST_ASSERT_TRUE(put(round + 1, true, 3, BERTH_OUTBOX_LATEST));
        expect_next(round, false, 1);
        expect_next(round, false, 2);
        expect_next(round + 1, true, 3);
        expect_empty();
    }
}

static void test_the_latest_takes_the_place_of_the_waiting_one(void) {
    for (uint32_t first = 0; first < BERTH_OUTBOX_MAX; first++) { /* across the ring's end too */
        setUp();
        outbox.first = (uint8_t)first;
        TEST_ASSERT_TRUE(put(1, false, 10, BERTH_OUTBOX_EACH));
        TEST_ASSERT_TRUE(put(2, false, 20, BERTH_OUTBOX_LATEST));
        TEST_ASSERT_TRUE(put(3, false, 30, BERTH_OUTBOX_LATEST));
        TEST_ASSERT_TRUE(put(2, false, 21, BERTH_OUTBOX_LATEST));
        TEST_ASSERT_TRUE(put(2, false, 22, BERTH_OUTBOX_LATEST));
        expect_next(1, false, 10);
        expect_next(2, false, 22);
        expect_next(3, false, 30);
        expect_empty();
    }
}

/* The same number names another frame in the other format. */
static void test_formats_are_told_apart(void) {
    TEST_ASSERT_TRUE(put(5, false, 1, BERTH_OUTBOX_LATEST));
    TEST_ASSERT_TRUE(put(5, true, 2, BERTH_OUTBOX_LATEST));
    TEST_ASSERT_TRUE(put(5, true, 3, BERTH_OUTBOX_LATEST));
    expect_next(5, false, 1);
    expect_next(5, true, 3);
    expect_empty();
}

static void test_a_full_outbox_drops_what_is_new_and_counts_it(void) {
    for (uint32_t i = 0; i < BERTH_OUTBOX_MAX; i++) {
        TEST_ASSERT_TRUE(put(i, false, 1, BERTH_OUTBOX_EACH));
    }
    TEST_ASSERT_FALSE(put(500, false, 1, BERTH_OUTBOX_EACH));
    TEST_ASSERT_FALSE(put(501, false, 1, BERTH_OUTBOX_LATEST));
    TEST_ASSERT_TRUE(put(3, false, 9, BERTH_OUTBOX_LATEST)); /* needs no room */
    TEST_ASSERT_EQUAL_UINT32(2, outbox.dropped);
    outbox.dropped = UINT32_MAX - 1;
    TEST_ASSERT_FALSE(put(502, false, 1, BERTH_OUTBOX_EACH));
    TEST_ASSERT_FALSE(put(502, false, 1, BERTH_OUTBOX_EACH));
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, outbox.dropped);
    for (uint32_t i = 0; i < BERTH_OUTBOX_MAX; i++) {
        expect_next(i, false, i == 3 ? 9 : 1);
    }
    expect_empty();
}

static void test_taking_from_an_empty_outbox_does_nothing(void) {
    berth_outbox_pop(&outbox);
    expect_empty();
    TEST_ASSERT_TRUE(put(1, false, 1, BERTH_OUTBOX_EACH));
    expect_next(1, false, 1);
    berth_outbox_pop(&outbox);
    expect_empty();
}

static void test_clearing_keeps_the_count_of_dropped_frames(void) {
    TEST_ASSERT_TRUE(put(1, false, 1, BERTH_OUTBOX_EACH));
    outbox.dropped = 4;
    berth_outbox_clear(&outbox);
    expect_empty();
    TEST_ASSERT_EQUAL_UINT32(4, outbox.dropped);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_frames_leave_in_the_order_in_which_they_came);
    RUN_TEST(test_the_latest_takes_the_place_of_the_waiting_one);
    RUN_TEST(test_formats_are_told_apart);
    RUN_TEST(test_a_full_outbox_drops_what_is_new_and_counts_it);
    RUN_TEST(test_taking_from_an_empty_outbox_does_nothing);
    RUN_TEST(test_clearing_keeps_the_count_of_dropped_frames);
    return UNITY_END();
}
