/* The command line of berth-sim: one function per command, and what the commands share. */
#ifndef HOST_SIM_CLI_H
#define HOST_SIM_CLI_H

#include "bus/session.h"
#include "run.h"
#include "scenario.h"
#include "summary.h"

#include <argp.h>
#include <stdint.h>

/* Exit status. */
#define CLI_OK 0
#define CLI_FAILED 1 /* the run collided or failed */
#define CLI_USAGE 2  /* bad usage or bad input */

/* Each gets its own name as argv[0] and returns the exit status; bad usage ends the process. */
int cli_run(int argc, char **argv);
int cli_compare(int argc, char **argv);
int cli_campaign(int argc, char **argv);
int cli_replay(int argc, char **argv);

/* What the commands are told. Strings point into argv. */
typedef struct {
    const char *scenario;
    const char *strategies; /* one name for `run`, a list with commas for `compare`, or NULL */
    const char *log_path;
    const char *figures;
    bool json;
    uint64_t seed;
    const char **sets; /* room for every argument */
    size_t set_count;
    bool bus;           /* `run`: board and robot on the virtual bus */
    bus_setup_t setup;  /* of the drives there */
    const char *record; /* `run` on the bus: what the board is told and does; NULL: none */
    const char *board;  /* `run` on the bus: path of the line to a board elsewhere; NULL: here */
} cli_options_t;

/* Keys of long options, beyond those of characters. */
enum {
    CLI_SEED = 0x100,
    CLI_SET,
    CLI_JSON,
    CLI_FIGURES,
    CLI_LOG,
    CLI_STRATEGY,
    CLI_STRATEGIES,
    CLI_BUS,
    CLI_RECORD,
    CLI_BOARD
};

/* The rows that run and compare have in their argp tables. */
#define CLI_COMMON_OPTIONS                                                                         \
    {"figures", CLI_FIGURES, "DIR", 0, "Write logs and figures (PDF, SVG, PNG) into DIR", 0},      \
        {"json", CLI_JSON, NULL, 0, "Print the summary as one JSON object and nothing else", 0},   \
        {"seed", CLI_SEED, "N", 0, "Seed of the sensors' noise, 0 to 9223372036854775807 (1)", 0}, \
        {"set",                                                                                    \
         CLI_SET,                                                                                  \
         "KEY=VALUE",                                                                              \
         0,                                                                                        \
         "Change one value of the scenario, by its dotted key; may be repeated",                   \
         0}

/* Handles the common options and the SCENARIO argument. */
error_t cli_common_option(int key, char *argument, struct argp_state *state,
                          cli_options_t *options);

/* argp's help_filter: appends the strategies and the exit status to the help text. */
char *cli_help_filter(int key, const char *text, void *input);

/* Parses one command's line into *options. The caller frees options->sets. */
void cli_parse(const struct argp *argp, int argc, char **argv, const char *name,
               cli_options_t *options);

/* "berth-sim NAME: " and the message, as one line on stderr. */
void cli_complain(const char *name, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* Loads the scenario, built in or from a file, and applies --set. False: it has complained. */
bool cli_load_scenario(const char *name, const cli_options_t *options, scenario_t *scenario);

/* Gives the scenario a strategy, by name. False: it has complained. */
bool cli_choose_strategy(const char *name, const char *strategy, scenario_t *scenario);

/* One run of a set that is drawn together. */
typedef struct {
    char strategy[32];
    char *log_path;
    run_summary_t summary;
} cli_figure_run_t;

/* Is there what drawing needs, and a folder for it? Made if missing. False: it has complained. */
bool cli_figures_prepare(const char *name, const char *directory);

/* DIR/SCENARIO_STRATEGY.csv, on the heap; NULL when out of memory. */
char *cli_figures_log_path(const char *directory, const scenario_t *scenario, const char *strategy);

/* Writes the description of the scene and draws the figures. False: it has complained. */
bool cli_figures_draw(const char *name, const char *directory, const scenario_t *scenario,
                      const cli_figure_run_t *runs, size_t count);

#endif
