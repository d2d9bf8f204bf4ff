#include "berth/avoid.h"

#include "angle_inline.h"
#include "check.h"
#include "lookahead.h"
#include "plan_inline.h"
#include "scalar.h"
#include "small.h"

#include <math.h>

#define HALF_PI (0.5f * BERTH_PI)
#define TWO_PI (2.0f * BERTH_PI)

/* Margin on an obstacle's visible half angle within which the braking cap acts: the heading may
 * still come nearer by that much while a drive with delay obeys the last command. */
#define BRAKING_MARGIN_RAD 0.05f

/* A side is forgotten once the robot is this far outside the regulated radius: skirting wavers
 * about the radius, and the choice must not be made anew each time. */
#define SIDE_RELEASE_M 0.1f

/* A paced robot is where the reference leaves the obstacle's regulated radius by a fifth of the
 * time before the reference is: a robot that comes late has no speed left to make it good. */
#define PACE 1.25f

/* An active obstacle as the robot sees it. */
typedef struct {
    float centre_rad; /* direction of its centre, relative to the heading */
    float half_rad;   /* alpha: half the angle under which its skirt is seen */
    float distance_m; /* d */
    berth_obstacle_slot_t *slot;
} cone_t;

/* Free turn to one side, and what bounds it. */
typedef struct {
    float room_rad;     /* >= 0 */
    const cone_t *cone; /* means something only where room < pi */
} side_t;

/* What a step sees. */
typedef struct {
    cone_t cones[BERTH_OBSTACLES_MAX];
    uint32_t count;
    side_t left; /* while free */
    side_t right;
    bool free;         /* the heading is free of all active obstacles */
    bool conservative; /* within the conservative radius of some obstacle */
    bool unseen;       /* there is an active one that the look-ahead has not begun with */
    bool coincident;   /* on the centre of one, where no heading leads away for sure */
} view_t;

/* Ranges of the configuration by itself. */
static const check_rule_t config_rules[] = {
    {BERTH_FIELD_SKIRT, false, CHECK_AT(berth_avoid_config_t, skirt_m), 0.0f, 10.0f},
    {BERTH_FIELD_TAU, false, CHECK_AT(berth_avoid_config_t, tau_s), 0.0f, 10.0f},
    {BERTH_FIELD_A_BRAKE, true, CHECK_AT(berth_avoid_config_t, a_brake_mps2), 0.001f, 1000.0f},
    {BERTH_FIELD_SIGMA_POSE, false, CHECK_AT(berth_avoid_config_t, sigma_pose_m), 0.0f, 1.0f},
};

/* And together with the robot's limits. */
static bool check_together(const berth_avoid_config_t *config, const berth_limits_config_t *limits,
                           uint32_t period_us, berth_refusal_t *refusal) {
    const float turn = limits->omega_max_radps * plan_period_s(period_us);
    const bool good =
        check_value(BERTH_FIELD_PLAN_PERIOD, (float)period_us, (float)BERTH_PERIOD_MIN_US,
                    (float)BERTH_PERIOD_MAX_US, refusal) &&
        check_value(BERTH_FIELD_V_CREEP, config->v_creep_mps, 0.001f, limits->v_max_mps, refusal) &&
        check_value(BERTH_FIELD_TURN_PER_PERIOD, turn, 0.0f, HALF_PI, refusal);
    /* braking that the drives are sure of cannot exceed what the limits let them have */
    return good &&
           (limits->a_max_mps2 == 0.0f || check_value(BERTH_FIELD_A_BRAKE, config->a_brake_mps2,
                                                      0.001f, limits->a_max_mps2, refusal));
}

