/* Counts instructions on the emulated mps2-an386. Timer 0 counts at 25 MHz of virtual time: with
 * the emulator's -icount 10, where an instruction takes 1024 ns, that resolves single ones. */
#include "laps.h"

#define REGISTER(address) (*(volatile uint32_t *)(uintptr_t)(address))
#define SYST_CSR REGISTER(0xe000e010u)
#define TIMER0_CTRL REGISTER(0x40000000u)
#define TIMER0_VALUE REGISTER(0x40000004u)
#define TIMER0_RELOAD REGISTER(0x40000008u)

void laps_open(void) {
    SYST_CSR = 0; /* its interrupts would be counted */
    TIMER0_RELOAD = UINT32_MAX;
    TIMER0_VALUE = UINT32_MAX;
    TIMER0_CTRL = 1u; /* on, no interrupt */
}

uint32_t laps_mark(void) {
    return TIMER0_VALUE;
}

/* A tick is 40 ns. */
uint32_t laps_since(uint32_t mark) {
    return (uint32_t)((UINT64_C(40) * (mark - TIMER0_VALUE) + 512u) / 1024u);
}
