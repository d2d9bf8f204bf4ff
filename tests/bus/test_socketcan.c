/* The SocketCAN driver on a real interface: a vcan whose name is in BERTH_VCAN. The test takes it
 * down, deletes it and makes it again, so it must be nobody else's, and the test needs
 * CAP_NET_ADMIN. Without BERTH_VCAN, or on a kernel without CAN, it says so and exits with 77.
 */
#include "can_open.h"
#include "realtime.h"
#include "socketcan.h"

#include "unity.h"

#include <errno.h>
#include <poll.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

/* The test speaks to the kernel itself for what the driver must not send: error frames. The
 * kernel's own headers are not used, so that the driver's idea of them is checked by numbers. */
#define FAMILY_CAN 29
#define CAN_RAW_PROTOCOL 1
#define ERROR_FRAME 0x20000000u
#define CLASS_CONTROLLER 0x004u
#define CLASS_PROTOCOL 0x008u
#define CLASS_ACKNOWLEDGE 0x020u
#define CLASS_BUS_OFF 0x040u
#define CLASS_RESTARTED 0x100u
#define CLASS_COUNTERS 0x200u

#define SKIPPED 77

static const char *name;
static socketcan_t a, b, injector;
static char error[CAN_OPEN_ERROR_MAX];

/* ---- Helpers -----------------------------------------------------------------------------------
 */

static int run(const char *format, ...) {
    char command[256];
    va_list arguments;
    va_start(arguments, format);
    (void)vsnprintf(command, sizeof command, format, arguments);
    va_end(arguments);
    return system(command);
}

static void link_up(void) {
    TEST_ASSERT_EQUAL_INT(0, run("ip link set %s up", name));
}

static void link_down(void) {
    TEST_ASSERT_EQUAL_INT(0, run("ip link set %s down", name));
}

static void open_bus(socketcan_t *bus, const berth_can_filter_t *filters, uint32_t count) {
    TEST_ASSERT_TRUE_MESSAGE(socketcan_open(bus, name, filters, count, error, sizeof error), error);
}

void setUp(void) {
    (void)run("ip link add %s type vcan 2>/dev/null", name);
    link_up();
    open_bus(&a, NULL, 0);
    open_bus(&b, NULL, 0);
}

void tearDown(void) {
    socketcan_close(&a);
    socketcan_close(&b);
    socketcan_close(&injector);
    (void)run("tc qdisc del dev %s root 2>/dev/null", name);
}

static berth_can_outcome_t put(socketcan_t *bus, const berth_can_frame_t *frame) {
    const berth_can_t can = socketcan_can(bus);
    return can.api->send(can.context, frame);
}

static berth_can_outcome_t get(socketcan_t *bus, berth_can_frame_t *frame) {
    const berth_can_t can = socketcan_can(bus);
    return can.api->receive(can.context, frame);
}

static berth_can_state_t state(socketcan_t *bus) {
    berth_can_state_t out;
    memset(&out, 0x5a, sizeof out);
    const berth_can_t can = socketcan_can(bus);
    can.api->state(can.context, &out);
    return out;
}

static void pause_ms(uint32_t ms) {
    (void)usleep(ms * 1000u);
}

/* Confirmations may be slow to come: then the flight is full. */
static void put_patiently(socketcan_t *bus, const berth_can_frame_t *frame) {
    berth_can_frame_t none;
    berth_can_outcome_t outcome = put(bus, frame);
    (void)get(bus, &none);
    for (int i = 0; i < 2000 && outcome == BERTH_CAN_AGAIN; i++) {
        pause_ms(1);
        (void)get(bus, &none);
        outcome = put(bus, frame);
    }
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, outcome);
}

/* vcan delivers through the receiving processor's soft interrupt: a moment later, at the latest. */
static void expect_frame(socketcan_t *bus, const berth_can_frame_t *want, berth_can_frame_t *got) {
    berth_can_outcome_t outcome = get(bus, got);
    for (int i = 0; i < 200 && outcome == BERTH_CAN_AGAIN; i++) {
        pause_ms(5);
        outcome = get(bus, got);
    }
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, outcome);
    TEST_ASSERT_EQUAL_HEX32(want->id, got->id);
    TEST_ASSERT_EQUAL_INT(want->extended, got->extended);
    TEST_ASSERT_EQUAL_INT(want->remote, got->remote);
    TEST_ASSERT_EQUAL_UINT8(want->length, got->length);
    TEST_ASSERT_EQUAL_HEX8_ARRAY(want->data, got->data, BERTH_CAN_DATA_MAX);
}

