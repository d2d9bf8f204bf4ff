#include "slcan.h"

/* MISRA D14, T2 in this file. */

#define RETURN '\r'
#define BELL '\a'

/* The host's status question answers F and two digits, with these bits. */
#define FLAG_RECEIVE_FULL 0x01u
#define FLAG_OVERRUN 0x08u
#define FLAG_PASSIVE 0x20u
#define FLAG_BUS_ERROR 0x80u

#define SETUP_ANSWERS 3u /* to C, S8 and O */

#define STAMP_WRAP_MS 60000

_Static_assert(SLCAN_TRANSMIT_BYTES >= 2u * SLCAN_LINE_MAX, "room for a frame beside an answer");
_Static_assert(SLCAN_TRANSMIT_BYTES <= UINT16_MAX, "positions have 16 bits");
_Static_assert(SLCAN_CHUNK_BYTES <= UINT8_MAX, "positions have 8 bits");

static void count(uint32_t *counter, uint32_t more) {
    *counter = more > UINT32_MAX - *counter ? UINT32_MAX : *counter + more;
}

static bool host(const slcan_t *line) {
    return line->config.role == SLCAN_HOST;
}

static int64_t now(const slcan_t *line) {
    return line->config.clock.api->now_us(line->config.clock.context);
}

/* ---- Bytes that wait to be written -------------------------------------------------------------
 */

/* Where the line begins that is being written: its start may be written already. */
static uint16_t line_start(const slcan_t *line) {
    uint16_t at = line->transmit_at;
    while (at > 0u && line->transmit[at - 1u] != RETURN && line->transmit[at - 1u] != BELL) {
        at--;
    }
    return at;
}

static bool is_frame_letter(uint8_t c) {
    return c == 't' || c == 'T' || c == 'r' || c == 'R';
}

static void drop_unwritten(slcan_t *line) {
    bool at_start = true;
    for (uint16_t at = line_start(line); at < line->transmit_end; at++) {
        const uint8_t c = line->transmit[at];
        if (at_start && is_frame_letter(c)) {
            count(&line->state.tx_dropped, 1u);
        }
        at_start = c == RETURN || c == BELL;
    }
    line->transmit_at = 0;
    line->transmit_end = 0;
}

static void compact(slcan_t *line) {
    const uint16_t from = line_start(line);
    for (uint16_t at = from; at < line->transmit_end; at++) {
        line->transmit[at - from] = line->transmit[at];
    }
    line->transmit_at = (uint16_t)(line->transmit_at - from);
    line->transmit_end = (uint16_t)(line->transmit_end - from);
}

/* All of it or nothing. */
static bool put(slcan_t *line, const char *text, size_t length) {
    if (length > SLCAN_TRANSMIT_BYTES - (size_t)line->transmit_end) {
        compact(line);
    }
    if (length > SLCAN_TRANSMIT_BYTES - (size_t)line->transmit_end) {
        return false;
    }
    for (size_t i = 0; i < length; i++) {
        line->transmit[line->transmit_end] = (uint8_t)text[i];
        line->transmit_end++;
    }
    return true;
}

/* ---- The line lost, and found ------------------------------------------------------------------
 */

static void lose(slcan_t *line) {
    drop_unwritten(line);
    line->lost = true;
    line->open = false;
    line->line_length = 0;
    line->skipping = false;
    line->chunk_at = 0;
    line->chunk_end = 0;
    line->unsettled = 0;
}

static void opened(slcan_t *line) {
    if (line->opened_before) {
        count(&line->state.restarts, 1u);
    }
    line->opened_before = true;
    line->open = true;
    line->state.mode = BERTH_CAN_ERROR_ACTIVE;
}

/* The first return ends whatever the adapter had half read. Nothing waits, so there is room. */
static void set_up(slcan_t *line) {
    static const char commands[] = "\rC\rS8\rO\r";
    (void)put(line, commands, sizeof commands - 1u);
    count(&line->counts.setups, 1u);
    line->answered = true;
    line->bell = false;
    line->unsettled = 0;
    line->setup_answers = SETUP_ANSWERS;
    line->poll_us = now(line) + SLCAN_POLL_US;
    opened(line);
}

static void found(slcan_t *line) {
    line->lost = false;
    if (host(line)) {
        set_up(line);
    }
}

