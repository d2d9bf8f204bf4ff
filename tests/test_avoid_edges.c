/* Avoidance and its look-ahead at their edges: what a configuration costs in clearance, distances
 * exactly on a radius, the heading exactly at the tolerance, ties, and how much the look-ahead does
 * in one step. The rig's numbers are exact in binary. */
#include "avoid_rig.h"

#include "../firmware/src/lookahead.h"

enum { NEW, SEEKS_INSIDE, SEEKS_OUTSIDE, FOUND }; /* the look-ahead's states */

static rig_t rig;
static berth_avoid_config_t config;

void setUp(void) {
    rig_start(&rig);
    config = rig_avoid_config();
}

void tearDown(void) {}

/* --- configuration ---------------------------------------------------------------------------- */

static berth_error_t init(berth_refusal_t *refusal) {
    return berth_avoid_init(&rig.avoid, &config, &rig.limits, RIG_PERIOD_US, refusal);
}

static void expect_taken(void) {
    berth_refusal_t refusal;
    TEST_ASSERT_EQUAL_INT(BERTH_OK, init(&refusal));
}

static void expect_refused(berth_field_t field, float value, float minimum, float maximum) {
    berth_refusal_t refusal = {.index = 77};
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_CONFIG, init(&refusal));
    TEST_ASSERT_EQUAL_INT(field, refusal.field);
    TEST_ASSERT_EQUAL_UINT32(0, refusal.index);
    TEST_ASSERT_EQUAL_FLOAT(value, refusal.value);
    TEST_ASSERT_EQUAL_FLOAT(minimum, refusal.minimum);
    TEST_ASSERT_EQUAL_FLOAT(maximum, refusal.maximum);
}

static void test_ranges_of_the_configuration(void) {
    const struct {
        float *value;
        float least, most;
        berth_field_t field;
    } ranges[] = {
        {&config.skirt_m, 0.0f, 10.0f, BERTH_FIELD_SKIRT},
        {&config.tau_s, 0.0f, 10.0f, BERTH_FIELD_TAU},
        {&config.a_brake_mps2, 0.001f, 1000.0f, BERTH_FIELD_A_BRAKE},
        {&config.sigma_pose_m, 0.0f, 1.0f, BERTH_FIELD_SIGMA_POSE},
    };
    for (size_t i = 0; i < sizeof ranges / sizeof ranges[0]; i++) {
        *ranges[i].value = 0.0f;
        expect_taken();
        *ranges[i].value = ranges[i].least;
        expect_taken();
        *ranges[i].value = ranges[i].most;
        expect_taken();
        const float over = nextafterf(ranges[i].most, INFINITY);
        *ranges[i].value = over;
        expect_refused(ranges[i].field, over, ranges[i].least, ranges[i].most);
        *ranges[i].value = -0.5f;
        expect_refused(ranges[i].field, -0.5f, ranges[i].least, ranges[i].most);
        config = rig_avoid_config();
    }
}

static void test_limits_are_checked_too(void) {
    rig.limits.track_m = 0.0f;
    expect_refused(BERTH_FIELD_TRACK, 0.0f, 0.01f, 10.0f);
}

static void expect_clearance(float clearance_m) {
    expect_taken();
    TEST_ASSERT_EQUAL_FLOAT(clearance_m, rig.avoid.clearance_min_m);
}

/* v_max (T + tau + 2 omega_max / alpha_max) + v_max^2 / (2 a_brake) + 3 sigma, term by term. */
static void test_what_the_clearance_has_to_be(void) {
    rig.limits.v_max_mps = 0.5f;
    rig.limits.omega_max_radps = 2.0f;
    expect_clearance(0.0625f);
    config.tau_s = 0.25f;
    expect_clearance(0.0625f + 0.125f);
    config.a_brake_mps2 = 0.25f;
    expect_clearance(0.0625f + 0.125f + 0.5f);
    config.sigma_pose_m = 0.125f;
    expect_clearance(0.0625f + 0.125f + 0.5f + 0.375f);
    rig.limits.alpha_max_radps2 = 8.0f;
    expect_clearance(0.0625f + 0.125f + 0.5f + 0.375f + 0.25f);
    rig.limits.alpha_max_radps2 = 0.5f;
    expect_clearance(0.0625f + 0.125f + 0.5f + 0.375f + 4.0f);
}

