/* The look-ahead along the reference: the first sample beyond an obstacle, found a few samples a
 * step, against a plain scan of all 400 samples ahead.
 */
#include "../firmware/src/lookahead.h"
#include "support.h"

#include "unity.h"

#include <math.h>
#include <stdio.h>

#define SAMPLES_MAX 1000u
#define SPACING_M 0.125f
#define PERIOD_US 50000u

static berth_sample_t samples[SAMPLES_MAX];
static berth_plan_t plan;
static berth_reference_t reference;
static berth_obstacles_t obstacles;
static berth_avoid_t avoid;
static berth_pose_t pose;
static int64_t now_us;

/* A straight line along x, one sample each SPACING_M; the robot is on the current sample. */
static void start_line(uint32_t count, bool closed) {
    for (uint32_t k = 0; k < count; k++) {
        samples[k] = (berth_sample_t){.x_m = SPACING_M * (float)k, .v_mps = 2.5f};
    }
    plan = (berth_plan_t){
        .samples = samples, .count = count, .period_us = PERIOD_US, .closed = closed};
}

void setUp(void) {
    avoid = (berth_avoid_t){.scan_next = 0};
    berth_obstacles_clear(&obstacles);
    now_us = 0;
}

void tearDown(void) {}

static void add(float x_m, float y_m, float regulated_m) {
    const berth_obstacle_t obstacle = {x_m, y_m, 0.1f, 0.2f, regulated_m};
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_obstacles_add(&obstacles, &obstacle));
}

/* Centred on sample k and reaching `reach` samples to either side. */
static void add_on_line(uint32_t k, uint32_t reach) {
    add(SPACING_M * (float)k, 0.0f, SPACING_M * ((float)reach + 0.5f));
}

static void robot_on_reference(void) {
    const berth_sample_t sample = berth_plan_sample(&plan, reference.index);
    pose = (berth_pose_t){sample.x_m, sample.y_m, sample.theta_rad};
}

static void start(void) {
    berth_reference_start(&reference, &plan, now_us);
    lookahead_start(&avoid, &obstacles, &plan, &reference);
    robot_on_reference();
}

static void move_on(uint32_t periods) {
    now_us += (int64_t)periods * PERIOD_US;
    berth_reference_advance(&reference, &plan, now_us);
}

/* One step with the robot on the reference. */
static void step(void) {
    move_on(1);
    robot_on_reference();
    lookahead_advance(&avoid, &obstacles, &plan, &reference, &pose);
}

static void expect_none(uint32_t i) {
    TEST_ASSERT_NULL(lookahead_exit(&obstacles.slots[i], &plan, &reference));
}

/* The exit of obstacle i is sample k of the line. */
static void expect_exit(uint32_t i, uint32_t k) {
    const berth_sample_t *beyond = lookahead_exit(&obstacles.slots[i], &plan, &reference);
    TEST_ASSERT_NOT_NULL(beyond);
    TEST_ASSERT_EQUAL_FLOAT(SPACING_M * (float)k, beyond->x_m);
}

static void test_exit_is_found_at_the_start(void) {
    start_line(600, false);
    add_on_line(40, 10);
    add_on_line(300, 3);
    start();
    expect_exit(0, 51);
    expect_exit(1, 304);
}

static void test_start_within_the_regulated_radius(void) {
    start_line(600, false);
    add_on_line(2, 10);
    start();
    expect_exit(0, 13);
}

static void test_a_path_that_passes_by_has_no_exit(void) {
    start_line(600, false);
    add(10.0f, 1.0f, 0.99f);
    start();
    expect_none(0);
    for (int i = 0; i < 500; i++) {
        step();
        expect_none(0);
    }
}

/* On the radius is inside, as for the robot. */
static void test_the_radius_is_inside(void) {
    start_line(600, false);
    add(SPACING_M * 40.0f, 0.0f, SPACING_M * 2.0f);
    start();
    expect_exit(0, 43);
}

