/* The simulated CiA 402 drive against CiA 301 and CiA 402: node 5, 4096 counts a turn, speeds in
 * counts/s, a gear of 2. One wheel turn/s is 8192 = 0x2000 units.
 */
#include "drive_sim_rig.h"
#include "support.h"

#include "unity.h"

static const drive_sim_config_t config = {.kind = DRIVE_SIM_CIA402,
                                          .node = 5,
                                          .sign = 1,
                                          .gear_ratio = 2.0,
                                          .counts_per_turn = 4096,
                                          .velocity_units_per_rps = 4096.0};

void setUp(void) {
    rig_create(&config);
    rig_run(10000);
    rig_expect_standard(0x705, RIG_BYTES(0)); /* boot-up */
    rig_run(5000);
    rig_expect_nothing();
}

void tearDown(void) {
    rig_destroy();
}

/* An SDO request and the answer to it. */
#define SDO(...) TEST_ASSERT_TRUE(rig_standard(0x605, RIG_BYTES(__VA_ARGS__)))
#define ANSWER(...) rig_expect_standard(0x585, RIG_BYTES(__VA_ARGS__))

/* A download that succeeds. */
#define WRITE(...)                                                                                 \
    do {                                                                                           \
        SDO(__VA_ARGS__);                                                                          \
        TEST_ASSERT_EQUAL_HEX8(0x60, drive_sim_front(rig_sim)->data[0]);                           \
        drive_sim_sent(rig_sim);                                                                   \
    } while (0)

static void download_2(uint8_t low, uint8_t high, uint8_t a, uint8_t b) {
    SDO(0x2b, low, high, 0, a, b, 0, 0);
    ANSWER(0x60, low, high, 0, 0, 0, 0, 0);
}

static void control(uint8_t low, uint8_t high) {
    download_2(0x40, 0x60, low, high);
}

static void expect_status(uint8_t low, uint8_t high) {
    SDO(0x40, 0x41, 0x60, 0, 0, 0, 0, 0);
    ANSWER(0x4b, 0x41, 0x60, 0, low, high, 0, 0);
}

static void set_mode(uint8_t mode) {
    SDO(0x2f, 0x60, 0x60, 0, mode, 0, 0, 0);
    ANSWER(0x60, 0x60, 0x60, 0, 0, 0, 0, 0);
}

static void set_target(uint8_t a, uint8_t b, uint8_t c, uint8_t d) {
    SDO(0x23, 0xff, 0x60, 0, a, b, c, d);
    ANSWER(0x60, 0xff, 0x60, 0, 0, 0, 0, 0);
}

static void nmt(uint8_t command) {
    TEST_ASSERT_TRUE(rig_standard(0x000, RIG_BYTES(command, 5)));
}

static void sync(void) {
    TEST_ASSERT_TRUE(rig_standard(0x080, NULL, 0));
}

/* Cyclic velocity mode, enabled, one wheel turn/s. */
static void run_cyclic(void) {
    set_mode(9);
    control(0x06, 0);
    control(0x0f, 0);
    set_target(0x00, 0x20, 0, 0);
    rig_wheel(0.0, 1.0);
    TEST_ASSERT_TRUE(drive_sim_enabled(rig_sim));
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 1.0, drive_sim_target_radps(rig_sim) / RIG_TWO_PI);
}

static double target(void) {
    return drive_sim_target_radps(rig_sim) / RIG_TWO_PI;
}

/* Network */

static void test_hears_nothing_until_it_has_booted(void) {
    nmt(129);
    TEST_ASSERT_EQUAL_INT64(rig_now_us + 10000, drive_sim_deadline(rig_sim));
    TEST_ASSERT_FALSE(rig_standard(0x605, RIG_BYTES(0x40, 0, 0x10, 0, 0, 0, 0, 0)));
    rig_run(9999);
    rig_expect_nothing();
    rig_run(1);
    rig_expect_standard(0x705, RIG_BYTES(0));
    expect_status(0x00, 0x00); /* not ready to switch on */
    rig_run(5000);
    expect_status(0x50, 0x02);
}

static void test_nmt_states_show_in_the_heartbeat(void) {
    SDO(0x2b, 0x17, 0x10, 0, 100, 0, 0, 0); /* 100 ms */
    ANSWER(0x60, 0x17, 0x10, 0, 0, 0, 0, 0);
    rig_run(99999);
    rig_expect_nothing();
    rig_run(1);
    rig_expect_standard(0x705, RIG_BYTES(0x7f));
    nmt(1);
    rig_expect_standard(0x185, RIG_BYTES(0x50, 0x02)); /* an event: it may speak now */
    rig_run(100000);
    rig_expect_standard(0x705, RIG_BYTES(0x05));
    nmt(2);
    rig_run(100000);
    rig_expect_standard(0x705, RIG_BYTES(0x04));
    TEST_ASSERT_TRUE(rig_standard(0x000, RIG_BYTES(128, 0))); /* all nodes */
    rig_run(100000);
    rig_expect_standard(0x705, RIG_BYTES(0x7f));
    TEST_ASSERT_FALSE(rig_standard(0x000, RIG_BYTES(1, 6))); /* another node */
    rig_trouble((drive_sim_trouble_t){.mute_heartbeat = true});
    rig_run(300000);
    rig_expect_nothing();
    rig_trouble((drive_sim_trouble_t){0});
    nmt(130); /* reset communication: boots again, and the heartbeat is off again */
    rig_run(1000);
    rig_expect_standard(0x705, RIG_BYTES(0));
    rig_run(1000000);
    rig_expect_nothing();
    TEST_ASSERT_EQUAL_UINT(0, drive_sim_counters(rig_sim).malformed);
}

static void test_malformed_nmt_and_sync(void) {
    TEST_ASSERT_TRUE(rig_standard(0x000, RIG_BYTES(1)));
    TEST_ASSERT_TRUE(rig_standard(0x000, RIG_BYTES(1, 5, 0)));
    TEST_ASSERT_TRUE(rig_standard(0x000, RIG_BYTES(3, 5)));
    TEST_ASSERT_TRUE(rig_remote(0x000, false, 2));
    TEST_ASSERT_TRUE(rig_standard(0x080, RIG_BYTES(1, 2)));
    TEST_ASSERT_TRUE(rig_remote(0x080, false, 0));
    TEST_ASSERT_EQUAL_UINT(6, drive_sim_counters(rig_sim).malformed);
    TEST_ASSERT_FALSE(rig_extended(0x605, RIG_BYTES(0x40, 0, 0x10, 0, 0, 0, 0, 0)));
    TEST_ASSERT_FALSE(rig_standard(0x606, RIG_BYTES(0x40, 0, 0x10, 0, 0, 0, 0, 0)));
    rig_expect_nothing();
}

static void test_stopped_means_no_sdo(void) {
    nmt(2);
    TEST_ASSERT_TRUE(rig_standard(0x605, RIG_BYTES(0x40, 0, 0x10, 0, 0, 0, 0, 0)));
    rig_expect_nothing();
}

/* SDO */

static void test_sdo_uploads_of_each_size(void) {
    SDO(0x40, 0x00, 0x10, 0, 0, 0, 0, 0); /* servo drive, profile 402 */
    ANSWER(0x43, 0x00, 0x10, 0, 0x92, 0x01, 0x02, 0x00);
    SDO(0x40, 0x01, 0x10, 0, 0, 0, 0, 0);
    ANSWER(0x4f, 0x01, 0x10, 0, 0, 0, 0, 0);
    SDO(0x40, 0x14, 0x10, 0, 0, 0, 0, 0);
    ANSWER(0x43, 0x14, 0x10, 0, 0x85, 0, 0, 0);
    SDO(0x40, 0x18, 0x10, 0, 0, 0, 0, 0);
    ANSWER(0x4f, 0x18, 0x10, 0, 4, 0, 0, 0);
    SDO(0x40, 0x18, 0x10, 2, 0, 0, 0, 0);
    ANSWER(0x43, 0x18, 0x10, 2, 0x92, 0x01, 0, 0);
    SDO(0x40, 0x5a, 0x60, 0, 0, 0, 0, 0); /* quick stop option: 2 */
    ANSWER(0x4b, 0x5a, 0x60, 0, 2, 0, 0, 0);
    SDO(0x40, 0x07, 0x60, 0, 0, 0, 0, 0); /* abort connection option: 1 */
    ANSWER(0x4b, 0x07, 0x60, 0, 1, 0, 0, 0);
    SDO(0x40, 0x02, 0x65, 0, 0, 0, 0, 0); /* modes: 3 and 9 */
    ANSWER(0x43, 0x02, 0x65, 0, 0x04, 0x01, 0, 0);
    SDO(0x40, 0xc2, 0x60, 2, 0, 0, 0, 0); /* -3 */
    ANSWER(0x4f, 0xc2, 0x60, 2, 0xfd, 0, 0, 0);
    SDO(0x40, 0x83, 0x60, 0, 0, 0, 0, 0); /* 4096000 = 0x3e8000 */
    ANSWER(0x43, 0x83, 0x60, 0, 0x00, 0x80, 0x3e, 0);
    SDO(0x40, 0x00, 0x18, 1, 0, 0, 0, 0);
    ANSWER(0x43, 0x00, 0x18, 1, 0x85, 0x01, 0, 0x40);
}

