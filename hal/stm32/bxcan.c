#include "bxcan.h"

#include <stddef.h>

#define BXCAN_TSR_NEXT 8u
#define ABORT_ALL (BXCAN_TSR_ABRQ0 | BXCAN_TSR_ABRQ1 | BXCAN_TSR_ABRQ2)
#define DONE_ALL (BXCAN_TSR_RQCP0 | BXCAN_TSR_RQCP1 | BXCAN_TSR_RQCP2)
#define LEC_NONE 0u
#define LEC_BY_SOFTWARE 7u

/* Looks until a released mailbox gives way to the next frame: a few clocks of the bus. */
#define RELEASE_LOOKS 32u
/* Frames that one interrupt takes at most; the line stays active for the rest. */
#define INTERRUPT_FRAMES 8u

static const stm32_can_limits_t limits = {1024, 16, 8, 4};

static int64_t now_us(const bxcan_t *can) {
    return can->clock.api->now_us(can->clock.context);
}

static bool wait_status(const bxcan_t *can, uint32_t mask, uint32_t value) {
    const int64_t start_us = now_us(can);
    for (uint32_t looks = 0; looks < BXCAN_WAIT_LOOKS; looks++) {
        if ((stm32_read(&can->regs->msr) & mask) == value) {
            return true;
        }
        if (now_us(can) - start_us >= BXCAN_WAIT_US) {
            break;
        }
    }
    return (stm32_read(&can->regs->msr) & mask) == value;
}

/* ---- Frames and registers ---------------------------------------------------------------------
 */

static uint32_t identifier_word(const berth_can_frame_t *frame) {
    const uint32_t kind = frame->remote ? BXCAN_TIR_RTR : 0u;
    if (frame->extended) {
        return kind | BXCAN_TIR_IDE | stm32_put(BXCAN_TIR_STID, frame->id >> 18) |
               stm32_put(BXCAN_TIR_EXID, frame->id);
    }
    return kind | stm32_put(BXCAN_TIR_STID, frame->id);
}

static void read_frame(const bxcan_rx_regs_t *box, berth_can_frame_t *frame) {
    const uint32_t rir = stm32_read(&box->rir);
    const uint32_t length = stm32_get(stm32_read(&box->rdtr), BXCAN_RDTR_DLC);
    const uint32_t words[2] = {stm32_read(&box->rdlr), stm32_read(&box->rdhr)};
    const uint32_t base = stm32_get(rir, BXCAN_RIR_STID);
    frame->extended = (rir & BXCAN_RIR_IDE) != 0u;
    frame->remote = (rir & BXCAN_RIR_RTR) != 0u;
    frame->id = frame->extended ? (base << 18) | stm32_get(rir, BXCAN_RIR_EXID) : base;
    /* Length codes 9 to 15 are sent by some, and mean 8. */
    frame->length = (uint8_t)(length < BERTH_CAN_DATA_MAX ? length : BERTH_CAN_DATA_MAX);
    stm32_can_unpack(frame, words);
}

/* ---- Opening ----------------------------------------------------------------------------------
 */

bxcan_config_t bxcan_config_default(bxcan_regs_t *can1, berth_clock_t clock, uint32_t clock_hz) {
    return (bxcan_config_t){.regs = can1,
                            .filters = can1,
                            .first_bank = 0,
                            .split = BXCAN_BANKS,
                            .clock_hz = clock_hz,
                            .bit_rate = 1000000,
                            .recovery = STM32_CAN_RECOVER_AFTER,
                            .restart_us = 1000000,
                            .clock = clock};
}

/* The banks from first_bank on that are this controller's. */
static uint32_t bank_count(const bxcan_config_t *config) {
    if (config->first_bank < config->split) {
        return config->split - config->first_bank;
    }
    return BXCAN_BANKS - config->first_bank;
}

