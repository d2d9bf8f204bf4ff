/* Drives a straight line of 1 m with a simulated robot and says where it ended. */
#include <berth/berth.h>

#include <stdio.h>

#define SAMPLES 40
#define PERIOD_US 50000

static const berth_mpc_t weights = {{10.0f, 40.0f, 1.0f}, {0.5f, 0.1f}, 20, 0};

int main(void) {
    static berth_sample_t samples[SAMPLES];
    for (int k = 0; k < SAMPLES; k++) {
        samples[k].x_m = 0.025f * (float)k;
        samples[k].v_mps = 0.5f;
    }
    berth_plan_t plan = {samples, NULL, SAMPLES, PERIOD_US, weights, false, BERTH_GAIN_ONLINE};
    berth_config_t config = berth_config_default(0.05f, 0.3f);
    static berth_controller_t controller;
    berth_refusal_t refusal;
    if (berth_controller_init(&controller, &plan, &config, &refusal) != BERTH_OK ||
        berth_controller_start(&controller, 0) != BERTH_OK) {
        fprintf(stderr, "refused: %s\n", berth_field_text(refusal.field));
        return 1;
    }
    berth_pose_t pose = {0.0f, 0.1f, 0.0f};
    for (int step = 0; step < SAMPLES + 20; step++) {
        berth_command_t command;
        float sine, cosine;
        if (berth_controller_step(&controller, (int64_t)step * PERIOD_US, &pose, &command) !=
            BERTH_OK) {
            return 1;
        }
        berth_sincos(pose.theta_rad, &sine, &cosine);
        pose.x_m += 0.05f * command.twist.v_mps * cosine;
        pose.y_m += 0.05f * command.twist.v_mps * sine;
        pose.theta_rad += 0.05f * command.twist.omega_radps;
    }
    printf("%.3f %.3f\n", (double)pose.x_m, (double)pose.y_m);
    return 0;
}