/* Every object's first value, and what becomes of the attempt to write that very value back. */
typedef struct {
    uint8_t low, high, sub;
    uint8_t answer; /* its first byte tells the size: 4f one byte, 4b two, 43 four */
    uint8_t data[4];
    bool writable;
} object_row_t;

static const object_row_t rows[] = {
    {0x00, 0x10, 0, 0x43, {0x92, 0x01, 0x02, 0x00}, false}, /* device type */
    {0x01, 0x10, 0, 0x4f, {0}, false},                      /* error register */
    {0x03, 0x10, 0, 0x4f, {0}, true},                       /* error history */
    {0x03, 0x10, 1, 0x43, {0}, false},
    {0x03, 0x10, 2, 0x43, {0}, false},
    {0x03, 0x10, 3, 0x43, {0}, false},
    {0x03, 0x10, 4, 0x43, {0}, false},
    {0x05, 0x10, 0, 0x43, {0x80}, true},  /* SYNC */
    {0x14, 0x10, 0, 0x43, {0x85}, false}, /* EMCY */
    {0x16, 0x10, 0, 0x4f, {1}, false},    /* heartbeats: consumer */
    {0x16, 0x10, 1, 0x43, {0}, true},
    {0x17, 0x10, 0, 0x4b, {0}, true},  /* producer */
    {0x18, 0x10, 0, 0x4f, {4}, false}, /* identity */
    {0x18, 0x10, 1, 0x43, {0}, false},
    {0x18, 0x10, 2, 0x43, {0x92, 0x01}, false},
    {0x18, 0x10, 3, 0x43, {0, 0, 1, 0}, false},
    {0x18, 0x10, 4, 0x43, {5}, false},
    {0x29, 0x10, 0, 0x4f, {1}, false}, /* error behaviour */
    {0x29, 0x10, 1, 0x4f, {0}, true},
    {0x07, 0x60, 0, 0x4b, {1}, true},                      /* abort connection option */
    {0x3f, 0x60, 0, 0x4b, {0}, false},                     /* error code */
    {0x40, 0x60, 0, 0x4b, {0}, true},                      /* controlword */
    {0x41, 0x60, 0, 0x4b, {0x50, 0x02}, false},            /* statusword */
    {0x5a, 0x60, 0, 0x4b, {2}, true},                      /* quick stop option */
    {0x5e, 0x60, 0, 0x4b, {2}, true},                      /* fault reaction option */
    {0x60, 0x60, 0, 0x4f, {0}, true},                      /* mode */
    {0x61, 0x60, 0, 0x4f, {0}, false},                     /* mode display */
    {0x64, 0x60, 0, 0x43, {0}, false},                     /* position */
    {0x6b, 0x60, 0, 0x43, {0}, false},                     /* velocity demand */
    {0x6c, 0x60, 0, 0x43, {0}, false},                     /* velocity */
    {0x6d, 0x60, 0, 0x4b, {0x9a, 0x01}, true},             /* window: 0.1 turns/s = 410 */
    {0x6f, 0x60, 0, 0x4b, {0xcd, 0x00}, true},             /* threshold: 0.05 turns/s = 205 */
    {0x83, 0x60, 0, 0x43, {0x00, 0x80, 0x3e, 0x00}, true}, /* 1000 turns/s2 = 4096000 */
    {0x84, 0x60, 0, 0x43, {0x00, 0x80, 0x3e, 0x00}, true},
    {0x85, 0x60, 0, 0x43, {0x00, 0x00, 0x7d, 0x00}, true}, /* 2000 turns/s2 = 8192000 */
    {0x8f, 0x60, 0, 0x4f, {2}, false},                     /* encoder: 4096 to one turn */
    {0x8f, 0x60, 1, 0x43, {0x00, 0x10}, false},
    {0x8f, 0x60, 2, 0x43, {1}, false},
    {0xc2, 0x60, 0, 0x4f, {2}, false}, /* interpolation: 10 ms */
    {0xc2, 0x60, 1, 0x4f, {10}, true},
    {0xc2, 0x60, 2, 0x4f, {0xfd}, true},
    {0xff, 0x60, 0, 0x43, {0}, true},           /* target velocity */
    {0x02, 0x65, 0, 0x43, {0x04, 0x01}, false}, /* modes 3 and 9 */
    /* PDOs: all begin with the controlword or the statusword; mode, position, velocity. */
    {0x00, 0x14, 0, 0x4f, {2}, false},
    {0x00, 0x14, 1, 0x43, {0x05, 0x02}, true},
    {0x00, 0x14, 2, 0x4f, {255}, true},
    {0x01, 0x14, 1, 0x43, {0x05, 0x03, 0, 0x80}, true},
    {0x02, 0x14, 1, 0x43, {0x05, 0x04, 0, 0x80}, true},
    {0x03, 0x14, 1, 0x43, {0x05, 0x05, 0, 0x80}, true},
    {0x00, 0x16, 0, 0x4f, {1}, false}, /* refused here: it is on */
    {0x00, 0x16, 1, 0x43, {0x10, 0, 0x40, 0x60}, false},
    {0x01, 0x16, 0, 0x4f, {2}, true},
    {0x01, 0x16, 1, 0x43, {0x10, 0, 0x40, 0x60}, false}, /* refused: the count is not zero */
    {0x01, 0x16, 2, 0x43, {0x08, 0, 0x60, 0x60}, false},
    {0x02, 0x16, 0, 0x4f, {0}, true},
    {0x02, 0x16, 1, 0x43, {0}, false},
    {0x03, 0x16, 2, 0x43, {0x20, 0, 0xff, 0x60}, false},
    {0x00, 0x18, 0, 0x4f, {5}, false},
    {0x00, 0x18, 1, 0x43, {0x85, 0x01, 0, 0x40}, true},
    {0x00, 0x18, 2, 0x4f, {255}, true},
    {0x00, 0x18, 3, 0x4b, {0}, false}, /* refused here: it is on */
    {0x00, 0x18, 5, 0x4b, {0}, true},
    {0x03, 0x18, 1, 0x43, {0x85, 0x04, 0, 0xc0}, true},
    {0x00, 0x1a, 0, 0x4f, {1}, false},
    {0x01, 0x1a, 2, 0x43, {0x08, 0, 0x61, 0x60}, false},
    {0x02, 0x1a, 2, 0x43, {0x20, 0, 0x64, 0x60}, false},
    {0x03, 0x1a, 2, 0x43, {0x20, 0, 0x6c, 0x60}, false},
    {0x03, 0x1a, 8, 0x43, {0}, false},
};

static void test_every_object(void) {
    for (size_t i = 0; i < sizeof rows / sizeof rows[0]; i++) {
        const object_row_t *r = &rows[i];
        SDO(0x40, r->low, r->high, r->sub, 0, 0, 0, 0);
        ANSWER(r->answer, r->low, r->high, r->sub, r->data[0], r->data[1], r->data[2], r->data[3]);
        /* 4f, 4b, 43 become 2f, 2b, 23: the client's expedited download of the same size. */
        SDO((uint8_t)(r->answer - 0x20), r->low, r->high, r->sub, r->data[0], r->data[1],
            r->data[2], r->data[3]);
        TEST_ASSERT_EQUAL_HEX8(r->writable ? 0x60 : 0x80, drive_sim_front(rig_sim)->data[0]);
        drive_sim_sent(rig_sim);
    }
}

static void test_values_out_of_range(void) {
    static const uint8_t requests[][8] = {
        {0x23, 0x16, 0x10, 1, 0xff, 0xff, 0x80, 0}, /* node 0x80 */
        {0x2f, 0x29, 0x10, 1, 3},                   /* 0 to 2 */
        {0x2b, 0x07, 0x60, 0, 4},                   /* 0 to 3 */
        {0x2b, 0x07, 0x60, 0, 0xff, 0xff},          /* -1 */
        {0x2b, 0x5a, 0x60, 0, 8},                   /* 0 to 3, 5 to 7 */
        {0x2b, 0x5a, 0x60, 0, 0xff, 0xff},
        {0x2b, 0x5e, 0x60, 0, 4}, /* 0 to 3 */
        {0x2f, 0x60, 0x60, 0, 1}, /* 0, 3 and 9 */
        {0x2f, 0x60, 0x60, 0, 2},
        {0x2f, 0x60, 0x60, 0, 4},
        {0x2f, 0x60, 0x60, 0, 10},
        {0x23, 0x83, 0x60, 0},       /* no ramp of zero */
        {0x23, 0x05, 0x10, 0, 0x81}, /* SYNC is at 0x80 */
        {0x2f, 0x00, 0x14, 2, 253},  /* transmission types */
    };
    for (size_t i = 0; i < sizeof requests / sizeof requests[0]; i++) {
        const uint8_t *r = requests[i];
        TEST_ASSERT_TRUE(rig_standard(0x605, r, 8));
        ANSWER(0x80, r[1], r[2], r[3], 0x30, 0x00, 0x09, 0x06);
    }
}

