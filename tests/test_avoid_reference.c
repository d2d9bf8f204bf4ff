/* The avoidance step against DESIGN's section 3 written down in double precision.
 *
 * The model below knows nothing of the firmware's code: it lists the edges of all cones and picks
 * among those that lie in none. Scenes in which float32 may rightly decide otherwise (a distance
 * on a radius, an edge on another cone's edge) are counted and passed over; they must be rare.
 */
#include "avoid_rig.h"

#include "../firmware/src/lookahead.h"
#include "support.h"

#include <math.h>
#include <stdio.h>

#define PI 3.14159265358979323846
#define MARGIN ((double)BERTH_EDGE_MARGIN_RAD) /* kept from the edges of cones */

/* Within this many radians or metres float32 and the tolerance of "free" may decide either way. */
#define BAND 5.0e-5

static rig_t rig;

/* One active obstacle, exact. */
typedef struct {
    uint32_t number; /* of its slot */
    double d, direction, half, conservative, hard;
    int side;
} disc_t;

typedef struct {
    disc_t discs[BERTH_OBSTACLES_MAX];
    uint32_t count;
    bool near_a_decision; /* within BAND of deciding otherwise */
} world_t;

typedef struct {
    berth_mode_t mode;
    double v, omega;
    int turning;
    int sides[BERTH_OBSTACLES_MAX];
    bool near_a_decision;
} answer_t;

void setUp(void) {}

void tearDown(void) {}

static double turn_left(double from, double to) {
    const double turn = fmod(to - from, 2.0 * PI);
    return turn < 0.0 ? turn + 2.0 * PI : turn;
}

static double skirt_of(const berth_obstacle_t *o) {
    return (double)o->conservative_m + (double)rig.avoid.config.skirt_m;
}

/* Radius up to which the conservative strategy holds: all of S when the regulated one is off. */
static double conservative_of(const berth_obstacle_t *o) {
    const bool off = (double)o->regulated_m - skirt_of(o) < 1.0e-6;
    return off ? (double)o->regulated_m : (double)o->conservative_m;
}

static void observe(world_t *world) {
    *world = (world_t){.count = 0};
    for (uint32_t i = 0; i < rig.obstacles.count; i++) {
        const berth_obstacle_t *o = &rig.obstacles.slots[i].obstacle;
        const double dx = (double)o->x_m - (double)rig.pose.x_m;
        const double dy = (double)o->y_m - (double)rig.pose.y_m;
        const double d = hypot(dx, dy);
        const double skirt = skirt_of(o);
        world->near_a_decision |= fabs(d - (double)o->regulated_m) < BAND ||
                                  fabs(d - conservative_of(o)) < BAND || d < BAND;
        if (d > (double)o->regulated_m) {
            continue;
        }
        disc_t *disc = &world->discs[world->count++];
        *disc = (disc_t){.number = i, .d = d, .direction = atan2(dy, dx)};
        disc->half = d > skirt ? asin(skirt / d) : 0.5 * PI;
        disc->conservative = conservative_of(o);
        disc->hard = (double)o->hard_m;
        disc->side = rig.obstacles.slots[i].memory.side;
        /* the arcsine is steep near 1, where rounding of its argument weighs most */
        world->near_a_decision |= fabs(d - skirt) < 8.0 * BAND;
    }
}

/* How far a heading is outside a disc's cone; negative: inside. */
static double outside(const disc_t *disc, double heading) {
    return fabs(support_wrap(heading - disc->direction)) - disc->half;
}

/* Least turn (to the left if sign > 0, else right) from the heading to a cone edge that lies in no
 * other cone; HUGE_VAL if there is none. */
static double free_turn(world_t *world, double heading, double sign) {
    double least = HUGE_VAL;
    for (uint32_t i = 0; i < world->count; i++) {
        const double edge = world->discs[i].direction + sign * world->discs[i].half;
        bool free = true;
        for (uint32_t j = 0; j < world->count; j++) {
            const double gap = j == i ? 0.0 : outside(&world->discs[j], edge);
            world->near_a_decision |= j != i && fabs(gap) < BAND;
            free = free && gap >= 0.0;
        }
        const double turn = sign > 0.0 ? turn_left(heading, edge) : turn_left(edge, heading);
        if (free && turn < least) {
            least = turn;
        }
    }
    return least;
}

/* Between the two free edges, by its centre: in the way. */
static bool in_the_way(const disc_t *disc, double heading, double left, double right) {
    const double centre = support_wrap(disc->direction - heading);
    return centre < left && centre > -right;
}

/* The obstacle that decides the side: the nearest that is in the way and has its side already,
 * else the nearest whose cone holds the heading. Nearest: least d - C. */
