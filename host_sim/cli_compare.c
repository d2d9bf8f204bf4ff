#include "cli.h"
#include "log.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>

#define RUNS_MAX 16

static const struct argp_option option_table[] = {
    {"strategies", CLI_STRATEGIES, "A,B,...", 0, "Controllers to compare, by name", 0},
    CLI_COMMON_OPTIONS,
    {0},
};

static error_t parse_option(int key, char *argument, struct argp_state *state) {
    cli_options_t *options = state->input;
    if (key == CLI_STRATEGIES) {
        options->strategies = argument;
        return 0;
    }
    if (key == ARGP_KEY_END && options->scenario != NULL && options->strategies == NULL) {
        argp_error(state, "--strategies is missing (allowed: names with commas between them)");
    }
    return cli_common_option(key, argument, state, options);
}

static const struct argp argp = {
    .options = option_table,
    .parser = parse_option,
    .args_doc = "SCENARIO --strategies A,B,...",
    .doc = "Runs one scenario under several controllers, with the same noise, and prints the "
           "results side by side.\n\n"
           "SCENARIO is `circle' or `eight' (the built-in experiments) or a YAML file.",
    .help_filter = cli_help_filter,
};

/* The runs of one comparison. Logs are open until all runs are done, so that a strategy which
 * refuses the scenario leaves nothing behind. */
typedef struct {
    cli_figure_run_t runs[RUNS_MAX];
    run_log_t logs[RUNS_MAX];
    size_t count;
} comparison_t;

static bool add_strategy(comparison_t *comparison, const char *strategy, const scenario_t *base) {
    scenario_t scenario = *base;
    if (!cli_choose_strategy("compare", strategy, &scenario)) {
        return false;
    }
    for (size_t i = 0; i < comparison->count; ++i) {
        if (strcmp(comparison->runs[i].strategy, strategy) == 0) {
            cli_complain("compare", "--strategies: '%s' is given twice (allowed: once)", strategy);
            return false;
        }
    }
    if (comparison->count == RUNS_MAX) {
        cli_complain("compare", "--strategies: too many (allowed: 1 to %d)", RUNS_MAX);
        return false;
    }
    strcpy(comparison->runs[comparison->count++].strategy, strategy);
    return true;
}

static bool add_strategies(comparison_t *comparison, const char *list, const scenario_t *scenario) {
    char *copy = strdup(list);
    char *rest = copy;
    bool ok = copy != NULL;
    while (ok && rest != NULL) {
        ok = add_strategy(comparison, strsep(&rest, ","), scenario);
    }
    free(copy);
    return ok;
}

static bool open_logs(comparison_t *comparison, const char *directory, const scenario_t *scenario) {
    scenario_error_t error;
    for (size_t i = 0; i < comparison->count; ++i) {
        cli_figure_run_t *run = &comparison->runs[i];
        run->log_path = cli_figures_log_path(directory, scenario, run->strategy);
        if (run->log_path == NULL) {
            cli_complain("compare", "out of memory");
            return false;
        }
        if (!run_log_open(&comparison->logs[i], run->log_path, &error)) {
            cli_complain("compare", "%s", error.text);
            return false;
        }
    }
    return true;
}

static bool commit_logs(comparison_t *comparison) {
    scenario_error_t error;
    for (size_t i = 0; i < comparison->count; ++i) {
        if (!run_log_commit(&comparison->logs[i], &error)) {
            cli_complain("compare", "%s", error.text);
            return false;
        }
    }
    return true;
}

static bool simulate(comparison_t *comparison, const scenario_t *base, uint64_t seed, bool log) {
    scenario_error_t error;
    scenario_t scenario = *base;
    run_plan_t plan;
    if (!run_plan_make(base, &plan, &error)) {
        cli_complain("compare", "%s", error.text);
        return false;
    }
    bool ok = true;
    for (size_t i = 0; ok && i < comparison->count; ++i) {
        cli_figure_run_t *run = &comparison->runs[i];
        strcpy(scenario.avoidance.strategy, run->strategy);
        const run_sink_t sink = {run_log_row, &comparison->logs[i]};
        ok = run_scenario(&scenario, &plan, seed, log ? &sink : NULL, &run->summary, &error);
        if (!ok) {
            cli_complain("compare", "strategy %s: %s", run->strategy, error.text);
        }
    }
    run_plan_free(&plan);
    return ok;
}

static bool print_json(const comparison_t *comparison, const cli_options_t *options,
                       const scenario_t *scenario) {
    json_t *all = json_object();
    for (size_t i = 0; i < comparison->count; ++i) {
        const run_summary_t *summary = &comparison->runs[i].summary;
        json_t *one = summary_json(summary);
        json_object_set_new(one, "stopped_time_s", summary_number(summary->stopped_time_s));
        json_object_set_new(all, comparison->runs[i].strategy, one);
    }
    return summary_write_json(stdout, json_pack("{ss, sI, so}", "scenario", scenario->name, "seed",
                                                (json_int_t)options->seed, "strategies", all));
}

static bool print_table(const comparison_t *comparison, const cli_options_t *options,
                        const scenario_t *scenario) {
    summary_column_t columns[RUNS_MAX];
    for (size_t i = 0; i < comparison->count; ++i) {
        columns[i].title = comparison->runs[i].strategy;
        columns[i].summary = comparison->runs[i].summary;
    }
    printf("%s, seed %llu: %ld periods of %g s\n\n", scenario->name,
           (unsigned long long)options->seed, comparison->runs[0].summary.steps,
           scenario->period_s);
    summary_print_table(stdout, columns, comparison->count);
    return fflush(stdout) == 0;
}

static int report(const comparison_t *comparison, const cli_options_t *options,
                  const scenario_t *scenario) {
    const bool printed = options->json ? print_json(comparison, options, scenario)
                                       : print_table(comparison, options, scenario);
    if (!printed) {
        cli_complain("compare", "cannot write the summary: %s", strerror(errno));
    }
    int collisions = 0;
    for (size_t i = 0; i < comparison->count; ++i) {
        collisions += comparison->runs[i].summary.collisions;
    }
    return printed && collisions == 0 ? CLI_OK : CLI_FAILED;
}

static int compare(comparison_t *comparison, const cli_options_t *options) {
    scenario_t scenario;
    const bool draw = options->figures != NULL;
    if (!cli_load_scenario("compare", options, &scenario) ||
        !add_strategies(comparison, options->strategies, &scenario) ||
        (draw && !cli_figures_prepare("compare", options->figures)) ||
        (draw && !open_logs(comparison, options->figures, &scenario)) ||
        !simulate(comparison, &scenario, options->seed, draw)) {
        return CLI_USAGE;
    }
    if (draw &&
        (!commit_logs(comparison) || !cli_figures_draw("compare", options->figures, &scenario,
                                                       comparison->runs, comparison->count))) {
        return CLI_FAILED;
    }
    return report(comparison, options, &scenario);
}

int cli_compare(int argc, char **argv) {
    cli_options_t options;
    comparison_t comparison = {0};
    cli_parse(&argp, argc, argv, "compare", &options);
    const int status = compare(&comparison, &options);
    for (size_t i = 0; i < comparison.count; ++i) {
        run_log_discard(&comparison.logs[i]);
        free(comparison.runs[i].log_path);
    }
    free(options.sets);
    return status;
}
