#include "fdcan_model.h"

#include "unity.h"

#include <string.h>

enum {
    CCCR = 0x18,
    NBTP = 0x1c,
    ECR = 0x40,
    PSR = 0x44,
    IR = 0x50,
    IE = 0x54,
    ILS = 0x58,
    ILE = 0x5c,
    RXGFC = 0x80,
    XIDAM = 0x84,
    RXF0S = 0x90,
    RXF0A = 0x94,
    TXBC = 0xc0,
    TXFQS = 0xc4,
    TXBRP = 0xc8,
    TXBAR = 0xcc,
    TXBCR = 0xd0,
    TXBTO = 0xd4,
    TXBCF = 0xd8
};

/* Words of the message RAM. */
enum { STANDARD = 0, EXTENDED = 28, FIFO0 = 44, FIFO1 = 98, EVENTS = 152, BUFFERS = 158 };

#define BIT(n) (1u << (n))
#define ELEMENT 18u

static void violate(fdcan_model_t *m, const char *what) {
    m->violations++;
    m->violation = what;
}

static void flag(fdcan_model_t *m, int bit) {
    m->ir |= BIT(bit);
}

/* ---- Modes and errors -------------------------------------------------------------------------
 */

static void reset_by_configuration(fdcan_model_t *m) {
    m->pending = 0;
    m->occurred = 0;
    m->finished = 0;
    m->cancelling = 0;
    m->on_wire = -1;
    m->fill = 0;
    m->get = 0;
}

static void change_mode(fdcan_model_t *m) {
    if (m->init == m->init_wanted || m->init_stuck) {
        return;
    }
    if (m->delay_left > 0) {
        m->delay_left--;
        return;
    }
    m->init = m->init_wanted;
    m->synchronized = false;
    if (!m->init && m->boff) {
        m->recovery = 129;
    }
}

static void synchronize(fdcan_model_t *m) {
    change_mode(m);
    if (!m->init && !m->bus_dominant && !m->boff) {
        m->synchronized = true;
    }
}

static void write_cccr(fdcan_model_t *m, uint32_t value) {
    if ((value & ~0x3u) != 0) {
        violate(m, "a mode other than classical CAN");
    }
    change_mode(m);
    if ((value & 1u) != (m->init_wanted ? 1u : 0u)) {
        m->init_wanted = (value & 1u) != 0;
        m->delay_left = m->init_delay;
        if (m->delay_left == 0) {
            change_mode(m);
        }
    }
    /* CCE can be set while INIT is, and goes with it. */
    const bool cce = (value & 2u) != 0 && m->init && m->init_wanted;
    if ((value & 2u) != 0 && !cce) {
        violate(m, "CCE was set outside initialisation");
    }
    if (cce && !m->cce) {
        reset_by_configuration(m);
    }
    m->cce = cce;
    m->restricted = m->restricted && !cce;
}

static uint32_t read_cccr(fdcan_model_t *m) {
    change_mode(m);
    return (m->init ? 1u : 0u) | (m->cce ? 2u : 0u) | (m->restricted ? 4u : 0u);
}

static uint32_t level(const fdcan_model_t *m) {
    return (m->tec >= 96 || m->rec >= 96 ? 1u : 0u) + (m->tec > 127 || m->rec > 127 ? 1u : 0u);
}

static void count_errors(fdcan_model_t *m, uint32_t tec, uint32_t rec) {
    const uint32_t before = level(m);
    m->tec = tec;
    m->rec = rec > 128 ? 128 : rec;
    if ((before < 1) != (level(m) < 1)) {
        flag(m, 18);
    }
    if ((before < 2) != (level(m) < 2)) {
        flag(m, 17);
    }
    if (m->tec > 255 && !m->boff) {
        m->boff = true;
        m->init = true;
        m->init_wanted = true;
        m->synchronized = false;
        flag(m, 19);
    }
}

