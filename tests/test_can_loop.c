/* The loop bus without faults: times, arbitration, queues, filters, clock and load. */
#include "can_rig.h"
#include "support.h"

static rig_t rig;
static rig_t twin;

void setUp(void) {
    rig_start(&rig, 3);
}

void tearDown(void) {}

static berth_can_frame_t random_frame(void) {
    berth_can_frame_t f = {.extended = support_index(2) == 0, .remote = support_index(8) == 0};
    f.id = support_index(f.extended ? 1u << 29 : 1u << 11);
    f.length = (uint8_t)support_index(9);
    const bool flat = support_index(3) == 0;
    for (int i = 0; i < 8; i++) {
        f.data[i] = flat ? 0 : (uint8_t)support_index(256);
    }
    return f;
}

static int64_t up_us(int64_t ns) {
    return (ns + 999) / 1000;
}

/* At each bit rate: the frame is there after its bits, not a microsecond earlier. */
static void test_exact_frame_times(void) {
    static const uint32_t rates[] = {1000000, 800000, 500000, 250000, 125000,
                                     100000,  50000,  20000,  10000,  1000};
    support_random_start();
    for (size_t r = 0; r < sizeof rates / sizeof rates[0]; r++) {
        for (int i = 0; i < 20; i++) {
            const int64_t begin_us = (int64_t)support_index(1000000);
            const berth_can_frame_t f = random_frame();
            rig_start_at(&rig, 2, rates[r], begin_us);
            const int64_t bit_ns = 1000000000 / rates[r];
            const int64_t end_ns = begin_us * 1000 + can_text_bits(&f) * bit_ns;
            TEST_ASSERT_EQUAL_INT64(CAN_LOOP_NEVER, can_loop_deadline(&rig.loop));
            TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, rig_send(&rig, 0, &f));
            TEST_ASSERT_EQUAL_INT64(up_us(end_ns), can_loop_deadline(&rig.loop));
            can_loop_run(&rig.loop, up_us(end_ns) - 1);
            TEST_ASSERT_EQUAL_INT64(up_us(end_ns), can_loop_deadline(&rig.loop));
            rig_gets_nothing(&rig, 1);
            can_loop_run(&rig.loop, up_us(end_ns));
            berth_can_frame_t got;
            TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, rig_receive(&rig, 1, &got));
            TEST_ASSERT_EQUAL_INT64(up_us(end_ns), got.time_us);
            TEST_ASSERT_EQUAL_HEX32(f.id, got.id);
            TEST_ASSERT_EQUAL_INT(f.extended, got.extended);
            TEST_ASSERT_EQUAL_INT(f.remote, got.remote);
            TEST_ASSERT_EQUAL_UINT8(f.length, got.length);
            TEST_ASSERT_EQUAL_MEMORY(f.data, got.data, 8);
            TEST_ASSERT_EQUAL_INT64(begin_us * 1000, rig.events[0].start_ns);
            TEST_ASSERT_EQUAL_INT64(end_ns, rig.events[0].end_ns);
            TEST_ASSERT_FALSE(rig.events[0].error);
        }
    }
}

static void test_intermission_between_frames(void) {
    int64_t at_ns = 0;
    for (uint32_t id = 0; id < 20; id++) {
        rig_sends(&rig, 0, id * 97);
    }
    can_loop_run(&rig.loop, 10000);
    TEST_ASSERT_EQUAL_UINT32(20, rig.event_count);
    for (uint32_t i = 0; i < 20; i++) {
        TEST_ASSERT_EQUAL_INT64(at_ns, rig.events[i].start_ns);
        at_ns += rig_bits(0, i * 97) * RIG_BIT_NS;
        TEST_ASSERT_EQUAL_INT64(at_ns, rig.events[i].end_ns);
        at_ns += 3 * RIG_BIT_NS;
        rig_gets(&rig, 1, i * 97);
    }
    TEST_ASSERT_EQUAL_INT64(at_ns, can_loop_busy_ns(&rig.loop));
}

