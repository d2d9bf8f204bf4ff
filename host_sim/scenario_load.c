/* YAML into a scenario, on libyaml's events: the only interface of it that shows anchors, aliases,
 * tags and duplicate keys, each with its line. The first fault ends the reading. */
#include "reference_source.h"
#include "refusal.h"
#include "scenario_keys.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <yaml.h>

#define FILE_BYTES_MAX ((size_t)1 << 20)

typedef struct {
    yaml_parser_t parser;
    yaml_event_t event;
    const unsigned char *bytes;
    size_t size;
    scenario_t *scenario;
    scenario_lines_t lines;
    scenario_error_t *error;
} loader_t;

/* A key's place: what section and, for obstacles, which one. */
typedef struct {
    key_section_t section;
    size_t index;
} place_t;

static int event_line(const loader_t *loader) {
    return (int)loader->event.start_mark.line + 1;
}

/* --- reading the file -------------------------------------------------------------------- */

static bool refuse_reading(const char *path, const char *what, scenario_error_t *error) {
    return refuse(error, "%s: cannot read: %s (allowed: a YAML file of at most %zu bytes)", path,
                  what, FILE_BYTES_MAX);
}

/* The whole file on the heap. */
static unsigned char *read_file(const char *path, size_t *size, scenario_error_t *error) {
    FILE *file = fopen(path, "rb");
    if (file == NULL) {
        refuse_reading(path, strerror(errno), error);
        return NULL;
    }
    unsigned char *bytes = malloc(FILE_BYTES_MAX + 1);
    errno = 0;
    *size = bytes == NULL ? 0 : fread(bytes, 1, FILE_BYTES_MAX + 1, file);
    const int reason = bytes == NULL ? ENOMEM : errno;
    const bool failed = bytes == NULL || ferror(file) != 0;
    (void)fclose(file);
    if (!failed && *size <= FILE_BYTES_MAX) {
        return bytes;
    }
    refuse_reading(path, failed ? strerror(reason) : "too large", error);
    free(bytes);
    return NULL;
}

/* --- events ------------------------------------------------------------------------------ */

static bool refuse_yaml(loader_t *loader) {
    const yaml_parser_t *parser = &loader->parser;
    int line = (int)parser->problem_mark.line + 1;
    const char *problem = parser->problem != NULL ? parser->problem : "out of memory";
    const char *allowed = "YAML of keys and values";
    if (parser->error == YAML_READER_ERROR) {
        /* the only fault that comes with an offset instead of a line */
        line = 1;
        for (size_t i = 0; i < parser->problem_offset && i < loader->size; i++) {
            line += loader->bytes[i] == '\n';
        }
        allowed = "UTF-8 text";
    }
    return refuse(loader->error, "%s:%d: yaml: %s (allowed: %s)", loader->lines.file, line, problem,
                  allowed);
}

static bool has_anchor(const yaml_event_t *event) {
    return (event->type == YAML_SCALAR_EVENT && event->data.scalar.anchor != NULL) ||
           (event->type == YAML_SEQUENCE_START_EVENT &&
            event->data.sequence_start.anchor != NULL) ||
           (event->type == YAML_MAPPING_START_EVENT && event->data.mapping_start.anchor != NULL);
}

static bool has_tag(const yaml_event_t *event) {
    return (event->type == YAML_SCALAR_EVENT && event->data.scalar.tag != NULL) ||
           (event->type == YAML_SEQUENCE_START_EVENT && event->data.sequence_start.tag != NULL) ||
           (event->type == YAML_MAPPING_START_EVENT && event->data.mapping_start.tag != NULL);
}

static bool next_event(loader_t *loader) {
    yaml_event_delete(&loader->event);
    if (!yaml_parser_parse(&loader->parser, &loader->event)) {
        return refuse_yaml(loader);
    }
    const char *what = NULL;
    if (loader->event.type == YAML_ALIAS_EVENT) {
        what = "aliases are not supported";
    } else if (has_anchor(&loader->event)) {
        what = "anchors are not supported";
    } else if (has_tag(&loader->event)) {
        what = "tags are not supported";
    }
    return what == NULL || refuse(loader->error, "%s:%d: yaml: %s (allowed: plain keys and values)",
                                  loader->lines.file, event_line(loader), what);
}

