/* The scenario loader: any bytes as YAML, and any text as KEY=VALUE. What must hold: a refusal says
 * why and changes nothing; what is accepted passes the checks, and written out it is read back to
 * the same values.
 */
#include "fuzz.h"
#include "input.h"
#include "memory_file.h"
#include "scenario.h"

/* Member by member where there is padding or text beyond its end. */
static bool same(const scenario_t *a, const scenario_t *b) {
    return strcmp(a->name, b->name) == 0 && a->period_s == b->period_s &&
           a->duration_s == b->duration_s && a->reference.shape == b->reference.shape &&
           a->reference.closed == b->reference.closed &&
           memcmp(&a->robot, &b->robot, sizeof a->robot) == 0 &&
           memcmp(&a->start, &b->start, sizeof a->start) == 0 && a->mpc.horizon == b->mpc.horizon &&
           memcmp(a->mpc.q, b->mpc.q, sizeof a->mpc.q) == 0 &&
           memcmp(a->mpc.r, b->mpc.r, sizeof a->mpc.r) == 0 && a->mpc.zoh == b->mpc.zoh &&
           a->mpc.constrained == b->mpc.constrained &&
           strcmp(a->avoidance.strategy, b->avoidance.strategy) == 0 &&
           a->avoidance.skirt_m == b->avoidance.skirt_m &&
           a->avoidance.v_creep_mps == b->avoidance.v_creep_mps &&
           a->obstacle_count == b->obstacle_count &&
           memcmp(a->obstacles, b->obstacles, a->obstacle_count * sizeof a->obstacles[0]) == 0 &&
           memcmp(&a->plant, &b->plant, sizeof a->plant) == 0;
}

static void check_accepted(const scenario_t *scenario) {
    scenario_error_t error = {""};
    scenario_t again;
    char *text = NULL;
    size_t size = 0;
    FUZZ_CHECK(scenario_check(scenario, &error), "what is accepted passes the checks");
    FILE *file = open_memstream(&text, &size);
    FUZZ_CHECK(file != NULL, "there is memory");
    const bool printed = scenario_print(scenario, file, &error);
    FUZZ_CHECK(fclose(file) == 0, "there is memory");
    if (printed) {
        FUZZ_CHECK(scenario_load_text("again", text, &again, &error), error.text);
        FUZZ_CHECK(same(scenario, &again), "what is written reads back");
    } else {
        FUZZ_CHECK(scenario->reference.shape == SHAPE_FILE, "a shape can be written");
    }
    free(text);
}

static void load(const uint8_t *data, size_t size) {
    const memory_file_t file = memory_file_open();
    scenario_error_t error = {""};
    static scenario_t scenario;
    memory_file_add(&file, data, size);
    if (scenario_load(file.path, &scenario, &error)) {
        check_accepted(&scenario);
    } else {
        FUZZ_CHECK(error.text[0] != '\0' && strchr(error.text, '\n') == NULL,
                   "a refusal is one line");
    }
    memory_file_close(&file);
}

/* One assignment a line. */
static void assign(const uint8_t *data, size_t size) {
    static scenario_t scenario;
    char *text = strndup((const char *)data, size);
    FUZZ_CHECK(text != NULL && scenario_builtin("circle", &scenario), "there is a circle");
    char *rest = text;
    for (char *line; (line = strsep(&rest, "\n")) != NULL;) {
        scenario_error_t error = {""};
        const scenario_t before = scenario;
        if (!scenario_set(&scenario, line, &error)) {
            FUZZ_CHECK(error.text[0] != '\0', "a refusal says why");
            FUZZ_CHECK(same(&before, &scenario), "what is refused changes nothing");
        } else if (scenario_check(&scenario, &error)) {
            check_accepted(&scenario);
        }
    }
    free(text);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    if (size > 0 && data[0] == '=') {
        assign(data + 1, size - 1);
    } else {
        load(data, size);
    }
    return 0;
}