static void expect_none(socketcan_t *bus) {
    berth_can_frame_t frame;
    berth_can_frame_t before;
    memset(&frame, 0x5a, sizeof frame);
    before = frame;
    pause_ms(20);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, get(bus, &frame));
    TEST_ASSERT_EQUAL_MEMORY(&before, &frame, sizeof frame);
}

/* Within two seconds, calling receive as a loop does. */
static void expect_mode(socketcan_t *bus, berth_can_mode_t mode) {
    berth_can_frame_t frame;
    for (int i = 0; i < 400 && state(bus).mode != mode; i++) {
        (void)get(bus, &frame);
        pause_ms(5);
    }
    TEST_ASSERT_EQUAL_INT(mode, state(bus).mode);
}

static void drain(socketcan_t *bus) {
    berth_can_frame_t frame;
    pause_ms(20);
    while (get(bus, &frame) == BERTH_CAN_DONE) {
    }
}

typedef struct {
    uint32_t id;
    uint8_t length, pad, reserved, length8;
    uint8_t data[8];
} raw_frame_t;

_Static_assert(sizeof(raw_frame_t) == 16u, "the kernel's layout");

/* Puts a frame on the interface as it is, by a socket of another driver object. */
static void inject(uint32_t id, const uint8_t data[8]) {
    raw_frame_t frame = {.id = id, .length = 8};
    if (injector.fd < 0) {
        open_bus(&injector, NULL, 0);
    }
    memcpy(frame.data, data, sizeof frame.data);
    const ssize_t done = write(injector.fd, &frame, sizeof frame);
    TEST_ASSERT_EQUAL_INT_MESSAGE(sizeof frame, done, strerror(errno));
}

static void inject_error(uint32_t classes, uint8_t controller) {
    const uint8_t data[8] = {0, controller, 0, 0, 0, 0, 120, 130};
    inject(ERROR_FRAME | classes, data);
}

static const berth_can_frame_t small = {.id = 0x123, .length = 2, .data = {0xab, 0xcd}};

/* ---- Frames ------------------------------------------------------------------------------------
 */

static void test_frames_of_every_kind(void) {
    static const berth_can_frame_t frames[] = {
        {.id = 0, .length = 0},
        {.id = 0x7ff, .length = 8, .data = {1, 2, 3, 4, 5, 6, 7, 8}},
        {.id = 0, .extended = true, .length = 1, .data = {0xff}},
        {.id = 0x1fffffff, .extended = true, .length = 8, .data = {8, 7, 6, 5, 4, 3, 2, 1}},
        {.id = 0x55, .remote = true, .length = 5},
        {.id = 0x12345, .extended = true, .remote = true, .length = 0},
    };
    berth_can_frame_t got;
    for (size_t i = 0; i < sizeof frames / sizeof frames[0]; i++) {
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, put(&a, &frames[i]));
        expect_frame(&b, &frames[i], &got);
    }
    expect_none(&b);
    TEST_ASSERT_EQUAL_UINT32(6, socketcan_statistics(&b).received);
    TEST_ASSERT_EQUAL_UINT32(6, socketcan_statistics(&a).sent);
}

/* A remote frame's data is not sent, and not believed. */
static void test_remote_frames_carry_no_data(void) {
    const berth_can_frame_t sent = {.id = 1, .remote = true, .length = 2, .data = {1, 2}};
    const berth_can_frame_t want = {.id = 1, .remote = true, .length = 2};
    berth_can_frame_t got;
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, put(&a, &sent));
    expect_frame(&b, &want, &got);
    inject(0x40000000u | 1u, (const uint8_t[8]){9, 9, 9, 9, 9, 9, 9, 9});
    const berth_can_frame_t want8 = {.id = 1, .remote = true, .length = 8};
    expect_frame(&b, &want8, &got);
}

static void test_own_frames_confirm_and_are_not_received(void) {
    for (uint32_t i = 0; i < 10u; i++) {
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, put(&a, &small));
        expect_none(&a);
    }
    TEST_ASSERT_EQUAL_UINT32(10, socketcan_statistics(&a).sent);
    TEST_ASSERT_EQUAL_UINT32(10, socketcan_statistics(&a).confirmed);
    TEST_ASSERT_EQUAL_UINT32(0, socketcan_statistics(&a).received);
    TEST_ASSERT_EQUAL_UINT32(0, state(&a).tx_dropped);
    TEST_ASSERT_EQUAL_UINT32(0, socketcan_statistics(&b).confirmed);
}