static stm32_can_result_t check(const bxcan_config_t *config, const berth_can_filter_t *filters,
                                uint32_t filter_count) {
    if (config->regs == NULL || config->filters == NULL || config->clock.api == NULL ||
        (filters == NULL && filter_count > 0u) || config->split > BXCAN_BANKS ||
        config->first_bank >= BXCAN_BANKS || config->restart_us < 0) {
        return STM32_CAN_ERROR_ARGUMENT;
    }
    if (filter_count > bank_count(config)) {
        return STM32_CAN_ERROR_FILTERS;
    }
    for (uint32_t i = 0; i < filter_count; i++) {
        if (!stm32_can_filter_is_good(&filters[i])) {
            return STM32_CAN_ERROR_FILTERS;
        }
    }
    return STM32_CAN_OK;
}

static void write_bank(bxcan_bank_regs_t *bank, const berth_can_filter_t *filter) {
    const berth_can_frame_t id = {.id = filter->id, .extended = filter->extended};
    const berth_can_frame_t mask = {.id = filter->mask, .extended = filter->extended};
    stm32_write(&bank->fr1, identifier_word(&id));
    /* The format counts, whether it is a remote frame does not. */
    stm32_write(&bank->fr2, identifier_word(&mask) | BXCAN_TIR_IDE);
}

static void write_filters(const bxcan_config_t *config, const berth_can_filter_t *filters,
                          uint32_t filter_count) {
    bxcan_regs_t *regs = config->filters;
    const uint32_t count = filter_count > 0u ? filter_count : 1u;
    const uint32_t own = (0xffffffffu >> (32u - bank_count(config))) << config->first_bank;
    const uint32_t used = (0xffffffffu >> (32u - count)) << config->first_bank;
    stm32_write(&regs->fmr, BXCAN_FMR_FINIT | stm32_put(BXCAN_FMR_CAN2SB, config->split));
    stm32_change(&regs->fa1r, own, 0);
    stm32_change(&regs->fm1r, own, 0);  /* masks */
    stm32_change(&regs->fs1r, 0, own);  /* of 32 bits */
    stm32_change(&regs->ffa1r, own, 0); /* to FIFO 0 */
    for (uint32_t i = 0; i < filter_count; i++) {
        write_bank(&regs->bank[config->first_bank + i], &filters[i]);
    }
    if (filter_count == 0u) {
        stm32_write(&regs->bank[config->first_bank].fr1, 0);
        stm32_write(&regs->bank[config->first_bank].fr2, 0);
    }
    stm32_change(&regs->fa1r, 0, used);
    stm32_write(&regs->fmr, stm32_put(BXCAN_FMR_CAN2SB, config->split));
}

static void release(bxcan_regs_t *regs) {
    stm32_write(&regs->rf0r, BXCAN_RF0R_RFOM0);
    for (uint32_t looks = 0; looks < RELEASE_LOOKS; looks++) {
        if ((stm32_read(&regs->rf0r) & BXCAN_RF0R_RFOM0) == 0u) {
            return;
        }
    }
}

/* What is left of an earlier life. */
static void clear(bxcan_regs_t *regs) {
    stm32_write(&regs->ier, 0);
    stm32_write(&regs->tsr, ABORT_ALL);
    stm32_write(&regs->tsr, DONE_ALL);
    for (uint32_t i = 0; i < 3u && (stm32_read(&regs->rf0r) & BXCAN_RF0R_FMP0) != 0u; i++) {
        release(regs);
    }
    stm32_write(&regs->rf0r, BXCAN_RF0R_FULL0 | BXCAN_RF0R_FOVR0);
    stm32_write(&regs->msr, BXCAN_MSR_ERRI);
}

static uint32_t mode_word(const bxcan_t *can) {
    const bool at_once = can->recovery == STM32_CAN_RECOVER_AT_ONCE;
    return BXCAN_MCR_RFLM | BXCAN_MCR_DBF | (at_once ? BXCAN_MCR_ABOM : 0u);
}

static void write_timing(bxcan_regs_t *regs, const stm32_can_timing_t *timing) {
    stm32_write(&regs->btr, stm32_put(BXCAN_BTR_BRP, timing->prescaler - 1u) |
                                stm32_put(BXCAN_BTR_TS1, timing->segment1 - 1u) |
                                stm32_put(BXCAN_BTR_TS2, timing->segment2 - 1u) |
                                stm32_put(BXCAN_BTR_SJW, timing->jump - 1u));
}

