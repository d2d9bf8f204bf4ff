/* Unity tests of a board's start-up code, time and memory; or, as BOARD_CHECK in the environment
 * says, one of the faults, or the far end of the bus port. */
#include "board.h"
#include "unity.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#if defined(BOARD_HAS_BUS)
#include "mps2_board.h"
#endif

void setUp(void) {}

void tearDown(void) {}

/* ---- Memory ---- */

static volatile int initialised = 0x1234;
static volatile int zeroed[100];

static void test_data_and_bss_are_filled_in(void) {
    TEST_ASSERT_EQUAL_INT(0x1234, initialised);
    for (int i = 0; i < 100; i++) {
        TEST_ASSERT_EQUAL_INT(0, zeroed[i]);
    }
}

__attribute__((noinline)) static uint8_t use_stack(size_t bytes) {
    uint8_t room[64];
    memset(room, (int)bytes, sizeof room);
    __asm volatile("" ::"r"(room) : "memory");
    return bytes <= sizeof room ? room[0] : (uint8_t)(use_stack(bytes - sizeof room) + room[1]);
}

/* First of all tests, before another one has used as much. */
static void test_stack_high_water_mark(void) {
    const size_t before = board_stack_used();
    TEST_ASSERT_GREATER_THAN_UINT32(0, before);
    TEST_ASSERT_LESS_THAN_UINT32(board_stack_size(), before);
    const size_t more = board_stack_size() - before - 256;
    use_stack(more / 4);
    const size_t after = board_stack_used();
    TEST_ASSERT_GREATER_THAN_UINT32(before, after);
    TEST_ASSERT_GREATER_OR_EQUAL_UINT32(more / 4, after);
    TEST_ASSERT_LESS_THAN_UINT32(board_stack_size(), after);
    TEST_ASSERT_EQUAL_UINT32(after, board_stack_used());
}

/* ---- Time: one instruction a nanosecond, as the emulator counts here ---- */

#define LOOPS 1000000u

static void two_instructions(uint32_t times) {
#if defined(__riscv)
    __asm volatile("1: addi %0, %0, -1\n\tbnez %0, 1b" : "+r"(times));
#else
    __asm volatile(".syntax unified\n\t1: subs %0, %0, #1\n\tbne 1b" : "+l"(times)::"cc");
#endif
}

static void test_time_counts_microseconds(void) {
    for (uint32_t i = 1; i <= 8; i++) {
        const int64_t before = board_now_us();
        two_instructions(i * LOOPS);
        const int64_t passed = board_now_us() - before;
        TEST_ASSERT_INT64_WITHIN(3 + i, 2 * i * (LOOPS / 1000), passed);
    }
}

/* In steps so small that every place between two ticks is met. */
static void test_time_never_goes_backwards(void) {
    int64_t last = board_now_us();
    const int64_t start = last;
    for (uint32_t i = 0; i < 200000; i++) {
        const int64_t now = board_now_us();
        TEST_ASSERT_TRUE(now >= last && now - last < 50);
        last = now;
        two_instructions(1 + i % 37);
    }
    TEST_ASSERT_TRUE(last - start > 5000);
}

#if defined(BOARD_HAS_BUS)

static void test_sleep_ends_at_the_deadline(void) {
    const berth_clock_t clock = board_clock();
    for (int64_t wait_us = 1; wait_us < 40000; wait_us = wait_us * 3 + 7) {
        const int64_t deadline = board_now_us() + wait_us;
        clock.api->sleep_until_us(clock.context, deadline);
        TEST_ASSERT_INT64_WITHIN(3, deadline + 2, board_now_us());
    }
    const int64_t before = board_now_us();
    clock.api->sleep_until_us(clock.context, before - 1);
    clock.api->sleep_until_us(clock.context, -1);
    TEST_ASSERT_INT64_WITHIN(3, before + 2, board_now_us());
}

static void test_quiet_bus_has_nothing(void) {
    const byte_stream_t bus = board_bus();
    uint8_t byte;
    size_t count = 7;
    TEST_ASSERT_EQUAL(BYTE_STREAM_AGAIN, bus.api->read(bus.context, &byte, 1, &count));
    TEST_ASSERT_EQUAL_UINT32(0, count);
}

static void write_all(const byte_stream_t *bus, const uint8_t *bytes, size_t length) {
    while (length > 0) {
        size_t count;
        bus->api->write(bus->context, bytes, length, &count);
        bytes += count;
        length -= count;
    }
}

/* Sends back what comes, until an end of transmission (4). Sleeps in between. */
static int echo(void) {
    const byte_stream_t bus = board_bus();
    const berth_clock_t clock = board_clock();
    puts("ready");
    for (;;) {
        uint8_t bytes[48];
        size_t count;
        if (bus.api->read(bus.context, bytes, sizeof bytes, &count) == BYTE_STREAM_FAILED) {
            puts("lost");
            return 1;
        }
        write_all(&bus, bytes, count);
        if (memchr(bytes, 4, count) != NULL) {
            return 0;
        }
        clock.api->sleep_until_us(clock.context, board_now_us() + 1000000);
    }
}

/* Does not look at the port until the line "!" comes... which it would not see: waits by the clock.
 * Then tells what it finds. */
static int overrun(void) {
    const byte_stream_t bus = board_bus();
    puts("ready");
    const int64_t end = board_now_us() + 300000;
    while (board_now_us() < end) {
    }
    for (int calls = 0; calls < 100; calls++) {
        uint8_t bytes[100];
        size_t count;
        const byte_stream_outcome_t outcome =
            bus.api->read(bus.context, bytes, sizeof bytes, &count);
        printf("%d %u %d\n", (int)outcome, (unsigned)count, count > 0 ? bytes[count - 1] : -1);
        if (outcome == BYTE_STREAM_AGAIN) {
            return 0;
        }
    }
    return 1;
}

#endif

/* ---- Faults ---- */

static volatile uint32_t zero;

/* Where there is nothing. */
#if defined(__riscv)
#define NOWHERE 0x08000000u
#else
#define NOWHERE 0x90000000u
#endif

static int fault_access(void) {
    return (int)*(volatile uint32_t *)(uintptr_t)(NOWHERE + zero);
}

static int fault_divide(void) {
    return (int)(1000u / zero);
}

static int fault_illegal(void) {
#if defined(__riscv)
    __asm volatile(".word 0");
#else
    __asm volatile("udf #7");
#endif
    return 0;
}

static int fault_stack(void) {
    return use_stack((size_t)1 << 30);
}

static int exit_with_7(void) {
    return 7;
}

static const struct {
    const char *name;
    int (*run)(void);
} modes[] = {
    {"access", fault_access}, {"divide", fault_divide}, {"illegal", fault_illegal},
    {"stack", fault_stack},   {"exit", exit_with_7},
#if defined(BOARD_HAS_BUS)
    {"echo", echo},           {"overrun", overrun},
#endif
};

int main(void) {
    const char *mode = getenv("BOARD_CHECK");
    for (size_t i = 0; mode != NULL && i < sizeof modes / sizeof modes[0]; i++) {
        if (strcmp(mode, modes[i].name) == 0) {
            return modes[i].run();
        }
    }
    UNITY_BEGIN();
    RUN_TEST(test_stack_high_water_mark);
    RUN_TEST(test_data_and_bss_are_filled_in);
    RUN_TEST(test_time_counts_microseconds);
    RUN_TEST(test_time_never_goes_backwards);
#if defined(BOARD_HAS_BUS)
    RUN_TEST(test_sleep_ends_at_the_deadline);
    RUN_TEST(test_quiet_bus_has_nothing);
#endif
    return UNITY_END();
}
