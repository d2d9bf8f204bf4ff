/* fdcan_regs.h - registers and message RAM of the FDCAN controller of STM32G4 (RM0440, chapter
 * "FDCAN"), as far as classical CAN needs them.
 *
 * Names are the reference manual's. A test compares offsets, fields, addresses and interrupt
 * numbers with published register data; the words of the message RAM's elements are not in there.
 */
#ifndef BERTH_HAL_FDCAN_REGS_H
#define BERTH_HAL_FDCAN_REGS_H

#include "stm32_io.h"

#include <stdint.h>

#define FDCAN_STANDARD_FILTERS 28u
#define FDCAN_EXTENDED_FILTERS 8u
#define FDCAN_RX_ELEMENTS 3u
#define FDCAN_TX_BUFFERS 3u

typedef struct {
    volatile uint32_t crel;
    volatile uint32_t endn;
    uint32_t reserved_08;
    volatile uint32_t dbtp;
    volatile uint32_t test;
    volatile uint32_t rwd;
    volatile uint32_t cccr;
    volatile uint32_t nbtp;
    volatile uint32_t tscc;
    volatile uint32_t tscv;
    volatile uint32_t tocc;
    volatile uint32_t tocv;
    uint32_t reserved_30[4];
    volatile uint32_t ecr;
    volatile uint32_t psr;
    volatile uint32_t tdcr;
    uint32_t reserved_4c;
    volatile uint32_t ir;
    volatile uint32_t ie;
    volatile uint32_t ils;
    volatile uint32_t ile;
    uint32_t reserved_60[8];
    volatile uint32_t rxgfc;
    volatile uint32_t xidam;
    volatile uint32_t hpms;
    uint32_t reserved_8c;
    volatile uint32_t rxf0s;
    volatile uint32_t rxf0a;
    volatile uint32_t rxf1s;
    volatile uint32_t rxf1a;
    uint32_t reserved_a0[8];
    volatile uint32_t txbc;
    volatile uint32_t txfqs;
    volatile uint32_t txbrp;
    volatile uint32_t txbar;
    volatile uint32_t txbcr;
    volatile uint32_t txbto;
    volatile uint32_t txbcf;
    volatile uint32_t txbtie;
    volatile uint32_t txbcie;
    volatile uint32_t txefs;
    volatile uint32_t txefa;
} fdcan_regs_t;

/* An element of a FIFO or a transmit buffer has room for 64 bytes of data; classical frames use the
 * first two words of it. */
#define FDCAN_ELEMENT_WORDS 18u

typedef struct {
    volatile uint32_t flssa[FDCAN_STANDARD_FILTERS];
    volatile uint32_t flesa[2u * FDCAN_EXTENDED_FILTERS];
    volatile uint32_t rxfifo0[FDCAN_RX_ELEMENTS * FDCAN_ELEMENT_WORDS];
    volatile uint32_t rxfifo1[FDCAN_RX_ELEMENTS * FDCAN_ELEMENT_WORDS];
    volatile uint32_t txefifo[6];
    volatile uint32_t txbuf[FDCAN_TX_BUFFERS * FDCAN_ELEMENT_WORDS];
} fdcan_ram_t;

/* STM32G4. */
#define STM32G4_FDCAN1_ADDRESS 0x40006400u
#define STM32G4_FDCAN2_ADDRESS 0x40006800u
#define STM32G4_FDCAN3_ADDRESS 0x40006c00u
#define STM32G4_FDCANRAM1_ADDRESS 0x4000a400u
#define STM32G4_FDCANRAM2_ADDRESS 0x4000a750u
#define STM32G4_FDCANRAM3_ADDRESS 0x4000aaa0u
#define STM32G4_FDCAN1_IT0_IRQ 21
#define STM32G4_FDCAN2_IT0_IRQ 86
#define STM32G4_FDCAN3_IT0_IRQ 88

