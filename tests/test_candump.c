/* candump's log format: what is written reads back, what can-utils write is read, and nothing else
 * gets through. */
#include "bus/candump.h"
#include "support.h"

#include "unity.h"

#include <stdlib.h>
#include <string.h>

static char why[CANDUMP_WHY_MAX];
static candump_line_t line;

void setUp(void) {}
void tearDown(void) {}

static berth_can_frame_t random_frame(void) {
    berth_can_frame_t frame = {.extended = support_index(2) == 0,
                               .remote = support_index(8) == 0,
                               .length = (uint8_t)support_index(9),
                               .time_us = (int64_t)support_index(1u << 31) * support_index(100000)};
    frame.id =
        support_index(frame.extended ? BERTH_CAN_EXTENDED_MAX + 1u : BERTH_CAN_STANDARD_MAX + 1u);
    for (uint32_t i = 0; i < frame.length && !frame.remote; i++) {
        frame.data[i] = (uint8_t)support_index(256);
    }
    return frame;
}

/* Prints one frame and returns the text, which the caller frees. */
static char *print(const berth_can_frame_t *frame, candump_direction_t direction) {
    char *text = NULL;
    size_t size = 0;
    FILE *file = open_memstream(&text, &size);
    TEST_ASSERT_NOT_NULL(file);
    candump_print(file, "vcan0", frame, direction);
    TEST_ASSERT_EQUAL_INT(0, fclose(file));
    return text;
}

static void test_what_is_written_reads_back(void) {
    support_random_start();
    for (uint32_t i = 0; i < support_runs(50000); i++) {
        const berth_can_frame_t frame = random_frame();
        const candump_direction_t direction = (candump_direction_t)support_index(3);
        char *text = print(&frame, direction);
        TEST_ASSERT_TRUE_MESSAGE(candump_parse(text, &line, why), text);
        free(text);
        TEST_ASSERT_TRUE(candump_same(&frame, &line.frame));
        TEST_ASSERT_EQUAL_INT64(frame.time_us, line.frame.time_us);
        TEST_ASSERT_EQUAL_INT(direction, line.direction);
        TEST_ASSERT_EQUAL_STRING("vcan0", line.channel);
    }
}

static void test_lines_of_can_utils_are_read(void) {
    TEST_ASSERT_TRUE(candump_parse("(1436509053.850870) vcan0 1E5#0102\n", &line, why));
    TEST_ASSERT_EQUAL_INT64(INT64_C(1436509053850870), line.frame.time_us);
    TEST_ASSERT_EQUAL_HEX32(0x1e5, line.frame.id);
    TEST_ASSERT_EQUAL_UINT8(2, line.frame.length);
    TEST_ASSERT_EQUAL_HEX8(0x02, line.frame.data[1]);
    TEST_ASSERT_TRUE(candump_parse("(0000000000.000001) can1 1234ABCD# T", &line, why));
    TEST_ASSERT_TRUE(line.frame.extended);
    TEST_ASSERT_EQUAL_INT(CANDUMP_SENT, line.direction);
    TEST_ASSERT_TRUE(candump_parse("(1.000000) can1 7FF#R", &line, why));
    TEST_ASSERT_TRUE(line.frame.remote);
    TEST_ASSERT_TRUE(candump_parse("(1.000000) can1 001#R8 R", &line, why));
    TEST_ASSERT_EQUAL_UINT8(8, line.frame.length);
    TEST_ASSERT_EQUAL_INT(CANDUMP_RECEIVED, line.direction);
    TEST_ASSERT_TRUE(candump_parse("(1.000000) can1 001#abCD", &line, why));
    TEST_ASSERT_EQUAL_HEX8(0xcd, line.frame.data[1]);
}

static void test_nothing_else_is_read(void) {
    static const char *const lines[] = {
        "",
        "\n",
        "# a comment",
        "1.000000 can0 123#",
        "(1.00000) can0 123#",
        "(1.0000000) can0 123#",
        "(.000000) can0 123#",
        "(-1.000000) can0 123#",
        "(99999999999999.000000) can0 123#",
        "(1.000000)can0 123#",
        "(1.000000) can0",
        "(1.000000)  123#",
        "(1.000000) a-name-that-is-much-too-long-for-a-channel 123#",
        "(1.000000) can0 12#",
        "(1.000000) can0 1234#",
        "(1.000000) can0 800#",
        "(1.000000) can0 20000040#0008000000000000",
        "(1.000000) can0 123",
        "(1.000000) can0 123##112233",
        "(1.000000) can0 123#1",
        "(1.000000) can0 123#0G",
        "(1.000000) can0 123#112233445566778899",
        "(1.000000) can0 123#R9",
        "(1.000000) can0 123#11 X",
        "(1.000000) can0 123#11 RT",
        "(1.000000) can0 123#11  R",
        "(1.000000) can0 123#11 R extra",
    };
    for (size_t i = 0; i < sizeof lines / sizeof lines[0]; i++) {
        const candump_line_t before = line;
        why[0] = '\0';
        TEST_ASSERT_FALSE_MESSAGE(candump_parse(lines[i], &line, why), lines[i]);
        TEST_ASSERT_NOT_NULL_MESSAGE(strstr(why, "allowed"), lines[i]);
        TEST_ASSERT_EQUAL_MEMORY(&before, &line, sizeof line);
    }
}

/* Every line with a character changed either reads as a frame in range or is refused. */
static void test_damaged_lines_do_no_harm(void) {
    support_random_start();
    for (uint32_t i = 0; i < support_runs(100000); i++) {
        const berth_can_frame_t frame = random_frame();
        char *text = print(&frame, CANDUMP_SENT);
        const uint32_t length = (uint32_t)strlen(text);
        for (uint32_t changes = 1 + support_index(3); changes > 0; changes--) {
            text[support_index(length)] = (char)support_index(256);
        }
        if (candump_parse(text, &line, why)) {
            TEST_ASSERT_TRUE(line.frame.length <= 8 && line.frame.time_us >= 0);
            TEST_ASSERT_TRUE(line.frame.id <= (line.frame.extended ? BERTH_CAN_EXTENDED_MAX
                                                                   : BERTH_CAN_STANDARD_MAX));
        }
        free(text);
    }
}

static void test_same_looks_at_all_that_goes_over_the_wire(void) {
    const berth_can_frame_t frame = {.id = 5, .length = 2, .data = {1, 2, 3}, .time_us = 7};
    berth_can_frame_t other = frame;
    other.time_us = 8;
    other.data[2] = 9; /* beyond the length */
    TEST_ASSERT_TRUE(candump_same(&frame, &other));
    other.data[1] = 9;
    TEST_ASSERT_FALSE(candump_same(&frame, &other));
    other = frame;
    other.length = 3;
    TEST_ASSERT_FALSE(candump_same(&frame, &other));
    other = frame;
    other.extended = true;
    TEST_ASSERT_FALSE(candump_same(&frame, &other));
    other = frame;
    other.remote = true;
    TEST_ASSERT_FALSE(candump_same(&frame, &other));
    other = frame;
    other.id = 6;
    TEST_ASSERT_FALSE(candump_same(&frame, &other));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_what_is_written_reads_back);
    RUN_TEST(test_lines_of_can_utils_are_read);
    RUN_TEST(test_nothing_else_is_read);
    RUN_TEST(test_damaged_lines_do_no_harm);
    RUN_TEST(test_same_looks_at_all_that_goes_over_the_wire);
    return UNITY_END();
}
