/* Berth's own frames: what is refused, what saturates, and what is not finite. The bytes of all
 * values are compared with another implementation by codec/test_dbc.py.
 */
#include "support.h"

#include "unity.h"

#include <float.h>
#include <math.h>
#include <string.h>

#define ADDRESS 5u

static const float not_finite[] = {NAN, -NAN, INFINITY, -INFINITY};
#define NOT_FINITE_COUNT (sizeof not_finite / sizeof not_finite[0])

static berth_can_frame_t frame;

void setUp(void) {
    memset(&frame, 0x55, sizeof frame);
}

void tearDown(void) {}

static int32_t i16_at(uint32_t place) {
    return (int16_t)(uint16_t)(frame.data[place] | (frame.data[place + 1] << 8));
}

static int32_t i24_at(uint32_t place) {
    const int32_t value =
        frame.data[place] | (frame.data[place + 1] << 8) | (frame.data[place + 2] << 16);
    return value >= 0x800000 ? value - 0x1000000 : value;
}

/* One decoder behind one signature. The struct that is decoded into must stay as it was when the
 * frame is refused. */
typedef union {
    berth_command_code_t command;
    berth_pose_t pose;
    berth_message_obstacle_t obstacle;
    berth_message_status_t status;
    berth_message_error_t error;
    uint8_t bytes[64];
} any_t;

typedef enum { COMMAND, POSE, OBSTACLE, STATUS, ERROR, KINDS } kind_t;

static bool decode(kind_t kind, any_t *out) {
    switch (kind) {
    case COMMAND:
        return berth_message_decode_command(&frame, &out->command);
    case POSE:
        return berth_message_decode_pose(&frame, &out->pose);
    case OBSTACLE:
        return berth_message_decode_obstacle(&frame, &out->obstacle);
    case STATUS:
        return berth_message_decode_status(&frame, &out->status);
    case ERROR:
        return berth_message_decode_error(&frame, &out->error);
    case KINDS:
        break;
    }
    return false;
}

static void expect_refused(kind_t kind) {
    any_t out;
    any_t before;
    memset(&out, 0xa7, sizeof out);
    memset(&before, 0xa7, sizeof before);
    TEST_ASSERT_FALSE(decode(kind, &out));
    TEST_ASSERT_EQUAL_MEMORY(&before, &out, sizeof out);
}

static void expect_taken(kind_t kind) {
    any_t out;
    memset(&out, 0xa7, sizeof out);
    TEST_ASSERT_TRUE(decode(kind, &out));
}

static void encode_good(kind_t kind) {
    const berth_pose_t pose = {1.5f, -2.25f, 0.75f};
    const berth_message_obstacle_t obstacle = {7, 1.0f, -3.0f, 0.25f, 500};
    const berth_message_status_t status = {.state = 3, .mode = 1, .active = 2, .clearance_m = 0.5f};
    const berth_message_error_t error = {{0.5f, -0.25f, 0.125f}, 0.75f};
    switch (kind) {
    case COMMAND:
        berth_message_encode_command(&frame, ADDRESS, BERTH_COMMAND_START);
        break;
    case POSE:
        berth_message_encode_pose(&frame, BERTH_MESSAGE_POSE_FIX, ADDRESS, &pose);
        break;
    case OBSTACLE:
        berth_message_encode_obstacle(&frame, ADDRESS, &obstacle);
        break;
    case STATUS:
        berth_message_encode_status(&frame, ADDRESS, &status);
        break;
    case ERROR:
        berth_message_encode_error(&frame, ADDRESS, &error);
        break;
    case KINDS:
        break;
    }
}

static void test_frames_have_their_form(void) {
    static const uint32_t kinds[] = {BERTH_MESSAGE_COMMAND, BERTH_MESSAGE_POSE_FIX,
                                     BERTH_MESSAGE_OBSTACLE, BERTH_MESSAGE_STATUS,
                                     BERTH_MESSAGE_ERROR};
    for (kind_t kind = COMMAND; kind < KINDS; kind++) {
        setUp();
        encode_good(kind);
        TEST_ASSERT_TRUE(frame.extended);
        TEST_ASSERT_FALSE(frame.remote);
        TEST_ASSERT_EQUAL_INT64(0, frame.time_us);
        TEST_ASSERT_EQUAL_UINT8(kind == COMMAND ? 2 : 8, frame.length);
        TEST_ASSERT_EQUAL_HEX32((kinds[kind] << 8) | ADDRESS, frame.id);
        TEST_ASSERT_LESS_OR_EQUAL_UINT32(BERTH_CAN_EXTENDED_MAX, frame.id);
        for (uint32_t i = frame.length; i < BERTH_CAN_DATA_MAX; i++) {
            TEST_ASSERT_EQUAL_UINT8(0, frame.data[i]);
        }
        expect_taken(kind);
    }
}

