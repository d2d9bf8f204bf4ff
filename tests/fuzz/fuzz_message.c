/* Berth's own frames: what decodes encodes to the same frame again, what is encoded from any floats
 * decodes to what it was, or is refused.
 */
#include "berth/avoid.h"
#include "berth/message.h"
#include "berth/supervisor.h"
#include "fuzz.h"
#include "input.h"

#define ADDRESS 9

static bool same_data(const berth_can_frame_t *a, const berth_can_frame_t *b) {
    return a->length == b->length && memcmp(a->data, b->data, a->length) == 0;
}

static void decode(const berth_can_frame_t *frame) {
    berth_can_frame_t again = {0};
    berth_command_code_t command;
    berth_message_obstacle_t obstacle;
    berth_message_status_t status;
    berth_message_error_t error;
    berth_pose_t pose;
    if (berth_message_decode_command(frame, &command)) {
        berth_message_encode_command(&again, ADDRESS, command);
        FUZZ_CHECK(same_data(frame, &again), "a command survives");
    }
    if (berth_message_decode_obstacle(frame, &obstacle)) {
        berth_message_encode_obstacle(&again, ADDRESS, &obstacle);
        FUZZ_CHECK(same_data(frame, &again), "an obstacle survives");
    }
    if (berth_message_decode_pose(frame, &pose)) {
        berth_message_encode_pose(&again, BERTH_MESSAGE_POSE, ADDRESS, &pose);
        FUZZ_CHECK(memcmp(frame->data, again.data, 6) == 0, "a position survives");
        FUZZ_CHECK(fabsf(pose.theta_rad) <= 3.14161f, "a heading is within half a turn");
    }
    if (berth_message_decode_status(frame, &status)) {
        FUZZ_CHECK(isfinite(status.clearance_m) &&
                       status.state <= (uint8_t)BERTH_SUPERVISOR_FAULT &&
                       status.mode <= (uint8_t)BERTH_MODE_BLOCKED,
                   "a status is in range");
    }
    if (berth_message_decode_error(frame, &error)) {
        const float values[] = {error.error.e1_m, error.error.e2_m, error.error.e3_rad,
                                error.v_mps};
        FUZZ_CHECK(finite_all(values, 4), "a tracking error is finite");
        berth_message_encode_error(&again, ADDRESS, &error);
        FUZZ_CHECK(memcmp(frame->data, again.data, 4) == 0 &&
                       memcmp(frame->data + 6, again.data + 6, 2) == 0,
                   "a tracking error survives");
    }
}

static bool near(float a, float b, float step) {
    return fabsf(a - b) <= 0.5001f * step + 1.0e-6f * fabsf(b);
}

static void encode_pose(input_t *in) {
    const float x = in_any_float(in);
    const float y = in_any_float(in);
    const berth_pose_t pose = {x, y, in_any_float(in)};
    berth_pose_t read;
    berth_can_frame_t frame;
    berth_message_encode_pose(&frame, BERTH_MESSAGE_POSE_FIX, ADDRESS, &pose);
    FUZZ_CHECK(berth_message_is(&frame, BERTH_MESSAGE_POSE_FIX, ADDRESS), "it is what it says");
    const bool good = berth_message_decode_pose(&frame, &read);
    const bool sane = isfinite(x) && isfinite(y) && isfinite(pose.theta_rad) &&
                      fabsf(x) <= BERTH_MESSAGE_POSITION_MAX_M &&
                      fabsf(y) <= BERTH_MESSAGE_POSITION_MAX_M;
    FUZZ_CHECK(good || !sane, "a pose in range is told");
    FUZZ_CHECK(!good || (near(read.x_m, x, 1e-4f) && near(read.y_m, y, 1e-4f)),
               "a pose is told as it is, or not at all");
}

