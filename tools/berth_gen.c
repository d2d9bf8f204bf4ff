/* berth-gen: a reference in, a plan with its gain table out. */
#include "gen_plan.h"
#include "gen_write.h"
#include "output_file.h"
#include "refusal.h"

#include <errno.h>
#include <getopt.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifndef BERTH_VERSION
#error "BERTH_VERSION comes from the build"
#endif

#define STATUS_OK 0
#define STATUS_FAILED 1 /* the output could not be written */
#define STATUS_USAGE 2  /* bad usage or bad input */

static const char help[] =
    "Usage: berth-gen [OPTION]... circle | eight | FILE.csv\n"
    "Samples a reference, computes the tracking gain of each sample, and writes both.\n"
    "\n"
    "Reference:\n"
    "  circle               x = cos(0.3 t), y = sin(0.3 t)\n"
    "  eight                x = 1.8 sin(0.15 t), y = 1.2 sin(0.30 t)\n"
    "  FILE.csv             header t,x,y,theta,v,omega; seconds, metres, radians; one row a\n"
    "                       period from t = 0; v and omega must fit the poses\n"
    "  --period T           seconds, 0.001 to 1 (shapes: 0.05; a file: its own, and T must\n"
    "                       agree with it)\n"
    "  --duration D         seconds, shapes only (circle 30, eight 45; with --closed one lap)\n"
    "  --closed             after the last sample comes the first again; a shape's duration\n"
    "                       must be whole laps, within half a period\n"
    "  --open               the reference ends with its last sample (default)\n"
    "\n"
    "Gain, least sum of e'Qe + u'Ru over the horizon:\n"
    "  --horizon N          periods, 1 to 200 (20)\n"
    "  --q A,B,C            weights on e1, e2, e3, each 0 to 1000000 (10,40,1)\n"
    "  --r A,B              weights on v and omega, each 0.000001 to 1000000 (0.5,0.1)\n"
    "  --discretization M   euler, or zoh: the exact zero-order hold (euler)\n"
    "\n"
    "Output:\n"
    "  --format F           csv: k,x,y,theta,v,omega,k11,k12,k13,k21,k22,k23 (default)\n"
    "                       c: const arrays and a berth_plan_t, ready to compile\n"
    "  --name SYMBOL        C name of the plan (berth_plan_circle, berth_plan_eight, or\n"
    "                       berth_plan_ and the file's name)\n"
    "  -o FILE              csv: where to write, - for standard output (default)\n"
    "                       c: required, FILE.c; FILE.h is written beside it\n"
    "\n"
    "  --help, --version    print this, or the version\n"
    "\n"
    "Examples:\n"
    "  berth-gen circle\n"
    "  berth-gen --closed --format c -o plan.c eight\n"
    "  berth-gen --horizon 30 --q 20,80,2 --discretization zoh -o gains.csv path.csv\n"
    "\n"
    "Samples with v = omega = 0 are not controllable; a warning gives their indices.\n"
    "Exit status: 0 done, 1 the output could not be written, 2 bad usage or bad input.\n";

typedef struct {
    gen_request_t request;
    bool format_c;
    const char *symbol; /* NULL: from the source */
    const char *output; /* NULL or "-": standard output */
} options_t;

enum {
    OPTION_PERIOD,
    OPTION_DURATION,
    OPTION_HORIZON,
    OPTION_Q,
    OPTION_R,
    OPTION_DISCRETIZATION,
    OPTION_CLOSED,
    OPTION_OPEN,
    OPTION_FORMAT,
    OPTION_NAME,
    OPTION_HELP,
    OPTION_VERSION
};

static const struct option long_options[] = {
    {"period", required_argument, NULL, OPTION_PERIOD},
    {"duration", required_argument, NULL, OPTION_DURATION},
    {"horizon", required_argument, NULL, OPTION_HORIZON},
    {"q", required_argument, NULL, OPTION_Q},
    {"r", required_argument, NULL, OPTION_R},
    {"discretization", required_argument, NULL, OPTION_DISCRETIZATION},
    {"closed", no_argument, NULL, OPTION_CLOSED},
    {"open", no_argument, NULL, OPTION_OPEN},
    {"format", required_argument, NULL, OPTION_FORMAT},
    {"name", required_argument, NULL, OPTION_NAME},
    {"help", no_argument, NULL, OPTION_HELP},
    {"version", no_argument, NULL, OPTION_VERSION},
    {NULL, 0, NULL, 0},
};

