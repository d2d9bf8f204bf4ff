/* Where what comes in is finite and in the range that validation demands, nothing that is not
 * finite arises in angles, error, law, limits while avoiding and wheels: here NaN and infinity are
 * alarms. Not shown so: sine and cosine of angles beyond 3 pi, and the scaling of commands while
 * tracking, whose quotients are at most 1 for a reason that ranges alone do not tell. */
#include "proof.h"

static float from(float least, float most) {
    return Frama_C_float_interval(least, most);
}

static void angles(void) {
    float sine;
    float cosine;
    const float any = from(-0x1.fffffep+127f, 0x1.fffffep+127f);
    (void)berth_wrap(any);
    berth_sincos(from(-3.0f * BERTH_PI, 3.0f * BERTH_PI), &sine, &cosine);
    (void)berth_asin(any);
}

static berth_twist_t track(void) {
    const berth_pose_t pose = {from(-BERTH_POSITION_MAX_M, BERTH_POSITION_MAX_M),
                               from(-BERTH_POSITION_MAX_M, BERTH_POSITION_MAX_M),
                               from(-BERTH_PI, BERTH_PI)};
    const berth_sample_t sample = {
        from(-BERTH_POSITION_MAX_M, BERTH_POSITION_MAX_M),
        from(-BERTH_POSITION_MAX_M, BERTH_POSITION_MAX_M), from(-BERTH_PI, BERTH_PI),
        from(-BERTH_SAMPLE_V_MAX_MPS, BERTH_SAMPLE_V_MAX_MPS),
        from(-BERTH_SAMPLE_OMEGA_MAX_RADPS, BERTH_SAMPLE_OMEGA_MAX_RADPS)};
    berth_gain_t gain;
    berth_tracking_error_t error;
    for (int row = 0; row < 2; row++) {
        gain.k[row][0] = from(-BERTH_GAIN_MAX, BERTH_GAIN_MAX);
        gain.k[row][1] = from(-BERTH_GAIN_MAX, BERTH_GAIN_MAX);
        gain.k[row][2] = from(-BERTH_GAIN_MAX, BERTH_GAIN_MAX);
    }
    berth_tracking_error(&pose, &sample, &error);
    return berth_tracker_law(&sample, &gain, &error);
}

static berth_limits_config_t any_limits(void) {
    return (berth_limits_config_t){
        .wheel_radius_m = from(0.001f, 10.0f),
        .track_m = from(0.01f, 10.0f),
        .v_max_mps = from(0.001f, 100.0f),
        .omega_max_radps = from(0.001f, 100.0f),
        .wheel_speed_max_radps = any_bool() ? 0.0f : from(0.001f, 10000.0f),
        .a_max_mps2 = any_bool() ? 0.0f : from(0.001f, 1000.0f),
        .alpha_max_radps2 = any_bool() ? 0.0f : from(0.001f, 1000.0f),
    };
}

/* The memory of the limits starts at zero and holds what was commanded last. */
static void limit_any(berth_twist_t command) {
    const berth_limits_config_t config = any_limits();
    berth_limits_t limits;
    berth_limits_reset(&limits);
    while (any_bool()) {
        berth_twist_t twist = command;
        (void)berth_limits_apply(&limits, &config, from(0.001f, 1.0f), true, &twist);
        const berth_wheels_t wheels = berth_wheels_from_twist(&config, twist);
        (void)berth_twist_from_wheels(&config, wheels);
    }
}

int main(void) {
    angles();
    limit_any(track());
    return 0;
}
