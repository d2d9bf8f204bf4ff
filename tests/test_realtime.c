/* realtime: the histogram's arithmetic, waits that are never short, and stamps on one clock. */
#include "realtime.h"
#include "stamp.h"
#include "support.h"

#include "unity.h"

#include <errno.h>
#include <math.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

static realtime_histogram_t histogram;
static realtime_t timer;

void setUp(void) {
    memset(&histogram, 0, sizeof histogram);
}

void tearDown(void) {}

/* ---- Histogram ---------------------------------------------------------------------------------
 */

static uint32_t bin_with(int64_t value) {
    realtime_histogram_t one = {0};
    realtime_histogram_add(&one, value);
    TEST_ASSERT_EQUAL_UINT64(1, one.count);
    for (uint32_t bin = 0; bin < REALTIME_BINS; bin++) {
        if (one.bins[bin] != 0u) {
            TEST_ASSERT_EQUAL_UINT64(1, one.bins[bin]);
            return bin;
        }
    }
    TEST_FAIL_MESSAGE("in no bin");
    return 0;
}

static void test_bins_join_without_gaps(void) {
    TEST_ASSERT_EQUAL_INT64(0, realtime_bin_low_us(0));
    TEST_ASSERT_EQUAL_INT64(15, realtime_bin_low_us(15));
    TEST_ASSERT_EQUAL_INT64(16, realtime_bin_low_us(16));
    TEST_ASSERT_EQUAL_INT64(18, realtime_bin_low_us(17));
    TEST_ASSERT_EQUAL_INT64(1 << 24, realtime_bin_low_us(REALTIME_BINS - 1u));
    for (uint32_t bin = 1; bin < REALTIME_BINS; bin++) {
        const int64_t low_us = realtime_bin_low_us(bin);
        TEST_ASSERT_EQUAL_UINT32(bin, bin_with(low_us));
        TEST_ASSERT_EQUAL_UINT32(bin - 1u, bin_with(low_us - 1));
        const int64_t width_us = low_us - realtime_bin_low_us(bin - 1u);
        TEST_ASSERT_TRUE(width_us == 1 || width_us * 8 <= realtime_bin_low_us(bin - 1u));
    }
    TEST_ASSERT_EQUAL_UINT32(REALTIME_BINS - 1u, bin_with(INT64_MAX));
    TEST_ASSERT_EQUAL_UINT32(0, bin_with(-1));
    TEST_ASSERT_EQUAL_UINT32(0, bin_with(INT64_MIN));
}

static void test_small_quantiles_are_exact(void) {
    TEST_ASSERT_EQUAL_INT64(0, realtime_histogram_quantile(&histogram, 0.5));
    for (int64_t value = 1; value <= 10; value++) {
        realtime_histogram_add(&histogram, value);
    }
    TEST_ASSERT_EQUAL_UINT64(10, histogram.count);
    TEST_ASSERT_EQUAL_INT64(10, histogram.max_us);
    TEST_ASSERT_EQUAL_INT64(1, realtime_histogram_quantile(&histogram, 0.0));
    TEST_ASSERT_EQUAL_INT64(1, realtime_histogram_quantile(&histogram, 0.1));
    TEST_ASSERT_EQUAL_INT64(2, realtime_histogram_quantile(&histogram, 0.11));
    TEST_ASSERT_EQUAL_INT64(5, realtime_histogram_quantile(&histogram, 0.5));
    TEST_ASSERT_EQUAL_INT64(10, realtime_histogram_quantile(&histogram, 0.99));
    TEST_ASSERT_EQUAL_INT64(10, realtime_histogram_quantile(&histogram, 1.0));
    TEST_ASSERT_EQUAL_INT64(10, realtime_histogram_quantile(&histogram, 2.0));
    TEST_ASSERT_EQUAL_INT64(1, realtime_histogram_quantile(&histogram, (double)NAN));
}

static int ascending(const void *a, const void *b) {
    const int64_t x = *(const int64_t *)a;
    const int64_t y = *(const int64_t *)b;
    return (x > y) - (x < y);
}

