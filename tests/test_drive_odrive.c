/* The ODrive protocol against frames written out by hand from its documents. */
#include "support.h"

#include "berth/drive_odrive.h"

#include "unity.h"

#include <math.h>
#include <string.h>

#define RAD_PER_TURN 6.2831853f
#define NODE 3u
#define ENABLE_TIMEOUT_US 1000000
#define PREPARE_US 10000
#define RETRY_US 250000

static berth_drive_t drive;
static berth_outbox_t outbox;

static berth_drive_config_t good_config(void) {
    return (berth_drive_config_t){
        .protocol = &berth_drive_odrive,
        .node = NODE,
        .sign = 1,
        .gear_ratio = 1.0f,
        .period_us = 10000,
        .feedback_timeout_us = 100000,
        .heartbeat_timeout_us = 350000,
        .enable_timeout_us = ENABLE_TIMEOUT_US,
    };
}

static void init_with(const berth_drive_config_t *config) {
    berth_refusal_t refusal;
    memset(&drive, 0xa5, sizeof drive);
    TEST_ASSERT_EQUAL(BERTH_OK, berth_drive_init(&drive, config, &refusal));
    berth_outbox_reset(&outbox);
}

void setUp(void) {
    const berth_drive_config_t config = good_config();
    init_with(&config);
}

void tearDown(void) {}

/* --- frames ------------------------------------------------------------------------------------
 */

static void expect(uint32_t id, uint8_t length, const uint8_t *data) {
    const berth_can_frame_t *front = berth_outbox_front(&outbox);
    TEST_ASSERT_NOT_NULL(front);
    TEST_ASSERT_EQUAL_HEX32(id, front->id);
    TEST_ASSERT_FALSE(front->extended);
    TEST_ASSERT_FALSE(front->remote);
    TEST_ASSERT_EQUAL(length, front->length);
    if (length > 0) {
        TEST_ASSERT_EQUAL_HEX8_ARRAY(data, front->data, length);
    }
    berth_outbox_pop(&outbox);
}

static void expect_nothing(void) {
    TEST_ASSERT_NULL(berth_outbox_front(&outbox));
}

static const uint8_t mode_velocity[] = {2, 0, 0, 0, 1, 0, 0, 0};
static const uint8_t closed_loop[] = {8, 0, 0, 0};
static const uint8_t idle[] = {1, 0, 0, 0};
static const uint8_t stand[] = {0, 0, 0, 0, 0, 0, 0, 0};

static void expect_prepare_frames(void) {
    expect(0x078, 0, NULL);
    expect(0x06B, 8, mode_velocity);
    expect(0x06D, 8, stand);
    expect_nothing();
}

static void expect_ask_frames(void) {
    expect(0x06B, 8, mode_velocity);
    expect(0x06D, 8, stand);
    expect(0x067, 4, closed_loop);
    expect_nothing();
}

static berth_can_frame_t heartbeat_frame(uint32_t error, uint8_t state) {
    berth_can_frame_t frame = {.id = 0x061, .length = 8};
    for (uint32_t i = 0; i < 4; i++) {
        frame.data[i] = (uint8_t)(error >> 8 * i);
    }
    frame.data[4] = state;
    return frame;
}

static bool say_heartbeat(uint32_t error, uint8_t state, int64_t at_us) {
    const berth_can_frame_t frame = heartbeat_frame(error, state);
    return berth_drive_receive(&drive, &frame, at_us);
}

static berth_can_frame_t estimates_frame(float turns, float rps) {
    berth_can_frame_t frame = {.id = 0x069, .length = 8};
    memcpy(frame.data, &turns, 4); /* the test's host is little endian, like the bus */
    memcpy(frame.data + 4, &rps, 4);
    return frame;
}

static bool say_estimates(float turns, float rps, int64_t at_us) {
    const berth_can_frame_t frame = estimates_frame(turns, rps);
    return berth_drive_receive(&drive, &frame, at_us);
}

static void step_at(int64_t now_us) {
    berth_drive_step(&drive, now_us, &outbox);
}

static void expect_state(berth_drive_state_t state, berth_drive_fault_t fault, uint32_t code) {
    TEST_ASSERT_EQUAL(state, berth_drive_status(&drive)->state);
    TEST_ASSERT_EQUAL(fault, berth_drive_status(&drive)->fault);
    TEST_ASSERT_EQUAL_HEX32(code, berth_drive_status(&drive)->code);
}

/* Begins to enable 10 ms before, and asks for closed loop. Only differences of times count. */
static void ask_at(int64_t now_us) {
    berth_drive_enable(&drive, now_us - PREPARE_US);
    step_at(now_us - PREPARE_US);
    step_at(now_us);
    berth_outbox_clear(&outbox);
}

