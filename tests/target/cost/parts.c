/* Gains, codecs, and memory. */
#include "cost.h"
#include "counter.h"

#include "berth/board.h"

#include <stdio.h>

static support_plan_t shape;

static void print_gain(const char *form, uint16_t horizon) {
    uint32_t most = 0;
    for (uint32_t k = 0; k < shape.plan.count; k += 13) {
        berth_gain_t gain;
        const uint32_t start = counter_now();
        berth_riccati_gain(&shape.plan, k, &gain);
        const uint32_t instructions = counter_since(start);
        most = instructions > most ? instructions : most;
    }
    char name[32];
    snprintf(name, sizeof name, "gain.%s.%u", form, (unsigned)horizon);
    cost_print(name, most);
}

void cost_gain(void) {
    static const uint16_t horizons[] = {10, 20, 40};
    support_plan(&shape, SUPPORT_EIGHT, 838, true);
    for (int form = 0; form < 2; form++) {
        shape.plan.mpc.discretization =
            (uint8_t)(form == 0 ? BERTH_DISCRETIZATION_EULER : BERTH_DISCRETIZATION_ZOH);
        for (int i = 0; i < 3; i++) {
            shape.plan.mpc.horizon = horizons[i];
            print_gain(form == 0 ? "euler" : "zoh", horizons[i]);
        }
    }
}

/* Counts one expression. */
#define COUNT(name, work)                                                                          \
    do {                                                                                           \
        const uint32_t start = counter_now();                                                      \
        work;                                                                                      \
        cost_print(name, counter_since(start));                                                    \
    } while (0)

void cost_messages(void) {
    berth_can_frame_t frame;
    berth_pose_t pose = {1.25f, -3.5f, 0.7f};
    berth_message_obstacle_t obstacle = {3, 1.0f, 2.0f, 0.3f, 500};
    berth_message_status_t status = {.state = 3, .active = 2, .clearance_m = 0.25f};
    const berth_message_error_t error = {{0.01f, -0.02f, 0.03f}, 0.4f};
    berth_command_code_t code;
    bool good = true;
    COUNT("message.encode.pose",
          berth_message_encode_pose(&frame, BERTH_MESSAGE_POSE_FIX, 1, &pose));
    COUNT("message.decode.pose", good &= berth_message_decode_pose(&frame, &pose));
    COUNT("message.encode.status", berth_message_encode_status(&frame, 1, &status));
    COUNT("message.encode.error", berth_message_encode_error(&frame, 1, &error));
    berth_message_encode_obstacle(&frame, 1, &obstacle);
    COUNT("message.decode.obstacle", good &= berth_message_decode_obstacle(&frame, &obstacle));
    berth_message_encode_command(&frame, 1, BERTH_COMMAND_STOP);
    COUNT("message.decode.command", good &= berth_message_decode_command(&frame, &code));
    if (!good) {
        cost_fail("a frame was refused");
    }
    berth_odometry_t odometry;
    const berth_odometry_config_t config = {0.05f, 0.3f, 0.2f, 0.5f, 0.5f};
    berth_refusal_t refusal;
    cost_require(berth_odometry_init(&odometry, &config, &refusal), "odometry");
    cost_require(berth_odometry_set(&odometry, &pose, 0), "pose");
    static cost_series_t advance;
    for (int i = 0; i < 400; i++) {
        const float left = 0.01f * (float)(i % 20), right = 0.013f * (float)(i % 17);
        const uint32_t start = counter_now();
        berth_odometry_advance(&odometry, left, right);
        cost_add(&advance, counter_since(start));
    }
    cost_print_series("odometry", &advance);
}

void cost_memory(void) {
    cost_print("ram.controller", sizeof(berth_controller_t));
    cost_print("ram.slot", sizeof(berth_obstacle_slot_t));
    cost_print("ram.obstacles_max", BERTH_OBSTACLES_MAX);
    cost_print("ram.constrained", sizeof(berth_constrained_t));
    cost_print("ram.board", sizeof(berth_board_t));
    cost_print("ram.drive", sizeof(berth_drive_t));
    cost_print("ram.outbox", sizeof(berth_outbox_t));
    cost_print("ram.odometry", sizeof(berth_odometry_t));
    cost_print("ram.supervisor", sizeof(berth_supervisor_t));
    cost_print("ram.link", sizeof(berth_link_t));
    cost_print("plan.sample", sizeof(berth_sample_t) + sizeof(berth_gain_t));
}