berth_error_t berth_avoid_init(berth_avoid_t *avoid, const berth_avoid_config_t *config,
                               const berth_limits_config_t *limits, uint32_t period_us,
                               berth_refusal_t *refusal) {
    const berth_error_t error = berth_limits_check(limits, refusal);
    if (error != BERTH_OK) {
        return error;
    }
    if (!check_rules(config, config_rules, CHECK_COUNT(config_rules), refusal) ||
        !check_together(config, limits, period_us, refusal)) {
        return BERTH_ERROR_CONFIG;
    }
    const float period_s = plan_period_s(period_us);
    const float v = limits->v_max_mps;
    const float braking_m =
        config->a_brake_mps2 > 0.0f ? v * v / (2.0f * config->a_brake_mps2) : 0.0f;
    /* from full turn one way to full turn the other the robot heads where it should not */
    const float yaw_delay_s = limits->alpha_max_radps2 > 0.0f
                                  ? 2.0f * limits->omega_max_radps / limits->alpha_max_radps2
                                  : 0.0f;
    *avoid = (berth_avoid_t){
        .config = *config,
        .period_s = period_s,
        .v_max_mps = v,
        .omega_max_radps = limits->omega_max_radps,
        .clearance_min_m =
            v * (period_s + config->tau_s + yaw_delay_s) + braking_m + 3.0f * config->sigma_pose_m,
        .clearance_m = BERTH_RADIUS_MAX_M,
    };
    return BERTH_OK;
}

berth_error_t berth_avoid_check_obstacle(const berth_avoid_t *avoid,
                                         const berth_obstacle_t *obstacle,
                                         berth_refusal_t *refusal) {
    const float clearance = obstacle->conservative_m - obstacle->hard_m;
    if (!check_range(clearance, avoid->clearance_min_m - BERTH_RADIUS_SLACK_M,
                     BERTH_RADIUS_MAX_M)) {
        *refusal = (berth_refusal_t){BERTH_FIELD_CLEARANCE, 0, clearance, avoid->clearance_min_m,
                                     BERTH_RADIUS_MAX_M - obstacle->hard_m};
        return BERTH_ERROR_CLEARANCE;
    }
    const float skirt = obstacle->conservative_m + avoid->config.skirt_m;
    if (!check_range(obstacle->regulated_m, skirt - BERTH_RADIUS_SLACK_M, BERTH_RADIUS_MAX_M)) {
        *refusal = (berth_refusal_t){BERTH_FIELD_OBSTACLE_REGULATED, 0, obstacle->regulated_m,
                                     skirt, BERTH_RADIUS_MAX_M};
        return BERTH_ERROR_CONFIG;
    }
    return BERTH_OK;
}

/* One copy for two callers. */
SMALL static float asin_ratio(float x) {
    return angle_asin_ratio(x);
}

/* Takes an active obstacle into the view. */
static inline void see(const berth_avoid_t *avoid, view_t *view, cone_t *cone) {
    const berth_obstacle_t *obstacle = &cone->slot->obstacle;
    const float skirt = obstacle->conservative_m + avoid->config.skirt_m;
    /* G = S switches the regulated strategy off: all that is active is conservative then */
    const float conservative = obstacle->regulated_m > skirt + BERTH_RADIUS_SLACK_M
                                   ? obstacle->conservative_m
                                   : obstacle->regulated_m;
    const float half = cone->distance_m > skirt ? asin_ratio(skirt / cone->distance_m) : HALF_PI;
    cone->half_rad = half;
    if (cone->distance_m <= conservative) {
        view->conservative = true;
    }
    const float gap = fabsf(cone->centre_rad) - half;
    if (gap < -BERTH_FREE_TOLERANCE_RAD) {
        view->free = false;
        return;
    }
    const float room = maximum(gap - BERTH_EDGE_MARGIN_RAD, 0.0f);
    side_t *side = cone->centre_rad > 0.0f ? &view->left : &view->right;
    if (room < side->room_rad) {
        *side = (side_t){room, cone};
    }
}