static void test_what_a_refused_obstacle_says(void) {
    berth_refusal_t refusal = {.index = 77};
    const berth_obstacle_t near = {0.0f, 0.0f, 0.5f, 0.5625f, 2.0f};
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_CLEARANCE,
                          berth_avoid_check_obstacle(&rig.avoid, &near, &refusal));
    TEST_ASSERT_EQUAL_INT(BERTH_FIELD_CLEARANCE, refusal.field);
    TEST_ASSERT_EQUAL_UINT32(0, refusal.index);
    TEST_ASSERT_EQUAL_FLOAT(0.0625f, refusal.value);
    TEST_ASSERT_EQUAL_FLOAT(rig.avoid.clearance_min_m, refusal.minimum);
    TEST_ASSERT_EQUAL_FLOAT(BERTH_RADIUS_MAX_M - 0.5f, refusal.maximum);
    refusal.index = 77;
    const berth_obstacle_t narrow = {0.0f, 0.0f, 0.5f, 1.0f, 1.0625f};
    TEST_ASSERT_EQUAL_INT(BERTH_ERROR_CONFIG,
                          berth_avoid_check_obstacle(&rig.avoid, &narrow, &refusal));
    TEST_ASSERT_EQUAL_INT(BERTH_FIELD_OBSTACLE_REGULATED, refusal.field);
    TEST_ASSERT_EQUAL_UINT32(0, refusal.index);
    TEST_ASSERT_EQUAL_FLOAT(1.0625f, refusal.value);
    TEST_ASSERT_EQUAL_FLOAT(1.125f, refusal.minimum);
    TEST_ASSERT_EQUAL_FLOAT(BERTH_RADIUS_MAX_M, refusal.maximum);
}

/* --- on a radius ------------------------------------------------------------------------------ */

/* G that is larger than S by its rounding alone leaves no regulated region. */
static void test_a_regulated_radius_within_the_slack_is_conservative(void) {
    config.skirt_m = 0.0f;
    rig_init(&rig, &config);
    const float slack = 0.5f + BERTH_RADIUS_SLACK_M;
    const float radii[] = {0.25f, 0.5f, slack};
    rig_add(&rig, nextafterf(slack, 0.0f), 0.0f, radii);
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_CONSERVATIVE_TURN, rig_step(&rig, 0.5f, 0.0f));
    TEST_ASSERT_EQUAL_FLOAT(0.0f, rig.command.v_mps);
    rig.obstacles.slots[0].obstacle.regulated_m = nextafterf(slack, 1.0f);
    rig.avoid.turning = 0;
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_REGULATED, rig_step(&rig, 0.5f, 0.0f));
}

/* 0.1 m outside the regulated radius a side is still kept; beyond that it is open again. */
static void test_a_side_is_kept_to_its_release(void) {
    const float radii[] = {0.25f, 0.5f, 1.0f};
    const float release = 1.0f + 0.1f;
    for (int side = -1; side <= 1; side++) {
        rig_start(&rig);
        rig_add(&rig, release, 0.0f, radii);
        rig.obstacles.slots[0].memory.side = (int8_t)side;
        (void)rig_step(&rig, 0.5f, 0.0f);
        TEST_ASSERT_EQUAL_INT8(side, rig.obstacles.slots[0].memory.side);
        rig.obstacles.slots[0].obstacle.x_m = nextafterf(release, 2.0f);
        (void)rig_step(&rig, 0.5f, 0.0f);
        TEST_ASSERT_EQUAL_INT8(0, rig.obstacles.slots[0].memory.side);
    }
}

/* --- headings --------------------------------------------------------------------------------- */

/* A skirt so small and so far that its half angle and the tolerance are of one size. */
static void test_a_heading_at_the_tolerance_is_free(void) {
    config.skirt_m = 0.0f;
    rig_init(&rig, &config);
    const float half = 1.5f * 0x1p-15f; /* 46e-6 rad: its own sine, to the bit */
    const float radii[] = {0.0001f, 16.0f * half, 17.0f};
    rig_add(&rig, 16.0f, 0.0f, radii);
    for (int side = -1; side <= 1; side += 2) {
        const float edge = (float)side * (half - BERTH_FREE_TOLERANCE_RAD);
        rig_pose(&rig, 0.0f, 0.0f, edge);
        TEST_ASSERT_EQUAL_INT(BERTH_MODE_TRACK, rig_step(&rig, 0.25f, 0.0f));
        rig_pose(&rig, 0.0f, 0.0f, nextafterf(edge, 0.0f));
        TEST_ASSERT_EQUAL_INT(BERTH_MODE_REGULATED, rig_step(&rig, 0.25f, 0.0f));
    }
}

