#include "fdcan.h"

#include <stddef.h>

#define ALL_BUFFERS ((1u << FDCAN_TX_BUFFERS) - 1u)
#define STANDARD_SHIFT 18u

#define STORE_IN_FIFO0 1u  /* of a filter element */
#define CLASSIC_MASK 2u    /* filter type: id and mask */
#define ACCEPT_IN_FIFO0 0u /* of what passes no filter */
#define REJECT 2u
#define SYNCHRONIZING 0u /* activity */

#define INTERRUPTS (FDCAN_IR_RF0N | FDCAN_IR_RF0L | FDCAN_IR_BO | FDCAN_IR_PEA | FDCAN_IR_PED)

/* Frames that one interrupt takes at most. Each takes longer on the wire than here, so the FIFO is
 * empty long before. */
#define INTERRUPT_FRAMES 16u

static const stm32_can_limits_t limits = {512, 256, 128, 128};

static int64_t now_us(const fdcan_t *can) {
    return can->clock.api->now_us(can->clock.context);
}

static bool wait_for(const fdcan_t *can, const volatile uint32_t *reg, uint32_t mask,
                     uint32_t value) {
    const int64_t start_us = now_us(can);
    for (uint32_t looks = 0; looks < FDCAN_WAIT_LOOKS; looks++) {
        if ((stm32_read(reg) & mask) == value) {
            return true;
        }
        if (now_us(can) - start_us >= FDCAN_WAIT_US) {
            break;
        }
    }
    return (stm32_read(reg) & mask) == value;
}

/* ---- Frames and the message RAM ---------------------------------------------------------------
 */

static uint32_t first_word(const berth_can_frame_t *frame) {
    const uint32_t kind = frame->remote ? FDCAN_ELEMENT0_RTR : 0u;
    return frame->extended ? kind | FDCAN_ELEMENT0_XTD | frame->id
                           : kind | (frame->id << STANDARD_SHIFT);
}

static void read_frame(const volatile uint32_t *element, berth_can_frame_t *frame) {
    const uint32_t word = stm32_read(&element[0]);
    const uint32_t length = stm32_get(stm32_read(&element[1]), FDCAN_ELEMENT1_DLC);
    const uint32_t words[2] = {stm32_read(&element[2]), stm32_read(&element[3])};
    frame->extended = (word & FDCAN_ELEMENT0_XTD) != 0u;
    frame->remote = (word & FDCAN_ELEMENT0_RTR) != 0u;
    frame->id = (word & FDCAN_ELEMENT0_ID) >> (frame->extended ? 0u : STANDARD_SHIFT);
    /* Length codes 9 to 15 are sent by some, and mean 8. */
    frame->length = (uint8_t)(length < BERTH_CAN_DATA_MAX ? length : BERTH_CAN_DATA_MAX);
    stm32_can_unpack(frame, words);
}

/* ---- Opening ----------------------------------------------------------------------------------
 */

fdcan_config_t fdcan_config_default(fdcan_regs_t *regs, fdcan_ram_t *ram, berth_clock_t clock,
                                    uint32_t clock_hz) {
    return (fdcan_config_t){.regs = regs,
                            .ram = ram,
                            .clock_hz = clock_hz,
                            .bit_rate = 1000000,
                            .recovery = STM32_CAN_RECOVER_AFTER,
                            .restart_us = 1000000,
                            .clock = clock};
}

static stm32_can_result_t check(const fdcan_config_t *config, const berth_can_filter_t *filters,
                                uint32_t filter_count) {
    if (config->regs == NULL || config->ram == NULL || config->clock.api == NULL ||
        (filters == NULL && filter_count > 0u) || config->restart_us < 0) {
        return STM32_CAN_ERROR_ARGUMENT;
    }
    uint32_t extended = 0;
    for (uint32_t i = 0; i < filter_count; i++) {
        if (!stm32_can_filter_is_good(&filters[i])) {
            return STM32_CAN_ERROR_FILTERS;
        }
        extended += filters[i].extended ? 1u : 0u;
    }
    return extended <= FDCAN_EXTENDED_FILTERS && filter_count - extended <= FDCAN_STANDARD_FILTERS
               ? STM32_CAN_OK
               : STM32_CAN_ERROR_FILTERS;
}

