/* A CAN driver against a model of its controller: the contract of berth_hal/can.h, and what both
 * drivers promise. Compiled once for each controller; CONTROLLER says which. */
#include CONTROLLER
#include "rig.h"

static ctl_rig_t rig;
static node_bus_t bus;
static node_t us;

void setUp(void) {
    io_model_reset();
    rig_time = (rig_clock_t){.now_us = 1000};
    memset(&bus, 0, sizeof bus);
    ctl_init(&rig);
    us = ctl_node(&rig);
}

void tearDown(void) {
    RIG_VIOLATIONS(&rig);
}

/* One frame of ours gets through; says which. */
static berth_can_frame_t one_sent(void) {
    berth_can_frame_t frame;
    TEST_ASSERT_TRUE_MESSAGE(us.ops->offer(us.context, &frame), "nothing to send");
    us.ops->sent(us.context);
    return frame;
}

static void hears(const berth_can_frame_t *frame) {
    us.ops->hear(us.context, frame);
}

static void go_off(void) {
    ctl_set_tec(&rig, 256);
    ctl_interrupts(&rig);
}

static berth_can_mode_t mode(void) {
    return state_of(&rig.can).mode;
}

/* ---- Opening ----------------------------------------------------------------------------------
 */

static void test_opens_from_reset(void) {
    ctl_delay(&rig, 20);
    ctl_open(&rig, NULL, 0);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, mode());
    TEST_ASSERT_EQUAL_UINT32(0, state_of(&rig.can).restarts);
}

static void test_a_silent_controller_is_given_up(void) {
    ctl_stick(&rig, true);
    TEST_ASSERT_EQUAL_INT(STM32_CAN_ERROR_SILENT, ctl_open_result(&rig, NULL, 0));
    TEST_ASSERT_TRUE(io_model_accesses() <= CTL_LOOKS + 100u);
    rig.can = ctl_can(&rig.driver);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DOWN, mode());
    berth_can_frame_t frame;
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, sends(&rig.can, 1, 1));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, receive(&rig.can, &frame));
    ctl_abort(&rig.driver);
    ctl_restart(&rig.driver);
    ctl_diagnosis_t diagnosis;
    ctl_diagnosis(&rig.driver, &diagnosis);
    TEST_ASSERT_EQUAL_UINT32(0, diagnosis.transmit_errors);
    ctl_stick(&rig, false); /* too late */
    for (int i = 0; i < 3; i++) {
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DOWN, mode());
    }
    TEST_ASSERT_EQUAL_UINT32(0, state_of(&rig.can).restarts);
}

static uint32_t dead_read(void *context, uint32_t offset) {
    (void)offset;
    return *(uint32_t *)context;
}

static void dead_write(void *context, uint32_t offset, uint32_t value) {
    (void)context;
    (void)offset;
    (void)value;
}

/* No clock, or no such peripheral: all registers read the same. */
static void test_dead_hardware_is_refused(void) {
    static const io_model_ops_t dead = {dead_read, dead_write};
    static uint32_t values[] = {0, UINT32_MAX};
    for (int i = 0; i < 2; i++) {
        io_model_reset();
        ctl_map_dead(&rig, &dead, &values[i]);
        TEST_ASSERT_EQUAL_INT(STM32_CAN_ERROR_SILENT, ctl_open_result(&rig, NULL, 0));
        rig.can = ctl_can(&rig.driver);
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DOWN, mode());
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, sends(&rig.can, 1, 1));
    }
}

static void test_waiting_ends_by_the_clock_too(void) {
    ctl_stick(&rig, true);
    rig_time.step_us = 100;
    TEST_ASSERT_EQUAL_INT(STM32_CAN_ERROR_SILENT, ctl_open_result(&rig, NULL, 0));
    TEST_ASSERT_TRUE(io_model_accesses() <= 200u);
}

static void test_joins_a_stuck_bus_later(void) {
    rig.model.bus_dominant = true;
    TEST_ASSERT_EQUAL_INT(STM32_CAN_ERROR_NOT_JOINED, ctl_open_result(&rig, NULL, 0));
    rig.can = ctl_can(&rig.driver);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DOWN, mode());
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, sends(&rig.can, 1, 1));
    rig.model.bus_dominant = false;
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, mode());
    TEST_ASSERT_EQUAL_UINT32(1, state_of(&rig.can).restarts);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, sends(&rig.can, 1, 1));
}

static void test_every_result_has_a_text(void) {
    for (int i = 0; i >= STM32_CAN_ERROR_NOT_JOINED; i--) {
        const char *text = stm32_can_result_text((stm32_can_result_t)i);
        TEST_ASSERT_TRUE(strlen(text) > 3 && strcmp(text, "unknown") != 0);
    }
    TEST_ASSERT_EQUAL_STRING("unknown", stm32_can_result_text((stm32_can_result_t)7));
}

