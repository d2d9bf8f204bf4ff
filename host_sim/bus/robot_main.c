/* berth-robot: the wheel drives and the robot on a CAN bus, in real time. */
#include "bus_report.h"
#include "can_open.h"
#include "log.h"
#include "realtime.h"
#include "robot.h"
#include "robot_options.h"
#include "run.h"
#include "summary.h"

#include <errno.h>
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <string.h>

/* After the run the robot stays for so long, at most, until it is told that the board is idle and
 * the wheels stand. */
#define LINGER_US 10000000
#define STANDING_MPS 1.0e-3

/* Frames received before time is looked at again. */
#define RECEIVE_MAX 256

/* While frames wait for room. */
#define RETRY_US 500

/* --- the loop ---------------------------------------------------------------------------- */

static volatile sig_atomic_t interrupted;

static void on_signal(int number) {
    (void)number;
    interrupted = 1;
}

static void catch_signals(void) {
    struct sigaction action = {.sa_handler = on_signal};
    (void)sigemptyset(&action.sa_mask);
    (void)sigaction(SIGINT, &action, NULL);
    (void)sigaction(SIGTERM, &action, NULL);
}

/* Why the robot stopped, where it is not the run's end. */
typedef enum { ENDED, NO_BOARD, INTERRUPTED } why_t;

typedef struct {
    bus_robot_t *robot;
    can_port_t *port;
    realtime_t timer;
    int64_t begin_us, timeout_us;
    int64_t ended_us;           /* when the run was over; -1: not yet */
    unsigned long failures;     /* calls of the bus that answered FAILED */
    unsigned long undelivered;  /* frames of the run for which the bus was down */
    unsigned long long dropped; /* until the run's end: then the board may go away */
    why_t why;
} loop_t;

static void receive(loop_t *loop) {
    const berth_can_t *can = &loop->port->can;
    for (int i = 0; i < RECEIVE_MAX; i++) {
        berth_can_frame_t frame;
        const berth_can_outcome_t outcome = can->api->receive(can->context, &frame);
        if (outcome != BERTH_CAN_DONE) {
            loop->failures += outcome == BERTH_CAN_FAILED ? 1 : 0;
            return;
        }
        bus_robot_receive(loop->robot, &frame);
    }
}

/* True while frames wait for room. On a bus that is down nothing waits: what is old by the time
 * that it is up again must not be taken for news. */
static bool transmit(loop_t *loop) {
    const berth_can_t *can = &loop->port->can;
    const bool running = bus_robot_result(loop->robot)->phase == BUS_ROBOT_RUNNING;
    const berth_can_frame_t *front = bus_robot_front(loop->robot);
    while (front != NULL) {
        const berth_can_outcome_t outcome = can->api->send(can->context, front);
        if (outcome == BERTH_CAN_AGAIN) {
            return true;
        }
        if (outcome == BERTH_CAN_FAILED) {
            loop->failures++;
            loop->undelivered += running ? 1 : 0;
        }
        bus_robot_sent(loop->robot);
        front = bus_robot_front(loop->robot);
    }
    return false;
}

/* Frames that were not sent, or came and were not fetched, so far. */
static unsigned long long count_dropped(const loop_t *loop, const bus_robot_result_t *result) {
    berth_can_state_t state;
    loop->port->can.api->state(loop->port->can.context, &state);
    return (unsigned long long)state.rx_lost + state.tx_dropped + loop->undelivered + result->lost +
           result->drives[0].overruns + result->drives[1].overruns;
}

/* A run that is over is watched until all stands, so that a collision on the way is seen. */
static bool lingers(loop_t *loop, const bus_robot_result_t *result, int64_t now_us) {
    if (loop->ended_us < 0) {
        loop->ended_us = now_us;
        loop->dropped = count_dropped(loop, result);
    }
    const bool stands =
        fabs(result->speed_mps) < STANDING_MPS &&
        (result->state == BERTH_SUPERVISOR_IDLE || result->state == BERTH_SUPERVISOR_FAULT);
    const bool silent = now_us > result->status_us + BUS_ROBOT_SILENCE_US;
    return !stands && !(silent && fabs(result->speed_mps) < STANDING_MPS) &&
           now_us < loop->ended_us + LINGER_US;
}