/* Asks for the status flags. Only an adapter that is not open refuses them: it has been reset. */
static void poll(slcan_t *line) {
    const int64_t now_us = now(line);
    if (line->lost || !host(line) || now_us < line->poll_us) {
        return;
    }
    if (line->bell && !line->answered) {
        drop_unwritten(line);
        set_up(line);
        return;
    }
    line->poll_us = now_us + SLCAN_POLL_US;
    if (put(line, "F\r", 2u)) {
        line->answered = false;
        line->bell = false;
    }
}

/* Writes what waits. False: nobody there. */
static bool flush(slcan_t *line) {
    const byte_stream_t *stream = &line->config.stream;
    while (line->transmit_at < line->transmit_end) {
        size_t written = 0;
        const size_t rest = (size_t)line->transmit_end - line->transmit_at;
        const byte_stream_outcome_t outcome =
            stream->api->write(stream->context, &line->transmit[line->transmit_at], rest, &written);
        if (outcome == BYTE_STREAM_FAILED) {
            lose(line);
            return false;
        }
        if (outcome == BYTE_STREAM_AGAIN || written == 0u || written > rest) {
            return true;
        }
        line->transmit_at = (uint16_t)(line->transmit_at + written);
    }
    line->transmit_at = 0;
    line->transmit_end = 0;
    return true;
}

/* ---- Answers to the peer's commands ------------------------------------------------------------
 */

static void answer(slcan_t *line, const char *text, size_t length) {
    if (!put(line, text, length)) {
        count(&line->counts.unsaid, 1u);
    }
}

static void answer_if(slcan_t *line, bool good) {
    if (good) {
        answer(line, "\r", 1u);
    } else if (!host(line)) {
        /* An adapter must not get a BELL from its host: it would spoil the next command. */
        answer(line, "\a", 1u);
    } else {
        /* a host says nothing */
    }
}

/* For a host, the channel is always open and always closed: its peer is a host as well. */
static bool may_configure(const slcan_t *line) {
    return host(line) || !line->open;
}

static bool in_range(char c, char low, char high) {
    return c >= low && c <= high;
}

static void answer_open(slcan_t *line, bool listen_only) {
    answer_if(line, may_configure(line));
    if (may_configure(line) && !host(line)) {
        line->listen_only = listen_only;
        opened(line);
    }
}

static void answer_close(slcan_t *line) {
    answer_if(line, line->open);
    line->open = line->open && host(line);
}

/* Commands of one letter. False: not one of them. */
static bool answer_letter(slcan_t *line, char letter) {
    switch (letter) {
    case 'O':
    case 'L':
        answer_open(line, letter == 'L');
        return true;
    case 'C':
        answer_close(line);
        return true;
    case 'V':
        answer(line, "V1013\r", 6u);
        return true;
    case 'N':
        answer(line, "NB001\r", 6u);
        return true;
    case 'F':
        if (line->open) {
            answer(line, "F00\r", 4u);
        } else {
            answer_if(line, false);
        }
        return true;
    default:
        return false;
    }
}

/* Set-up by letter and value. */
static void answer_setting(slcan_t *line, const char *text, size_t length) {
    const char value = text[1];
    bool good = false;
    if (text[0] == 'S' && length == 2u) {
        good = in_range(value, '0', '8') && may_configure(line);
    } else if (text[0] == 's') {
        good = (length == 5u || length == 7u) && may_configure(line);
    } else if (text[0] == 'Z' && length == 2u) {
        good = in_range(value, '0', '1') && may_configure(line);
        const bool on = value == '1';
        line->stamps = good && !host(line) ? on : line->stamps;
    } else if (text[0] == 'X' && length == 2u) {
        good = value == '1';
    } else {
        /* not a setting */
    }
    answer_if(line, good);
}

static void take_command(slcan_t *line, const char *text, size_t length) {
    count(&line->counts.commands, 1u);
    if (length == 1u) {
        if (!answer_letter(line, text[0])) {
            answer_if(line, false);
        }
        return;
    }
    answer_setting(line, text, length);
}

/* ---- Lines received ----------------------------------------------------------------------------
 */

static uint32_t hex_of(char c) {
    if (in_range(c, '0', '9')) {
        return (uint32_t)(c - '0');
    }
    return (uint32_t)((c | 0x20) - 'a') + 10u;
}

static bool is_hex(char c) {
    return in_range(c, '0', '9') || in_range(c, 'a', 'f') || in_range(c, 'A', 'F');
}