static void test_reaches_399_samples_ahead(void) {
    start_line(600, false);
    add_on_line(390, 8);
    add_on_line(390, 9);
    start();
    expect_exit(0, 399);
    expect_none(1);
}

static void test_rolls_on_with_the_reference(void) {
    start_line(600, false);
    add_on_line(450, 5); /* exit 456: 400 samples ahead of sample 56 */
    start();
    while (reference.index < 56) {
        expect_none(0);
        step();
    }
    expect_none(0);
    step();
    expect_exit(0, 456);
    while (reference.index < 456) {
        expect_exit(0, 456);
        step();
    }
}

static void test_an_obstacle_added_later_is_scanned_for(void) {
    start_line(600, false);
    start();
    step();
    add_on_line(200, 5);
    const uint32_t steps = (206 + BERTH_SCAN_PER_STEP_MIN - 1) / BERTH_SCAN_PER_STEP_MIN;
    for (uint32_t i = 0; i < steps; i++) {
        expect_none(0);
        step();
    }
    expect_exit(0, 206);
}

/* Only the robot's own way out of the regulated radius ends a passage. */
static void test_exit_is_kept_while_the_robot_is_inside(void) {
    start_line(600, false);
    add_on_line(40, 5);
    start();
    pose = (berth_pose_t){SPACING_M * 38.0f, 0.0f, 0.0f};
    for (int i = 0; i < 120; i++) {
        move_on(1);
        lookahead_advance(&avoid, &obstacles, &plan, &reference, &pose);
        expect_exit(0, 46);
    }
    pose.y_m = 100.0f;
    move_on(1);
    lookahead_advance(&avoid, &obstacles, &plan, &reference, &pose);
    expect_none(0);
}

/* The reference has ended; the robot, held up inside, still has to get out where the plan did. */
static void test_exit_is_kept_after_the_end_of_an_open_plan(void) {
    start_line(60, false);
    add_on_line(40, 5);
    start();
    pose = (berth_pose_t){SPACING_M * 38.0f, 0.0f, 0.0f};
    for (int i = 0; i < 1000; i++) {
        move_on(1);
        lookahead_advance(&avoid, &obstacles, &plan, &reference, &pose);
        expect_exit(0, 46);
    }
    TEST_ASSERT_TRUE(reference.finished);
}

static void test_exit_is_kept_for_laps(void) {
    start_line(60, true);
    add_on_line(40, 5);
    start();
    pose = (berth_pose_t){SPACING_M * 38.0f, 0.0f, 0.0f};
    for (int i = 0; i < 1000; i++) {
        move_on(1);
        lookahead_advance(&avoid, &obstacles, &plan, &reference, &pose);
        expect_exit(0, 46);
    }
}

/* Out along the line and back again: two passages of one obstacle. */
static void test_second_passage(void) {
    start_line(400, false);
    for (uint32_t k = 200; k < 400; k++) {
        samples[k].x_m = SPACING_M * (float)(399 - k);
    }
    add_on_line(100, 5);
    start();
    expect_exit(0, 106);
    while (reference.index < 150) {
        step();
    }
    expect_exit(0, 94); /* on the way back */
}

static void test_closed_plan_wraps_around(void) {
    start_line(200, true);
    add_on_line(10, 5);
    start();
    expect_exit(0, 16);
    for (int lap = 0; lap < 5; lap++) {
        while (reference.index != 16) {
            step();
        }
        while (reference.index != 60) {
            step();
        }
        while (reference.index != 15) {
            expect_exit(0, 16);
            step();
        }
    }
}

/* An obstacle on the seam between last and first sample. */
static void test_closed_plan_leaves_across_the_seam(void) {
    start_line(200, true);
    const float gap = 10.0f; /* from the last sample back to the first */
    add(SPACING_M * 199.0f, gap, SPACING_M * 3.5f);
    samples[0] = (berth_sample_t){.x_m = SPACING_M * 199.0f, .y_m = gap};
    start();
    expect_exit(0, 1);
    while (reference.index != 100) {
        step();
    }
    expect_exit(0, 1);
}