static void write_filters(const fdcan_t *can, const berth_can_filter_t *filters,
                          uint32_t filter_count) {
    fdcan_ram_t *ram = can->ram;
    uint32_t standard = 0;
    uint32_t extended = 0;
    for (uint32_t i = 0; i < filter_count; i++) {
        const berth_can_filter_t *filter = &filters[i];
        if (filter->extended) {
            stm32_write(&ram->flesa[2u * (size_t)extended],
                        stm32_put(FDCAN_EXTENDED0_EFEC, STORE_IN_FIFO0) |
                            stm32_put(FDCAN_EXTENDED0_EFID1, filter->id));
            stm32_write(&ram->flesa[2u * extended + 1u],
                        stm32_put(FDCAN_EXTENDED1_EFT, CLASSIC_MASK) |
                            stm32_put(FDCAN_EXTENDED1_EFID2, filter->mask));
            extended++;
        } else {
            stm32_write(&ram->flssa[standard], stm32_put(FDCAN_STANDARD_SFT, CLASSIC_MASK) |
                                                   stm32_put(FDCAN_STANDARD_SFEC, STORE_IN_FIFO0) |
                                                   stm32_put(FDCAN_STANDARD_SFID1, filter->id) |
                                                   stm32_put(FDCAN_STANDARD_SFID2, filter->mask));
            standard++;
        }
    }
    /* Remote frames go through the filters too; a full FIFO keeps what it has. */
    const uint32_t others = filter_count > 0u ? REJECT : ACCEPT_IN_FIFO0;
    stm32_write(&can->regs->rxgfc,
                stm32_put(FDCAN_RXGFC_ANFE, others) | stm32_put(FDCAN_RXGFC_ANFS, others) |
                    stm32_put(FDCAN_RXGFC_LSS, standard) | stm32_put(FDCAN_RXGFC_LSE, extended));
    stm32_write(&can->regs->xidam, FDCAN_XIDAM_EIDM);
}

/* Stops the controller and opens its configuration, which also empties FIFO and buffers. */
static bool stop(const fdcan_t *can) {
    fdcan_regs_t *regs = can->regs;
    stm32_write(&regs->cccr, FDCAN_CCCR_INIT);
    if (!wait_for(can, &regs->cccr, FDCAN_CCCR_INIT | FDCAN_CCCR_CSA, FDCAN_CCCR_INIT)) {
        return false;
    }
    stm32_write(&regs->cccr, FDCAN_CCCR_INIT | FDCAN_CCCR_CCE);
    return wait_for(can, &regs->cccr, FDCAN_CCCR_CCE, FDCAN_CCCR_CCE);
}

static void write_timing(fdcan_regs_t *regs, const stm32_can_timing_t *timing) {
    stm32_write(&regs->nbtp, stm32_put(FDCAN_NBTP_NBRP, timing->prescaler - 1u) |
                                 stm32_put(FDCAN_NBTP_NTSEG1, timing->segment1 - 1u) |
                                 stm32_put(FDCAN_NBTP_NTSEG2, timing->segment2 - 1u) |
                                 stm32_put(FDCAN_NBTP_NSJW, timing->jump - 1u));
}

static void write_interrupts(fdcan_regs_t *regs) {
    stm32_write(&regs->ir, ~0u);
    stm32_write(&regs->ie,
                FDCAN_IE_RF0NE | FDCAN_IE_RF0LE | FDCAN_IE_BOE | FDCAN_IE_PEAE | FDCAN_IE_PEDE);
    stm32_write(&regs->ils, 0);
    stm32_write(&regs->ile, FDCAN_ILE_EINT0);
}