static void test_sdo_downloads_are_kept(void) {
    SDO(0x23, 0x84, 0x60, 0, 1, 2, 3, 4);
    ANSWER(0x60, 0x84, 0x60, 0, 0, 0, 0, 0);
    SDO(0x40, 0x84, 0x60, 0, 0, 0, 0, 0);
    ANSWER(0x43, 0x84, 0x60, 0, 1, 2, 3, 4);
    /* Without a length told, it is the object's: what is in the other bytes does not matter. */
    SDO(0x22, 0x5e, 0x60, 0, 1, 0, 0xaa, 0xbb);
    ANSWER(0x60, 0x5e, 0x60, 0, 0, 0, 0, 0);
    SDO(0x40, 0x5e, 0x60, 0, 0, 0, 0, 0);
    ANSWER(0x4b, 0x5e, 0x60, 0, 1, 0, 0, 0);
    nmt(129); /* and reset node puts the default back */
    rig_run(20000);
    (void)rig_drop();
    SDO(0x40, 0x5e, 0x60, 0, 0, 0, 0, 0);
    ANSWER(0x4b, 0x5e, 0x60, 0, 2, 0, 0, 0);
}

static void test_sdo_aborts(void) {
    SDO(0x40, 0x00, 0x20, 0, 0, 0, 0, 0); /* no such object */
    ANSWER(0x80, 0x00, 0x20, 0, 0x00, 0x00, 0x02, 0x06);
    SDO(0x2b, 0x41, 0x61, 0, 0, 0, 0, 0);
    ANSWER(0x80, 0x41, 0x61, 0, 0x00, 0x00, 0x02, 0x06);
    SDO(0x40, 0x18, 0x10, 5, 0, 0, 0, 0); /* no such sub-index */
    ANSWER(0x80, 0x18, 0x10, 5, 0x11, 0x00, 0x09, 0x06);
    SDO(0x40, 0x00, 0x18, 4, 0, 0, 0, 0);
    ANSWER(0x80, 0x00, 0x18, 4, 0x11, 0x00, 0x09, 0x06);
    SDO(0x40, 0x00, 0x14, 3, 0, 0, 0, 0);
    ANSWER(0x80, 0x00, 0x14, 3, 0x11, 0x00, 0x09, 0x06);
    SDO(0x40, 0x00, 0x1a, 9, 0, 0, 0, 0);
    ANSWER(0x80, 0x00, 0x1a, 9, 0x11, 0x00, 0x09, 0x06);
    SDO(0x23, 0x00, 0x1a, 9, 0, 0, 0, 0);
    ANSWER(0x80, 0x00, 0x1a, 9, 0x11, 0x00, 0x09, 0x06);
    SDO(0x23, 0x00, 0x14, 3, 0, 0, 0, 0);
    ANSWER(0x80, 0x00, 0x14, 3, 0x11, 0x00, 0x09, 0x06);
    SDO(0x40, 0x04, 0x14, 1, 0, 0, 0, 0); /* there are four PDOs */
    ANSWER(0x80, 0x04, 0x14, 1, 0x00, 0x00, 0x02, 0x06);
    SDO(0x2b, 0x41, 0x60, 0, 0, 0, 0, 0); /* read-only */
    ANSWER(0x80, 0x41, 0x60, 0, 0x02, 0x00, 0x01, 0x06);
    SDO(0x2f, 0x00, 0x18, 0, 2, 0, 0, 0);
    ANSWER(0x80, 0x00, 0x18, 0, 0x02, 0x00, 0x01, 0x06);
    SDO(0x2b, 0x60, 0x60, 0, 3, 0, 0, 0); /* two bytes into one */
    ANSWER(0x80, 0x60, 0x60, 0, 0x10, 0x00, 0x07, 0x06);
    SDO(0x27, 0x40, 0x60, 0, 6, 0, 0, 0);
    ANSWER(0x80, 0x40, 0x60, 0, 0x10, 0x00, 0x07, 0x06);
    SDO(0x2f, 0x60, 0x60, 0, 8, 0, 0, 0); /* no position mode */
    ANSWER(0x80, 0x60, 0x60, 0, 0x30, 0x00, 0x09, 0x06);
    SDO(0x2f, 0x60, 0x60, 0, 0xff, 0, 0, 0); /* -1 */
    ANSWER(0x80, 0x60, 0x60, 0, 0x30, 0x00, 0x09, 0x06);
    SDO(0x2b, 0x5a, 0x60, 0, 4, 0, 0, 0);
    ANSWER(0x80, 0x5a, 0x60, 0, 0x30, 0x00, 0x09, 0x06);
    SDO(0x2f, 0x00, 0x14, 2, 241, 0, 0, 0); /* a reserved transmission type */
    ANSWER(0x80, 0x00, 0x14, 2, 0x30, 0x00, 0x09, 0x06);
    SDO(0xe0, 0x00, 0x10, 0, 0, 0, 0, 0); /* no such command */
    ANSWER(0x80, 0x00, 0x10, 0, 0x01, 0x00, 0x04, 0x05);
    SDO(0xa0, 0x00, 0x10, 0, 0, 0, 0, 0); /* block upload */
    ANSWER(0x80, 0x00, 0x10, 0, 0x01, 0x00, 0x04, 0x05);
    SDO(0xc2, 0x17, 0x10, 0, 0, 0, 0, 0); /* block download */
    ANSWER(0x80, 0x17, 0x10, 0, 0x01, 0x00, 0x04, 0x05);
    SDO(0x21, 0x17, 0x10, 0, 2, 0, 0, 0); /* segmented download */
    ANSWER(0x80, 0x17, 0x10, 0, 0x01, 0x00, 0x04, 0x05);
    SDO(0x21, 0x17, 0x30, 0, 2, 0, 0, 0); /* of an object that is not there */
    ANSWER(0x80, 0x17, 0x30, 0, 0x00, 0x00, 0x02, 0x06);
    SDO(0x00, 1, 2, 3, 4, 5, 6, 7); /* segments of nothing */
    ANSWER(0x80, 0, 0, 0, 0x01, 0x00, 0x04, 0x05);
    SDO(0x60, 0, 0, 0, 0, 0, 0, 0);
    ANSWER(0x80, 0, 0, 0, 0x01, 0x00, 0x04, 0x05);
    SDO(0x80, 0x17, 0x10, 0, 0, 0, 4, 5); /* the client's own abort is not answered */
    rig_expect_nothing();
    TEST_ASSERT_EQUAL_UINT(0, drive_sim_counters(rig_sim).malformed);
    TEST_ASSERT_TRUE(rig_standard(0x605, RIG_BYTES(0x40, 0x00, 0x10, 0, 0, 0, 0)));
    TEST_ASSERT_TRUE(rig_remote(0x605, false, 8));
    rig_expect_nothing();
    TEST_ASSERT_EQUAL_UINT(2, drive_sim_counters(rig_sim).malformed);
}

static void test_sdo_refused_set_up(void) {
    rig_trouble((drive_sim_trouble_t){.refuse_setup = true});
    SDO(0x2b, 0x17, 0x10, 0, 100, 0, 0, 0);
    ANSWER(0x80, 0x17, 0x10, 0, 0x22, 0x00, 0x00, 0x08);
    SDO(0x40, 0x17, 0x10, 0, 0, 0, 0, 0);
    ANSWER(0x4b, 0x17, 0x10, 0, 0, 0, 0, 0);
}

/* "simulated CiA 402 wheel drive": 29 characters, 4 segments of 7 and one of 1. */
static void test_sdo_segmented_upload(void) {
    SDO(0x40, 0x08, 0x10, 0, 0, 0, 0, 0);
    ANSWER(0x41, 0x08, 0x10, 0, 29, 0, 0, 0);
    SDO(0x60, 0, 0, 0, 0, 0, 0, 0);
    ANSWER(0x00, 's', 'i', 'm', 'u', 'l', 'a', 't');
    SDO(0x70, 0, 0, 0, 0, 0, 0, 0);
    ANSWER(0x10, 'e', 'd', ' ', 'C', 'i', 'A', ' ');
    SDO(0x60, 0, 0, 0, 0, 0, 0, 0);
    ANSWER(0x00, '4', '0', '2', ' ', 'w', 'h', 'e');
    SDO(0x70, 0, 0, 0, 0, 0, 0, 0);
    ANSWER(0x10, 'e', 'l', ' ', 'd', 'r', 'i', 'v');
    SDO(0x60, 0, 0, 0, 0, 0, 0, 0);
    ANSWER(0x0d, 'e', 0, 0, 0, 0, 0, 0);
    SDO(0x70, 0, 0, 0, 0, 0, 0, 0); /* it is over */
    ANSWER(0x80, 0, 0, 0, 0x01, 0x00, 0x04, 0x05);

    SDO(0x40, 0x08, 0x10, 0, 0, 0, 0, 0);
    ANSWER(0x41, 0x08, 0x10, 0, 29, 0, 0, 0);
    SDO(0x80, 0x08, 0x10, 0, 0, 0, 0, 8); /* the client gives up */
    SDO(0x60, 0, 0, 0, 0, 0, 0, 0);
    ANSWER(0x80, 0, 0, 0, 0x01, 0x00, 0x04, 0x05);

    SDO(0x40, 0x08, 0x10, 0, 0, 0, 0, 0);
    ANSWER(0x41, 0x08, 0x10, 0, 29, 0, 0, 0);
    SDO(0x40, 0x01, 0x10, 0, 0, 0, 0, 0); /* something else instead */
    ANSWER(0x4f, 0x01, 0x10, 0, 0, 0, 0, 0);
    SDO(0x60, 0, 0, 0, 0, 0, 0, 0);
    ANSWER(0x80, 0, 0, 0, 0x01, 0x00, 0x04, 0x05);

    SDO(0x40, 0x08, 0x10, 0, 0, 0, 0, 0);
    ANSWER(0x41, 0x08, 0x10, 0, 29, 0, 0, 0);
    SDO(0x70, 0, 0, 0, 0, 0, 0, 0); /* toggle bit not alternated */
    ANSWER(0x80, 0x08, 0x10, 0, 0x00, 0x00, 0x03, 0x05);
    SDO(0x60, 0, 0, 0, 0, 0, 0, 0);
    ANSWER(0x80, 0, 0, 0, 0x01, 0x00, 0x04, 0x05);
}

