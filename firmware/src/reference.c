#include "berth/reference.h"

#include "bytes.h"
#include "check.h"
#include "plan_inline.h"

/* MISRA D9 in this file. */

#ifdef BERTH_WITHOUT_ZOH
#define DISCRETIZATION_MAX BERTH_DISCRETIZATION_EULER
#else
#define DISCRETIZATION_MAX BERTH_DISCRETIZATION_ZOH
#endif

/* Compared as floats, which hold all of these integers exactly. */
static bool check_header(const berth_plan_t *plan, berth_refusal_t *refusal) {
    return check_value(BERTH_FIELD_PLAN_COUNT, (float)plan->count, 1.0f,
                       (float)BERTH_PLAN_COUNT_MAX, refusal) &&
           check_value(BERTH_FIELD_PLAN_PERIOD, (float)plan->period_us, (float)BERTH_PERIOD_MIN_US,
                       (float)BERTH_PERIOD_MAX_US, refusal) &&
           check_value(BERTH_FIELD_PLAN_HORIZON, (float)plan->mpc.horizon, 1.0f,
                       (float)BERTH_HORIZON_MAX, refusal) &&
           check_value(BERTH_FIELD_PLAN_DISCRETIZATION, (float)plan->mpc.discretization, 0.0f,
                       (float)DISCRETIZATION_MAX, refusal) &&
           check_value(BERTH_FIELD_PLAN_GAIN_SOURCE, (float)plan->gain_source, 0.0f,
                       (float)BERTH_GAIN_ONLINE, refusal);
}

static bool check_sample(const berth_sample_t *sample, berth_refusal_t *refusal) {
    static const check_rule_t rules[] = {
        {BERTH_FIELD_SAMPLE_X, false, CHECK_AT(berth_sample_t, x_m), -BERTH_POSITION_MAX_M,
         BERTH_POSITION_MAX_M},
        {BERTH_FIELD_SAMPLE_Y, false, CHECK_AT(berth_sample_t, y_m), -BERTH_POSITION_MAX_M,
         BERTH_POSITION_MAX_M},
        {BERTH_FIELD_SAMPLE_THETA, false, CHECK_AT(berth_sample_t, theta_rad), -BERTH_PI, BERTH_PI},
        {BERTH_FIELD_SAMPLE_V, false, CHECK_AT(berth_sample_t, v_mps), -BERTH_SAMPLE_V_MAX_MPS,
         BERTH_SAMPLE_V_MAX_MPS},
        {BERTH_FIELD_SAMPLE_OMEGA, false, CHECK_AT(berth_sample_t, omega_radps),
         -BERTH_SAMPLE_OMEGA_MAX_RADPS, BERTH_SAMPLE_OMEGA_MAX_RADPS},
    };
    return check_rules(sample, rules, CHECK_COUNT(rules), refusal);
}

static bool check_rows(const berth_plan_t *plan, berth_refusal_t *refusal) {
    for (uint32_t k = 0; k < plan->count; k++) {
        bool good = check_sample(&plan->samples[k], refusal);
        if (good && plan->gains != NULL) {
            for (uint32_t row = 0; good && row < 2u; row++) {
                good = check_vector(BERTH_FIELD_GAIN, plan->gains[k].k[row], 3, -BERTH_GAIN_MAX,
                                    BERTH_GAIN_MAX, refusal);
            }
        }
        if (!good) {
            refusal->index = k;
            return false;
        }
    }
    return true;
}

berth_error_t berth_plan_check(const berth_plan_t *plan, berth_refusal_t *refusal) {
    const bool wants_table = plan->gain_source == BERTH_GAIN_TABLE;
    if (plan->samples == NULL || (plan->gains != NULL) != wants_table) {
        return BERTH_ERROR_ARGUMENT;
    }
    const bool good =
        check_header(plan, refusal) &&
        check_vector(BERTH_FIELD_PLAN_Q, plan->mpc.q, 3, 0.0f, BERTH_WEIGHT_MAX, refusal) &&
        check_vector(BERTH_FIELD_PLAN_R, plan->mpc.r, 2, BERTH_WEIGHT_R_MIN, BERTH_WEIGHT_MAX,
                     refusal) &&
        check_rows(plan, refusal);
    return good ? BERTH_OK : BERTH_ERROR_PLAN;
}

