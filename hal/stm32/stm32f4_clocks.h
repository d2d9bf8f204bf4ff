/* stm32f4_clocks.h - the clock tree of an STM32F405: 168 MHz from a crystal, or 16 MHz without.
 *
 * 168 MHz core, 42 MHz APB1 (CAN), 84 MHz APB2 (USART1), 5 flash wait states with caches and
 * prefetch, and the clock security system: should the crystal fail later, a non-maskable interrupt
 * comes. Supply of 2.7 V or more.
 *
 * Each wait is bounded. When the crystal or the PLL does not come, everything runs from the
 * internal oscillator at 16 MHz, undivided. That one is off by up to a percent and more over
 * temperature: good for a console, not for CAN at 1 Mbit/s.
 */
#ifndef BERTH_HAL_STM32F4_CLOCKS_H
#define BERTH_HAL_STM32F4_CLOCKS_H

#include "stm32f4_regs.h"

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Looks at each flag; some 100 ms from the internal oscillator, where a crystal takes 2. */
#define STM32F4_CLOCKS_LOOKS 200000u

typedef struct {
    uint32_t core_hz;
    uint32_t apb1_hz;
    uint32_t apb2_hz;
    bool crystal;
    const char *problem; /* what did not come; NULL with the crystal */
} stm32f4_clocks_t;

/* crystal_hz: 4 to 26 MHz, a multiple of 2 MHz; others are answered with the internal oscillator.
 */
void stm32f4_clocks_start(stm32f4_rcc_t *rcc, stm32f4_flash_t *flash, uint32_t crystal_hz,
                          stm32f4_clocks_t *out);

#ifdef __cplusplus
}
#endif

#endif
