/* The CANopen wheel drive at its edges: a drive that is stopped, disabled or faulty while it is
 * being enabled, one that boots anew, what comes too early or too late, and the last values that
 * are good. Frames are written as ID#DATA, like candump does. */
#include "berth/drive_cia402.h"
#include "berth/reference.h"
#include "cia402_rig.h"

#include "unity.h"

#include <math.h>
#include <string.h>

static rig_t rig;

void setUp(void) {
    rig_init(&rig, rig_config());
}

void tearDown(void) {}

/* --- a drive that answers --------------------------------------------------------------------- */

/* The frame that waits, if it is an SDO request. NMT commands before it are taken out. */
static bool next_request(berth_can_frame_t *request) {
    for (;;) {
        const berth_can_frame_t *front = berth_outbox_front(&rig.outbox);
        if (front == NULL) {
            return false;
        }
        *request = *front;
        berth_outbox_pop(&rig.outbox);
        if (request->id == 0x605) {
            return true;
        }
    }
}

static void answer(const berth_can_frame_t *request) {
    berth_can_frame_t frame = {.id = 0x585, .length = 8};
    memcpy(frame.data + 1, request->data + 1, 3);
    frame.data[0] = request->data[0] == 0x40 ? 0x4F : 0x60;
    frame.data[4] = request->data[0] == 0x40 ? rig.drive.config.mode : 0;
    rig_take(&rig, &frame);
}

static uint32_t index_of(const berth_can_frame_t *request) {
    return request->data[1] | (uint32_t)request->data[2] << 8;
}

/* Answers all requests until one is for this object, which is returned unanswered; index 0: answers
 * all, and the node then waits to be started. */
static berth_can_frame_t answer_until(uint32_t index) {
    berth_can_frame_t request = {0};
    rig_step(&rig);
    while (next_request(&request)) {
        if (index != 0 && index_of(&request) == index) {
            return request;
        }
        answer(&request);
        if (index_of(&request) == 0x1017) {
            rig_say(&rig, "705#7F");
        }
        rig_step(&rig);
    }
    TEST_ASSERT_EQUAL_HEX32(0, index);
    return request;
}

static void go_to_run(void) {
    rig_enable(&rig);
    (void)answer_until(0);
    rig_say(&rig, "705#05");
    rig_expect_state(&rig, BERTH_DRIVE_STARTING);
}

/* Obeys one controlword after the other, up to operation enabled. */
static void go_to_operation(void) {
    static const char *const words[] = {"185#500200000000", "185#310200000000", "185#330200000000",
                                        "185#370200000000"};
    for (uint32_t i = 0; i < 4; i++) {
        rig_say(&rig, words[i]);
        berth_drive_cycle(&rig.drive, rig.now_us, &rig.outbox);
        rig_drop(&rig);
    }
}

static void go_to_enabled(void) {
    go_to_run();
    go_to_operation();
    rig_step(&rig);
    rig_expect(&rig, "605#4061600000000000");
    rig_say(&rig, "585#4F61600009000000");
    rig_say(&rig, "185#370200000000");
    rig_expect_state(&rig, BERTH_DRIVE_ENABLED);
    rig_say(&rig, "285#00000000");
    rig_drop(&rig);
}

/* Steps until long after every repetition: nothing more is said. */
static void expect_silence_from_now_on(void) {
    for (int i = 0; i < 10; i++) {
        rig_step(&rig);
        rig_expect_silence(&rig);
        rig.now_us += BERTH_CIA402_NMT_REPEAT_US / 4;
    }
}

/* --- stopped, disabled or faulty -------------------------------------------------------------- */

static void test_a_stop_ends_the_set_up(void) {
    /* 0: the set-up is done, and the node is to be started */
    static const uint32_t objects[] = {0x6040, 0x1017, 0x6060, 0x1600, 0x1803, 0};
    berth_drive_config_t config = rig_config();
    config.feedback_timeout_us = 10000000;
    config.heartbeat_timeout_us = 10000000;
    for (uint32_t i = 0; i < sizeof objects / sizeof objects[0]; i++) {
        rig_init(&rig, config);
        rig_enable(&rig);
        (void)answer_until(objects[i]);
        berth_drive_stop(&rig.drive, &rig.outbox);
        rig_drop(&rig);
        expect_silence_from_now_on();
        rig_expect_state(&rig, BERTH_DRIVE_STOPPED);
    }
}