/* Sent at one instant, in whatever order of calls: the smallest goes first. */
static void test_one_instant_arbitrates_together(void) {
    rig_sends(&rig, 2, 0x300);
    can_loop_run(&rig.loop, 0);
    rig_sends(&rig, 1, 0x200);
    can_loop_run(&rig.loop, 0);
    rig_sends(&rig, 0, 0x100);
    can_loop_run(&rig.loop, 5000);
    TEST_ASSERT_EQUAL_UINT32(3, rig.event_count);
    for (uint32_t i = 0; i < 3; i++) {
        TEST_ASSERT_EQUAL_UINT32(i, rig.events[i].node);
        TEST_ASSERT_EQUAL_UINT64(i, rig.events[i].index);
    }
}

/* A frame under way is not overtaken by a better one that comes a microsecond later. */
static void test_no_preemption(void) {
    rig_sends(&rig, 0, 0x700);
    can_loop_run(&rig.loop, 1);
    rig_sends(&rig, 1, 0x001);
    can_loop_run(&rig.loop, 5000);
    TEST_ASSERT_EQUAL_UINT32(0, rig.events[0].node);
    TEST_ASSERT_EQUAL_UINT32(1, rig.events[1].node);
}

/* A node's better frame behind its worse one does not help it: its queue is first in, first out. */
static void test_oldest_frame_arbitrates(void) {
    rig_sends(&rig, 0, 0x400);
    rig_sends(&rig, 0, 0x001);
    rig_sends(&rig, 1, 0x200);
    can_loop_run(&rig.loop, 5000);
    static const uint32_t expected[] = {0x200, 0x400, 0x001};
    for (uint32_t i = 0; i < 3; i++) {
        TEST_ASSERT_EQUAL_HEX32(expected[i], rig.events[i].frame.id);
    }
}

static void test_formats_with_the_same_base(void) {
    rig_start(&rig, 5);
    const berth_can_frame_t frames[] = {
        {.id = 0x123u << 18 | 5, .extended = true, .remote = true},
        {.id = 0x123u << 18 | 5, .extended = true},
        {.id = 0x123, .remote = true},
        {.id = 0x123},
    };
    for (uint32_t i = 0; i < 4; i++) {
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, rig_send(&rig, i, &frames[i]));
    }
    can_loop_run(&rig.loop, 5000);
    for (uint32_t i = 0; i < 4; i++) {
        TEST_ASSERT_EQUAL_UINT32(3 - i, rig.events[i].node);
    }
    /* the same identifier from two nodes: the lower number first */
    rig_sends(&rig, 3, 0x50);
    rig_sends(&rig, 1, 0x50);
    can_loop_run(&rig.loop, 10000);
    TEST_ASSERT_EQUAL_UINT32(1, rig.events[4].node);
    TEST_ASSERT_EQUAL_UINT32(3, rig.events[5].node);
}

/* A brute-force bus: at each free instant the waiting fronts put their bits on a wired-and, and
 * whoever reads another bit than it sent drops out. */
#define MODEL_NODES 5u
#define MODEL_FRAMES 60u

typedef struct {
    berth_can_frame_t frame;
    int64_t at_us;
    uint32_t node;
} traffic_t;

static traffic_t traffic[MODEL_FRAMES];
static traffic_t *lines[MODEL_NODES][MODEL_FRAMES];
static uint32_t line_first[MODEL_NODES];
static uint32_t line_count[MODEL_NODES];

/* Frames in order of time. Each node has identifiers of its own, else nobody can win. */
static void make_traffic(void) {
    memset(line_first, 0, sizeof line_first);
    memset(line_count, 0, sizeof line_count);
    const bool crowded = support_index(2) == 0;
    int64_t at_us = 0;
    for (uint32_t i = 0; i < MODEL_FRAMES; i++) {
        traffic_t *t = &traffic[i];
        *t = (traffic_t){random_frame(), at_us, support_index(MODEL_NODES)};
        while (line_count[t->node] == CAN_LOOP_TX_MAX) {
            t->node = (t->node + 1) % MODEL_NODES;
        }
        const uint32_t few = support_index(6) * MODEL_NODES + t->node;
        t->frame.id = t->frame.extended ? (few << 18 | support_index(4)) : few;
        lines[t->node][line_count[t->node]] = t;
        line_count[t->node]++;
        at_us += support_index(4) == 0 ? (int64_t)support_index(crowded ? 100 : 400) : 0;
    }
}

