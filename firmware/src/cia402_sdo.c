#include "cia402.h"

/* How a request's value is made. */
enum {
    VALUE_AS_IS = 0,
    VALUE_PLUS_NODE, /* a COB-ID */
    VALUE_PRODUCER,
    VALUE_CONSUMER,
    VALUE_MODE,
    VALUE_PERIOD,
    VALUE_PERIOD_EXPONENT
};

enum { WHEN_ALWAYS = 0, WHEN_OPTIONAL = 1, WHEN_MODE_9 = 2, WHEN_POSITION = 4 };

enum { SIZE_UPLOAD = 0 }; /* reads, and compares with the value; else the bytes of a download */

typedef struct {
    uint16_t index;
    uint8_t sub;
    uint8_t size : 3; /* bytes of the object */
    uint8_t kind : 5;
    uint8_t when;
    uint32_t value;
} request_t;

#define INVALID_PDO 0x80000000u
#define NO_REMOTE 0x40000000u

/* Number of requests after which the node must be known to be pre-operational: some drives refuse
 * another mapping in other states. */
#define BEFORE_HALT 2u

static const request_t requests[] = {
    {0x6040, 0, 2, VALUE_AS_IS, WHEN_ALWAYS, CIA402_WORD_QUICK_STOP},
    {0x1017, 0, 2, VALUE_PRODUCER, WHEN_ALWAYS, 0},

    /* not all drives change their mode in a quick stop */
    {0x6040, 0, 2, VALUE_AS_IS, WHEN_ALWAYS, CIA402_WORD_DISABLE_VOLTAGE},
    {0x1016, 1, 4, VALUE_CONSUMER, WHEN_ALWAYS, 0},
    {0x6060, 0, 1, VALUE_MODE, WHEN_ALWAYS, 0},
    {0x6007, 0, 2, VALUE_AS_IS, WHEN_OPTIONAL, 3},
    {0x605A, 0, 2, VALUE_AS_IS, WHEN_OPTIONAL, 6},
    {0x60C2, 1, 1, VALUE_PERIOD, WHEN_OPTIONAL | WHEN_MODE_9, 0},
    {0x60C2, 2, 1, VALUE_PERIOD_EXPONENT, WHEN_OPTIONAL | WHEN_MODE_9, 0},

    {0x1400, 1, 4, VALUE_PLUS_NODE, WHEN_ALWAYS, INVALID_PDO | CIA402_ID_RPDO1},
    {0x1400, 2, 1, VALUE_AS_IS, WHEN_ALWAYS, 1},
    {0x1600, 0, 1, VALUE_AS_IS, WHEN_ALWAYS, 0},
    {0x1600, 1, 4, VALUE_AS_IS, WHEN_ALWAYS, 0x60400010},
    {0x1600, 2, 4, VALUE_AS_IS, WHEN_ALWAYS, 0x60FF0020},
    {0x1600, 0, 1, VALUE_AS_IS, WHEN_ALWAYS, 2},
    {0x1400, 1, 4, VALUE_PLUS_NODE, WHEN_ALWAYS, CIA402_ID_RPDO1},

    {0x1800, 1, 4, VALUE_PLUS_NODE, WHEN_ALWAYS, INVALID_PDO | NO_REMOTE | CIA402_ID_TPDO1},
    {0x1800, 2, 1, VALUE_AS_IS, WHEN_ALWAYS, 1},
    {0x1A00, 0, 1, VALUE_AS_IS, WHEN_ALWAYS, 0},
    {0x1A00, 1, 4, VALUE_AS_IS, WHEN_ALWAYS, 0x60410010},
    {0x1A00, 2, 4, VALUE_AS_IS, WHEN_ALWAYS, 0x606C0020},
    {0x1A00, 0, 1, VALUE_AS_IS, WHEN_ALWAYS, 2},
    {0x1800, 1, 4, VALUE_PLUS_NODE, WHEN_ALWAYS, NO_REMOTE | CIA402_ID_TPDO1},

    /* where it is needed and missing, the next request says so */
    {0x1801, 1, 4, VALUE_PLUS_NODE, WHEN_OPTIONAL, INVALID_PDO | NO_REMOTE | CIA402_ID_TPDO2},
    {0x1801, 2, 1, VALUE_AS_IS, WHEN_POSITION, 1},
    {0x1A01, 0, 1, VALUE_AS_IS, WHEN_POSITION, 0},
    {0x1A01, 1, 4, VALUE_AS_IS, WHEN_POSITION, 0x60640020},
    {0x1A01, 0, 1, VALUE_AS_IS, WHEN_POSITION, 1},
    {0x1801, 1, 4, VALUE_PLUS_NODE, WHEN_POSITION, NO_REMOTE | CIA402_ID_TPDO2},

    {0x1802, 1, 4, VALUE_PLUS_NODE, WHEN_OPTIONAL, INVALID_PDO | NO_REMOTE | 0x380u},
    {0x1803, 1, 4, VALUE_PLUS_NODE, WHEN_OPTIONAL, INVALID_PDO | NO_REMOTE | 0x480u},

    /* some drives tell another mode until operation is enabled */
    {0x6061, 0, SIZE_UPLOAD, VALUE_MODE, WHEN_ALWAYS, 0},
};