static void test_filters(void) {
    static const berth_can_filter_t filters[] = {
        {0x120, 0x7f0, false}, {0x1000, 0x1fffffff, true}, {0x300, 0x7ff, false}};
    static const struct {
        uint32_t id;
        bool extended, wanted;
    } cases[] = {
        {0x120, false, true},  {0x12f, false, true},      {0x130, false, false},
        {0x120, true, false},  {0x1000, true, true},      {0x1001, true, false},
        {0x300, false, true},  {0x301, false, false},     {0, false, false},
        {0x7ff, false, false}, {0x1fffffff, true, false},
    };
    socketcan_close(&b);
    open_bus(&b, filters, 3);
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        const berth_can_frame_t frame = {.id = cases[i].id, .extended = cases[i].extended};
        berth_can_frame_t got;
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, put(&a, &frame));
        if (cases[i].wanted) {
            expect_frame(&b, &frame, &got);
        } else {
            expect_none(&b);
        }
    }
    const berth_can_frame_t remote = {.id = 0x300, .remote = true};
    berth_can_frame_t got;
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, put(&a, &remote));
    expect_frame(&b, &remote, &got);
}

/* So often a sender fetches its confirmations, lest its flight fills up. */
#define CONFIRM_EACH 16

/* Confirmations pass the kernel's filter though their ids are not wanted from others. */
static void test_sent_ids_are_confirmed_behind_filters(void) {
    static const berth_can_filter_t filter = {0x300, 0x7ff, false};
    socketcan_close(&b);
    open_bus(&b, &filter, 1);
    for (uint32_t i = 0; i < SOCKETCAN_SENT_IDS_MAX + 6u; i++) {
        const berth_can_frame_t frame = {.id = i, .extended = i % 2u == 0u};
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, put(&b, &frame));
        if (i % CONFIRM_EACH == 0) {
            expect_none(&b); /* which takes the confirmations */
        }
    }
    expect_none(&b);
    const socketcan_statistics_t statistics = socketcan_statistics(&b);
    TEST_ASSERT_EQUAL_UINT32(SOCKETCAN_SENT_IDS_MAX + 6u, statistics.sent);
    TEST_ASSERT_EQUAL_UINT32(SOCKETCAN_SENT_IDS_MAX, statistics.confirmed);
    TEST_ASSERT_EQUAL_UINT32(6, statistics.untracked);
    const berth_can_frame_t stolen = {.id = 1};
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, put(&a, &stolen));
    expect_none(&b);
    TEST_ASSERT_EQUAL_UINT32(1, socketcan_statistics(&b).foreign);
    TEST_ASSERT_EQUAL_UINT32(0, state(&b).tx_dropped);
}

static void test_stamps_are_monotonic_and_near(void) {
    int64_t last_us = 0;
    pause_ms(100); /* the kernel begins to stamp a moment after the first socket asks for it */
    for (int i = 0; i < 50; i++) {
        berth_can_frame_t got;
        const int64_t before_us = realtime_now_us();
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, put(&a, &small));
        const int64_t after_us = realtime_now_us();
        pause_ms(i % 5 == 0 ? 20u : 0u); /* waiting in the queue does not change the stamp */
        expect_frame(&b, &small, &got);
        TEST_ASSERT_TRUE(got.time_us >= last_us);
        TEST_ASSERT_TRUE(got.time_us >= before_us - 2000);
        TEST_ASSERT_TRUE(got.time_us <= after_us + 10000);
        last_us = got.time_us;
        if (i % CONFIRM_EACH == 0) {
            expect_none(&a);
        }
    }
    TEST_ASSERT_FALSE(socketcan_statistics(&b).hardware_stamps);
}

static void test_frames_out_of_range_are_refused(void) {
    static const berth_can_frame_t bad[] = {{.id = 0x800},
                                            {.id = UINT32_MAX},
                                            {.id = 0x20000000, .extended = true},
                                            {.id = 0x80000001, .extended = true},
                                            {.id = 1, .length = 9},
                                            {.id = 1, .length = 255, .remote = true}};
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, put(&a, &bad[i]));
    }
    expect_none(&b);
    TEST_ASSERT_EQUAL_UINT32(6, socketcan_statistics(&a).refused);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, state(&a).mode);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, put(&a, &small));
}

static void test_the_descriptor_wakes_a_sleeper(void) {
    struct pollfd item = {.fd = socketcan_fd(&b), .events = POLLIN};
    TEST_ASSERT_EQUAL_INT(0, poll(&item, 1, 0));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, put(&a, &small));
    TEST_ASSERT_EQUAL_INT(1, poll(&item, 1, 1000));
    berth_can_frame_t got;
    expect_frame(&b, &small, &got);
    TEST_ASSERT_EQUAL_INT(0, poll(&item, 1, 0));
}

/* ---- Queues ------------------------------------------------------------------------------------
 */

