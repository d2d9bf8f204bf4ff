/* Watchdog and clock tree of the STM32F4, against models of their registers. */
#include "io_model.h"
#include "stm32_iwdg.h"
#include "stm32f4_clocks.h"
#include "support.h"

#include "unity.h"

#include <string.h>

/* ---- Watchdog ---------------------------------------------------------------------------------
 */

static stm32f4_iwdg_t iwdg_block;

static struct {
    uint32_t prescaler, reload;
    bool running, unlocked, stuck;
    uint32_t busy, feeds;
} iwdg;

static uint32_t iwdg_read(void *context, uint32_t offset) {
    (void)context;
    TEST_ASSERT_EQUAL_UINT32(0x0c, offset);
    if (iwdg.busy > 0 && !iwdg.stuck) {
        iwdg.busy--;
    }
    return iwdg.busy > 0 ? 3u : 0u;
}

static void iwdg_write(void *context, uint32_t offset, uint32_t value) {
    (void)context;
    switch (offset) {
    case 0x00:
        iwdg.running = iwdg.running || value == 0xcccc;
        iwdg.unlocked = value == 0x5555;
        iwdg.feeds += value == 0xaaaa ? 1u : 0u;
        break;
    case 0x04:
        TEST_ASSERT_TRUE(iwdg.unlocked && value <= 6);
        iwdg.prescaler = 4u << value;
        iwdg.busy = 5;
        break;
    case 0x08:
        TEST_ASSERT_TRUE(iwdg.unlocked && value <= 4095);
        iwdg.reload = value;
        iwdg.busy = 5;
        break;
    default:
        TEST_FAIL_MESSAGE("a register that is not modelled");
    }
}

/* At the fastest oscillator not before the time, and not much after. */
static void test_watchdog_times(void) {
    support_random_start();
    for (uint32_t i = 0; i < support_runs(3000); i++) {
        memset(&iwdg, 0, sizeof iwdg);
        const uint32_t timeout_us =
            (uint32_t)support_log_uniform(1, STM32_IWDG_TIMEOUT_MAX_US + 0.5);
        TEST_ASSERT_TRUE(stm32_iwdg_start(&iwdg_block, timeout_us));
        TEST_ASSERT_TRUE(iwdg.running && !iwdg.unlocked && iwdg.feeds == 1);
        const double least_us = 1e6 * iwdg.prescaler * iwdg.reload / 47000.0;
        const double tick_us = 1e6 * iwdg.prescaler / 47000.0;
        TEST_ASSERT_TRUE(least_us >= timeout_us);
        TEST_ASSERT_TRUE(least_us <= timeout_us + 2.0 * tick_us);
        TEST_ASSERT_TRUE(iwdg.prescaler == 4 || iwdg.reload > 2000);
    }
    stm32_iwdg_feed(&iwdg_block);
    TEST_ASSERT_EQUAL_UINT32(2, iwdg.feeds);
}

static void test_watchdog_refuses_and_gives_up(void) {
    memset(&iwdg, 0, sizeof iwdg);
    TEST_ASSERT_FALSE(stm32_iwdg_start(&iwdg_block, 0));
    TEST_ASSERT_FALSE(stm32_iwdg_start(&iwdg_block, STM32_IWDG_TIMEOUT_MAX_US + 1u));
    TEST_ASSERT_FALSE(iwdg.running);
    iwdg.stuck = true;
    TEST_ASSERT_FALSE(stm32_iwdg_start(&iwdg_block, 1000));
    TEST_ASSERT_TRUE(io_model_accesses() <= STM32_IWDG_WAIT_LOOKS + 10u);
}

/* ---- Clock tree -------------------------------------------------------------------------------
 */

static stm32f4_rcc_t rcc_block;
static stm32f4_flash_t flash_block;

enum { NO_CRYSTAL = 1, NO_LOCK = 2, NO_SWITCH = 4, NO_WAIT_STATES = 8, DEAD = 16 };

static struct {
    uint32_t broken;
    uint32_t cr, pllcfgr, cfgr, acr;
    uint32_t delay, countdown;
    uint32_t hse_hz;
} rcc;

static uint32_t core_hz(void) {
    const uint32_t source = rcc.cfgr >> 2 & 3u;
    if (source == 2) {
        const uint64_t input = rcc.hse_hz / (rcc.pllcfgr & 0x3fu);
        TEST_ASSERT_TRUE(input >= 1000000 && input <= 2000000);
        const uint64_t vco = input * (rcc.pllcfgr >> 6 & 0x1ffu);
        TEST_ASSERT_TRUE(vco >= 100000000 && vco <= 432000000);
        return (uint32_t)(vco / (2u * ((rcc.pllcfgr >> 16 & 3u) + 1u)));
    }
    return source == 0 ? 16000000u : rcc.hse_hz;
}