#define REQUESTS (sizeof requests / sizeof requests[0])
#define CHECK_REQUEST (REQUESTS - 1u)

_Static_assert(REQUESTS <= UINT8_MAX, "the request's number is a byte");

enum {
    COMMAND_DOWNLOAD = 0x23, /* expedited, size told; four bytes less the unused ones << 2 */
    COMMAND_DOWNLOADED = 0x60,
    COMMAND_UPLOAD = 0x40,
    COMMAND_ABORT = 0x80
};

#define ABORT_NO_OBJECT 0x06020000u
#define ABORT_NO_SUB_INDEX 0x06090011u

/* The time between two SYNCs as value * 10^exponent s, in whole milliseconds where it is, since
 * that is what all drives understand; with three digits otherwise, if they fit a byte. */
static uint32_t interpolation_period(const berth_drive_config_t *config, bool exponent) {
    uint32_t value = cia402_sync_period_us(config);
    uint32_t power = 0;
    while (power < 3u && (value > UINT8_MAX || value % 10u == 0u)) {
        value = (value + 5u) / 10u;
        power++;
    }
    return exponent ? (uint32_t)(uint8_t)(power - 6u) : value;
}

static uint32_t request_value(const berth_drive_config_t *config, const request_t *request) {
    const uint32_t timeout_ms = config->heartbeat_timeout_us / 1000u;
    switch (request->kind) {
    case VALUE_PLUS_NODE:
        return request->value + config->node;
    case VALUE_PRODUCER:
        return timeout_ms / 3u;
    case VALUE_CONSUMER:
        return ((uint32_t)config->master_node << 16) | timeout_ms;
    case VALUE_MODE:
        return config->mode;
    case VALUE_PERIOD:
        return interpolation_period(config, false);
    case VALUE_PERIOD_EXPONENT:
        return interpolation_period(config, true);
    default:
        return request->value;
    }
}

static bool wanted(const berth_drive_config_t *config, const request_t *request) {
    return ((request->when & WHEN_MODE_9) == 0 || config->mode == 9u) &&
           ((request->when & WHEN_POSITION) == 0 || config->has_position);
}

static berth_can_frame_t request_frame(const berth_drive_t *drive, const request_t *request,
                                       uint32_t value) {
    berth_can_frame_t frame =
        drive_frame(CIA402_ID_REQUEST + (uint32_t)drive->config.node, false, 8);
    if (request->size == SIZE_UPLOAD) {
        frame.data[0] = COMMAND_UPLOAD;
    } else {
        frame.data[0] = (uint8_t)(COMMAND_DOWNLOAD | (4u - request->size) << 2);
        put_u32_le(&frame.data[4], value);
    }
    put_u16_le(&frame.data[1], request->index);
    frame.data[3] = request->sub;
    return frame;
}

void cia402_put_nmt(const berth_drive_t *drive, uint8_t command, berth_outbox_t *outbox) {
    berth_can_frame_t frame = drive_frame(CIA402_ID_NMT, false, 2);
    frame.data[0] = command;
    frame.data[1] = drive->config.node;
    (void)berth_outbox_put(outbox, &frame, BERTH_OUTBOX_EACH);
}

/* Takes the place of a request that waits to be sent: a controlword ends the set-up. */
void cia402_put_word_by_sdo(const berth_drive_t *drive, uint16_t word, berth_outbox_t *outbox) {
    const berth_can_frame_t frame = request_frame(drive, &requests[0], word);
    (void)berth_outbox_put(outbox, &frame, BERTH_OUTBOX_LATEST);
}

uint32_t cia402_setup_object(const berth_drive_t *drive) {
    const request_t *request = &requests[drive->state.cia402.request];
    return ((uint32_t)request->index << 8) | request->sub;
}

void cia402_setup_start(berth_drive_t *drive, int64_t at_us) {
    drive->state.cia402 = (berth_drive_cia402_state_t){
        .stage = CIA402_SETUP,
        .error_code = drive->state.cia402.error_code,
        .due_us = at_us,
    };
}

void cia402_setup_check(berth_drive_t *drive, int64_t at_us) {
    berth_drive_cia402_state_t *state = &drive->state.cia402;
    state->stage = CIA402_CHECK;
    state->request = CHECK_REQUEST;
    state->tries = 0;
    state->due_us = at_us;
}