static void test_unconfirmed_frames_fill_the_flight(void) {
    uint32_t sent = 0;
    while (sent < 1000u && put(&a, &small) == BERTH_CAN_DONE) {
        sent++;
    }
    TEST_ASSERT_TRUE(sent <= SOCKETCAN_IN_FLIGHT_MAX);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, put(&a, &small));
    TEST_ASSERT_EQUAL_UINT32(2, socketcan_statistics(&a).queue_full);
    expect_none(&a);
    while (socketcan_statistics(&a).confirmed < sent) {
        expect_none(&a);
    }
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, put(&a, &small));
    TEST_ASSERT_EQUAL_UINT32(0, state(&a).tx_dropped);
}

/* A slow queue in front of the interface: the kernel has no room, nothing is lost, order is kept.
 */
static void test_a_full_queue_is_again(void) {
    if (run("tc qdisc add dev %s root netem delay 300ms limit 5 2>/dev/null", name) != 0) {
        TEST_IGNORE_MESSAGE("this kernel has no netem: a full kernel queue was not tried");
    }
    berth_can_frame_t frame = {.id = 0x100};
    uint32_t taken = 0;
    while (taken < 100u && put(&a, &frame) == BERTH_CAN_DONE) {
        taken++;
        frame.id++;
    }
    TEST_ASSERT_EQUAL_UINT32(5, taken);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, put(&a, &frame));
    TEST_ASSERT_EQUAL_UINT32(2, socketcan_statistics(&a).queue_full);
    TEST_ASSERT_EQUAL_UINT32(5, a.flight_count); /* slots of refused frames were given back */
    expect_none(&a);
    pause_ms(400);
    for (uint32_t i = 0; i < taken; i++) {
        const berth_can_frame_t want = {.id = 0x100u + i};
        berth_can_frame_t got;
        expect_frame(&b, &want, &got);
    }
    expect_none(&a);
    TEST_ASSERT_EQUAL_UINT32(5, socketcan_statistics(&a).confirmed);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, put(&a, &frame));
    TEST_ASSERT_EQUAL_UINT32(0, state(&a).tx_dropped);
}

/* Takes a's confirmations away, as if its frames had never gone out. */
static void steal_confirmations(uint32_t count) {
    for (uint32_t i = 0; i < count; i++) {
        raw_frame_t frame;
        struct pollfd item = {.fd = a.fd, .events = POLLIN};
        TEST_ASSERT_EQUAL_INT(1, poll(&item, 1, 1000));
        TEST_ASSERT_EQUAL_INT(sizeof frame, read(a.fd, &frame, sizeof frame));
    }
}

static void test_frames_that_never_go_out_are_counted(void) {
    for (int i = 0; i < 3; i++) {
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, put(&a, &small));
    }
    steal_confirmations(3);
    expect_none(&a);
    TEST_ASSERT_EQUAL_UINT32(0, state(&a).tx_dropped);
    pause_ms(1100);
    TEST_ASSERT_EQUAL_UINT32(3, state(&a).tx_dropped);
    TEST_ASSERT_EQUAL_UINT32(0, a.flight_count);
    TEST_ASSERT_EQUAL_UINT32(0, socketcan_statistics(&a).confirmed);
}

/* Of several, the one in the middle: the others are found all the same. */
static void test_one_lost_confirmation(void) {
    for (uint32_t i = 0; i < 5u; i++) {
        const berth_can_frame_t frame = {.id = 0x200u + i};
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, put(&a, &frame));
        if (i < 2u) {
            expect_none(&a);
        } else if (i == 2u) {
            steal_confirmations(1);
        }
    }
    expect_none(&a);
    TEST_ASSERT_EQUAL_UINT32(4, socketcan_statistics(&a).confirmed);
    TEST_ASSERT_EQUAL_UINT32(1, a.flight_count);
    TEST_ASSERT_EQUAL_HEX32(0x202, a.flight[a.flight_at].id);
    pause_ms(1100);
    TEST_ASSERT_EQUAL_UINT32(1, state(&a).tx_dropped);
}

/* In our own overflow, confirmations may be lost too: such frames are not called dropped. */
static void test_confirmations_lost_in_an_overflow(void) {
    const berth_can_frame_t last = {.id = 0x321};
    for (uint32_t i = 0; i < 1000u; i++) {
        put_patiently(&b, &small);
    }
    pause_ms(20);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, put(&a, &last));
    pause_ms(20);
    drain(&a);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, put(&b, &small));
    drain(&a);
    TEST_ASSERT_TRUE(state(&a).rx_lost > 0u);
    TEST_ASSERT_EQUAL_UINT32(0, socketcan_statistics(&a).confirmed);
    pause_ms(1100);
    TEST_ASSERT_EQUAL_UINT32(0, state(&a).tx_dropped);
    TEST_ASSERT_EQUAL_UINT32(1, socketcan_statistics(&a).unknown);
}

