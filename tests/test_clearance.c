/* The clearance theorem: outside all hard radii once, outside for ever - whatever the tracker asks
 * for, however the obstacles overlap, and along the arcs as well as at the control instants.
 *
 * Bounds. In exact arithmetic nothing is lost. In float32 a heading that is free by
 * BERTH_FREE_TOLERANCE_RAD alone may lose v_max T times that in a step, the radii may miss the
 * clearance condition by BERTH_RADIUS_SLACK_M, and distances round.
 */
#include "avoid_rig.h"
#include "plant.h"
#include "support.h"

#include <math.h>
#include <stdio.h>

#define PI 3.14159265358979323846
#define ROUNDING_M 5.0e-7 /* of positions and distances within 16 m of the origin */
#define LOSS_MAX_M 1.0e-6 /* of distance, in one step begun within C */
#define WALK_STEPS 200u

static rig_t rig;
static double period_s;

/* What was seen over all scenes of a test. */
typedef struct {
    uint32_t steps, modes[5], below_radius, inside_conservative;
    double worst_m; /* clearance */
    double loss_m;  /* of distance in one step begun within C */
} record_t;

static record_t record;

void setUp(void) {
    record = (record_t){.worst_m = HUGE_VAL};
}

void tearDown(void) {}

static float draw(double low, double high) {
    return (float)support_uniform(low, high);
}

static bool chance(uint32_t in) {
    return support_index(in) == 0;
}

static double travel_m(void) {
    return (double)rig.limits.v_max_mps * period_s;
}

static double tolerance_m(void) {
    return travel_m() * (double)BERTH_FREE_TOLERANCE_RAD + (double)BERTH_RADIUS_SLACK_M +
           ROUNDING_M;
}

/* Any robot and period that the configuration's checks let through. */
static void draw_robot(void) {
    static const uint32_t periods_us[] = {1000, 5000, 10000, 20000, 50000, 100000};
    berth_refusal_t refusal;
    rig_start(&rig);
    rig.plan.period_us = periods_us[support_index(6)];
    period_s = 1.0e-6 * rig.plan.period_us;
    rig.limits.v_max_mps = (float)support_log_uniform(0.05, 2.0);
    const double omega_limit = 0.9999999 * 0.5 * PI / period_s;
    rig.limits.omega_max_radps = (float)fmin(omega_limit, support_log_uniform(0.5, 50.0));
    rig.limits.wheel_speed_max_radps = chance(3) ? draw(1.0, 30.0) : 0.0f;
    const berth_avoid_config_t config = {
        .skirt_m = chance(4) ? 0.0f : draw(0.0, 0.1),
        .v_creep_mps = (float)support_log_uniform(0.001, (double)rig.limits.v_max_mps),
        .tau_s = chance(2) ? (float)support_log_uniform(0.001, 0.3) : 0.0f,
        .paced = chance(2)};
    TEST_ASSERT_EQUAL_INT(
        BERTH_OK, berth_avoid_init(&rig.avoid, &config, &rig.limits, rig.plan.period_us, &refusal));
}

/* The least C that the theorem allows, or more; G from S upward. Here commands are executed
 * exactly, so the condition is the one without delay, also where a delay makes the robot keep its
 * pace. */
static void draw_obstacle(double x, double y, double spread) {
    const float hard = (float)support_log_uniform(0.05, 0.6);
    float conservative = (float)((double)hard + travel_m());
    while ((double)conservative - (double)hard < travel_m()) {
        conservative = nextafterf(conservative, 1.0e9f);
    }
    conservative += chance(3) ? 0.0f : draw(0.0, 0.1);
    const float skirt = conservative + rig.avoid.config.skirt_m;
    const float radii[3] = {hard, conservative, skirt + (chance(3) ? 0.0f : draw(0.0, 0.5))};
    rig_add(&rig, (float)(x + support_uniform(-spread, spread)),
            (float)(y + support_uniform(-spread, spread)), radii);
    const berth_obstacle_t *added = &rig.obstacles.slots[rig.obstacles.count - 1].obstacle;
    berth_refusal_t refusal;
    if (rig.avoid.config.tau_s > 0.0f) {
        return;
    }
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_avoid_check_obstacle(&rig.avoid, added, &refusal));
}

static void draw_obstacles(void) {
    const uint32_t count = 1 + support_index(chance(4) ? BERTH_OBSTACLES_MAX : 5);
    const double x = support_uniform(-5.0, 5.0);
    const double y = support_uniform(-5.0, 5.0);
    const double spread = support_uniform(0.2, 1.5);
    for (uint32_t i = 0; i < count; i++) {
        draw_obstacle(x, y, spread);
    }
}

