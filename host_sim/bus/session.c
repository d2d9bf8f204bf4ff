#include "session.h"

#include "refusal.h"
#include "strategy_common.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define LOAD_WINDOW_US 100000
#define BUS_SPEED CAN_LOOP_BIT_RATE

/* Arming, and coming to a stand, take no longer than this. The board's own time-outs are shorter.
 */
#define GRACE_US 15000000

/* After the end all is watched for so long: after a fault at least, when idle at most. */
#define WATCH_US 500000
#define STANDING_MPS 1.0e-6

/* How far the operator is. */
typedef enum { TO_ARM, TO_START, TO_STOP, TO_END, OVER } operator_t;

typedef struct {
    const session_config_t *config;
    session_result_t *result;
    session_parts_t parts;
    operator_t operator;
    int64_t now_us;
    int64_t since_us;                  /* when the operator did something last */
    int64_t idle_us;                   /* when the board went idle at the end; -1: not */
    int64_t fault_us;                  /* when the board went into fault; -1: not */
    int64_t limit_us;                  /* it must be over by then */
    int64_t window_us, window_busy_ns; /* of the load */
    int64_t load_us, load_busy_ns;     /* when the run began */
} session_t;

static int64_t least(int64_t a, int64_t b) {
    return a < b ? a : b;
}

/* --- the bus's load ---------------------------------------------------------------------- */

static void begin_load(session_t *session) {
    session->load_us = session->window_us = session->now_us;
    session->load_busy_ns = session->window_busy_ns = can_loop_busy_ns(&session->parts.loop);
}

static void watch_load(session_t *session) {
    if (session->operator!= TO_STOP || session->now_us<session->window_us + LOAD_WINDOW_US) {
        return;
    }
    const double load =
        can_loop_load(&session->parts.loop, session->window_us, session->window_busy_ns);
    session->result->load_peak = fmax(session->result->load_peak, load);
    session->window_us = session->now_us;
    session->window_busy_ns = can_loop_busy_ns(&session->parts.loop);
}

static void end_load(session_t *session) {
    session->result->load =
        can_loop_load(&session->parts.loop, session->load_us, session->load_busy_ns);
}

/* --- the board, here or elsewhere --------------------------------------------------------- */

/* Without its board a session is over at once. */
static void note(session_t *session, bool good) {
    if (!good) {
        session->operator= OVER;
    }
}

static void command_board(session_t *session, berth_command_code_t code) {
    const session_remote_t *remote = session->config->remote;
    if (remote != NULL) {
        note(session, remote->api->command(remote->context, code, session->now_us));
    } else {
        berth_board_command(&session->parts.board, code, session->now_us);
    }
}

static void put_robot(session_t *session, const berth_pose_t *pose) {
    const session_remote_t *remote = session->config->remote;
    if (remote != NULL) {
        note(session, remote->api->set_pose(remote->context, pose, SESSION_BEGIN_US));
    } else {
        (void)!berth_board_set_pose(&session->parts.board, pose, SESSION_BEGIN_US);
    }
}

static void run_board(session_t *session) {
    const session_remote_t *remote = session->config->remote;
    if (remote != NULL) {
        note(session, remote->api->run(remote->context, session->now_us));
    } else {
        berth_link_run(&session->parts.link, session->now_us);
    }
}

static int64_t board_deadline(const session_t *session) {
    const session_remote_t *remote = session->config->remote;
    return remote != NULL ? remote->api->deadline(remote->context)
                          : berth_link_deadline(&session->parts.link);
}

/* --- the operator ------------------------------------------------------------------------ */

static void command(session_t *session, berth_command_code_t code, operator_t next) {
    if (session->config->record != NULL) {
        record_command(session->config->record, code, session->now_us);
    }
    session->operator= next;
    session->since_us = session->now_us;
    command_board(session, code);
}

static void over(session_t *session, session_end_t end) {
    session->operator= OVER;
    session->result->end = end;
}

