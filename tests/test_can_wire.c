/* Frames as bits: against an encoder of the test's own, and against published figures. */
#include "can_text.h"
#include "can_wire.h"
#include "support.h"

#include "unity.h"

void setUp(void) {}

void tearDown(void) {}

static berth_can_frame_t random_frame(void) {
    berth_can_frame_t f = {.extended = support_index(2) == 0, .remote = support_index(8) == 0};
    f.id = support_index(f.extended ? 1u << 29 : 1u << 11);
    f.length = (uint8_t)support_index(9);
    /* long runs of equal bits are where stuffing can go wrong */
    const uint32_t style = support_index(3);
    for (int i = 0; i < 8; i++) {
        f.data[i] = (uint8_t)(style == 0 ? support_index(256) : (style == 1 ? 0x00 : 0xff));
    }
    if (style != 0) {
        f.data[support_index(8)] ^= (uint8_t)(1u << support_index(8));
        f.id &= support_index(2) == 0 ? 0x1f000007u : 0x00ffff00u;
        f.id &= f.extended ? BERTH_CAN_EXTENDED_MAX : BERTH_CAN_STANDARD_MAX;
    }
    return f;
}

static void test_the_tests_own_check_sum(void) {
    /* The check value that catalogues of check sums list for CRC-15/CAN: of "123456789". */
    can_text_t t = {""};
    for (const char *c = "123456789"; *c != '\0'; c++) {
        can_text_add(&t, (uint8_t)*c, 8);
    }
    TEST_ASSERT_EQUAL_HEX32(0x059e, can_text_crc(&t));
}

static void expect_same_bits(const berth_can_frame_t *f) {
    const can_text_t head = can_text_head(f);
    TEST_ASSERT_EQUAL_HEX32(can_text_crc(&head), can_wire_crc(f));
    uint8_t bits[CAN_WIRE_STUFFED_MAX];
    can_text_t got = {""};
    const uint32_t count = can_wire_stuffed(f, bits);
    for (uint32_t i = 0; i < count; i++) {
        can_text_add(&got, bits[i], 1);
    }
    TEST_ASSERT_EQUAL_STRING(can_text_stuffed(f).text, got.text);
    TEST_ASSERT_EQUAL_UINT32(can_text_bits(f), can_wire_bits(f));
}

static void test_bits_of_random_frames(void) {
    support_random_start();
    const uint32_t runs = support_runs(50000);
    for (uint32_t i = 0; i < runs; i++) {
        const berth_can_frame_t f = random_frame();
        expect_same_bits(&f);
    }
}

static void test_bits_of_every_standard_identifier(void) {
    for (uint32_t id = 0; id <= BERTH_CAN_STANDARD_MAX; id++) {
        berth_can_frame_t f = {.id = id, .length = (uint8_t)(id % 9)};
        expect_same_bits(&f);
        f.remote = true;
        expect_same_bits(&f);
    }
}

/* Published bounds with the intermission: 8 s + 47 unstuffed and floor((34 + 8 s - 1) / 4) more
 * for standard frames, that is 111 to 135 for 8 bytes; 8 s + 67 and floor((54 + 8 s - 1) / 4) for
 * extended ones, 131 to 160. */
static void test_published_bounds(void) {
    support_random_start();
    uint32_t least[2] = {UINT32_MAX, UINT32_MAX};
    uint32_t most[2] = {0, 0};
    const uint32_t runs = support_runs(200000);
    for (uint32_t i = 0; i < runs; i++) {
        berth_can_frame_t f = random_frame();
        const uint32_t bytes = f.remote ? 0 : f.length;
        const uint32_t plain = (f.extended ? 67u : 47u) + 8u * bytes;
        const uint32_t stuffable = (f.extended ? 54u : 34u) + 8u * bytes;
        const uint32_t bits = can_wire_bits(&f) + CAN_WIRE_INTERMISSION;
        TEST_ASSERT_TRUE(bits >= plain && bits <= plain + (stuffable - 1) / 4);
        if (bytes == 8) {
            const int kind = f.extended ? 1 : 0;
            least[kind] = bits < least[kind] ? bits : least[kind];
            most[kind] = bits > most[kind] ? bits : most[kind];
        }
    }
    TEST_ASSERT_TRUE(least[0] < 115 && most[0] > 125);
    TEST_ASSERT_TRUE(least[1] < 136 && most[1] > 145);
}

