/* Range checks that fill a refusal. Private to firmware/src. */
#ifndef BERTH_SRC_CHECK_H
#define BERTH_SRC_CHECK_H

#include "berth/angle.h"
#include "berth/result.h"

/* Largest finite float32. */
#define CHECK_FLOAT_MAX 0x1.fffffep+127f

/* False for NaN too, because every comparison with NaN is false. */
static inline bool check_range(float value, float lowest, float highest) {
    return value >= lowest && value <= highest;
}

/* One float of a struct and the range that it must be in. Tables of these are constant data, which
 * takes a third of the flash that the same checks take as code. */
typedef struct {
    uint8_t field;     /* berth_field_t */
    bool zero_allowed; /* 0 switches the thing off; it need not be in the range */
    uint16_t at;       /* CHECK_AT */
    float minimum;
    float maximum;
} check_rule_t;

/* Where a float is in a struct, in floats: their alignment makes it whole. */
#define CHECK_AT(type, member) ((uint16_t)(offsetof(type, member) / sizeof(float)))

#define CHECK_COUNT(rules) (sizeof(rules) / sizeof((rules)[0]))

/* True when the value is in the range; otherwise fills *refusal (index 0). */
bool check_value(berth_field_t field, float value, float minimum, float maximum,
                 berth_refusal_t *refusal);

/* True when all rules hold for the struct; otherwise fills *refusal from the first that fails. */
bool check_rules(const void *values, const check_rule_t *rules, size_t count,
                 berth_refusal_t *refusal);

/* True when all count values are in the range; otherwise fills *refusal with the first's index. */
bool check_vector(berth_field_t field, const float *values, uint32_t count, float minimum,
                  float maximum, berth_refusal_t *refusal);

#endif