static void test_opening_again_forgets_the_past(void) {
    ctl_open(&rig, NULL, 0);
    const berth_can_frame_t heard = frame_with(5, 5);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, sends(&rig.can, 1, 1));
    for (int i = 0; i < 4; i++) {
        hears(&heard);
    }
    ctl_open(&rig, NULL, 0);
    berth_can_frame_t frame;
    TEST_ASSERT_FALSE(us.ops->offer(us.context, &frame));
    ctl_interrupts(&rig);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, receive(&rig.can, &frame));
    TEST_ASSERT_EQUAL_UINT32(0, state_of(&rig.can).rx_lost);
    TEST_ASSERT_EQUAL_UINT32(0, state_of(&rig.can).tx_dropped);
}

/* ---- Sending ----------------------------------------------------------------------------------
 */

static void test_every_kind_of_frame_goes_out_as_it_is(void) {
    support_random_start();
    ctl_open(&rig, NULL, 0);
    for (uint32_t i = 0; i < support_runs(5000); i++) {
        const berth_can_frame_t frame = random_frame();
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, send(&rig.can, &frame));
        const berth_can_frame_t sent = one_sent();
        expect_frame(&frame, &sent);
    }
    TEST_ASSERT_EQUAL_UINT32(0, state_of(&rig.can).tx_dropped);
}

static void test_bad_frames_are_refused(void) {
    ctl_open(&rig, NULL, 0);
    const berth_can_frame_t bad[] = {
        {.id = 0x800},
        {.id = 0x20000000, .extended = true},
        {.id = UINT32_MAX, .extended = true},
        {.id = 1, .length = 9},
        {.id = 1, .length = 255, .remote = true},
    };
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, send(&rig.can, &bad[i]));
    }
    berth_can_frame_t frame;
    TEST_ASSERT_FALSE(us.ops->offer(us.context, &frame));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, mode());
}

static void test_three_mailboxes_then_again(void) {
    ctl_open(&rig, NULL, 0);
    for (uint32_t id = 1; id <= 3; id++) {
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, sends(&rig.can, id, 0));
    }
    for (int i = 0; i < 5; i++) {
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, sends(&rig.can, 4, 0));
    }
    one_sent();
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, sends(&rig.can, 4, 0));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, sends(&rig.can, 5, 0));
}

static void test_the_most_urgent_goes_first(void) {
    ctl_open(&rig, NULL, 0);
    sends(&rig.can, 0x300, 1);
    sends(&rig.can, 0x100, 2);
    sends(&rig.can, 0x200, 3);
    TEST_ASSERT_EQUAL_HEX32(0x100, one_sent().id);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, sends(&rig.can, 0x080, 4));
    TEST_ASSERT_EQUAL_HEX32(0x080, one_sent().id);
    TEST_ASSERT_EQUAL_HEX32(0x200, one_sent().id);
    TEST_ASSERT_EQUAL_HEX32(0x300, one_sent().id);
}

static void test_frames_of_one_id_keep_their_order(void) {
    support_random_start();
    ctl_open(&rig, NULL, 0);
    uint8_t given[8] = {0};
    uint8_t seen[8] = {0};
    for (uint32_t i = 0; i < support_runs(20000); i++) {
        const uint32_t which = support_index(4);
        berth_can_frame_t frame = frame_with(0x10u + which / 2u, given[which]);
        frame.extended = which % 2u == 1;
        if (chance(0.6) && send(&rig.can, &frame) == BERTH_CAN_DONE) {
            given[which] = (uint8_t)((given[which] + 1u) & 0xffu);
        }
        if (chance(0.2) && us.ops->offer(us.context, &frame)) {
            us.ops->lost_arbitration(us.context);
        }
        if (chance(0.5) && us.ops->offer(us.context, &frame)) {
            us.ops->sent(us.context);
            const uint32_t got = (frame.id - 0x10u) * 2u + (frame.extended ? 1u : 0u);
            TEST_ASSERT_EQUAL_UINT8(seen[got], frame.data[0]);
            seen[got] = (uint8_t)((seen[got] + 1u) & 0xffu);
        }
    }
    TEST_ASSERT_EQUAL_UINT32(0, state_of(&rig.can).tx_dropped);
}

/* A data frame would overtake a remote frame with its id. */
static void test_a_remote_frame_is_not_overtaken(void) {
    ctl_open(&rig, NULL, 0);
    const berth_can_frame_t request = {.id = 0x20, .remote = true, .length = 4};
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, send(&rig.can, &request));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, sends(&rig.can, 0x20, 1));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, sends(&rig.can, 0x21, 1));
    TEST_ASSERT_TRUE(one_sent().remote);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, sends(&rig.can, 0x20, 1));
}

