/* Scenarios: what a file gives, what `set` changes, and that writing loses nothing. What is refused
 * in a file is tested through the command line, in cli/test_scenario_errors.py. */
#include "rng.h"
#include "scenario.h"
#include "scenario_keys.h"
#include "unity.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#define SEED 161803u

static char folder[64];
static char path[128];
static scenario_t scenario;
static scenario_error_t error;

void setUp(void) {
    strcpy(folder, "/tmp/berth_scenario_XXXXXX");
    TEST_ASSERT_NOT_NULL(mkdtemp(folder));
    (void)snprintf(path, sizeof path, "%s/scenario.yaml", folder);
    memset(&scenario, 0, sizeof scenario);
    error.text[0] = '\0';
}

void tearDown(void) {
    char other[128];
    (void)snprintf(other, sizeof other, "%s/path.csv", folder);
    (void)unlink(other);
    (void)unlink(path);
    TEST_ASSERT_EQUAL(0, rmdir(folder)); /* nothing else was left behind */
}

/* --- helpers ----------------------------------------------------------------------------- */

static void write_text(const char *name, const char *text) {
    FILE *file = fopen(name, "w");
    TEST_ASSERT_NOT_NULL(file);
    fputs(text, file);
    TEST_ASSERT_EQUAL(0, fclose(file));
}

static void load(const char *text) {
    write_text(path, text);
    TEST_ASSERT_TRUE_MESSAGE(scenario_load(path, &scenario, &error), error.text);
}

static void assert_same(double expected, double found) {
    TEST_ASSERT_EQUAL_MEMORY(&expected, &found, sizeof expected);
}

static void assert_says(const char *part) {
    if (strstr(error.text, part) == NULL) {
        char message[700];
        (void)snprintf(message, sizeof message, "'%s' lacks '%s'", error.text, part);
        TEST_FAIL_MESSAGE(message);
    }
}

static void assert_set(const char *assignment) {
    TEST_ASSERT_TRUE_MESSAGE(scenario_set(&scenario, assignment, &error), error.text);
}

static void assert_not_set(const char *assignment, const char *key, const char *allowed) {
    const scenario_t before = scenario;
    TEST_ASSERT_FALSE_MESSAGE(scenario_set(&scenario, assignment, &error), assignment);
    TEST_ASSERT_EQUAL_MEMORY_MESSAGE(&before, &scenario, sizeof before, assignment);
    assert_says(key);
    assert_says(allowed);
}

static const char least[] = "name: least\n"
                            "period_s: 0.1\n"
                            "duration_s: 12\n"
                            "reference: {shape: eight}\n"
                            "robot: {wheel_radius_m: 0.04, track_m: 0.25, v_max_mps: 0.7,\n"
                            "        omega_max_radps: 2.5}\n";

static const char full[] =
    "# every key\n"
    "name: \"all of it: \\\"1\\\"\"\n"
    "period_s: 0.02\n"
    "duration_s: 1.5e1\n"
    "reference:\n"
    "  shape: circle\n"
    "  closed: true\n"
    "robot:\n"
    "  wheel_radius_m: 0.06\n"
    "  track_m: 0.31\n"
    "  v_max_mps: 0.9\n"
    "  omega_max_radps: 4\n"
    "  wheel_speed_max_radps: 17.5\n"
    "start: {x_m: 1.25, y_m: -2.5, theta_rad: -3}\n"
    "mpc:\n"
    "  horizon: 35\n"
    "  q: [1, 2.5, 0]\n"
    "  r:\n"
    "    - 0.25\n"
    "    - 1e-6\n"
    "  discretization: zoh\n"
    "avoidance:\n"
    "  strategy: conservative\n"
    "  skirt_m: 0.03\n"
    "  v_creep_mps: 0.1\n"
    "  paced: false\n"
    "obstacles:\n"
    "  - {x_m: 1, y_m: 2, hard_m: 0.1, conservative_m: 0.2, regulated_m: 0.5}\n"
    "  - regulated_m: 0.6\n"
    "    conservative_m: 0.3\n"
    "    hard_m: 0.15\n"
    "    y_m: -4\n"
    "    x_m: -3\n"
    "plant:\n"
    "  tau_s: 0.05\n"
    "  a_max_mps2: 3\n"
    "  alpha_max_radps2: 9\n"
    "  pose_noise_m: 0.003\n"
    "  heading_noise_rad: 0.01\n"
    "  slip: 0.02\n"
    "  pose_delay_s: 0.04\n"
    "  watchdog_s: 0.25\n"
    "  untold: 0.5\n";

