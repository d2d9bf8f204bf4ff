#include "bxcan_model.h"

#include "unity.h"

#include <string.h>

enum {
    MCR = 0x00,
    MSR = 0x04,
    TSR = 0x08,
    RF0R = 0x0c,
    RF1R = 0x10,
    IER = 0x14,
    ESR = 0x18,
    BTR = 0x1c,
    MAILBOXES = 0x180,
    FIFO_BOXES = 0x1b0,
    FMR = 0x200,
    FM1R = 0x204,
    FS1R = 0x20c,
    FFA1R = 0x214,
    FA1R = 0x21c,
    BANKS = 0x240
};

#define BIT(n) (1u << (n))

static void violate(bxcan_model_t *m, const char *what) {
    m->violations++;
    m->violation = what;
}

/* ---- Modes ------------------------------------------------------------------------------------
 */

static bx_mode_t wanted_mode(const bxcan_model_t *m) {
    if ((m->mcr & BIT(0)) != 0) {
        return BX_INIT;
    }
    return (m->mcr & BIT(1)) != 0 ? BX_SLEEP : BX_NORMAL;
}

/* A transmission under way is ended before initialisation mode is entered. */
static bool on_wire(const bxcan_model_t *m) {
    for (int i = 0; i < 3; i++) {
        if (m->boxes[i].state == BX_ON_WIRE) {
            return true;
        }
    }
    return false;
}

static void change_mode(bxcan_model_t *m) {
    const bx_mode_t wanted = wanted_mode(m);
    if (wanted == m->mode || m->mode_stuck || on_wire(m)) {
        return;
    }
    if (m->delay_left > 0) {
        m->delay_left--;
        return;
    }
    if (wanted == BX_NORMAL && m->bus_dominant) {
        return;
    }
    if (m->mode == BX_INIT && wanted == BX_NORMAL && m->boff) {
        m->recovering = true;
        m->recovery = 128;
    }
    m->mode = wanted;
}

/* ---- Errors -----------------------------------------------------------------------------------
 */

static void raise(bxcan_model_t *m, uint32_t enable) {
    if ((m->ier & enable) != 0) {
        m->erri = true;
    }
}

static uint32_t level(const bxcan_model_t *m) {
    return (m->tec >= 96 || m->rec >= 96 ? 1u : 0u) + (m->tec > 127 || m->rec > 127 ? 1u : 0u);
}

static void count_errors(bxcan_model_t *m, uint32_t tec, uint32_t rec) {
    const uint32_t before = level(m);
    m->tec = tec;
    m->rec = rec > 255 ? 255 : rec;
    if (before < 1 && level(m) >= 1) {
        raise(m, BIT(8));
    }
    if (before < 2 && level(m) == 2) {
        raise(m, BIT(9));
    }
    if (m->tec > 255 && !m->boff) {
        m->boff = true;
        raise(m, BIT(10));
        m->recovering = (m->mcr & BIT(6)) != 0;
        m->recovery = 128;
    }
}

void bxcan_model_set_tec(bxcan_model_t *m, uint32_t tec) {
    count_errors(m, tec, m->rec);
}

static void set_code(bxcan_model_t *m, uint32_t code) {
    m->lec = code;
    if (code >= 1 && code <= 6) {
        raise(m, BIT(11));
    }
}

static void recover(bxcan_model_t *m, uint32_t sequences) {
    if (!m->boff || !m->recovering || m->mode != BX_NORMAL) {
        return;
    }
    m->recovery -= sequences < m->recovery ? sequences : m->recovery;
    if (m->recovery == 0) {
        m->boff = false;
        m->recovering = false;
        m->tec = 0;
        m->rec = 0;
    }
}

/* ---- Mailboxes --------------------------------------------------------------------------------
 */