static void test_lost_and_failed_transmissions_are_repeated(void) {
    ctl_open(&rig, NULL, 0);
    sends(&rig.can, 0x10, 7);
    berth_can_frame_t frame;
    for (int i = 0; i < 5; i++) {
        TEST_ASSERT_TRUE(us.ops->offer(us.context, &frame));
        us.ops->lost_arbitration(us.context);
        TEST_ASSERT_TRUE(us.ops->offer(us.context, &frame));
        us.ops->failed(us.context, NODE_ERROR_BIT1);
        ctl_interrupts(&rig);
    }
    TEST_ASSERT_EQUAL_HEX8(7, one_sent().data[0]);
    const berth_can_state_t state = state_of(&rig.can);
    TEST_ASSERT_EQUAL_UINT32(5, state.error_frames);
    TEST_ASSERT_EQUAL_UINT32(0, state.tx_dropped);
}

static void test_abort_takes_back_what_waits(void) {
    ctl_open(&rig, NULL, 0);
    for (uint32_t id = 1; id <= 3; id++) {
        sends(&rig.can, id, (uint8_t)id);
    }
    berth_can_frame_t frame;
    TEST_ASSERT_TRUE(us.ops->offer(us.context, &frame));
    ctl_abort(&rig.driver);
    TEST_ASSERT_EQUAL_UINT32(2, state_of(&rig.can).tx_dropped);
    us.ops->sent(us.context); /* that one was on the wire */
    TEST_ASSERT_EQUAL_UINT32(2, state_of(&rig.can).tx_dropped);
    TEST_ASSERT_FALSE(us.ops->offer(us.context, &frame));
    sends(&rig.can, 9, 9);
    TEST_ASSERT_TRUE(us.ops->offer(us.context, &frame));
    ctl_abort(&rig.driver);
    us.ops->failed(us.context, NODE_ERROR_ACKNOWLEDGE); /* and this one did not make it */
    TEST_ASSERT_EQUAL_UINT32(3, state_of(&rig.can).tx_dropped);
    TEST_ASSERT_FALSE(us.ops->offer(us.context, &frame));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, sends(&rig.can, 9, 9));
}

/* ---- Receiving --------------------------------------------------------------------------------
 */

static void test_every_kind_of_frame_is_received_with_its_time(void) {
    support_random_start();
    ctl_open(&rig, NULL, 0);
    for (uint32_t i = 0; i < support_runs(5000); i++) {
        const berth_can_frame_t frame = random_frame();
        rig_time.now_us += 1 + support_index(1000);
        hears(&frame);
        ctl_interrupts(&rig);
        const int64_t arrived_us = rig_time.now_us;
        rig_time.now_us += 5000;
        berth_can_frame_t got;
        memset(&got, 0x5a, sizeof got);
        TEST_ASSERT_TRUE(ctl_has_input(&rig.driver));
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, receive(&rig.can, &got));
        expect_frame(&frame, &got);
        TEST_ASSERT_EQUAL_INT64(arrived_us, got.time_us);
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, receive(&rig.can, &got));
        TEST_ASSERT_FALSE(ctl_has_input(&rig.driver));
    }
    TEST_ASSERT_EQUAL_UINT32(0, state_of(&rig.can).rx_lost);
}

static void test_length_codes_above_eight_mean_eight(void) {
    ctl_open(&rig, NULL, 0);
    for (uint8_t code = 9; code <= 15; code++) {
        const berth_can_frame_t frame = {.id = 1, .length = code, .data = {1, 2, 3, 4, 5, 6, 7, 8}};
        hears(&frame);
        ctl_interrupts(&rig);
        berth_can_frame_t got;
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, receive(&rig.can, &got));
        TEST_ASSERT_EQUAL_UINT8(8, got.length);
        TEST_ASSERT_EQUAL_HEX8_ARRAY(frame.data, got.data, 8);
    }
}

static void test_order_is_kept_through_the_fifo(void) {
    ctl_open(&rig, NULL, 0);
    for (uint8_t i = 0; i < 3; i++) {
        const berth_can_frame_t frame = frame_with(i, i);
        hears(&frame);
    }
    ctl_interrupts(&rig);
    for (uint8_t i = 0; i < 3; i++) {
        berth_can_frame_t got;
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, receive(&rig.can, &got));
        TEST_ASSERT_EQUAL_HEX8(i, got.data[0]);
    }
}