void fdcan_model_set_tec(fdcan_model_t *m, uint32_t tec) {
    count_errors(m, tec, m->rec);
}

static void set_code(fdcan_model_t *m, uint32_t code) {
    m->lec = code;
    if (code >= 1 && code <= 6) {
        flag(m, 21);
    }
}

static uint32_t read_psr(fdcan_model_t *m) {
    synchronize(m);
    const uint32_t activity = m->synchronized ? 1u : 0u;
    const uint32_t value = m->lec | activity << 3 | (level(m) == 2 ? BIT(5) : 0u) |
                           (level(m) >= 1 ? BIT(6) : 0u) | (m->boff ? BIT(7) : 0u) | 7u << 8;
    m->lec = 7; /* reading sets "no change" */
    return value;
}

static uint32_t read_ecr(const fdcan_model_t *m) {
    const uint32_t rec = m->rec > 127 ? 127 : m->rec;
    return (m->tec & 0xffu) | rec << 8 | (m->rec > 127 ? BIT(15) : 0u);
}

/* ---- Transmission -----------------------------------------------------------------------------
 */

static bool is_queue(const fdcan_model_t *m) {
    return (m->txbc & BIT(24)) != 0;
}

static uint32_t put_index(const fdcan_model_t *m) {
    for (uint32_t i = 0; i < 3; i++) {
        if ((m->pending & BIT(i)) == 0) {
            return i;
        }
    }
    return 0;
}

static uint32_t read_txfqs(fdcan_model_t *m) {
    if (!is_queue(m)) {
        violate(m, "the FIFO's indices are not modelled");
    }
    if (m->pending != 7) {
        m->offered |= BIT(put_index(m));
    }
    return (m->garbled ? 3u : put_index(m)) << 16 | (m->pending == 7 ? BIT(21) : 0u);
}

static void request(fdcan_model_t *m, uint32_t value) {
    for (uint32_t i = 0; i < 3; i++) {
        if ((value & BIT(i)) == 0) {
            continue;
        }
        if (m->cce || (m->pending & BIT(i)) != 0 || (m->offered & BIT(i)) == 0) {
            violate(m, "a request for a buffer that was not offered");
            continue;
        }
        if ((m->ram[BUFFERS + i * ELEMENT + 1] >> 16 & 0xfu) > 8 ||
            (m->ram[BUFFERS + i * ELEMENT + 1] & 0x00b00000u) != 0) {
            violate(m, "more than 8 bytes, a long frame or an event");
        }
        m->offered &= ~BIT(i);
        m->pending |= BIT(i);
        m->occurred &= ~BIT(i);
        m->finished &= ~BIT(i);
        m->order[i] = m->requests++;
    }
}

static void cancel(fdcan_model_t *m, uint32_t value) {
    for (uint32_t i = 0; i < 3; i++) {
        if ((value & BIT(i) & m->pending) == 0 || m->cce) {
            continue;
        }
        if (m->on_wire == (int)i || (m->init && m->lazy_cancel)) {
            m->cancelling |= BIT(i);
        } else {
            m->pending &= ~BIT(i);
            m->finished |= BIT(i);
        }
    }
}

static berth_can_frame_t frame_of(const uint32_t *element) {
    berth_can_frame_t frame = {0};
    frame.extended = (element[0] & BIT(30)) != 0;
    frame.remote = (element[0] & BIT(29)) != 0;
    frame.id = frame.extended ? element[0] & 0x1fffffffu : element[0] >> 18 & 0x7ffu;
    frame.length = (uint8_t)(element[1] >> 16 & 0xfu);
    for (int i = 0; i < frame.length && i < 8 && !frame.remote; i++) {
        frame.data[i] = (uint8_t)(element[2 + i / 4] >> (8 * (i % 4)) & 0xffu);
    }
    return frame;
}