static void look(berth_avoid_t *avoid, berth_obstacles_t *obstacles, const berth_pose_t *pose,
                 view_t *view) {
    const float x_m = pose->x_m;
    const float y_m = pose->y_m;
    cone_t *cone = view->cones;
    float clearance_m = BERTH_RADIUS_MAX_M;
    view->left = (side_t){BERTH_PI, cone};
    view->right = (side_t){BERTH_PI, cone};
    view->free = true;
    view->conservative = false;
    view->unseen = false;
    view->coincident = false;
    const berth_obstacle_slot_t *const end = &obstacles->slots[obstacles->count];
    for (berth_obstacle_slot_t *slot = obstacles->slots; slot != end; slot++) {
        const berth_obstacle_t *obstacle = &slot->obstacle;
        const float dx = obstacle->x_m - x_m;
        const float dy = obstacle->y_m - y_m;
        const float square = dx * dx + dy * dy;
        if (square > obstacle->regulated_m * obstacle->regulated_m) {
            if (slot->memory.side != 0) {
                const float release = obstacle->regulated_m + SIDE_RELEASE_M;
                if (square > release * release) {
                    slot->memory.side = 0;
                }
            }
            continue;
        }
        cone->centre_rad = berth_wrap_inline(berth_atan2(dy, dx) - pose->theta_rad);
        cone->distance_m = sqrtf(square);
        cone->slot = slot;
        see(avoid, view, cone);
        if (slot->memory.scan == 0u) {
            view->unseen = true;
        }
        if (!(cone->distance_m > 0.0f)) {
            view->coincident = true;
        }
        clearance_m = minimum(clearance_m, cone->distance_m - obstacle->hard_m);
        cone++;
    }
    const ptrdiff_t count = cone - view->cones; /* MISRA D11 */
    view->count = (uint32_t)count;
    avoid->clearance_m = clearance_m;
    avoid->active = (uint8_t)view->count;
}

/* Turn to the nearest free heading on one side, direction +1 left, -1 right: goes from cone to cone
 * until it is inside none. Each cone moves the edge at most once, since the edge only grows and
 * leaves a cone at its far side; a full turn or more means that no heading is free. */
static float free_edge(const view_t *view, float direction) {
    float edge = 0.0f;
    for (uint32_t pass = 0; pass <= view->count; pass++) {
        bool moved = false;
        for (uint32_t i = 0; i < view->count; i++) {
            const cone_t *cone = &view->cones[i];
            float inside = edge - direction * cone->centre_rad;
            if (inside > BERTH_PI) {
                inside -= TWO_PI;
            }
            if (fabsf(inside) - cone->half_rad < -BERTH_FREE_TOLERANCE_RAD) {
                edge += cone->half_rad - inside;
                moved = true;
            }
        }
        if (!moved || edge >= TWO_PI) {
            break;
        }
    }
    return edge;
}

/* The obstacle that decides the side: of those in the way, one whose side is being kept, else the
 * one whose skirt is nearest. There is one in the way. */
static const cone_t *deciding_cone(const view_t *view, float left_rad, float right_rad) {
    const cone_t *nearest = view->cones;
    const cone_t *kept = NULL;
    float nearest_m = BERTH_RADIUS_MAX_M; /* further than any active one: C > 0 */
    float kept_m = nearest_m;
    for (uint32_t i = 0; i < view->count; i++) {
        const cone_t *cone = &view->cones[i];
        const float distance = cone->distance_m - cone->slot->obstacle.conservative_m;
        const bool ahead = fabsf(cone->centre_rad) - cone->half_rad < -BERTH_FREE_TOLERANCE_RAD;
        const bool between = cone->centre_rad < left_rad && cone->centre_rad > -right_rad;
        if (ahead && distance < nearest_m) {
            nearest = cone;
            nearest_m = distance;
        }
        if (between && cone->slot->memory.side != 0 && distance < kept_m) {
            kept = cone;
            kept_m = distance;
        }
    }
    return kept != NULL ? kept : nearest;
}

/* Everything a step works on. */
typedef struct {
    berth_avoid_t *avoid;
    const berth_plan_t *plan;
    const berth_reference_t *reference;
    const berth_pose_t *pose;
} scene_t;

/* Side that the plan asks for: the way round the obstacle to the reference's first sample beyond
 * it. 0 when the look-ahead has not found one. */
static int8_t planned_side(const scene_t *scene, const berth_obstacle_slot_t *slot) {
    const berth_sample_t *beyond = lookahead_exit(slot, scene->plan, scene->reference);
    if (beyond == NULL) {
        return 0;
    }
    const float robot_x = scene->pose->x_m - slot->obstacle.x_m;
    const float robot_y = scene->pose->y_m - slot->obstacle.y_m;
    const float exit_x = beyond->x_m - slot->obstacle.x_m;
    const float exit_y = beyond->y_m - slot->obstacle.y_m;
    const float cross = robot_x * exit_y - robot_y * exit_x;
    if (cross > 0.0f) {
        return -1; /* counter-clockwise about the obstacle: it stays on the robot's left */
    }
    return cross < 0.0f ? 1 : 0;
}

