#include "berth/digest.h"
#include "support.h"
#include "unity.h"

void setUp(void) {}
void tearDown(void) {}

static const berth_sample_t samples[] = {{0.0f, 0.0f, 0.0f, 0.2f, 0.0f},
                                         {0.01f, 0.0f, 0.0f, 0.2f, 0.0f}};

static berth_plan_t plan(void) {
    return (berth_plan_t){
        .samples = samples,
        .count = 2,
        .period_us = 50000,
        .mpc = {.q = {10.0f, 40.0f, 1.0f}, .r = {0.5f, 0.1f}, .horizon = 5},
        .gain_source = BERTH_GAIN_ONLINE,
    };
}

static berth_board_config_t config(void) {
    berth_board_config_t usual = berth_board_config_default(0.05f, 0.3f, 50000);
    for (uint8_t side = 0; side < 2; side++) {
        usual.drives[side].protocol = &berth_drive_odrive;
        usual.drives[side].node = (uint8_t)(side + 1);
    }
    usual.regions.conservative_m = 2.0f; /* room for every change below */
    usual.controller.avoid.a_brake_mps2 = 2.0f;
    return usual;
}

/* Not on the stack, which small boards have little of. */
static berth_board_t board, other_board;
static berth_board_config_t made, changed;

static uint32_t digest(const berth_plan_t *of, const berth_board_config_t *with) {
    berth_refusal_t refusal = {.field = BERTH_FIELD_NONE};
    const berth_error_t error = berth_board_init(&other_board, of, with, 0, &refusal);
    TEST_ASSERT_EQUAL_MESSAGE(BERTH_OK, error, berth_field_text(refusal.field));
    return berth_board_digest(&other_board);
}

static void test_same_boards_have_the_same_digest_at_any_time(void) {
    const berth_plan_t straight = plan();
    made = config();
    berth_refusal_t refusal;
    TEST_ASSERT_EQUAL(BERTH_OK, berth_board_init(&board, &straight, &made, 7000000, &refusal));
    const uint32_t before = digest(&straight, &made);
    TEST_ASSERT_EQUAL_HEX32(before, berth_board_digest(&board));
    /* what happens does not change what was set up */
    const berth_pose_t pose = {1.0f, 2.0f, 0.5f};
    TEST_ASSERT_EQUAL(BERTH_OK, berth_board_set_pose(&board, &pose, 7000000));
    berth_board_command(&board, BERTH_COMMAND_ARM, 7000000);
    berth_board_step(&board, 7000000);
    TEST_ASSERT_EQUAL_HEX32(before, berth_board_digest(&board));
}

static void test_the_plan_counts(void) {
    berth_plan_t other = plan();
    made = config();
    const uint32_t before = digest(&other, &made);
    other.mpc.q[1] = 40.5f;
    TEST_ASSERT_NOT_EQUAL(before, digest(&other, &made));
}

