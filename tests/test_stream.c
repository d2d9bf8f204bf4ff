/* stream: a pty and a unix socket at either end, peers that go and come back; can_open's words. */
#include "can_open.h"
#include "stream.h"

#include "unity.h"

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <pty.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

static char folder[64];
static char path[96];
static char error[CAN_OPEN_ERROR_MAX];
static stream_t a, b;

void setUp(void) {
    (void)snprintf(folder, sizeof folder, "/tmp/berth-stream-XXXXXX");
    TEST_ASSERT_NOT_NULL(mkdtemp(folder));
    (void)snprintf(path, sizeof path, "%s/line", folder);
    memset(error, 0, sizeof error);
    a = (stream_t){.fd = -1, .listener = -1};
    b = a;
}

void tearDown(void) {
    stream_close(&a);
    stream_close(&b);
    (void)unlink(path);
    (void)rmdir(folder);
}

static void open_a(void) {
    TEST_ASSERT_TRUE_MESSAGE(stream_open(&a, path, error, sizeof error), error);
}

static void open_b(void) {
    TEST_ASSERT_TRUE_MESSAGE(stream_open(&b, path, error, sizeof error), error);
}

static byte_stream_outcome_t put(stream_t *stream, const char *text) {
    const byte_stream_t bytes = stream_bytes(stream);
    size_t count = 99;
    const byte_stream_outcome_t outcome =
        bytes.api->write(bytes.context, (const uint8_t *)text, strlen(text), &count);
    TEST_ASSERT_EQUAL_UINT(outcome == BYTE_STREAM_DONE ? strlen(text) : 0u, count);
    return outcome;
}

static byte_stream_outcome_t get(stream_t *stream, char text[64]) {
    const byte_stream_t bytes = stream_bytes(stream);
    size_t count = 99;
    const byte_stream_outcome_t outcome =
        bytes.api->read(bytes.context, (uint8_t *)text, 63, &count);
    TEST_ASSERT_EQUAL_INT(outcome == BYTE_STREAM_DONE, count > 0u);
    text[count] = '\0';
    return outcome;
}

/* Within five seconds. */
static void expect_text(stream_t *stream, const char *want) {
    char text[64];
    for (int i = 0; i < 1000; i++) {
        if (get(stream, text) == BYTE_STREAM_DONE) {
            TEST_ASSERT_EQUAL_STRING(want, text);
            return;
        }
        (void)usleep(5000);
    }
    TEST_FAIL_MESSAGE(want);
}

/* Within five seconds, reading gives this. */
static void expect_outcome(stream_t *stream, byte_stream_outcome_t want) {
    char text[64];
    byte_stream_outcome_t outcome = get(stream, text);
    for (int i = 0; i < 1000 && outcome != want; i++) {
        (void)usleep(5000);
        outcome = get(stream, text);
    }
    TEST_ASSERT_EQUAL_INT(want, outcome);
}

/* ---- Unix socket -------------------------------------------------------------------------------
 */

static void test_socket_both_ends(void) {
    struct stat status;
    char text[64];
    open_a();
    TEST_ASSERT_EQUAL_INT(STREAM_LISTEN, a.kind);
    TEST_ASSERT_EQUAL_INT(0, stat(path, &status));
    TEST_ASSERT_TRUE(S_ISSOCK(status.st_mode));
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_FAILED, get(&a, text));
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_FAILED, put(&a, "x"));
    TEST_ASSERT_TRUE(stream_fd(&a) >= 0); /* to wait for a peer */
    open_b();
    TEST_ASSERT_EQUAL_INT(STREAM_CONNECT, b.kind);
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_DONE, put(&b, "hello\r"));
    expect_text(&a, "hello\r");
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_DONE, put(&a, "\xff\x01\r\n"));
    expect_text(&b, "\xff\x01\r\n");
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_AGAIN, get(&a, text));
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_AGAIN, get(&b, text));
    stream_close(&a);
    stream_close(&a);
    TEST_ASSERT_EQUAL_INT(-1, stat(path, &status));
    TEST_ASSERT_EQUAL_INT(-1, stream_fd(&a));
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_FAILED, get(&a, text));
}

