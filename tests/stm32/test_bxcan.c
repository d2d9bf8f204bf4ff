/* What is bxCAN's own; test_controller_contract.c has what all controllers share. */
#include "bxcan_rig.h"
#include "rig.h"

static bxcan_rig_t rig;
static node_t us;

void setUp(void) {
    io_model_reset();
    rig_time = (rig_clock_t){.now_us = 1000};
    bxcan_rig_init(&rig, 0);
    us = bxcan_model_node(&rig.model);
}

void tearDown(void) {
    RIG_VIOLATIONS(&rig);
}

static void hears(const berth_can_frame_t *frame) {
    us.ops->hear(us.context, frame);
}

static berth_can_mode_t mode(void) {
    return state_of(&rig.can).mode;
}

static void test_the_mode_word(void) {
    bxcan_rig_open(&rig, NULL, 0);
    TEST_ASSERT_EQUAL_INT(BX_NORMAL, rig.model.mode);
    /* No TTCM, NART, TXFP, SLEEP, INRQ; ABOM only when recovery is to be at once. */
    TEST_ASSERT_EQUAL_HEX32(0, rig.model.mcr & 0xd7u);
    rig.config.recovery = STM32_CAN_RECOVER_AT_ONCE;
    bxcan_rig_open(&rig, NULL, 0);
    TEST_ASSERT_EQUAL_HEX32(0x40, rig.model.mcr & 0xd7u);
}

static void refuses(stm32_can_result_t result, const berth_can_filter_t *filters, uint32_t count) {
    TEST_ASSERT_EQUAL_INT(result, bxcan_open(&rig.driver, &rig.config, filters, count));
    rig.can = bxcan_can(&rig.driver);
    TEST_ASSERT_EQUAL_UINT32_MESSAGE(0, io_model_accesses(), "nothing was touched");
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DOWN, mode());
    rig.config = bxcan_config_default(rig.block, rig_clock(), 42000000);
}

static void test_one_megabit(void) {
    bxcan_rig_open(&rig, NULL, 0);
    const uint32_t btr = rig.model.btr;
    const uint32_t prescaler = (btr & 0x3ffu) + 1u;
    const uint32_t segment1 = (btr >> 16 & 0xfu) + 1u;
    const uint32_t segment2 = (btr >> 20 & 0x7u) + 1u;
    TEST_ASSERT_EQUAL_UINT32(42, prescaler * (1u + segment1 + segment2));
    TEST_ASSERT_TRUE((1u + segment1) * 1000u >= 750u * (1u + segment1 + segment2));
    TEST_ASSERT_TRUE((1u + segment1) * 1000u <= 875u * (1u + segment1 + segment2));
    TEST_ASSERT_EQUAL_UINT32(segment2 < 4u ? segment2 : 4u, (btr >> 24 & 3u) + 1u);
    TEST_ASSERT_EQUAL_HEX32(0, btr & 0xc0000000u); /* neither silent nor looped back */
}

static void test_bad_configurations_are_refused(void) {
    berth_can_filter_t filters[29] = {{0}};
    rig.config.regs = NULL;
    refuses(STM32_CAN_ERROR_ARGUMENT, NULL, 0);
    rig.config.filters = NULL;
    refuses(STM32_CAN_ERROR_ARGUMENT, NULL, 0);
    rig.config.clock.api = NULL;
    refuses(STM32_CAN_ERROR_ARGUMENT, NULL, 0);
    rig.config.split = 29;
    refuses(STM32_CAN_ERROR_ARGUMENT, NULL, 0);
    rig.config.first_bank = 28;
    refuses(STM32_CAN_ERROR_ARGUMENT, NULL, 0);
    rig.config.restart_us = -1;
    refuses(STM32_CAN_ERROR_ARGUMENT, NULL, 0);
    refuses(STM32_CAN_ERROR_ARGUMENT, NULL, 1);
    rig.config.clock_hz = 8500000;
    refuses(STM32_CAN_ERROR_TIMING, NULL, 0);
    rig.config.bit_rate = 0;
    refuses(STM32_CAN_ERROR_TIMING, NULL, 0);
    refuses(STM32_CAN_ERROR_FILTERS, filters, 29);
    rig.config.split = 14;
    refuses(STM32_CAN_ERROR_FILTERS, filters, 15);
    rig.config.split = 14;
    rig.config.first_bank = 5;
    refuses(STM32_CAN_ERROR_FILTERS, filters, 10);
    rig.config.split = 14;
    rig.config.first_bank = 20;
    refuses(STM32_CAN_ERROR_FILTERS, filters, 9);
    filters[13] = (berth_can_filter_t){.id = 0x800, .mask = 0x7ff};
    refuses(STM32_CAN_ERROR_FILTERS, filters, 14);
    filters[13] = (berth_can_filter_t){.id = 0x20000000, .extended = true};
    refuses(STM32_CAN_ERROR_FILTERS, filters, 14);
}