static void test_receive_overflow_is_counted(void) {
    for (uint32_t round = 1; round <= 3u; round++) {
        const uint32_t before = state(&b).rx_lost;
        for (uint32_t i = 0; i < 1000u; i++) {
            put_patiently(&a, &small); /* a fetches its confirmations, b nothing */
        }
        drain(&b);
        /* The kernel tells with the next frame that finds room. */
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, put(&a, &small));
        drain(&b);
        const uint32_t lost = state(&b).rx_lost;
        TEST_ASSERT_TRUE(lost > before);
        TEST_ASSERT_EQUAL_UINT32(round * 1001u, lost + socketcan_statistics(&b).received);
    }
    TEST_ASSERT_EQUAL_UINT32(0, state(&a).rx_lost);
    /* A new socket's count begins at 0. */
    link_down();
    expect_mode(&a, BERTH_CAN_DOWN);
    expect_mode(&b, BERTH_CAN_DOWN);
    link_up();
    expect_mode(&a, BERTH_CAN_ERROR_ACTIVE);
    expect_mode(&b, BERTH_CAN_ERROR_ACTIVE);
    for (uint32_t i = 0; i < 1000u; i++) {
        put_patiently(&a, &small);
    }
    drain(&b);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, put(&a, &small));
    drain(&b);
    TEST_ASSERT_EQUAL_UINT32(4004, state(&b).rx_lost + socketcan_statistics(&b).received);
}

/* ---- Down and up -------------------------------------------------------------------------------
 */

static void test_interface_down_and_up(void) {
    berth_can_frame_t got;
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, state(&a).mode);
    link_down();
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, put(&a, &small));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DOWN, state(&a).mode);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, get(&b, &got));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DOWN, state(&b).mode);
    pause_ms(200);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, get(&a, &got));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, put(&a, &small));
    TEST_ASSERT_EQUAL_INT(ENETDOWN, socketcan_statistics(&a).last_errno);
    TEST_ASSERT_EQUAL_INT(-1, socketcan_fd(&a));
    TEST_ASSERT_EQUAL_UINT32(0, state(&a).restarts);
    link_up();
    expect_mode(&a, BERTH_CAN_ERROR_ACTIVE);
    expect_mode(&b, BERTH_CAN_ERROR_ACTIVE);
    TEST_ASSERT_EQUAL_UINT32(1, state(&a).restarts);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, put(&a, &small));
    expect_frame(&b, &small, &got);
    expect_none(&a);
    TEST_ASSERT_EQUAL_UINT32(1, socketcan_statistics(&a).confirmed);
}

/* Faster than anybody looked. */
static void test_a_short_outage_is_noticed(void) {
    berth_can_frame_t got;
    link_down();
    link_up();
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, get(&a, &got));
    expect_mode(&a, BERTH_CAN_ERROR_ACTIVE);
    TEST_ASSERT_EQUAL_UINT32(1, state(&a).restarts);
}

static void test_state_alone_finds_the_interface(void) {
    berth_can_frame_t got;
    link_down();
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, get(&a, &got));
    link_up();
    for (int i = 0; i < 100 && state(&a).mode != BERTH_CAN_ERROR_ACTIVE; i++) {
        pause_ms(10);
    }
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, state(&a).mode);
}

static void test_interface_deleted_and_made_again(void) {
    static const berth_can_filter_t filter = {0x120, 0x7f0, false};
    berth_can_frame_t got;
    socketcan_close(&b);
    open_bus(&b, &filter, 1);
    for (uint32_t round = 1; round <= 2u; round++) {
        TEST_ASSERT_EQUAL_INT(0, run("ip link del %s", name));
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, put(&a, &small));
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, get(&b, &got));
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DOWN, state(&a).mode);
        pause_ms(150);
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, put(&a, &small));
        TEST_ASSERT_EQUAL_INT(ENODEV, socketcan_statistics(&a).last_errno);
        TEST_ASSERT_EQUAL_INT(0, run("ip link add dev %s type vcan", name));
        pause_ms(100);
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, get(&a, &got)); /* not up yet */
        link_up();
        expect_mode(&a, BERTH_CAN_ERROR_ACTIVE);
        expect_mode(&b, BERTH_CAN_ERROR_ACTIVE);
        TEST_ASSERT_EQUAL_UINT32(round, state(&a).restarts);
        const berth_can_frame_t unwanted = {.id = 0x130};
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, put(&a, &unwanted));
        expect_none(&b); /* filters are as they were */
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, put(&a, &small));
        expect_frame(&b, &small, &got);
    }
}

