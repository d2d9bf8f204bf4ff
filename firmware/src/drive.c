#include "berth/drive.h"

#include "berth/reference.h"
#include "check.h"
#include "count.h"
#include "drive_protocol.h"
#include "scalar.h"

/* MISRA D9 in this file. */

#define TURNS_PER_RAD 0.159154943f
#define SECONDS_PER_US 1.0e-6f

/* A position jumps when it is further from where the speed says than a quarter of a motor turn,
 * 50 ms of time stamp error and a mean acceleration of 1000 turns/s^2 between two speeds explain.
 */
#define JUMP_TURNS 0.25f
#define JUMP_TIME_S 0.05f
#define JUMP_TURNS_PER_S2 250.0f

static berth_error_t check_common(const berth_drive_config_t *config, berth_refusal_t *refusal) {
    const bool backwards = config->sign == -1;
    const bool good =
        (backwards ||
         check_value(BERTH_FIELD_DRIVE_SIGN, (float)config->sign, 1.0f, 1.0f, refusal)) &&
        check_value(BERTH_FIELD_GEAR_RATIO, config->gear_ratio, 0.001f, 1000.0f, refusal) &&
        check_value(BERTH_FIELD_PLAN_PERIOD, (float)config->period_us, (float)BERTH_PERIOD_MIN_US,
                    (float)BERTH_PERIOD_MAX_US, refusal) &&
        check_value(BERTH_FIELD_FEEDBACK_TIMEOUT, (float)config->feedback_timeout_us, 1.0e3f,
                    1.0e7f, refusal) &&
        check_value(BERTH_FIELD_HEARTBEAT_TIMEOUT, (float)config->heartbeat_timeout_us, 1.0e3f,
                    1.0e7f, refusal) &&
        check_value(BERTH_FIELD_ENABLE_TIMEOUT, (float)config->enable_timeout_us, 1.0e3f, 6.0e7f,
                    refusal);
    return good ? BERTH_OK : BERTH_ERROR_CONFIG;
}

berth_error_t drive_check_node(const berth_drive_config_t *config, float lowest, float highest,
                               berth_refusal_t *refusal) {
    return check_value(BERTH_FIELD_DRIVE_NODE, (float)config->node, lowest, highest, refusal)
               ? BERTH_OK
               : BERTH_ERROR_CONFIG;
}

/* No feedback counts any more: what was measured before says nothing about now. */
static void forget_feedback(berth_drive_t *drive) {
    drive->status.feedback_us = -1;
    drive->status.heartbeat_us = -1;
    drive->status.velocity_radps = 0.0f;
    drive->travel_us = -1;
    drive_position_lost(drive);
}

berth_error_t berth_drive_init(berth_drive_t *drive, const berth_drive_config_t *config,
                               berth_refusal_t *refusal) {
    /* an initializer zeroes a union's first member */
    _Static_assert(sizeof drive->state == sizeof(berth_drive_cia402_state_t),
                   "no protocol's state is larger than the first");
    if (drive == NULL || config == NULL || config->protocol == NULL || refusal == NULL) {
        return BERTH_ERROR_ARGUMENT;
    }
    berth_error_t error = check_common(config, refusal);
    if (error == BERTH_OK) {
        error = config->protocol->check(config, refusal);
    }
    if (error != BERTH_OK) {
        return error;
    }
    *drive = (berth_drive_t){
        .config = *config,
        .motor_turns_per_rad = (float)config->sign * config->gear_ratio * TURNS_PER_RAD,
    };
    forget_feedback(drive);
    return BERTH_OK;
}

void berth_drive_enable(berth_drive_t *drive, int64_t now_us) {
    if (drive->status.state != BERTH_DRIVE_OFF && drive->status.state != BERTH_DRIVE_STOPPED) {
        return;
    }
    forget_feedback(drive);
    drive->status.state = BERTH_DRIVE_STARTING;
    drive->command_radps = 0.0f;
    drive->enabling_us = now_us;
    drive->released = false;
    drive->config.protocol->enable(drive, now_us);
}

void berth_drive_disable(berth_drive_t *drive, berth_outbox_t *outbox) {
    drive->config.protocol->disable(drive, outbox);
    drive->released = true;
    if (drive->status.state != BERTH_DRIVE_FAULT) {
        drive->status.state = BERTH_DRIVE_OFF;
    }
}

