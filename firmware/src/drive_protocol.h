/* What a protocol is to drive.c, and what drive.c does for all protocols. Private to firmware/src.
 */
#ifndef BERTH_SRC_DRIVE_PROTOCOL_H
#define BERTH_SRC_DRIVE_PROTOCOL_H

#include "berth/drive.h"
#include "bytes.h"

typedef enum {
    DRIVE_FRAME_FOREIGN = 0, /* not this drive's */
    DRIVE_FRAME_GOOD,
    DRIVE_FRAME_MALFORMED
} drive_frame_t;

/* Each function may assume a checked configuration. drive.c keeps status.state: protocols change it
 * by drive_enabled and drive_fail alone, and read it. */
struct berth_drive_protocol {
    /* Checks the fields that are this protocol's own, the node among them. */
    berth_error_t (*check)(const berth_drive_config_t *config, berth_refusal_t *refusal);
    /* Begins the set-up, and forgets what it must of drive->state. berth_drive_init zeroed that. */
    void (*enable)(berth_drive_t *drive, int64_t now_us);
    /* Puts frames: take the torque off; quick stop; emergency stop. */
    void (*disable)(berth_drive_t *drive, berth_outbox_t *outbox);
    void (*stop)(berth_drive_t *drive, berth_outbox_t *outbox);
    void (*emergency_stop)(berth_drive_t *drive, berth_outbox_t *outbox);
    /* Puts the period's command frame: drive_motor_rps while ENABLED, else what keeps the drive
     * stopped. Not called while OFF or released. */
    void (*cycle)(berth_drive_t *drive, int64_t now_us, berth_outbox_t *outbox);
    /* Puts what all drives of the protocol share; NULL: nothing. */
    void (*sync)(const berth_drive_t *drive, int64_t now_us, berth_outbox_t *outbox);
    drive_frame_t (*receive)(berth_drive_t *drive, const berth_can_frame_t *frame, int64_t at_us);
    /* Set-up and whatever else has timers; called in every state but OFF. deadline: when it has
     * something to do, BERTH_TIME_MAX_US for never. Watchdogs are drive.c's. */
    void (*step)(berth_drive_t *drive, int64_t now_us, berth_outbox_t *outbox);
    int64_t (*deadline)(const berth_drive_t *drive);
    uint32_t (*filters)(const berth_drive_t *drive, berth_can_filter_t *filters);
    /* Step reached, for the code of BERTH_DRIVE_FAULT_ENABLE. */
    uint32_t (*progress)(const berth_drive_t *drive);
};

/* The set-up is done: STARTING becomes ENABLED, once there has been feedback and a sign of life
 * since enabling began. Call it again and again until then. */
void drive_enabled(berth_drive_t *drive);

/* A fault; the first one is kept. OFF stays OFF. */
void drive_fail(berth_drive_t *drive, berth_drive_fault_t fault, uint32_t code);

/* A sign of life. */
void drive_alive(berth_drive_t *drive, int64_t at_us);

/* Measured speed of the motor, turns/s: |motor_rps| at most 1e9. A time before the last feedback's
 * counts as that time. */
void drive_velocity(berth_drive_t *drive, float motor_rps, int64_t at_us);

/* The motor has turned by this since the last position; of a first position it is not looked at.
 * quantum: what the drive's unit of position is in turns. Call it after drive_velocity when one
 * frame tells both. False: it has jumped, further than the speeds since the last position can
 * explain. Then the speed alone tells the travel up to here, and positions count from this one. */
bool drive_position(berth_drive_t *drive, float turned, float quantum, int64_t at_us);

/* There is no position any more; the next one will be a first one. */
void drive_position_lost(berth_drive_t *drive);

/* Commanded speed of the motor, turns/s: zero unless ENABLED. */
float drive_motor_rps(const berth_drive_t *drive);

/* To the nearest integer in [-limit, limit]; beyond it saturates and is counted. limit is at most
 * 2147483520, the largest float32 below 2^31. */
int32_t drive_to_int(berth_drive_t *drive, float value, float limit);

/* As it is, or the limit with its sign, which is counted. */
float drive_clamp(berth_drive_t *drive, float value, float limit);

/* A data frame without data yet. */
berth_can_frame_t drive_frame(uint32_t id, bool extended, uint8_t length);

/* True when the frame is a data frame of exactly this length. */
static inline bool drive_frame_has(const berth_can_frame_t *frame, uint8_t length) {
    return !frame->remote && frame->length == length;
}

/* The one check that most nodes need. */
berth_error_t drive_check_node(const berth_drive_config_t *config, float lowest, float highest,
                               berth_refusal_t *refusal);

#endif