#define FDCAN_CCCR_INIT STM32_BIT(0)
#define FDCAN_CCCR_CCE STM32_BIT(1)
#define FDCAN_CCCR_ASM STM32_BIT(2)
#define FDCAN_CCCR_CSA STM32_BIT(3)
#define FDCAN_CCCR_CSR STM32_BIT(4)

#define FDCAN_NBTP_NTSEG2 STM32_FIELD(0, 7)
#define FDCAN_NBTP_NTSEG1 STM32_FIELD(8, 8)
#define FDCAN_NBTP_NBRP STM32_FIELD(16, 9)
#define FDCAN_NBTP_NSJW STM32_FIELD(25, 7)

#define FDCAN_ECR_TEC STM32_FIELD(0, 8)
#define FDCAN_ECR_REC STM32_FIELD(8, 7)
#define FDCAN_ECR_RP STM32_BIT(15)

#define FDCAN_PSR_ACT STM32_FIELD(3, 2)
#define FDCAN_PSR_EP STM32_BIT(5)
#define FDCAN_PSR_EW STM32_BIT(6)
#define FDCAN_PSR_BO STM32_BIT(7)

#define FDCAN_IR_RF0N STM32_BIT(0)
#define FDCAN_IR_RF0L STM32_BIT(2)
#define FDCAN_IR_BO STM32_BIT(19)
#define FDCAN_IR_PEA STM32_BIT(21)
#define FDCAN_IR_PED STM32_BIT(22)

#define FDCAN_IE_RF0NE STM32_BIT(0)
#define FDCAN_IE_RF0LE STM32_BIT(2)
#define FDCAN_IE_BOE STM32_BIT(19)
#define FDCAN_IE_PEAE STM32_BIT(21)
#define FDCAN_IE_PEDE STM32_BIT(22)

#define FDCAN_ILE_EINT0 STM32_BIT(0)

#define FDCAN_RXGFC_RRFE STM32_BIT(0)
#define FDCAN_RXGFC_RRFS STM32_BIT(1)
#define FDCAN_RXGFC_ANFE STM32_FIELD(2, 2)
#define FDCAN_RXGFC_ANFS STM32_FIELD(4, 2)
#define FDCAN_RXGFC_F0OM STM32_BIT(9)
#define FDCAN_RXGFC_LSS STM32_FIELD(16, 5)
#define FDCAN_RXGFC_LSE STM32_FIELD(24, 4)

#define FDCAN_XIDAM_EIDM STM32_FIELD(0, 29)

#define FDCAN_RXF0S_F0FL STM32_FIELD(0, 4)
#define FDCAN_RXF0S_F0GI STM32_FIELD(8, 2)
#define FDCAN_RXF0A_F0AI STM32_FIELD(0, 3)

#define FDCAN_TXBC_TFQM STM32_BIT(24)

#define FDCAN_TXFQS_TFQPI STM32_FIELD(16, 2)
#define FDCAN_TXFQS_TFQF STM32_BIT(21)

/* Words of the message RAM. ELEMENT0 and 1: of the receive FIFO and of a transmit buffer. */
#define FDCAN_ELEMENT0_ID STM32_FIELD(0, 29) /* standard ids in its upper 11 bits */
#define FDCAN_ELEMENT0_RTR STM32_BIT(29)
#define FDCAN_ELEMENT0_XTD STM32_BIT(30)
#define FDCAN_ELEMENT1_DLC STM32_FIELD(16, 4)

#define FDCAN_STANDARD_SFID2 STM32_FIELD(0, 11)
#define FDCAN_STANDARD_SFID1 STM32_FIELD(16, 11)
#define FDCAN_STANDARD_SFEC STM32_FIELD(27, 3)
#define FDCAN_STANDARD_SFT STM32_FIELD(30, 2)
#define FDCAN_EXTENDED0_EFID1 STM32_FIELD(0, 29)
#define FDCAN_EXTENDED0_EFEC STM32_FIELD(29, 3)
#define FDCAN_EXTENDED1_EFID2 STM32_FIELD(0, 29)
#define FDCAN_EXTENDED1_EFT STM32_FIELD(30, 2)

#endif
