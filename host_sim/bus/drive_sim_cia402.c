/* The device profile CiA 402: state machine, velocity modes, feedback.
 *
 * The power stage obeys at once. Shutdown, disable operation and disable voltage release the motor;
 * quick stop and fault reaction brake it as their option codes say, on ramps. Quick stop options
 * 5 to 7 keep the drive in QUICK STOP ACTIVE, the others end in SWITCH ON DISABLED.
 */
#include "drive_sim_inner.h"

#include <math.h>

#define START_US INT64_C(15000)  /* from power-on to SWITCH ON DISABLED */
#define RAMP_US INT64_C(1000)    /* how often a ramp asks to be stepped */
#define STAND_US INT64_C(500000) /* how long a stop waits for the wheel */

enum { SWITCH_ON = 0x01, ENABLE_VOLTAGE = 0x02, NO_QUICK_STOP = 0x04, ENABLE_OPERATION = 0x08 };
enum { FAULT_RESET = 0x80, HALT = 0x100 };
enum {
    VOLTAGE_ENABLED = 0x0010,
    WARNING = 0x0080,
    REMOTE = 0x0200,
    TARGET_REACHED = 0x0400,
    MODE_BIT_12 = 0x1000 /* speed is zero; in mode 9: follows the command */
};
enum { PROFILE_VELOCITY = 3, CYCLIC_VELOCITY = 9 };

static const uint16_t patterns[] = {
    [CIA402_NOT_READY_TO_SWITCH_ON] = 0x0000, [CIA402_SWITCH_ON_DISABLED] = 0x0040,
    [CIA402_READY_TO_SWITCH_ON] = 0x0021,     [CIA402_SWITCHED_ON] = 0x0023,
    [CIA402_OPERATION_ENABLED] = 0x0027,      [CIA402_QUICK_STOP_ACTIVE] = 0x0007,
    [CIA402_FAULT_REACTION_ACTIVE] = 0x000f,  [CIA402_FAULT] = 0x0008,
};

static double units_per_rps(const drive_sim_t *sim) {
    const double units = sim->config.velocity_units_per_rps;
    return units > 0.0 ? units : 1.0;
}

static double speed(const drive_sim_t *sim) {
    return sim->motor_rps * units_per_rps(sim);
}

static bool stands(const drive_sim_t *sim) {
    return fabs(speed(sim)) <= (double)canopen_number(sim, OBJECT_VELOCITY_THRESHOLD);
}

static bool halted(const drive_sim_t *sim) {
    return (sim->state.cia402.objects[OBJECT_CONTROLWORD] & HALT) != 0;
}

static bool has_mode(const drive_sim_t *sim) {
    return canopen_number(sim, OBJECT_MODE) != 0;
}

void cia402_reset(drive_sim_t *sim) {
    drive_sim_cia402_state_t *state = &sim->state.cia402;
    state->state = CIA402_NOT_READY_TO_SWITCH_ON;
    state->ready_us = sim->now_us + START_US;
    state->setpoint = 0.0;
    state->ramp_us = sim->now_us;
    state->stand_us = INT64_MAX;
}

bool cia402_enabled(const drive_sim_t *sim) {
    const cia402_state_t state = sim->state.cia402.state;
    return state == CIA402_OPERATION_ENABLED || state == CIA402_QUICK_STOP_ACTIVE ||
           state == CIA402_FAULT_REACTION_ACTIVE;
}

double cia402_target_rps(const drive_sim_t *sim) {
    return sim->state.cia402.setpoint / units_per_rps(sim);
}

/* Ramps. */

static double aim(const drive_sim_t *sim) {
    const bool runs =
        sim->state.cia402.state == CIA402_OPERATION_ENABLED && has_mode(sim) && !halted(sim);
    return runs ? (double)canopen_number(sim, OBJECT_TARGET_VELOCITY) : 0.0;
}