/* The order in which arbitration would let them through. */
static uint64_t urgency(const uint32_t *element) {
    const berth_can_frame_t frame = frame_of(element);
    const uint64_t remote = frame.remote ? 1u : 0u;
    if (frame.extended) {
        return (uint64_t)(frame.id >> 18) << 21 | 3u << 19 | (uint64_t)(frame.id & 0x3ffffu) << 1 |
               remote;
    }
    return (uint64_t)frame.id << 21 | remote << 20;
}

static int scheduled(const fdcan_model_t *m) {
    int best = -1;
    for (int i = 0; i < 3; i++) {
        if ((m->pending & BIT(i)) != 0 &&
            (best < 0 || urgency(&m->ram[BUFFERS + (uint32_t)i * ELEMENT]) <
                             urgency(&m->ram[BUFFERS + (uint32_t)best * ELEMENT]))) {
            best = i;
        }
    }
    return best;
}

/* ---- Reception --------------------------------------------------------------------------------
 */

static bool matches(fdcan_model_t *m, uint32_t type, uint32_t id, uint32_t first, uint32_t second) {
    switch (type) {
    case 0:
        return id >= first && id <= second;
    case 1:
        return id == first || id == second;
    case 2:
        return ((id ^ first) & second) == 0;
    default:
        violate(m, "a filter type that is not modelled");
        return false;
    }
}

/* What the matching filter, or the rule for those that match none, wants done: 1: store in FIFO 0,
 * 2: in FIFO 1, 3: reject. */
static uint32_t verdict(fdcan_model_t *m, const berth_can_frame_t *frame) {
    const uint32_t standard = m->rxgfc >> 16 & 0x1fu;
    const uint32_t extended = m->rxgfc >> 24 & 0xfu;
    if (frame->remote && (m->rxgfc & BIT(frame->extended ? 0 : 1)) != 0) {
        return 3;
    }
    for (uint32_t i = 0; !frame->extended && i < standard; i++) {
        const uint32_t word = m->ram[STANDARD + i];
        if ((word >> 27 & 7u) != 0 &&
            matches(m, word >> 30, frame->id, word >> 16 & 0x7ffu, word & 0x7ffu)) {
            return word >> 27 & 7u;
        }
    }
    for (uint32_t i = 0; frame->extended && i < extended; i++) {
        const uint32_t word = m->ram[EXTENDED + 2 * i];
        const uint32_t second = m->ram[EXTENDED + 2 * i + 1];
        if (word >> 29 != 0 && matches(m, second >> 30, frame->id & m->xidam, word & 0x1fffffffu,
                                       second & 0x1fffffffu)) {
            return word >> 29;
        }
    }
    const uint32_t others = m->rxgfc >> (frame->extended ? 2 : 4) & 3u;
    return others < 2 ? others + 1 : 3;
}

static void store(fdcan_model_t *m, const berth_can_frame_t *frame) {
    if (m->fill == 3) {
        flag(m, 2);
        m->lost++;
        if ((m->rxgfc & BIT(9)) == 0) {
            return; /* blocking */
        }
        m->get = (m->get + 1) % 3;
        m->fill--;
    }
    uint32_t *element = &m->ram[FIFO0 + (m->get + m->fill) % 3 * ELEMENT];
    m->fill++;
    element[0] = (frame->extended ? frame->id | BIT(30) : frame->id << 18) |
                 (frame->remote ? BIT(29) : 0u) | (m->tec % 2 == 0 ? BIT(31) : 0u);
    element[1] = (uint32_t)frame->length << 16 | 0x8500abcdu; /* filter and time: whatever */
    element[2] = 0x5a5a5a5au;
    element[3] = 0x5a5a5a5au;
    for (int i = 0; i < frame->length && i < 8 && !frame->remote; i++) {
        element[2 + i / 4] &= ~(0xffu << (8 * (i % 4)));
        element[2 + i / 4] |= (uint32_t)frame->data[i] << (8 * (i % 4));
    }
    flag(m, 0);
    if (m->fill == 3) {
        flag(m, 1);
    }
}