static void test_listener_takes_the_next_peer(void) {
    char text[64];
    open_a();
    for (int i = 0; i < 3; i++) {
        open_b();
        TEST_ASSERT_EQUAL_INT(BYTE_STREAM_DONE, put(&b, "1"));
        expect_text(&a, "1");
        TEST_ASSERT_EQUAL_INT(BYTE_STREAM_DONE, put(&b, "last words"));
        stream_close(&b);
        expect_text(&a, "last words");
        TEST_ASSERT_EQUAL_INT(BYTE_STREAM_FAILED, get(&a, text));
        TEST_ASSERT_EQUAL_UINT32((uint32_t)i + 1u, a.losses);
    }
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_FAILED, put(&a, "nobody"));
}

static void test_a_new_peer_is_never_joined_to_the_old(void) {
    char text[64];
    stream_t c = {.fd = -1, .listener = -1};
    open_a();
    open_b();
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_DONE, put(&b, "half"));
    expect_text(&a, "half");
    TEST_ASSERT_TRUE(stream_open(&c, path, error, sizeof error));
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_DONE, put(&c, "line"));
    stream_close(&b);
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_FAILED, get(&a, text));
    expect_text(&a, "line");
    stream_close(&c);
}

static void test_connected_end_finds_a_new_listener(void) {
    open_a();
    open_b();
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_DONE, put(&b, "1"));
    expect_text(&a, "1");
    stream_close(&a);
    expect_outcome(&b, BYTE_STREAM_FAILED);
    TEST_ASSERT_EQUAL_INT(-1, stream_fd(&b));
    open_a();
    TEST_ASSERT_EQUAL_INT(STREAM_LISTEN, a.kind);
    expect_outcome(&b, BYTE_STREAM_AGAIN);
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_DONE, put(&b, "2"));
    expect_text(&a, "2");
}

static void test_a_dead_socket_is_replaced(void) {
    open_a();
    const int listener = a.listener;
    a.listener = -1; /* as if its process had died: closed, not removed */
    stream_close(&a);
    TEST_ASSERT_EQUAL_INT(0, close(listener));
    TEST_ASSERT_EQUAL_INT(0, access(path, F_OK));
    open_a();
    TEST_ASSERT_EQUAL_INT(STREAM_LISTEN, a.kind);
    open_b();
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_DONE, put(&b, "1"));
    expect_text(&a, "1");
}

static void test_close_leaves_another_ones_socket(void) {
    open_a();
    TEST_ASSERT_EQUAL_INT(0, unlink(path));
    open_b();
    TEST_ASSERT_EQUAL_INT(STREAM_LISTEN, b.kind);
    stream_close(&a);
    TEST_ASSERT_EQUAL_INT(0, access(path, F_OK));
    stream_close(&b);
    TEST_ASSERT_EQUAL_INT(-1, access(path, F_OK));
}

static void test_two_processes_start_at_once(void) {
    for (int round = 0; round < 20; round++) {
        const pid_t child = fork();
        TEST_ASSERT_TRUE(child >= 0);
        if (child == 0) {
            (void)alarm(20);
            bool good = stream_open(&b, path, error, sizeof error);
            char text[64];
            for (int i = 0; good && i < 8000 && get(&b, text) != BYTE_STREAM_DONE; i++) {
                (void)usleep(1000);
            }
            good = good && text[0] == 'p' && put(&b, "child") == BYTE_STREAM_DONE;
            _exit(good ? 0 : 1); /* without closing: a socket may stay behind */
        }
        open_a();
        for (int i = 0; i < 8000 && put(&a, "p") != BYTE_STREAM_DONE; i++) {
            (void)usleep(1000);
        }
        expect_text(&a, "child");
        int status = 0;
        TEST_ASSERT_EQUAL_INT(child, waitpid(child, &status, 0));
        TEST_ASSERT_EQUAL_INT(0, status);
        stream_close(&a);
    }
}

static void test_a_peer_that_stands_still_is_no_room(void) {
    uint32_t written = 0;
    open_a();
    open_b();
    while (put(&b, "t1238112233445566\r") == BYTE_STREAM_DONE) {
        written++;
        TEST_ASSERT_TRUE(written < 1000u);
    }
    TEST_ASSERT_TRUE(written >= 10u && written <= 100u);
    char text[64];
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_AGAIN, put(&b, "x"));
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_AGAIN, get(&b, text));
    while (get(&a, text) == BYTE_STREAM_DONE) {
    }
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_DONE, put(&b, "x"));
    TEST_ASSERT_EQUAL_UINT32(0, b.losses);
}

