/* Seeded random numbers: the same stream on every platform, compiler and word size, because only
 * integer arithmetic and IEEE double + - * / sqrt are used (no libm but sqrt, which IEEE 754
 * defines to the bit). Not for secrets. One generator belongs to one thread. */
#ifndef HOST_SIM_RNG_H
#define HOST_SIM_RNG_H

#include <stdbool.h>
#include <stdint.h>

/* xoshiro256** 1.0 (Blackman & Vigna 2018): period 2^256 - 1. */
typedef struct {
    uint64_t state[4];
    double spare; /* second value of the last normal pair */
    bool has_spare;
} rng_t;

/* Any seed is good: neighbouring seeds give unrelated streams (splitmix64 spreads them). */
void rng_seed(rng_t *rng, uint64_t seed);
uint64_t rng_u64(rng_t *rng);
double rng_uniform(rng_t *rng, double low, double high); /* in [low, high), 53 random bits */
double rng_normal(rng_t *rng);                           /* mean 0, standard deviation 1 */

/* Natural logarithm of a positive, finite, normal x, within 2 units in the last place. */
double rng_log(double x);

#endif
