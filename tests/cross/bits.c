/* Prints a digest of the bits that each part of the firmware computes from a fixed stream of
 * inputs. Every build, on every target, must print the same lines. */
#include "berth/berth.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define SAMPLES 400
#define HORIZON 20

static uint32_t stream = 2463534242u;

static uint32_t next_word(void) {
    stream ^= stream << 13;
    stream ^= stream >> 17;
    stream ^= stream << 5;
    return stream;
}

/* Uniform in [-1, 1), exact in float32. */
static float next_unit(void) {
    return (float)(int32_t)(next_word() >> 8) * (1.0f / 8388608.0f) - 1.0f;
}

/* Any finite float, of any magnitude. */
static float next_finite(void) {
    float value;
    uint32_t word;
    do {
        word = next_word();
    } while ((word & 0x7f800000u) == 0x7f800000u);
    memcpy(&value, &word, sizeof value);
    return value;
}

/* FNV-1a over the bytes of the floats. */
static uint64_t digest(uint64_t sum, const float *values, size_t count) {
    for (size_t i = 0; i < count; i++) {
        uint32_t word;
        memcpy(&word, &values[i], sizeof word);
        for (int byte = 0; byte < 4; byte++) {
            sum = (sum ^ (word & 0xffu)) * UINT64_C(1099511628211);
            word >>= 8;
        }
    }
    return sum;
}

static const uint64_t digest_start = UINT64_C(14695981039346656037);

static void report(const char *name, uint64_t sum) {
    printf("%s %016" PRIx64 "\n", name, sum);
}

static void angles(void) {
    uint64_t sum = digest_start;
    for (int i = 0; i < 300000; i++) {
        float wild = next_finite();
        float tame = 4.0f * next_unit();
        float out[6];
        out[0] = berth_wrap(wild);
        berth_sincos(wild, &out[1], &out[2]);
        out[3] = berth_atan2(tame, next_unit());
        out[4] = berth_asin(next_unit());
        out[5] = berth_wrap(tame);
        sum = digest(sum, out, 6);
    }
    report("angle", sum);
}

static berth_sample_t samples[SAMPLES];
static berth_gain_t gains[SAMPLES];

static berth_plan_t make_plan(uint8_t discretization) {
    float theta = 0.0f, x = 0.0f, y = 0.0f;
    for (uint32_t k = 0; k < SAMPLES; k++) {
        float v = 0.3f + 0.2f * next_unit(), omega = next_unit(), sine, cosine;
        samples[k] = (berth_sample_t){x, y, theta, v, omega};
        berth_sincos(theta, &sine, &cosine);
        x += 0.05f * v * cosine;
        y += 0.05f * v * sine;
        theta = berth_wrap(theta + 0.05f * omega);
    }
    return (berth_plan_t){.samples = samples,
                          .gains = gains,
                          .count = SAMPLES,
                          .period_us = 50000,
                          .mpc = {{10.0f, 40.0f, 1.0f}, {0.5f, 0.1f}, HORIZON, discretization},
                          .gain_source = BERTH_GAIN_TABLE};
}

static void fill_gains(const char *name, const berth_plan_t *plan) {
    uint64_t sum = digest_start;
    for (uint32_t k = 0; k < SAMPLES; k++) {
        berth_riccati_gain(plan, k, &gains[k]);
        sum = digest(sum, &gains[k].k[0][0], 6);
    }
    report(name, sum);
}

static void require(berth_error_t error) {
    if (error != BERTH_OK) {
        fprintf(stderr, "bits: %s\n", berth_error_text(error));
        exit(1);
    }
}

static void place_obstacles(berth_controller_t *controller) {
    for (uint32_t i = 1; i <= 5; i++) {
        const berth_sample_t *at = &samples[i * 60];
        float hard = 0.1f + 0.02f * (float)i;
        berth_obstacle_t obstacle = {at->x_m + 0.1f * next_unit(), at->y_m + 0.1f * next_unit(),
                                     hard, hard + 0.25f, hard + 0.5f};
        berth_refusal_t refusal;
        require(berth_controller_add_obstacle(controller, &obstacle, &refusal));
    }
}

/* One Euler step of a robot that obeys. */
static void move(berth_pose_t *pose, const berth_twist_t *twist) {
    float sine, cosine;
    berth_sincos(pose->theta_rad, &sine, &cosine);
    pose->x_m += 0.05f * twist->v_mps * cosine;
    pose->y_m += 0.05f * twist->v_mps * sine;
    pose->theta_rad += 0.05f * twist->omega_radps;
}

static void closed_loop(const berth_plan_t *plan) {
    static berth_controller_t controller;
    berth_config_t config = berth_config_default(0.05f, 0.3f);
    config.limits.a_max_mps2 = 2.0f;
    config.avoid.a_brake_mps2 = 2.0f;
    berth_refusal_t refusal;
    require(berth_controller_init(&controller, plan, &config, &refusal));
    place_obstacles(&controller);
    require(berth_controller_start(&controller, 0));

    uint64_t sum = digest_start;
    berth_pose_t pose = {0.1f, -0.1f, 0.4f};
    int modes = 0;
    for (int64_t step = 0; step < SAMPLES + 40; step++) {
        berth_command_t command;
        if (step % 40 == 10) { /* one that appears ahead, and goes again */
            const berth_sample_t *ahead = &samples[(step + 10) % SAMPLES];
            const berth_obstacle_t obstacle = {ahead->x_m, ahead->y_m, 0.05f, 0.3f, 0.5f};
            require(berth_controller_put_obstacle(&controller, (uint16_t)(step % 3), &obstacle,
                                                  (step + 30) * 50000, &refusal));
        }
        require(berth_controller_step(&controller, step * 50000, &pose, &command));
        move(&pose, &command.twist);
        float out[] = {pose.x_m, pose.y_m, pose.theta_rad, command.wheels.left_radps,
                       command.wheels.right_radps};
        sum = digest(sum, out, sizeof out / sizeof *out);
        modes |= 1 << berth_controller_status(&controller)->mode;
    }
    /* Tracking and avoidance must both have been exercised. */
    printf("modes %d\n", modes);
    report("closed_loop", sum);
}

