/* The serial port, against a model of its registers. */
#include "io_model.h"
#include "stm32_usart.h"
#include "support.h"

#include "unity.h"

#include <string.h>

static stm32f4_usart_t block;

/* One byte each way, as the reference manual describes it. */
static struct {
    uint32_t brr, cr1, cr2, cr3;
    uint8_t rdr, tdr;
    bool rxne, ore, status_read, tdr_full;
    bool stuck; /* never ready to send */
    uint8_t sent[100000];
    uint32_t sent_count;
} port;

static stm32_usart_t usart;
static byte_stream_t stream;

static bool line(void) {
    return ((port.rxne || port.ore) && (port.cr1 & 1u << 5) != 0) ||
           (!port.tdr_full && (port.cr1 & 1u << 7) != 0);
}

static uint32_t port_read(void *context, uint32_t offset) {
    (void)context;
    switch (offset) {
    case 0x00:
        port.status_read = true;
        return (port.ore ? 1u << 3 : 0u) | (port.rxne ? 1u << 5 : 0u) |
               (!port.tdr_full && !port.stuck ? 1u << 7 : 0u);
    case 0x04:
        port.rxne = false;
        port.ore = port.ore && !port.status_read;
        return port.rdr | 0x100u;
    case 0x0c:
        return port.cr1;
    default:
        TEST_FAIL_MESSAGE("a register that is not modelled");
        return 0;
    }
}

static void port_write(void *context, uint32_t offset, uint32_t value) {
    (void)context;
    switch (offset) {
    case 0x04:
        TEST_ASSERT_FALSE_MESSAGE(port.tdr_full, "a byte was overwritten");
        port.tdr = (uint8_t)value;
        port.tdr_full = true;
        break;
    case 0x08:
        port.brr = value;
        break;
    case 0x0c:
        port.cr1 = value;
        break;
    case 0x10:
        port.cr2 = value;
        break;
    case 0x14:
        port.cr3 = value;
        break;
    default:
        TEST_FAIL_MESSAGE("a register that is not modelled");
    }
}

static void interrupts(void) {
    for (int i = 0; line(); i++) {
        TEST_ASSERT_TRUE(i < 10);
        stm32_usart_interrupt(&usart);
    }
}

/* One byte's time. */
static void line_sends(void) {
    if (port.tdr_full) {
        TEST_ASSERT_TRUE(port.sent_count < sizeof port.sent);
        port.sent[port.sent_count++] = port.tdr;
        port.tdr_full = false;
    }
}

static void line_receives(uint8_t byte) {
    port.status_read = false;
    if (port.rxne) {
        port.ore = true; /* the older byte stays */
        return;
    }
    port.rdr = byte;
    port.rxne = true;
}

void setUp(void) {
    static const io_model_ops_t ops = {port_read, port_write};
    io_model_reset();
    io_model_map(&block, sizeof block, &ops, NULL);
    memset(&port, 0, sizeof port);
    port.cr1 = 0xffff; /* left by an earlier program */
    port.cr2 = 0xffff;
    port.cr3 = 0xffff;
    TEST_ASSERT_TRUE(stm32_usart_open(&usart, &block, 84000000, 115200));
    stream = stm32_usart_stream(&usart);
}

void tearDown(void) {}

static byte_stream_outcome_t reads(uint8_t *bytes, size_t room, size_t *count) {
    *count = 77;
    return stream.api->read(stream.context, bytes, room, count);
}

static void test_opens(void) {
    TEST_ASSERT_EQUAL_HEX32(0x202c, port.cr1);
    TEST_ASSERT_EQUAL_HEX32(0, port.cr2 | port.cr3);
    TEST_ASSERT_EQUAL_UINT32(729, port.brr); /* 84 MHz / 115200 = 729.17 */
}

static void test_bad_rates_are_refused(void) {
    static const struct {
        uint32_t clock_hz, baud;
    } bad[] = {{84000000, 0},      {84000000, 6000000}, {84000000, 1000}, {0, 115200},
               {16000000, 970000}, {UINT32_MAX, 1},     {1, UINT32_MAX}};
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        io_model_hook(NULL, NULL);
        TEST_ASSERT_FALSE(stm32_usart_open(&usart, &block, bad[i].clock_hz, bad[i].baud));
        TEST_ASSERT_EQUAL_UINT32(0, io_model_accesses());
    }
    TEST_ASSERT_TRUE(stm32_usart_open(&usart, &block, 16000000, 115200));
    TEST_ASSERT_EQUAL_UINT32(139, port.brr);
}