static uint32_t wired_and(const bool *takes_part) {
    can_text_t texts[MODEL_NODES];
    bool in[MODEL_NODES];
    for (uint32_t n = 0; n < MODEL_NODES; n++) {
        in[n] = takes_part[n];
        if (in[n]) {
            texts[n] = can_text_arbitration(&lines[n][line_first[n]]->frame);
            strcat(texts[n].text, "1"); /* so that the loop below may look one bit further */
        }
    }
    for (uint32_t bit = 0; bit < 32; bit++) {
        char wire = '1';
        for (uint32_t n = 0; n < MODEL_NODES; n++) {
            if (in[n] && bit < strlen(texts[n].text) && texts[n].text[bit] == '0') {
                wire = '0';
            }
        }
        for (uint32_t n = 0; n < MODEL_NODES; n++) {
            in[n] = in[n] && (bit >= strlen(texts[n].text) || texts[n].text[bit] == wire);
        }
    }
    uint32_t winner = MODEL_NODES;
    for (uint32_t n = 0; n < MODEL_NODES; n++) {
        if (in[n]) {
            TEST_ASSERT_EQUAL_UINT32(MODEL_NODES, winner);
            winner = n;
        }
    }
    return winner;
}

static bool waits(uint32_t node) {
    return line_first[node] < line_count[node];
}

/* Compares what the rig has seen with what the brute-force bus does. */
static void expect_as_modelled(void) {
    int64_t idle_ns = 0;
    for (uint32_t i = 0; i < MODEL_FRAMES; i++) {
        int64_t start_ns = INT64_MAX;
        for (uint32_t n = 0; n < MODEL_NODES; n++) {
            if (waits(n) && lines[n][line_first[n]]->at_us * 1000 < start_ns) {
                start_ns = lines[n][line_first[n]]->at_us * 1000;
            }
        }
        start_ns = start_ns > idle_ns ? start_ns : idle_ns;
        bool takes_part[MODEL_NODES];
        for (uint32_t n = 0; n < MODEL_NODES; n++) {
            takes_part[n] = waits(n) && lines[n][line_first[n]]->at_us * 1000 <= start_ns;
        }
        const uint32_t winner = wired_and(takes_part);
        TEST_ASSERT_TRUE(winner < MODEL_NODES);
        const traffic_t *t = lines[winner][line_first[winner]];
        line_first[winner]++;
        const can_loop_event_t *e = &rig.events[i];
        TEST_ASSERT_EQUAL_UINT32(winner, e->node);
        TEST_ASSERT_EQUAL_HEX32(t->frame.id, e->frame.id);
        TEST_ASSERT_EQUAL_INT64(start_ns, e->start_ns);
        TEST_ASSERT_EQUAL_INT64(start_ns + can_text_bits(&t->frame) * RIG_BIT_NS, e->end_ns);
        idle_ns = e->end_ns + 3 * RIG_BIT_NS;
    }
}

/* Puts the traffic on a rig. Stepwise: with many more runs in between than it needs. */
static void play_traffic(rig_t *on, bool stepwise) {
    rig_start(on, MODEL_NODES);
    for (uint32_t i = 0; i < MODEL_FRAMES; i++) {
        while (stepwise && can_loop_now_us(&on->loop) < traffic[i].at_us) {
            int64_t next_us = can_loop_now_us(&on->loop) + (int64_t)support_index(30);
            can_loop_run(&on->loop, next_us < traffic[i].at_us ? next_us : traffic[i].at_us);
        }
        can_loop_run(&on->loop, traffic[i].at_us);
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, rig_send(on, traffic[i].node, &traffic[i].frame));
    }
    while (can_loop_deadline(&on->loop) != CAN_LOOP_NEVER) {
        can_loop_run(&on->loop, can_loop_deadline(&on->loop));
    }
    TEST_ASSERT_EQUAL_UINT32(MODEL_FRAMES, on->event_count);
}

static void test_arbitration_against_brute_force(void) {
    support_random_start();
    const uint32_t runs = support_runs(500);
    for (uint32_t i = 0; i < runs; i++) {
        make_traffic();
        play_traffic(&rig, false);
        expect_as_modelled();
    }
}