/* A release that takes forever: no frame is read twice, and the interrupt ends. */
static void test_a_slow_release_gives_no_frame_twice(void) {
    bxcan_rig_open(&rig, NULL, 0);
    rig.model.release_delay = 1000;
    for (uint8_t i = 0; i < 2; i++) {
        const berth_can_frame_t frame = frame_with(i, i);
        hears(&frame);
    }
    bxcan_receive_interrupt(&rig.driver);
    berth_can_frame_t got;
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, receive(&rig.can, &got));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, receive(&rig.can, &got));
    for (int i = 0; i < 2000; i++) {
        bxcan_receive_interrupt(&rig.driver);
    }
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, receive(&rig.can, &got));
    TEST_ASSERT_EQUAL_HEX8(1, got.data[0]);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, receive(&rig.can, &got));
}

/* Two controllers, one set of banks: each gets what it asked for, whichever opens first. */
static void test_two_controllers_share_the_banks(void) {
    static bxcan_rig_t second;
    support_random_start();
    for (uint32_t run = 0; run < support_runs(50); run++) {
        berth_can_filter_t filters[2][14];
        bxcan_rig_t *const rigs[2] = {&rig, &second};
        io_model_reset();
        bxcan_rig_init(&rig, 0);
        bxcan_rig_init(&second, 1);
        second.model.filters = &rig.model;
        second.config.filters = rig.block;
        rig.config.split = 14;
        second.config.split = 14;
        second.config.first_bank = 14;
        const uint32_t first = support_index(2);
        for (uint32_t i = 0; i < 28; i++) {
            filters[i % 2][i / 2] = random_filter();
        }
        const uint32_t counts[2] = {1u + support_index(14), 1u + support_index(14)};
        bxcan_rig_open(rigs[first], filters[first], counts[first]);
        bxcan_rig_open(rigs[1 - first], filters[1 - first], counts[1 - first]);
        for (uint32_t i = 0; i < 100; i++) {
            const berth_can_frame_t frame = frame_near(&filters[i % 2][support_index(14)]);
            for (int k = 0; k < 2; k++) {
                berth_can_frame_t got;
                const node_t node = bxcan_model_node(&rigs[k]->model);
                node.ops->hear(node.context, &frame);
                bxcan_rig_interrupts(rigs[k]);
                TEST_ASSERT_EQUAL_INT(wanted(filters[k], counts[k], &frame),
                                      receive(&rigs[k]->can, &got) == BERTH_CAN_DONE);
            }
        }
        RIG_VIOLATIONS(&second);
    }
}

/* Remote frames: any mailbox holds them back, whichever frame came first. */
static void test_a_data_frame_waits_for_a_remote_frame_and_the_other_way_round(void) {
    bxcan_rig_open(&rig, NULL, 0);
    const berth_can_frame_t request = {.id = 0x20, .remote = true, .length = 4};
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, sends(&rig.can, 0x20, 1));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, send(&rig.can, &request));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, sends(&rig.can, 0x20, 2));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, sends(&rig.can, 0x20, 3));
}

/* Recovered by hardware before anybody looked: it is told all the same. */
static void test_recovery_by_hardware_unseen(void) {
    rig.config.recovery = STM32_CAN_RECOVER_AT_ONCE;
    bxcan_rig_open(&rig, NULL, 0);
    sends(&rig.can, 1, 1);
    bxcan_model_set_tec(&rig.model, 256);
    bxcan_rig_interrupts(&rig);
    us.ops->idle(us.context, 128);
    berth_can_frame_t frame;
    TEST_ASSERT_FALSE(us.ops->offer(us.context, &frame));
    berth_can_state_t state = state_of(&rig.can);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_BUS_OFF, state.mode);
    TEST_ASSERT_EQUAL_UINT32(1, state.tx_dropped);
    state = state_of(&rig.can);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, state.mode);
    TEST_ASSERT_EQUAL_UINT32(1, state.restarts);
}

