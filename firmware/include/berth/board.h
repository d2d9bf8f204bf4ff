/* berth/board.h - the whole firmware of a drive board: frames and time in, frames and the next
 * deadline out.
 *
 *     berth_board_init(&board, &plan, &config, now_us, &refusal);
 *     berth_board_add_obstacle(&board, &obstacle, &refusal);       as often as needed
 *     berth_board_set_pose(&board, &pose, now_us);                 where the robot has been put
 *     then, in any order and as often as needed:
 *         berth_board_receive    each frame that the bus gives
 *         berth_board_bus        how the bus is
 *         berth_board_command    arm, start, stop, ... by a button or a program (the same commands
 *                                come as frames)
 *         berth_board_step       at berth_board_deadline, and after frames
 *         berth_board_front, berth_board_sent    frames to put on the bus
 *
 * link.h does the loop around it for any platform with a berth_can_t. The board owns no clock and
 * does no I/O, so the same calls give the same frames, on the target and on the desk.
 *
 * All state is in the caller's struct. All calls belong to one context (a task or one interrupt
 * level).
 *
 * Timing. Control steps are due each plan period from berth_board_init on. A step that comes late
 * is done once, late, and counted; steps are never made up for.
 * Times are 0 to BERTH_TIME_MAX_US. Another one, in whatever call, is a fault (BERTH_FAULT_PERIOD)
 * at the last good time, and the call does nothing else, but for an emergency stop.
 *
 * Safety. Whatever goes wrong, both wheels are commanded to stop in the same call that finds it
 * out, the reason is kept (berth_board_status), and nothing moves until a reset whose cause is
 * gone. In RUNNING each control step feeds the drives' own watchdogs; in FAULT zero speed does,
 * until the wheels stand, then the drives are told to take their torque off.
 */
#ifndef BERTH_BOARD_H
#define BERTH_BOARD_H

#include "berth/controller.h"
#include "berth/drive.h"
#include "berth/message.h"
#include "berth/odometry.h"
#include "berth/outbox.h"
#include "berth/supervisor.h"
#include "berth_hal/can.h"

