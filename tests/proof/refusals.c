/* What the other proofs take for granted of a plan or a configuration is checked at the boundary:
 * whatever lies outside is refused. And calls with pointers missing or before a successful init. */
#include "scene.h"

#define REFUSED(call)                                                                              \
    do {                                                                                           \
        const berth_error_t error = (call);                                                        \
        /*@ assert refused: error != BERTH_OK; */                                                  \
        (void)error;                                                                               \
    } while (0)

static berth_plan_t plan;
static berth_constrained_t workspace;
static berth_controller_t controller;
static berth_board_t board;
static berth_drive_t drive;

static void plans(void) {
    berth_refusal_t refusal;
    berth_plan_t bad = plan;
    bad.count = 0;
    REFUSED(berth_plan_check(&bad, &refusal));
    bad.count = u32_from(BERTH_PLAN_COUNT_MAX + 1u, UINT32_MAX);
    REFUSED(berth_plan_check(&bad, &refusal));
    bad = plan;
    bad.period_us = u32_from(0, BERTH_PERIOD_MIN_US - 1u);
    REFUSED(berth_plan_check(&bad, &refusal));
    bad.period_us = u32_from(BERTH_PERIOD_MAX_US + 1u, UINT32_MAX);
    REFUSED(berth_plan_check(&bad, &refusal));
    bad = plan;
    bad.mpc.horizon = 0;
    REFUSED(berth_plan_check(&bad, &refusal));
    bad.mpc.horizon = Frama_C_unsigned_short_interval(BERTH_HORIZON_MAX + 1u, UINT16_MAX);
    REFUSED(berth_plan_check(&bad, &refusal));
    bad = plan;
    bad.mpc.discretization = Frama_C_unsigned_char_interval(2, UINT8_MAX);
    REFUSED(berth_plan_check(&bad, &refusal));
    bad = plan;
    bad.gain_source = Frama_C_unsigned_char_interval(2, UINT8_MAX);
    REFUSED(berth_plan_check(&bad, &refusal));
    bad = plan;
    bad.samples = NULL;
    REFUSED(berth_plan_check(&bad, &refusal));
    bad = plan;
    bad.gain_source = BERTH_GAIN_TABLE; /* which is not there */
    REFUSED(berth_plan_check(&bad, &refusal));
}

static void horizons(void) {
    berth_limits_config_t limits;
    berth_refusal_t refusal;
    ANY_BYTES(limits);
    plan.mpc.horizon =
        Frama_C_unsigned_short_interval(BERTH_CONSTRAINED_HORIZON_MAX + 1u, UINT16_MAX);
    REFUSED(berth_constrained_init(&workspace, &plan, &limits, any_float(), &refusal));
}

static void drives(const berth_drive_protocol_t *protocol) {
    berth_drive_config_t config = any_drive_config(protocol);
    berth_refusal_t refusal;
    config.period_us = u32_from(0, BERTH_PERIOD_MIN_US - 1u);
    REFUSED(berth_drive_init(&drive, &config, &refusal));
    config.period_us = u32_from(BERTH_PERIOD_MAX_US + 1u, UINT32_MAX);
    REFUSED(berth_drive_init(&drive, &config, &refusal));
    REFUSED(berth_drive_init(&drive, &config, NULL));
    REFUSED(berth_drive_init(&drive, NULL, &refusal));
    REFUSED(berth_drive_init(NULL, &config, &refusal));
    config.protocol = NULL;
    REFUSED(berth_drive_init(&drive, &config, &refusal));
}

/* A controller and a board that no plan was good enough for. */
static void without_plan(void) {
    berth_config_t config;
    berth_board_config_t board_config;
    berth_refusal_t refusal;
    berth_command_t command;
    berth_obstacle_t obstacle;
    const berth_pose_t pose = any_pose();
    ANY_BYTES(config);
    ANY_BYTES(board_config);
    ANY_BYTES(obstacle);
    REFUSED(berth_controller_init(NULL, &plan, &config, &refusal));
    REFUSED(berth_controller_init(&controller, NULL, &config, &refusal));
    REFUSED(berth_controller_init(&controller, &plan, NULL, &refusal));
    REFUSED(berth_controller_init(&controller, &plan, &config, NULL));
    REFUSED(berth_controller_start(&controller, any_i64()));
    REFUSED(berth_controller_step(&controller, any_i64(), &pose, &command));
    REFUSED(berth_controller_step(NULL, any_i64(), &pose, &command));
    REFUSED(berth_controller_start(NULL, any_i64()));
    REFUSED(berth_controller_add_obstacle(&controller, &obstacle, &refusal));
    REFUSED(berth_controller_add_obstacle(NULL, &obstacle, &refusal));
    REFUSED(berth_controller_put_obstacle(NULL, any_u16(), &obstacle, any_i64(), &refusal));
    berth_controller_remove_obstacle(&controller, any_u16());
    berth_controller_remove_obstacle(NULL, any_u16());
    REFUSED(berth_board_init(NULL, &plan, &board_config, any_i64(), &refusal));
    REFUSED(berth_board_init(&board, NULL, &board_config, any_i64(), &refusal));
    REFUSED(berth_board_init(&board, &plan, NULL, any_i64(), &refusal));
    REFUSED(berth_board_init(&board, &plan, &board_config, any_i64(), NULL));
    REFUSED(berth_board_init(&board, &plan, &board_config, i64_from(INT64_MIN, -1), &refusal));
}

/* It takes no commands and puts no frames. */
static void unusable_board(void) {
    berth_refusal_t refusal;
    berth_obstacle_t obstacle;
    const berth_pose_t pose = any_pose();
    const berth_can_frame_t frame = any_frame();
    ANY_BYTES(obstacle);
    REFUSED(berth_board_add_obstacle(&board, &obstacle, &refusal));
    REFUSED(berth_board_set_pose(&board, &pose, any_i64()));
    berth_board_command(&board, ANY_ENUM(berth_command_code_t), any_i64());
    berth_board_receive(&board, &frame, any_i64());
    berth_board_bus(&board, ANY_ENUM(berth_can_mode_t), any_bool(), any_i64());
    berth_board_step(&board, any_i64());
    (void)berth_board_deadline(&board);
    berth_board_sent(&board, any_i64());
    const berth_can_frame_t *front = berth_board_front(&board);
    /*@ assert refused: front == \null; */
    (void)front;
}

int main(void) {
    plan = any_plan();
    plans();
    drives(&berth_drive_odrive);
    drives(&berth_drive_vesc);
    drives(&berth_drive_cia402);
    horizons();
    without_plan();
    unusable_board();
    return 0;
}
