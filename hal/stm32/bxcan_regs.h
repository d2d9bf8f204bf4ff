/* bxcan_regs.h - registers of the bxCAN controller of STM32F1 to F4, L4 (RM0090 chapter "bxCAN").
 *
 * Names are the reference manual's. A test compares offsets, fields, addresses and interrupt
 * numbers with published register data.
 */
#ifndef BERTH_HAL_BXCAN_REGS_H
#define BERTH_HAL_BXCAN_REGS_H

#include "stm32_io.h"

#include <stdint.h>

#define BXCAN_MAILBOXES 3u
#define BXCAN_BANKS 28u

typedef struct {
    volatile uint32_t tir;
    volatile uint32_t tdtr;
    volatile uint32_t tdlr;
    volatile uint32_t tdhr;
} bxcan_tx_regs_t;

typedef struct {
    volatile uint32_t rir;
    volatile uint32_t rdtr;
    volatile uint32_t rdlr;
    volatile uint32_t rdhr;
} bxcan_rx_regs_t;

typedef struct {
    volatile uint32_t fr1;
    volatile uint32_t fr2;
} bxcan_bank_regs_t;

typedef struct {
    volatile uint32_t mcr;
    volatile uint32_t msr;
    volatile uint32_t tsr;
    volatile uint32_t rf0r;
    volatile uint32_t rf1r;
    volatile uint32_t ier;
    volatile uint32_t esr;
    volatile uint32_t btr;
    uint32_t reserved_20[88];
    bxcan_tx_regs_t tx[BXCAN_MAILBOXES];
    bxcan_rx_regs_t rx[2];
    uint32_t reserved_1d0[12];
    volatile uint32_t fmr;
    volatile uint32_t fm1r;
    uint32_t reserved_208;
    volatile uint32_t fs1r;
    uint32_t reserved_210;
    volatile uint32_t ffa1r;
    uint32_t reserved_218;
    volatile uint32_t fa1r;
    uint32_t reserved_220[8];
    bxcan_bank_regs_t
        bank[BXCAN_BANKS]; /* fmr and all that follows: CAN1's, for both controllers */
} bxcan_regs_t;

/* STM32F405. */
#define STM32F4_CAN1_ADDRESS 0x40006400u
#define STM32F4_CAN2_ADDRESS 0x40006800u
#define STM32F4_CAN1_TX_IRQ 19
#define STM32F4_CAN1_RX0_IRQ 20
#define STM32F4_CAN1_SCE_IRQ 22
#define STM32F4_CAN2_TX_IRQ 63
#define STM32F4_CAN2_RX0_IRQ 64
#define STM32F4_CAN2_SCE_IRQ 66

#define BXCAN_MCR_INRQ STM32_BIT(0)
#define BXCAN_MCR_SLEEP STM32_BIT(1)
#define BXCAN_MCR_TXFP STM32_BIT(2)
#define BXCAN_MCR_RFLM STM32_BIT(3)
#define BXCAN_MCR_NART STM32_BIT(4)
#define BXCAN_MCR_AWUM STM32_BIT(5)
#define BXCAN_MCR_ABOM STM32_BIT(6)
#define BXCAN_MCR_TTCM STM32_BIT(7)
#define BXCAN_MCR_RESET STM32_BIT(15)
#define BXCAN_MCR_DBF STM32_BIT(16)

#define BXCAN_MSR_INAK STM32_BIT(0)
#define BXCAN_MSR_SLAK STM32_BIT(1)
#define BXCAN_MSR_ERRI STM32_BIT(2)

/* Mailbox 0; those of 1 and 2 are BXCAN_TSR_NEXT further. */
#define BXCAN_TSR_RQCP0 STM32_BIT(0)
#define BXCAN_TSR_TXOK0 STM32_BIT(1)
#define BXCAN_TSR_ALST0 STM32_BIT(2)
#define BXCAN_TSR_TERR0 STM32_BIT(3)
#define BXCAN_TSR_ABRQ0 STM32_BIT(7)
#define BXCAN_TSR_RQCP1 STM32_BIT(8)
#define BXCAN_TSR_ABRQ1 STM32_BIT(15)
#define BXCAN_TSR_RQCP2 STM32_BIT(16)
#define BXCAN_TSR_ABRQ2 STM32_BIT(23)
#define BXCAN_TSR_TME0 STM32_BIT(26)
#define BXCAN_TSR_TME1 STM32_BIT(27)
#define BXCAN_TSR_TME2 STM32_BIT(28)

#define BXCAN_RF0R_FMP0 STM32_FIELD(0, 2)
#define BXCAN_RF0R_FULL0 STM32_BIT(3)
#define BXCAN_RF0R_FOVR0 STM32_BIT(4)
#define BXCAN_RF0R_RFOM0 STM32_BIT(5)

#define BXCAN_IER_TMEIE STM32_BIT(0)
#define BXCAN_IER_FMPIE0 STM32_BIT(1)
#define BXCAN_IER_FOVIE0 STM32_BIT(3)
#define BXCAN_IER_BOFIE STM32_BIT(10)
#define BXCAN_IER_LECIE STM32_BIT(11)
#define BXCAN_IER_ERRIE STM32_BIT(15)

#define BXCAN_ESR_EWGF STM32_BIT(0)
#define BXCAN_ESR_EPVF STM32_BIT(1)
#define BXCAN_ESR_BOFF STM32_BIT(2)
#define BXCAN_ESR_LEC STM32_FIELD(4, 3)
#define BXCAN_ESR_TEC STM32_FIELD(16, 8)
#define BXCAN_ESR_REC STM32_FIELD(24, 8)

#define BXCAN_BTR_BRP STM32_FIELD(0, 10)
#define BXCAN_BTR_TS1 STM32_FIELD(16, 4)
#define BXCAN_BTR_TS2 STM32_FIELD(20, 3)
#define BXCAN_BTR_SJW STM32_FIELD(24, 2)
#define BXCAN_BTR_LBKM STM32_BIT(30)
#define BXCAN_BTR_SILM STM32_BIT(31)

#define BXCAN_TIR_TXRQ STM32_BIT(0)
#define BXCAN_TIR_RTR STM32_BIT(1)
#define BXCAN_TIR_IDE STM32_BIT(2)
#define BXCAN_TIR_EXID STM32_FIELD(3, 18)
#define BXCAN_TIR_STID STM32_FIELD(21, 11)

#define BXCAN_TDTR_DLC STM32_FIELD(0, 4)

#define BXCAN_RIR_RTR STM32_BIT(1)
#define BXCAN_RIR_IDE STM32_BIT(2)
#define BXCAN_RIR_EXID STM32_FIELD(3, 18)
#define BXCAN_RIR_STID STM32_FIELD(21, 11)

#define BXCAN_RDTR_DLC STM32_FIELD(0, 4)

#define BXCAN_FMR_FINIT STM32_BIT(0)
#define BXCAN_FMR_CAN2SB STM32_FIELD(8, 6)

#endif
