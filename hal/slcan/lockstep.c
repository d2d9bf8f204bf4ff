#include "lockstep.h"

/* MISRA D14 in this file. */

#define KIND_MASK 0xffu

void lockstep_encode(berth_can_frame_t *frame, lockstep_kind_t kind, uint64_t value) {
    *frame = (berth_can_frame_t){.id = LOCKSTEP_ID | (uint32_t)kind, .extended = true};
    for (; value != 0u; value >>= 8) {
        frame->data[frame->length] = (uint8_t)(value & 0xffu);
        frame->length++;
    }
}

bool lockstep_decode(const berth_can_frame_t *frame, lockstep_kind_t *kind, uint64_t *value) {
    if (!frame->extended || frame->remote || (frame->id & ~KIND_MASK) != LOCKSTEP_ID) {
        return false;
    }
    const uint32_t number = frame->id & KIND_MASK;
    *kind = (lockstep_kind_t)number;
    *value = 0;
    for (uint32_t i = 0; i < frame->length && i < BERTH_CAN_DATA_MAX; i++) {
        *value |= (uint64_t)frame->data[i] << (8u * i); /* MISRA T5 */
    }
    return true;
}

lockstep_take_t lockstep_take(lockstep_line_t *line, uint8_t byte, berth_can_frame_t *frame) {
    if (byte != '\r') {
        if (line->length < SLCAN_LINE_MAX) {
            line->text[line->length] = (char)byte;
            line->length++;
        }
        return LOCKSTEP_MORE;
    }
    const uint32_t length = line->length;
    line->length = 0;
    if (length == 0u) {
        return LOCKSTEP_MORE;
    }
    const bool good = length < SLCAN_LINE_MAX && slcan_decode(line->text, length, frame);
    return good ? LOCKSTEP_FRAME : LOCKSTEP_GARBAGE;
}
