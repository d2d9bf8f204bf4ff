#include "stm32_can.h"

#define SAMPLE_POINT_PERMILLE 800u
#define SAMPLE_POINT_MIN_PERMILLE 750u
#define SAMPLE_POINT_MAX_PERMILLE 875u

const char *stm32_can_result_text(stm32_can_result_t result) {
    switch (result) {
    case STM32_CAN_OK:
        return "open";
    case STM32_CAN_ERROR_ARGUMENT:
        return "bad argument";
    case STM32_CAN_ERROR_TIMING:
        return "the bit rate cannot be made from this clock";
    case STM32_CAN_ERROR_FILTERS:
        return "too many filters, or an id out of range";
    case STM32_CAN_ERROR_SILENT:
        return "the controller does not answer";
    case STM32_CAN_ERROR_NOT_JOINED:
        return "the bus is not idle";
    default:
        return "unknown";
    }
}

static uint32_t smaller(uint32_t a, uint32_t b) {
    return a < b ? a : b;
}

static uint32_t distance(uint32_t a, uint32_t b) {
    return a > b ? a - b : b - a;
}

/* Sample points as fractions of the same denominator: quanta * 1000. */
static bool better(uint32_t quanta, uint32_t segment1, const stm32_can_timing_t *best) {
    if (best->prescaler == 0u) {
        return true;
    }
    const uint32_t best_quanta = 1u + best->segment1 + best->segment2;
    const uint32_t mine = distance((1u + segment1) * 1000u, SAMPLE_POINT_PERMILLE * quanta);
    const uint32_t its =
        distance((1u + best->segment1) * 1000u, SAMPLE_POINT_PERMILLE * best_quanta);
    return mine * best_quanta < its * quanta;
}

static void try_quanta(uint32_t prescaler, uint32_t quanta, const stm32_can_limits_t *limits,
                       stm32_can_timing_t *best) {
    for (uint32_t segment2 = 1; segment2 <= smaller(limits->segment2_max, quanta - 2u);
         segment2++) {
        const uint32_t segment1 = quanta - 1u - segment2;
        const uint32_t sample = (1u + segment1) * 1000u;
        if (segment1 > limits->segment1_max || sample < SAMPLE_POINT_MIN_PERMILLE * quanta ||
            sample > SAMPLE_POINT_MAX_PERMILLE * quanta || !better(quanta, segment1, best)) {
            continue;
        }
        *best = (stm32_can_timing_t){.prescaler = prescaler,
                                     .segment1 = segment1,
                                     .segment2 = segment2,
                                     .jump = smaller(segment2, limits->jump_max)};
    }
}

bool stm32_can_timing(uint32_t clock_hz, uint32_t bit_rate, const stm32_can_limits_t *limits,
                      stm32_can_timing_t *out) {
    stm32_can_timing_t best = {0};
    if (bit_rate == 0u || clock_hz % bit_rate != 0u) {
        return false;
    }
    const uint32_t clocks = clock_hz / bit_rate;
    for (uint32_t quanta = STM32_CAN_QUANTA_MAX; quanta >= STM32_CAN_QUANTA_MIN; quanta--) {
        if (clocks % quanta == 0u && clocks / quanta >= 1u &&
            clocks / quanta <= limits->prescaler_max) {
            try_quanta(clocks / quanta, quanta, limits, &best);
        }
    }
    if (best.prescaler == 0u) {
        return false;
    }
    *out = best;
    return true;
}

static uint32_t id_max(bool extended) {
    return extended ? BERTH_CAN_EXTENDED_MAX : BERTH_CAN_STANDARD_MAX;
}

bool stm32_can_frame_is_good(const berth_can_frame_t *frame) {
    return frame->length <= BERTH_CAN_DATA_MAX && frame->id <= id_max(frame->extended);
}

bool stm32_can_filter_is_good(const berth_can_filter_t *filter) {
    return filter->id <= id_max(filter->extended);
}

void stm32_can_pack(const berth_can_frame_t *frame, uint32_t words[2]) {
    words[0] = 0;
    words[1] = 0;
    for (uint32_t i = 0; i < frame->length && i < BERTH_CAN_DATA_MAX && !frame->remote; i++) {
        words[i / 4u] |= (uint32_t)frame->data[i] << (8u * (i % 4u));
    }
}

void stm32_can_unpack(berth_can_frame_t *frame, const uint32_t words[2]) {
    for (uint32_t i = 0; i < BERTH_CAN_DATA_MAX; i++) {
        const bool there = i < frame->length && !frame->remote;
        frame->data[i] = (uint8_t)(there ? (words[i / 4u] >> (8u * (i % 4u))) & 0xffu : 0u);
    }
}
