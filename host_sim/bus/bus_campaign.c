#include "bus_campaign.h"

#include "berth/message.h"
#include "berth/supervisor.h"
#include "rng.h"
#include "session.h"

#include <math.h>

/* Another stream than the scene's. */
#define FAULT_STREAM UINT64_C(0x6661756c7473)

#define KINDS 3u
#define NODE_STRANGER 2u
#define ARMING_S 1.5 /* about what a session takes beside the run */
#define LASTS_MAX_S 0.6
#define FOREVER_SHARE 0.3
#define LATE_MAX_US 100000.0
#define STANDING_MPS 0.01
/* By then the board has found out what is there to stay, and has stopped. */
#define FOUND_US 600000

/* Reasons, as a set: bit n is berth_fault_t n, and a drive's fault n is bit 32 + n. */
#define REASON(fault) (UINT64_C(1) << BERTH_FAULT_##fault)
#define DRIVE(fault) (UINT64_C(1) << (32 + BERTH_DRIVE_FAULT_##fault))
/* Neither side hears the other any more; the drive that stops by itself for that may say so. */
#define APART                                                                                      \
    (DRIVE(FEEDBACK) | DRIVE(HEARTBEAT) | DRIVE(ENABLE) | DRIVE(SETUP_SILENT) | REASON(TRANSMIT) | \
     REASON(ARM_TIMEOUT))
#define BY_ITSELF (DRIVE(DEVICE) | DRIVE(DISABLED) | DRIVE(EMERGENCY))
#define BOTH (APART | BY_ITSELF)

typedef struct run run_t;
typedef void (*act_t)(run_t *run);

typedef struct {
    const char *name;
    uint64_t reasons; /* of a stop */
    double frames;    /* largest share of the frames that it happens to; 0: happens at a time */
    bool lasts;       /* for a time drawn, or for ever */
    bool ends;        /* never for ever */
    bool stops;       /* while it is there to stay and the robot runs, the board must stop */
    bool drive;       /* happens to one of the drives */
    bool reported;    /* means nothing to a vesc, which does not tell */
    bool misread;     /* the simulated robot may take the run for over before it is */
    act_t begin, end;
} fault_t;

struct run {
    const bus_campaign_t *campaign;
    const scenario_t *scene;
    const fault_t *fault;
    campaign_row_t *row;
    session_parts_t *parts;
    berth_can_t stranger;
    rng_t rng;
    double share; /* of the frames */
    int side;
    int64_t begin_us, end_us; /* of the fault, in bus time; INT64_MAX: never */
    bool begun, ended;
    int64_t stop_us;  /* when the board went into fault; -1: not */
    int64_t moved_us; /* when the robot moved last */
};

/* --- what goes wrong ---------------------------------------------------------------------- */

static void cut_board(run_t *run) {
    can_loop_cut(&run->parts->loop, SESSION_NODE_BOARD, !run->begun);
}

static void cut_robot(run_t *run) {
    can_loop_cut(&run->parts->loop, SESSION_NODE_ROBOT, !run->begun);
}

static void board_off(run_t *run) {
    can_loop_bus_off(&run->parts->loop, SESSION_NODE_BOARD);
}

static void board_recovers(run_t *run) {
    can_loop_recover(&run->parts->loop, SESSION_NODE_BOARD);
}

static void robot_off(run_t *run) {
    can_loop_bus_off(&run->parts->loop, SESSION_NODE_ROBOT);
}

static void robot_recovers(run_t *run) {
    can_loop_recover(&run->parts->loop, SESSION_NODE_ROBOT);
}

static void board_down(run_t *run) {
    can_loop_down(&run->parts->loop, SESSION_NODE_BOARD);
}

static void board_up(run_t *run) {
    can_loop_up(&run->parts->loop, SESSION_NODE_BOARD);
}

static void babble(run_t *run) {
    const berth_can_frame_t loud = {.id = 0x001, .length = 8};
    (void)can_loop_babble(&run->parts->loop, NODE_STRANGER, &loud, run->end_us);
}