/* Of two obstacles that are equally near and keep different sides, the first one's holds. */
static void test_of_equally_near_kept_sides_the_first_holds(void) {
    const float radii[] = {0.25f, 0.5f, 2.0f};
    for (int first = -1; first <= 1; first += 2) {
        rig_start(&rig);
        rig_add(&rig, 1.0f, 0.125f, radii);
        rig_add(&rig, 1.0f, -0.125f, radii);
        rig.obstacles.slots[0].memory.side = (int8_t)first;
        rig.obstacles.slots[1].memory.side = (int8_t)-first;
        TEST_ASSERT_EQUAL_INT(BERTH_MODE_REGULATED, rig_step(&rig, 0.5f, 0.0f));
        TEST_ASSERT_TRUE((float)first * rig.command.omega_radps > 0.0f);
    }
}

/* The same where the plan asks for different sides. */
static void test_of_equally_near_obstacles_the_plan_at_the_first_holds(void) {
    const float radii[] = {0.25f, 0.5f, 2.0f};
    for (int first = -1; first <= 1; first += 2) {
        rig_start(&rig);
        rig.samples[1] = (berth_sample_t){.x_m = 2.0f, .y_m = 5.0f};  /* round to the left */
        rig.samples[2] = (berth_sample_t){.x_m = 2.0f, .y_m = -5.0f}; /* to the right */
        rig.plan.count = 3;
        rig_add(&rig, 1.0f, 0.125f, radii);
        rig_add(&rig, 1.0f, -0.125f, radii);
        for (int i = 0; i < 2; i++) {
            const bool left = (i == 0) == (first > 0);
            rig.obstacles.slots[i].memory =
                (berth_obstacle_memory_t){.scan = FOUND, .cursor = left ? 1 : 2};
        }
        TEST_ASSERT_EQUAL_INT(BERTH_MODE_REGULATED, rig_step(&rig, 0.5f, 0.0f));
        TEST_ASSERT_TRUE((float)first * rig.command.omega_radps > 0.0f);
    }
}

/* --- skirting --------------------------------------------------------------------------------- */

/* After the end of an open plan nothing is to be kept up with, whatever lies behind its last row.
 */
static void test_after_the_plans_end_it_skirts_at_its_own_speed(void) {
    const float radii[] = {0.125f, 0.25f, 2.0f};
    rig_add_at(&rig, 1.0, 60.0, radii);
    rig.plan.closed = false;
    rig.samples[1] = (berth_sample_t){.x_m = 500.0f, .v_mps = 0.75f};
    rig.reference.index = 1;
    (void)rig_step(&rig, 0.125f, 11.0f);
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_REGULATED, rig.mode);
    TEST_ASSERT_EQUAL_FLOAT(0.125f, rig.command.v_mps);
    (void)rig_step(&rig, 0.0f, 11.0f);
    TEST_ASSERT_EQUAL_FLOAT(0.0625f, rig.command.v_mps);
}

/* Of two obstacles that leave the same room, the first one's exit sets the pace. */
static void test_of_equal_rooms_the_first_sets_the_pace(void) {
    const float radii[] = {0.125f, 0.25f, 2.0f};
    config.tau_s = 0.375f;
    config.paced = true;
    for (int first = 0; first < 2; first++) {
        rig_init(&rig, &config);
        rig.samples[8] = (berth_sample_t){.x_m = 2.0f, .v_mps = 0.25f};
        rig.plan.count = 9;
        for (int i = 0; i < 2; i++) {
            rig_add_at(&rig, 1.0, 60.0, radii);
            rig.obstacles.slots[i].memory = (berth_obstacle_memory_t){
                .scan = i == first ? FOUND : SEEKS_INSIDE, .cursor = i == first ? 8 : 0};
        }
        TEST_ASSERT_EQUAL_INT(BERTH_MODE_REGULATED, rig_step(&rig, 0.125f, 11.0f));
        /* 2 m in 8 periods of 1/8 s, by a fifth of the time early; or as ever */
        TEST_ASSERT_FLOAT_WITHIN(1.0e-6f, first == 0 ? 2.5f : 0.25f, rig.command.v_mps);
    }
}

