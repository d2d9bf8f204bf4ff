/* The loop's body: what each outcome of the bus obliges it to, and that a flood cannot starve the
 * control step. */
#include "board_rig.h"

#include "berth/link.h"

#include "unity.h"

/* A bus that answers as told, and notes what it was asked. */
typedef struct {
    berth_can_outcome_t send, receive;
    berth_can_mode_t mode;
    uint32_t waiting; /* frames to receive */
    uint32_t room;    /* frames that may still be sent */
    uint32_t sent, received, asked;
    uint32_t stops; /* of the left wheel */
} script_t;

static script_t script;
static rig_t rig;
static berth_link_t link_under_test;

static berth_can_outcome_t script_send(void *context, const berth_can_frame_t *frame) {
    script_t *self = context;
    self->asked++;
    if (self->send != BERTH_CAN_DONE) {
        return self->send;
    }
    if (self->room == 0) {
        return BERTH_CAN_AGAIN;
    }
    self->room--;
    self->sent++;
    self->stops += frame->id == 0x121u && !frame->extended;
    return BERTH_CAN_DONE;
}

static berth_can_outcome_t script_receive(void *context, berth_can_frame_t *frame) {
    script_t *self = context;
    if (self->receive == BERTH_CAN_FAILED) {
        return BERTH_CAN_FAILED;
    }
    if (self->waiting == 0) {
        return BERTH_CAN_AGAIN;
    }
    self->waiting--;
    self->received++;
    *frame = drive_frame(0x7f0, false, 8);
    return BERTH_CAN_DONE;
}

static void script_state(void *context, berth_can_state_t *state) {
    *state = (berth_can_state_t){.mode = ((script_t *)context)->mode};
}

static const berth_can_api_t script_api = {script_send, script_receive, script_state};

void setUp(void) {
    const berth_can_t can = {&script_api, &script};
    berth_refusal_t refusal;
    script = (script_t){.room = 1000};
    rig_prepare(&rig);
    TEST_ASSERT_EQUAL_INT(BERTH_OK, rig_init(&rig, &refusal));
    rig_set_pose(&rig, 1.0f, 0.0f, 1.57f);
    berth_link_init(&link_under_test, &rig.board, &can);
}

void tearDown(void) {}

static void run(int64_t now_us) {
    berth_link_run(&link_under_test, now_us);
}

static const berth_board_status_t *status(void) {
    return berth_board_status(&rig.board);
}

static void test_a_run_receives_steps_and_sends(void) {
    script.waiting = 3;
    run(0);
    TEST_ASSERT_EQUAL_UINT32(3, status()->foreign);
    TEST_ASSERT_EQUAL_UINT32(1, status()->steps);
    TEST_ASSERT_EQUAL_UINT32(2, script.sent); /* status and pose */
    TEST_ASSERT_EQUAL_INT64(RIG_PERIOD_US, berth_link_deadline(&link_under_test));
}

static void test_a_flood_is_taken_in_pieces(void) {
    script.waiting = 1000000;
    run(0);
    TEST_ASSERT_EQUAL_UINT32(BERTH_LINK_RECEIVE_MAX, script.received);
    TEST_ASSERT_EQUAL_UINT32(1, status()->steps);
    TEST_ASSERT_EQUAL_INT64(0, berth_link_deadline(&link_under_test)); /* at once: there is more */
    run(RIG_PERIOD_US);
    TEST_ASSERT_EQUAL_UINT32(2, status()->steps);
    script.waiting = 0;
    run(RIG_PERIOD_US + 1);
    TEST_ASSERT_EQUAL_INT64(2 * RIG_PERIOD_US, berth_link_deadline(&link_under_test));
}

static void test_no_room_keeps_the_frames_for_later(void) {
    script.room = 1;
    run(0);
    TEST_ASSERT_EQUAL_UINT32(1, script.sent);
    TEST_ASSERT_EQUAL_UINT32(1, link_under_test.send_again);
    TEST_ASSERT_EQUAL_INT64(BERTH_LINK_RETRY_US, berth_link_deadline(&link_under_test));
    script.room = 10;
    run(BERTH_LINK_RETRY_US);
    TEST_ASSERT_EQUAL_UINT32(2, script.sent);
    TEST_ASSERT_EQUAL_UINT32(0, link_under_test.failures);
    TEST_ASSERT_EQUAL_INT64(RIG_PERIOD_US, berth_link_deadline(&link_under_test));
}

/* The most that can wait leaves in one run. */
static void test_a_full_outbox_is_sent_whole(void) {
    const berth_can_frame_t frame = drive_frame(0x7f1, false, 0);
    run(0);
    script.sent = 0;
    for (uint32_t i = 0; i < BERTH_OUTBOX_MAX; i++) {
        TEST_ASSERT_TRUE(berth_outbox_put(&rig.board.outbox, &frame, BERTH_OUTBOX_EACH));
    }
    run(1);
    TEST_ASSERT_EQUAL_UINT32(BERTH_OUTBOX_MAX, script.sent);
    TEST_ASSERT_NULL(berth_board_front(&rig.board));
    TEST_ASSERT_EQUAL_INT64(RIG_PERIOD_US, berth_link_deadline(&link_under_test));
}

