/* A scenario as YAML. Numbers are written so that they read back to the same bits. */
#include "number.h"
#include "output_file.h"
#include "refusal.h"
#include "scenario_keys.h"

#include <stdlib.h>
#include <string.h>

static void write_text(FILE *file, const char *text) {
    fputc('"', file);
    for (; *text != '\0'; text++) {
        if (*text == '"' || *text == '\\') {
            fputc('\\', file);
        }
        fputc(*text, file);
    }
    fputc('"', file);
}

static void write_number(FILE *file, double value) {
    char text[NUMBER_TEXT_MAX];
    number_text(value, text, sizeof text);
    fputs(text, file);
}

static void write_numbers(FILE *file, const double *values, size_t count) {
    if (count == 1) {
        write_number(file, values[0]);
        return;
    }
    for (size_t i = 0; i < count; i++) {
        fputs(i == 0 ? "[" : ", ", file);
        write_number(file, values[i]);
    }
    fputc(']', file);
}

static void write_value(FILE *file, const scenario_key_t *key, const char *base) {
    const void *value = base + key->offset;
    switch (key->kind) {
    case KIND_BOOL:
        fputs(*(const bool *)value ? "true" : "false", file);
        break;
    case KIND_NAME:
    case KIND_FILE:
        write_text(file, value);
        break;
    case KIND_SHAPE:
        fputs(*(const shape_t *)value == SHAPE_CIRCLE ? "circle" : "eight", file);
        break;
    case KIND_DISCRETIZATION:
        fputs(*(const bool *)value ? "zoh" : "euler", file);
        break;
    case KIND_STRATEGY:
        fputs(value, file);
        break;
    case KIND_INTEGER:
        fprintf(file, "%d", *(const int *)value);
        break;
    case KIND_NUMBER:
    case KIND_PERIOD:
    case KIND_NUMBER_OR_ZERO:
    default:
        write_numbers(file, value, key->count);
        break;
    }
}

/* Which of shape and file there is, and the wheels' limit that is absent when zero. */
static bool is_written(const scenario_t *scenario, const scenario_key_t *key) {
    if (key->kind == KIND_SHAPE || key->kind == KIND_FILE) {
        return (key->kind == KIND_FILE) == (scenario->reference.shape == SHAPE_FILE);
    }
    return key->offset != offsetof(scenario_t, robot.wheel_speed_max_radps) ||
           key->section != SECTION_ROBOT || scenario->robot.wheel_speed_max_radps > 0.0;
}

static void write_section(FILE *file, const scenario_t *scenario, key_section_t section) {
    if (section != SECTION_TOP) {
        fprintf(file, "%s:\n", scenario_sections[section]);
    }
    for (size_t i = 0; i < SCENARIO_KEY_COUNT; i++) {
        const scenario_key_t *key = &scenario_keys[i];
        if (key->section == section && is_written(scenario, key)) {
            fprintf(file, "%s%s: ", section == SECTION_TOP ? "" : "  ", key->name);
            write_value(file, key, (const char *)scenario);
            fputc('\n', file);
        }
    }
}

static void write_obstacles(FILE *file, const scenario_t *scenario) {
    fputs(scenario->obstacle_count == 0 ? "obstacles: []\n" : "obstacles:\n", file);
    for (size_t n = 0; n < scenario->obstacle_count; n++) {
        const char *lead = "  - ";
        for (size_t i = 0; i < SCENARIO_KEY_COUNT; i++) {
            const scenario_key_t *key = &scenario_keys[i];
            if (key->section == SECTION_OBSTACLES) {
                fprintf(file, "%s%s: ", lead, key->name);
                write_value(file, key, (const char *)&scenario->obstacles[n]);
                fputc('\n', file);
                lead = "    ";
            }
        }
    }
}

/* A loader takes a relative path from the folder of the scenario file, which is not where this one
 * is relative to. */
static bool make_absolute(scenario_t *scenario, scenario_error_t *error) {
    if (scenario->reference.shape != SHAPE_FILE || scenario->reference.file[0] == '/') {
        return true;
    }
    char *absolute = realpath(scenario->reference.file, NULL);
    const bool good = absolute != NULL && strlen(absolute) < sizeof scenario->reference.file &&
                      scenario_text_printable(absolute);
    if (good) {
        strcpy(scenario->reference.file, absolute);
    }
    free(absolute);
    return good || refuse(error,
                          "reference.file: '%.80s' has no absolute path (allowed: a file that "
                          "exists, with an absolute path of at most %d printable bytes)",
                          scenario->reference.file, SCENARIO_TEXT_MAX - 1);
}

bool scenario_print(const scenario_t *scenario, FILE *file, scenario_error_t *error) {
    scenario_t copy = *scenario;
    if (!make_absolute(&copy, error)) {
        return false;
    }
    for (size_t i = 0; i < SECTION_COUNT; i++) {
        if (i == SECTION_OBSTACLES) {
            write_obstacles(file, &copy);
        } else {
            write_section(file, &copy, (key_section_t)i);
        }
    }
    return true;
}

bool scenario_write(const scenario_t *scenario, const char *path, scenario_error_t *error) {
    output_file_t out;
    if (!output_file_open(&out, path, error)) {
        return false;
    }
    if (!scenario_print(scenario, out.file, error)) {
        output_file_discard(&out);
        return false;
    }
    return output_file_commit(&out, error);
}
