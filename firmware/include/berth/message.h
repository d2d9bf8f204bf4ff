/* berth/message.h - Berth's own frames: commands, pose fixes and obstacles in; status, pose and
 * tracking error out. tools/berth.dbc describes the same frames for other tools.
 *
 * All are extended frames, little endian. id = kind << 8 | address, where the address (0 to 255)
 * tells one robot from another on the same bus. What comes in ranks before all else of ours on the
 * bus, what goes out ranks last.
 *
 * Encoding. Values are rounded to the nearest unit, exactly; a value half way between two goes to
 * the even one. What does not fit saturates. Signed fields keep their most negative number for what
 * is not finite, which no real value encodes to; where a field is unsigned, what is not finite
 * becomes the end that is safer to believe. So no value is ever turned into another harmless one.
 *
 * Decoding refuses a remote frame, a wrong length, what is not finite, and values out of range.
 * Each decoded float is the float32 nearest to the value that the frame stands for.
 *
 * Pure functions; any context may call them; constant cost, without floating-point division when
 * encoding.
 */
#ifndef BERTH_MESSAGE_H
#define BERTH_MESSAGE_H

#include "berth/types.h"
#include "berth_hal/can.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Kinds: the upper 21 bits of the id. */
#define BERTH_MESSAGE_COMMAND 0x04b200u  /* to the robot */
#define BERTH_MESSAGE_POSE_FIX 0x04b201u /* to the robot */
#define BERTH_MESSAGE_OBSTACLE 0x04b202u /* to the robot */
#define BERTH_MESSAGE_STATUS 0x18b200u   /* from the robot */
#define BERTH_MESSAGE_POSE 0x18b201u     /* from the robot */
#define BERTH_MESSAGE_ERROR 0x18b202u    /* from the robot */

/* Command, 2 bytes: uint8 command, uint8 its one's complement, so that no single wrong byte makes a
 * robot move. A number that is none of these encodes as NONE and is refused when decoded. */
typedef enum {
    BERTH_COMMAND_NONE = 0,
    BERTH_COMMAND_ARM = 1,            /* idle: start-up checks, enable the drives */
    BERTH_COMMAND_START = 2,          /* armed: follow the plan from its first sample */
    BERTH_COMMAND_STOP = 3,           /* come to a stand, take the torque off, idle */
    BERTH_COMMAND_EMERGENCY_STOP = 4, /* stop by the hardest means and stay in fault */
    BERTH_COMMAND_RESET = 5,          /* leave a fault whose cause is gone: idle */
    BERTH_COMMAND_COUNT
} berth_command_code_t;

/* Pose and pose fix, 8 bytes: x and y int24 in 0.1 mm, theta int16 in 0.1 mrad. theta is wrapped to
 * [-pi, pi) when encoded, and any heading of at most 3.1416 rad is good when decoded. A position
 * beyond BERTH_MESSAGE_POSITION_MAX_M saturates at 838.8607 m, which means "further out": a robot
 * must not take that for a place, so decoding refuses it. */
#define BERTH_MESSAGE_POSITION_MAX_M 838.8606f

/* Obstacle, 8 bytes: uint8 id, x and y int16 in cm, radius uint8 in cm (of the obstacle alone: the
 * robot adds its own body and regions, in which 13 mm are for the rounding of the three), uint16
 * time to live in ms, 0 to remove it at once. A position beyond BERTH_MESSAGE_OBSTACLE_MAX_M
 * saturates at 327.67 m and is refused when decoded. A radius below zero encodes as 0; above 2.55
 * m, or not finite, as 2.55 m: a larger obstacle takes several. */
#define BERTH_MESSAGE_OBSTACLE_MAX_M 327.66f
typedef struct {
    uint8_t id;
    float x_m;
    float y_m;
    float radius_m;
    uint16_t ttl_ms;
} berth_message_obstacle_t;

/* Status, 8 bytes: bits 0-3 supervisor state, 4-7 mode; uint8 fault; uint24 samples since the
 * start; bits 0-4 of byte 5 active obstacles (31: 31 or more), bit 5 finished, bit 6 braking, bit 7
 * a limit acted; uint16 clearance in mm (65535: no active obstacle; below zero or not finite: 0;
 * 65534: that or more). State and mode saturate at 15; decoding refuses those that are not in their
 * enums, and passes every fault, so that one that the reader does not know is still seen. */
typedef struct {
    uint8_t state;  /* berth_supervisor_state_t */
    uint8_t mode;   /* berth_mode_t */
    uint8_t fault;  /* berth_fault_t */
    uint32_t total; /* samples since the start, modulo 2^24 */
    uint8_t active; /* obstacles within their regulated radius */
    bool finished;
    bool braking;
    bool limited;
    float clearance_m; /* least d - R of the active obstacles. Encoded only when some are active;
                          decoded as -1 when the frame says that none is */
} berth_message_status_t;

/* Tracking error, 8 bytes: e1 and e2 int16 in mm, e3 int16 in 0.1 mrad and wrapped like theta,
 * int16 commanded speed in mm/s. 32.767 m and m/s stand for that or more. */
typedef struct {
    berth_tracking_error_t error;
    float v_mps;
} berth_message_error_t;

/* True when the frame has this kind and address. */
bool berth_message_is(const berth_can_frame_t *frame, uint32_t kind, uint8_t address);

/* Each fills the whole frame; its time becomes 0. kind: BERTH_MESSAGE_POSE or _POSE_FIX. */
void berth_message_encode_command(berth_can_frame_t *frame, uint8_t address,
                                  berth_command_code_t command);
void berth_message_encode_pose(berth_can_frame_t *frame, uint32_t kind, uint8_t address,
                               const berth_pose_t *pose);
void berth_message_encode_obstacle(berth_can_frame_t *frame, uint8_t address,
                                   const berth_message_obstacle_t *obstacle);
void berth_message_encode_status(berth_can_frame_t *frame, uint8_t address,
                                 const berth_message_status_t *status);
void berth_message_encode_error(berth_can_frame_t *frame, uint8_t address,
                                const berth_message_error_t *error);

/* False when the frame is malformed: *out is then as it was. The id is not looked at. */
bool berth_message_decode_command(const berth_can_frame_t *frame, berth_command_code_t *out);
bool berth_message_decode_pose(const berth_can_frame_t *frame, berth_pose_t *out);
bool berth_message_decode_obstacle(const berth_can_frame_t *frame, berth_message_obstacle_t *out);
bool berth_message_decode_status(const berth_can_frame_t *frame, berth_message_status_t *out);
bool berth_message_decode_error(const berth_can_frame_t *frame, berth_message_error_t *out);

#ifdef __cplusplus
}
#endif

#endif
