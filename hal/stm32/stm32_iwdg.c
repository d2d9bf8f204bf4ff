#include "stm32_iwdg.h"

#define KEY_START 0xccccu
#define KEY_UNLOCK 0x5555u
#define KEY_FEED 0xaaaau

#define OSCILLATOR_MAX_HZ 47000u
#define PRESCALER_MIN 4u
#define PRESCALER_CODE_MAX 6u
#define RELOAD_MAX 4095u

bool stm32_iwdg_start(stm32f4_iwdg_t *regs, uint32_t timeout_us) {
    if (timeout_us == 0u || timeout_us > STM32_IWDG_TIMEOUT_MAX_US) {
        return false;
    }
    /* Counts of the undivided oscillator, rounded up. */
    const uint64_t counts = ((uint64_t)timeout_us * OSCILLATOR_MAX_HZ + 999999u) / 1000000u;
    uint32_t code = 0;
    while (code < PRESCALER_CODE_MAX && counts > (((uint64_t)(RELOAD_MAX)*PRESCALER_MIN) << code)) {
        code++;
    }
    const uint32_t prescaler = PRESCALER_MIN << code;
    const uint32_t reload = (uint32_t)((counts + prescaler - 1u) / prescaler);
    stm32_write(&regs->kr, KEY_START);
    stm32_write(&regs->kr, KEY_UNLOCK);
    stm32_write(&regs->pr, code);
    stm32_write(&regs->rlr, reload);
    bool taken = false;
    for (uint32_t looks = 0; looks < STM32_IWDG_WAIT_LOOKS && !taken; looks++) {
        taken = (stm32_read(&regs->sr) & (IWDG_SR_PVU | IWDG_SR_RVU)) == 0u;
    }
    stm32_write(&regs->kr, KEY_FEED);
    return taken;
}

void stm32_iwdg_feed(stm32f4_iwdg_t *regs) {
    stm32_write(&regs->kr, KEY_FEED);
}