static void stop_by_frame(run_t *run) {
    berth_can_frame_t frame;
    berth_message_encode_command(&frame, 0, BERTH_COMMAND_EMERGENCY_STOP);
    (void)run->stranger.api->send(run->stranger.context, &frame);
}

static void order(run_t *run, const bus_robot_order_t *what) {
    bus_robot_order_t when = *what;
    when.at_us = run->begin_us;
    when.side = run->side;
    (void)bus_robot_order(run->parts->robot, &when);
}

static void dead(run_t *run) {
    order(run, &(bus_robot_order_t){.trouble = {.dead = true}});
}

static void no_feedback(run_t *run) {
    order(run, &(bus_robot_order_t){.trouble = {.mute_feedback = true}});
}

static void no_heartbeat(run_t *run) {
    order(run, &(bus_robot_order_t){.trouble = {.mute_heartbeat = true}});
}

static void drive_error(run_t *run) {
    order(run, &(bus_robot_order_t){.fail = 0x2310});
}

static void rule(run_t *run, const can_loop_action_t *action) {
    const can_loop_rule_t often = {
        .node = CAN_LOOP_ANY_NODE, .probability = run->share, .action = *action};
    (void)can_loop_rule(&run->parts->loop, &often);
}

static void lose(run_t *run) {
    rule(run, &(can_loop_action_t){.deaf = CAN_LOOP_EVERYBODY});
}

static void hold_back(run_t *run) {
    const double late_us = rng_uniform(&run->rng, 1000.0, LATE_MAX_US);
    rule(run, &(can_loop_action_t){.delay_us = (int64_t)late_us});
}

static void repeat(run_t *run) {
    rule(run, &(can_loop_action_t){.copies = 1});
}

static void corrupt(run_t *run) {
    rule(run, &(can_loop_action_t){.corrupt = true});
}

static const fault_t no_fault = {.name = "none"};

static const fault_t faults[] = {
    {.name = "frames lost", .reasons = BOTH, .frames = 0.05, .begin = lose},
    {.name = "frames late", .reasons = BOTH, .frames = 0.05, .misread = true, .begin = hold_back},
    {.name = "frames doubled", .reasons = 0, .frames = 0.2, .begin = repeat},
    {.name = "frames corrupted",
     .reasons = BOTH | REASON(BUS_OFF),
     .frames = 0.1,
     .begin = corrupt},
    {.name = "drive dead", .reasons = APART, .stops = true, .drive = true, .begin = dead},
    {.name = "drive without feedback",
     .reasons = APART,
     .stops = true,
     .drive = true,
     .begin = no_feedback},
    {.name = "drive without heartbeat",
     .reasons = APART,
     .stops = true,
     .drive = true,
     .reported = true,
     .begin = no_heartbeat},
    {.name = "drive fails",
     .reasons = BY_ITSELF,
     .stops = true,
     .drive = true,
     .reported = true,
     .begin = drive_error},
    {.name = "board's wire cut",
     .reasons = BOTH,
     .lasts = true,
     .stops = true,
     .misread = true,
     .begin = cut_board,
     .end = cut_board},
    {.name = "robot's wire cut",
     .reasons = BOTH,
     .lasts = true,
     .stops = true,
     .misread = true,
     .begin = cut_robot,
     .end = cut_robot},
    {.name = "board bus-off",
     .reasons = REASON(BUS_OFF),
     .lasts = true,
     .stops = true,
     .misread = true,
     .begin = board_off,
     .end = board_recovers},
    {.name = "robot bus-off",
     .reasons = BOTH,
     .lasts = true,
     .stops = true,
     .misread = true,
     .begin = robot_off,
     .end = robot_recovers},
    {.name = "interface down",
     .reasons = REASON(BUS_DOWN),
     .lasts = true,
     .stops = true,
     .misread = true,
     .begin = board_down,
     .end = board_up},
    {.name = "babble",
     .reasons = BOTH,
     .lasts = true,
     .ends = true,
     .misread = true,
     .begin = babble},
    {.name = "emergency stop",
     .reasons = REASON(EMERGENCY_STOP),
     .stops = true,
     .begin = stop_by_frame},
};
#define FAULTS (sizeof faults / sizeof faults[0])

