#include "bus/bus_campaign.h"
#include "campaign.h"
#include "campaign_rows.h"
#include "cli.h"
#include "number.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#define RUNS_DEFAULT 1000
#define RUNS_MAX 1000000000u
#define JOBS_MAX 1024u
#define ROWS_MAX 10000000u /* kept in memory until the end */
#define BAR_WIDTH 40
#define BAD_SHOWN 20u

enum {
    CAMPAIGN_RUNS = 0x200,
    CAMPAIGN_JOBS,
    CAMPAIGN_OVERLAP,
    CAMPAIGN_PLANT,
    CAMPAIGN_SCENE,
    CAMPAIGN_ROWS,
    CAMPAIGN_FAULTS
};

typedef struct {
    cli_options_t common; /* first: cli_parse hands this to the option parser */
    campaign_overlap_t overlap;
    campaign_plant_t plant;
    uint64_t runs, jobs;
    const char *scene_path, *rows_path;
    bool faults; /* on the bus */
} campaign_cli_t;

static const struct argp_option option_table[] = {
    {"runs", CAMPAIGN_RUNS, "N", 0, "Number of runs, 1 to 1000000000 (1000)", 0},
    {"seed", CLI_SEED, "N", 0, "Seed of the first run; the others count up from it (1)", 0},
    {"jobs", CAMPAIGN_JOBS, "J", 0, "Threads, 1 to 1024 (one for each core)", 0},
    {"overlap", CAMPAIGN_OVERLAP, "HOW", 0,
     "Conservative circles that overlap: any (as drawn), demand, or forbid", 0},
    {"plant", CAMPAIGN_PLANT, "WHICH", 0,
     "base: as --set has it (default). drawn: each run draws its own: tau up to 0.1 s, 2 to 5 "
     "m/s2, "
     "noise up to 5 mm and 5 mrad, slip up to 5 %, a pose up to 0.1 s old. untold: as drawn, and "
     "the firmware is told only a part of it, drawn too: its clearance condition holds for a "
     "better "
     "robot. late: as drawn, with a pose up to 0.2 s old",
     0},
    {"strategy", CLI_STRATEGY, "S", 0, "Controller (combined)", 0},
    {"set", CLI_SET, "KEY=VALUE", 0,
     "Change one value of both base scenarios (robot, plant, mpc, avoidance); may be repeated", 0},
    {"scene", CAMPAIGN_SCENE, "FILE.yaml", 0,
     "Write the first run's scene as a scenario file for `berth-sim run' instead of running", 0},
    {"rows", CAMPAIGN_ROWS, "FILE.csv", 0, "Write one row a run, 10000000 at most", 0},
    {"bus", CLI_BUS, "loop", 0,
     "Put board and robot on a virtual CAN bus; without --drive each run draws one of the three. "
     "The drives' watchdog counts as delay (plant.watchdog_s=0.25 unless set)",
     0},
    {"faults", CAMPAIGN_FAULTS, NULL, 0,
     "With --bus loop: one thing goes wrong in each run, drawn from its seed", 0},
    {"json", CLI_JSON, NULL, 0, "Print the totals as one JSON object and nothing else", 0},
    {0},
};

static void parse_count(const char *option, const char *argument, uint64_t maximum, uint64_t *value,
                        struct argp_state *state) {
    if (!number_parse_count(argument, maximum, value) || *value == 0) {
        argp_error(state, "%s: '%s' is no such number (allowed: an integer from 1 to %llu)", option,
                   argument, (unsigned long long)maximum);
    }
}

/* Index of a word in a list that ends with NULL. */
static int parse_word(const char *option, const char *argument, const char *const *names,
                      struct argp_state *state) {
    char allowed[64] = "";
    for (int i = 0; names[i] != NULL; i++) {
        if (strcmp(argument, names[i]) == 0) {
            return i;
        }
        const size_t length = strlen(allowed);
        (void)snprintf(allowed + length, sizeof allowed - length, "%s%s", i == 0 ? "" : ", ",
                       names[i]);
    }
    argp_error(state, "%s: '%s' (allowed: %s)", option, argument, allowed);
    return 0;
}

static const char *const overlap_names[] = {"any", "demand", "forbid", NULL};
static const char *const plant_names[] = {"base", "drawn", "untold", "late", NULL};