/* Round and round inside: nothing to be found, and no scan without end. */
static void test_closed_plan_within_the_obstacle_has_no_exit(void) {
    start_line(50, true);
    add_on_line(25, 100);
    start();
    for (int i = 0; i < 500; i++) {
        expect_none(0);
        step();
    }
}

static void test_open_plan_that_ends_inside_has_no_exit(void) {
    start_line(100, false);
    add_on_line(95, 4);
    add_on_line(95, 3);
    start();
    expect_none(0);
    expect_exit(1, 99);
    for (int i = 0; i < 300; i++) {
        step();
        expect_none(0);
    }
}

static void test_a_plan_of_one_sample(void) {
    start_line(1, false);
    add_on_line(0, 3);
    add_on_line(50, 3);
    start();
    for (int i = 0; i < 10; i++) {
        step();
        expect_none(0);
        expect_none(1);
    }
    plan.closed = true;
    start();
    step();
    expect_none(0);
}

static void test_late_steps(void) {
    start_line(600, false);
    add_on_line(300, 5);
    start();
    move_on(299);
    robot_on_reference();
    lookahead_advance(&avoid, &obstacles, &plan, &reference, &pose);
    expect_exit(0, 306);
    move_on(100); /* over the exit */
    robot_on_reference();
    lookahead_advance(&avoid, &obstacles, &plan, &reference, &pose);
    expect_none(0);
    setUp();
    start_line(600, false);
    add_on_line(500, 5);
    start();
    move_on(450); /* past all that was scanned */
    robot_on_reference();
    for (int i = 0; i < 4; i++) {
        lookahead_advance(&avoid, &obstacles, &plan, &reference, &pose);
    }
    expect_exit(0, 506);
}

static void test_counter_of_samples_wraps(void) {
    start_line(200, true);
    add_on_line(100, 5);
    start();
    reference.total = UINT32_MAX - 50u; /* as after laps and laps */
    obstacles.slots[0].memory = (berth_obstacle_memory_t){.cursor = 0};
    for (int i = 0; i < 8; i++) {
        step();
    }
    while (reference.index != 106) {
        expect_exit(0, 106);
        step();
    }
    TEST_ASSERT_LESS_THAN_UINT32(100, reference.total);
}

/* First sample outside after one inside, at most 399 ahead; -1 if there is none. */
static int64_t brute_force(const berth_obstacle_t *o) {
    bool been_inside = false;
    for (uint32_t ahead = 0; ahead < BERTH_SCAN_AHEAD; ahead++) {
        const uint32_t k = reference.index + ahead;
        if (!plan.closed && k >= plan.count) {
            return -1;
        }
        const berth_sample_t *s = &samples[k % plan.count];
        const bool inside = hypot((double)s->x_m - (double)o->x_m,
                                  (double)s->y_m - (double)o->y_m) <= (double)o->regulated_m;
        if (been_inside && !inside) {
            return k % plan.count;
        }
        been_inside = been_inside || inside;
    }
    return -1;
}

static void draw_scene(void) {
    const uint32_t count = 100 + support_index(SAMPLES_MAX - 100);
    setUp();
    start_line(count, support_index(2) == 0);
    double heading = support_uniform(-3.0, 3.0);
    for (uint32_t k = 1; k < count; k++) {
        heading += support_uniform(-0.3, 0.3);
        samples[k].x_m = samples[k - 1].x_m + 0.05f * (float)cos(heading);
        samples[k].y_m = samples[k - 1].y_m + 0.05f * (float)sin(heading);
    }
    const uint32_t number = 1 + support_index(BERTH_OBSTACLES_MAX);
    for (uint32_t i = 0; i < number; i++) {
        const berth_sample_t *near = &samples[support_index(count)];
        add(near->x_m + (float)support_uniform(-0.4, 0.4),
            near->y_m + (float)support_uniform(-0.4, 0.4), (float)support_uniform(0.3, 1.0));
    }
}

