/* slcan: the codec, and both roles over lines that split, stall, break and babble. */
#include "slcan.h"
#include "support.h"

#include "unity.h"

#include <stdio.h>
#include <string.h>

#define PIPE_BYTES 8192u

/* One direction of a line: what was written and not yet read. */
typedef struct {
    uint8_t bytes[PIPE_BYTES];
    size_t at, end;
} pipe_t;

/* One end: reads from in, writes to out, at most `piece` bytes at once. */
typedef struct {
    pipe_t *in, *out;
    size_t piece;
    size_t room; /* bytes that may still be written */
    bool broken;
    bool mute; /* what is written finds nobody */
} end_t;

static pipe_t to_us, to_peer;
static end_t ours, theirs;
static int64_t time_us;
static slcan_t line;
static berth_can_t can;

static byte_stream_outcome_t end_read(void *context, uint8_t *bytes, size_t room, size_t *count) {
    end_t *end = context;
    const size_t there = end->in->end - end->in->at;
    *count = 0;
    if (end->broken) {
        return BYTE_STREAM_FAILED;
    }
    if (there == 0u) {
        return BYTE_STREAM_AGAIN;
    }
    size_t n = there < room ? there : room;
    n = n < end->piece ? n : end->piece;
    memcpy(bytes, &end->in->bytes[end->in->at], n);
    end->in->at += n;
    *count = n;
    return BYTE_STREAM_DONE;
}

static byte_stream_outcome_t end_write(void *context, const uint8_t *bytes, size_t length,
                                       size_t *count) {
    end_t *end = context;
    *count = 0;
    if (end->broken || end->mute) {
        return BYTE_STREAM_FAILED;
    }
    size_t n = length < end->piece ? length : end->piece;
    n = n < end->room ? n : end->room;
    if (n == 0u) {
        return BYTE_STREAM_AGAIN;
    }
    if (end->out->at == end->out->end) {
        end->out->at = 0;
        end->out->end = 0;
    }
    TEST_ASSERT_TRUE(end->out->end + n <= PIPE_BYTES);
    memcpy(&end->out->bytes[end->out->end], bytes, n);
    end->out->end += n;
    end->room -= n;
    *count = n;
    return BYTE_STREAM_DONE;
}

static const byte_stream_api_t end_api = {end_read, end_write};

static int64_t now_us(void *context) {
    (void)context;
    return time_us;
}

static const berth_clock_api_t clock_api = {now_us, NULL};

static slcan_config_t config_of(slcan_role_t role, end_t *end) {
    return (slcan_config_t){.role = role, .stream = {&end_api, end}, .clock = {&clock_api, NULL}};
}

static void begin(slcan_role_t role) {
    const slcan_config_t config = config_of(role, &ours);
    slcan_init(&line, &config);
    can = slcan_can(&line);
}

void setUp(void) {
    memset(&to_us, 0, sizeof to_us);
    memset(&to_peer, 0, sizeof to_peer);
    ours = (end_t){&to_us, &to_peer, SIZE_MAX, SIZE_MAX, false, false};
    theirs = (end_t){&to_peer, &to_us, SIZE_MAX, SIZE_MAX, false, false};
    time_us = 1000;
}

void tearDown(void) {}

static void peer_says(const char *text) {
    size_t done = 0;
    (void)end_write(&theirs, (const uint8_t *)text, strlen(text), &done);
    TEST_ASSERT_EQUAL_UINT(strlen(text), done);
}

/* Everything that we wrote and the peer has not looked at yet. */
static const char *peer_hears(void) {
    static char text[PIPE_BYTES + 1u];
    const size_t length = to_peer.end - to_peer.at;
    memcpy(text, &to_peer.bytes[to_peer.at], length);
    text[length] = '\0';
    to_peer.at = to_peer.end;
    return text;
}

static berth_can_outcome_t receive(berth_can_frame_t *frame) {
    return can.api->receive(can.context, frame);
}

static berth_can_outcome_t send(const berth_can_frame_t *frame) {
    return can.api->send(can.context, frame);
}

static berth_can_state_t state(void) {
    berth_can_state_t out;
    memset(&out, 0x5a, sizeof out);
    can.api->state(can.context, &out);
    return out;
}

static void expect_none(void) {
    berth_can_frame_t frame;
    berth_can_frame_t before;
    memset(&frame, 0x5a, sizeof frame);
    before = frame;
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, receive(&frame));
    TEST_ASSERT_EQUAL_MEMORY(&before, &frame, sizeof frame);
}

static berth_can_frame_t random_frame(void) {
    berth_can_frame_t frame = {.extended = support_index(2) == 1u,
                               .remote = support_index(4) == 0u};
    const uint32_t max = frame.extended ? BERTH_CAN_EXTENDED_MAX : BERTH_CAN_STANDARD_MAX;
    frame.id = support_index(8) == 0u ? max : support_index(max + 1u);
    frame.length = (uint8_t)support_index(BERTH_CAN_DATA_MAX + 1u);
    for (uint32_t i = 0; i < frame.length && !frame.remote; i++) {
        frame.data[i] = (uint8_t)support_index(256);
    }
    return frame;
}