static void check_bus(const campaign_cli_t *cli, struct argp_state *state) {
    const char *given = bus_setup_any_given(&cli->common.setup);
    if (!cli->common.bus && given != NULL) {
        argp_error(state, "--%s is for the bus (allowed: with --bus loop)", given);
    }
    if (!cli->common.bus && cli->faults) {
        argp_error(state, "--faults are the bus's (allowed: with --bus loop)");
    }
    if (cli->rows_path != NULL && cli->runs > ROWS_MAX) {
        argp_error(state, "--rows: %llu runs (allowed: up to %u; more in parts, by --seed)",
                   (unsigned long long)cli->runs, ROWS_MAX);
    }
}

static error_t parse_bus_option(int key, char *argument, struct argp_state *state,
                                campaign_cli_t *cli) {
    switch (key) {
    case ARGP_KEY_INIT:
        bus_setup_init(&cli->common.setup, false);
        state->child_inputs[0] = &cli->common.setup;
        state->child_inputs[1] = &cli->common.setup;
        return 0;
    case ARGP_KEY_END:
        check_bus(cli, state);
        return 0;
    case CLI_BUS:
        if (strcmp(argument, "loop") != 0) {
            argp_error(state, "--bus: '%s' is no bus here (allowed: loop)", argument);
        }
        cli->common.bus = true;
        return 0;
    case CAMPAIGN_FAULTS:
        cli->faults = true;
        return 0;
    default:
        return cli_common_option(key, argument, state, &cli->common);
    }
}

