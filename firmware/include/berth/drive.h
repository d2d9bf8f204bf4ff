/* berth/drive.h - one wheel's motor controller on the bus, whatever protocol it speaks.
 *
 *     berth_drive_init(&drive, &config, &refusal);
 *     berth_drive_enable(&drive, now_us);                until status->state is ENABLED
 *     each control period: berth_drive_command, berth_drive_cycle, and once for all drives of one
 *         protocol berth_drive_sync
 *     for each frame received: berth_drive_receive
 *     at or after berth_drive_deadline: berth_drive_step
 *
 * A drive is a passive state machine: frames and time in, frames (into an outbox) and the next
 * deadline out. It owns no clock and does no I/O. All state is in the caller's struct. Calls for
 * one drive belong to one context; none may come from an interrupt while another runs.
 *
 * Speeds and angles are the wheel's, in rad and rad/s, positive forward; gear, sign and units of
 * the motor side are the configuration's. What does not fit a frame saturates and is counted, it
 * never wraps. A frame of this drive's with a wrong length, type or value is counted and changes
 * nothing.
 *
 * Safety: only an ENABLED drive is commanded a speed other than zero. A fault is kept, with its
 * reason, until berth_drive_reset; a faulty drive is commanded to stop for as long as it hears. The
 * drive's own watchdog (each protocol's header says which) stops the wheel when the bus is lost.
 */
#ifndef BERTH_DRIVE_H
#define BERTH_DRIVE_H

#include "berth/outbox.h"
#include "berth/result.h"
#include "berth/types.h"
#include "berth_hal/can.h"

/* MISRA D12 in this file. */