static void expect_same(const berth_can_frame_t *want, const berth_can_frame_t *got) {
    TEST_ASSERT_EQUAL_HEX32(want->id, got->id);
    TEST_ASSERT_EQUAL_INT(want->extended, got->extended);
    TEST_ASSERT_EQUAL_INT(want->remote, got->remote);
    TEST_ASSERT_EQUAL_UINT8(want->length, got->length);
    TEST_ASSERT_EQUAL_HEX8_ARRAY(want->data, got->data, BERTH_CAN_DATA_MAX);
}

/* ---- Codec -------------------------------------------------------------------------------------
 */

static void expect_line(const char *text, berth_can_frame_t frame) {
    char out[SLCAN_LINE_MAX + 1u];
    const size_t length = slcan_encode(&frame, out);
    out[length] = '\0';
    TEST_ASSERT_EQUAL_STRING(text, out);
}

static void test_frames_are_written_as_the_protocol_says(void) {
    expect_line("t1002AB0F\r", (berth_can_frame_t){.id = 0x100, .length = 2, .data = {0xab, 0x0f}});
    expect_line("t7FF0\r", (berth_can_frame_t){.id = 0x7ff});
    expect_line("T1FFFFFFF81122334455667788\r",
                (berth_can_frame_t){.id = 0x1fffffff,
                                    .extended = true,
                                    .length = 8,
                                    .data = {0x11, 0x22, 0x33, 0x44, 0x55, 0x66, 0x77, 0x88}});
    expect_line("r0018\r", (berth_can_frame_t){.id = 1, .remote = true, .length = 8});
    expect_line("R000000A13\r",
                (berth_can_frame_t){.id = 0xa1, .remote = true, .extended = true, .length = 3});
}

/* A frame that breaks the contract is nonsense, but within the line. */
static void test_a_length_beyond_its_range_overruns_nothing(void) {
    for (uint32_t length = 9; length < 256; length++) {
        const berth_can_frame_t frame = {
            .id = 0x1fffffff, .extended = true, .length = (uint8_t)length};
        char text[SLCAN_LINE_MAX + 1u];
        memset(text, '?', sizeof text);
        TEST_ASSERT_EQUAL_UINT(SLCAN_LINE_MAX - 4u, slcan_encode(&frame, text)); /* no stamp */
        TEST_ASSERT_EQUAL_CHAR('?', text[SLCAN_LINE_MAX]);
    }
}

static void test_every_frame_comes_back(void) {
    support_random_start();
    for (uint32_t i = 0; i < support_runs(200000); i++) {
        const berth_can_frame_t frame = random_frame();
        char text[SLCAN_LINE_MAX];
        const size_t length = slcan_encode(&frame, text);
        TEST_ASSERT_TRUE(length <= SLCAN_LINE_MAX);
        berth_can_frame_t back;
        memset(&back, 0x5a, sizeof back);
        TEST_ASSERT_TRUE(slcan_decode(text, length - 1u, &back));
        expect_same(&frame, &back);
        TEST_ASSERT_EQUAL_INT64(0, back.time_us);
    }
}

static void expect_refused(const char *text) {
    berth_can_frame_t frame;
    berth_can_frame_t before;
    memset(&frame, 0x5a, sizeof frame);
    before = frame;
    TEST_ASSERT_FALSE_MESSAGE(slcan_decode(text, strlen(text), &frame), text);
    TEST_ASSERT_EQUAL_MEMORY(&before, &frame, sizeof frame);
}

static void test_only_exact_frames_are_read(void) {
    berth_can_frame_t frame;
    TEST_ASSERT_TRUE(slcan_decode("t12320aFf", 9, &frame));
    TEST_ASSERT_EQUAL_HEX8(0xff, frame.data[1]);
    TEST_ASSERT_TRUE(slcan_decode("t12320aFf1234", 13, &frame));
    TEST_ASSERT_TRUE(slcan_decode("r1232ABCD", 9, &frame));
    TEST_ASSERT_EQUAL_UINT8(2, frame.length);
    TEST_ASSERT_EQUAL_HEX8(0, frame.data[0]);
    const char *const bad[] = {
        "",           "t",          "t12",          "t123",       "t8000",
        "tFFF0",      "t1239",      "t123A",        "t12G0",      "t1231",
        "t12311",     "t1231112",   "t1230123",     "t12301234F", "t1231GG",
        "t12311123G", "T200000000", "TFFFFFFFF0",   "T0000001",   "T00000010 ",
        "x1230",      "r1230x",     "R000000010AB", " t1230",     "t123011223344",
        "t-1F0",      "t1230\n",    "t123012G4",    "t1230123G",  "T0000000091122334455667788",
    };
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        expect_refused(bad[i]);
    }
}

