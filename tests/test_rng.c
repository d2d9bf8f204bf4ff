/* The generator: a fixed stream, sound statistics, and a logarithm that is good to the last bits.
 */
#include "rng.h"

#include "unity.h"

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define SEED 20240917u

void setUp(void) {}

void tearDown(void) {}

static int runs(int full) {
    const char *effort = getenv("BERTH_TEST_EFFORT");
    return effort != NULL && strcmp(effort, "short") == 0 ? full / 10 : full;
}

/* Computed by an independent program from the definitions of splitmix64 and xoshiro256**. */
static void test_stream_is_the_published_generator(void) {
    static const struct {
        uint64_t seed;
        uint64_t values[4];
    } golden[] = {
        {0, {0x99ec5f36cb75f2b4, 0xbf6e1f784956452a, 0x1a5f849d4933e6e0, 0x6aa594f1262d2d2c}},
        {12345, {0xbe6a36374160d49b, 0x214aaa0637a688c6, 0xf69d16de9954d388, 0x0c60048c4e96e033}},
        {24690, {0x7b7afa2a9b93ad09, 0xe187105598280c39, 0x96cec06836280f28, 0xa5b45e6d9d57f31e}},
    };
    for (size_t i = 0; i < sizeof golden / sizeof golden[0]; i++) {
        rng_t rng;
        rng_seed(&rng, golden[i].seed);
        for (int k = 0; k < 4; k++) {
            TEST_ASSERT_EQUAL_HEX64(golden[i].values[k], rng_u64(&rng));
        }
    }
}

static void check_bits(double expected, double actual) {
    uint64_t expected_bits;
    uint64_t actual_bits;
    memcpy(&expected_bits, &expected, sizeof expected_bits);
    memcpy(&actual_bits, &actual, sizeof actual_bits);
    TEST_ASSERT_EQUAL_HEX64(expected_bits, actual_bits);
}

/* The same on every compiler, word size and optimisation level. */
static void test_normal_stream_to_the_bit(void) {
    static const double golden[2][4] = {
        {0x1.323a82a4bc9e5p-1, 0x1.76a54f2c0effap+0, -0x1.ca445408b789ap-1, -0x1.81270d2ddbad5p-3},
        {0x1.87d441d454dbfp-2, -0x1.2947ddbdf918cp-1, 0x1.c5bf541d85808p-6, -0x1.f6f030cda551ep-3},
    };
    for (int i = 0; i < 2; i++) {
        rng_t rng;
        rng_seed(&rng, i == 0 ? 0 : 12345);
        for (int k = 0; k < 4; k++) {
            check_bits(golden[i][k], rng_normal(&rng));
        }
    }
}

static void test_uniform_to_the_bit_and_in_range(void) {
    rng_t rng;
    rng_seed(&rng, 0);
    check_bits((double)(0x99ec5f36cb75f2b4 >> 11) * 0x1p-53, rng_uniform(&rng, 0.0, 1.0));
    for (int i = 0; i < runs(1000000); i++) {
        const double value = rng_uniform(&rng, -2.5, 7.0);
        TEST_ASSERT_TRUE(value >= -2.5 && value < 7.0);
    }
    /* here half of the sums round up to the upper end, which is not in the interval */
    const double high = nextafter(1.0, 2.0);
    for (int i = 0; i < 1000; i++) {
        check_bits(1.0, rng_uniform(&rng, 1.0, high));
    }
}

/* Mean, variance, skewness and kurtosis, each within 5 standard errors. */
static void check_moments(const double sums[5], double count, const double expected[5],
                          const double deviation[5]) {
    for (int power = 1; power < 5; power++) {
        const double tolerance = 5.0 * deviation[power] / sqrt(count);
        TEST_ASSERT_DOUBLE_WITHIN(tolerance, expected[power], sums[power] / count);
    }
}

static void test_uniform_moments(void) {
    rng_t rng;
    rng_seed(&rng, SEED);
    double sums[5] = {0.0};
    const int count = runs(4000000);
    for (int i = 0; i < count; i++) {
        const double value = rng_uniform(&rng, -1.0, 1.0);
        double power = 1.0;
        for (int k = 1; k < 5; k++) {
            power *= value;
            sums[k] += power;
        }
    }
    /* E x^n = 1 / (n + 1) for even n; Var x^n = 1 / (2 n + 1) - (E x^n)^2 */
    const double expected[5] = {1.0, 0.0, 1.0 / 3.0, 0.0, 0.2};
    const double deviation[5] = {0.0, sqrt(1.0 / 3.0), sqrt(4.0 / 45.0), sqrt(1.0 / 7.0),
                                 sqrt(16.0 / 225.0)};
    check_moments(sums, count, expected, deviation);
}

