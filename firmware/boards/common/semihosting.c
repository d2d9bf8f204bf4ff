#include "semihosting.h"

#include <stdint.h>

#define GET_CMDLINE 0x15u
#define EXIT_EXTENDED 0x20u
#define APPLICATION_EXIT 0x20026u

uintptr_t semihosting_call(uintptr_t operation, const void *argument);

/* Operation and argument are in the first two registers, and so is the answer. */
#if defined(__riscv)
/* Three uncompressed instructions within one page. */
__attribute__((naked, noinline, aligned(16))) uintptr_t semihosting_call(
    __attribute__((unused)) uintptr_t operation, __attribute__((unused)) const void *argument) {
    __asm volatile(".option push\n\t"
                   ".option norvc\n\t"
                   "slli x0, x0, 0x1f\n\t"
                   "ebreak\n\t"
                   "srai x0, x0, 7\n\t"
                   "ret\n\t"
                   ".option pop");
}
#else
__attribute__((naked, noinline)) uintptr_t semihosting_call(
    __attribute__((unused)) uintptr_t operation, __attribute__((unused)) const void *argument) {
    __asm volatile("bkpt 0xab\n\t"
                   "bx lr");
}
#endif

void semihosting_exit(int status) {
    const uintptr_t block[2] = {APPLICATION_EXIT, (uintptr_t)status};
    semihosting_call(EXIT_EXTENDED, block);
}

void semihosting_command_line(char *text, size_t room) {
    uintptr_t block[2] = {(uintptr_t)text, room};
    text[0] = '\0';
    if (semihosting_call(GET_CMDLINE, block) != 0) {
        text[0] = '\0';
    }
    text[room - 1] = '\0';
}
