/* Angles against double precision: accuracy, symmetry, edges, and the bits of the results.
 *
 * usage: test_angle [SEED]    seed of the random arguments
 */
#include "berth/angle.h"
#include "support.h"
#include "unity.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* angle.h promises 2e-6 throughout; these are what the polynomials and rounding leave. A
 * coefficient with a wrong digit shows here long before it breaks the promise. */
#define WRAP_ERROR_MAX 4.0e-7
#define SINCOS_ERROR_MAX 7.5e-7
#define CIRCLE_ERROR_MAX 1.5e-6
#define ATAN2_ERROR_MAX 7.0e-7
#define ASIN_ERROR_MAX 2.5e-7
#define RELATIVE_ERROR_MAX 1.2e-6

#define PI 3.14159265358979323846
#define TURN (2.0 * PI)

/* Neighbours of pi: the largest float32 below it and the smallest above. */
#define BELOW_PI 0x1.921fb4p+1f
#define ABOVE_PI 0x1.921fb6p+1f

static uint64_t seed = 0x5eed0fa9u;

static uint32_t next_random(uint64_t *state) {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    return (uint32_t)(*state >> 24);
}

static float float_of(uint32_t bits) {
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static uint32_t bits_of(float value) {
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

/* Any bit pattern of a finite float32: all exponents are equally likely. */
static float random_finite(uint64_t *state) {
    for (;;) {
        const float value = float_of(next_random(state));
        if (isfinite(value)) {
            return value;
        }
    }
}

static float random_in(uint64_t *state, double lo, double hi) {
    return (float)(lo + (hi - lo) * (double)next_random(state) / 4294967296.0);
}

/* Largest error so far and where it was. */
typedef struct {
    double error;
    float at[2];
} worst_t;

static void note(worst_t *worst, double error, float x, float y) {
    if (!(error <= worst->error)) { /* true for NaN, which must not pass */
        *worst = (worst_t){error, {x, y}};
    }
}

static void expect_within(const char *what, const worst_t *worst, double limit) {
    char message[160];
    snprintf(message, sizeof message, "%s: largest error %.3g at %a, %a", what, worst->error,
             (double)worst->at[0], (double)worst->at[1]);
    puts(message);
    TEST_ASSERT_TRUE_MESSAGE(worst->error <= limit, message);
}

/* Equal to the bit; any NaN equals any other. */
static bool same(float a, float b) {
    return bits_of(a) == bits_of(b) || (isnan(a) && isnan(b));
}

static void expect_same(const char *what, float expected, float actual, float x, float y) {
    if (!same(expected, actual)) {
        char message[160];
        snprintf(message, sizeof message, "%s: expected %a, found %a at %a, %a", what,
                 (double)expected, (double)actual, (double)x, (double)y);
        TEST_FAIL_MESSAGE(message);
    }
}

/* 2^(e - 23) modulo 2 pi for e = 14 to 127, from 80 decimal digits:
 *   from mpmath import *; mp.dps = 80
 *   for e in range(14, 128): v = mpf(2)**(e - 23); print(float(v - 2*pi*nint(v/(2*pi))).hex()) */
static const double POWER_WRAPPED[114] = {
    0x1.0000000000000p-9,  0x1.0000000000000p-8,  0x1.0000000000000p-7,  0x1.0000000000000p-6,
    0x1.0000000000000p-5,  0x1.0000000000000p-4,  0x1.0000000000000p-3,  0x1.0000000000000p-2,
    0x1.0000000000000p-1,  0x1.0000000000000p+0,  0x1.0000000000000p+1,  -0x1.243f6a8885a31p+1,
    0x1.b7812aeef4b9fp+0,  -0x1.6cbe3f9990e92p+1, 0x1.2b0bad558f435p-1,  0x1.2b0bad558f435p+0,
    0x1.2b0bad558f435p+1,  -0x1.9c501fbace38dp+0, 0x1.87ef4acdb76a3p+1,  -0x1.460d4ed16ce9ep-3,
    -0x1.460d4ed16ce9ep-2, -0x1.460d4ed16ce9ep-1, -0x1.460d4ed16ce9ep+0, -0x1.460d4ed16ce9ep+1,
    0x1.304999cb579e8p+0,  0x1.304999cb579e8p+1,  -0x1.87586de3accc3p+0, -0x1.87586de3accc3p+1,
    0x1.58e8ec12c0aa8p-3,  0x1.58e8ec12c0aa8p-2,  0x1.58e8ec12c0aa8p-1,  0x1.58e8ec12c0aa8p+0,
    0x1.58e8ec12c0aa8p+1,  -0x1.c9b6498c1137fp-1, -0x1.c9b6498c1137fp+0, 0x1.5a8920fc746b2p+1,
    -0x1.bcb4a23e73336p-1, -0x1.bcb4a23e73336p+0, 0x1.678ac84a126fap+1,  -0x1.54a767d1830eep-1,
    -0x1.54a767d1830eep+0, -0x1.54a767d1830eep+1, 0x1.ebc26b95fe14fp-1,  0x1.ebc26b95fe14fp+0,
    -0x1.387cfef2878e2p+1, 0x1.668ad946ed0dap+0,  0x1.668ad946ed0dap+1,  -0x1.5ca6dfeaae1f6p-1,
    -0x1.5ca6dfeaae1f6p+0, -0x1.5ca6dfeaae1f6p+1, 0x1.abc6aacca5912p-1,  0x1.abc6aacca5912p+0,
    -0x1.7878bfbbe011fp+1, 0x1.9a6f58862bf99p-2,  0x1.9a6f58862bf99p-1,  0x1.9a6f58862bf99p+0,
    -0x1.89d0120259a97p+1, 0x1.09f4683d25023p-3,  0x1.09f4683d25023p-2,  0x1.09f4683d25023p-1,
    0x1.09f4683d25023p+0,  0x1.09f4683d25023p+1,  -0x1.10569a0e3b9eap+1, 0x1.0392366c0e65cp+1,
    -0x1.1d1afdb068d79p+1, 0x1.d412de4f67e7ep+0,  -0x1.502c8c391dbb2p+1, 0x1.07cca42c94599p+0,
    0x1.07cca42c94599p+1,  -0x1.14a6222f5ceffp+1, 0x1.f5e64c5397865p+0,  -0x1.2e591e34ee1cbp+1,
    0x1.8f1a5c3d52d34p+0,  0x1.8f1a5c3d52d34p+1,  -0x1.82ac8377ff216p-5, -0x1.82ac8377ff216p-4,
    -0x1.82ac8377ff216p-3, -0x1.82ac8377ff216p-2, -0x1.82ac8377ff216p-1, -0x1.82ac8377ff216p+0,
    -0x1.82ac8377ff216p+1, 0x1.ee6639887604dp-3,  0x1.ee6639887604dp-2,  0x1.ee6639887604dp-1,
    0x1.ee6639887604dp+0,  -0x1.35d931000f9e3p+1, 0x1.711a1110cccd4p+0,  0x1.711a1110cccd4p+1,
    -0x1.082d219bb0225p-1, -0x1.082d219bb0225p+0, -0x1.082d219bb0225p+1, 0x1.13e52751255e7p+1,
    -0x1.f8ea37cc75cc6p+0, 0x1.2b5532bc0fd6bp+1,  -0x1.9b2a0a20cbeb6p+0, 0x1.89156067b9b7bp+1,
    -0x1.214a9b91233b2p-3, -0x1.214a9b91233b2p-2, -0x1.214a9b91233b2p-1, -0x1.214a9b91233b2p+0,
    -0x1.214a9b91233b2p+1, 0x1.c35466cc7e59ap+0,  -0x1.60eb03bc07497p+1, 0x1.89a58c41dc40cp-1,
    0x1.89a58c41dc40cp+0,  0x1.89a58c41dc40cp+1,  -0x1.0f45204cd2192p-3, -0x1.0f45204cd2192p-2,
    -0x1.0f45204cd2192p-1, -0x1.0f45204cd2192p+0, -0x1.0f45204cd2192p+1, 0x1.05b529eee170cp+1,
    -0x1.18d516aac2c18p+1, 0x1.e52a7a6600402p+0};

/* Reference with an error below 3e-8: the mantissa is multiplied in halves, so that the error of
 * the rounded table entry grows by 2^24 only in its absolute size. */
static double wrap_reference(float x) {
    if (fabsf(x) < 16384.0f) {
        return remainder((double)x, TURN);
    }
    int exponent;
    const double fraction = frexp((double)x, &exponent);
    const double mantissa = ldexp(fraction, 24);
    const double high = trunc(mantissa / 4096.0);
    const double low = mantissa - 4096.0 * high;
    const double unit = POWER_WRAPPED[exponent - 1 - 14];
    const double partial = 4096.0 * remainder(high * unit, TURN) + low * unit;
    return remainder(partial, TURN);
}

static double wrap_error(float x) {
    const float wrapped = berth_wrap(x);
    if (!(fabsf(wrapped) <= BELOW_PI)) {
        return HUGE_VAL;
    }
    return fabs(remainder((double)wrapped - wrap_reference(x), TURN));
}

static double sincos_error(float x) {
    float sine;
    float cosine;
    berth_sincos(x, &sine, &cosine);
    const double reduced = wrap_reference(x);
    return fmax(fabs((double)sine - sin(reduced)), fabs((double)cosine - cos(reduced)));
}

static double atan2_error(float y, float x) {
    return fabs((double)berth_atan2(y, x) - atan2((double)y, (double)x));
}

static double asin_error(float x) {
    return fabs((double)berth_asin(x) - asin((double)x));
}

/* Values that the reductions and branches turn on, all not negative; the tests use both signs. */
static const float EDGES[] = {0.0f,
                              0x1p-149f,
                              0x1.fffffcp-127f,
                              FLT_MIN,
                              0x1p-64f,
                              1e-10f,
                              1e-5f,
                              0x1.921fb4p-1f,
                              0x1.921fb6p-1f,
                              0x1.921fb8p-1f,
                              0x1.921fb4p+0f,
                              0x1.921fb6p+0f,
                              0x1p-1f,
                              0x1.000002p-1f,
                              0x1.fffffep-2f,
                              0x1.fffffep-1f,
                              1.0f,
                              0x1.000002p+0f,
                              BELOW_PI,
                              ABOVE_PI,
                              0x1.921fb2p+1f,
                              0x1.921fb8p+1f,
                              0x1.2d97c6p+2f,
                              0x1.2d97c8p+2f,
                              2.0f * BELOW_PI,
                              2.0f * ABOVE_PI,
                              0x1.2d97c4p+3f,
                              0x1.2d97c6p+3f,
                              0x1.2d97c8p+3f,
                              0x1.2d97cap+3f,
                              1000.0f,
                              0x1.fffffep+13f,
                              0x1p+14f,
                              0x1.000002p+14f,
                              0x1p+23f,
                              0x1.fffffep+23f,
                              0x1p+24f,
                              1e10f,
                              0x1p+63f,
                              0x1p+64f,
                              0x1p+96f,
                              0x1.fffffep+126f,
                              0x1p+127f,
                              0x1.fffffcp+127f,
                              FLT_MAX};
#define EDGE_COUNT (sizeof EDGES / sizeof EDGES[0])

/* Regular steps through a range are as much coarser as random runs are fewer. */
static int stride(void) {
    return (int)(100u / support_runs(100));
}

void setUp(void) {}

void tearDown(void) {}

/* Between -pi and pi nothing changes, not even the sign of zero. */
static void test_wrapped_angles_stay(void) {
    uint64_t state = seed;
    for (uint32_t i = 0; i < support_runs(300000); i++) {
        const float x = random_in(&state, -(double)BELOW_PI, (double)BELOW_PI);
        expect_same("wrap", x, berth_wrap(x), x, 0.0f);
    }
    for (size_t i = 0; i < EDGE_COUNT && EDGES[i] <= BELOW_PI; i++) {
        expect_same("wrap", EDGES[i], berth_wrap(EDGES[i]), EDGES[i], 0.0f);
        expect_same("wrap", -EDGES[i], berth_wrap(-EDGES[i]), EDGES[i], 0.0f);
    }
    TEST_ASSERT_TRUE(berth_wrap(ABOVE_PI) == -BELOW_PI);
    TEST_ASSERT_TRUE(berth_wrap(-ABOVE_PI) == BELOW_PI);
}

/* Around odd multiples of pi the number of turns is hard to tell: take the neighbours of each. */
static void test_wrap_near_half_turns(void) {
    worst_t worst = {0};
    for (int k = 1; k < 5300; k += 2 * stride()) {
        const uint32_t middle = bits_of((float)(k * PI));
        for (uint32_t bits = middle - 6u; bits <= middle + 6u; bits++) {
            note(&worst, wrap_error(float_of(bits)), float_of(bits), 0.0f);
        }
    }
    expect_within("wrap near odd multiples of pi", &worst, WRAP_ERROR_MAX);
}

static void test_wrap_up_to_many_turns(void) {
    worst_t worst = {0};
    uint64_t state = seed;
    for (uint32_t bits = bits_of(BELOW_PI); bits < bits_of(9.5f);
         bits += 29u * (uint32_t)stride()) {
        note(&worst, wrap_error(float_of(bits)), float_of(bits), 0.0f);
    }
    for (uint32_t i = 0; i < support_runs(500000); i++) {
        const float x = random_in(&state, -17000.0, 17000.0);
        note(&worst, wrap_error(x), x, 0.0f);
    }
    expect_within("wrap up to 17000 rad", &worst, WRAP_ERROR_MAX);
}

static void test_wrap_and_sincos_at_every_exponent(void) {
    worst_t wrap = {0};
    worst_t sincos = {0};
    uint64_t state = seed;
    for (uint32_t exponent = 0; exponent < 255u; exponent++) {
        for (uint32_t i = 0; i < support_runs(2000); i++) {
            const float x = float_of((next_random(&state) & 0x807fffffu) | exponent << 23);
            note(&wrap, wrap_error(x), x, 0.0f);
            note(&sincos, sincos_error(x), x, 0.0f);
        }
    }
    for (size_t i = 0; i < EDGE_COUNT; i++) {
        note(&wrap, fmax(wrap_error(EDGES[i]), wrap_error(-EDGES[i])), EDGES[i], 0.0f);
        note(&sincos, fmax(sincos_error(EDGES[i]), sincos_error(-EDGES[i])), EDGES[i], 0.0f);
    }
    expect_within("wrap at every exponent", &wrap, WRAP_ERROR_MAX);
    expect_within("sincos at every exponent", &sincos, SINCOS_ERROR_MAX);
}

/* Values by mpmath as above, independent of the reference in this file. 0x1.f37c8ap+95 is the
 * float32 nearest to an odd multiple of pi / 2. */
static void test_large_angles_against_many_digits(void) {
    static const struct {
        float angle;
        double wrapped;
    } GOLDEN[] = {
        {0x1p+14f, -2.5472811243615316},          {0x1.388p+14f, 0.62116724737624396},
        {0x1.86ap+16f, 3.1058362368812196},       {0x1.000002p+23f, -2.5885770869298916},
        {0x1.2a05f2p+33f, -0.50923107216573482},  {0x1p+32f, -2.6613588116653011},
        {0x1.c6bf52p+49f, 1.4652419482995329},    {0x1.f37c8ap+95f, 1.5707963284096664},
        {0x1.5af1d8p+66f, 0.71627108944115303},   {0x1.0f0cfp+73f, -0.82431313988443899},
        {0x1p+100f, -1.0596485316801574},         {0x1.93e594p+99f, -2.2288837180324954},
        {0x1.000002p+127f, 2.5682444570056346},   {0x1.fffffcp+127f, -2.4442287446136954},
        {0x1.fffffep+127f, -0.54904932995745426}, {0x1.000002p+14f, -2.5453279993615316},
    };
    worst_t wrap = {0};
    worst_t reference = {0};
    for (size_t i = 0; i < sizeof GOLDEN / sizeof GOLDEN[0]; i++) {
        const float x = GOLDEN[i].angle;
        note(&wrap, fabs((double)berth_wrap(x) - GOLDEN[i].wrapped), x, 0.0f);
        note(&reference, fabs(wrap_reference(x) - GOLDEN[i].wrapped), x, 0.0f);
    }
    expect_within("wrap of large angles", &wrap, WRAP_ERROR_MAX);
    expect_within("reference of large angles", &reference, 3.0e-8);
}

static void test_sincos_over_some_turns(void) {
    worst_t worst = {0};
    worst_t circle = {0};
    for (int i = 0; i <= 1200000; i += stride()) {
        const float x = (float)((i - 600000) * 1.7e-5);
        float sine;
        float cosine;
        berth_sincos(x, &sine, &cosine);
        note(&worst, sincos_error(x), x, 0.0f);
        const double square = (double)sine * (double)sine + (double)cosine * (double)cosine;
        note(&circle, fabs(square - 1.0), x, 0.0f);
    }
    expect_within("sincos from -10 to 10", &worst, SINCOS_ERROR_MAX);
    expect_within("sine^2 + cosine^2", &circle, CIRCLE_ERROR_MAX);
}

static void test_sincos_at_multiples_of_an_eighth_turn(void) {
    worst_t worst = {0};
    for (int k = -4000; k <= 4000; k += stride()) {
        const float middle = (float)(k * PI / 4.0);
        const float around[3] = {nextafterf(middle, -INFINITY), middle,
                                 nextafterf(middle, INFINITY)};
        for (int i = 0; i < 3; i++) {
            note(&worst, sincos_error(around[i]), around[i], 0.0f);
        }
    }
    expect_within("sincos at multiples of pi/4", &worst, SINCOS_ERROR_MAX);
}

/* Small angles keep their relative accuracy; at 0 the cosine is exactly 1. */
static void test_small_arguments_are_relative(void) {
    worst_t worst = {0};
    uint64_t state = seed;
    for (uint32_t i = 0; i < support_runs(100000); i++) {
        const uint32_t exponent = 4u + next_random(&state) % 120u;
        const float x = float_of((next_random(&state) & 0x007fffffu) | exponent << 23);
        float sine;
        float cosine;
        berth_sincos(x, &sine, &cosine);
        note(&worst, fabs((double)sine / sin((double)x) - 1.0), x, 0.0f);
        note(&worst, fabs((double)berth_atan2(x, 1.0f) / atan((double)x) - 1.0), x, 0.0f);
        note(&worst, fabs((double)berth_asin(x) / asin((double)x) - 1.0), x, 0.0f);
    }
    expect_within("relative, below 1/8", &worst, RELATIVE_ERROR_MAX);
    float sine;
    float cosine;
    berth_sincos(0.0f, &sine, &cosine);
    TEST_ASSERT_TRUE(sine == 0.0f && cosine == 1.0f);
}

static void test_atan2_all_around(void) {
    static const float SCALES[] = {0x1p-140f, 0x1p-126f, 1e-20f, 1.0f, 37.0f, 1e20f, 0x1p+127f};
    worst_t worst = {0};
    uint64_t state = seed;
    for (size_t s = 0; s < sizeof SCALES / sizeof SCALES[0]; s++) {
        for (uint32_t i = 0; i < support_runs(80000); i++) {
            const double angle = (double)random_in(&state, -PI, PI);
            const float y = (float)(sin(angle) * (double)SCALES[s]);
            const float x = (float)(cos(angle) * (double)SCALES[s]);
            note(&worst, atan2_error(y, x), y, x);
        }
    }
    for (uint32_t i = 0; i < support_runs(300000); i++) {
        const float y = random_finite(&state);
        const float x = random_finite(&state);
        note(&worst, atan2_error(y, x), y, x);
    }
    expect_within("atan2 all around", &worst, ATAN2_ERROR_MAX);
}

static void test_atan2_of_all_pairs_of_edges(void) {
    worst_t worst = {0};
    for (size_t i = 0; i < EDGE_COUNT; i++) {
        for (size_t j = 0; j < EDGE_COUNT; j++) {
            const float y = EDGES[i];
            const float x = EDGES[j];
            note(&worst, atan2_error(y, x), y, x);
            note(&worst, atan2_error(-y, x), -y, x);
            if (y != 0.0f || x != 0.0f) { /* the library tells (0, -0) from (0, 0) */
                note(&worst, atan2_error(y, -x), y, -x);
                note(&worst, atan2_error(-y, -x), -y, -x);
            }
        }
    }
    expect_within("atan2 at edges", &worst, ATAN2_ERROR_MAX);
}

static void test_atan2_on_the_axes(void) {
    const float pi = BERTH_PI;
    expect_same("atan2", 0.0f, berth_atan2(0.0f, 0.0f), 0.0f, 0.0f);
    expect_same("atan2", 0.0f, berth_atan2(0.0f, -0.0f), 0.0f, -0.0f);
    expect_same("atan2", 0.0f, berth_atan2(0.0f, 2.0f), 0.0f, 2.0f);
    expect_same("atan2", pi, berth_atan2(0.0f, -2.0f), 0.0f, -2.0f);
    expect_same("atan2", -pi, berth_atan2(-0.0f, -2.0f), -0.0f, -2.0f);
    expect_same("atan2", 0.5f * pi, berth_atan2(2.0f, 0.0f), 2.0f, 0.0f);
    expect_same("atan2", 0.5f * pi, berth_atan2(2.0f, -0.0f), 2.0f, -0.0f);
    expect_same("atan2", -0.5f * pi, berth_atan2(-2.0f, 0.0f), -2.0f, 0.0f);
}

static void test_asin_over_its_range(void) {
    worst_t worst = {0};
    for (int i = -600000; i <= 600000; i += stride()) {
        const float x = (float)(i / 600000.0);
        note(&worst, asin_error(x), x, 0.0f);
    }
    for (uint32_t bits = bits_of(1.0f) - 100000u; bits <= bits_of(1.0f);
         bits += (uint32_t)stride()) {
        note(&worst, asin_error(float_of(bits)), float_of(bits), 0.0f);
    }
    for (size_t i = 0; i < EDGE_COUNT && EDGES[i] <= 1.0f; i++) {
        note(&worst, asin_error(EDGES[i]), EDGES[i], 0.0f);
    }
    expect_within("asin", &worst, ASIN_ERROR_MAX);
}

static void test_asin_beyond_one_is_that_of_one(void) {
    const float right = 0.5f * BERTH_PI;
    static const float BEYOND[] = {1.0f, 0x1.000002p+0f, 2.0f, 1e30f, FLT_MAX, INFINITY};
    for (size_t i = 0; i < sizeof BEYOND / sizeof BEYOND[0]; i++) {
        expect_same("asin", right, berth_asin(BEYOND[i]), BEYOND[i], 0.0f);
        expect_same("asin", -right, berth_asin(-BEYOND[i]), -BEYOND[i], 0.0f);
    }
}

static void expect_symmetric(float x, float y) {
    float sine[2];
    float cosine[2];
    berth_sincos(x, &sine[0], &cosine[0]);
    berth_sincos(-x, &sine[1], &cosine[1]);
    expect_same("sine is odd", -sine[0], sine[1], x, 0.0f);
    expect_same("cosine is even", cosine[0], cosine[1], x, 0.0f);
    expect_same("wrap is odd", -berth_wrap(x), berth_wrap(-x), x, 0.0f);
    expect_same("asin is odd", -berth_asin(x), berth_asin(-x), x, 0.0f);
    expect_same("atan2 is odd in y", -berth_atan2(y, x), berth_atan2(-y, x), y, x);
}

static void test_symmetry_to_the_bit(void) {
    uint64_t state = seed;
    for (uint32_t i = 0; i < support_runs(300000); i++) {
        const float any_x = random_finite(&state);
        const float any_y = random_finite(&state);
        expect_symmetric(any_x, any_y);
        const float x = random_in(&state, -20.0, 20.0);
        const float y = random_in(&state, -20.0, 20.0);
        expect_symmetric(x, y);
        expect_symmetric(x * 0.05f, y);
    }
    for (size_t i = 0; i < EDGE_COUNT; i++) {
        for (size_t j = 0; j < EDGE_COUNT; j++) {
            expect_symmetric(EDGES[i], EDGES[j]);
            expect_symmetric(-EDGES[i], EDGES[j]);
        }
    }
}

static void test_not_finite_gives_nan(void) {
    const float bad[] = {NAN, -NAN, INFINITY, -INFINITY, float_of(0x7f800001u)};
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        float sine = 0.0f;
        float cosine = 0.0f;
        berth_sincos(bad[i], &sine, &cosine);
        TEST_ASSERT_TRUE(isnan(sine) && isnan(cosine));
        TEST_ASSERT_TRUE(isnan(berth_wrap(bad[i])));
        for (size_t j = 0; j < EDGE_COUNT; j++) {
            TEST_ASSERT_TRUE(isnan(berth_atan2(bad[i], EDGES[j])));
            TEST_ASSERT_TRUE(isnan(berth_atan2(bad[i], -EDGES[j])));
            TEST_ASSERT_TRUE(isnan(berth_atan2(EDGES[j], bad[i])));
        }
        TEST_ASSERT_TRUE(isnan(berth_atan2(bad[i], bad[i])));
        TEST_ASSERT_TRUE(isnan(berth_asin(bad[i])) == isnan(bad[i]));
    }
}

/* FNV-1a over the bytes of a result, low byte first; all NaN count as one. */
static void hash_result(uint32_t *hash, float result) {
    const uint32_t bits = isnan(result) ? 0x7fc00000u : bits_of(result);
    for (unsigned shift = 0; shift < 32u; shift += 8u) {
        *hash = (*hash ^ (bits >> shift & 0xffu)) * 16777619u;
    }
}

static void hash_results(uint32_t *hash, float x, float y) {
    float sine;
    float cosine;
    berth_sincos(x, &sine, &cosine);
    hash_result(hash, sine);
    hash_result(hash, cosine);
    hash_result(hash, berth_wrap(x));
    hash_result(hash, berth_atan2(y, x));
    hash_result(hash, berth_asin(x));
}

/* The same bits with every compiler, optimisation and target: a replayed log depends on it. The
 * arguments do not depend on the seed. A deliberate change of a polynomial changes the hash. */
static void test_results_have_the_same_bits_everywhere(void) {
    uint32_t hash = 2166136261u;
    uint64_t state = 1u;
    for (int i = 0; i < 100000; i++) {
        const float any_x = float_of(next_random(&state));
        const float any_y = float_of(next_random(&state));
        hash_results(&hash, any_x, any_y);
        const int32_t x = (int32_t)(next_random(&state) >> 8) - 0x800000;
        const int32_t y = (int32_t)(next_random(&state) >> 8) - 0x800000;
        hash_results(&hash, (float)x * 0x1p-23f, (float)y * 0x1p-23f);
        hash_results(&hash, (float)x * 0x1p-20f, (float)y * 0x1p-22f);
    }
    printf("hash of results: %08lx\n", (unsigned long)hash);
    TEST_ASSERT_EQUAL_HEX32(0x2f7e9423u, hash);
}

int main(int argc, char **argv) {
    if (argc > 1) {
        seed = strtoull(argv[1], NULL, 0) | 1u; /* the generator must not start at 0 */
    }
    printf("seed 0x%llx\n", (unsigned long long)seed);
    UNITY_BEGIN();
    RUN_TEST(test_wrapped_angles_stay);
    RUN_TEST(test_wrap_near_half_turns);
    RUN_TEST(test_wrap_up_to_many_turns);
    RUN_TEST(test_wrap_and_sincos_at_every_exponent);
    RUN_TEST(test_large_angles_against_many_digits);
    RUN_TEST(test_sincos_over_some_turns);
    RUN_TEST(test_sincos_at_multiples_of_an_eighth_turn);
    RUN_TEST(test_small_arguments_are_relative);
    RUN_TEST(test_atan2_all_around);
    RUN_TEST(test_atan2_of_all_pairs_of_edges);
    RUN_TEST(test_atan2_on_the_axes);
    RUN_TEST(test_asin_over_its_range);
    RUN_TEST(test_asin_beyond_one_is_that_of_one);
    RUN_TEST(test_symmetry_to_the_bit);
    RUN_TEST(test_not_finite_gives_nan);
    RUN_TEST(test_results_have_the_same_bits_everywhere);
    return UNITY_END();
}