static void make_enabled(int64_t now_us) {
    ask_at(now_us);
    (void)say_estimates(0.0f, 0.0f, now_us + 500);
    (void)say_heartbeat(0, 8, now_us + 1000);
    expect_state(BERTH_DRIVE_ENABLED, BERTH_DRIVE_FAULT_NONE, 0);
}

/* --- enabling ----------------------------------------------------------------------------------
 */

static void test_the_whole_enable_sequence(void) {
    expect_nothing();
    berth_drive_enable(&drive, 1000);
    TEST_ASSERT_EQUAL(1000, berth_drive_deadline(&drive));
    step_at(1000);
    expect_prepare_frames();
    TEST_ASSERT_EQUAL(11000, berth_drive_deadline(&drive));
    step_at(10999);
    expect_nothing();
    step_at(11000);
    expect_ask_frames();
    TEST_ASSERT_EQUAL(11000 + RETRY_US, berth_drive_deadline(&drive));
    TEST_ASSERT_TRUE(say_estimates(1.5f, 0.0f, 12000));
    TEST_ASSERT_TRUE(say_heartbeat(0, 1, 13000)); /* still idle */
    step_at(13000);
    expect_state(BERTH_DRIVE_STARTING, BERTH_DRIVE_FAULT_NONE, 0);
    TEST_ASSERT_TRUE(say_heartbeat(0, 8, 20000));
    expect_state(BERTH_DRIVE_ENABLED, BERTH_DRIVE_FAULT_NONE, 0);
    step_at(20000);
    expect_nothing();
    TEST_ASSERT_EQUAL(3, berth_drive_status(&drive)->received);
}

static void test_frames_are_repeated_until_the_drive_follows(void) {
    berth_drive_enable(&drive, 0);
    for (int64_t now_us = 0; now_us < ENABLE_TIMEOUT_US; now_us += PREPARE_US + RETRY_US) {
        step_at(now_us);
        expect_prepare_frames();
        step_at(now_us + PREPARE_US);
        expect_ask_frames();
        step_at(now_us + PREPARE_US + RETRY_US - 1);
        expect_nothing();
    }
}

static void test_an_old_heartbeat_does_not_enable(void) {
    berth_drive_enable(&drive, 10000);
    (void)say_estimates(0.0f, 0.0f, 10000);
    (void)say_heartbeat(0, 8, 11000); /* nothing has been asked yet */
    step_at(12000);
    (void)say_heartbeat(0, 8, 13000);
    step_at(22000);
    (void)say_heartbeat(0, 8, 21999); /* sent before that */
    expect_state(BERTH_DRIVE_STARTING, BERTH_DRIVE_FAULT_NONE, 0);
    (void)say_heartbeat(0, 8, 22000);
    expect_state(BERTH_DRIVE_ENABLED, BERTH_DRIVE_FAULT_NONE, 0);
}

static void test_without_feedback_it_waits_and_says_so(void) {
    berth_drive_enable(&drive, 0);
    step_at(0);
    step_at(10000);
    (void)say_heartbeat(0, 8, 11000);
    expect_state(BERTH_DRIVE_STARTING, BERTH_DRIVE_FAULT_NONE, 0);
    TEST_ASSERT_EQUAL(ENABLE_TIMEOUT_US + 1, berth_drive_deadline(&drive));
    berth_outbox_clear(&outbox);
    step_at(10000 + RETRY_US); /* it is in closed loop: nothing is asked again */
    expect_nothing();
    step_at(ENABLE_TIMEOUT_US + 1);
    expect_state(BERTH_DRIVE_FAULT, BERTH_DRIVE_FAULT_ENABLE, BERTH_ODRIVE_NO_FEEDBACK);

    setUp();
    ask_at(10000);
    (void)say_heartbeat(0, 8, 11000);
    (void)say_estimates(0.0f, 0.0f, 12000); /* the last that was missing */
    expect_state(BERTH_DRIVE_ENABLED, BERTH_DRIVE_FAULT_NONE, 0);
}

static void test_how_far_enabling_came(void) {
    ask_at(10000);
    (void)say_estimates(0.0f, 0.0f, 12000);
    step_at(ENABLE_TIMEOUT_US + 1);
    expect_state(BERTH_DRIVE_FAULT, BERTH_DRIVE_FAULT_ENABLE, BERTH_ODRIVE_NO_HEARTBEAT);

    setUp();
    ask_at(10000);
    (void)say_heartbeat(0, 1, 11000);
    step_at(ENABLE_TIMEOUT_US);
    expect_state(BERTH_DRIVE_STARTING, BERTH_DRIVE_FAULT_NONE, 0);
    step_at(ENABLE_TIMEOUT_US + 1);
    expect_state(BERTH_DRIVE_FAULT, BERTH_DRIVE_FAULT_ENABLE, BERTH_ODRIVE_NOT_IN_CLOSED_LOOP);
}

