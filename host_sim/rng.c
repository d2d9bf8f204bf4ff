#include "rng.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

static uint64_t splitmix64(uint64_t *state) {
    uint64_t z = (*state += 0x9e3779b97f4a7c15u);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return z ^ (z >> 31);
}

static uint64_t rotate_left(uint64_t x, int bits) {
    return (x << bits) | (x >> (64 - bits));
}

void rng_seed(rng_t *rng, uint64_t seed) {
    for (int i = 0; i < 4; ++i) {
        rng->state[i] = splitmix64(&seed);
    }
    rng->spare = 0.0;
    rng->has_spare = false;
}

uint64_t rng_u64(rng_t *rng) {
    uint64_t *s = rng->state;
    uint64_t result = rotate_left(s[1] * 5, 7) * 9;
    uint64_t t = s[1] << 17;
    s[2] ^= s[0];
    s[3] ^= s[1];
    s[1] ^= s[2];
    s[0] ^= s[3];
    s[2] ^= t;
    s[3] = rotate_left(s[3], 45);
    return result;
}

double rng_uniform(rng_t *rng, double low, double high) {
    double unit = (double)(rng_u64(rng) >> 11) * 0x1p-53;
    double value = low + (high - low) * unit;
    /* The sum can round up to high. */
    return value < high ? value : low;
}

/* x = 2^exponent m with m in [1, 2); returns m. */
static double split_exponent(double x, int *exponent) {
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    *exponent = (int)(bits >> 52) - 1023;
    bits = (bits & 0x000fffffffffffffu) | 0x3ff0000000000000u;
    memcpy(&x, &bits, sizeof x);
    return x;
}

double rng_log(double x) {
    /* ln 2 in two parts: any exponent times the first one is exact. */
    static const double ln2_high = 0x1.62e42fee00000p-1;
    static const double ln2_low = 0x1.a39ef35793c76p-33;
    static const double inverse[] = {1.0 / 23, 1.0 / 21, 1.0 / 19, 1.0 / 17, 1.0 / 15, 1.0 / 13,
                                     1.0 / 11, 1.0 / 9,  1.0 / 7,  1.0 / 5,  1.0 / 3};
    int exponent;
    double m = split_exponent(x, &exponent);
    if (m > 1.41421356237309505) {
        m *= 0.5;
        exponent += 1;
    }
    /* ln m = 2 atanh z; |z| <= 0.172, so that the first term left out is below 2^-59. */
    double f = m - 1.0;
    double z = f / (m + 1.0);
    double w = z * z;
    double sum = 0.0;
    for (size_t i = 0; i < sizeof inverse / sizeof inverse[0]; ++i) {
        sum = sum * w + inverse[i];
    }
    /* 2 z = f - z f, which keeps the leading term exact. */
    double tail = z * (2.0 * w * sum - f);
    double e = (double)exponent;
    return e * ln2_high + (f + (tail + e * ln2_low));
}

double rng_normal(rng_t *rng) {
    if (rng->has_spare) {
        rng->has_spare = false;
        return rng->spare;
    }
    /* Marsaglia's polar method: a uniform point of the unit disc gives two normal values. */
    double a;
    double b;
    double s;
    do {
        a = rng_uniform(rng, -1.0, 1.0);
        b = rng_uniform(rng, -1.0, 1.0);
        s = a * a + b * b;
    } while (s >= 1.0 || s <= 0.0);
    double scale = sqrt(-2.0 * rng_log(s) / s);
    rng->spare = b * scale;
    rng->has_spare = true;
    return a * scale;
}
