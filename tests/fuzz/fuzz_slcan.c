/* SLCAN: any bytes into both roles, in any pieces; frames out and in again. What must hold: it does
 * not matter where the bytes are split; counters stay with what was handed out; each frame survives
 * the codec; what decodes encodes to the same line.
 */
#include "fuzz.h"
#include "input.h"
#include "lockstep.h"
#include "slcan.h"

#include <ctype.h>

#define FRAMES_MAX 4096

/* The other end of the line: gives bytes in pieces, takes as many as it likes. */
typedef struct {
    const uint8_t *data;
    size_t left;
    uint32_t pieces; /* random numbers for their sizes; 0: as large as they come */
    uint32_t answers;
    size_t written;
    int64_t now_us;
} peer_t;

static uint32_t draw(uint32_t *state) {
    *state = (uint32_t)((uint64_t)*state * 1664525u + 1013904223u);
    return *state >> 16;
}

static byte_stream_outcome_t peer_read(void *context, uint8_t *bytes, size_t room, size_t *count) {
    peer_t *peer = context;
    size_t size = peer->pieces != 0 ? 1 + draw(&peer->pieces) % 7u : room;
    size = size < room ? size : room;
    size = size < peer->left ? size : peer->left;
    *count = size;
    if (size == 0) {
        return BYTE_STREAM_AGAIN;
    }
    memcpy(bytes, peer->data, size);
    peer->data += size;
    peer->left -= size;
    return BYTE_STREAM_DONE;
}

static byte_stream_outcome_t peer_write(void *context, const uint8_t *bytes, size_t length,
                                        size_t *count) {
    peer_t *peer = context;
    for (size_t i = 0; i < length; i++) {
        FUZZ_CHECK(bytes[i] == '\r' || bytes[i] == '\a' || isalnum(bytes[i]),
                   "what is written is of the protocol");
    }
    peer->written += length;
    *count = length;
    return BYTE_STREAM_DONE;
}

static int64_t peer_now(void *context) {
    return ((peer_t *)context)->now_us;
}

typedef struct {
    uint32_t digest;
    slcan_counts_t counts;
    berth_can_state_t state;
    size_t written;
} outcome_t;

static const byte_stream_api_t stream_api = {peer_read, peer_write};
static const berth_clock_api_t clock_api = {peer_now, NULL};
static const berth_can_filter_t filters[] = {{0x100, 0x700, false}, {0x04b20000, 0x1fff0000, true}};

/* All bytes through one line. */
static outcome_t receive_all(slcan_role_t role, const uint8_t *data, size_t size, uint32_t pieces,
                             uint32_t filter_count) {
    static slcan_t line;
    peer_t peer = {.data = data, .left = size, .pieces = pieces, .now_us = 1000};
    const slcan_config_t config = {
        role, {&stream_api, &peer}, {&clock_api, &peer}, filters, filter_count};
    outcome_t outcome = {.digest = DIGEST_START};
    slcan_init(&line, &config);
    const berth_can_t can = slcan_can(&line);
    uint32_t frames = 0;
    for (size_t idle = 0; idle < 2; idle = peer.left > 0 ? 0 : idle + 1) {
        berth_can_frame_t frame;
        while (can.api->receive(can.context, &frame) == BERTH_CAN_DONE) {
            FUZZ_CHECK(frame.length <= BERTH_CAN_DATA_MAX &&
                           frame.id <=
                               (frame.extended ? BERTH_CAN_EXTENDED_MAX : BERTH_CAN_STANDARD_MAX),
                       "a received frame is one that a bus can carry");
            digest_bytes(&outcome.digest, &frame.id, sizeof frame.id);
            digest_bytes(&outcome.digest, frame.data, frame.length);
            frames++;
        }
    }
    outcome.counts = slcan_counts(&line);
    outcome.written = peer.written;
    can.api->state(can.context, &outcome.state);
    FUZZ_CHECK(outcome.counts.received == frames, "received frames are counted");
    return outcome;
}