/* A step that comes too late finds that out before it asks for torque. */
static void test_no_torque_is_asked_for_when_the_time_is_over(void) {
    berth_drive_enable(&drive, 0);
    step_at(0);
    expect_prepare_frames();
    step_at(ENABLE_TIMEOUT_US + 1);
    expect_nothing();
    expect_state(BERTH_DRIVE_FAULT, BERTH_DRIVE_FAULT_ENABLE, BERTH_ODRIVE_NO_HEARTBEAT);
}

static void test_an_error_that_stays_is_named(void) {
    ask_at(10000);
    (void)say_heartbeat(0x01000000, 1, 11000); /* may be from before the errors were cleared */
    step_at(ENABLE_TIMEOUT_US);
    expect_state(BERTH_DRIVE_STARTING, BERTH_DRIVE_FAULT_NONE, 0);
    step_at(ENABLE_TIMEOUT_US + 1);
    expect_state(BERTH_DRIVE_FAULT, BERTH_DRIVE_FAULT_DEVICE, 0x01000000);
}

static void test_state_8_with_an_error_is_not_enabled(void) {
    ask_at(10000);
    (void)say_estimates(0.0f, 0.0f, 10500);
    (void)say_heartbeat(0x40, 8, 11000);
    expect_state(BERTH_DRIVE_STARTING, BERTH_DRIVE_FAULT_NONE, 0);
}

/* In closed loop, but it falls out before there was any feedback. */
static void test_falling_out_while_starting_asks_again(void) {
    ask_at(10000);
    (void)say_heartbeat(0, 8, 11000);
    (void)say_heartbeat(0x20, 1, 12000);
    (void)say_estimates(0.0f, 0.0f, 12500);
    expect_state(BERTH_DRIVE_STARTING, BERTH_DRIVE_FAULT_NONE, 0);
    TEST_ASSERT_EQUAL(12000 + RETRY_US, berth_drive_deadline(&drive));
    step_at(12000 + RETRY_US);
    expect_prepare_frames();
}

/* Leaves room for so many frames. */
static void fill_outbox_but(uint32_t room) {
    const berth_can_frame_t other = {.id = 0x7ff};
    berth_outbox_clear(&outbox);
    for (uint32_t i = room; i < BERTH_OUTBOX_MAX; i++) {
        TEST_ASSERT_TRUE(berth_outbox_put(&outbox, &other, BERTH_OUTBOX_EACH));
    }
}

static void fill_outbox(void) {
    fill_outbox_but(0);
}

static void test_a_full_outbox_delays_enabling(void) {
    berth_drive_enable(&drive, 0);
    fill_outbox();
    step_at(0);
    berth_outbox_clear(&outbox);
    step_at(10000);
    expect_prepare_frames();
    fill_outbox();
    step_at(20000);
    berth_outbox_clear(&outbox);
    (void)say_estimates(0.0f, 0.0f, 21000);
    (void)say_heartbeat(0, 8, 21000); /* it is, but not because we asked */
    expect_state(BERTH_DRIVE_STARTING, BERTH_DRIVE_FAULT_NONE, 0);
    step_at(30000);
    expect_ask_frames();
    (void)say_heartbeat(0, 8, 31000);
    expect_state(BERTH_DRIVE_ENABLED, BERTH_DRIVE_FAULT_NONE, 0);
}

/* Where only a part fits, all of it is said again: closed loop is asked for after mode and speed.
 */
static void test_an_outbox_with_too_little_room_delays_enabling(void) {
    for (uint32_t room = 0; room < 3; room++) {
        setUp();
        berth_drive_enable(&drive, 0);
        fill_outbox_but(room);
        step_at(0);
        berth_outbox_clear(&outbox);
        TEST_ASSERT_EQUAL_INT64(PREPARE_US, berth_drive_deadline(&drive));
        step_at(10000);
        expect_prepare_frames();
        fill_outbox_but(room);
        step_at(20000);
        berth_outbox_clear(&outbox);
        TEST_ASSERT_EQUAL_INT64(20000 + PREPARE_US, berth_drive_deadline(&drive));
        (void)say_estimates(0.0f, 0.0f, 21000);
        (void)say_heartbeat(0, 8, 21000);
        expect_state(BERTH_DRIVE_STARTING, BERTH_DRIVE_FAULT_NONE, 0);
        step_at(30000);
        expect_ask_frames();
        (void)say_heartbeat(0, 8, 31000);
        expect_state(BERTH_DRIVE_ENABLED, BERTH_DRIVE_FAULT_NONE, 0);
    }
}