stm32_can_result_t fdcan_open(fdcan_t *can, const fdcan_config_t *config,
                              const berth_can_filter_t *filters, uint32_t filter_count) {
    stm32_can_timing_t timing;
    *can = (fdcan_t){.regs = config->regs,
                     .ram = config->ram,
                     .clock = config->clock,
                     .recovery = config->recovery,
                     .restart_us = config->restart_us};
    const stm32_can_result_t result = check(config, filters, filter_count);
    if (result != STM32_CAN_OK) {
        return result;
    }
    if (!stm32_can_timing(config->clock_hz, config->bit_rate, &limits, &timing)) {
        return STM32_CAN_ERROR_TIMING;
    }
    fdcan_regs_t *regs = can->regs;
    if (!stop(can)) {
        return STM32_CAN_ERROR_SILENT;
    }
    write_timing(regs, &timing);
    write_filters(can, filters, filter_count);
    stm32_write(&regs->txbc, FDCAN_TXBC_TFQM);
    write_interrupts(regs);
    stm32_write(&regs->cccr, 0);
    can->phase = FDCAN_JOINING;
    if (!wait_for(can, &regs->cccr, FDCAN_CCCR_INIT, 0)) {
        can->phase = FDCAN_DOWN;
        return STM32_CAN_ERROR_SILENT;
    }
    const int64_t start_us = now_us(can);
    for (uint32_t looks = 0; looks < FDCAN_WAIT_LOOKS && now_us(can) - start_us < FDCAN_WAIT_US;
         looks++) {
        if (stm32_get(stm32_read(&regs->psr), FDCAN_PSR_ACT) != SYNCHRONIZING) {
            can->phase = FDCAN_ON;
            return STM32_CAN_OK;
        }
    }
    return STM32_CAN_ERROR_NOT_JOINED;
}

/* ---- Looking after the controller -------------------------------------------------------------
 */

/* Gives back the buffers that the controller is done with. */
static void collect(fdcan_t *can) {
    if (can->taken == 0u) {
        return;
    }
    const uint32_t pending = stm32_read(&can->regs->txbrp);
    const uint32_t sent = stm32_read(&can->regs->txbto);
    for (uint32_t i = 0; i < FDCAN_TX_BUFFERS; i++) {
        const uint32_t bit = 1u << i;
        if ((can->taken & bit) != 0u && (pending & bit) == 0u) {
            if ((sent & bit) == 0u) {
                stm32_can_count(&can->tx_dropped);
            }
            can->taken &= (uint8_t)~bit;
        }
    }
}

static void drop_taken(fdcan_t *can) {
    for (; can->taken != 0u; can->taken &= (uint8_t)(can->taken - 1u)) {
        stm32_can_count(&can->tx_dropped);
    }
}

void fdcan_abort(fdcan_t *can) {
    if (can->phase == FDCAN_DOWN) {
        return;
    }
    collect(can);
    stm32_write(&can->regs->txbcr, ALL_BUFFERS);
}

static void back_on(fdcan_t *can) {
    can->phase = FDCAN_ON;
    stm32_can_count(&can->restarts);
}

static void go_off(fdcan_t *can) {
    can->phase = FDCAN_OFF;
    can->off_us = now_us(can);
    can->ordered = false;
    stm32_write(&can->regs->txbcr, ALL_BUFFERS);
    collect(can);
}

static bool is_restart_due(const fdcan_t *can) {
    switch (can->recovery) {
    case STM32_CAN_RECOVER_AFTER:
        return can->ordered || now_us(can) - can->off_us >= can->restart_us;
    case STM32_CAN_RECOVER_ORDERED:
        return can->ordered;
    default:
        return true;
    }
}

/* Opening the configuration empties the buffers. FIFO 0 has been emptied by the interrupt, and
 * nothing comes in while the controller stands. */
static void restart(fdcan_t *can) {
    collect(can);
    stm32_write(&can->regs->cccr, FDCAN_CCCR_INIT | FDCAN_CCCR_CCE);
    drop_taken(can);
    stm32_write(&can->regs->cccr, 0);
    can->phase = FDCAN_REJOINING;
}