static void complete(bxcan_model_t *m, int box, bool ok) {
    m->boxes[box].state = BX_EMPTY;
    m->boxes[box].abort = false;
    m->boxes[box].words[0] &= ~BIT(0);
    m->tsr |= (BIT(0) | (ok ? BIT(1) : 0u)) << (8 * box);
}

static void write_tsr(bxcan_model_t *m, uint32_t value) {
    for (int box = 0; box < 3; box++) {
        if ((value & BIT(8 * box)) != 0) {
            m->tsr &= ~(0xfu << (8 * box)); /* RQCP and with it TXOK, ALST, TERR */
        }
        if ((value & BIT(8 * box + 7)) != 0) {
            if (m->boxes[box].state == BX_PENDING) {
                complete(m, box, false);
            } else if (m->boxes[box].state == BX_ON_WIRE) {
                m->boxes[box].abort = true;
            }
        }
    }
}

static uint32_t read_tsr(const bxcan_model_t *m) {
    uint32_t value = m->tsr;
    uint32_t code = 3;
    for (int box = 2; box >= 0; box--) {
        if (m->boxes[box].state == BX_EMPTY) {
            value |= BIT(26 + box);
            code = (uint32_t)box;
        }
        if (m->boxes[box].abort) {
            value |= BIT(8 * box + 7);
        }
    }
    return value | (code & 3u) << 24;
}

static void write_mailbox(bxcan_model_t *m, int box, int word, uint32_t value) {
    if (m->boxes[box].state != BX_EMPTY) {
        violate(m, "a mailbox that is not empty was written");
        return;
    }
    m->boxes[box].words[word] = value;
    if (word == 0 && (value & BIT(0)) != 0) {
        if ((m->boxes[box].words[1] & 0xfu) > 8) {
            violate(m, "more than 8 bytes to be sent");
        }
        m->boxes[box].state = BX_PENDING;
        m->tsr &= ~(0xfu << (8 * box));
    }
}

static berth_can_frame_t frame_of(const uint32_t words[4]) {
    berth_can_frame_t frame = {0};
    frame.extended = (words[0] & BIT(2)) != 0;
    frame.remote = (words[0] & BIT(1)) != 0;
    frame.id = frame.extended ? words[0] >> 3 : words[0] >> 21;
    frame.length = (uint8_t)(words[1] & 0xfu);
    for (int i = 0; i < frame.length && i < 8 && !frame.remote; i++) {
        frame.data[i] = (uint8_t)(words[2 + i / 4] >> (8 * (i % 4)) & 0xffu);
    }
    return frame;
}

/* Lowest identifier first, as arbitration would have it; then the lowest mailbox. */
static uint64_t urgency(const uint32_t words[4]) {
    const uint64_t base = words[0] >> 21;
    const uint64_t rtr = words[0] >> 1 & 1u;
    if ((words[0] & BIT(2)) != 0) {
        return base << 21 | 1u << 20 | 1u << 19 | (uint64_t)(words[0] >> 3 & 0x3ffffu) << 1 | rtr;
    }
    return base << 21 | rtr << 20;
}

static int scheduled(const bxcan_model_t *m) {
    int best = -1;
    for (int box = 0; box < 3; box++) {
        if (m->boxes[box].state != BX_EMPTY &&
            (best < 0 || urgency(m->boxes[box].words) < urgency(m->boxes[best].words))) {
            best = box;
        }
    }
    return best;
}

/* ---- FIFO and filters -------------------------------------------------------------------------
 */

static void end_release(bxcan_model_t *m) {
    m->releasing = false;
    if (m->fmp > 0) {
        m->fmp--;
        memmove(m->fifo[0], m->fifo[1], sizeof m->fifo[0] * (BXCAN_MODEL_FIFO - 1u));
    }
}

static uint32_t read_rf0r(bxcan_model_t *m) {
    if (m->releasing) {
        if (m->release_left > 0) {
            m->release_left--;
        } else {
            end_release(m);
        }
    }
    return m->fmp | (m->fmp == BXCAN_MODEL_FIFO ? BIT(3) : 0u) | (m->fovr ? BIT(4) : 0u) |
           (m->releasing ? BIT(5) : 0u);
}

