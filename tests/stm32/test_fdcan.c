/* What is FDCAN's own; test_controller_contract.c has what all controllers share. */
#include "fdcan_rig.h"
#include "rig.h"

static fdcan_rig_t rig;
static node_t us;

void setUp(void) {
    io_model_reset();
    rig_time = (rig_clock_t){.now_us = 1000};
    fdcan_rig_init(&rig, 0);
    us = fdcan_model_node(&rig.model);
}

void tearDown(void) {
    RIG_VIOLATIONS(&rig);
}

static berth_can_mode_t mode(void) {
    return state_of(&rig.can).mode;
}

static void test_one_megabit(void) {
    fdcan_rig_open(&rig, NULL, 0);
    const uint32_t nbtp = rig.model.nbtp;
    const uint32_t prescaler = (nbtp >> 16 & 0x1ffu) + 1u;
    const uint32_t segment1 = (nbtp >> 8 & 0xffu) + 1u;
    const uint32_t segment2 = (nbtp & 0x7fu) + 1u;
    const uint32_t quanta = 1u + segment1 + segment2;
    TEST_ASSERT_EQUAL_UINT32(170, prescaler * quanta);
    TEST_ASSERT_TRUE((1u + segment1) * 1000u >= 750u * quanta);
    TEST_ASSERT_TRUE((1u + segment1) * 1000u <= 875u * quanta);
    TEST_ASSERT_EQUAL_UINT32(segment2, (nbtp >> 25) + 1u);
}

static void refuses(stm32_can_result_t result, const berth_can_filter_t *filters, uint32_t count) {
    TEST_ASSERT_EQUAL_INT(result, fdcan_open(&rig.driver, &rig.config, filters, count));
    rig.can = fdcan_can(&rig.driver);
    TEST_ASSERT_EQUAL_UINT32_MESSAGE(0, io_model_accesses(), "nothing was touched");
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DOWN, mode());
    rig.config =
        fdcan_config_default(&fdcan_rig_blocks[0], &fdcan_rig_rams[0], rig_clock(), 170000000);
}

static void test_bad_configurations_are_refused(void) {
    berth_can_filter_t filters[29] = {{0}};
    rig.config.regs = NULL;
    refuses(STM32_CAN_ERROR_ARGUMENT, NULL, 0);
    rig.config.ram = NULL;
    refuses(STM32_CAN_ERROR_ARGUMENT, NULL, 0);
    rig.config.clock.api = NULL;
    refuses(STM32_CAN_ERROR_ARGUMENT, NULL, 0);
    rig.config.restart_us = -1;
    refuses(STM32_CAN_ERROR_ARGUMENT, NULL, 0);
    refuses(STM32_CAN_ERROR_ARGUMENT, NULL, 1);
    rig.config.clock_hz = 8500000;
    refuses(STM32_CAN_ERROR_TIMING, NULL, 0);
    refuses(STM32_CAN_ERROR_FILTERS, filters, 29);
    for (int i = 0; i < 9; i++) {
        filters[i].extended = true;
    }
    refuses(STM32_CAN_ERROR_FILTERS, filters, 9);
    refuses(STM32_CAN_ERROR_FILTERS, filters, 28);
    filters[8] = (berth_can_filter_t){.id = 0x800, .mask = 0x7ff};
    refuses(STM32_CAN_ERROR_FILTERS, filters, 9);
    filters[8] = (berth_can_filter_t){.id = 0x20000000, .extended = true};
    refuses(STM32_CAN_ERROR_FILTERS, filters, 9);
}

/* One format is asked for: the other one is not let in by default. */
static void test_filters_of_one_format_keep_the_other_out(void) {
    for (int extended = 0; extended < 2; extended++) {
        const berth_can_filter_t all = {.extended = extended == 1};
        rig.model.xidam = 0; /* left by an earlier program */
        rig.model.ils = 0x7f;
        fdcan_rig_open(&rig, &all, 1);
        for (int other = 0; other < 2; other++) {
            const berth_can_frame_t frame = {.id = 0x55, .extended = other == 1};
            berth_can_frame_t got;
            us.ops->hear(us.context, &frame);
            fdcan_rig_interrupts(&rig);
            TEST_ASSERT_EQUAL_INT(extended == other ? BERTH_CAN_DONE : BERTH_CAN_AGAIN,
                                  receive(&rig.can, &got));
        }
    }
}

