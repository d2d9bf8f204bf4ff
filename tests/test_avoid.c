/* The avoidance state machine, case by case in scenes whose answer is computed by hand.
 *
 * Unless a test says otherwise the robot stands at the origin, heading along x. An obstacle NEAR
 * has R = 0.25, C = 0.375, S = 0.5 and G = 1.25 m: from 1 m away its skirt is seen under 2 x 30
 * degrees.
 */
#include "avoid_rig.h"

#include <float.h>

static const float NEAR[3] = {0.25f, 0.375f, 1.25f};
static const float CONSERVATIVE_ALONE[3] = {0.25f, 0.375f, 0.5f}; /* G = S */
static const float WIDE[3] = {0.25f, 0.375f, 4.0f};

#define DEG (BERTH_PI / 180.0f)

static rig_t rig;

void setUp(void) {
    rig_start(&rig);
}

void tearDown(void) {}

static void test_without_obstacles_the_command_passes(void) {
    (void)rig_step(&rig, -0.3f, 17.1f);
    rig_expect_passed(&rig, -0.3f, 17.1f);
    (void)rig_step(&rig, -0.0f, -0.0f);
    rig_expect_passed(&rig, -0.0f, -0.0f);
    (void)rig_step(&rig, FLT_MAX, -FLT_MIN);
    rig_expect_passed(&rig, FLT_MAX, -FLT_MIN);
    TEST_ASSERT_EQUAL_UINT8(0, rig.avoid.active);
    TEST_ASSERT_EQUAL_FLOAT(BERTH_RADIUS_MAX_M, rig.avoid.clearance_m);
}

static void test_an_inactive_obstacle_changes_nothing(void) {
    rig_add(&rig, nextafterf(1.25f, 2.0f), 0.0f, NEAR);
    rig_add(&rig, 0.0f, -30.0f, NEAR);
    (void)rig_step(&rig, -0.3f, 17.1f);
    rig_expect_passed(&rig, -0.3f, 17.1f);
    TEST_ASSERT_EQUAL_UINT8(0, rig.avoid.active);
    TEST_ASSERT_EQUAL_FLOAT(BERTH_RADIUS_MAX_M, rig.avoid.clearance_m);
}

static void test_an_obstacle_is_active_up_to_its_regulated_radius(void) {
    rig_add(&rig, 1.25f, 0.0f, NEAR);
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_REGULATED, rig_step(&rig, 0.3f, 0.0f));
    TEST_ASSERT_EQUAL_UINT8(1, rig.avoid.active);
}

static void test_no_driving_backward_beside_an_active_obstacle(void) {
    rig_add(&rig, -1.0f, 0.0f, NEAR);
    (void)rig_step(&rig, -0.3f, 1.0f);
    rig_expect_passed(&rig, 0.0f, 1.0f);
    (void)rig_step(&rig, 0.3f, -1.0f);
    rig_expect_passed(&rig, 0.3f, -1.0f);
}

/* Obstacle at 60 degrees: its edge lies 30 degrees to the left. */
static void test_turn_is_clamped_on_the_left(void) {
    rig_add_at(&rig, 1.0, 60.0, NEAR);
    (void)rig_step(&rig, 0.75f, 5.0f); /* 35.8 degrees */
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.75f, 30.0f);
    (void)rig_step(&rig, 0.75f, 4.1f); /* 29.4 degrees */
    rig_expect_passed(&rig, 0.75f, 4.1f);
    (void)rig_step(&rig, 0.75f, -10.0f);
    rig_expect_passed(&rig, 0.75f, -10.0f);
}

static void test_turn_is_clamped_on_the_right(void) {
    rig_add_at(&rig, 1.0, -60.0, NEAR);
    (void)rig_step(&rig, 0.75f, -5.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.75f, -30.0f);
    (void)rig_step(&rig, 0.75f, -4.1f);
    rig_expect_passed(&rig, 0.75f, -4.1f);
    (void)rig_step(&rig, 0.75f, 10.0f);
    rig_expect_passed(&rig, 0.75f, 10.0f);
}

static void test_the_nearest_edge_bounds_either_side(void) {
    rig_add_at(&rig, 1.0, 80.0, NEAR);
    rig_add_at(&rig, 1.0, 50.0, NEAR);
    rig_add_at(&rig, 1.0, -100.0, NEAR);
    rig_add_at(&rig, 1.0, -70.0, NEAR);
    (void)rig_step(&rig, 0.5f, 11.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.5f, 20.0f);
    (void)rig_step(&rig, 0.5f, -11.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.5f, -40.0f);
}

/* v = max(v*, v_r, v_creep), v* being at least 0; the reference's speed is 0.25. */
static void test_speed_while_skirting(void) {
    rig_add_at(&rig, 1.0, 60.0, NEAR);
    (void)rig_step(&rig, 0.5f, 9.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.5f, 30.0f);
    (void)rig_step(&rig, 0.1f, 9.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.25f, 30.0f);
    rig.samples[0].v_mps = 0.03125f;
    (void)rig_step(&rig, 0.05f, 9.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.0625f, 30.0f);
    rig.samples[0].v_mps = -0.5f;
    (void)rig_step(&rig, -0.7f, 9.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.0625f, 30.0f);
}

/* Past the end of an open plan the reference stands, whatever its last sample's speed. */
static void test_skirting_at_the_end_of_an_open_plan_creeps(void) {
    rig_add_at(&rig, 1.0, 60.0, NEAR);
    rig.plan.closed = false;
    berth_reference_advance(&rig.reference, &rig.plan, 10 * RIG_PERIOD_US);
    TEST_ASSERT_TRUE(rig.reference.finished);
    (void)rig_step(&rig, 0.0f, 9.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.0625f, 30.0f);
}

