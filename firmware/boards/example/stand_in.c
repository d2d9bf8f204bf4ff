#include "stand_in.h"

#include "berth/angle.h"

#include <string.h>

#define TURN_RAD 6.28318531f
#define PERIOD_S ((float)STAND_IN_PERIOD_US * 1e-6f)

/* Of a drive: the id is node << 5 | command (berth/drive_odrive.h). */
enum {
    HEARTBEAT = 0x01,
    EMERGENCY_STOP = 0x02,
    AXIS_STATE = 0x07,
    ENCODER_ESTIMATES = 0x09,
    INPUT_VELOCITY = 0x0d
};
enum { STATE_IDLE = 1, STATE_CLOSED_LOOP = 8 };

/* Frames that wait: two of each drive's. */
enum { FRAMES = 4, ALL_FRAMES = (1 << FRAMES) - 1 };

static const uint32_t nodes[2] = {STAND_IN_LEFT_NODE, STAND_IN_RIGHT_NODE};

static void go_idle(stand_in_wheel_t *wheel) {
    wheel->closed_loop = false;
    wheel->asked_rps = 0.0f;
}

static void turn(stand_in_t *robot, stand_in_wheel_t *wheel) {
    if (wheel->closed_loop && robot->next_us - wheel->fed_us > STAND_IN_WATCHDOG_US) {
        go_idle(wheel);
        robot->bites++;
    }
    wheel->rps = wheel->asked_rps;
    wheel->turns += wheel->rps * PERIOD_S;
}

/* One period of the drives: half of the turn, straight on, the other half. */
static void move(stand_in_t *robot) {
    turn(robot, &robot->wheels[0]);
    turn(robot, &robot->wheels[1]);
    const float rim_m = TURN_RAD * STAND_IN_WHEEL_RADIUS_M * PERIOD_S;
    const float left_m = robot->wheels[0].rps * rim_m;
    const float right_m = robot->wheels[1].rps * rim_m;
    const float half_rad = 0.5f * (right_m - left_m) / STAND_IN_TRACK_M;
    float sine;
    float cosine;
    berth_sincos(robot->pose.theta_rad + half_rad, &sine, &cosine);
    robot->pose.x_m += 0.5f * (left_m + right_m) * cosine;
    robot->pose.y_m += 0.5f * (left_m + right_m) * sine;
    robot->pose.theta_rad = berth_wrap(robot->pose.theta_rad + 2.0f * half_rad);
}

/* float32 are little endian on the wire, as all these processors have them. */
static void fill(const stand_in_wheel_t *wheel, uint32_t command, berth_can_frame_t *frame) {
    if (command == HEARTBEAT) {
        frame->data[4] = wheel->closed_loop ? STATE_CLOSED_LOOP : STATE_IDLE;
    } else {
        memcpy(frame->data, &wheel->turns, 4);
        memcpy(frame->data + 4, &wheel->rps, 4);
    }
}

static berth_can_outcome_t receive(void *context, berth_can_frame_t *frame) {
    stand_in_t *robot = context;
    if (robot->waiting == 0) {
        if (robot->clock.api->now_us(robot->clock.context) < robot->next_us) {
            return BERTH_CAN_AGAIN;
        }
        move(robot);
        robot->waiting = ALL_FRAMES;
        robot->next_us += STAND_IN_PERIOD_US;
    }
    uint32_t which = 0;
    while ((robot->waiting & 1u << which) == 0) {
        which++;
    }
    robot->waiting &= ~(1u << which);
    const uint32_t command = which < 2 ? ENCODER_ESTIMATES : HEARTBEAT;
    *frame = (berth_can_frame_t){.time_us = robot->next_us - STAND_IN_PERIOD_US,
                                 .id = nodes[which % 2u] << 5 | command,
                                 .length = 8};
    fill(&robot->wheels[which % 2u], command, frame);
    return BERTH_CAN_DONE;
}

static void obey(const stand_in_t *robot, stand_in_wheel_t *wheel, const berth_can_frame_t *frame) {
    const uint32_t command = frame->id & 0x1fu;
    if (command == AXIS_STATE && frame->data[0] == STATE_CLOSED_LOOP) {
        wheel->closed_loop = true;
        wheel->fed_us = robot->clock.api->now_us(robot->clock.context);
    } else if (command == AXIS_STATE || command == EMERGENCY_STOP) {
        go_idle(wheel);
    } else if (command == INPUT_VELOCITY && frame->length == 8 && wheel->closed_loop) {
        memcpy(&wheel->asked_rps, frame->data, 4);
        wheel->fed_us = robot->clock.api->now_us(robot->clock.context);
    }
}

static berth_can_outcome_t send(void *context, const berth_can_frame_t *frame) {
    stand_in_t *robot = context;
    const uint32_t limit = frame->extended ? BERTH_CAN_EXTENDED_MAX : BERTH_CAN_STANDARD_MAX;
    if (frame->id > limit || frame->length > BERTH_CAN_DATA_MAX) {
        return BERTH_CAN_FAILED;
    }
    for (int side = 0; side < 2; side++) {
        if (!frame->extended && !frame->remote && frame->id >> 5 == nodes[side]) {
            obey(robot, &robot->wheels[side], frame);
        }
    }
    return BERTH_CAN_DONE;
}

static void state(void *context, berth_can_state_t *out) {
    (void)context;
    *out = (berth_can_state_t){.mode = BERTH_CAN_ERROR_ACTIVE};
}

berth_can_t stand_in_can(stand_in_t *robot) {
    static const berth_can_api_t api = {send, receive, state};
    return (berth_can_t){&api, robot};
}

void stand_in_open(stand_in_t *robot, berth_clock_t clock, const berth_pose_t *start) {
    *robot = (stand_in_t){
        .clock = clock,
        .pose = *start,
        .next_us = clock.api->now_us(clock.context) + STAND_IN_PERIOD_US,
    };
}

int64_t stand_in_due(const stand_in_t *robot) {
    return robot->waiting != 0 ? 0 : robot->next_us;
}