static void ask(berth_drive_t *drive, int64_t now_us, berth_outbox_t *outbox) {
    berth_drive_cia402_state_t *state = &drive->state.cia402;
    const request_t *request = &requests[state->request];
    if (state->stage == CIA402_SETUP && (state->tries > 0u || state->request == 0u)) {
        cia402_put_nmt(drive, CIA402_NMT_ENTER_PREOPERATIONAL, outbox);
    }
    const berth_can_frame_t frame =
        request_frame(drive, request, request_value(&drive->config, request));
    (void)berth_outbox_put(outbox, &frame, BERTH_OUTBOX_EACH);
    state->tries++;
    state->waiting = true;
    state->due_us = now_us + BERTH_CIA402_ANSWER_US;
}

void cia402_setup_step(berth_drive_t *drive, int64_t now_us, berth_outbox_t *outbox) {
    berth_drive_cia402_state_t *state = &drive->state.cia402;
    if (now_us < state->due_us) {
        return;
    }
    switch (state->stage) {
    case CIA402_SETUP:
    case CIA402_CHECK:
        if (state->tries >= BERTH_CIA402_TRIES) {
            drive_fail(drive, BERTH_DRIVE_FAULT_SETUP_SILENT, cia402_setup_object(drive));
        } else {
            ask(drive, now_us, outbox);
        }
        break;
    case CIA402_HALT:
        cia402_put_nmt(drive, CIA402_NMT_ENTER_PREOPERATIONAL, outbox);
        state->due_us = now_us + BERTH_CIA402_NMT_REPEAT_US;
        break;
    case CIA402_NODE:
        cia402_put_nmt(drive, CIA402_NMT_START, outbox);
        state->due_us = now_us + BERTH_CIA402_NMT_REPEAT_US;
        break;
    default:
        break;
    }
}

/* On to the next request that this configuration has, or to what comes after the last. */
static void next_request(berth_drive_t *drive, int64_t at_us) {
    berth_drive_cia402_state_t *state = &drive->state.cia402;
    uint32_t number = state->request + 1u;
    while (number < CHECK_REQUEST && !wanted(&drive->config, &requests[number])) {
        number++;
    }
    state->waiting = false;
    state->tries = 0;
    state->due_us = at_us;
    if (number >= CHECK_REQUEST) {
        state->stage = CIA402_NODE;
        return;
    }
    state->request = (uint8_t)number;
    if (number == BEFORE_HALT && state->nmt_state != CIA402_NMT_PREOPERATIONAL) {
        state->stage = CIA402_HALT;
        state->due_us = at_us + BERTH_CIA402_NMT_REPEAT_US;
    }
}

static bool expedited(uint8_t command) {
    return (command & 0xF2u) == 0x42u; /* with or without the size told */
}

/* The drive may take a moment to change its mode, so another answer is waited for as long as for
 * any; the last one counts. */
static void compare_mode(berth_drive_t *drive, uint8_t told) {
    berth_drive_cia402_state_t *state = &drive->state.cia402;
    if (told == drive->config.mode) {
        state->waiting = false;
        state->mode_told = true;
        state->stage = CIA402_RUN;
    } else if (state->tries >= BERTH_CIA402_TRIES) {
        drive_fail(drive, BERTH_DRIVE_FAULT_SETUP, BERTH_CIA402_CODE_MODE + told);
    } else {
        /* it may still change */
    }
}

static void refused(berth_drive_t *drive, const request_t *request, uint32_t code, int64_t at_us) {
    const bool missing = code == ABORT_NO_OBJECT || code == ABORT_NO_SUB_INDEX;
    if (missing && (request->when & WHEN_OPTIONAL) != 0u) {
        next_request(drive, at_us);
    } else {
        drive_fail(drive, BERTH_DRIVE_FAULT_SETUP, code);
    }
}

drive_frame_t cia402_answer(berth_drive_t *drive, const berth_can_frame_t *frame, int64_t at_us) {
    const berth_drive_cia402_state_t *state = &drive->state.cia402;
    const uint8_t command = frame->data[0];
    if (!drive_frame_has(frame, 8) ||
        (command != COMMAND_DOWNLOADED && command != COMMAND_ABORT && !expedited(command))) {
        return DRIVE_FRAME_MALFORMED;
    }
    const request_t *request = &requests[state->request];
    if (drive->status.state != BERTH_DRIVE_STARTING || !state->waiting ||
        get_u16_le(&frame->data[1]) != request->index || frame->data[3] != request->sub) {
        return DRIVE_FRAME_GOOD;
    }
    if (command == COMMAND_ABORT) {
        refused(drive, request, get_u32_le(&frame->data[4]), at_us);
        return DRIVE_FRAME_GOOD;
    }
    if (expedited(command) != (request->size == SIZE_UPLOAD)) {
        return DRIVE_FRAME_MALFORMED;
    }
    if (request->size == SIZE_UPLOAD) {
        compare_mode(drive, frame->data[4]);
    } else {
        next_request(drive, at_us);
    }
    return DRIVE_FRAME_GOOD;
}