/* --- loading ----------------------------------------------------------------------------- */

static void test_every_key_arrives(void) {
    load(full);
    TEST_ASSERT_EQUAL_STRING("all of it: \"1\"", scenario.name);
    assert_same(0.02, scenario.period_s);
    assert_same(15.0, scenario.duration_s);
    TEST_ASSERT_EQUAL(SHAPE_CIRCLE, scenario.reference.shape);
    TEST_ASSERT_TRUE(scenario.reference.closed);
    assert_same(0.06, scenario.robot.wheel_radius_m);
    assert_same(0.31, scenario.robot.track_m);
    assert_same(0.9, scenario.robot.v_max_mps);
    assert_same(4.0, scenario.robot.omega_max_radps);
    assert_same(17.5, scenario.robot.wheel_speed_max_radps);
    assert_same(1.25, scenario.start.x_m);
    assert_same(-2.5, scenario.start.y_m);
    assert_same(-3.0, scenario.start.theta_rad);
    TEST_ASSERT_EQUAL(35, scenario.mpc.horizon);
    assert_same(1.0, scenario.mpc.q[0]);
    assert_same(2.5, scenario.mpc.q[1]);
    assert_same(0.0, scenario.mpc.q[2]);
    assert_same(0.25, scenario.mpc.r[0]);
    assert_same(1e-6, scenario.mpc.r[1]);
    TEST_ASSERT_TRUE(scenario.mpc.zoh);
    TEST_ASSERT_EQUAL_STRING("conservative", scenario.avoidance.strategy);
    assert_same(0.03, scenario.avoidance.skirt_m);
    assert_same(0.1, scenario.avoidance.v_creep_mps);
    TEST_ASSERT_FALSE(scenario.avoidance.paced);
    TEST_ASSERT_EQUAL_UINT(2, scenario.obstacle_count);
    const scenario_obstacle_t obstacles[] = {{1, 2, 0.1, 0.2, 0.5}, {-3, -4, 0.15, 0.3, 0.6}};
    TEST_ASSERT_EQUAL_MEMORY(obstacles, scenario.obstacles, sizeof obstacles);
    const scenario_plant_t plant = {0.05, 3, 9, 0.003, 0.01, 0.02, 0.04, 0.25, 0.5, 1, 1};
    TEST_ASSERT_EQUAL_MEMORY(&plant, &scenario.plant, sizeof plant);
}

static void test_the_constrained_tracker_is_asked_for(void) {
    char text[1000];
    (void)snprintf(text, sizeof text,
                   "%smpc: {horizon: 40, q: [10, 40, 1], r: [0.5, 0.1], constrained: true}\n",
                   least);
    load(text);
    TEST_ASSERT_TRUE(scenario.mpc.constrained);
    TEST_ASSERT_FALSE(scenario.mpc.zoh);
}

