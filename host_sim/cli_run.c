#include "bus/board_host.h"
#include "bus/bus_report.h"
#include "bus/remote_board.h"
#include "cli.h"
#include "log.h"
#include "refusal.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>

static const struct argp_option option_table[] = {
    {"strategy", CLI_STRATEGY, "S", 0, "Controller; the scenario's own without this option", 0},
    {"log", CLI_LOG, "FILE.csv", 0, "Write one row a period", 0},
    {"bus", CLI_BUS, "loop", 0,
     "Put the board and the robot on a virtual CAN bus: frames, drives and odometry between them",
     0},
    {"record", CLI_RECORD, "FILE", 0,
     "With --bus loop: write what the board is told and does, for `berth-sim replay'", 0},
    {"board", CLI_BOARD, "slcan:PATH", 0,
     "With --bus loop: the board is the one at the other end of this tty, pty or unix socket, in "
     "lock-step",
     0},
    CLI_COMMON_OPTIONS,
    {0},
};

static void take_bus(const char *argument, struct argp_state *state, cli_options_t *options) {
    if (strcmp(argument, "loop") != 0) {
        argp_error(state, "--bus: '%s' is no bus here (allowed: loop)", argument);
    }
    options->bus = true;
}

static void take_board(const char *argument, struct argp_state *state, cli_options_t *options) {
    static const char word[] = "slcan:";
    if (strncmp(argument, word, sizeof word - 1) != 0 || argument[sizeof word - 1] == '\0') {
        argp_error(state, "--board: '%s' is no line (allowed: slcan:PATH)", argument);
    }
    options->board = argument + sizeof word - 1;
}

/* Options of the drives mean nothing where there are none. */
static void check_bus(struct argp_state *state, const cli_options_t *options) {
    const char *given = bus_setup_any_given(&options->setup);
    if (!options->bus && given != NULL) {
        argp_error(state, "--%s is for the bus (allowed: with --bus loop)", given);
    }
    if (!options->bus && options->record != NULL) {
        argp_error(state, "--record is for the bus (allowed: with --bus loop)");
    }
    if (!options->bus && options->board != NULL) {
        argp_error(state, "--board is for the bus (allowed: with --bus loop)");
    }
    if (options->record != NULL && options->board != NULL) {
        argp_error(state, "--record is for a board in this process (allowed: without --board)");
    }
}

static error_t parse_option(int key, char *argument, struct argp_state *state) {
    cli_options_t *options = state->input;
    switch (key) {
    case ARGP_KEY_INIT:
        bus_setup_init(&options->setup, false);
        state->child_inputs[0] = &options->setup;
        state->child_inputs[1] = &options->setup;
        return 0;
    case ARGP_KEY_END:
        check_bus(state, options);
        return 0;
    case CLI_BUS:
        take_bus(argument, state, options);
        return 0;
    case CLI_RECORD:
        options->record = argument;
        return 0;
    case CLI_BOARD:
        take_board(argument, state, options);
        return 0;
    case CLI_STRATEGY:
        options->strategies = argument;
        return 0;
    case CLI_LOG:
        options->log_path = argument;
        return 0;
    default:
        return cli_common_option(key, argument, state, options);
    }
}

static const struct argp_child children[] = {
    {&bus_setup_argp, 0, "With --bus loop, the drives:", 2},
    {&bus_setup_robot_argp, 0, "With --bus loop, the localisation:", 3},
    {0},
};

static const struct argp argp = {
    .options = option_table,
    .parser = parse_option,
    .children = children,
    .args_doc = "SCENARIO",
    .doc = "Simulates one run and prints what it amounted to.\n\n"
           "SCENARIO is `circle' or `eight' (the built-in experiments) or a YAML file.",
    .help_filter = cli_help_filter,
};

/* Where the rows of one run go: --log, --figures, both or neither. */
typedef struct {
    run_log_t logs[2];
    size_t count;
} sinks_t;

static void on_row(void *context, const run_row_t *row) {
    sinks_t *sinks = context;
    for (size_t i = 0; i < sinks->count; ++i) {
        run_log_row(&sinks->logs[i], row);
    }
}

