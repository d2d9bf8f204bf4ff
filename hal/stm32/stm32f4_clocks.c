#include "stm32f4_clocks.h"

#include <stddef.h>

#define MHZ 1000000u
#define INTERNAL_HZ (16u * MHZ)
#define PLL_INPUT_HZ (2u * MHZ)
#define PLL_MULTIPLY 168u /* to 336 MHz */
#define PLL_BY_2 0u       /* to 168 MHz */
#define PLL_USB 7u        /* to 48 MHz */

#define SWITCH_INTERNAL 0u
#define SWITCH_PLL 2u
#define APB_BY_2 4u
#define APB_BY_4 5u
#define WAIT_STATES 5u

static bool wait_for(const volatile uint32_t *reg, uint32_t mask, uint32_t value) {
    for (uint32_t looks = 0; looks < STM32F4_CLOCKS_LOOKS; looks++) {
        if ((stm32_read(reg) & mask) == value) {
            return true;
        }
    }
    return false;
}

static bool switch_to(stm32f4_rcc_t *rcc, uint32_t source) {
    stm32_change(&rcc->cfgr, RCC_CFGR_SW, stm32_put(RCC_CFGR_SW, source));
    return wait_for(&rcc->cfgr, RCC_CFGR_SWS, stm32_put(RCC_CFGR_SWS, source));
}

/* As after reset, whatever ran before. Its flags are not waited for where nothing else can be done
 * anyway: the processor runs, so some clock does. */
static void start_internal(stm32f4_rcc_t *rcc) {
    stm32_change(&rcc->cr, 0, RCC_CR_HSION);
    (void)wait_for(&rcc->cr, RCC_CR_HSIRDY, RCC_CR_HSIRDY);
    (void)switch_to(rcc, SWITCH_INTERNAL);
    stm32_change(&rcc->cr, RCC_CR_PLLON | RCC_CR_CSSON, 0);
    (void)wait_for(&rcc->cr, RCC_CR_PLLRDY, 0);
    stm32_change(&rcc->cr, RCC_CR_HSEON | RCC_CR_HSEBYP, 0);
    stm32_change(&rcc->cfgr, RCC_CFGR_HPRE | RCC_CFGR_PPRE1 | RCC_CFGR_PPRE2, 0);
}

/* What did not come; NULL: all did. */
static const char *start_crystal(stm32f4_rcc_t *rcc, stm32f4_flash_t *flash, uint32_t crystal_hz) {
    const uint32_t divide = crystal_hz / PLL_INPUT_HZ;
    if (divide < 2u || divide > 13u || crystal_hz % PLL_INPUT_HZ != 0u) {
        return "no such crystal";
    }
    stm32_change(&rcc->cr, 0, RCC_CR_HSEON);
    if (!wait_for(&rcc->cr, RCC_CR_HSERDY, RCC_CR_HSERDY)) {
        return "the crystal does not start";
    }
    stm32_write(&rcc->pllcfgr, stm32_put(RCC_PLLCFGR_PLLM, divide) |
                                   stm32_put(RCC_PLLCFGR_PLLN, PLL_MULTIPLY) |
                                   stm32_put(RCC_PLLCFGR_PLLP, PLL_BY_2) |
                                   stm32_put(RCC_PLLCFGR_PLLQ, PLL_USB) | RCC_PLLCFGR_PLLSRC);
    stm32_change(&rcc->cr, 0, RCC_CR_PLLON);
    if (!wait_for(&rcc->cr, RCC_CR_PLLRDY, RCC_CR_PLLRDY)) {
        return "the PLL does not lock";
    }
    /* Before the faster clock; the flash has taken it when it reads so. */
    const uint32_t latency = stm32_put(FLASH_ACR_LATENCY, WAIT_STATES);
    stm32_write(&flash->acr, latency | FLASH_ACR_PRFTEN | FLASH_ACR_ICEN | FLASH_ACR_DCEN);
    if (!wait_for(&flash->acr, FLASH_ACR_LATENCY, latency)) {
        return "the flash does not take its wait states";
    }
    stm32_change(&rcc->cfgr, RCC_CFGR_HPRE | RCC_CFGR_PPRE1 | RCC_CFGR_PPRE2,
                 stm32_put(RCC_CFGR_PPRE1, APB_BY_4) | stm32_put(RCC_CFGR_PPRE2, APB_BY_2));
    if (!switch_to(rcc, SWITCH_PLL)) {
        return "the PLL is not taken";
    }
    stm32_change(&rcc->cr, 0, RCC_CR_CSSON);
    return NULL;
}

void stm32f4_clocks_start(stm32f4_rcc_t *rcc, stm32f4_flash_t *flash, uint32_t crystal_hz,
                          stm32f4_clocks_t *out) {
    start_internal(rcc);
    const char *problem = start_crystal(rcc, flash, crystal_hz);
    if (problem != NULL) {
        start_internal(rcc);
        *out = (stm32f4_clocks_t){.core_hz = INTERNAL_HZ,
                                  .apb1_hz = INTERNAL_HZ,
                                  .apb2_hz = INTERNAL_HZ,
                                  .problem = problem};
        return;
    }
    *out = (stm32f4_clocks_t){
        .core_hz = 168u * MHZ, .apb1_hz = 42u * MHZ, .apb2_hz = 84u * MHZ, .crystal = true};
}
