/* PDOs: four received, four sent, all of them mappable, and SYNC.
 *
 * A PDO's identifier, inhibit time and mapping are changed only while it is switched off (bit 31 of
 * its identifier), and entries of the mapping only while their count is zero. At SYNC, received
 * PDOs take effect before the ones to be sent are sampled.
 */
#include "drive_sim_inner.h"

#include <string.h>

#define OFF UINT32_C(0x80000000)
#define NO_REMOTE UINT32_C(0x40000000)
#define TYPE_SYNC_MAX 240u
#define TYPE_EVENT_MIN 254u

enum {
    RPDO_PARAMETER = 0x1400,
    RPDO_MAPPING = 0x1600,
    TPDO_PARAMETER = 0x1800,
    TPDO_MAPPING = 0x1a00
};

static bool operational(const drive_sim_t *sim) {
    return sim->state.cia402.nmt == CANOPEN_OPERATIONAL;
}

static bool valid(const canopen_pdo_t *pdo) {
    return (pdo->cob_id & OFF) == 0;
}

static canopen_object_t mapped(uint32_t entry) {
    return canopen_object((uint16_t)(entry >> 16), (uint8_t)(entry >> 8 & 0xffu));
}

static unsigned length_of(const canopen_pdo_t *pdo) {
    unsigned length = 0;
    for (unsigned i = 0; i < pdo->count; i++) {
        length += (pdo->map[i] & 0xffu) / 8u;
    }
    return length;
}

/* Parameters. */

bool canopen_pdo_owns(uint16_t index) {
    const unsigned base = index & 0xff00u;
    const unsigned number = index & 0x00ffu;
    return number < CANOPEN_PDOS && (base == RPDO_PARAMETER || base == RPDO_MAPPING ||
                                     base == TPDO_PARAMETER || base == TPDO_MAPPING);
}

static bool is_received(uint32_t multiplexer) {
    const unsigned base = multiplexer & 0xff00u;
    return base == RPDO_PARAMETER || base == RPDO_MAPPING;
}

static bool is_mapping(uint32_t multiplexer) {
    const unsigned base = multiplexer & 0xff00u;
    return base == RPDO_MAPPING || base == TPDO_MAPPING;
}

static canopen_pdo_t *pdo_of(drive_sim_t *sim, uint32_t multiplexer) {
    const unsigned number = multiplexer & 0x00ffu;
    return is_received(multiplexer) ? &sim->state.cia402.rpdo[number]
                                    : &sim->state.cia402.tpdo[number];
}

static unsigned sub_of(uint32_t multiplexer) {
    return multiplexer >> 16 & 0xffu;
}

static uint32_t read_mapping(const canopen_pdo_t *pdo, unsigned sub, uint32_t *value,
                             unsigned *size) {
    if (sub > CANOPEN_MAPPED) {
        return CANOPEN_ABORT_NO_SUB;
    }
    *value = sub == 0 ? pdo->count : pdo->map[sub - 1];
    *size = sub == 0 ? 1 : 4;
    return 0;
}

uint32_t canopen_pdo_read(drive_sim_t *sim, uint32_t multiplexer, uint32_t *value, unsigned *size) {
    const canopen_pdo_t *pdo = pdo_of(sim, multiplexer);
    const unsigned sub = sub_of(multiplexer);
    if (is_mapping(multiplexer)) {
        return read_mapping(pdo, sub, value, size);
    }
    if (is_received(multiplexer) && sub > 2) {
        return CANOPEN_ABORT_NO_SUB;
    }
    switch (sub) {
    case 0:
        *value = is_received(multiplexer) ? 2 : 5;
        *size = 1;
        return 0;
    case 1:
        *value = pdo->cob_id;
        *size = 4;
        return 0;
    case 2:
        *value = pdo->type;
        *size = 1;
        return 0;
    case 3:
        *value = pdo->inhibit_100us;
        *size = 2;
        return 0;
    case 5:
        *value = pdo->event_ms;
        *size = 2;
        return 0;
    default:
        return CANOPEN_ABORT_NO_SUB;
    }
}

