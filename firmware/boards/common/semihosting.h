/* semihosting.h - calls to the emulator or debugger that runs the program: its end and its command
 * line. Arm's "Semihosting for AArch32 and AArch64", and RISC-V's adoption of it. */
#ifndef BERTH_BOARDS_SEMIHOSTING_H
#define BERTH_BOARDS_SEMIHOSTING_H

#include <stddef.h>

void semihosting_exit(int status);

/* The command line, ended by a zero; empty when there is none or it does not fit. */
void semihosting_command_line(char *text, size_t room);

#endif
