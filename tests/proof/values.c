/* Pure functions and texts, whatever bits they are given. */
#include "scene.h"

static void angles(void) {
    float sine;
    float cosine;
    (void)berth_wrap(any_float());
    berth_sincos(any_float(), &sine, &cosine);
    (void)berth_atan2(any_float(), any_float());
    (void)berth_asin(any_float());
}

static void texts(void) {
    (void)berth_error_text(ANY_ENUM(berth_error_t));
    (void)berth_field_text(ANY_ENUM(berth_field_t));
    (void)berth_mode_text(ANY_ENUM(berth_mode_t));
    (void)berth_drive_state_text(ANY_ENUM(berth_drive_state_t));
    (void)berth_drive_fault_text(ANY_ENUM(berth_drive_fault_t));
    (void)berth_supervisor_state_text(ANY_ENUM(berth_supervisor_state_t));
    (void)berth_fault_text(any_u8());
    (void)berth_fault_side_text(any_u8());
}

static void encoding(void) {
    berth_can_frame_t frame;
    const berth_pose_t pose = any_pose();
    berth_message_obstacle_t obstacle;
    berth_message_error_t error;
    ANY_BYTES(obstacle);
    ANY_BYTES(error);
    const berth_message_status_t status = {.state = any_u8(),
                                           .mode = any_u8(),
                                           .fault = any_u8(),
                                           .total = any_u32(),
                                           .active = any_u8(),
                                           .finished = any_bool(),
                                           .braking = any_bool(),
                                           .limited = any_bool(),
                                           .clearance_m = any_float()};
    berth_message_encode_command(&frame, any_u8(), ANY_ENUM(berth_command_code_t));
    berth_message_encode_pose(&frame, any_u32(), any_u8(), &pose);
    berth_message_encode_obstacle(&frame, any_u8(), &obstacle);
    berth_message_encode_status(&frame, any_u8(), &status);
    berth_message_encode_error(&frame, any_u8(), &error);
}

static void decoding(void) {
    const berth_can_frame_t frame = any_frame();
    berth_command_code_t command;
    berth_pose_t pose;
    berth_message_obstacle_t obstacle;
    berth_message_status_t status;
    berth_message_error_t error;
    (void)berth_message_is(&frame, any_u32(), any_u8());
    (void)berth_message_decode_command(&frame, &command);
    (void)berth_message_decode_pose(&frame, &pose);
    (void)berth_message_decode_obstacle(&frame, &obstacle);
    (void)berth_message_decode_status(&frame, &status);
    (void)berth_message_decode_error(&frame, &error);
}

static void law(void) {
    const berth_pose_t pose = any_pose();
    berth_sample_t sample;
    berth_gain_t gain;
    berth_tracking_error_t error;
    berth_limits_config_t config;
    berth_limits_t limits;
    berth_refusal_t refusal;
    berth_wheels_t wheels;
    ANY_BYTES(sample);
    ANY_BYTES(gain);
    ANY_BYTES(config);
    ANY_BYTES(wheels);
    berth_tracking_error(&pose, &sample, &error);
    ANY_BYTES(error);
    berth_twist_t twist = berth_tracker_law(&sample, &gain, &error);
    (void)berth_limits_check(&config, &refusal);
    berth_limits_reset(&limits);
    ANY_BYTES(limits);
    ANY_BYTES(twist);
    (void)berth_limits_apply(&limits, &config, any_float(), any_bool(), &twist);
    (void)berth_wheels_from_twist(&config, twist);
    (void)berth_twist_from_wheels(&config, wheels);
}

static void configurations(void) {
    (void)berth_config_default(any_float(), any_float());
    (void)berth_board_config_default(any_float(), any_float(), any_u32());
}

int main(void) {
    angles();
    texts();
    encoding();
    decoding();
    law();
    configurations();
    return 0;
}