/* State machine */

static void test_statusword_in_every_state(void) {
    expect_status(0x50, 0x02); /* switch on disabled; voltage there, remote */
    control(0x06, 0);
    expect_status(0x31, 0x02); /* ready to switch on */
    control(0x07, 0);
    expect_status(0x33, 0x02); /* switched on */
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
    control(0x0f, 0);
    expect_status(0x37, 0x02); /* operation enabled, without a mode */
    TEST_ASSERT_TRUE(drive_sim_enabled(rig_sim));
    set_mode(9);
    expect_status(0x37, 0x12); /* follows the command */
    set_mode(3);
    expect_status(0x37, 0x16); /* target reached, speed is zero */
    rig_wheel(0.0, 1.0);
    expect_status(0x37, 0x02); /* turns although it should not */
    control(0x02, 0);
    expect_status(0x17, 0x02); /* quick stop active, until the wheel stands */
    TEST_ASSERT_TRUE(drive_sim_enabled(rig_sim));
    rig_wheel(0.0, 0.0);
    rig_run(2000);
    expect_status(0x50, 0x02);
    control(0x06, 0);
    control(0x0f, 0); /* switch on and enable in one */
    rig_wheel(0.0, 1.0);
    drive_sim_fail(rig_sim, 0x2310);
    rig_expect_standard(0x085, RIG_BYTES(0x10, 0x23, 0x03, 0, 0, 0, 0, 0));
    expect_status(0x1f, 0x02); /* fault reaction active */
    TEST_ASSERT_TRUE(drive_sim_enabled(rig_sim));
    rig_wheel(0.0, 0.0);
    rig_run(2000);
    expect_status(0x18, 0x02); /* fault */
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
}

static void test_each_command_in_each_state(void) {
    /* disable voltage, quick stop: back to switch on disabled */
    control(0x06, 0);
    control(0x00, 0);
    expect_status(0x50, 0x02);
    control(0x06, 0);
    control(0x02, 0);
    expect_status(0x50, 0x02);
    control(0x06, 0);
    control(0x07, 0);
    control(0x02, 0);
    expect_status(0x50, 0x02);
    control(0x06, 0);
    control(0x07, 0);
    control(0x05, 0);
    expect_status(0x50, 0x02);
    /* commands that switch on disabled does not know */
    control(0x07, 0);
    expect_status(0x50, 0x02);
    control(0x0f, 0);
    expect_status(0x50, 0x02);
    /* shutdown and disable operation */
    control(0x06, 0);
    control(0x0f, 0);
    control(0x07, 0);
    expect_status(0x33, 0x02);
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
    control(0x06, 0);
    expect_status(0x31, 0x02);
    control(0x0f, 0);
    control(0x06, 0);
    expect_status(0x31, 0x02);
    control(0x0f, 0);
    control(0x00, 0);
    expect_status(0x50, 0x02);
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
}

static void test_fault_is_left_by_the_rising_edge_of_bit_7_alone(void) {
    control(0x06, 0);
    control(0x0f, 0);
    control(0x8f, 0); /* the bit is set already when the fault comes */
    expect_status(0x37, 0x02);
    drive_sim_fail(rig_sim, 0xff05);
    rig_expect_standard(0x085, RIG_BYTES(0x05, 0xff, 0x01, 0, 0, 0, 0, 0));
    rig_run(2000);
    expect_status(0x18, 0x02);
    SDO(0x40, 0x3f, 0x60, 0, 0, 0, 0, 0);
    ANSWER(0x4b, 0x3f, 0x60, 0, 0x05, 0xff, 0, 0);
    SDO(0x40, 0x03, 0x10, 1, 0, 0, 0, 0);
    ANSWER(0x43, 0x03, 0x10, 1, 0x05, 0xff, 0, 0);
    control(0x80, 0);
    expect_status(0x18, 0x02);
    control(0x00, 0);
    control(0x06, 0);
    control(0x0f, 0);
    expect_status(0x18, 0x02);
    rig_expect_nothing();
    SDO(0x2b, 0x40, 0x60, 0, 0x80, 0, 0, 0);
    rig_expect_standard(0x085, RIG_BYTES(0, 0, 0, 0, 0, 0, 0, 0)); /* all is well again */
    ANSWER(0x60, 0x40, 0x60, 0, 0, 0, 0, 0);
    expect_status(0x50, 0x02);
    control(0x06, 0);
    expect_status(0x31, 0x02);
}

static void test_quick_stop_that_stays(void) {
    run_cyclic();
    download_2(0x5a, 0x60, 6, 0);
    control(0x02, 0);
    rig_run(4000); /* one turn/s is off in 8192/8192000 s = 1 ms */
    TEST_ASSERT_EQUAL_DOUBLE(0.0, target());
    rig_wheel(0.0, 0.0);
    rig_run(1000000);
    expect_status(0x17, 0x06); /* and has reached its target: standing */
    TEST_ASSERT_TRUE(drive_sim_enabled(rig_sim));
    control(0x0f, 0); /* transition 16 */
    expect_status(0x37, 0x12);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 1.0, target());
    control(0x02, 0);
    control(0x00, 0); /* transition 12 */
    expect_status(0x50, 0x02);
}

static void test_quick_stop_that_releases_at_once(void) {
    run_cyclic();
    download_2(0x5a, 0x60, 0, 0);
    control(0x02, 0);
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
    expect_status(0x50, 0x02);
}

static void test_quick_stop_does_not_wait_for_ever(void) {
    run_cyclic();
    control(0x02, 0);
    control(0x0f, 0); /* option 2: it cannot be enabled again from here */
    rig_run(499000);
    expect_status(0x17, 0x02); /* something keeps turning the wheel */
    rig_run(10000);
    expect_status(0x50, 0x02);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, target());
    SDO(0x40, 0x6b, 0x60, 0, 0, 0, 0, 0);
    ANSWER(0x43, 0x6b, 0x60, 0, 0, 0, 0, 0);
    run_cyclic();
    SDO(0x40, 0x6b, 0x60, 0, 0, 0, 0, 0);
    ANSWER(0x43, 0x6b, 0x60, 0, 0, 0x20, 0, 0);
    control(0x02, 0); /* and the next stop waits as long again */
    rig_run(499000);
    expect_status(0x17, 0x02);
}

static void test_profile_velocity_ramps(void) {
    set_mode(3);
    SDO(0x23, 0x83, 0x60, 0, 0x00, 0x40, 0, 0); /* 16384 units/s2: 2 wheel turns/s2 */
    ANSWER(0x60, 0x83, 0x60, 0, 0, 0, 0, 0);
    SDO(0x23, 0x84, 0x60, 0, 0x00, 0x80, 0, 0); /* 4 */
    ANSWER(0x60, 0x84, 0x60, 0, 0, 0, 0, 0);
    control(0x06, 0);
    control(0x0f, 0);
    set_target(0x00, 0x20, 0, 0);
    rig_run(250000);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.5, target());
    rig_run(500000);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 1.0, target());
    TEST_ASSERT_EQUAL_INT64(INT64_MAX, drive_sim_deadline(rig_sim)); /* nothing left to do */
    control(0x0f, 0x01);                                             /* halt */
    rig_run(125000);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.5, target());
    control(0x0f, 0x00);
    set_target(0x00, 0xe0, 0xff, 0xff); /* -1 turn/s */
    rig_run(2000000);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, -1.0, target());
    TEST_ASSERT_EQUAL_UINT(2, drive_sim_counters(rig_sim).commands);
}

