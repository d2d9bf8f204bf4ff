/* Lines of candump's log format. What must hold: what is refused changes nothing and says why; what
 * is read is a frame that a bus can carry, and written out it is read back.
 */
#include "bus/candump.h"
#include "fuzz.h"
#include "input.h"

static void check_line(const char *text) {
    char why[CANDUMP_WHY_MAX] = "";
    candump_line_t line;
    memset(&line, 0xA5, sizeof line);
    const candump_line_t before = line;
    if (!candump_parse(text, &line, why)) {
        FUZZ_CHECK(why[0] != '\0' && memcmp(&before, &line, sizeof line) == 0,
                   "what is refused changes nothing");
        return;
    }
    const uint32_t most = line.frame.extended ? BERTH_CAN_EXTENDED_MAX : BERTH_CAN_STANDARD_MAX;
    FUZZ_CHECK(line.frame.id <= most && line.frame.length <= BERTH_CAN_DATA_MAX &&
                   line.frame.time_us >= 0 && line.channel[0] != '\0',
               "a line is a frame that a bus can carry");
    candump_line_t again;
    char *written = NULL;
    size_t size = 0;
    FILE *file = open_memstream(&written, &size);
    FUZZ_CHECK(file != NULL, "there is memory");
    candump_print(file, line.channel, &line.frame, line.direction);
    FUZZ_CHECK(fclose(file) == 0, "there is memory");
    FUZZ_CHECK(candump_parse(written, &again, why) && candump_same(&line.frame, &again.frame) &&
                   line.frame.time_us == again.frame.time_us && line.direction == again.direction &&
                   strcmp(line.channel, again.channel) == 0,
               "what is written reads back");
    free(written);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    char *text = strndup((const char *)data, size);
    FUZZ_CHECK(text != NULL, "there is memory");
    check_line(text);
    char *rest = text;
    for (char *line; (line = strsep(&rest, "\n")) != NULL;) {
        check_line(line);
    }
    free(text);
    return 0;
}