static void draw_fault(run_t *run, drive_sim_kind_t kind) {
    rng_t *rng = &run->rng;
    run->fault = &no_fault;
    run->begin_us = run->end_us = INT64_MAX;
    if (!run->campaign->faults) {
        return;
    }
    do {
        run->fault = &faults[rng_u64(rng) % FAULTS];
    } while (run->fault->reported && kind == DRIVE_SIM_VESC);
    run->share = rng_uniform(rng, 0.0, run->fault->frames);
    run->side = rng_u64(rng) >> 63 ? BERTH_LEFT : BERTH_RIGHT;
    if (run->fault->frames > 0.0) {
        run->begin_us = SESSION_BEGIN_US;
        return;
    }
    const double begin_s = rng_uniform(rng, 0.0, run->scene->duration_s + ARMING_S);
    const double lasts_s = rng_uniform(rng, 0.001, LASTS_MAX_S);
    const bool forever = rng_uniform(rng, 0.0, 1.0) < FOREVER_SHARE && !run->fault->ends;
    run->begin_us = SESSION_BEGIN_US + (int64_t)llround(1.0e6 * begin_s);
    run->row->fault_s = 1.0e-6 * (double)(run->begin_us - SESSION_BEGIN_US);
    if (run->fault->lasts && !forever) {
        run->end_us = run->begin_us + (int64_t)llround(1.0e6 * lasts_s);
        run->row->fault_lasts_s = lasts_s;
    }
}

/* --- the session -------------------------------------------------------------------------- */

static void on_prepare(void *context, session_parts_t *parts) {
    run_t *run = context;
    run->parts = parts;
    (void)can_loop_attach(&parts->loop, &run->stranger);
    if (run->fault->frames > 0.0 || run->fault->drive) {
        run->fault->begin(run);
        run->begun = run->ended = true;
    }
}

static void on_instant(void *context, session_parts_t *parts, int64_t now_us) {
    run_t *run = context;
    if (!run->begun && run->fault->begin != NULL && now_us >= run->begin_us) {
        run->fault->begin(run);
        run->begun = true;
    }
    if (run->begun && !run->ended && run->fault->end != NULL && now_us >= run->end_us) {
        run->fault->end(run);
        run->ended = true;
    }
    if (run->stop_us < 0 && berth_board_status(&parts->board)->state == BERTH_SUPERVISOR_FAULT) {
        run->stop_us = now_us;
    }
    const bus_robot_wheels_t wheels = bus_robot_wheels(parts->robot);
    const double radius_m = run->scene->robot.wheel_radius_m;
    if (radius_m * fabs(wheels.speed_radps[BERTH_LEFT]) > STANDING_MPS ||
        radius_m * fabs(wheels.speed_radps[BERTH_RIGHT]) > STANDING_MPS) {
        run->moved_us = now_us;
    }
}

/* --- what must come of it ----------------------------------------------------------------- */

static uint64_t reason_of(uint8_t fault) {
    const unsigned number = fault;
    if (number >= BERTH_FAULT_RIGHT) {
        return UINT64_C(1) << (32 + number - BERTH_FAULT_RIGHT);
    }
    return number >= BERTH_FAULT_LEFT ? UINT64_C(1) << (32 + number - BERTH_FAULT_LEFT)
                                      : UINT64_C(1) << number;
}

/* Until the wheels stand at the latest: the watchdog, two periods, the lag and the braking, and as
 * long as the bus keeps what the board has to say. */