static void test_feedback_counts_whole_steps_wraps_and_saturates(void) {
    rig_wheel(-0.25 / 8192.0, 100.4 / 8192.0);
    SDO(0x40, 0x64, 0x60, 0, 0, 0, 0, 0);
    ANSWER(0x43, 0x64, 0x60, 0, 0xff, 0xff, 0xff, 0xff);
    SDO(0x40, 0x6c, 0x60, 0, 0, 0, 0, 0);
    ANSWER(0x43, 0x6c, 0x60, 0, 100, 0, 0, 0);
    rig_wheel(2147483648.5 / 8192.0, -100.6 / 8192.0);
    SDO(0x40, 0x64, 0x60, 0, 0, 0, 0, 0);
    ANSWER(0x43, 0x64, 0x60, 0, 0, 0, 0, 0x80);
    SDO(0x40, 0x6c, 0x60, 0, 0, 0, 0, 0);
    ANSWER(0x43, 0x6c, 0x60, 0, 0x9b, 0xff, 0xff, 0xff);
    rig_wheel(-2147483648.5 / 8192.0, -1e12);
    SDO(0x40, 0x64, 0x60, 0, 0, 0, 0, 0);
    ANSWER(0x43, 0x64, 0x60, 0, 0xff, 0xff, 0xff, 0x7f);
    SDO(0x40, 0x6c, 0x60, 0, 0, 0, 0, 0);
    ANSWER(0x43, 0x6c, 0x60, 0, 0, 0, 0, 0x80);
}

static void test_quick_stop_options(void) {
    /* Option 1 brakes with the deceleration: 8192 units/s from 0x2000 units in 1 s. */
    WRITE(0x23, 0x84, 0x60, 0, 0x00, 0x20, 0, 0);
    download_2(0x5a, 0x60, 1, 0);
    run_cyclic();
    control(0x02, 0);
    rig_run(750000);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.25, target());
    rig_wheel(0.0, 0.0);
    rig_run(249000);
    expect_status(0x17, 0x02); /* a wheel that stands already is not the end of the ramp */
    rig_run(2000);
    expect_status(0x50, 0x02);
    /* Option 2, and 6, with the quick stop deceleration. */
    WRITE(0x23, 0x85, 0x60, 0, 0x00, 0x40, 0, 0);
    download_2(0x5a, 0x60, 2, 0);
    run_cyclic();
    control(0x02, 0);
    rig_run(250000);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.5, target());
    rig_wheel(0.0, 0.0);
    rig_run(300000);
    expect_status(0x50, 0x02);
    /* Option 5 is 1, but stays. */
    download_2(0x5a, 0x60, 5, 0);
    run_cyclic();
    control(0x02, 0);
    rig_run(500000);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.5, target());
    rig_wheel(0.0, 0.0);
    rig_run(2000000);
    expect_status(0x17, 0x06);
    control(0x00, 0);
    /* Option 3 brakes as hard as it can. */
    download_2(0x5a, 0x60, 3, 0);
    run_cyclic();
    control(0x02, 0);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, target());
    expect_status(0x17, 0x02);
}

static void test_fault_reaction_options(void) {
    download_2(0x5e, 0x60, 0, 0); /* lets go at once */
    run_cyclic();
    drive_sim_fail(rig_sim, 0x4210);
    rig_expect_standard(0x085, RIG_BYTES(0x10, 0x42, 0x09, 0, 0, 0, 0, 0));
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
    expect_status(0x18, 0x02);
    drive_sim_fail(rig_sim, 0x3220); /* a second one while faulty */
    rig_expect_standard(0x085, RIG_BYTES(0x20, 0x32, 0x05, 0, 0, 0, 0, 0));
    expect_status(0x18, 0x02);
    SDO(0x40, 0x03, 0x10, 0, 0, 0, 0, 0); /* both are in the history, the last one first */
    ANSWER(0x4f, 0x03, 0x10, 0, 2, 0, 0, 0);
    SDO(0x40, 0x03, 0x10, 1, 0, 0, 0, 0);
    ANSWER(0x43, 0x03, 0x10, 1, 0x20, 0x32, 0, 0);
    SDO(0x40, 0x03, 0x10, 2, 0, 0, 0, 0);
    ANSWER(0x43, 0x03, 0x10, 2, 0x10, 0x42, 0, 0);
    SDO(0x2f, 0x03, 0x10, 0, 1, 0, 0, 0);
    ANSWER(0x80, 0x03, 0x10, 0, 0x30, 0x00, 0x09, 0x06);
    WRITE(0x2f, 0x03, 0x10, 0, 0, 0, 0, 0); /* which can be cleared */
    SDO(0x40, 0x03, 0x10, 1, 0, 0, 0, 0);
    ANSWER(0x43, 0x03, 0x10, 1, 0, 0, 0, 0);
    SDO(0x40, 0x01, 0x10, 0, 0, 0, 0, 0);
    ANSWER(0x4f, 0x01, 0x10, 0, 0x05, 0, 0, 0);
}

static void test_history_keeps_four(void) {
    for (uint32_t code = 0xff01; code <= 0xff06; code++) {
        drive_sim_fail(rig_sim, code);
    }
    (void)rig_drop();
    SDO(0x40, 0x03, 0x10, 0, 0, 0, 0, 0);
    ANSWER(0x4f, 0x03, 0x10, 0, 4, 0, 0, 0);
    SDO(0x40, 0x03, 0x10, 4, 0, 0, 0, 0);
    ANSWER(0x43, 0x03, 0x10, 4, 0x03, 0xff, 0, 0);
    SDO(0x40, 0x03, 0x10, 5, 0, 0, 0, 0);
    ANSWER(0x80, 0x03, 0x10, 5, 0x11, 0x00, 0x09, 0x06);
}

/* PDOs */

static void test_mapping_wants_the_proper_order(void) {
    /* On: neither identifier nor mapping may change. */
    SDO(0x23, 0x00, 0x14, 1, 0x06, 0x02, 0, 0);
    ANSWER(0x80, 0x00, 0x14, 1, 0x22, 0, 0, 0x08);
    SDO(0x2f, 0x00, 0x16, 0, 0, 0, 0, 0);
    ANSWER(0x80, 0x00, 0x16, 0, 0x22, 0, 0, 0x08);
    SDO(0x23, 0x00, 0x16, 1, 0x10, 0, 0x40, 0x60);
    ANSWER(0x80, 0x00, 0x16, 1, 0x22, 0, 0, 0x08);
    SDO(0x23, 0x00, 0x14, 1, 0x05, 0x02, 0, 0x80); /* off */
    ANSWER(0x60, 0x00, 0x14, 1, 0, 0, 0, 0);
    SDO(0x23, 0x00, 0x16, 2, 0x20, 0, 0xff, 0x60); /* the count is not zero yet */
    ANSWER(0x80, 0x00, 0x16, 2, 0x22, 0, 0, 0x08);
    SDO(0x2f, 0x00, 0x16, 0, 0, 0, 0, 0);
    ANSWER(0x60, 0x00, 0x16, 0, 0, 0, 0, 0);
    SDO(0x23, 0x00, 0x16, 2, 0x20, 0, 0xfe, 0x60); /* unknown */
    ANSWER(0x80, 0x00, 0x16, 2, 0x00, 0, 0x02, 0x06);
    SDO(0x23, 0x00, 0x16, 2, 0x20, 0, 0x6c, 0x60); /* cannot be received */
    ANSWER(0x80, 0x00, 0x16, 2, 0x41, 0, 0x04, 0x06);
    SDO(0x23, 0x00, 0x16, 2, 0x10, 0, 0xff, 0x60); /* is not of 16 bits */
    ANSWER(0x80, 0x00, 0x16, 2, 0x41, 0, 0x04, 0x06);
    SDO(0x2f, 0x00, 0x16, 0, 3, 0, 0, 0); /* entries that are empty */
    ANSWER(0x80, 0x00, 0x16, 0, 0x00, 0, 0x02, 0x06);
    SDO(0x2f, 0x00, 0x16, 0, 9, 0, 0, 0);
    ANSWER(0x80, 0x00, 0x16, 0, 0x42, 0, 0x04, 0x06);
    SDO(0x23, 0x00, 0x16, 2, 0x20, 0, 0xff, 0x60);
    ANSWER(0x60, 0x00, 0x16, 2, 0, 0, 0, 0);
    SDO(0x23, 0x00, 0x16, 3, 0x20, 0, 0xff, 0x60);
    ANSWER(0x60, 0x00, 0x16, 3, 0, 0, 0, 0);
    SDO(0x2f, 0x00, 0x16, 0, 3, 0, 0, 0); /* 10 bytes */
    ANSWER(0x80, 0x00, 0x16, 0, 0x42, 0, 0x04, 0x06);
    SDO(0x2f, 0x00, 0x16, 0, 2, 0, 0, 0);
    ANSWER(0x60, 0x00, 0x16, 0, 0, 0, 0, 0);
    SDO(0x23, 0x00, 0x14, 1, 0x05, 0x06, 0, 0); /* 0x605 is the SDO's */
    ANSWER(0x80, 0x00, 0x14, 1, 0x30, 0, 0x09, 0x06);
    SDO(0x23, 0x00, 0x14, 1, 0x05, 0x02, 0, 0x20); /* 29 bits are not for this drive */
    ANSWER(0x80, 0x00, 0x14, 1, 0x30, 0, 0x09, 0x06);
    SDO(0x23, 0x00, 0x14, 1, 0x05, 0x02, 0, 0);
    ANSWER(0x60, 0x00, 0x14, 1, 0, 0, 0, 0);
    SDO(0x40, 0x00, 0x16, 2, 0, 0, 0, 0);
    ANSWER(0x43, 0x00, 0x16, 2, 0x20, 0, 0xff, 0x60);
    SDO(0x40, 0x00, 0x16, 0, 0, 0, 0, 0);
    ANSWER(0x4f, 0x00, 0x16, 0, 2, 0, 0, 0);
}

