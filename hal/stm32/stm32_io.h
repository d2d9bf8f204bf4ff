/* stm32_io.h - how the drivers in this folder reach registers.
 *
 * Register blocks are plain structs of volatile words. On the target an access is one load or
 * store. Where STM32_IO_MODEL is defined, each access is a call instead, so that a model of the
 * peripheral can stand behind the same driver: memory alone does not react.
 *
 * Fields are masks in their place: STM32_FIELD(20, 3) is bits 20 to 22. With a constant mask,
 * stm32_put and stm32_get compile to a shift and an and.
 */
#ifndef BERTH_HAL_STM32_IO_H
#define BERTH_HAL_STM32_IO_H

#include <stdint.h>

/* MISRA T4 in this file. */

#ifdef __cplusplus
extern "C" {
#endif

#define STM32_BIT(number) ((uint32_t)1u << (number))
#define STM32_FIELD(shift, bits) ((0xffffffffu >> (32u - (uint32_t)(bits))) << (shift))

#ifdef STM32_IO_MODEL

uint32_t stm32_io_read(const volatile uint32_t *address);
void stm32_io_write(volatile uint32_t *address, uint32_t value);

/* Sleeping: the model lets time pass. */
void stm32_io_wait(void);
uint32_t stm32_io_mask(void);
void stm32_io_unmask(uint32_t before);

static inline uint32_t stm32_read(const volatile uint32_t *address) {
    return stm32_io_read(address);
}

static inline void stm32_write(volatile uint32_t *address, uint32_t value) {
    stm32_io_write(address, value);
}

#else

static inline uint32_t stm32_read(const volatile uint32_t *address) {
    return *address;
}

static inline void stm32_write(volatile uint32_t *address, uint32_t value) {
    *address = value;
}

#if defined(__arm__)
/* Until an interrupt is pending, masked or not. */
static inline void stm32_io_wait(void) {
    __asm volatile("dsb\n\twfi" ::: "memory");
}

/* Holds interrupts off (faults excepted); gives what stm32_io_unmask needs. */
static inline uint32_t stm32_io_mask(void) {
    uint32_t before;
    __asm volatile("mrs %0, primask\n\tcpsid i" : "=r"(before)::"memory");
    return before;
}

static inline void stm32_io_unmask(uint32_t before) {
    __asm volatile("msr primask, %0" ::"r"(before) : "memory");
}
#else
/* No such processor: compiled only to be checked. */
static inline void stm32_io_wait(void) {}

static inline uint32_t stm32_io_mask(void) {
    return 0;
}

static inline void stm32_io_unmask(uint32_t before) {
    (void)before;
}
#endif

#endif

/* value placed in a field; what does not fit is cut off. */
static inline uint32_t stm32_put(uint32_t field, uint32_t value) {
    return (value * (field & (~field + 1u))) & field;
}

/* A field's value. */
static inline uint32_t stm32_get(uint32_t word, uint32_t field) {
    return (word & field) / (field & (~field + 1u));
}

/* Read, change, write. Not for registers whose bits are cleared by writing 1. */
static inline void stm32_change(volatile uint32_t *address, uint32_t clear, uint32_t set) {
    stm32_write(address, (stm32_read(address) & ~clear) | set);
}

#ifdef __cplusplus
}
#endif

#endif