static const char *event_text(const loader_t *loader) {
    return (const char *)loader->event.data.scalar.value;
}

static const char *event_kind(const loader_t *loader) {
    switch ((int)loader->event.type) {
    case YAML_SEQUENCE_START_EVENT:
        return "is a list";
    case YAML_MAPPING_START_EVENT:
        return "is a mapping";
    default:
        return loader->event.data.scalar.length == 0 ? "is empty" : "is a single value";
    }
}

/* Fails for the current event, under a dotted path. */
static bool refuse_here(loader_t *loader, const char *path, const char *what, const char *allowed) {
    return refuse(loader->error, "%s:%d: %s: %s (allowed: %s)", loader->lines.file,
                  event_line(loader), path, what, allowed);
}

/* --- values ------------------------------------------------------------------------------ */

/* The current event is element `element` of a key's value. */
static bool load_scalar(loader_t *loader, size_t key, place_t place, size_t element) {
    const scenario_key_t *row = &scenario_keys[key];
    char path[KEY_PATH_MAX + 8];
    char allowed[KEY_ALLOWED_MAX];
    char what[KEY_WHAT_MAX];
    scenario_key_path(row, place.index, path);
    scenario_key_allowed(row, allowed);
    if (row->count > 1) {
        const size_t length = strlen(path);
        (void)snprintf(path + length, sizeof path - length, ".%zu", element);
    }
    if (loader->event.type != YAML_SCALAR_EVENT) {
        return refuse_here(loader, path, event_kind(loader), allowed);
    }
    if (strlen(event_text(loader)) != loader->event.data.scalar.length) {
        return refuse_here(loader, path, "has a zero byte", allowed);
    }
    const key_value_t value = {
        .text = event_text(loader),
        .quoted = loader->event.data.scalar.style != YAML_PLAIN_SCALAR_STYLE,
    };
    return scenario_key_assign(row, loader->scenario, place.index, element, value, what) ||
           refuse_here(loader, path, what, allowed);
}

/* The current event begins a list of numbers. */
static bool load_list(loader_t *loader, size_t key, place_t place) {
    char path[KEY_PATH_MAX];
    char allowed[KEY_ALLOWED_MAX];
    char what[KEY_WHAT_MAX];
    size_t found = 0;
    scenario_key_path(&scenario_keys[key], place.index, path);
    scenario_key_allowed(&scenario_keys[key], allowed);
    if (loader->event.type != YAML_SEQUENCE_START_EVENT) {
        return refuse_here(loader, path, event_kind(loader), allowed);
    }
    for (;;) {
        if (!next_event(loader)) {
            return false;
        }
        const bool end = loader->event.type == YAML_SEQUENCE_END_EVENT;
        if (end != (found == scenario_keys[key].count)) {
            (void)snprintf(what, sizeof what, end ? "has %zu numbers" : "has more than %zu numbers",
                           found);
            return refuse_here(loader, path, what, allowed);
        }
        if (end) {
            return true;
        }
        if (!load_scalar(loader, key, place, found)) {
            return false;
        }
        found++;
    }
}

static bool load_value(loader_t *loader, size_t key, place_t place) {
    return next_event(loader) &&
           (scenario_keys[key].count > 1 ? load_list(loader, key, place)
                                         : load_scalar(loader, key, place, 0));
}

/* --- mappings ---------------------------------------------------------------------------- */

/* "robot.", "obstacles.2.", "" */
static void place_text(place_t place, char out[KEY_PATH_MAX]) {
    if (place.section == SECTION_OBSTACLES) {
        (void)snprintf(out, KEY_PATH_MAX, "obstacles.%zu.", place.index);
    } else {
        (void)snprintf(out, KEY_PATH_MAX, "%s%s", scenario_sections[place.section],
                       place.section == SECTION_TOP ? "" : ".");
    }
}