static void test_identifiers_that_are_kept_for_others(void) {
    static const uint16_t kept[] = {0x000, 0x001, 0x07f, 0x101, 0x180, 0x581, 0x5ff,
                                    0x601, 0x67f, 0x6e0, 0x6ff, 0x701, 0x77f, 0x7ff};
    static const uint16_t free_ids[] = {0x080, 0x100, 0x181, 0x580, 0x600, 0x680, 0x6df};
    for (size_t i = 0; i < sizeof kept / sizeof kept[0]; i++) {
        SDO(0x23, 0x01, 0x14, 1, (uint8_t)(kept[i] & 0xff), (uint8_t)(kept[i] >> 8), 0, 0);
        ANSWER(0x80, 0x01, 0x14, 1, 0x30, 0x00, 0x09, 0x06);
    }
    for (size_t i = 0; i < sizeof free_ids / sizeof free_ids[0]; i++) {
        const uint8_t low = (uint8_t)(free_ids[i] & 0xff), high = (uint8_t)(free_ids[i] >> 8);
        WRITE(0x23, 0x01, 0x14, 1, low, high, 0, 0);
        WRITE(0x23, 0x01, 0x14, 1, low, high, 0, 0x80);
    }
}

/* RPDO1: controlword, target; TPDO1: statusword, velocity; both with this transmission type. */
static void map_pdos(uint8_t type) {
    WRITE(0x23, 0x00, 0x14, 1, 0x05, 0x02, 0, 0x80);
    WRITE(0x2f, 0x00, 0x14, 2, type, 0, 0, 0);
    WRITE(0x2f, 0x00, 0x16, 0, 0, 0, 0, 0);
    WRITE(0x23, 0x00, 0x16, 1, 0x10, 0, 0x40, 0x60);
    WRITE(0x23, 0x00, 0x16, 2, 0x20, 0, 0xff, 0x60);
    WRITE(0x2f, 0x00, 0x16, 0, 2, 0, 0, 0);
    WRITE(0x23, 0x00, 0x14, 1, 0x05, 0x02, 0, 0);
    WRITE(0x23, 0x00, 0x18, 1, 0x85, 0x01, 0, 0xc0);
    WRITE(0x2f, 0x00, 0x18, 2, type, 0, 0, 0);
    WRITE(0x2f, 0x00, 0x1a, 0, 0, 0, 0, 0);
    WRITE(0x23, 0x00, 0x1a, 1, 0x10, 0, 0x41, 0x60);
    WRITE(0x23, 0x00, 0x1a, 2, 0x20, 0, 0x6c, 0x60);
    WRITE(0x2f, 0x00, 0x1a, 0, 2, 0, 0, 0);
    WRITE(0x23, 0x00, 0x18, 1, 0x85, 0x01, 0, 0x40);
}

static void test_synchronous_pdos(void) {
    map_pdos(1);
    set_mode(9);
    sync(); /* pre-operational: nothing */
    TEST_ASSERT_FALSE(rig_standard(0x205, RIG_BYTES(0x06, 0, 0, 0, 0, 0)));
    rig_expect_nothing();
    nmt(1);
    rig_expect_nothing();
    TEST_ASSERT_TRUE(rig_standard(0x205, RIG_BYTES(0x06, 0, 0, 0, 0, 0)));
    rig_expect_nothing();
    sync();
    rig_expect_standard(0x185, RIG_BYTES(0x31, 0x02, 0, 0, 0, 0));
    TEST_ASSERT_TRUE(rig_standard(0x205, RIG_BYTES(0x07, 0, 0, 0, 0, 0)));
    TEST_ASSERT_TRUE(rig_standard(0x205, RIG_BYTES(0x0f, 0, 0x00, 0x20, 0, 0))); /* the last wins */
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
    TEST_ASSERT_TRUE(rig_standard(0x080, RIG_BYTES(17))); /* with a counter */
    TEST_ASSERT_TRUE(drive_sim_enabled(rig_sim));
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 1.0, target());
    rig_expect_standard(0x185, RIG_BYTES(0x37, 0x12, 0, 0, 0, 0));
    rig_wheel(3.0, -1.0);
    sync();
    rig_expect_standard(0x185, RIG_BYTES(0x37, 0x12, 0x00, 0xe0, 0xff, 0xff));
    TEST_ASSERT_EQUAL_UINT(1, drive_sim_counters(rig_sim).commands);
    rig_trouble((drive_sim_trouble_t){.mute_feedback = true});
    sync();
    rig_expect_nothing();
}

static void test_the_slowest_synchronous_type(void) {
    map_pdos(240);
    nmt(1);
    TEST_ASSERT_TRUE(rig_standard(0x205, RIG_BYTES(0x06, 0, 0, 0, 0, 0)));
    expect_status(0x50, 0x02); /* waits for the next SYNC, whatever the number */
    sync();
    expect_status(0x31, 0x02);
    for (int i = 1; i < 480; i++) {
        TEST_ASSERT_EQUAL_UINT(i == 240 ? 1 : 0, rig_drop());
        sync();
    }
    TEST_ASSERT_EQUAL_UINT(1, rig_drop());
}

static void test_starting_again_starts_the_count_of_syncs(void) {
    map_pdos(3);
    nmt(1);
    sync();
    sync();
    TEST_ASSERT_TRUE(rig_standard(0x205, RIG_BYTES(0x06, 0, 0, 0, 0, 0)));
    nmt(128);
    nmt(1);
    sync(); /* neither what was counted nor what waited is left */
    sync();
    rig_expect_nothing();
    sync();
    rig_expect_standard(0x185, RIG_BYTES(0x50, 0x02, 0, 0, 0, 0));
}

static void test_reset_communication_undoes_the_mapping_alone(void) {
    map_pdos(1);
    download_2(0x5a, 0x60, 6, 0);
    run_cyclic();
    nmt(130);
    rig_expect_standard(0x085, RIG_BYTES(0x00, 0x81, 0x11, 0, 0, 0, 0, 0));
    rig_run(5000);
    rig_wheel(0.0, 0.0);
    rig_run(1000);
    rig_expect_standard(0x705, RIG_BYTES(0));
    rig_expect_nothing();
    expect_status(0x18, 0x02); /* the wheel was stopped, as when the connection is lost */
    SDO(0x40, 0x5a, 0x60, 0, 0, 0, 0, 0);
    ANSWER(0x4b, 0x5a, 0x60, 0, 6, 0, 0, 0);
    SDO(0x40, 0x00, 0x16, 0, 0, 0, 0, 0);
    ANSWER(0x4f, 0x00, 0x16, 0, 1, 0, 0, 0);
    SDO(0x40, 0x00, 0x18, 2, 0, 0, 0, 0);
    ANSWER(0x4f, 0x00, 0x18, 2, 255, 0, 0, 0);
}

static void test_every_third_sync(void) {
    map_pdos(3);
    nmt(1);
    for (int i = 0; i < 9; i++) {
        sync();
        TEST_ASSERT_EQUAL_UINT(i % 3 == 2 ? 1 : 0, rig_drop());
    }
}

static void test_type_0_is_sent_at_sync_when_something_happened(void) {
    map_pdos(0);
    nmt(1);
    sync();
    TEST_ASSERT_EQUAL_UINT(1, rig_drop());
    sync();
    rig_expect_nothing();
    TEST_ASSERT_TRUE(rig_standard(0x205, RIG_BYTES(0x06, 0, 0, 0, 0, 0)));
    rig_expect_nothing();
    sync();
    rig_expect_standard(0x185, RIG_BYTES(0x31, 0x02, 0, 0, 0, 0));
    sync();
    rig_expect_nothing();
}

static void test_asynchronous_pdos(void) {
    map_pdos(255);
    WRITE(0x23, 0x00, 0x18, 1, 0x85, 0x01, 0, 0xc0);
    WRITE(0x2b, 0x00, 0x18, 3, 50, 0, 0, 0); /* at most each 5 ms */
    WRITE(0x2b, 0x00, 0x18, 5, 20, 0, 0, 0); /* and each 20 ms anyway */
    WRITE(0x23, 0x00, 0x18, 1, 0x85, 0x01, 0, 0x40);
    nmt(1);
    rig_expect_standard(0x185, RIG_BYTES(0x50, 0x02, 0, 0, 0, 0));
    TEST_ASSERT_TRUE(rig_standard(0x205, RIG_BYTES(0x06, 0, 0, 0, 0, 0)));
    rig_expect_nothing(); /* too early */
    TEST_ASSERT_EQUAL_INT64(rig_now_us + 5000, drive_sim_deadline(rig_sim));
    rig_run(4999);
    rig_expect_nothing();
    rig_run(1);
    rig_expect_standard(0x185, RIG_BYTES(0x31, 0x02, 0, 0, 0, 0));
    TEST_ASSERT_EQUAL_INT64(rig_now_us + 15000, drive_sim_deadline(rig_sim));
    rig_wheel(0.0, 1.0); /* a speed is no event */
    rig_run(14999);
    rig_expect_nothing();
    rig_run(1);
    rig_expect_standard(0x185, RIG_BYTES(0x31, 0x02, 0x00, 0x20, 0, 0));
    sync();
    rig_expect_nothing();
    rig_run(20000);
    TEST_ASSERT_EQUAL_UINT(1, rig_drop());
    nmt(128);
    TEST_ASSERT_EQUAL_INT64(INT64_MAX, drive_sim_deadline(rig_sim));
    rig_run(100000);
    rig_expect_nothing();
    nmt(1); /* tells once how things are */
    rig_expect_standard(0x185, RIG_BYTES(0x31, 0x02, 0x00, 0x20, 0, 0));
}