/* --- braking ---------------------------------------------------------------------------------- */

static void start_braking(float distance_m, float theta_rad) {
    const float radii[] = {0.5f, 0.625f, 2.0f};
    config.tau_s = 0.125f; /* with T: 0.25 s */
    rig_init(&rig, &config);
    rig_add(&rig, distance_m, 0.0f, radii);
    rig_pose(&rig, 0.0f, 0.0f, theta_rad);
    (void)rig_step(&rig, 0.5f, 0.0f);
}

/* Within the hard radius it may still drive away, and nothing else. */
static void test_within_the_hard_radius_it_may_drive_away(void) {
    start_braking(0.25f, BERTH_PI);
    TEST_ASSERT_EQUAL_FLOAT(0.5f, rig.command.v_mps);
    TEST_ASSERT_FALSE(rig.avoid.braking);
    start_braking(0.25f, 1.6f); /* free, but not away by the margin */
    TEST_ASSERT_EQUAL_FLOAT(0.0f, rig.command.v_mps);
    TEST_ASSERT_TRUE(rig.avoid.braking);
}

static void test_braking_ends_at_its_margin(void) {
    const float edge = 0.5f * BERTH_PI + 0.05f; /* on the hard radius it is seen at 90 degrees */
    for (int side = -1; side <= 1; side += 2) {
        start_braking(0.5f, (float)side * edge);
        TEST_ASSERT_FALSE(rig.avoid.braking);
        TEST_ASSERT_EQUAL_FLOAT(0.5f, rig.command.v_mps);
        start_braking(0.5f, (float)side * nextafterf(edge, 0.0f));
        TEST_ASSERT_TRUE(rig.avoid.braking);
        TEST_ASSERT_EQUAL_FLOAT(0.0f, rig.command.v_mps);
    }
}

/* Room 0.125 m in 0.25 s: 0.5 m/s. */
static void test_just_the_speed_that_can_stop_is_not_braked(void) {
    const float radii[] = {0.5f, 0.5625f, 2.0f};
    config.tau_s = 0.125f;
    config.skirt_m = 0.0f;
    rig_init(&rig, &config);
    rig_add(&rig, 0.625f, 0.0f, radii);
    for (int more = 0; more < 2; more++) {
        rig.avoid.turning = 0;
        (void)rig_step(&rig, more == 0 ? 0.5f : 0.53125f, 0.0f);
        TEST_ASSERT_EQUAL_INT(BERTH_MODE_REGULATED, rig.mode);
        TEST_ASSERT_EQUAL_FLOAT(0.5f, rig.command.v_mps);
        TEST_ASSERT_EQUAL_INT(more, rig.avoid.braking);
    }
}

/* --- when the look-ahead runs ----------------------------------------------------------------- */

/* Obstacles that the robot is within the regulated radius of, and that are not in its way. The
 * plan is long and stays inside, so that there is always something to scan. */
static void start_active(uint32_t active) {
    const float radii[] = {0.25f, 0.5f, 40.0f};
    rig_start(&rig);
    for (uint32_t k = 0; k < RIG_SAMPLES_MAX; k++) {
        rig.samples[k] = (berth_sample_t){.x_m = -2.0f};
    }
    rig.plan.count = RIG_SAMPLES_MAX;
    for (uint32_t i = 0; i < active; i++) {
        rig_add(&rig, -2.0f, (float)i, radii);
        rig.obstacles.slots[i].memory.scan = SEEKS_OUTSIDE;
    }
}

static bool looks_ahead(void) {
    const uint32_t before = rig.obstacles.slots[0].memory.cursor;
    rig.avoid.scan_next = 0;
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_TRACK, rig_step(&rig, 0.25f, 0.0f));
    return rig.obstacles.slots[0].memory.cursor != before;
}

static void test_it_stands_while_two_are_active(void) {
    start_active(1);
    TEST_ASSERT_TRUE(looks_ahead());
    start_active(2);
    TEST_ASSERT_FALSE(looks_ahead());
    start_active(3);
    TEST_ASSERT_FALSE(looks_ahead());
}