/* One look, without waiting. */
static void look(fdcan_t *can) {
    if (can->phase == FDCAN_DOWN) {
        return;
    }
    collect(can);
    const uint32_t cccr = stm32_read(&can->regs->cccr);
    const uint32_t psr = stm32_read(&can->regs->psr);
    const bool off = (psr & FDCAN_PSR_BO) != 0u;
    const uint32_t bus_offs = can->bus_offs;
    const bool anew = bus_offs != can->bus_offs_seen;
    can->bus_offs_seen = bus_offs;
    if (can->phase == FDCAN_OFF) {
        if (is_restart_due(can)) {
            restart(can);
        }
    } else if (anew || (off && can->phase != FDCAN_REJOINING)) {
        go_off(can);
    } else if ((cccr & FDCAN_CCCR_ASM) != 0u ||
               ((cccr & FDCAN_CCCR_INIT) != 0u && can->phase == FDCAN_ON)) {
        drop_taken(can);
        can->phase = FDCAN_DOWN;
    } else if (can->phase != FDCAN_ON && !off && (cccr & FDCAN_CCCR_INIT) == 0u &&
               stm32_get(psr, FDCAN_PSR_ACT) != SYNCHRONIZING) {
        back_on(can);
    } else {
        /* as it was */
    }
}

void fdcan_restart(fdcan_t *can) {
    look(can);
    can->ordered = can->phase == FDCAN_OFF;
    look(can);
}

/* ---- The contract -----------------------------------------------------------------------------
 */

/* The buffer that the controller offers, if it keeps the order of frames of one id;
 * FDCAN_TX_BUFFERS: none. */
static uint32_t choose(const fdcan_t *can, uint32_t word) {
    const uint32_t status = stm32_read(&can->regs->txfqs);
    const uint32_t offered = stm32_get(status, FDCAN_TXFQS_TFQPI);
    if ((status & FDCAN_TXFQS_TFQF) != 0u || offered >= FDCAN_TX_BUFFERS ||
        (can->taken & (1u << offered)) != 0u) {
        return FDCAN_TX_BUFFERS;
    }
    for (uint32_t i = 0; i < FDCAN_TX_BUFFERS; i++) {
        const uint32_t difference = can->held[i] ^ word;
        /* Of a data and a remote frame with one id, the data frame goes first from any buffer. */
        if ((can->taken & (1u << i)) != 0u && (difference & ~FDCAN_ELEMENT0_RTR) == 0u &&
            (difference != 0u || i > offered)) {
            return FDCAN_TX_BUFFERS;
        }
    }
    return offered;
}

static berth_can_outcome_t send(void *context, const berth_can_frame_t *frame) {
    fdcan_t *can = context;
    if (!stm32_can_frame_is_good(frame)) {
        return BERTH_CAN_FAILED;
    }
    look(can);
    if (can->phase != FDCAN_ON) {
        return BERTH_CAN_FAILED;
    }
    uint32_t words[2];
    const uint32_t word = first_word(frame);
    const uint32_t buffer = choose(can, word);
    if (buffer == FDCAN_TX_BUFFERS) {
        return BERTH_CAN_AGAIN;
    }
    volatile uint32_t *element = &can->ram->txbuf[(size_t)buffer * FDCAN_ELEMENT_WORDS];
    stm32_can_pack(frame, words);
    stm32_write(&element[0], word);
    stm32_write(&element[1], stm32_put(FDCAN_ELEMENT1_DLC, frame->length));
    stm32_write(&element[2], words[0]);
    stm32_write(&element[3], words[1]);
    can->taken |= (uint8_t)(1u << buffer);
    can->held[buffer] = word;
    stm32_write(&can->regs->txbar, 1u << buffer);
    return BERTH_CAN_DONE;
}

static berth_can_outcome_t receive(void *context, berth_can_frame_t *frame) {
    fdcan_t *can = context;
    if (stm32_can_ring_take(&can->received, frame)) {
        return BERTH_CAN_DONE;
    }
    look(can);
    return can->phase == FDCAN_ON ? BERTH_CAN_AGAIN : BERTH_CAN_FAILED;
}

