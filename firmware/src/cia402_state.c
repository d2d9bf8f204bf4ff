#include "check.h"
#include "cia402.h"

/* MISRA D9 in this file. */

/* Faster than this, turns/s, is no speed. */
#define MOTOR_RPS_MAX 1.0e9f

/* The states of CiA 402 that a statusword can tell. */
typedef enum {
    STATE_UNKNOWN = 0, /* not ready to switch on, or no state of the table's */
    STATE_SWITCH_ON_DISABLED,
    STATE_READY,
    STATE_SWITCHED_ON,
    STATE_OPERATION,
    STATE_QUICK_STOP,
    STATE_FAULT_REACTION,
    STATE_FAULT
} device_state_t;

typedef struct {
    uint8_t mask;
    uint8_t value;
    uint8_t state;
} pattern_t;

static device_state_t decode(uint16_t statusword) {
    static const pattern_t patterns[] = {
        {0x4F, 0x40, STATE_SWITCH_ON_DISABLED},
        {0x6F, 0x21, STATE_READY},
        {0x6F, 0x23, STATE_SWITCHED_ON},
        {0x6F, 0x27, STATE_OPERATION},
        {0x6F, 0x07, STATE_QUICK_STOP},
        {0x4F, 0x0F, STATE_FAULT_REACTION},
        {0x4F, 0x08, STATE_FAULT},
    };
    for (uint32_t i = 0; i < sizeof patterns / sizeof patterns[0]; i++) {
        if ((statusword & patterns[i].mask) == patterns[i].value) {
            return (device_state_t)patterns[i].state;
        }
    }
    return STATE_UNKNOWN;
}

static bool faulty(device_state_t state) {
    return state == STATE_FAULT || state == STATE_FAULT_REACTION;
}

bool cia402_fault_told(const berth_drive_t *drive) {
    return drive->state.cia402.told && faulty(decode(drive->state.cia402.statusword));
}

/* An old fault is reset while enabling; one that comes after that is a new one. */
static void check_starting(berth_drive_t *drive, device_state_t now, int64_t at_us) {
    berth_drive_cia402_state_t *state = &drive->state.cia402;
    if (state->stage < CIA402_RUN) {
        return;
    }
    state->told = true;
    if (faulty(now)) {
        if (state->healthy) {
            drive_fail(drive, BERTH_DRIVE_FAULT_DEVICE, state->error_code);
        }
        return;
    }
    state->healthy = state->healthy || now != STATE_UNKNOWN;
    if (now == STATE_OPERATION && state->asked) {
        if (state->mode_told) {
            drive_enabled(drive);
        } else if (state->stage == CIA402_RUN) {
            cia402_setup_check(drive, at_us);
        } else {
            /* the set-up or the check of the mode goes on */
        }
    }
}

static void check_state(berth_drive_t *drive, int64_t at_us) {
    const berth_drive_cia402_state_t *state = &drive->state.cia402;
    const device_state_t now = decode(state->statusword);
    switch (drive->status.state) {
    case BERTH_DRIVE_STARTING:
        check_starting(drive, now, at_us);
        break;
    case BERTH_DRIVE_ENABLED:
    case BERTH_DRIVE_STOPPED:
        if (faulty(now)) {
            drive_fail(drive, BERTH_DRIVE_FAULT_DEVICE, state->error_code);
        } else if (drive->status.state == BERTH_DRIVE_ENABLED && now != STATE_OPERATION) {
            drive_fail(drive, BERTH_DRIVE_FAULT_DISABLED,
                       BERTH_CIA402_CODE_STATUS + state->statusword);
        } else {
            /* as it should be */
        }
        break;
    default:
        break;
    }
}

drive_frame_t cia402_status(berth_drive_t *drive, const berth_can_frame_t *frame, int64_t at_us) {
    berth_drive_cia402_state_t *state = &drive->state.cia402;
    if (state->stage < CIA402_NODE) {
        return DRIVE_FRAME_GOOD; /* what a former mapping means is not known */
    }
    const float units = (float)signed_u32(get_u32_le(&frame->data[2]));
    const float motor_rps = units / drive->config.velocity_units_per_rps;
    if (!drive_frame_has(frame, 6) || !check_range(motor_rps, -MOTOR_RPS_MAX, MOTOR_RPS_MAX)) {
        return DRIVE_FRAME_MALFORMED;
    }
    state->statusword = get_u16_le(frame->data);
    drive_velocity(drive, motor_rps, at_us);
    check_state(drive, at_us);
    return DRIVE_FRAME_GOOD;
}

/* Bit 7 acts when it rises, so it has to fall first; frames get lost, so it does so again and
 * again. */
static uint16_t fault_reset_word(berth_drive_cia402_state_t *state, int64_t now_us) {
    if (now_us >= state->due_us) {
        state->edge = !state->edge;
        state->due_us = now_us + BERTH_CIA402_RESET_HOLD_US;
    }
    return state->edge ? CIA402_WORD_FAULT_RESET : CIA402_WORD_DISABLE_VOLTAGE;
}

static uint16_t enabling_word(berth_drive_cia402_state_t *state, int64_t now_us) {
    const device_state_t now = state->told ? decode(state->statusword) : STATE_UNKNOWN;
    if (now == STATE_FAULT) {
        return fault_reset_word(state, now_us);
    }
    switch (now) {
    case STATE_SWITCH_ON_DISABLED:
        return CIA402_WORD_SHUTDOWN;
    case STATE_READY:
        return CIA402_WORD_SWITCH_ON;
    case STATE_SWITCHED_ON:
        state->asked = true;
        return CIA402_WORD_ENABLE;
    case STATE_OPERATION:
        /* one that we did not ask for may already be on its way down by our first controlword */
        return state->asked ? CIA402_WORD_ENABLE : CIA402_WORD_DISABLE_VOLTAGE;
    default:
        return CIA402_WORD_DISABLE_VOLTAGE;
    }
}

/* Only fresh feedback can say that the wheel stands. */
static bool standing(const berth_drive_t *drive, int64_t now_us) {
    const int64_t measured_us = drive->status.feedback_us;
    const float speed = drive->status.velocity_radps;
    return measured_us >= 0 && now_us - measured_us <= drive->config.feedback_timeout_us &&
           speed < BERTH_CIA402_STANDING_RADPS && speed > -BERTH_CIA402_STANDING_RADPS;
}

uint16_t cia402_word(berth_drive_t *drive, int64_t now_us) {
    berth_drive_cia402_state_t *state = &drive->state.cia402;
    if (drive->status.state == BERTH_DRIVE_STARTING) {
        return enabling_word(state, now_us);
    }
    if (drive->status.state == BERTH_DRIVE_ENABLED) {
        return CIA402_WORD_ENABLE;
    }
    state->let_go = state->let_go || (state->emergency && standing(drive, now_us));
    return state->let_go ? CIA402_WORD_DISABLE_VOLTAGE : CIA402_WORD_QUICK_STOP;
}
