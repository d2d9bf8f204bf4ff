/* The clock over SysTick, against a model of SysTick that goes on with each access. */
#include "io_model.h"
#include "stm32_clock.h"
#include "support.h"

#include "unity.h"

#include <string.h>

static stm32_systick_t block;
static uint32_t icsr;

/* The core's counter of ticks, and SysTick as it follows from it. */
static struct {
    uint64_t ticks;
    uint32_t reload;
    uint32_t csr;
    uint64_t handled; /* interrupts */
    bool hold;        /* the handler cannot run now */
    uint32_t speed;   /* ticks that an access takes at most */
} systick;

static stm32_clock_t timer;
static berth_clock_t berth;

static uint64_t reloads(void) {
    return systick.ticks / ((uint64_t)systick.reload + 1u);
}

static void deliver(void) {
    while (!systick.hold && !io_model_masked() && systick.handled < reloads()) {
        systick.handled++;
        stm32_clock_tick(&timer);
    }
}

static void pass(uint64_t ticks) {
    while (ticks > 0) {
        const uint64_t step = ticks < systick.reload / 2u ? ticks : systick.reload / 2u;
        systick.ticks += step;
        ticks -= step;
        deliver();
    }
}

static uint32_t systick_read(void *context, uint32_t offset) {
    (void)context;
    TEST_ASSERT_EQUAL_UINT32(8, offset);
    const uint32_t since = (uint32_t)(systick.ticks % ((uint64_t)systick.reload + 1u));
    return since == 0 ? 0 : systick.reload + 1u - since;
}

static void systick_write(void *context, uint32_t offset, uint32_t value) {
    (void)context;
    switch (offset) {
    case 0:
        systick.csr = value;
        break;
    case 4:
        systick.reload = value;
        break;
    default:
        systick.ticks = 0;
        break;
    }
}

static uint32_t icsr_read(void *context, uint32_t offset) {
    (void)context;
    TEST_ASSERT_EQUAL_UINT32(0, offset);
    return systick.handled < reloads() ? 1u << 26 : 0u;
}

static void icsr_write(void *context, uint32_t offset, uint32_t value) {
    (void)context;
    (void)offset;
    (void)value;
    TEST_FAIL_MESSAGE("nothing is to be written there");
}

static void go_on(void *context, uint32_t number) {
    (void)context;
    (void)number;
    if (systick.csr != 0) {
        pass(support_index(systick.speed + 1u));
    }
}

static void wait(void *context) {
    (void)context;
    systick.ticks = (reloads() + 1u) * ((uint64_t)systick.reload + 1u);
    deliver();
}

static stm32_clock_config_t config(uint32_t clock_hz) {
    return (stm32_clock_config_t){.systick = &block, .icsr = &icsr, .clock_hz = clock_hz};
}

static void start(uint32_t clock_hz) {
    const stm32_clock_config_t c = config(clock_hz);
    systick.ticks = 12345; /* left by an earlier program */
    TEST_ASSERT_TRUE(stm32_clock_start(&timer, &c));
    TEST_ASSERT_EQUAL_HEX32(7, systick.csr);
    TEST_ASSERT_EQUAL_UINT32(clock_hz / 1000u, systick.reload + 1u);
    berth = stm32_clock(&timer);
}

static int64_t now(void) {
    return berth.api->now_us(berth.context);
}

static int64_t truth(void) {
    return (int64_t)(systick.ticks / ((systick.reload + 1u) / 1000u));
}

void setUp(void) {
    static const io_model_ops_t ops = {systick_read, systick_write};
    static const io_model_ops_t icsr_ops = {icsr_read, icsr_write};
    io_model_reset();
    io_model_map(&block, sizeof block, &ops, NULL);
    io_model_map(&icsr, sizeof icsr, &icsr_ops, NULL);
    memset(&systick, 0, sizeof systick);
    io_model_on_wait(wait, NULL);
}

void tearDown(void) {
    TEST_ASSERT_FALSE(io_model_masked());
}

