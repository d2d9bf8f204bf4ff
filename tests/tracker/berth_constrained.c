/* Solves tracking problems with the constrained tracker, one to a line, for test_constrained.py.
 *
 * A line: N T track rim q1 q2 q3 r1 r2 e1 e2 e3 change last_v last_omega, then v and omega of each
 * stage. Answer: passes stopped limited v omega, then the iterate after each pass from the first,
 * N pairs u1 u2 each (none where no limit acts). */
#include "berth/berth.h"

#include <stdio.h>
#include <stdlib.h>

static berth_constrained_t workspace;
static berth_sample_t samples[BERTH_CONSTRAINED_HORIZON_MAX];

static float number(void) {
    float value = 0.0f;
    if (scanf("%f", &value) != 1) {
        fprintf(stderr, "berth-constrained: a number is missing\n");
        exit(2);
    }
    return value;
}

static void numbers(float *out, int count) {
    for (int i = 0; i < count; i++) {
        out[i] = number();
    }
}

static void require(berth_error_t error, const berth_refusal_t *refusal) {
    if (error != BERTH_OK) {
        fprintf(stderr, "berth-constrained: %s: %s is %g, allowed %g to %g\n",
                berth_error_text(error), berth_field_text(refusal->field), (double)refusal->value,
                (double)refusal->minimum, (double)refusal->maximum);
        exit(1);
    }
}

static void answer(const berth_plan_t *plan, const berth_limits_config_t *limits, float change,
                   const berth_tracker_input_t *input) {
    berth_refusal_t refusal = {BERTH_FIELD_NONE, 0, 0.0f, 0.0f, 0.0f};
    require(berth_plan_check(plan, &refusal), &refusal);
    require(berth_limits_check(limits, &refusal), &refusal);
    require(berth_constrained_init(&workspace, plan, limits, change, &refusal), &refusal);
    const berth_twist_t twist = berth_constrained_step(&workspace, input);
    const int passes = workspace.passes;
    printf("%d %d %d %.9g %.9g", passes, workspace.stopped, workspace.limited, (double)twist.v_mps,
           (double)twist.omega_radps);
    for (int pass = 1; workspace.limited && pass <= passes; pass++) {
        require(berth_constrained_init(&workspace, plan, limits, change, &refusal), &refusal);
        workspace.passes_max = (uint8_t)pass;
        (void)berth_constrained_step(&workspace, input);
        for (int i = 0; i < workspace.horizon; i++) {
            const berth_constrained_stage_t *stage = &workspace.stages[i];
            printf(" %.9g %.9g", (double)(stage->u[0] * workspace.frequency_hz),
                   (double)(stage->u[1] * workspace.frequency_hz));
        }
    }
    printf("\n");
}

int main(void) {
    int horizon;
    while (scanf("%d", &horizon) == 1) {
        if (horizon < 1 || horizon > BERTH_CONSTRAINED_HORIZON_MAX) {
            fprintf(stderr, "berth-constrained: horizon %d\n", horizon);
            return 2;
        }
        const float period_s = number();
        const float track_m = number();
        const float rim_mps = number();
        berth_plan_t plan = {.samples = samples,
                             .count = (uint32_t)horizon,
                             .period_us = (uint32_t)(period_s * 1.0e6f + 0.5f),
                             .gain_source = BERTH_GAIN_ONLINE};
        float rest[6];
        numbers(plan.mpc.q, 3);
        numbers(plan.mpc.r, 2);
        numbers(rest, 6);
        plan.mpc.horizon = (uint16_t)horizon;
        for (int i = 0; i < horizon; i++) {
            samples[i] = (berth_sample_t){0.0f, 0.0f, 0.0f, number(), number()};
        }
        const berth_limits_config_t limits = {.wheel_radius_m = 1.0f,
                                              .track_m = track_m,
                                              .v_max_mps = 100.0f,
                                              .omega_max_radps = 100.0f,
                                              .wheel_speed_max_radps = rim_mps};
        const berth_tracking_error_t error = {rest[0], rest[1], rest[2]};
        berth_reference_t reference = {0};
        const berth_tracker_input_t input = {.plan = &plan,
                                             .reference = &reference,
                                             .sample = &samples[0],
                                             .error = &error,
                                             .last = {rest[4], rest[5]}};
        answer(&plan, &limits, rest[3], &input);
    }
    return 0;
}