static void test_an_overrun_is_counted_and_keeps_the_older_frames(void) {
    ctl_open(&rig, NULL, 0);
    for (uint8_t i = 0; i < 5; i++) {
        const berth_can_frame_t frame = frame_with(i, i);
        hears(&frame);
    }
    ctl_interrupts(&rig);
    TEST_ASSERT_EQUAL_UINT32(1, state_of(&rig.can).rx_lost);
    for (uint8_t i = 0; i < 3; i++) {
        berth_can_frame_t got;
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, receive(&rig.can, &got));
        TEST_ASSERT_EQUAL_HEX8(i, got.data[0]);
    }
    const berth_can_frame_t frame = frame_with(9, 9);
    hears(&frame);
    ctl_interrupts(&rig);
    berth_can_frame_t got;
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, receive(&rig.can, &got));
    TEST_ASSERT_EQUAL_UINT32(1, state_of(&rig.can).rx_lost);
}

static void test_a_full_queue_loses_and_counts(void) {
    ctl_open(&rig, NULL, 0);
    for (uint32_t round = 1; round <= 3; round++) {
        for (uint32_t i = 0; i < STM32_CAN_RX_MAX + 10u; i++) {
            const berth_can_frame_t frame = frame_with(i, (uint8_t)i);
            hears(&frame);
            ctl_interrupts(&rig);
        }
        TEST_ASSERT_EQUAL_UINT32(10u * round, state_of(&rig.can).rx_lost);
        berth_can_frame_t got;
        for (uint32_t i = 0; i < STM32_CAN_RX_MAX; i++) {
            TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, receive(&rig.can, &got));
            TEST_ASSERT_EQUAL_HEX8(i, got.data[0]);
        }
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, receive(&rig.can, &got));
    }
}

/* The counts of frames wrap after four thousand million of them. */
static void test_the_queue_survives_the_wrap_of_its_counts(void) {
    ctl_open(&rig, NULL, 0);
    rig.driver.received.head = UINT32_MAX - 2u;
    rig.driver.received.tail = UINT32_MAX - 2u;
    test_order_is_kept_through_the_fifo();
    for (uint32_t i = 0; i < STM32_CAN_RX_MAX + 1u; i++) {
        const berth_can_frame_t frame = frame_with(i, (uint8_t)i);
        hears(&frame);
        ctl_interrupts(&rig);
    }
    TEST_ASSERT_EQUAL_UINT32(1, state_of(&rig.can).rx_lost);
}

static void test_counters_stay_at_their_largest(void) {
    ctl_open(&rig, NULL, 0);
    rig.driver.rx_lost = UINT32_MAX;
    rig.driver.errors = UINT32_MAX;
    rig.driver.tx_dropped = UINT32_MAX;
    rig.driver.restarts = UINT32_MAX;
    for (uint8_t i = 0; i < 5; i++) {
        const berth_can_frame_t frame = frame_with(i, i);
        hears(&frame);
    }
    us.ops->hear_error(us.context, NODE_ERROR_CRC);
    sends(&rig.can, 1, 1);
    go_off();
    state_of(&rig.can);
    rig_time.now_us += 2000000;
    for (int i = 0; i < 5; i++) {
        state_of(&rig.can);
        us.ops->idle(us.context, CTL_RECOVERY);
    }
    const berth_can_state_t state = state_of(&rig.can);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, state.mode);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, state.rx_lost);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, state.error_frames);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, state.tx_dropped);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, state.restarts);
}

/* ---- Filters ----------------------------------------------------------------------------------
 */

static bool gets_through(const berth_can_frame_t *frame) {
    berth_can_frame_t got;
    hears(frame);
    ctl_interrupts(&rig);
    const bool through = receive(&rig.can, &got) == BERTH_CAN_DONE;
    if (through) {
        expect_frame(frame, &got);
    }
    return through;
}

/* As many as fit, or few. */
static uint32_t random_filters(berth_can_filter_t filters[CTL_FILTERS_MAX]) {
    const uint32_t wish = support_index(chance(0.5) ? 4u : CTL_FILTERS_MAX + 1u);
    uint32_t left[2] = {CTL_STANDARD_MAX, CTL_EXTENDED_MAX};
    uint32_t count = 0;
    for (uint32_t i = 0; i < wish; i++) {
        const berth_can_filter_t filter = random_filter();
        if (left[filter.extended ? 1 : 0] > 0) {
            left[filter.extended ? 1 : 0]--;
            filters[count++] = filter;
        }
    }
    return count;
}

static void test_filters_pass_exactly_what_was_asked_for(void) {
    support_random_start();
    uint32_t passed = 0;
    for (uint32_t run = 0; run < support_runs(300); run++) {
        berth_can_filter_t filters[CTL_FILTERS_MAX];
        const uint32_t count = random_filters(filters);
        ctl_open(&rig, filters, count);
        for (uint32_t i = 0; i < 200; i++) {
            const berth_can_frame_t frame = count > 0 && chance(0.7)
                                                ? frame_near(&filters[support_index(count)])
                                                : random_frame();
            const bool through = gets_through(&frame);
            TEST_ASSERT_EQUAL_INT(wanted(filters, count, &frame), through);
            passed += through ? 1u : 0u;
        }
    }
    TEST_ASSERT_TRUE(passed > 100);
}