/* --- what a drive makes of it, with one frame lost ---------------------------------------------
 */

/* As much of a drive as enabling needs, with the worst values for a start. */
typedef struct {
    uint32_t error;
    uint8_t state;
    bool velocity_mode;
    float input;
} model_t;

static void obey(model_t *model, const berth_can_frame_t *frame) {
    switch (frame->id) {
    case 0x078:
        model->error = 0;
        break;
    case 0x06B:
        model->velocity_mode = memcmp(frame->data, mode_velocity, 8) == 0;
        break;
    case 0x067:
        if (model->error == 0) {
            TEST_ASSERT_TRUE(model->velocity_mode); /* nothing old in force */
            TEST_ASSERT_EQUAL_FLOAT(0.0f, model->input);
            model->state = frame->data[0];
        }
        break;
    case 0x06D:
        memcpy(&model->input, frame->data, 4);
        break;
    default:
        TEST_FAIL_MESSAGE("an id that is not in use");
    }
}

/* Frames to the drive are 0, 1, 2, ... and those from it too; the lost-th of all is lost. Returns
 * how many there were until it was enabled. */
static uint32_t enable_without(uint32_t lost, model_t *model) {
    uint32_t count = 0;
    setUp();
    berth_drive_enable(&drive, 0);
    for (int64_t now_us = 0; now_us <= ENABLE_TIMEOUT_US; now_us += 1000) {
        step_at(now_us);
        if (now_us % 10000 == 0) {
            berth_drive_cycle(&drive, now_us, &outbox);
        }
        for (const berth_can_frame_t *front = berth_outbox_front(&outbox); front != NULL;
             front = berth_outbox_front(&outbox)) {
            if (count++ != lost) {
                obey(model, front);
            }
            berth_outbox_pop(&outbox);
        }
        if (berth_drive_status(&drive)->state == BERTH_DRIVE_ENABLED) {
            return count;
        }
        if (now_us % 10000 == 5000 && count++ != lost) {
            TEST_ASSERT_TRUE(say_estimates(0.0f, 0.0f, now_us));
        }
        if (now_us % 100000 == 6000 && count++ != lost) {
            TEST_ASSERT_TRUE(say_heartbeat(model->error, model->state, now_us));
        }
    }
    TEST_FAIL_MESSAGE("not enabled");
    return 0;
}

static void test_whichever_frame_is_lost_enabling_gets_there(void) {
    model_t model = {.error = 0x01000000, .state = 1, .input = 5.0f};
    const uint32_t frames = enable_without(UINT32_MAX, &model);
    TEST_ASSERT_TRUE(frames > 8);
    for (uint32_t lost = 0; lost < frames; lost++) {
        model = (model_t){.error = 0x01000000, .state = 1, .input = 5.0f};
        (void)enable_without(lost, &model);
        TEST_ASSERT_TRUE(model.velocity_mode);
        TEST_ASSERT_EQUAL(8, model.state);
        TEST_ASSERT_EQUAL_HEX32(0, model.error);
        TEST_ASSERT_EQUAL_FLOAT(0.0f, model.input);
    }
}

/* --- commands ----------------------------------------------------------------------------------
 */

static void test_the_speed_command(void) {
    const uint8_t minus_two_and_a_half[] = {0x00, 0x00, 0x20, 0xC0, 0, 0, 0, 0};
    berth_drive_config_t config = good_config();
    config.node = 62;
    config.sign = -1;
    config.gear_ratio = 10.0f;
    init_with(&config);
    ask_at(0);
    berth_can_frame_t frame = estimates_frame(0.0f, 0.0f);
    frame.id = 0x7C9;
    TEST_ASSERT_TRUE(berth_drive_receive(&drive, &frame, 500));
    frame = heartbeat_frame(0, 8);
    frame.id = 0x7C1;
    TEST_ASSERT_TRUE(berth_drive_receive(&drive, &frame, 1000));
    expect_state(BERTH_DRIVE_ENABLED, BERTH_DRIVE_FAULT_NONE, 0);
    berth_drive_command(&drive, 0.25f * RAD_PER_TURN);
    berth_drive_cycle(&drive, 2000, &outbox);
    expect(0x7CD, 8, minus_two_and_a_half);
}

static void test_a_newer_command_takes_the_place_of_one_that_waits(void) {
    const uint8_t one[] = {0x00, 0x00, 0x80, 0x3F, 0, 0, 0, 0};
    make_enabled(0);
    berth_drive_command(&drive, 7.0f);
    berth_drive_cycle(&drive, 2000, &outbox);
    berth_drive_command(&drive, RAD_PER_TURN);
    berth_drive_cycle(&drive, 12000, &outbox);
    expect(0x06D, 8, one);
    expect_nothing();
}