/* The dotted path of the key that is the current event. */
static void key_here(const loader_t *loader, place_t place, char *out, size_t size) {
    char excerpt[REFUSAL_EXCERPT_MAX];
    char prefix[KEY_PATH_MAX];
    place_text(place, prefix);
    refusal_excerpt(event_text(loader), excerpt, sizeof excerpt);
    (void)snprintf(out, size, "%s%s", prefix, excerpt[0] == '\0' ? "''" : excerpt);
}

static bool refuse_unknown(loader_t *loader, place_t place) {
    char path[KEY_PATH_MAX + REFUSAL_EXCERPT_MAX];
    char allowed[KEY_ALLOWED_MAX];
    char like[KEY_PATH_MAX];
    char what[KEY_WHAT_MAX] = "unknown key";
    key_here(loader, place, path, sizeof path);
    scenario_section_allowed(place.section, allowed);
    if (scenario_key_suggest(place.section, event_text(loader), like)) {
        (void)snprintf(what, sizeof what, "unknown key, did you mean %s?", like);
    }
    return refuse_here(loader, path, what, allowed);
}

/* Notes where a key or section stands; fails when it stood elsewhere before. */
static bool note_line(loader_t *loader, place_t place, int *line) {
    if (*line == 0) {
        *line = event_line(loader);
        return true;
    }
    char path[KEY_PATH_MAX + REFUSAL_EXCERPT_MAX];
    char what[KEY_WHAT_MAX];
    key_here(loader, place, path, sizeof path);
    (void)snprintf(what, sizeof what, "duplicate key, given before in line %d", *line);
    return refuse_here(loader, path, what, "once");
}

/* The current event must begin a mapping. */
static bool expect_mapping(loader_t *loader, const char *path, key_section_t section) {
    char allowed[KEY_ALLOWED_MAX + 32];
    char keys[KEY_ALLOWED_MAX];
    if (loader->event.type == YAML_MAPPING_START_EVENT) {
        return true;
    }
    scenario_section_allowed(section, keys);
    (void)snprintf(allowed, sizeof allowed, "a mapping of %s", keys);
    return refuse_here(loader, path, event_kind(loader), allowed);
}

/* Moves to the next key of a mapping; *end tells that there is none. */
static bool next_key(loader_t *loader, place_t place, bool *end) {
    if (!next_event(loader)) {
        return false;
    }
    *end = loader->event.type == YAML_MAPPING_END_EVENT;
    if (*end || loader->event.type == YAML_SCALAR_EVENT) {
        return true;
    }
    char allowed[KEY_ALLOWED_MAX];
    scenario_section_allowed(place.section, allowed);
    const char *name = scenario_sections[place.section];
    return refuse_here(loader, name[0] == '\0' ? "scenario" : name, "a key is not a plain word",
                       allowed);
}

/* The current event is a key. */
static bool load_key(loader_t *loader, place_t place) {
    const size_t key = scenario_key_find(place.section, event_text(loader));
    if (key == SCENARIO_KEY_COUNT) {
        return refuse_unknown(loader, place);
    }
    return note_line(loader, place, &loader->lines.keys[key][place.index]) &&
           load_value(loader, key, place);
}

/* The keys of a section or an obstacle, up to the end of the mapping that has begun. */
static bool load_keys(loader_t *loader, place_t place) {
    bool end = false;
    while (next_key(loader, place, &end)) {
        if (end) {
            return true;
        }
        if (!load_key(loader, place)) {
            return false;
        }
    }
    return false;
}

static bool load_obstacle(loader_t *loader) {
    const size_t index = loader->scenario->obstacle_count;
    char path[KEY_PATH_MAX];
    char what[KEY_WHAT_MAX];
    char allowed[KEY_ALLOWED_MAX];
    (void)snprintf(path, sizeof path, "obstacles.%zu", index);
    if (index == SCENARIO_OBSTACLES_MAX) {
        (void)snprintf(what, sizeof what, "more than %d obstacles", SCENARIO_OBSTACLES_MAX);
        (void)snprintf(allowed, sizeof allowed, "0 to %d", SCENARIO_OBSTACLES_MAX);
        return refuse_here(loader, "obstacles", what, allowed);
    }
    if (!expect_mapping(loader, path, SECTION_OBSTACLES)) {
        return false;
    }
    loader->lines.obstacles[index] = event_line(loader);
    loader->scenario->obstacle_count++;
    return load_keys(loader, (place_t){SECTION_OBSTACLES, index});
}

