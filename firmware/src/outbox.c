#include "berth/outbox.h"

#include "count.h"

_Static_assert(BERTH_OUTBOX_MAX >= 8u && BERTH_OUTBOX_MAX <= 255u,
               "one control period of two drives and the telemetry need 8; counts are bytes");

void berth_outbox_reset(berth_outbox_t *outbox) {
    berth_outbox_clear(outbox);
    outbox->dropped = 0;
}

void berth_outbox_clear(berth_outbox_t *outbox) {
    outbox->first = 0;
    outbox->count = 0;
}

static uint32_t slot(const berth_outbox_t *outbox, uint32_t place) {
    const uint32_t index = outbox->first + place;
    return index < BERTH_OUTBOX_MAX ? index : index - BERTH_OUTBOX_MAX;
}

bool berth_outbox_put(berth_outbox_t *outbox, const berth_can_frame_t *frame,
                      berth_outbox_policy_t policy) {
    if (policy == BERTH_OUTBOX_LATEST) {
        for (uint32_t place = 0; place < outbox->count; place++) {
            berth_can_frame_t *waiting = &outbox->frames[slot(outbox, place)];
            if (waiting->id == frame->id && waiting->extended == frame->extended) {
                *waiting = *frame;
                return true;
            }
        }
    }
    if (outbox->count >= BERTH_OUTBOX_MAX) {
        count(&outbox->dropped);
        return false;
    }
    outbox->frames[slot(outbox, outbox->count)] = *frame;
    outbox->count++;
    return true;
}

const berth_can_frame_t *berth_outbox_front(const berth_outbox_t *outbox) {
    return outbox->count > 0u ? &outbox->frames[outbox->first] : NULL;
}

void berth_outbox_pop(berth_outbox_t *outbox) {
    if (outbox->count > 0u) {
        outbox->first = (uint8_t)slot(outbox, 1);
        outbox->count--;
    }
}