static void test_quantiles_are_within_an_eighth(void) {
    static int64_t values[1000];
    support_random_start();
    for (uint32_t round = 0; round < support_runs(200); round++) {
        memset(&histogram, 0, sizeof histogram);
        const uint32_t count = 1u + support_index(1000);
        for (uint32_t i = 0; i < count; i++) {
            values[i] = (int64_t)support_log_uniform(1.0, 1e7);
            realtime_histogram_add(&histogram, values[i]);
        }
        qsort(values, count, sizeof values[0], ascending);
        for (uint32_t percent = 1; percent <= 100u; percent++) {
            const int64_t want = values[(count * percent + 99u) / 100u - 1u];
            const int64_t got = realtime_histogram_quantile(&histogram, percent / 100.0);
            TEST_ASSERT_TRUE(got >= want);
            TEST_ASSERT_TRUE(got <= want + want / 8);
        }
        TEST_ASSERT_EQUAL_INT64(values[count - 1u], histogram.max_us);
    }
}

static void test_printed(void) {
    char text[512] = "";
    FILE *out = fmemopen(text, sizeof text, "w");
    TEST_ASSERT_NOT_NULL(out);
    realtime_histogram_add(&histogram, 3);
    realtime_histogram_add(&histogram, 3);
    realtime_histogram_add(&histogram, 1000);
    realtime_histogram_print(&histogram, out);
    (void)fclose(out);
    TEST_ASSERT_EQUAL_STRING("late_us: count 3, median 3, p99 1000, max 1000\n"
                             "         3 us and more: 2\n"
                             "       960 us and more: 1\n",
                             text);
}

/* ---- Waiting -----------------------------------------------------------------------------------
 */

static int pipe_fd(void *context) {
    return *(const int *)context;
}

static void test_waits_are_never_short(void) {
    realtime_init(&timer, NULL);
    const berth_clock_t clock = realtime_clock(&timer);
    const int64_t start_us = clock.api->now_us(clock.context);
    for (int64_t i = 1; i <= 100; i++) {
        const int64_t deadline_us = start_us + i * 2000;
        const bool future = deadline_us > clock.api->now_us(clock.context);
        clock.api->sleep_until_us(clock.context, deadline_us);
        TEST_ASSERT_TRUE(clock.api->now_us(clock.context) >= deadline_us);
        TEST_ASSERT_TRUE(future || timer.past > 0u);
    }
    TEST_ASSERT_EQUAL_UINT64(100, timer.late.count + timer.past);
    TEST_ASSERT_TRUE(timer.late.count > 0u);
    TEST_ASSERT_EQUAL_UINT64(0, timer.early);
    TEST_ASSERT_TRUE(timer.late.max_us < 5000000);
    realtime_print(&timer, stdout);
}

static void test_deadlines_in_the_past_return_at_once(void) {
    realtime_init(&timer, NULL);
    const berth_clock_t clock = realtime_clock(&timer);
    const int64_t before_us = realtime_now_us();
    clock.api->sleep_until_us(clock.context, before_us - 1000);
    clock.api->sleep_until_us(clock.context, 0);
    clock.api->sleep_until_us(clock.context, INT64_MIN);
    TEST_ASSERT_TRUE(realtime_now_us() - before_us < 1000000);
    TEST_ASSERT_EQUAL_UINT64(3, timer.past);
    TEST_ASSERT_TRUE(timer.past_max_us >= before_us);
    TEST_ASSERT_EQUAL_UINT64(0, timer.late.count);
}

static void test_something_to_receive_cuts_a_wait(void) {
    int ends[2];
    TEST_ASSERT_EQUAL_INT(0, pipe(ends));
    const realtime_wait_t wait = {pipe_fd, &ends[0]};
    realtime_init(&timer, &wait);
    const berth_clock_t clock = realtime_clock(&timer);
    int64_t before_us = realtime_now_us();
    clock.api->sleep_until_us(clock.context, before_us + 20000); /* nothing there */
    TEST_ASSERT_TRUE(realtime_now_us() >= before_us + 20000);
    TEST_ASSERT_EQUAL_UINT64(1, timer.late.count);
    TEST_ASSERT_EQUAL_INT(1, write(ends[1], "x", 1));
    before_us = realtime_now_us();
    clock.api->sleep_until_us(clock.context, INT64_MAX);
    TEST_ASSERT_TRUE(realtime_now_us() - before_us < 2000000);
    TEST_ASSERT_EQUAL_UINT64(1, timer.early);
    TEST_ASSERT_EQUAL_UINT64(1, timer.late.count);
    (void)close(ends[0]);
    (void)close(ends[1]);
}