/* On or in the skirt the half plane away from the obstacle is free. */
static void test_clamping_within_the_conservative_radius(void) {
    rig_add_at(&rig, 0.3125, 120.0, NEAR);
    (void)rig_step(&rig, 0.5f, 9.0f);
    rig_expect(&rig, BERTH_MODE_CONSERVATIVE_GO, 0.5f, 30.0f);
    (void)rig_step(&rig, 0.5f, 4.1f);
    rig_expect_passed(&rig, 0.5f, 4.1f);
}

/* Along an edge to either side, straight on: nothing is clamped. */
static void test_straight_on_along_an_edge_passes(void) {
    for (int sign = -1; sign <= 1; sign += 2) {
        rig_start(&rig);
        rig_add(&rig, 0.0f, (float)sign * 0.3125f, NEAR);
        (void)rig_step(&rig, 0.01f, 0.0f);
        rig_expect_passed(&rig, 0.01f, 0.0f);
        (void)rig_step(&rig, 0.01f, (float)sign * 1.0e-3f);
        rig_expect(&rig, BERTH_MODE_CONSERVATIVE_GO, 0.25f, 0.0f);
    }
}

/* From 8 m the skirt is seen under 2 x 3.583 degrees; the edge lies 1.417 degrees off. */
static void test_clamping_beside_a_far_obstacle(void) {
    static const float far[3] = {0.25f, 0.375f, 10.0f};
    for (int sign = -1; sign <= 1; sign += 2) {
        rig_start(&rig);
        rig_add_at(&rig, 8.0, 5.0 * sign, far);
        (void)rig_step(&rig, 0.5f, 5.0f * (float)sign);
        rig_expect(&rig, BERTH_MODE_REGULATED, 0.5f, 1.4167f * (float)sign);
        (void)rig_step(&rig, 0.5f, -5.0f * (float)sign);
        rig_expect_passed(&rig, 0.5f, -5.0f * (float)sign);
    }
}

/* Between C and S it is still regulated, with half the plane free. */
static void test_clamping_between_conservative_radius_and_skirt(void) {
    rig_add_at(&rig, 0.4375, 120.0, NEAR);
    (void)rig_step(&rig, 0.5f, 9.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.5f, 30.0f);
}

static void test_any_obstacle_within_its_conservative_radius_counts(void) {
    rig_add_at(&rig, 1.0, 60.0, NEAR);
    rig_add_at(&rig, 0.3125, 180.0, NEAR);
    (void)rig_step(&rig, 0.5f, 9.0f);
    rig_expect(&rig, BERTH_MODE_CONSERVATIVE_GO, 0.5f, 30.0f);
}

static void test_driving_turn_to_the_nearest_edge(void) {
    rig_add_at(&rig, 1.0, 20.0, NEAR);
    (void)rig_step(&rig, 0.3f, 2.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.3f, -10.0f);
    rig_start(&rig);
    rig_add_at(&rig, 1.0, -20.0, NEAR);
    (void)rig_step(&rig, 0.3f, -2.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.3f, 10.0f);
    (void)rig_step(&rig, -0.3f, -2.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.0f, 10.0f);
}

static void test_standing_turn_within_the_conservative_radius(void) {
    rig_add_at(&rig, 0.3125, 50.0, NEAR);
    (void)rig_step(&rig, 0.3f, 2.0f);
    rig_expect(&rig, BERTH_MODE_CONSERVATIVE_TURN, 0.0f, -40.0f);
}

static void test_turns_keep_to_the_yaw_rate_limit(void) {
    rig_add_at(&rig, 0.3125, 0.5, NEAR); /* edge at 89.5 degrees, limit at 85.94 */
    (void)rig_step(&rig, 0.3f, 0.0f);
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_CONSERVATIVE_TURN, rig.mode);
    rig_expect_same_bits(-12.0f, rig.command.omega_radps);
    rig_expect_same_bits(0.0f, rig.command.v_mps);
}

/* A turning heading that crosses -pi is the same as any other. */
static void test_headings_across_the_wrap(void) {
    rig_add_at(&rig, 1.0, 178.0, NEAR);
    rig_pose(&rig, 0.0f, 0.0f, -174.0f * DEG);
    (void)rig_step(&rig, 0.3f, 0.0f); /* the centre 8 degrees to the right: 22 to the left */
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.3f, 22.0f);
}

static void test_conservative_radius_is_inclusive(void) {
    rig_add(&rig, 0.375f, 0.0f, NEAR);
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_CONSERVATIVE_TURN, rig_step(&rig, 0.3f, 0.0f));
    rig_start(&rig);
    rig_add(&rig, nextafterf(0.375f, 1.0f), 0.0f, NEAR);
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_REGULATED, rig_step(&rig, 0.3f, 0.0f));
}

/* G = S: no regulated strategy. Between C and S the robot stands and turns, too. */
static void test_equal_skirt_and_regulated_radius_leave_the_conservative_strategy(void) {
    rig_add_at(&rig, 0.4375, 50.0, CONSERVATIVE_ALONE);
    (void)rig_step(&rig, 0.3f, 0.0f);
    rig_expect(&rig, BERTH_MODE_CONSERVATIVE_TURN, 0.0f, -40.0f);
    rig_start(&rig);
    rig_add_at(&rig, 0.4375, 120.0, CONSERVATIVE_ALONE);
    (void)rig_step(&rig, 0.3f, 9.0f);
    rig_expect(&rig, BERTH_MODE_CONSERVATIVE_GO, 0.3f, 30.0f);
    rig_start(&rig);
    rig_add_at(&rig, 0.5625, 0.0, CONSERVATIVE_ALONE);
    (void)rig_step(&rig, -0.3f, 9.0f);
    rig_expect_passed(&rig, -0.3f, 9.0f);
}

