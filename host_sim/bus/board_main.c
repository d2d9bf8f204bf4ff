/* berth-board: the firmware on Linux, with wheel drives on a real CAN bus. */
#include "berth/link.h"
#include "board_host.h"
#include "can_open.h"
#include "candump.h"
#include "number.h"
#include "realtime.h"
#include "record.h"
#include "refusal.h"
#include "status_line.h"
#include "summary.h"

#include <errno.h>
#include <math.h>
#include <signal.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#ifndef BERTH_VERSION
#error "BERTH_VERSION comes from the build"
#endif

#define STATUS_OK 0
#define STATUS_FAILED 1
#define STATUS_USAGE 2

/* A board in fault is kept going until the drives have let go, so that the stop is heard. */
#define FAULT_LINGER_US 1000000
#define FAULT_TEXT_SIZE 128

/* How long a bus may take to come up before there is no point in waiting. */
#define BUS_WAIT_US 30000000

enum {
    OPTION_CAN = 0x100,
    OPTION_SET,
    OPTION_RECORD,
    OPTION_PRIORITY,
    OPTION_LOCK,
    OPTION_REMOTE,
    OPTION_JSON,
    OPTION_QUIET,
    OPTION_TIME
};

typedef struct {
    board_recipe_t recipe;
    const char *scenario;
    const char *can;
    const char *record;
    const char **sets;
    size_t set_count;
    int priority;
    bool lock;
    bool remote;
    bool json;
    bool quiet;
    double time_s; /* 0: the scenario's duration */
} options_t;

static const struct argp_option option_table[] = {
    {"can", OPTION_CAN, "BUS", 0, "socketcan:NAME, or slcan:PATH (a tty, pty or unix socket)", 0},
    {"set", OPTION_SET, "KEY=VALUE", 0,
     "Change one value of the scenario, by its dotted key; may be repeated", 0},
    {"remote", OPTION_REMOTE, NULL, 0,
     "Wait for arm, start and stop from the bus, and run until interrupted", 0},
    {"time", OPTION_TIME, "S", 0, "Stop after so many seconds (the scenario's duration)", 0},
    {"record", OPTION_RECORD, "FILE", 0,
     "Write a log in candump's format that `berth-sim replay' can do again", 0},
    {"priority", OPTION_PRIORITY, "N", 0, "Ask for SCHED_FIFO with this priority, 1 to 99", 0},
    {"lock", OPTION_LOCK, NULL, 0, "Ask for locked memory", 0},
    {"json", OPTION_JSON, NULL, 0, "Print the summary as one JSON object and nothing else", 0},
    {"quiet", OPTION_QUIET, NULL, 0, "No status line", 0},
    {0},
};

static void take_scenario(options_t *options, const char *argument, struct argp_state *state) {
    if (options->scenario != NULL) {
        argp_error(state, "more than one SCENARIO: '%s' after '%s' (allowed: one)", argument,
                   options->scenario);
    }
    options->scenario = argument;
}

static void take_number(options_t *options, int key, const char *argument,
                        struct argp_state *state) {
    uint64_t count = 0;
    if (key == OPTION_PRIORITY) {
        if (!number_parse_count(argument, 99, &count) || count == 0) {
            argp_error(state,
                       "--priority: '%.40s' is not possible (allowed: an integer from 1 to 99)",
                       argument);
        }
        options->priority = (int)count;
        return;
    }
    if (!number_parse(argument, &options->time_s) || options->time_s < 0.001 ||
        options->time_s > 1.0e6) {
        argp_error(state, "--time: '%.40s' is not possible (allowed: 0.001 to 1000000)", argument);
    }
}

static void check_line(const options_t *options, struct argp_state *state) {
    if (options->can == NULL) {
        argp_error(state, "--can is missing (allowed: socketcan:NAME, slcan:PATH)");
    }
    if (options->scenario == NULL) {
        argp_error(state, "SCENARIO is missing (allowed: circle, eight or a YAML file)");
    }
}

