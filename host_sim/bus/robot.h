/* The robot as the other side of the bus: two wheel drives, the plant that they move, a
 * localisation that sends pose fixes, and an ear for what the board tells, from which the figures
 * of merit come.
 *
 * Passive, like the board: frames and time in, frames and the next deadline out. The plant is moved
 * lazily, from event to event, always with what the drives wanted at that time; a wheel whose drive
 * holds no torque runs out.
 *
 * The run begins when the board first says RUNNING. The time that its sample count stands for is
 * the zero of the reference, and is put right by later statuses that come less late; each period
 * from then on is a row, with the true pose at its start, the command that the wheels had at its
 * end, and the mode last told. It ends after the scenario's periods, or when the board leaves
 * RUNNING, or when no status comes any more.
 */
#ifndef HOST_SIM_BUS_ROBOT_H
#define HOST_SIM_BUS_ROBOT_H

#include "drive_sim.h"
#include "run.h"

typedef struct {
    const scenario_t *scenario; /* it and the plan outlive the robot */
    const berth_plan_t *plan;
    uint64_t seed; /* of the localisation's noise */
    drive_sim_config_t drives[2];
    uint8_t address;        /* of Berth's own frames */
    int64_t fix_period_us;  /* of pose fixes, from the start on; 0: none */
    int64_t fix_latency_us; /* from the measurement until the frame is sent: 0 to
                               BUS_ROBOT_LATENCY_PERIODS fix periods */
    int64_t silence_us;     /* without a status for so long the board counts as lost */
    bool announced;         /* tell the board the scenario's obstacles, over and over */
    double body_m;          /* their discs are so much smaller than their hard radii */
    const run_sink_t *sink; /* gets the rows; may be NULL */
} bus_robot_config_t;

#define BUS_ROBOT_FIX_PERIOD_US 100000
#define BUS_ROBOT_SILENCE_US 1000000
#define BUS_ROBOT_LATENCY_PERIODS 15

/* Obstacles are told so often, and stand for so long. */
#define BUS_ROBOT_ANNOUNCE_US 200000
#define BUS_ROBOT_ANNOUNCE_TTL_MS 1000

/* How far the run is. */
typedef enum {
    BUS_ROBOT_WAITING, /* the board has not said RUNNING yet */
    BUS_ROBOT_RUNNING,
    BUS_ROBOT_DONE,   /* all periods of the scenario */
    BUS_ROBOT_LEFT,   /* the board left RUNNING before */
    BUS_ROBOT_SILENT, /* no status any more */
} bus_robot_phase_t;

typedef struct {
    bus_robot_phase_t phase;
    run_summary_t summary; /* of the run */
    uint8_t state;         /* of the board, as last told: berth_supervisor_state_t */
    uint8_t fault;         /* berth_fault_t, as last told */
    uint8_t run_fault;     /* as told when the board left RUNNING */
    int64_t run_us;        /* when the reference began; -1: not yet */
    int64_t status_us;     /* when the last status came; -1: never */
    double clearance_m;    /* least since the robot was made, before and after the run too;
                              INFINITY without obstacles */
    double pose_error_m;   /* largest distance during the run between the pose that the board tells
                              and the true one when it tells it */
    double speed_mps;      /* true, now */
    unsigned long statuses, poses, errors; /* good ones, from the board */
    unsigned long malformed;               /* the board's frames that were not */
    unsigned long fixes, announcements;    /* frames put */
    unsigned long lost;                    /* of these, without room */
    drive_sim_counters_t drives[2];
} bus_robot_result_t;

/* "waiting", "running", "done", "left", "silent". */
const char *bus_robot_phase_text(bus_robot_phase_t phase);

typedef struct bus_robot bus_robot_t;

/* On the heap; the robot stands at the scenario's start. NULL with *error filled. */
bus_robot_t *bus_robot_create(const bus_robot_config_t *config, int64_t now_us,
                              scenario_error_t *error);
void bus_robot_destroy(bus_robot_t *robot);

/* A frame from the bus; frame->time_us is when it was on the wire. */
void bus_robot_receive(bus_robot_t *robot, const berth_can_frame_t *frame);

/* Runs what is due at now_us, each thing at its own time. */
void bus_robot_step(bus_robot_t *robot, int64_t now_us);

/* When bus_robot_step has something to do, at the latest. */
int64_t bus_robot_deadline(const bus_robot_t *robot);

/* The receive filters for all frames that such a robot wants. Returns how many. */
#define BUS_ROBOT_FILTERS_MAX 8u
uint32_t bus_robot_filters(const drive_sim_config_t drives[2], uint8_t address,
                           berth_can_filter_t filters[BUS_ROBOT_FILTERS_MAX]);

/* The frame to send next, or NULL; and the note that it has been sent. */
const berth_can_frame_t *bus_robot_front(bus_robot_t *robot);
void bus_robot_sent(bus_robot_t *robot);

/* Ends the run now, if it is under way (phase LEFT with the fault last told), and fills in the
 * result. */
void bus_robot_end(bus_robot_t *robot);

/* As of the last event. The summary is whole once the phase is DONE, LEFT or SILENT. */
const bus_robot_result_t *bus_robot_result(bus_robot_t *robot);

/* The true pose, as of the last event. */
berth_pose_t bus_robot_pose(const bus_robot_t *robot);

/* What the drives want the wheels to do, and what these do, rad/s, as of the last event. */
typedef struct {
    double wanted_radps[2]; /* left, right; 0 where a drive holds no torque */
    double speed_radps[2];
} bus_robot_wheels_t;
bus_robot_wheels_t bus_robot_wheels(const bus_robot_t *robot);

/* The speed limit that the drives were set up with, rad/s of the wheel: a command beyond it turns a
 * wheel no faster. 0: the motors' own. */
void bus_robot_limit(bus_robot_t *robot, double speed_max_radps);

/* Faults to order, each at its time; they happen in the order of their times. False: no room for
 * more than BUS_ROBOT_ORDERS_MAX. */
#define BUS_ROBOT_ORDERS_MAX 8
typedef struct {
    int64_t at_us;
    int side; /* BERTH_LEFT, BERTH_RIGHT */
    drive_sim_trouble_t trouble;
    uint32_t fail; /* not 0: the drive reports this error, and there is no other trouble */
} bus_robot_order_t;
bool bus_robot_order(bus_robot_t *robot, const bus_robot_order_t *order);

#endif