/* Per obstacle: the plain scan's answer, for how long it could have been known, and for how long
 * the robot has been outside. */
typedef struct {
    int64_t expected[BERTH_OBSTACLES_MAX];
    uint32_t known[BERTH_OBSTACLES_MAX], outside[BERTH_OBSTACLES_MAX];
    uint32_t agreed, behind;
} watch_t;

static bool is_sample(const berth_sample_t *sample, int64_t k) {
    return k >= 0 && sample->x_m == samples[k].x_m && sample->y_m == samples[k].y_m;
}

static void follow(watch_t *watch, uint32_t i) {
    const berth_obstacle_t *o = &obstacles.slots[i].obstacle;
    const int64_t expected = brute_force(o);
    const double d = hypot((double)pose.x_m - (double)o->x_m, (double)pose.y_m - (double)o->y_m);
    watch->known[i] = expected == watch->expected[i] ? watch->known[i] + 1 : 0;
    watch->expected[i] = expected;
    watch->outside[i] = d > (double)o->regulated_m ? watch->outside[i] + 1 : 0;
}

/* What is known of the way ahead is right. A passed exit is dropped at the slot's next turn with
 * the robot outside; then nothing is known for as long as the scan takes to catch up. */
static void compare(watch_t *watch, uint32_t i) {
    const uint32_t turns = obstacles.count;
    /* each turn gains on the reference; the plan's last row ends a turn early */
    const uint32_t catch_up = 2u * turns * (BERTH_SCAN_AHEAD / (BERTH_SCAN_PER_STEP_MIN / 2) + 1u);
    const berth_obstacle_slot_t *slot = &obstacles.slots[i];
    const berth_sample_t *beyond = lookahead_exit(slot, &plan, &reference);
    follow(watch, i);
    if (beyond == NULL) {
        watch->agreed += watch->expected[i] < 0;
        watch->behind += watch->expected[i] >= 0;
        TEST_ASSERT_TRUE(watch->expected[i] < 0 || watch->known[i] <= catch_up);
    } else if ((int32_t)(slot->memory.cursor - reference.total) > 0) {
        watch->agreed++;
        TEST_ASSERT_TRUE(is_sample(beyond, watch->expected[i]));
    } else {
        watch->behind++;
        watch->known[i] = 0;
        TEST_ASSERT_TRUE(watch->outside[i] <= turns);
    }
}

static void test_agrees_with_a_plain_scan(void) {
    uint32_t agreed = 0;
    uint32_t behind = 0;
    support_random_start();
    for (uint32_t scene = 0; scene < support_runs(200); scene++) {
        watch_t watch = {.agreed = 0};
        draw_scene();
        start();
        for (uint32_t i = 0; i < 1200; i++) {
            for (uint32_t o = 0; o < obstacles.count; o++) {
                compare(&watch, o);
            }
            step();
        }
        agreed += watch.agreed;
        behind += watch.behind;
    }
    printf("%u answers agree, %u are behind\n", agreed, behind);
    TEST_ASSERT_LESS_THAN_UINT32(agreed / 10, behind);
}

/* Samples looked at in a step: those that cursors move over, and one for each exit found. */
static uint32_t samples_looked_at(void) {
    uint32_t from[BERTH_OBSTACLES_MAX];
    bool found[BERTH_OBSTACLES_MAX];
    uint32_t looked_at = 0;
    for (uint32_t i = 0; i < obstacles.count; i++) {
        from[i] = obstacles.slots[i].memory.cursor;
        found[i] = lookahead_exit(&obstacles.slots[i], &plan, &reference) != NULL;
    }
    lookahead_advance(&avoid, &obstacles, &plan, &reference, &pose);
    for (uint32_t i = 0; i < obstacles.count; i++) {
        const uint32_t to = obstacles.slots[i].memory.cursor;
        const bool passed = (int32_t)(from[i] - reference.total) < 0;
        if (to != from[i]) {
            looked_at += to - (passed ? reference.total : from[i]);
        }
        if (lookahead_exit(&obstacles.slots[i], &plan, &reference) != NULL) {
            looked_at += !found[i] || (passed && to != from[i]);
        }
    }
    return looked_at;
}

