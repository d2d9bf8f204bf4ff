#include "lockstep.h"
#include "support.h"
#include "unity.h"

#include <string.h>

void setUp(void) {}
void tearDown(void) {}

static void test_every_number_comes_back(void) {
    static const uint64_t values[] = {0,          1,          0xff,      0x100,     0xff00,
                                      UINT32_MAX, 1ull << 56, INT64_MAX, UINT64_MAX};
    for (uint32_t i = 0; i < sizeof values / sizeof values[0]; i++) {
        berth_can_frame_t frame;
        lockstep_kind_t kind = LOCKSTEP_BEGIN;
        uint64_t value = 7;
        lockstep_encode(&frame, LOCKSTEP_DONE, values[i]);
        TEST_ASSERT_TRUE(frame.extended && !frame.remote);
        TEST_ASSERT_EQUAL_HEX32(0x1fff0083u, frame.id);
        TEST_ASSERT_TRUE(frame.length == 0 || frame.data[frame.length - 1] != 0);
        TEST_ASSERT_TRUE(lockstep_decode(&frame, &kind, &value));
        TEST_ASSERT_EQUAL(LOCKSTEP_DONE, kind);
        TEST_ASSERT_EQUAL_HEX64(values[i], value);
    }
}

static void test_frames_of_the_bus_are_no_control_frames(void) {
    lockstep_kind_t kind = LOCKSTEP_BEGIN;
    uint64_t value = 7;
    const berth_can_frame_t frames[] = {
        {.id = 0x083},
        {.id = LOCKSTEP_ID & 0x7ffu},
        {.id = LOCKSTEP_ID | 0x83u, .extended = true, .remote = true},
        {.id = 0x1ffe0083u, .extended = true},
        {.id = 0x1fff0183u, .extended = true},
        {.id = 0x18b20000u, .extended = true, .length = 8},
    };
    for (uint32_t i = 0; i < sizeof frames / sizeof frames[0]; i++) {
        TEST_ASSERT_FALSE(lockstep_decode(&frames[i], &kind, &value));
    }
    TEST_ASSERT_EQUAL(LOCKSTEP_BEGIN, kind);
    TEST_ASSERT_EQUAL_HEX64(7, value);
}

/* A length beyond 8 breaks the contract; no byte beyond the data is read. */
static void test_a_length_beyond_its_range(void) {
    berth_can_frame_t frame;
    lockstep_kind_t kind;
    uint64_t value;
    lockstep_encode(&frame, LOCKSTEP_BEGIN, UINT64_MAX);
    for (uint32_t length = 8; length < 256; length++) {
        frame.length = (uint8_t)length;
        TEST_ASSERT_TRUE(lockstep_decode(&frame, &kind, &value));
        TEST_ASSERT_EQUAL_HEX64(UINT64_MAX, value);
    }
}

/* The results of a text's bytes that are not MORE, a letter each. */
static void feed(lockstep_line_t *line, const char *text, char *seen, berth_can_frame_t *last) {
    for (; *text != '\0'; text++) {
        const lockstep_take_t taken = lockstep_take(line, (uint8_t)*text, last);
        if (taken != LOCKSTEP_MORE) {
            *seen = taken == LOCKSTEP_FRAME ? 'f' : 'g';
            seen++;
        }
    }
    *seen = '\0';
}

static void test_lines(void) {
    char seen[16];
    berth_can_frame_t frame;
    lockstep_line_t line = {.length = 0};
    feed(&line, "\r\rt0292AB01\rT1FFF00070\r", seen, &frame);
    TEST_ASSERT_EQUAL_STRING("ff", seen);
    TEST_ASSERT_EQUAL_HEX32(0x1fff0007u, frame.id);
    feed(&line, "O\rt029\rT1FFF000701\r", seen, &frame);
    TEST_ASSERT_EQUAL_STRING("ggg", seen);
    /* a long line is garbage once, and what follows is good again */
    feed(&line, "T1FFF000181122334455667788TTTTTTTTTTTTTTTTTTTTTTTTTTTTT\rT1FFF000101\rt0290\r",
         seen, &frame);
    TEST_ASSERT_EQUAL_STRING("ggf", seen);
    TEST_ASSERT_EQUAL_HEX32(0x029, frame.id);
    /* in two parts */
    feed(&line, "t02", seen, &frame);
    TEST_ASSERT_EQUAL_STRING("", seen);
    feed(&line, "A0\r", seen, &frame);
    TEST_ASSERT_EQUAL_STRING("f", seen);
    TEST_ASSERT_EQUAL_HEX32(0x02a, frame.id);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_every_number_comes_back);
    RUN_TEST(test_frames_of_the_bus_are_no_control_frames);
    RUN_TEST(test_a_length_beyond_its_range);
    RUN_TEST(test_lines);
    return UNITY_END();
}