/* A plan of three samples: before the obstacle, in it, and beyond at (x, y). */
static void plan_through(float inside_x, float inside_y, float beyond_x, float beyond_y) {
    rig.samples[0] = (berth_sample_t){.x_m = -500.0f, .v_mps = 0.25f};
    rig.samples[1] = (berth_sample_t){.x_m = inside_x, .y_m = inside_y};
    rig.samples[2] = (berth_sample_t){.x_m = beyond_x, .y_m = beyond_y};
    rig.plan.count = 3;
    rig.plan.closed = false;
}

/* The nearest edge is on the right, 10 degrees off; the left one is 50 degrees off. */
static void test_plan_asks_for_the_left(void) {
    rig_add_at(&rig, 1.0, 20.0, NEAR);
    plan_through(0.9f, 0.3f, 0.0f, 3.0f);
    (void)rig_step(&rig, 0.3f, 0.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.3f, 50.0f);
}

static void test_plan_asks_for_the_right(void) {
    rig_add_at(&rig, 1.0, -20.0, NEAR);
    plan_through(0.9f, -0.3f, 0.0f, -3.0f);
    (void)rig_step(&rig, 0.3f, 0.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.3f, -50.0f);
}

/* What counts is the way round the obstacle, not the side of the robot's heading: both ends lie to
 * the left of the x axis. */
static void test_side_is_the_smaller_angle_about_the_obstacle(void) {
    rig_add_at(&rig, 1.0, 20.0, NEAR);
    plan_through(0.9f, 0.3f, 2.4f, 0.75f); /* 17 degrees from the origin: right of the centre */
    (void)rig_step(&rig, 0.3f, 0.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.3f, -10.0f);
    rig_start(&rig);
    rig_add_at(&rig, 1.0, 20.0, NEAR);
    plan_through(0.9f, 0.3f, 2.3f, 1.0f); /* 23 degrees: left of it */
    (void)rig_step(&rig, 0.3f, 0.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.3f, 50.0f);
}

/* Straight through the centre either way round is as far. */
static void test_plan_straight_through_asks_for_no_side(void) {
    for (int sign = -1; sign <= 1; sign += 2) {
        rig_start(&rig);
        rig_add(&rig, 1.0f, 0.0f, NEAR);
        plan_through(1.0f, 0.0f, 3.0f, 0.0f);
        rig_pose(&rig, 0.0f, 0.0f, (float)sign * 20.0f * DEG);
        (void)rig_step(&rig, 0.3f, 0.0f);
        rig_expect(&rig, BERTH_MODE_REGULATED, 0.3f, (float)sign * 10.0f);
    }
}

static void test_edges_as_near_as_each_other(void) {
    rig_add(&rig, 1.0f, 0.0f, NEAR);
    (void)rig_step(&rig, 0.3f, 0.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.3f, 30.0f);
}

static void test_plan_that_never_leaves_asks_for_no_side(void) {
    rig_add_at(&rig, 1.0, 20.0, NEAR);
    plan_through(0.9f, 0.3f, 0.9f, 1.0f); /* ends within G */
    (void)rig_step(&rig, 0.3f, 0.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.3f, -10.0f);
}

static void test_plan_that_never_enters_asks_for_no_side(void) {
    rig_add_at(&rig, 1.0, 20.0, NEAR);
    plan_through(9.0f, 9.0f, 0.0f, 3.0f);
    (void)rig_step(&rig, 0.3f, 0.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.3f, -10.0f);
}

/* The obstacle straight ahead, but for 2 degrees to and fro. */
static void test_side_is_kept_while_the_pose_wavers(void) {
    rig_add(&rig, 1.0f, 0.0f, NEAR);
    rig_pose(&rig, 0.0f, 0.0f, -2.0f * DEG);
    (void)rig_step(&rig, 0.0f, 0.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.0f, -28.0f);
    rig_pose(&rig, 0.0f, 0.0f, 2.0f * DEG);
    (void)rig_step(&rig, 0.0f, 0.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.0f, -32.0f);
    rig_pose(&rig, 0.0f, -0.01f, 2.0f * DEG);
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_REGULATED, rig_step(&rig, 0.0f, 0.0f));
    TEST_ASSERT_TRUE(rig.command.omega_radps < 0.0f);
}

/* Between two turns the heading is free, and the robot may be a little outside G. */
static void test_side_is_kept_until_the_obstacle_is_passed(void) {
    rig_add(&rig, 1.0f, 0.0f, NEAR);
    rig_pose(&rig, 0.0f, 0.0f, -2.0f * DEG);
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_REGULATED, rig_step(&rig, 0.0f, 0.0f));
    rig_pose(&rig, 0.0f, 0.0f, -40.0f * DEG);
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_TRACK, rig_step(&rig, 0.0f, 0.0f));
    rig_pose(&rig, -0.27f, 0.0f, 0.0f);
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_TRACK, rig_step(&rig, 0.0f, 0.0f));
    TEST_ASSERT_EQUAL_UINT8(0, rig.avoid.active);
    rig_pose(&rig, 0.0f, 0.0f, 2.0f * DEG);
    (void)rig_step(&rig, 0.0f, 0.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.0f, -32.0f);
}

static void test_side_is_forgotten_far_away(void) {
    rig_add(&rig, 1.0f, 0.0f, NEAR);
    rig_pose(&rig, 0.0f, 0.0f, -2.0f * DEG);
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_REGULATED, rig_step(&rig, 0.0f, 0.0f));
    rig_pose(&rig, -3.0f, 0.0f, 0.0f);
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_TRACK, rig_step(&rig, 0.0f, 0.0f));
    rig_pose(&rig, 0.0f, 0.0f, 2.0f * DEG);
    (void)rig_step(&rig, 0.0f, 0.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.0f, 28.0f);
}