static void test_speeds_saturate_and_are_counted(void) {
    const uint8_t thousand[] = {0x00, 0x00, 0x7A, 0x44, 0, 0, 0, 0};
    const uint8_t minus_thousand[] = {0x00, 0x00, 0x7A, 0xC4, 0, 0, 0, 0};
    make_enabled(0);
    berth_drive_command(&drive, 3.4e38f);
    berth_drive_cycle(&drive, 2000, &outbox);
    expect(0x06D, 8, thousand);
    berth_drive_command(&drive, -1.0e4f);
    berth_drive_cycle(&drive, 12000, &outbox);
    expect(0x06D, 8, minus_thousand);
    TEST_ASSERT_EQUAL(2, berth_drive_status(&drive)->saturated);
    berth_drive_command(&drive, NAN);
    berth_drive_cycle(&drive, 22000, &outbox);
    expect(0x06D, 8, stand);
    TEST_ASSERT_EQUAL(2, berth_drive_status(&drive)->saturated);
    TEST_ASSERT_EQUAL(1, berth_drive_status(&drive)->refused);
}

/* With the highest gear the product is beyond float32. */
static void test_speeds_saturate_with_any_gear(void) {
    const uint8_t minus_thousand[] = {0x00, 0x00, 0x7A, 0xC4, 0, 0, 0, 0};
    berth_drive_config_t config = good_config();
    config.gear_ratio = 1000.0f;
    init_with(&config);
    make_enabled(0);
    berth_drive_command(&drive, -3.4e38f);
    berth_drive_cycle(&drive, 2000, &outbox);
    expect(0x06D, 8, minus_thousand);
}

static void test_stops_and_disabling(void) {
    make_enabled(0);
    berth_drive_command(&drive, 3.0f);
    berth_drive_cycle(&drive, 2000, &outbox); /* waits; must not be sent any more */
    berth_drive_stop(&drive, &outbox);
    expect(0x06D, 8, stand);
    expect_nothing();
    berth_drive_cycle(&drive, 12000, &outbox);
    expect(0x06D, 8, stand);
    berth_drive_emergency_stop(&drive, &outbox);
    expect(0x06D, 8, stand);
    expect(0x062, 0, NULL);
    expect_nothing();
    berth_drive_disable(&drive, &outbox);
    expect(0x067, 4, idle);
    expect_nothing();
    expect_state(BERTH_DRIVE_OFF, BERTH_DRIVE_FAULT_NONE, 0);
    berth_drive_cycle(&drive, 22000, &outbox);
    expect_nothing();
}

/* --- heartbeats --------------------------------------------------------------------------------
 */

static void test_an_error_is_a_fault_and_zero_is_commanded(void) {
    make_enabled(0);
    berth_drive_command(&drive, 3.0f);
    (void)say_heartbeat(0x80000041, 8, 2000);
    expect_state(BERTH_DRIVE_FAULT, BERTH_DRIVE_FAULT_DEVICE, 0x80000041);
    berth_drive_cycle(&drive, 12000, &outbox);
    expect(0x06D, 8, stand);
}

static void test_another_state_is_a_fault(void) {
    for (unsigned state = 0; state < 256; state++) {
        setUp();
        make_enabled(0);
        (void)say_heartbeat(0, (uint8_t)state, 2000);
        if (state == 8) {
            expect_state(BERTH_DRIVE_ENABLED, BERTH_DRIVE_FAULT_NONE, 0);
        } else {
            expect_state(BERTH_DRIVE_FAULT, BERTH_DRIVE_FAULT_DISABLED, state);
        }
    }
}

static void test_a_stopped_drive_with_an_error_is_a_fault(void) {
    make_enabled(0);
    berth_drive_stop(&drive, &outbox);
    (void)say_heartbeat(0x100, 1, 2000);
    expect_state(BERTH_DRIVE_FAULT, BERTH_DRIVE_FAULT_DEVICE, 0x100);
}

static void test_what_follows_from_an_emergency_stop_is_no_fault(void) {
    make_enabled(0);
    berth_drive_emergency_stop(&drive, &outbox);
    (void)say_heartbeat(0x02000000, 1, 2000);
    expect_state(BERTH_DRIVE_STOPPED, BERTH_DRIVE_FAULT_NONE, 0);
    make_enabled(10000); /* clears it */
    (void)say_heartbeat(0x02000000, 1, 12000);
    expect_state(BERTH_DRIVE_FAULT, BERTH_DRIVE_FAULT_DEVICE, 0x02000000);
}