static void write_rf0r(bxcan_model_t *m, uint32_t value) {
    if ((value & BIT(4)) != 0) {
        m->fovr = false;
    }
    if ((value & BIT(5)) != 0) {
        if (m->releasing) {
            violate(m, "released while a release was under way");
            return;
        }
        if (m->release_delay == 0) {
            end_release(m);
        } else {
            m->releasing = true;
            m->release_left = m->release_delay;
        }
    }
}

static bool passes(bxcan_model_t *m, uint32_t bank, uint32_t word) {
    const bxcan_model_t *f = m->filters;
    if ((f->fa1r & BIT(bank)) == 0) {
        return false;
    }
    if ((f->fs1r & BIT(bank)) == 0 || (f->ffa1r & BIT(bank)) != 0) {
        violate(m, "a bank of 16 bits, or for FIFO 1");
        return false;
    }
    const uint32_t first = f->banks[2 * bank];
    const uint32_t second = f->banks[2 * bank + 1];
    if ((f->fm1r & BIT(bank)) != 0) {
        return (word & ~1u) == (first & ~1u) || (word & ~1u) == (second & ~1u);
    }
    return ((word ^ first) & second & ~1u) == 0;
}

static bool accepts(bxcan_model_t *m, uint32_t word) {
    const uint32_t split = m->filters->fmr >> 8 & 0x3fu;
    const bool first = m->filters == m;
    if ((m->filters->fmr & 1u) != 0) {
        return false; /* reception is off */
    }
    for (uint32_t bank = 0; bank < 28; bank++) {
        if ((bank < split) == first && passes(m, bank, word)) {
            return true;
        }
    }
    return false;
}

static void node_hear(void *context, const berth_can_frame_t *frame) {
    bxcan_model_t *m = context;
    const uint32_t word = (frame->extended ? frame->id << 3 | BIT(2) : frame->id << 21) |
                          (frame->remote ? BIT(1) : 0u);
    m->heard++;
    m->lec = 0;
    count_errors(m, m->tec, m->rec > 127 ? 120 : m->rec > 0 ? m->rec - 1 : 0);
    if (!accepts(m, word)) {
        m->filtered++;
        return;
    }
    if (m->fmp == BXCAN_MODEL_FIFO) {
        m->fovr = true;
        m->overruns++;
        if ((m->mcr & BIT(3)) != 0) {
            return; /* locked */
        }
        m->fmp--;
    }
    uint32_t *place = m->fifo[m->fmp++];
    place[0] = word;
    place[1] = frame->length | 0xabcd0000u; /* time and filter index: whatever */
    place[2] = 0x5a5a5a5au;                 /* beyond the length: what was there */
    place[3] = 0x5a5a5a5au;
    for (int i = 0; i < frame->length && i < 8 && !frame->remote; i++) {
        place[2 + i / 4] &= ~(0xffu << (8 * (i % 4)));
        place[2 + i / 4] |= (uint32_t)frame->data[i] << (8 * (i % 4));
    }
}

/* ---- Registers --------------------------------------------------------------------------------
 */

static uint32_t read_msr(bxcan_model_t *m) {
    change_mode(m);
    return (m->mode == BX_INIT ? 1u : 0u) | (m->mode == BX_SLEEP ? 2u : 0u) | (m->erri ? 4u : 0u) |
           0xc00u;
}

static uint32_t read_esr(const bxcan_model_t *m) {
    return (m->tec >= 96 || m->rec >= 96 || m->boff ? 1u : 0u) |
           (m->tec > 127 || m->rec > 127 || m->boff ? 2u : 0u) | (m->boff ? 4u : 0u) | m->lec << 4 |
           (m->tec & 0xffu) << 16 | m->rec << 24;
}