/* Two obstacles apart, (1, 0) to be passed on its left and (0, 1) on its right. */
static void prepare_conflict(void) {
    rig_add(&rig, 1.0f, 0.0f, WIDE);
    rig_add(&rig, 0.0f, 1.0f, WIDE);
    rig_pose(&rig, 0.0f, 0.0f, 10.0f * DEG);
    (void)rig_step(&rig, 0.0f, 0.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.0f, 20.0f);
    rig_pose(&rig, 0.0f, 0.0f, 45.0f * DEG);
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_TRACK, rig_step(&rig, 0.0f, 0.0f));
    rig_pose(&rig, 0.0f, 0.0f, 80.0f * DEG);
    (void)rig_step(&rig, 0.0f, 0.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.0f, -20.0f);
    rig_pose(&rig, 0.0f, 0.0f, 45.0f * DEG);
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_TRACK, rig_step(&rig, 0.0f, 0.0f));
}

/* Seen in one line, the nearer of the two decides; from the other end that is the other one. */
static void test_conflicting_obstacles_each_decide_their_own_turn(void) {
    prepare_conflict();
    rig_pose(&rig, 2.0f, -1.0f, 135.0f * DEG);
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_REGULATED, rig_step(&rig, 0.0f, 0.0f));
    TEST_ASSERT_TRUE(rig.command.omega_radps > 0.0f);
    rig_pose(&rig, 0.5f, 0.5f, 45.0f * DEG);
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_TRACK, rig_step(&rig, 0.0f, 0.0f));
    rig_pose(&rig, -1.0f, 2.0f, -45.0f * DEG);
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_REGULATED, rig_step(&rig, 0.0f, 0.0f));
    TEST_ASSERT_TRUE(rig.command.omega_radps < 0.0f);
}

static void test_a_turn_is_not_reversed_by_a_conflicting_obstacle(void) {
    prepare_conflict();
    rig_pose(&rig, 2.0f, -1.0f, 135.0f * DEG);
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_REGULATED, rig_step(&rig, 0.0f, 0.0f));
    TEST_ASSERT_TRUE(rig.command.omega_radps > 0.0f);
    rig_pose(&rig, -1.0f, 2.0f, -45.0f * DEG);
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_REGULATED, rig_step(&rig, 0.0f, 0.0f));
    TEST_ASSERT_TRUE(rig.command.omega_radps > 0.0f);
}

/* Cones -30 to 30 and 10 to 70 degrees. */
static void test_overlapping_cones_are_one(void) {
    rig_add_at(&rig, 1.0, 40.0, NEAR);
    rig_add_at(&rig, 1.0, 0.0, NEAR);
    (void)rig_step(&rig, 0.3f, 0.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.3f, -30.0f);
    rig_start(&rig);
    rig_add_at(&rig, 1.0, 0.0, NEAR);
    rig_add_at(&rig, 1.0, 40.0, NEAR);
    plan_through(0.9f, 0.0f, 0.0f, 3.0f);
    (void)rig_step(&rig, 0.3f, 0.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.3f, 70.0f);
}

/* Eleven links 20 degrees apart, added in an order that helps no single pass over them. */
static void add_chain(void) {
    static const int order[] = {6, 1, 9, 4, 0, 7, 10, 3, 8, 2, 5};
    for (size_t i = 0; i < sizeof order / sizeof order[0]; i++) {
        rig_add_at(&rig, 1.0, 20.0 * order[i], NEAR); /* 0 to 200 degrees */
    }
}

static void test_a_chain_of_cones_is_followed_to_its_end(void) {
    add_chain();
    rig_pose(&rig, 0.0f, 0.0f, 160.0f * DEG);
    (void)rig_step(&rig, 0.3f, 0.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.3f, 70.0f);
    rig_start(&rig);
    add_chain();
    rig_pose(&rig, 0.0f, 0.0f, 40.0f * DEG);
    (void)rig_step(&rig, 0.3f, 0.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.3f, -70.0f);
}

static void test_order_of_obstacles_does_not_matter(void) {
    static const double directions[] = {15.0, 50.0, -35.0, 100.0, -160.0};
    float omega[5];
    for (size_t first = 0; first < 5; first++) {
        rig_start(&rig);
        for (size_t i = 0; i < 5; i++) {
            rig_add_at(&rig, 1.0 + 0.01 * (double)((first + i) % 5), directions[(first + i) % 5],
                       NEAR);
        }
        (void)rig_step(&rig, 0.3f, 0.0f);
        omega[first] = rig.command.omega_radps;
        rig_expect_same_bits(omega[0], omega[first]);
    }
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_REGULATED, rig.mode);
}

/* The skirts of four obstacles at 0.6 m are seen under 2 x 56.4 degrees each. */
static void surround(uint32_t count, double distance_m, double offset_deg) {
    for (uint32_t i = 0; i < count; i++) {
        rig_add_at(&rig, distance_m, offset_deg + 360.0 * i / count, NEAR);
    }
}

static void expect_blocked_all_around(void) {
    for (int degree = -180; degree < 180; degree++) {
        rig_pose(&rig, 0.0f, 0.0f, (float)degree * DEG);
        (void)rig_step(&rig, 0.7f, degree % 2 == 0 ? 11.0f : -3.0f);
        rig_expect(&rig, BERTH_MODE_BLOCKED, 0.0f, 0.0f);
    }
}

static void test_blocked_when_surrounded(void) {
    surround(4, 0.6, 45.0);
    expect_blocked_all_around();
}