/* Of an option code for stopping: slow down, quick stop, or as hard as can be. */
static double stopping_rate(const drive_sim_t *sim, int64_t option) {
    switch (option) {
    case 1:
    case 5:
        return (double)canopen_number(sim, OBJECT_DECELERATION);
    case 2:
    case 6:
        return (double)canopen_number(sim, OBJECT_QUICK_STOP_DECELERATION);
    default:
        return HUGE_VAL;
    }
}

static double rate(const drive_sim_t *sim, double aimed) {
    const drive_sim_cia402_state_t *state = &sim->state.cia402;
    switch (state->state) {
    case CIA402_QUICK_STOP_ACTIVE:
        return stopping_rate(sim, canopen_number(sim, OBJECT_QUICK_STOP_OPTION));
    case CIA402_FAULT_REACTION_ACTIVE:
        return stopping_rate(sim, canopen_number(sim, OBJECT_FAULT_OPTION));
    case CIA402_OPERATION_ENABLED:
        if (canopen_number(sim, OBJECT_MODE) != PROFILE_VELOCITY) {
            return HUGE_VAL;
        }
        return (double)canopen_number(
            sim, fabs(aimed) > fabs(state->setpoint) ? OBJECT_ACCELERATION : OBJECT_DECELERATION);
    default:
        return HUGE_VAL;
    }
}

static void ramp(drive_sim_t *sim) {
    drive_sim_cia402_state_t *state = &sim->state.cia402;
    const double elapsed_s = (double)(sim->now_us - state->ramp_us) * 1e-6;
    state->ramp_us = sim->now_us;
    const double aimed = aim(sim);
    const double left = aimed - state->setpoint;
    const double rate_per_s = rate(sim, aimed);
    if (isinf(rate_per_s) || fabs(left) <= rate_per_s * elapsed_s) {
        state->setpoint = aimed;
    } else {
        state->setpoint += copysign(rate_per_s * elapsed_s, left);
    }
}

/* States. */

static void release(drive_sim_t *sim, cia402_state_t next) {
    sim->state.cia402.state = next;
    sim->state.cia402.setpoint = 0.0;
}

static bool stops_by_itself(const drive_sim_t *sim) {
    const cia402_state_t state = sim->state.cia402.state;
    return state == CIA402_FAULT_REACTION_ACTIVE ||
           (state == CIA402_QUICK_STOP_ACTIVE && canopen_number(sim, OBJECT_QUICK_STOP_OPTION) < 5);
}

static void end_stop(drive_sim_t *sim) {
    drive_sim_cia402_state_t *state = &sim->state.cia402;
    if (!stops_by_itself(sim) || state->setpoint != 0.0) {
        return;
    }
    if (state->stand_us == INT64_MAX) {
        state->stand_us = sim->now_us + STAND_US;
    }
    if (stands(sim) || sim->now_us >= state->stand_us) {
        release(sim, state->state == CIA402_FAULT_REACTION_ACTIVE ? CIA402_FAULT
                                                                  : CIA402_SWITCH_ON_DISABLED);
    }
}

void cia402_advance(drive_sim_t *sim) {
    drive_sim_cia402_state_t *state = &sim->state.cia402;
    if (state->state == CIA402_NOT_READY_TO_SWITCH_ON && sim->now_us >= state->ready_us) {
        state->state = CIA402_SWITCH_ON_DISABLED;
    }
    ramp(sim);
    end_stop(sim);
}

int64_t cia402_deadline(const drive_sim_t *sim) {
    const drive_sim_cia402_state_t *state = &sim->state.cia402;
    if (state->state == CIA402_NOT_READY_TO_SWITCH_ON) {
        return state->ready_us;
    }
    return stops_by_itself(sim) || state->setpoint != aim(sim) ? state->ramp_us + RAMP_US
                                                               : INT64_MAX;
}

static void enable(drive_sim_t *sim) {
    drive_sim_cia402_state_t *state = &sim->state.cia402;
    if (state->state != CIA402_QUICK_STOP_ACTIVE) {
        state->setpoint = speed(sim); /* a wheel that still turns is caught as it turns */
    }
    state->state = CIA402_OPERATION_ENABLED;
}