static int64_t standing_us(const run_t *run) {
    const scenario_t *scene = run->scene;
    const double a = scene->plant.a_max_mps2;
    const double rim_mps =
        scene->robot.v_max_mps + 0.5 * scene->robot.track_m * scene->robot.omega_max_radps;
    const double s = BUS_CAMPAIGN_WATCHDOG_S + 2.0 * scene->period_s + 6.0 * scene->plant.tau_s +
                     (a > 0.0 ? rim_mps / a : 0.0) + run->row->fault_lasts_s;
    return (int64_t)llround(1.0e6 * s);
}

static const char *wrong_stop(const run_t *run, const session_result_t *result) {
    const bool right_side =
        !run->fault->drive || result->board.fault < BERTH_FAULT_LEFT ||
        (result->board.fault >= BERTH_FAULT_RIGHT) == (run->side == BERTH_RIGHT);
    if ((run->fault->reasons & reason_of(result->board.fault)) == 0 || !right_side) {
        return "stopped with the wrong reason";
    }
    if (run->stop_us < run->begin_us) {
        return "stopped before anything was wrong";
    }
    return run->moved_us > run->stop_us + standing_us(run) ? "moved for too long after the stop"
                                                           : NULL;
}

static const char *wrong_end(const run_t *run, const session_result_t *result) {
    const int64_t run_us = (int64_t)llround(1.0e6 * run->scene->duration_s);
    const int64_t begin_us = run->begin_us - SESSION_BEGIN_US;
    const bool to_stay = run->fault->stops && run->end_us == INT64_MAX;
    if (result->end != SESSION_IDLE) {
        return "never ended";
    }
    if (to_stay && begin_us >= result->started_us &&
        begin_us + FOUND_US < result->started_us + run_us) {
        return "carried on";
    }
    return result->robot.phase != BUS_ROBOT_DONE && !run->fault->misread
               ? "did not do the whole run"
               : NULL;
}

static void judge(const run_t *run, const session_result_t *result) {
    campaign_row_t *row = run->row;
    row->summary = result->robot.summary;
    row->summary.min_clearance_m = result->robot.clearance_m;
    row->collided = result->robot.clearance_m < 0.0;
    row->end = session_end_text(result->end);
    if (result->end == SESSION_FAULT) {
        row->reason = result->board.fault;
        row->stopped_s = 1.0e-6 * (double)(run->stop_us - SESSION_BEGIN_US);
        row->wrong = wrong_stop(run, result);
    } else {
        row->wrong = wrong_end(run, result);
    }
    if (row->collided) {
        row->wrong = "collided";
    }
}

bool bus_campaign_run(const void *context, const scenario_t *scene, const run_plan_t *plan,
                      campaign_row_t *row, scenario_error_t *error) {
    const bus_campaign_t *campaign = context;
    run_t run = {.campaign = campaign, .scene = scene, .row = row, .stop_us = -1};
    rng_seed(&run.rng, row->seed ^ FAULT_STREAM);
    const bus_setup_t *setup = &campaign->setups[campaign->drawn ? rng_u64(&run.rng) % KINDS : 0];
    draw_fault(&run, setup->drive);
    row->drive = bus_setup_drive_name(setup->drive);
    row->fault = run.fault->name;
    const session_config_t config = {
        .scenario = scene,
        .plan = plan,
        .seed = row->seed,
        .setup = setup,
        .prepare = on_prepare,
        .instant = on_instant,
        .context = &run,
    };
    session_result_t result;
    if (!session_run(&config, &result, error)) {
        return false;
    }
    judge(&run, &result);
    return true;
}

bool bus_campaign_init(bus_campaign_t *campaign, const bus_setup_t *given, bool faults_wanted,
                       scenario_error_t *error) {
    *campaign = (bus_campaign_t){
        .drawn = !bus_setup_given(given, BUS_SETUP_DRIVE),
        .faults = faults_wanted,
    };
    for (unsigned kind = 0; kind < KINDS; kind++) {
        campaign->setups[kind] = *given;
        if (campaign->drawn) {
            campaign->setups[kind].drive = (drive_sim_kind_t)kind;
        }
        if (!bus_setup_finish(&campaign->setups[kind], error)) {
            return false;
        }
    }
    return true;
}
