#include "cli.h"
#include "output_file.h"

#include <errno.h>
#include <spawn.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

/* The environment wins over what the build compiled in; "" when there is neither. */
static const char *plot_python(void) {
    const char *python = getenv("BERTH_PLOT_PYTHON");
#ifdef BERTH_PLOT_PYTHON
    return python != NULL ? python : BERTH_PLOT_PYTHON;
#else
    return python != NULL ? python : "";
#endif
}

static const char *plot_script(void) {
    const char *script = getenv("BERTH_PLOT_SCRIPT");
#ifdef BERTH_PLOT_SCRIPT
    return script != NULL ? script : BERTH_PLOT_SCRIPT;
#else
    return script != NULL ? script : "";
#endif
}

/* mkdir -p */
static bool make_directory(const char *path) {
    char *part = strdup(path);
    if (part == NULL) {
        return false;
    }
    for (char *slash = strchr(part + (part[0] == '/'), '/'); slash != NULL;
         slash = strchr(slash + 1, '/')) {
        *slash = '\0';
        mkdir(part, 0777);
        *slash = '/';
    }
    mkdir(part, 0777);
    free(part);
    struct stat status;
    if (stat(path, &status) == 0 && !S_ISDIR(status.st_mode)) {
        errno = ENOTDIR;
        return false;
    }
    return access(path, W_OK | X_OK) == 0;
}

bool cli_figures_prepare(const char *name, const char *directory) {
    if (access(plot_python(), X_OK) != 0) {
        cli_complain(name,
                     "--figures: no Python for plots at '%s' (run tools/setup, or set "
                     "BERTH_PLOT_PYTHON to a Python that has matplotlib)",
                     plot_python());
        return false;
    }
    if (access(plot_script(), R_OK) != 0) {
        cli_complain(name,
                     "--figures: no plot script at '%s' (set BERTH_PLOT_SCRIPT to "
                     "tools/plot/plot.py)",
                     plot_script());
        return false;
    }
    if (!make_directory(directory)) {
        cli_complain(name, "--figures: %s: cannot write there: %s", directory, strerror(errno));
        return false;
    }
    return true;
}

/* DIR/SCENARIO_ENDING, with what is no plain character of a file name made '_'. */
static char *figure_path(const char *directory, const scenario_t *scenario, const char *ending) {
    static const char plain[] = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-_";
    const size_t size = strlen(directory) + strlen(scenario->name) + strlen(ending) + 3;
    char *path = malloc(size);
    if (path == NULL) {
        return NULL;
    }
    snprintf(path, size, "%s/%s_%s", directory, scenario->name, ending);
    char *c = path + strlen(directory) + 1;
    for (const char *end = c + strlen(scenario->name); c < end; ++c) {
        if (strchr(plain, *c) == NULL) {
            *c = '_';
        }
    }
    return path;
}

char *cli_figures_log_path(const char *directory, const scenario_t *scenario,
                           const char *strategy) {
    char ending[64];
    snprintf(ending, sizeof ending, "%s.csv", strategy);
    return figure_path(directory, scenario, ending);
}

static json_t *obstacles_json(const scenario_t *scenario) {
    json_t *obstacles = json_array();
    for (size_t i = 0; i < scenario->obstacle_count; ++i) {
        const scenario_obstacle_t *o = &scenario->obstacles[i];
        json_array_append_new(obstacles,
                              json_pack("{sf, sf, sf, sf, sf}", "x_m", o->x_m, "y_m", o->y_m,
                                        "hard_m", o->hard_m, "conservative_m", o->conservative_m,
                                        "regulated_m", o->regulated_m));
    }
    return obstacles;
}

static json_t *runs_json(const cli_figure_run_t *runs, size_t count) {
    json_t *list = json_array();
    for (size_t i = 0; i < count; ++i) {
        json_t *summary = summary_json(&runs[i].summary);
        /* Machine time would make two equal runs differ. */
        json_object_del(summary, "wall_s");
        json_object_set_new(summary, "stopped_time_s",
                            summary_number(runs[i].summary.stopped_time_s));
        const char *slash = strrchr(runs[i].log_path, '/');
        json_array_append_new(list, json_pack("{ss, ss, so}", "strategy", runs[i].strategy, "log",
                                              slash + 1, "summary", summary));
    }
    return list;
}

static bool write_scene(const char *name, const char *path, const scenario_t *scenario,
                        const cli_figure_run_t *runs, size_t count) {
    scenario_error_t error;
    output_file_t out;
    json_t *scene =
        json_pack("{ss, sf, sf, s{sf, sf}, so, so}", "name", scenario->name, "period_s",
                  scenario->period_s, "skirt_m", scenario->avoidance.skirt_m, "robot", "v_max_mps",
                  scenario->robot.v_max_mps, "omega_max_radps", scenario->robot.omega_max_radps,
                  "obstacles", obstacles_json(scenario), "runs", runs_json(runs, count));
    if (!output_file_open(&out, path, &error)) {
        cli_complain(name, "%s", error.text);
        json_decref(scene);
        return false;
    }
    if (!summary_write_json(out.file, scene)) {
        cli_complain(name, "%s: cannot write", path);
        output_file_discard(&out);
        return false;
    }
    if (!output_file_commit(&out, &error)) {
        cli_complain(name, "%s", error.text);
        return false;
    }
    return true;
}

/* Runs the plot script and waits. Its output goes to stderr: stdout is for the summary. */
static bool plot(const char *name, char *scene_path) {
    char *python = strdup(plot_python());
    char *script = strdup(plot_script());
    char *arguments[] = {python, script, scene_path, NULL};
    posix_spawn_file_actions_t actions;
    pid_t child = 0;
    int status = 0;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_adddup2(&actions, STDERR_FILENO, STDOUT_FILENO);
    const int failure = python == NULL || script == NULL
                            ? ENOMEM
                            : posix_spawn(&child, python, &actions, NULL, arguments, environ);
    posix_spawn_file_actions_destroy(&actions);
    bool ok = failure == 0;
    if (!ok) {
        cli_complain(name, "%s: cannot start: %s", plot_python(), strerror(failure));
    } else if (waitpid(child, &status, 0) != child || status != 0) {
        cli_complain(name, "%s: failed to draw %s", plot_script(), scene_path);
        ok = false;
    }
    free(python);
    free(script);
    return ok;
}

bool cli_figures_draw(const char *name, const char *directory, const scenario_t *scenario,
                      const cli_figure_run_t *runs, size_t count) {
    char ending[64] = "compare.json";
    if (strcmp(name, "run") == 0) {
        snprintf(ending, sizeof ending, "%s.json", runs[0].strategy);
    }
    char *path = figure_path(directory, scenario, ending);
    if (path == NULL) {
        cli_complain(name, "out of memory");
        return false;
    }
    const bool ok = write_scene(name, path, scenario, runs, count) && plot(name, path);
    free(path);
    return ok;
}
