#include "refusal.h"
#include "scenario.h"

#include <unistd.h>

static bool load(const char *name, scenario_t *scenario, scenario_error_t *error) {
    if (scenario_builtin(name, scenario)) {
        return true;
    }
    if (access(name, F_OK) != 0) {
        return refuse(error, "SCENARIO '%s': no such file (allowed: circle, eight or a YAML file)",
                      name);
    }
    return scenario_load(name, scenario, error);
}

bool scenario_open(const char *name, const char *const *sets, size_t set_count,
                   scenario_t *scenario, scenario_error_t *error) {
    if (!load(name, scenario, error)) {
        return false;
    }
    for (size_t i = 0; i < set_count; i++) {
        scenario_error_t why;
        if (!scenario_set(scenario, sets[i], &why)) {
            return refuse(error, "--set: %s", why.text);
        }
    }
    return scenario_check(scenario, error);
}