static bool goes_on(loop_t *loop, int64_t now_us) {
    const bus_robot_result_t *result = bus_robot_result(loop->robot);
    if (interrupted) {
        loop->why = INTERRUPTED;
        return false;
    }
    if (result->phase == BUS_ROBOT_WAITING) {
        const int64_t heard_us = result->status_us < 0 ? loop->begin_us : result->status_us;
        loop->why = now_us < heard_us + loop->timeout_us ? ENDED : NO_BOARD;
        return loop->why == ENDED;
    }
    return result->phase == BUS_ROBOT_RUNNING || lingers(loop, result, now_us);
}

static void run_loop(loop_t *loop) {
    const berth_clock_t clock = realtime_clock(&loop->timer);
    int64_t now_us = loop->begin_us;
    while (goes_on(loop, now_us)) {
        receive(loop);
        now_us = clock.api->now_us(clock.context);
        bus_robot_step(loop->robot, now_us);
        int64_t due_us = bus_robot_deadline(loop->robot);
        if (transmit(loop) && due_us > now_us + RETRY_US) {
            due_us = now_us + RETRY_US;
        }
        clock.api->sleep_until_us(clock.context, due_us);
        now_us = clock.api->now_us(clock.context);
    }
    bus_robot_end(loop->robot);
    if (loop->ended_us < 0) {
        loop->dropped = count_dropped(loop, bus_robot_result(loop->robot));
    }
}

/* --- what it came to --------------------------------------------------------------------- */

static json_t *can_json(const loop_t *loop) {
    berth_can_state_t state;
    loop->port->can.api->state(loop->port->can.context, &state);
    return json_pack("{sI, sI, sI, sI, sI}", "rx_lost", (json_int_t)state.rx_lost, "tx_dropped",
                     (json_int_t)state.tx_dropped, "error_frames", (json_int_t)state.error_frames,
                     "restarts", (json_int_t)state.restarts, "failures",
                     (json_int_t)loop->failures);
}

static json_t *timing_json(const realtime_t *timer) {
    const realtime_histogram_t *late = &timer->late;
    return json_pack("{sI, sI, sI, sI, sI}", "waits", (json_int_t)late->count, "median_us",
                     (json_int_t)realtime_histogram_quantile(late, 0.5), "p99_us",
                     (json_int_t)realtime_histogram_quantile(late, 0.99), "max_us",
                     (json_int_t)late->max_us, "past_max_us", (json_int_t)timer->past_max_us);
}

static bool print_json(const robot_options_t *options, const loop_t *loop) {
    const bus_robot_result_t *result = bus_robot_result(loop->robot);
    json_t *document = summary_json(&result->summary);
    json_t *bus = bus_report_robot_json(&options->setup, result);
    if (document == NULL || bus == NULL ||
        json_object_set_new(bus, "dropped", json_integer((json_int_t)loop->dropped)) != 0 ||
        json_object_set_new(bus, "can", can_json(loop)) != 0 ||
        json_object_set_new(bus, "timing", timing_json(&loop->timer)) != 0) {
        json_decref(document);
        json_decref(bus);
        return false;
    }
    if (json_object_set_new(document, "bus", bus) != 0) {
        json_decref(document);
        return false;
    }
    return summary_write_json(stdout, document);
}

static bool print_table(const robot_options_t *options, const scenario_t *scenario,
                        const loop_t *loop) {
    const bus_robot_result_t *result = bus_robot_result(loop->robot);
    const summary_column_t column = {scenario->avoidance.strategy, result->summary};
    printf("%s, seed %llu: %ld periods of %g s\n\n", scenario->name,
           (unsigned long long)options->seed, result->summary.steps, scenario->period_s);
    summary_print_table(stdout, &column, 1);
    bus_report_print_robot(stdout, &options->setup, result);
    printf("%-28s%14llu\n", "frames dropped", loop->dropped);
    printf("%-28s%14lu\n", "calls that failed", loop->failures);
    realtime_print(&loop->timer, stdout);
    return fflush(stdout) == 0;
}