static void test_open_while_down(void) {
    link_down();
    socketcan_close(&a);
    open_bus(&a, NULL, 0);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DOWN, state(&a).mode);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, put(&a, &small));
    link_up();
    expect_mode(&a, BERTH_CAN_ERROR_ACTIVE);
}

static void test_frames_in_flight_are_dropped_when_it_goes_down(void) {
    for (int i = 0; i < 3; i++) {
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, put(&a, &small));
    }
    link_down(); /* the confirmations are in the queue, but nobody fetched them: not known */
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, put(&a, &small));
    TEST_ASSERT_EQUAL_UINT32(3, state(&a).tx_dropped);
    TEST_ASSERT_EQUAL_UINT32(0, a.flight_count);
}

/* ---- Errors on the bus -------------------------------------------------------------------------
 */

static void test_passive_and_active_again(void) {
    berth_can_frame_t got;
    inject_error(CLASS_CONTROLLER | CLASS_COUNTERS, 0x20); /* transmit counter over 127 */
    expect_mode(&a, BERTH_CAN_ERROR_PASSIVE);
    TEST_ASSERT_EQUAL_UINT8(120, socketcan_statistics(&a).tx_errors);
    TEST_ASSERT_EQUAL_UINT8(130, socketcan_statistics(&a).rx_errors);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, put(&a, &small)); /* frames still get through */
    expect_frame(&b, &small, &got);
    inject_error(CLASS_CONTROLLER, 0x40);
    expect_mode(&a, BERTH_CAN_ERROR_ACTIVE);
    inject_error(CLASS_CONTROLLER, 0x10); /* receive counter */
    expect_mode(&a, BERTH_CAN_ERROR_PASSIVE);
    inject_error(CLASS_CONTROLLER, 0x08); /* back at the warning level */
    expect_mode(&a, BERTH_CAN_ERROR_ACTIVE);
    inject_error(CLASS_CONTROLLER, 0x01); /* the controller's own overflow */
    expect_none(&a);
    TEST_ASSERT_EQUAL_UINT32(1, state(&a).rx_lost);
    TEST_ASSERT_EQUAL_UINT32(5, state(&a).error_frames);
    TEST_ASSERT_EQUAL_UINT32(5, socketcan_statistics(&a).errors.controller);
    TEST_ASSERT_EQUAL_UINT32(0, state(&a).restarts);
}

static void test_error_frames_by_class(void) {
    static const berth_can_filter_t filter = {0x300, 0x7ff, false};
    socketcan_close(&a);
    open_bus(&a, &filter, 1); /* error frames come whatever the filters */
    inject_error(CLASS_PROTOCOL | CLASS_ACKNOWLEDGE, 0);
    inject_error(CLASS_PROTOCOL, 0);
    inject_error(0x1ffffc97u, 0); /* every other class, and bits that mean nothing */
    expect_none(&a);
    const socketcan_errors_t errors = socketcan_statistics(&a).errors;
    TEST_ASSERT_EQUAL_UINT32(2, errors.protocol);
    TEST_ASSERT_EQUAL_UINT32(1, errors.no_acknowledge);
    TEST_ASSERT_EQUAL_UINT32(1, errors.tx_timeout);
    TEST_ASSERT_EQUAL_UINT32(1, errors.lost_arbitration);
    TEST_ASSERT_EQUAL_UINT32(1, errors.controller);
    TEST_ASSERT_EQUAL_UINT32(1, errors.transceiver);
    TEST_ASSERT_EQUAL_UINT32(1, errors.bus_error);
    TEST_ASSERT_EQUAL_UINT32(0, errors.bus_off);
    TEST_ASSERT_EQUAL_UINT32(3, state(&a).error_frames);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, state(&a).mode);
}

static void go_off(void) {
    berth_can_frame_t got;
    inject_error(CLASS_BUS_OFF, 0);
    expect_mode(&a, BERTH_CAN_BUS_OFF);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, put(&a, &small));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, get(&a, &got));
    TEST_ASSERT_EQUAL_UINT32(1, socketcan_statistics(&a).errors.bus_off);
    TEST_ASSERT_EQUAL_UINT32(0, state(&a).restarts);
}

static void expect_on_again(void) {
    berth_can_frame_t got;
    expect_mode(&a, BERTH_CAN_ERROR_ACTIVE);
    TEST_ASSERT_EQUAL_UINT32(1, state(&a).restarts);
    socketcan_close(&b); /* the error frame was for it as well */
    open_bus(&b, NULL, 0);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, put(&a, &small));
    expect_frame(&b, &small, &got);
}

