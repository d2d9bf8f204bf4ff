/* Counts executed instructions on an emulated board.
 *
 * The emulator runs with `-icount shift=10`: each instruction takes 1024 ns of virtual time, so
 * that every timer is a counter of instructions, the same in every run. Arm: timer 0 of the mps2
 * boards, whose ticks are shorter than an instruction (25 MHz: 25.6 ticks each). RISC-V: minstret,
 * which the emulator counts in nanoseconds then.
 *
 *     counter_open();
 *     const uint32_t start = counter_now();
 *     work();
 *     const uint32_t instructions = counter_since(start);
 *
 * counter_since takes off what the counting itself costs. Longest span: 167 million instructions on
 * Arm, 4 million on RISC-V. Interrupts stay off after counter_open, and board_now_us stands.
 */
#ifndef BERTH_TESTS_TARGET_COUNTER_H
#define BERTH_TESTS_TARGET_COUNTER_H

#include <stdint.h>

#define COUNTER_NS_PER_INSTRUCTION 1024u

#if defined(__riscv)

static inline uint32_t counter_now(void) {
    uint32_t count;
    __asm volatile("csrr %0, minstret" : "=r"(count)::"memory");
    return count;
}

static inline uint32_t counter_span(uint32_t start, uint32_t end) {
    return (end - start) / COUNTER_NS_PER_INSTRUCTION;
}

static inline void counter_enable(void) {}

#else

/* Timer 0: where it is, and its clock. */
#ifndef COUNTER_BASE
#define COUNTER_BASE 0x40000000u
#define COUNTER_HZ 25000000u
#endif

#define COUNTER_CONTROL (*(volatile uint32_t *)(uintptr_t)(COUNTER_BASE))
#define COUNTER_VALUE (*(volatile uint32_t *)(uintptr_t)(COUNTER_BASE + 4u))
#define COUNTER_RELOAD (*(volatile uint32_t *)(uintptr_t)(COUNTER_BASE + 8u))

static inline uint32_t counter_now(void) {
    const uint32_t left = COUNTER_VALUE;
    __asm volatile("" ::: "memory");
    return left;
}

/* It counts downwards. Rounded, since a tick more or less is far less than an instruction. */
static inline uint32_t counter_span(uint32_t start, uint32_t end) {
    const uint64_t ticks = start - end;
    const uint64_t ns_hz = (uint64_t)COUNTER_NS_PER_INSTRUCTION * COUNTER_HZ;
    return (uint32_t)((ticks * 1000000000u + ns_hz / 2u) / ns_hz);
}

static inline void counter_enable(void) {
    __asm volatile("cpsid i" ::: "memory");
    COUNTER_RELOAD = UINT32_MAX;
    COUNTER_VALUE = UINT32_MAX;
    COUNTER_CONTROL = 1u; /* on, no interrupt */
}

#endif

extern uint32_t counter_overhead; /* counter.c */

static inline uint32_t counter_since(uint32_t start) {
    return counter_span(start, counter_now()) - counter_overhead;
}

/* Once, before anything is counted. */
void counter_open(void);

#endif
