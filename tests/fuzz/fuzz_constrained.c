/* The constrained tracker by itself: any plan that is accepted, any finite error and last command.
 * What must hold: finite commands, within the rims' limits whenever a limit acts; the same command
 * again from the same start; passes within their bound.
 */
#include "berth/constrained.h"
#include "berth/riccati.h"
#include "fuzz.h"
#include "input.h"
#include "plan_input.h"

static float finite_float(input_t *in, float low, float high) {
    const float value = in_some_float(in, low, high);
    return isfinite(value) ? value : 0.0f;
}

/* The tracker takes its inputs off the plan's speeds: that is what they are rounded to. */
static void check_twist(const berth_constrained_t *workspace, const berth_tracker_input_t *input,
                        const berth_limits_config_t *limits, berth_twist_t twist) {
    FUZZ_CHECK(isfinite(twist.v_mps) && isfinite(twist.omega_radps), "a command is finite");
    FUZZ_CHECK(workspace->passes <= BERTH_CONSTRAINED_PASSES_MAX, "passes have a bound");
    if (!workspace->limited_now) {
        return;
    }
    const double rim = (double)workspace->rim_m / (1.0e-6 * input->plan->period_us);
    const double half_track = 0.5 * (double)limits->track_m;
    const double turn = half_track * (double)twist.omega_radps;
    const double v = (double)twist.v_mps;
    const double planned =
        fabs((double)input->sample->v_mps) + half_track * fabs((double)input->sample->omega_radps);
    const double slack = 1.0e-5 * rim + 5.0e-7 * planned;
    FUZZ_CHECK(fabs(v + turn) <= rim + slack && fabs(v - turn) <= rim + slack,
               "a command is within the rims' limits");
}

/* One step twice: after what went before, and from the start. */
static void step(berth_constrained_t *workspace, const berth_plan_t *plan,
                 const berth_limits_config_t *limits, input_t *in) {
    berth_reference_t reference;
    berth_reference_start(&reference, plan, 0);
    const uint32_t k = in_u8(in) % (plan->count + 2u);
    for (uint32_t i = 0; i < k; i++) {
        berth_reference_advance(&reference, plan, (int64_t)(i + 1) * plan->period_us);
    }
    const berth_sample_t sample = berth_plan_sample(plan, reference.index);
    berth_tracking_error_t error;
    error.e1_m = finite_float(in, -2.0f, 2.0f);
    error.e2_m = finite_float(in, -2.0f, 2.0f);
    error.e3_rad = finite_float(in, -3.14159f, 3.14159f);
    berth_gain_t gain;
    berth_riccati_gain(plan, reference.index, &gain);
    berth_tracker_input_t input = {
        .plan = plan,
        .reference = &reference,
        .sample = &sample,
        .gain = (in_u8(in) & 1u) != 0 ? &gain : NULL,
        .error = &error,
    };
    input.last.v_mps = finite_float(in, -1.0f, 1.0f);
    input.last.omega_radps = finite_float(in, -3.0f, 3.0f);
    check_twist(workspace, &input, limits, berth_constrained_step(workspace, &input));
    berth_constrained_reset(workspace);
    const berth_twist_t cold = berth_constrained_step(workspace, &input);
    check_twist(workspace, &input, limits, cold);
    berth_constrained_reset(workspace);
    const berth_twist_t again = berth_constrained_step(workspace, &input);
    FUZZ_CHECK(memcmp(&cold, &again, sizeof cold) == 0, "the same start gives the same command");
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static plan_input_t plan;
    static berth_constrained_t workspace;
    input_t in = {data, size};
    berth_refusal_t refusal;
    const uint8_t flags = in_u8(&in);
    in_plan(&in, (uint8_t)(flags & ~2u), &plan);
    berth_config_t config = berth_config_default(0.05f, 0.3f);
    in_config(&in, &config);
    memset(&workspace, 0xA5, sizeof workspace);
    if (berth_plan_check(&plan.plan, &refusal) != BERTH_OK ||
        berth_limits_check(&config.limits, &refusal) != BERTH_OK ||
        berth_constrained_init(&workspace, &plan.plan, &config.limits,
                               config.tracker.rim_change_max_mps2, &refusal) != BERTH_OK) {
        return 0;
    }
    for (int i = 0; in.left > 0 && i < 64; i++) {
        step(&workspace, &plan.plan, &config.limits, &in);
    }
    return 0;
}