static void test_every_standard_id_against_a_filter(void) {
    const berth_can_filter_t filter = {.id = 0x2a9, .mask = 0x5f8};
    ctl_open(&rig, &filter, 1);
    for (uint32_t id = 0; id <= BERTH_CAN_STANDARD_MAX; id++) {
        const berth_can_frame_t frame = frame_with(id, 0);
        TEST_ASSERT_EQUAL_INT(wanted(&filter, 1, &frame), gets_through(&frame));
    }
}

/* ---- Errors and bus-off -----------------------------------------------------------------------
 */

static void test_bus_errors_are_counted(void) {
    ctl_open(&rig, NULL, 0);
    for (node_error_t error = NODE_ERROR_STUFF; error <= NODE_ERROR_CRC; error++) {
        us.ops->hear_error(us.context, error);
        ctl_interrupts(&rig);
        const berth_can_frame_t frame = frame_with(1, 1);
        hears(&frame); /* no error */
        ctl_interrupts(&rig);
    }
    TEST_ASSERT_EQUAL_UINT32(6, state_of(&rig.can).error_frames);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, mode());
    us.ops->hear_error(us.context, NODE_ERROR_CRC);
    ctl_interrupts(&rig);
    go_off(); /* another interrupt: the last error is not counted once more */
    TEST_ASSERT_EQUAL_UINT32(7, state_of(&rig.can).error_frames);
}

static void test_error_passive_comes_and_goes(void) {
    ctl_open(&rig, NULL, 0);
    ctl_diagnosis_t diagnosis;
    ctl_set_tec(&rig, 95);
    ctl_diagnosis(&rig.driver, &diagnosis);
    TEST_ASSERT_FALSE(diagnosis.warning);
    ctl_set_tec(&rig, 96);
    ctl_diagnosis(&rig.driver, &diagnosis);
    TEST_ASSERT_TRUE(diagnosis.warning && !diagnosis.passive);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, mode());
    ctl_set_tec(&rig, 128);
    ctl_interrupts(&rig);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_PASSIVE, mode());
    ctl_diagnosis(&rig.driver, &diagnosis);
    TEST_ASSERT_TRUE(diagnosis.passive && !diagnosis.off);
    TEST_ASSERT_EQUAL_UINT32(128, diagnosis.transmit_errors);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, sends(&rig.can, 1, 1));
    one_sent();
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, mode());
    for (uint32_t i = 1; i <= 128; i++) {
        us.ops->hear_error(us.context, NODE_ERROR_STUFF);
        ctl_interrupts(&rig);
        ctl_diagnosis(&rig.driver, &diagnosis);
        TEST_ASSERT_EQUAL_UINT32(i, diagnosis.receive_errors);
    }
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_PASSIVE, mode());
    ctl_diagnosis(&rig.driver, &diagnosis);
    TEST_ASSERT_EQUAL_UINT32(128, diagnosis.receive_errors);
    const berth_can_frame_t frame = frame_with(1, 1);
    hears(&frame);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, mode());
}

/* Alone on a bus: passive for ever, never off; the frame waits. */
static void test_without_an_acknowledge_the_node_stays_passive(void) {
    ctl_open(&rig, NULL, 0);
    node_bus_add(&bus, us);
    sends(&rig.can, 1, 1);
    for (int i = 0; i < 100; i++) {
        TEST_ASSERT_FALSE(node_bus_step(&bus));
        ctl_interrupts(&rig);
    }
    const berth_can_state_t state = state_of(&rig.can);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_PASSIVE, state.mode);
    TEST_ASSERT_EQUAL_UINT32(100, state.error_frames);
    TEST_ASSERT_EQUAL_UINT32(0, state.tx_dropped);
}

static void test_bus_off_drops_what_waits(void) {
    ctl_open(&rig, NULL, 0);
    const berth_can_frame_t heard = frame_with(3, 3);
    hears(&heard);
    ctl_interrupts(&rig);
    sends(&rig.can, 1, 1);
    sends(&rig.can, 2, 2);
    go_off();
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, sends(&rig.can, 4, 4));
    const berth_can_state_t state = state_of(&rig.can);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_BUS_OFF, state.mode);
    TEST_ASSERT_EQUAL_UINT32(2, state.tx_dropped);
    TEST_ASSERT_EQUAL_UINT32(0, state.restarts);
    TEST_ASSERT_EQUAL_UINT32_MESSAGE(0, state.error_frames, "bus-off by itself is no bus error");
    berth_can_frame_t got;
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, receive(&rig.can, &got)); /* what came before */
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, receive(&rig.can, &got));
    ctl_diagnosis_t diagnosis;
    ctl_diagnosis(&rig.driver, &diagnosis);
    TEST_ASSERT_TRUE(diagnosis.off);
}

