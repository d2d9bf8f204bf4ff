/* A drive board: two ODrives on CAN, a plan in flash, a prompt on the serial line. */
#include "stm32f405_board.h"

#include "berth/berth.h"
#include "berth/board.h"
#include "berth/link.h"
#include "plan.h"
#include "prompt.h"

/* The robot. */
#define WHEEL_RADIUS_M 0.05f
#define TRACK_M 0.30f
#define LEFT_NODE 0u
#define RIGHT_NODE 1u

/* The main loop comes round once in a millisecond or so, and in 5 when it has most to do. */
#define WATCHDOG_US 50000u

#define PROMPT_PERIOD_US 2000

static berth_board_t board;
static berth_link_t link;
static prompt_t prompt;

static void say_start(void) {
    const stm32f4_clocks_t *clocks = stm32f405_clocks();
    board_puts("\r\nberth on stm32f405\r\n");
    if (stm32f405_was_reset_by_watchdog()) {
        board_puts("RESET BY THE WATCHDOG\r\n");
    }
    if (clocks->crystal) {
        board_puts("clock: crystal, 168 MHz\r\n");
    } else {
        board_puts("clock: INTERNAL, 16 MHz: ");
        board_puts(clocks->problem);
        board_puts("\r\n");
    }
}

static berth_board_config_t configuration(void) {
    berth_board_config_t config =
        berth_board_config_default(WHEEL_RADIUS_M, TRACK_M, drive_plan.period_us);
    config.drives[BERTH_LEFT].protocol = &berth_drive_odrive;
    config.drives[BERTH_LEFT].node = LEFT_NODE;
    config.drives[BERTH_RIGHT].protocol = &berth_drive_odrive;
    config.drives[BERTH_RIGHT].node = RIGHT_NODE;
    return config;
}

static bool open_board(void) {
    berth_refusal_t refusal;
    const berth_board_config_t config = configuration();
    const berth_error_t error =
        berth_board_init(&board, &drive_plan, &config, board_now_us(), &refusal);
    if (error != BERTH_OK) {
        board_puts("board: ");
        board_puts(berth_error_text(error));
        board_puts(": ");
        board_puts(berth_field_text(refusal.field));
        board_puts("\r\n");
    }
    return error == BERTH_OK;
}

/* Without the crystal the bit rate would be off, and our frames would disturb everybody's. */
static const char *open_bus(void) {
    berth_can_filter_t filters[BERTH_BOARD_FILTERS_MAX];
    if (!stm32f405_clocks()->crystal) {
        return "not opened without the crystal";
    }
    const uint32_t count = berth_board_filters(&board, filters);
    return stm32_can_result_text(stm32f405_can_open(filters, count));
}

static int64_t sooner(int64_t a, int64_t b) {
    return a < b ? a : b;
}

int main(void) {
    say_start();
    if (!open_board()) {
        return BOARD_STATUS_FAULT;
    }
    const char *bus_text = open_bus();
    const berth_can_t can = stm32f405_can();
    const berth_clock_t clock = stm32f405_clock();
    berth_link_init(&link, &board, &can);
    prompt_init(&prompt, &board, &can, stm32f405_console());
    prompt_say(&prompt, "can", bus_text);
    if (!stm32f405_watchdog_start(WATCHDOG_US)) {
        prompt_say(&prompt, "watchdog", "did not start");
    }
    for (;;) {
        stm32f405_watchdog_feed();
        berth_link_run(&link, clock.api->now_us(clock.context));
        const int64_t now_us = clock.api->now_us(clock.context);
        prompt_run(&prompt, now_us);
        stm32f405_console_poll();
        clock.api->sleep_until_us(clock.context,
                                  sooner(berth_link_deadline(&link), now_us + PROMPT_PERIOD_US));
    }
}