/* Speed with which the robot is at the exit a little before the reference is. */
static float paced_speed(const scene_t *scene, const berth_obstacle_slot_t *slot,
                         const berth_sample_t *beyond) {
    const uint32_t gap = slot->memory.cursor - scene->reference->total;
    const int32_t ahead = (int32_t)gap;
    if (ahead <= 0) {
        return scene->avoid->v_max_mps;
    }
    const float dx = beyond->x_m - scene->pose->x_m;
    const float dy = beyond->y_m - scene->pose->y_m;
    return PACE * sqrtf(dx * dx + dy * dy) / ((float)ahead * scene->avoid->period_s);
}

/* Whether the drives' delay is reckoned with: not where the robot stands to turn. */
static bool is_paced(const berth_avoid_t *avoid, const view_t *view) {
#ifdef BERTH_WITHOUT_PACE
    (void)avoid;
    (void)view;
    return false;
#else
    return avoid->config.paced && !view->conservative;
#endif
}

/* Speed that keeps the robot going round the obstacle that bounds its turn. */
static float skirting_speed(const scene_t *scene, const view_t *view, const side_t *bound,
                            float v_mps) {
    if (is_paced(scene->avoid, view) && scene->avoid->config.tau_s > 0.0f &&
        bound->room_rad < BERTH_PI) {
        /* NOLINTNEXTLINE(clang-analyzer-core.NullDereference): room < pi comes with its cone */
        const berth_obstacle_slot_t *slot = bound->cone->slot;
        const berth_sample_t *beyond = lookahead_exit(slot, scene->plan, scene->reference);
        if (beyond != NULL) {
            return paced_speed(scene, slot, beyond);
        }
    }
    const berth_plan_t *plan = scene->plan;
    const uint32_t index = scene->reference->index;
    const float v_r = index < plan->count ? plan->samples[index].v_mps : 0.0f;
    return maximum(maximum(v_mps, v_r), scene->avoid->config.v_creep_mps);
}

/* The heading is free: keep it free. */
static berth_mode_t keep_free(const scene_t *scene, const view_t *view, berth_twist_t *command) {
    /* within C there is no room for a turn that goes on past the edge, again and again */
    const float turn_s = scene->avoid->period_s + scene->avoid->config.tau_s;
    const float turn = command->omega_radps * turn_s;
    const side_t *bound = turn > 0.0f ? &view->left : &view->right;
    if (fabsf(turn) <= bound->room_rad) {
        return BERTH_MODE_TRACK;
    }
    command->omega_radps = (turn > 0.0f ? bound->room_rad : -bound->room_rad) / turn_s;
    command->v_mps = skirting_speed(scene, view, bound, command->v_mps);
    return view->conservative ? BERTH_MODE_CONSERVATIVE_GO : BERTH_MODE_REGULATED;
}

/* Obstacles that are in the way together are passed on the same side, unless one already has its
 * own: the way between them is not free from here. */
static void keep_side(const view_t *view, float left_rad, float right_rad, int8_t side) {
    for (uint32_t i = 0; i < view->count; i++) {
        const cone_t *cone = &view->cones[i];
        berth_obstacle_memory_t *memory = &cone->slot->memory;
        const bool between = cone->centre_rad < left_rad && cone->centre_rad > -right_rad;
        if (between && memory->side == 0) {
            memory->side = side;
        }
    }
}

/* Side for the turn at hand. A turn that has begun goes on to its end: the robot stands or nearly
 * so, and obstacles that ask for different sides must not turn it to and fro. */
static int8_t choose_side(const scene_t *scene, const view_t *view, float left_rad,
                          float right_rad) {
    berth_obstacle_slot_t *slot = deciding_cone(view, left_rad, right_rad)->slot;
    int8_t side = scene->avoid->turning;
    if (side == 0) {
        side = slot->memory.side;
    }
    if (side == 0) {
        side = planned_side(scene, slot);
    }
    if (side == 0) {
        side = left_rad <= right_rad ? 1 : -1;
    }
    scene->avoid->turning = side;
    slot->memory.side = side;
    keep_side(view, left_rad, right_rad, side);
    return side;
}