/* A controller that lets go of its buffers only when its configuration is opened. */
static void test_frames_that_survive_bus_off_are_dropped_before_the_restart(void) {
    for (uint32_t recovery = STM32_CAN_RECOVER_AFTER; recovery <= STM32_CAN_RECOVER_ORDERED;
         recovery++) {
        io_model_reset();
        fdcan_rig_init(&rig, 0);
        rig.model.lazy_cancel = true;
        rig.config.recovery = (stm32_can_recovery_t)recovery;
        fdcan_rig_open(&rig, NULL, 0);
        sends(&rig.can, 1, 1);
        sends(&rig.can, 2, 2);
        fdcan_model_set_tec(&rig.model, 256);
        fdcan_rig_interrupts(&rig);
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_BUS_OFF, mode());
        rig_time.now_us += 2000000;
        fdcan_restart(&rig.driver);
        for (int i = 0; i < 4; i++) {
            mode();
            us.ops->idle(us.context, 129);
            fdcan_rig_interrupts(&rig);
        }
        const berth_can_state_t state = state_of(&rig.can);
        berth_can_frame_t frame;
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, state.mode);
        TEST_ASSERT_EQUAL_UINT32(2, state.tx_dropped);
        TEST_ASSERT_EQUAL_UINT32(1, state.restarts);
        TEST_ASSERT_FALSE(us.ops->offer(us.context, &frame));
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, sends(&rig.can, 1, 1));
        RIG_VIOLATIONS(&rig);
    }
}

/* Frames that came in before bus-off are not lost by the restart. */
static void test_received_frames_survive_the_restart(void) {
    rig.config.recovery = STM32_CAN_RECOVER_AT_ONCE;
    fdcan_rig_open(&rig, NULL, 0);
    for (uint8_t i = 0; i < 3; i++) {
        const berth_can_frame_t frame = frame_with(i, i);
        us.ops->hear(us.context, &frame);
    }
    fdcan_model_set_tec(&rig.model, 256);
    fdcan_rig_interrupts(&rig);
    mode();
    mode();
    for (uint8_t i = 0; i < 3; i++) {
        berth_can_frame_t got;
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, receive(&rig.can, &got));
        TEST_ASSERT_EQUAL_HEX8(i, got.data[0]);
    }
}

static void test_restricted_operation_is_down(void) {
    fdcan_rig_open(&rig, NULL, 0);
    sends(&rig.can, 1, 1);
    rig.model.restricted = true;
    const berth_can_state_t state = state_of(&rig.can);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DOWN, state.mode);
    TEST_ASSERT_EQUAL_UINT32(1, state.tx_dropped);
    fdcan_rig_open(&rig, NULL, 0);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, mode());
}

/* The controller offers its lowest free buffer; a frame whose id waits in a higher one waits. */
static void test_a_lower_buffer_does_not_overtake(void) {
    fdcan_rig_open(&rig, NULL, 0);
    berth_can_frame_t frame;
    sends(&rig.can, 0x10, 0);
    sends(&rig.can, 0x20, 1);
    sends(&rig.can, 0x20, 2);
    TEST_ASSERT_TRUE(us.ops->offer(us.context, &frame));
    us.ops->sent(us.context);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, sends(&rig.can, 0x20, 3));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, sends(&rig.can, 0x30, 4));
    for (uint8_t i = 1; i <= 2; i++) {
        TEST_ASSERT_TRUE(us.ops->offer(us.context, &frame));
        TEST_ASSERT_EQUAL_HEX8(i, frame.data[0]);
        us.ops->sent(us.context);
    }
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, sends(&rig.can, 0x20, 3));
}