static void test_defaults(void) {
    load(least);
    TEST_ASSERT_EQUAL_STRING("least", scenario.name);
    TEST_ASSERT_FALSE(scenario.reference.closed);
    assert_same(0.0, scenario.robot.wheel_speed_max_radps);
    TEST_ASSERT_EQUAL(20, scenario.mpc.horizon);
    const double q[] = {10, 40, 1};
    const double r[] = {0.5, 0.1};
    TEST_ASSERT_EQUAL_MEMORY(q, scenario.mpc.q, sizeof q);
    TEST_ASSERT_EQUAL_MEMORY(r, scenario.mpc.r, sizeof r);
    TEST_ASSERT_FALSE(scenario.mpc.zoh);
    TEST_ASSERT_FALSE(scenario.mpc.constrained);
    TEST_ASSERT_EQUAL_STRING("combined", scenario.avoidance.strategy);
    assert_same(0.02, scenario.avoidance.skirt_m);
    assert_same(0.05, scenario.avoidance.v_creep_mps);
    TEST_ASSERT_TRUE(scenario.avoidance.paced);
    TEST_ASSERT_EQUAL_UINT(0, scenario.obstacle_count);
    const scenario_plant_t plant = {.radius_scale = 1, .track_scale = 1};
    TEST_ASSERT_EQUAL_MEMORY(&plant, &scenario.plant, sizeof plant);
}

static void test_without_a_start_the_robot_stands_on_the_reference(void) {
    load(least);
    assert_same(0.0, scenario.start.x_m);
    assert_same(0.0, scenario.start.y_m);
    assert_same((double)(float)atan2(1.2 * 0.30, 1.8 * 0.15), scenario.start.theta_rad);
}

static void test_a_file_is_found_beside_the_scenario(void) {
    char csv[128];
    char text[600];
    (void)snprintf(csv, sizeof csv, "%s/path.csv", folder);
    write_text(csv, "t,x,y,theta,v,omega\n0,0.5,-1,0,0.2,0\n0.1,0.52,-1,0,0.2,0\n");
    (void)snprintf(text, sizeof text, "%s", least);
    char *shape = strstr(text, "{shape: eight}");
    TEST_ASSERT_NOT_NULL(shape);
    char rest[400];
    strcpy(rest, shape + strlen("{shape: eight}"));
    strcpy(shape, "{file: path.csv}");
    strcat(text, rest);
    load(text);
    TEST_ASSERT_EQUAL(SHAPE_FILE, scenario.reference.shape);
    TEST_ASSERT_EQUAL_STRING(csv, scenario.reference.file);
    assert_same(0.5, scenario.start.x_m);
    assert_same(-1.0, scenario.start.y_m);
    assert_same(0.0, scenario.start.theta_rad);
}

static void test_a_refused_file_changes_nothing(void) {
    load(full);
    const scenario_t before = scenario;
    write_text(path, "name: x\nperiod_s: 0.1\nduration_s: oops\n");
    TEST_ASSERT_FALSE(scenario_load(path, &scenario, &error));
    TEST_ASSERT_EQUAL_MEMORY(&before, &scenario, sizeof before);
    char expected[256];
    (void)snprintf(expected, sizeof expected,
                   "%s:3: duration_s: 'oops' is not a finite decimal number "
                   "(allowed: 0.001 to 100000)",
                   path);
    TEST_ASSERT_EQUAL_STRING(expected, error.text);
}

static void test_a_document_may_be_marked(void) {
    char text[700];
    (void)snprintf(text, sizeof text, "%%YAML 1.1\n---\n%s...\n", least);
    load(text);
    TEST_ASSERT_EQUAL_STRING("least", scenario.name);
}

/* --- built-in experiments ---------------------------------------------------------------- */

static void test_builtin_names(void) {
    TEST_ASSERT_TRUE(scenario_builtin("circle", &scenario));
    TEST_ASSERT_TRUE(scenario_builtin("eight", &scenario));
    const scenario_t before = scenario;
    TEST_ASSERT_FALSE(scenario_builtin("circles", &scenario));
    TEST_ASSERT_FALSE(scenario_builtin("", &scenario));
    TEST_ASSERT_EQUAL_MEMORY(&before, &scenario, sizeof before);
}