/* The reference's speed takes part in skirting; its shape in the choice of side. */
static void draw_plan(void) {
    const berth_obstacle_t *o = &rig.obstacles.slots[0].obstacle;
    rig.plan.count = 8;
    for (uint32_t k = 0; k < rig.plan.count; k++) {
        rig.samples[k] = (berth_sample_t){.x_m = o->x_m + draw(-2.0, 2.0),
                                          .y_m = o->y_m + draw(-2.0, 2.0),
                                          .v_mps = draw(-1.0, 2.0) * rig.limits.v_max_mps};
    }
}

static double distance_m(uint32_t i, double x, double y) {
    const berth_obstacle_t *o = &rig.obstacles.slots[i].obstacle;
    return hypot((double)o->x_m - x, (double)o->y_m - y);
}

static bool outside_hard_radii(double x, double y) {
    for (uint32_t i = 0; i < rig.obstacles.count; i++) {
        if (distance_m(i, x, y) < (double)rig.obstacles.slots[i].obstacle.hard_m) {
            return false;
        }
    }
    return true;
}

/* A distance from an obstacle at which decisions change, or any within reach. */
static double draw_distance(const berth_obstacle_t *o) {
    const double tiny = support_uniform(-1.0e-6, 1.0e-6);
    const double skirt = (double)o->conservative_m + (double)rig.avoid.config.skirt_m;
    switch (support_index(8)) {
    case 0:
        return (double)o->hard_m + fabs(tiny);
    case 1:
        return (double)o->conservative_m + tiny;
    case 2:
        return (double)o->conservative_m;
    case 3:
        return skirt;
    case 4:
        return skirt + tiny;
    case 5:
        return (double)o->regulated_m + tiny;
    default:
        return support_uniform((double)o->hard_m, (double)o->regulated_m + 0.1);
    }
}

/* Towards the obstacle, along an edge of its cone and just beside it, or anywhere. */
static double draw_heading(const berth_obstacle_t *o) {
    const double dx = (double)o->x_m - (double)rig.pose.x_m;
    const double dy = (double)o->y_m - (double)rig.pose.y_m;
    const double skirt = (double)o->conservative_m + (double)rig.avoid.config.skirt_m;
    const double half = asin(fmin(1.0, skirt / hypot(dx, dy)));
    const double sign = chance(2) ? 1.0 : -1.0;
    switch (support_index(4)) {
    case 0:
        return atan2(dy, dx) + support_uniform(-0.1, 0.1);
    case 1:
        return atan2(dy, dx) + sign * (half + support_uniform(-5.0e-5, 5.0e-5));
    case 2:
        return atan2(dy, dx) + sign * (half + support_uniform(0.0, 0.3));
    default:
        return support_uniform(-PI, PI);
    }
}

/* A pose outside all hard radii; false when the obstacles leave none near the one chosen. */
static bool draw_pose(void) {
    for (int i = 0; i < 50; i++) {
        const uint32_t chosen = support_index(rig.obstacles.count);
        const berth_obstacle_t *o = &rig.obstacles.slots[chosen].obstacle;
        const double d = draw_distance(o);
        const double direction = support_uniform(-PI, PI);
        rig_pose(&rig, (float)((double)o->x_m + d * cos(direction)),
                 (float)((double)o->y_m + d * sin(direction)), 0.0f);
        if (outside_hard_radii((double)rig.pose.x_m, (double)rig.pose.y_m)) {
            rig.pose.theta_rad = (float)support_wrap(draw_heading(o));
            return true;
        }
    }
    return false;
}

static void draw_memory(void) {
    rig.avoid.turning = (int8_t)((int)support_index(3) - 1);
    for (uint32_t i = 0; i < rig.obstacles.count; i++) {
        rig.obstacles.slots[i].memory.side = (int8_t)((int)support_index(3) - 1);
    }
}

/* Avoidance and limits, then the arc from a true pose that the rig's pose was measured at. */
static void step_from(support_pose_t pose, berth_twist_t wish) {
    berth_limits_t limits;
    berth_limits_reset(&limits);
    (void)rig_step(&rig, wish.v_mps, wish.omega_radps);
    (void)berth_limits_apply(&limits, &rig.limits, rig.avoid.period_s, rig.mode != BERTH_MODE_TRACK,
                             &rig.command);
    const plant_arc_t arc = {pose.x_m,
                             pose.y_m,
                             pose.theta_rad,
                             (double)rig.command.v_mps,
                             (double)rig.command.omega_radps,
                             period_s};
    record.steps++;
    record.modes[rig.mode]++;
    for (uint32_t i = 0; i < rig.obstacles.count; i++) {
        const berth_obstacle_t *o = &rig.obstacles.slots[i].obstacle;
        const double before = distance_m(i, pose.x_m, pose.y_m);
        const double nearest = plant_arc_distance(&arc, (double)o->x_m, (double)o->y_m);
        record.worst_m = fmin(record.worst_m, nearest - (double)o->hard_m);
        record.below_radius += nearest < (double)o->hard_m;
        TEST_ASSERT_TRUE_MESSAGE(nearest >= (double)o->hard_m - tolerance_m(), "collision");
        if (before <= (double)o->conservative_m - ROUNDING_M) {
            record.inside_conservative++;
            record.loss_m = fmax(record.loss_m, before - nearest);
        }
    }
}