#ifdef __cplusplus
extern "C" {
#endif

#define BERTH_LEFT 0
#define BERTH_RIGHT 1

/* How an obstacle from the bus, a disc, gets its regions. */
typedef struct {
    float body_m;         /* robot body and uncertainty, added to the disc for R: 0 to 100 */
    float conservative_m; /* C - R: at least what the clearance condition demands */
    float regulated_m;    /* G - C: at least the skirt */
} berth_board_regions_t;

typedef struct {
    berth_config_t controller;
    berth_drive_config_t drives[2];   /* left, right; period_us is set from the plan */
    berth_odometry_config_t odometry; /* wheels are set from controller.limits */
    berth_supervisor_config_t supervisor;
    berth_board_regions_t regions;
    uint8_t address;            /* in Berth's own frames: see message.h */
    uint16_t telemetry_periods; /* status, pose and error each so many periods; 0: never */
} berth_board_config_t;

/* Reasonable values for a robot with these wheels; fill in protocol, nodes and what differs. */
berth_board_config_t berth_board_config_default(float wheel_radius_m, float track_m,
                                                uint32_t period_us);

/* What is known of the board, for people and tests. */
typedef struct {
    berth_supervisor_state_t state;
    uint8_t fault; /* berth_fault_t */
    berth_can_mode_t bus;
    berth_pose_t pose; /* at the last control step */
    bool pose_known;
    berth_command_t command;    /* of the last control step */
    uint32_t steps;             /* control steps done */
    uint32_t late;              /* of these, later than half a period */
    uint32_t missed;            /* periods without a control step */
    int64_t latest_us;          /* the latest that a control step was */
    uint32_t received;          /* frames that were for us and good */
    uint32_t malformed;         /* frames that were for us and were not */
    uint32_t foreign;           /* frames that were for others */
    uint32_t commands_refused;  /* not allowed in the state that the board was in */
    uint32_t obstacles_refused; /* from the bus: out of range, or no room */
} berth_board_status_t;

typedef struct {
    berth_controller_t controller;
    berth_drive_t drives[2];
    berth_odometry_t odometry;
    berth_supervisor_t supervisor;
    berth_outbox_t outbox;
    berth_board_regions_t regions;
    berth_board_status_t status;
    int64_t tick_us;    /* when the next control step is due */
    int64_t last_us;    /* time of the last step */
    int64_t waiting_us; /* since when the front of the outbox waits; -1: none waits */
    uint32_t period_us;
    uint32_t plan_crc; /* of the plan as it was validated */
    uint16_t telemetry_periods;
    uint16_t telemetry_left;        /* periods until the next telemetry */
    berth_supervisor_state_t acted; /* the state that the drives have been told */
    uint8_t address;
    bool ready;      /* init succeeded */
    bool starting;   /* the controller starts in the next control step */
    bool bus_failed; /* the last send or receive answered FAILED */
    bool released;   /* the drives were told to take their torque off */
} berth_board_t;

/* Validates everything and sets the board up, IDLE, with no obstacles and no known pose. plan stays
 * referenced. now_us: 0 to BERTH_TIME_MAX_US; the first control step is due then.
 * Returns BERTH_OK; BERTH_ERROR_ARGUMENT; BERTH_ERROR_PLAN, BERTH_ERROR_CONFIG with *refusal filled
 * (index 0 left, 1 right for a drive's fields); BERTH_ERROR_TIME. After an error the board is
 * unusable: it puts no frames and takes no commands. Cost: O(plan->count). */
BERTH_MUST_USE berth_error_t berth_board_init(berth_board_t *board, const berth_plan_t *plan,
                                              const berth_board_config_t *config, int64_t now_us,
                                              berth_refusal_t *refusal);

/* As berth_controller_add_obstacle: an obstacle that stays. */
BERTH_MUST_USE berth_error_t berth_board_add_obstacle(berth_board_t *board,
                                                      const berth_obstacle_t *obstacle,
                                                      berth_refusal_t *refusal);

/* Where the robot is, when somebody has put it there; later pose fixes correct it. Returns
 * BERTH_OK, BERTH_ERROR_POSE, or BERTH_ERROR_STATE while the robot is RUNNING or STOPPING. */
BERTH_MUST_USE berth_error_t berth_board_set_pose(berth_board_t *board, const berth_pose_t *pose,
                                                  int64_t now_us);

/* A command from a button or a program on the board. Refused ones are counted. */
void berth_board_command(berth_board_t *board, berth_command_code_t command, int64_t now_us);

/* A frame from the bus. frame->time_us is taken as its time when it is within a second before
 * now_us, else now_us. Frames of others cost some 30 instructions. */
void berth_board_receive(berth_board_t *board, const berth_can_frame_t *frame, int64_t now_us);

/* How the bus is; failed: its last send or receive answered FAILED. */
void berth_board_bus(berth_board_t *board, berth_can_mode_t mode, bool failed, int64_t now_us);

/* Runs what is due: drives' timers, and the control step when its time has come. Calls before the
 * deadline do no harm. Time that goes backwards is a fault (BERTH_FAULT_PERIOD). */
void berth_board_step(berth_board_t *board, int64_t now_us);

/* When berth_board_step is to be called next, at the latest. */
int64_t berth_board_deadline(const berth_board_t *board);

/* The frame to send next, or NULL; and the note that it has been sent. */
const berth_can_frame_t *berth_board_front(const berth_board_t *board);
void berth_board_sent(berth_board_t *board, int64_t now_us);

/* Status of the board and of its parts; valid until the next call. */
const berth_board_status_t *berth_board_status(const berth_board_t *board);
const berth_status_t *berth_board_control(const berth_board_t *board);
const berth_drive_status_t *berth_board_drive(const berth_board_t *board, int side);

/* The receive filters for all frames that the board wants. Returns how many. */
#define BERTH_BOARD_FILTERS_MAX (2u * BERTH_DRIVE_FILTERS_MAX + 3u)
uint32_t berth_board_filters(const berth_board_t *board,
                             berth_can_filter_t filters[BERTH_BOARD_FILTERS_MAX]);

#ifdef __cplusplus
}
#endif

#endif