static void test_bus_off_until_restarted(void) {
    inject_error(CLASS_CONTROLLER, 0x30);
    expect_mode(&a, BERTH_CAN_ERROR_PASSIVE);
    go_off();
    inject_error(CLASS_RESTARTED, 0);
    expect_on_again();
}

/* What the controller still had will not go out: old commands must not wait for the bus to return.
 */
static void test_frames_in_flight_are_dropped_at_bus_off(void) {
    for (int i = 0; i < 2; i++) {
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, put(&a, &small));
    }
    steal_confirmations(2);
    go_off();
    TEST_ASSERT_EQUAL_UINT32(2, state(&a).tx_dropped);
    TEST_ASSERT_EQUAL_UINT32(0, a.flight_count);
}

static void test_bus_off_until_asked(void) {
    TEST_ASSERT_FALSE(socketcan_restart(&a)); /* not off */
    go_off();
    TEST_ASSERT_TRUE(socketcan_restart(&a)); /* vcan has no restart: error active at once */
    TEST_ASSERT_EQUAL_INT(EOPNOTSUPP, socketcan_statistics(&a).restart_errno);
    expect_on_again();
}

static void test_bus_off_asks_for_a_restart_at_a_bounded_rate(void) {
    berth_can_frame_t got;
    go_off();
    const int64_t start_us = realtime_now_us();
    while (realtime_now_us() - start_us < 1500000) {
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, get(&a, &got));
        pause_ms(5);
    }
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_BUS_OFF, state(&a).mode); /* silence proves nothing */
    const uint32_t asked = socketcan_statistics(&a).restarts_asked;
    TEST_ASSERT_TRUE(asked >= 1u && asked <= 3u);
    TEST_ASSERT_EQUAL_INT(EOPNOTSUPP, socketcan_statistics(&a).restart_errno);
}

static void test_bus_off_until_frames_come_in(void) {
    berth_can_frame_t got;
    go_off();
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, put(&b, &small)); /* too soon: from the queue, maybe */
    pause_ms(20);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, get(&a, &got));
    TEST_ASSERT_EQUAL_UINT32(1, socketcan_statistics(&a).discarded);
    pause_ms(600);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, get(&a, &got));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, put(&b, &small));
    pause_ms(20);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, get(&a, &got));
    TEST_ASSERT_EQUAL_HEX32(small.id, got.id);
    expect_on_again();
}

static void test_bus_off_until_down_and_up(void) {
    berth_can_frame_t got;
    inject_error(CLASS_CONTROLLER, 0x30);
    expect_mode(&a, BERTH_CAN_ERROR_PASSIVE);
    go_off();
    link_down();
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, get(&a, &got));
    link_up();
    expect_on_again();
}

/* ---- Opening -----------------------------------------------------------------------------------
 */

static void expect_refused(const char *interface, const berth_can_filter_t *filters, uint32_t count,
                           const char *reason) {
    static socketcan_t bus;
    TEST_ASSERT_FALSE(socketcan_open(&bus, interface, filters, count, error, sizeof error));
    TEST_ASSERT_NOT_NULL_MESSAGE(strstr(error, reason), error);
    TEST_ASSERT_EQUAL_INT(-1, socketcan_fd(&bus));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DOWN, state(&bus).mode);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, put(&bus, &small));
    socketcan_close(&bus);
}

static void test_open_refuses_with_a_reason(void) {
    static const berth_can_filter_t wide = {0x800, 0x7ff, false};
    static const berth_can_filter_t wide29 = {0x20000000, 0, true};
    expect_refused("", NULL, 0, "1 to 15 characters");
    expect_refused("a234567890123456", NULL, 0, "1 to 15 characters");
    expect_refused("berth-none", NULL, 0, "no such interface");
    expect_refused("lo", NULL, 0, "'lo': not a CAN interface");
    expect_refused(name, &wide, 1, "a filter's id");
    expect_refused(name, &wide29, 1, "a filter's id");
    expect_refused(name, NULL, 1, "0 to 64 filters");
    expect_refused(name, &wide, SOCKETCAN_FILTERS_MAX + 1u, "0 to 64 filters");
}