/* What happens does not depend on how often the bus is run. */
static void test_steps_do_not_matter(void) {
    support_random_start();
    const uint32_t runs = support_runs(100);
    for (uint32_t i = 0; i < runs; i++) {
        make_traffic();
        play_traffic(&rig, false);
        play_traffic(&twin, true);
        rig_expect_same_events(&rig, &twin);
        TEST_ASSERT_EQUAL_INT64(can_loop_busy_ns(&rig.loop), can_loop_busy_ns(&twin.loop));
        for (uint32_t n = 0; n < MODEL_NODES; n++) {
            berth_can_frame_t a;
            berth_can_frame_t b;
            memset(&a, 0, sizeof a);
            memset(&b, 0, sizeof b);
            while (rig_receive(&rig, n, &a) == BERTH_CAN_DONE) {
                TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, rig_receive(&twin, n, &b));
                TEST_ASSERT_EQUAL_INT64(a.time_us, b.time_us);
                TEST_ASSERT_EQUAL_HEX32(a.id, b.id);
            }
            rig_gets_nothing(&twin, n);
        }
    }
}

/* Everybody else gets it, once; the sender does not. */
static void test_own_frames_are_not_received(void) {
    rig_sends(&rig, 1, 0x77);
    can_loop_run(&rig.loop, 1000);
    rig_gets_nothing(&rig, 1);
    rig_gets(&rig, 0, 0x77);
    rig_gets(&rig, 2, 0x77);
    rig_gets_nothing(&rig, 0);
    rig_gets_nothing(&rig, 2);
}

static void test_full_transmit_queue(void) {
    can_loop_depths(&rig.loop, 0, 4, 100);
    const berth_can_frame_t f = {.id = 1};
    for (int i = 0; i < 4; i++) {
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, rig_send(&rig, 0, &f));
    }
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, rig_send(&rig, 0, &f));
    TEST_ASSERT_EQUAL_UINT32(4, can_loop_waiting(&rig.loop, 0));
    const int64_t end_us = can_loop_deadline(&rig.loop);
    can_loop_run(&rig.loop, end_us - 1); /* a frame under way still takes its place */
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, rig_send(&rig, 0, &f));
    can_loop_run(&rig.loop, end_us);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, rig_send(&rig, 0, &f));
    can_loop_run(&rig.loop, 10000);
    TEST_ASSERT_EQUAL_UINT64(5, can_loop_counters(&rig.loop, 0)->sent);
    TEST_ASSERT_EQUAL_UINT64(2, can_loop_counters(&rig.loop, 0)->refused);
    TEST_ASSERT_EQUAL_UINT32(0, rig_state(&rig, 0).tx_dropped);
    /* depths are clamped */
    can_loop_depths(&rig.loop, 0, 0, 0);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, rig_send(&rig, 0, &f));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, rig_send(&rig, 0, &f));
    can_loop_depths(&rig.loop, 0, UINT32_MAX, UINT32_MAX);
    for (uint32_t i = 1; i < CAN_LOOP_TX_MAX; i++) {
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, rig_send(&rig, 0, &f));
    }
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_AGAIN, rig_send(&rig, 0, &f));
}

static void test_full_receive_queue(void) {
    can_loop_depths(&rig.loop, 1, 4, 3);
    for (uint32_t id = 0; id < 10; id++) {
        rig_sends(&rig, 0, id);
    }
    can_loop_run(&rig.loop, 10000);
    TEST_ASSERT_EQUAL_UINT32(7, rig_state(&rig, 1).rx_lost);
    for (uint32_t id = 0; id < 3; id++) {
        rig_gets(&rig, 1, id); /* the oldest are kept */
    }
    rig_gets_nothing(&rig, 1);
    TEST_ASSERT_EQUAL_UINT32(0, rig_state(&rig, 2).rx_lost);
    TEST_ASSERT_EQUAL_UINT64(10, can_loop_counters(&rig.loop, 2)->received);
}

static void test_queues_wrap_around(void) {
    uint32_t next = 0;
    for (uint32_t id = 0; id < 3 * CAN_LOOP_RX_MAX; id++) {
        rig_sends(&rig, 0, id);
        if (id % 3 == 2) {
            can_loop_run(&rig.loop, can_loop_now_us(&rig.loop) + 1000);
            for (; next <= id; next++) {
                rig_gets(&rig, 1, next);
            }
        }
    }
    TEST_ASSERT_EQUAL_UINT32(0, rig_state(&rig, 1).rx_lost);
}