/* Every number of the configuration, changed a little, shows. */
#define ASSERT_COUNTS(field, value)                                                                \
    do {                                                                                           \
        changed = config();                                                                        \
        TEST_ASSERT_TRUE(changed.field != (value));                                                \
        changed.field = (value);                                                                   \
        TEST_ASSERT_NOT_EQUAL_MESSAGE(before, digest(&straight, &changed), #field);                \
    } while (0)

static void test_the_controllers_configuration_counts(void) {
    const berth_plan_t straight = plan();
    made = config();
    const uint32_t before = digest(&straight, &made);
    ASSERT_COUNTS(controller.limits.wheel_radius_m, 0.051f);
    ASSERT_COUNTS(controller.limits.track_m, 0.31f);
    ASSERT_COUNTS(controller.limits.v_max_mps, 0.77f);
    ASSERT_COUNTS(controller.limits.omega_max_radps, 2.5f);
    ASSERT_COUNTS(controller.limits.wheel_speed_max_radps, 30.0f);
    ASSERT_COUNTS(controller.limits.a_max_mps2, 3.0f);
    ASSERT_COUNTS(controller.limits.alpha_max_radps2, 9.0f);
    ASSERT_COUNTS(controller.avoid.skirt_m, 0.03f);
    ASSERT_COUNTS(controller.avoid.v_creep_mps, 0.06f);
    ASSERT_COUNTS(controller.avoid.tau_s, 0.01f);
    ASSERT_COUNTS(controller.avoid.a_brake_mps2, 5.0f);
    ASSERT_COUNTS(controller.avoid.sigma_pose_m, 0.001f);
    ASSERT_COUNTS(controller.avoid.paced, !made.controller.avoid.paced);
    ASSERT_COUNTS(regions.body_m, 0.26f);
    ASSERT_COUNTS(regions.conservative_m, 2.1f);
    ASSERT_COUNTS(regions.regulated_m, 0.31f);
    static berth_constrained_t workspace;
    changed = made;
    changed.controller.tracker = berth_constrained_tracker(&workspace);
    TEST_ASSERT_NOT_EQUAL_HEX32(before, digest(&straight, &changed));
    const uint32_t constrained = digest(&straight, &changed);
    changed.controller.tracker.rim_change_max_mps2 = 1.0f;
    TEST_ASSERT_NOT_EQUAL_HEX32(constrained, digest(&straight, &changed));
    ASSERT_COUNTS(address, 3);
    ASSERT_COUNTS(telemetry_periods, 4);
}

static void test_the_drives_configuration_counts(void) {
    const berth_plan_t straight = plan();
    made = config();
    const uint32_t before = digest(&straight, &made);
    ASSERT_COUNTS(drives[0].node, 3);
    ASSERT_COUNTS(drives[1].node, 3);
    ASSERT_COUNTS(drives[1].protocol, &berth_drive_vesc);
    ASSERT_COUNTS(drives[0].sign, -1);
    ASSERT_COUNTS(drives[1].sign, -1);
    ASSERT_COUNTS(drives[0].gear_ratio, 2.0f);
    ASSERT_COUNTS(drives[1].feedback_timeout_us, 123456u);
    ASSERT_COUNTS(drives[1].heartbeat_timeout_us, 123456u);
    ASSERT_COUNTS(drives[0].enable_timeout_us, 123456u);
}

static void test_odometry_and_supervisor_count(void) {
    const berth_plan_t straight = plan();
    made = config();
    const uint32_t before = digest(&straight, &made);
    ASSERT_COUNTS(odometry.fix_gain, 0.3f);
    ASSERT_COUNTS(odometry.fix_jump_m, 0.6f);
    ASSERT_COUNTS(odometry.fix_jump_rad, 0.6f);
    ASSERT_COUNTS(supervisor.fix_timeout_us, 1000000u);
    ASSERT_COUNTS(supervisor.period_late_us, 123456u);
    ASSERT_COUNTS(supervisor.transmit_timeout_us, 123456u);
    ASSERT_COUNTS(supervisor.arm_timeout_us, 123456u);
    ASSERT_COUNTS(supervisor.stop_timeout_us, 123456u);
    ASSERT_COUNTS(supervisor.standing_radps, 0.3f);
    ASSERT_COUNTS(supervisor.following_radps, 0.3f);
    ASSERT_COUNTS(supervisor.following_us, 123456u);
}

static void test_obstacles_that_stay_count_and_others_do_not(void) {
    const berth_plan_t straight = plan();
    made = config();
    berth_refusal_t refusal;
    berth_obstacle_t obstacle = {3.0f, 1.0f, 0.3f, 0.6f, 0.9f};
    TEST_ASSERT_EQUAL(BERTH_OK, berth_board_init(&board, &straight, &made, 0, &refusal));
    const uint32_t without = berth_board_digest(&board);
    TEST_ASSERT_EQUAL(BERTH_OK, berth_controller_put_obstacle(&board.controller, 5, &obstacle,
                                                              9000000, &refusal));
    TEST_ASSERT_EQUAL_HEX32(without, berth_board_digest(&board));
    TEST_ASSERT_EQUAL(BERTH_OK, berth_board_add_obstacle(&board, &obstacle, &refusal));
    const uint32_t with = berth_board_digest(&board);
    TEST_ASSERT_NOT_EQUAL(without, with);
    TEST_ASSERT_EQUAL(BERTH_OK, berth_board_init(&board, &straight, &made, 0, &refusal));
    obstacle.regulated_m = 0.91f;
    TEST_ASSERT_EQUAL(BERTH_OK, berth_board_add_obstacle(&board, &obstacle, &refusal));
    TEST_ASSERT_NOT_EQUAL(with, berth_board_digest(&board));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_same_boards_have_the_same_digest_at_any_time);
    RUN_TEST(test_the_plan_counts);
    RUN_TEST(test_the_controllers_configuration_counts);
    RUN_TEST(test_the_drives_configuration_counts);
    RUN_TEST(test_odometry_and_supervisor_count);
    RUN_TEST(test_obstacles_that_stay_count_and_others_do_not);
    return UNITY_END();
}