/* The profile's own fourth PDOs: control word and target, status word and speed. */
static void test_the_last_pdos_work_like_the_first(void) {
    WRITE(0x2f, 0x03, 0x14, 2, 1, 0, 0, 0);
    WRITE(0x2f, 0x03, 0x18, 2, 1, 0, 0, 0);
    WRITE(0x23, 0x03, 0x14, 1, 0x05, 0x05, 0, 0);
    WRITE(0x23, 0x03, 0x18, 1, 0x85, 0x04, 0, 0);
    set_mode(9);
    control(0x06, 0);
    nmt(1);
    (void)rig_drop();
    TEST_ASSERT_TRUE(rig_standard(0x505, RIG_BYTES(0x0f, 0, 0x00, 0x20, 0, 0)));
    sync();
    rig_expect_standard(0x485, RIG_BYTES(0x37, 0x12, 0, 0, 0, 0));
    rig_expect_standard(0x185, RIG_BYTES(0x37, 0x12));
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 1.0, target());
    TEST_ASSERT_TRUE(rig_remote(0x485, false, 6));
    rig_expect_standard(0x485, RIG_BYTES(0x37, 0x12, 0, 0, 0, 0));
    WRITE(0x2f, 0x03, 0x18, 2, 254, 0, 0, 0); /* from now on as events */
    (void)rig_drop();
    TEST_ASSERT_TRUE(rig_standard(0x505, RIG_BYTES(0x07, 0, 0, 0, 0, 0)));
    sync();
    rig_expect_standard(0x185, RIG_BYTES(0x33, 0x02));
    rig_expect_standard(0x485, RIG_BYTES(0x33, 0x02, 0, 0, 0, 0));
}

static void test_remote_request_of_a_pdo(void) {
    nmt(1);
    (void)rig_drop();
    TEST_ASSERT_FALSE(rig_remote(0x185, false, 8)); /* bit 30: not allowed */
    rig_expect_nothing();
    WRITE(0x23, 0x00, 0x18, 1, 0x85, 0x01, 0, 0x80);
    WRITE(0x23, 0x00, 0x18, 1, 0x85, 0x01, 0, 0x00);
    (void)rig_drop();
    TEST_ASSERT_TRUE(rig_remote(0x185, false, 8));
    rig_expect_standard(0x185, RIG_BYTES(0x50, 0x02));
}

static void test_inhibit_time_wants_the_pdo_off(void) {
    SDO(0x2b, 0x00, 0x18, 3, 50, 0, 0, 0);
    ANSWER(0x80, 0x00, 0x18, 3, 0x22, 0, 0, 0x08);
    SDO(0x2f, 0x00, 0x18, 3, 50, 0, 0, 0);
    ANSWER(0x80, 0x00, 0x18, 3, 0x10, 0, 0x07, 0x06);
}

static void test_value_out_of_range_in_a_pdo_is_counted_and_ignored(void) {
    set_mode(3);
    WRITE(0x23, 0x01, 0x14, 1, 0x05, 0x03, 0, 0); /* the profile's second: with the mode */
    nmt(1);
    (void)rig_drop();
    TEST_ASSERT_TRUE(rig_standard(0x305, RIG_BYTES(0x06, 0, 8)));
    TEST_ASSERT_EQUAL_UINT(1, drive_sim_counters(rig_sim).malformed);
    rig_expect_standard(0x185, RIG_BYTES(0x31, 0x02)); /* the controlword counts all the same */
    SDO(0x40, 0x61, 0x60, 0, 0, 0, 0, 0);
    ANSWER(0x4f, 0x61, 0x60, 0, 3, 0, 0, 0);
    TEST_ASSERT_TRUE(rig_standard(0x305, RIG_BYTES(0x06, 0, 9)));
    SDO(0x40, 0x61, 0x60, 0, 0, 0, 0, 0);
    ANSWER(0x4f, 0x61, 0x60, 0, 9, 0, 0, 0);
}

static void test_short_pdo_is_reported_once_and_changes_nothing(void) {
    map_pdos(255);
    nmt(1);
    (void)rig_drop();
    for (uint8_t length = 0; length < 6; length++) {
        const uint8_t data[6] = {0x06};
        TEST_ASSERT_TRUE(rig_standard(0x205, data, length));
    }
    rig_expect_standard(0x085, RIG_BYTES(0x10, 0x82, 0x11, 0, 0, 0, 0, 0));
    rig_expect_standard(0x185, RIG_BYTES(0xd0, 0x02, 0, 0, 0, 0)); /* a warning, no fault */
    rig_expect_nothing();
    TEST_ASSERT_EQUAL_UINT(6, drive_sim_counters(rig_sim).malformed);
    /* A longer one counts for what is mapped. */
    TEST_ASSERT_TRUE(rig_standard(0x205, RIG_BYTES(0x06, 0, 0, 0, 0, 0, 1, 2)));
    rig_expect_standard(0x085, RIG_BYTES(0, 0, 0, 0, 0, 0, 0, 0));
    rig_expect_standard(0x185, RIG_BYTES(0x31, 0x02, 0, 0, 0, 0));
    TEST_ASSERT_TRUE(rig_remote(0x205, false, 6));
    TEST_ASSERT_EQUAL_UINT(7, drive_sim_counters(rig_sim).malformed);
    rig_expect_nothing();
}

/* Heartbeat of the master */

/* Node 0x10 has to be heard each 50 ms. */
static void watch_master(void) {
    WRITE(0x23, 0x16, 0x10, 1, 50, 0, 0x10, 0);
    rig_run(1000000); /* not before it was heard once */
    rig_expect_nothing();
    TEST_ASSERT_TRUE(rig_standard(0x710, RIG_BYTES(0x05)));
}

static void test_lost_heartbeat_is_a_fault_while_enabled(void) {
    watch_master();
    run_cyclic();
    rig_run(40000);
    TEST_ASSERT_TRUE(rig_standard(0x710, RIG_BYTES(0x05)));
    rig_run(49999);
    rig_expect_nothing();
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 1.0, target());
    rig_run(1);
    rig_expect_standard(0x085, RIG_BYTES(0x30, 0x81, 0x11, 0, 0, 0, 0, 0));
    rig_run(4000);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, target());
    rig_wheel(0.0, 0.0);
    rig_run(2000);
    expect_status(0x18, 0x02);
    TEST_ASSERT_EQUAL_UINT(1, drive_sim_counters(rig_sim).watchdog_stops);
    TEST_ASSERT_TRUE(rig_standard(0x710, RIG_BYTES(0x05)));
    control(0x00, 0);
    SDO(0x2b, 0x40, 0x60, 0, 0x80, 0, 0, 0);
    rig_expect_standard(0x085, RIG_BYTES(0, 0, 0, 0, 0, 0, 0, 0));
    ANSWER(0x60, 0x40, 0x60, 0, 0, 0, 0, 0);
    expect_status(0x50, 0x02);
}

static void test_lost_heartbeat_with_quick_stop_instead(void) {
    download_2(0x07, 0x60, 3, 0);
    watch_master();
    run_cyclic();
    rig_run(50000);
    rig_expect_standard(0x085, RIG_BYTES(0x30, 0x81, 0x11, 0, 0, 0, 0, 0));
    expect_status(0x97, 0x02); /* quick stop active, and a warning */
    rig_wheel(0.0, 0.0);
    rig_run(5000);
    expect_status(0xd0, 0x02);
    TEST_ASSERT_TRUE(rig_standard(0x710, RIG_BYTES(0x05)));
    rig_expect_standard(0x085, RIG_BYTES(0, 0, 0, 0, 0, 0, 0, 0));
    expect_status(0x50, 0x02);
}

static void test_reset_communication_forgets_the_master(void) {
    watch_master();
    nmt(130);
    rig_run(100000);
    rig_expect_standard(0x705, RIG_BYTES(0));
    rig_expect_nothing();
    TEST_ASSERT_FALSE(rig_standard(0x710, RIG_BYTES(0x05)));
}

