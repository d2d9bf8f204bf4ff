/* What works on a plan: any plan that berth_plan_check accepts, and more. */
#include "scene.h"

static berth_plan_t plan;

static void look_at_plan(void) {
    berth_refusal_t refusal;
    berth_gain_t gain;
    (void)berth_plan_check(&plan, &refusal);
    (void)berth_plan_crc(&plan);
    (void)berth_plan_sample(&plan, any_u32());
    berth_riccati_gain(&plan, any_u32(), &gain);
}

/* Headers that berth_plan_check refuses, too. */
static void check_any(void) {
    berth_plan_t any = plan;
    berth_refusal_t refusal;
    any.count = u32_from(0, ROWS);
    any.period_us = any_u32();
    any.gain_source = any_u8();
    ANY_BYTES(any.mpc);
    (void)berth_plan_check(&any, &refusal);
    any.samples = NULL;
    (void)berth_plan_check(&any, &refusal);
}

static void go_through(void) {
    berth_reference_t reference;
    berth_reference_start(&reference, &plan, any_time());
    /*@ widen_hints global:"all", HINTS; */
    while (any_bool()) {
        berth_reference_advance(&reference, &plan, any_time());
    }
}

int main(void) {
    plan = any_plan();
    if (any_bool()) {
        give_gains(&plan);
    }
    check_any();
    look_at_plan();
    go_through();
    return 0;
}