static bool open_sink(sinks_t *sinks, const char *path) {
    scenario_error_t error;
    if (path == NULL) {
        return true;
    }
    if (!run_log_open(&sinks->logs[sinks->count], path, &error)) {
        cli_complain("run", "%s", error.text);
        return false;
    }
    ++sinks->count;
    return true;
}

static void discard_sinks(sinks_t *sinks) {
    for (size_t i = 0; i < sinks->count; ++i) {
        run_log_discard(&sinks->logs[i]);
    }
}

static bool commit_sinks(sinks_t *sinks) {
    scenario_error_t error;
    for (size_t i = 0; i < sinks->count; ++i) {
        if (!run_log_commit(&sinks->logs[i], &error)) {
            cli_complain("run", "%s", error.text);
            discard_sinks(sinks);
            return false;
        }
    }
    return true;
}

/* What a run came to. */
typedef struct {
    run_summary_t summary;
    session_result_t session;     /* on the bus */
    remote_board_counts_t remote; /* with a board elsewhere */
} outcome_t;

/* A record with the set-up in it. */
static bool open_record(record_t *record, const char *path, const session_config_t *config,
                        scenario_error_t *error) {
    const board_recipe_t recipe = {.scenario = *config->scenario, .setup = *config->setup};
    char *text = board_recipe_text(&recipe, error);
    if (text == NULL || !record_open(record, path, "loop", error)) {
        free(text);
        return false;
    }
    record_setup(record, text, SESSION_BEGIN_US);
    free(text);
    return true;
}

static bool run_on_bus(const cli_options_t *options, session_config_t *config, outcome_t *outcome,
                       scenario_error_t *error) {
    record_t record = {.file = NULL};
    if (!bus_setup_strategy(config->scenario->avoidance.strategy, error)) {
        return false;
    }
    if (options->record != NULL) {
        if (!open_record(&record, options->record, config, error)) {
            return false;
        }
        config->record = &record;
    }
    scenario_error_t at_end;
    bool good = session_run(config, &outcome->session, error);
    if (!record_close(&record, &at_end) && good) {
        *error = at_end;
        good = false;
    }
    outcome->summary = outcome->session.robot.summary;
    return good;
}

/* The board is at the other end of a line. */
static bool run_remote(const cli_options_t *options, session_config_t *config, outcome_t *outcome,
                       scenario_error_t *error) {
    remote_board_t *board = malloc(sizeof *board);
    if (board == NULL) {
        return refuse(error, "out of memory");
    }
    bool good = remote_board_open(board, options->board, error);
    if (good) {
        const session_remote_t remote = remote_board(board);
        config->remote = &remote;
        good = run_on_bus(options, config, outcome, error);
        config->remote = NULL;
        outcome->remote = *remote_board_counts(board);
        remote_board_close(board);
    }
    free(board);
    return good;
}

static bool run_any(const cli_options_t *options, session_config_t *config, outcome_t *outcome,
                    scenario_error_t *error) {
    if (options->board != NULL) {
        return run_remote(options, config, outcome, error);
    }
    if (options->bus) {
        return run_on_bus(options, config, outcome, error);
    }
    return run_scenario(config->scenario, config->plan, config->seed, config->sink,
                        &outcome->summary, error);
}

static int simulate(const cli_options_t *options, const scenario_t *scenario, sinks_t *sinks,
                    outcome_t *outcome) {
    scenario_error_t error;
    run_plan_t plan;
    if (!run_plan_make(scenario, &plan, &error)) {
        cli_complain("run", "%s", error.text);
        return CLI_USAGE;
    }
    const run_sink_t sink = {on_row, sinks};
    session_config_t session = {
        .scenario = scenario,
        .plan = &plan,
        .seed = options->seed,
        .setup = &options->setup,
        .sink = &sink,
    };
    const bool ok = run_any(options, &session, outcome, &error);
    run_plan_free(&plan);
    if (!ok) {
        cli_complain("run", "%s", error.text);
        return CLI_USAGE;
    }
    return CLI_OK;
}