static void test_bad_frequencies_are_refused(void) {
    static const uint32_t bad[] = {0, 999999, 1500000, 16777000, UINT32_MAX};
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        const stm32_clock_config_t c = config(bad[i]);
        TEST_ASSERT_FALSE(stm32_clock_start(&timer, &c));
        TEST_ASSERT_EQUAL_UINT32(0, io_model_accesses());
    }
}

static void test_starts_at_zero(void) {
    start(168000000);
    TEST_ASSERT_EQUAL_INT64(0, now());
    pass(168 * 1234567ull);
    TEST_ASSERT_EQUAL_INT64(1234567, now());
}

/* The time lies between the model's before and after the call, whenever the handler runs. */
static void test_is_right_and_never_goes_back(void) {
    static const uint32_t clocks[] = {1000000, 16000000, 168000000};
    support_random_start();
    for (size_t k = 0; k < 3; k++) {
        setUp();
        start(clocks[k]);
        io_model_hook(go_on, NULL);
        int64_t last = 0;
        for (uint32_t i = 0; i < support_runs(100000); i++) {
            systick.speed = support_index(10) == 0 ? systick.reload / 4u : 3u;
            /* Held off for less than a period, as by an interrupt of the same priority. */
            systick.hold = support_index(4) == 0;
            if (systick.hold) {
                systick.speed = systick.reload / 20u;
            }
            const int64_t before = truth();
            const int64_t time = now();
            TEST_ASSERT_TRUE(time >= before && time <= truth());
            TEST_ASSERT_TRUE(time >= last);
            last = time;
            systick.hold = false;
            deliver();
            pass(support_index(systick.reload / 3u));
        }
    }
}

static void test_the_count_of_milliseconds_wraps(void) {
    start(16000000);
    timer.low = UINT32_MAX - 1u;
    for (int i = 0; i < 4; i++) {
        TEST_ASSERT_EQUAL_INT64(((int64_t)UINT32_MAX - 1 + i) * 1000, now());
        pass(16000);
    }
    timer.high = 7;
    TEST_ASSERT_EQUAL_INT64(((int64_t)7 << 32) + 2, now() / 1000);
}

static void test_sleeping_ends_at_the_deadline(void) {
    support_random_start();
    start(168000000);
    systick.speed = 200;
    io_model_hook(go_on, NULL);
    for (uint32_t i = 0; i < support_runs(2000); i++) {
        const int64_t deadline = now() + (int64_t)support_index(20000);
        berth.api->sleep_until_us(berth.context, deadline);
        const int64_t late = now() - deadline;
        TEST_ASSERT_TRUE(late >= 0 && late < 20);
    }
    const int64_t before = now();
    berth.api->sleep_until_us(berth.context, INT64_MIN);
    berth.api->sleep_until_us(berth.context, before);
    TEST_ASSERT_TRUE(now() - before < 50);
}

static uint32_t asked;
static uint32_t ask_for;

static bool something(void *context) {
    TEST_ASSERT_EQUAL_PTR(&asked, context);
    return ++asked > ask_for;
}

/* Also when it comes between the first look and the sleep. */
static void test_sleeping_ends_when_there_is_something_to_do(void) {
    for (ask_for = 0; ask_for < 6; ask_for++) {
        setUp();
        stm32_clock_config_t c = config(16000000);
        c.wakes = something;
        c.wakes_context = &asked;
        TEST_ASSERT_TRUE(stm32_clock_start(&timer, &c));
        berth = stm32_clock(&timer);
        asked = 0;
        berth.api->sleep_until_us(berth.context, INT64_MAX);
        TEST_ASSERT_TRUE(now() <= 1000 * (1 + (int64_t)ask_for / 2));
        TEST_ASSERT_TRUE(asked <= ask_for + 2);
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_bad_frequencies_are_refused);
    RUN_TEST(test_starts_at_zero);
    RUN_TEST(test_is_right_and_never_goes_back);
    RUN_TEST(test_the_count_of_milliseconds_wraps);
    RUN_TEST(test_sleeping_ends_at_the_deadline);
    RUN_TEST(test_sleeping_ends_when_there_is_something_to_do);
    return UNITY_END();
}
