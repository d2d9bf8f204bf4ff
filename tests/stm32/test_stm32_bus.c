/* Both controllers on one bus, with traffic and errors: every frame is accounted for. */
#include "bxcan_rig.h"
#include "fdcan_rig.h"
#include "rig.h"

#define EACH 2u
#define NODES (2u * EACH)

static bxcan_rig_t first[EACH];
static fdcan_rig_t second[EACH];
static node_bus_t bus;
static uint32_t through[NODES];

static const berth_can_t *can_of(uint32_t node) {
    return node < EACH ? &first[node].can : &second[node - EACH].can;
}

static void interrupts(void) {
    for (uint32_t i = 0; i < EACH; i++) {
        bxcan_rig_interrupts(&first[i]);
        fdcan_rig_interrupts(&second[i]);
    }
}

static void observe(void *context, uint32_t sender, const berth_can_frame_t *frame) {
    (void)context;
    (void)frame;
    through[sender]++;
}

void setUp(void) {
    io_model_reset();
    rig_time = (rig_clock_t){.now_us = 1000};
    memset(&bus, 0, sizeof bus);
    memset(through, 0, sizeof through);
    bus.observe = observe;
    for (uint32_t i = 0; i < EACH; i++) {
        bxcan_rig_init(&first[i], i);
        first[i].config.restart_us = 3000;
        bxcan_rig_open(&first[i], NULL, 0);
        node_bus_add(&bus, bxcan_model_node(&first[i].model));
    }
    for (uint32_t i = 0; i < EACH; i++) {
        fdcan_rig_init(&second[i], i);
        second[i].config.recovery = STM32_CAN_RECOVER_AT_ONCE;
        fdcan_rig_open(&second[i], NULL, 0);
        node_bus_add(&bus, fdcan_model_node(&second[i].model));
    }
}

void tearDown(void) {
    for (uint32_t i = 0; i < EACH; i++) {
        RIG_VIOLATIONS(&first[i]);
        RIG_VIOLATIONS(&second[i]);
    }
}

/* Ids carry their sender, so that no two nodes send the same one. */
static berth_can_frame_t frame_from(uint32_t node, uint8_t mark) {
    berth_can_frame_t frame = random_frame();
    frame.remote = false;
    frame.length = 2;
    frame.id = (frame.id & ~0x3u) % 16u | node;
    frame.data[0] = (uint8_t)node;
    frame.data[1] = mark;
    memset(&frame.data[2], 0, 6);
    return frame;
}

static uint32_t fetch(uint32_t node) {
    uint32_t count = 0;
    berth_can_frame_t frame;
    while (receive(can_of(node), &frame) == BERTH_CAN_DONE) {
        TEST_ASSERT_EQUAL_UINT32(frame.id % 4u, frame.data[0]);
        TEST_ASSERT_TRUE(frame.data[0] != node);
        count++;
    }
    return count;
}

static void run(uint32_t steps, double errors, uint32_t taken[NODES], uint32_t got[NODES]) {
    for (uint32_t step = 0; step < steps; step++) {
        const uint32_t node = support_index(NODES);
        const berth_can_frame_t frame = frame_from(node, (uint8_t)(step & 0xffu));
        taken[node] += send(can_of(node), &frame) == BERTH_CAN_DONE ? 1u : 0u;
        if (chance(errors)) {
            bus.destroy += 1u + support_index(chance(0.02) ? 40u : 2u);
        }
        rig_time.now_us += 100;
        node_bus_step(&bus);
        interrupts();
        got[node] += fetch(node);
    }
}

/* No more errors and nothing new: all that waits gets through. */
static void drain(uint32_t got[NODES]) {
    bus.destroy = 0;
    for (uint32_t i = 0; i < 400; i++) {
        rig_time.now_us += 1000;
        node_bus_step(&bus);
        interrupts();
        for (uint32_t node = 0; node < NODES; node++) {
            state_of(can_of(node));
            got[node] += fetch(node);
        }
    }
}

static void test_a_clean_bus_loses_nothing(void) {
    support_random_start();
    uint32_t taken[NODES] = {0};
    uint32_t got[NODES] = {0};
    uint32_t all = 0;
    run(support_runs(50000), 0, taken, got);
    drain(got);
    for (uint32_t node = 0; node < NODES; node++) {
        TEST_ASSERT_EQUAL_UINT32(taken[node], through[node]);
        all += through[node];
    }
    for (uint32_t node = 0; node < NODES; node++) {
        const berth_can_state_t state = state_of(can_of(node));
        TEST_ASSERT_EQUAL_UINT32(all, through[node] + got[node] + state.rx_lost);
        TEST_ASSERT_EQUAL_UINT32(0, state.rx_lost + state.tx_dropped + state.error_frames);
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, state.mode);
    }
    TEST_ASSERT_TRUE(all > 1000);
}

static void test_a_noisy_bus_accounts_for_every_frame(void) {
    support_random_start();
    uint32_t taken[NODES] = {0};
    uint32_t got[NODES] = {0};
    uint32_t restarts = 0;
    uint32_t dropped = 0;
    uint32_t errors = 0;
    run(support_runs(200000), 0.2, taken, got);
    drain(got);
    for (uint32_t node = 0; node < NODES; node++) {
        const berth_can_state_t state = state_of(can_of(node));
        TEST_ASSERT_TRUE(state.mode <= BERTH_CAN_ERROR_PASSIVE);
        TEST_ASSERT_EQUAL_UINT32(taken[node], through[node] + state.tx_dropped);
        restarts += state.restarts;
        dropped += state.tx_dropped;
        errors += state.error_frames;
    }
    printf("through %u, dropped %u, errors %u, restarts %u\n",
           through[0] + through[1] + through[2] + through[3], dropped, errors, restarts);
    TEST_ASSERT_TRUE(restarts > 5 && dropped > 5 && errors > 1000);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_a_clean_bus_loses_nothing);
    RUN_TEST(test_a_noisy_bus_accounts_for_every_frame);
    return UNITY_END();
}
