/* The plan's samples and its clock: on time, early, late, very late, wrapping and ending. */
#include "support.h"

#include "unity.h"

#include <stdio.h>
#include <string.h>

#define T ((int64_t)50000)
#define COUNT 7u

static support_plan_t open_plan;
static support_plan_t closed_plan;

void setUp(void) {
    support_plan(&open_plan, SUPPORT_CIRCLE, COUNT, false);
    support_plan(&closed_plan, SUPPORT_CIRCLE, COUNT, true);
}

void tearDown(void) {}

static berth_reference_t started(const support_plan_t *plan, int64_t now_us) {
    berth_reference_t reference;
    memset(&reference, 0xa5, sizeof reference); /* start must set every field */
    berth_reference_start(&reference, &plan->plan, now_us);
    return reference;
}

static void check(const berth_reference_t *reference, uint32_t index, uint32_t total,
                  uint32_t skipped, bool finished) {
    TEST_ASSERT_EQUAL_UINT32_MESSAGE(index, reference->index, "index");
    TEST_ASSERT_EQUAL_UINT32_MESSAGE(total, reference->total, "total");
    TEST_ASSERT_EQUAL_UINT32_MESSAGE(skipped, reference->skipped, "skipped");
    TEST_ASSERT_EQUAL_MESSAGE(finished, reference->finished, "finished");
}

static void check_same_row(const berth_sample_t *expected, const berth_sample_t *actual) {
    TEST_ASSERT_EQUAL_MEMORY(expected, actual, sizeof *expected);
}

static void test_sample_within_the_plan(void) {
    for (uint32_t k = 0; k < COUNT; k++) {
        const berth_sample_t in_open = berth_plan_sample(&open_plan.plan, k);
        const berth_sample_t in_closed = berth_plan_sample(&closed_plan.plan, k);
        check_same_row(&open_plan.samples[k], &in_open);
        check_same_row(&closed_plan.samples[k], &in_closed);
    }
}

static void test_sample_beyond_an_open_plan_holds_the_last_pose(void) {
    const uint32_t beyond[] = {COUNT, COUNT + 1, 2 * COUNT, 1000000u, UINT32_MAX};
    berth_sample_t hold = open_plan.samples[COUNT - 1];
    hold.v_mps = 0.0f;
    hold.omega_radps = 0.0f;
    for (size_t i = 0; i < sizeof beyond / sizeof beyond[0]; i++) {
        const berth_sample_t sample = berth_plan_sample(&open_plan.plan, beyond[i]);
        check_same_row(&hold, &sample);
    }
}

static void test_sample_of_a_closed_plan_wraps(void) {
    const uint32_t beyond[] = {COUNT, COUNT + 1, 3 * COUNT - 1, 1000000u, UINT32_MAX};
    for (size_t i = 0; i < sizeof beyond / sizeof beyond[0]; i++) {
        const berth_sample_t sample = berth_plan_sample(&closed_plan.plan, beyond[i]);
        check_same_row(&closed_plan.samples[beyond[i] % COUNT], &sample);
    }
}

static void test_single_sample_plans(void) {
    support_plan_t *plan = &open_plan;
    plan->plan.count = 1;
    berth_reference_t reference = started(plan, 0);
    check(&reference, 0, 0, 0, false);
    berth_reference_advance(&reference, &plan->plan, T);
    check(&reference, 1, 1, 0, true);
    plan->plan.closed = true;
    reference = started(plan, 0);
    berth_reference_advance(&reference, &plan->plan, 5 * T);
    check(&reference, 0, 5, 4, false);
}

static void test_on_time_steps_go_one_by_one(void) {
    const int64_t starts[] = {0, 1, 123456789, BERTH_TIME_MAX_US - 100 * T};
    for (size_t i = 0; i < sizeof starts / sizeof starts[0]; i++) {
        berth_reference_t reference = started(&closed_plan, starts[i]);
        for (uint32_t k = 0; k < 3 * COUNT; k++) {
            berth_reference_advance(&reference, &closed_plan.plan, starts[i] + (int64_t)k * T);
            check(&reference, k % COUNT, k, 0, false);
        }
    }
}

