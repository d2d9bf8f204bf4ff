/* Cores of angle.h, inlined into the control step. Private to firmware/src.
 *
 * All work in the same way: reduce to a short interval, then a minimax polynomial in Horner form.
 * The errors given are the polynomial's own, without rounding; tests/test_angle.c bounds the whole.
 * No operation depends on the direction of an argument but by its sign, hence the exact symmetry.
 */
#ifndef BERTH_SRC_ANGLE_INLINE_H
#define BERTH_SRC_ANGLE_INLINE_H

#include "berth/angle.h"

#include <math.h>

/* MISRA D12 in this file. */

/* Largest float32 below pi: the largest wrapped angle. */
#define ANGLE_WRAPPED_MAX 0x1.921fb4p+1f

/* 2 pi = high + low; subtracting high from an angle between pi and 3 pi is exact. */
#define ANGLE_TURN_HIGH 6.28318548f
#define ANGLE_TURN_LOW (-1.74845560e-7f)

#define ANGLE_HALF_PI 1.57079633f

/* Wraps what lies outside [-pi, pi): any float32, NaN and infinity included. Not inline, because
 * headings are wrapped where they are made and seldom leave that interval by more than the turn of
 * one period. */
float angle_wrap_outside(float angle_rad);

/* A float and its bits; C11 defines reading the member that was not written last. */
typedef union {
    float value;
    uint32_t bits;
} angle_bits_t;

static inline uint32_t angle_bits_of(float value) {
    const angle_bits_t whole = {.value = value};
    return whole.bits;
}

/* magnitude >= 0 with the sign bit of sign: -0 counts as negative. */
static inline float angle_with_sign(float magnitude, float sign) {
    const angle_bits_t whole = {.bits =
                                    angle_bits_of(magnitude) | (angle_bits_of(sign) & 0x80000000u)};
    return whole.value;
}

static inline float berth_wrap_inline(float angle_rad) {
    if (fabsf(angle_rad) <= ANGLE_WRAPPED_MAX) {
        return angle_rad;
    }
    return angle_wrap_outside(angle_rad);
}

/* sqrt(2) sin(x / 2) for |x| <= pi, z = x^2. Least maximum absolute error over [0, pi]: 5e-9. */
static inline float angle_scaled_half_sine(float x, float z) {
    return x *
           (0.707106769f + z * (-0.0294627491f +
                                z * (3.6826561e-4f + z * (-2.18771083e-6f + z * 7.15528126e-9f))));
}

/* sqrt(2) cos(x / 2) for |x| <= pi, z = x^2. Least maximum over [0, pi] of the absolute error times
 * sqrt(2) sin(x / 2), which is its share in the error of the sine: 6e-8. */
static inline float angle_scaled_half_cosine(float z) {
    return 1.4142133f +
           z * (-0.176776052f + z * (3.68246133e-3f + z * (-3.05973044e-5f + z * 1.27220233e-7f)));
}

/* Cosine of an angle that is already wrapped. cos(x) = 1 - 2 sin^2(x / 2) is exactly 1 at 0. */
static inline float berth_cos_wrapped_inline(float wrapped_rad) {
    const float s = angle_scaled_half_sine(wrapped_rad, wrapped_rad * wrapped_rad);
    return 1.0f - s * s;
}

static inline float berth_cos_inline(float angle_rad) {
    return berth_cos_wrapped_inline(berth_wrap_inline(angle_rad));
}

/* sin(x) = 2 sin(x / 2) cos(x / 2): the half angles need neither quadrants nor swaps. */
static inline void berth_sincos_inline(float angle_rad, float *sine, float *cosine) {
    const float x = berth_wrap_inline(angle_rad);
    const float z = x * x;
    const float s = angle_scaled_half_sine(x, z);
    *sine = s * angle_scaled_half_cosine(z);
    *cosine = 1.0f - s * s;
}

/* arctan(num / den) for |num| <= |den|; NaN for an infinite den, since inf - inf is NaN.
 * Least maximum absolute error over [0, 1] with the first coefficient held at 1: 3.4e-7. That
 * coefficient stands in the bracket, not apart, so that -0 gives -0. */
static inline float angle_atan_ratio(float num, float den) {
    const float q = num / den;
    const float z = q * q + (den - den);
    const float p =
        -0.33325398f +
        z * (0.198618576f +
             z * (-0.133987963f + z * (0.0821678266f + z * (-0.035519965f + z * 7.37400074e-3f))));
    return q * (1.0f + z * p);
}

static inline float berth_atan2_inline(float y, float x) {
    const bool steep = fabsf(y) > fabsf(x);
    if (!steep && !(fabsf(x) > 0.0f)) {
        return x == 0.0f ? y : x; /* both are zero, or one is NaN */
    }
    /* one copy of the polynomial for all three cases */
    const float ratio = angle_atan_ratio(steep ? x : y, steep ? y : x);
    if (steep) {
        return angle_with_sign(ANGLE_HALF_PI, y) - ratio;
    }
    return x < 0.0f ? angle_with_sign(BERTH_PI, y) + ratio : ratio;
}

/* arcsin(s) = s + s z P(z), z = s^2. Least maximum relative error over [0, 1/2]: 9e-8. */
static inline float angle_asin_core(float s, float z) {
    return s +
           s * z * (0.166655704f + z * (0.0754098296f + z * (0.0400071256f + z * 0.0500108749f)));
}

/* Arcsine of a ratio in [0, 1], without the tests of sign and range; the same bits. At 1 the square
 * root is 0, which gives pi/2. */
static inline float angle_asin_ratio(float x) {
    if (x <= 0.5f) {
        return angle_asin_core(x, x * x);
    }
    const float z = 0.5f * (1.0f - x);
    const float half = angle_asin_core(sqrtf(z), z);
    return ANGLE_HALF_PI - (half + half);
}

/* Above 1/2: arcsin(x) = pi/2 - 2 arcsin(sqrt((1 - x) / 2)). */
static inline float berth_asin_inline(float x) {
    const float ax = fabsf(x);
    if (ax <= 0.5f) {
        return angle_asin_core(x, x * x);
    }
    const float below_one = 1.0f - ax;
    if (below_one <= 0.0f) {
        return angle_with_sign(ANGLE_HALF_PI, x);
    }
    const float z = 0.5f * below_one;
    const float half = angle_asin_core(sqrtf(z), z);
    return angle_with_sign(ANGLE_HALF_PI - (half + half), x);
}

#endif