static void test_blocked_in_several_rings(void) {
    surround(8, 1.0, 3.0);
    surround(4, 0.7, 20.0);
    surround(4, 0.3125, 11.0);
    TEST_ASSERT_EQUAL_UINT32(BERTH_OBSTACLES_MAX, rig.obstacles.count);
    expect_blocked_all_around();
    TEST_ASSERT_EQUAL_UINT8(BERTH_OBSTACLES_MAX, rig.avoid.active);
}

static void test_no_braking_reported_while_blocked(void) {
    const berth_avoid_config_t config = {
        .skirt_m = 0.125f, .v_creep_mps = 0.0625f, .tau_s = 1.0f, .a_brake_mps2 = 0.5f};
    rig_init(&rig, &config);
    surround(4, 0.6, 45.0);
    (void)rig_step(&rig, 0.8f, 0.0f);
    rig_expect(&rig, BERTH_MODE_BLOCKED, 0.0f, 0.0f);
    TEST_ASSERT_FALSE(rig.avoid.braking);
}

/* The obstacles stand at +-45 and +-135 degrees; the one at 45 goes. */
static void test_blocked_ends_when_there_is_a_gap(void) {
    surround(4, 0.6, 45.0);
    (void)rig_step(&rig, 0.7f, 0.0f);
    rig_expect(&rig, BERTH_MODE_BLOCKED, 0.0f, 0.0f);
    rig.obstacles.slots[0] = rig.obstacles.slots[3];
    rig.obstacles.count = 3;
    (void)rig_step(&rig, 0.7f, 0.0f);
    /* the nearest edge: that of the obstacle at -45 degrees, asin(5 / 6) = 56.4427 from it */
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.7f, 11.4427f);
}

/* A gap of 2 x 0.6 degrees between eight skirts at d = 0.5 / sin(21.9 deg). */
static void test_a_narrow_gap_is_found(void) {
    const double distance = 0.5 / sin(21.9 * 3.14159265358979323846 / 180.0);
    static const float radii[3] = {0.25f, 0.375f, 2.0f};
    for (int i = 0; i < 8; i++) {
        rig_add_at(&rig, distance, 22.5 + 45.0 * i, radii);
    }
    rig_pose(&rig, 0.0f, 0.0f, 5.0f * DEG);
    (void)rig_step(&rig, 0.3f, 0.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.3f, -4.4f);
}

static void test_on_the_centre_of_an_obstacle(void) {
    rig_add(&rig, 0.0f, 0.0f, NEAR);
    expect_blocked_all_around();
    TEST_ASSERT_EQUAL_FLOAT(-0.25f, rig.avoid.clearance_m);
    rig_add(&rig, 1.0f, 0.0f, NEAR);
    expect_blocked_all_around();
}

/* So near that the squared distance vanishes in float32. */
static void test_next_to_the_centre_of_an_obstacle(void) {
    rig_add(&rig, 1.0e-30f, -1.0e-30f, NEAR);
    expect_blocked_all_around();
}

static void test_inside_the_hard_radius_only_outward(void) {
    rig_add(&rig, 0.0625f, 0.0f, NEAR);
    rig_pose(&rig, 0.0f, 0.0f, 100.0f * DEG);
    (void)rig_step(&rig, 0.3f, 0.5f);
    rig_expect_passed(&rig, 0.3f, 0.5f);
    TEST_ASSERT_EQUAL_FLOAT(-0.1875f, rig.avoid.clearance_m);
    (void)rig_step(&rig, 0.3f, -5.0f);
    rig_expect(&rig, BERTH_MODE_CONSERVATIVE_GO, 0.3f, -10.0f);
    rig_pose(&rig, 0.0f, 0.0f, 80.0f * DEG);
    (void)rig_step(&rig, 0.3f, 0.0f);
    rig_expect(&rig, BERTH_MODE_CONSERVATIVE_TURN, 0.0f, 10.0f);
}

/* R = 0.25, C = 0.75, S = 0.875, G = 4 m; T + tau = 0.375 s. */
static const float BRAKING[3] = {0.25f, 0.75f, 4.0f};

static void start_braking(float tau_s, float a_brake_mps2) {
    const berth_avoid_config_t config = {
        .skirt_m = 0.125f, .v_creep_mps = 0.0625f, .tau_s = tau_s, .a_brake_mps2 = a_brake_mps2};
    rig_init(&rig, &config);
}

static void expect_cap(double distance_m, double cap_mps) {
    rig_pose(&rig, (float)-distance_m, 0.0f, 0.0f);
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_REGULATED, rig_step(&rig, 50.0f, 0.0f));
    TEST_ASSERT_FLOAT_WITHIN((float)(1.0e-5 * (1.0 + cap_mps)), (float)cap_mps, rig.command.v_mps);
    TEST_ASSERT_TRUE(rig.avoid.braking);
    (void)rig_step(&rig, (float)(0.99 * cap_mps), 0.0f);
    rig_expect_same_bits((float)(0.99 * cap_mps), rig.command.v_mps);
    TEST_ASSERT_FALSE(rig.avoid.braking);
}

static void test_braking_cap(void) {
    start_braking(0.25f, 2.0f);
    rig_add(&rig, 0.0f, 0.0f, BRAKING);
    for (double distance = 0.7501; distance < 4.0; distance += 0.01) {
        expect_cap(distance, 2.0 * (-0.375 + sqrt(0.375 * 0.375 + 2.0 * (distance - 0.25) / 2.0)));
    }
}