static void test_wrong_lengths_and_remote_frames_are_refused(void) {
    for (kind_t kind = COMMAND; kind < KINDS; kind++) {
        encode_good(kind);
        const uint8_t good = frame.length;
        for (uint32_t length = 0; length <= 255; length++) {
            frame.length = (uint8_t)length;
            if (frame.length == good) {
                expect_taken(kind);
            } else {
                expect_refused(kind);
            }
        }
        frame.length = good;
        frame.remote = true;
        expect_refused(kind);
    }
}

static void test_kind_and_address(void) {
    encode_good(POSE);
    TEST_ASSERT_TRUE(berth_message_is(&frame, BERTH_MESSAGE_POSE_FIX, ADDRESS));
    TEST_ASSERT_FALSE(berth_message_is(&frame, BERTH_MESSAGE_POSE_FIX, ADDRESS + 1));
    TEST_ASSERT_FALSE(berth_message_is(&frame, BERTH_MESSAGE_POSE_FIX, 0));
    TEST_ASSERT_FALSE(berth_message_is(&frame, BERTH_MESSAGE_POSE, ADDRESS));
    TEST_ASSERT_FALSE(berth_message_is(&frame, BERTH_MESSAGE_COMMAND, ADDRESS));
    for (uint32_t bit = 0; bit < 32; bit++) {
        frame.id ^= UINT32_C(1) << bit;
        TEST_ASSERT_FALSE(berth_message_is(&frame, BERTH_MESSAGE_POSE_FIX, ADDRESS));
        frame.id ^= UINT32_C(1) << bit;
    }
    frame.extended = false;
    TEST_ASSERT_FALSE(berth_message_is(&frame, BERTH_MESSAGE_POSE_FIX, ADDRESS));
}

/* No single wrong bit, nor any single wrong byte, makes one command of another. */
/* A command that does not exist goes out as none, never as another one. */
static void test_commands_that_do_not_exist_are_sent_as_none(void) {
    berth_command_code_t got;
    for (int code = BERTH_COMMAND_NONE; code < 256; code++) {
        berth_message_encode_command(&frame, ADDRESS, (berth_command_code_t)code);
        TEST_ASSERT_TRUE(berth_message_decode_command(&frame, &got));
        TEST_ASSERT_EQUAL_INT(code < BERTH_COMMAND_COUNT ? code : BERTH_COMMAND_NONE, got);
    }
}

static void test_commands_with_a_wrong_byte_are_refused(void) {
    for (int code = BERTH_COMMAND_NONE; code < BERTH_COMMAND_COUNT; code++) {
        for (uint32_t place = 0; place < 2; place++) {
            for (uint32_t change = 1; change < 256; change++) {
                berth_message_encode_command(&frame, ADDRESS, (berth_command_code_t)code);
                frame.data[place] = (uint8_t)(frame.data[place] ^ change);
                expect_refused(COMMAND);
            }
        }
    }
    for (uint32_t code = BERTH_COMMAND_COUNT; code < 256; code++) {
        frame.data[0] = (uint8_t)code;
        frame.data[1] = (uint8_t)~code;
        expect_refused(COMMAND);
    }
}

static void encode_pose(float x_m, float y_m, float theta_rad) {
    const berth_pose_t pose = {x_m, y_m, theta_rad};
    berth_message_encode_pose(&frame, BERTH_MESSAGE_POSE_FIX, ADDRESS, &pose);
}