/* It fell out of operational with a fault that could not be reset. */
static void test_a_fault_that_stays_ends_the_asking(void) {
    go_to_run();
    rig_say(&rig, "185#380200000000");
    rig_say(&rig, "705#7F");
    rig.now_us = rig.enabled_us + rig.drive.config.enable_timeout_us + 1;
    rig_step(&rig);
    rig_expect_fault(&rig, BERTH_DRIVE_FAULT_DEVICE, 0);
    rig_expect_silence(&rig);
}

/* SYNCs in between belong to the commands, and there are none any more. */
static void test_a_disabled_drive_is_sent_no_sync(void) {
    rig.drive.config.period_us = 50000;
    go_to_enabled();
    rig_say(&rig, "185#380200000000");
    rig_expect_fault(&rig, BERTH_DRIVE_FAULT_DEVICE, 0);
    berth_drive_cycle(&rig.drive, rig.now_us, &rig.outbox);
    TEST_ASSERT_EQUAL_INT64(rig.now_us + 10000, berth_drive_deadline(&rig.drive));
    berth_drive_disable(&rig.drive, &rig.outbox);
    rig_drop(&rig);
    TEST_ASSERT_EQUAL_INT64(BERTH_TIME_MAX_US, berth_drive_deadline(&rig.drive));
    expect_silence_from_now_on();
}

/* A quick stop that is active is a state of a healthy drive: a fault after it is a new one. */
static void test_a_fault_after_a_quick_stop_is_a_new_one(void) {
    go_to_run();
    rig_say(&rig, "185#170200000000");
    rig_expect_state(&rig, BERTH_DRIVE_STARTING);
    rig_say(&rig, "185#180200000000");
    rig_expect_fault(&rig, BERTH_DRIVE_FAULT_DEVICE, 0);
}

/* --- too early and too late ------------------------------------------------------------------- */

/* Whatever length a former mapping had. */
static void test_positions_of_a_former_mapping_are_good_and_mean_nothing(void) {
    rig_enable(&rig);
    (void)answer_until(0x1A01);
    const uint32_t received = rig_status(&rig)->received;
    rig_say(&rig, "285#00010000");
    rig_say(&rig, "285#0001000000000000");
    rig_say(&rig, "285#");
    TEST_ASSERT_EQUAL_UINT32(received + 3, rig_status(&rig)->received);
    TEST_ASSERT_EQUAL_UINT32(0, rig_status(&rig)->malformed);
    TEST_ASSERT_FALSE(rig_status(&rig)->position_used);
}

/* A node that has left operational has to come back first. */
static void test_statuswords_before_operational_do_not_enable(void) {
    go_to_run();
    go_to_operation();
    rig_step(&rig);
    rig_expect(&rig, "605#4061600000000000");
    rig_say(&rig, "585#4F61600009000000");
    rig_say(&rig, "705#7F");
    rig_say(&rig, "185#370200000000");
    rig_expect_state(&rig, BERTH_DRIVE_STARTING);
    rig_say(&rig, "705#05");
    rig_expect_state(&rig, BERTH_DRIVE_STARTING);
    rig_say(&rig, "185#370200000000");
    rig_expect_state(&rig, BERTH_DRIVE_ENABLED);
}

/* The fault reset's level lasts; the question after the mode does not wait for that. */
static void test_the_mode_is_asked_for_at_once_after_a_fault_reset(void) {
    go_to_run();
    rig_say(&rig, "185#380200000000");
    berth_drive_cycle(&rig.drive, rig.now_us, &rig.outbox);
    rig_expect(&rig, "205#800000000000");
    go_to_operation();
    TEST_ASSERT_EQUAL_INT64(rig.now_us, berth_drive_deadline(&rig.drive));
    rig_step(&rig);
    rig_expect(&rig, "605#4061600000000000");
}

/* The answers to earlier tries come after the one that decided. */
static void test_late_answers_about_the_mode_change_nothing(void) {
    go_to_run();
    go_to_operation();
    for (int tries = 0; tries < 3; tries++) {
        rig_step(&rig);
        rig_expect(&rig, "605#4061600000000000");
        rig.now_us += BERTH_CIA402_ANSWER_US;
    }
    rig_say(&rig, "585#4F61600009000000");
    rig_say(&rig, "585#4F61600003000000");
    rig_say(&rig, "585#8061600000000206");
    rig_expect_state(&rig, BERTH_DRIVE_STARTING);
    rig_say(&rig, "185#370200000000");
    rig_expect_state(&rig, BERTH_DRIVE_ENABLED);
}

/* --- booting anew ----------------------------------------------------------------------------- */

