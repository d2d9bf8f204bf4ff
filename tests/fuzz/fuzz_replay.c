/* Records of a board, replayed, and the set-up that they begin with. The first byte chooses: 's' a
 * set-up, 'r' any file, else the events of a record whose set-up is the circle's with two drives of
 * one protocol. What must hold: a refusal says why; a difference says where; the same file gives
 * the same result.
 */
#include "bus/board_host.h"
#include "bus/record.h"
#include "bus/replay.h"
#include "fuzz.h"
#include "input.h"
#include "memory_file.h"

#define BEGIN_US 1000000

/* The beginning of a record, made once. */
typedef struct {
    char *text;
    size_t size;
} head_t;

static void print_setup(FILE *file, const char *text) {
    for (size_t at = 0, left = strlen(text); left > 0;) {
        berth_can_frame_t frame = {.id = RECORD_SETUP, .time_us = BEGIN_US};
        frame.length = (uint8_t)(left < BERTH_CAN_DATA_MAX ? left : BERTH_CAN_DATA_MAX);
        memcpy(frame.data, text + at, frame.length);
        candump_print(file, RECORD_CHANNEL, &frame, CANDUMP_UNKNOWN);
        at += frame.length;
        left -= frame.length;
    }
}

static head_t make_head(void) {
    static board_recipe_t recipe;
    static board_host_t host;
    scenario_error_t error = {""};
    head_t head = {NULL, 0};
    bus_setup_init(&recipe.setup, false);
    FUZZ_CHECK(scenario_builtin("circle", &recipe.scenario) &&
                   scenario_set(&recipe.scenario, "duration_s=3", &error) &&
                   bus_setup_finish(&recipe.setup, &error) &&
                   board_host_make(&host, &recipe, BEGIN_US, &error),
               error.text);
    char *text = board_recipe_text(&recipe, &error);
    FILE *file = open_memstream(&head.text, &head.size);
    FUZZ_CHECK(text != NULL && file != NULL, "there is memory");
    print_setup(file, text);
    berth_can_frame_t init = {.id = RECORD_INIT, .length = 4, .time_us = BEGIN_US};
    memcpy(init.data, &host.board.plan_crc, 4);
    candump_print(file, RECORD_CHANNEL, &init, CANDUMP_UNKNOWN);
    FUZZ_CHECK(fclose(file) == 0, "there is memory");
    board_host_free(&host);
    free(text);
    return head;
}

static bool replay_once(const char *path, replay_result_t *result) {
    scenario_error_t error = {""};
    const bool good = replay_file(path, result, &error);
    FUZZ_CHECK(good || error.text[0] != '\0', "a refusal says why");
    FUZZ_CHECK(!good || result->same || (result->line > 0 && result->difference[0] != '\0'),
               "a difference says where");
    FUZZ_CHECK(!good || !result->same || result->difference[0] == '\0', "no difference, no words");
    return good;
}

static void replay(const head_t *head, const uint8_t *data, size_t size) {
    const memory_file_t file = memory_file_open();
    replay_result_t first;
    replay_result_t second;
    if (head != NULL) {
        memory_file_add(&file, head->text, head->size);
    }
    memory_file_add(&file, data, size);
    const bool good = replay_once(file.path, &first);
    FUZZ_CHECK(replay_once(file.path, &second) == good, "the same file gives the same result");
    FUZZ_CHECK(!good || (first.same == second.same && first.sent == second.sent &&
                         first.received == second.received && first.runs == second.runs &&
                         strcmp(first.state, second.state) == 0),
               "the same file gives the same result");
    memory_file_close(&file);
}

static void parse_setup(const uint8_t *data, size_t size) {
    static board_recipe_t recipe;
    scenario_error_t error = {""};
    char *text = strndup((const char *)data, size);
    FUZZ_CHECK(text != NULL, "there is memory");
    const bool good = board_recipe_parse("set-up", text, &recipe, &error);
    FUZZ_CHECK(good || error.text[0] != '\0', "a refusal says why");
    free(text);
    text = good ? board_recipe_text(&recipe, &error) : NULL;
    if (text != NULL) {
        static board_recipe_t again;
        FUZZ_CHECK(board_recipe_parse("again", text, &again, &error), error.text);
        FUZZ_CHECK(memcmp(&recipe.options, &again.options, sizeof again.options) == 0,
                   "options survive");
        free(text);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static head_t head;
    if (head.text == NULL) {
        head = make_head();
    }
    if (size == 0) {
        return 0;
    }
    if (data[0] == 's') {
        parse_setup(data + 1, size - 1);
    } else if (data[0] == 'r') {
        /* another set-up may ask for a plan that takes a minute to make */
        if (memmem(data, size, " 010#", 5) == NULL) {
            replay(NULL, data + 1, size - 1);
        }
    } else {
        replay(&head, data + 1, size - 1);
    }
    return 0;
}