static void test_pose_that_is_not_finite_is_refused(void) {
    for (uint32_t i = 0; i < NOT_FINITE_COUNT; i++) {
        encode_pose(not_finite[i], 1.0f, 1.0f);
        TEST_ASSERT_EQUAL_INT32(-8388608, i24_at(0));
        expect_refused(POSE);
        encode_pose(1.0f, not_finite[i], 1.0f);
        TEST_ASSERT_EQUAL_INT32(-8388608, i24_at(3));
        expect_refused(POSE);
        encode_pose(1.0f, 1.0f, not_finite[i]);
        TEST_ASSERT_EQUAL_INT32(-32768, i16_at(6));
        expect_refused(POSE);
    }
}

static void test_position_beyond_the_range_is_refused(void) {
    static const float beyond[] = {838.8607f,  839.0f, 1000.0f,     1.0e6f,  4194304.0f,
                                   8388608.0f, 1.0e7f, 16777216.0f, 1.0e30f, FLT_MAX};
    for (uint32_t i = 0; i < sizeof beyond / sizeof beyond[0]; i++) {
        encode_pose(beyond[i], 0.0f, 0.0f);
        TEST_ASSERT_EQUAL_INT32(8388607, i24_at(0));
        expect_refused(POSE);
        encode_pose(0.0f, -beyond[i], 0.0f);
        TEST_ASSERT_EQUAL_INT32(-8388607, i24_at(3));
        expect_refused(POSE);
    }
    encode_pose(BERTH_MESSAGE_POSITION_MAX_M, -BERTH_MESSAGE_POSITION_MAX_M, 0.0f);
    TEST_ASSERT_EQUAL_INT32(8388606, i24_at(0));
    TEST_ASSERT_EQUAL_INT32(-8388606, i24_at(3));
    berth_pose_t pose;
    TEST_ASSERT_TRUE(berth_message_decode_pose(&frame, &pose));
    TEST_ASSERT_TRUE(support_same_bits(BERTH_MESSAGE_POSITION_MAX_M, pose.x_m));
    TEST_ASSERT_TRUE(support_same_bits(-BERTH_MESSAGE_POSITION_MAX_M, pose.y_m));
}

static void test_headings_beyond_half_a_turn_are_refused(void) {
    for (int32_t theta = INT16_MIN; theta <= INT16_MAX; theta++) {
        encode_pose(0.0f, 0.0f, 0.0f);
        frame.data[6] = (uint8_t)((uint32_t)theta & 0xffu);
        frame.data[7] = (uint8_t)(((uint32_t)theta >> 8) & 0xffu);
        if (theta >= -31416 && theta <= 31416) {
            berth_pose_t pose;
            TEST_ASSERT_TRUE(berth_message_decode_pose(&frame, &pose));
            TEST_ASSERT_TRUE(support_same_bits((float)(theta / 10000.0), pose.theta_rad));
        } else {
            expect_refused(POSE);
        }
    }
}

static void test_headings_are_wrapped(void) {
    static const struct {
        float theta_rad;
        int32_t raw;
    } cases[] = {
        {3.14159f, 31416},      {3.1415927f, -31416},  {-3.1415927f, 31416}, {4.0f, 40000 - 62832},
        {-4.0f, 62832 - 40000}, {7.0f, 70000 - 62832}, {-0.0f, 0},           {1.0e-9f, 0},
        {0.00005f, 0},          {0.000051f, 1}};
    for (uint32_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        encode_pose(0.0f, 0.0f, cases[i].theta_rad);
        TEST_ASSERT_EQUAL_INT32(cases[i].raw, i16_at(6));
        expect_taken(POSE);
    }
    encode_pose(0.0f, 0.0f, FLT_MAX); /* a finite heading, however large */
    expect_taken(POSE);
}

static void test_rounding_is_to_nearest_even(void) {
    /* k / 32 m are k * 312.5 units: halves that float32 holds exactly */
    for (int32_t k = -26000; k <= 26000; k++) {
        encode_pose((float)k / 32.0f, 0.0f, 0.0f);
        TEST_ASSERT_EQUAL_INT32((int32_t)nearbyint(k * 312.5), i24_at(0));
    }
    support_random_start();
    const uint32_t runs = support_runs(200000);
    for (uint32_t i = 0; i < runs; i++) {
        const float x = (float)support_uniform(-839.0, 839.0);
        const float y = (float)support_log_uniform(1.0e-44, 838.0);
        encode_pose(x, y, 0.0f);
        const double exact = nearbyint((double)x * 10000.0); /* 38 bits: exact in double */
        TEST_ASSERT_EQUAL_INT32((int32_t)fmax(fmin(exact, 8388607.0), -8388607.0), i24_at(0));
        TEST_ASSERT_EQUAL_INT32((int32_t)nearbyint((double)y * 10000.0), i24_at(3));
    }
}

