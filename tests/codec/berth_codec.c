/* Runs the message codecs on lines of input, one answer a line, for test_dbc.py.
 *
 *     encode KIND ADDRESS VALUE...   ->  ID LENGTH HEX
 *     decode KIND HEX                ->  VALUE..., or "refused"
 *
 * A float goes in and comes out as the hexadecimal digits of its bits, so that nothing is lost on
 * the way. Values are in the order of the structs in message.h.
 */
#include "berth/message.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define WORDS_MAX 16
#define LINE_MAX_CHARS 512

typedef struct {
    char *words[WORDS_MAX];
    int count;
} line_t;

static void fail(const char *why, const char *word) {
    (void)fprintf(stderr, "berth-codec: %s: %s\n", why, word);
    exit(2);
}

static float bits_to_float(uint32_t bits) {
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static uint32_t float_to_bits(float value) {
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

static uint32_t number(const line_t *line, int place, int base) {
    if (place >= line->count) {
        fail("value missing", line->words[0]);
    }
    char *end = NULL;
    const unsigned long value = strtoul(line->words[place], &end, base);
    if (*end != '\0' || value > UINT32_MAX) {
        fail("not a number", line->words[place]);
    }
    return (uint32_t)value;
}

static uint32_t integer(const line_t *line, int place) {
    return number(line, place, 10);
}

static float real(const line_t *line, int place) {
    return bits_to_float(number(line, place, 16));
}

static bool is(const line_t *line, const char *kind) {
    return strcmp(line->words[1], kind) == 0;
}

static void encode_status(const line_t *line, uint8_t address, berth_can_frame_t *frame) {
    const berth_message_status_t status = {
        .state = (uint8_t)integer(line, 3),
        .mode = (uint8_t)integer(line, 4),
        .fault = (uint8_t)integer(line, 5),
        .total = integer(line, 6),
        .active = (uint8_t)integer(line, 7),
        .finished = integer(line, 8) != 0,
        .braking = integer(line, 9) != 0,
        .limited = integer(line, 10) != 0,
        .clearance_m = real(line, 11),
    };
    berth_message_encode_status(frame, address, &status);
}

static void encode_obstacle(const line_t *line, uint8_t address, berth_can_frame_t *frame) {
    const berth_message_obstacle_t obstacle = {(uint8_t)integer(line, 3), real(line, 4),
                                               real(line, 5), real(line, 6),
                                               (uint16_t)integer(line, 7)};
    berth_message_encode_obstacle(frame, address, &obstacle);
}

static void encode(const line_t *line) {
    const uint8_t address = (uint8_t)integer(line, 2);
    berth_can_frame_t frame;
    memset(&frame, 0x55, sizeof frame); /* what is not written must not pass for zero */
    if (is(line, "command")) {
        berth_message_encode_command(&frame, address, (berth_command_code_t)integer(line, 3));
    } else if (is(line, "pose") || is(line, "pose_fix")) {
        const berth_pose_t pose = {real(line, 3), real(line, 4), real(line, 5)};
        berth_message_encode_pose(
            &frame, is(line, "pose") ? BERTH_MESSAGE_POSE : BERTH_MESSAGE_POSE_FIX, address, &pose);
    } else if (is(line, "obstacle")) {
        encode_obstacle(line, address, &frame);
    } else if (is(line, "status")) {
        encode_status(line, address, &frame);
    } else if (is(line, "error")) {
        const berth_message_error_t error = {{real(line, 3), real(line, 4), real(line, 5)},
                                             real(line, 6)};
        berth_message_encode_error(&frame, address, &error);
    } else {
        fail("no such kind", line->words[1]);
    }
    if (!frame.extended || frame.remote || frame.length > BERTH_CAN_DATA_MAX) {
        fail("not a good frame", line->words[1]);
    }
    printf("%" PRIx32 " %u ", frame.id, (unsigned)frame.length);
    for (unsigned i = 0; i < frame.length; i++) {
        printf("%02x", (unsigned)frame.data[i]);
    }
    printf("\n");
}

static void print_reals(const float *values, int count) {
    for (int i = 0; i < count; i++) {
        printf("%08" PRIx32 "%s", float_to_bits(values[i]), i + 1 < count ? " " : "\n");
    }
}

static bool decode_pose(const berth_can_frame_t *frame) {
    berth_pose_t pose;
    if (!berth_message_decode_pose(frame, &pose)) {
        return false;
    }
    print_reals((const float[]){pose.x_m, pose.y_m, pose.theta_rad}, 3);
    return true;
}

static bool decode_obstacle(const berth_can_frame_t *frame) {
    berth_message_obstacle_t obstacle;
    if (!berth_message_decode_obstacle(frame, &obstacle)) {
        return false;
    }
    printf("%u %u ", (unsigned)obstacle.id, (unsigned)obstacle.ttl_ms);
    print_reals((const float[]){obstacle.x_m, obstacle.y_m, obstacle.radius_m}, 3);
    return true;
}

static bool decode_status(const berth_can_frame_t *frame) {
    berth_message_status_t s;
    if (!berth_message_decode_status(frame, &s)) {
        return false;
    }
    printf("%u %u %u %" PRIu32 " %u %d %d %d ", (unsigned)s.state, (unsigned)s.mode,
           (unsigned)s.fault, s.total, (unsigned)s.active, s.finished, s.braking, s.limited);
    print_reals(&s.clearance_m, 1);
    return true;
}

static bool decode_error(const berth_can_frame_t *frame) {
    berth_message_error_t e;
    if (!berth_message_decode_error(frame, &e)) {
        return false;
    }
    print_reals((const float[]){e.error.e1_m, e.error.e2_m, e.error.e3_rad, e.v_mps}, 4);
    return true;
}

static bool decode_command(const berth_can_frame_t *frame) {
    berth_command_code_t command;
    if (!berth_message_decode_command(frame, &command)) {
        return false;
    }
    printf("%d\n", (int)command);
    return true;
}

static bool decode_any(const line_t *line, const berth_can_frame_t *frame) {
    if (is(line, "command")) {
        return decode_command(frame);
    }
    if (is(line, "pose") || is(line, "pose_fix")) {
        return decode_pose(frame);
    }
    if (is(line, "obstacle")) {
        return decode_obstacle(frame);
    }
    if (is(line, "status")) {
        return decode_status(frame);
    }
    if (!is(line, "error")) {
        fail("no such kind", line->words[1]);
    }
    return decode_error(frame);
}

static void decode(const line_t *line) {
    berth_can_frame_t frame = {.extended = true};
    const char *hex = line->words[2];
    frame.length = (uint8_t)(strlen(hex) / 2);
    if (frame.length > BERTH_CAN_DATA_MAX) {
        fail("too long", hex);
    }
    for (unsigned i = 0; i < frame.length; i++) {
        unsigned byte = 0;
        if (sscanf(&hex[(size_t)2 * i], "%2x", &byte) != 1) {
            fail("not hexadecimal", hex);
        }
        frame.data[i] = (uint8_t)byte;
    }
    if (!decode_any(line, &frame)) {
        printf("refused\n");
    }
}

int main(void) {
    char text[LINE_MAX_CHARS];
    while (fgets(text, sizeof text, stdin) != NULL) {
        line_t line = {.count = 0};
        char *rest = NULL;
        for (char *word = strtok_r(text, " \n", &rest); word != NULL && line.count < WORDS_MAX;
             word = strtok_r(NULL, " \n", &rest)) {
            line.words[line.count++] = word;
        }
        if (line.count < 3) {
            fail("too few words", line.count > 0 ? line.words[0] : "");
        }
        if (strcmp(line.words[0], "encode") == 0) {
            encode(&line);
        } else if (strcmp(line.words[0], "decode") == 0) {
            decode(&line);
        } else {
            fail("no such request", line.words[0]);
        }
    }
    return 0;
}