static void check_splits(const uint8_t *data, size_t size, uint8_t how) {
    const slcan_role_t role = (how & 1u) != 0 ? SLCAN_HOST : SLCAN_ADAPTER;
    const uint32_t filter_count = (how & 2u) != 0 ? 2 : 0;
    const outcome_t whole = receive_all(role, data, size, 0, filter_count);
    const outcome_t split = receive_all(role, data, size, 1u + how, filter_count);
    FUZZ_CHECK(whole.digest == split.digest, "the same frames, however the bytes come");
    FUZZ_CHECK(whole.counts.malformed == split.counts.malformed &&
                   whole.counts.filtered == split.counts.filtered &&
                   whole.counts.commands == split.counts.commands &&
                   whole.counts.refused == split.counts.refused,
               "the same counts, however the bytes come");
    FUZZ_CHECK(whole.state.mode == split.state.mode, "the same state, however the bytes come");
}

/* What decodes encodes to the same line, in upper case and without a time stamp. */
static void check_line(const uint8_t *data, size_t size) {
    berth_can_frame_t frame = {0};
    char line[SLCAN_LINE_MAX];
    if (!slcan_decode((const char *)data, size, &frame)) {
        return;
    }
    const size_t length = slcan_encode(&frame, line) - 1;
    FUZZ_CHECK(length == size || length + 4 == size, "a line has its length");
    FUZZ_CHECK(line[0] == (char)data[0], "a line has its letter");
    for (size_t i = 1; i < length; i++) {
        FUZZ_CHECK(line[i] == toupper(data[i]), "what decodes encodes to the same line");
    }
}

static bool same(const berth_can_frame_t *a, const berth_can_frame_t *b) {
    return a->id == b->id && a->extended == b->extended && a->remote == b->remote &&
           a->length == b->length && (a->remote || memcmp(a->data, b->data, a->length) == 0);
}

static void check_frame(input_t *in) {
    const berth_can_frame_t frame = in_frame(in);
    berth_can_frame_t again;
    char line[SLCAN_LINE_MAX];
    const size_t length = slcan_encode(&frame, line);
    FUZZ_CHECK(length <= SLCAN_LINE_MAX && line[length - 1] == '\r', "a line ends");
    FUZZ_CHECK(slcan_decode(line, length - 1, &again) && same(&frame, &again),
               "a frame survives the codec");
    lockstep_line_t taken = {.length = 0};
    lockstep_take_t take = LOCKSTEP_MORE;
    for (size_t i = 0; i < length; i++) {
        FUZZ_CHECK(take == LOCKSTEP_MORE, "a line is one line");
        take = lockstep_take(&taken, (uint8_t)line[i], &again);
    }
    FUZZ_CHECK(take == LOCKSTEP_FRAME && same(&frame, &again), "a frame survives the lines");
}

static void check_lockstep(const uint8_t *data, size_t size) {
    lockstep_line_t line = {.length = 0};
    for (size_t i = 0; i < size; i++) {
        berth_can_frame_t frame = {0};
        lockstep_kind_t kind;
        uint64_t value;
        if (lockstep_take(&line, data[i], &frame) == LOCKSTEP_FRAME &&
            lockstep_decode(&frame, &kind, &value)) {
            berth_can_frame_t again;
            uint64_t read;
            lockstep_kind_t read_kind;
            lockstep_encode(&again, kind, value);
            FUZZ_CHECK(lockstep_decode(&again, &read_kind, &read) && read == value &&
                           read_kind == kind,
                       "a number survives");
        }
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    if (size < 2) {
        return 0;
    }
    input_t in = {data + 1, size - 1};
    switch (data[0] % 4u) {
    case 0:
        check_line(data + 1, size - 1);
        break;
    case 1:
        while (in.left > 0) {
            check_frame(&in);
        }
        break;
    case 2:
        check_lockstep(data + 1, size - 1);
        break;
    default:
        check_splits(data + 1, size - 1, data[0] / 4u);
        break;
    }
    return 0;
}
