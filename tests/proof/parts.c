/* Odometry, supervisor and outbox on their own, in any order of calls. */
#include "scene.h"

static berth_odometry_t odometry;
static berth_supervisor_t supervisor;
static berth_outbox_t outbox;

static void move(void) {
    const berth_pose_t pose = any_pose();
    berth_odometry_advance(&odometry, any_float(), any_float());
    (void)berth_odometry_set(&odometry, &pose, any_i64());
    (void)berth_odometry_fix(&odometry, &pose, any_i64());
    (void)berth_odometry_fix_age_us(&odometry, any_i64());
}

static void supervise_any(void) {
    const berth_supervisor_inputs_t inputs = {.drives_enabled = any_bool(),
                                              .standing = any_bool(),
                                              .pose_known = any_bool(),
                                              .fix_age_us = any_i64(),
                                              .late_us = any_i64(),
                                              .transmit_wait_us = any_i64(),
                                              .following_radps = any_float(),
                                              .problem = any_u8()};
    if (any_bool()) {
        berth_supervisor_command(&supervisor, ANY_ENUM(berth_command_code_t), any_bool(),
                                 any_time());
    }
    if (any_bool()) {
        berth_supervisor_fail(&supervisor, any_u8(), any_time());
    }
    (void)berth_supervisor_step(&supervisor, &inputs, any_time());
}

static void queue(void) {
    const berth_can_frame_t frame = any_frame();
    if (any_bool()) {
        (void)berth_outbox_put(&outbox, &frame, ANY_ENUM(berth_outbox_policy_t));
    }
    const berth_can_frame_t *front = berth_outbox_front(&outbox);
    if (front != NULL && front->length > 0) {
        berth_outbox_pop(&outbox);
    }
    if (any_bool()) {
        berth_outbox_clear(&outbox);
        berth_outbox_pop(&outbox);
    }
}

static void call_all(void) {
    /*@ widen_hints global:"all", HINTS; */
    while (any_bool()) {
        move();
        supervise_any();
        queue();
    }
}

int main(void) {
    berth_odometry_config_t odometry_config;
    berth_supervisor_config_t supervisor_config;
    berth_refusal_t refusal;
    ANY_BYTES(odometry_config);
    ANY_BYTES(supervisor_config);
    berth_outbox_reset(&outbox);
    if (berth_odometry_init(&odometry, &odometry_config, &refusal) == BERTH_OK &&
        berth_supervisor_init(&supervisor, &supervisor_config, &refusal) == BERTH_OK) {
        call_all();
    }
    return 0;
}