stm32_can_result_t bxcan_open(bxcan_t *can, const bxcan_config_t *config,
                              const berth_can_filter_t *filters, uint32_t filter_count) {
    stm32_can_timing_t timing;
    *can = (bxcan_t){.regs = config->regs,
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
    bxcan_regs_t *regs = can->regs;
    stm32_write(&regs->mcr, mode_word(can) | BXCAN_MCR_INRQ);
    if (!wait_status(can, BXCAN_MSR_INAK | BXCAN_MSR_SLAK, BXCAN_MSR_INAK)) {
        return STM32_CAN_ERROR_SILENT;
    }
    write_timing(regs, &timing);
    write_filters(config, filters, filter_count);
    clear(regs);
    stm32_write(&regs->ier, BXCAN_IER_FMPIE0 | BXCAN_IER_FOVIE0 | BXCAN_IER_BOFIE |
                                BXCAN_IER_LECIE | BXCAN_IER_ERRIE);
    stm32_write(&regs->mcr, mode_word(can));
    can->phase = BXCAN_JOINING;
    if (!wait_status(can, BXCAN_MSR_INAK, 0)) {
        return STM32_CAN_ERROR_NOT_JOINED;
    }
    can->phase = BXCAN_ON;
    return STM32_CAN_OK;
}

/* ---- Looking after the controller -------------------------------------------------------------
 */

/* Gives back the mailboxes that the controller is done with. */
static void collect(bxcan_t *can) {
    const uint32_t tsr = stm32_read(&can->regs->tsr);
    uint32_t done = 0;
    for (uint32_t box = 0; box < BXCAN_MAILBOXES; box++) {
        const uint32_t shift = box * BXCAN_TSR_NEXT;
        if ((can->taken & (1u << box)) == 0u || (tsr & (BXCAN_TSR_RQCP0 << shift)) == 0u) {
            continue;
        }
        if ((tsr & (BXCAN_TSR_TXOK0 << shift)) == 0u) {
            stm32_can_count(&can->tx_dropped);
        }
        can->taken &= (uint8_t)~(1u << box);
        done |= BXCAN_TSR_RQCP0 << shift;
    }
    if (done != 0u) {
        stm32_write(&can->regs->tsr, done);
    }
}

void bxcan_abort(bxcan_t *can) {
    if (can->phase == BXCAN_DOWN) {
        return;
    }
    collect(can);
    stm32_write(&can->regs->tsr, ABORT_ALL);
}

static void back_on(bxcan_t *can) {
    can->phase = BXCAN_ON;
    stm32_can_count(&can->restarts);
}

static bool is_restart_due(const bxcan_t *can) {
    switch (can->recovery) {
    case STM32_CAN_RECOVER_AFTER:
        return can->ordered || now_us(can) - can->off_us >= can->restart_us;
    case STM32_CAN_RECOVER_ORDERED:
        return can->ordered;
    default: /* the hardware does it */
        return false;
    }
}

static void go_off(bxcan_t *can) {
    can->phase = BXCAN_OFF;
    can->off_us = now_us(can);
    can->ordered = false;
    stm32_write(&can->regs->tsr, ABORT_ALL);
    collect(can);
}

static void look_while_off(bxcan_t *can, uint32_t msr, bool off, bool anew) {
    bxcan_regs_t *regs = can->regs;
    /* A frame that came between bus-off and its interrupt. */
    if (can->taken != 0u) {
        stm32_write(&regs->tsr, ABORT_ALL);
        collect(can);
    }
    if (can->phase == BXCAN_OFF) {
        if (!off) {
            back_on(can);
        } else if (is_restart_due(can)) {
            stm32_write(&regs->mcr, mode_word(can) | BXCAN_MCR_INRQ);
            can->phase = BXCAN_STOPPING;
        } else {
            /* it stays off */
        }
    } else if (can->phase == BXCAN_STOPPING) {
        if ((msr & BXCAN_MSR_INAK) != 0u) {
            stm32_write(&regs->mcr, mode_word(can));
            can->phase = BXCAN_REJOINING;
        }
    } else if (anew) {
        go_off(can); /* it was back, and off again, between two looks */
    } else if (!off && (msr & BXCAN_MSR_INAK) == 0u) {
        back_on(can);
    } else {
        /* still on its way */
    }
}

/* It was reset: what was in its mailboxes is gone. */
static void lose_controller(bxcan_t *can) {
    for (; can->taken != 0u; can->taken &= (uint8_t)(can->taken - 1u)) {
        stm32_can_count(&can->tx_dropped);
    }
    can->phase = BXCAN_DOWN;
}

/* One look, without waiting. */
static void look(bxcan_t *can) {
    if (can->phase == BXCAN_DOWN) {
        return;
    }
    collect(can);
    const uint32_t bus_offs = can->bus_offs;
    const bool anew = bus_offs != can->bus_offs_seen;
    const uint32_t msr = stm32_read(&can->regs->msr);
    const bool off = (stm32_read(&can->regs->esr) & BXCAN_ESR_BOFF) != 0u;
    if (can->phase == BXCAN_JOINING) {
        if ((msr & BXCAN_MSR_INAK) == 0u) {
            back_on(can);
        }
    } else if (can->phase != BXCAN_ON) {
        look_while_off(can, msr, off, anew);
    } else if ((msr & (BXCAN_MSR_INAK | BXCAN_MSR_SLAK)) != 0u) {
        lose_controller(can);
    } else if (off || anew) {
        go_off(can);
    } else {
        /* on, as it was */
    }
    can->bus_offs_seen = bus_offs;
}

void bxcan_restart(bxcan_t *can) {
    look(can);
    can->ordered = can->phase == BXCAN_OFF;
    look(can);
}

/* ---- The contract -----------------------------------------------------------------------------
 */

/* The lowest mailbox that keeps the order of frames of one id; BXCAN_MAILBOXES: none. */
static uint32_t choose(const bxcan_t *can, uint32_t word) {
    const uint32_t tsr = stm32_read(&can->regs->tsr);
    uint32_t lowest = 0;
    for (uint32_t box = 0; box < BXCAN_MAILBOXES; box++) {
        if ((can->taken & (1u << box)) == 0u || ((can->held[box] ^ word) & ~BXCAN_TIR_RTR) != 0u) {
            continue;
        }
        /* Of a data and a remote frame with one id, the data frame goes first from any mailbox. */
        lowest = can->held[box] == word ? box + 1u : BXCAN_MAILBOXES;
    }
    while (lowest < BXCAN_MAILBOXES &&
           ((can->taken & (1u << lowest)) != 0u || (tsr & (BXCAN_TSR_TME0 << lowest)) == 0u)) {
        lowest++;
    }
    return lowest;
}

static berth_can_outcome_t send(void *context, const berth_can_frame_t *frame) {
    bxcan_t *can = context;
    if (!stm32_can_frame_is_good(frame)) {
        return BERTH_CAN_FAILED;
    }
    look(can);
    if (can->phase != BXCAN_ON) {
        return BERTH_CAN_FAILED;
    }
    uint32_t words[2];
    const uint32_t word = identifier_word(frame);
    const uint32_t box = choose(can, word);
    if (box == BXCAN_MAILBOXES) {
        return BERTH_CAN_AGAIN;
    }
    bxcan_tx_regs_t *regs = &can->regs->tx[box];
    stm32_can_pack(frame, words);
    stm32_write(&regs->tdtr, stm32_put(BXCAN_TDTR_DLC, frame->length));
    stm32_write(&regs->tdlr, words[0]);
    stm32_write(&regs->tdhr, words[1]);
    can->taken |= (uint8_t)(1u << box);
    can->held[box] = word;
    stm32_write(&regs->tir, word | BXCAN_TIR_TXRQ);
    if (can->bus_offs != can->bus_offs_seen) {
        /* Bus-off came while this was written: the interrupt did not see the frame. */
        stm32_write(&can->regs->tsr, BXCAN_TSR_ABRQ0 << (box * BXCAN_TSR_NEXT));
    }
    return BERTH_CAN_DONE;
}

static berth_can_outcome_t receive(void *context, berth_can_frame_t *frame) {
    bxcan_t *can = context;
    if (stm32_can_ring_take(&can->received, frame)) {
        return BERTH_CAN_DONE;
    }
    look(can);
    return can->phase == BXCAN_ON ? BERTH_CAN_AGAIN : BERTH_CAN_FAILED;
}

static berth_can_mode_t mode_of(const bxcan_t *can) {
    switch (can->phase) {
    case BXCAN_DOWN:
    case BXCAN_JOINING:
        return BERTH_CAN_DOWN;
    case BXCAN_ON:
        return (stm32_read(&can->regs->esr) & BXCAN_ESR_EPVF) != 0u ? BERTH_CAN_ERROR_PASSIVE
                                                                    : BERTH_CAN_ERROR_ACTIVE;
    default:
        return BERTH_CAN_BUS_OFF;
    }
}

static void state(void *context, berth_can_state_t *out) {
    bxcan_t *can = context;
    look(can);
    *out = (berth_can_state_t){.mode = mode_of(can),
                               .rx_lost = can->rx_lost,
                               .tx_dropped = can->tx_dropped,
                               .error_frames = can->errors,
                               .restarts = can->restarts};
}

berth_can_t bxcan_can(bxcan_t *can) {
    static const berth_can_api_t api = {send, receive, state};
    return (berth_can_t){&api, can};
}

bool bxcan_has_input(const bxcan_t *can) {
    return !stm32_can_ring_is_empty(&can->received);
}

void bxcan_diagnosis(const bxcan_t *can, bxcan_diagnosis_t *out) {
    *out = (bxcan_diagnosis_t){0};
    if (can->phase != BXCAN_DOWN) {
        const uint32_t esr = stm32_read(&can->regs->esr);
        out->transmit_errors = stm32_get(esr, BXCAN_ESR_TEC);
        out->receive_errors = stm32_get(esr, BXCAN_ESR_REC);
        out->warning = (esr & BXCAN_ESR_EWGF) != 0u;
        out->passive = (esr & BXCAN_ESR_EPVF) != 0u;
        out->off = (esr & BXCAN_ESR_BOFF) != 0u;
    }
}

/* ---- Interrupts -------------------------------------------------------------------------------
 */

void bxcan_receive_interrupt(bxcan_t *can) {
    bxcan_regs_t *regs = can->regs;
    const int64_t time_us = now_us(can);
    for (uint32_t i = 0; i < INTERRUPT_FRAMES; i++) {
        const uint32_t status = stm32_read(&regs->rf0r);
        if ((status & BXCAN_RF0R_FOVR0) != 0u) {
            stm32_can_count(&can->rx_lost);
            stm32_write(&regs->rf0r, BXCAN_RF0R_FOVR0);
        }
        /* A mailbox that is still being released would be read twice. */
        if ((status & BXCAN_RF0R_FMP0) == 0u || (status & BXCAN_RF0R_RFOM0) != 0u) {
            return;
        }
        berth_can_frame_t *place = stm32_can_ring_place(&can->received);
        if (place != NULL) {
            place->time_us = time_us;
            read_frame(&regs->rx[0], place);
            stm32_can_ring_put(&can->received);
        } else {
            stm32_can_count(&can->rx_lost);
        }
        release(regs);
    }
}

void bxcan_status_interrupt(bxcan_t *can) {
    bxcan_regs_t *regs = can->regs;
    /* First, so that what happens from here on interrupts anew. */
    stm32_write(&regs->msr, BXCAN_MSR_ERRI);
    const uint32_t esr = stm32_read(&regs->esr);
    const uint32_t code = stm32_get(esr, BXCAN_ESR_LEC);
    if (code != LEC_NONE && code != LEC_BY_SOFTWARE) {
        stm32_can_count(&can->errors);
    }
    if ((esr & BXCAN_ESR_BOFF) != 0u) {
        stm32_write(&regs->tsr, ABORT_ALL);
        can->bus_offs = can->bus_offs + 1u;
    }
    stm32_write(&regs->esr, stm32_put(BXCAN_ESR_LEC, LEC_BY_SOFTWARE));
}