static void test_a_descriptor_that_only_fails_does_not_spin(void) {
    int ends[2];
    TEST_ASSERT_EQUAL_INT(0, pipe(ends));
    (void)close(ends[1]); /* the reader sees a hang-up and nothing to read */
    const realtime_wait_t wait = {pipe_fd, &ends[0]};
    realtime_init(&timer, &wait);
    const berth_clock_t clock = realtime_clock(&timer);
    const int64_t end_us = realtime_now_us() + 50000;
    uint32_t waits = 0;
    while (realtime_now_us() < end_us) {
        clock.api->sleep_until_us(clock.context, end_us);
        waits++;
    }
    TEST_ASSERT_TRUE(waits <= 60u);
    (void)close(ends[0]);
    ends[0] = -1; /* none now */
    const int64_t before_us = realtime_now_us();
    clock.api->sleep_until_us(clock.context, before_us + 5000);
    TEST_ASSERT_TRUE(realtime_now_us() >= before_us + 5000);
}

/* ---- Rights ------------------------------------------------------------------------------------
 */

static void print_rights(const realtime_rights_t *rights, char *text, size_t size) {
    FILE *out = fmemopen(text, size, "w");
    TEST_ASSERT_NOT_NULL(out);
    realtime_rights_print(rights, out);
    (void)fclose(out);
}

static void test_rights_are_granted_or_refused_with_a_reason(void) {
    char text[256] = "";
    realtime_rights_t rights = realtime_ask(0, false);
    TEST_ASSERT_EQUAL_INT(0, rights.priority + rights.priority_errno + rights.locked_errno);
    TEST_ASSERT_FALSE(rights.locked);
    print_rights(&rights, text, sizeof text);
    TEST_ASSERT_EQUAL_STRING(
        "scheduling: SCHED_FIFO not asked for\nmemory: locking not asked for\n", text);
    rights = realtime_ask(1000, false);
    TEST_ASSERT_EQUAL_INT(0, rights.priority);
    TEST_ASSERT_EQUAL_INT(EINVAL, rights.priority_errno);
    rights = realtime_ask(1, true);
    const bool fifo = sched_getscheduler(0) == SCHED_FIFO;
    TEST_ASSERT_EQUAL_INT(fifo ? 1 : 0, rights.priority);
    TEST_ASSERT_EQUAL_INT(fifo, rights.priority_errno == 0);
    TEST_ASSERT_EQUAL_INT(rights.locked, rights.locked_errno == 0);
    print_rights(&rights, text, sizeof text);
    fputs(text, stdout);
    TEST_ASSERT_EQUAL_INT(fifo, strstr(text, "SCHED_FIFO, priority 1") != NULL);
    const struct sched_param normal = {.sched_priority = 0};
    (void)sched_setscheduler(0, SCHED_OTHER, &normal);
    (void)munlockall();
    rights = (realtime_rights_t){.priority_errno = EPERM, .locked_errno = ENOMEM};
    print_rights(&rights, text, sizeof text);
    TEST_ASSERT_EQUAL_STRING("scheduling: SCHED_FIFO refused (Operation not permitted)\n"
                             "memory: locking refused (Cannot allocate memory)\n",
                             text);
}

/* ---- Stamps ------------------------------------------------------------------------------------
 */