/* ---- Host --------------------------------------------------------------------------------------
 */

static void test_host_sets_the_adapter_up(void) {
    const berth_can_frame_t frame = {.id = 0x123, .length = 1, .data = {7}};
    begin(SLCAN_HOST);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DOWN, state().mode);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, send(&frame));
    expect_none();
    TEST_ASSERT_EQUAL_STRING("\rC\rS8\rO\r", peer_hears());
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, state().mode);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, send(&frame));
    TEST_ASSERT_EQUAL_STRING("t123107\r", peer_hears());
    peer_says("\a\r\rz\r"); /* the closed adapter's answers, and the frame's */
    expect_none();
    TEST_ASSERT_EQUAL_UINT32(0, state().tx_dropped);
    TEST_ASSERT_EQUAL_UINT32(0, state().restarts);
    TEST_ASSERT_EQUAL_UINT32(0, state().error_frames);
}

static void test_host_receives_at_every_split(void) {
    const char *text = "t1232AB0F\rT000045671121234\r\nr0018\rz\r\rF00\rt7FF0\r";
    const size_t length = strlen(text);
    for (size_t first = 0; first <= length; first++) {
        for (size_t piece = 1; piece <= length; piece = piece == 1u ? 7u : piece + length) {
            setUp();
            begin(SLCAN_HOST);
            ours.piece = piece;
            uint32_t got = 0;
            static const uint32_t ids[] = {0x123, 0x4567, 1, 0x7ff};
            for (size_t part = 0; part < 2u; part++) {
                size_t done = 0;
                const size_t from = part == 0u ? 0u : first;
                const size_t to = part == 0u ? first : length;
                (void)end_write(&theirs, (const uint8_t *)text + from, to - from, &done);
                berth_can_frame_t frame;
                while (receive(&frame) == BERTH_CAN_DONE) {
                    TEST_ASSERT_TRUE(got < 4u);
                    TEST_ASSERT_EQUAL_HEX32(ids[got++], frame.id);
                    TEST_ASSERT_EQUAL_INT64(time_us, frame.time_us);
                }
            }
            TEST_ASSERT_EQUAL_UINT32(4, got);
            TEST_ASSERT_EQUAL_UINT32(0, slcan_counts(&line).malformed);
        }
    }
}

static void test_host_survives_bad_lines(void) {
    begin(SLCAN_HOST);
    expect_none();
    peer_says("t1239\r");
    peer_says("T0000000181122334455667788123456789\r"); /* longer than any line */
    peer_says("\x01\xff\r");
    peer_says("t12\a"); /* refused in the middle of a line */
    peer_says("t1230\r");
    berth_can_frame_t frame;
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, receive(&frame));
    TEST_ASSERT_EQUAL_HEX32(0x123, frame.id);
    TEST_ASSERT_EQUAL_UINT32(4, slcan_counts(&line).malformed);
    TEST_ASSERT_EQUAL_UINT32(4, state().error_frames);
}

static void test_host_send_when_the_line_stalls(void) {
    berth_can_frame_t frame = {.id = 0x100, .length = 8};
    begin(SLCAN_HOST);
    expect_none();
    (void)peer_hears();
    ours.room = 55; /* two lines and a half */
    uint32_t taken = 0;
    while (send(&frame) == BERTH_CAN_DONE) {
        frame.id++;
        taken++;
        TEST_ASSERT_TRUE(taken < 100u);
    }
    TEST_ASSERT_TRUE(taken > 10u);
    TEST_ASSERT_EQUAL_UINT32(taken, slcan_counts(&line).sent);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, send(&frame));
    ours.room = SIZE_MAX;
    ours.piece = 5;
    for (int i = 0; i < 200; i++) {
        expect_none();
    }
    /* All of them, whole and in order. */
    const char *text = peer_hears();
    for (uint32_t i = 0; i < taken; i++) {
        berth_can_frame_t back;
        const char *end = strchr(text, '\r');
        TEST_ASSERT_NOT_NULL(end);
        TEST_ASSERT_TRUE(slcan_decode(text, (size_t)(end - text), &back));
        TEST_ASSERT_EQUAL_HEX32(0x100u + i, back.id);
        text = end + 1;
    }
    TEST_ASSERT_EQUAL_STRING("", text);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, send(&frame));
}

