/* Prints a digest of the bits that each part of the firmware computes from a fixed stream of
 * inputs, and how many control steps each mode took. Every build, on every target, must print the
 * same lines. It fits into 16 KiB of RAM. */
#include "berth/berth.h"
#include "berth/drive_cia402.h"
#include "berth/drive_odrive.h"
#include "berth/drive_vesc.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define SAMPLES 120
#define HORIZON 20
#define STEPS 12000
#define PERIOD_US 50000
#define MODES 5

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

/* In a loop, because the order in which a call's arguments are computed is the compiler's. */
static void draw(float *values, size_t count) {
    for (size_t i = 0; i < count; i++) {
        values[i] = next_unit();
    }
}

/* FNV-1a. */
static uint64_t sum;

static void take_byte(uint32_t byte) {
    sum = (sum ^ (byte & 0xffu)) * UINT64_C(1099511628211);
}

static void take_word(uint32_t word) {
    for (int byte = 0; byte < 4; byte++) {
        take_byte(word);
        word >>= 8;
    }
}

static void take(const float *values, size_t count) {
    for (size_t i = 0; i < count; i++) {
        uint32_t word;
        memcpy(&word, &values[i], sizeof word);
        take_word(word);
    }
}

static void take_frame(const berth_can_frame_t *frame) {
    take_word(frame->id);
    take_byte(frame->extended);
    take_byte(frame->length);
    for (int i = 0; i < frame->length; i++) {
        take_byte(frame->data[i]);
    }
}

static void begin(void) {
    sum = UINT64_C(14695981039346656037);
}

static void report(const char *name) {
    printf("%s %08lx%08lx\n", name, (unsigned long)(sum >> 32), (unsigned long)(sum & 0xffffffffu));
}

static void require(berth_error_t error) {
    if (error != BERTH_OK) {
        printf("bits: %s\n", berth_error_text(error));
        exit(1);
    }
}

/* ---- Angles ---- */

static void angles(void) {
    begin();
    for (int i = 0; i < 30000; i++) {
        float wild = next_finite();
        float wilder = next_finite();
        float tame = 4.0f * next_unit();
        float out[10];
        out[0] = berth_wrap(wild);
        berth_sincos(wild, &out[1], &out[2]);
        out[3] = berth_atan2(tame, next_unit());
        out[4] = berth_asin(next_unit());
        out[5] = berth_wrap(tame);
        berth_sincos(tame, &out[6], &out[7]);
        out[8] = berth_atan2(wild, wilder);
        out[9] = berth_wrap(1000.0f * tame);
        take(out, 10);
    }
    report("angle");
    /* The whole circle in even steps. */
    begin();
    for (int i = -2048; i <= 2048; i++) {
        float angle = (float)i * (BERTH_PI / 2048.0f);
        float out[4];
        berth_sincos(angle, &out[0], &out[1]);
        out[2] = berth_atan2(out[0], out[1]);
        out[3] = berth_asin(out[0]);
        take(out, 4);
    }
    report("circle");
}

/* ---- Plan and gains ---- */

static berth_sample_t samples[SAMPLES];
static berth_gain_t gains[SAMPLES];
static berth_plan_t plan;

/* Wanders about, and is pulled back to the middle. */
static void make_plan(uint8_t discretization, bool closed) {
    float theta = 0.0f, x = 0.0f, y = 0.0f;
    for (uint32_t k = 0; k < SAMPLES; k++) {
        float v = 0.3f + 0.2f * next_unit(), omega = 0.8f + next_unit(), sine, cosine;
        samples[k] = (berth_sample_t){x, y, theta, v, omega};
        berth_sincos(theta, &sine, &cosine);
        x += 0.05f * v * cosine;
        y += 0.05f * v * sine;
        theta = berth_wrap(theta + 0.05f * omega);
    }
    plan = (berth_plan_t){.samples = samples,
                          .gains = gains,
                          .count = SAMPLES,
                          .period_us = PERIOD_US,
                          .mpc = {{10.0f, 40.0f, 1.0f}, {0.5f, 0.1f}, HORIZON, discretization},
                          .closed = closed,
                          .gain_source = BERTH_GAIN_TABLE};
}

static void fill_gains(const char *name) {
    begin();
    for (uint32_t k = 0; k < SAMPLES; k++) {
        berth_riccati_gain(&plan, k, &gains[k]);
        take(&gains[k].k[0][0], 6);
    }
    take_word(berth_plan_crc(&plan));
    report(name);
}

/* ---- Closed loop ---- */