static void encode_obstacle(input_t *in) {
    berth_message_obstacle_t obstacle = {.id = in_u8(in), .ttl_ms = in_u16(in)};
    obstacle.x_m = in_any_float(in);
    obstacle.y_m = in_any_float(in);
    obstacle.radius_m = in_any_float(in);
    berth_message_obstacle_t read;
    berth_can_frame_t frame;
    berth_message_encode_obstacle(&frame, ADDRESS, &obstacle);
    if (!berth_message_decode_obstacle(&frame, &read)) {
        FUZZ_CHECK(!(fabsf(obstacle.x_m) <= BERTH_MESSAGE_OBSTACLE_MAX_M &&
                     fabsf(obstacle.y_m) <= BERTH_MESSAGE_OBSTACLE_MAX_M),
                   "an obstacle in range is told");
        return;
    }
    FUZZ_CHECK(near(read.x_m, obstacle.x_m, 0.01f) && near(read.y_m, obstacle.y_m, 0.01f) &&
                   read.id == obstacle.id && read.ttl_ms == obstacle.ttl_ms,
               "an obstacle is told as it is, or not at all");
    const bool fits = obstacle.radius_m >= 0.0f && obstacle.radius_m <= 2.55f;
    FUZZ_CHECK(fits ? near(read.radius_m, obstacle.radius_m, 0.01f)
                    : read.radius_m ==
                          (obstacle.radius_m < 0.0f && isfinite(obstacle.radius_m) ? 0.0f : 2.55f),
               "a radius that does not fit becomes the safer end");
}

static void encode_status(input_t *in) {
    berth_message_status_t status = {.state = in_u8(in), .mode = in_u8(in), .fault = in_u8(in)};
    status.total = in_u32(in);
    status.active = in_u8(in);
    const uint8_t flags = in_u8(in);
    status.finished = (flags & 1u) != 0;
    status.braking = (flags & 2u) != 0;
    status.limited = (flags & 4u) != 0;
    status.clearance_m = in_any_float(in);
    berth_message_status_t read;
    berth_can_frame_t frame;
    berth_message_encode_status(&frame, ADDRESS, &status);
    if (!berth_message_decode_status(&frame, &read)) {
        FUZZ_CHECK(status.state > (uint8_t)BERTH_SUPERVISOR_FAULT ||
                       status.mode > (uint8_t)BERTH_MODE_BLOCKED,
                   "a status in range is told");
        return;
    }
    FUZZ_CHECK(read.state == status.state && read.mode == status.mode &&
                   read.fault == status.fault && read.total == (status.total & 0xffffffu) &&
                   read.active == (status.active < 31 ? status.active : 31) &&
                   read.finished == status.finished && read.braking == status.braking &&
                   read.limited == status.limited,
               "a status is told as it is");
    FUZZ_CHECK(status.active == 0
                   ? read.clearance_m == -1.0f
                   : read.clearance_m >= 0.0f &&
                         (!isfinite(status.clearance_m) || status.clearance_m < 0.0f ||
                          read.clearance_m <= status.clearance_m + 0.0006f),
               "a clearance is not told larger than it is");
}

static void encode_error(input_t *in) {
    berth_message_error_t error;
    error.error.e1_m = in_any_float(in);
    error.error.e2_m = in_any_float(in);
    error.error.e3_rad = in_any_float(in);
    error.v_mps = in_any_float(in);
    berth_message_error_t read;
    berth_can_frame_t frame;
    berth_message_encode_error(&frame, ADDRESS, &error);
    const float values[] = {error.error.e1_m, error.error.e2_m, error.error.e3_rad, error.v_mps};
    FUZZ_CHECK(berth_message_decode_error(&frame, &read) == finite_all(values, 4),
               "finite errors are told, and no others");
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    input_t in = {data, size};
    while (in.left > 0) {
        berth_can_frame_t frame;
        switch (in_u8(&in) % 6u) {
        case 0:
            encode_pose(&in);
            break;
        case 1:
            encode_obstacle(&in);
            break;
        case 2:
            encode_status(&in);
            break;
        case 3:
            encode_error(&in);
            break;
        case 4:
            berth_message_encode_command(&frame, ADDRESS, (berth_command_code_t)in_u8(&in));
            decode(&frame);
            break;
        default:
            frame = in_frame(&in);
            frame.length = (uint8_t)(frame.length + (in_u8(&in) & 128u));
            decode(&frame);
            break;
        }
    }
    return 0;
}