static void test_host_loses_the_line_and_finds_it(void) {
    const berth_can_frame_t frame = {.id = 0x100, .length = 8};
    begin(SLCAN_HOST);
    expect_none();
    (void)peer_hears();
    ours.room = 3; /* the first frame is half written */
    for (int i = 0; i < 5; i++) {
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, send(&frame));
    }
    peer_says("t12");
    expect_none();
    ours.broken = true;
    berth_can_frame_t got;
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, receive(&got));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, send(&frame));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DOWN, state().mode);
    TEST_ASSERT_EQUAL_UINT32(5, state().tx_dropped);
    TEST_ASSERT_EQUAL_UINT32(0, state().restarts);
    (void)peer_hears();
    ours.broken = false;
    ours.room = SIZE_MAX;
    peer_says("30\r"); /* not joined to what came before the loss */
    expect_none();
    TEST_ASSERT_EQUAL_STRING("\rC\rS8\rO\r", peer_hears());
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, state().mode);
    TEST_ASSERT_EQUAL_UINT32(1, state().restarts);
    TEST_ASSERT_EQUAL_UINT32(5, state().tx_dropped);
}

/* Whatever part of the first line is out already: a frame whose end has not left never left. */
static void test_frames_that_wait_when_the_line_breaks_are_counted(void) {
    const berth_can_frame_t frame = {.id = 0x100, .length = 1};
    berth_can_frame_t got;
    for (uint32_t written = 0; written <= 24; written++) { /* three lines of 8 characters */
        setUp();
        begin(SLCAN_HOST);
        expect_none();
        ours.room = 0;
        for (int i = 0; i < 3; i++) {
            TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, send(&frame));
        }
        ours.room = written;
        expect_none();
        TEST_ASSERT_EQUAL_UINT(0, ours.room);
        ours.broken = true;
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, receive(&got));
        TEST_ASSERT_EQUAL_UINT32(3 - written / 8, state().tx_dropped);
        TEST_ASSERT_EQUAL_UINT32(3, slcan_counts(&line).sent);
    }
}

/* Answers that wait among the frames are none, and no letter in them is taken for a frame's. */
static void test_answers_that_wait_when_the_line_breaks_are_not_counted(void) {
    const berth_can_frame_t frame = {.id = 0x100};
    berth_can_frame_t got;
    static const uint32_t dropped[] = {2, 2, 2, 2, 2, 2, 2, 1, 1, 1, 1, 1, 1, 0};
    for (uint32_t written = 0; written < sizeof dropped / sizeof dropped[0]; written++) {
        setUp();
        begin(SLCAN_ADAPTER);
        peer_says("O\r");
        expect_none();
        ours.room = 0;
        peer_says("q\r"); /* is refused: a BELL */
        expect_none();
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, send(&frame));
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, send(&frame));
        peer_says("N\r"); /* NB001 waits behind them */
        expect_none();
        ours.room = written;
        expect_none();
        ours.broken = true;
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, receive(&got));
        TEST_ASSERT_EQUAL_UINT32(dropped[written], state().tx_dropped);
    }
}

/* The line may break for writing alone. */
static void test_a_line_that_takes_no_bytes_any_more_is_lost(void) {
    const berth_can_frame_t frame = {.id = 0x100};
    berth_can_frame_t got;
    begin(SLCAN_HOST);
    expect_none();
    ours.room = 0;
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, send(&frame)); /* waits */
    ours.mute = true;
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, send(&frame));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DOWN, state().mode);
    TEST_ASSERT_EQUAL_UINT32(1, state().tx_dropped);
    TEST_ASSERT_EQUAL_UINT32(1, slcan_counts(&line).sent);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, receive(&got)); /* the set-up finds nobody either */
    ours.mute = false;
    ours.room = SIZE_MAX;
    (void)peer_hears();
    expect_none();
    TEST_ASSERT_EQUAL_STRING("\rC\rS8\rO\r", peer_hears());
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, state().mode);
    ours.mute = true;
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, send(&frame)); /* taken, and lost at once */
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DOWN, state().mode);
    TEST_ASSERT_EQUAL_UINT32(2, state().tx_dropped);
}

/* Lines of 8 characters until nothing more fits. */
static void fill_to_the_last_byte(void) {
    const berth_can_frame_t frame = {.id = 0x100, .length = 1};
    ours.room = 0;
    for (uint32_t i = 0; i < SLCAN_TRANSMIT_BYTES / 8u; i++) {
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, send(&frame));
    }
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, send(&frame));
}

/* The question for the flags waits for its turn, and that it was not asked is no reset. */
static void test_host_that_cannot_ask_asks_later(void) {
    begin(SLCAN_HOST);
    expect_none();
    (void)peer_hears();
    fill_to_the_last_byte();
    time_us += SLCAN_POLL_US;
    peer_says("\a");
    expect_none();
    ours.room = SIZE_MAX;
    expect_none();
    TEST_ASSERT_NULL(strchr(peer_hears(), 'F'));
    TEST_ASSERT_EQUAL_UINT32(1, slcan_counts(&line).setups);
    time_us += SLCAN_POLL_US;
    expect_none();
    TEST_ASSERT_EQUAL_STRING("F\r", peer_hears());
}

