#include "berth/supervisor.h"

#include "check.h"
#include "count.h"

/* MISRA D9 in this file. */

#define SECOND_US 1.0e6f

static bool check_time(berth_field_t field, uint32_t value_us, float maximum_us,
                       berth_refusal_t *refusal) {
    return check_value(field, (float)value_us, 1.0e3f, maximum_us, refusal);
}

berth_error_t berth_supervisor_init(berth_supervisor_t *supervisor,
                                    const berth_supervisor_config_t *config,
                                    berth_refusal_t *refusal) {
    const bool good =
        (config->fix_timeout_us == 0u || check_time(BERTH_FIELD_FIX_TIMEOUT, config->fix_timeout_us,
                                                    3600.0f * SECOND_US, refusal)) &&
        check_time(BERTH_FIELD_PERIOD_LATE, config->period_late_us, 10.0f * SECOND_US, refusal) &&
        check_time(BERTH_FIELD_TRANSMIT_TIMEOUT, config->transmit_timeout_us, 10.0f * SECOND_US,
                   refusal) &&
        check_time(BERTH_FIELD_ARM_TIMEOUT, config->arm_timeout_us, 60.0f * SECOND_US, refusal) &&
        check_time(BERTH_FIELD_STOP_TIMEOUT, config->stop_timeout_us, 60.0f * SECOND_US, refusal) &&
        check_value(BERTH_FIELD_STANDING, config->standing_radps, 0.001f, 10.0f, refusal) &&
        (config->following_radps == 0.0f ||
         check_value(BERTH_FIELD_FOLLOWING, config->following_radps, 0.01f, 1000.0f, refusal)) &&
        check_time(BERTH_FIELD_FOLLOWING_TIME, config->following_us, 10.0f * SECOND_US, refusal);
    if (!good) {
        return BERTH_ERROR_CONFIG;
    }
    *supervisor = (berth_supervisor_t){.config = *config, .state = BERTH_SUPERVISOR_IDLE};
    return BERTH_OK;
}

static void enter(berth_supervisor_t *supervisor, berth_supervisor_state_t state, int64_t now_us) {
    supervisor->state = state;
    supervisor->since_us = now_us;
    supervisor->followed_us = now_us;
}

void berth_supervisor_fail(berth_supervisor_t *supervisor, uint8_t fault, int64_t now_us) {
    if (supervisor->state != BERTH_SUPERVISOR_FAULT) {
        supervisor->fault = fault;
        count(&supervisor->faults);
        enter(supervisor, BERTH_SUPERVISOR_FAULT, now_us);
    }
}

/* Stop: from a moving robot by standing first; a standing one needs no more than to let go. */
static bool stop(berth_supervisor_t *supervisor, int64_t now_us) {
    switch (supervisor->state) {
    case BERTH_SUPERVISOR_ARMING:
    case BERTH_SUPERVISOR_ARMED:
        enter(supervisor, BERTH_SUPERVISOR_IDLE, now_us);
        return true;
    case BERTH_SUPERVISOR_RUNNING:
        enter(supervisor, BERTH_SUPERVISOR_STOPPING, now_us);
        return true;
    case BERTH_SUPERVISOR_IDLE:
    case BERTH_SUPERVISOR_STOPPING:
        return true; /* done, or being done */
    default:         /* FAULT */
        return false;
    }
}

static bool obey(berth_supervisor_t *supervisor, berth_command_code_t command, bool reset_allowed,
                 int64_t now_us) {
    const berth_supervisor_state_t state = supervisor->state;
    switch (command) {
    case BERTH_COMMAND_ARM:
        if (state != BERTH_SUPERVISOR_IDLE) {
            return false;
        }
        enter(supervisor, BERTH_SUPERVISOR_ARMING, now_us);
        return true;
    case BERTH_COMMAND_START:
        if (state != BERTH_SUPERVISOR_ARMED) {
            return false;
        }
        enter(supervisor, BERTH_SUPERVISOR_RUNNING, now_us);
        return true;
    case BERTH_COMMAND_STOP:
        return stop(supervisor, now_us);
    case BERTH_COMMAND_EMERGENCY_STOP:
        berth_supervisor_fail(supervisor, BERTH_FAULT_EMERGENCY_STOP, now_us);
        return true;
    case BERTH_COMMAND_RESET:
        if (state != BERTH_SUPERVISOR_FAULT || !reset_allowed) {
            return false;
        }
        supervisor->fault = BERTH_FAULT_NONE;
        enter(supervisor, BERTH_SUPERVISOR_IDLE, now_us);
        return true;
    default:
        return false;
    }
}

void berth_supervisor_command(berth_supervisor_t *supervisor, berth_command_code_t command,
                              bool reset_allowed, int64_t now_us) {
    if (!obey(supervisor, command, reset_allowed, now_us)) {
        count(&supervisor->refused);
    }
}

static bool fix_too_old(const berth_supervisor_t *supervisor,
                        const berth_supervisor_inputs_t *inputs) {
    return supervisor->config.fix_timeout_us > 0u &&
           inputs->fix_age_us > supervisor->config.fix_timeout_us;
}