static bool load_obstacles(loader_t *loader) {
    if (!next_event(loader)) {
        return false;
    }
    if (loader->event.type != YAML_SEQUENCE_START_EVENT) {
        return refuse_here(loader, "obstacles", event_kind(loader),
                           "a list of 0 to 16 obstacles; [] for none");
    }
    while (next_event(loader)) {
        if (loader->event.type == YAML_SEQUENCE_END_EVENT) {
            return true;
        }
        if (!load_obstacle(loader)) {
            return false;
        }
    }
    return false;
}

static key_section_t find_section(const char *name) {
    key_section_t section = SECTION_COUNT;
    for (size_t i = 1; i < SECTION_COUNT; i++) {
        if (strcmp(scenario_sections[i], name) == 0) {
            section = (key_section_t)i;
        }
    }
    return section;
}

/* The current event is a key of the top: a value of its own, or a section. */
static bool load_top_key(loader_t *loader) {
    const place_t top = {SECTION_TOP, 0};
    const key_section_t section = find_section(event_text(loader));
    if (section == SECTION_COUNT) {
        return load_key(loader, top);
    }
    if (!note_line(loader, top, &loader->lines.sections[section])) {
        return false;
    }
    if (section == SECTION_OBSTACLES) {
        return load_obstacles(loader);
    }
    return next_event(loader) && expect_mapping(loader, scenario_sections[section], section) &&
           load_keys(loader, (place_t){section, 0});
}

static bool load_top(loader_t *loader) {
    bool end = false;
    if (!next_event(loader) || !expect_mapping(loader, "scenario", SECTION_TOP)) {
        return false;
    }
    loader->lines.sections[SECTION_TOP] = event_line(loader);
    while (next_key(loader, (place_t){SECTION_TOP, 0}, &end)) {
        if (end) {
            return true;
        }
        if (!load_top_key(loader)) {
            return false;
        }
    }
    return false;
}

/* One document and nothing after it. */
static bool load_document(loader_t *loader) {
    /* NOLINTNEXTLINE(misc-redundant-expression): each takes one: the stream, the document */
    if (!next_event(loader) || !next_event(loader)) {
        return false;
    }
    if (loader->event.type != YAML_DOCUMENT_START_EVENT) {
        return refuse_here(loader, "scenario", "the file is empty",
                           "a mapping of name, period_s, duration_s, reference, robot and more");
    }
    if (!load_top(loader) || !next_event(loader) || !next_event(loader)) {
        return false;
    }
    return loader->event.type == YAML_STREAM_END_EVENT ||
           refuse_here(loader, "yaml", "more than one document", "one");
}

/* --- what is missing --------------------------------------------------------------------- */

static bool refuse_missing(loader_t *loader, size_t key, size_t index) {
    char allowed[KEY_ALLOWED_MAX];
    scenario_key_allowed(&scenario_keys[key], allowed);
    return scenario_refuse_key(&loader->lines, key, index, "missing key", allowed, loader->error);
}

static bool check_given(loader_t *loader, size_t key) {
    const scenario_key_t *row = &scenario_keys[key];
    if (row->section == SECTION_OBSTACLES) {
        for (size_t i = 0; i < loader->scenario->obstacle_count; i++) {
            if (loader->lines.keys[key][i] == 0) {
                return refuse_missing(loader, key, i);
            }
        }
        return true;
    }
    const bool needed = row->need == NEED_ALWAYS ||
                        (row->need == NEED_IN_SECTION && loader->lines.sections[row->section] != 0);
    return !needed || loader->lines.keys[key][0] != 0 || refuse_missing(loader, key, 0);
}

