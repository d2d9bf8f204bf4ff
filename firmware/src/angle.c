#include "berth/angle.h"

#include "angle_inline.h"

_Static_assert(__FLT_EVAL_METHOD__ == 0,
               "float32 expressions must not carry excess precision (x86: -msse2 -mfpmath=sse)");

/* Largest float32 below 3 pi: up to here one turn is taken off. */
#define ONE_TURN_MAX 0x1.2d97c6p+3f

/* 2 pi = coarse + fine for the angles up to NEAR_MAX: coarse has 12 significant bits, so that it
 * times the number of turns (at most 2608) is exact, and so is the difference from the angle. */
#define NEAR_MAX 16384.0f
#define TURN_COARSE 6.283203125f
#define TURN_FINE (-1.78178204e-5f)
#define TURNS_PER_RADIAN 0.159154943f

/* 1.5 * 2^23: adding and taking away rounds to the nearest whole number, ties to even. */
#define ROUNDER 12582912.0f

/* 2 pi / 2^32, rounded down so that half a turn stays below pi. */
#define RADIANS_PER_UNIT 0x1.921fb4p-30f

/* Exponent of 2^14 = NEAR_MAX as stored in a float32, and that of infinity and NaN. */
#define FAR_EXPONENT_MIN 141u
#define EXPONENT_NOT_FINITE 255u

/* The bits of 1 / (2 pi) after nine zeros: an angle of 2^14 begins with its window at bit 0. */
static const uint32_t TURN_BITS[6] = {0x00145f30u, 0x6dc9c882u, 0xa53f84eau,
                                      0xfa3ea69bu, 0xb81b6c52u, 0xb3278872u};
_Static_assert((254u - FAR_EXPONENT_MIN) / 32u < 4u &&
                   sizeof TURN_BITS / sizeof TURN_BITS[0] == 4u + 2u,
               "the window of the largest finite exponent lies within the table");

static float minus_one_turn(float x) {
    if (x > 0.0f) {
        return (x - ANGLE_TURN_HIGH) - ANGLE_TURN_LOW;
    }
    return (x + ANGLE_TURN_HIGH) + ANGLE_TURN_LOW;
}

/* Near an odd multiple of pi the number of turns can come out one off, and the rest just beyond
 * pi. */
static float wrap_near(float x) {
    const float turns = (x * TURNS_PER_RADIAN + ROUNDER) - ROUNDER;
    const float rest = (x - turns * TURN_COARSE) - turns * TURN_FINE;
    return fabsf(rest) <= ANGLE_WRAPPED_MAX ? rest : minus_one_turn(rest);
}

/* 64 bits of 1 / (2 pi), such that those before them give whole turns for this exponent. */
static uint64_t turn_window(uint32_t exponent) {
    const uint32_t first = exponent - FAR_EXPONENT_MIN;
    const uint32_t *words = &TURN_BITS[(first / 32u) % 4u];
    const uint32_t shift = first % 32u;
    /* NOLINTNEXTLINE(clang-analyzer-core.UndefinedBinaryOperatorResult): first is not < 0 */
    const uint64_t high = (((uint64_t)words[0] << 32) | words[1]) << shift;
    const uint64_t low = (((uint64_t)words[1] << 32) | words[2]) << shift;
    return (high & 0xffffffff00000000u) | (low >> 32);
}

/* Payne & Hanek, "Radian reduction for trigonometric functions" (1983), in turns: the mantissa
 * times the window, modulo 2^64, is the fraction of a turn to within 2^-40. */
static float wrap_far(float x) {
    const uint32_t bits = angle_bits_of(x);
    const uint32_t exponent = (bits >> 23) & 0xffu;
    if (exponent == EXPONENT_NOT_FINITE) {
        return x - x;
    }
    const uint32_t mantissa = (bits & 0x007fffffu) | 0x00800000u;
    const uint32_t fraction = (uint32_t)((turn_window(exponent) * mantissa) >> 32);
    const bool beyond_half = fraction > 0x80000000u;
    const float rest = (float)(beyond_half ? 0u - fraction : fraction) * RADIANS_PER_UNIT;
    const bool below_zero = x < 0.0f;
    return beyond_half != below_zero ? -rest : rest;
}

float angle_wrap_outside(float angle_rad) {
    const float magnitude = fabsf(angle_rad);
    if (magnitude <= ONE_TURN_MAX) {
        return minus_one_turn(angle_rad);
    }
    if (magnitude < NEAR_MAX) {
        return wrap_near(angle_rad);
    }
    return wrap_far(angle_rad);
}

float berth_wrap(float angle_rad) {
    return berth_wrap_inline(angle_rad);
}

void berth_sincos(float angle_rad, float *sine, float *cosine) {
    berth_sincos_inline(angle_rad, sine, cosine);
}

float berth_atan2(float y, float x) {
    return berth_atan2_inline(y, x);
}

float berth_asin(float x) {
    return berth_asin_inline(x);
}