static void test_extremes(void) {
    /* Five equal bits, then four of the other kind over and over: 3 stuff bits up to the control
     * field, which cannot do it, 16 from there to the last data bit, and some in the check sum. */
    berth_can_frame_t f = {.id = 0x078, .length = 8};
    memset(f.data, 0x3c, sizeof f.data);
    const uint32_t most = can_wire_bits(&f) + CAN_WIRE_INTERMISSION;
    TEST_ASSERT_TRUE(most >= 111 + 19 && most <= 135);
    /* Alternating bits, two bytes altered: some need no stuff bit at all. */
    f = (berth_can_frame_t){.id = 0x555, .length = 8};
    uint32_t least = UINT32_MAX;
    for (uint32_t i = 0; i < 65536; i++) {
        memset(f.data, 0x55, sizeof f.data);
        f.data[1] ^= (uint8_t)(i & 0xff);
        f.data[4] ^= (uint8_t)(i >> 8);
        const uint32_t bits = can_wire_bits(&f) + CAN_WIRE_INTERMISSION;
        least = bits < least ? bits : least;
    }
    TEST_ASSERT_EQUAL_UINT32(111, least);
}

/* The rank orders frames as the bits on the wire do. */
static void test_rank_is_wire_order(void) {
    support_random_start();
    const uint32_t runs = support_runs(100000);
    for (uint32_t i = 0; i < runs; i++) {
        const berth_can_frame_t a = random_frame();
        berth_can_frame_t b = random_frame();
        if (support_index(2) == 0) { /* the same base identifier */
            const uint32_t base = a.extended ? a.id >> 18 : a.id;
            b.id = b.extended ? base << 18 | (b.id & 0x3ffffu) : base;
        }
        const can_text_t ta = can_text_arbitration(&a);
        const can_text_t tb = can_text_arbitration(&b);
        size_t k = 0;
        while (ta.text[k] != '\0' && ta.text[k] == tb.text[k]) {
            k++;
        }
        /* one text cannot be a part of the other: IDE differs before the shorter ends */
        const int order = (ta.text[k] > tb.text[k]) - (ta.text[k] < tb.text[k]);
        const uint32_t ra = can_wire_rank(&a);
        const uint32_t rb = can_wire_rank(&b);
        TEST_ASSERT_EQUAL_INT(order, (ra > rb) - (ra < rb));
    }
}

static void test_valid(void) {
    berth_can_frame_t f = {.id = 0x7ff, .length = 8};
    TEST_ASSERT_TRUE(can_wire_valid(&f));
    f.id = 0x800;
    TEST_ASSERT_FALSE(can_wire_valid(&f));
    f.extended = true;
    TEST_ASSERT_TRUE(can_wire_valid(&f));
    f.id = 0x1fffffff;
    TEST_ASSERT_TRUE(can_wire_valid(&f));
    f.id = 0x20000000;
    TEST_ASSERT_FALSE(can_wire_valid(&f));
    f.id = 0;
    f.length = 9;
    TEST_ASSERT_FALSE(can_wire_valid(&f));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_the_tests_own_check_sum);
    RUN_TEST(test_bits_of_random_frames);
    RUN_TEST(test_bits_of_every_standard_identifier);
    RUN_TEST(test_published_bounds);
    RUN_TEST(test_extremes);
    RUN_TEST(test_rank_is_wire_order);
    RUN_TEST(test_valid);
    return UNITY_END();
}