/* Each of send, receive and state notices bus-off by itself, also when its interrupt is late. */
static void test_bus_off_is_noticed_by_any_call(void) {
    for (int interrupt = 0; interrupt < 2; interrupt++) {
        for (int call = 0; call < 3; call++) {
            berth_can_frame_t frame;
            io_model_reset();
            ctl_init(&rig);
            ctl_open(&rig, NULL, 0);
            sends(&rig.can, 1, 1);
            ctl_set_tec(&rig, 256);
            if (interrupt == 1) {
                ctl_interrupts(&rig);
            }
            switch (call) {
            case 0:
                TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, sends(&rig.can, 2, 2));
                break;
            case 1:
                TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, receive(&rig.can, &frame));
                break;
            default:
                TEST_ASSERT_EQUAL_INT(BERTH_CAN_BUS_OFF, mode());
                break;
            }
            TEST_ASSERT_EQUAL_UINT32(1, rig.driver.tx_dropped);
            TEST_ASSERT_FALSE(us.ops->offer(us.context, &frame));
            ctl_interrupts(&rig);
            TEST_ASSERT_EQUAL_INT(BERTH_CAN_BUS_OFF, mode());
            RIG_VIOLATIONS(&rig);
        }
    }
}

/* A caller that only sends, or only receives, gets the bus back too. */
static void test_any_call_brings_the_bus_back(void) {
    for (int call = 0; call < 2; call++) {
        berth_can_frame_t frame;
        io_model_reset();
        ctl_init(&rig);
        ctl_open(&rig, NULL, 0);
        go_off();
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, sends(&rig.can, 1, 1));
        rig_time.now_us += 1000000;
        for (int i = 0; i < 5; i++) {
            if (call == 0) {
                sends(&rig.can, 1, 1);
            } else {
                receive(&rig.can, &frame);
            }
            us.ops->idle(us.context, CTL_RECOVERY);
        }
        TEST_ASSERT_EQUAL_INT(call == 0, us.ops->offer(us.context, &frame));
        TEST_ASSERT_EQUAL_UINT32(1, rig.driver.restarts);
    }
}

static void recovers(void) {
    for (int i = 0; i < 3; i++) {
        mode(); /* the steps that take no time on the bus */
    }
    for (int i = 0; i < 4; i++) {
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_BUS_OFF, mode());
        us.ops->idle(us.context, 31);
    }
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_BUS_OFF, mode());
    us.ops->idle(us.context, CTL_RECOVERY - 124u);
    const berth_can_state_t state = state_of(&rig.can);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, state.mode);
    TEST_ASSERT_EQUAL_UINT32(1, state.restarts);
    berth_can_frame_t frame;
    TEST_ASSERT_FALSE_MESSAGE(us.ops->offer(us.context, &frame), "an old frame is sent");
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, sends(&rig.can, 7, 7));
    TEST_ASSERT_EQUAL_HEX32(7, one_sent().id);
}

static void stays_off(void) {
    for (int i = 0; i < 20; i++) {
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_BUS_OFF, mode());
        us.ops->idle(us.context, 100);
    }
}

static void test_recovery_after_a_time(void) {
    rig.config.restart_us = 500000;
    ctl_delay(&rig, 1);
    ctl_open(&rig, NULL, 0);
    sends(&rig.can, 1, 1);
    go_off();
    stays_off();
    rig_time.now_us += 499999;
    stays_off();
    rig_time.now_us += 1;
    for (int i = 0; i < 6; i++) {
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_BUS_OFF, mode());
    }
    recovers();
}

static void test_recovery_at_once(void) {
    rig.config.recovery = STM32_CAN_RECOVER_AT_ONCE;
    ctl_open(&rig, NULL, 0);
    sends(&rig.can, 1, 1);
    go_off();
    recovers();
}

static void test_recovery_when_ordered(void) {
    rig.config.recovery = STM32_CAN_RECOVER_ORDERED;
    ctl_open(&rig, NULL, 0);
    ctl_restart(&rig.driver); /* too early: without effect */
    sends(&rig.can, 1, 1);
    go_off();
    rig_time.now_us += 1000000000;
    stays_off();
    ctl_restart(&rig.driver);
    recovers();
    go_off(); /* the order is used up */
    stays_off();
}

static void test_an_order_shortens_the_wait(void) {
    ctl_open(&rig, NULL, 0);
    go_off();
    stays_off();
    ctl_restart(&rig.driver);
    recovers();
}

static void test_the_second_bus_off_waits_anew(void) {
    rig.config.restart_us = 1000;
    ctl_open(&rig, NULL, 0);
    for (uint32_t i = 1; i <= 5; i++) {
        go_off();
        stays_off();
        rig_time.now_us += 1000;
        for (int k = 0; k < 4; k++) {
            mode();
            us.ops->idle(us.context, CTL_RECOVERY);
        }
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, mode());
        TEST_ASSERT_EQUAL_UINT32(i, state_of(&rig.can).restarts);
    }
}

