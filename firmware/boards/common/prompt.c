#include "prompt.h"

#include <string.h>

#define PROMPT "> "
#define BACKSPACE 0x08
#define DELETE 0x7f

/* Room that an answer may need: nothing is read while there is less. */
#define ANSWER_MAX 640u

#define POSE_LIMIT 1000000000
#define MILLI 1.0e-3f

/* ---- Output -----------------------------------------------------------------------------------
 */

static void put(prompt_t *prompt, const char *text) {
    for (; *text != '\0' && prompt->out_end < PROMPT_OUT_MAX; text++) {
        prompt->out[prompt->out_end++] = *text;
    }
}

static void put_number(prompt_t *prompt, int64_t number) {
    char text[21];
    size_t at = sizeof text - 1u;
    uint64_t rest = number < 0 ? 0u - (uint64_t)number : (uint64_t)number;
    text[at] = '\0';
    do {
        text[--at] = (char)('0' + (char)(rest % 10u));
        rest /= 10u;
    } while (rest > 0 && at > 1u);
    if (number < 0) {
        text[--at] = '-';
    }
    put(prompt, &text[at]);
}

static void put_named(prompt_t *prompt, const char *name, int64_t number) {
    put(prompt, name);
    put(prompt, " ");
    put_number(prompt, number);
}

/* In thousandths, rounded. What is not finite, or too large to be true, shows as the limit. */
static void put_milli(prompt_t *prompt, float value) {
    const float limit = (float)POSE_LIMIT * MILLI;
    const float within = value > -limit ? (value < limit ? value : limit) : -limit;
    put_number(prompt, (int32_t)(within / MILLI + (within < 0.0f ? -0.5f : 0.5f)));
}

static void write_out(prompt_t *prompt) {
    size_t count = 0;
    if (prompt->out_start < prompt->out_end) {
        const byte_stream_outcome_t outcome = prompt->stream.api->write(
            prompt->stream.context, (const uint8_t *)&prompt->out[prompt->out_start],
            prompt->out_end - prompt->out_start, &count);
        prompt->out_start += outcome == BYTE_STREAM_DONE ? count : 0u;
    }
    if (prompt->out_start > 0) {
        memmove(prompt->out, &prompt->out[prompt->out_start], prompt->out_end - prompt->out_start);
        prompt->out_end -= prompt->out_start;
        prompt->out_start = 0;
    }
}

/* ---- Status -----------------------------------------------------------------------------------
 */

static const char *mode_text(berth_can_mode_t mode) {
    switch (mode) {
    case BERTH_CAN_ERROR_ACTIVE:
        return "up";
    case BERTH_CAN_ERROR_PASSIVE:
        return "error passive";
    case BERTH_CAN_BUS_OFF:
        return "BUS-OFF";
    case BERTH_CAN_DOWN:
        return "DOWN";
    }
    return "?";
}

static const char *drive_text(berth_drive_state_t state) {
    switch (state) {
    case BERTH_DRIVE_OFF:
        return "off";
    case BERTH_DRIVE_STARTING:
        return "starting";
    case BERTH_DRIVE_ENABLED:
        return "enabled";
    case BERTH_DRIVE_STOPPED:
        return "stopped";
    case BERTH_DRIVE_FAULT:
        return "FAULT";
    }
    return "?";
}

static void put_state(prompt_t *prompt) {
    const berth_board_status_t *status = berth_board_status(prompt->board);
    put(prompt, "state ");
    put(prompt, berth_supervisor_state_text(status->state));
    if (status->fault != BERTH_FAULT_NONE) {
        put(prompt, ": ");
        put(prompt, berth_fault_side_text(status->fault));
        put(prompt, berth_fault_text(status->fault));
    }
    put(prompt, "\r\n");
}

static void put_bus(prompt_t *prompt) {
    berth_can_state_t state;
    prompt->can.api->state(prompt->can.context, &state);
    put(prompt, "can ");
    put(prompt, mode_text(state.mode));
    put_named(prompt, ", rx lost", state.rx_lost);
    put_named(prompt, ", tx dropped", state.tx_dropped);
    put_named(prompt, ", errors", state.error_frames);
    put_named(prompt, ", restarts", state.restarts);
    put(prompt, "\r\n");
}

