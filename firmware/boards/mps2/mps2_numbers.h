/* mps2_numbers.h - what differs between the MPS2 images. Sources: Arm application notes AN385,
 * AN386, AN500 and AN505. */
#ifndef BERTH_BOARDS_MPS2_NUMBERS_H
#define BERTH_BOARDS_MPS2_NUMBERS_H

#if defined(MPS2_AN505)
#define MPS2_CLOCK_HZ 20000000u
#define MPS2_CONSOLE 0x50200000u
#define MPS2_BUS 0x50201000u
#define MPS2_BUS_LINE 34 /* first of the port's two interrupt lines */
#else
#define MPS2_CLOCK_HZ 25000000u
#define MPS2_CONSOLE 0x40004000u
#define MPS2_BUS 0x40005000u
#define MPS2_BUS_LINE 2
#endif

#define MPS2_BAUD 115200u

#endif
