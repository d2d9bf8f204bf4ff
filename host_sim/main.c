#include "cli.h"

#include <stdio.h>
#include <string.h>

#ifndef BERTH_VERSION
#error "BERTH_VERSION comes from the build"
#endif

static const char help[] =
    "Usage: berth-sim COMMAND [OPTION...] [SCENARIO]\n"
    "Simulates a differential-drive robot that follows a reference trajectory past obstacles.\n"
    "The controller is the firmware's own code.\n"
    "\n"
    "Commands:\n"
    "  run SCENARIO                        one run: summary, log, figures\n"
    "  compare SCENARIO --strategies A,B   the same scenario under several controllers\n"
    "  campaign                            many random scenes: does the robot ever collide?\n"
    "  replay FILE                         a record of berth-board again, compared bit for bit\n"
    "\n"
    "SCENARIO is `circle' or `eight' (the two built-in experiments) or a YAML file.\n"
    "\n"
    "Examples:\n"
    "  berth-sim run circle\n"
    "  berth-sim run eight --set robot.v_max_mps=0.6 --log eight.csv\n"
    "  berth-sim compare eight --strategies combined,adaptive --figures out\n"
    "\n"
    "  berth-sim COMMAND --help   tells more about a command.\n"
    "  berth-sim --version        prints the version.\n"
    "\n"
    "Exit status: 0 done, 1 a run collided or failed, 2 bad usage or bad input.\n";

typedef struct {
    const char *name;
    int (*call)(int argc, char **argv);
} command_t;

static const command_t commands[] = {
    {"run", cli_run},
    {"compare", cli_compare},
    {"campaign", cli_campaign},
    {"replay", cli_replay},
};

static int print(const char *text) {
    return fputs(text, stdout) != EOF && fflush(stdout) == 0 ? CLI_OK : CLI_FAILED;
}

static int bad_usage(const char *what, const char *argument) {
    fprintf(stderr,
            "berth-sim: %s%s%s%s (allowed: run, compare, campaign, replay, --help, --version)\n"
            "Try `berth-sim --help' for more information.\n",
            what, argument[0] != '\0' ? " '" : "", argument, argument[0] != '\0' ? "'" : "");
    return CLI_USAGE;
}

int main(int argc, char **argv) {
    argp_program_version = "berth-sim " BERTH_VERSION;
    argp_err_exit_status = CLI_USAGE;
    if (argc < 2) {
        return bad_usage("no command given", "");
    }
    const char *first = argv[1];
    if (strcmp(first, "--help") == 0 || strcmp(first, "-h") == 0 || strcmp(first, "-?") == 0) {
        return print(help);
    }
    if (strcmp(first, "--version") == 0 || strcmp(first, "-V") == 0) {
        return print("berth-sim " BERTH_VERSION "\n");
    }
    for (size_t i = 0; i < sizeof commands / sizeof commands[0]; ++i) {
        if (strcmp(first, commands[i].name) == 0) {
            return commands[i].call(argc - 1, argv + 1);
        }
    }
    return bad_usage(first[0] == '-' ? "unknown option" : "unknown command", first);
}
