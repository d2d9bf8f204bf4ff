#include "check.h"

bool check_value(berth_field_t field, float value, float minimum, float maximum,
                 berth_refusal_t *refusal) {
    if (check_range(value, minimum, maximum)) {
        return true;
    }
    *refusal = (berth_refusal_t){field, 0, value, minimum, maximum};
    return false;
}

bool check_rules(const void *values, const check_rule_t *rules, size_t count,
                 berth_refusal_t *refusal) {
    const float *const floats = values;
    for (size_t i = 0; i < count; i++) {
        const check_rule_t *rule = &rules[i];
        const float value = floats[rule->at];
        const bool off = rule->zero_allowed && value == 0.0f;
        if (!off && !check_value((berth_field_t)rule->field, value, rule->minimum, rule->maximum,
                                 refusal)) {
            return false;
        }
    }
    return true;
}

bool check_vector(berth_field_t field, const float *values, uint32_t count, float minimum,
                  float maximum, berth_refusal_t *refusal) {
    for (uint32_t i = 0; i < count; i++) {
        if (!check_value(field, values[i], minimum, maximum, refusal)) {
            refusal->index = i;
            return false;
        }
    }
    return true;
}