static void test_filters(void) {
    const berth_can_filter_t node3 = {.id = 3u << 5, .mask = 0x7e0};
    const berth_can_filter_t packet = {.id = 0x0905, .mask = 0xffff, .extended = true};
    TEST_ASSERT_TRUE(can_loop_filter(&rig.loop, 1, &node3));
    TEST_ASSERT_TRUE(can_loop_filter(&rig.loop, 1, &packet));
    const berth_can_frame_t frames[] = {
        {.id = 3u << 5 | 9},
        {.id = 4u << 5 | 9},
        {.id = 0x0905, .extended = true},
        {.id = 0x105},
        {.id = 3u << 5, .extended = true},
        {.id = 0x10905, .extended = true},
    };
    for (size_t i = 0; i < 6; i++) {
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE, rig_send(&rig, 0, &frames[i]));
    }
    can_loop_run(&rig.loop, 10000);
    rig_gets(&rig, 1, 3u << 5 | 9);
    rig_gets(&rig, 1, 0x0905);
    rig_gets(&rig, 1, 0x10905);
    rig_gets_nothing(&rig, 1);
    TEST_ASSERT_EQUAL_UINT64(3, can_loop_counters(&rig.loop, 1)->filtered);
    TEST_ASSERT_EQUAL_UINT32(0, rig_state(&rig, 1).rx_lost);
    TEST_ASSERT_EQUAL_UINT64(6, can_loop_counters(&rig.loop, 2)->received);
    can_loop_filter_clear(&rig.loop, 1);
    rig_sends(&rig, 0, 0x111);
    can_loop_run(&rig.loop, 20000);
    rig_gets(&rig, 1, 0x111);
    for (uint32_t i = 0; i < CAN_LOOP_FILTERS_MAX; i++) {
        TEST_ASSERT_TRUE(can_loop_filter(&rig.loop, 1, &node3));
    }
    TEST_ASSERT_FALSE(can_loop_filter(&rig.loop, 1, &node3));
    TEST_ASSERT_FALSE(can_loop_filter(&rig.loop, 3, &node3));
}

static void test_frames_that_break_the_contract(void) {
    const berth_can_frame_t bad[] = {{.id = 0x800},
                                     {.id = UINT32_MAX},
                                     {.id = 1u << 29, .extended = true},
                                     {.id = 1, .length = 9},
                                     {.id = 1, .remote = true, .length = 255}};
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        TEST_ASSERT_EQUAL_INT(BERTH_CAN_FAILED, rig_send(&rig, 0, &bad[i]));
    }
    TEST_ASSERT_EQUAL_INT64(CAN_LOOP_NEVER, can_loop_deadline(&rig.loop));
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_ERROR_ACTIVE, rig_state(&rig, 0).mode);
}

static void test_time_and_clock(void) {
    const berth_clock_t clock = can_loop_clock(&rig.loop);
    TEST_ASSERT_EQUAL_INT64(0, clock.api->now_us(clock.context));
    can_loop_run(&rig.loop, 12345);
    TEST_ASSERT_EQUAL_INT64(12345, clock.api->now_us(clock.context));
    clock.api->sleep_until_us(clock.context, 99999);
    TEST_ASSERT_EQUAL_INT64(12345, clock.api->now_us(clock.context));
    static const int64_t nothing[] = {
        12344, 0, -1, INT64_MIN, CAN_LOOP_NEVER, CAN_LOOP_TIME_MAX_US + 1};
    rig_sends(&rig, 0, 1);
    for (size_t i = 0; i < sizeof nothing / sizeof nothing[0]; i++) {
        can_loop_run(&rig.loop, nothing[i]);
        TEST_ASSERT_EQUAL_INT64(12345, can_loop_now_us(&rig.loop));
    }
    can_loop_run(&rig.loop, CAN_LOOP_TIME_MAX_US);
    TEST_ASSERT_EQUAL_UINT32(1, rig.event_count);
    TEST_ASSERT_EQUAL_INT64(CAN_LOOP_TIME_MAX_US, can_loop_now_us(&rig.loop));
}