static void encode_obstacle(float x_m, float y_m, float radius_m) {
    const berth_message_obstacle_t obstacle = {1, x_m, y_m, radius_m, 100};
    berth_message_encode_obstacle(&frame, ADDRESS, &obstacle);
}

static void test_obstacle_that_is_nowhere_is_refused(void) {
    for (uint32_t i = 0; i < NOT_FINITE_COUNT; i++) {
        encode_obstacle(not_finite[i], 0.0f, 0.1f);
        TEST_ASSERT_EQUAL_INT32(-32768, i16_at(1));
        expect_refused(OBSTACLE);
        encode_obstacle(0.0f, not_finite[i], 0.1f);
        TEST_ASSERT_EQUAL_INT32(-32768, i16_at(3));
        expect_refused(OBSTACLE);
    }
    encode_obstacle(400.0f, 0.0f, 0.1f);
    TEST_ASSERT_EQUAL_INT32(32767, i16_at(1));
    expect_refused(OBSTACLE);
    encode_obstacle(0.0f, -FLT_MAX, 0.1f);
    TEST_ASSERT_EQUAL_INT32(-32767, i16_at(3));
    expect_refused(OBSTACLE);
    encode_obstacle(BERTH_MESSAGE_OBSTACLE_MAX_M, -BERTH_MESSAGE_OBSTACLE_MAX_M, 0.1f);
    expect_taken(OBSTACLE);
}

static void test_radius_that_is_unknown_is_the_largest(void) {
    static const struct {
        float radius_m;
        uint8_t raw;
    } cases[] = {{0.0f, 0},    {-0.0f, 0},      {-1.0f, 0},      {-FLT_MAX, 0},  {0.0051f, 1},
                 {2.54f, 254}, {2.5551f, 255},  {3.0f, 255},     {FLT_MAX, 255}, {NAN, 255},
                 {-NAN, 255},  {INFINITY, 255}, {-INFINITY, 255}};
    for (uint32_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        encode_obstacle(1.0f, 1.0f, cases[i].radius_m);
        TEST_ASSERT_EQUAL_UINT8(cases[i].raw, frame.data[5]);
        expect_taken(OBSTACLE);
    }
}

static void test_obstacle_comes_back(void) {
    for (uint32_t id = 0; id < 256; id++) {
        const berth_message_obstacle_t sent = {(uint8_t)id, -1.25f, 327.5f, 0.75f,
                                               (uint16_t)(id * 257)};
        berth_message_obstacle_t got;
        berth_message_encode_obstacle(&frame, ADDRESS, &sent);
        TEST_ASSERT_TRUE(berth_message_decode_obstacle(&frame, &got));
        TEST_ASSERT_EQUAL_UINT8(sent.id, got.id);
        TEST_ASSERT_EQUAL_UINT16(sent.ttl_ms, got.ttl_ms);
        TEST_ASSERT_TRUE(support_same_bits(sent.x_m, got.x_m));
        TEST_ASSERT_TRUE(support_same_bits(sent.y_m, got.y_m));
        TEST_ASSERT_TRUE(support_same_bits(sent.radius_m, got.radius_m));
    }
}

static uint32_t encoded_clearance(uint8_t active, float clearance_m) {
    const berth_message_status_t status = {.active = active, .clearance_m = clearance_m};
    berth_message_encode_status(&frame, ADDRESS, &status);
    return (uint32_t)i16_at(6) & 0xffffu;
}