static uint32_t divided(uint32_t hz, uint32_t code) {
    return (code & 4u) != 0 ? hz >> ((code & 3u) + 1u) : hz;
}

/* What the data sheet forbids. */
static void check_limits(void) {
    const uint32_t wait_states = rcc.acr & 7u;
    TEST_ASSERT_TRUE(core_hz() <= 168000000u);
    TEST_ASSERT_TRUE(divided(core_hz(), rcc.cfgr >> 10 & 7u) <= 42000000u);
    TEST_ASSERT_TRUE(divided(core_hz(), rcc.cfgr >> 13 & 7u) <= 84000000u);
    TEST_ASSERT_TRUE(core_hz() <= 30000000u * (wait_states + 1u));
}

static void settle(void) {
    if (rcc.countdown > 0) {
        rcc.countdown--;
        return;
    }
    const uint32_t ready =
        ((rcc.cr & 1u) != 0 ? 1u << 1 : 0u) |
        ((rcc.cr & 1u << 16) != 0 && (rcc.broken & NO_CRYSTAL) == 0 ? 1u << 17 : 0u) |
        ((rcc.cr & 1u << 24) != 0 && (rcc.broken & NO_LOCK) == 0 ? 1u << 25 : 0u);
    rcc.cr = (rcc.cr & ~(1u << 1 | 1u << 17 | 1u << 25)) | ready;
    const uint32_t wanted = rcc.cfgr & 3u;
    const bool there =
        wanted == 0 || (wanted == 2 && (rcc.cr & 1u << 25) != 0 && (rcc.broken & NO_SWITCH) == 0);
    if (there) {
        rcc.cfgr = (rcc.cfgr & ~0xcu) | wanted << 2;
    }
    check_limits();
}

static uint32_t rcc_read(void *context, uint32_t offset) {
    (void)context;
    if (rcc.broken == DEAD) {
        return 0;
    }
    settle();
    return offset == 0 ? rcc.cr : offset == 4 ? rcc.pllcfgr : offset == 8 ? rcc.cfgr : 0;
}

static void rcc_write(void *context, uint32_t offset, uint32_t value) {
    (void)context;
    rcc.countdown = rcc.delay;
    switch (offset) {
    case 0:
        if (rcc.broken == DEAD) {
            value = 1; /* whatever is written */
        }
        if ((rcc.cfgr >> 2 & 3u) == 2) {
            TEST_ASSERT_TRUE_MESSAGE((value & 1u << 24) != 0, "the PLL in use was switched off");
        }
        if ((value & rcc.cr & 1u << 24) != 0) {
            TEST_ASSERT_TRUE_MESSAGE((value & 1u << 16) != 0 || (rcc.pllcfgr & 1u << 22) == 0,
                                     "the running PLL's crystal was switched off");
        }
        rcc.cr = (value & ~0x02020002u) | (rcc.cr & 0x02020002u);
        break;
    case 4:
        TEST_ASSERT_EQUAL_HEX32_MESSAGE(0, rcc.cr & (1u << 24), "the PLL was set while on");
        rcc.pllcfgr = value;
        break;
    case 8:
        rcc.cfgr = (value & ~0xcu) | (rcc.cfgr & 0xcu);
        check_limits();
        break;
    default:
        TEST_FAIL_MESSAGE("a register that is not modelled");
    }
}

static uint32_t flash_read(void *context, uint32_t offset) {
    (void)context;
    TEST_ASSERT_EQUAL_UINT32(0, offset);
    return rcc.acr;
}

static void flash_write(void *context, uint32_t offset, uint32_t value) {
    (void)context;
    TEST_ASSERT_EQUAL_UINT32(0, offset);
    if ((rcc.broken & (NO_WAIT_STATES | DEAD)) == 0) {
        rcc.acr = value;
    }
}

static void reset_rcc(uint32_t hse_hz, uint32_t broken) {
    memset(&rcc, 0, sizeof rcc);
    rcc.hse_hz = hse_hz;
    rcc.broken = broken;
    rcc.cr = 0x80; /* a boot loader may have switched the internal oscillator off */
    rcc.pllcfgr = 0x24003010;
    rcc.delay = 3;
}