static void quick_stop(drive_sim_t *sim) {
    if (canopen_number(sim, OBJECT_QUICK_STOP_OPTION) == 0) {
        release(sim, CIA402_SWITCH_ON_DISABLED);
        return;
    }
    sim->state.cia402.state = CIA402_QUICK_STOP_ACTIVE;
    sim->state.cia402.stand_us = INT64_MAX;
}

static void reset_fault(drive_sim_t *sim) {
    drive_sim_cia402_state_t *state = &sim->state.cia402;
    if (state->state == CIA402_FAULT) {
        state->state = CIA402_SWITCH_ON_DISABLED;
        state->objects[OBJECT_ERROR_CODE] = 0;
        canopen_check_errors(sim);
    }
}

/* Bit 1 clear, or bit 2 clear, in a state in which nothing has to be braked. */
static bool leave(drive_sim_t *sim) {
    switch (sim->state.cia402.state) {
    case CIA402_READY_TO_SWITCH_ON:
    case CIA402_SWITCHED_ON:
        sim->state.cia402.state = CIA402_SWITCH_ON_DISABLED;
        return true;
    default:
        return false;
    }
}

static void disable_voltage(drive_sim_t *sim) {
    const cia402_state_t state = sim->state.cia402.state;
    if (!leave(sim) && (state == CIA402_OPERATION_ENABLED || state == CIA402_QUICK_STOP_ACTIVE)) {
        release(sim, CIA402_SWITCH_ON_DISABLED);
    }
}

static void shut_down(drive_sim_t *sim) {
    switch (sim->state.cia402.state) {
    case CIA402_SWITCH_ON_DISABLED:
    case CIA402_SWITCHED_ON:
    case CIA402_OPERATION_ENABLED:
        release(sim, CIA402_READY_TO_SWITCH_ON);
        return;
    default:
        return;
    }
}

static void switch_on(drive_sim_t *sim, bool operation) {
    drive_sim_cia402_state_t *state = &sim->state.cia402;
    if (state->state == CIA402_READY_TO_SWITCH_ON) {
        state->state = CIA402_SWITCHED_ON;
    }
    if (!operation) {
        if (state->state == CIA402_OPERATION_ENABLED) {
            release(sim, CIA402_SWITCHED_ON);
        }
    } else if (state->state == CIA402_SWITCHED_ON ||
               (state->state == CIA402_QUICK_STOP_ACTIVE && !stops_by_itself(sim))) {
        enable(sim);
    }
}

static void obey(drive_sim_t *sim, uint32_t word) {
    if ((word & ENABLE_VOLTAGE) == 0) {
        disable_voltage(sim);
    } else if ((word & NO_QUICK_STOP) == 0) {
        if (!leave(sim) && sim->state.cia402.state == CIA402_OPERATION_ENABLED) {
            quick_stop(sim);
        }
    } else if ((word & SWITCH_ON) == 0) {
        shut_down(sim);
    } else {
        switch_on(sim, (word & ENABLE_OPERATION) != 0);
    }
}

void cia402_written(drive_sim_t *sim, canopen_object_t object) {
    drive_sim_cia402_state_t *state = &sim->state.cia402;
    if (object == OBJECT_CONTROLWORD) {
        const uint32_t word = state->objects[OBJECT_CONTROLWORD];
        const uint32_t before = state->controlword;
        state->controlword = word;
        if ((word & FAULT_RESET) == 0) {
            obey(sim, word);
        } else if ((before & FAULT_RESET) == 0) {
            reset_fault(sim);
        }
    } else if (object == OBJECT_TARGET_VELOCITY && has_mode(sim) &&
               state->state == CIA402_OPERATION_ENABLED) {
        sim->counters.commands++;
    }
}

/* Faults. */

static bool faulty(const drive_sim_t *sim) {
    const cia402_state_t state = sim->state.cia402.state;
    return state == CIA402_FAULT || state == CIA402_FAULT_REACTION_ACTIVE;
}

