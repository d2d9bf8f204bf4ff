/* The whole board, from init on, in any order of calls; with LINK the loop around it on a platform
 * that answers whatever it likes. */
#include "scene.h"

#ifndef LEFT
#define LEFT berth_drive_odrive
#define RIGHT berth_drive_odrive
#endif

static berth_plan_t plan;
static berth_board_t board;
static berth_refusal_t refusal;

#ifdef LINK
static berth_link_t link;

static berth_can_outcome_t send_any(void *context, const berth_can_frame_t *frame) {
    (void)context;
    (void)frame;
    return ANY_ENUM(berth_can_outcome_t);
}

static berth_can_outcome_t receive_any(void *context, berth_can_frame_t *frame) {
    (void)context;
    *frame = any_frame();
    return ANY_ENUM(berth_can_outcome_t);
}

static void state_any(void *context, berth_can_state_t *state) {
    (void)context;
    state->mode = ANY_ENUM(berth_can_mode_t);
}

static const berth_can_api_t platform = {send_any, receive_any, state_any};

static void start_link(void) {
    const berth_can_t can = {&platform, NULL};
    berth_link_init(&link, &board, &can);
}

static void run_link(void) {
    berth_link_run(&link, any_i64());
    (void)berth_link_deadline(&link);
}
#else
static void start_link(void) {}

static void run_link(void) {}
#endif

static void call_any(void) {
    const int64_t now_us = any_i64();
    const berth_can_frame_t frame = any_frame();
    (void)frame;
    berth_can_filter_t filters[BERTH_BOARD_FILTERS_MAX];
    const berth_pose_t pose = any_pose();
    berth_obstacle_t obstacle;
    switch (Frama_C_interval(0, 9)) {
    case 0:
        ANY_BYTES(obstacle);
        (void)berth_board_add_obstacle(&board, &obstacle, &refusal);
        break;
    case 1:
        (void)berth_board_set_pose(&board, &pose, now_us);
        break;
    case 2:
        berth_board_command(&board, ANY_ENUM(berth_command_code_t), now_us);
        break;
#ifndef LINK /* which calls these */
    case 3:
        berth_board_receive(&board, &frame, now_us);
        break;
    case 4:
        berth_board_bus(&board, ANY_ENUM(berth_can_mode_t), any_bool(), now_us);
        break;
    case 5:
        berth_board_step(&board, now_us);
        break;
    case 7:
        (void)berth_board_front(&board);
        berth_board_sent(&board, now_us);
        break;
#endif
    case 6:
        (void)berth_board_deadline(&board);
        (void)berth_board_status(&board);
        (void)berth_board_control(&board);
        (void)berth_board_drive(&board, Frama_C_int_interval(INT32_MIN, INT32_MAX));
        break;
    case 8:
        run_link();
        break;
    default:
        (void)berth_board_filters(&board, filters);
        (void)berth_board_digest(&board);
        break;
    }
}

static void call_all(void) {
    /*@ widen_hints global:"all", HINTS; */
    while (any_bool()) {
        call_any();
    }
}

static berth_board_config_t any_board_config(void) {
    berth_board_config_t config;
    ANY_BYTES(config);
    config.controller.avoid.paced = any_bool();
    config.drives[0] = any_drive_config(&LEFT);
    config.drives[1] = any_drive_config(&RIGHT);
    config.controller.tracker = (berth_tracker_t){0};
    config.controller.tracker.rim_change_max_mps2 = any_float();
    return config;
}

int main(void) {
    plan = any_plan();
    give_gains(&plan);
    const berth_board_config_t config = any_board_config();
    if (berth_board_init(&board, &plan, &config, any_i64(), &refusal) == BERTH_OK) {
        start_link();
        call_all();
    }
    return 0;
}