static void test_clearance(void) {
    for (uint32_t i = 0; i < NOT_FINITE_COUNT; i++) {
        TEST_ASSERT_EQUAL_UINT32(0, encoded_clearance(1, not_finite[i]));
        TEST_ASSERT_EQUAL_UINT32(65535, encoded_clearance(0, not_finite[i]));
    }
    TEST_ASSERT_EQUAL_UINT32(0, encoded_clearance(1, -0.5f)); /* a collision is no all-clear */
    TEST_ASSERT_EQUAL_UINT32(0, encoded_clearance(1, -FLT_MAX));
    TEST_ASSERT_EQUAL_UINT32(500, encoded_clearance(255, 0.5f));
    TEST_ASSERT_EQUAL_UINT32(65534, encoded_clearance(1, 65.5346f));
    TEST_ASSERT_EQUAL_UINT32(65534, encoded_clearance(1, FLT_MAX));
    TEST_ASSERT_EQUAL_UINT32(65535, encoded_clearance(0, 0.5f));
    berth_message_status_t got;
    TEST_ASSERT_TRUE(berth_message_decode_status(&frame, &got));
    TEST_ASSERT_TRUE(got.clearance_m == -1.0f);
}

static void test_status_saturates(void) {
    const berth_message_status_t sent = {.state = 5,
                                         .mode = 4,
                                         .fault = 0xa5,
                                         .total = 0xfedcba98u,
                                         .active = 200,
                                         .braking = true,
                                         .clearance_m = 0.25f};
    berth_message_status_t got;
    berth_message_encode_status(&frame, ADDRESS, &sent);
    TEST_ASSERT_TRUE(berth_message_decode_status(&frame, &got));
    TEST_ASSERT_EQUAL_UINT8(5, got.state);
    TEST_ASSERT_EQUAL_UINT8(4, got.mode);
    TEST_ASSERT_EQUAL_HEX8(0xa5, got.fault);
    TEST_ASSERT_EQUAL_HEX32(0xdcba98u, got.total);
    TEST_ASSERT_EQUAL_UINT8(31, got.active);
    TEST_ASSERT_FALSE(got.finished);
    TEST_ASSERT_TRUE(got.braking);
    TEST_ASSERT_FALSE(got.limited);
    TEST_ASSERT_TRUE(support_same_bits(0.25f, got.clearance_m));
}

static void test_each_flag_of_the_status_comes_back_alone(void) {
    for (uint32_t flags = 0; flags < 8; flags++) {
        const berth_message_status_t sent = {.active = 31,
                                             .finished = (flags & 1u) != 0,
                                             .braking = (flags & 2u) != 0,
                                             .limited = (flags & 4u) != 0};
        berth_message_status_t got;
        berth_message_encode_status(&frame, ADDRESS, &sent);
        TEST_ASSERT_TRUE(berth_message_decode_status(&frame, &got));
        TEST_ASSERT_EQUAL_INT(sent.finished, got.finished);
        TEST_ASSERT_EQUAL_INT(sent.braking, got.braking);
        TEST_ASSERT_EQUAL_INT(sent.limited, got.limited);
        TEST_ASSERT_EQUAL_UINT8(31, got.active);
    }
}

/* A state or mode that does not exist must not pass for another: 16 is not 0. */
static void test_states_and_modes_that_do_not_exist(void) {
    for (uint32_t number = 0; number < 256; number++) {
        const berth_message_status_t state = {.state = (uint8_t)number};
        const berth_message_status_t mode = {.mode = (uint8_t)number};
        berth_message_encode_status(&frame, ADDRESS, &state);
        TEST_ASSERT_EQUAL_UINT32(number < 15 ? number : 15, frame.data[0]);
        if (number <= BERTH_SUPERVISOR_FAULT) {
            expect_taken(STATUS);
        } else {
            expect_refused(STATUS);
        }
        berth_message_encode_status(&frame, ADDRESS, &mode);
        if (number <= BERTH_MODE_BLOCKED) {
            expect_taken(STATUS);
        } else {
            expect_refused(STATUS);
        }
    }
}

static void test_error_that_is_not_finite_is_refused(void) {
    for (uint32_t field = 0; field < 4; field++) {
        for (uint32_t i = 0; i < NOT_FINITE_COUNT; i++) {
            float values[4] = {0.0f, 0.0f, 0.0f, 0.0f};
            values[field] = not_finite[i];
            const berth_message_error_t error = {{values[0], values[1], values[2]}, values[3]};
            berth_message_encode_error(&frame, ADDRESS, &error);
            TEST_ASSERT_EQUAL_INT32(-32768, i16_at(2 * field));
            expect_refused(ERROR);
        }
    }
}