/* Four bits at a time: a table of 16 words is little flash, and the plan is checked at rest. */
static uint32_t crc_word(uint32_t crc, uint32_t word) {
    static const uint32_t table[16] = {
        0x00000000u, 0x1db71064u, 0x3b6e20c8u, 0x26d930acu, 0x76dc4190u, 0x6b6b51f4u,
        0x4db26158u, 0x5005713cu, 0xedb88320u, 0xf00f9344u, 0xd6d6a3e8u, 0xcb61b38cu,
        0x9b64c2b0u, 0x86d3d2d4u, 0xa00ae278u, 0xbdbdf21cu,
    };
    crc ^= word;
    for (int nibble = 0; nibble < 8; nibble++) {
        crc = (crc >> 4) ^ table[crc & 15u];
    }
    return crc;
}

static uint32_t crc_floats(uint32_t crc, const float *values, uint32_t count) {
    for (uint32_t i = 0; i < count; i++) {
        crc = crc_word(crc, bits_from_float(values[i]));
    }
    return crc;
}

uint32_t berth_plan_crc(const berth_plan_t *plan) {
    const uint32_t flags = ((uint32_t)plan->closed << 24) | ((uint32_t)plan->gain_source << 16) |
                           ((uint32_t)plan->mpc.discretization << 8);
    uint32_t crc = UINT32_MAX;
    crc = crc_word(crc, plan->count);
    crc = crc_word(crc, plan->period_us);
    crc = crc_word(crc, plan->mpc.horizon);
    crc = crc_word(crc, flags);
    crc = crc_floats(crc, plan->mpc.q, 3);
    crc = crc_floats(crc, plan->mpc.r, 2);
    for (uint32_t k = 0; k < plan->count; k++) {
        const berth_sample_t *sample = &plan->samples[k];
        const float row[5] = {sample->x_m, sample->y_m, sample->theta_rad, sample->v_mps,
                              sample->omega_radps};
        crc = crc_floats(crc, row, 5);
        if (plan->gains != NULL) {
            crc = crc_floats(crc, plan->gains[k].k[0], 3);
            crc = crc_floats(crc, plan->gains[k].k[1], 3);
        }
    }
    return ~crc;
}

berth_sample_t berth_plan_sample(const berth_plan_t *plan, uint32_t k) {
    berth_sample_t sample;
    plan_sample_inline(plan, k, &sample);
    return sample;
}

void berth_reference_start(berth_reference_t *reference, const berth_plan_t *plan, int64_t now_us) {
    *reference = (berth_reference_t){.next_us = now_us + (plan->period_us + 1u) / 2u};
}

/* Quotient and remainder for a divisor below 2^20, twelve bits at a time: the compiler's 64-bit
 * division would cost 700 bytes of flash for a step that is more than an hour late. */
static uint64_t divide(uint64_t value, uint32_t divisor, uint32_t *remainder) {
    uint64_t quotient = 0;
    uint32_t rest = 0;
    for (int shift = 60; shift >= 0; shift -= 12) {
        const uint32_t part = (rest << 12) | (uint32_t)((value >> (uint32_t)shift) & 0xfffu);
        quotient = (quotient << 12) | (part / divisor);
        rest = part % divisor;
    }
    *remainder = rest;
    return quotient;
}

_Static_assert(BERTH_PERIOD_MAX_US < 0x100000u && BERTH_PLAN_COUNT_MAX < 0x100000u,
               "divide() takes divisors below 2^20");

void berth_reference_advance(berth_reference_t *reference, const berth_plan_t *plan,
                             int64_t now_us) {
    if (now_us < reference->next_us) {
        return;
    }
    const int64_t behind_us = now_us - reference->next_us;
    uint64_t late_us = (uint64_t)behind_us;
    uint64_t late = 0; /* whole periods */
    uint32_t index;
    if (late_us >= plan->period_us) { /* off the usual path, which has no division */
        uint32_t into_us;
        late = divide(late_us, plan->period_us, &into_us);
        late_us = into_us;
    }
    reference->next_us = now_us - (int64_t)late_us + plan->period_us;
    reference->total += (uint32_t)late + 1u;
    const uint64_t skipped = reference->skipped + late;
    reference->skipped = skipped > UINT32_MAX ? UINT32_MAX : (uint32_t)skipped;
    const uint64_t reached = reference->index + late + 1u;
    if (reached < plan->count) {
        reference->index = (uint32_t)reached;
    } else if (plan->closed) {
        (void)divide(reached, plan->count, &index);
        reference->index = index;
    } else {
        reference->index = plan->count;
        reference->finished = true;
    }
}