static bool print_table(const cli_options_t *options, const scenario_t *scenario,
                        const outcome_t *outcome) {
    const run_summary_t *summary = &outcome->summary;
    const summary_column_t column = {scenario->avoidance.strategy, *summary};
    printf("%s, seed %llu: %ld periods of %g s in %.2g s\n\n", scenario->name,
           (unsigned long long)options->seed, summary->steps, scenario->period_s, summary->wall_s);
    summary_print_table(stdout, &column, 1);
    if (options->bus) {
        bus_report_print_session(stdout, &options->setup, &outcome->session);
    }
    if (options->board != NULL) {
        const remote_board_counts_t *remote = &outcome->remote;
        printf("%-28s%14llu\n", "answers of the board", remote->trips);
        printf("%-28s%14llu\n", "  bytes to it", remote->sent);
        printf("%-28s%14llu\n", "  bytes from it", remote->received);
        printf("%-28s%14.2f\n", "  wall time, s", outcome->session.wall_s);
    }
    return fflush(stdout) == 0;
}

static json_t *remote_json(const remote_board_counts_t *remote) {
    return json_pack("{sI, sI, sI, sI}", "answers", (json_int_t)remote->trips, "skipped",
                     (json_int_t)remote->skipped, "bytes_sent", (json_int_t)remote->sent,
                     "bytes_received", (json_int_t)remote->received);
}

static bool print_json(const cli_options_t *options, const outcome_t *outcome) {
    json_t *document = summary_json(&outcome->summary);
    if (document != NULL && options->bus &&
        json_object_set_new(document, "bus",
                            bus_report_session_json(&options->setup, &outcome->session)) != 0) {
        json_decref(document);
        document = NULL;
    }
    if (document != NULL && options->board != NULL &&
        json_object_set_new(document, "line", remote_json(&outcome->remote)) != 0) {
        json_decref(document);
        document = NULL;
    }
    return summary_write_json(stdout, document);
}

static int report(const cli_options_t *options, const scenario_t *scenario,
                  const outcome_t *outcome) {
    const bool printed =
        options->json ? print_json(options, outcome) : print_table(options, scenario, outcome);
    if (!printed) {
        cli_complain("run", "cannot write the summary: %s", strerror(errno));
    }
    const bool good =
        outcome->summary.collisions == 0 && (!options->bus || session_good(&outcome->session));
    return printed && good ? CLI_OK : CLI_FAILED;
}

/* With the options and the scenario known to be good. */
static int run_and_report(const cli_options_t *options, const scenario_t *scenario,
                          char *figure_log) {
    sinks_t sinks = {0};
    cli_figure_run_t run = {.log_path = figure_log};
    snprintf(run.strategy, sizeof run.strategy, "%s", scenario->avoidance.strategy);
    if (!open_sink(&sinks, options->log_path) || !open_sink(&sinks, figure_log)) {
        discard_sinks(&sinks);
        return CLI_USAGE;
    }
    outcome_t outcome = {0};
    const int status = simulate(options, scenario, &sinks, &outcome);
    if (status != CLI_OK) {
        discard_sinks(&sinks);
        return status;
    }
    run.summary = outcome.summary;
    if (!commit_sinks(&sinks)) {
        return CLI_FAILED;
    }
    if (figure_log != NULL && !cli_figures_draw("run", options->figures, scenario, &run, 1)) {
        return CLI_FAILED;
    }
    return report(options, scenario, &outcome);
}

static int run_with(const cli_options_t *options) {
    scenario_t scenario;
    if (!cli_load_scenario("run", options, &scenario)) {
        return CLI_USAGE;
    }
    if (options->strategies != NULL &&
        !cli_choose_strategy("run", options->strategies, &scenario)) {
        return CLI_USAGE;
    }
    if (options->figures == NULL) {
        return run_and_report(options, &scenario, NULL);
    }
    if (!cli_figures_prepare("run", options->figures)) {
        return CLI_USAGE;
    }
    char *path = cli_figures_log_path(options->figures, &scenario, scenario.avoidance.strategy);
    const int status = path == NULL ? CLI_FAILED : run_and_report(options, &scenario, path);
    free(path);
    return status;
}

int cli_run(int argc, char **argv) {
    cli_options_t options;
    cli_parse(&argp, argc, argv, "run", &options);
    const int status = run_with(&options);
    free(options.sets);
    return status;
}