static void test_braking_cap_of_drives_without_delay(void) {
    start_braking(0.0f, 0.0625f);
    rig_add(&rig, 0.0f, 0.0f, BRAKING);
    for (double distance = 0.7501; distance < 4.0; distance += 0.1) {
        expect_cap(distance,
                   0.0625 * (-0.125 + sqrt(0.125 * 0.125 + 2.0 * (distance - 0.25) / 0.0625)));
    }
}

/* Unlimited braking: the room within the delay. */
static void test_braking_cap_of_drives_with_delay_alone(void) {
    start_braking(0.0625f, 0.0f);
    rig_add(&rig, 0.0f, 0.0f, BRAKING);
    for (double distance = 0.7501; distance < 4.0; distance += 0.1) {
        expect_cap(distance, (distance - 0.25) / 0.1875);
    }
}

static void test_no_cap_for_drives_that_obey_at_once(void) {
    rig_add(&rig, 0.0f, 0.0f, BRAKING);
    rig_pose(&rig, -1.0f, 0.0f, 0.0f);
    (void)rig_step(&rig, 50.0f, 0.0f);
    rig_expect_same_bits(50.0f, rig.command.v_mps);
    TEST_ASSERT_FALSE(rig.avoid.braking);
}

/* From 1.25 m the hard disc is seen under 2 x asin(0.2) = 2 x 0.20136 rad; the cap reaches 0.05
 * further. */
static void test_braking_cap_applies_ahead_only(void) {
    start_braking(0.25f, 2.0f);
    rig_add(&rig, 1.25f, 0.0f, BRAKING);
    for (int sign = -1; sign <= 1; sign += 2) {
        rig_pose(&rig, 0.0f, 0.0f, (float)(sign * 0.2513));
        (void)rig_step(&rig, 50.0f, 0.0f);
        TEST_ASSERT_TRUE(rig.avoid.braking);
        TEST_ASSERT_FLOAT_WITHIN(1.0e-5f, 1.386001f, rig.command.v_mps);
        rig_pose(&rig, 0.0f, 0.0f, (float)(sign * 0.2515));
        TEST_ASSERT_EQUAL_INT(BERTH_MODE_REGULATED, rig_step(&rig, 50.0f, 0.0f));
        TEST_ASSERT_FALSE(rig.avoid.braking);
        rig_expect_same_bits(50.0f, rig.command.v_mps);
    }
    rig_pose(&rig, 0.0f, 0.0f, 3.0f);
    (void)rig_step(&rig, 50.0f, 0.0f);
    rig_expect_passed(&rig, 50.0f, 0.0f);
    TEST_ASSERT_FALSE(rig.avoid.braking);
}

/* The nearer one counts, whichever comes first in the list. */
static void test_braking_cap_is_the_least_of_all(void) {
    const double cap = 2.0 * (-0.375 + sqrt(0.375 * 0.375 + 0.75));
    for (int first = 0; first < 2; first++) {
        start_braking(0.25f, 2.0f);
        rig_add(&rig, first == 0 ? 1.0f : 2.0f, 0.0f, BRAKING);
        rig_add(&rig, first == 0 ? 2.0f : 1.0f, 0.0f, BRAKING);
        (void)rig_step(&rig, 50.0f, 0.0f);
        TEST_ASSERT_FLOAT_WITHIN(1.0e-5f, (float)cap, rig.command.v_mps);
        TEST_ASSERT_TRUE(rig.avoid.braking);
    }
}

/* Tangentially at the hard radius, within 0.05 rad of the disc: next to no room, or none. */
static void test_braking_cap_at_the_hard_radius(void) {
    start_braking(0.25f, 2.0f);
    rig_add(&rig, 0.0f, 0.25015625f, BRAKING);
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_TRACK, rig_step(&rig, 0.5f, 0.0f));
    TEST_ASSERT_FLOAT_WITHIN(1.0e-6f, 4.165e-4f, rig.command.v_mps);
    rig_pose(&rig, 0.0f, 0.001f, 0.0f);
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_TRACK, rig_step(&rig, 0.5f, 0.0f));
    rig_expect_same_bits(0.0f, rig.command.v_mps);
    TEST_ASSERT_TRUE(rig.avoid.braking);
}

/* T = 0.125 s and tau = 0.375 s: turns take four times as long. */
static void start_paced(bool paced) {
    const berth_avoid_config_t config = {
        .skirt_m = 0.125f, .v_creep_mps = 0.0625f, .tau_s = 0.375f, .paced = paced};
    rig_init(&rig, &config);
}

static void test_turns_take_the_time_of_the_drives(void) {
    for (int paced = 0; paced < 2; paced++) {
        const float part = paced != 0 ? 4.0f : 1.0f;
        start_paced(paced != 0);
        rig_add_at(&rig, 1.0, 60.0, NEAR);
        (void)rig_step(&rig, 0.3f, 11.0f);
        rig_expect(&rig, BERTH_MODE_REGULATED, 0.3f, 30.0f / 4.0f);
        start_paced(paced != 0);
        rig_add_at(&rig, 1.0, -60.0, NEAR);
        (void)rig_step(&rig, 0.3f, -11.0f);
        rig_expect(&rig, BERTH_MODE_REGULATED, 0.3f, -30.0f / 4.0f);
        start_paced(paced != 0);
        rig_add_at(&rig, 1.0, 20.0, NEAR);
        (void)rig_step(&rig, 0.3f, 0.0f);
        rig_expect(&rig, BERTH_MODE_REGULATED, 0.3f, -10.0f / part);
    }
}

/* A turn that would not reach the edge in that time passes as it is. */
static void test_turns_pass_within_their_room(void) {
    start_paced(true);
    rig_add_at(&rig, 1.0, 60.0, NEAR);
    (void)rig_step(&rig, 0.3f, 1.0f);
    rig_expect_passed(&rig, 0.3f, 1.0f);
    (void)rig_step(&rig, 0.3f, -1.0f);
    rig_expect_passed(&rig, 0.3f, -1.0f);
}