static void assert_common(void) {
    assert_same(0.05, scenario.period_s);
    TEST_ASSERT_EQUAL(20, scenario.mpc.horizon);
    const double q[] = {10, 40, 1};
    const double r[] = {0.5, 0.1};
    TEST_ASSERT_EQUAL_MEMORY(q, scenario.mpc.q, sizeof q);
    TEST_ASSERT_EQUAL_MEMORY(r, scenario.mpc.r, sizeof r);
    assert_same(0.8, scenario.robot.v_max_mps);
    assert_same(3.0, scenario.robot.omega_max_radps);
    assert_same(0.3, scenario.robot.track_m);
    assert_same(0.05, scenario.robot.wheel_radius_m);
    TEST_ASSERT_EQUAL_UINT(3, scenario.obstacle_count);
    TEST_ASSERT_TRUE_MESSAGE(scenario_check(&scenario, &error), error.text);
}

static void test_circle_is_as_designed(void) {
    TEST_ASSERT_TRUE(scenario_builtin("circle", &scenario));
    assert_common();
    assert_same(30.0, scenario.duration_s);
    for (size_t i = 0; i < 3; i++) {
        const scenario_obstacle_t *o = &scenario.obstacles[i];
        assert_same(0.10, o->hard_m);
        assert_same(0.20, o->conservative_m);
        TEST_ASSERT_TRUE(fabs(hypot(o->x_m, o->y_m) - 1.0) < 0.06);
    }
}

static void test_eight_is_as_designed(void) {
    const double hard[] = {0.10, 0.12, 0.15};
    const double times[] = {8, 17, 33};
    TEST_ASSERT_TRUE(scenario_builtin("eight", &scenario));
    assert_common();
    assert_same(45.0, scenario.duration_s);
    for (size_t i = 0; i < 3; i++) {
        const scenario_obstacle_t *o = &scenario.obstacles[i];
        assert_same(hard[i], o->hard_m);
        TEST_ASSERT_TRUE(fabs(o->conservative_m - hard[i] - 0.08) < 1e-12);
        TEST_ASSERT_TRUE(fabs(o->regulated_m - o->conservative_m - 0.20) < 1e-12);
        const double off =
            hypot(o->x_m - 1.8 * sin(0.15 * times[i]), o->y_m - 1.2 * sin(0.30 * times[i]));
        TEST_ASSERT_TRUE(off < 0.05);
    }
}

/* --- setting ----------------------------------------------------------------------------- */

static void test_set_changes_one_value(void) {
    TEST_ASSERT_TRUE(scenario_builtin("eight", &scenario));
    scenario_t expected = scenario;
    assert_set("robot.v_max_mps=0.6");
    expected.robot.v_max_mps = 0.6;
    assert_set("obstacles.2.hard_m=0.2");
    expected.obstacles[2].hard_m = 0.2;
    assert_set("mpc.q=[1, 2,3]");
    expected.mpc.q[0] = 1.0;
    expected.mpc.q[1] = 2.0;
    expected.mpc.q[2] = 3.0;
    assert_set("mpc.r=[1e-6,4]");
    expected.mpc.r[0] = 1e-6;
    expected.mpc.r[1] = 4.0;
    assert_set("mpc.horizon=7");
    expected.mpc.horizon = 7;
    assert_set("mpc.discretization=zoh");
    expected.mpc.zoh = true;
    assert_set("reference.closed=true");
    expected.reference.closed = true;
    assert_set("reference.shape=circle");
    expected.reference.shape = SHAPE_CIRCLE;
    assert_set("plant.a_max_mps2=0");
    assert_set("plant.tau_s=0.1");
    expected.plant.tau_s = 0.1;
    TEST_ASSERT_EQUAL_MEMORY(&expected, &scenario, sizeof expected);
    assert_set("name=with = and spaces");
    TEST_ASSERT_EQUAL_STRING("with = and spaces", scenario.name);
    assert_set("avoidance.strategy=normal");
    TEST_ASSERT_EQUAL_STRING("normal", scenario.avoidance.strategy);
    assert_set("reference.file=some.csv");
    TEST_ASSERT_EQUAL(SHAPE_FILE, scenario.reference.shape);
    TEST_ASSERT_EQUAL_STRING("some.csv", scenario.reference.file);
    assert_set("obstacles=[]");
    TEST_ASSERT_EQUAL_UINT(0, scenario.obstacle_count);
}