/* What keeps up with the reference until the obstacle's next turn and gains on it, within the least
 * and the most. */
static uint32_t budget_for(uint32_t count) {
    const uint32_t wanted = 2 * count;
    const uint32_t least = BERTH_SCAN_PER_STEP_MIN;
    const uint32_t most = BERTH_SCAN_PER_STEP_MAX;
    return wanted < least ? least : wanted > most ? most : wanted;
}

static void test_budget_is_used_up_and_never_exceeded(void) {
    uint32_t used_up = 0;
    support_random_start();
    for (uint32_t scene = 0; scene < support_runs(400); scene++) {
        draw_scene();
        start();
        const uint32_t count = obstacles.count;
        for (uint32_t i = 0; i < 600; i++) {
            move_on(support_index(20) == 0 ? support_index(500) : 1);
            robot_on_reference();
            const uint32_t looked_at = samples_looked_at();
            TEST_ASSERT_TRUE(looked_at <= budget_for(count));
            used_up += looked_at == budget_for(count);
        }
    }
    TEST_ASSERT_GREATER_THAN_UINT32(0, used_up);
}

/* A robot that stays by an obstacle for 2^31 periods: the exit is one of the plan's samples, and
 * nothing overflows on the way to it. */
static void test_exit_after_more_periods_than_an_int_holds(void) {
    start_line(600, true);
    add_on_line(40, 10);
    start();
    reference.index = 599;
    reference.total = obstacles.slots[0].memory.cursor - (uint32_t)INT32_MAX;
    expect_exit(0, (599u + (uint32_t)INT32_MAX % 600u) % 600u);
    reference.total -= 1u; /* further ahead than behind, as it now seems */
    expect_exit(0, (599u + 600u - 2147483648u % 600u) % 600u);
}

/* What avoidance remembers belongs to one plan: with another, shorter one there is no exit. */
static void test_memory_of_another_plan_is_no_exit(void) {
    start_line(600, false);
    add_on_line(40, 10);
    start();
    plan.count = 51;
    expect_none(0);
    plan.count = 52;
    expect_exit(0, 51);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_exit_is_found_at_the_start);
    RUN_TEST(test_start_within_the_regulated_radius);
    RUN_TEST(test_a_path_that_passes_by_has_no_exit);
    RUN_TEST(test_the_radius_is_inside);
    RUN_TEST(test_reaches_399_samples_ahead);
    RUN_TEST(test_rolls_on_with_the_reference);
    RUN_TEST(test_an_obstacle_added_later_is_scanned_for);
    RUN_TEST(test_exit_is_kept_while_the_robot_is_inside);
    RUN_TEST(test_exit_is_kept_after_the_end_of_an_open_plan);
    RUN_TEST(test_exit_is_kept_for_laps);
    RUN_TEST(test_second_passage);
    RUN_TEST(test_closed_plan_wraps_around);
    RUN_TEST(test_closed_plan_leaves_across_the_seam);
    RUN_TEST(test_closed_plan_within_the_obstacle_has_no_exit);
    RUN_TEST(test_open_plan_that_ends_inside_has_no_exit);
    RUN_TEST(test_a_plan_of_one_sample);
    RUN_TEST(test_late_steps);
    RUN_TEST(test_counter_of_samples_wraps);
    RUN_TEST(test_exit_after_more_periods_than_an_int_holds);
    RUN_TEST(test_memory_of_another_plan_is_no_exit);
    RUN_TEST(test_agrees_with_a_plain_scan);
    RUN_TEST(test_budget_is_used_up_and_never_exceeded);
    return UNITY_END();
}