static const disc_t *decider(world_t *world, double heading, double left, double right) {
    const disc_t *best = NULL;
    bool best_kept = false;
    double best_m = 0.0;
    for (uint32_t i = 0; i < world->count; i++) {
        const disc_t *disc = &world->discs[i];
        const bool kept = disc->side != 0 && in_the_way(disc, heading, left, right);
        if (!kept && outside(disc, heading) >= 0.0) {
            continue;
        }
        const double m =
            disc->d - (double)rig.obstacles.slots[disc->number].obstacle.conservative_m;
        world->near_a_decision |= best != NULL && kept == best_kept && fabs(m - best_m) < BAND;
        if (best == NULL || (kept && !best_kept) || (kept == best_kept && m < best_m)) {
            best = disc;
            best_kept = kept;
            best_m = m;
        }
    }
    return best;
}

/* The first sample outside G after one inside, up to 400 ahead. */
typedef struct {
    bool found;
    uint32_t ahead;
    double x, y;
    int side; /* the way round the obstacle to it */
} exit_t;

static exit_t exit_of_the_plan(world_t *world, const berth_obstacle_t *o) {
    bool been_inside = false;
    for (uint32_t ahead = 0; ahead < 400; ahead++) {
        const uint32_t k = rig.reference.index + ahead;
        if (!rig.plan.closed && k >= rig.plan.count) {
            break;
        }
        const berth_sample_t *s = &rig.samples[k % rig.plan.count];
        const double x = (double)s->x_m - (double)o->x_m;
        const double y = (double)s->y_m - (double)o->y_m;
        const bool inside = hypot(x, y) <= (double)o->regulated_m;
        world->near_a_decision |= fabs(hypot(x, y) - (double)o->regulated_m) < BAND;
        if (been_inside && !inside) {
            const double from =
                atan2((double)rig.pose.y_m - (double)o->y_m, (double)rig.pose.x_m - (double)o->x_m);
            const double angle = support_wrap(atan2(y, x) - from);
            world->near_a_decision |= fabs(angle) < BAND || fabs(angle) > PI - BAND;
            /* counter-clockwise about it is to its right */
            return (exit_t){true, ahead, (double)s->x_m, (double)s->y_m, angle > 0.0 ? -1 : 1};
        }
        been_inside = been_inside || inside;
    }
    return (exit_t){.found = false};
}

/* Time that turns to a free heading are planned over. */
static double turn_s(bool conservative) {
    const berth_avoid_config_t *config = &rig.avoid.config;
    const bool paced = config->paced && !conservative;
    return (double)rig.avoid.period_s + (paced ? (double)config->tau_s : 0.0);
}

static int choose(world_t *world, double heading, double left, double right) {
    const disc_t *disc = decider(world, heading, left, right);
    if (rig.avoid.turning != 0) {
        return rig.avoid.turning;
    }
    if (disc->side != 0) {
        return disc->side;
    }
    const exit_t planned = exit_of_the_plan(world, &rig.obstacles.slots[disc->number].obstacle);
    if (planned.found) {
        return planned.side;
    }
    world->near_a_decision |= fabs(left - right) < BAND;
    return left <= right ? 1 : -1;
}

static void not_free(world_t *world, double heading, bool conservative, answer_t *answer) {
    const double left = free_turn(world, heading, 1.0);
    const double right = free_turn(world, heading, -1.0);
    if (isinf(left)) {
        answer->mode = BERTH_MODE_BLOCKED;
        answer->v = 0.0;
        answer->omega = 0.0;
        return;
    }
    const disc_t *decides = decider(world, heading, left, right);
    const int side = choose(world, heading, left, right);
    answer->turning = side;
    for (uint32_t i = 0; i < world->count; i++) {
        const disc_t *disc = &world->discs[i];
        const double centre = support_wrap(disc->direction - heading);
        world->near_a_decision |= fabs(centre - left) < BAND || fabs(centre + right) < BAND;
        if (disc == decides || (disc->side == 0 && in_the_way(disc, heading, left, right))) {
            answer->sides[disc->number] = side;
        }
    }
    const double rate = ((side > 0 ? left : right) + MARGIN) / turn_s(conservative);
    answer->omega = side * fmin(rate, (double)rig.limits.omega_max_radps);
    answer->mode = conservative ? BERTH_MODE_CONSERVATIVE_TURN : BERTH_MODE_REGULATED;
    answer->v = conservative ? 0.0 : answer->v;
}

/* Speed of a robot that skirts: at its pace where that is asked for and the way is known. */
static double skirting(world_t *world, const disc_t *by, bool conservative, double v) {
    const double v_r = (double)berth_plan_sample(&rig.plan, rig.reference.index).v_mps;
    const bool paced = turn_s(conservative) > (double)rig.avoid.period_s;
    if (paced && by != NULL) {
        const berth_obstacle_t *o = &rig.obstacles.slots[by->number].obstacle;
        const exit_t planned = exit_of_the_plan(world, o);
        if (planned.found && planned.ahead == 0) {
            return (double)rig.limits.v_max_mps;
        }
        if (planned.found) {
            const double way =
                hypot(planned.x - (double)rig.pose.x_m, planned.y - (double)rig.pose.y_m);
            return 1.25 * way / (planned.ahead * (double)rig.avoid.period_s);
        }
    }
    return fmax(v, fmax(v_r, (double)rig.avoid.config.v_creep_mps));
}