/* ---- Tty ---------------------------------------------------------------------------------------
 */

/* A pty whose slave has a name of ours, as a tty of the system has. */
static int open_pty(void) {
    int master = -1;
    int slave = -1;
    char name[64];
    TEST_ASSERT_EQUAL_INT(0, openpty(&master, &slave, name, NULL, NULL));
    (void)close(slave);
    TEST_ASSERT_EQUAL_INT(0, symlink(name, path));
    TEST_ASSERT_EQUAL_INT(0, fcntl(master, F_SETFL, O_NONBLOCK));
    return master;
}

static void test_tty_is_raw(void) {
    char text[64];
    const int master = open_pty();
    open_a();
    TEST_ASSERT_EQUAL_INT(STREAM_TTY, a.kind);
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_AGAIN, get(&a, text));
    TEST_ASSERT_EQUAL_INT(7, write(master, "t\r\n\x03\x11\xff\a", 7));
    expect_text(&a, "t\r\n\x03\x11\xff\a");
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_DONE, put(&a, "z\r\n\x04"));
    struct pollfd item = {.fd = master, .events = POLLIN};
    TEST_ASSERT_EQUAL_INT(1, poll(&item, 1, 5000)); /* a pty delivers a moment later */
    TEST_ASSERT_EQUAL_INT(4, read(master, text, sizeof text));
    TEST_ASSERT_EQUAL_MEMORY("z\r\n\x04", text, 4);
    TEST_ASSERT_EQUAL_INT(-1, read(master, text, sizeof text)); /* no echo */
    TEST_ASSERT_EQUAL_INT(EAGAIN, errno);
    (void)close(master);
}

static void test_tty_unplugged_and_back(void) {
    int master = open_pty();
    open_a();
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_DONE, put(&a, "1"));
    TEST_ASSERT_EQUAL_INT(0, unlink(path)); /* first, since its number may be another pty's soon */
    (void)close(master);
    expect_outcome(&a, BYTE_STREAM_FAILED);
    TEST_ASSERT_EQUAL_INT(-1, stream_fd(&a));
    (void)usleep(2 * STREAM_RETRY_US);
    expect_outcome(&a, BYTE_STREAM_FAILED);
    master = open_pty();
    expect_outcome(&a, BYTE_STREAM_AGAIN);
    TEST_ASSERT_EQUAL_INT(1, write(master, "2", 1));
    expect_text(&a, "2");
    TEST_ASSERT_EQUAL_UINT32(1, a.losses);
    (void)close(master);
}

/* ---- Paths and words that cannot be used -------------------------------------------------------
 */

static void expect_refused(const char *bad_path, const char *reason) {
    TEST_ASSERT_FALSE(stream_open(&a, bad_path, error, sizeof error));
    TEST_ASSERT_NOT_NULL_MESSAGE(strstr(error, reason), error);
    TEST_ASSERT_EQUAL_INT(-1, stream_fd(&a));
    char text[64];
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_FAILED, get(&a, text));
}

static void test_paths_that_cannot_be_used(void) {
    char big[STREAM_PATH_MAX + 2u];
    memset(big, 'x', sizeof big);
    big[sizeof big - 1u] = '\0';
    expect_refused("", "no path");
    expect_refused(big, "97 characters");
    expect_refused("/dev/null", "/dev/null: not a tty");
    expect_refused(folder, "neither a tty nor a socket");
    expect_refused("/nowhere/at/all", "/nowhere/at/all: No such file");
    FILE *file = fopen(path, "w");
    TEST_ASSERT_NOT_NULL(file);
    (void)fclose(file);
    expect_refused(path, "neither a tty nor a socket");
    TEST_ASSERT_EQUAL_INT(0, access(path, F_OK));
    char tiny[8] = "........";
    TEST_ASSERT_FALSE(stream_open(&a, "/dev/null", tiny, 4));
    TEST_ASSERT_EQUAL_STRING("/de", tiny);
    TEST_ASSERT_EQUAL_CHAR('.', tiny[4]);
}