/* Identifiers that CiA 301 keeps for other services. */
static bool restricted(uint32_t id) {
    return id <= 0x07f || (id >= 0x101 && id <= 0x180) || (id >= 0x581 && id <= 0x5ff) ||
           (id >= 0x601 && id <= 0x67f) || id >= 0x6e0;
}

static void restart(const drive_sim_t *sim, canopen_pdo_t *pdo) {
    pdo->waiting = false;
    pdo->told = false;
    pdo->due = false;
    pdo->syncs = 0;
    pdo->quiet_until_us = INT64_MIN;
    drive_sim_timer_start(&pdo->event, pdo->event_ms * INT64_C(1000), sim->now_us);
}

static uint32_t write_id(const drive_sim_t *sim, canopen_pdo_t *pdo, uint32_t value) {
    const bool on = (value & OFF) == 0;
    if ((value & UINT32_C(0x3ffff800)) != 0 || (on && restricted(value & 0x7ffu))) {
        return CANOPEN_ABORT_RANGE;
    }
    if (valid(pdo) && on && value != pdo->cob_id) {
        return CANOPEN_ABORT_STATE;
    }
    pdo->cob_id = value;
    restart(sim, pdo);
    return 0;
}

static uint32_t write_parameter(const drive_sim_t *sim, canopen_pdo_t *pdo, unsigned sub,
                                uint32_t value) {
    switch (sub) {
    case 1:
        return write_id(sim, pdo, value);
    case 2:
        if (value > TYPE_SYNC_MAX && value < TYPE_EVENT_MIN) {
            return CANOPEN_ABORT_RANGE;
        }
        pdo->type = (uint8_t)value;
        restart(sim, pdo);
        return 0;
    case 3:
        if (valid(pdo)) {
            return CANOPEN_ABORT_STATE;
        }
        pdo->inhibit_100us = (uint16_t)value;
        return 0;
    default:
        pdo->event_ms = (uint16_t)value;
        restart(sim, pdo);
        return 0;
    }
}

static uint32_t check_entry(uint32_t entry, bool received) {
    const canopen_object_t object = mapped(entry);
    if (object == OBJECT_NONE) {
        return CANOPEN_ABORT_NO_OBJECT;
    }
    const unsigned bits = entry & 0xffu;
    return canopen_object_mappable(object, received) && bits == 8u * canopen_object_size(object)
               ? 0
               : CANOPEN_ABORT_NO_MAPPING;
}

static uint32_t write_count(canopen_pdo_t *pdo, uint32_t count, bool received) {
    if (count > CANOPEN_MAPPED) {
        return CANOPEN_ABORT_PDO_LENGTH;
    }
    unsigned bits = 0;
    for (unsigned i = 0; i < count; i++) {
        const uint32_t abort_code = check_entry(pdo->map[i], received);
        if (abort_code != 0) {
            return abort_code;
        }
        bits += pdo->map[i] & 0xffu;
    }
    if (bits > 64) {
        return CANOPEN_ABORT_PDO_LENGTH;
    }
    pdo->count = (uint8_t)count;
    return 0;
}

static uint32_t write_mapping(canopen_pdo_t *pdo, unsigned sub, uint32_t value, bool received) {
    if (valid(pdo)) {
        return CANOPEN_ABORT_STATE;
    }
    if (sub == 0) {
        return write_count(pdo, value, received);
    }
    if (pdo->count != 0) {
        return CANOPEN_ABORT_STATE;
    }
    const uint32_t abort_code = check_entry(value, received);
    if (abort_code == 0) {
        pdo->map[sub - 1] = value;
    }
    return abort_code;
}