/* One Euler step of a robot that obeys. */
static void move(berth_pose_t *pose, const berth_twist_t *twist) {
    float sine, cosine;
    berth_sincos(pose->theta_rad, &sine, &cosine);
    pose->x_m += 0.05f * twist->v_mps * cosine;
    pose->y_m += 0.05f * twist->v_mps * sine;
    pose->theta_rad += 0.05f * twist->omega_radps;
}

/* Of one part at a time. */
static union {
    berth_controller_t controller;
    berth_constrained_t constrained;
    struct {
        berth_drive_t drive;
        berth_outbox_t outbox;
    } bus;
} state;

static void put(uint16_t id, float x_m, float y_m, int64_t until_us) {
    float hard = 0.06f + 0.02f * (float)(id % 4u);
    berth_obstacle_t obstacle = {x_m, y_m, hard, hard + 0.25f, hard + 0.5f};
    berth_refusal_t refusal;
    require(berth_controller_put_obstacle(&state.controller, id, &obstacle, until_us, &refusal));
}

/* Now and then obstacles appear for a while: by the path, or all around the robot. */
static void change_obstacles(int64_t step, const berth_pose_t *pose) {
    const int64_t now_us = step * PERIOD_US;
    if (step % 40 == 0) {
        const berth_sample_t *at = &samples[next_word() % SAMPLES];
        float off[2];
        draw(off, 2);
        put((uint16_t)(step / 40 % 5), at->x_m + 0.15f * off[0], at->y_m + 0.15f * off[1],
            now_us + 120 * PERIOD_US);
    }
    if (step % 600 == 300) {
        for (uint16_t i = 0; i < 5; i++) {
            float sine, cosine;
            berth_sincos(1.2566f * (float)i + next_unit(), &sine, &cosine);
            put((uint16_t)(10u + i), pose->x_m + 0.3f * cosine, pose->y_m + 0.3f * sine,
                now_us + 25 * PERIOD_US);
        }
    }
}

/* A fifth of the time something kicks the robot, or the wish of the plan is far away. */
static void disturb(int64_t step, berth_pose_t *pose) {
    if (step % 251 == 0) {
        pose->x_m += 0.3f * next_unit();
        pose->y_m += 0.3f * next_unit();
        pose->theta_rad += next_unit();
    }
    pose->x_m += 0.002f * next_unit();
    pose->y_m += 0.002f * next_unit();
}

static void closed_loop(const char *name, bool limited) {
    berth_config_t config = berth_config_default(0.05f, 0.3f);
    if (limited) {
        config.limits.a_max_mps2 = 2.0f;
        config.limits.wheel_speed_max_radps = 14.0f;
        config.avoid.a_brake_mps2 = 2.0f;
        config.avoid.tau_s = 0.05f; /* paced */
    }
    berth_refusal_t refusal;
    require(berth_controller_init(&state.controller, &plan, &config, &refusal));
    require(berth_controller_start(&state.controller, 0));
    begin();
    berth_pose_t pose = {0.1f, -0.1f, 0.4f};
    unsigned modes[MODES] = {0};
    for (int64_t step = 0; step < STEPS / 2; step++) {
        berth_command_t command;
        change_obstacles(step, &pose);
        disturb(step, &pose);
        require(berth_controller_step(&state.controller, step * PERIOD_US, &pose, &command));
        const berth_status_t *status = berth_controller_status(&state.controller);
        const float out[] = {command.twist.v_mps,           command.twist.omega_radps,
                             command.wheels.left_radps,     command.wheels.right_radps,
                             status->tracking_error.e1_m,   status->tracking_error.e2_m,
                             status->tracking_error.e3_rad, status->clearance_m};
        take(out, sizeof out / sizeof *out);
        take_word((uint32_t)status->mode << 16 | (uint32_t)status->limited << 8 | status->active);
        modes[status->mode]++;
        move(&pose, &command.twist);
    }
    report(name);
    printf("steps");
    for (int mode = 0; mode < MODES; mode++) {
        printf(" %s=%u", berth_mode_text((berth_mode_t)mode), modes[mode]);
    }
    printf("\n");
}

/* ---- Constrained tracker ---- */