/* Unless there is one that it has never looked at: it, and it alone, is a reason to go on. */
static void test_it_goes_on_for_one_that_is_new(void) {
    start_active(3);
    rig.obstacles.slots[1].memory.scan = NEW;
    TEST_ASSERT_TRUE(looks_ahead());
    rig.obstacles.slots[1].memory.scan = SEEKS_OUTSIDE;
    TEST_ASSERT_FALSE(looks_ahead());
    TEST_ASSERT_FALSE(looks_ahead());
}

static void test_it_stands_during_a_turn(void) {
    const float radii[] = {0.25f, 0.5f, 40.0f};
    start_active(1);
    rig_add(&rig, 0.625f, 0.0f, radii); /* in the way, and conservative */
    rig.obstacles.slots[1].memory.scan = NEW;
    rig.avoid.turning = 1;
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_REGULATED, rig_step(&rig, 0.25f, 0.0f));
    TEST_ASSERT_EQUAL_UINT32(0, rig.obstacles.slots[0].memory.cursor);
    TEST_ASSERT_EQUAL_UINT32(0, rig.obstacles.slots[1].memory.cursor);
}

/* --- how much it does ------------------------------------------------------------------------- */

/* A straight line along x, 1 m a sample, with count obstacles of which none is on it. */
static berth_sample_t line[1000];

static void start_line(uint32_t samples, bool closed, uint32_t count) {
    const float radii[] = {0.25f, 0.5f, 0.75f};
    rig_start(&rig);
    for (uint32_t k = 0; k < samples; k++) {
        line[k] = (berth_sample_t){.x_m = (float)k};
    }
    rig.plan.samples = line;
    rig.plan.count = samples;
    rig.plan.closed = closed;
    berth_reference_start(&rig.reference, &rig.plan, 0);
    for (uint32_t i = 0; i < count; i++) {
        rig_add(&rig, 0.0f, 50.0f + (float)i, radii);
        rig.obstacles.slots[i].memory.scan = SEEKS_INSIDE;
    }
}

static void advance(void) {
    lookahead_advance(&rig.avoid, &rig.obstacles, &rig.plan, &rig.reference, &rig.pose);
}

static uint32_t cursor(uint32_t i) {
    return rig.obstacles.slots[i].memory.cursor;
}

/* Two samples for each obstacle there is, from 16 to 32. */
static void test_samples_a_step(void) {
    static const struct {
        uint32_t count, samples;
    } cases[] = {{1, 16}, {7, 16}, {8, 16}, {9, 18}, {12, 24}, {15, 30}, {16, 32}};
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        start_line(1000, false, cases[i].count);
        advance();
        TEST_ASSERT_EQUAL_UINT32(cases[i].samples, cursor(0));
        for (uint32_t k = 1; k < cases[i].count; k++) {
            TEST_ASSERT_EQUAL_UINT32(0, cursor(k));
        }
    }
}

/* One obstacle a step, in turn; those that have their exit are passed over, four a step at most. */
static void test_whose_turn_it_is(void) {
    start_line(1000, false, 6);
    for (uint32_t step = 0; step < 12; step++) {
        advance();
        TEST_ASSERT_EQUAL_UINT8(step % 6 + 1, rig.avoid.scan_next);
        TEST_ASSERT_EQUAL_UINT32(16 * (step / 6 + 1), cursor(step % 6));
    }
    start_line(1000, false, 6);
    for (uint32_t i = 0; i < 5; i++) {
        rig.obstacles.slots[i].memory.scan = FOUND;
        rig.obstacles.slots[i].memory.cursor = 100;
    }
    advance();
    TEST_ASSERT_EQUAL_UINT8(4, rig.avoid.scan_next);
    TEST_ASSERT_EQUAL_UINT32(0, cursor(5));
    advance();
    TEST_ASSERT_EQUAL_UINT8(6, rig.avoid.scan_next);
    TEST_ASSERT_EQUAL_UINT32(16, cursor(5));
    for (uint32_t i = 0; i < 5; i++) {
        TEST_ASSERT_EQUAL_UINT32(100, cursor(i));
    }
}

static void test_fewer_than_four_are_looked_at_once(void) {
    start_line(1000, false, 2);
    for (uint32_t i = 0; i < 2; i++) {
        rig.obstacles.slots[i].memory.scan = FOUND;
        rig.obstacles.slots[i].memory.cursor = 100;
    }
    advance();
    TEST_ASSERT_EQUAL_UINT8(2, rig.avoid.scan_next);
}

