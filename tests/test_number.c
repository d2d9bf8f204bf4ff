/* Strict numbers: what is read, what is refused, and that writing is exact. */
#include "number.h"
#include "unity.h"

#include <float.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "rng.h"

#define SEED 271828u

void setUp(void) {}

void tearDown(void) {}

static void test_numbers_that_are_read(void) {
    static const struct {
        const char *text;
        double value;
    } good[] = {
        {"0", 0.0},
        {"-0", -0.0},
        {"1", 1.0},
        {"+1", 1.0},
        {"-2.5", -2.5},
        {".5", 0.5},
        {"5.", 5.0},
        {"1e3", 1000.0},
        {"1E-3", 0.001},
        {"1.5e+2", 150.0},
        {"007", 7.0},
        {"0.1", 0.1},
        {"1e-400", 0.0},
        {"1.7976931348623157e308", DBL_MAX},
        {"4.9e-324", 4.9e-324},
    };
    for (size_t i = 0; i < sizeof good / sizeof good[0]; i++) {
        double value = 42.0;
        TEST_ASSERT_TRUE_MESSAGE(number_parse(good[i].text, &value), good[i].text);
        TEST_ASSERT_EQUAL_MEMORY_MESSAGE(&good[i].value, &value, sizeof value, good[i].text);
    }
}

static void test_texts_that_are_no_numbers(void) {
    static const char *const bad[] = {
        "",     " ",        " 1",   "1 ",    "1\n",  "2.7m",  "nan",      "NaN",    "inf",
        "-inf", "infinity", "0x10", "0x1p3", "1e",   "1e+",   "e5",       ".",      "-",
        "+",    "+-1",      "--1",  "1.2.3", "1,5",  "1_000", "1e5.0",    "1e999",  "-1e999",
        "0b1",  "1f",       "1d0",  "1:30",  "true", "1e1e1", "\xD9\xA1", "nan(1)",
    };
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        double value = 42.0;
        TEST_ASSERT_FALSE_MESSAGE(number_parse(bad[i], &value), bad[i]);
        TEST_ASSERT_TRUE_MESSAGE(value == 42.0, bad[i]);
    }
}

static void test_lists(void) {
    double values[3] = {0.0, 0.0, 0.0};
    TEST_ASSERT_TRUE(number_parse_list("10,40,1", values, 3));
    TEST_ASSERT_TRUE(values[0] == 10.0 && values[1] == 40.0 && values[2] == 1.0);
    TEST_ASSERT_TRUE(number_parse_list(" 1 , -2e1,  3 ", values, 3));
    TEST_ASSERT_TRUE(values[0] == 1.0 && values[1] == -20.0 && values[2] == 3.0);
    TEST_ASSERT_TRUE(number_parse_list("7", values, 1));
    TEST_ASSERT_TRUE(values[0] == 7.0 && values[1] == -20.0);
}

static void test_texts_that_are_no_lists(void) {
    static const char *const bad[] = {
        "",      "1,2",   "1,2,3,4", "1,2,3,",  ",1,2",    "1,,2",
        "1;2;3", "1 2 3", "1,2,x",   "1,2,3 4", "[1,2,3]",
    };
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        double values[3] = {42.0, 42.0, 42.0};
        TEST_ASSERT_FALSE_MESSAGE(number_parse_list(bad[i], values, 3), bad[i]);
        TEST_ASSERT_TRUE_MESSAGE(values[0] == 42.0 && values[2] == 42.0, bad[i]);
    }
}

static void test_long_elements_are_refused(void) {
    char text[200];
    double value = 42.0;
    memset(text, '1', sizeof text);
    text[sizeof text - 1] = '\0';
    TEST_ASSERT_FALSE(number_parse_list(text, &value, 1));
}

static void test_ranges_in_words(void) {
    char text[NUMBER_RANGE_TEXT_MAX];
    number_range_text(0.001, 1.0, text, sizeof text);
    TEST_ASSERT_EQUAL_STRING("0.001 to 1", text);
    number_range_text(-1000.0, 1e6, text, sizeof text);
    TEST_ASSERT_EQUAL_STRING("-1000 to 1000000", text);
    number_range_text(0.04, (double)INFINITY, text, sizeof text);
    TEST_ASSERT_EQUAL_STRING("at least 0.04", text);
}

static void test_writing_is_short_where_it_can_be(void) {
    char text[NUMBER_TEXT_MAX];
    number_text(0.1, text, sizeof text);
    TEST_ASSERT_EQUAL_STRING("0.1", text);
    number_text(-0.25, text, sizeof text);
    TEST_ASSERT_EQUAL_STRING("-0.25", text);
    number_text(0.1 + 0.2, text, sizeof text);
    TEST_ASSERT_EQUAL_STRING("0.30000000000000004", text);
}

static void test_what_is_written_reads_back_to_the_same_bits(void) {
    rng_t rng;
    rng_seed(&rng, SEED);
    printf("seed %u\n", SEED);
    for (int i = 0; i < 100000; i++) {
        char text[NUMBER_TEXT_MAX];
        const uint64_t bits = rng_u64(&rng);
        double value = 0.0;
        double back = 0.0;
        memcpy(&value, &bits, sizeof value);
        if (!isfinite(value)) {
            continue;
        }
        number_text(value, text, sizeof text);
        TEST_ASSERT_TRUE_MESSAGE(number_parse(text, &back), text);
        TEST_ASSERT_EQUAL_MEMORY_MESSAGE(&value, &back, sizeof value, text);
    }
}

static void check_count(const char *text, uint64_t maximum, bool good, uint64_t expected) {
    uint64_t value = 4711;
    TEST_ASSERT_EQUAL_MESSAGE(good, number_parse_count(text, maximum, &value), text);
    TEST_ASSERT_EQUAL_UINT64_MESSAGE(good ? expected : 4711, value, text);
}

static void test_counts_are_plain_digits_up_to_their_maximum(void) {
    check_count("0", 0, true, 0);
    check_count("007", 10, true, 7);
    check_count("254", 254, true, 254);
    check_count("255", 254, false, 0);
    check_count("2540", 254, false, 0);
    check_count("18446744073709551615", UINT64_MAX, true, UINT64_MAX);
    check_count("18446744073709551616", UINT64_MAX, false, 0);
    check_count("99999999999999999999999", UINT64_MAX, false, 0);
    const char *const bad[] = {"", " 1", "1 ", "+1", "-1", "1e3", "1.0", "0x10", "1a", "a"};
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        check_count(bad[i], UINT64_MAX, false, 0);
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_numbers_that_are_read);
    RUN_TEST(test_texts_that_are_no_numbers);
    RUN_TEST(test_lists);
    RUN_TEST(test_texts_that_are_no_lists);
    RUN_TEST(test_long_elements_are_refused);
    RUN_TEST(test_ranges_in_words);
    RUN_TEST(test_writing_is_short_where_it_can_be);
    RUN_TEST(test_what_is_written_reads_back_to_the_same_bits);
    RUN_TEST(test_counts_are_plain_digits_up_to_their_maximum);
    return UNITY_END();
}
