#include "start.h"
#include "vectors.h"

#define REGISTER(address) (*(volatile uint32_t *)(uintptr_t)(address))
#define SCB_CCR REGISTER(0xe000ed14u)
#define SCB_SHCSR REGISTER(0xe000ed24u)
#define SCB_CFSR REGISTER(0xe000ed28u)
#define SCB_HFSR REGISTER(0xe000ed2cu)
#define SCB_MMFAR REGISTER(0xe000ed34u)
#define SCB_BFAR REGISTER(0xe000ed38u)
#define SCB_CPACR REGISTER(0xe000ed88u)

#define MPU_CTRL REGISTER(0xe000ed94u)
#define MPU_RBAR REGISTER(0xe000ed9cu)
#define MPU_RASR REGISTER(0xe000eda0u)

#define CCR_DIV_0_TRP (1u << 4)
/* Limit of the stack, or a memory or bus fault when stacking. */
#define CFSR_STACKING_FAILED ((1u << 20) | (1u << 12) | (1u << 4))
#define SHCSR_MEM_BUS_USAGE (7u << 16)
#define MPU_ON_WITH_BACKGROUND 5u
#define RBAR_REGION_0 (1u << 4)
#define RASR_NO_ACCESS_4K ((11u << 1) | 1u)
#define GUARD_BYTES 4096u
#define CPACR_CP10_CP11_FULL (0xfu << 20)

/* ARMv6-M has one fault only, and no registers about it. */
#if __ARM_ARCH >= 7
#define HAS_FAULT_REGISTERS 1
#else
#define HAS_FAULT_REGISTERS 0
#endif

/* Nothing may touch the page below the main stack: what lies there need not fault by itself.
 * ARMv8-M has a register for it, set at reset. */
static void guard_stack(void) {
#if __ARM_ARCH == 7
    MPU_RBAR = ((uint32_t)(uintptr_t)board_stack_start - GUARD_BYTES) | RBAR_REGION_0;
    MPU_RASR = RASR_NO_ACCESS_4K;
    MPU_CTRL = MPU_ON_WITH_BACKGROUND;
    __asm volatile("dsb\n\tisb" ::: "memory");
#endif
}

static void open_core(void) {
    guard_stack();
#if HAS_FAULT_REGISTERS
    SCB_CCR |= CCR_DIV_0_TRP;
    SCB_SHCSR |= SHCSR_MEM_BUS_USAGE;
#endif
#if defined(__ARM_FP)
    SCB_CPACR |= CPACR_CP10_CP11_FULL;
    __asm volatile("dsb\n\tisb" ::: "memory");
#endif
}

/* Called on the main stack. */
__attribute__((noreturn, used)) static void start(uint32_t *stack_pointer) {
    board_prepare_memory(stack_pointer);
    open_core();
    board_run();
}

/* The processor comes up on the handlers' stack. Thread mode gets the main stack; ARMv8-M has
 * registers that guard both. */
__attribute__((naked)) void board_reset(void) {
    __asm volatile(".syntax unified\n\t"
                   "ldr r0, =board_stack_end\n\t"
                   "msr psp, r0\n\t"
#if defined(__ARM_ARCH_8M_MAIN__)
                   "ldr r1, =board_stack_start\n\t"
                   "msr psplim, r1\n\t"
                   "ldr r1, =board_handler_stack_start\n\t"
                   "msr msplim, r1\n\t"
#endif
                   "movs r1, #2\n\t"
                   "msr control, r1\n\t"
                   "isb\n\t"
                   "mov r0, sp\n\t"
                   "subs r0, r0, #64\n\t"
                   "ldr r1, =start\n\t"
                   "bx r1\n\t"
                   ".ltorg");
}

__attribute__((weak)) void cortex_m_tick(void) {}

/* Which stack the exception's frame is on, and where. */
__attribute__((naked)) void cortex_m_fault(void) {
    __asm volatile(".syntax unified\n\t"
                   "mov r1, lr\n\t"
                   "movs r0, #4\n\t"
                   "tst r0, r1\n\t"
                   "beq 1f\n\t"
                   "mrs r0, psp\n\t"
                   "b 2f\n"
                   "1:\n\t"
                   "mrs r0, msp\n"
                   "2:\n\t"
                   "ldr r2, =report_fault\n\t"
                   "bx r2\n\t"
                   ".ltorg");
}

static const char *exception_name(uint32_t number) {
    switch (number) {
    case 2:
        return "nmi";
    case 3:
        return "hard";
    case 4:
        return "memory";
    case 5:
        return "bus";
    case 6:
        return "usage";
    case 7:
        return "secure";
    default:
        return "unexpected";
    }
}

/* The eight words that the processor stacked, when there was room for them. */
static void print_frame(const uint32_t *frame, bool stacked) {
    static const char *const names[8] = {"r0", "r1", "r2", "r3", "r12", "lr", "pc", "psr"};
    if (!stacked || frame < board_stack_start || frame + 8 > board_handler_stack_end) {
        board_puts("stack overflow: no frame\n");
        return;
    }
    for (int i = 0; i < 8; i++) {
        board_print_register(names[i], frame[i]);
    }
}

__attribute__((noreturn, used)) static void report_fault(const uint32_t *frame,
                                                         uint32_t exception_return) {
    if (board_is_stopping()) {
        board_exit(BOARD_STATUS_FAULT);
    }
    uint32_t number;
    __asm volatile("mrs %0, ipsr" : "=r"(number));
    board_puts("\nFAULT ");
    board_puts(exception_name(number));
    board_puts("\n");
    board_print_register("exception", number);
    board_print_register("return", exception_return);
    board_print_register("sp", (uint32_t)(uintptr_t)frame);
    bool stacked = true;
#if HAS_FAULT_REGISTERS
    stacked = (SCB_CFSR & CFSR_STACKING_FAILED) == 0;
    board_print_register("cfsr", SCB_CFSR);
    board_print_register("hfsr", SCB_HFSR);
    board_print_register("mmfar", SCB_MMFAR);
    board_print_register("bfar", SCB_BFAR);
#endif
    print_frame(frame, stacked);
    board_stop_after_fault();
}
