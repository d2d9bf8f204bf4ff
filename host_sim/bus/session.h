/* A board and a robot on one bus, in one process and in virtual time: what two processes on vcan do
 * in real time, as fast as the computer can and the same each time.
 *
 * The board is the firmware as it is, with link.h around it; the bus is hal/loop's. The session
 * operates the board as a person would: arm, wait until it is armed, start, and when the robot has
 * seen the whole run, stop, until it is idle. When the board goes into fault it waits for the
 * wheels to stand.
 */
#ifndef HOST_SIM_BUS_SESSION_H
#define HOST_SIM_BUS_SESSION_H

#include "berth/board.h"
#include "berth/link.h"
#include "bus_setup.h"
#include "can_loop.h"
#include "record.h"
#include "robot.h"

/* Nodes of the bus. */
#define SESSION_NODE_BOARD 0
#define SESSION_NODE_ROBOT 1

/* Virtual time at which a session begins. */
#define SESSION_BEGIN_US 1000000

/* What takes part. */
typedef struct {
    can_loop_t loop;
    berth_board_t board;
    berth_constrained_t workspace; /* used where the scenario asks for it */
    berth_can_t can;               /* the board's bus; prepare may put another one around it */
    berth_link_t link;
    bus_robot_t *robot;
    berth_can_t robot_can;
} session_parts_t;

/* A board that is not in this process: at the other end of a line, say. It is set up alike: the one
 * in parts is given to begin to compare with, and mirrors it from there on: nothing but its status'
 * state and fault is kept up to date, and by end all that a session's result has. Frames go through
 * parts->can. Each call returns when the board has done it; false: it is lost, and end says why. */
typedef struct {
    bool (*begin)(void *context, session_parts_t *parts, int64_t now_us);
    bool (*set_pose)(void *context, const berth_pose_t *pose, int64_t now_us);
    bool (*command)(void *context, berth_command_code_t code, int64_t now_us);
    bool (*run)(void *context, int64_t now_us); /* as berth_link_run */
    int64_t (*deadline)(const void *context);   /* as berth_link_deadline */
    bool (*end)(void *context, scenario_error_t *error);
} session_remote_api_t;

typedef struct {
    const session_remote_api_t *api;
    void *context;
} session_remote_t;

typedef struct {
    const scenario_t *scenario;
    const run_plan_t *plan;
    uint64_t seed;
    const bus_setup_t *setup;
    const berth_board_config_t *board; /* NULL: bus_setup_board_config's */
    const session_remote_t *remote;    /* the board is that one; NULL: in this process. Not with
                                          record */
    const run_sink_t *sink;            /* gets the rows; may be NULL */
    record_t *record; /* open, with the set-up in it: gets what the board is told and does. NULL:
                         none. Not with a board configuration of one's own, nor with commands of
                         instant's: it would not tell of them */

    /* For tests. Both may be NULL. prepare is called when all is set up and time has not begun: to
     * order faults of drives and frames, observe the bus, attach more nodes, wrap the board's bus.
     * instant is called after all that happens at an instant is done: to send commands, take the
     * bus down. */
    void (*prepare)(void *context, session_parts_t *parts);
    void (*instant)(void *context, session_parts_t *parts, int64_t now_us);
    void *context;
} session_config_t;

typedef enum {
    SESSION_IDLE,      /* the board is idle again after the stop: all went as it should */
    SESSION_FAULT,     /* the board is in fault, and the wheels stand */
    SESSION_NOT_ARMED, /* it has never got ready */
    SESSION_OVERTIME,  /* it should have been over by now: something does not stop */
} session_end_t;

typedef struct {
    session_end_t end;
    int64_t armed_us, started_us; /* since the session's begin; -1: never */
    int64_t end_us;
    bus_robot_result_t robot; /* with the run's summary */
    berth_board_status_t board;
    berth_drive_status_t drives[2];
    uint32_t outbox_dropped;       /* frames of the board without room */
    uint32_t send_again, failures; /* of link.h */
    can_loop_counters_t nodes[2];  /* board, robot */
    uint64_t frames;               /* on the wire, without error */
    double load, load_peak;        /* of the bus from the start to the stop: mean, and the largest
                                      of 100 ms */
    double wall_s;
} session_result_t;

/* Frames that somebody wanted to send and that were not sent, or that came and were not fetched. */
unsigned long session_dropped(const session_result_t *result);

/* The whole run was done without touching anything, and the board went back to idle. */
bool session_good(const session_result_t *result);

/* "idle", "fault", ... */
const char *session_end_text(session_end_t end);

/* Runs one session. Without pose fixes the board is told where the robot was put. False, with
 * *error filled, when the board or the robot refuses its configuration, or a remote board is lost.
 */
bool session_run(const session_config_t *config, session_result_t *result, scenario_error_t *error);

#endif