static void test_an_error_while_off_is_none_of_ours(void) {
    TEST_ASSERT_TRUE(say_heartbeat(0x40, 1, 2000));
    expect_state(BERTH_DRIVE_OFF, BERTH_DRIVE_FAULT_NONE, 0);
    TEST_ASSERT_EQUAL(2000, berth_drive_status(&drive)->heartbeat_us);
}

static void test_silence_is_a_fault(void) {
    make_enabled(0); /* feedback at 500, heartbeat at 1000 */
    step_at(100500);
    expect_state(BERTH_DRIVE_ENABLED, BERTH_DRIVE_FAULT_NONE, 0);
    step_at(100501);
    expect_state(BERTH_DRIVE_FAULT, BERTH_DRIVE_FAULT_FEEDBACK, 0);

    setUp();
    make_enabled(0);
    (void)say_estimates(0.0f, 0.0f, 351000);
    step_at(351000);
    expect_state(BERTH_DRIVE_ENABLED, BERTH_DRIVE_FAULT_NONE, 0);
    step_at(351001);
    expect_state(BERTH_DRIVE_FAULT, BERTH_DRIVE_FAULT_HEARTBEAT, 0);
}

static void test_heartbeats_of_5_to_8_bytes_are_good(void) {
    for (unsigned length = 0; length < 256; length++) {
        setUp();
        berth_can_frame_t frame = heartbeat_frame(0, 8);
        frame.length = (uint8_t)length;
        TEST_ASSERT_TRUE(berth_drive_receive(&drive, &frame, 1000));
        const bool good = length >= 5 && length <= 8;
        TEST_ASSERT_EQUAL(good ? 1 : 0, berth_drive_status(&drive)->received);
        TEST_ASSERT_EQUAL(good ? 0 : 1, berth_drive_status(&drive)->malformed);
        TEST_ASSERT_EQUAL(good ? 1000 : -1, berth_drive_status(&drive)->heartbeat_us);
    }
}

/* --- feedback ----------------------------------------------------------------------------------
 */

static void test_feedback_bytes(void) {
    /* -0.75 turns, 1.5 turns/s */
    const berth_can_frame_t frame = {
        .id = 0x069, .length = 8, .data = {0x00, 0x00, 0x40, 0xBF, 0x00, 0x00, 0xC0, 0x3F}};
    TEST_ASSERT_TRUE(berth_drive_receive(&drive, &frame, 1234));
    const berth_drive_status_t *status = berth_drive_status(&drive);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-5f, 1.5f * RAD_PER_TURN, status->velocity_radps);
    TEST_ASSERT_EQUAL(1234, status->feedback_us);
    TEST_ASSERT_TRUE(status->position_used);
}

static void expect_malformed(const berth_can_frame_t *frame) {
    const uint32_t before = berth_drive_status(&drive)->malformed;
    TEST_ASSERT_TRUE(berth_drive_receive(&drive, frame, 5000));
    TEST_ASSERT_EQUAL(before + 1, berth_drive_status(&drive)->malformed);
    TEST_ASSERT_EQUAL(500, berth_drive_status(&drive)->feedback_us);
    TEST_ASSERT_EQUAL(1000, berth_drive_status(&drive)->heartbeat_us);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, berth_drive_status(&drive)->velocity_radps);
    expect_state(BERTH_DRIVE_ENABLED, BERTH_DRIVE_FAULT_NONE, 0);
}

static void test_bad_feedback_changes_nothing(void) {
    const float bad[] = {NAN, INFINITY, -INFINITY};
    make_enabled(0);
    for (uint32_t i = 0; i < 3; i++) {
        const berth_can_frame_t turns = estimates_frame(bad[i], 1.0f);
        expect_malformed(&turns);
        const berth_can_frame_t speed = estimates_frame(0.0f, bad[i]);
        expect_malformed(&speed);
    }
    const berth_can_frame_t fast = estimates_frame(0.0f, -1000.1f);
    expect_malformed(&fast);
    for (unsigned length = 0; length < 256; length++) {
        berth_can_frame_t frame = estimates_frame(0.01f, 1.0f);
        frame.length = (uint8_t)length;
        if (length != 8) {
            expect_malformed(&frame);
        }
    }
    berth_can_frame_t remote = estimates_frame(0.01f, 1.0f);
    remote.remote = true;
    expect_malformed(&remote);
    remote = heartbeat_frame(1, 1);
    remote.remote = true;
    expect_malformed(&remote);
}