static void stop_state(berth_drive_t *drive) {
    drive->command_radps = 0.0f;
    if (drive->status.state == BERTH_DRIVE_STARTING || drive->status.state == BERTH_DRIVE_ENABLED) {
        drive->status.state = BERTH_DRIVE_STOPPED;
    }
}

void berth_drive_stop(berth_drive_t *drive, berth_outbox_t *outbox) {
    stop_state(drive);
    drive->config.protocol->stop(drive, outbox);
}

void berth_drive_emergency_stop(berth_drive_t *drive, berth_outbox_t *outbox) {
    stop_state(drive);
    drive->config.protocol->emergency_stop(drive, outbox);
}

void berth_drive_reset(berth_drive_t *drive) {
    if (drive->status.state == BERTH_DRIVE_FAULT) {
        drive->status.state = BERTH_DRIVE_OFF;
        drive->status.fault = BERTH_DRIVE_FAULT_NONE;
        drive->status.code = 0;
    }
}

void berth_drive_command(berth_drive_t *drive, float wheel_radps) {
    const bool good = check_range(wheel_radps, -CHECK_FLOAT_MAX, CHECK_FLOAT_MAX);
    if (!good) {
        count(&drive->status.refused);
    }
    drive->command_radps = good ? wheel_radps : 0.0f;
}

void berth_drive_cycle(berth_drive_t *drive, int64_t now_us, berth_outbox_t *outbox) {
    if (drive->status.state != BERTH_DRIVE_OFF && !drive->released) {
        drive->config.protocol->cycle(drive, now_us, outbox);
    }
}

void berth_drive_sync(const berth_drive_t *drive, int64_t now_us, berth_outbox_t *outbox) {
    if (drive->config.protocol->sync != NULL) {
        drive->config.protocol->sync(drive, now_us, outbox);
    }
}

bool berth_drive_receive(berth_drive_t *drive, const berth_can_frame_t *frame, int64_t at_us) {
    const drive_frame_t kind = drive->config.protocol->receive(drive, frame, at_us);
    if (kind == DRIVE_FRAME_GOOD) {
        count(&drive->status.received);
    } else if (kind == DRIVE_FRAME_MALFORMED) {
        count(&drive->status.malformed);
    } else {
        /* not from this drive */
    }
    return kind != DRIVE_FRAME_FOREIGN;
}

static bool watched(const berth_drive_t *drive) {
    return drive->status.state == BERTH_DRIVE_ENABLED || drive->status.state == BERTH_DRIVE_STOPPED;
}

/* The last sign, or the beginning of enabling where there was none since. */
static int64_t last_sign(const berth_drive_t *drive, int64_t at_us) {
    return at_us > drive->enabling_us ? at_us : drive->enabling_us;
}

static int64_t feedback_deadline(const berth_drive_t *drive) {
    return last_sign(drive, drive->status.feedback_us) + drive->config.feedback_timeout_us;
}

static int64_t heartbeat_deadline(const berth_drive_t *drive) {
    return last_sign(drive, drive->status.heartbeat_us) + drive->config.heartbeat_timeout_us;
}

static int64_t enable_deadline(const berth_drive_t *drive) {
    return drive->enabling_us + drive->config.enable_timeout_us;
}

void berth_drive_step(berth_drive_t *drive, int64_t now_us, berth_outbox_t *outbox) {
    if (drive->status.state == BERTH_DRIVE_OFF) {
        return;
    }
    drive->config.protocol->step(drive, now_us, outbox);
    if (drive->status.state == BERTH_DRIVE_STARTING && now_us > enable_deadline(drive)) {
        drive_fail(drive, BERTH_DRIVE_FAULT_ENABLE, drive->config.protocol->progress(drive));
    }
    if (watched(drive) && now_us > feedback_deadline(drive)) {
        drive_fail(drive, BERTH_DRIVE_FAULT_FEEDBACK, 0);
    }
    if (watched(drive) && now_us > heartbeat_deadline(drive)) {
        drive_fail(drive, BERTH_DRIVE_FAULT_HEARTBEAT, 0);
    }
}

static int64_t earlier(int64_t a, int64_t b) {
    return a < b ? a : b;
}

