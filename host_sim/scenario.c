#include "scenario.h"

#include "berth/avoid.h"
#include "berth/constrained.h"
#include "berth/reference.h"
#include "number.h"
#include "refusal.h"
#include "scenario_keys.h"
#include "strategy.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#define ROBOT                                                                                      \
    .robot = {.wheel_radius_m = 0.05, .track_m = 0.30, .v_max_mps = 0.8, .omega_max_radps = 3.0}
#define MPC .mpc = {.horizon = 20, .q = {10.0, 40.0, 1.0}, .r = {0.5, 0.1}}
#define AVOIDANCE                                                                                  \
    .avoidance = {.strategy = "combined", .skirt_m = 0.02, .v_creep_mps = 0.05, .paced = true}
#define PLANT .plant = {.radius_scale = 1.0, .track_scale = 1.0}

static const scenario_t builtins[] = {
    {
        .name = "circle",
        .period_s = 0.05,
        .duration_s = 30.0,
        .reference = {.shape = SHAPE_CIRCLE},
        ROBOT,
        .start = {.x_m = 0.8, .y_m = -0.2, .theta_rad = 1.2},
        MPC,
        AVOIDANCE,
        /* at the angles 1.5, 3.4 and 5.2 rad, on radii of 1.03, 0.98 and 1.05 m */
        .obstacles =
            {
                {0.073, 1.027, 0.10, 0.20, 0.40},
                {-0.947, -0.250, 0.10, 0.20, 0.40},
                {0.492, -0.928, 0.10, 0.20, 0.40},
            },
        .obstacle_count = 3,
        PLANT,
    },
    {
        .name = "eight",
        .period_s = 0.05,
        .duration_s = 45.0,
        .reference = {.shape = SHAPE_EIGHT},
        ROBOT,
        .start = {.x_m = -0.2, .y_m = -0.15, .theta_rad = 0.3},
        MPC,
        AVOIDANCE,
        /* where the reference is at 8, 17 and 33 s, 3 cm left, 4 cm right and 2 cm left of it */
        .obstacles =
            {
                {1.706, 0.821, 0.10, 0.18, 0.38},
                {1.025, -1.077, 0.12, 0.20, 0.40},
                {-1.730, -0.545, 0.15, 0.23, 0.43},
            },
        .obstacle_count = 3,
        PLANT,
    },
};

bool scenario_builtin(const char *name, scenario_t *scenario) {
    for (size_t i = 0; i < sizeof builtins / sizeof builtins[0]; i++) {
        if (strcmp(builtins[i].name, name) == 0) {
            *scenario = builtins[i];
            return true;
        }
    }
    return false;
}

/* --- setting one value ------------------------------------------------------------------- */

/* Takes "N." off the front of an obstacle's key. */
static bool take_index(const char **name, size_t count, size_t *index) {
    const size_t digits = strspn(*name, "0123456789");
    if (digits == 0 || digits > 2 || (*name)[digits] != '.') {
        return false;
    }
    *index = 0;
    for (size_t i = 0; i < digits; i++) {
        *index = *index * 10 + (size_t)((*name)[i] - '0');
    }
    *name += digits + 1;
    return *index < count;
}

static bool refuse_obstacle(const scenario_t *scenario, const char *path, scenario_error_t *error) {
    if (scenario->obstacle_count == 0) {
        return refuse(error, "%s: there are no obstacles (allowed: obstacles=[])", path);
    }
    return refuse(error,
                  "%s: no such obstacle (allowed: obstacles.0 to obstacles.%zu, or "
                  "obstacles=[] for none)",
                  path, scenario->obstacle_count - 1);
}

static bool refuse_unknown(const char *path, key_section_t section, const char *name,
                           scenario_error_t *error) {
    char excerpt[REFUSAL_EXCERPT_MAX];
    char allowed[KEY_ALLOWED_MAX];
    char like[KEY_PATH_MAX];
    refusal_excerpt(path, excerpt, sizeof excerpt);
    scenario_section_allowed(section, allowed);
    if (scenario_key_suggest(section, name, like)) {
        return refuse(error, "%s: unknown key, did you mean %s? (allowed: %s)", excerpt, like,
                      allowed);
    }
    return refuse(error, "%s: unknown key (allowed: %s)", excerpt, allowed);
}