static void acknowledge(fdcan_model_t *m, uint32_t index) {
    if (m->fill == 0 || index != m->get) {
        violate(m, "an element was acknowledged that was not next");
        return;
    }
    m->get = (m->get + 1) % 3;
    m->fill--;
}

/* ---- Registers and message RAM ----------------------------------------------------------------
 */

static uint32_t model_read(void *context, uint32_t offset) {
    fdcan_model_t *m = context;
    switch (offset) {
    case CCCR:
        return read_cccr(m);
    case NBTP:
        return m->nbtp;
    case ECR:
        return read_ecr(m);
    case PSR:
        return read_psr(m);
    case IR:
        return m->ir;
    case IE:
        return m->ie;
    case ILS:
        return m->ils;
    case ILE:
        return m->ile;
    case RXGFC:
        return m->rxgfc;
    case XIDAM:
        return m->xidam;
    case RXF0S:
        return m->fill | (m->garbled ? 3u : m->get) << 8 | (m->get + m->fill) % 3 << 16 |
               (m->fill == 3 ? BIT(24) : 0u) | ((m->ir & BIT(2)) != 0 ? BIT(25) : 0u);
    case TXBC:
        return m->txbc;
    case TXFQS:
        return read_txfqs(m);
    case TXBRP:
        return m->pending;
    case TXBTO:
        return m->occurred;
    case TXBCF:
        return m->finished;
    default:
        violate(m, "a register that is not modelled was read");
        return 0;
    }
}

static void write_protected(fdcan_model_t *m, uint32_t *reg, uint32_t value) {
    if (m->cce) {
        *reg = value;
    } else {
        violate(m, "a protected register was written outside configuration mode");
    }
}

static void model_write(void *context, uint32_t offset, uint32_t value) {
    fdcan_model_t *m = context;
    switch (offset) {
    case CCCR:
        write_cccr(m, value);
        break;
    case NBTP:
        write_protected(m, &m->nbtp, value);
        break;
    case RXGFC:
        write_protected(m, &m->rxgfc, value);
        break;
    case XIDAM:
        write_protected(m, &m->xidam, value);
        break;
    case TXBC:
        write_protected(m, &m->txbc, value);
        break;
    case IR:
        m->ir &= ~value;
        break;
    case IE:
        m->ie = value;
        break;
    case ILS:
        m->ils = value;
        break;
    case ILE:
        m->ile = value;
        break;
    case RXF0A:
        acknowledge(m, value & 7u);
        break;
    case TXBAR:
        request(m, value);
        break;
    case TXBCR:
        cancel(m, value);
        break;
    default:
        violate(m, "a register that is not modelled was written");
    }
}

static uint32_t ram_read(void *context, uint32_t offset) {
    fdcan_model_t *m = context;
    const uint32_t word = offset / 4;
    if (word >= FIFO0 && word < FIFO1) {
        const uint32_t behind = ((word - FIFO0) / ELEMENT + 3 - m->get) % 3;
        if (behind >= m->fill) {
            violate(m, "an element was read that holds no frame");
        }
    }
    return m->ram[word];
}

static void ram_write(void *context, uint32_t offset, uint32_t value) {
    fdcan_model_t *m = context;
    const uint32_t word = offset / 4;
    if (word >= BUFFERS && (m->pending & BIT((word - BUFFERS) / ELEMENT)) != 0) {
        violate(m, "a pending buffer was written");
    }
    if (word >= FIFO0 && word < BUFFERS) {
        violate(m, "the controller's part of the message RAM was written");
    }
    m->ram[word] = value;
}

/* ---- On the bus -------------------------------------------------------------------------------
 */

static bool node_is_on(void *context) {
    fdcan_model_t *m = context;
    synchronize(m);
    return m->synchronized && !m->boff && !m->init && !m->bus_dominant;
}

