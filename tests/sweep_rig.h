/* Runs one session (host_sim/bus/session.h) in which something goes wrong, and holds it against
 * what must come of it: never a collision; the robot carries on within bounds and ends idle, or
 * stops with a reason that is right for what went wrong; after a fault no command but zero leaves
 * the board; and no wheel obeys a command for longer than its drive's own watchdog allows.
 *
 * The scenario: the beginning of the circle experiment, at 0.3 m/s, with one obstacle in the way,
 * whose regions leave room for what a robot drives while nobody can tell it to stop:
 * C - R >= v_max (T + W), W being the drives' own watchdog. A robot on a bus needs that beyond the
 * clearance condition, which knows no lost frames. The drives have a speed limit of their own, 5 %
 * above what the board commands at most, as whoever sets them up should see to.
 */
#ifndef BERTH_TESTS_SWEEP_RIG_H
#define BERTH_TESTS_SWEEP_RIG_H

#include "can_fault.h"
#include "session.h"

#include <stdbool.h>
#include <stdint.h>

#define SWEEP_KINDS 3
#define SWEEP_PERIOD_US 50000
#define SWEEP_WATCHDOG_US 250000

/* Reasons, as a set: bit n is berth_fault_t n, and a drive's fault n, whichever side, is 32 + n. */
#define SWEEP_REASON(fault) (UINT64_C(1) << (fault))
#define SWEEP_DRIVE(fault) (UINT64_C(1) << (32 + (fault)))
#define SWEEP_LEFT 1u
#define SWEEP_RIGHT 2u

typedef struct sweep sweep_t;

/* A call of the HAL: which (CAN_FAULT_SEND, ...), how many of its kind came before it, and the
 * state that the board was in. */
typedef struct {
    uint8_t kind;
    uint8_t state;
    uint16_t before;
} sweep_call_t;

/* Something that happens at a time, counted from when the session begins. */
typedef struct {
    int64_t at_us;
    void (*act)(sweep_t *sweep, int64_t now_us);
} sweep_act_t;

#define SWEEP_ACTS_MAX 4
#define SWEEP_STRANGERS_MAX 2
#define SWEEP_CALLS_MAX 20000u
#define SWEEP_STRANGER 2 /* number of the first such node */

typedef struct {
    drive_sim_kind_t kind;

    /* What goes wrong. */
    can_fault_order_t call; /* calls 0: none */
    bool has_frame;
    uint64_t frame; /* index on the wire */
    can_loop_action_t action;
    bool flip;                   /* besides: one byte of it is altered, at random */
    bus_robot_order_t orders[2]; /* at_us from the session's begin; 0: none */
    sweep_act_t acts[SWEEP_ACTS_MAX];
    uint32_t tx_depth;  /* frames that the board's bus takes ahead; 0: as many as the loop can */
    uint32_t strangers; /* nodes to attach beside board and robot */
    int64_t flood_gap_us;
    void (*flood)(sweep_t *sweep, berth_can_frame_t *frame); /* what the first stranger sends */
    uint64_t seed;                                           /* of what the acts draw */
    float following_radps; /* as in berth_supervisor_config_t; 0: not watched */

    /* What may come of it. */
    bool may_stop, may_carry_on;
    bool may_run_out;     /* the last frame may have set a wheel going */
    bool may_misread;     /* the robot may take the run to be over earlier */
    uint64_t reasons;     /* of stopping */
    uint32_t sides;       /* 0: either; of a drive's fault */
    int64_t stop_us;      /* wheels stand so long after the board's fault */
    int64_t twitch_us;    /* after that time they turn no longer than this in all */
    int64_t wire_us;      /* what the bus had taken before may leave so long after the fault */
    int64_t obey_us;      /* longest time without a command while a wheel is to turn */
    double rms_m, peak_m; /* error beyond the undisturbed run's, when carrying on */
    double clearance_m;   /* at least */
} sweep_case_t;

/* What came of it. */
typedef struct {
    session_result_t result;
    bool carried_on;
    int64_t fault_us;        /* when the board went into fault, since the begin; -1: never */
    int64_t moved_us;        /* when a wheel turned last */
    int64_t twitch_us;       /* how long wheels turned after fault_us + stop_us */
    int64_t obeyed_us;       /* longest time without a command while a wheel was to turn */
    int64_t acted_us;        /* when the first act was done; -1: not */
    double way_m;            /* from then on */
    uint64_t calls;          /* of the HAL */
    uint64_t answered;       /* of these, by order */
    uint64_t frames;         /* started on the wire */
    uint32_t node;           /* sender of the frame that the case is about */
    berth_can_frame_t frame; /* and this itself, before anything was done to it */
    unsigned late_commands,
        late_wire; /* other than zero after the fault: at the HAL, on the wire */
} sweep_outcome_t;

struct sweep {
    const sweep_case_t *what;
    session_parts_t *parts;
    sweep_outcome_t *out;
    berth_can_t inner; /* what the tap is around */
    berth_can_t strangers[SWEEP_STRANGERS_MAX];
    can_fault_t fault;
    unsigned act;
    uint32_t of_kind[CAN_FAULT_ANY + 1];
    int64_t flooded_us;
    int64_t last_us;  /* time of the last look */
    int64_t flood_us; /* a flood goes on until then, since the session's begin */
    int64_t command_us[2];
    unsigned long commands[2];
    berth_pose_t last;
    uint64_t random;
    sweep_call_t *calls; /* SWEEP_CALLS_MAX of them; NULL: not wanted */
};

/* Scenario, plan and undisturbed runs: once for a program, before all else. */
void sweep_begin(double duration_s);
void sweep_end(void);

/* The undisturbed run of a kind. */
const sweep_outcome_t *sweep_plain(drive_sim_kind_t kind);
const char *sweep_kind_name(drive_sim_kind_t kind);

/* A case in which nothing goes wrong, with the usual bounds and no reason to stop. */
sweep_case_t sweep_case(drive_sim_kind_t kind);

/* The k-th of the undisturbed run's HAL calls; k below sweep_plain(kind)->calls. */
sweep_call_t sweep_call(drive_sim_kind_t kind, uint64_t k);

/* Runs a case, checks it and counts it. The first violations are printed with the case's name and
 * what was broken; sweep_report fails the test. */
void sweep_run(const sweep_case_t *what, const char *name, sweep_outcome_t *out);

/* The same without the checks. */
void sweep_try(const sweep_case_t *what, sweep_outcome_t *out);

/* A number below count, from the case's own stream. */
uint32_t sweep_random(sweep_t *sweep, uint32_t count);

/* Prints the counts since the last call under a title: cases, carried on, stopped by reason; and
 * fails the test if a case was not as it must be. */
void sweep_report(const char *title);

#endif