/* Back, and off again, before anybody looked. */
static void test_a_second_bus_off_during_the_recovery(void) {
    for (int recovery = STM32_CAN_RECOVER_AFTER; recovery <= STM32_CAN_RECOVER_AT_ONCE;
         recovery++) {
        io_model_reset();
        ctl_init(&rig);
        rig.config.recovery = (stm32_can_recovery_t)recovery;
        rig.config.restart_us = 1000;
        ctl_open(&rig, NULL, 0);
        go_off();
        mode();
        rig_time.now_us += 1000;
        mode();
        mode();
        us.ops->idle(us.context, CTL_RECOVERY);
        ctl_interrupts(&rig);
        TEST_ASSERT_TRUE(us.ops->is_on(us.context));
        go_off();
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_BUS_OFF, mode());
        for (int i = 0; i < 5; i++) {
            rig_time.now_us += 1000;
            mode();
            us.ops->idle(us.context, CTL_RECOVERY);
            ctl_interrupts(&rig);
        }
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, mode());
    }
}

static void test_a_controller_that_was_reset_is_down(void) {
    ctl_open(&rig, NULL, 0);
    sends(&rig.can, 1, 1);
    sends(&rig.can, 2, 1);
    ctl_reset(&rig);
    const berth_can_state_t state = state_of(&rig.can);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DOWN, state.mode);
    TEST_ASSERT_EQUAL_UINT32(2, state.tx_dropped);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, sends(&rig.can, 1, 1));
    ctl_open(&rig, NULL, 0);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, mode());
}

/* ---- Interrupts at every place ----------------------------------------------------------------
 */

static uint32_t strike_at;

static void strike_bus_off(void *context, uint32_t number) {
    (void)context;
    if (number == strike_at) {
        ctl_set_tec(&rig, 256);
        ctl_interrupts(&rig);
    }
}

/* Bus-off between any two register accesses of a send: the frame is never sent late, and each frame
 * taken is counted. */
static void bus_off_during_a_send(stm32_can_recovery_t recovery, uint32_t before) {
    io_model_reset();
    ctl_init(&rig);
    rig.config.recovery = recovery;
    rig.config.restart_us = 0;
    ctl_open(&rig, NULL, 0);
    for (uint32_t i = 0; i < before; i++) {
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, sends(&rig.can, 2 + i, 0));
    }
    io_model_hook(strike_bus_off, NULL);
    const berth_can_outcome_t outcome = sends(&rig.can, 1, 1);
    io_model_hook(NULL, NULL);
    if (!rig.model.boff) {
        go_off();
    }
    us.ops->idle(us.context, CTL_RECOVERY); /* at once: back before anybody looks */
    berth_can_frame_t frame;
    if (!rig.model.boff) {
        TEST_ASSERT_FALSE(us.ops->offer(us.context, &frame));
    }
    for (int i = 0; i < 6; i++) {
        state_of(&rig.can);
        us.ops->idle(us.context, CTL_RECOVERY);
    }
    const berth_can_state_t state = state_of(&rig.can);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, state.mode);
    TEST_ASSERT_EQUAL_UINT32(1, state.restarts);
    TEST_ASSERT_FALSE(us.ops->offer(us.context, &frame));
    TEST_ASSERT_EQUAL_UINT32(before + (outcome == BERTH_CAN_DONE ? 1u : 0u), state.tx_dropped);
    RIG_VIOLATIONS(&rig);
}

static void test_bus_off_at_every_access_of_a_send(void) {
    for (uint32_t before = 0; before < 3; before++) {
        for (strike_at = 0; strike_at < 20; strike_at++) {
            bus_off_during_a_send(STM32_CAN_RECOVER_AFTER, before);
            bus_off_during_a_send(STM32_CAN_RECOVER_AT_ONCE, before);
        }
    }
}

/* Anything between any two accesses of anything, for long. */
typedef struct {
    uint32_t heard;
    uint32_t sent;
} chaos_t;

static void chaos(void *context, uint32_t number) {
    chaos_t *counts = context;
    berth_can_frame_t frame;
    (void)number;
    if (!chance(0.1) || !us.ops->is_on(us.context)) {
        return;
    }
    switch (support_index(5)) {
    case 0:
        frame = frame_with(0x100, (uint8_t)(counts->heard & 0xffu));
        counts->heard++;
        hears(&frame);
        break;
    case 1:
    case 2:
        if (us.ops->offer(us.context, &frame)) {
            us.ops->sent(us.context);
            counts->sent++;
        }
        break;
    case 3:
        if (us.ops->offer(us.context, &frame)) {
            us.ops->failed(us.context, NODE_ERROR_FORM);
        }
        break;
    default:
        if (chance(0.05)) {
            ctl_set_tec(&rig, 256);
        }
        break;
    }
    ctl_interrupts(&rig);
}