static void test_without_obstacles_it_touches_none(void) {
    start_line(1000, false, 0);
    const berth_obstacle_memory_t untouched = {.cursor = 77, .scan = SEEKS_INSIDE};
    rig.obstacles.slots[0].memory = untouched;
    advance();
    TEST_ASSERT_EQUAL_UINT32(77, cursor(0));
}

static void test_a_start_begins_with_the_first(void) {
    start_line(1000, false, 3);
    rig.avoid.scan_next = 2;
    rig.avoid.turning = 1;
    lookahead_start(&rig.avoid, &rig.obstacles, &rig.plan, &rig.reference);
    TEST_ASSERT_EQUAL_UINT8(0, rig.avoid.scan_next);
    TEST_ASSERT_EQUAL_INT8(0, rig.avoid.turning);
    for (uint32_t i = 0; i < 3; i++) {
        TEST_ASSERT_EQUAL_UINT32(400, cursor(i));
    }
}

/* Wherever the reference begins: it ends at the horizon, with nothing found. */
static void test_a_start_within_the_plan_ends_at_the_horizon(void) {
    start_line(1000, false, 1);
    rig.reference.index = 300;
    rig.reference.total = 300;
    lookahead_start(&rig.avoid, &rig.obstacles, &rig.plan, &rig.reference);
    TEST_ASSERT_EQUAL_UINT32(700, cursor(0));
    TEST_ASSERT_EQUAL_UINT8(SEEKS_INSIDE, rig.obstacles.slots[0].memory.scan);
}

/* --- exits ------------------------------------------------------------------------------------ */

static void expect_exit(bool known, float x_m) {
    const berth_sample_t *const beyond =
        lookahead_exit(&rig.obstacles.slots[0], &rig.plan, &rig.reference);
    TEST_ASSERT_EQUAL_INT(known, beyond != NULL);
    TEST_ASSERT_TRUE(beyond == NULL || beyond->x_m == x_m);
}

static void start_exit(uint32_t samples, bool closed, float x_m) {
    const float radii[] = {0.25f, 0.375f, 0.5f};
    start_line(samples, closed, 0);
    rig_add(&rig, x_m, 0.0f, radii);
    lookahead_start(&rig.avoid, &rig.obstacles, &rig.plan, &rig.reference);
}

static void move_on(uint32_t samples) {
    rig.reference.index += samples;
    rig.reference.total += samples;
}

static void test_an_exit_is_399_samples_ahead_at_most(void) {
    start_exit(1000, false, 398.0f);
    expect_exit(true, 399.0f);
    start_exit(1000, false, 399.0f);
    expect_exit(false, 0.0f);
    advance(); /* nor is it looked for while the reference stands */
    expect_exit(false, 0.0f);
    TEST_ASSERT_EQUAL_UINT32(400, cursor(0));
    move_on(1);
    rig_pose(&rig, 1.0f, 0.0f, 0.0f);
    advance();
    expect_exit(true, 400.0f);
}

/* The last sample that is looked at is the first of the next lap. */
static void test_an_exit_across_the_end_of_a_lap(void) {
    start_exit(399, true, 398.0f);
    expect_exit(true, 0.0f);
}

/* Where the reference has caught up with the scan, the sample at hand is still to be looked at. */
static void test_the_current_sample_has_not_been_passed(void) {
    start_exit(1000, false, 10.0f);
    expect_exit(true, 11.0f);
    move_on(11);
    rig_pose(&rig, 20.0f, 0.0f, 0.0f); /* outside */
    advance();
    expect_exit(true, 11.0f);
    rig.obstacles.slots[0].memory.scan = SEEKS_OUTSIDE;
    advance();
    expect_exit(true, 11.0f);
    move_on(1);
    advance();
    expect_exit(false, 0.0f);
}