static void report(void) {
    printf("%u steps: track %u regulated %u turn %u go %u blocked %u\n", record.steps,
           record.modes[0], record.modes[1], record.modes[2], record.modes[3], record.modes[4]);
    printf("worst clearance %.3g m, %u below R by less than the tolerance\n", record.worst_m,
           record.below_radius);
    printf("largest loss of distance in a step begun within C: %.3g m (of %u)\n", record.loss_m,
           record.inside_conservative);
    /* Few runs need not meet every mode. */
    for (int mode = 0; mode < 5 && support_runs(20) >= 2; mode++) {
        TEST_ASSERT_GREATER_THAN_UINT32(record.steps / 1000, record.modes[mode]);
    }
    TEST_ASSERT_GREATER_THAN_UINT32(record.steps / 20, record.inside_conservative);
    TEST_ASSERT_TRUE(record.loss_m <= LOSS_MAX_M);
}

static void test_one_step_from_anywhere(void) {
    support_random_start();
    for (uint32_t i = 0; i < support_runs(400000); i++) {
        draw_robot();
        draw_obstacles();
        draw_plan();
        if (!draw_pose()) {
            continue;
        }
        draw_memory();
        const berth_twist_t wish = {draw(-2.0, 2.0) * rig.limits.v_max_mps,
                                    draw(-2.0, 2.0) * rig.limits.omega_max_radps};
        const support_pose_t pose = {(double)rig.pose.x_m, (double)rig.pose.y_m,
                                     (double)rig.pose.theta_rad};
        step_from(pose, wish);
    }
    report();
}

/* Trackers that no plan would give. */
typedef enum { ADVERSARY_ERRATIC, ADVERSARY_RAMS, ADVERSARY_CREEPS, ADVERSARY_HOLDS } adversary_t;

/* Turns at full rate to the obstacle whose hard disc is nearest. */
static float homing_omega(support_pose_t pose) {
    double least = HUGE_VAL;
    double bearing = 0.0;
    for (uint32_t i = 0; i < rig.obstacles.count; i++) {
        const berth_obstacle_t *o = &rig.obstacles.slots[i].obstacle;
        const double gap = distance_m(i, pose.x_m, pose.y_m) - (double)o->hard_m;
        if (gap < least) {
            least = gap;
            bearing = support_wrap(atan2((double)o->y_m - pose.y_m, (double)o->x_m - pose.x_m) -
                                   pose.theta_rad);
        }
    }
    return (float)(bearing / period_s);
}

static berth_twist_t adversary_wish(adversary_t adversary, support_pose_t pose,
                                    berth_twist_t last) {
    const float v_max = rig.limits.v_max_mps;
    const float omega_max = rig.limits.omega_max_radps;
    switch (adversary) {
    case ADVERSARY_RAMS:
        return (berth_twist_t){v_max, homing_omega(pose)};
    case ADVERSARY_CREEPS:
        return (berth_twist_t){(float)support_log_uniform(1.0e-7, (double)v_max),
                               homing_omega(pose)};
    case ADVERSARY_HOLDS:
        if (!chance(20)) {
            return last;
        }
        break;
    default:
        break;
    }
    return (berth_twist_t){draw(-1.0, 2.0) * v_max, draw(-1.0, 1.0) * omega_max};
}

/* The reference moves on, so that the plan's side and speed change on the way. */
static void walk(adversary_t adversary) {
    support_pose_t pose = {(double)rig.pose.x_m, (double)rig.pose.y_m, (double)rig.pose.theta_rad};
    berth_twist_t wish = {rig.limits.v_max_mps, 0.0f};
    for (uint32_t step = 0; step < WALK_STEPS; step++) {
        berth_reference_advance(&rig.reference, &rig.plan, (int64_t)step * rig.plan.period_us);
        wish = adversary_wish(adversary, pose, wish);
        rig.pose = support_measure(pose);
        step_from(pose, wish);
        pose = support_move(pose, (double)rig.command.v_mps, (double)rig.command.omega_radps,
                            period_s);
        pose.theta_rad = support_wrap(pose.theta_rad);
    }
}

static void test_walks_with_an_adversary(void) {
    support_random_start();
    for (uint32_t i = 0; i < support_runs(20000); i++) {
        draw_robot();
        draw_obstacles();
        draw_plan();
        if (draw_pose()) {
            walk((adversary_t)support_index(4));
        }
    }
    TEST_ASSERT_GREATER_THAN_UINT32(support_runs(19000) * WALK_STEPS, record.steps);
    report();
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_one_step_from_anywhere);
    RUN_TEST(test_walks_with_an_adversary);
    return UNITY_END();
}