static void test_frames_of_others_are_left_alone(void) {
    make_enabled(0);
    const uint32_t received = berth_drive_status(&drive)->received;
    for (uint32_t id = 0; id <= BERTH_CAN_STANDARD_MAX; id++) {
        berth_can_frame_t frame = heartbeat_frame(1, 1);
        frame.id = id;
        if (id != 0x061 && id != 0x069) {
            TEST_ASSERT_FALSE(berth_drive_receive(&drive, &frame, 2000));
        }
        frame.extended = true;
        TEST_ASSERT_FALSE(berth_drive_receive(&drive, &frame, 2000));
    }
    TEST_ASSERT_EQUAL(received, berth_drive_status(&drive)->received);
    TEST_ASSERT_EQUAL(0, berth_drive_status(&drive)->malformed);
    expect_state(BERTH_DRIVE_ENABLED, BERTH_DRIVE_FAULT_NONE, 0);
}

static void test_travel_follows_the_turns(void) {
    berth_drive_config_t config = good_config();
    config.sign = -1;
    config.gear_ratio = 4.0f;
    init_with(&config);
    make_enabled(0);
    (void)berth_drive_travel(&drive, 500);
    TEST_ASSERT_TRUE(say_estimates(0.1f, 0.0f, 10500)); /* the speed says nothing of it */
    TEST_ASSERT_FLOAT_WITHIN(1.0e-6f, -0.025f * RAD_PER_TURN, berth_drive_travel(&drive, 10500));
    TEST_ASSERT_TRUE(say_estimates(-0.1f, 0.0f, 20500));
    TEST_ASSERT_FLOAT_WITHIN(1.0e-6f, 0.05f * RAD_PER_TURN, berth_drive_travel(&drive, 20500));
    TEST_ASSERT_EQUAL(0, berth_drive_status(&drive)->malformed);
}

static void test_a_jump_is_counted_and_the_speed_counts(void) {
    make_enabled(0);
    TEST_ASSERT_TRUE(say_estimates(40.0f, 1.0f, 10500));
    TEST_ASSERT_EQUAL(1, berth_drive_status(&drive)->malformed);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-6f, 0.005f * RAD_PER_TURN, berth_drive_travel(&drive, 10500));
    TEST_ASSERT_TRUE(say_estimates(40.01f, 1.0f, 20500));
    TEST_ASSERT_EQUAL(1, berth_drive_status(&drive)->malformed);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-4f, 0.01f * RAD_PER_TURN, berth_drive_travel(&drive, 20500));
}

static void test_beyond_what_float32_resolves_the_speed_counts(void) {
    const float most = 65536.0f;
    make_enabled(0);
    TEST_ASSERT_TRUE(say_estimates(nextafterf(most, 1.0e9f), 10.0f, 10500));
    TEST_ASSERT_FALSE(berth_drive_status(&drive)->position_used);
    (void)berth_drive_travel(&drive, 10500);
    TEST_ASSERT_TRUE(say_estimates(3.0e38f, 10.0f, 20500));
    TEST_ASSERT_FALSE(berth_drive_status(&drive)->position_used);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-5f, 0.1f * RAD_PER_TURN, berth_drive_travel(&drive, 20500));
    TEST_ASSERT_TRUE(say_estimates(most, 10.0f, 30500)); /* back again: a first position */
    TEST_ASSERT_TRUE(berth_drive_status(&drive)->position_used);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-5f, 0.1f * RAD_PER_TURN, berth_drive_travel(&drive, 30500));
    TEST_ASSERT_EQUAL(0, berth_drive_status(&drive)->malformed);
}

/* 1/256 turn is the step of the position there; the speed is finer, either side of zero. */
static void test_a_coarse_position_does_not_spoil_the_speed(void) {
    for (int side = -1; side <= 1; side += 2) {
        setUp();
        make_enabled(0);
        const float far = (float)side * 60000.0f;
        double turns = (double)far;
        TEST_ASSERT_TRUE(say_estimates(far, 0.1f, 500)); /* a jump: far from 0 */
        TEST_ASSERT_EQUAL(1, berth_drive_status(&drive)->malformed);
        (void)berth_drive_travel(&drive, 500);
        for (int64_t now_us = 10500; now_us < 5000000; now_us += 10000) {
            turns += 0.001;
            TEST_ASSERT_TRUE(say_estimates((float)turns, 0.1f, now_us));
            const float travel = berth_drive_travel(&drive, now_us);
            TEST_ASSERT_FLOAT_WITHIN(1.0e-5f, 0.001f * RAD_PER_TURN, travel);
        }
        TEST_ASSERT_EQUAL(1, berth_drive_status(&drive)->malformed);
    }
}

/* --- the rest ----------------------------------------------------------------------------------
 */

static void test_node_numbers(void) {
    berth_drive_config_t config = good_config();
    berth_refusal_t refusal;
    config.node = 0;
    TEST_ASSERT_EQUAL(BERTH_OK, berth_drive_init(&drive, &config, &refusal));
    config.node = 63;
    TEST_ASSERT_EQUAL(BERTH_ERROR_CONFIG, berth_drive_init(&drive, &config, &refusal));
    TEST_ASSERT_EQUAL(BERTH_FIELD_DRIVE_NODE, refusal.field);
    TEST_ASSERT_EQUAL_FLOAT(62.0f, refusal.maximum);
}

