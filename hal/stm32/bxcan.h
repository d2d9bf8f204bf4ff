/* bxcan.h - a CAN bus on the bxCAN controller of STM32F1 to F4 and L4 (RM0090, chapter "bxCAN").
 *
 *     static bxcan_t bus;
 *     const bxcan_config_t config = bxcan_config_default(registers, clock, 42000000);
 *     stm32_can_result_t result = bxcan_open(&bus, &config, filters, filter_count);
 *     the FIFO 0 interrupt:       bxcan_receive_interrupt(&bus);
 *     the status change (SCE) interrupt: bxcan_status_interrupt(&bus);
 *     berth_can_t can = bxcan_can(&bus);
 *
 * The caller switches the peripheral's clock on, sets up its pins, and enables the two interrupts
 * in the NVIC after bxcan_open. Both handlers need the same priority (or one that keeps them from
 * interrupting each other); any priority will do towards the rest.
 *
 * Contexts. send, receive, state, bxcan_abort, bxcan_restart and bxcan_diagnosis belong to one
 * context below both interrupts. No interrupt is masked anywhere. What is shared: the queue of
 * received frames (stm32_can.h has its rules), counters that one side alone writes, and the
 * transmit status register, which both sides only ever write with bits that act when 1.
 *
 * Send. No queue but the three mailboxes: AGAIN when none fits. The controller sends the mailbox
 * with the most urgent id first (TXFP off), so an urgent frame never waits for our own lesser ones.
 * Equal ids: it takes the lower mailbox first, so a frame goes into a mailbox above those that hold
 * its id, and gets AGAIN when there is none; so frames of one id leave in the order in which they
 * came. Failing transmissions are repeated until they succeed, bus-off, or bxcan_abort. No transmit
 * interrupt is used.
 *
 * Receive. Each filter takes one bank in 32-bit mask mode: exactly the frames asked for pass, data
 * and remote. The interrupt stamps and queues them. A full queue or FIFO keeps the older frames.
 * rx_lost counts frames lost at the queue, and each overrun of the FIFO once: how many frames an
 * overrun cost, the controller does not tell.
 *
 * Bus-off. Noticed by the interrupt, which takes back all frames that wait: they are counted in
 * tx_dropped and never sent late. send answers FAILED from then on, receive too once the queue is
 * empty. Recovery: see stm32_can_recovery_t. It is done in small steps by calls of send, receive
 * and state, none of which waits. restarts counts the returns, from bus-off and from DOWN.
 *
 * Bus errors (stuff, form, acknowledge, bit, CRC) interrupt and are counted in error_frames: at
 * most one in about 20 bit times.
 *
 * A controller that is found in initialisation or sleep mode without having been told so (it was
 * reset behind our back) is DOWN until it is opened again.
 */
#ifndef BERTH_HAL_BXCAN_H
#define BERTH_HAL_BXCAN_H

#include "berth_hal/can.h"
#include "berth_hal/clock.h"
#include "bxcan_regs.h"
#include "stm32_can.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* bxcan_open waits this long for the controller, twice: for the end of a frame under way, and for
 * an idle bus. By the clock, and by a number of looks in case the clock stands. */
#define BXCAN_WAIT_US 10000
#define BXCAN_WAIT_LOOKS 200000u

typedef struct {
    bxcan_regs_t *regs;    /* the controller */
    bxcan_regs_t *filters; /* the one that has the filters: CAN1, for CAN1 and for CAN2 */
    uint32_t first_bank;   /* its banks: CAN1's 0 to split - 1, CAN2's split to 27 */
    uint32_t split;        /* 0 to 28; written to the shared register: the same for both */
    uint32_t clock_hz;     /* of the peripheral (APB1) */
    uint32_t bit_rate;
    stm32_can_recovery_t recovery;
    int64_t restart_us; /* for STM32_CAN_RECOVER_AFTER */
    berth_clock_t clock;
} bxcan_config_t;

/* CAN1 alone: all 28 banks, 1 Mbit/s, recovery a second after bus-off. */
bxcan_config_t bxcan_config_default(bxcan_regs_t *can1, berth_clock_t clock, uint32_t clock_hz);

/* Private, but here so that the caller owns the memory. */
typedef enum {
    BXCAN_DOWN = 0,
    BXCAN_JOINING, /* set up; waiting for the bus to be idle */
    BXCAN_ON,
    BXCAN_OFF,      /* bus-off */
    BXCAN_STOPPING, /* bus-off, and initialisation mode asked for */
    BXCAN_REJOINING /* initialisation mode left; 128 times 11 recessive bits are being waited for */
} bxcan_phase_t;

typedef struct {
    bxcan_regs_t *regs;
    berth_clock_t clock;
    stm32_can_recovery_t recovery;
    int64_t restart_us;
    bxcan_phase_t phase;
    int64_t off_us;                 /* when bus-off was noticed */
    bool ordered;                   /* bxcan_restart was called since */
    uint8_t taken;                  /* bit n: mailbox n has a frame of ours */
    uint32_t held[BXCAN_MAILBOXES]; /* its identifier register */
    uint32_t bus_offs_seen;         /* of bus_offs, those that have been dealt with */
    uint32_t tx_dropped;
    uint32_t restarts;
    volatile uint32_t bus_offs; /* written by the status interrupt */
    volatile uint32_t errors;   /* likewise */
    volatile uint32_t rx_lost;  /* written by the receive interrupt */
    stm32_can_ring_t received;
} bxcan_t;

/* Sets the controller up and joins the bus. Returns what stm32_can_result_t says; after
 * ERROR_NOT_JOINED the bus is usable later, after the other errors it stays DOWN. No filters at
 * all: every frame passes. May be called again at any time, from the context of send, with the two
 * interrupts disabled; the counters begin anew. While it runs, the other controller that shares the
 * filters receives nothing. */
stm32_can_result_t bxcan_open(bxcan_t *can, const bxcan_config_t *config,
                              const berth_can_filter_t *filters, uint32_t filter_count);

berth_can_t bxcan_can(bxcan_t *can);

/* To be called by the handlers of the interrupts FIFO 0 and SCE. Some 150 instructions a frame. */
void bxcan_receive_interrupt(bxcan_t *can);
void bxcan_status_interrupt(bxcan_t *can);

/* Takes back the frames that wait; what is on the wire already still ends. Those that do not get
 * through are counted in tx_dropped when the controller has let go of them. */
void bxcan_abort(bxcan_t *can);

/* Leave bus-off now, however recovery was set. Without effect at other times. */
void bxcan_restart(bxcan_t *can);

/* Something can be received. Any context. */
bool bxcan_has_input(const bxcan_t *can);

typedef struct {
    uint32_t transmit_errors; /* the controller's counters; at 256 it is bus-off */
    uint32_t receive_errors;
    bool warning; /* one of them is at 96 or more */
    bool passive; /* at 128 or more */
    bool off;
} bxcan_diagnosis_t;

void bxcan_diagnosis(const bxcan_t *can, bxcan_diagnosis_t *out);

#ifdef __cplusplus
}
#endif

#endif
