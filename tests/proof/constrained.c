/* The constrained tracker, from init on, whatever errors and references it is given. */
#include "scene.h"

static berth_plan_t plan;
static berth_constrained_t workspace;

static void step_any(void) {
    berth_reference_t reference = {.index = any_u32(), .total = any_u32()};
    berth_sample_t sample;
    berth_gain_t gain;
    berth_tracking_error_t error;
    berth_twist_t last;
    ANY_BYTES(sample);
    ANY_BYTES(gain);
    ANY_BYTES(error);
    ANY_BYTES(last);
    const berth_tracker_input_t input = {&plan,  &reference, &sample, any_bool() ? &gain : NULL,
                                         &error, last};
    (void)berth_constrained_step(&workspace, &input);
}

static void call_all(void) {
    /*@ widen_hints global:"all", HINTS; */
    while (any_bool()) {
        if (any_bool()) {
            berth_constrained_reset(&workspace);
        } else {
            step_any();
        }
    }
}

int main(void) {
    berth_limits_config_t limits;
    berth_refusal_t refusal;
    plan = any_plan();
    if (any_bool()) {
        give_gains(&plan);
    }
    ANY_BYTES(limits);
    const berth_tracker_t tracker = berth_constrained_tracker(&workspace);
    plan.mpc.horizon = Frama_C_unsigned_short_interval(1, BERTH_CONSTRAINED_HORIZON_MAX);
    if (berth_constrained_init(tracker.workspace, &plan, &limits, any_float(), &refusal) ==
        BERTH_OK) {
        call_all();
    }
    return 0;
}