/* Through kicks, its iterates included. */
static void constrained(void) {
    berth_constrained_t *workspace = &state.constrained;
    berth_limits_config_t config = berth_config_default(0.05f, 0.3f).limits;
    berth_refusal_t refusal;
    berth_plan_t online = plan;
    online.gains = NULL;
    online.gain_source = BERTH_GAIN_ONLINE;
    config.wheel_speed_max_radps = 9.0f;
    require(berth_constrained_init(workspace, &online, &config, 3.0f, &refusal));
    begin();
    berth_twist_t twist = {0.0f, 0.0f};
    unsigned passes = 0;
    for (uint32_t k = 0; k < 2000; k++) {
        const berth_reference_t reference = {.index = k % SAMPLES, .total = k};
        const berth_sample_t sample = berth_plan_sample(&online, reference.index);
        const float size = k % 3 == 0 ? 1.0f : 0.1f;
        float r[3];
        draw(r, 3);
        const berth_tracking_error_t error = {size * r[0], size * r[1], size * r[2]};
        const berth_tracker_input_t input = {&online, &reference, &sample, NULL, &error, twist};
        twist = berth_constrained_step(workspace, &input);
        passes |= 1u << workspace->passes;
        const float out[] = {twist.v_mps, twist.omega_radps, workspace->stages[7].u[0],
                             workspace->stages[7].u[1]};
        take(out, sizeof out / sizeof *out);
    }
    printf("passes %x\n", passes);
    report("constrained");
}

/* ---- Limits, odometry, messages ---- */

static void limits(void) {
    begin();
    berth_limits_t limiter;
    berth_limits_reset(&limiter);
    for (int i = 0; i < 5000; i++) {
        float r[6];
        draw(r, 6);
        const bool some = r[0] < 0.0f;
        const bool avoids = r[1] < 0.0f;
        const berth_limits_config_t config = {
            0.1f + 0.09f * r[0], 0.5f + 0.4f * r[1], 1.0f + 0.9f * r[2], 2.5f + 2.0f * r[3],
            some ? 0.0f : 12.0f, some ? 1.5f : 0.0f, some ? 9.0f : 0.0f};
        berth_twist_t twist = {3.0f * r[4], 8.0f * r[5]};
        const uint8_t acted = berth_limits_apply(&limiter, &config, 0.05f, avoids, &twist);
        const berth_wheels_t wheels = berth_wheels_from_twist(&config, twist);
        const berth_twist_t back = berth_twist_from_wheels(&config, wheels);
        const float out[] = {twist.v_mps,        twist.omega_radps, wheels.left_radps,
                             wheels.right_radps, back.v_mps,        back.omega_radps};
        take(out, sizeof out / sizeof *out);
        take_byte(acted);
    }
    report("limits");
}

static void odometry(void) {
    static berth_odometry_t sums;
    const berth_odometry_config_t config = {0.05f, 0.3f, 0.2f, 0.5f, 0.6f};
    berth_refusal_t refusal;
    require(berth_odometry_init(&sums, &config, &refusal));
    begin();
    for (int64_t i = 0; i < 6000; i++) {
        const float size = i % 100 == 0 ? 60.0f : 0.2f;
        float travel[3];
        draw(travel, 3);
        berth_odometry_advance(&sums, size * travel[0], size * travel[1]);
        if (i % 50 == 0) {
            berth_pose_t fix = sums.pose;
            disturb(i, &fix);
            fix.theta_rad += 0.1f * next_unit();
            require(berth_odometry_fix(&sums, &fix, i * 10000));
        }
        if (i % 1000 == 999) {
            const berth_pose_t pose = {900.0f * travel[0], 900.0f * travel[1], travel[2]};
            require(berth_odometry_set(&sums, &pose, i * 10000));
        }
        const float out[] = {sums.pose.x_m, sums.pose.y_m, sums.pose.theta_rad, sums.lost_x_m,
                             sums.distance_m};
        take(out, sizeof out / sizeof *out);
    }
    take_word(sums.jumps);
    report("odometry");
}

static float next_of_any_size(float scale) {
    const uint32_t kind = next_word() % 8u;
    if (kind == 0) {
        return next_finite();
    }
    return (kind == 1 ? 100.0f : 1.0f) * scale * next_unit();
}

