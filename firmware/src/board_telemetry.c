#include "board_parts.h"

void board_put_status(berth_board_t *board) {
    const berth_status_t *control = berth_controller_status(&board->controller);
    const berth_message_status_t status = {
        .state = (uint8_t)board->supervisor.state,
        .mode = (uint8_t)control->mode,
        .fault = board->supervisor.fault,
        .total = board->controller.reference.total,
        .active = control->active,
        .finished = control->finished,
        .braking = control->braking,
        .limited = control->limited != 0u,
        .clearance_m = control->active > 0u ? control->clearance_m : -1.0f,
    };
    berth_can_frame_t frame;
    berth_message_encode_status(&frame, board->address, &status);
    (void)berth_outbox_put(&board->outbox, &frame, BERTH_OUTBOX_LATEST);
}

static void put_pose(berth_board_t *board) {
    berth_can_frame_t frame;
    berth_message_encode_pose(&frame, BERTH_MESSAGE_POSE, board->address, &board->odometry.pose);
    (void)berth_outbox_put(&board->outbox, &frame, BERTH_OUTBOX_LATEST);
}

static void put_error(berth_board_t *board) {
    const berth_message_error_t error = {
        .error = berth_controller_status(&board->controller)->tracking_error,
        .v_mps = board->status.command.twist.v_mps,
    };
    berth_can_frame_t frame;
    berth_message_encode_error(&frame, board->address, &error);
    (void)berth_outbox_put(&board->outbox, &frame, BERTH_OUTBOX_LATEST);
}

void board_put_telemetry(berth_board_t *board) {
    if (board->telemetry_periods == 0u) {
        return;
    }
    if (board->telemetry_left > 1u) {
        board->telemetry_left--;
        return;
    }
    board->telemetry_left = board->telemetry_periods;
    board_put_status(board);
    if (board->odometry.known) { /* a pose that means nothing is not told */
        put_pose(board);
    }
    if (board->supervisor.state == BERTH_SUPERVISOR_RUNNING) {
        put_error(board);
    }
}

uint32_t berth_board_filters(const berth_board_t *board,
                             berth_can_filter_t filters[BERTH_BOARD_FILTERS_MAX]) {
    static const uint32_t kinds[] = {BERTH_MESSAGE_COMMAND, BERTH_MESSAGE_POSE_FIX,
                                     BERTH_MESSAGE_OBSTACLE};
    uint32_t used = 0;
    for (uint32_t i = 0; i < sizeof kinds / sizeof kinds[0]; i++) {
        filters[used] = (berth_can_filter_t){.id = (kinds[i] << 8) | board->address,
                                             .mask = BERTH_CAN_EXTENDED_MAX,
                                             .extended = true};
        used++;
    }
    for (int side = 0; side < 2; side++) {
        used += berth_drive_filters(&board->drives[side], &filters[used]);
    }
    return used;
}