static void test_168_mhz_from_any_crystal(void) {
    for (uint32_t mhz = 4; mhz <= 26; mhz += 2) {
        stm32f4_clocks_t clocks;
        reset_rcc(mhz * 1000000u, 0);
        stm32f4_clocks_start(&rcc_block, &flash_block, mhz * 1000000u, &clocks);
        TEST_ASSERT_TRUE(clocks.crystal && clocks.problem == NULL);
        TEST_ASSERT_EQUAL_UINT32(168000000, clocks.core_hz);
        TEST_ASSERT_EQUAL_UINT32(clocks.core_hz, core_hz());
        TEST_ASSERT_EQUAL_UINT32(clocks.apb1_hz, divided(core_hz(), rcc.cfgr >> 10 & 7u));
        TEST_ASSERT_EQUAL_UINT32(clocks.apb2_hz, divided(core_hz(), rcc.cfgr >> 13 & 7u));
        TEST_ASSERT_EQUAL_HEX32(0x705, rcc.acr);
        TEST_ASSERT_EQUAL_HEX32(1u << 19, rcc.cr & 1u << 19); /* clock security */
        TEST_ASSERT_EQUAL_UINT32(7, rcc.pllcfgr >> 24 & 0xfu);
    }
}

static void falls_back(uint32_t hse_hz, uint32_t crystal_hz, uint32_t broken) {
    stm32f4_clocks_t clocks;
    reset_rcc(hse_hz, broken);
    io_model_hook(NULL, NULL);
    stm32f4_clocks_start(&rcc_block, &flash_block, crystal_hz, &clocks);
    TEST_ASSERT_FALSE(clocks.crystal);
    TEST_ASSERT_NOT_NULL(clocks.problem);
    TEST_ASSERT_EQUAL_UINT32(16000000, clocks.core_hz);
    TEST_ASSERT_EQUAL_UINT32(16000000, clocks.apb1_hz);
    TEST_ASSERT_EQUAL_UINT32(16000000, clocks.apb2_hz);
    TEST_ASSERT_EQUAL_UINT32(16000000, core_hz());
    TEST_ASSERT_EQUAL_HEX32(0, rcc.cfgr & 0xfcf3u);
    TEST_ASSERT_EQUAL_HEX32(1, rcc.cr & (1u | 1u << 16 | 1u << 18 | 1u << 19 | 1u << 24));
    TEST_ASSERT_TRUE(io_model_accesses() <= 8u * STM32F4_CLOCKS_LOOKS);
}

static void test_falls_back_when_anything_does_not_come(void) {
    falls_back(8000000, 8000000, NO_CRYSTAL);
    falls_back(8000000, 8000000, NO_LOCK);
    falls_back(8000000, 8000000, NO_SWITCH);
    falls_back(8000000, 8000000, NO_WAIT_STATES);
    falls_back(8000000, 8000000, DEAD);
}

static void test_impossible_crystals_are_answered_with_the_internal_oscillator(void) {
    static const uint32_t bad[] = {0, 2000000, 5000000, 8000001, 28000000, UINT32_MAX};
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        falls_back(8000000, bad[i], 0);
    }
}

/* A boot loader may have left the PLL running. */
static void test_starts_from_a_running_pll(void) {
    stm32f4_clocks_t clocks;
    reset_rcc(8000000, 0);
    for (int i = 0; i < 2; i++) {
        stm32f4_clocks_start(&rcc_block, &flash_block, 8000000, &clocks);
        TEST_ASSERT_TRUE(clocks.crystal);
    }
}

void setUp(void) {
    static const io_model_ops_t iwdg_ops = {iwdg_read, iwdg_write};
    static const io_model_ops_t rcc_ops = {rcc_read, rcc_write};
    static const io_model_ops_t flash_ops = {flash_read, flash_write};
    io_model_reset();
    io_model_map(&iwdg_block, sizeof iwdg_block, &iwdg_ops, NULL);
    io_model_map(&rcc_block, sizeof rcc_block, &rcc_ops, NULL);
    io_model_map(&flash_block, sizeof flash_block, &flash_ops, NULL);
}

void tearDown(void) {}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_watchdog_times);
    RUN_TEST(test_watchdog_refuses_and_gives_up);
    RUN_TEST(test_168_mhz_from_any_crystal);
    RUN_TEST(test_falls_back_when_anything_does_not_come);
    RUN_TEST(test_impossible_crystals_are_answered_with_the_internal_oscillator);
    RUN_TEST(test_starts_from_a_running_pll);
    return UNITY_END();
}