static void take_flags(slcan_t *line, const char *digits) {
    const uint32_t flags = (hex_of(digits[0]) << 4u) | hex_of(digits[1]);
    line->answered = true;
    if ((flags & (FLAG_RECEIVE_FULL | FLAG_OVERRUN)) != 0u) {
        count(&line->state.rx_lost, 1u);
    }
    if ((flags & FLAG_BUS_ERROR) != 0u) {
        count(&line->state.error_frames, 1u);
    }
    line->state.mode =
        (flags & FLAG_PASSIVE) != 0u ? BERTH_CAN_ERROR_PASSIVE : BERTH_CAN_ERROR_ACTIVE;
}

/* The peer's answer to something: a return alone, z or Z for a frame. */
static void settle(slcan_t *line) {
    if (line->setup_answers > 0u) {
        line->setup_answers--;
    } else if (line->unsettled > 0u) {
        line->unsettled--;
    } else {
        /* an answer to nothing */
    }
}

static void take_bell(slcan_t *line) {
    count(&line->counts.refused, 1u);
    /* A closed adapter refuses to be closed; that says nothing. */
    line->bell = line->bell || line->setup_answers == 0u;
    if (line->setup_answers == 0u && line->unsettled > 0u) {
        count(&line->state.tx_dropped, 1u);
    }
    settle(line);
}

static void malformed(slcan_t *line) {
    count(&line->counts.malformed, 1u);
    count(&line->state.error_frames, 1u);
}

static bool wanted(slcan_t *line, const berth_can_frame_t *frame) {
    bool good = line->config.filter_count == 0u;
    for (uint32_t i = 0; i < line->config.filter_count && !good; i++) {
        const berth_can_filter_t *filter = &line->config.filters[i];
        good = filter->extended == frame->extended &&
               (frame->id & filter->mask) == (filter->id & filter->mask);
    }
    if (!good) {
        count(&line->counts.filtered, 1u);
    }
    return good;
}

/* True: the line is a frame to hand out. */
static bool take_frame(slcan_t *line, const char *text, size_t length, berth_can_frame_t *frame) {
    berth_can_frame_t got;
    const bool good = slcan_decode(text, length, &got);
    if (!good) {
        malformed(line);
    }
    if (!host(line)) {
        const bool taken = good && line->open && !line->listen_only;
        if (taken) {
            answer(line, got.extended ? "Z\r" : "z\r", 2u);
        } else {
            answer_if(line, false);
        }
        if (!taken) {
            return false;
        }
    }
    if (!good || !wanted(line, &got)) {
        return false;
    }
    got.time_us = now(line);
    *frame = got;
    count(&line->counts.received, 1u);
    return true;
}

/* Answers to what a host says: status flags, and the acknowledgement of a frame. */
static bool is_answer(slcan_t *line, const char *text, size_t length) {
    if (length == 1u && (text[0] == 'z' || text[0] == 'Z')) {
        settle(line);
        return true;
    }
    if (length == 3u && text[0] == 'F' && is_hex(text[1]) && is_hex(text[2])) {
        if (host(line)) {
            take_flags(line, &text[1]);
        }
        return true;
    }
    return false;
}

static bool is_command_letter(char c) {
    return in_range(c, 'A', 'Z') || in_range(c, 'a', 'z');
}

/* A line without its return. */
static bool take_line(slcan_t *line, berth_can_frame_t *frame) {
    const char *text = line->line;
    const size_t length = line->line_length;
    line->line_length = 0;
    if (line->skipping) {
        line->skipping = false;
        malformed(line);
        return false;
    }
    if (length == 0u) {
        settle(line);
        return false;
    }
    if (is_frame_letter((uint8_t)text[0])) {
        return take_frame(line, text, length, frame);
    }
    if (is_answer(line, text, length)) {
        return false;
    }
    /* V1013 and NB001 are longer than the questions: answers that were not asked for. */
    if ((text[0] == 'V' || text[0] == 'N') && length > 1u) {
        return false;
    }
    if (is_command_letter(text[0])) {
        take_command(line, text, length);
    } else {
        malformed(line);
    }
    return false;
}

static bool take_byte(slcan_t *line, uint8_t byte, berth_can_frame_t *frame) {
    if (byte == RETURN) {
        return take_line(line, frame);
    }
    if (byte == BELL) {
        if (line->line_length > 0u) {
            malformed(line);
            line->line_length = 0;
            line->skipping = false;
        }
        take_bell(line);
        return false;
    }
    if (byte == '\n' && line->line_length == 0u) {
        return false;
    }
    if (line->line_length < SLCAN_LINE_MAX - 1u) {
        line->line[line->line_length] = (char)byte;
        line->line_length++;
    } else {
        line->skipping = true;
    }
    return false;
}