static error_t parse_option(int key, char *argument, struct argp_state *state) {
    campaign_cli_t *cli = state->input;
    switch (key) {
    case CAMPAIGN_RUNS:
        parse_count("--runs", argument, RUNS_MAX, &cli->runs, state);
        return 0;
    case CAMPAIGN_JOBS:
        parse_count("--jobs", argument, JOBS_MAX, &cli->jobs, state);
        return 0;
    case CAMPAIGN_OVERLAP:
        cli->overlap = (campaign_overlap_t)parse_word("--overlap", argument, overlap_names, state);
        return 0;
    case CAMPAIGN_PLANT:
        cli->plant = (campaign_plant_t)parse_word("--plant", argument, plant_names, state);
        return 0;
    case CAMPAIGN_ROWS:
        cli->rows_path = argument;
        return 0;
    case CAMPAIGN_SCENE:
        cli->scene_path = argument;
        return 0;
    case CLI_STRATEGY:
        cli->common.strategies = argument;
        return 0;
    case ARGP_KEY_ARG:
        argp_error(state, "unexpected argument '%s' (a campaign draws its own scenes)", argument);
        return 0;
    case ARGP_KEY_NO_ARGS:
        return 0;
    default:
        return parse_bus_option(key, argument, state, cli);
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
    .doc = "Runs many random scenes and prints the totals.\n\n"
           "Each run draws circle or eight, 1, 3 or 6 obstacles of hard radius 0.05 to 0.25 m near "
           "the path, and a start off the path, all from its own seed. The conservative radius is "
           "what the clearance condition demands of what the firmware is told, and 1 cm more. A "
           "campaign of one run with the seed of a bad run is that run again.",
    .help_filter = cli_help_filter,
};

/* What a scene draws or is built on cannot be set. */
static bool may_set(const campaign_cli_t *cli, const char *set) {
    static const char *const drawn[] = {"reference", "obstacles", "start", "name"};
    bool may = true;
    for (size_t i = 0; i < sizeof drawn / sizeof drawn[0]; i++) {
        may = may && strncmp(set, drawn[i], strlen(drawn[i])) != 0;
    }
    if (!may) {
        cli_complain("campaign",
                     "--set: %s: drawn for each run (allowed: keys of robot, plant, mpc, "
                     "avoidance, period_s, duration_s)",
                     set);
    } else if (cli->plant != CAMPAIGN_PLANT_BASE && strncmp(set, "plant.", 6) == 0 &&
               strncmp(set, "plant.watchdog_s", 16) != 0 &&
               strncmp(set, "plant.alpha_max_radps2", 22) != 0) {
        cli_complain("campaign",
                     "--set: %s: drawn for each run (allowed: with --plant base; of the plant "
                     "alpha_max_radps2 and watchdog_s)",
                     set);
        may = false;
    }
    return may;
}

/* One of the two scenarios that scenes are made from. */
static bool load_base(const campaign_cli_t *cli, const char *shape, scenario_t *scenario) {
    scenario_error_t error;
    const char *strategy = cli->common.strategies == NULL ? "combined" : cli->common.strategies;
    (void)scenario_builtin(shape, scenario);
    scenario->obstacle_count = 0; /* each run draws its own */
    scenario->plant.watchdog_s = cli->common.bus ? BUS_CAMPAIGN_WATCHDOG_S : 0.0;
    if (!cli_choose_strategy("campaign", strategy, scenario)) {
        return false;
    }
    for (size_t i = 0; i < cli->common.set_count; i++) {
        const char *set = cli->common.sets[i];
        if (!may_set(cli, set)) {
            return false;
        }
        if (!scenario_set(scenario, set, &error)) {
            cli_complain("campaign", "--set: %s", error.text);
            return false;
        }
    }
    if (!scenario_check(scenario, &error)) {
        cli_complain("campaign", "%s", error.text);
        return false;
    }
    return true;
}

static void show_progress(void *context, long done, long total) {
    (void)context;
    const int filled = (int)((double)done / (double)total * BAR_WIDTH);
    fprintf(stderr, "\r[%.*s%*s] %ld of %ld runs", filled,
            "########################################", BAR_WIDTH - filled, "", done, total);
    if (done == total) {
        fputc('\n', stderr);
    }
    fflush(stderr);
}

static json_t *result_json(const campaign_cli_t *cli, const campaign_result_t *result) {
    json_t *modes = json_object();
    json_t *seeds = json_array();
    for (int mode = 0; mode < RUN_MODES; mode++) {
        json_object_set_new(modes, berth_mode_text((berth_mode_t)mode),
                            json_real(result->mode_time_s[mode]));
    }
    for (size_t i = 0; i < result->bad_count; i++) {
        json_array_append_new(seeds, json_integer((json_int_t)result->bad[i].seed));
    }
    json_t *document = json_object();
    json_object_set_new(document, "runs", json_integer(result->runs));
    json_object_set_new(document, "collisions", json_integer(result->collisions));
    json_object_set_new(document, "worst_clearance_m", summary_number(result->worst_clearance_m));
    json_object_set_new(document, "recovered", json_integer(result->recovered));
    json_object_set_new(document, "blocked", json_integer(result->blocked));
    json_object_set_new(document, "steps", json_integer(result->steps));
    json_object_set_new(document, "wall_s", json_real(result->wall_s));
    json_object_set_new(document, "mode_time_s", modes);
    json_object_set_new(document, "bad_seeds", seeds);
    if (cli->common.bus) {
        json_object_set_new(document, "stopped", json_integer(result->stopped));
        json_object_set_new(document, "wrong", json_integer(result->wrong));
    }
    return document;
}

static void print_bad(const campaign_result_t *result) {
    const size_t shown = result->bad_count < BAD_SHOWN ? result->bad_count : BAD_SHOWN;
    if (shown == 0) {
        return;
    }
    printf("\nRuns that went wrong or did not recover; the same options with --runs 1 --seed N\n"
           "repeat one, and --scene FILE.yaml writes it for `berth-sim run':\n");
    for (size_t i = 0; i < shown; i++) {
        const campaign_bad_t *bad = &result->bad[i];
        const bool told = bad->wrong != NULL; /* a collision on the bus is told as wrong already */
        printf("  --seed %llu%s%s%s%s%s\n", (unsigned long long)bad->seed, told ? "  " : "",
               told ? bad->wrong : "", bad->collided && !told ? "  collided" : "",
               bad->unrecovered ? "  not recovered" : "", bad->blocked ? "  blocked" : "");
    }
    if (result->bad_count > shown) {
        printf("  and %zu more (--json lists them all)\n", result->bad_count - shown);
    }
}

static void print_result(const campaign_cli_t *cli, const campaign_result_t *result,
                         uint64_t jobs) {
    double total_s = 0.0;
    for (int mode = 0; mode < RUN_MODES; mode++) {
        total_s += result->mode_time_s[mode];
    }
    printf("runs                 %ld\n", result->runs);
    printf("collisions           %ld\n", result->collisions);
    printf("worst clearance      %.4f m\n", result->worst_clearance_m);
    printf("recovered            %ld (%.3f %%)\n", result->recovered,
           100.0 * (double)result->recovered / (double)result->runs);
    printf("blocked              %ld\n", result->blocked);
    if (cli->common.bus) {
        printf("stopped by a fault   %ld\n", result->stopped);
        printf("not as it must be    %ld\n", result->wrong);
    }
    for (int mode = 0; mode < RUN_MODES; mode++) {
        printf("%-20s %.2f s (%.3f %%)\n", berth_mode_text((berth_mode_t)mode),
               result->mode_time_s[mode], 100.0 * result->mode_time_s[mode] / total_s);
    }
    printf("closed-loop steps    %ld in %.2f s with --jobs %llu: %.2f million a second\n",
           result->steps, result->wall_s, (unsigned long long)jobs,
           1.0e-6 * (double)result->steps / result->wall_s);
    print_bad(result);
}

static int write_scene(const campaign_options_t *options, const char *path) {
    scenario_t scene;
    scenario_error_t error;
    if (!campaign_scene(options, options->seed, &scene, &error) ||
        !scenario_write(&scene, path, &error)) {
        cli_complain("campaign", "%s", error.text);
        return CLI_USAGE;
    }
    return CLI_OK;
}

static int report(const campaign_cli_t *cli, const campaign_result_t *result, uint64_t jobs) {
    if (!cli->common.json) {
        print_result(cli, result, jobs);
    } else if (!summary_write_json(stdout, result_json(cli, result))) {
        return CLI_FAILED;
    }
    const bool good = result->collisions == 0 && result->wrong == 0;
    return fflush(stdout) == 0 && good ? CLI_OK : CLI_FAILED;
}

/* Runs it with rows where they are wanted, and reports. */
static int run_and_report(const campaign_cli_t *cli, campaign_options_t *options) {
    campaign_result_t result;
    scenario_error_t error;
    const campaign_progress_fn progress = isatty(STDERR_FILENO) ? show_progress : NULL;
    if (cli->rows_path != NULL) {
        options->rows = calloc((size_t)options->runs, sizeof *options->rows);
        if (options->rows == NULL) {
            cli_complain("campaign", "out of memory for %ld rows", options->runs);
            return CLI_FAILED;
        }
    }
    bool good = campaign_run(options, progress, NULL, &result, &error);
    if (good && options->rows != NULL &&
        !campaign_rows_write(cli->rows_path, options->rows, options->runs, &error)) {
        campaign_result_free(&result);
        good = false;
    }
    free(options->rows);
    if (!good) {
        cli_complain("campaign", "%s", error.text);
        return CLI_USAGE;
    }
    const int status = report(cli, &result, (uint64_t)options->jobs);
    campaign_result_free(&result);
    return status;
}

/* The virtual bus, if the campaign is to run there. */
static bool choose_bus(const campaign_cli_t *cli, bus_campaign_t *bus,
                       campaign_options_t *options) {
    scenario_error_t error;
    if (!cli->common.bus) {
        return true;
    }
    if (!bus_setup_strategy(options->circle.avoidance.strategy, &error) ||
        !bus_campaign_init(bus, &cli->common.setup, cli->faults, &error)) {
        cli_complain("campaign", "%s", error.text);
        return false;
    }
    options->run = bus_campaign_run;
    options->run_context = bus;
    return true;
}

static int run_campaign(const campaign_cli_t *cli) {
    bus_campaign_t bus;
    campaign_options_t options = {
        .runs = (long)cli->runs,
        .seed = cli->common.seed,
        .jobs = (int)(cli->jobs < cli->runs ? cli->jobs : cli->runs),
        .overlap = cli->overlap,
        .plant = cli->plant,
    };
    if (!load_base(cli, "circle", &options.circle) || !load_base(cli, "eight", &options.eight)) {
        return CLI_USAGE;
    }
    if (cli->common.seed > (uint64_t)INT64_MAX - (cli->runs - 1)) {
        cli_complain("campaign",
                     "--seed: %llu and %llu runs count beyond the largest seed "
                     "(allowed: seed + runs up to 9223372036854775808)",
                     (unsigned long long)cli->common.seed, (unsigned long long)cli->runs);
        return CLI_USAGE;
    }
    if (cli->scene_path != NULL) {
        return write_scene(&options, cli->scene_path);
    }
    return choose_bus(cli, &bus, &options) ? run_and_report(cli, &options) : CLI_USAGE;
}

int cli_campaign(int argc, char **argv) {
    const long cores = sysconf(_SC_NPROCESSORS_ONLN);
    campaign_cli_t cli = {.runs = RUNS_DEFAULT, .jobs = cores > 0 ? (uint64_t)cores : 1};
    cli_parse(&argp, argc, argv, "campaign", &cli.common);
    const int status = run_campaign(&cli);
    free(cli.common.sets);
    return status;
}