int64_t berth_drive_deadline(const berth_drive_t *drive) {
    if (drive->status.state == BERTH_DRIVE_OFF) {
        return BERTH_TIME_MAX_US;
    }
    int64_t deadline_us = drive->config.protocol->deadline(drive);
    /* watchdogs bite one microsecond after their time */
    if (drive->status.state == BERTH_DRIVE_STARTING) {
        deadline_us = earlier(deadline_us, enable_deadline(drive) + 1);
    }
    if (watched(drive)) {
        deadline_us = earlier(deadline_us, feedback_deadline(drive) + 1);
        deadline_us = earlier(deadline_us, heartbeat_deadline(drive) + 1);
    }
    return deadline_us;
}

const berth_drive_status_t *berth_drive_status(const berth_drive_t *drive) {
    return &drive->status;
}

uint32_t berth_drive_filters(const berth_drive_t *drive,
                             berth_can_filter_t filters[BERTH_DRIVE_FILTERS_MAX]) {
    return drive->config.protocol->filters(drive, filters);
}

/* --- what the protocols call ---------------------------------------------------------------- */

void drive_enabled(berth_drive_t *drive) {
    if (drive->status.state == BERTH_DRIVE_STARTING && drive->status.feedback_us >= 0 &&
        drive->status.heartbeat_us >= 0) {
        drive->status.state = BERTH_DRIVE_ENABLED;
    }
}

void drive_fail(berth_drive_t *drive, berth_drive_fault_t fault, uint32_t code) {
    if (drive->status.state == BERTH_DRIVE_OFF || drive->status.state == BERTH_DRIVE_FAULT) {
        return;
    }
    drive->status.state = BERTH_DRIVE_FAULT;
    drive->status.fault = fault;
    drive->status.code = code;
    drive->command_radps = 0.0f;
}

void drive_alive(berth_drive_t *drive, int64_t at_us) {
    if (at_us > drive->status.heartbeat_us) {
        drive->status.heartbeat_us = at_us;
    }
}

static int64_t later(int64_t a, int64_t b) {
    return a > b ? a : b;
}

/* Time between two events as float32; more than the feedback timeout means nothing here. */
static float seconds(const berth_drive_t *drive, int64_t from_us, int64_t to_us) {
    const int64_t longest_us = drive->config.feedback_timeout_us;
    int64_t span_us = to_us - from_us;
    span_us = span_us > longest_us ? longest_us : span_us;
    span_us = span_us < -longest_us ? -longest_us : span_us;
    /* It fits, and 64 bits become a float by way of double on processors without a float unit. */
    return (float)(int32_t)span_us * SECONDS_PER_US;
}

static void travel_by(berth_drive_t *drive, float angle_rad) {
    drive->travel_rad += angle_rad;
    drive->gap_rad -= angle_rad;
}

/* Until when travel may go on with the last speed. A position may have taken it further. */
static int64_t horizon(const berth_drive_t *drive) {
    const int64_t longest_us = drive->status.feedback_us + drive->config.feedback_timeout_us;
    return later(longest_us, drive->travel_us);
}

/* Goes on, or back, with the last speed: a frame may have been on the wire before the last step. */
static void extrapolate(berth_drive_t *drive, int64_t to_us) {
    travel_by(drive, drive->status.velocity_radps * seconds(drive, drive->travel_us, to_us));
    drive->travel_us = to_us;
}

/* Up to a measurement at at_us. What lies beyond the horizon is for the measurement to tell. */
static void advance(berth_drive_t *drive, int64_t at_us) {
    extrapolate(drive, earlier(at_us, horizon(drive)));
    drive->travel_us = at_us;
}

static float magnitude(float value) {
    return value < 0.0f ? -value : value;
}

void drive_velocity(berth_drive_t *drive, float motor_rps, int64_t at_us) {
    const float velocity = motor_rps / drive->motor_turns_per_rad;
    if (drive->travel_us < 0) {
        drive->travel_us = at_us;
        drive->status.feedback_us = at_us;
    } else {
        /* The order in which frames came is surer than their times: none takes the time back. */
        const int64_t when_us = later(at_us, drive->status.feedback_us);
        advance(drive, when_us);
        /* since the last feedback the speed has gone from the old one to this one */
        travel_by(drive, 0.5f * (velocity - drive->status.velocity_radps) *
                             seconds(drive, drive->status.feedback_us, when_us));
        drive->status.feedback_us = when_us;
    }
    drive->status.velocity_radps = velocity;
    drive->fastest_radps = maximum(drive->fastest_radps, magnitude(velocity));
}

