#include "robot_options.h"

#include "number.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

#ifndef BERTH_VERSION
#error "BERTH_VERSION comes from the build"
#endif

#define SEED_DEFAULT 1
#define TIMEOUT_S 60
#define TIMEOUT_MAX_S 86400

/* Keys beyond those of characters and below BUS_SETUP_DRIVE. */
enum { OPTION_CAN = 0x100, OPTION_JSON, OPTION_LOG, OPTION_SEED, OPTION_SET, OPTION_TIMEOUT };

static const struct argp_option option_table[] = {
    {"can", OPTION_CAN, "BUS", 0,
     "socketcan:NAME (an interface) or slcan:PATH (a tty, a pty or a unix socket)", 0},
    {"json", OPTION_JSON, NULL, 0, "Print the summary as one JSON object and nothing else", 0},
    {"log", OPTION_LOG, "FILE.csv", 0, "Write one row a period", 0},
    {"seed", OPTION_SEED, "N", 0, "Seed of the sensors' noise, 0 to 9223372036854775807 (1)", 0},
    {"set", OPTION_SET, "KEY=VALUE", 0,
     "Change one value of the scenario, by its dotted key; may be repeated", 0},
    {"timeout", OPTION_TIMEOUT, "S", 0,
     "Give up when no board is heard for so long before the run, 1 to 86400 (60)", 0},
    {0},
};

static void take_count(const char *name, const char *argument, uint64_t least, uint64_t most,
                       uint64_t *value, struct argp_state *state) {
    uint64_t number = 0;
    if (!number_parse_count(argument, most, &number) || number < least) {
        argp_error(state, "--%s: '%s' is not possible (allowed: an integer from %llu to %llu)",
                   name, argument, (unsigned long long)least, (unsigned long long)most);
    }
    *value = number;
}

static void take_scenario(robot_options_t *options, const char *argument,
                          struct argp_state *state) {
    if (options->scenario != NULL) {
        argp_error(state, "more than one SCENARIO: '%s' after '%s' (allowed: one)", argument,
                   options->scenario);
    }
    options->scenario = argument;
}

static void check(const robot_options_t *options, struct argp_state *state) {
    if (options->can == NULL) {
        argp_error(state, "--can is missing (allowed: socketcan:NAME or slcan:PATH)");
    }
    if (options->scenario == NULL) {
        argp_error(state, "SCENARIO is missing (allowed: circle, eight or a YAML file)");
    }
}

static error_t parse_option(int key, char *argument, struct argp_state *state) {
    robot_options_t *options = state->input;
    switch (key) {
    case ARGP_KEY_INIT:
        state->child_inputs[0] = &options->setup;
        state->child_inputs[1] = &options->setup;
        return 0;
    case OPTION_CAN:
        options->can = argument;
        return 0;
    case OPTION_JSON:
        options->json = true;
        return 0;
    case OPTION_LOG:
        options->log_path = argument;
        return 0;
    case OPTION_SEED:
        take_count("seed", argument, 0, INT64_MAX, &options->seed, state);
        return 0;
    case OPTION_SET:
        options->sets[options->set_count++] = argument;
        return 0;
    case OPTION_TIMEOUT:
        take_count("timeout", argument, 1, TIMEOUT_MAX_S, &options->timeout_s, state);
        return 0;
    case ARGP_KEY_ARG:
        take_scenario(options, argument, state);
        return 0;
    case ARGP_KEY_END:
        check(options, state);
        return 0;
    default:
        return ARGP_ERR_UNKNOWN;
    }
}

static const struct argp_child children[] = {
    {&bus_setup_argp, 0, "The drives:", 2},
    {&bus_setup_robot_argp, 0, "The localisation:", 3},
    {0},
};

static const struct argp argp = {
    .options = option_table,
    .parser = parse_option,
    .children = children,
    .args_doc = "SCENARIO",
    .doc = "Simulates two wheel drives and the robot that they move, on a CAN bus and in real "
           "time: the other side of berth-board.\v"
           "SCENARIO is `circle' or `eight' (the built-in experiments) or a YAML file; give "
           "berth-board the same one. The run begins when the board does, and is summed up when "
           "it is over; an interrupt (SIGINT, SIGTERM) ends it early.\n\n"
           "Exit status: 0 done, 1 the run collided, was not finished or never began, 2 bad usage "
           "or bad input.",
};

bool robot_options_parse(robot_options_t *options, int argc, char **argv) {
    argp_program_version = "berth-robot " BERTH_VERSION;
    argp_err_exit_status = ROBOT_USAGE;
    setenv("ARGP_HELP_FMT", "rmargin=100", 0);
    *options = (robot_options_t){.seed = SEED_DEFAULT, .timeout_s = TIMEOUT_S};
    bus_setup_init(&options->setup, true);
    options->sets = calloc((size_t)argc, sizeof *options->sets);
    if (options->sets == NULL) {
        robot_complain("out of memory");
        return false;
    }
    argp_parse(&argp, argc, argv, 0, NULL, options);
    return true;
}

void robot_options_free(robot_options_t *options) {
    free(options->sets);
    options->sets = NULL;
}

void robot_complain(const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    fputs("berth-robot: ", stderr);
    vfprintf(stderr, format, arguments);
    fputc('\n', stderr);
    va_end(arguments);
}