static void test_error_saturates(void) {
    const berth_message_error_t error = {{40.0f, -FLT_MAX, 4.0f}, -32.7671f};
    berth_message_error_t got;
    berth_message_encode_error(&frame, ADDRESS, &error);
    TEST_ASSERT_TRUE(berth_message_decode_error(&frame, &got));
    TEST_ASSERT_TRUE(support_same_bits(32.767f, got.error.e1_m));
    TEST_ASSERT_TRUE(support_same_bits(-32.767f, got.error.e2_m));
    TEST_ASSERT_TRUE(support_same_bits(-2.2832f, got.error.e3_rad));
    TEST_ASSERT_TRUE(support_same_bits(-32.767f, got.v_mps));
}

/* Whatever bytes come, what is decoded is finite and in range. */
static void test_random_bytes(void) {
    support_random_start();
    uint32_t taken[KINDS] = {0};
    const uint32_t runs = support_runs(300000);
    for (uint32_t run = 0; run < runs; run++) {
        for (uint32_t i = 0; i < BERTH_CAN_DATA_MAX; i++) {
            frame.data[i] = (uint8_t)support_index(256);
        }
        const kind_t kind = (kind_t)(run % KINDS);
        if (kind == COMMAND && support_index(2) == 0) {
            frame.data[0] = (uint8_t)support_index(2 * BERTH_COMMAND_COUNT);
            frame.data[1] = (uint8_t)~frame.data[0];
        }
        frame.remote = false;
        frame.length = kind == COMMAND ? 2 : 8;
        any_t out;
        if (!decode(kind, &out)) {
            continue;
        }
        taken[kind]++;
        if (kind == POSE) {
            TEST_ASSERT_TRUE(fabsf(out.pose.x_m) <= BERTH_MESSAGE_POSITION_MAX_M);
            TEST_ASSERT_TRUE(fabsf(out.pose.y_m) <= BERTH_MESSAGE_POSITION_MAX_M);
            TEST_ASSERT_TRUE(fabsf(out.pose.theta_rad) <= 3.1416f);
        } else if (kind == OBSTACLE) {
            TEST_ASSERT_TRUE(fabsf(out.obstacle.x_m) <= BERTH_MESSAGE_OBSTACLE_MAX_M);
            TEST_ASSERT_TRUE(fabsf(out.obstacle.y_m) <= BERTH_MESSAGE_OBSTACLE_MAX_M);
            TEST_ASSERT_TRUE(out.obstacle.radius_m >= 0.0f && out.obstacle.radius_m <= 2.55f);
        } else if (kind == COMMAND) {
            TEST_ASSERT_TRUE(out.command < BERTH_COMMAND_COUNT);
        }
    }
    for (kind_t kind = COMMAND; kind < KINDS; kind++) {
        TEST_ASSERT_GREATER_THAN_UINT32(0, taken[kind]);
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_frames_have_their_form);
    RUN_TEST(test_wrong_lengths_and_remote_frames_are_refused);
    RUN_TEST(test_kind_and_address);
    RUN_TEST(test_commands_that_do_not_exist_are_sent_as_none);
    RUN_TEST(test_commands_with_a_wrong_byte_are_refused);
    RUN_TEST(test_pose_that_is_not_finite_is_refused);
    RUN_TEST(test_position_beyond_the_range_is_refused);
    RUN_TEST(test_headings_beyond_half_a_turn_are_refused);
    RUN_TEST(test_headings_are_wrapped);
    RUN_TEST(test_rounding_is_to_nearest_even);
    RUN_TEST(test_obstacle_that_is_nowhere_is_refused);
    RUN_TEST(test_radius_that_is_unknown_is_the_largest);
    RUN_TEST(test_obstacle_comes_back);
    RUN_TEST(test_clearance);
    RUN_TEST(test_status_saturates);
    RUN_TEST(test_each_flag_of_the_status_comes_back_alone);
    RUN_TEST(test_states_and_modes_that_do_not_exist);
    RUN_TEST(test_error_that_is_not_finite_is_refused);
    RUN_TEST(test_error_saturates);
    RUN_TEST(test_random_bytes);
    return UNITY_END();
}
