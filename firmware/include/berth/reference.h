/* berth/reference.h - the plan (samples, gains, weights) and its index in time.
 *
 * A plan is constant data: fixed-size const arrays that berth-gen writes, or arrays that the caller
 * fills at run time. It must stay unchanged while a controller uses it. The gains are either a
 * table with one row a sample, or absent and computed in each step; the controller is the same.
 *
 * Sample k is meant for the time k T after the start. Beyond its last sample an open plan holds the
 * last pose with v = omega = 0, and a closed plan wraps around to its first sample.
 */
#ifndef BERTH_REFERENCE_H
#define BERTH_REFERENCE_H

#include "berth/result.h"
#include "berth/types.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Ranges that berth_plan_check enforces. The horizon's bound keeps a table-free step bounded. */
#define BERTH_PLAN_COUNT_MAX 1000000u
#define BERTH_PERIOD_MIN_US 1000u
#define BERTH_PERIOD_MAX_US 1000000u
#define BERTH_HORIZON_MAX 200u
#define BERTH_SAMPLE_V_MAX_MPS 100.0f
#define BERTH_SAMPLE_OMEGA_MAX_RADPS 100.0f
#define BERTH_WEIGHT_MAX 1.0e6f
#define BERTH_WEIGHT_R_MIN 1.0e-6f
#define BERTH_GAIN_MAX 1.0e6f

/* Where the library is compiled with BERTH_WITHOUT_ZOH defined, plans with the zero-order hold are
 * refused, which saves some 900 bytes of flash. */
typedef enum {
    BERTH_DISCRETIZATION_EULER = 0, /* A_k = I + T A, B_d = T B */
    BERTH_DISCRETIZATION_ZOH = 1    /* exact for inputs held over the period */
} berth_discretization_t;

typedef enum {
    BERTH_GAIN_TABLE = 0, /* plan.gains has one row a sample */
    BERTH_GAIN_ONLINE = 1 /* plan.gains is NULL; berth_riccati_gain runs in each step */
} berth_gain_source_t;

/* Weights and horizon of the tracking problem. The gain table was computed with them; the gain that
 * holds the last pose of an open plan, and online gains, are computed from them on the board. */
typedef struct {
    float q[3];       /* on e1 (1/m^2), e2 (1/m^2), e3 (1/rad^2): 0 to BERTH_WEIGHT_MAX */
    float r[2];       /* on u1 (s^2/m^2), u2 (s^2/rad^2): BERTH_WEIGHT_R_MIN to BERTH_WEIGHT_MAX */
    uint16_t horizon; /* N, periods: 1 to BERTH_HORIZON_MAX */
    uint8_t discretization; /* berth_discretization_t */
} berth_mpc_t;

typedef struct {
    const berth_sample_t *samples; /* count rows */
    const berth_gain_t *gains;     /* count rows, or NULL: see gain_source */
    uint32_t count;                /* 1 to BERTH_PLAN_COUNT_MAX */
    uint32_t period_us;            /* T: BERTH_PERIOD_MIN_US to BERTH_PERIOD_MAX_US */
    berth_mpc_t mpc;
    bool closed;         /* wraps around instead of ending */
    uint8_t gain_source; /* berth_gain_source_t */
} berth_plan_t;

/* Where the plan's clock stands. */
typedef struct {
    int64_t next_us;  /* when the sample after this one becomes the nearest in time */
    uint32_t index;   /* current sample; plan->count when an open plan has ended */
    uint32_t total;   /* samples gone by since the start, modulo 2^32: counts laps too */
    uint32_t skipped; /* periods passed over since the start because steps came late */
    bool finished;    /* an open plan is past its last sample */
} berth_reference_t;

/* Validates every value of the plan: O(count). plan and refusal must not be NULL.
 * Returns BERTH_OK, BERTH_ERROR_ARGUMENT (no samples, or a gain table that is absent or should be)
 * or BERTH_ERROR_PLAN with *refusal filled. */
BERTH_MUST_USE berth_error_t berth_plan_check(const berth_plan_t *plan, berth_refusal_t *refusal);

/* CRC-32 (IEEE 802.3) of everything that a plan points to and of its numbers, to tell later whether
 * it is still what was checked. O(count), some 400 instructions a sample. */
uint32_t berth_plan_crc(const berth_plan_t *plan);

/* Sample k for any k: wraps around in a closed plan; past the end of an open one it is the last
 * pose with v = omega = 0. Pure; constant cost. */
/*@ requires checked: 1 <= plan->count <= BERTH_PLAN_COUNT_MAX; */
berth_sample_t berth_plan_sample(const berth_plan_t *plan, uint32_t k);

/* Puts sample 0 at now_us (0 to BERTH_TIME_MAX_US). */
/*@ requires checked: 1 <= plan->count <= BERTH_PLAN_COUNT_MAX;
  @ requires checked: BERTH_PERIOD_MIN_US <= plan->period_us <= BERTH_PERIOD_MAX_US;
  @ requires time: 0 <= now_us <= BERTH_TIME_MAX_US; */
void berth_reference_start(berth_reference_t *reference, const berth_plan_t *plan, int64_t now_us);

/* Moves to the sample nearest in time to now_us: a step that is early or late by less than half a
 * period keeps its own sample, a later one skips samples, counts them, and never replays them.
 * now_us: 0 to BERTH_TIME_MAX_US; time that goes backwards leaves the index where it is. Constant
 * cost. */
/*@ requires checked: 1 <= plan->count <= BERTH_PLAN_COUNT_MAX;
  @ requires checked: BERTH_PERIOD_MIN_US <= plan->period_us <= BERTH_PERIOD_MAX_US;
  @ requires time: 0 <= now_us <= BERTH_TIME_MAX_US; */
void berth_reference_advance(berth_reference_t *reference, const berth_plan_t *plan,
                             int64_t now_us);

#ifdef __cplusplus
}
#endif

#endif