static void expect_bad_word(const char *spec, const char *reason) {
    static can_port_t port;
    TEST_ASSERT_FALSE(can_open(&port, spec, NULL, 0, error, sizeof error));
    TEST_ASSERT_NOT_NULL_MESSAGE(strstr(error, reason), error);
    TEST_ASSERT_EQUAL_INT(-1, can_fd(&port));
    can_close(&port);
}

static void test_words_that_cannot_be_used(void) {
    static can_port_t port;
    const berth_can_filter_t bad = {0x800, 0x7ff, false};
    expect_bad_word("", "allowed: socketcan:INTERFACE");
    expect_bad_word("can0", "'can0'");
    expect_bad_word("socketCAN:can0", "allowed");
    expect_bad_word("slcan:", "slcan: stream: no path");
    expect_bad_word("slcan:/dev/null", "slcan: /dev/null: not a tty");
    expect_bad_word("socketcan:", "1 to 15 characters");
    expect_bad_word("socketcan:a-name-much-too-long", "1 to 15 characters");
    expect_bad_word("socketcan:berth-nowhere", "socketcan: interface 'berth-nowhere': ");
    TEST_ASSERT_FALSE(can_open(&port, "socketcan:vcan0", &bad, 1, error, sizeof error));
    TEST_ASSERT_NOT_NULL_MESSAGE(strstr(error, "filter"), error);
    TEST_ASSERT_FALSE(
        can_open(&port, "slcan:x", &bad, SOCKETCAN_FILTERS_MAX + 1u, error, sizeof error));
    TEST_ASSERT_NOT_NULL_MESSAGE(strstr(error, "65 filters"), error);
    TEST_ASSERT_FALSE(can_open(&port, "slcan:x", NULL, 1, error, sizeof error));
}

/* Frames between two ports over one path, and the descriptor that wakes the sleeper. */
static void test_frames_between_two_ports(void) {
    static can_port_t left, right;
    char spec[128];
    const berth_can_filter_t filter = {0x100, 0x700, false};
    berth_can_frame_t frame;
    (void)snprintf(spec, sizeof spec, "slcan:%s", path);
    TEST_ASSERT_TRUE_MESSAGE(can_open(&left, spec, &filter, 1, error, sizeof error), error);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, left.can.api->receive(left.can.context, &frame));
    TEST_ASSERT_TRUE_MESSAGE(can_open(&right, spec, NULL, 0, error, sizeof error), error);
    realtime_t timer;
    realtime_init(&timer, &left.wait);
    const berth_clock_t clock = realtime_clock(&timer);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, left.can.api->receive(left.can.context, &frame));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, right.can.api->receive(right.can.context, &frame));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, left.can.api->receive(left.can.context, &frame));
    for (uint32_t id = 0x90; id < 0x110u; id += 0x10u) {
        const berth_can_frame_t sent = {.id = id, .length = 1, .data = {(uint8_t)id}};
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, right.can.api->send(right.can.context, &sent));
    }
    const int64_t before_us = realtime_now_us();
    clock.api->sleep_until_us(clock.context, before_us + 5000000);
    TEST_ASSERT_TRUE(realtime_now_us() - before_us < 2000000);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, left.can.api->receive(left.can.context, &frame));
    TEST_ASSERT_EQUAL_HEX32(0x100, frame.id);
    TEST_ASSERT_TRUE(frame.time_us >= before_us && frame.time_us <= realtime_now_us());
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, left.can.api->receive(left.can.context, &frame));
    can_close(&right);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, left.can.api->receive(left.can.context, &frame));
    can_close(&left);
    can_close(&left);
    TEST_ASSERT_EQUAL_INT(-1, access(path, F_OK));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_socket_both_ends);
    RUN_TEST(test_listener_takes_the_next_peer);
    RUN_TEST(test_a_new_peer_is_never_joined_to_the_old);
    RUN_TEST(test_connected_end_finds_a_new_listener);
    RUN_TEST(test_a_dead_socket_is_replaced);
    RUN_TEST(test_close_leaves_another_ones_socket);
    RUN_TEST(test_two_processes_start_at_once);
    RUN_TEST(test_a_peer_that_stands_still_is_no_room);
    RUN_TEST(test_tty_is_raw);
    RUN_TEST(test_tty_unplugged_and_back);
    RUN_TEST(test_paths_that_cannot_be_used);
    RUN_TEST(test_words_that_cannot_be_used);
    RUN_TEST(test_frames_between_two_ports);
    return UNITY_END();
}
