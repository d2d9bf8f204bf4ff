#include "cli.h"
#include "number.h"
#include "strategy.h"

#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#define SEED_DEFAULT 1u

void cli_complain(const char *name, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    fprintf(stderr, "berth-sim %s: ", name);
    vfprintf(stderr, format, arguments);
    fputc('\n', stderr);
    va_end(arguments);
}

static void take_scenario(const char *argument, struct argp_state *state, cli_options_t *options) {
    if (options->scenario != NULL) {
        argp_error(state, "more than one SCENARIO: '%s' after '%s' (allowed: one)", argument,
                   options->scenario);
    }
    options->scenario = argument;
}

error_t cli_common_option(int key, char *argument, struct argp_state *state,
                          cli_options_t *options) {
    switch (key) {
    case CLI_FIGURES:
        options->figures = argument;
        return 0;
    case CLI_JSON:
        options->json = true;
        return 0;
    case CLI_SEED:
        if (!number_parse_count(argument, INT64_MAX, &options->seed)) {
            argp_error(state,
                       "--seed: '%s' is no seed (allowed: an integer from 0 to "
                       "9223372036854775807)",
                       argument);
        }
        return 0;
    case CLI_SET:
        options->sets[options->set_count++] = argument;
        return 0;
    case ARGP_KEY_ARG:
        take_scenario(argument, state, options);
        return 0;
    case ARGP_KEY_NO_ARGS:
        argp_error(state, "SCENARIO is missing (allowed: circle, eight or a YAML file)");
        return 0;
    default:
        return ARGP_ERR_UNKNOWN;
    }
}

char *cli_help_filter(int key, const char *text, void *input) {
    (void)input;
    if (key != ARGP_KEY_HELP_EXTRA) {
        return (char *)text;
    }
    char *extra = NULL;
    size_t size = 0;
    FILE *stream = open_memstream(&extra, &size);
    if (stream == NULL) {
        return NULL;
    }
    fputs("Strategies:\n", stream);
    for (size_t i = 0; strategies[i] != NULL; ++i) {
        fprintf(stream, "  %-15s %s\n", strategies[i]->name, strategies[i]->summary);
    }
    fputs("\nExit status: 0 done, 1 a run collided or failed, 2 bad usage or bad input.", stream);
    fclose(stream);
    return extra;
}

void cli_parse(const struct argp *argp, int argc, char **argv, const char *name,
               cli_options_t *options) {
    static char full_name[64];
    *options = (cli_options_t){.seed = SEED_DEFAULT};
    options->sets = calloc((size_t)argc, sizeof *options->sets);
    if (options->sets == NULL) {
        cli_complain(name, "out of memory");
        exit(CLI_FAILED);
    }
    snprintf(full_name, sizeof full_name, "berth-sim %s", name);
    argv[0] = full_name;
    setenv("ARGP_HELP_FMT", "rmargin=100", 0); /* the strategies' lines are longer than 79 */
    argp_parse(argp, argc, argv, 0, NULL, options);
}

bool cli_load_scenario(const char *name, const cli_options_t *options, scenario_t *scenario) {
    scenario_error_t error;
    if (!scenario_open(options->scenario, options->sets, options->set_count, scenario, &error)) {
        cli_complain(name, "%s", error.text);
        return false;
    }
    return true;
}

bool cli_choose_strategy(const char *name, const char *strategy, scenario_t *scenario) {
    if (strategy_find(strategy) != NULL && strlen(strategy) < sizeof scenario->avoidance.strategy) {
        scenario_error_t error;
        strcpy(scenario->avoidance.strategy, strategy);
        /* what the regions must be depends on the strategy */
        if (!scenario_check(scenario, &error)) {
            cli_complain(name, "strategy %s: %s", strategy, error.text);
            return false;
        }
        return true;
    }
    fprintf(stderr, "berth-sim %s: unknown strategy '%s' (allowed:", name, strategy);
    for (size_t i = 0; strategies[i] != NULL; ++i) {
        fprintf(stderr, "%s %s", i == 0 ? "" : ",", strategies[i]->name);
    }
    fputs(")\n", stderr);
    return false;
}