static int report(const robot_options_t *options, const scenario_t *scenario, const loop_t *loop) {
    const bus_robot_result_t *result = bus_robot_result(loop->robot);
    if (loop->why == NO_BOARD) {
        robot_complain("no board is heard on %s", options->can);
    } else if (loop->why == INTERRUPTED) {
        robot_complain("interrupted");
    }
    const bool printed =
        options->json ? print_json(options, loop) : print_table(options, scenario, loop);
    if (!printed) {
        robot_complain("cannot write the summary: %s", strerror(errno));
    }
    const bool good = result->phase == BUS_ROBOT_DONE && result->summary.collisions == 0 &&
                      result->clearance_m >= 0.0;
    return printed && good ? ROBOT_OK : ROBOT_FAILED;
}

/* --- set-up ------------------------------------------------------------------------------ */

/* What a run needs, and gives back. */
typedef struct {
    scenario_t scenario;
    run_plan_t plan;
    run_log_t log;
    can_port_t port;
    bus_robot_t *robot;
} session_t;

static bool open_all(const robot_options_t *options, session_t *session) {
    scenario_error_t error;
    char bus_error[CAN_OPEN_ERROR_MAX];
    scenario_t *scenario = &session->scenario;
    if (!scenario_open(options->scenario, options->sets, options->set_count, scenario, &error) ||
        !bus_setup_strategy(scenario->avoidance.strategy, &error) ||
        !run_plan_make(scenario, &session->plan, &error) ||
        (options->log_path != NULL && !run_log_open(&session->log, options->log_path, &error))) {
        robot_complain("%s", error.text);
        return false;
    }
    berth_can_filter_t filters[BUS_ROBOT_FILTERS_MAX];
    const drive_sim_config_t drives[2] = {bus_setup_drive_sim(&options->setup, BERTH_LEFT),
                                          bus_setup_drive_sim(&options->setup, BERTH_RIGHT)};
    const uint32_t count = bus_robot_filters(drives, options->setup.address, filters);
    if (!can_open(&session->port, options->can, filters, count, bus_error, sizeof bus_error)) {
        robot_complain("--can: %s", bus_error);
        return false;
    }
    return true;
}

static void close_all(session_t *session) {
    bus_robot_destroy(session->robot);
    can_close(&session->port);
    run_log_discard(&session->log);
    run_plan_free(&session->plan);
}

static bool make_robot(const robot_options_t *options, session_t *session, const run_sink_t *sink) {
    const bus_setup_t *setup = &options->setup;
    scenario_error_t error;
    const bus_robot_config_t config = {
        .scenario = &session->scenario,
        .plan = &session->plan.plan,
        .seed = options->seed,
        .drives = {bus_setup_drive_sim(setup, BERTH_LEFT), bus_setup_drive_sim(setup, BERTH_RIGHT)},
        .address = setup->address,
        .fix_period_us = setup->fix_period_us,
        .fix_latency_us = bus_setup_fix_latency_us(setup, &session->scenario),
        .silence_us = BUS_ROBOT_SILENCE_US,
        .announced = setup->announced && strcmp(session->scenario.avoidance.strategy, "none") != 0,
        .body_m = BUS_SETUP_BODY_M,
        .sink = options->log_path != NULL ? sink : NULL,
    };
    session->robot = bus_robot_create(&config, realtime_now_us(), &error);
    if (session->robot == NULL) {
        robot_complain("%s", error.text);
    }
    return session->robot != NULL;
}

static int run(const robot_options_t *options, session_t *session) {
    const run_sink_t sink = {run_log_row, &session->log};
    scenario_error_t error;
    if (!make_robot(options, session, &sink)) {
        return ROBOT_USAGE;
    }
    loop_t loop = {.robot = session->robot,
                   .port = &session->port,
                   .begin_us = realtime_now_us(),
                   .timeout_us = 1000000 * (int64_t)options->timeout_s,
                   .ended_us = -1};
    catch_signals();
    (void)realtime_ask(0, false);
    realtime_init(&loop.timer, &session->port.wait);
    run_loop(&loop);
    if (options->log_path != NULL && !run_log_commit(&session->log, &error)) {
        robot_complain("%s", error.text);
        return ROBOT_FAILED;
    }
    return report(options, &session->scenario, &loop);
}

int main(int argc, char **argv) {
    static session_t session; /* a port must not be moved, and is large */
    robot_options_t options;
    if (!robot_options_parse(&options, argc, argv)) {
        return ROBOT_FAILED;
    }
    const int status = open_all(&options, &session) ? run(&options, &session) : ROBOT_USAGE;
    close_all(&session);
    robot_options_free(&options);
    return status;
}