static void put_pose(prompt_t *prompt) {
    const berth_board_status_t *status = berth_board_status(prompt->board);
    put(prompt, "pose ");
    if (!status->pose_known) {
        put(prompt, "unknown\r\n");
        return;
    }
    put_milli(prompt, status->pose.x_m);
    put(prompt, " ");
    put_milli(prompt, status->pose.y_m);
    put(prompt, " mm, ");
    put_milli(prompt, status->pose.theta_rad);
    put(prompt, " mrad\r\n");
}

static void put_status(prompt_t *prompt) {
    const berth_board_status_t *status = berth_board_status(prompt->board);
    put_state(prompt);
    put_bus(prompt);
    put_pose(prompt);
    for (int side = BERTH_LEFT; side <= BERTH_RIGHT; side++) {
        const berth_drive_status_t *drive = berth_board_drive(prompt->board, side);
        put(prompt, side == BERTH_LEFT ? "left " : "right ");
        put(prompt, drive_text(drive->state));
        put_named(prompt, ", received", drive->received);
        put(prompt, "\r\n");
    }
    put_named(prompt, "steps", status->steps);
    put_named(prompt, ", late", status->late);
    put_named(prompt, ", missed", status->missed);
    put_named(prompt, ", latest us", status->latest_us);
    put(prompt, "\r\n");
}

/* ---- Commands ---------------------------------------------------------------------------------
 */

/* The integer that begins there, after blanks, and ends at a blank or the end; *text moves on. */
static bool take_number(const char **text, int32_t *number) {
    const char *at = *text;
    int32_t value = 0;
    while (*at == ' ') {
        at++;
    }
    const bool negative = *at == '-';
    at += negative ? 1 : 0;
    const char *first = at;
    for (; *at >= '0' && *at <= '9'; at++) {
        if (value > (POSE_LIMIT - 9) / 10) {
            return false;
        }
        value = value * 10 + (*at - '0');
    }
    if (at == first || (*at != ' ' && *at != '\0')) {
        return false;
    }
    *text = at;
    *number = negative ? -value : value;
    return true;
}

static void set_pose(prompt_t *prompt, const char *arguments, int64_t now_us) {
    int32_t numbers[3];
    for (int i = 0; i < 3; i++) {
        if (!take_number(&arguments, &numbers[i])) {
            put(prompt, "pose wants three integers: X and Y in mm, THETA in mrad\r\n");
            return;
        }
    }
    if (strspn(arguments, " ") != strlen(arguments)) {
        put(prompt, "pose wants no more than three integers\r\n");
        return;
    }
    const berth_pose_t pose = {.x_m = (float)numbers[0] * MILLI,
                               .y_m = (float)numbers[1] * MILLI,
                               .theta_rad = (float)numbers[2] * MILLI};
    const berth_error_t error = berth_board_set_pose(prompt->board, &pose, now_us);
    put(prompt, error == BERTH_OK ? "ok" : berth_error_text(error));
    put(prompt, "\r\n");
}

static void command(prompt_t *prompt, berth_command_code_t code, int64_t now_us) {
    const uint32_t refused = berth_board_status(prompt->board)->commands_refused;
    berth_board_command(prompt->board, code, now_us);
    const bool taken = berth_board_status(prompt->board)->commands_refused == refused;
    put(prompt, taken ? "ok\r\n" : "refused\r\n");
}

static berth_command_code_t command_named(const char *name) {
    static const struct {
        const char *name;
        berth_command_code_t code;
    } commands[] = {{"arm", BERTH_COMMAND_ARM},
                    {"start", BERTH_COMMAND_START},
                    {"stop", BERTH_COMMAND_STOP},
                    {"estop", BERTH_COMMAND_EMERGENCY_STOP},
                    {"reset", BERTH_COMMAND_RESET}};
    for (size_t i = 0; i < sizeof commands / sizeof commands[0]; i++) {
        if (strcmp(name, commands[i].name) == 0) {
            return commands[i].code;
        }
    }
    return BERTH_COMMAND_NONE;
}