static void test_by_its_word(void) {
    static can_port_t port;
    char spec[64];
    berth_can_frame_t got;
    static const berth_can_filter_t filter = {0x123, 0x7ff, false};
    (void)snprintf(spec, sizeof spec, "socketcan:%s", name);
    TEST_ASSERT_TRUE_MESSAGE(can_open(&port, spec, &filter, 1, error, sizeof error), error);
    TEST_ASSERT_EQUAL_INT(socketcan_fd(&port.socketcan), port.wait.fd(port.wait.context));
    const berth_can_frame_t other = {.id = 0x124};
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, put(&a, &other));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, put(&a, &small));
    realtime_t timer;
    realtime_init(&timer, &port.wait);
    const berth_clock_t clock = realtime_clock(&timer);
    clock.api->sleep_until_us(clock.context, realtime_now_us() + 1000000);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, port.can.api->receive(port.can.context, &got));
    TEST_ASSERT_EQUAL_HEX32(0x123, got.id);
    can_close(&port);
    TEST_ASSERT_EQUAL_INT(-1, can_fd(&port));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, port.can.api->receive(port.can.context, &got));
}

/* ---- Cost --------------------------------------------------------------------------------------
 */

static void test_cost(void) {
    const uint32_t frames = 20000;
    berth_can_frame_t got;
    const int64_t start_us = realtime_now_us();
    uint32_t received = 0;
    for (uint32_t i = 0; i < frames; i++) {
        put_patiently(&a, &small);
        received += get(&b, &got) == BERTH_CAN_DONE ? 1u : 0u;
    }
    const int64_t spent_us = realtime_now_us() - start_us;
    drain(&a);
    berth_can_outcome_t outcome = BERTH_CAN_DONE;
    for (int i = 0; i < 50; i++) {
        while ((outcome = get(&b, &got)) == BERTH_CAN_DONE) {
            received++;
        }
        pause_ms(2);
    }
    TEST_ASSERT_EQUAL_UINT32(frames, received);
    TEST_ASSERT_EQUAL_UINT32(frames, socketcan_statistics(&a).confirmed);
    printf("send, confirm and receive: %.2f us a frame\n", (double)spent_us / (double)frames);
}

static int skip(const char *why) {
    fprintf(stderr, "test_socketcan SKIPPED: %s\n", why);
    return SKIPPED;
}

int main(void) {
    name = getenv("BERTH_VCAN");
    if (name == NULL || name[0] == '\0') {
        return skip("BERTH_VCAN names no vcan interface that this test may take down and delete");
    }
    const int probe = socket(FAMILY_CAN, SOCK_RAW, CAN_RAW_PROTOCOL);
    if (probe < 0) {
        return skip("this kernel has no CAN");
    }
    (void)close(probe);
    injector.fd = -1;
    UNITY_BEGIN();
    RUN_TEST(test_frames_of_every_kind);
    RUN_TEST(test_remote_frames_carry_no_data);
    RUN_TEST(test_own_frames_confirm_and_are_not_received);
    RUN_TEST(test_filters);
    RUN_TEST(test_sent_ids_are_confirmed_behind_filters);
    RUN_TEST(test_stamps_are_monotonic_and_near);
    RUN_TEST(test_frames_out_of_range_are_refused);
    RUN_TEST(test_the_descriptor_wakes_a_sleeper);
    RUN_TEST(test_unconfirmed_frames_fill_the_flight);
    RUN_TEST(test_a_full_queue_is_again);
    RUN_TEST(test_frames_that_never_go_out_are_counted);
    RUN_TEST(test_one_lost_confirmation);
    RUN_TEST(test_confirmations_lost_in_an_overflow);
    RUN_TEST(test_receive_overflow_is_counted);
    RUN_TEST(test_interface_down_and_up);
    RUN_TEST(test_a_short_outage_is_noticed);
    RUN_TEST(test_state_alone_finds_the_interface);
    RUN_TEST(test_interface_deleted_and_made_again);
    RUN_TEST(test_open_while_down);
    RUN_TEST(test_frames_in_flight_are_dropped_when_it_goes_down);
    RUN_TEST(test_passive_and_active_again);
    RUN_TEST(test_error_frames_by_class);
    RUN_TEST(test_bus_off_until_restarted);
    RUN_TEST(test_frames_in_flight_are_dropped_at_bus_off);
    RUN_TEST(test_bus_off_until_asked);
    RUN_TEST(test_bus_off_asks_for_a_restart_at_a_bounded_rate);
    RUN_TEST(test_bus_off_until_frames_come_in);
    RUN_TEST(test_bus_off_until_down_and_up);
    RUN_TEST(test_open_refuses_with_a_reason);
    RUN_TEST(test_by_its_word);
    RUN_TEST(test_cost);
    /* For whoever comes next. */
    (void)run("ip link add %s type vcan 2>/dev/null", name);
    (void)run("ip link set %s up", name);
    return UNITY_END();
}