static void encode(berth_can_frame_t *frame, uint32_t kind, uint8_t address) {
    float r[3];
    for (int i = 0; i < 3; i++) {
        r[i] = next_of_any_size(i < 2 ? 800.0f : 3.0f);
    }
    const uint32_t word = next_word();
    const berth_pose_t pose = {r[0], r[1], r[2]};
    const berth_message_obstacle_t obstacle = {(uint8_t)word, 0.4f * r[0], 0.4f * r[1], r[2],
                                               (uint16_t)(word >> 8)};
    const berth_message_status_t status = {
        .state = (uint8_t)(word % 6u),
        .mode = (uint8_t)(word % 5u),
        .fault = (uint8_t)(word >> 3),
        .total = word,
        .active = (uint8_t)(word % 40u),
        .finished = (word & 0x100u) != 0,
        .braking = (word & 0x200u) != 0,
        .limited = (word & 0x400u) != 0,
        .clearance_m = 0.1f * r[0],
    };
    const berth_message_error_t error = {{0.04f * r[0], 0.04f * r[1], r[2]}, 0.05f * r[1]};
    switch (kind) {
    case 0:
        berth_message_encode_pose(frame, BERTH_MESSAGE_POSE_FIX, address, &pose);
        break;
    case 1:
        berth_message_encode_obstacle(frame, address, &obstacle);
        break;
    case 2:
        berth_message_encode_status(frame, address, &status);
        break;
    default:
        berth_message_encode_error(frame, address, &error);
        break;
    }
}

static void decode(const berth_can_frame_t *frame) {
    berth_pose_t pose = {0};
    berth_message_obstacle_t obstacle = {0};
    berth_message_status_t status = {0};
    berth_message_error_t error = {0};
    take_byte(berth_message_decode_pose(frame, &pose));
    take_byte(berth_message_decode_obstacle(frame, &obstacle));
    take_byte(berth_message_decode_status(frame, &status));
    take_byte(berth_message_decode_error(frame, &error));
    const float out[] = {pose.x_m,         pose.y_m,           pose.theta_rad,     obstacle.x_m,
                         obstacle.y_m,     obstacle.radius_m,  status.clearance_m, error.error.e1_m,
                         error.error.e2_m, error.error.e3_rad, error.v_mps};
    take(out, sizeof out / sizeof *out);
}

static void messages(void) {
    begin();
    for (uint32_t i = 0; i < 8000; i++) {
        berth_can_frame_t frame;
        encode(&frame, i % 4u, (uint8_t)i);
        take_frame(&frame);
        decode(&frame);
        for (int byte = 0; byte < 8; byte++) {
            frame.data[byte] = (uint8_t)next_word();
        }
        decode(&frame);
    }
    report("messages");
}

/* ---- Drives ---- */

/* Mostly one that the drive listens to. */
static berth_can_frame_t next_frame(const berth_drive_t *drive) {
    berth_can_filter_t filters[BERTH_DRIVE_FILTERS_MAX];
    const uint32_t count = berth_drive_filters(drive, filters);
    const berth_can_filter_t *filter = &filters[next_word() % count];
    berth_can_frame_t frame = {.id = filter->id, .extended = filter->extended, .length = 8};
    if (next_word() % 16u == 0) {
        frame.length = (uint8_t)(next_word() % 9u);
    }
    const float value = next_of_any_size(20.0f);
    for (int i = 0; i < 8; i++) {
        frame.data[i] = (uint8_t)next_word();
    }
    if (next_word() % 2u == 0) {
        memcpy(&frame.data[4], &value, sizeof value);
    }
    if (next_word() % 4u == 0) {
        memset(frame.data, 0, 8);
        frame.data[4] = 8;
    }
    return frame;
}

static void take_drive(berth_drive_t *drive, int64_t now_us) {
    const berth_drive_status_t *status = berth_drive_status(drive);
    const float out[] = {status->velocity_radps, berth_drive_travel(drive, now_us)};
    take(out, 2);
    take_word((uint32_t)status->state << 16 | (uint32_t)status->fault);
    take_word(status->code);
    take_word(status->received);
    take_word(status->malformed);
    take_word(status->saturated);
}

/* A CANopen drive that does as it is told, so that ours gets past its set-up. */
#define NODE 5u

static struct {
    uint8_t nmt;
    uint8_t status;
    int32_t counts;
    bool asked;
    uint8_t answer[8];
} peer;

static void peer_hear(const berth_can_frame_t *frame) {
    const uint8_t *data = frame->data;
    if (frame->id == 0) {
        peer.nmt = data[0] == 1 ? 5 : 127;
    } else if (frame->id == 0x600u + NODE) {
        const bool upload = data[0] == 0x40;
        peer.asked = true;
        memcpy(peer.answer, data, 8);
        memset(&peer.answer[4], 0, 4);
        peer.answer[0] = upload ? 0x4f : 0x60;
        peer.answer[4] = upload ? 9 : 0;
    } else if (frame->id == 0x200u + NODE) {
        peer.status = data[0] == 15 ? 0x37 : data[0] == 7 ? 0x33 : data[0] == 6 ? 0x31 : 0x40;
    }
}