static void watch_fault(session_t *session) {
    const double speed_mps = bus_robot_result(session->parts.robot)->speed_mps;
    if (session->fault_us < 0) {
        session->fault_us = session->now_us;
        if (session->operator== TO_STOP) {
            end_load(session);
        }
    }
    if (session->now_us >= session->fault_us + WATCH_US && fabs(speed_mps) < STANDING_MPS) {
        bus_robot_end(session->parts.robot);
        over(session, SESSION_FAULT);
    }
}

/* The bus is watched until the robot has heard of the end, if anything is heard there. */
static void watch_idle(session_t *session, bool idle) {
    const bool heard = bus_robot_result(session->parts.robot)->state == BERTH_SUPERVISOR_IDLE;
    if (!idle) {
        session->idle_us = -1;
    } else if (session->idle_us < 0) {
        session->idle_us = session->now_us;
    }
    if (idle && (heard || session->now_us >= session->idle_us + WATCH_US)) {
        over(session, SESSION_IDLE);
    }
}

/* One look at the board, as a person at its buttons has. */
static void operate(session_t *session) {
    const berth_supervisor_state_t state = berth_board_status(&session->parts.board)->state;
    const bus_robot_phase_t phase = bus_robot_result(session->parts.robot)->phase;
    if (state == BERTH_SUPERVISOR_FAULT) {
        watch_fault(session);
        return;
    }
    session->fault_us = -1;
    switch (session->operator) {
    case TO_ARM:
        command(session, BERTH_COMMAND_ARM, TO_START);
        break;
    case TO_START:
        if (state == BERTH_SUPERVISOR_ARMED) {
            session->result->armed_us = session->now_us - SESSION_BEGIN_US;
            command(session, BERTH_COMMAND_START, TO_STOP);
            session->result->started_us = session->now_us - SESSION_BEGIN_US;
            begin_load(session);
        } else if (session->now_us > session->since_us + GRACE_US) {
            over(session, SESSION_NOT_ARMED);
        }
        break;
    case TO_STOP:
        if (phase != BUS_ROBOT_WAITING && phase != BUS_ROBOT_RUNNING) {
            end_load(session);
            command(session, BERTH_COMMAND_STOP, TO_END);
        }
        break;
    case TO_END:
        watch_idle(session, state == BERTH_SUPERVISOR_IDLE);
        break;
    case OVER:
    default:
        break;
    }
}

/* --- time -------------------------------------------------------------------------------- */

static void serve_robot(session_parts_t *parts, int64_t now_us) {
    const berth_can_t *can = &parts->robot_can;
    berth_can_frame_t frame;
    while (can->api->receive(can->context, &frame) == BERTH_CAN_DONE) {
        bus_robot_receive(parts->robot, &frame);
    }
    bus_robot_step(parts->robot, now_us);
    const berth_can_frame_t *front = bus_robot_front(parts->robot);
    /* on a bus that is down nothing waits: it would be old when the bus is up again */
    while (front != NULL && can->api->send(can->context, front) != BERTH_CAN_AGAIN) {
        bus_robot_sent(parts->robot);
        front = bus_robot_front(parts->robot);
    }
}

/* The next instant at which something happens. */
static int64_t next_us(session_t *session) {
    session_parts_t *parts = &session->parts;
    int64_t due_us = least(board_deadline(session), bus_robot_deadline(parts->robot));
    due_us = least(due_us, can_loop_deadline(&parts->loop));
    due_us = least(due_us, session->limit_us);
    return due_us > session->now_us ? due_us : session->now_us + 1;
}

static void run(session_t *session) {
    session_parts_t *parts = &session->parts;
    const session_config_t *config = session->config;
    while (session->operator!= OVER) {
        if (config->record != NULL) {
            record_run(config->record, session->now_us);
        }
        run_board(session);
        serve_robot(parts, session->now_us);
        operate(session);
        watch_load(session);
        if (config->instant != NULL) {
            config->instant(config->context, parts, session->now_us);
        }
        if (session->operator!= OVER && session->now_us >= session->limit_us) {
            over(session, SESSION_OVERTIME);
        }
        session->now_us = next_us(session);
        can_loop_run(&parts->loop, session->now_us);
    }
}