static void test_set_refuses_what_a_file_may_not_say(void) {
    TEST_ASSERT_TRUE(scenario_builtin("eight", &scenario));
    assert_not_set("robot.v_max_mps", "robot.v_max_mps", "(allowed: KEY=VALUE)");
    assert_not_set("=1", "=1", "(allowed: KEY=VALUE)");
    assert_not_set("", "''", "(allowed: KEY=VALUE)");
    assert_not_set("robot.v_max_mps=", "robot.v_max_mps", "(allowed: 0.001 to 100)");
    assert_not_set("robot.v_max_mps=0.6m", "robot.v_max_mps", "(allowed: 0.001 to 100)");
    assert_not_set("robot.v_max_mps=101", "robot.v_max_mps", "(allowed: 0.001 to 100)");
    assert_not_set("robot.v_max_mps=nan", "robot.v_max_mps", "(allowed: 0.001 to 100)");
    assert_not_set("robot.v_max=1", "did you mean robot.v_max_mps?", "omega_max_radps");
    assert_not_set("v_max_mps=1", "did you mean robot.v_max_mps?", "(allowed: name, period_s");
    assert_not_set("robott.v_max_mps=1", "robott.v_max_mps", "robot");
    assert_not_set("robot=1", "robot", "(allowed: name, period_s");
    assert_not_set("period_s=0.0000015", "period_s", "(allowed: 0.001 to 1");
    assert_not_set("period_s=0.0010005", "whole number of microseconds", "(allowed: 0.001 to 1");
    assert_not_set("mpc.q=[1,2]", "mpc.q", "(allowed: a list of 3 numbers, each 0 to 1000000)");
    assert_not_set("mpc.q=1,2,3", "mpc.q", "(allowed: a list of 3 numbers, each 0 to 1000000)");
    assert_not_set("mpc.q=[1,2,-3]", "mpc.q", "(allowed: a list of 3 numbers, each 0 to 1000000)");
    assert_not_set("mpc.r=[0,1]", "mpc.r", "(allowed: a list of 2 numbers, each 1e-06 to 1000000)");
    assert_not_set("mpc.horizon=2.5", "mpc.horizon", "(allowed: a whole number, 1 to 200)");
    assert_not_set("obstacles.3.x_m=1", "obstacles.3.x_m", "(allowed: obstacles.0 to obstacles.2");
    assert_not_set("obstacles.x_m=1", "obstacles.x_m", "(allowed: obstacles.0 to obstacles.2");
    assert_not_set("obstacles.1.z_m=1", "obstacles.1.z_m", "(allowed: x_m, y_m, hard_m");
    assert_not_set("obstacles.999999999999999999999.x_m=1", "obstacles", "(allowed: ");
    assert_not_set("avoidance.strategy=luck", "avoidance.strategy", "combined");
    assert_not_set("reference.closed=yes", "reference.closed", "(allowed: true or false)");
    assert_not_set("plant.a_max_mps2=0.0001", "plant.a_max_mps2", "(allowed: 0, or 0.001 to 1000)");
    assert_not_set("robot.wheel_speed_max_radps=0", "robot.wheel_speed_max_radps",
                   "(allowed: 0.001 to 10000)");
    assert_not_set("name=", "name", "(allowed: a text of 1 to 255 printable bytes)");
    assert_not_set("name=a\nb", "name", "(allowed: a text of 1 to 255 printable bytes)");
    /* no UTF-8, which could be written but not read again: Latin-1, an end too early, a surrogate,
     * more bytes than needed, beyond the last character, none at all */
    static const char *const bad[] = {
        "caf\xE9",          "\xE2\x82",     "\xED\xA0\x80", "\xC0\xAF",
        "\xF4\x90\x80\x80", "\xEF\xBF\xBF", "\xFF",         "\x80"};
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        char assignment[16];
        (void)snprintf(assignment, sizeof assignment, "name=%s", bad[i]);
        assert_not_set(assignment, "name", "(allowed: a text of 1 to 255 printable bytes)");
    }
    assert_set("name=\xF0\x9F\x9A\xA2 \xED\x9F\xBF");
}