/* The wait for an idle bus ends by the clock where there is one. */
static void test_a_stuck_bus_is_waited_for_so_long(void) {
    rig.model.bus_dominant = true;
    rig_time.step_us = 100;
    TEST_ASSERT_EQUAL_INT(STM32_CAN_ERROR_NOT_JOINED,
                          fdcan_open(&rig.driver, &rig.config, NULL, 0));
    TEST_ASSERT_TRUE(io_model_accesses() < 1000u);
}

static void recover_before_the_second_access(void *context, uint32_t number) {
    fdcan_model_t *model = context;
    if (number == 1) { /* the protocol status; the control register has been read */
        model->boff = false;
        model->init = false;
        model->synchronized = true;
        model->tec = 0;
    }
}

/* Control and protocol status are two registers: what changes between them is seen at the next
 * look. */
static void test_back_on_the_bus_between_two_reads(void) {
    rig.config.recovery = STM32_CAN_RECOVER_ORDERED;
    fdcan_rig_open(&rig, NULL, 0);
    fdcan_model_set_tec(&rig.model, 256);
    fdcan_rig_interrupts(&rig);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_BUS_OFF, mode());
    rig.model.init_delay = 1000;
    fdcan_restart(&rig.driver);
    TEST_ASSERT_TRUE(rig.model.init);
    io_model_hook(recover_before_the_second_access, &rig.model);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_BUS_OFF, mode());
    io_model_hook(NULL, NULL);
    const berth_can_state_t state = state_of(&rig.can);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, state.mode);
    TEST_ASSERT_EQUAL_UINT32(1, state.restarts);
}

static void hear_before_each_access(void *context, uint32_t number) {
    const berth_can_frame_t frame = frame_with(number & 0x7ffu, 0);
    (void)context;
    if (rig.model.fill < 3) {
        us.ops->hear(us.context, &frame);
    }
}

/* Frames that come faster than they are fetched do not hold the interrupt for ever. */
static void test_the_interrupt_ends_under_a_flood(void) {
    berth_can_frame_t frame;
    fdcan_rig_open(&rig, NULL, 0);
    io_model_hook(hear_before_each_access, NULL);
    fdcan_interrupt(&rig.driver);
    io_model_hook(NULL, NULL);
    TEST_ASSERT_GREATER_THAN_UINT32(0, rig.model.fill);
    for (uint32_t i = 0; i < 16; i++) {
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, receive(&rig.can, &frame));
    }
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, receive(&rig.can, &frame));
}

/* A broken controller: no memory beyond the message RAM's three places is touched for it. */
static void test_places_that_do_not_exist_are_not_used(void) {
    berth_can_frame_t frame = frame_with(5, 5);
    fdcan_rig_open(&rig, NULL, 0);
    rig.model.garbled = true;
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, sends(&rig.can, 1, 1));
    TEST_ASSERT_EQUAL_UINT32(0, rig.model.pending);
    us.ops->hear(us.context, &frame);
    fdcan_interrupt(&rig.driver);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, receive(&rig.can, &frame));
    TEST_ASSERT_GREATER_THAN_UINT32(0, state_of(&rig.can).rx_lost);
    TEST_ASSERT_GREATER_THAN_UINT32(0, rig.model.violations); /* it was told so */
    rig.model.violations = 0;
    rig.model.garbled = false;
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, sends(&rig.can, 1, 1));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_one_megabit);
    RUN_TEST(test_bad_configurations_are_refused);
    RUN_TEST(test_filters_of_one_format_keep_the_other_out);
    RUN_TEST(test_frames_that_survive_bus_off_are_dropped_before_the_restart);
    RUN_TEST(test_received_frames_survive_the_restart);
    RUN_TEST(test_restricted_operation_is_down);
    RUN_TEST(test_a_lower_buffer_does_not_overtake);
    RUN_TEST(test_a_stuck_bus_is_waited_for_so_long);
    RUN_TEST(test_back_on_the_bus_between_two_reads);
    RUN_TEST(test_the_interrupt_ends_under_a_flood);
    RUN_TEST(test_places_that_do_not_exist_are_not_used);
    return UNITY_END();
}
