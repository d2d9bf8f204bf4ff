#include "berth/link.h"

#include "count.h"

void berth_link_init(berth_link_t *link, berth_board_t *board, const berth_can_t *can) {
    *link = (berth_link_t){.board = board, .can = *can};
}

static void fail(berth_link_t *link) {
    link->failed = true;
    count(&link->failures);
}

static void report(berth_link_t *link, int64_t now_us) {
    berth_can_state_t state = {.mode = BERTH_CAN_DOWN};
    link->can.api->state(link->can.context, &state);
    berth_board_bus(link->board, state.mode, link->failed, now_us);
}

static void receive(berth_link_t *link, int64_t now_us) {
    link->more = true;
    for (uint32_t i = 0; i < BERTH_LINK_RECEIVE_MAX; i++) {
        berth_can_frame_t frame;
        const berth_can_outcome_t outcome = link->can.api->receive(link->can.context, &frame);
        if (outcome != BERTH_CAN_DONE) {
            if (outcome != BERTH_CAN_AGAIN) {
                fail(link);
            }
            link->more = false;
            return;
        }
        berth_board_receive(link->board, &frame, now_us);
    }
}

/* The outbox is the bound: nothing is put into it here. */
static void transmit(berth_link_t *link, int64_t now_us) {
    for (uint32_t i = 0; i < BERTH_OUTBOX_MAX; i++) {
        const berth_can_frame_t *frame = berth_board_front(link->board);
        if (frame == NULL) {
            return;
        }
        const berth_can_outcome_t outcome = link->can.api->send(link->can.context, frame);
        if (outcome != BERTH_CAN_DONE) {
            if (outcome == BERTH_CAN_AGAIN) {
                count(&link->send_again);
            } else {
                fail(link);
            }
            return;
        }
        berth_board_sent(link->board, now_us);
    }
}

void berth_link_run(berth_link_t *link, int64_t now_us) {
    link->run_us = now_us < BERTH_TIME_MAX_US ? now_us : BERTH_TIME_MAX_US;
    link->failed = false;
    receive(link, now_us);
    report(link, now_us);
    berth_board_step(link->board, now_us);
    transmit(link, now_us);
    if (link->failed) { /* found while sending: the board is told in the same run */
        report(link, now_us);
    }
}

int64_t berth_link_deadline(const berth_link_t *link) {
    const int64_t deadline_us = berth_board_deadline(link->board);
    if (link->more) {
        return link->run_us;
    }
    if (berth_board_front(link->board) == NULL) {
        return deadline_us;
    }
    const int64_t wait_us = link->failed ? BERTH_LINK_FAILED_US : BERTH_LINK_RETRY_US;
    const int64_t retry_us = link->run_us + wait_us;
    return retry_us < deadline_us ? retry_us : deadline_us;
}