static void test_set_refuses_a_text_that_does_not_fit(void) {
    char assignment[SCENARIO_TEXT_MAX + 16] = "name=";
    TEST_ASSERT_TRUE(scenario_builtin("eight", &scenario));
    memset(assignment + 5, 'x', SCENARIO_TEXT_MAX - 1);
    assert_set(assignment);
    TEST_ASSERT_EQUAL_UINT(SCENARIO_TEXT_MAX - 1, strlen(scenario.name));
    memset(assignment + 5, 'y', SCENARIO_TEXT_MAX);
    assert_not_set(assignment, "name", "1 to 255");
}

/* --- checks of more than one value ------------------------------------------------------- */

static void assert_check_refuses(const char *key, const char *allowed) {
    TEST_ASSERT_FALSE(scenario_check(&scenario, &error));
    TEST_ASSERT_EQUAL_INT_MESSAGE(0, strncmp(error.text, key, strlen(key)), error.text);
    assert_says(allowed);
}

static void test_check_of_durations(void) {
    TEST_ASSERT_TRUE(scenario_builtin("circle", &scenario));
    scenario.duration_s = 0.04;
    assert_check_refuses("duration_s: ", "(allowed: 0.05 to 50000)");
    scenario.duration_s = 50000.1;
    assert_check_refuses("duration_s: ", "(allowed: 0.05 to 50000)");
    scenario.duration_s = (double)NAN;
    assert_check_refuses("duration_s: ", "(allowed: 0.05 to 50000)");
    scenario.duration_s = 0.05;
    TEST_ASSERT_TRUE(scenario_check(&scenario, &error));
}

static void test_check_of_radii(void) {
    TEST_ASSERT_TRUE(scenario_builtin("circle", &scenario));
    scenario.obstacles[1].conservative_m = 0.1;
    assert_check_refuses("obstacles.1.conservative_m: ", "(allowed: above 0.1, to 100)");
    scenario.obstacles[1].conservative_m = 0.2;
    scenario.obstacles[1].regulated_m = 0.21;
    assert_check_refuses("obstacles.1.regulated_m: ", "(allowed: 0.22 to 100)");
    scenario.obstacles[1].regulated_m = 0.22; /* in double, 0.2 + 0.02 is more than 0.22 */
    TEST_ASSERT_TRUE_MESSAGE(scenario_check(&scenario, &error), error.text);
}

/* conservative replaces the regulated radius by its skirt; the others have no skirt. */
static void test_check_of_radii_depends_on_the_strategy(void) {
    static const char *const loose[] = {"none", "conservative", "normal", "adaptive", "kanayama"};
    TEST_ASSERT_TRUE(scenario_builtin("circle", &scenario));
    scenario.obstacles[0].regulated_m = 0.2;
    for (size_t i = 0; i < sizeof loose / sizeof loose[0]; i++) {
        strcpy(scenario.avoidance.strategy, loose[i]);
        TEST_ASSERT_TRUE_MESSAGE(scenario_check(&scenario, &error), error.text);
    }
    strcpy(scenario.avoidance.strategy, "kanayama_avoid");
    assert_check_refuses("obstacles.0.regulated_m: ", "(allowed: 0.22 to 100)");
    strcpy(scenario.avoidance.strategy, "normal");
    scenario.obstacles[0].regulated_m = 0.19;
    assert_check_refuses("obstacles.0.regulated_m: ", "(allowed: 0.2 to 100)");
}