/* The nearest sample in time: the boundary is half a period either side, for odd periods too. */
static void test_half_a_period_is_the_boundary(void) {
    const uint32_t periods[] = {1000, 1001, 50000, 99999, 1000000};
    for (size_t i = 0; i < sizeof periods / sizeof periods[0]; i++) {
        const int64_t period = periods[i];
        closed_plan.plan.period_us = periods[i];
        for (int64_t offset = -(period - 1) / 2; offset <= (period - 1) / 2;
             offset += (period - 1) / 2) {
            berth_reference_t reference = started(&closed_plan, 10);
            for (uint32_t k = 1; k < 20; k++) {
                const int64_t now_us = 10 + (int64_t)k * period + offset;
                berth_reference_advance(&reference, &closed_plan.plan, now_us);
                check(&reference, k % COUNT, k, 0, false);
            }
            berth_reference_advance(&reference, &closed_plan.plan,
                                    10 + 20 * period + (period + 1) / 2);
            check(&reference, 21 % COUNT, 21, 1, false);
        }
    }
}

static void test_repeated_time_keeps_the_sample(void) {
    berth_reference_t reference = started(&open_plan, 0);
    for (int i = 0; i < 5; i++) {
        berth_reference_advance(&reference, &open_plan.plan, T);
        check(&reference, 1, 1, 0, false);
    }
}

static void test_a_late_step_skips_and_counts(void) {
    berth_reference_t reference = started(&closed_plan, 0);
    berth_reference_advance(&reference, &closed_plan.plan, 4 * T);
    check(&reference, 4, 4, 3, false);
    berth_reference_advance(&reference, &closed_plan.plan, 5 * T);
    check(&reference, 5, 5, 3, false);
    berth_reference_advance(&reference, &closed_plan.plan, 100 * T + T / 2 - 1);
    check(&reference, 100 % COUNT, 100, 97, false);
    berth_reference_advance(&reference, &closed_plan.plan, 101 * T - T / 2);
    check(&reference, 101 % COUNT, 101, 97, false);
}

/* Past 2^32 microseconds the lateness no longer fits 32 bits. */
static void test_hours_and_days_late(void) {
    const int64_t lates[] = {
        ((int64_t)1 << 32) - 1,  (int64_t)1 << 32,         ((int64_t)1 << 32) + 1,
        (int64_t)3600 * 1000000, (int64_t)86400 * 1000000, (int64_t)30 * 86400 * 1000000,
    };
    for (size_t i = 0; i < sizeof lates / sizeof lates[0]; i++) {
        const uint32_t nearest = (uint32_t)((lates[i] + T / 2) / T);
        berth_reference_t reference = started(&closed_plan, 77);
        berth_reference_advance(&reference, &closed_plan.plan, 77 + lates[i]);
        check(&reference, nearest % COUNT, nearest, nearest - 1, false);
        /* and goes on from there in step */
        const int64_t next_us = 77 + (int64_t)(nearest + 1u) * T;
        berth_reference_advance(&reference, &closed_plan.plan, next_us);
        check(&reference, (nearest + 1) % COUNT, nearest + 1, nearest - 1, false);
    }
}

/* Against plain division, from a microsecond to thousands of years, and nothing accumulates. */
static void test_late_by_any_amount_matches_division(void) {
    support_random_start();
    for (uint32_t run = 0; run < support_runs(200000); run++) {
        const uint32_t period = 1000u + support_index(999001u);
        closed_plan.plan.period_us = period;
        const int64_t start_us = (int64_t)support_log_uniform(1.0, 1.0e18);
        const double longest = run % 2 == 0 ? 1.0e9 : 8.0e17;
        berth_reference_t reference = started(&closed_plan, start_us);
        int64_t now_us = start_us;
        uint64_t before = 0;
        uint64_t skipped = 0;
        for (int step = 0; step < 4; step++) {
            now_us += (int64_t)support_log_uniform(1.0, longest);
            berth_reference_advance(&reference, &closed_plan.plan, now_us);
            const uint64_t nearest = (uint64_t)(now_us - start_us + period / 2) / period;
            skipped += nearest > before ? nearest - before - 1u : 0u;
            before = nearest;
            check(&reference, (uint32_t)(nearest % COUNT), (uint32_t)nearest,
                  skipped > UINT32_MAX ? UINT32_MAX : (uint32_t)skipped, false);
        }
    }
}