static void test_answers_without_room_are_counted(void) {
    begin(SLCAN_ADAPTER);
    peer_says("O\r");
    expect_none();
    fill_to_the_last_byte();
    peer_says("V\rF\r");
    expect_none();
    TEST_ASSERT_EQUAL_UINT32(2, slcan_counts(&line).unsaid);
    (void)peer_hears();
    ours.room = SIZE_MAX;
    expect_none();
    TEST_ASSERT_EQUAL_UINT(SLCAN_TRANSMIT_BYTES, strlen(peer_hears()));
}

/* One call parses so much and no more, however much there is. */
static void test_a_flood_of_empty_lines_does_not_hold_the_caller(void) {
    berth_can_frame_t got;
    begin(SLCAN_HOST);
    for (int i = 0; i < 5000; i++) {
        peer_says("\r");
    }
    peer_says("t1230\r");
    expect_none();
    TEST_ASSERT_EQUAL_UINT(SLCAN_RECEIVE_BYTES, to_us.at);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, receive(&got));
    TEST_ASSERT_EQUAL_HEX32(0x123, got.id);
}

static void test_counters_do_not_wrap(void) {
    begin(SLCAN_HOST);
    line.counts.malformed = UINT32_MAX - 1u;
    line.state.error_frames = UINT32_MAX;
    peer_says("?\r?\r");
    expect_none();
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, slcan_counts(&line).malformed);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, state().error_frames);
}

static void test_host_asks_for_status(void) {
    begin(SLCAN_HOST);
    expect_none();
    (void)peer_hears();
    time_us += SLCAN_POLL_US - 1;
    expect_none();
    TEST_ASSERT_EQUAL_STRING("", peer_hears());
    time_us += 1;
    expect_none();
    TEST_ASSERT_EQUAL_STRING("F\r", peer_hears());
    peer_says("FA8\r"); /* bus error, passive, overrun */
    expect_none();
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_PASSIVE, state().mode);
    TEST_ASSERT_EQUAL_UINT32(1, state().rx_lost);
    TEST_ASSERT_EQUAL_UINT32(1, state().error_frames);
    time_us += SLCAN_POLL_US;
    peer_says("F00\r");
    expect_none();
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, state().mode);
    TEST_ASSERT_EQUAL_UINT32(1, state().error_frames);
}

static void test_host_opens_a_reset_adapter_again(void) {
    const berth_can_frame_t frame = {.id = 1};
    begin(SLCAN_HOST);
    expect_none();
    peer_says("\r\r\r");
    expect_none();
    (void)peer_hears();
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, send(&frame));
    peer_says("\a"); /* reset and closed: it refuses the frame, */
    expect_none();
    TEST_ASSERT_EQUAL_UINT32(1, state().tx_dropped);
    time_us += SLCAN_POLL_US;
    expect_none();
    peer_says("\a"); /* and the question for its flags */
    time_us += SLCAN_POLL_US;
    (void)peer_hears();
    expect_none();
    TEST_ASSERT_EQUAL_STRING("\rC\rS8\rO\r", peer_hears());
    TEST_ASSERT_EQUAL_UINT32(1, state().tx_dropped);
    TEST_ASSERT_EQUAL_UINT32(1, state().restarts);
    TEST_ASSERT_EQUAL_UINT32(2, slcan_counts(&line).setups);
    TEST_ASSERT_EQUAL_UINT32(2, slcan_counts(&line).refused);
    peer_says("\r\r\r");
    for (int i = 0; i < 4; i++) { /* once is enough */
        time_us += SLCAN_POLL_US;
        expect_none();
    }
    TEST_ASSERT_EQUAL_UINT32(2, slcan_counts(&line).setups);
}

/* Its queue was full: it refuses frames and tells its flags. */
static void test_host_keeps_an_adapter_that_refuses_frames(void) {
    const berth_can_frame_t frame = {.id = 1};
    begin(SLCAN_HOST);
    expect_none();
    peer_says("\r\r\r");
    for (uint32_t i = 1; i <= 5u; i++) {
        time_us += SLCAN_POLL_US;
        expect_none();
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, send(&frame));
        peer_says("\aF00\r");
        expect_none();
        TEST_ASSERT_EQUAL_UINT32(i, state().tx_dropped);
        TEST_ASSERT_EQUAL_UINT32(i, slcan_counts(&line).refused);
    }
    TEST_ASSERT_EQUAL_UINT32(1, slcan_counts(&line).setups);
}

static void test_host_keeps_a_silent_adapter(void) {
    begin(SLCAN_HOST);
    expect_none();
    (void)peer_hears();
    for (int i = 0; i < 10; i++) {
        time_us += SLCAN_POLL_US;
        expect_none();
        expect_none(); /* asked once */
        TEST_ASSERT_EQUAL_STRING("F\r", peer_hears());
    }
    TEST_ASSERT_EQUAL_UINT32(1, slcan_counts(&line).setups);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, state().mode);
}