static void test_refused_starts(void) {
    static const uint32_t rates[] = {0, 999, 1000001, 83333, UINT32_MAX};
    for (size_t i = 0; i < sizeof rates / sizeof rates[0]; i++) {
        TEST_ASSERT_FALSE(can_loop_init(&rig.loop, rates[i], 0, 1));
    }
    TEST_ASSERT_FALSE(can_loop_init(&rig.loop, 500000, -1, 1));
    TEST_ASSERT_FALSE(can_loop_init(&rig.loop, 500000, CAN_LOOP_TIME_MAX_US + 1, 1));
    rig_start(&rig, CAN_LOOP_NODES_MAX);
    berth_can_t more;
    TEST_ASSERT_FALSE(can_loop_attach(&rig.loop, &more));
}

static void test_load_of_a_single_frame(void) {
    const int64_t bits = rig_bits(0, 0x123);
    can_loop_run(&rig.loop, 100);
    rig_sends(&rig, 0, 0x123);
    can_loop_run(&rig.loop, 110); /* under way since 10 us */
    TEST_ASSERT_EQUAL_INT64(10 * RIG_BIT_NS, can_loop_busy_ns(&rig.loop));
    can_loop_run(&rig.loop, 100 + bits);
    TEST_ASSERT_EQUAL_INT64(bits * RIG_BIT_NS, can_loop_busy_ns(&rig.loop));
    can_loop_run(&rig.loop, 1000);
    TEST_ASSERT_EQUAL_INT64((bits + 3) * RIG_BIT_NS, can_loop_busy_ns(&rig.loop));
    TEST_ASSERT_TRUE(can_loop_load(&rig.loop, 0, 0) == (double)(bits + 3) / 1000.0);
    TEST_ASSERT_TRUE(can_loop_load(&rig.loop, 1000, can_loop_busy_ns(&rig.loop)) == 0.0);
}

/* Over random traffic the windows' sums are the total, and that is the sum of the frames. */
static void test_load_sums(void) {
    support_random_start();
    rig_start(&rig, 4);
    int64_t windows_ns = 0;
    int64_t last_ns = 0;
    int64_t last_us = 0;
    for (int i = 0; i < 3000; i++) {
        const berth_can_frame_t f = random_frame();
        (void)rig_send(&rig, support_index(4), &f);
        can_loop_run(&rig.loop, can_loop_now_us(&rig.loop) + (int64_t)support_index(200));
        const int64_t busy_ns = can_loop_busy_ns(&rig.loop);
        const double load = can_loop_load(&rig.loop, last_us, last_ns);
        TEST_ASSERT_TRUE(load >= 0.0 && load <= 1.0);
        windows_ns += busy_ns - last_ns;
        last_ns = busy_ns;
        last_us = can_loop_now_us(&rig.loop);
    }
    can_loop_run(&rig.loop, last_us + 100000);
    int64_t sum_ns = 0;
    for (uint32_t i = 0; i < rig.event_count; i++) {
        sum_ns += (can_text_bits(&rig.events[i].frame) + 3) * RIG_BIT_NS;
    }
    TEST_ASSERT_EQUAL_INT64(sum_ns, can_loop_busy_ns(&rig.loop));
    TEST_ASSERT_EQUAL_INT64(sum_ns, windows_ns + can_loop_busy_ns(&rig.loop) - last_ns);
    TEST_ASSERT_EQUAL_UINT64(rig.event_count, can_loop_frames(&rig.loop));
    TEST_ASSERT_TRUE(rig.event_count > 2000);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_exact_frame_times);
    RUN_TEST(test_intermission_between_frames);
    RUN_TEST(test_one_instant_arbitrates_together);
    RUN_TEST(test_no_preemption);
    RUN_TEST(test_oldest_frame_arbitrates);
    RUN_TEST(test_formats_with_the_same_base);
    RUN_TEST(test_arbitration_against_brute_force);
    RUN_TEST(test_steps_do_not_matter);
    RUN_TEST(test_own_frames_are_not_received);
    RUN_TEST(test_full_transmit_queue);
    RUN_TEST(test_full_receive_queue);
    RUN_TEST(test_queues_wrap_around);
    RUN_TEST(test_filters);
    RUN_TEST(test_frames_that_break_the_contract);
    RUN_TEST(test_time_and_clock);
    RUN_TEST(test_refused_starts);
    RUN_TEST(test_load_of_a_single_frame);
    RUN_TEST(test_load_sums);
    return UNITY_END();
}