static void test_jitter_never_skips_or_repeats(void) {
    support_random_start();
    berth_reference_t reference = started(&closed_plan, 0);
    for (uint32_t k = 1; k <= 100000; k++) {
        const int64_t jitter = (int64_t)support_uniform(-0.49 * (double)T, 0.49 * (double)T);
        berth_reference_advance(&reference, &closed_plan.plan, (int64_t)k * T + jitter);
        check(&reference, k % COUNT, k, 0, false);
    }
}

static void test_closed_wraps_over_many_laps(void) {
    berth_reference_t reference = started(&closed_plan, 5);
    for (uint32_t k = 1; k <= 1000 * COUNT; k++) {
        berth_reference_advance(&reference, &closed_plan.plan, 5 + (int64_t)k * T);
        TEST_ASSERT_EQUAL_UINT32(k % COUNT, reference.index);
    }
    check(&reference, 0, 1000 * COUNT, 0, false);
}

static void test_open_finishes_and_stays_finished(void) {
    berth_reference_t reference = started(&open_plan, 0);
    for (uint32_t k = 0; k < COUNT; k++) {
        berth_reference_advance(&reference, &open_plan.plan, (int64_t)k * T);
        check(&reference, k, k, 0, false);
    }
    for (uint32_t k = COUNT; k < 10 * COUNT; k++) {
        berth_reference_advance(&reference, &open_plan.plan, (int64_t)k * T);
        check(&reference, COUNT, k, 0, true);
    }
    berth_reference_advance(&reference, &open_plan.plan, (int64_t)1 << 50);
    TEST_ASSERT_EQUAL_UINT32(COUNT, reference.index);
    TEST_ASSERT_TRUE(reference.finished);
}

static void test_open_finishes_in_one_late_step(void) {
    berth_reference_t reference = started(&open_plan, 0);
    berth_reference_advance(&reference, &open_plan.plan, (int64_t)COUNT * T - T / 2 - 1);
    check(&reference, COUNT - 1, COUNT - 1, COUNT - 2, false);
    reference = started(&open_plan, 0);
    berth_reference_advance(&reference, &open_plan.plan, (int64_t)COUNT * T - T / 2);
    check(&reference, COUNT, COUNT, COUNT - 1, true);
}

/* total counts modulo 2^32: 6.8 years of 50 ms periods, 50 days of 1 ms ones. The index must not
 * notice, whether the step over the wrap is a single one or a late one. */
static void test_total_wraps(void) {
    berth_reference_t reference = started(&closed_plan, 0);
    reference.total = UINT32_MAX;
    reference.index = 3;
    berth_reference_advance(&reference, &closed_plan.plan, T);
    check(&reference, 4, 0, 0, false);
    reference.total = UINT32_MAX - 2;
    berth_reference_advance(&reference, &closed_plan.plan, 11 * T);
    check(&reference, 14 % COUNT, 7, 9, false);
}

static void test_more_than_2_to_the_32_samples_late(void) {
    closed_plan.plan.period_us = 1000;
    berth_reference_t reference = started(&closed_plan, 0);
    const uint64_t samples = ((uint64_t)3 << 32) + 12345u;
    berth_reference_advance(&reference, &closed_plan.plan, (int64_t)(samples * 1000u));
    check(&reference, (uint32_t)(samples % COUNT), 12345u, UINT32_MAX, false);
    berth_reference_advance(&reference, &closed_plan.plan, (int64_t)((samples + 9u) * 1000u));
    check(&reference, (uint32_t)((samples + 9u) % COUNT), 12354u, UINT32_MAX, false);
}

static void test_skipped_saturates(void) {
    berth_reference_t reference = started(&closed_plan, 0);
    reference.skipped = UINT32_MAX - 1;
    berth_reference_advance(&reference, &closed_plan.plan, 2 * T);
    check(&reference, 2, 2, UINT32_MAX, false);
    berth_reference_advance(&reference, &closed_plan.plan, 9 * T);
    check(&reference, 2, 9, UINT32_MAX, false);
}