/* A bus that fails is tried again later than one that is busy, but the control step does not wait.
 */
static void test_frames_that_wait_are_tried_again(void) {
    script.send = BERTH_CAN_FAILED;
    run(0);
    TEST_ASSERT_TRUE(link_under_test.failed);
    TEST_ASSERT_EQUAL_INT64(BERTH_LINK_FAILED_US, berth_link_deadline(&link_under_test));
    script.send = BERTH_CAN_AGAIN;
    run(BERTH_LINK_FAILED_US);
    TEST_ASSERT_EQUAL_INT64(BERTH_LINK_FAILED_US + BERTH_LINK_RETRY_US,
                            berth_link_deadline(&link_under_test));
    run(RIG_PERIOD_US - BERTH_LINK_RETRY_US / 2);
    TEST_ASSERT_EQUAL_INT64(RIG_PERIOD_US, berth_link_deadline(&link_under_test));
}

static void arm(int64_t now_us) {
    berth_board_command(&rig.board, BERTH_COMMAND_ARM, now_us);
    TEST_ASSERT_EQUAL_INT(BERTH_SUPERVISOR_ARMING, status()->state);
}

static void test_a_failed_send_stops_the_board_in_the_same_run(void) {
    run(0);
    arm(1);
    script.send = BERTH_CAN_FAILED;
    run(RIG_PERIOD_US);
    TEST_ASSERT_EQUAL_UINT8(BERTH_FAULT_BUS_DOWN, status()->fault);
    TEST_ASSERT_EQUAL_UINT32(1, link_under_test.failures);
    TEST_ASSERT_NOT_NULL(berth_board_front(&rig.board)); /* the stop waits for the bus */
    TEST_ASSERT_EQUAL_UINT32(0, script.stops);
    script.send = BERTH_CAN_DONE;
    run(RIG_PERIOD_US + 1000);
    TEST_ASSERT_EQUAL_UINT32(1, script.stops);
    TEST_ASSERT_NULL(berth_board_front(&rig.board));
    const int64_t later_us = 3000000; /* silent drives count as off once their torque is taken */
    run(later_us);
    berth_board_command(&rig.board, BERTH_COMMAND_RESET, later_us);
    TEST_ASSERT_EQUAL_INT(BERTH_SUPERVISOR_IDLE, status()->state);
}

static void test_a_failed_receive_stops_the_board_before_its_step(void) {
    run(0);
    arm(1);
    script.receive = BERTH_CAN_FAILED;
    run(10);
    TEST_ASSERT_EQUAL_UINT8(BERTH_FAULT_BUS_DOWN, status()->fault);
    TEST_ASSERT_EQUAL_UINT32(1, script.stops); /* and has gone out */
}

static void test_the_bus_mode_is_told(void) {
    script.mode = BERTH_CAN_ERROR_PASSIVE;
    run(0);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_PASSIVE, status()->bus);
    arm(1);
    script.mode = BERTH_CAN_BUS_OFF;
    run(2);
    TEST_ASSERT_EQUAL_UINT8(BERTH_FAULT_BUS_OFF, status()->fault);
}

/* Outcomes that the contract does not know count as failures, not as success. */
static void test_an_unknown_outcome_is_a_failure(void) {
    run(0);
    arm(1);
    script.send = (berth_can_outcome_t)7;
    run(RIG_PERIOD_US);
    TEST_ASSERT_EQUAL_UINT8(BERTH_FAULT_BUS_DOWN, status()->fault);
}

/* The largest of times: when to run next does not overflow, and the board stops. */
static void test_a_time_that_cannot_be(void) {
    run(0);
    arm(1);
    script.room = 0;
    run(INT64_MAX);
    TEST_ASSERT_EQUAL_UINT8(BERTH_FAULT_PERIOD, status()->fault);
    TEST_ASSERT_TRUE(berth_board_front(&rig.board) != NULL);
    TEST_ASSERT_TRUE(berth_link_deadline(&link_under_test) > 0);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_a_run_receives_steps_and_sends);
    RUN_TEST(test_a_flood_is_taken_in_pieces);
    RUN_TEST(test_no_room_keeps_the_frames_for_later);
    RUN_TEST(test_a_full_outbox_is_sent_whole);
    RUN_TEST(test_frames_that_wait_are_tried_again);
    RUN_TEST(test_a_failed_send_stops_the_board_in_the_same_run);
    RUN_TEST(test_a_failed_receive_stops_the_board_before_its_step);
    RUN_TEST(test_the_bus_mode_is_told);
    RUN_TEST(test_an_unknown_outcome_is_a_failure);
    RUN_TEST(test_a_time_that_cannot_be);
    return UNITY_END();
}