/* Options that are values of a scenario, and how they are written there. */
static const struct {
    const char *before, *after;
} assignments[] = {
    [OPTION_PERIOD] = {"period_s=", ""},     [OPTION_DURATION] = {"duration_s=", ""},
    [OPTION_HORIZON] = {"mpc.horizon=", ""}, [OPTION_Q] = {"mpc.q=[", "]"},
    [OPTION_R] = {"mpc.r=[", "]"},           [OPTION_DISCRETIZATION] = {"mpc.discretization=", ""},
};

static int complain(const char *text, int status) {
    fprintf(stderr, "berth-gen: %s\n", text);
    return status;
}

static _Noreturn void usage_and_exit(void) {
    fputs("Try 'berth-gen --help' for more information.\n", stderr);
    exit(STATUS_USAGE);
}

static _Noreturn void refuse_and_exit(const char *option, const char *value, const char *what) {
    char excerpt[REFUSAL_EXCERPT_MAX];
    fprintf(stderr, "berth-gen: %s: '%s' %s\n", option,
            refusal_excerpt(value, excerpt, sizeof excerpt), what);
    usage_and_exit();
}

static _Noreturn void print_and_exit(const char *text) {
    const bool written = fputs(text, stdout) != EOF && fflush(stdout) == 0;
    exit(written ? STATUS_OK : STATUS_FAILED);
}

/* --- options ----------------------------------------------------------------------------- */

/* Stores a value with the checks that a scenario has for it. */
static void set_value(options_t *options, int option, const char *value) {
    char assignment[256];
    scenario_error_t error;
    const int length = snprintf(assignment, sizeof assignment, "%s%s%s", assignments[option].before,
                                value, assignments[option].after);
    if (length < 0 || (size_t)length >= sizeof assignment) {
        refuse_and_exit(long_options[option].name, value, "is too long (allowed: 200 characters)");
    }
    if (!scenario_set(&options->request.settings, assignment, &error)) {
        /* the message begins with the key, which is called like the option here */
        const char *what = strchr(error.text, ':');
        fprintf(stderr, "berth-gen: --%s%s\n", long_options[option].name,
                what != NULL ? what : error.text);
        usage_and_exit();
    }
    options->request.period_given |= option == OPTION_PERIOD;
    options->request.duration_given |= option == OPTION_DURATION;
}

static void set_format(options_t *options, const char *value) {
    options->format_c = strcmp(value, "c") == 0;
    if (!options->format_c && strcmp(value, "csv") != 0) {
        refuse_and_exit("--format", value, "is not known (allowed: csv or c)");
    }
}

static void set_name(options_t *options, const char *value) {
    if (!gen_symbol_good(value)) {
        refuse_and_exit("--name", value,
                        "is no name for a plan (allowed: a C identifier of 1 to 63 characters that "
                        "begins with a letter, does not end in _t and is no keyword)");
    }
    options->symbol = value;
}

static void take_option(options_t *options, int option, const char *value) {
    switch (option) {
    case OPTION_CLOSED:
    case OPTION_OPEN:
        options->request.settings.reference.closed = option == OPTION_CLOSED;
        break;
    case OPTION_FORMAT:
        set_format(options, value);
        break;
    case OPTION_NAME:
        set_name(options, value);
        break;
    case 'o':
        options->output = value;
        break;
    case OPTION_HELP:
        print_and_exit(help);
    case OPTION_VERSION:
        print_and_exit("berth-gen " BERTH_VERSION "\n");
    case '?': /* getopt has complained */
        usage_and_exit();
    default:
        set_value(options, option, value);
        break;
    }
}