static uint32_t read_fifo_box(bxcan_model_t *m, uint32_t offset) {
    if (offset >= FIFO_BOXES + 16 || m->fmp == 0 || m->releasing) {
        violate(m, "an empty FIFO was read");
        return 0xeeeeeeeeu;
    }
    return m->fifo[0][(offset - FIFO_BOXES) / 4];
}

static uint32_t model_read(void *context, uint32_t offset) {
    bxcan_model_t *m = context;
    if (offset >= MAILBOXES && offset < FIFO_BOXES) {
        return m->boxes[(offset - MAILBOXES) / 16].words[(offset - MAILBOXES) % 16 / 4];
    }
    if (offset >= FIFO_BOXES && offset < FIFO_BOXES + 32) {
        return read_fifo_box(m, offset);
    }
    if (offset >= BANKS && offset < BXCAN_MODEL_BYTES) {
        return m->banks[(offset - BANKS) / 4];
    }
    switch (offset) {
    case MCR:
        return m->mcr;
    case MSR:
        return read_msr(m);
    case TSR:
        return read_tsr(m);
    case RF0R:
        return read_rf0r(m);
    case RF1R:
        return 0;
    case IER:
        return m->ier;
    case ESR:
        return read_esr(m);
    case BTR:
        return m->btr;
    case FMR:
        return m->fmr;
    case FM1R:
        return m->fm1r;
    case FS1R:
        return m->fs1r;
    case FFA1R:
        return m->ffa1r;
    case FA1R:
        return m->fa1r;
    default:
        violate(m, "a reserved register was read");
        return 0;
    }
}

static void write_filter_setting(bxcan_model_t *m, uint32_t *setting, uint32_t value) {
    if ((m->fmr & 1u) == 0) {
        violate(m, "filter settings were written outside their initialisation");
    } else {
        *setting = value & 0x0fffffffu;
    }
}

static void write_bank(bxcan_model_t *m, uint32_t word, uint32_t value) {
    if ((m->fmr & 1u) == 0 && (m->fa1r & BIT(word / 2)) != 0) {
        violate(m, "an active filter bank was written");
    } else {
        m->banks[word] = value;
    }
}

static void write_mcr(bxcan_model_t *m, uint32_t value) {
    if ((value & BIT(7)) != 0 || (value & BIT(5)) != 0) {
        violate(m, "time-triggered mode or automatic wake-up");
    }
    if (((value ^ m->mcr) & 3u) != 0) {
        m->delay_left = m->mode_delay;
    }
    m->mcr = value & 0x1807fu;
}

static void write_control(bxcan_model_t *m, uint32_t offset, uint32_t value) {
    switch (offset) {
    case MCR:
        write_mcr(m, value);
        break;
    case MSR:
        m->erri = m->erri && (value & 4u) == 0;
        break;
    case TSR:
        write_tsr(m, value);
        break;
    case RF0R:
        write_rf0r(m, value);
        break;
    case IER:
        m->ier = value;
        break;
    case ESR:
        m->lec = value >> 4 & 7u;
        break;
    case BTR:
        if (m->mode != BX_INIT) {
            violate(m, "the bit timing was written outside initialisation");
        } else {
            m->btr = value;
        }
        break;
    default:
        violate(m, "a reserved register was written");
    }
}

static void model_write(void *context, uint32_t offset, uint32_t value) {
    bxcan_model_t *m = context;
    if (offset >= MAILBOXES && offset < FIFO_BOXES) {
        write_mailbox(m, (int)(offset - MAILBOXES) / 16, (int)(offset - MAILBOXES) % 16 / 4, value);
    } else if (offset >= BANKS && offset < BXCAN_MODEL_BYTES) {
        write_bank(m, (offset - BANKS) / 4, value);
    } else if (offset == FMR) {
        m->fmr = value & 0x3f01u;
    } else if (offset == FM1R) {
        write_filter_setting(m, &m->fm1r, value);
    } else if (offset == FS1R) {
        write_filter_setting(m, &m->fs1r, value);
    } else if (offset == FFA1R) {
        write_filter_setting(m, &m->ffa1r, value);
    } else if (offset == FA1R) {
        m->fa1r = value & 0x0fffffffu;
    } else {
        write_control(m, offset, value);
    }
}