static void obey(prompt_t *prompt, int64_t now_us) {
    const char *line = prompt->line;
    const berth_command_code_t code = command_named(line);
    if (code != BERTH_COMMAND_NONE) {
        command(prompt, code, now_us);
    } else if (strcmp(line, "status") == 0) {
        put_status(prompt);
    } else if (strncmp(line, "pose ", 5) == 0) {
        set_pose(prompt, &line[5], now_us);
    } else if (strcmp(line, "help") == 0) {
        put(prompt, "status   how the board, the bus and the drives are\r\n"
                    "arm      enable the drives\r\n"
                    "start    follow the plan\r\n"
                    "stop     come to a stand, take the torque off\r\n"
                    "estop    stop by the hardest means\r\n"
                    "reset    leave a fault whose cause is gone\r\n"
                    "pose X Y THETA   where the robot stands: mm, mm, mrad\r\n");
    } else if (line[0] != '\0') {
        put(prompt, "unknown: try help\r\n");
    }
}

/* ---- Input ------------------------------------------------------------------------------------
 */

static void end_line(prompt_t *prompt, int64_t now_us) {
    put(prompt, "\r\n");
    if (prompt->too_long) {
        put(prompt, "too long\r\n");
    } else {
        while (prompt->length > 0 && prompt->line[prompt->length - 1u] == ' ') {
            prompt->length--;
        }
        prompt->line[prompt->length] = '\0';
        obey(prompt, now_us);
    }
    prompt->length = 0;
    prompt->too_long = false;
    put(prompt, PROMPT);
}

/* One character. True when a line has ended. */
static bool take(prompt_t *prompt, uint8_t byte, int64_t now_us) {
    if (byte == '\r' || byte == '\n') {
        end_line(prompt, now_us);
        return true;
    }
    if (byte == BACKSPACE || byte == DELETE) {
        if (prompt->length > 0) {
            prompt->length--;
            put(prompt, "\b \b");
        }
    } else if (byte >= ' ' && byte < DELETE) {
        if (prompt->length == PROMPT_LINE_MAX) {
            prompt->too_long = true;
            return false;
        }
        const char echo[2] = {(char)byte, '\0'};
        prompt->line[prompt->length++] = (char)byte;
        put(prompt, echo);
    }
    return false;
}

static void read_in(prompt_t *prompt, int64_t now_us) {
    for (uint32_t i = 0; i < PROMPT_BYTES && PROMPT_OUT_MAX - prompt->out_end >= ANSWER_MAX; i++) {
        uint8_t byte;
        size_t count;
        const byte_stream_outcome_t outcome =
            prompt->stream.api->read(prompt->stream.context, &byte, 1, &count);
        if (outcome == BYTE_STREAM_FAILED) {
            prompt->too_long = prompt->length > 0 || prompt->too_long;
        }
        if (outcome != BYTE_STREAM_DONE || take(prompt, byte, now_us)) {
            return;
        }
    }
}

/* What had been typed of a line stands again after it. */
static void put_prompt_again(prompt_t *prompt) {
    put(prompt, PROMPT);
    prompt->line[prompt->length] = '\0';
    put(prompt, prompt->line);
}

void prompt_say(prompt_t *prompt, const char *what, const char *text) {
    put(prompt, "\r");
    put(prompt, what);
    put(prompt, ": ");
    put(prompt, text);
    put(prompt, "\r\n");
    put_prompt_again(prompt);
}

static void tell_changes(prompt_t *prompt) {
    const berth_board_status_t *status = berth_board_status(prompt->board);
    if (status->state == prompt->told_state && status->fault == prompt->told_fault) {
        return;
    }
    prompt->told_state = status->state;
    prompt->told_fault = status->fault;
    put(prompt, "\r");
    put_state(prompt);
    put_prompt_again(prompt);
}

void prompt_init(prompt_t *prompt, berth_board_t *board, const berth_can_t *can,
                 byte_stream_t stream) {
    *prompt = (prompt_t){.board = board, .can = *can, .stream = stream};
    prompt->told_state = berth_board_status(board)->state;
    prompt->told_fault = berth_board_status(board)->fault;
    put(prompt, PROMPT);
}

void prompt_run(prompt_t *prompt, int64_t now_us) {
    tell_changes(prompt);
    read_in(prompt, now_us);
    write_out(prompt);
}