/* Its counts begin anew, and nobody knows what the wheel did meanwhile: a first position. */
static void test_positions_from_before_a_boot_up_do_not_count(void) {
    go_to_run();
    rig_say(&rig, "185#500200000000");
    rig_say(&rig, "285#00100000");
    TEST_ASSERT_TRUE(rig_status(&rig)->position_used);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, berth_drive_travel(&rig.drive, rig.now_us));
    rig_say(&rig, "705#00");
    TEST_ASSERT_FALSE(rig_status(&rig)->position_used);
    (void)answer_until(0);
    rig_say(&rig, "705#05");
    rig_say(&rig, "185#500200000000");
    rig_say(&rig, "285#01000000");
    TEST_ASSERT_TRUE(rig_status(&rig)->position_used);
    TEST_ASSERT_EQUAL_UINT32(0, rig_status(&rig)->malformed);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, berth_drive_travel(&rig.drive, rig.now_us));
    rig_say(&rig, "285#11000000"); /* 16 counts of 4096, a tenth of that at the wheel */
    TEST_ASSERT_FLOAT_WITHIN(2.0e-4f, 0.0024544f, berth_drive_travel(&rig.drive, rig.now_us));
}

/* The speed before the boot says nothing of the way that positions tell after it. */
static void test_a_wheel_that_turned_into_the_boot_up_travels_by_its_speed(void) {
    go_to_run();
    rig_say(&rig, "185#500200A00000"); /* 10 motor turns/s: 6.28 rad/s of the wheel */
    rig_say(&rig, "285#00000000");
    rig_say(&rig, "705#00");
    rig.now_us += 10000;
    (void)answer_until(0);
    rig_say(&rig, "705#05");
    rig_say(&rig, "185#500200A00000");
    const float by_speed = 0.0628319f;
    TEST_ASSERT_FLOAT_WITHIN(1.0e-5f, by_speed, berth_drive_travel(&rig.drive, rig.now_us));
    rig_say(&rig, "285#00000000");
    TEST_ASSERT_EQUAL_FLOAT(0.0f, berth_drive_travel(&rig.drive, rig.now_us));
}

/* --- numbers ---------------------------------------------------------------------------------- */

static void expect_refused(const berth_drive_config_t *config, berth_field_t field, float value,
                           float minimum, float maximum) {
    berth_drive_t drive;
    berth_refusal_t refusal = {0};
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_CONFIG, berth_drive_init(&drive, config, &refusal));
    TEST_ASSERT_EQUAL_INT(field, refusal.field);
    TEST_ASSERT_EQUAL_FLOAT(value, refusal.value);
    TEST_ASSERT_EQUAL_FLOAT(minimum, refusal.minimum);
    TEST_ASSERT_EQUAL_FLOAT(maximum, refusal.maximum);
}

static void test_what_a_refusal_says(void) {
    berth_drive_config_t config = rig_config();
    config.master_node = 1;
    rig_init(&rig, config);
    config.master_node = 0;
    expect_refused(&config, BERTH_FIELD_MASTER_NODE, 0.0f, 1.0f, 127.0f);
    config = rig_config();
    config.counts_per_turn = 1;
    rig_init(&rig, config);
    config.counts_per_turn = 16777216;
    rig_init(&rig, config);
    config.counts_per_turn = 0;
    expect_refused(&config, BERTH_FIELD_COUNTS_PER_TURN, 0.0f, 1.0f, 16777216.0f);
    config = rig_config();
    config.heartbeat_timeout_us = 10000000;
    rig_init(&rig, config);
    config.heartbeat_timeout_us = 19999;
    expect_refused(&config, BERTH_FIELD_HEARTBEAT_TIMEOUT, 19999.0f, 20000.0f, 1.0e7f);
    config.period_us = 1000;
    config.heartbeat_timeout_us = 2999;
    expect_refused(&config, BERTH_FIELD_HEARTBEAT_TIMEOUT, 2999.0f, 3000.0f, 1.0e7f);
    config = rig_config();
    config.mode = 4;
    expect_refused(&config, BERTH_FIELD_DRIVE_MODE, 4.0f, 3.0f, 3.0f);
}

static void expect_request(const char *expected, const berth_can_frame_t *request) {
    char text[32];
    rig_text(request, text);
    TEST_ASSERT_EQUAL_STRING(expected, text);
}