static bool node_offer(void *context, berth_can_frame_t *frame) {
    fdcan_model_t *m = context;
    m->on_wire = m->restricted ? -1 : scheduled(m);
    if (m->on_wire < 0) {
        return false;
    }
    *frame = frame_of(&m->ram[BUFFERS + (uint32_t)m->on_wire * ELEMENT]);
    return true;
}

static uint32_t take_off_wire(fdcan_model_t *m) {
    TEST_ASSERT_TRUE(m->on_wire >= 0);
    const uint32_t bit = BIT(m->on_wire);
    m->on_wire = -1;
    return bit;
}

static void node_sent(void *context) {
    fdcan_model_t *m = context;
    const uint32_t bit = take_off_wire(m);
    m->pending &= ~bit;
    m->occurred |= bit;
    if ((m->cancelling & bit) != 0) {
        m->cancelling &= ~bit;
        m->finished |= bit;
    }
    m->lec = 0;
    count_errors(m, m->tec > 0 ? m->tec - 1 : 0, m->rec);
}

static void unsent(fdcan_model_t *m) {
    const uint32_t bit = take_off_wire(m);
    if ((m->cancelling & bit) != 0) {
        m->cancelling &= ~bit;
        m->pending &= ~bit;
        m->finished |= bit;
    }
}

static void node_failed(void *context, node_error_t error) {
    fdcan_model_t *m = context;
    unsent(m);
    set_code(m, error);
    const bool counts = error != NODE_ERROR_ACKNOWLEDGE || m->tec <= 127;
    count_errors(m, m->tec + (counts ? 8u : 0u), m->rec);
}

static void node_lost(void *context) {
    unsent(context);
}

static void node_hear(void *context, const berth_can_frame_t *frame) {
    fdcan_model_t *m = context;
    m->lec = 0;
    count_errors(m, m->tec, m->rec > 127 ? 120 : m->rec > 0 ? m->rec - 1 : 0);
    const uint32_t what = verdict(m, frame);
    if (what == 1) {
        store(m, frame);
    } else if (what != 3) {
        violate(m, "FIFO 1 or a priority message");
    }
}

static void node_hear_error(void *context, node_error_t error) {
    fdcan_model_t *m = context;
    set_code(m, error);
    count_errors(m, m->tec, m->rec + 1);
}

static void node_idle(void *context, uint32_t sequences) {
    fdcan_model_t *m = context;
    change_mode(m);
    if (m->bus_dominant || m->init || !m->boff) {
        return;
    }
    m->recovery -= sequences < m->recovery ? sequences : m->recovery;
    if (m->recovery == 0) {
        m->boff = false;
        m->tec = 0;
        m->rec = 0;
        flag(m, 19); /* the status has changed again */
    }
}

/* ---- For the tests ----------------------------------------------------------------------------
 */

void fdcan_model_init(fdcan_model_t *m) {
    *m = (fdcan_model_t){.init = true,
                         .init_wanted = true,
                         .nbtp = 0x06000a03,
                         .xidam = 0x1fffffff,
                         .lec = 7,
                         .on_wire = -1};
    memset(m->ram, 0xa7, sizeof m->ram);
}

void fdcan_model_map(fdcan_model_t *m, const volatile void *block, const volatile void *ram) {
    static const io_model_ops_t registers = {model_read, model_write};
    static const io_model_ops_t memory = {ram_read, ram_write};
    io_model_map(block, FDCAN_MODEL_BYTES, &registers, m);
    io_model_map(ram, sizeof m->ram, &memory, m);
}

node_t fdcan_model_node(fdcan_model_t *m) {
    static const node_ops_t ops = {node_is_on, node_offer, node_sent,       node_failed,
                                   node_lost,  node_hear,  node_hear_error, node_idle};
    return (node_t){&ops, m};
}

bool fdcan_model_line(const fdcan_model_t *m) {
    return (m->ir & m->ie) != 0 && (m->ile & 1u) != 0 && m->ils == 0;
}