/* There the robot stands while it turns, and time is lost by turning slowly; but when it goes, it
 * is not to turn on past the edge. */
static void test_no_pace_within_the_conservative_radius(void) {
    start_paced(true);
    rig_add_at(&rig, 0.3125, 80.0, NEAR);
    (void)rig_step(&rig, 0.3f, 0.0f);
    rig_expect(&rig, BERTH_MODE_CONSERVATIVE_TURN, 0.0f, -10.0f);
    start_paced(true);
    rig_add_at(&rig, 0.3125, 120.0, NEAR);
    plan_through(0.0f, 0.5f, 0.0f, 3.0f);
    (void)rig_step(&rig, 0.5f, 9.0f);
    rig_expect(&rig, BERTH_MODE_CONSERVATIVE_GO, 0.5f, 30.0f / 4.0f);
}

/* The obstacle's centre is at 60 degrees to the left, the exit 3 m away, the reference is there in
 * 16 periods of 0.125 s: 1.25 * 3 m / 2 s. */
static void pace_towards(float beyond_x, float beyond_y, bool left) {
    start_paced(true);
    rig_add_at(&rig, 1.0, left ? 60.0 : -60.0, NEAR);
    for (uint32_t k = 0; k < 16; k++) {
        rig.samples[k] = (berth_sample_t){.x_m = 0.5f, .y_m = left ? 0.8f : -0.8f, .v_mps = 0.25f};
    }
    rig.samples[16] = (berth_sample_t){.x_m = beyond_x, .y_m = left ? beyond_y : -beyond_y};
    rig.plan.count = 17;
    rig.plan.closed = false;
    berth_reference_advance(&rig.reference, &rig.plan, 0);
    (void)rig_step(&rig, 0.0f, 0.0f); /* the look-ahead */
    (void)rig_step(&rig, 0.0f, 0.0f);
}

static void test_pace_is_what_brings_the_robot_to_the_exit_in_time(void) {
    for (int left = 0; left < 2; left++) {
        const float sign = left != 0 ? 1.0f : -1.0f;
        pace_towards(3.0f, 0.0f, left != 0);
        (void)rig_step(&rig, 0.7f, 11.0f * sign);
        TEST_ASSERT_EQUAL_INT(BERTH_MODE_REGULATED, rig.mode);
        TEST_ASSERT_FLOAT_WITHIN(1.0e-5f, 1.875f, rig.command.v_mps);
        berth_reference_advance(&rig.reference, &rig.plan, 8 * RIG_PERIOD_US);
        (void)rig_step(&rig, 0.7f, 11.0f * sign);
        TEST_ASSERT_FLOAT_WITHIN(1.0e-5f, 3.75f, rig.command.v_mps);
    }
}

/* Late or not, whichever way round: what counts is the exit, and the time until the reference is
 * there. */
static void test_a_paced_robot_hurries_once_the_reference_is_out(void) {
    for (int left = 0; left < 2; left++) {
        const float sign = left != 0 ? 1.0f : -1.0f;
        pace_towards(-3.0f, 0.0f, left != 0);
        berth_reference_advance(&rig.reference, &rig.plan, 15 * RIG_PERIOD_US);
        (void)rig_step(&rig, 0.7f, 11.0f * sign);
        TEST_ASSERT_FLOAT_WITHIN(1.0e-4f, 30.0f, rig.command.v_mps);
        berth_reference_advance(&rig.reference, &rig.plan, 16 * RIG_PERIOD_US);
        (void)rig_step(&rig, 0.1f, 11.0f * sign);
        rig_expect(&rig, BERTH_MODE_REGULATED, 0.8f, sign * 7.5f);
    }
}

static void test_a_paced_robot_without_an_exit_skirts_as_ever(void) {
    start_paced(true);
    rig_add_at(&rig, 1.0, 60.0, NEAR);
    (void)rig_step(&rig, 0.1f, 11.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.25f, 7.5f);
    /* nothing at all bounds a turn to the right but the half turn */
    (void)rig_step(&rig, 0.1f, -40.0f);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.25f, -45.0f);
}

static void test_clearance_is_the_least_of_the_active_ones(void) {
    static const float small[3] = {0.0625f, 0.1875f, 1.0f};
    rig_add(&rig, -1.0f, 0.0f, NEAR);    /* 0.75 */
    rig_add(&rig, -0.75f, 0.0f, small);  /* 0.6875 */
    rig_add(&rig, 0.0f, -1.125f, small); /* inactive */
    (void)rig_step(&rig, 0.3f, 0.0f);
    TEST_ASSERT_EQUAL_UINT8(2, rig.avoid.active);
    TEST_ASSERT_EQUAL_FLOAT(0.6875f, rig.avoid.clearance_m);
    rig_pose(&rig, 50.0f, 0.0f, 0.0f);
    (void)rig_step(&rig, 0.3f, 0.0f);
    TEST_ASSERT_EQUAL_UINT8(0, rig.avoid.active);
    TEST_ASSERT_EQUAL_FLOAT(BERTH_RADIUS_MAX_M, rig.avoid.clearance_m);
}

static void test_full_list(void) {
    for (uint32_t i = 0; i < BERTH_OBSTACLES_MAX; i++) {
        rig_add_at(&rig, 1.0, 90.0 + 0.5 * i, NEAR);
    }
    const berth_obstacle_t one_more = {1.0f, 0.0f, NEAR[0], NEAR[1], NEAR[2]};
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_CAPACITY, berth_obstacles_add(&rig.obstacles, &one_more));
    (void)rig_step(&rig, 0.3f, 9.0f);
    TEST_ASSERT_EQUAL_UINT8(BERTH_OBSTACLES_MAX, rig.avoid.active);
    rig_expect(&rig, BERTH_MODE_REGULATED, 0.3f, 60.0f);
    berth_obstacles_clear(&rig.obstacles);
    (void)rig_step(&rig, -0.3f, 9.0f);
    rig_expect_passed(&rig, -0.3f, 9.0f);
}