/* ---- On the bus -------------------------------------------------------------------------------
 */

static bool node_is_on(void *context) {
    bxcan_model_t *m = context;
    change_mode(m);
    return m->mode == BX_NORMAL && !m->boff && !m->bus_dominant;
}

static bool node_offer(void *context, berth_can_frame_t *frame) {
    bxcan_model_t *m = context;
    const int box = scheduled(m);
    if (box < 0) {
        return false;
    }
    m->boxes[box].state = BX_ON_WIRE;
    *frame = frame_of(m->boxes[box].words);
    return true;
}

static int box_on_wire(const bxcan_model_t *m) {
    for (int box = 0; box < 3; box++) {
        if (m->boxes[box].state == BX_ON_WIRE) {
            return box;
        }
    }
    TEST_FAIL_MESSAGE("no mailbox is on the wire");
    return 0;
}

static void node_sent(void *context) {
    bxcan_model_t *m = context;
    m->lec = 0;
    count_errors(m, m->tec > 0 ? m->tec - 1 : 0, m->rec);
    complete(m, box_on_wire(m), true);
}

static void unsent(bxcan_model_t *m, uint32_t flag) {
    const int box = box_on_wire(m);
    m->tsr |= flag << (8 * box);
    if (m->boxes[box].abort || (m->mcr & BIT(4)) != 0) {
        complete(m, box, false);
    } else {
        m->boxes[box].state = BX_PENDING;
    }
}

static void node_failed(void *context, node_error_t error) {
    bxcan_model_t *m = context;
    unsent(m, BIT(3));
    set_code(m, error);
    /* An error passive node that nobody acknowledges does not count that. */
    const bool counts = error != NODE_ERROR_ACKNOWLEDGE || m->tec <= 127;
    count_errors(m, m->tec + (counts ? 8u : 0u), m->rec);
}

static void node_lost(void *context) {
    unsent(context, BIT(2));
}

static void node_hear_error(void *context, node_error_t error) {
    bxcan_model_t *m = context;
    set_code(m, error);
    count_errors(m, m->tec, m->rec + 1);
}

static void node_idle(void *context, uint32_t sequences) {
    bxcan_model_t *m = context;
    change_mode(m);
    if (!m->bus_dominant) {
        recover(m, sequences);
    }
}

/* ---- For the tests ----------------------------------------------------------------------------
 */

void bxcan_model_init(bxcan_model_t *m) {
    *m = (bxcan_model_t){.mode = BX_SLEEP,
                         .mcr = 0x00010002,
                         .btr = 0x01230000,
                         .fmr = 0x0e01}; /* the reset values */
    m->filters = m;
}

void bxcan_model_map(bxcan_model_t *m, const volatile void *block) {
    static const io_model_ops_t ops = {model_read, model_write};
    io_model_map(block, BXCAN_MODEL_BYTES, &ops, m);
}

node_t bxcan_model_node(bxcan_model_t *m) {
    static const node_ops_t ops = {node_is_on, node_offer, node_sent,       node_failed,
                                   node_lost,  node_hear,  node_hear_error, node_idle};
    return (node_t){&ops, m};
}

bool bxcan_model_fifo_line(const bxcan_model_t *m) {
    return (m->fmp > 0 && (m->ier & BIT(1)) != 0) ||
           (m->fmp == BXCAN_MODEL_FIFO && (m->ier & BIT(2)) != 0) ||
           (m->fovr && (m->ier & BIT(3)) != 0);
}

bool bxcan_model_status_line(const bxcan_model_t *m) {
    return m->erri && (m->ier & BIT(15)) != 0;
}