static error_t parse_option(int key, char *argument, struct argp_state *state) {
    options_t *options = state->input;
    switch (key) {
    case ARGP_KEY_INIT:
        state->child_inputs[0] = &options->recipe.setup;
        state->child_inputs[1] = &options->recipe.options;
        return 0;
    case OPTION_CAN:
        options->can = argument;
        return 0;
    case OPTION_SET:
        options->sets[options->set_count++] = argument;
        return 0;
    case OPTION_RECORD:
        options->record = argument;
        return 0;
    case OPTION_PRIORITY:
    case OPTION_TIME:
        take_number(options, key, argument, state);
        return 0;
    case OPTION_LOCK:
        options->lock = true;
        return 0;
    case OPTION_REMOTE:
        options->remote = true;
        return 0;
    case OPTION_JSON:
        options->json = true;
        return 0;
    case OPTION_QUIET:
        options->quiet = true;
        return 0;
    case ARGP_KEY_ARG:
        take_scenario(options, argument, state);
        return 0;
    case ARGP_KEY_END:
        check_line(options, state);
        return 0;
    default:
        return ARGP_ERR_UNKNOWN;
    }
}

static const struct argp_child children[] = {
    {&bus_setup_argp, 0, "Drives:", 0}, {&board_options_argp, 0, "Supervision:", 0}, {0}};

static const struct argp argp = {
    .options = option_table,
    .parser = parse_option,
    .args_doc = "SCENARIO",
    .doc = "Runs Berth's firmware on this machine: arms the drives on the bus, follows the "
           "scenario's reference from its start, stops, and takes the torque off."
           "\v"
           "The robot is taken to stand where the scenario says (`start'); pose fixes from the bus "
           "correct that. The first interrupt stops the robot, the second is an emergency stop.\n"
           "\n"
           "Exit status: 0 done, 1 stopped by a fault, 2 bad usage or bad input.",
    .children = children,
};

static void complain(const char *format, ...) __attribute__((format(printf, 1, 2)));
static void complain(const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    fputs("berth-board: ", stderr);
    vfprintf(stderr, format, arguments);
    fputc('\n', stderr);
    va_end(arguments);
}

/* --- interrupts ------------------------------------------------------------------------------- */

static volatile sig_atomic_t interrupts;

static void on_interrupt(int number) {
    (void)number;
    if (interrupts < 2) {
        interrupts++;
    }
}

static void catch_interrupts(void) {
    struct sigaction action = {.sa_handler = on_interrupt};
    (void)sigemptyset(&action.sa_mask);
    (void)sigaction(SIGINT, &action, NULL);
    (void)sigaction(SIGTERM, &action, NULL);
}

/* --- one run ---------------------------------------------------------------------------------- */

typedef struct {
    const options_t *options;
    board_host_t host;
    can_port_t port;
    realtime_t timer;
    berth_clock_t clock;
    realtime_rights_t rights;
    berth_link_t link;
    berth_can_t bus; /* as the link sees it: with the record in between, if there is one */
    record_t record;
    bool recording;
    status_line_t line;
    realtime_histogram_t late; /* of control steps */
    uint32_t steps_seen;
    int obeyed; /* interrupts that have been obeyed */
    bool armed; /* ARM has been commanded */
    int64_t begin_us;
    int64_t started_us; /* when RUNNING began; -1: not yet */
    int64_t fault_us;   /* when the fault was first seen; -1: none */
    uint8_t fault;
    uint32_t fault_code;
    bool released_idle; /* IDLE again after a run */
} session_t;

/* Counts the frames for the bus load; between link and bus. */
static berth_can_outcome_t counted_send(void *context, const berth_can_frame_t *frame) {
    session_t *session = context;
    const berth_can_outcome_t outcome = session->bus.api->send(session->bus.context, frame);
    if (outcome == BERTH_CAN_DONE) {
        status_line_frame(&session->line, frame);
    }
    return outcome;
}