/* What ends any state in which the drives hold torque. */
static uint8_t find_problem(const berth_supervisor_t *supervisor,
                            const berth_supervisor_inputs_t *inputs) {
    if (inputs->problem != BERTH_FAULT_NONE) {
        return inputs->problem;
    }
    if (inputs->late_us > supervisor->config.period_late_us) {
        return BERTH_FAULT_PERIOD;
    }
    if (inputs->transmit_wait_us > supervisor->config.transmit_timeout_us) {
        return BERTH_FAULT_TRANSMIT;
    }
    return BERTH_FAULT_NONE;
}

/* What ends the states in which the robot is about to move, or moves. */
static uint8_t find_lost_pose(const berth_supervisor_t *supervisor,
                              const berth_supervisor_inputs_t *inputs) {
    if (!inputs->pose_known) {
        return BERTH_FAULT_POSE_UNKNOWN;
    }
    return fix_too_old(supervisor, inputs) ? BERTH_FAULT_POSE_AGE : BERTH_FAULT_NONE;
}

static bool follows(berth_supervisor_t *supervisor, const berth_supervisor_inputs_t *inputs,
                    int64_t now_us) {
    const float most = supervisor->config.following_radps;
    if (most == 0.0f || inputs->following_radps <= most) {
        supervisor->followed_us = now_us;
    }
    return now_us - supervisor->followed_us <= supervisor->config.following_us;
}

static void step_arming(berth_supervisor_t *supervisor, const berth_supervisor_inputs_t *inputs,
                        int64_t now_us) {
    if (inputs->drives_enabled && inputs->standing &&
        find_lost_pose(supervisor, inputs) == BERTH_FAULT_NONE) {
        enter(supervisor, BERTH_SUPERVISOR_ARMED, now_us);
    } else if (now_us - supervisor->since_us > supervisor->config.arm_timeout_us) {
        berth_supervisor_fail(supervisor, BERTH_FAULT_ARM_TIMEOUT, now_us);
    } else {
        /* not yet, and there is time */
    }
}

static void step_ready(berth_supervisor_t *supervisor, const berth_supervisor_inputs_t *inputs,
                       int64_t now_us) {
    const uint8_t lost = find_lost_pose(supervisor, inputs);
    if (lost != BERTH_FAULT_NONE) {
        berth_supervisor_fail(supervisor, lost, now_us);
    } else if (!follows(supervisor, inputs, now_us)) {
        berth_supervisor_fail(supervisor, BERTH_FAULT_FOLLOWING, now_us);
    } else {
        /* nothing is amiss */
    }
}

static void step_stopping(berth_supervisor_t *supervisor, const berth_supervisor_inputs_t *inputs,
                          int64_t now_us) {
    if (inputs->standing) {
        enter(supervisor, BERTH_SUPERVISOR_IDLE, now_us);
    } else if (now_us - supervisor->since_us > supervisor->config.stop_timeout_us) {
        berth_supervisor_fail(supervisor, BERTH_FAULT_STOP_TIMEOUT, now_us);
    } else {
        /* not yet, and there is time */
    }
}

berth_supervisor_state_t berth_supervisor_step(berth_supervisor_t *supervisor,
                                               const berth_supervisor_inputs_t *inputs,
                                               int64_t now_us) {
    if (supervisor->state == BERTH_SUPERVISOR_IDLE || supervisor->state == BERTH_SUPERVISOR_FAULT) {
        return supervisor->state;
    }
    const uint8_t problem = find_problem(supervisor, inputs);
    if (problem != BERTH_FAULT_NONE) {
        berth_supervisor_fail(supervisor, problem, now_us);
    } else if (supervisor->state == BERTH_SUPERVISOR_ARMING) {
        step_arming(supervisor, inputs, now_us);
    } else if (supervisor->state == BERTH_SUPERVISOR_STOPPING) {
        step_stopping(supervisor, inputs, now_us);
    } else {
        step_ready(supervisor, inputs, now_us);
    }
    return supervisor->state;
}

const char *berth_supervisor_state_text(berth_supervisor_state_t state) {
    static const char *const texts[] = {"idle", "arming", "armed", "running", "stopping", "fault"};
    const unsigned number = (unsigned)state;
    return number < sizeof texts / sizeof texts[0] ? texts[number] : "?";
}

const char *berth_fault_text(uint8_t fault) {
    static const char *const texts[] = {
        "none",
        "emergency stop",
        "the controller refused its input",
        "the pose is not known",
        "no pose fix in time",
        "control step too late",
        "bus-off",
        "CAN interface down or failing",
        "frames do not leave in time",
        "not armed in time",
        "wheels still turn after the stop",
        "a wheel does not do what it is told",
        "the plan has changed since it was checked",
        "no room for an obstacle from the bus",
    };
    if (fault >= BERTH_FAULT_RIGHT) {
        return berth_drive_fault_text((berth_drive_fault_t)(fault - BERTH_FAULT_RIGHT));
    }
    if (fault >= BERTH_FAULT_LEFT) {
        return berth_drive_fault_text((berth_drive_fault_t)(fault - BERTH_FAULT_LEFT));
    }
    return fault < sizeof texts / sizeof texts[0] ? texts[fault] : "?";
}

const char *berth_fault_side_text(uint8_t fault) {
    if (fault >= BERTH_FAULT_RIGHT) {
        return "right drive: ";
    }
    return fault >= BERTH_FAULT_LEFT ? "left drive: " : "";
}