#ifdef __cplusplus
extern "C" {
#endif

typedef enum {
    BERTH_DRIVE_OFF = 0,      /* nothing is asked of it; it holds no torque, as far as we know */
    BERTH_DRIVE_STARTING = 1, /* being configured and enabled */
    BERTH_DRIVE_ENABLED = 2,  /* obeys speed commands */
    BERTH_DRIVE_STOPPED = 3,  /* quick stop: commanded to stand until disabled or enabled anew */
    BERTH_DRIVE_FAULT = 4     /* see fault; left by berth_drive_reset */
} berth_drive_state_t;

typedef enum {
    BERTH_DRIVE_FAULT_NONE = 0,
    BERTH_DRIVE_FAULT_FEEDBACK = 1,  /* no speed feedback within feedback_timeout_us */
    BERTH_DRIVE_FAULT_HEARTBEAT = 2, /* no heartbeat (or status) within heartbeat_timeout_us */
    BERTH_DRIVE_FAULT_DEVICE = 3,    /* the drive reports an error; code is the drive's own */
    BERTH_DRIVE_FAULT_DISABLED = 4,  /* the drive left its enabled state unasked; code: its state */
    BERTH_DRIVE_FAULT_ENABLE = 5,    /* not enabled within enable_timeout_us; code: step reached */
    BERTH_DRIVE_FAULT_SETUP = 6,     /* the drive refused a setting; code: SDO abort code */
    BERTH_DRIVE_FAULT_SETUP_SILENT = 7, /* no answer to a setting; code: object index << 8 | sub */
    BERTH_DRIVE_FAULT_EMERGENCY = 8, /* the drive sent an emergency message; code: its error code */
    BERTH_DRIVE_FAULT_COUNT
} berth_drive_fault_t;

typedef struct berth_drive berth_drive_t;

/* What a protocol provides; berth_drive_* call it. Private to the drive modules. */
typedef struct berth_drive_protocol berth_drive_protocol_t;

extern const berth_drive_protocol_t berth_drive_odrive; /* drive_odrive.h */
extern const berth_drive_protocol_t berth_drive_vesc;   /* drive_vesc.h */
extern const berth_drive_protocol_t berth_drive_cia402; /* drive_cia402.h */

typedef struct {
    const berth_drive_protocol_t *protocol; /* only what is named here gets linked */
    uint8_t node;                           /* odrive 0 to 62, vesc 0 to 254, cia402 1 to 127 */
    int8_t sign;      /* +1, or -1 where the motor turns backwards for forward */
    float gear_ratio; /* motor turns per wheel turn: 0.001 to 1000 */

    uint8_t pole_pairs; /* vesc: of the motor, 1 to 100 */

    uint8_t mode;                 /* cia402: 3 profile velocity, 9 cyclic synchronous velocity */
    uint8_t master_node;          /* cia402: our own node number, 1 to 127, not a drive's */
    bool has_position;            /* cia402: the drive maps 0x6064 */
    uint32_t counts_per_turn;     /* cia402: of 0x6064, per motor turn: 1 to 16777216 */
    float velocity_units_per_rps; /* cia402: of 0x60FF and 0x606C, per motor turn/s: 1e-3 to 1e8;
                                     60 where they are in rpm, counts_per_turn in counts/s */

    uint32_t period_us;            /* control period: how often berth_drive_cycle comes */
    uint32_t feedback_timeout_us;  /* 1000 to 10000000 */
    uint32_t heartbeat_timeout_us; /* 1000 to 10000000 */
    uint32_t enable_timeout_us;    /* 1000 to 60000000 */
} berth_drive_config_t;

typedef struct {
    berth_drive_state_t state;
    berth_drive_fault_t fault;
    uint32_t code;        /* see berth_drive_fault_t */
    float velocity_radps; /* last measured */
    int64_t feedback_us;  /* when it was measured; -1: never since enabled */
    int64_t heartbeat_us; /* when the drive last gave a sign of life; -1: never since enabled */
    bool position_used;   /* travel comes from a position, else from the speed alone */
    uint32_t received;    /* good frames from this drive */
    uint32_t malformed;   /* frames from this drive with a wrong length, type or value, and
                             positions that jumped: see berth_drive_travel */
    uint32_t saturated;   /* commands beyond what the frame or the drive's range can hold */
    uint32_t refused;     /* commands that were not finite: taken as zero */
} berth_drive_status_t;

/* Protocol states. Private to the drive modules; here so that the caller owns the memory. */
typedef struct {
    uint8_t step;
    uint8_t axis_state; /* last told by the heartbeat */
    uint32_t error;     /* last told by the heartbeat */
    bool stopped_hard;  /* the emergency stop message was sent since enabling */
    float turns;        /* last position */
    int64_t asked_us;   /* when the axis was first asked to enable; INT64_MAX: not yet */
    int64_t retry_us;   /* when to do the next step */
} berth_drive_odrive_state_t;

typedef struct {
    uint32_t tachometer; /* last */
} berth_drive_vesc_state_t;

typedef struct {
    uint8_t stage;     /* of enabling */
    uint8_t request;   /* of the set-up: which one */
    uint8_t tries;     /* of the present request */
    uint8_t nmt_state; /* last told by the heartbeat */
    bool waiting;      /* for an answer to the present request */
    bool told;         /* there has been a statusword since the node was started */
    bool healthy;      /* and one without a fault */
    bool asked;        /* operation has been enabled by us */
    bool mode_told;    /* by the drive, and it is the one that we want */
    bool edge;         /* the fault reset bit is set */
    bool emergency;    /* take the torque off once the wheel stands */
    bool let_go;       /* it does, after an emergency stop */
    uint16_t statusword;
    uint16_t error_code; /* of the last emergency message, 0 when all errors are gone */
    uint32_t counts;     /* last position */
    uint8_t syncs;       /* still to come in this period */
    int64_t sync_us;     /* when the next of them is due */
    int64_t due_us;      /* when to try again */
} berth_drive_cia402_state_t;

struct berth_drive {
    berth_drive_config_t config;
    berth_drive_status_t status;
    float motor_turns_per_rad; /* sign * gear_ratio / (2 pi) */
    float command_radps;
    float travel_rad;    /* since it was last taken */
    float gap_rad;       /* measured position less the one that travel tells */
    float fastest_radps; /* since the last position */
    int64_t travel_us;   /* time that travel_rad stands for; -1: no feedback yet */
    int64_t position_us; /* time of the last position, where position_used */
    int64_t enabling_us; /* when enabling began */
    bool released;       /* told to take the torque off, and not enabled since */
    union {
        berth_drive_cia402_state_t cia402; /* the largest first: that is what init zeroes */
        berth_drive_odrive_state_t odrive;
        berth_drive_vesc_state_t vesc;
    } state;
};

/* Validates the configuration and sets the drive up, OFF. Returns BERTH_OK, BERTH_ERROR_ARGUMENT (a
 * missing pointer or protocol) or BERTH_ERROR_CONFIG with *refusal filled (index left to the
 * caller). */
BERTH_MUST_USE berth_error_t berth_drive_init(berth_drive_t *drive,
                                              const berth_drive_config_t *config,
                                              berth_refusal_t *refusal);

/* Begins to configure and enable the drive: OFF or STOPPED become STARTING. In other states nothing
 * happens. The command is zero until berth_drive_command. now_us: 0 to BERTH_TIME_MAX_US, here and
 * below. */
/*@ requires time: 0 <= now_us <= BERTH_TIME_MAX_US; */
void berth_drive_enable(berth_drive_t *drive, int64_t now_us);

/* Takes the torque off: frames that tell the drive so, and OFF. A fault stays a fault. */
void berth_drive_disable(berth_drive_t *drive, berth_outbox_t *outbox);

/* Quick stop at once: puts the frames that stop this wheel by the protocol's own means, and keeps
 * it stopped (cycle goes on saying so) until disabled or enabled anew. STARTING and ENABLED become
 * STOPPED; FAULT stays FAULT; OFF stays OFF, but the frames are put all the same. */
void berth_drive_stop(berth_drive_t *drive, berth_outbox_t *outbox);

/* Emergency stop: as berth_drive_stop, by the hardest means that the protocol has (for odrive the
 * emergency stop message, which the drive itself keeps until its errors are cleared). */
void berth_drive_emergency_stop(berth_drive_t *drive, berth_outbox_t *outbox);

/* Forgets a fault: FAULT becomes OFF. The next enabling clears the errors in the drive itself. */
void berth_drive_reset(berth_drive_t *drive);

/* The wheel's speed from the next cycle on. A value that is not finite counts as zero, and is
 * counted. */
void berth_drive_command(berth_drive_t *drive, float wheel_radps);

/* Puts this period's command frame. OFF puts nothing, and every state but ENABLED commands zero.
 * Call it once a control period: the drives' own watchdogs live on it. */
/*@ requires time: 0 <= now_us <= BERTH_TIME_MAX_US; */
void berth_drive_cycle(berth_drive_t *drive, int64_t now_us, berth_outbox_t *outbox);

/* Puts what one period's commands of all drives share: SYNC and our heartbeat for cia402, nothing
 * for the others. Once a period, after the cycles, with any one of the drives. */
/*@ requires time: 0 <= now_us <= BERTH_TIME_MAX_US; */
void berth_drive_sync(const berth_drive_t *drive, int64_t now_us, berth_outbox_t *outbox);

/* Takes a received frame. at_us: when it was on the wire, which may be earlier than the last step.
 * True when it was this drive's, good or not. */
/*@ requires time: 0 <= at_us <= BERTH_TIME_MAX_US; */
bool berth_drive_receive(berth_drive_t *drive, const berth_can_frame_t *frame, int64_t at_us);

/* Runs timers: set-up, watchdogs. Call it at or after the deadline; earlier does no harm. */
/*@ requires time: 0 <= now_us <= BERTH_TIME_MAX_US; */
void berth_drive_step(berth_drive_t *drive, int64_t now_us, berth_outbox_t *outbox);

/* When berth_drive_step has something to do; BERTH_TIME_MAX_US when nothing is pending. */
int64_t berth_drive_deadline(const berth_drive_t *drive);

/* The wheel's travel in rad from the last call until now_us, and takes it. Up to the last feedback
 * it is measured; from there on it is extrapolated with the last speed, for feedback_timeout_us at
 * most, and the next feedback corrects it. 0 before the first feedback after enabling.
 *
 * Where the drive tells a position, no error adds up: the sum of all travel is the wheel's angle
 * within two steps of the position, one for either end. In between the speeds count, taken to
 * change evenly from one to the next. A position that is further from there than the speeds can
 * explain (a quarter of a motor turn, 50 ms at the highest speed since, and 250 turns/s^2 over the
 * time since the last position, 1 s at most) is no travel: it is counted as malformed, the speeds
 * alone tell the way up to it, and later positions count from there. */
/*@ requires time: 0 <= now_us <= BERTH_TIME_MAX_US; */
float berth_drive_travel(berth_drive_t *drive, int64_t now_us);

/* What was last known of the drive. Valid until the next call. */
const berth_drive_status_t *berth_drive_status(const berth_drive_t *drive);

/* The receive filters for this drive's frames, at most BERTH_DRIVE_FILTERS_MAX. Returns how many.
 */
#define BERTH_DRIVE_FILTERS_MAX 8u
uint32_t berth_drive_filters(const berth_drive_t *drive,
                             berth_can_filter_t filters[BERTH_DRIVE_FILTERS_MAX]);

/* Short English texts; "?" outside the enum. */
const char *berth_drive_state_text(berth_drive_state_t state);
const char *berth_drive_fault_text(berth_drive_fault_t fault);

#ifdef __cplusplus
}
#endif

#endif