static berth_can_outcome_t counted_receive(void *context, berth_can_frame_t *frame) {
    session_t *session = context;
    const berth_can_outcome_t outcome = session->bus.api->receive(session->bus.context, frame);
    if (outcome == BERTH_CAN_DONE) {
        status_line_frame(&session->line, frame);
    }
    return outcome;
}

static void counted_state(void *context, berth_can_state_t *state) {
    session_t *session = context;
    session->bus.api->state(session->bus.context, state);
}

static const berth_can_api_t counted_api = {counted_send, counted_receive, counted_state};

static void command(session_t *session, berth_command_code_t code, int64_t now_us) {
    if (session->recording) {
        record_command(&session->record, code, now_us);
    }
    berth_board_command(&session->host.board, code, now_us);
}

/* As soon as the bus can be used. */
static void arm(session_t *session, int64_t now_us) {
    const berth_board_status_t *status = berth_board_status(&session->host.board);
    const bool usable =
        status->bus == BERTH_CAN_ERROR_ACTIVE || status->bus == BERTH_CAN_ERROR_PASSIVE;
    session->armed = status->steps > 0 && usable && !session->link.failed;
    if (session->armed) {
        command(session, BERTH_COMMAND_ARM, now_us);
    }
}

/* Periods of the run. One more is driven, so that whoever watches sees the last one whole. */
static int64_t run_periods(const session_t *session) {
    const options_t *options = session->options;
    const scenario_t *scenario = &options->recipe.scenario;
    const double time_s = options->time_s > 0.0 ? options->time_s : scenario->duration_s;
    return (int64_t)llround(time_s / scenario->period_s) + 1;
}

/* Arms, starts and stops by itself. */
static void drive_along(session_t *session, int64_t now_us) {
    const berth_board_t *board = &session->host.board;
    const berth_supervisor_state_t state = berth_board_status(board)->state;
    const bool started = session->started_us >= 0;
    if (!session->armed) {
        arm(session, now_us);
    } else if (state == BERTH_SUPERVISOR_ARMED && !started) {
        command(session, BERTH_COMMAND_START, now_us);
        session->started_us = now_us;
    } else if (state == BERTH_SUPERVISOR_RUNNING && !board->starting &&
               (int64_t)board->controller.reference.total >= run_periods(session)) {
        command(session, BERTH_COMMAND_STOP, now_us);
    } else if (state == BERTH_SUPERVISOR_IDLE && started) {
        session->released_idle = true;
    }
}

static void obey_interrupts(session_t *session, int64_t now_us) {
    const int wanted = (int)interrupts;
    if (wanted == session->obeyed) {
        return;
    }
    session->obeyed = wanted;
    command(session, wanted == 1 ? BERTH_COMMAND_STOP : BERTH_COMMAND_EMERGENCY_STOP, now_us);
}

static void note_steps(session_t *session, int64_t now_us, int64_t due_us) {
    const berth_board_status_t *status = berth_board_status(&session->host.board);
    if (status->steps != session->steps_seen) {
        session->steps_seen = status->steps;
        realtime_histogram_add(&session->late, now_us - due_us);
    }
}

/* What the faulty drive itself tells: an error, abort or emergency code. 0 for other faults. */
static uint32_t fault_code(const session_t *session, uint8_t fault) {
    if (fault < BERTH_FAULT_LEFT) {
        return 0;
    }
    const int side = fault < BERTH_FAULT_RIGHT ? BERTH_LEFT : BERTH_RIGHT;
    return berth_board_drive(&session->host.board, side)->code;
}

static void describe_fault(const session_t *session, char *text, size_t size) {
    const uint8_t fault = session->fault;
    char code[32] = "";
    if (session->fault_code != 0) {
        (void)snprintf(code, sizeof code, " (code 0x%X)", (unsigned)session->fault_code);
    }
    (void)snprintf(text, size, "%s%s%s", berth_fault_side_text(fault), berth_fault_text(fault),
                   code);
}