/* Lowers the bound of a turn to one side to what an obstacle on that side leaves. */
static void bound(world_t *world, const disc_t *disc, double room, double *least,
                  const disc_t **by) {
    world->near_a_decision |= fabs(room - *least) < BAND && turn_s(false) > turn_s(true);
    if (room < *least) {
        *least = room;
        *by = disc;
    }
}

/* Clamps the turn to the free headings around the heading. */
static void still_free(world_t *world, double heading, bool conservative, answer_t *answer) {
    const double late_s = (double)rig.avoid.period_s + (double)rig.avoid.config.tau_s;
    const double turn = answer->omega * late_s;
    double left = PI; /* beyond an obstacle on the other side no turn of one period gets */
    double right = PI;
    const disc_t *left_by = NULL;
    const disc_t *right_by = NULL;
    for (uint32_t i = 0; i < world->count; i++) {
        const disc_t *disc = &world->discs[i];
        const double centre = support_wrap(disc->direction - heading);
        world->near_a_decision |= fabs(centre) > PI - BAND;
        if (centre > 0.0) {
            bound(world, disc, centre - disc->half - MARGIN, &left, &left_by);
        } else {
            bound(world, disc, -centre - disc->half - MARGIN, &right, &right_by);
        }
    }
    answer->turning = 0;
    world->near_a_decision |= fabs(turn - left) < BAND || fabs(turn + right) < BAND;
    if (turn <= left && turn >= -right) {
        answer->mode = BERTH_MODE_TRACK;
        return;
    }
    const bool to_left = turn > left;
    answer->omega = fmin(fmax(turn, -right), left) / late_s;
    answer->v = skirting(world, to_left ? left_by : right_by, conservative, answer->v);
    answer->mode = conservative ? BERTH_MODE_CONSERVATIVE_GO : BERTH_MODE_REGULATED;
}

/* The robot can stop at R of what it heads for, after the delay; without a limit of braking: within
 * the delay. */
static void cap(world_t *world, double heading, answer_t *answer) {
    const double delay = (double)rig.avoid.period_s + (double)rig.avoid.config.tau_s;
    const double a = (double)rig.avoid.config.a_brake_mps2;
    if (answer->mode == BERTH_MODE_BLOCKED || (delay <= (double)rig.avoid.period_s && a <= 0.0)) {
        return;
    }
    for (uint32_t i = 0; i < world->count; i++) {
        const disc_t *disc = &world->discs[i];
        const double aside = fabs(support_wrap(heading - disc->direction));
        const double limit = asin(fmin(disc->hard / disc->d, 1.0)) + 0.05;
        const double room = fmax(disc->d - disc->hard, 0.0);
        world->near_a_decision |= fabs(aside - limit) < BAND || fabs(disc->d - disc->hard) < BAND;
        if (aside < limit) {
            const double most =
                a > 0.0 ? a * (sqrt(delay * delay + 2.0 * room / a) - delay) : room / delay;
            answer->v = fmin(answer->v, most);
        }
    }
}

/* Sides of inactive obstacles are forgotten some way outside; never asked of the model. */
static answer_t model(double v, double omega) {
    world_t world;
    observe(&world);
    answer_t answer = {
        .mode = BERTH_MODE_TRACK, .v = v, .omega = omega, .turning = rig.avoid.turning};
    for (uint32_t i = 0; i < rig.obstacles.count; i++) {
        answer.sides[i] = rig.obstacles.slots[i].memory.side;
    }
    if (world.count > 0) {
        const double heading = (double)rig.pose.theta_rad;
        bool free = true;
        bool conservative = false;
        for (uint32_t i = 0; i < world.count; i++) {
            const double gap = outside(&world.discs[i], heading);
            world.near_a_decision |= fabs(gap) < BAND;
            free = free && gap >= 0.0;
            conservative = conservative || world.discs[i].d <= world.discs[i].conservative;
        }
        answer.v = fmax(v, 0.0);
        if (free) {
            still_free(&world, heading, conservative, &answer);
        } else {
            not_free(&world, heading, conservative, &answer);
        }
        cap(&world, heading, &answer);
    } else {
        answer.turning = 0;
    }
    answer.near_a_decision = world.near_a_decision;
    return answer;
}

static float draw(double low, double high) {
    return (float)support_uniform(low, high);
}