static bool check_reference_given(loader_t *loader) {
    const size_t shape = scenario_key_find(SECTION_REFERENCE, "shape");
    const size_t file = scenario_key_find(SECTION_REFERENCE, "file");
    const bool has_shape = loader->lines.keys[shape][0] != 0;
    const bool has_file = loader->lines.keys[file][0] != 0;
    if (has_shape == has_file) {
        return scenario_refuse_key(&loader->lines, has_shape ? file : shape, 0,
                                   has_shape ? "given beside reference.shape"
                                             : "missing key, and no reference.file either",
                                   "exactly one of shape: circle or eight, and file: PATH",
                                   loader->error);
    }
    return true;
}

static bool check_all_given(loader_t *loader) {
    bool good = true;
    for (size_t i = 0; good && i < SCENARIO_KEY_COUNT; i++) {
        good = check_given(loader, i);
    }
    return good && check_reference_given(loader);
}

/* --- what follows from the values -------------------------------------------------------- */

/* A relative path is relative to the folder of the scenario file. */
static bool resolve_file(loader_t *loader) {
    const char *file = loader->scenario->reference.file;
    const char *slash = strrchr(loader->lines.file, '/');
    char resolved[SCENARIO_TEXT_MAX];
    if (loader->scenario->reference.shape != SHAPE_FILE || file[0] == '/' || slash == NULL) {
        return true;
    }
    const int folder = (int)(slash - loader->lines.file) + 1;
    const int length =
        snprintf(resolved, sizeof resolved, "%.*s%s", folder, loader->lines.file, file);
    if (length < 0 || (size_t)length >= sizeof resolved) {
        return scenario_refuse_key(&loader->lines, scenario_key_find(SECTION_REFERENCE, "file"), 0,
                                   "too long a path together with the scenario's folder",
                                   "1 to 255 bytes", loader->error);
    }
    strcpy(loader->scenario->reference.file, resolved);
    return true;
}

/* Without `start` the robot stands on the reference's first sample. */
static bool default_start(loader_t *loader) {
    scenario_t *scenario = loader->scenario;
    reference_samples_t samples = {NULL, 0, 0.0};
    if (loader->lines.sections[SECTION_START] != 0) {
        return true;
    }
    const bool good = scenario->reference.shape == SHAPE_FILE
                          ? reference_from_csv(scenario->reference.file, scenario->period_s,
                                               scenario->reference.closed, &samples, loader->error)
                          : reference_from_shape(scenario->reference.shape, scenario->period_s,
                                                 scenario->period_s, &samples, loader->error);
    if (good) {
        scenario->start.x_m = (double)samples.samples[0].x_m;
        scenario->start.y_m = (double)samples.samples[0].y_m;
        scenario->start.theta_rad = (double)samples.samples[0].theta_rad;
        reference_samples_free(&samples);
    }
    return good;
}

/* bytes stays the caller's. */
static bool load_bytes(const char *name, const unsigned char *bytes, size_t size,
                       scenario_t *scenario, scenario_error_t *error) {
    scenario_t loaded;
    loader_t loader = {
        .scenario = &loaded, .error = error, .lines = {.file = name}, .bytes = bytes, .size = size};
    if (!yaml_parser_initialize(&loader.parser)) {
        return refuse_reading(name, "out of memory", error);
    }
    yaml_parser_set_encoding(&loader.parser, YAML_UTF8_ENCODING);
    yaml_parser_set_input_string(&loader.parser, bytes, size);
    scenario_defaults(&loaded);
    const bool good = load_document(&loader) && check_all_given(&loader) && resolve_file(&loader) &&
                      scenario_check_lines(&loaded, &loader.lines, error) && default_start(&loader);
    yaml_event_delete(&loader.event);
    yaml_parser_delete(&loader.parser);
    if (good) {
        *scenario = loaded;
    }
    return good;
}

bool scenario_load(const char *path, scenario_t *scenario, scenario_error_t *error) {
    size_t size = 0;
    unsigned char *bytes = read_file(path, &size, error);
    if (bytes == NULL) {
        return false;
    }
    const bool good = load_bytes(path, bytes, size, scenario, error);
    free(bytes);
    return good;
}

bool scenario_load_text(const char *name, const char *text, scenario_t *scenario,
                        scenario_error_t *error) {
    return load_bytes(name, (const unsigned char *)text, strlen(text), scenario, error);
}
