#include "board_host.h"

#include "number.h"
#include "refusal.h"
#include "strategy_common.h"

#include <stdlib.h>
#include <string.h>

/* --- options ---------------------------------------------------------------------------------- */

static const struct argp_option option_table[] = {
    {"fix-timeout", BOARD_FIX_TIMEOUT, "MS", 0,
     "Without a pose fix for so long: fault, 1 to 3600000, or 0: dead reckoning will do (0)", 0},
    {"following", BOARD_FOLLOWING, "RADPS", 0,
     "A wheel that differs from its command by more than this for 0.5 s: fault, 0.01 to 1000, or "
     "0: "
     "not watched (0)",
     0},
    {"late", BOARD_LATE, "MS", 0,
     "A control step later than this: fault, 1 to 10000 (three periods)", 0},
    {0},
};

static uint32_t parse_ms(const char *name, const char *argument, uint32_t least, uint32_t most,
                         struct argp_state *state) {
    uint64_t count = 0;
    if (!number_parse_count(argument, most, &count) || count < least) {
        argp_error(state, "--%s: '%.40s' is not possible (allowed: an integer from %u to %u)", name,
                   argument, (unsigned)least, (unsigned)most);
    }
    return (uint32_t)count;
}

static error_t parse_option(int key, char *argument, struct argp_state *state) {
    board_options_t *options = state->input;
    double value = 0.0;
    switch (key) {
    case BOARD_FIX_TIMEOUT:
        options->fix_timeout_ms = parse_ms("fix-timeout", argument, 0, 3600000, state);
        return 0;
    case BOARD_LATE:
        options->late_ms = parse_ms("late", argument, 1, 10000, state);
        return 0;
    case BOARD_FOLLOWING:
        if (!number_parse(argument, &value) || (value != 0.0 && (value < 0.01 || value > 1000.0))) {
            argp_error(state, "--following: '%.40s' is not possible (allowed: 0, or 0.01 to 1000)",
                       argument);
        }
        options->following_radps = value;
        return 0;
    default:
        return ARGP_ERR_UNKNOWN;
    }
}

const struct argp board_options_argp = {.options = option_table, .parser = parse_option};

/* --- the board -------------------------------------------------------------------------------- */

bool board_host_make(board_host_t *host, const board_recipe_t *recipe, int64_t now_us,
                     scenario_error_t *error) {
    berth_board_config_t config;
    berth_refusal_t refusal = {.field = BERTH_FIELD_NONE};
    if (!bus_setup_strategy(recipe->scenario.avoidance.strategy, error) ||
        !run_plan_make(&recipe->scenario, &host->plan, error)) {
        return false;
    }
    bool good = bus_setup_board_config(&recipe->setup, &recipe->scenario, host->plan.plan.period_us,
                                       &config, error);
    if (good) {
        strategy_constrain(&config.controller, &recipe->scenario, &host->workspace);
        config.supervisor.fix_timeout_us = recipe->options.fix_timeout_ms * 1000u;
        config.supervisor.following_radps = (float)recipe->options.following_radps;
        if (recipe->options.late_ms > 0) {
            config.supervisor.period_late_us = recipe->options.late_ms * 1000u;
        }
        const berth_error_t result =
            berth_board_init(&host->board, &host->plan.plan, &config, now_us, &refusal);
        if (result != BERTH_OK) {
            bus_setup_refusal_text(result, &refusal, error);
            good = false;
        }
    }
    good = good && bus_setup_obstacles(&recipe->setup, &recipe->scenario, &host->board, error);
    if (!good) {
        run_plan_free(&host->plan);
    }
    return good;
}

void board_host_free(board_host_t *host) {
    run_plan_free(&host->plan);
}

/* --- as text ---------------------------------------------------------------------------------- */

char *board_recipe_text(const board_recipe_t *recipe, scenario_error_t *error) {
    char *text = NULL;
    size_t size = 0;
    FILE *file = open_memstream(&text, &size);
    if (file == NULL) {
        (void)refuse(error, "out of memory");
        return NULL;
    }
    char following[NUMBER_TEXT_MAX];
    number_text(recipe->options.following_radps, following, sizeof following);
    bus_setup_print(&recipe->setup, file);
    fprintf(file, "--fix-timeout=%u\n--following=%s\n", (unsigned)recipe->options.fix_timeout_ms,
            following);
    if (recipe->options.late_ms > 0) {
        fprintf(file, "--late=%u\n", (unsigned)recipe->options.late_ms);
    }
    fputc('\n', file);
    bool good = scenario_print(&recipe->scenario, file, error);
    if (fclose(file) != 0 && good) {
        good = refuse(error, "out of memory");
    }
    if (!good) {
        free(text);
        return NULL;
    }
    return text;
}

/* Set-up text is a line for each option, so that no word in it needs quoting. */
#define OPTIONS_MAX 64

/* NOLINTNEXTLINE(readability-non-const-parameter): the type is that of the C library */
static error_t parse_nothing(int key, char *argument, struct argp_state *state) {
    board_recipe_t *recipe = state->input;
    (void)argument;
    if (key == ARGP_KEY_INIT) {
        state->child_inputs[0] = &recipe->setup;
        state->child_inputs[1] = &recipe->options;
        return 0;
    }
    return key == ARGP_KEY_ARG ? EINVAL : ARGP_ERR_UNKNOWN;
}

/* Options refuse themselves on stderr; what a record holds has passed them once, so their words
 * hardly matter, but a status does. */
static bool parse_options(int count, char **words, board_recipe_t *recipe) {
    static const struct argp_child children[] = {
        {&bus_setup_argp, 0, NULL, 0}, {&board_options_argp, 0, NULL, 0}, {0}};
    static const struct argp argp = {.parser = parse_nothing, .children = children};
    return argp_parse(&argp, count, words, ARGP_SILENT, NULL, recipe) == 0;
}

bool board_recipe_parse(const char *name, const char *text, board_recipe_t *recipe,
                        scenario_error_t *error) {
    const char *yaml = strstr(text, "\n\n");
    if (yaml == NULL) {
        return refuse(error,
                      "%s: the set-up is not whole (allowed: options, an empty line, a "
                      "scenario)",
                      name);
    }
    char *copy = strndup(text, (size_t)(yaml - text));
    if (copy == NULL) {
        return refuse(error, "out of memory");
    }
    char program[] = "set-up";
    char *words[OPTIONS_MAX + 1] = {program};
    int count = 1;
    char *rest = copy;
    for (char *word; count < OPTIONS_MAX && (word = strsep(&rest, "\n")) != NULL;) {
        words[count++] = word;
    }
    *recipe = (board_recipe_t){.options = {.fix_timeout_ms = 0}};
    bus_setup_init(&recipe->setup, false);
    const bool good = rest == NULL && parse_options(count, words, recipe);
    free(copy);
    if (!good) {
        return refuse(error,
                      "%s: the set-up's options are not good (allowed: what berth-board "
                      "writes)",
                      name);
    }
    return scenario_load_text(name, yaml + 2, &recipe->scenario, error);
}
