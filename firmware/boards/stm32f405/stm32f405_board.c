#include "stm32f405_board.h"

#include "bxcan.h"
#include "start.h"
#include "stm32_clock.h"
#include "stm32_iwdg.h"
#include "stm32_usart.h"
#include "vectors.h"

#define BLOCK(type, address) ((type *)(uintptr_t)(address))
#define RCC BLOCK(stm32f4_rcc_t, STM32F4_RCC_ADDRESS)
#define FLASH BLOCK(stm32f4_flash_t, STM32F4_FLASH_ADDRESS)
#define GPIOA BLOCK(stm32f4_gpio_t, STM32F4_GPIOA_ADDRESS)
#define GPIOB BLOCK(stm32f4_gpio_t, STM32F4_GPIOB_ADDRESS)
#define USART1 BLOCK(stm32f4_usart_t, STM32F4_USART1_ADDRESS)
#define IWDG BLOCK(stm32f4_iwdg_t, STM32F4_IWDG_ADDRESS)
#define CAN1 BLOCK(bxcan_regs_t, STM32F4_CAN1_ADDRESS)

#define NVIC_ISER_ADDRESS 0xe000e100u
#define CONSOLE_BAUD 115200u
#define CONSOLE_POLL_BYTES 16u
#define INTERRUPT_LINES 82

#define PIN_ALTERNATE 2u
#define PIN_FAST 2u
#define PIN_PULL_UP 1u
#define USART_FUNCTION 7u
#define CAN_FUNCTION 9u

static bxcan_t bus;
static stm32_usart_t console;
static stm32f4_clocks_t clocks;
static stm32_clock_t system_clock;
static bool reset_by_watchdog;

static bool has_input(void *context) {
    (void)context;
    return bxcan_has_input(&bus) || stm32_usart_has_input(&console);
}

/* A pin of a peripheral's, pulled up. pin: 8 to 15. */
static void set_pin(stm32f4_gpio_t *port, uint32_t pin, uint32_t function) {
    const uint32_t pair = STM32_FIELD(2u * pin, 2);
    const uint32_t nibble = STM32_FIELD(4u * (pin - 8u), 4);
    stm32_change(&port->afrh, nibble, stm32_put(nibble, function));
    stm32_change(&port->ospeedr, pair, stm32_put(pair, PIN_FAST));
    stm32_change(&port->pupdr, pair, stm32_put(pair, PIN_PULL_UP));
    stm32_change(&port->moder, pair, stm32_put(pair, PIN_ALTERNATE));
}

static void enable_interrupt(uint32_t line) {
    volatile uint32_t *enable = BLOCK(volatile uint32_t, NVIC_ISER_ADDRESS);
    stm32_write(&enable[line / 32u], STM32_BIT(line % 32u));
}

void board_open(void) {
    reset_by_watchdog = (stm32_read(&RCC->csr) & RCC_CSR_WDGRSTF) != 0;
    stm32_change(&RCC->csr, 0, RCC_CSR_RMVF);
    stm32f4_clocks_start(RCC, FLASH, STM32F405_CRYSTAL_HZ, &clocks);
    stm32_change(&RCC->ahb1enr, 0, RCC_AHB1ENR_GPIOAEN | RCC_AHB1ENR_GPIOBEN);
    stm32_change(&RCC->apb2enr, 0, RCC_APB2ENR_USART1EN);
    stm32_change(&RCC->apb1enr, 0, RCC_APB1ENR_CAN1EN);
    /* A switched-on clock takes a moment to arrive; reading the register back is longer. */
    (void)stm32_read(&RCC->apb1enr);
    set_pin(GPIOA, 9, USART_FUNCTION);
    set_pin(GPIOA, 10, USART_FUNCTION);
    set_pin(GPIOB, 8, CAN_FUNCTION);
    set_pin(GPIOB, 9, CAN_FUNCTION);
    (void)stm32_usart_open(&console, USART1, clocks.apb2_hz, CONSOLE_BAUD);
    enable_interrupt(STM32F4_USART1_IRQ);
    const stm32_clock_config_t config = {
        .systick = BLOCK(stm32_systick_t, STM32_SYSTICK_ADDRESS),
        .icsr = BLOCK(volatile uint32_t, STM32_ICSR_ADDRESS),
        .clock_hz = clocks.core_hz,
        .wakes = has_input,
    };
    (void)stm32_clock_start(&system_clock, &config);
}

void cortex_m_tick(void) {
    stm32_clock_tick(&system_clock);
}

static void usart1_interrupt(void) {
    stm32_usart_interrupt(&console);
}

static void can1_receive_interrupt(void) {
    bxcan_receive_interrupt(&bus);
}

static void can1_status_interrupt(void) {
    bxcan_status_interrupt(&bus);
}

__attribute__((section(".vectors"), used))
const cortex_m_vector_t stm32f405_vectors[16 + INTERRUPT_LINES] = {
    CORTEX_M_VECTORS,
    [16 + STM32F4_CAN1_RX0_IRQ] = {.handler = can1_receive_interrupt},
    [16 + STM32F4_CAN1_SCE_IRQ] = {.handler = can1_status_interrupt},
    [16 + STM32F4_USART1_IRQ] = {.handler = usart1_interrupt},
};

/* A fault may come before the console is there. */
void board_write(const char *text, size_t length) {
    for (size_t i = 0; i < length && console.regs != NULL; i++) {
        stm32_usart_put(&console, (uint8_t)text[i]);
    }
}

int64_t board_now_us(void) {
    const berth_clock_t clock = stm32f405_clock();
    return clock.api->now_us(clock.context);
}

const stm32f4_clocks_t *stm32f405_clocks(void) {
    return &clocks;
}

bool stm32f405_was_reset_by_watchdog(void) {
    return reset_by_watchdog;
}

berth_clock_t stm32f405_clock(void) {
    return stm32_clock(&system_clock);
}

byte_stream_t stm32f405_console(void) {
    return stm32_usart_stream(&console);
}

void stm32f405_console_poll(void) {
    for (uint32_t i = 0; i < CONSOLE_POLL_BYTES; i++) {
        stm32_usart_poll(&console);
    }
}

berth_can_t stm32f405_can(void) {
    return bxcan_can(&bus);
}

stm32_can_result_t stm32f405_can_open(const berth_can_filter_t *filters, uint32_t filter_count) {
    const bxcan_config_t config = bxcan_config_default(CAN1, stm32f405_clock(), clocks.apb1_hz);
    const stm32_can_result_t result = bxcan_open(&bus, &config, filters, filter_count);
    if (result == STM32_CAN_OK || result == STM32_CAN_ERROR_NOT_JOINED) {
        enable_interrupt(STM32F4_CAN1_RX0_IRQ);
        enable_interrupt(STM32F4_CAN1_SCE_IRQ);
    }
    return result;
}

bool stm32f405_watchdog_start(uint32_t timeout_us) {
    return stm32_iwdg_start(IWDG, timeout_us);
}

void stm32f405_watchdog_feed(void) {
    stm32_iwdg_feed(IWDG);
}