/* A fault stays on the screen and in the exit status even if a reset from the bus leaves it. */
static void note_fault(session_t *session, int64_t now_us) {
    const berth_board_status_t *status = berth_board_status(&session->host.board);
    if (status->fault != BERTH_FAULT_NONE && session->fault != status->fault) {
        session->fault = status->fault;
        session->fault_code = fault_code(session, status->fault);
        session->fault_us = now_us;
        status_line_end(&session->line);
        char text[FAULT_TEXT_SIZE];
        describe_fault(session, text, sizeof text);
        complain("fault: %s", text);
    }
}

static bool finished(const session_t *session, int64_t now_us) {
    const berth_board_t *board = &session->host.board;
    const berth_supervisor_state_t state = berth_board_status(board)->state;
    if (state == BERTH_SUPERVISOR_FAULT) {
        const bool ends = !session->options->remote || session->obeyed > 0;
        return ends && board->released && now_us - session->fault_us >= FAULT_LINGER_US;
    }
    if (!session->options->remote && !session->armed && session->obeyed == 0) {
        return now_us - session->begin_us > BUS_WAIT_US;
    }
    const bool empty =
        berth_board_front(board) == NULL || berth_board_status(board)->bus == BERTH_CAN_DOWN;
    if (state == BERTH_SUPERVISOR_IDLE && empty) {
        return session->released_idle || session->obeyed > 0;
    }
    return false;
}

static void loop(session_t *session) {
    int64_t now_us = session->clock.api->now_us(session->clock.context);
    while (!finished(session, now_us)) {
        now_us = session->clock.api->now_us(session->clock.context);
        obey_interrupts(session, now_us);
        if (!session->options->remote) {
            drive_along(session, now_us);
        }
        const int64_t due_us = session->host.board.tick_us;
        if (session->recording) {
            record_run(&session->record, now_us);
        }
        berth_link_run(&session->link, now_us);
        note_steps(session, now_us, due_us);
        note_fault(session, now_us);
        status_line_show(&session->line, &session->host.board, now_us);
        session->clock.api->sleep_until_us(session->clock.context,
                                           berth_link_deadline(&session->link));
    }
    status_line_end(&session->line);
}

/* --- the summary ------------------------------------------------------------------------------ */

static void print_drive(const session_t *session, int side) {
    const berth_drive_status_t *drive = berth_board_drive(&session->host.board, side);
    printf("  %-27s%u good frames, %u malformed, %u commands saturated\n",
           side == BERTH_LEFT ? "left drive" : "right drive", (unsigned)drive->received,
           (unsigned)drive->malformed, (unsigned)(drive->saturated + drive->refused));
}

/* A line for each factor of four, which is enough to see what kind of machine it is. */
static void print_late(const realtime_histogram_t *late) {
    printf("control steps late           median %lld us, p99 %lld us, at most %lld us\n",
           (long long)realtime_histogram_quantile(late, 0.5),
           (long long)realtime_histogram_quantile(late, 0.99), (long long)late->max_us);
    uint32_t bin = 0;
    for (int64_t end_us = 64; bin < REALTIME_BINS; end_us *= 4) {
        uint64_t count = 0;
        while (bin < REALTIME_BINS && realtime_bin_low_us(bin) < end_us) {
            count += late->bins[bin++];
        }
        if (count > 0) {
            printf("  below %8lld us          %llu\n", (long long)end_us,
                   (unsigned long long)count);
        }
    }
}