static void test_bytes_go_out_in_order(void) {
    support_random_start();
    uint8_t bytes[64];
    uint32_t given = 0;
    for (uint32_t i = 0; i < support_runs(20000); i++) {
        const size_t length = 1u + support_index(sizeof bytes);
        for (size_t k = 0; k < length; k++) {
            bytes[k] = (uint8_t)((given + k) * 7u & 0xffu);
        }
        size_t count = 77;
        const byte_stream_outcome_t outcome =
            stream.api->write(stream.context, bytes, length, &count);
        TEST_ASSERT_EQUAL_INT(count > 0 ? BYTE_STREAM_DONE : BYTE_STREAM_AGAIN, outcome);
        TEST_ASSERT_TRUE(count <= length);
        given += (uint32_t)count;
        for (uint32_t k = support_index(80); k > 0 && given - port.sent_count > 0; k--) {
            interrupts();
            line_sends();
        }
        if (port.sent_count > 90000) {
            break;
        }
    }
    while (port.sent_count < given) {
        interrupts();
        line_sends();
    }
    for (uint32_t i = 0; i < given; i++) {
        TEST_ASSERT_EQUAL_HEX8(i * 7u & 0xffu, port.sent[i]);
    }
    interrupts();
    TEST_ASSERT_EQUAL_HEX32(0, port.cr1 & 1u << 7); /* the interrupt rests */
    TEST_ASSERT_TRUE(given > 1000);
}

static void test_a_full_ring_takes_nothing(void) {
    uint8_t bytes[STM32_USART_RING + 10u] = {0};
    size_t count;
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_DONE,
                          stream.api->write(stream.context, bytes, sizeof bytes, &count));
    TEST_ASSERT_EQUAL_UINT32(STM32_USART_RING, count);
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_AGAIN, stream.api->write(stream.context, bytes, 1, &count));
    TEST_ASSERT_EQUAL_UINT32(0, count);
}

static void test_bytes_come_in(void) {
    uint8_t bytes[300];
    size_t count;
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_AGAIN, reads(bytes, sizeof bytes, &count));
    TEST_ASSERT_EQUAL_UINT32(0, count);
    for (uint32_t round = 0; round < 20; round++) {
        for (uint32_t i = 0; i < 256; i++) {
            line_receives((uint8_t)i);
            interrupts();
        }
        TEST_ASSERT_TRUE(stm32_usart_has_input(&usart));
        TEST_ASSERT_EQUAL_INT(BYTE_STREAM_DONE, reads(bytes, 100, &count));
        TEST_ASSERT_EQUAL_UINT32(100, count);
        TEST_ASSERT_EQUAL_INT(BYTE_STREAM_DONE, reads(&bytes[100], 200, &count));
        TEST_ASSERT_EQUAL_UINT32(156, count);
        for (uint32_t i = 0; i < 256; i++) {
            TEST_ASSERT_EQUAL_HEX8(i, bytes[i]);
        }
        TEST_ASSERT_FALSE(stm32_usart_has_input(&usart));
    }
    TEST_ASSERT_EQUAL_UINT32(0, usart.lost);
}

static void expect_gap(uint32_t before, uint8_t after) {
    static uint8_t bytes[2 * STM32_USART_RING];
    size_t count;
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_DONE, reads(bytes, sizeof bytes, &count));
    TEST_ASSERT_EQUAL_UINT32(before, count);
    line_receives(0xee); /* thrown away: the loss has not been told */
    interrupts();
    TEST_ASSERT_TRUE(stm32_usart_has_input(&usart));
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_FAILED, reads(bytes, sizeof bytes, &count));
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_AGAIN, reads(bytes, sizeof bytes, &count));
    line_receives(after);
    interrupts();
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_DONE, reads(bytes, sizeof bytes, &count));
    TEST_ASSERT_EQUAL_UINT32(1, count);
    TEST_ASSERT_EQUAL_HEX8(after, bytes[0]);
}

static void test_an_overrun_is_told_between_before_and_after(void) {
    line_receives('a');
    line_receives('b'); /* before the interrupt was served */
    interrupts();
    TEST_ASSERT_EQUAL_UINT32(1, usart.lost);
    expect_gap(1, 'z');
}

/* The flag alone: there is no byte to be had. */
static void test_an_overrun_without_a_byte(void) {
    usart.lost = UINT32_MAX;
    port.ore = true;
    port.rdr = 'q';
    interrupts();
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, usart.lost);
    uint8_t byte;
    size_t count;
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_FAILED, reads(&byte, 1, &count));
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_AGAIN, reads(&byte, 1, &count));
}

static void test_a_full_receive_ring_is_told_likewise(void) {
    for (uint32_t i = 0; i < STM32_USART_RING + 5u; i++) {
        line_receives((uint8_t)(i & 0xffu));
        interrupts();
    }
    TEST_ASSERT_EQUAL_UINT32(5, usart.lost);
    expect_gap(STM32_USART_RING, 'z');
}