static void test_normal_moments_and_tails(void) {
    rng_t rng;
    rng_seed(&rng, SEED + 1);
    double sums[5] = {0.0};
    int beyond[5] = {0}; /* |x| > k */
    double lag = 0.0;
    double last = 0.0;
    const int count = runs(4000000);
    for (int i = 0; i < count; i++) {
        const double value = rng_normal(&rng);
        double power = 1.0;
        for (int k = 1; k < 5; k++) {
            power *= value;
            sums[k] += power;
            beyond[k] += fabs(value) > k ? 1 : 0;
        }
        lag += value * last;
        last = value;
    }
    const double expected[5] = {1.0, 0.0, 1.0, 0.0, 3.0};
    const double deviation[5] = {0.0, 1.0, sqrt(2.0), sqrt(15.0), sqrt(96.0)};
    check_moments(sums, count, expected, deviation);
    TEST_ASSERT_DOUBLE_WITHIN(5.0 / sqrt(count), 0.0, lag / count);
    for (int k = 1; k < 5; k++) {
        const double share = erfc(k / sqrt(2.0));
        const double tolerance = 5.0 * sqrt(share * (1.0 - share) / count);
        TEST_ASSERT_DOUBLE_WITHIN(tolerance, share, (double)beyond[k] / count);
    }
}

/* Chi-square over each of the top 8 bits' values, and over the low 8 that uniform numbers drop. */
static void test_bits_are_even(void) {
    rng_t rng;
    rng_seed(&rng, SEED + 2);
    static int high[256];
    static int low[256];
    const int count = 256 * runs(4000);
    for (int i = 0; i < count; i++) {
        const uint64_t value = rng_u64(&rng);
        high[value >> 56]++;
        low[value & 0xff]++;
    }
    const double mean = count / 256.0;
    double chi_high = 0.0;
    double chi_low = 0.0;
    for (int i = 0; i < 256; i++) {
        chi_high += (high[i] - mean) * (high[i] - mean) / mean;
        chi_low += (low[i] - mean) * (low[i] - mean) / mean;
    }
    /* 255 degrees of freedom: mean 255, standard deviation 22.6 */
    TEST_ASSERT_DOUBLE_WITHIN(5.0 * 22.6, 255.0, chi_high);
    TEST_ASSERT_DOUBLE_WITHIN(5.0 * 22.6, 255.0, chi_low);
}

/* Neighbouring seeds, as a campaign uses them, give unrelated streams. */
static void test_neighbouring_seeds_are_unrelated(void) {
    double product = 0.0;
    const int count = runs(200000);
    for (int i = 0; i < count; i++) {
        rng_t a;
        rng_t b;
        rng_seed(&a, (uint64_t)i);
        rng_seed(&b, (uint64_t)i + 1);
        product += rng_normal(&a) * rng_normal(&b);
    }
    TEST_ASSERT_DOUBLE_WITHIN(5.0 / sqrt(count), 0.0, product / count);
}

/* Two generators do not touch each other, and seeding drops the kept second value of a pair. */
static void test_generators_are_independent(void) {
    rng_t a;
    rng_t b;
    rng_t other;
    rng_seed(&a, 7);
    rng_seed(&b, 7);
    rng_seed(&other, 8);
    for (int i = 0; i < 1000; i++) {
        const double value = rng_normal(&a);
        (void)rng_normal(&other);
        (void)rng_u64(&other);
        check_bits(value, rng_normal(&b));
    }
    (void)rng_normal(&a);
    rng_seed(&a, 7);
    rng_seed(&b, 7);
    check_bits(rng_normal(&b), rng_normal(&a));
}

static void check_log(double x) {
    const double expected = log(x);
    const double unit = nextafter(fabs(expected), HUGE_VAL) - fabs(expected);
    TEST_ASSERT_DOUBLE_WITHIN(2.0 * unit, expected, rng_log(x));
}

static void test_log_is_accurate(void) {
    check_bits(0.0, rng_log(1.0));
    check_log(nextafter(1.0, 0.0));
    check_log(nextafter(1.0, 2.0));
    check_log(0x1p-1022);
    check_log(0x1.fffffffffffffp1023);
    rng_t rng;
    rng_seed(&rng, SEED + 3);
    for (int i = 0; i < runs(1000000); i++) {
        check_log(ldexp(rng_uniform(&rng, 1.0, 2.0), (int)(rng_u64(&rng) % 2044) - 1022));
        check_log(rng_uniform(&rng, 0x1p-53, 1.0));
        check_log(1.0 + ldexp(rng_uniform(&rng, -1.0, 1.0), -(int)(rng_u64(&rng) % 50) - 1));
    }
}

int main(void) {
    printf("seed %u\n", SEED);
    UNITY_BEGIN();
    RUN_TEST(test_stream_is_the_published_generator);
    RUN_TEST(test_normal_stream_to_the_bit);
    RUN_TEST(test_uniform_to_the_bit_and_in_range);
    RUN_TEST(test_uniform_moments);
    RUN_TEST(test_normal_moments_and_tails);
    RUN_TEST(test_bits_are_even);
    RUN_TEST(test_neighbouring_seeds_are_unrelated);
    RUN_TEST(test_generators_are_independent);
    RUN_TEST(test_log_is_accurate);
    return UNITY_END();
}