static void test_host_answers_a_host_but_sends_no_bell(void) {
    begin(SLCAN_HOST);
    expect_none();
    (void)peer_hears();
    peer_says("C\rS8\rO\rV\rN\rF\rZ1\r");
    expect_none();
    TEST_ASSERT_EQUAL_STRING("\r\r\rV1013\rNB001\rF00\r\r", peer_hears());
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, send(&(berth_can_frame_t){.id = 5}));
    TEST_ASSERT_EQUAL_STRING("t0050\r", peer_hears()); /* adapters want no stamps */
    peer_says("V1013\rNB001\rQ1\rboot message\rt1230\r");
    berth_can_frame_t frame;
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, receive(&frame));
    TEST_ASSERT_EQUAL_STRING("", peer_hears());
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, state().mode);
}

static void test_filters_and_bad_arguments(void) {
    const berth_can_filter_t filters[] = {{0x120, 0x7f0, false}, {0x1000, 0x1fffffff, true}};
    slcan_config_t config = config_of(SLCAN_HOST, &ours);
    config.filters = filters;
    config.filter_count = 2;
    slcan_init(&line, &config);
    can = slcan_can(&line);
    peer_says("t1330\rt1200\rT000001200\rt1000\rt1310\rT000010000\rt12F0\r");
    static const uint32_t ids[] = {0x120, 0x1000, 0x12f};
    berth_can_frame_t frame;
    for (uint32_t i = 0; i < 3u; i++) {
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, receive(&frame));
        TEST_ASSERT_EQUAL_HEX32(ids[i], frame.id);
    }
    expect_none();
    TEST_ASSERT_EQUAL_UINT32(4, slcan_counts(&line).filtered);
    TEST_ASSERT_EQUAL_UINT32(3, slcan_counts(&line).received);
    TEST_ASSERT_EQUAL_UINT32(0, slcan_counts(&line).malformed);
    const berth_can_frame_t bad[] = {{.id = 0x800},
                                     {.id = 0x20000000, .extended = true},
                                     {.id = UINT32_MAX},
                                     {.id = 1, .length = 9}};
    (void)peer_hears();
    for (size_t i = 0; i < 4u; i++) {
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, send(&bad[i]));
    }
    TEST_ASSERT_EQUAL_STRING("", peer_hears());
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, state().mode);
}

/* ---- Adapter -----------------------------------------------------------------------------------
 */

static void expect_answer(const char *command, const char *answer) {
    berth_can_frame_t frame;
    (void)peer_hears();
    peer_says(command);
    while (receive(&frame) == BERTH_CAN_DONE) {
    }
    TEST_ASSERT_EQUAL_STRING_MESSAGE(answer, peer_hears(), command);
}

static void test_adapter_answers_commands(void) {
    begin(SLCAN_ADAPTER);
    expect_answer("V\r", "V1013\r");
    expect_answer("N\r", "NB001\r");
    expect_answer("F\r", "\a");
    expect_answer("C\r", "\a");
    expect_answer("t1230\r", "\a");
    expect_answer("S8\r", "\r");
    expect_answer("S9\r", "\a");
    expect_answer("S\r", "\a");
    expect_answer("s031C\r", "\r");
    expect_answer("s031C00\r", "\r");
    expect_answer("s031\r", "\a");
    expect_answer("O\r", "\r");
    expect_answer("O\r", "\a");
    expect_answer("S8\r", "\a");
    expect_answer("Z1\r", "\a"); /* too late: no stamps */
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, send(&(berth_can_frame_t){.id = 5}));
    TEST_ASSERT_EQUAL_STRING("t0050\r", peer_hears());
    expect_answer("F\r", "F00\r");
    expect_answer("X1\r", "\r");
    expect_answer("X0\r", "\a");
    expect_answer("M00000000\r", "\a");
    expect_answer("t1230\r", "z\r");
    expect_answer("T000000010\r", "Z\r");
    expect_answer("t1239\r", "\a");
    expect_answer("\r", "");
    expect_answer("\a", "");
    expect_answer("z\r", "");
    expect_answer("C\r", "\r");
    expect_answer("L\r", "\r");
    expect_answer("t1230\r", "\a");
}