static berth_can_frame_t peer_frame(uint32_t id, uint8_t length, uint8_t low, int32_t value) {
    berth_can_frame_t frame = {.id = id + NODE, .length = length, .data = {low}};
    for (int i = 0; i < 4; i++) {
        const uint8_t byte = (uint8_t)((uint32_t)value >> (8 * i));
        frame.data[id == 0x180u ? i + 2 : i] = length > 1 ? byte : low;
    }
    return frame;
}

static void peer_speak(berth_drive_t *drive, int64_t now_us) {
    berth_can_frame_t answer = {.id = 0x580u + NODE, .length = 8};
    memcpy(answer.data, peer.answer, 8);
    const int32_t speed = (int32_t)(next_word() % 4000u) - 2000;
    peer.counts = (int32_t)((uint32_t)peer.counts + (uint32_t)speed);
    const berth_can_frame_t frames[] = {peer_frame(0x700u, 1, peer.nmt, 0),
                                        peer_frame(0x180u, 6, peer.status, speed),
                                        peer_frame(0x280u, 4, 0, peer.counts), answer};
    for (size_t i = 0; i < (peer.asked ? 4u : 3u); i++) {
        take_byte(berth_drive_receive(drive, &frames[i], now_us));
    }
    peer.asked = false;
}

static void send_all(berth_outbox_t *outbox) {
    const berth_can_frame_t *frame;
    while ((frame = berth_outbox_front(outbox)) != NULL) {
        take_frame(frame);
        peer_hear(frame);
        berth_outbox_pop(outbox);
    }
}

#define RESTART 200u

/* Enabled anew now and then, whatever has come of it. */
static void restart(berth_drive_t *drive, berth_outbox_t *outbox, uint32_t cycle, int64_t now_us) {
    if (cycle % RESTART == RESTART - 10u) {
        berth_drive_stop(drive, outbox);
    }
    if (cycle % RESTART == 0) {
        berth_drive_disable(drive, outbox);
        berth_drive_reset(drive);
        berth_drive_enable(drive, now_us);
    }
}

static void drives(const char *name, const berth_drive_protocol_t *protocol) {
    berth_drive_t *drive = &state.bus.drive;
    berth_outbox_t *outbox = &state.bus.outbox;
    berth_drive_config_t config =
        berth_board_config_default(0.05f, 0.3f, PERIOD_US / 5).drives[BERTH_LEFT];
    config.protocol = protocol;
    config.node = NODE;
    config.sign = -1;
    config.gear_ratio = 7.3f;
    config.pole_pairs = 7;
    config.master_node = 100;
    config.mode = 9;
    config.has_position = true;
    config.counts_per_turn = 4096;
    config.velocity_units_per_rps = 60.0f;
    config.period_us = PERIOD_US / 5;
    berth_refusal_t refusal;
    require(berth_drive_init(drive, &config, &refusal));
    berth_outbox_reset(outbox);
    begin();
    unsigned enabled = 0;
    for (uint32_t cycle = 0; cycle < 3000; cycle++) {
        const int64_t now_us = (int64_t)cycle * (PERIOD_US / 5);
        restart(drive, outbox, cycle, now_us);
        if (protocol == &berth_drive_cia402) {
            peer_speak(drive, now_us);
        }
        /* Not while a drive is being set up that is not heard through the noise. */
        const bool noisy = protocol != &berth_drive_cia402 || cycle % RESTART > 150u;
        for (int i = 0; noisy && i < 3; i++) {
            const berth_can_frame_t frame = next_frame(drive);
            take_byte(berth_drive_receive(drive, &frame, now_us));
        }
        berth_drive_step(drive, now_us, outbox);
        berth_drive_command(drive, next_of_any_size(30.0f));
        berth_drive_cycle(drive, now_us, outbox);
        berth_drive_sync(drive, now_us, outbox);
        send_all(outbox);
        take_drive(drive, now_us);
        enabled += berth_drive_status(drive)->state == BERTH_DRIVE_ENABLED;
    }
    report(name);
    printf("enabled %u\n", enabled);
}

int main(void) {
    angles();
    make_plan(BERTH_DISCRETIZATION_ZOH, false);
    fill_gains("riccati_zoh");
    make_plan(BERTH_DISCRETIZATION_EULER, true);
    fill_gains("riccati_euler");
    closed_loop("closed_loop", false);
    closed_loop("closed_loop_limited", true);
    constrained();
    limits();
    odometry();
    messages();
    drives("odrive", &berth_drive_odrive);
    drives("vesc", &berth_drive_vesc);
    drives("cia402", &berth_drive_cia402);
    return 0;
}