/* True: *frame is filled. */
static bool take_chunk(slcan_t *line, berth_can_frame_t *frame) {
    while (line->chunk_at < line->chunk_end) {
        if (take_byte(line, line->chunk[line->chunk_at++], frame)) {
            return true;
        }
    }
    return false;
}

static byte_stream_outcome_t read_chunk(slcan_t *line) {
    const byte_stream_t *stream = &line->config.stream;
    size_t got = 0;
    const byte_stream_outcome_t outcome =
        stream->api->read(stream->context, line->chunk, SLCAN_CHUNK_BYTES, &got);
    if (outcome == BYTE_STREAM_FAILED) {
        lose(line);
        return outcome;
    }
    if (line->lost) {
        found(line);
    }
    if (outcome != BYTE_STREAM_DONE || got == 0u || got > SLCAN_CHUNK_BYTES) {
        return BYTE_STREAM_AGAIN;
    }
    line->chunk_at = 0;
    line->chunk_end = (uint8_t)got;
    return BYTE_STREAM_DONE;
}

/* ---- The bus -----------------------------------------------------------------------------------
 */

static bool usable(const slcan_t *line) {
    return !line->lost && line->open;
}

static size_t stamp_line(const slcan_t *line, char text[SLCAN_LINE_MAX], size_t length) {
    const int64_t into_ms = (now(line) / 1000) % STAMP_WRAP_MS;
    const uint32_t ms = (uint32_t)into_ms;
    size_t at = length - 1u;
    for (uint32_t shift = 16u; shift > 0u; shift -= 4u) {
        text[at] = "0123456789ABCDEF"[(ms >> (shift - 4u)) & 0xfu];
        at++;
    }
    text[at] = RETURN;
    return at + 1u;
}

static bool valid(const berth_can_frame_t *frame) {
    const uint32_t max = frame->extended ? BERTH_CAN_EXTENDED_MAX : BERTH_CAN_STANDARD_MAX;
    return frame->id <= max && frame->length <= BERTH_CAN_DATA_MAX;
}

static berth_can_outcome_t bus_send(void *context, const berth_can_frame_t *frame) {
    slcan_t *line = context;
    if (!valid(frame) || !usable(line) || !flush(line)) {
        return BERTH_CAN_FAILED;
    }
    char text[SLCAN_LINE_MAX];
    size_t length = slcan_encode(frame, text);
    if (line->stamps) {
        length = stamp_line(line, text, length);
    }
    if (!put(line, text, length)) {
        return BERTH_CAN_AGAIN;
    }
    count(&line->counts.sent, 1u);
    if (host(line) && line->unsettled < UINT8_MAX) {
        line->unsettled++;
    }
    /* If the line is lost now, the frame is counted as dropped there. */
    (void)flush(line);
    return BERTH_CAN_DONE;
}

static berth_can_outcome_t bus_receive(void *context, berth_can_frame_t *frame) {
    slcan_t *line = context;
    bool got = take_chunk(line, frame);
    byte_stream_outcome_t outcome = BYTE_STREAM_DONE;
    for (uint32_t parsed = 0; !got && outcome == BYTE_STREAM_DONE && parsed < SLCAN_RECEIVE_BYTES;
         parsed += line->chunk_end) {
        outcome = read_chunk(line);
        got = take_chunk(line, frame);
    }
    poll(line);
    if (!line->lost) {
        (void)flush(line);
    }
    if (got) {
        return BERTH_CAN_DONE;
    }
    return usable(line) ? BERTH_CAN_AGAIN : BERTH_CAN_FAILED;
}

static void bus_state(void *context, berth_can_state_t *state) {
    const slcan_t *line = context;
    *state = line->state;
    if (!usable(line)) {
        state->mode = BERTH_CAN_DOWN;
    }
}

void slcan_init(slcan_t *line, const slcan_config_t *config) {
    *line = (slcan_t){.config = *config, .lost = true};
}

berth_can_t slcan_can(slcan_t *line) {
    static const berth_can_api_t api = {bus_send, bus_receive, bus_state};
    return (berth_can_t){&api, line};
}

slcan_counts_t slcan_counts(const slcan_t *line) {
    return line->counts;
}
