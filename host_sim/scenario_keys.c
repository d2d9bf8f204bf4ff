#include "scenario_keys.h"

#include "berth/angle.h"
#include "berth/obstacles.h"
#include "berth/reference.h"
#include "number.h"
#include "pose_delay.h"
#include "refusal.h"
#include "strategy.h"

#include <string.h>

#define POSITION_MAX ((double)BERTH_POSITION_MAX_M)
#define RADIUS_MIN 0.001
#define RADIUS_MAX ((double)BERTH_RADIUS_MAX_M)
#define TURN 6.283185307179586
#define HALF_TURN 3.141592653589793
#define SLIP_MAX 0.5

#define AT(member) offsetof(scenario_t, member)
#define IN(member) offsetof(scenario_obstacle_t, member)

const char *const scenario_sections[SECTION_COUNT] = {
    "", "reference", "robot", "start", "mpc", "avoidance", "obstacles", "plant",
};

/* Ranges are those of the firmware's headers where the value gets there. */
const scenario_key_t scenario_keys[SCENARIO_KEY_COUNT] = {
    {SECTION_TOP, "name", KIND_NAME, 1, AT(name), 0, 0, NEED_ALWAYS, NULL},
    {SECTION_TOP, "period_s", KIND_PERIOD, 1, AT(period_s), 0.001, 1, NEED_ALWAYS, NULL},
    {SECTION_TOP, "duration_s", KIND_NUMBER, 1, AT(duration_s), 0.001, 100000, NEED_ALWAYS, NULL},

    {SECTION_REFERENCE, "shape", KIND_SHAPE, 1, AT(reference.shape), 0, 0, NEED_NEVER, NULL},
    {SECTION_REFERENCE, "file", KIND_FILE, 1, AT(reference.file), 0, 0, NEED_NEVER, NULL},
    {SECTION_REFERENCE, "closed", KIND_BOOL, 1, AT(reference.closed), 0, 0, NEED_NEVER, "false"},

    {SECTION_ROBOT, "wheel_radius_m", KIND_NUMBER, 1, AT(robot.wheel_radius_m), 0.001, 10,
     NEED_ALWAYS, NULL},
    {SECTION_ROBOT, "track_m", KIND_NUMBER, 1, AT(robot.track_m), 0.01, 10, NEED_ALWAYS, NULL},
    {SECTION_ROBOT, "v_max_mps", KIND_NUMBER, 1, AT(robot.v_max_mps), 0.001, 100, NEED_ALWAYS,
     NULL},
    {SECTION_ROBOT, "omega_max_radps", KIND_NUMBER, 1, AT(robot.omega_max_radps), 0.001, 100,
     NEED_ALWAYS, NULL},
    {SECTION_ROBOT, "wheel_speed_max_radps", KIND_NUMBER, 1, AT(robot.wheel_speed_max_radps), 0.001,
     10000, NEED_NEVER, NULL},

    {SECTION_START, "x_m", KIND_NUMBER, 1, AT(start.x_m), -POSITION_MAX, POSITION_MAX,
     NEED_IN_SECTION, NULL},
    {SECTION_START, "y_m", KIND_NUMBER, 1, AT(start.y_m), -POSITION_MAX, POSITION_MAX,
     NEED_IN_SECTION, NULL},
    /* a full turn: angles in degrees get noticed */
    {SECTION_START, "theta_rad", KIND_NUMBER, 1, AT(start.theta_rad), -TURN, TURN, NEED_IN_SECTION,
     NULL},

    {SECTION_MPC, "horizon", KIND_INTEGER, 1, AT(mpc.horizon), 1, BERTH_HORIZON_MAX,
     NEED_IN_SECTION, "20"},
    {SECTION_MPC, "q", KIND_NUMBER, 3, AT(mpc.q), 0, (double)BERTH_WEIGHT_MAX, NEED_IN_SECTION,
     "[10, 40, 1]"},
    {SECTION_MPC, "r", KIND_NUMBER, 2, AT(mpc.r), 1e-6, (double)BERTH_WEIGHT_MAX, NEED_IN_SECTION,
     "[0.5, 0.1]"},
    {SECTION_MPC, "discretization", KIND_DISCRETIZATION, 1, AT(mpc.zoh), 0, 0, NEED_NEVER, "euler"},
    {SECTION_MPC, "constrained", KIND_BOOL, 1, AT(mpc.constrained), 0, 0, NEED_NEVER, "false"},

    {SECTION_AVOIDANCE, "strategy", KIND_STRATEGY, 1, AT(avoidance.strategy), 0, 0, NEED_NEVER,
     "combined"},
    {SECTION_AVOIDANCE, "skirt_m", KIND_NUMBER, 1, AT(avoidance.skirt_m), 0, 10, NEED_NEVER,
     "0.02"},
    {SECTION_AVOIDANCE, "v_creep_mps", KIND_NUMBER, 1, AT(avoidance.v_creep_mps), 0.001, 100,
     NEED_NEVER, "0.05"},
    {SECTION_AVOIDANCE, "paced", KIND_BOOL, 1, AT(avoidance.paced), 0, 0, NEED_NEVER, "true"},

    {SECTION_OBSTACLES, "x_m", KIND_NUMBER, 1, IN(x_m), -POSITION_MAX, POSITION_MAX,
     NEED_IN_SECTION, NULL},
    {SECTION_OBSTACLES, "y_m", KIND_NUMBER, 1, IN(y_m), -POSITION_MAX, POSITION_MAX,
     NEED_IN_SECTION, NULL},
    {SECTION_OBSTACLES, "hard_m", KIND_NUMBER, 1, IN(hard_m), RADIUS_MIN, RADIUS_MAX,
     NEED_IN_SECTION, NULL},
    {SECTION_OBSTACLES, "conservative_m", KIND_NUMBER, 1, IN(conservative_m), RADIUS_MIN,
     RADIUS_MAX, NEED_IN_SECTION, NULL},
    {SECTION_OBSTACLES, "regulated_m", KIND_NUMBER, 1, IN(regulated_m), RADIUS_MIN, RADIUS_MAX,
     NEED_IN_SECTION, NULL},

    {SECTION_PLANT, "tau_s", KIND_NUMBER, 1, AT(plant.tau_s), 0, 10, NEED_NEVER, "0"},
    {SECTION_PLANT, "a_max_mps2", KIND_NUMBER_OR_ZERO, 1, AT(plant.a_max_mps2), 0.001, 1000,
     NEED_NEVER, "0"},
    {SECTION_PLANT, "alpha_max_radps2", KIND_NUMBER_OR_ZERO, 1, AT(plant.alpha_max_radps2), 0.001,
     1000, NEED_NEVER, "0"},
    {SECTION_PLANT, "pose_noise_m", KIND_NUMBER, 1, AT(plant.pose_noise_m), 0, 1, NEED_NEVER, "0"},
    {SECTION_PLANT, "heading_noise_rad", KIND_NUMBER, 1, AT(plant.heading_noise_rad), 0, HALF_TURN,
     NEED_NEVER, "0"},
    {SECTION_PLANT, "slip", KIND_NUMBER, 1, AT(plant.slip), 0, SLIP_MAX, NEED_NEVER, "0"},
    {SECTION_PLANT, "pose_delay_s", KIND_NUMBER, 1, AT(plant.pose_delay_s), 0, POSE_DELAY_MAX_S,
     NEED_NEVER, "0"},
    {SECTION_PLANT, "watchdog_s", KIND_NUMBER, 1, AT(plant.watchdog_s), 0, 10, NEED_NEVER, "0"},
    {SECTION_PLANT, "untold", KIND_NUMBER, 1, AT(plant.untold), 0, 1, NEED_NEVER, "0"},
};