/* Splits "section.name"; a path without a known section is one of the top. */
static key_section_t split_path(const char *path, const char **name) {
    for (size_t i = 1; i < SECTION_COUNT; i++) {
        const size_t length = strlen(scenario_sections[i]);
        if (strncmp(path, scenario_sections[i], length) == 0 && path[length] == '.') {
            *name = path + length + 1;
            return (key_section_t)i;
        }
    }
    *name = path;
    return SECTION_TOP;
}

static bool set_path(scenario_t *scenario, const char *path, const char *value,
                     scenario_error_t *error) {
    const char *name = NULL;
    size_t index = 0;
    const key_section_t section = split_path(path, &name);
    if (section == SECTION_OBSTACLES && !take_index(&name, scenario->obstacle_count, &index)) {
        return refuse_obstacle(scenario, path, error);
    }
    const size_t key = scenario_key_find(section, name);
    if (key == SCENARIO_KEY_COUNT) {
        return refuse_unknown(path, section, name, error);
    }
    char what[KEY_WHAT_MAX];
    if (scenario_key_assign_text(&scenario_keys[key], scenario, index, value, what)) {
        return true;
    }
    char allowed[KEY_ALLOWED_MAX];
    scenario_key_allowed(&scenario_keys[key], allowed);
    return scenario_refuse_key(NULL, key, index, what, allowed, error);
}

bool scenario_set(scenario_t *scenario, const char *assignment, scenario_error_t *error) {
    const char *equals = strchr(assignment, '=');
    char path[KEY_PATH_MAX];
    char excerpt[REFUSAL_EXCERPT_MAX];
    if (equals == NULL || equals == assignment) {
        return refuse(error, "'%s' is no assignment (allowed: KEY=VALUE)",
                      refusal_excerpt(assignment, excerpt, sizeof excerpt));
    }
    const size_t length = (size_t)(equals - assignment);
    if (length >= sizeof path) {
        return refuse(error, "%s: unknown key (allowed: keys of a scenario file)",
                      refusal_excerpt(assignment, excerpt, sizeof excerpt));
    }
    memcpy(path, assignment, length);
    path[length] = '\0';
    if (strcmp(path, "obstacles") == 0 && strcmp(equals + 1, "[]") == 0) {
        scenario->obstacle_count = 0;
        return true;
    }
    return set_path(scenario, path, equals + 1, error);
}

/* --- checks of more than one value ------------------------------------------------------- */

static bool check_duration(const scenario_t *scenario, const scenario_lines_t *lines,
                           scenario_error_t *error) {
    char allowed[NUMBER_RANGE_TEXT_MAX];
    char what[KEY_WHAT_MAX];
    const double minimum = scenario->period_s;
    const double maximum = fmin(100000.0, scenario->period_s * (double)BERTH_PLAN_COUNT_MAX);
    /* the negated form refuses NaN as well */
    if (scenario->duration_s >= minimum && scenario->duration_s <= maximum) {
        return true;
    }
    (void)snprintf(what, sizeof what, "%.9g s, at a period of %.9g s, is not 1 to %u periods",
                   scenario->duration_s, scenario->period_s, BERTH_PLAN_COUNT_MAX);
    number_range_text(minimum, maximum, allowed, sizeof allowed);
    return scenario_refuse_key(lines, scenario_key_find(SECTION_TOP, "duration_s"), 0, what,
                               allowed, error);
}

static bool check_strategy(const scenario_t *scenario, const scenario_lines_t *lines,
                           scenario_error_t *error) {
    char allowed[KEY_ALLOWED_MAX];
    char what[KEY_WHAT_MAX];
    if (strategy_find(scenario->avoidance.strategy) != NULL) {
        return true;
    }
    const size_t key = scenario_key_find(SECTION_AVOIDANCE, "strategy");
    scenario_key_allowed(&scenario_keys[key], allowed);
    (void)snprintf(what, sizeof what, "'%s' is not known", scenario->avoidance.strategy);
    return scenario_refuse_key(lines, key, 0, what, allowed, error);
}