static void test_filters_are_exactly_the_ids_in_use(void) {
    berth_can_filter_t filters[BERTH_DRIVE_FILTERS_MAX];
    TEST_ASSERT_EQUAL(2, berth_drive_filters(&drive, filters));
    TEST_ASSERT_EQUAL_HEX32(0x061, filters[0].id);
    TEST_ASSERT_EQUAL_HEX32(0x069, filters[1].id);
    for (uint32_t i = 0; i < 2; i++) {
        TEST_ASSERT_EQUAL_HEX32(0x7ff, filters[i].mask);
        TEST_ASSERT_FALSE(filters[i].extended);
    }
}

static void test_any_frames_at_any_time_never_break_it(void) {
    support_random_start();
    make_enabled(0);
    for (uint32_t run = 0; run < support_runs(200000); run++) {
        berth_can_frame_t frame = {
            .id = support_index(4) == 0 ? support_index(2048) : 0x060 + support_index(16),
            .extended = support_index(8) == 0,
            .remote = support_index(8) == 0,
            .length = (uint8_t)support_index(10),
        };
        for (uint32_t i = 0; i < 8; i++) {
            frame.data[i] = (uint8_t)support_index(256);
        }
        const int64_t now_us = (int64_t)support_index(1000000);
        (void)berth_drive_receive(&drive, &frame, now_us);
        step_at(now_us);
        TEST_ASSERT_TRUE(isfinite(berth_drive_travel(&drive, now_us)));
        TEST_ASSERT_TRUE(isfinite(berth_drive_status(&drive)->velocity_radps));
        berth_drive_cycle(&drive, now_us, &outbox);
        if (berth_drive_status(&drive)->state == BERTH_DRIVE_FAULT) {
            berth_drive_reset(&drive);
            berth_drive_enable(&drive, now_us);
        }
        berth_outbox_clear(&outbox);
    }
    TEST_ASSERT_TRUE(berth_drive_status(&drive)->received > 0);
    TEST_ASSERT_TRUE(berth_drive_status(&drive)->malformed > 0);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_the_whole_enable_sequence);
    RUN_TEST(test_frames_are_repeated_until_the_drive_follows);
    RUN_TEST(test_an_old_heartbeat_does_not_enable);
    RUN_TEST(test_without_feedback_it_waits_and_says_so);
    RUN_TEST(test_how_far_enabling_came);
    RUN_TEST(test_no_torque_is_asked_for_when_the_time_is_over);
    RUN_TEST(test_an_error_that_stays_is_named);
    RUN_TEST(test_state_8_with_an_error_is_not_enabled);
    RUN_TEST(test_falling_out_while_starting_asks_again);
    RUN_TEST(test_a_full_outbox_delays_enabling);
    RUN_TEST(test_an_outbox_with_too_little_room_delays_enabling);
    RUN_TEST(test_whichever_frame_is_lost_enabling_gets_there);
    RUN_TEST(test_the_speed_command);
    RUN_TEST(test_a_newer_command_takes_the_place_of_one_that_waits);
    RUN_TEST(test_speeds_saturate_and_are_counted);
    RUN_TEST(test_speeds_saturate_with_any_gear);
    RUN_TEST(test_stops_and_disabling);
    RUN_TEST(test_an_error_is_a_fault_and_zero_is_commanded);
    RUN_TEST(test_another_state_is_a_fault);
    RUN_TEST(test_a_stopped_drive_with_an_error_is_a_fault);
    RUN_TEST(test_what_follows_from_an_emergency_stop_is_no_fault);
    RUN_TEST(test_an_error_while_off_is_none_of_ours);
    RUN_TEST(test_silence_is_a_fault);
    RUN_TEST(test_heartbeats_of_5_to_8_bytes_are_good);
    RUN_TEST(test_feedback_bytes);
    RUN_TEST(test_bad_feedback_changes_nothing);
    RUN_TEST(test_frames_of_others_are_left_alone);
    RUN_TEST(test_travel_follows_the_turns);
    RUN_TEST(test_a_jump_is_counted_and_the_speed_counts);
    RUN_TEST(test_beyond_what_float32_resolves_the_speed_counts);
    RUN_TEST(test_a_coarse_position_does_not_spoil_the_speed);
    RUN_TEST(test_node_numbers);
    RUN_TEST(test_filters_are_exactly_the_ids_in_use);
    RUN_TEST(test_any_frames_at_any_time_never_break_it);
    return UNITY_END();
}
