#include "counter.h"

#include "cost.h"

#include <stdio.h>

uint32_t counter_overhead;

void counter_open(void) {
    counter_enable();
    counter_overhead = 0;
    const uint32_t start = counter_now();
    counter_overhead = counter_span(start, counter_now());
}

/* Instructions of a loop of n turns that are known by hand. */
#if defined(__riscv)
#define LOOP "1: addi %0, %0, -1\n\tbnez %0, 1b"
#else
#define LOOP ".syntax unified\n1: subs %0, %0, #1\n\tbne 1b"
#endif

/* Not inline, so that the register which counts down is this function's alone. */
__attribute__((noinline)) static uint32_t loop(uint32_t left) {
    const uint32_t start = counter_now();
    __asm volatile(LOOP : "+r"(left)::"cc");
    return counter_since(start);
}

void cost_counter(void) {
    for (uint32_t turns = 1; turns < 100000; turns = 3 * turns + 1) {
        if (loop(turns) != 2 * turns) {
            printf("%lu turns: %lu instructions\n", (unsigned long)turns,
                   (unsigned long)loop(turns));
            cost_fail("the counter does not count instructions");
        }
    }
}