static void test_check_of_names(void) {
    TEST_ASSERT_TRUE(scenario_builtin("circle", &scenario));
    strcpy(scenario.avoidance.strategy, "luck");
    assert_check_refuses("avoidance.strategy: ", "combined");
    TEST_ASSERT_TRUE(scenario_builtin("circle", &scenario));
    assert_set("reference.file=/nonexistent/path.csv");
    assert_check_refuses("reference.file: ", "(allowed: path of a readable CSV file");
}

/* --- writing ----------------------------------------------------------------------------- */

static void assert_round_trip(void) {
    scenario_t back;
    memset(&back, 0, sizeof back);
    TEST_ASSERT_TRUE_MESSAGE(scenario_write(&scenario, path, &error), error.text);
    TEST_ASSERT_TRUE_MESSAGE(scenario_load(path, &back, &error), error.text);
    TEST_ASSERT_EQUAL_STRING(scenario.name, back.name);
    TEST_ASSERT_EQUAL_STRING(scenario.reference.file, back.reference.file);
    TEST_ASSERT_EQUAL_STRING(scenario.avoidance.strategy, back.avoidance.strategy);
    TEST_ASSERT_EQUAL(scenario.reference.shape, back.reference.shape);
    TEST_ASSERT_EQUAL(scenario.reference.closed, back.reference.closed);
    TEST_ASSERT_EQUAL(scenario.mpc.horizon, back.mpc.horizon);
    TEST_ASSERT_EQUAL(scenario.mpc.zoh, back.mpc.zoh);
    TEST_ASSERT_EQUAL_UINT(scenario.obstacle_count, back.obstacle_count);
    assert_same(scenario.period_s, back.period_s);
    assert_same(scenario.duration_s, back.duration_s);
    TEST_ASSERT_EQUAL_MEMORY(&scenario.robot, &back.robot, sizeof back.robot);
    TEST_ASSERT_EQUAL_MEMORY(&scenario.start, &back.start, sizeof back.start);
    TEST_ASSERT_EQUAL_MEMORY(scenario.mpc.q, back.mpc.q, sizeof back.mpc.q);
    TEST_ASSERT_EQUAL_MEMORY(scenario.mpc.r, back.mpc.r, sizeof back.mpc.r);
    assert_same(scenario.avoidance.skirt_m, back.avoidance.skirt_m);
    assert_same(scenario.avoidance.v_creep_mps, back.avoidance.v_creep_mps);
    TEST_ASSERT_EQUAL(scenario.avoidance.paced, back.avoidance.paced);
    if (scenario.obstacle_count > 0) {
        TEST_ASSERT_EQUAL_MEMORY(scenario.obstacles, back.obstacles,
                                 scenario.obstacle_count * sizeof back.obstacles[0]);
    }
    TEST_ASSERT_EQUAL_MEMORY(&scenario.plant, &back.plant, sizeof back.plant);
}

static void test_builtins_survive_writing(void) {
    TEST_ASSERT_TRUE(scenario_builtin("circle", &scenario));
    assert_round_trip();
    TEST_ASSERT_TRUE(scenario_builtin("eight", &scenario));
    assert_round_trip();
    assert_set("obstacles=[]");
    assert_round_trip();
    load(full);
    assert_round_trip();
}

static void test_awkward_names_survive_writing(void) {
    static const char *const names[] = {
        "a: b # c", "\"",
        "\\",       "\\n",
        "- x",      "{",
        "[1]",      "~",
        "null",     "true",
        "0x10",     "1",
        " x ",      "'",
        "%",        "@",
        "`",        "&a",
        "*a",       "!t",
        "|",        ">",
        "?",        "...",
        "---",      "\xC3\xA4\xE2\x82\xAC",
    };
    TEST_ASSERT_TRUE(scenario_builtin("circle", &scenario));
    for (size_t i = 0; i < sizeof names / sizeof names[0]; i++) {
        strcpy(scenario.name, names[i]);
        assert_round_trip();
    }
}