/* How far, in rad of the wheel, the position may be from where the speed says that it is. */
static float plausible_gap(const berth_drive_t *drive, float slack, int64_t at_us) {
    const float span_s = minimum(seconds(drive, drive->position_us, at_us), 1.0f);
    const float motor_turns = JUMP_TURNS + JUMP_TURNS_PER_S2 * span_s * span_s;
    const float per_turn = magnitude(1.0f / drive->motor_turns_per_rad);
    return slack + motor_turns * per_turn + JUMP_TIME_S * drive->fastest_radps;
}

bool drive_position(berth_drive_t *drive, float turned, float quantum, int64_t at_us) {
    if (drive->travel_us < 0) {
        return true; /* an angle counts from the first speed on */
    }
    const int64_t when_us = later(at_us, drive->status.feedback_us);
    advance(drive, when_us);
    /* Within one quantum the speed knows better than the position; beyond it the position does. */
    const float per_turn = 1.0f / drive->motor_turns_per_rad;
    const float slack = quantum * magnitude(per_turn);
    const float gap = drive->gap_rad + turned * per_turn;
    const bool jumped =
        drive->status.position_used && !(magnitude(gap) <= plausible_gap(drive, slack, when_us));
    if (jumped || !drive->status.position_used) {
        drive->gap_rad = 0.0f; /* the speed alone tells the way to here */
    } else {
        const float kept = minimum(maximum(gap, -slack), slack);
        drive->travel_rad += gap - kept;
        drive->gap_rad = kept;
    }
    drive->status.position_used = true;
    drive->position_us = when_us;
    drive->fastest_radps = magnitude(drive->status.velocity_radps);
    return !jumped;
}

void drive_position_lost(berth_drive_t *drive) {
    drive->status.position_used = false;
}

float berth_drive_travel(berth_drive_t *drive, int64_t now_us) {
    if (drive->travel_us < 0) {
        return 0.0f;
    }
    extrapolate(drive, earlier(now_us, horizon(drive)));
    const float travel = drive->travel_rad;
    drive->travel_rad = 0.0f;
    return travel;
}

float drive_motor_rps(const berth_drive_t *drive) {
    return drive->status.state == BERTH_DRIVE_ENABLED
               ? drive->command_radps * drive->motor_turns_per_rad
               : 0.0f;
}

float drive_clamp(berth_drive_t *drive, float value, float limit) {
    float clamped = value == value ? value : 0.0f; /* what is no number means stand */
    if (clamped > limit) {
        clamped = limit;
    } else if (clamped < -limit) {
        clamped = -limit;
    } else {
        /* it fits */
    }
    if (clamped != value) {
        count(&drive->status.saturated);
    }
    return clamped;
}

int32_t drive_to_int(berth_drive_t *drive, float value, float limit) {
    const float clamped = drive_clamp(drive, value, limit);
    const int32_t whole = (int32_t)clamped;
    const float rest = clamped - (float)whole; /* exact */
    if (rest >= 0.5f) {
        return whole + 1;
    }
    return rest <= -0.5f ? whole - 1 : whole;
}

berth_can_frame_t drive_frame(uint32_t id, bool extended, uint8_t length) {
    return (berth_can_frame_t){.id = id, .extended = extended, .length = length};
}

/* --- texts ------------------------------------------------------------------------------------ */

const char *berth_drive_state_text(berth_drive_state_t state) {
    static const char *const texts[] = {"off", "starting", "enabled", "stopped", "fault"};
    const unsigned number = (unsigned)state;
    return number < sizeof texts / sizeof texts[0] ? texts[number] : "?";
}

const char *berth_drive_fault_text(berth_drive_fault_t fault) {
    static const char *const texts[] = {
        "none",
        "no speed feedback in time",
        "no heartbeat in time",
        "the drive reports an error",
        "the drive left its enabled state",
        "not enabled in time",
        "the drive refused a setting",
        "no answer to a setting",
        "emergency message from the drive",
    };
    _Static_assert(sizeof texts / sizeof texts[0] == (size_t)BERTH_DRIVE_FAULT_COUNT,
                   "one text each");
    const unsigned number = (unsigned)fault;
    return number < (unsigned)BERTH_DRIVE_FAULT_COUNT ? texts[number] : "?";
}