/* A passed exit is kept while the robot is by the obstacle: on its radius too, wherever that is. */
static void test_a_passed_exit_is_dropped_outside_the_radius(void) {
    const float radii[] = {0.25f, 0.375f, 0.5f};
    for (int far = 0; far < 2; far++) {
        start_line(1000, false, 0);
        rig_add(&rig, 10.0f, 0.0f, radii);
        lookahead_start(&rig.avoid, &rig.obstacles, &rig.plan, &rig.reference);
        rig.obstacles.slots[0].obstacle.y_m = 7.0f; /* both coordinates count */
        move_on(12);
        rig_pose(&rig, 10.0f, far == 0 ? 7.5f : 7.53125f, 0.0f);
        advance();
        expect_exit(far == 0, 11.0f);
        rig.obstacles.slots[0].memory.scan = FOUND;
        rig.obstacles.slots[0].memory.cursor = 11;
        rig_pose(&rig, far == 0 ? 9.5f : 9.46875f, 7.0f, 0.0f);
        advance();
        expect_exit(far == 0, 11.0f);
    }
}

/* Three cones all around, of which two overlap at the back by the tolerance of "free", to the last
 * bits: seen from one side there is a free heading, and from the other side there is none. In doubt
 * the robot stands; mirrored too. A little apart, there is a way between them from both sides. */
static void test_a_gap_that_only_one_side_sees_is_none(void) {
    static const float radii[3] = {0.25f, 0.375f, 1.25f};
    for (int sign = -1; sign <= 1; sign += 2) {
        const float mirror = (float)sign;
        for (int apart = 0; apart < 2; apart++) {
            const float shift = apart == 1 ? 0x1p-10f : 0.0f;
            rig_start(&rig);
            rig_add(&rig, 0x1.189f94p-1f, mirror * 0x1.792abep-5f, radii);
            rig_add(&rig, -0x1.24ce2ep-2f, mirror * (0x1.0d93bep-1f + shift), radii);
            rig_add(&rig, -0x1.ef165cp-3f, mirror * -0x1.ec8b7p-2f, radii);
            const berth_mode_t mode = rig_step(&rig, 0.3f, 0.5f);
            TEST_ASSERT_EQUAL_UINT8(3, rig.avoid.active);
            TEST_ASSERT_EQUAL_INT(apart == 1 ? BERTH_MODE_REGULATED : BERTH_MODE_BLOCKED, mode);
            TEST_ASSERT_TRUE((rig.command.omega_radps != 0.0f) == (apart == 1));
            TEST_ASSERT_TRUE(apart == 1 || rig.command.v_mps == 0.0f);
        }
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_ranges_of_the_configuration);
    RUN_TEST(test_limits_are_checked_too);
    RUN_TEST(test_what_the_clearance_has_to_be);
    RUN_TEST(test_what_a_refused_obstacle_says);
    RUN_TEST(test_a_regulated_radius_within_the_slack_is_conservative);
    RUN_TEST(test_a_side_is_kept_to_its_release);
    RUN_TEST(test_a_heading_at_the_tolerance_is_free);
    RUN_TEST(test_a_gap_that_only_one_side_sees_is_none);
    RUN_TEST(test_of_equally_near_kept_sides_the_first_holds);
    RUN_TEST(test_of_equally_near_obstacles_the_plan_at_the_first_holds);
    RUN_TEST(test_after_the_plans_end_it_skirts_at_its_own_speed);
    RUN_TEST(test_of_equal_rooms_the_first_sets_the_pace);
    RUN_TEST(test_within_the_hard_radius_it_may_drive_away);
    RUN_TEST(test_braking_ends_at_its_margin);
    RUN_TEST(test_just_the_speed_that_can_stop_is_not_braked);
    RUN_TEST(test_it_stands_while_two_are_active);
    RUN_TEST(test_it_goes_on_for_one_that_is_new);
    RUN_TEST(test_it_stands_during_a_turn);
    RUN_TEST(test_samples_a_step);
    RUN_TEST(test_whose_turn_it_is);
    RUN_TEST(test_fewer_than_four_are_looked_at_once);
    RUN_TEST(test_without_obstacles_it_touches_none);
    RUN_TEST(test_a_start_begins_with_the_first);
    RUN_TEST(test_a_start_within_the_plan_ends_at_the_horizon);
    RUN_TEST(test_an_exit_is_399_samples_ahead_at_most);
    RUN_TEST(test_an_exit_across_the_end_of_a_lap);
    RUN_TEST(test_the_current_sample_has_not_been_passed);
    RUN_TEST(test_a_passed_exit_is_dropped_outside_the_radius);
    return UNITY_END();
}
