#include "berth/link.h"
#include "mps2_board.h"
#include "pil.h"
#include "pil_clock.h"
#include "slcan.h"

/* After the stop the board stays for so long, so that all hear of it. */
#define LINGER_US 2000000

typedef struct {
    const pil_options_t *options;
    berth_board_t board;
    berth_link_t link;
    slcan_t line;
    berth_can_filter_t filters[BERTH_BOARD_FILTERS_MAX];
    berth_supervisor_state_t told;
    uint8_t told_fault;
    bool stopped;    /* the run was stopped at its end */
    int64_t idle_us; /* since when the board is idle after it */
} live_t;

static void tell(live_t *live) {
    const berth_board_status_t *status = berth_board_status(&live->board);
    if (status->state == live->told && status->fault == live->told_fault) {
        return;
    }
    live->told = status->state;
    live->told_fault = status->fault;
    board_puts("state ");
    board_puts(berth_supervisor_state_text(status->state));
    if (status->fault != BERTH_FAULT_NONE) {
        board_puts(": ");
        board_puts(berth_fault_side_text(status->fault));
        board_puts(berth_fault_text(status->fault));
    }
    board_puts("\n");
}

/* As a person at the buttons would. */
static void operate(live_t *live, int64_t now_us) {
    const berth_board_status_t *status = berth_board_status(&live->board);
    switch (status->state) {
    case BERTH_SUPERVISOR_IDLE:
        if (!live->stopped && status->pose_known && status->bus == BERTH_CAN_ERROR_ACTIVE) {
            berth_board_command(&live->board, BERTH_COMMAND_ARM, now_us);
        }
        break;
    case BERTH_SUPERVISOR_ARMED:
        berth_board_command(&live->board, BERTH_COMMAND_START, now_us);
        break;
    case BERTH_SUPERVISOR_RUNNING:
        if (berth_board_control(&live->board)->finished) {
            live->stopped = true;
            berth_board_command(&live->board, BERTH_COMMAND_STOP, now_us);
        }
        break;
    default:
        break;
    }
}

static bool is_over(live_t *live, int64_t now_us) {
    if (!live->stopped || berth_board_status(&live->board)->state != BERTH_SUPERVISOR_IDLE) {
        live->idle_us = now_us;
    }
    return now_us > live->idle_us + LINGER_US;
}

static void open_line(live_t *live, berth_clock_t clock) {
    const slcan_config_t config = {
        .role = SLCAN_ADAPTER,
        .stream = board_bus(),
        .clock = clock,
        .filters = live->filters,
        .filter_count = berth_board_filters(&live->board, live->filters),
    };
    slcan_init(&live->line, &config);
    const berth_can_t can = slcan_can(&live->line);
    berth_link_init(&live->link, &live->board, &can);
}

int pil_live(const pil_options_t *options) {
    static live_t live;
    const berth_clock_t clock = pil_clock_start();
    const bool copied = options->breaks == PIL_BREAK_PLAN;
    const berth_plan_t *plan = pil_plan(options);
    live.options = options;
    if (!pil_setup(&live.board, options, copied ? pil_break_plan_copy(plan) : plan,
                   clock.api->now_us(clock.context))) {
        board_puts("refused\n");
        return 1;
    }
    if (copied) {
        pil_break_plan();
    }
    open_line(&live, clock);
    board_puts("live\n");
    int64_t now_us = clock.api->now_us(clock.context);
    while (!options->self || !is_over(&live, now_us)) {
        now_us = clock.api->now_us(clock.context);
        berth_link_run(&live.link, now_us);
        if (options->self) {
            operate(&live, now_us);
        }
        tell(&live);
        pil_break(options, &live.board);
        clock.api->sleep_until_us(clock.context, berth_link_deadline(&live.link));
    }
    return 0;
}