/* The constrained tracker through kicks, its iterates included. */
static void constrained(const berth_plan_t *plan) {
    static berth_constrained_t workspace;
    berth_limits_config_t limits = berth_config_default(0.05f, 0.3f).limits;
    berth_refusal_t refusal;
    berth_plan_t online = *plan;
    online.gains = NULL;
    online.gain_source = BERTH_GAIN_ONLINE;
    limits.wheel_speed_max_radps = 9.0f;
    require(berth_constrained_init(&workspace, &online, &limits, 3.0f, &refusal));
    uint64_t sum = digest_start;
    berth_twist_t twist = {0.0f, 0.0f};
    int passes = 0;
    for (uint32_t k = 0; k < 2000; k++) {
        const berth_reference_t reference = {.index = k % SAMPLES, .total = k};
        const berth_sample_t sample = berth_plan_sample(&online, reference.index);
        const float size = k % 3 == 0 ? 1.0f : 0.1f;
        const berth_tracking_error_t error = {size * next_unit(), size * next_unit(),
                                              size * next_unit()};
        const berth_tracker_input_t input = {&online, &reference, &sample, NULL, &error, twist};
        twist = berth_constrained_step(&workspace, &input);
        passes |= 1 << workspace.passes;
        const float out[] = {twist.v_mps, twist.omega_radps, workspace.stages[7].u[0],
                             workspace.stages[7].u[1]};
        sum = digest(sum, out, sizeof out / sizeof *out);
    }
    printf("passes %x\n", (unsigned)passes);
    report("constrained", sum);
}

/* Wheel travel and fixes in; poses out. */
static void odometry(void) {
    static berth_odometry_t odometry;
    const berth_odometry_config_t config = {0.05f, 0.3f, 0.2f, 0.5f, 0.5f};
    const berth_pose_t start = {100.0f, -100.0f, 1.0f};
    berth_refusal_t refusal;
    require(berth_odometry_init(&odometry, &config, &refusal));
    require(berth_odometry_set(&odometry, &start, 0));
    uint64_t sum = digest_start;
    for (int i = 0; i < 100000; i++) {
        const float wide = i % 100 == 0 ? 100.0f : 1.0f;
        const float left = wide * next_unit();
        const float right = wide * next_unit();
        berth_odometry_advance(&odometry, left, right);
        if (i % 10 == 0) {
            const berth_pose_t fix = {odometry.pose.x_m + next_unit(),
                                      odometry.pose.y_m + next_unit(), 5.0f * next_unit()};
            require(berth_odometry_fix(&odometry, &fix, i));
        }
        const float out[] = {odometry.pose.x_m, odometry.pose.y_m, odometry.pose.theta_rad,
                             odometry.distance_m};
        sum = digest(sum, out, sizeof out / sizeof *out);
    }
    report("odometry", sum);
}

/* Values of any magnitude to frames, and what the frames say. */
static void messages(void) {
    uint64_t sum = digest_start;
    for (int i = 0; i < 100000; i++) {
        const float scale = i % 4 == 0 ? 0.0f : 900.0f;
        const berth_pose_t pose = {scale > 0.0f ? scale * next_unit() : next_finite(),
                                   scale * next_unit(), next_finite()};
        const berth_message_error_t error = {{40.0f * next_unit(), next_finite(), next_finite()},
                                             3.0f * next_unit()};
        const berth_message_obstacle_t obstacle = {(uint8_t)i, 400.0f * next_unit(), next_finite(),
                                                   3.0f * next_unit(), (uint16_t)i};
        berth_can_frame_t frames[3];
        float out[9] = {0.0f};
        berth_message_encode_pose(&frames[0], BERTH_MESSAGE_POSE, 1, &pose);
        berth_message_encode_error(&frames[1], 1, &error);
        berth_message_encode_obstacle(&frames[2], 1, &obstacle);
        for (int f = 0; f < 3; f++) {
            memcpy(&out[2 * f], frames[f].data, sizeof frames[f].data);
        }
        berth_pose_t back;
        if (berth_message_decode_pose(&frames[0], &back)) {
            out[6] = back.x_m;
            out[7] = back.y_m;
            out[8] = back.theta_rad;
        }
        sum = digest(sum, out, sizeof out / sizeof *out);
    }
    report("messages", sum);
}

int main(void) {
    angles();
    odometry();
    messages();
    berth_plan_t zoh = make_plan(BERTH_DISCRETIZATION_ZOH);
    fill_gains("riccati_zoh", &zoh);
    berth_plan_t plan = make_plan(BERTH_DISCRETIZATION_EULER);
    fill_gains("riccati_euler", &plan);
    closed_loop(&plan);
    constrained(&plan);
    return 0;
}