static void test_adapter_is_down_until_opened(void) {
    const berth_can_frame_t frame = {.id = 0x10, .length = 1, .data = {0xfe}};
    berth_can_frame_t got;
    begin(SLCAN_ADAPTER);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, receive(&got));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, send(&frame));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DOWN, state().mode);
    peer_says("t1230\rS8\rO\r");
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, receive(&got));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, state().mode);
    (void)peer_hears();
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, send(&frame));
    TEST_ASSERT_EQUAL_STRING("t0101FE\r", peer_hears());
    peer_says("C\r");
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, receive(&got));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, send(&frame));
    peer_says("Z1\rO\r");
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, receive(&got));
    TEST_ASSERT_EQUAL_UINT32(1, state().restarts);
    (void)peer_hears();
    time_us = INT64_C(60000) * 1000 * 3 + 0x1234 * 1000; /* stamps wrap each minute */
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, send(&frame));
    TEST_ASSERT_EQUAL_STRING("t0101FE1234\r", peer_hears());
    time_us += INT64_C(3600) * 1000000;
    expect_none();
    TEST_ASSERT_EQUAL_STRING("", peer_hears()); /* an adapter asks nothing */
}

/* ---- Both, and noise ---------------------------------------------------------------------------
 */

static void test_a_host_and_an_adapter_understand_each_other(void) {
    static slcan_t other;
    const slcan_config_t config = config_of(SLCAN_ADAPTER, &theirs);
    support_random_start();
    slcan_init(&other, &config);
    const berth_can_t far = slcan_can(&other);
    begin(SLCAN_HOST);
    berth_can_frame_t frame;
    for (uint32_t i = 0; i < support_runs(20000); i++) {
        ours.piece = 1u + support_index(40);
        theirs.piece = 1u + support_index(40);
        time_us += support_index(100000);
        const berth_can_frame_t sent = random_frame();
        const berth_can_t *from = support_index(2) == 0u ? &can : &far;
        const berth_can_t *to = from == &can ? &far : &can;
        (void)can.api->receive(can.context, &frame);
        (void)far.api->receive(far.context, &frame);
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, from->api->send(from->context, &sent));
        /* The rest of a line that was cut is written by the sender's next call. */
        bool got = false;
        for (int turn = 0; turn < 50 && !got; turn++) {
            berth_can_frame_t none;
            TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, from->api->receive(from->context, &none));
            got = to->api->receive(to->context, &frame) == BERTH_CAN_DONE;
        }
        TEST_ASSERT_TRUE(got);
        expect_same(&sent, &frame);
    }
    berth_can_state_t at_far;
    far.api->state(far.context, &at_far);
    TEST_ASSERT_EQUAL_UINT32(0, state().tx_dropped + state().error_frames + state().restarts);
    TEST_ASSERT_EQUAL_UINT32(0, at_far.error_frames + at_far.restarts);
    TEST_ASSERT_EQUAL_UINT32(1, slcan_counts(&line).setups);
}

static void test_two_hosts_understand_each_other(void) {
    static slcan_t other;
    const slcan_config_t config = config_of(SLCAN_HOST, &theirs);
    slcan_init(&other, &config);
    const berth_can_t far = slcan_can(&other);
    begin(SLCAN_HOST);
    berth_can_frame_t frame;
    uint32_t written = 0;
    for (uint32_t i = 0; i < 1000u; i++) {
        time_us += 10000;
        const berth_can_frame_t sent = {.id = i % 2048u, .length = 1, .data = {(uint8_t)i}};
        expect_none();
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, far.api->receive(far.context, &frame));
        expect_none();
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, send(&sent));
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, far.api->receive(far.context, &frame));
        expect_same(&sent, &frame);
        written += (uint32_t)(to_us.end + to_peer.end);
    }
    TEST_ASSERT_EQUAL_UINT32(0, state().tx_dropped + state().error_frames + state().restarts);
    TEST_ASSERT_EQUAL_UINT32(1, slcan_counts(&line).setups + slcan_counts(&other).setups - 1u);
    TEST_ASSERT_TRUE(written < 1000u * 100u); /* no answer is answered */
}