static void print_table(session_t *session) {
    const berth_board_status_t *status = berth_board_status(&session->host.board);
    berth_can_state_t bus;
    session->port.can.api->state(session->port.can.context, &bus);
    printf("%s: %s", session->options->recipe.scenario.name,
           session->fault == BERTH_FAULT_NONE ? "done" : "stopped by a fault: ");
    if (session->fault != BERTH_FAULT_NONE) {
        char text[FAULT_TEXT_SIZE];
        describe_fault(session, text, sizeof text);
        printf("%s", text);
    }
    printf("\n  control steps              %u, %u periods missed\n", (unsigned)status->steps,
           (unsigned)status->missed);
    printf("  frames                     %u good, %u malformed, %u of others\n",
           (unsigned)status->received, (unsigned)status->malformed, (unsigned)status->foreign);
    print_drive(session, BERTH_LEFT);
    print_drive(session, BERTH_RIGHT);
    printf(
        "  bus                        %u frames lost, %u dropped, %u error frames, %u restarts\n",
        (unsigned)bus.rx_lost, (unsigned)bus.tx_dropped, (unsigned)bus.error_frames,
        (unsigned)bus.restarts);
    printf("  frames not put             %u\n", (unsigned)session->host.board.outbox.dropped);
    print_late(&session->late);
    if (session->options->priority > 0 || session->options->lock) {
        realtime_rights_print(&session->rights, stdout);
    }
}

static bool print_json(session_t *session) {
    const berth_board_status_t *status = berth_board_status(&session->host.board);
    const berth_drive_status_t *left = berth_board_drive(&session->host.board, BERTH_LEFT);
    const berth_drive_status_t *right = berth_board_drive(&session->host.board, BERTH_RIGHT);
    berth_can_state_t bus;
    session->port.can.api->state(session->port.can.context, &bus);
    json_t *document = json_pack(
        "{ss, ss, ss, sI, sI, sI, sI, sI, sI, sI, sI, sI, sI, sI, sI, sI, sI, sI, sI}", "state",
        berth_supervisor_state_text(status->state), "fault",
        session->fault == BERTH_FAULT_NONE ? "" : berth_fault_text(session->fault), "fault_side",
        berth_fault_side_text(session->fault), "fault_code", (json_int_t)session->fault_code,
        "steps", (json_int_t)status->steps, "missed", (json_int_t)status->missed, "late_max_us",
        (json_int_t)session->late.max_us, "late_p99_us",
        (json_int_t)realtime_histogram_quantile(&session->late, 0.99), "received",
        (json_int_t)status->received, "malformed", (json_int_t)status->malformed, "foreign",
        (json_int_t)status->foreign, "drive_malformed",
        (json_int_t)left->malformed + (json_int_t)right->malformed, "saturated",
        (json_int_t)left->saturated + (json_int_t)right->saturated, "commands_refused",
        (json_int_t)status->commands_refused, "rx_lost", (json_int_t)bus.rx_lost, "tx_dropped",
        (json_int_t)bus.tx_dropped, "error_frames", (json_int_t)bus.error_frames, "restarts",
        (json_int_t)bus.restarts, "outbox_dropped", (json_int_t)session->host.board.outbox.dropped);
    return summary_write_json(stdout, document);
}

static bool report(session_t *session) {
    if (session->options->json) {
        return print_json(session);
    }
    print_table(session);
    return fflush(stdout) == 0;
}

/* --- setting up ------------------------------------------------------------------------------- */

static bool load_scenario(options_t *options) {
    scenario_error_t error;
    if (!scenario_open(options->scenario, options->sets, options->set_count,
                       &options->recipe.scenario, &error)) {
        complain("%s", error.text);
        return false;
    }
    if (options->recipe.scenario.plant.untold > 0.0) {
        complain("plant.untold: %g breaks the clearance condition, which is for simulation alone "
                 "(allowed: 0)",
                 options->recipe.scenario.plant.untold);
        return false;
    }
    return true;
}

static bool open_record(session_t *session, int64_t now_us) {
    const options_t *options = session->options;
    scenario_error_t error;
    const char *channel = strchr(options->can, ':');
    channel = strncmp(options->can, "socketcan:", 10) == 0 ? channel + 1 : "slcan";
    char *text = board_recipe_text(&options->recipe, &error);
    if (text == NULL || !record_open(&session->record, options->record, channel, &error)) {
        complain("%s", error.text);
        free(text);
        return false;
    }
    record_setup(&session->record, text, now_us);
    record_init(&session->record, session->host.board.plan_crc, now_us);
    free(text);
    session->recording = true;
    session->bus = record_can(&session->record, &session->port.can);
    return true;
}