static void test_frames_are_conserved_whatever_happens_when(void) {
    support_random_start();
    chaos_t counts = {0};
    uint32_t taken = 0;
    uint32_t got = 0;
    rig.config.restart_us = 100;
    ctl_open(&rig, NULL, 0);
    io_model_hook(chaos, &counts);
    for (uint32_t i = 0; i < support_runs(200000); i++) {
        berth_can_frame_t frame;
        rig_time.now_us += 10;
        taken += sends(&rig.can, 0x10u + support_index(4), 0) == BERTH_CAN_DONE ? 1u : 0u;
        got += receive(&rig.can, &frame) == BERTH_CAN_DONE ? 1u : 0u;
        us.ops->idle(us.context, 5);
    }
    io_model_hook(NULL, NULL);
    for (int i = 0; i < 200; i++) {
        rig_time.now_us += 1000;
        us.ops->idle(us.context, CTL_RECOVERY);
        state_of(&rig.can);
    }
    berth_can_frame_t frame;
    TEST_ASSERT_TRUE(us.ops->is_on(us.context));
    while (us.ops->offer(us.context, &frame)) {
        us.ops->sent(us.context);
        counts.sent++;
    }
    while (receive(&rig.can, &frame) == BERTH_CAN_DONE) {
        got++;
    }
    RIG_VIOLATIONS(&rig);
    const berth_can_state_t state = state_of(&rig.can);
    printf("taken %u, sent %u, dropped %u; heard %u, got %u, lost %u; restarts %u\n", taken,
           counts.sent, state.tx_dropped, counts.heard, got, state.rx_lost, state.restarts);
    TEST_ASSERT_EQUAL_UINT32(taken, counts.sent + state.tx_dropped);
    TEST_ASSERT_EQUAL_UINT32(counts.heard, got + state.rx_lost);
    TEST_ASSERT_TRUE(counts.sent > 100 && got > 100 && state.tx_dropped > 3 && state.restarts > 3);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_opens_from_reset);
    RUN_TEST(test_a_silent_controller_is_given_up);
    RUN_TEST(test_dead_hardware_is_refused);
    RUN_TEST(test_waiting_ends_by_the_clock_too);
    RUN_TEST(test_joins_a_stuck_bus_later);
    RUN_TEST(test_every_result_has_a_text);
    RUN_TEST(test_opening_again_forgets_the_past);
    RUN_TEST(test_every_kind_of_frame_goes_out_as_it_is);
    RUN_TEST(test_bad_frames_are_refused);
    RUN_TEST(test_three_mailboxes_then_again);
    RUN_TEST(test_the_most_urgent_goes_first);
    RUN_TEST(test_frames_of_one_id_keep_their_order);
    RUN_TEST(test_a_remote_frame_is_not_overtaken);
    RUN_TEST(test_lost_and_failed_transmissions_are_repeated);
    RUN_TEST(test_abort_takes_back_what_waits);
    RUN_TEST(test_every_kind_of_frame_is_received_with_its_time);
    RUN_TEST(test_length_codes_above_eight_mean_eight);
    RUN_TEST(test_order_is_kept_through_the_fifo);
    RUN_TEST(test_an_overrun_is_counted_and_keeps_the_older_frames);
    RUN_TEST(test_a_full_queue_loses_and_counts);
    RUN_TEST(test_the_queue_survives_the_wrap_of_its_counts);
    RUN_TEST(test_counters_stay_at_their_largest);
    RUN_TEST(test_filters_pass_exactly_what_was_asked_for);
    RUN_TEST(test_every_standard_id_against_a_filter);
    RUN_TEST(test_bus_errors_are_counted);
    RUN_TEST(test_error_passive_comes_and_goes);
    RUN_TEST(test_without_an_acknowledge_the_node_stays_passive);
    RUN_TEST(test_bus_off_drops_what_waits);
    RUN_TEST(test_bus_off_is_noticed_by_any_call);
    RUN_TEST(test_any_call_brings_the_bus_back);
    RUN_TEST(test_recovery_after_a_time);
    RUN_TEST(test_recovery_at_once);
    RUN_TEST(test_recovery_when_ordered);
    RUN_TEST(test_an_order_shortens_the_wait);
    RUN_TEST(test_the_second_bus_off_waits_anew);
    RUN_TEST(test_a_second_bus_off_during_the_recovery);
    RUN_TEST(test_a_controller_that_was_reset_is_down);
    RUN_TEST(test_bus_off_at_every_access_of_a_send);
    RUN_TEST(test_frames_are_conserved_whatever_happens_when);
    return UNITY_END();
}