static void fuzz(slcan_role_t role, bool mutated) {
    static const char letters[] = "tTrRzZFVNCOLSsX0123456789abcdefABCDEF\r\r\r\r\a\n";
    begin(role);
    uint32_t frames = 0;
    for (uint32_t i = 0; i < support_runs(20000); i++) {
        char text[64];
        size_t length = 1u + support_index(60);
        for (size_t at = 0; at < length; at++) {
            text[at] = support_index(20) == 0u ? (char)support_index(256)
                                               : letters[support_index(sizeof letters - 1u)];
        }
        if (mutated) {
            const berth_can_frame_t frame = random_frame();
            length = slcan_encode(&frame, text);
            if (support_index(2) == 0u) {
                text[support_index((uint32_t)length)] = (char)support_index(256);
            }
        }
        size_t done = 0;
        (void)end_write(&theirs, (const uint8_t *)text, length, &done);
        ours.broken = support_index(100) == 0u;
        ours.room = support_index(10) == 0u ? support_index(10) : SIZE_MAX;
        ours.piece = 1u + support_index(64);
        time_us += support_index(200000);
        berth_can_frame_t frame;
        while (receive(&frame) == BERTH_CAN_DONE) {
            frames++;
            TEST_ASSERT_TRUE(frame.length <= BERTH_CAN_DATA_MAX);
            TEST_ASSERT_TRUE(frame.id <=
                             (frame.extended ? BERTH_CAN_EXTENDED_MAX : BERTH_CAN_STANDARD_MAX));
        }
        if (support_index(3) == 0u) {
            frame = random_frame();
            (void)send(&frame);
        }
        (void)state();
        (void)peer_hears();
        TEST_ASSERT_TRUE(line.line_length < SLCAN_LINE_MAX);
        TEST_ASSERT_TRUE(line.transmit_at <= line.transmit_end);
        TEST_ASSERT_TRUE(line.transmit_end <= SLCAN_TRANSMIT_BYTES);
    }
    TEST_ASSERT_TRUE(slcan_counts(&line).malformed > 0u);
    if (mutated && role == SLCAN_HOST) {
        TEST_ASSERT_TRUE(frames > support_runs(20000) / 4u);
    }
    /* It still works. */
    ours = (end_t){&to_us, &to_peer, SIZE_MAX, SIZE_MAX, false, false};
    peer_says("\rC\rO\rt1230\r");
    berth_can_frame_t frame = {0};
    bool found = false;
    for (int i = 0; i < 10 && !found; i++) {
        found = receive(&frame) == BERTH_CAN_DONE && frame.id == 0x123u;
    }
    TEST_ASSERT_TRUE(found);
}

static void test_noise(void) {
    support_random_start();
    fuzz(SLCAN_HOST, false);
    setUp();
    fuzz(SLCAN_ADAPTER, false);
    setUp();
    fuzz(SLCAN_HOST, true);
    setUp();
    fuzz(SLCAN_ADAPTER, true);
}

/* A stream that breaks its contract harms nobody. */
static byte_stream_outcome_t lying_read(void *context, uint8_t *bytes, size_t room, size_t *count) {
    (void)bytes;
    *count = *(size_t *)context == 0u ? 0u : room + *(size_t *)context;
    return BYTE_STREAM_DONE;
}

static byte_stream_outcome_t lying_write(void *context, const uint8_t *bytes, size_t length,
                                         size_t *count) {
    (void)bytes;
    *count = *(size_t *)context == 0u ? 0u : length + *(size_t *)context;
    return BYTE_STREAM_DONE;
}

static void test_a_lying_stream(void) {
    static const byte_stream_api_t liar = {lying_read, lying_write};
    static size_t too_much[] = {0, 1, 1000};
    for (size_t i = 0; i < 3u; i++) {
        slcan_config_t config = config_of(SLCAN_HOST, &ours);
        config.stream = (byte_stream_t){&liar, &too_much[i]};
        slcan_init(&line, &config);
        can = slcan_can(&line);
        const berth_can_frame_t frame = {.id = 1};
        expect_none();
        for (int n = 0; n < 200; n++) {
            (void)send(&frame);
            expect_none();
        }
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_frames_are_written_as_the_protocol_says);
    RUN_TEST(test_a_length_beyond_its_range_overruns_nothing);
    RUN_TEST(test_every_frame_comes_back);
    RUN_TEST(test_only_exact_frames_are_read);
    RUN_TEST(test_host_sets_the_adapter_up);
    RUN_TEST(test_host_receives_at_every_split);
    RUN_TEST(test_host_survives_bad_lines);
    RUN_TEST(test_host_send_when_the_line_stalls);
    RUN_TEST(test_host_loses_the_line_and_finds_it);
    RUN_TEST(test_frames_that_wait_when_the_line_breaks_are_counted);
    RUN_TEST(test_answers_that_wait_when_the_line_breaks_are_not_counted);
    RUN_TEST(test_a_line_that_takes_no_bytes_any_more_is_lost);
    RUN_TEST(test_host_that_cannot_ask_asks_later);
    RUN_TEST(test_answers_without_room_are_counted);
    RUN_TEST(test_a_flood_of_empty_lines_does_not_hold_the_caller);
    RUN_TEST(test_counters_do_not_wrap);
    RUN_TEST(test_host_asks_for_status);
    RUN_TEST(test_host_opens_a_reset_adapter_again);
    RUN_TEST(test_host_keeps_an_adapter_that_refuses_frames);
    RUN_TEST(test_host_keeps_a_silent_adapter);
    RUN_TEST(test_host_answers_a_host_but_sends_no_bell);
    RUN_TEST(test_filters_and_bad_arguments);
    RUN_TEST(test_adapter_answers_commands);
    RUN_TEST(test_adapter_is_down_until_opened);
    RUN_TEST(test_a_host_and_an_adapter_understand_each_other);
    RUN_TEST(test_two_hosts_understand_each_other);
    RUN_TEST(test_noise);
    RUN_TEST(test_a_lying_stream);
    return UNITY_END();
}