/* A plan that wanders among the obstacles, so that they are entered and left. */
static void draw_plan(void) {
    const uint32_t count = 2 + support_index(RIG_SAMPLES_MAX - 2);
    double x = support_uniform(-2.0, 2.0);
    double y = support_uniform(-2.0, 2.0);
    for (uint32_t k = 0; k < count; k++) {
        x += support_uniform(-0.6, 0.6);
        y += support_uniform(-0.6, 0.6);
        rig.samples[k] =
            (berth_sample_t){.x_m = (float)x, .y_m = (float)y, .v_mps = draw(-0.2, 0.8)};
    }
    rig.plan.count = count;
    rig.plan.closed = support_index(2) == 0;
    const uint32_t last = rig.plan.closed ? 3 * count : count + 2;
    berth_reference_advance(&rig.reference, &rig.plan,
                            (int64_t)support_index(last) * RIG_PERIOD_US);
}

static void draw_obstacles(void) {
    const uint32_t count = 1 + support_index(support_index(4) == 0 ? BERTH_OBSTACLES_MAX : 5);
    const double skirt = (double)rig.avoid.config.skirt_m;
    for (uint32_t i = 0; i < count; i++) {
        const double hard = support_uniform(0.05, 0.5);
        const double conservative = hard + support_uniform(0.1, 0.3);
        const double wide = support_index(4) == 0 ? 0.0 : support_uniform(0.0, 1.0);
        const float radii[3] = {(float)hard, (float)conservative,
                                (float)(conservative + skirt + wide)};
        rig_add(&rig, draw(-1.5, 1.5), draw(-1.5, 1.5), radii);
    }
}

/* After the look-ahead has run, because that forgets all sides. */
static void draw_memory(void) {
    rig.avoid.turning = (int8_t)(support_index(3) == 0 ? (int)support_index(3) - 1 : 0);
    for (uint32_t i = 0; i < rig.obstacles.count; i++) {
        if (support_index(4) == 0) {
            rig.obstacles.slots[i].memory.side = (int8_t)((int)support_index(3) - 1);
        }
    }
}

static void draw_scene(void) {
    const bool delayed = support_index(2) == 0;
    const berth_avoid_config_t config = {
        .skirt_m = draw(0.0, 0.2),
        .v_creep_mps = 0.05f,
        .tau_s = delayed ? draw(0.0, 0.5) : 0.0f,
        .a_brake_mps2 = delayed && support_index(2) == 0 ? draw(0.5, 5.0) : 0.0f,
        .paced = support_index(2) == 0,
    };
    rig_init(&rig, &config);
    draw_plan();
    draw_obstacles();
    lookahead_start(&rig.avoid, &rig.obstacles, &rig.plan, &rig.reference);
    draw_memory();
    rig_pose(&rig, draw(-1.5, 1.5), draw(-1.5, 1.5), draw(-PI, PI));
}

static void compare(const answer_t *expected) {
    TEST_ASSERT_EQUAL_STRING(berth_mode_text(expected->mode), berth_mode_text(rig.mode));
    TEST_ASSERT_EQUAL_INT(expected->turning, rig.avoid.turning);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-6 + 1.0e-5 * fabs(expected->v), expected->v,
                              (double)rig.command.v_mps);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-4, expected->omega, (double)rig.command.omega_radps);
    for (uint32_t i = 0; i < rig.obstacles.count; i++) {
        const berth_obstacle_slot_t *slot = &rig.obstacles.slots[i];
        const double d = hypot((double)slot->obstacle.x_m - (double)rig.pose.x_m,
                               (double)slot->obstacle.y_m - (double)rig.pose.y_m);
        if (d <= (double)slot->obstacle.regulated_m) {
            TEST_ASSERT_EQUAL_INT(expected->sides[i], slot->memory.side);
        }
    }
}

static void test_one_step_in_random_scenes(void) {
    const uint32_t runs = support_runs(400000);
    uint32_t skipped = 0;
    uint32_t modes[5] = {0};
    support_random_start();
    for (uint32_t i = 0; i < runs; i++) {
        draw_scene();
        const float v = draw(-0.8, 1.2);
        const float omega = draw(-12.0, 12.0);
        const answer_t expected = model((double)v, (double)omega);
        if (expected.near_a_decision) {
            skipped++;
            continue;
        }
        (void)rig_step(&rig, v, omega);
        modes[rig.mode]++;
        compare(&expected);
    }
    printf("%u scenes, %u passed over; track %u regulated %u turn %u go %u blocked %u\n", runs,
           skipped, modes[0], modes[1], modes[2], modes[3], modes[4]);
    TEST_ASSERT_LESS_THAN_UINT32(runs / 200, skipped);
    for (int mode = 0; mode < 5; mode++) {
        TEST_ASSERT_GREATER_THAN_UINT32(runs / 200, modes[mode]);
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_one_step_in_random_scenes);
    return UNITY_END();
}
