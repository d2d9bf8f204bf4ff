#include "bus/replay.h"
#include "cli.h"

#include <errno.h>
#include <string.h>

typedef struct {
    const char *file;
    bool json;
} replay_options_t;

static const struct argp_option option_table[] = {
    {"json", CLI_JSON, NULL, 0, "Print the result as one JSON object and nothing else", 0},
    {0},
};

static error_t parse_option(int key, char *argument, struct argp_state *state) {
    replay_options_t *options = state->input;
    switch (key) {
    case CLI_JSON:
        options->json = true;
        return 0;
    case ARGP_KEY_ARG:
        if (options->file != NULL) {
            argp_error(state, "more than one FILE: '%s' after '%s' (allowed: one)", argument,
                       options->file);
        }
        options->file = argument;
        return 0;
    case ARGP_KEY_NO_ARGS:
        argp_error(state, "FILE is missing (allowed: a record of berth-board --record)");
        return 0;
    default:
        return ARGP_ERR_UNKNOWN;
    }
}

static const struct argp argp = {
    .options = option_table,
    .parser = parse_option,
    .args_doc = "FILE",
    .doc = "Feeds a record of berth-board to the firmware again and compares every frame that the "
           "firmware sends, bit for bit."
           "\v"
           "FILE is what `berth-board --record FILE' wrote; it holds the set-up too.\n"
           "\n"
           "Exit status: 0 all frames are the same, 1 one differs, 2 bad usage or bad input.",
};

static bool print_json(const replay_result_t *result) {
    json_t *difference = json_null();
    if (!result->same) {
        difference = json_pack("{sI, sI, ss}", "frame", (json_int_t)result->frame, "line",
                               (json_int_t)result->line, "what", result->difference);
    }
    return summary_write_json(stdout, json_pack("{sb, sI, sI, sI, sb, ss, so}", "same",
                                                (int)result->same, "runs", (json_int_t)result->runs,
                                                "received", (json_int_t)result->received, "sent",
                                                (json_int_t)result->sent, "cut", (int)result->cut,
                                                "state", result->state, "difference", difference));
}

static bool print_text(const replay_options_t *options, const replay_result_t *result) {
    if (!result->same) {
        printf("%s:%lu: differs at sent frame %lu: %s\n", options->file, result->line,
               result->frame, result->difference);
    }
    printf("%lu runs of the loop, %lu frames received, %lu frames sent and the same%s\n",
           result->runs, result->received, result->sent,
           result->cut ? "; the record ends within a run" : "");
    printf("the board at the end: %s\n", result->state);
    return fflush(stdout) == 0;
}

int cli_replay(int argc, char **argv) {
    static char name[] = "berth-sim replay";
    replay_options_t options = {.file = NULL};
    replay_result_t result;
    scenario_error_t error;
    argv[0] = name;
    argp_parse(&argp, argc, argv, 0, NULL, &options);
    if (!replay_file(options.file, &result, &error)) {
        cli_complain("replay", "%s", error.text);
        return CLI_USAGE;
    }
    if (!(options.json ? print_json(&result) : print_text(&options, &result))) {
        cli_complain("replay", "cannot write the result: %s", strerror(errno));
        return CLI_FAILED;
    }
    return result.same ? CLI_OK : CLI_FAILED;
}