/* The header's name goes into an #include line. */
static bool c_path_good(const char *path) {
    const char *slash = strrchr(path, '/');
    const char *base = slash == NULL ? path : slash + 1;
    const size_t length = strlen(base);
    if (length < 3 || strcmp(base + length - 2, ".c") != 0) {
        return false;
    }
    for (const unsigned char *at = (const unsigned char *)base; *at != '\0'; at++) {
        if (*at < 0x20u || *at == '"' || *at == '\\') {
            return false;
        }
    }
    return true;
}

static void check_options(const options_t *options) {
    const char *output = options->output != NULL ? options->output : "-";
    if (options->format_c && !c_path_good(output)) {
        refuse_and_exit("-o", output, "does not suit --format c (allowed: FILE.c)");
    }
    if (output[0] == '\0') {
        refuse_and_exit("-o", output, "is empty (allowed: FILE, or -)");
    }
}

static void parse(int argc, char **argv, options_t *options) {
    *options = (options_t){.format_c = false};
    gen_request_defaults(&options->request);
    for (int option = getopt_long(argc, argv, "o:", long_options, NULL); option != -1;
         option = getopt_long(argc, argv, "o:", long_options, NULL)) {
        take_option(options, option, optarg);
    }
    if (argc - optind != 1) {
        fprintf(stderr,
                "berth-gen: %d references given (allowed: one of circle, eight, FILE.csv)\n",
                argc - optind);
        usage_and_exit();
    }
    options->request.source = argv[optind];
    check_options(options);
}

/* --- output ------------------------------------------------------------------------------ */

static bool standing(const berth_sample_t *sample) {
    return sample->v_mps == 0.0f && sample->omega_radps == 0.0f;
}

/* "3", "0-9, 40": runs of samples that stand. */
static void warn_uncontrollable(const berth_plan_t *plan) {
    const char *lead = "berth-gen: warning: not controllable, v = omega = 0: sample ";
    bool any = false;
    for (uint32_t k = 0; k < plan->count; k++) {
        const uint32_t first = k;
        if (!standing(&plan->samples[k])) {
            continue;
        }
        while (k + 1 < plan->count && standing(&plan->samples[k + 1])) {
            k++;
        }
        fprintf(stderr, k > first ? "%s%u-%u" : "%s%u", lead, (unsigned)first, (unsigned)k);
        lead = ", ";
        any = true;
    }
    if (any) {
        fputs(" (the gain there comes from the rest of the horizon)\n", stderr);
    }
}

static int write_stdout(const berth_plan_t *plan) {
    gen_write_csv(stdout, plan);
    errno = 0;
    if (fflush(stdout) == 0 && ferror(stdout) == 0) {
        return STATUS_OK;
    }
    fprintf(stderr, "berth-gen: standard output: cannot write: %s\n", strerror(errno));
    return STATUS_FAILED;
}

static int write_csv(const char *path, const berth_plan_t *plan) {
    output_file_t out;
    scenario_error_t error;
    if (!output_file_open(&out, path, &error)) {
        return complain(error.text, STATUS_FAILED);
    }
    gen_write_csv(out.file, plan);
    return output_file_commit(&out, &error) ? STATUS_OK : complain(error.text, STATUS_FAILED);
}

static int write_c(const options_t *options, const berth_plan_t *plan) {
    char fallback[GEN_SYMBOL_MAX];
    scenario_error_t error;
    gen_symbol_default(options->request.source, fallback);
    const gen_name_t name = {
        .symbol = options->symbol != NULL ? options->symbol : fallback,
        .source = options->request.source,
    };
    return gen_write_c(options->output, plan, name, &error) ? STATUS_OK
                                                            : complain(error.text, STATUS_FAILED);
}

int main(int argc, char **argv) {
    options_t options;
    gen_plan_t made;
    scenario_error_t error;
    int status = STATUS_OK;
    parse(argc, argv, &options);
    if (!gen_plan_make(&options.request, &made, &error)) {
        return complain(error.text, STATUS_USAGE);
    }
    if (options.format_c) {
        status = write_c(&options, &made.plan);
    } else if (options.output == NULL || strcmp(options.output, "-") == 0) {
        status = write_stdout(&made.plan);
    } else {
        status = write_csv(options.output, &made.plan);
    }
    if (status == STATUS_OK) {
        warn_uncontrollable(&made.plan);
    }
    gen_plan_free(&made);
    return status;
}