static berth_can_mode_t mode_of(const fdcan_t *can) {
    switch (can->phase) {
    case FDCAN_DOWN:
    case FDCAN_JOINING:
        return BERTH_CAN_DOWN;
    case FDCAN_ON:
        return (stm32_read(&can->regs->psr) & FDCAN_PSR_EP) != 0u ? BERTH_CAN_ERROR_PASSIVE
                                                                  : BERTH_CAN_ERROR_ACTIVE;
    default:
        return BERTH_CAN_BUS_OFF;
    }
}

static void state(void *context, berth_can_state_t *out) {
    fdcan_t *can = context;
    look(can);
    *out = (berth_can_state_t){.mode = mode_of(can),
                               .rx_lost = can->rx_lost,
                               .tx_dropped = can->tx_dropped,
                               .error_frames = can->errors,
                               .restarts = can->restarts};
}

berth_can_t fdcan_can(fdcan_t *can) {
    static const berth_can_api_t api = {send, receive, state};
    return (berth_can_t){&api, can};
}

bool fdcan_has_input(const fdcan_t *can) {
    return !stm32_can_ring_is_empty(&can->received);
}

void fdcan_diagnosis(const fdcan_t *can, fdcan_diagnosis_t *out) {
    *out = (fdcan_diagnosis_t){0};
    if (can->phase != FDCAN_DOWN) {
        const uint32_t ecr = stm32_read(&can->regs->ecr);
        const uint32_t psr = stm32_read(&can->regs->psr);
        out->transmit_errors = stm32_get(ecr, FDCAN_ECR_TEC);
        out->receive_errors = (ecr & FDCAN_ECR_RP) != 0u ? 128u : stm32_get(ecr, FDCAN_ECR_REC);
        out->warning = (psr & FDCAN_PSR_EW) != 0u;
        out->passive = (psr & FDCAN_PSR_EP) != 0u;
        out->off = (psr & FDCAN_PSR_BO) != 0u;
    }
}

/* ---- Interrupt --------------------------------------------------------------------------------
 */

static void take_frames(fdcan_t *can, int64_t time_us) {
    for (uint32_t i = 0; i < INTERRUPT_FRAMES; i++) {
        const uint32_t status = stm32_read(&can->regs->rxf0s);
        if ((status & FDCAN_RXF0S_F0FL) == 0u) {
            return;
        }
        const uint32_t index = stm32_get(status, FDCAN_RXF0S_F0GI);
        berth_can_frame_t *place = stm32_can_ring_place(&can->received);
        if (place != NULL && index < FDCAN_RX_ELEMENTS) {
            place->time_us = time_us;
            read_frame(&can->ram->rxfifo0[(size_t)index * FDCAN_ELEMENT_WORDS], place);
            stm32_can_ring_put(&can->received);
        } else {
            stm32_can_count(&can->rx_lost);
        }
        stm32_write(&can->regs->rxf0a, stm32_put(FDCAN_RXF0A_F0AI, index));
    }
}

void fdcan_interrupt(fdcan_t *can) {
    fdcan_regs_t *regs = can->regs;
    const int64_t time_us = now_us(can);
    const uint32_t why = stm32_read(&regs->ir) & INTERRUPTS;
    /* First, so that what happens from here on interrupts anew. */
    stm32_write(&regs->ir, why);
    if ((why & FDCAN_IR_RF0L) != 0u) {
        stm32_can_count(&can->rx_lost);
    }
    take_frames(can, time_us);
    if ((why & (FDCAN_IR_PEA | FDCAN_IR_PED)) != 0u) {
        stm32_can_count(&can->errors);
    }
    /* It tells of the way back too. Frames that wait cannot leave: the controller stands. */
    if ((why & FDCAN_IR_BO) != 0u && (stm32_read(&regs->psr) & FDCAN_PSR_BO) != 0u) {
        can->bus_offs = can->bus_offs + 1u;
    }
}