static void test_wall_stamps(void) {
    const int64_t wall_us = INT64_C(1700000000) * 1000000;
    TEST_ASSERT_EQUAL_INT64(4990, stamp_from_wall(wall_us - 10, wall_us, 5000));
    TEST_ASSERT_EQUAL_INT64(5000, stamp_from_wall(wall_us, wall_us, 5000));
    TEST_ASSERT_EQUAL_INT64(5000, stamp_from_wall(wall_us + 1, wall_us, 5000)); /* clock set back */
    TEST_ASSERT_EQUAL_INT64(0, stamp_from_wall(wall_us - 6000, wall_us, 5000));
    const int64_t late_us = INT64_C(50000000);
    TEST_ASSERT_EQUAL_INT64(late_us - STAMP_AGE_MAX_US,
                            stamp_from_wall(wall_us - STAMP_AGE_MAX_US, wall_us, late_us));
    TEST_ASSERT_EQUAL_INT64(late_us,
                            stamp_from_wall(wall_us - STAMP_AGE_MAX_US - 1, wall_us, late_us));
    TEST_ASSERT_EQUAL_INT64(late_us, stamp_from_wall(INT64_MIN, wall_us, late_us));
    TEST_ASSERT_EQUAL_INT64(late_us, stamp_from_wall(INT64_MAX, wall_us, late_us));
}

/* An adapter's clock with an offset and a drift, and delays on the way: the stamps come out within
 * the least delay and what the drift allows, never in the future, far nearer than the delays. */
static void test_adapter_stamps(void) {
    support_random_start();
    for (int drift_ppm = -100; drift_ppm <= 100; drift_ppm += 50) {
        stamp_map_t map = {0};
        int64_t true_us = 1000000;
        for (uint32_t i = 0; i < 20000u; i++) {
            true_us += 1000 + (int64_t)support_index(2000);
            const int64_t adapter_us = 77777 + true_us + true_us * drift_ppm / 1000000;
            const int64_t received_us =
                true_us + 50 + (int64_t)(support_index(10) == 0u ? 0u : support_index(5000));
            const int64_t stamp_us = stamp_from_adapter(&map, adapter_us, received_us);
            TEST_ASSERT_TRUE(stamp_us <= received_us);
            if (i > 1000u) {
                TEST_ASSERT_INT64_WITHIN(100, true_us + 50, stamp_us);
            }
        }
        /* The adapter was plugged in again: its clock starts anew. */
        const int64_t fresh_us = stamp_from_adapter(&map, 5, true_us + 1000000);
        TEST_ASSERT_EQUAL_INT64(true_us + 1000000, fresh_us);
        TEST_ASSERT_EQUAL_INT64(true_us + 1000000 + 10,
                                stamp_from_adapter(&map, INT64_C(1) << 50, true_us + 1000010));
    }
}

/* How far before the kernel an adapter's stamp may lie until its clock is taken to have jumped. */
static void test_adapter_jumps(void) {
    static const int64_t starts_us[] = {-1000000, 0, 1000000};
    for (size_t i = 0; i < sizeof starts_us / sizeof starts_us[0]; i++) {
        stamp_map_t map = {0};
        const int64_t start_us = starts_us[i];
        TEST_ASSERT_EQUAL_INT64(5000000, stamp_from_adapter(&map, start_us, 5000000));
        /* 1 ms on the adapter, 51 ms here: held up on the way. */
        TEST_ASSERT_INT64_WITHIN(10, 5001000, stamp_from_adapter(&map, start_us + 1000, 5051000));
        /* 1 ms more there, 10 s here: another clock. */
        TEST_ASSERT_EQUAL_INT64(15000000, stamp_from_adapter(&map, start_us + 2000, 15000000));
        TEST_ASSERT_EQUAL_INT64(15001000, stamp_from_adapter(&map, start_us + 3000, 15001000));
        TEST_ASSERT_EQUAL_INT64(15052001,
                                stamp_from_adapter(&map, start_us + 3000 + 900, 15052001));
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_bins_join_without_gaps);
    RUN_TEST(test_small_quantiles_are_exact);
    RUN_TEST(test_quantiles_are_within_an_eighth);
    RUN_TEST(test_printed);
    RUN_TEST(test_waits_are_never_short);
    RUN_TEST(test_deadlines_in_the_past_return_at_once);
    RUN_TEST(test_something_to_receive_cuts_a_wait);
    RUN_TEST(test_a_descriptor_that_only_fails_does_not_spin);
    RUN_TEST(test_rights_are_granted_or_refused_with_a_reason);
    RUN_TEST(test_wall_stamps);
    RUN_TEST(test_adapter_stamps);
    RUN_TEST(test_adapter_jumps);
    return UNITY_END();
}
