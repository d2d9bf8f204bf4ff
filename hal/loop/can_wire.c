#include "can_wire.h"

#define CRC_POLYNOMIAL 0x4599u
#define CRC_BITS 15u
#define PLAIN_MAX (CAN_WIRE_STUFFED_MAX - 29u)

typedef struct {
    uint8_t bits[PLAIN_MAX];
    uint32_t count;
} plain_t;

bool can_wire_valid(const berth_can_frame_t *frame) {
    const uint32_t id_max = frame->extended ? BERTH_CAN_EXTENDED_MAX : BERTH_CAN_STANDARD_MAX;
    return frame->id <= id_max && frame->length <= BERTH_CAN_DATA_MAX;
}

static void put(plain_t *plain, uint32_t value, uint32_t width) {
    for (uint32_t i = width; i > 0u; i--) {
        plain->bits[plain->count] = (uint8_t)((value >> (i - 1u)) & 1u);
        plain->count++;
    }
}

static uint16_t crc_of(const plain_t *plain) {
    uint32_t crc = 0;
    for (uint32_t i = 0; i < plain->count; i++) {
        const uint32_t next = plain->bits[i] ^ ((crc >> (CRC_BITS - 1u)) & 1u);
        crc = (crc << 1) & 0x7fffu;
        if (next != 0u) {
            crc ^= CRC_POLYNOMIAL;
        }
    }
    return (uint16_t)crc;
}

/* SOF to the last data bit. */
static void head(const berth_can_frame_t *frame, plain_t *plain) {
    const uint32_t remote = frame->remote ? 1u : 0u;
    plain->count = 0;
    put(plain, 0, 1);
    if (frame->extended) {
        put(plain, frame->id >> 18, 11);
        put(plain, 3, 2);
        put(plain, frame->id & 0x3ffffu, 18);
        put(plain, remote, 1);
        put(plain, 0, 2);
    } else {
        put(plain, frame->id, 11);
        put(plain, remote, 1);
        put(plain, 0, 2);
    }
    put(plain, frame->length, 4);
    for (uint32_t i = 0; !frame->remote && i < frame->length; i++) {
        put(plain, frame->data[i], 8);
    }
}

uint16_t can_wire_crc(const berth_can_frame_t *frame) {
    plain_t plain;
    head(frame, &plain);
    return crc_of(&plain);
}

uint32_t can_wire_stuffed(const berth_can_frame_t *frame, uint8_t bits[CAN_WIRE_STUFFED_MAX]) {
    plain_t plain;
    head(frame, &plain);
    put(&plain, crc_of(&plain), CRC_BITS);
    uint32_t count = 0;
    uint32_t same = 0;
    uint8_t last = 1; /* the idle bus; SOF begins a new run */
    for (uint32_t i = 0; i < plain.count; i++) {
        same = plain.bits[i] == last ? same + 1u : 1u;
        last = plain.bits[i];
        bits[count] = last;
        count++;
        if (same == 5u) {
            last ^= 1u;
            same = 1;
            bits[count] = last;
            count++;
        }
    }
    return count;
}

uint32_t can_wire_bits(const berth_can_frame_t *frame) {
    uint8_t bits[CAN_WIRE_STUFFED_MAX];
    return can_wire_stuffed(frame, bits) + CAN_WIRE_TAIL;
}

uint32_t can_wire_rank(const berth_can_frame_t *frame) {
    const uint32_t remote = frame->remote ? 1u : 0u;
    if (frame->extended) {
        return ((frame->id >> 18) << 21) | 0x180000u | ((frame->id & 0x3ffffu) << 1) | remote;
    }
    return (frame->id << 21) | (remote << 20);
}