/* Value and exponent of 0x60C2, and how the third digit is rounded. */
static void test_interpolation_periods_at_a_bytes_end(void) {
    static const struct {
        uint32_t period_us;
        const char *value, *exponent;
    } cases[] = {
        {2550, "605#2FC26001FF000000", "605#2FC26002FB000000"}, /* 255 fits */
        {2560, "605#2FC260011A000000", "605#2FC26002FC000000"},
        {2544, "605#2FC26001FE000000", "605#2FC26002FB000000"}, /* 254.4 */
        {2535, "605#2FC26001FE000000", "605#2FC26002FB000000"}, /* 253.5 */
    };
    for (uint32_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        berth_drive_config_t config = rig_config();
        config.period_us = cases[i].period_us;
        rig_init(&rig, config);
        rig_enable(&rig);
        berth_can_frame_t request = answer_until(0x60C2);
        expect_request(cases[i].value, &request);
        answer(&request);
        request = answer_until(0x60C2);
        expect_request(cases[i].exponent, &request);
    }
}

/* Whole milliseconds, and a third of them. */
static void test_heartbeat_times(void) {
    berth_drive_config_t config = rig_config();
    config.heartbeat_timeout_us = 2000999;
    rig_init(&rig, config);
    rig_enable(&rig);
    berth_can_frame_t request = answer_until(0x1017);
    expect_request("605#2B1710009A020000", &request);
    answer(&request);
    rig_say(&rig, "705#7F");
    request = answer_until(0x1016);
    expect_request("605#23161001D0077F00", &request);
}

static void test_filters_end_where_they_are_said_to(void) {
    for (int with = 0; with < 2; with++) {
        berth_drive_config_t config = rig_config();
        config.has_position = with != 0;
        rig_init(&rig, config);
        berth_can_filter_t filters[BERTH_DRIVE_FILTERS_MAX];
        memset(filters, 0x5A, sizeof filters);
        const uint32_t count = berth_drive_filters(&rig.drive, filters);
        TEST_ASSERT_EQUAL_UINT32(with != 0 ? 5 : 4, count);
        TEST_ASSERT_EQUAL_HEX32(0x7FF, filters[count - 1].mask);
        TEST_ASSERT_EQUAL_HEX32(0x5A5A5A5A, filters[count].id);
        TEST_ASSERT_EQUAL_HEX32(0x5A5A5A5A, filters[count].mask);
    }
}

/* --- the emergency stop ----------------------------------------------------------------------- */

static void expect_word(const char *command) {
    berth_drive_cycle(&rig.drive, rig.now_us, &rig.outbox);
    rig_expect(&rig, command);
    rig_drop(&rig);
}

static void test_a_wheel_at_the_standing_speed_does_not_stand(void) {
    for (int sign = -1; sign <= 1; sign += 2) {
        setUp();
        go_to_enabled();
        berth_drive_emergency_stop(&rig.drive, &rig.outbox);
        rig_drop(&rig);
        rig.drive.status.velocity_radps = (float)sign * BERTH_CIA402_STANDING_RADPS;
        expect_word("205#020000000000");
        rig.drive.status.velocity_radps =
            (float)sign * nextafterf(BERTH_CIA402_STANDING_RADPS, 0.0f);
        expect_word("205#000000000000");
    }
}

static void test_standing_at_time_zero_is_standing(void) {
    rig.now_us = 0;
    go_to_enabled();
    TEST_ASSERT_EQUAL_INT64(0, rig_status(&rig)->feedback_us);
    berth_drive_emergency_stop(&rig.drive, &rig.outbox);
    rig_drop(&rig);
    expect_word("205#000000000000");
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_a_stop_ends_the_set_up);
    RUN_TEST(test_a_fault_that_stays_ends_the_asking);
    RUN_TEST(test_a_disabled_drive_is_sent_no_sync);
    RUN_TEST(test_a_fault_after_a_quick_stop_is_a_new_one);
    RUN_TEST(test_positions_of_a_former_mapping_are_good_and_mean_nothing);
    RUN_TEST(test_statuswords_before_operational_do_not_enable);
    RUN_TEST(test_the_mode_is_asked_for_at_once_after_a_fault_reset);
    RUN_TEST(test_late_answers_about_the_mode_change_nothing);
    RUN_TEST(test_positions_from_before_a_boot_up_do_not_count);
    RUN_TEST(test_a_wheel_that_turned_into_the_boot_up_travels_by_its_speed);
    RUN_TEST(test_what_a_refusal_says);
    RUN_TEST(test_interpolation_periods_at_a_bytes_end);
    RUN_TEST(test_heartbeat_times);
    RUN_TEST(test_filters_end_where_they_are_said_to);
    RUN_TEST(test_a_wheel_at_the_standing_speed_does_not_stand);
    RUN_TEST(test_standing_at_time_zero_is_standing);
    return UNITY_END();
}