size_t scenario_key_find(key_section_t section, const char *name) {
    size_t i = 0;
    while (i < SCENARIO_KEY_COUNT &&
           (scenario_keys[i].section != section || strcmp(scenario_keys[i].name, name) != 0)) {
        i++;
    }
    return i;
}

void scenario_key_path(const scenario_key_t *key, size_t index, char out[KEY_PATH_MAX]) {
    if (key->section == SECTION_TOP) {
        (void)snprintf(out, KEY_PATH_MAX, "%s", key->name);
    } else if (key->section == SECTION_OBSTACLES) {
        (void)snprintf(out, KEY_PATH_MAX, "obstacles.%zu.%s", index, key->name);
    } else {
        (void)snprintf(out, KEY_PATH_MAX, "%s.%s", scenario_sections[key->section], key->name);
    }
}

/* Appends a name to a list with commas. */
static void append_name(char *out, const char *name) {
    const size_t length = strlen(out);
    (void)snprintf(out + length, KEY_ALLOWED_MAX - length, "%s%s", length == 0 ? "" : ", ", name);
}

static void strategies_allowed(char *out) {
    out[0] = '\0';
    for (size_t i = 0; strategies[i] != NULL; i++) {
        append_name(out, strategies[i]->name);
    }
}

static void number_allowed(const scenario_key_t *key, char *out) {
    char range[NUMBER_RANGE_TEXT_MAX];
    number_range_text(key->minimum, key->maximum, range, sizeof range);
    if (key->count > 1) {
        (void)snprintf(out, KEY_ALLOWED_MAX, "a list of %zu numbers, each %s", key->count, range);
    } else if (key->kind == KIND_NUMBER_OR_ZERO) {
        (void)snprintf(out, KEY_ALLOWED_MAX, "0, or %s", range);
    } else if (key->kind == KIND_PERIOD) {
        (void)snprintf(out, KEY_ALLOWED_MAX, "%s, a whole number of microseconds", range);
    } else if (key->kind == KIND_INTEGER) {
        (void)snprintf(out, KEY_ALLOWED_MAX, "a whole number, %s", range);
    } else {
        (void)snprintf(out, KEY_ALLOWED_MAX, "%s", range);
    }
}