/* The heading is not free: turn to a free one. */
static berth_mode_t turn_free(const scene_t *scene, const view_t *view, berth_twist_t *command) {
    const berth_avoid_t *avoid = scene->avoid;
    const float left = free_edge(view, 1.0f);
    const float right = free_edge(view, -1.0f);
    if (left >= TWO_PI || right >= TWO_PI) {
        return BERTH_MODE_BLOCKED;
    }
    const int8_t side = choose_side(scene, view, left, right);
    const float turn = (side > 0 ? left : right) + BERTH_EDGE_MARGIN_RAD;
    const float turn_s = avoid->period_s + (is_paced(avoid, view) ? avoid->config.tau_s : 0.0f);
    const float omega = minimum(turn / turn_s, avoid->omega_max_radps);
    command->omega_radps = (float)side * omega;
    if (view->conservative) {
        command->v_mps = 0.0f;
        return BERTH_MODE_CONSERVATIVE_TURN;
    }
    return BERTH_MODE_REGULATED;
}

/* Caps the speed so that the robot can stop at the hard radius of each obstacle ahead. */
static void brake(berth_avoid_t *avoid, const view_t *view, berth_twist_t *command) {
    const float delay = avoid->period_s + avoid->config.tau_s;
    const float a = avoid->config.a_brake_mps2;
    for (uint32_t i = 0; i < view->count; i++) {
        const cone_t *cone = &view->cones[i];
        const float hard = cone->slot->obstacle.hard_m;
        const float half = asin_ratio(minimum(hard / cone->distance_m, 1.0f));
        if (fabsf(cone->centre_rad) >= half + BRAKING_MARGIN_RAD) {
            continue;
        }
        const float room = maximum(cone->distance_m - hard, 0.0f);
        const float cap =
            a > 0.0f ? a * (sqrtf(delay * delay + 2.0f * room / a) - delay) : room / delay;
        if (command->v_mps > cap) {
            command->v_mps = cap;
            avoid->braking = true;
        }
    }
}

berth_mode_t berth_avoid_step(berth_avoid_t *avoid, berth_obstacles_t *obstacles,
                              const berth_plan_t *plan, const berth_reference_t *reference,
                              const berth_pose_t *pose, berth_twist_t *command) {
    view_t view;
    const scene_t scene = {avoid, plan, reference, pose};
    look(avoid, obstacles, pose, &view);
    avoid->braking = false;
    if (view.free) {
        avoid->turning = 0;
    }
    /* The look-ahead is far ahead of what it is needed for: it may stand while there is much else
     * to do, but for an obstacle that it has never looked at. A turn under way does not need it. */
    if (avoid->turning == 0 && (view.unseen || view.count < 2u)) {
        lookahead_advance(avoid, obstacles, plan, reference, pose);
    }
    if (view.count == 0u) {
        return BERTH_MODE_TRACK;
    }
    command->v_mps = maximum(command->v_mps, 0.0f); /* it sees where it is going only ahead */
    berth_mode_t mode = BERTH_MODE_BLOCKED;
    if (!view.coincident) {
        mode = view.free ? keep_free(&scene, &view, command) : turn_free(&scene, &view, command);
    }
    if (mode == BERTH_MODE_BLOCKED) {
        *command = (berth_twist_t){0.0f, 0.0f};
    } else if (avoid->config.tau_s > 0.0f || avoid->config.a_brake_mps2 > 0.0f) {
        brake(avoid, &view, command);
    } else {
        /* it stops at once: there is no way to brake on */
    }
    return mode;
}

const char *berth_mode_text(berth_mode_t mode) {
    static const char *const texts[] = {"track", "regulated", "conservative_turn",
                                        "conservative_go", "blocked"};
    const unsigned number = (unsigned)mode;
    return number <= (unsigned)BERTH_MODE_BLOCKED ? texts[number] : "?";
}
