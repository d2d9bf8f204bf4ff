/* fdcan.h - a CAN bus on the FDCAN controller of STM32G4 (RM0440, chapter "FDCAN"), in classical
 * mode.
 *
 *     static fdcan_t bus;
 *     const fdcan_config_t config = fdcan_config_default(registers, ram, clock, 170000000);
 *     stm32_can_result_t result = fdcan_open(&bus, &config, filters, filter_count);
 *     the controller's interrupt line 0: fdcan_interrupt(&bus);
 *     berth_can_t can = fdcan_can(&bus);
 *
 * The caller switches the controller's clock on (not divided: CKDIV as after reset), sets up its
 * pins, and enables the interrupt in the NVIC after fdcan_open.
 *
 * Contexts, receiving, bus errors, and what restarts and rx_lost count are as in bxcan.h. The two
 * sides share the queue, counters, and registers that act on the bits written as 1.
 *
 * Send. Three buffers as a queue: the most urgent id goes first, and of equal ids the lower buffer.
 * The controller names the buffer to be filled, its lowest free one; a frame whose id waits in a
 * higher one gets AGAIN, and so does any frame while all are full. So frames of one id leave in the
 * order in which they came.
 *
 * Receive. Up to 28 standard and 8 extended filters; others are rejected. FIFO 0 has three places.
 *
 * Bus-off. The controller stops by itself, so nothing leaves any more. Frames that wait are taken
 * back by the next call of send, receive or state, and at the latest before the restart, by
 * switching the controller's configuration on and off; they are counted in tx_dropped. Recovery by
 * stm32_can_recovery_t; there is none by hardware, so "at once" is with the next call. Then the
 * controller waits for 129 times 11 recessive bits.
 *
 * A controller that is found stopped or in restricted operation without bus-off (reset behind our
 * back, or its message RAM did not answer in time) is DOWN until it is opened again.
 */
#ifndef BERTH_HAL_FDCAN_H
#define BERTH_HAL_FDCAN_H

#include "berth_hal/can.h"
#include "berth_hal/clock.h"
#include "fdcan_regs.h"
#include "stm32_can.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define FDCAN_WAIT_US 10000
#define FDCAN_WAIT_LOOKS 200000u

typedef struct {
    fdcan_regs_t *regs;
    fdcan_ram_t *ram;  /* this controller's part */
    uint32_t clock_hz; /* of the kernel clock */
    uint32_t bit_rate;
    stm32_can_recovery_t recovery;
    int64_t restart_us; /* for STM32_CAN_RECOVER_AFTER */
    berth_clock_t clock;
} fdcan_config_t;

/* 1 Mbit/s, recovery a second after bus-off. */
fdcan_config_t fdcan_config_default(fdcan_regs_t *regs, fdcan_ram_t *ram, berth_clock_t clock,
                                    uint32_t clock_hz);

/* Private, but here so that the caller owns the memory. */
typedef enum {
    FDCAN_DOWN = 0,
    FDCAN_JOINING, /* set up; waiting for the bus to be idle */
    FDCAN_ON,
    FDCAN_OFF,      /* bus-off */
    FDCAN_REJOINING /* 129 times 11 recessive bits are being waited for */
} fdcan_phase_t;

typedef struct {
    fdcan_regs_t *regs;
    fdcan_ram_t *ram;
    berth_clock_t clock;
    stm32_can_recovery_t recovery;
    int64_t restart_us;
    fdcan_phase_t phase;
    int64_t off_us;                  /* when bus-off was noticed */
    bool ordered;                    /* fdcan_restart was called since */
    uint8_t taken;                   /* bit n: buffer n has a frame of ours */
    uint32_t held[FDCAN_TX_BUFFERS]; /* its first word */
    uint32_t bus_offs_seen;          /* of bus_offs, those that have been dealt with */
    uint32_t tx_dropped;
    uint32_t restarts;
    volatile uint32_t bus_offs; /* written by the interrupt, as are the next two */
    volatile uint32_t errors;
    volatile uint32_t rx_lost;
    stm32_can_ring_t received;
} fdcan_t;

/* As bxcan_open; FDCAN_WAIT_US and _LOOKS bound each of its three waits. */
stm32_can_result_t fdcan_open(fdcan_t *can, const fdcan_config_t *config,
                              const berth_can_filter_t *filters, uint32_t filter_count);

berth_can_t fdcan_can(fdcan_t *can);

/* To be called by the handler of interrupt line 0. */
void fdcan_interrupt(fdcan_t *can);

/* As their namesakes in bxcan.h. */
void fdcan_abort(fdcan_t *can);
void fdcan_restart(fdcan_t *can);
bool fdcan_has_input(const fdcan_t *can);

typedef struct {
    uint32_t transmit_errors; /* the controller's counters */
    uint32_t receive_errors;  /* 128: that or more */
    bool warning;             /* one of them is at 96 or more */
    bool passive;             /* at 128 or more */
    bool off;
} fdcan_diagnosis_t;

void fdcan_diagnosis(const fdcan_t *can, fdcan_diagnosis_t *out);

#ifdef __cplusplus
}
#endif

#endif
