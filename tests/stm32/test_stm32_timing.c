/* Bit timing: against all timings that there are. */
#include "stm32_can.h"
#include "support.h"

#include "unity.h"

void setUp(void) {}
void tearDown(void) {}

static const stm32_can_limits_t bxcan = {1024, 16, 8, 4};
static const stm32_can_limits_t fdcan = {512, 256, 128, 128};

static bool allowed(uint32_t segment1, uint32_t segment2) {
    const uint32_t quanta = 1u + segment1 + segment2;
    return quanta >= 8 && quanta <= 80 && 8u * (1u + segment1) <= 7u * quanta &&
           4u * (1u + segment1) >= 3u * quanta;
}

static double miss(uint32_t segment1, uint32_t segment2) {
    const double sample = (1.0 + segment1) / (1.0 + segment1 + segment2);
    return sample > 0.8 ? sample - 0.8 : 0.8 - sample;
}

/* The least miss of all timings; 1: there is none. */
static double best_of_all(uint32_t clock_hz, uint32_t rate, const stm32_can_limits_t *limits) {
    double best = 1;
    for (uint32_t segment1 = 1; segment1 <= limits->segment1_max && segment1 < 80; segment1++) {
        for (uint32_t segment2 = 1; segment2 <= limits->segment2_max && segment2 < 80; segment2++) {
            const uint64_t divider = (uint64_t)rate * (1u + segment1 + segment2);
            if (allowed(segment1, segment2) && clock_hz % divider == 0 &&
                clock_hz / divider <= limits->prescaler_max && clock_hz / divider >= 1 &&
                miss(segment1, segment2) < best) {
                best = miss(segment1, segment2);
            }
        }
    }
    return best;
}

static void check(uint32_t clock_hz, uint32_t rate, const stm32_can_limits_t *limits) {
    stm32_can_timing_t t = {77, 77, 77, 77};
    const double best = best_of_all(clock_hz, rate, limits);
    const bool found = stm32_can_timing(clock_hz, rate, limits, &t);
    TEST_ASSERT_EQUAL_INT(best < 1, found);
    if (!found) {
        TEST_ASSERT_EQUAL_UINT32(77, t.prescaler + t.segment1 + t.segment2 + t.jump - 3 * 77);
        return;
    }
    TEST_ASSERT_TRUE(allowed(t.segment1, t.segment2));
    TEST_ASSERT_EQUAL_UINT64(clock_hz,
                             (uint64_t)rate * t.prescaler * (1u + t.segment1 + t.segment2));
    TEST_ASSERT_TRUE(t.prescaler <= limits->prescaler_max);
    TEST_ASSERT_TRUE(t.segment1 <= limits->segment1_max && t.segment2 <= limits->segment2_max);
    TEST_ASSERT_TRUE(t.jump >= 1 && t.jump <= limits->jump_max && t.jump <= t.segment2);
    TEST_ASSERT_TRUE(miss(t.segment1, t.segment2) < best + 1e-9);
}

static void test_common_clocks_at_one_megabit(void) {
    static const uint32_t good[] = {8000000,  16000000, 24000000, 36000000, 40000000,  42000000,
                                    45000000, 48000000, 80000000, 84000000, 160000000, 170000000};
    for (size_t i = 0; i < sizeof good / sizeof good[0]; i++) {
        stm32_can_timing_t t;
        check(good[i], 1000000, &bxcan);
        check(good[i], 1000000, &fdcan);
        TEST_ASSERT_TRUE(stm32_can_timing(good[i], 1000000, &fdcan, &t));
    }
}

static void test_impossible_ones_are_refused(void) {
    stm32_can_timing_t t;
    TEST_ASSERT_FALSE(stm32_can_timing(0, 1000000, &bxcan, &t));
    TEST_ASSERT_FALSE(stm32_can_timing(42000000, 0, &bxcan, &t));
    TEST_ASSERT_FALSE(stm32_can_timing(42000001, 1000000, &bxcan, &t));
    TEST_ASSERT_FALSE(stm32_can_timing(7000000, 1000000, &bxcan, &t));
    TEST_ASSERT_FALSE(stm32_can_timing(37000000, 1000000, &bxcan, &t));
    TEST_ASSERT_FALSE(stm32_can_timing(1000000, 42000000, &bxcan, &t));
    TEST_ASSERT_FALSE(stm32_can_timing(UINT32_MAX, UINT32_MAX, &bxcan, &t));
}

static void test_any_clock_and_rate(void) {
    static const uint32_t rates[] = {10000, 50000, 100000, 125000, 250000, 500000, 800000, 1000000};
    support_random_start();
    for (uint32_t i = 0; i < support_runs(3000); i++) {
        const uint32_t rate = rates[support_index(8)];
        const uint32_t clock_hz = (1u + support_index(180)) * 1000000u;
        check(clock_hz, rate, support_index(2) == 0 ? &bxcan : &fdcan);
    }
}

/* A length beyond 8 breaks the contract; nothing beyond the data is read. */
static void test_packing_reads_eight_bytes_at_most(void) {
    berth_can_frame_t frame = {.data = {1, 2, 3, 4, 5, 6, 7, 8}};
    for (uint32_t length = 0; length < 256; length++) {
        uint32_t words[2] = {0x5a5a5a5a, 0x5a5a5a5a};
        frame.length = (uint8_t)length;
        stm32_can_pack(&frame, words);
        TEST_ASSERT_EQUAL_HEX32(length < 4 ? 0x04030201u & ((1u << 8 * length) - 1u) : 0x04030201u,
                                words[0]);
        TEST_ASSERT_EQUAL_INT(length > 4, words[1] != 0);
        TEST_ASSERT_EQUAL_INT(length >= 8, words[1] == 0x08070605u);
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_common_clocks_at_one_megabit);
    RUN_TEST(test_impossible_ones_are_refused);
    RUN_TEST(test_any_clock_and_rate);
    RUN_TEST(test_packing_reads_eight_bytes_at_most);
    return UNITY_END();
}