static void test_the_log_writes_whole_lines_or_none(void) {
    const berth_log_t log = stm32_usart_log(&usart);
    char text[STM32_USART_RING];
    log.api->line(log.context, "hello");
    for (int i = 0; i < 20; i++) {
        interrupts();
        line_sends();
    }
    TEST_ASSERT_EQUAL_UINT32(7, port.sent_count);
    TEST_ASSERT_EQUAL_MEMORY("hello\r\n", port.sent, 7);
    memset(text, 'x', sizeof text);
    text[STM32_USART_RING - 2u] = '\0';
    text[STM32_USART_RING - 2u] = 'x';
    text[STM32_USART_RING - 1u] = '\0';
    log.api->line(log.context, text); /* its end would not fit */
    TEST_ASSERT_EQUAL_UINT32(1, usart.lines_dropped);
    TEST_ASSERT_EQUAL_UINT32(usart.waiting.tail, usart.waiting.head);
    text[STM32_USART_RING - 2u] = '\0';
    log.api->line(log.context, text); /* just fits */
    TEST_ASSERT_EQUAL_UINT32(1, usart.lines_dropped);
    log.api->line(log.context, "");
    TEST_ASSERT_EQUAL_UINT32(2, usart.lines_dropped);
    usart.lines_dropped = UINT32_MAX;
    log.api->line(log.context, "");
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, usart.lines_dropped);
}

static void test_last_words_wait_for_a_while(void) {
    stm32_usart_put(&usart, 'x');
    TEST_ASSERT_EQUAL_HEX8('x', port.tdr);
    line_sends();
    port.stuck = true;
    io_model_hook(NULL, NULL);
    stm32_usart_put(&usart, 'y');
    TEST_ASSERT_EQUAL_UINT32(STM32_USART_PUT_LOOKS, io_model_accesses());
    TEST_ASSERT_FALSE(port.tdr_full);
}

/* A port whose interrupt never comes. */
static void test_polling_does_without_the_interrupt(void) {
    size_t count;
    stream.api->write(stream.context, (const uint8_t *)"abc", 3, &count);
    line_receives('x');
    for (int i = 0; i < 5; i++) {
        stm32_usart_poll(&usart);
        line_sends();
    }
    TEST_ASSERT_EQUAL_UINT32(3, port.sent_count);
    TEST_ASSERT_EQUAL_MEMORY("abc", port.sent, 3);
    uint8_t byte;
    TEST_ASSERT_EQUAL_INT(BYTE_STREAM_DONE, reads(&byte, 1, &count));
    TEST_ASSERT_EQUAL_HEX8('x', byte);
    TEST_ASSERT_FALSE(io_model_masked());
}

static void strike(void *context, uint32_t number) {
    (void)context;
    (void)number;
    if (support_index(3) == 0) {
        line_sends();
    }
    if (line()) {
        stm32_usart_interrupt(&usart);
    }
}

/* The interrupt between any two accesses of a write: no byte stays behind. */
static void test_no_byte_is_forgotten(void) {
    support_random_start();
    uint32_t given = 0;
    io_model_hook(strike, NULL);
    for (uint32_t i = 0; i < support_runs(20000); i++) {
        const uint8_t byte = (uint8_t)(given & 0xffu);
        size_t count;
        stream.api->write(stream.context, &byte, 1, &count);
        given += (uint32_t)count;
        if (support_index(3) == 0) {
            for (int k = 0; k < 5; k++) {
                line_sends();
                if (line()) {
                    stm32_usart_interrupt(&usart);
                }
            }
        }
    }
    io_model_hook(NULL, NULL);
    for (uint32_t i = 0; i < 3u * STM32_USART_RING; i++) {
        line_sends();
        interrupts();
    }
    TEST_ASSERT_EQUAL_UINT32(given, port.sent_count);
    for (uint32_t i = 0; i < given; i++) {
        TEST_ASSERT_EQUAL_HEX8(i & 0xffu, port.sent[i]);
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_opens);
    RUN_TEST(test_bad_rates_are_refused);
    RUN_TEST(test_bytes_go_out_in_order);
    RUN_TEST(test_a_full_ring_takes_nothing);
    RUN_TEST(test_bytes_come_in);
    RUN_TEST(test_an_overrun_is_told_between_before_and_after);
    RUN_TEST(test_an_overrun_without_a_byte);
    RUN_TEST(test_a_full_receive_ring_is_told_likewise);
    RUN_TEST(test_the_log_writes_whole_lines_or_none);
    RUN_TEST(test_last_words_wait_for_a_while);
    RUN_TEST(test_polling_does_without_the_interrupt);
    RUN_TEST(test_no_byte_is_forgotten);
    return UNITY_END();
}