static void test_names_of_the_modes(void) {
    TEST_ASSERT_EQUAL_STRING("track", berth_mode_text(BERTH_MODE_TRACK));
    TEST_ASSERT_EQUAL_STRING("regulated", berth_mode_text(BERTH_MODE_REGULATED));
    TEST_ASSERT_EQUAL_STRING("conservative_turn", berth_mode_text(BERTH_MODE_CONSERVATIVE_TURN));
    TEST_ASSERT_EQUAL_STRING("conservative_go", berth_mode_text(BERTH_MODE_CONSERVATIVE_GO));
    TEST_ASSERT_EQUAL_STRING("blocked", berth_mode_text(BERTH_MODE_BLOCKED));
    TEST_ASSERT_EQUAL_STRING("?", berth_mode_text((berth_mode_t)5));
}

static void run_tests_of_headings_and_sides(void) {
    RUN_TEST(test_without_obstacles_the_command_passes);
    RUN_TEST(test_an_inactive_obstacle_changes_nothing);
    RUN_TEST(test_an_obstacle_is_active_up_to_its_regulated_radius);
    RUN_TEST(test_no_driving_backward_beside_an_active_obstacle);
    RUN_TEST(test_turn_is_clamped_on_the_left);
    RUN_TEST(test_turn_is_clamped_on_the_right);
    RUN_TEST(test_the_nearest_edge_bounds_either_side);
    RUN_TEST(test_speed_while_skirting);
    RUN_TEST(test_skirting_at_the_end_of_an_open_plan_creeps);
    RUN_TEST(test_clamping_within_the_conservative_radius);
    RUN_TEST(test_straight_on_along_an_edge_passes);
    RUN_TEST(test_clamping_beside_a_far_obstacle);
    RUN_TEST(test_clamping_between_conservative_radius_and_skirt);
    RUN_TEST(test_any_obstacle_within_its_conservative_radius_counts);
    RUN_TEST(test_driving_turn_to_the_nearest_edge);
    RUN_TEST(test_standing_turn_within_the_conservative_radius);
    RUN_TEST(test_turns_keep_to_the_yaw_rate_limit);
    RUN_TEST(test_headings_across_the_wrap);
    RUN_TEST(test_conservative_radius_is_inclusive);
    RUN_TEST(test_equal_skirt_and_regulated_radius_leave_the_conservative_strategy);
    RUN_TEST(test_plan_asks_for_the_left);
    RUN_TEST(test_plan_asks_for_the_right);
    RUN_TEST(test_side_is_the_smaller_angle_about_the_obstacle);
    RUN_TEST(test_plan_straight_through_asks_for_no_side);
    RUN_TEST(test_edges_as_near_as_each_other);
}

int main(void) {
    UNITY_BEGIN();
    run_tests_of_headings_and_sides();
    RUN_TEST(test_plan_that_never_leaves_asks_for_no_side);
    RUN_TEST(test_plan_that_never_enters_asks_for_no_side);
    RUN_TEST(test_side_is_kept_while_the_pose_wavers);
    RUN_TEST(test_side_is_kept_until_the_obstacle_is_passed);
    RUN_TEST(test_side_is_forgotten_far_away);
    RUN_TEST(test_conflicting_obstacles_each_decide_their_own_turn);
    RUN_TEST(test_a_turn_is_not_reversed_by_a_conflicting_obstacle);
    RUN_TEST(test_overlapping_cones_are_one);
    RUN_TEST(test_a_chain_of_cones_is_followed_to_its_end);
    RUN_TEST(test_order_of_obstacles_does_not_matter);
    RUN_TEST(test_blocked_when_surrounded);
    RUN_TEST(test_blocked_in_several_rings);
    RUN_TEST(test_no_braking_reported_while_blocked);
    RUN_TEST(test_blocked_ends_when_there_is_a_gap);
    RUN_TEST(test_a_narrow_gap_is_found);
    RUN_TEST(test_on_the_centre_of_an_obstacle);
    RUN_TEST(test_next_to_the_centre_of_an_obstacle);
    RUN_TEST(test_inside_the_hard_radius_only_outward);
    RUN_TEST(test_braking_cap);
    RUN_TEST(test_braking_cap_of_drives_without_delay);
    RUN_TEST(test_braking_cap_of_drives_with_delay_alone);
    RUN_TEST(test_no_cap_for_drives_that_obey_at_once);
    RUN_TEST(test_braking_cap_applies_ahead_only);
    RUN_TEST(test_braking_cap_is_the_least_of_all);
    RUN_TEST(test_braking_cap_at_the_hard_radius);
    RUN_TEST(test_turns_take_the_time_of_the_drives);
    RUN_TEST(test_turns_pass_within_their_room);
    RUN_TEST(test_no_pace_within_the_conservative_radius);
    RUN_TEST(test_pace_is_what_brings_the_robot_to_the_exit_in_time);
    RUN_TEST(test_a_paced_robot_hurries_once_the_reference_is_out);
    RUN_TEST(test_a_paced_robot_without_an_exit_skirts_as_ever);
    RUN_TEST(test_clearance_is_the_least_of_the_active_ones);
    RUN_TEST(test_full_list);
    RUN_TEST(test_names_of_the_modes);
    return UNITY_END();
}