void cia402_fault(drive_sim_t *sim, uint16_t code) {
    drive_sim_cia402_state_t *state = &sim->state.cia402;
    state->objects[OBJECT_ERROR_CODE] = code;
    if (cia402_enabled(sim) && !faulty(sim) && canopen_number(sim, OBJECT_FAULT_OPTION) != 0) {
        state->state = CIA402_FAULT_REACTION_ACTIVE;
        state->stand_us = INT64_MAX;
    } else if (!faulty(sim)) {
        release(sim, CIA402_FAULT);
    }
    canopen_emergency(sim, code);
}

bool cia402_connection_lost(drive_sim_t *sim, uint16_t code) {
    if (!cia402_enabled(sim) || faulty(sim)) {
        return false;
    }
    switch (canopen_number(sim, OBJECT_ABORT_CONNECTION)) {
    case 1:
        cia402_fault(sim, code);
        return true;
    case 2:
        disable_voltage(sim);
        return false;
    case 3:
        if (sim->state.cia402.state == CIA402_OPERATION_ENABLED) {
            quick_stop(sim);
        }
        return false;
    default:
        return false;
    }
}

/* The generic bit, and one for what the error code's class is about. */
uint8_t cia402_error_register(const drive_sim_t *sim) {
    if (!faulty(sim)) {
        return 0;
    }
    switch (sim->state.cia402.objects[OBJECT_ERROR_CODE] >> 12) {
    case 0x2:
        return 0x03; /* current */
    case 0x3:
        return 0x05; /* voltage */
    case 0x4:
        return 0x09; /* temperature */
    case 0x8:
        return 0x11; /* communication */
    default:
        return 0x01;
    }
}

/* Feedback. */

static uint32_t status_of_mode(const drive_sim_t *sim) {
    const drive_sim_cia402_state_t *state = &sim->state.cia402;
    if (state->state == CIA402_QUICK_STOP_ACTIVE) {
        return state->setpoint == 0.0 && stands(sim) ? TARGET_REACHED : 0;
    }
    if (state->state != CIA402_OPERATION_ENABLED) {
        return 0;
    }
    switch (canopen_number(sim, OBJECT_MODE)) {
    case PROFILE_VELOCITY: {
        const double window = (double)canopen_number(sim, OBJECT_VELOCITY_WINDOW);
        const uint32_t reached = fabs(aim(sim) - speed(sim)) <= window ? TARGET_REACHED : 0;
        return reached | (stands(sim) ? MODE_BIT_12 : 0);
    }
    case CYCLIC_VELOCITY:
        return halted(sim) ? 0 : MODE_BIT_12;
    default:
        return 0;
    }
}

static uint32_t statusword(const drive_sim_t *sim) {
    const drive_sim_cia402_state_t *state = &sim->state.cia402;
    if (state->state == CIA402_NOT_READY_TO_SWITCH_ON) {
        return patterns[CIA402_NOT_READY_TO_SWITCH_ON];
    }
    const bool warning = state->objects[OBJECT_ERROR_REGISTER] != 0 && !faulty(sim);
    return patterns[state->state] | VOLTAGE_ENABLED | REMOTE | (warning ? WARNING : 0u) |
           status_of_mode(sim);
}

static uint32_t saturated(double value) {
    const double whole = isnan(value) ? 0.0 : round(value);
    return (uint32_t)(int32_t)fmin(fmax(whole, -2147483648.0), 2147483647.0);
}

void cia402_refresh(drive_sim_t *sim) {
    uint32_t *values = sim->state.cia402.objects;
    canopen_check_errors(sim);
    values[OBJECT_STATUSWORD] = statusword(sim);
    values[OBJECT_MODE_DISPLAY] = values[OBJECT_MODE];
    values[OBJECT_POSITION] =
        (uint32_t)drive_sim_wrap(sim->motor_turns * sim->config.counts_per_turn);
    values[OBJECT_VELOCITY] = saturated(speed(sim));
    values[OBJECT_VELOCITY_DEMAND] = saturated(sim->state.cia402.setpoint);
}