static bool check_file(const scenario_t *scenario, const scenario_lines_t *lines,
                       scenario_error_t *error) {
    char allowed[KEY_ALLOWED_MAX];
    char what[KEY_WHAT_MAX];
    if (scenario->reference.shape != SHAPE_FILE || access(scenario->reference.file, R_OK) == 0) {
        return true;
    }
    (void)snprintf(what, sizeof what, "cannot read '%.80s': %s", scenario->reference.file,
                   strerror(errno));
    const size_t key = scenario_key_find(SECTION_REFERENCE, "file");
    scenario_key_allowed(&scenario_keys[key], allowed);
    return scenario_refuse_key(lines, key, 0, what, allowed, error);
}

/* `conservative` takes the skirt for its regulated radius whatever the scenario says, and others
 * have no skirt. */
static bool needs_room_for_skirt(const scenario_t *scenario) {
    return strcmp(scenario->avoidance.strategy, "combined") == 0 ||
           strcmp(scenario->avoidance.strategy, "kanayama_avoid") == 0;
}

static bool check_obstacle(const scenario_t *scenario, size_t index, const scenario_lines_t *lines,
                           scenario_error_t *error) {
    const scenario_obstacle_t *obstacle = &scenario->obstacles[index];
    const bool skirt = needs_room_for_skirt(scenario);
    const double least = obstacle->conservative_m + (skirt ? scenario->avoidance.skirt_m : 0.0);
    char allowed[KEY_ALLOWED_MAX];
    char what[KEY_WHAT_MAX];
    if (!(obstacle->conservative_m > obstacle->hard_m)) {
        (void)snprintf(what, sizeof what, "%.9g m is not greater than hard_m",
                       obstacle->conservative_m);
        (void)snprintf(allowed, sizeof allowed, "above %.9g, to %.9g", obstacle->hard_m,
                       (double)BERTH_RADIUS_MAX_M);
        return scenario_refuse_key(lines, scenario_key_find(SECTION_OBSTACLES, "conservative_m"),
                                   index, what, allowed, error);
    }
    /* sums of decimal fractions round: 0.2 + 0.02 > 0.22 */
    if (!(obstacle->regulated_m >= least - (double)BERTH_RADIUS_SLACK_M)) {
        (void)snprintf(what, sizeof what, "%.9g m is less than conservative_m%s",
                       obstacle->regulated_m, skirt ? " + avoidance.skirt_m" : "");
        number_range_text(least, (double)BERTH_RADIUS_MAX_M, allowed, sizeof allowed);
        return scenario_refuse_key(lines, scenario_key_find(SECTION_OBSTACLES, "regulated_m"),
                                   index, what, allowed, error);
    }
    return true;
}

/* What the constrained tracker is made for, and has room for. */
static bool check_constrained(const scenario_t *scenario, const scenario_lines_t *lines,
                              scenario_error_t *error) {
    char what[KEY_WHAT_MAX];
    char allowed[NUMBER_RANGE_TEXT_MAX];
    if (!scenario->mpc.constrained) {
        return true;
    }
    if (scenario->mpc.zoh) {
        return scenario_refuse_key(lines, scenario_key_find(SECTION_MPC, "discretization"), 0,
                                   "'zoh' is not possible with mpc.constrained", "euler", error);
    }
    if (scenario->mpc.horizon <= BERTH_CONSTRAINED_HORIZON_MAX) {
        return true;
    }
    (void)snprintf(what, sizeof what, "%d is too long for mpc.constrained", scenario->mpc.horizon);
    number_range_text(1.0, BERTH_CONSTRAINED_HORIZON_MAX, allowed, sizeof allowed);
    return scenario_refuse_key(lines, scenario_key_find(SECTION_MPC, "horizon"), 0, what, allowed,
                               error);
}

bool scenario_check_lines(const scenario_t *scenario, const scenario_lines_t *lines,
                          scenario_error_t *error) {
    bool good = check_duration(scenario, lines, error) && check_strategy(scenario, lines, error) &&
                check_file(scenario, lines, error) && check_constrained(scenario, lines, error);
    for (size_t i = 0; good && i < scenario->obstacle_count; i++) {
        good = check_obstacle(scenario, i, lines, error);
    }
    return good;
}

bool scenario_check(const scenario_t *scenario, scenario_error_t *error) {
    return scenario_check_lines(scenario, NULL, error);
}
