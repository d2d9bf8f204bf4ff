/* berth/supervisor.h - may the robot move? Idle, arming, armed, running, stopping, fault; and why
 * it stopped.
 *
 *     IDLE --arm--> ARMING --all checks good--> ARMED --start--> RUNNING --stop--> STOPPING -->
 * IDLE any state --something wrong, or emergency stop--> FAULT --reset, cause gone--> IDLE
 *
 * A pure state machine: the board tells it once a control period what it sees, and does what the
 * state says. In doubt it stops: every fault is kept with its reason, the first one wins, and only
 * a reset leaves it. One struct, one context; constant cost.
 */
#ifndef BERTH_SUPERVISOR_H
#define BERTH_SUPERVISOR_H

#include "berth/drive.h"
#include "berth/message.h"
#include "berth/result.h"
#include "berth/types.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum {
    BERTH_SUPERVISOR_IDLE = 0,     /* no torque */
    BERTH_SUPERVISOR_ARMING = 1,   /* drives are being enabled, start-up checks run */
    BERTH_SUPERVISOR_ARMED = 2,    /* stands under torque, ready to start */
    BERTH_SUPERVISOR_RUNNING = 3,  /* follows the plan */
    BERTH_SUPERVISOR_STOPPING = 4, /* comes to a stand, then idle */
    BERTH_SUPERVISOR_FAULT = 5     /* both wheels are commanded to stop; kept until reset */
} berth_supervisor_state_t;

/* Why. A drive's fault is BERTH_FAULT_LEFT or _RIGHT plus its berth_drive_fault_t. */
typedef enum {
    BERTH_FAULT_NONE = 0,
    BERTH_FAULT_EMERGENCY_STOP = 1, /* told to */
    BERTH_FAULT_CONTROLLER = 2,     /* the control step refused its input; see controller status */
    BERTH_FAULT_POSE_UNKNOWN = 3,   /* no pose, or none any more */
    BERTH_FAULT_POSE_AGE = 4,       /* no pose fix within fix_timeout_us */
    BERTH_FAULT_PERIOD = 5,         /* control steps came later than period_late_us */
    BERTH_FAULT_BUS_OFF = 6,        /* our CAN controller has withdrawn from the bus */
    BERTH_FAULT_BUS_DOWN = 7,       /* the CAN interface is down, unplugged or failing */
    BERTH_FAULT_TRANSMIT = 8,       /* frames did not leave within transmit_timeout_us */
    BERTH_FAULT_ARM_TIMEOUT = 9,    /* start-up checks not good within arm_timeout_us */
    BERTH_FAULT_STOP_TIMEOUT = 10,  /* wheels still turn stop_timeout_us after the stop */
    BERTH_FAULT_FOLLOWING = 11,     /* a wheel does not do what it is told: see following_* */
    BERTH_FAULT_PLAN = 12,          /* the plan has changed since it was checked */
    BERTH_FAULT_OBSTACLES = 13,     /* an obstacle from the bus found no room in the list */
    BERTH_FAULT_LEFT = 32,
    BERTH_FAULT_RIGHT = 64
} berth_fault_t;

typedef struct {
    uint32_t fix_timeout_us;      /* 0 (dead reckoning is allowed), or 1000 to 3600000000 */
    uint32_t period_late_us;      /* 1000 to 10000000: a control step later than this is a fault */
    uint32_t transmit_timeout_us; /* 1000 to 10000000 */
    uint32_t arm_timeout_us;      /* 1000 to 60000000 */
    uint32_t stop_timeout_us;     /* 1000 to 60000000 */
    float standing_radps;         /* a wheel below this stands: 0.001 to 10 */
    float following_radps;        /* 0 (off), or 0.01 to 1000: a wheel's speed may differ from its
                                     command by more than this for following_us at most */
    uint32_t following_us;        /* 1000 to 10000000 */
} berth_supervisor_config_t;

/* What the board sees in one period. */
typedef struct {
    bool drives_enabled; /* both */
    bool standing;       /* both wheels are measured to stand, or are known to be off */
    bool pose_known;
    int64_t fix_age_us;       /* INT64_MAX: no fix yet */
    int64_t late_us;          /* of this control step */
    int64_t transmit_wait_us; /* how long the oldest frame has waited to leave; 0: none waits */
    float following_radps;    /* largest |commanded - measured| of the two wheels */
    uint8_t problem;          /* berth_fault_t that a module reports, or BERTH_FAULT_NONE */
} berth_supervisor_inputs_t;

typedef struct {
    berth_supervisor_config_t config;
    berth_supervisor_state_t state;
    uint8_t fault;       /* berth_fault_t, kept until reset; BERTH_FAULT_NONE otherwise */
    int64_t since_us;    /* when the state began */
    int64_t followed_us; /* when the wheels last did as told */
    uint32_t faults;     /* faults since init */
    uint32_t refused;    /* commands that the state did not allow */
} berth_supervisor_t;

/* Validates the configuration; IDLE. Returns BERTH_OK or BERTH_ERROR_CONFIG with *refusal filled.
 */
BERTH_MUST_USE berth_error_t berth_supervisor_init(berth_supervisor_t *supervisor,
                                                   const berth_supervisor_config_t *config,
                                                   berth_refusal_t *refusal);

/* Takes a command. reset_allowed: the board sees no cause for a fault any more. A command that the
 * state does not allow is counted and changes nothing; STOP is allowed everywhere but in FAULT. */
/*@ requires time: 0 <= now_us <= BERTH_TIME_MAX_US; */
void berth_supervisor_command(berth_supervisor_t *supervisor, berth_command_code_t command,
                              bool reset_allowed, int64_t now_us);

/* One control period: looks for reasons to stop, and moves on. Returns the new state. */
/*@ requires time: 0 <= now_us <= BERTH_TIME_MAX_US; */
berth_supervisor_state_t berth_supervisor_step(berth_supervisor_t *supervisor,
                                               const berth_supervisor_inputs_t *inputs,
                                               int64_t now_us);

/* Reports a fault found between periods. The first one is kept. */
/*@ requires time: 0 <= now_us <= BERTH_TIME_MAX_US; */
void berth_supervisor_fail(berth_supervisor_t *supervisor, uint8_t fault, int64_t now_us);

/* Short English texts; "?" outside the enums. The text of a drive's fault names no side:
 * berth_fault_side_text gives "left drive: ", "right drive: " or "". */
const char *berth_supervisor_state_text(berth_supervisor_state_t state);
const char *berth_fault_text(uint8_t fault);
const char *berth_fault_side_text(uint8_t fault);

#ifdef __cplusplus
}
#endif

#endif
