/* The template for a port is whole, and safe as it is. */
#include "blank.h"

#include "unity.h"

#include <string.h>

void setUp(void) {}
void tearDown(void) {}

static void test_nothing_is_sent_or_received(void) {
    const berth_can_t can = blank_can();
    const berth_can_frame_t good = {.id = 0x123, .length = 8};
    berth_can_frame_t frame;
    berth_can_frame_t before;
    memset(&frame, 0x5a, sizeof frame);
    before = frame;
    for (int i = 0; i < 3; i++) {
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, can.api->send(can.context, &good));
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, can.api->receive(can.context, &frame));
    }
    TEST_ASSERT_EQUAL_MEMORY(&before, &frame, sizeof frame);
}

static void test_the_bus_is_down(void) {
    const berth_can_t can = blank_can();
    berth_can_state_t state;
    memset(&state, 0x5a, sizeof state);
    can.api->state(can.context, &state);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DOWN, state.mode);
    TEST_ASSERT_EQUAL_UINT32(0, state.rx_lost);
    TEST_ASSERT_EQUAL_UINT32(0, state.tx_dropped);
    TEST_ASSERT_EQUAL_UINT32(0, state.error_frames);
    TEST_ASSERT_EQUAL_UINT32(0, state.restarts);
}

static void test_waiting_returns_and_time_stands(void) {
    const berth_clock_t clock = blank_clock();
    TEST_ASSERT_EQUAL_INT64(0, clock.api->now_us(clock.context));
    clock.api->sleep_until_us(clock.context, INT64_MAX);
    clock.api->sleep_until_us(clock.context, INT64_MIN);
    TEST_ASSERT_EQUAL_INT64(0, clock.api->now_us(clock.context));
}

static void test_lines_go_nowhere(void) {
    const berth_log_t log = blank_log();
    TEST_ASSERT_NOT_NULL(log.api);
    log.api->line(log.context, "a line");
    log.api->line(log.context, "");
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_nothing_is_sent_or_received);
    RUN_TEST(test_the_bus_is_down);
    RUN_TEST(test_waiting_returns_and_time_stands);
    RUN_TEST(test_lines_go_nowhere);
    return UNITY_END();
}