/* --- set-up ------------------------------------------------------------------------------ */

static bool make_board(session_t *session, scenario_error_t *error) {
    const session_config_t *config = session->config;
    const berth_plan_t *plan = &config->plan->plan;
    session_parts_t *parts = &session->parts;
    berth_board_config_t board;
    if (config->board != NULL) {
        board = *config->board;
    } else if (!bus_setup_board_config(config->setup, config->scenario, plan->period_us, &board,
                                       error)) {
        return false;
    }
    strategy_constrain(&board.controller, config->scenario, &parts->workspace);
    berth_refusal_t refusal = {.field = BERTH_FIELD_NONE};
    const berth_error_t result =
        berth_board_init(&parts->board, plan, &board, SESSION_BEGIN_US, &refusal);
    if (result != BERTH_OK) {
        bus_setup_refusal_text(result, &refusal, error);
        return false;
    }
    return bus_setup_obstacles(config->setup, config->scenario, &parts->board, error);
}

static bool make_robot(session_t *session, scenario_error_t *error) {
    const session_config_t *config = session->config;
    const bus_robot_config_t robot = {
        .scenario = config->scenario,
        .plan = &config->plan->plan,
        .seed = config->seed,
        .drives = {bus_setup_drive_sim(config->setup, BERTH_LEFT),
                   bus_setup_drive_sim(config->setup, BERTH_RIGHT)},
        .address = config->setup->address,
        .fix_period_us = config->setup->fix_period_us,
        .fix_latency_us = bus_setup_fix_latency_us(config->setup, config->scenario),
        .silence_us = BUS_ROBOT_SILENCE_US,
        .announced =
            config->setup->announced && strcmp(config->scenario->avoidance.strategy, "none") != 0,
        .body_m = BUS_SETUP_BODY_M,
        .sink = config->sink,
    };
    session->parts.robot = bus_robot_create(&robot, SESSION_BEGIN_US, error);
    return session->parts.robot != NULL;
}

/* Without fixes somebody has to say where the robot was put. */
static void tell_start(session_t *session) {
    const berth_pose_t pose = bus_robot_pose(session->parts.robot);
    if (session->config->setup->fix_period_us == 0) {
        if (session->config->record != NULL) {
            record_pose(session->config->record, &pose, SESSION_BEGIN_US);
        }
        put_robot(session, &pose);
    }
}

static bool filter(session_parts_t *parts, uint32_t node, const berth_can_filter_t *filters,
                   uint32_t count) {
    for (uint32_t i = 0; i < count; i++) {
        if (!can_loop_filter(&parts->loop, node, &filters[i])) {
            return false;
        }
    }
    return true;
}

static bool connect(session_t *session, scenario_error_t *error) {
    session_parts_t *parts = &session->parts;
    berth_can_filter_t filters[BERTH_BOARD_FILTERS_MAX];
    if (!can_loop_init(&parts->loop, BUS_SPEED, SESSION_BEGIN_US, session->config->seed) ||
        !can_loop_attach(&parts->loop, &parts->can) ||
        !can_loop_attach(&parts->loop, &parts->robot_can)) {
        return refuse(error, "the virtual bus has no place");
    }
    const uint32_t count = berth_board_filters(&parts->board, filters);
    if (!filter(parts, SESSION_NODE_BOARD, filters, count)) {
        return refuse(error, "the virtual bus has no place for the board's filters");
    }
    const bus_setup_t *setup = session->config->setup;
    const drive_sim_config_t drives[2] = {bus_setup_drive_sim(setup, BERTH_LEFT),
                                          bus_setup_drive_sim(setup, BERTH_RIGHT)};
    berth_can_filter_t heard[BUS_ROBOT_FILTERS_MAX];
    const uint32_t heard_count = bus_robot_filters(drives, setup->address, heard);
    if (!filter(parts, SESSION_NODE_ROBOT, heard, heard_count)) {
        return refuse(error, "the virtual bus has no place for the robot's filters");
    }
    return true;
}