static bool put_robot(session_t *session, int64_t now_us) {
    const scenario_t *scenario = &session->options->recipe.scenario;
    const berth_pose_t pose = {(float)scenario->start.x_m, (float)scenario->start.y_m,
                               (float)scenario->start.theta_rad};
    if (session->recording) {
        record_pose(&session->record, &pose, now_us);
    }
    return berth_board_set_pose(&session->host.board, &pose, now_us) == BERTH_OK;
}

static void start(session_t *session, int64_t now_us) {
    const berth_can_t counted = {&counted_api, session};
    berth_link_init(&session->link, &session->host.board, &counted);
    status_line_init(&session->line, session->options->quiet ? NULL : stderr, now_us);
    session->begin_us = now_us;
    session->started_us = -1;
    session->fault_us = -1;
    if (session->options->priority > 0 || session->options->lock) {
        session->rights = realtime_ask(session->options->priority, session->options->lock);
    }
}

static int run(session_t *session) {
    scenario_error_t error;
    loop(session);
    bool good = session->armed || session->options->remote || session->obeyed > 0;
    if (!good) {
        complain("--can: the bus has not come up in %d s (allowed: an interface that is up, or a "
                 "peer that answers)",
                 BUS_WAIT_US / 1000000);
    }
    if (session->recording && !record_close(&session->record, &error)) {
        complain("%s", error.text);
        good = false;
    }
    if (!report(session)) {
        complain("cannot write the summary: %s", strerror(errno));
        good = false;
    }
    return good && session->fault == BERTH_FAULT_NONE ? STATUS_OK : STATUS_FAILED;
}

/* With a bus that is open. */
static int run_on_bus(session_t *session) {
    realtime_init(&session->timer, &session->port.wait);
    session->clock = realtime_clock(&session->timer);
    session->bus = session->port.can;
    /* from here on the board's time is the present: what went before counted from zero */
    const int64_t now_us = session->clock.api->now_us(session->clock.context);
    session->host.board.tick_us = now_us;
    session->host.board.last_us = now_us;
    if (session->options->record != NULL && !open_record(session, now_us)) {
        return STATUS_USAGE;
    }
    if (!put_robot(session, now_us)) {
        complain("start: the board refuses this pose");
        return STATUS_USAGE;
    }
    start(session, now_us);
    return run(session);
}

static int run_with(options_t *options) {
    session_t *session = calloc(1, sizeof *session);
    scenario_error_t error;
    if (session == NULL) {
        complain("out of memory");
        return STATUS_FAILED;
    }
    session->options = options;
    if (!board_host_make(&session->host, &options->recipe, realtime_now_us(), &error)) {
        complain("%s", error.text);
        free(session);
        return STATUS_USAGE;
    }
    berth_can_filter_t filters[BERTH_BOARD_FILTERS_MAX];
    const uint32_t count = berth_board_filters(&session->host.board, filters);
    char why[CAN_OPEN_ERROR_MAX];
    int status = STATUS_USAGE;
    if (can_open(&session->port, options->can, filters, count, why, sizeof why)) {
        status = run_on_bus(session);
        can_close(&session->port);
    } else {
        complain("--can: %s", why);
    }
    board_host_free(&session->host);
    free(session);
    return status;
}

int main(int argc, char **argv) {
    options_t options = {.scenario = NULL};
    argp_program_version = "berth-board " BERTH_VERSION;
    argp_err_exit_status = STATUS_USAGE;
    bus_setup_init(&options.recipe.setup, true);
    options.sets = calloc((size_t)argc, sizeof *options.sets);
    if (options.sets == NULL) {
        complain("out of memory");
        return STATUS_FAILED;
    }
    argp_parse(&argp, argc, argv, 0, NULL, &options);
    catch_interrupts();
    const int status = load_scenario(&options) ? run_with(&options) : STATUS_USAGE;
    free(options.sets);
    return status;
}