uint32_t canopen_pdo_write(drive_sim_t *sim, uint32_t multiplexer, uint32_t value, unsigned size) {
    uint32_t present;
    unsigned wanted;
    const uint32_t abort_code = canopen_pdo_read(sim, multiplexer, &present, &wanted);
    if (abort_code != 0) {
        return abort_code;
    }
    const unsigned sub = sub_of(multiplexer);
    if (!is_mapping(multiplexer) && sub == 0) {
        return CANOPEN_ABORT_READ_ONLY;
    }
    if (size != 0 && size != wanted) {
        return CANOPEN_ABORT_LENGTH;
    }
    if (wanted < 4) {
        value &= (1u << (8 * wanted)) - 1u;
    }
    canopen_pdo_t *pdo = pdo_of(sim, multiplexer);
    return is_mapping(multiplexer) ? write_mapping(pdo, sub, value, is_received(multiplexer))
                                   : write_parameter(sim, pdo, sub, value);
}

/* The profile's own PDOs: all start with the control or status word. Only the first are on. The
 * third would be for positions; a velocity drive receives nothing there. */
void canopen_pdo_reset(drive_sim_t *sim) {
    drive_sim_cia402_state_t *state = &sim->state.cia402;
    static const uint32_t second_received[CANOPEN_PDOS] = {0, 0x60600008, 0, 0x60ff0020};
    static const uint32_t second_sent[CANOPEN_PDOS] = {0, 0x60610008, 0x60640020, 0x606c0020};
    for (unsigned i = 0; i < CANOPEN_PDOS; i++) {
        const uint32_t off = i == 0 ? 0 : OFF;
        const uint32_t id = sim->config.node + 0x100u * i;
        state->rpdo[i] = (canopen_pdo_t){.cob_id = off | (0x200u + id),
                                         .type = 255,
                                         .count = second_received[i] == 0 ? 1 : 2,
                                         .map = {0x60400010, second_received[i]}};
        state->tpdo[i] = (canopen_pdo_t){.cob_id = off | NO_REMOTE | (0x180u + id),
                                         .type = 255,
                                         .count = second_sent[i] == 0 ? 1 : 2,
                                         .map = {0x60410010, second_sent[i]}};
        restart(sim, &state->rpdo[i]);
        restart(sim, &state->tpdo[i]);
    }
    state->rpdo[2].count = 0;
    state->rpdo[2].map[0] = 0;
}

void canopen_pdo_start(drive_sim_t *sim) {
    for (unsigned i = 0; i < CANOPEN_PDOS; i++) {
        restart(sim, &sim->state.cia402.rpdo[i]);
        restart(sim, &sim->state.cia402.tpdo[i]);
    }
}

/* Sending. */

static void pack(drive_sim_t *sim, const canopen_pdo_t *pdo, bool events_only, uint8_t data[8]) {
    memset(data, 0, 8);
    unsigned at = 0;
    for (unsigned i = 0; i < pdo->count; i++) {
        const canopen_object_t object = mapped(pdo->map[i]);
        const unsigned size = canopen_object_size(object);
        if (!events_only || canopen_object_is_event(object)) {
            drive_sim_put_le(&data[at], sim->state.cia402.objects[object], size);
        }
        at += size;
    }
}

static void send(drive_sim_t *sim, canopen_pdo_t *pdo) {
    pack(sim, pdo, true, pdo->key);
    pdo->told = true;
    pdo->due = false;
    pdo->syncs = 0;
    pdo->quiet_until_us = sim->now_us + pdo->inhibit_100us * INT64_C(100);
    if (sim->trouble.mute_feedback) {
        return;
    }
    berth_can_frame_t frame = {.id = pdo->cob_id & 0x7ffu, .length = (uint8_t)length_of(pdo)};
    pack(sim, pdo, false, frame.data);
    drive_sim_put(sim, &frame);
}

static bool changed(drive_sim_t *sim, const canopen_pdo_t *pdo) {
    uint8_t key[8];
    pack(sim, pdo, true, key);
    return !pdo->told || memcmp(key, pdo->key, sizeof key) != 0;
}

void canopen_pdo_events(drive_sim_t *sim) {
    if (!operational(sim)) {
        return;
    }
    cia402_refresh(sim);
    for (unsigned i = 0; i < CANOPEN_PDOS; i++) {
        canopen_pdo_t *pdo = &sim->state.cia402.tpdo[i];
        if (!valid(pdo) || pdo->type < TYPE_EVENT_MIN) {
            continue;
        }
        pdo->due = drive_sim_timer_take(&pdo->event, sim->now_us) || pdo->due || changed(sim, pdo);
        if (pdo->due && sim->now_us >= pdo->quiet_until_us) {
            send(sim, pdo);
        }
    }
}

