#include "board.h"
#include "pil.h"
#include "semihosting.h"

#include <string.h>

#define COMMAND_LINE_BYTES 256

static bool take_word(pil_options_t *options, const char *word) {
    static const struct {
        const char *word;
        uint8_t flag; /* of the table below */
        uint8_t value;
    } known[] = {
        {"PLAN=circle", 0, 0},
        {"PLAN=eight", 0, 1},
        {"OBSTACLES=plan", 1, 0},
        {"OBSTACLES=bus", 1, 1},
        {"MODE=live", 2, 0},
        {"MODE=lockstep", 2, 1},
        {"SELF=0", 3, 0},
        {"SELF=1", 3, 1},
        {"PATIENT=0", 4, 0},
        {"PATIENT=1", 4, 1},
        {"BREAK=stack", 5, PIL_BREAK_STACK},
        {"BREAK=late", 5, PIL_BREAK_LATE},
        {"BREAK=plan", 5, PIL_BREAK_PLAN},
    };
    bool *const flags[] = {&options->eight, &options->announced, &options->lockstep, &options->self,
                           &options->patient};
    for (uint32_t i = 0; i < sizeof known / sizeof known[0]; i++) {
        if (strcmp(known[i].word, word) == 0) {
            if (known[i].flag < 5) {
                *flags[known[i].flag] = known[i].value != 0;
            } else {
                options->breaks = (pil_break_t)known[i].value;
            }
            return true;
        }
    }
    return false;
}

bool pil_options(pil_options_t *options) {
    static char line[COMMAND_LINE_BYTES];
    *options = (pil_options_t){.eight = false};
    semihosting_command_line(line, sizeof line);
    char *at = line + strcspn(line, " "); /* the first word is the program's name */
    while (*at != '\0') {
        at += strspn(at, " ");
        char *word = at;
        at += strcspn(at, " ");
        if (*at != '\0') {
            *at = '\0';
            at++;
        }
        if (*word != '\0' && !take_word(options, word)) {
            board_puts("unknown: ");
            board_puts(word);
            board_puts("\n");
            return false;
        }
    }
    return true;
}

int main(void) {
    pil_options_t options;
    if (!pil_options(&options)) {
        return 2;
    }
    return options.lockstep ? pil_lockstep(&options) : pil_live(&options);
}
