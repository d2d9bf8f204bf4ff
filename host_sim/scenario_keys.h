/* The keys of a scenario: one table that loading, setting, checking and writing share.
 * Private to scenario*.c. */
#ifndef HOST_SIM_SCENARIO_KEYS_H
#define HOST_SIM_SCENARIO_KEYS_H

#include "scenario.h"

#include <stdio.h>

typedef enum {
    SECTION_TOP,
    SECTION_REFERENCE,
    SECTION_ROBOT,
    SECTION_START,
    SECTION_MPC,
    SECTION_AVOIDANCE,
    SECTION_OBSTACLES,
    SECTION_PLANT,
    SECTION_COUNT
} key_section_t;

typedef enum {
    KIND_NUMBER,
    KIND_PERIOD,         /* a number, and a whole number of microseconds */
    KIND_NUMBER_OR_ZERO, /* 0 switches it off */
    KIND_INTEGER,
    KIND_BOOL,
    KIND_NAME,
    KIND_SHAPE,
    KIND_FILE,
    KIND_DISCRETIZATION,
    KIND_STRATEGY
} key_kind_t;

typedef enum {
    NEED_ALWAYS,     /* an error when missing */
    NEED_IN_SECTION, /* an error when missing while its section is given */
    NEED_NEVER
} key_need_t;

typedef struct {
    key_section_t section;
    const char *name;
    key_kind_t kind;
    size_t count;  /* of numbers: 1, or more for a list */
    size_t offset; /* in scenario_t, or in scenario_obstacle_t */
    double minimum, maximum;
    key_need_t need;
    const char *fallback; /* value when missing; NULL: zero, or set by the loader */
} scenario_key_t;

#define SCENARIO_KEY_COUNT 37
extern const scenario_key_t scenario_keys[SCENARIO_KEY_COUNT];
extern const char *const scenario_sections[SECTION_COUNT];

/* Room for the longest dotted key, and for the longest text of what is allowed. */
#define KEY_PATH_MAX 64
#define KEY_ALLOWED_MAX 160
#define KEY_WHAT_MAX 160

/* A key's value as it stands in a file. */
typedef struct {
    const char *text;
    bool quoted;
} key_value_t;

/* Index in the table; SCENARIO_KEY_COUNT when there is no such key. */
size_t scenario_key_find(key_section_t section, const char *name);

/* "robot.track_m", "obstacles.2.hard_m"; index is ignored but for obstacles. */
void scenario_key_path(const scenario_key_t *key, size_t index, char out[KEY_PATH_MAX]);

/* What a key allows: "0.01 to 10", "euler or zoh", "3 numbers, each 0 to 1000000". */
void scenario_key_allowed(const scenario_key_t *key, char out[KEY_ALLOWED_MAX]);

/* Names of the keys in a section, with commas. */
void scenario_section_allowed(key_section_t section, char out[KEY_ALLOWED_MAX]);

/* Dotted path of the key most like an unknown one; false when none is like it. */
bool scenario_key_suggest(key_section_t section, const char *name, char out[KEY_PATH_MAX]);

/* Stores element `element` of a key's value. On false nothing is stored and what says why. */
bool scenario_key_assign(const scenario_key_t *key, scenario_t *scenario, size_t index,
                         size_t element, key_value_t value, char what[KEY_WHAT_MAX]);

/* Stores a whole value written as one text; lists look like [1, 2, 3]. */
bool scenario_key_assign_text(const scenario_key_t *key, scenario_t *scenario, size_t index,
                              const char *text, char what[KEY_WHAT_MAX]);

/* A scenario with nothing but the defaults. */
void scenario_defaults(scenario_t *scenario);

/* Where the values of a scenario stand in its file. Line 0: not given. */
typedef struct {
    const char *file;
    int sections[SECTION_COUNT];
    int obstacles[SCENARIO_OBSTACLES_MAX];
    int keys[SCENARIO_KEY_COUNT][SCENARIO_OBSTACLES_MAX];
} scenario_lines_t;

/* "FILE:LINE: KEY: what (allowed: ALLOWED)", without FILE:LINE when lines is NULL; always false. A
 * key that is not given is reported where its section, or the file, begins. */
bool scenario_refuse_key(const scenario_lines_t *lines, size_t key, size_t index, const char *what,
                         const char *allowed, scenario_error_t *error);

/* scenario_check with line numbers. lines may be NULL. */
bool scenario_check_lines(const scenario_t *scenario, const scenario_lines_t *lines,
                          scenario_error_t *error);

/* True when every character of a name or a path can stand in a line of YAML. */
bool scenario_text_printable(const char *text);

#endif