int64_t canopen_pdo_deadline(const drive_sim_t *sim) {
    int64_t deadline_us = INT64_MAX;
    for (unsigned i = 0; i < CANOPEN_PDOS && operational(sim); i++) {
        const canopen_pdo_t *pdo = &sim->state.cia402.tpdo[i];
        if (!valid(pdo) || pdo->type < TYPE_EVENT_MIN) {
            continue;
        }
        deadline_us = drive_sim_timer_deadline(&pdo->event, deadline_us);
        if (pdo->due && pdo->quiet_until_us < deadline_us) {
            deadline_us = pdo->quiet_until_us;
        }
    }
    return deadline_us;
}

/* Receiving. */

static void apply(drive_sim_t *sim, const canopen_pdo_t *pdo) {
    unsigned at = 0;
    for (unsigned i = 0; i < pdo->count; i++) {
        const canopen_object_t object = mapped(pdo->map[i]);
        const unsigned size = canopen_object_size(object);
        if (canopen_store(sim, object, drive_sim_get_le(&pdo->data[at], size)) != 0) {
            sim->counters.malformed++;
        }
        at += size;
    }
}

static void take(drive_sim_t *sim, canopen_pdo_t *pdo, const berth_can_frame_t *frame) {
    drive_sim_cia402_state_t *state = &sim->state.cia402;
    const unsigned length = length_of(pdo);
    if (frame->remote || frame->length < length) {
        sim->counters.malformed++;
        if (!frame->remote && !state->pdo_error) {
            state->pdo_error = true;
            canopen_emergency(sim, 0x8210);
        }
        return;
    }
    state->pdo_error = false;
    canopen_check_errors(sim);
    memcpy(pdo->data, frame->data, length);
    pdo->waiting = pdo->type <= TYPE_SYNC_MAX;
    if (!pdo->waiting) {
        apply(sim, pdo);
    }
}

static bool answer(drive_sim_t *sim, uint32_t id) {
    for (unsigned i = 0; i < CANOPEN_PDOS; i++) {
        canopen_pdo_t *pdo = &sim->state.cia402.tpdo[i];
        if (valid(pdo) && (pdo->cob_id & 0x7ffu) == id && (pdo->cob_id & NO_REMOTE) == 0) {
            cia402_refresh(sim);
            send(sim, pdo);
            return true;
        }
    }
    return false;
}

bool canopen_pdo_receive(drive_sim_t *sim, const berth_can_frame_t *frame) {
    if (!operational(sim)) {
        return false;
    }
    for (unsigned i = 0; i < CANOPEN_PDOS; i++) {
        canopen_pdo_t *pdo = &sim->state.cia402.rpdo[i];
        if (valid(pdo) && (pdo->cob_id & 0x7ffu) == frame->id) {
            take(sim, pdo, frame);
            return true;
        }
    }
    return frame->remote && answer(sim, frame->id);
}

void canopen_pdo_sync(drive_sim_t *sim) {
    if (!operational(sim)) {
        return;
    }
    drive_sim_cia402_state_t *state = &sim->state.cia402;
    for (unsigned i = 0; i < CANOPEN_PDOS; i++) {
        if (state->rpdo[i].waiting) {
            state->rpdo[i].waiting = false;
            apply(sim, &state->rpdo[i]);
        }
    }
    cia402_refresh(sim);
    for (unsigned i = 0; i < CANOPEN_PDOS; i++) {
        canopen_pdo_t *pdo = &state->tpdo[i];
        if (!valid(pdo) || pdo->type > TYPE_SYNC_MAX) {
            continue;
        }
        pdo->syncs++;
        if (pdo->type == 0 ? changed(sim, pdo) : pdo->syncs >= pdo->type) {
            send(sim, pdo);
        }
    }
}