/* The wire's end of an aborted frame comes after bus-off: it is dropped then, and once. */
static void test_a_frame_on_the_wire_at_bus_off_is_given_up_later(void) {
    berth_can_frame_t frame;
    bxcan_rig_open(&rig, NULL, 0);
    sends(&rig.can, 1, 1);
    TEST_ASSERT_TRUE(us.ops->offer(us.context, &frame));
    bxcan_model_set_tec(&rig.model, 256);
    bxcan_rig_interrupts(&rig);
    TEST_ASSERT_EQUAL_UINT32(0, state_of(&rig.can).tx_dropped);
    TEST_ASSERT_EQUAL_UINT32(0, state_of(&rig.can).tx_dropped);
    us.ops->failed(us.context, NODE_ERROR_ACKNOWLEDGE);
    const berth_can_state_t state = state_of(&rig.can);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_BUS_OFF, state.mode);
    TEST_ASSERT_EQUAL_UINT32(1, state.tx_dropped);
    TEST_ASSERT_FALSE(us.ops->offer(us.context, &frame));
}

static void recover_before_the_third_access(void *context, uint32_t number) {
    bxcan_model_t *model = context;
    if (number == 2) { /* the error state; the mode has been read */
        model->boff = false;
        model->recovering = false;
        model->mode = BX_NORMAL;
        model->tec = 0;
    }
}

/* Mode and error state are two registers: what changes between them is seen at the next look. */
static void test_back_on_the_bus_between_two_reads(void) {
    rig.config.recovery = STM32_CAN_RECOVER_ORDERED;
    bxcan_rig_open(&rig, NULL, 0);
    bxcan_model_set_tec(&rig.model, 256);
    bxcan_rig_interrupts(&rig);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_BUS_OFF, mode());
    bxcan_restart(&rig.driver);
    rig.model.mode_delay = 3;
    mode();
    TEST_ASSERT_EQUAL_INT(BX_INIT, rig.model.mode);
    io_model_hook(recover_before_the_third_access, &rig.model);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_BUS_OFF, mode());
    io_model_hook(NULL, NULL);
    const berth_can_state_t state = state_of(&rig.can);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, state.mode);
    TEST_ASSERT_EQUAL_UINT32(1, state.restarts);
}

/* A mailbox that is not ours is left alone until it is empty, whoever has filled it. */
static void test_a_mailbox_that_is_full_already_is_passed_over(void) {
    bxcan_rig_open(&rig, NULL, 0);
    rig.model.boxes[0].state = BX_PENDING;
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, sends(&rig.can, 0x20, 2));
    TEST_ASSERT_EQUAL_INT(BX_PENDING, rig.model.boxes[1].state);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, sends(&rig.can, 0x20, 3));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, sends(&rig.can, 0x20, 4));
}

static void hear_before_each_access(void *context, uint32_t number) {
    const berth_can_frame_t frame = frame_with(number & 0x7ffu, 0);
    (void)context;
    if (rig.model.fmp < BXCAN_MODEL_FIFO) {
        hears(&frame);
    }
}

/* Frames that come faster than they are fetched do not hold the interrupt for ever. */
static void test_the_interrupt_ends_under_a_flood(void) {
    berth_can_frame_t frame;
    bxcan_rig_open(&rig, NULL, 0);
    io_model_hook(hear_before_each_access, NULL);
    bxcan_receive_interrupt(&rig.driver);
    io_model_hook(NULL, NULL);
    TEST_ASSERT_TRUE(bxcan_model_fifo_line(&rig.model)); /* and comes again */
    for (uint32_t i = 0; i < 8; i++) {
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, receive(&rig.can, &frame));
    }
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, receive(&rig.can, &frame));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_the_mode_word);
    RUN_TEST(test_one_megabit);
    RUN_TEST(test_bad_configurations_are_refused);
    RUN_TEST(test_a_slow_release_gives_no_frame_twice);
    RUN_TEST(test_two_controllers_share_the_banks);
    RUN_TEST(test_a_data_frame_waits_for_a_remote_frame_and_the_other_way_round);
    RUN_TEST(test_recovery_by_hardware_unseen);
    RUN_TEST(test_a_frame_on_the_wire_at_bus_off_is_given_up_later);
    RUN_TEST(test_back_on_the_bus_between_two_reads);
    RUN_TEST(test_a_mailbox_that_is_full_already_is_passed_over);
    RUN_TEST(test_the_interrupt_ends_under_a_flood);
    return UNITY_END();
}