void scenario_key_allowed(const scenario_key_t *key, char out[KEY_ALLOWED_MAX]) {
    static const char *const texts[] = {
        [KIND_BOOL] = "true or false",
        [KIND_NAME] = "a text of 1 to 255 printable bytes",
        [KIND_SHAPE] = "circle or eight",
        [KIND_FILE] = "path of a readable CSV file, 1 to 255 printable bytes",
        [KIND_DISCRETIZATION] = "euler or zoh",
    };
    if (key->kind == KIND_STRATEGY) {
        strategies_allowed(out);
    } else if (key->kind <= KIND_INTEGER) {
        number_allowed(key, out);
    } else {
        (void)snprintf(out, KEY_ALLOWED_MAX, "%s", texts[key->kind]);
    }
}

void scenario_section_allowed(key_section_t section, char out[KEY_ALLOWED_MAX]) {
    out[0] = '\0';
    for (size_t i = 0; i < SCENARIO_KEY_COUNT; i++) {
        if (scenario_keys[i].section == section) {
            append_name(out, scenario_keys[i].name);
        }
    }
    for (size_t i = 1; section == SECTION_TOP && i < SECTION_COUNT; i++) {
        append_name(out, scenario_sections[i]);
    }
}

/* Changes of one character that turn a into b (Levenshtein), with one row of the table. */
static size_t edit_distance(const char *a, const char *b) {
    size_t row[KEY_PATH_MAX];
    const size_t width = strlen(b);
    for (size_t j = 0; j <= width; j++) {
        row[j] = j;
    }
    for (size_t i = 0; a[i] != '\0'; i++) {
        size_t diagonal = row[0];
        row[0] = i + 1;
        for (size_t j = 0; j < width; j++) {
            const size_t replaced = diagonal + (a[i] != b[j]);
            const size_t shorter = (row[j] < row[j + 1] ? row[j] : row[j + 1]) + 1;
            diagonal = row[j + 1];
            row[j + 1] = replaced < shorter ? replaced : shorter;
        }
    }
    return row[width];
}

/* Small: alike. The beginning of a name (v_max for v_max_mps) is as good as one wrong letter. */
static size_t unlikeness(const char *name, const char *key) {
    const size_t length = strlen(name);
    if (length >= 3 && strncmp(name, key, length) == 0) {
        return 1;
    }
    return edit_distance(name, key);
}

bool scenario_key_suggest(key_section_t section, const char *name, char out[KEY_PATH_MAX]) {
    const size_t length = strlen(name);
    size_t best = length / 3 + 1; /* more changes than that: another word */
    bool found = false;
    if (length >= KEY_PATH_MAX) {
        return false;
    }
    for (size_t i = 0; i < SCENARIO_KEY_COUNT; i++) {
        const scenario_key_t *key = &scenario_keys[i];
        const size_t unlike = unlikeness(name, key->name) + (key->section == section ? 0 : 1);
        if (unlike < best || (unlike == best && !found)) {
            best = unlike;
            found = true;
            scenario_key_path(key, 0, out);
        }
    }
    for (size_t i = 1; section == SECTION_TOP && i < SECTION_COUNT; i++) {
        const size_t unlike = unlikeness(name, scenario_sections[i]);
        if (unlike < best || (unlike == best && !found)) {
            best = unlike;
            found = true;
            (void)snprintf(out, KEY_PATH_MAX, "%s", scenario_sections[i]);
        }
    }
    return found;
}

bool scenario_refuse_key(const scenario_lines_t *lines, size_t key, size_t index, const char *what,
                         const char *allowed, scenario_error_t *error) {
    char path[KEY_PATH_MAX];
    scenario_key_path(&scenario_keys[key], index, path);
    if (lines == NULL) {
        return refuse(error, "%s: %s (allowed: %s)", path, what, allowed);
    }
    const bool obstacle = scenario_keys[key].section == SECTION_OBSTACLES;
    int line = lines->keys[key][obstacle ? index : 0];
    if (line == 0) {
        line = obstacle ? lines->obstacles[index] : lines->sections[scenario_keys[key].section];
    }
    if (line == 0) {
        line = lines->sections[SECTION_TOP];
    }
    return refuse(error, "%s:%d: %s: %s (allowed: %s)", lines->file, line, path, what, allowed);
}
