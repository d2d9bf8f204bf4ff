#include "start.h"

void board_reset(void);
void riscv_trap(void);

#define READ(csr)                                                                                  \
    __extension__({                                                                                \
        uint32_t value_;                                                                           \
        __asm volatile("csrr %0, " #csr : "=r"(value_));                                           \
        value_;                                                                                    \
    })
#define WRITE(csr, value) __asm volatile("csrw " #csr ", %0" ::"r"((uint32_t)(value)) : "memory")

/* One page without any permission, for the machine mode too. */
#define PMP_LOCKED_PAGE 0x98u
#define PAGE_BYTES 4096u

/* Called on the main stack. */
__attribute__((noreturn, used)) static void start(uint32_t *stack_pointer) {
    board_prepare_memory(stack_pointer);
    /* The page below the main stack. */
    WRITE(pmpaddr0, ((uintptr_t)board_stack_start - PAGE_BYTES + PAGE_BYTES / 2 - 1) >> 2);
    WRITE(pmpcfg0, PMP_LOCKED_PAGE);
    board_run();
}

/* The float unit on (mstatus.FS), traps on a stack of their own. */
__attribute__((naked, section(".vectors"))) void board_reset(void) {
    __asm volatile("csrw mie, x0\n\t"
                   "li t0, 0x2000\n\t"
                   "csrs mstatus, t0\n\t"
                   "csrw fcsr, x0\n\t"
                   "la sp, board_stack_end\n\t"
                   "la tp, __tls_base\n\t"
                   "la t0, board_handler_stack_end\n\t"
                   "csrw mscratch, t0\n\t"
                   "la t0, riscv_trap\n\t"
                   "csrw mtvec, t0\n\t"
                   "addi a0, sp, -64\n\t"
                   "j start");
}

/* Traps are faults: no interrupt is ever enabled. */
__attribute__((naked, aligned(4), used)) void riscv_trap(void) {
    __asm volatile("csrrw sp, mscratch, sp\n\t"
                   "mv a1, ra\n\t"
                   "csrr a0, mscratch\n\t"
                   "j report_fault");
}

static const char *cause_name(uint32_t cause) {
    switch (cause) {
    case 0:
    case 4:
    case 6:
        return "alignment";
    case 1:
    case 5:
    case 7:
        return "access";
    case 2:
        return "illegal";
    default:
        return "unexpected";
    }
}

__attribute__((noreturn, used)) static void report_fault(uint32_t stack_pointer,
                                                         uint32_t return_address) {
    if (board_is_stopping()) {
        board_exit(BOARD_STATUS_FAULT);
    }
    board_puts("\nFAULT ");
    board_puts(cause_name(READ(mcause)));
    board_puts("\n");
    board_print_register("mcause", READ(mcause));
    board_print_register("mtval", READ(mtval));
    board_print_register("mstatus", READ(mstatus));
    board_print_register("pc", READ(mepc));
    board_print_register("ra", return_address);
    board_print_register("sp", stack_pointer);
    if (stack_pointer < (uintptr_t)board_stack_start) {
        board_puts("stack overflow\n");
    }
    board_stop_after_fault();
}