static void test_time_backwards_leaves_all_as_it_is(void) {
    berth_reference_t reference = started(&closed_plan, 1000 * T);
    berth_reference_advance(&reference, &closed_plan.plan, 1005 * T);
    const berth_reference_t before = reference;
    const int64_t backwards[] = {1004 * T, 1000 * T, 999 * T, 1, 0};
    for (size_t i = 0; i < sizeof backwards / sizeof backwards[0]; i++) {
        berth_reference_advance(&reference, &closed_plan.plan, backwards[i]);
        TEST_ASSERT_EQUAL_INT64(before.next_us, reference.next_us);
        check(&reference, before.index, before.total, before.skipped, before.finished);
    }
    berth_reference_advance(&reference, &closed_plan.plan, 1006 * T);
    check(&reference, 6, 6, 4, false);
}

static void test_the_largest_times(void) {
    const uint32_t periods[] = {1000, 50000, 1000000};
    for (size_t i = 0; i < sizeof periods / sizeof periods[0]; i++) {
        closed_plan.plan.period_us = periods[i];
        berth_reference_t reference = started(&closed_plan, BERTH_TIME_MAX_US);
        berth_reference_advance(&reference, &closed_plan.plan, BERTH_TIME_MAX_US);
        check(&reference, 0, 0, 0, false);
        reference = started(&closed_plan, 0);
        berth_reference_advance(&reference, &closed_plan.plan, BERTH_TIME_MAX_US);
        const uint64_t samples = ((uint64_t)BERTH_TIME_MAX_US + periods[i] / 2u) / periods[i];
        TEST_ASSERT_EQUAL_UINT32(samples % COUNT, reference.index);
        TEST_ASSERT_EQUAL_UINT32((uint32_t)samples, reference.total);
        TEST_ASSERT_TRUE(reference.next_us > BERTH_TIME_MAX_US);
        TEST_ASSERT_TRUE(reference.next_us <= BERTH_TIME_MAX_US + (int64_t)periods[i]);
    }
}

/* A late step on an open plan, from random places: never past count, finished exactly at it. */
static void test_open_plan_index_never_passes_count(void) {
    support_random_start();
    for (uint32_t run = 0; run < support_runs(20000); run++) {
        berth_reference_t reference = started(&open_plan, 0);
        int64_t now_us = 0;
        for (int step = 0; step < 6; step++) {
            now_us += (int64_t)support_log_uniform(1000.0, 1.0e7);
            berth_reference_advance(&reference, &open_plan.plan, now_us);
            const int64_t nearest = (now_us + T / 2) / T;
            const bool ended = nearest >= COUNT;
            TEST_ASSERT_EQUAL_UINT32(ended ? COUNT : (uint32_t)nearest, reference.index);
            TEST_ASSERT_EQUAL(ended, reference.finished);
        }
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_sample_within_the_plan);
    RUN_TEST(test_sample_beyond_an_open_plan_holds_the_last_pose);
    RUN_TEST(test_sample_of_a_closed_plan_wraps);
    RUN_TEST(test_single_sample_plans);
    RUN_TEST(test_on_time_steps_go_one_by_one);
    RUN_TEST(test_half_a_period_is_the_boundary);
    RUN_TEST(test_repeated_time_keeps_the_sample);
    RUN_TEST(test_a_late_step_skips_and_counts);
    RUN_TEST(test_hours_and_days_late);
    RUN_TEST(test_late_by_any_amount_matches_division);
    RUN_TEST(test_jitter_never_skips_or_repeats);
    RUN_TEST(test_closed_wraps_over_many_laps);
    RUN_TEST(test_open_finishes_and_stays_finished);
    RUN_TEST(test_open_finishes_in_one_late_step);
    RUN_TEST(test_total_wraps);
    RUN_TEST(test_more_than_2_to_the_32_samples_late);
    RUN_TEST(test_skipped_saturates);
    RUN_TEST(test_time_backwards_leaves_all_as_it_is);
    RUN_TEST(test_the_largest_times);
    RUN_TEST(test_open_plan_index_never_passes_count);
    return UNITY_END();
}