static void fill_result(session_t *session) {
    session_parts_t *parts = &session->parts;
    session_result_t *result = session->result;
    result->end_us = session->now_us - SESSION_BEGIN_US;
    result->robot = *bus_robot_result(parts->robot);
    result->board = *berth_board_status(&parts->board);
    for (int side = 0; side < 2; side++) {
        result->drives[side] = *berth_board_drive(&parts->board, side);
        result->nodes[side] = *can_loop_counters(&parts->loop, (uint32_t)side);
    }
    result->outbox_dropped = parts->board.outbox.dropped;
    result->send_again = parts->link.send_again;
    result->failures = parts->link.failures;
    result->frames = can_loop_frames(&parts->loop);
}

static bool end_remote(session_t *session, scenario_error_t *error) {
    const session_remote_t *remote = session->config->remote;
    return remote == NULL || remote->api->end(remote->context, error);
}

static bool begin_remote(session_t *session, scenario_error_t *error) {
    const session_remote_t *remote = session->config->remote;
    return remote == NULL ||
           remote->api->begin(remote->context, &session->parts, SESSION_BEGIN_US) ||
           end_remote(session, error);
}

/* All that follows when the parts are set up. */
static void carry_out(session_t *session) {
    const session_config_t *config = session->config;
    session_parts_t *parts = &session->parts;
    if (config->record != NULL) {
        record_init(config->record, parts->board.plan_crc, SESSION_BEGIN_US);
    }
    tell_start(session);
    if (config->prepare != NULL) {
        config->prepare(config->context, parts);
    }
    berth_can_t can = parts->can;
    if (config->record != NULL) {
        can = record_can(config->record, &parts->can);
    }
    berth_link_init(&parts->link, &parts->board, &can);
    run(session);
}

static double wall_s(void) {
    struct timespec now;
    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1.0e-9 * (double)now.tv_nsec;
}

bool session_run(const session_config_t *config, session_result_t *result,
                 scenario_error_t *error) {
    session_t *session = calloc(1, sizeof *session);
    if (session == NULL) {
        strategy_memory_text(error);
        return false;
    }
    const double begin_s = wall_s();
    *result = (session_result_t){.armed_us = -1, .started_us = -1};
    session->config = config;
    session->result = result;
    session->now_us = session->since_us = SESSION_BEGIN_US;
    session->fault_us = session->idle_us = -1;
    session->limit_us =
        SESSION_BEGIN_US + 2 * GRACE_US + (int64_t)llround(1.0e6 * config->scenario->duration_s);
    bool good = make_board(session, error) && make_robot(session, error) &&
                connect(session, error) && begin_remote(session, error);
    if (good) {
        carry_out(session);
        good = end_remote(session, error);
    }
    if (good) {
        fill_result(session);
        result->wall_s = wall_s() - begin_s;
        result->robot.summary.wall_s = result->wall_s;
    }
    bus_robot_destroy(session->parts.robot);
    free(session);
    return good;
}

unsigned long session_dropped(const session_result_t *result) {
    unsigned long dropped = result->outbox_dropped + result->robot.lost;
    for (int i = 0; i < 2; i++) {
        dropped += (unsigned long)(result->nodes[i].dropped + result->nodes[i].overflow +
                                   result->nodes[i].late_lost);
        dropped += result->robot.drives[i].overruns;
    }
    return dropped;
}

bool session_good(const session_result_t *result) {
    return result->end == SESSION_IDLE && result->robot.phase == BUS_ROBOT_DONE &&
           result->robot.clearance_m >= 0.0;
}

const char *session_end_text(session_end_t end) {
    static const char *const texts[] = {
        [SESSION_IDLE] = "idle",
        [SESSION_FAULT] = "fault",
        [SESSION_NOT_ARMED] = "not armed",
        [SESSION_OVERTIME] = "overtime",
    };
    return texts[end];
}