static void test_a_reference_file_survives_writing(void) {
    TEST_ASSERT_TRUE(scenario_builtin("circle", &scenario));
    char csv[140];
    (void)snprintf(csv, sizeof csv, "%s/path.csv", folder);
    write_text(csv, "t,x,y,theta,v,omega\n0,0,0,0,0.2,0\n0.05,0.01,0,0,0.2,0\n");
    scenario.reference.shape = SHAPE_FILE;
    strcpy(scenario.reference.file, csv);
    assert_round_trip();
}

/* Any number in its range, with all of its bits. */
static void test_random_values_survive_writing(void) {
    rng_t rng;
    rng_seed(&rng, SEED);
    printf("seed %u\n", SEED);
    for (int run = 0; run < 300; run++) {
        TEST_ASSERT_TRUE(scenario_builtin("eight", &scenario));
        for (size_t i = 0; i < SCENARIO_KEY_COUNT; i++) {
            const scenario_key_t *key = &scenario_keys[i];
            char *base = (char *)&scenario;
            if ((key->kind != KIND_NUMBER && key->kind != KIND_NUMBER_OR_ZERO) ||
                key->section == SECTION_OBSTACLES) {
                continue;
            }
            for (size_t n = 0; n < key->count; n++) {
                const double value = rng_uniform(&rng, key->minimum, key->maximum);
                memcpy(base + key->offset + n * sizeof value, &value, sizeof value);
            }
        }
        scenario.duration_s = rng_uniform(&rng, 0.05, 50000.0);
        scenario.obstacle_count = (size_t)rng_uniform(&rng, 0.0, SCENARIO_OBSTACLES_MAX + 1.0);
        for (size_t n = 0; n < scenario.obstacle_count; n++) {
            scenario_obstacle_t *o = &scenario.obstacles[n];
            o->x_m = rng_uniform(&rng, -1000.0, 1000.0);
            o->y_m = rng_normal(&rng);
            o->hard_m = rng_uniform(&rng, 0.001, 1.0);
            o->conservative_m = o->hard_m + rng_uniform(&rng, 1e-3, 1.0);
            o->regulated_m =
                o->conservative_m + scenario.avoidance.skirt_m + rng_uniform(&rng, 0.0, 1.0);
        }
        assert_round_trip();
    }
}

static void test_writing_into_no_folder(void) {
    TEST_ASSERT_TRUE(scenario_builtin("circle", &scenario));
    TEST_ASSERT_FALSE(scenario_write(&scenario, "/nonexistent/scenario.yaml", &error));
    assert_says("/nonexistent/scenario.yaml");
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_every_key_arrives);
    RUN_TEST(test_the_constrained_tracker_is_asked_for);
    RUN_TEST(test_defaults);
    RUN_TEST(test_without_a_start_the_robot_stands_on_the_reference);
    RUN_TEST(test_a_file_is_found_beside_the_scenario);
    RUN_TEST(test_a_refused_file_changes_nothing);
    RUN_TEST(test_a_document_may_be_marked);
    RUN_TEST(test_builtin_names);
    RUN_TEST(test_circle_is_as_designed);
    RUN_TEST(test_eight_is_as_designed);
    RUN_TEST(test_set_changes_one_value);
    RUN_TEST(test_set_refuses_what_a_file_may_not_say);
    RUN_TEST(test_set_refuses_a_text_that_does_not_fit);
    RUN_TEST(test_check_of_durations);
    RUN_TEST(test_check_of_radii);
    RUN_TEST(test_check_of_radii_depends_on_the_strategy);
    RUN_TEST(test_check_of_names);
    RUN_TEST(test_builtins_survive_writing);
    RUN_TEST(test_awkward_names_survive_writing);
    RUN_TEST(test_a_reference_file_survives_writing);
    RUN_TEST(test_random_values_survive_writing);
    RUN_TEST(test_writing_into_no_folder);
    return UNITY_END();
}
