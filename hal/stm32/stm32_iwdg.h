/* stm32_iwdg.h - the independent watchdog of an STM32F4: resets the chip when it is not fed.
 *
 *     stm32_iwdg_start(registers, 50000);
 *     each time round the main loop, and only there: stm32_iwdg_feed(registers);
 *
 * Once started it runs until the next reset. It has an oscillator of its own, of 17 to 47 kHz: the
 * chip is reset after timeout_us at the earliest and 2.8 times that at the latest.
 */
#ifndef BERTH_HAL_STM32_IWDG_H
#define BERTH_HAL_STM32_IWDG_H

#include "stm32f4_regs.h"

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define STM32_IWDG_TIMEOUT_MAX_US 22000000u
#define STM32_IWDG_WAIT_LOOKS 200000u

/* timeout_us: 1 to STM32_IWDG_TIMEOUT_MAX_US. False when it is not, and nothing is touched; also
 * when the watchdog did not take the setting in time: it may run then, with another time. */
bool stm32_iwdg_start(stm32f4_iwdg_t *regs, uint32_t timeout_us);

void stm32_iwdg_feed(stm32f4_iwdg_t *regs);

#ifdef __cplusplus
}
#endif

#endif