static void test_lost_heartbeat_leaves_operational(void) {
    watch_master();
    WRITE(0x2b, 0x17, 0x10, 0, 30, 0, 0, 0);
    nmt(1);
    (void)rig_drop();
    rig_run(30000);
    rig_expect_standard(0x705, RIG_BYTES(0x05));
    rig_run(30000);
    rig_expect_standard(0x085, RIG_BYTES(0x30, 0x81, 0x11, 0, 0, 0, 0, 0));
    rig_expect_standard(0x705, RIG_BYTES(0x7f));
    TEST_ASSERT_EQUAL_UINT(0, drive_sim_counters(rig_sim).watchdog_stops);
}

static void test_lost_heartbeat_without_an_effect_or_with_torque_off(void) {
    download_2(0x07, 0x60, 0, 0);
    WRITE(0x2f, 0x29, 0x10, 1, 1, 0, 0, 0); /* nor on the network state */
    watch_master();
    run_cyclic();
    nmt(1);
    (void)rig_drop();
    rig_run(50000);
    rig_expect_standard(0x085, RIG_BYTES(0x30, 0x81, 0x11, 0, 0, 0, 0, 0));
    rig_expect_standard(0x185, RIG_BYTES(0xb7, 0x12)); /* still enabled; a warning */
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 1.0, target());
    TEST_ASSERT_EQUAL_UINT(0, drive_sim_counters(rig_sim).watchdog_stops);
    rig_run(1000000); /* once, not again and again */
    rig_expect_nothing();
    download_2(0x07, 0x60, 2, 0);
    WRITE(0x2f, 0x29, 0x10, 1, 2, 0, 0, 0);
    TEST_ASSERT_TRUE(rig_standard(0x710, RIG_BYTES(0x05)));
    (void)rig_drop();
    rig_run(50000);
    rig_expect_standard(0x085, RIG_BYTES(0x30, 0x81, 0x11, 0, 0, 0, 0, 0));
    rig_expect_nothing(); /* stopped: no PDO */
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
    TEST_ASSERT_EQUAL_UINT(1, drive_sim_counters(rig_sim).watchdog_stops);
    TEST_ASSERT_TRUE(rig_standard(0x605, RIG_BYTES(0x40, 0x41, 0x60, 0, 0, 0, 0, 0)));
    rig_expect_nothing(); /* and no SDO */
}

static void test_malformed_heartbeats_do_not_count(void) {
    watch_master();
    rig_run(40000);
    TEST_ASSERT_TRUE(rig_remote(0x710, false, 1));
    TEST_ASSERT_TRUE(rig_standard(0x710, NULL, 0));
    TEST_ASSERT_TRUE(rig_standard(0x710, RIG_BYTES(5, 5)));
    TEST_ASSERT_FALSE(rig_standard(0x711, RIG_BYTES(5)));
    rig_run(10000);
    rig_expect_standard(0x085, RIG_BYTES(0x30, 0x81, 0x11, 0, 0, 0, 0, 0));
}

static void test_nmt_stop_while_enabled_stops_the_wheel(void) {
    run_cyclic();
    nmt(2);
    rig_run(5000);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, target());
    rig_wheel(0.0, 0.0);
    rig_run(2000);
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
    nmt(128);
    rig_drop();
    expect_status(0x18, 0x02);
}

static void test_reset_node_lets_go_of_the_wheel(void) {
    run_cyclic();
    nmt(129);
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
    rig_run(20000);
    rig_expect_standard(0x705, RIG_BYTES(0));
    expect_status(0x50, 0x02);
    SDO(0x40, 0xff, 0x60, 0, 0, 0, 0, 0);
    ANSWER(0x43, 0xff, 0x60, 0, 0, 0, 0, 0);
}

static void test_dead_and_alive_again_boots(void) {
    run_cyclic();
    rig_trouble((drive_sim_trouble_t){.dead = true});
    TEST_ASSERT_FALSE(drive_sim_enabled(rig_sim));
    TEST_ASSERT_FALSE(rig_standard(0x605, RIG_BYTES(0x40, 0, 0x10, 0, 0, 0, 0, 0)));
    rig_run(1000000);
    rig_expect_nothing();
    rig_trouble((drive_sim_trouble_t){0});
    rig_run(20000);
    rig_expect_standard(0x705, RIG_BYTES(0));
    expect_status(0x50, 0x02);
}

/* Random frames, near the drive's identifiers and on them, in whatever state they lead to. */
static void test_hostile_frames(void) {
    static const uint16_t ids[] = {0x000, 0x080, 0x205, 0x305, 0x405, 0x505, 0x605, 0x710};
    static const uint16_t indexes[] = {0x1003, 0x1016, 0x1017, 0x1029, 0x1400, 0x1600, 0x1800,
                                       0x1a00, 0x6007, 0x6040, 0x605a, 0x6060, 0x6083, 0x60ff};
    support_random_start();
    rig_hostile(support_runs(50000));
    for (uint32_t i = 0; i < support_runs(200000); i++) {
        uint8_t data[8];
        for (unsigned k = 0; k < 8; k++) {
            data[k] = (uint8_t)support_index(support_index(2) == 0 ? 16 : 256);
        }
        const uint16_t id = ids[support_index(8)];
        if (id == 0x605) {
            const uint16_t index = indexes[support_index(14)];
            data[0] = (uint8_t)(support_index(8) << 5 | support_index(16));
            data[1] = (uint8_t)(index & 0xff);
            data[2] = (uint8_t)(index >> 8);
        }
        (void)rig_standard(id, data, (uint8_t)support_index(9));
        if (support_index(20) == 0) {
            drive_sim_fail(rig_sim, support_index(0x10000));
        }
        rig_wheel(support_uniform(-1e6, 1e6), support_uniform(-10.0, 10.0));
        rig_run((int64_t)support_index(3000));
        (void)rig_drop();
        TEST_ASSERT_TRUE(target() - target() == 0.0);
    }
    /* Reset node brings any of them back. */
    rig_run(20000); /* one of the frames may have reset it just now */
    TEST_ASSERT_TRUE(rig_standard(0x000, RIG_BYTES(129, 5)));
    rig_wheel(0.0, 0.0);
    rig_run(20000);
    (void)rig_drop();
    expect_status(0x50, 0x02);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_hears_nothing_until_it_has_booted);
    RUN_TEST(test_nmt_states_show_in_the_heartbeat);
    RUN_TEST(test_malformed_nmt_and_sync);
    RUN_TEST(test_stopped_means_no_sdo);
    RUN_TEST(test_sdo_uploads_of_each_size);
    RUN_TEST(test_every_object);
    RUN_TEST(test_values_out_of_range);
    RUN_TEST(test_sdo_downloads_are_kept);
    RUN_TEST(test_sdo_aborts);
    RUN_TEST(test_sdo_refused_set_up);
    RUN_TEST(test_sdo_segmented_upload);
    RUN_TEST(test_statusword_in_every_state);
    RUN_TEST(test_each_command_in_each_state);
    RUN_TEST(test_fault_is_left_by_the_rising_edge_of_bit_7_alone);
    RUN_TEST(test_quick_stop_that_stays);
    RUN_TEST(test_quick_stop_that_releases_at_once);
    RUN_TEST(test_quick_stop_does_not_wait_for_ever);
    RUN_TEST(test_quick_stop_options);
    RUN_TEST(test_fault_reaction_options);
    RUN_TEST(test_history_keeps_four);
    RUN_TEST(test_profile_velocity_ramps);
    RUN_TEST(test_feedback_counts_whole_steps_wraps_and_saturates);
    RUN_TEST(test_mapping_wants_the_proper_order);
    RUN_TEST(test_identifiers_that_are_kept_for_others);
    RUN_TEST(test_synchronous_pdos);
    RUN_TEST(test_the_slowest_synchronous_type);
    RUN_TEST(test_starting_again_starts_the_count_of_syncs);
    RUN_TEST(test_reset_communication_undoes_the_mapping_alone);
    RUN_TEST(test_every_third_sync);
    RUN_TEST(test_type_0_is_sent_at_sync_when_something_happened);
    RUN_TEST(test_asynchronous_pdos);
    RUN_TEST(test_the_last_pdos_work_like_the_first);
    RUN_TEST(test_remote_request_of_a_pdo);
    RUN_TEST(test_inhibit_time_wants_the_pdo_off);
    RUN_TEST(test_value_out_of_range_in_a_pdo_is_counted_and_ignored);
    RUN_TEST(test_short_pdo_is_reported_once_and_changes_nothing);
    RUN_TEST(test_lost_heartbeat_is_a_fault_while_enabled);
    RUN_TEST(test_lost_heartbeat_with_quick_stop_instead);
    RUN_TEST(test_reset_communication_forgets_the_master);
    RUN_TEST(test_lost_heartbeat_leaves_operational);
    RUN_TEST(test_lost_heartbeat_without_an_effect_or_with_torque_off);
    RUN_TEST(test_malformed_heartbeats_do_not_count);
    RUN_TEST(test_nmt_stop_while_enabled_stops_the_wheel);
    RUN_TEST(test_reset_node_lets_go_of_the_wheel);
    RUN_TEST(test_dead_and_alive_again_boots);
    RUN_TEST(test_hostile_frames);
    return UNITY_END();
}
