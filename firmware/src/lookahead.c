#include "lookahead.h"

#include "plan_inline.h"

/* Obstacles whose scan may go on in one step. */
#define SLOTS_PER_STEP 2u

enum { SCAN_NEW = 0, SCAN_SEEKS_INSIDE, SCAN_SEEKS_OUTSIDE, SCAN_FOUND };

_Static_assert(BERTH_SCAN_AHEAD > 0 && BERTH_SCAN_AHEAD <= 32767,
               "offsets from the current sample are compared as signed numbers");
_Static_assert(BERTH_SCAN_PER_STEP > 0 && BERTH_SCAN_PER_STEP <= BERTH_SCAN_PER_STEP_MAX,
               "the look-ahead's share of a step is bounded by contract");

static bool outside(const berth_obstacle_t *obstacle, float x_m, float y_m) {
    const float dx = obstacle->x_m - x_m;
    const float dy = obstacle->y_m - y_m;
    return dx * dx + dy * dy > obstacle->regulated_m * obstacle->regulated_m;
}

/* Offset of the cursor from the current sample; negative once the reference has passed it. The
 * counter wraps at 2^32, which the difference survives. */
static int32_t offset(const berth_obstacle_slot_t *slot, const berth_reference_t *reference) {
    return (int32_t)(slot->memory.cursor - reference->total);
}

/* Scans on until the exit, the horizon, the end of an open plan or the budget is reached. Returns
 * how many samples it looked at. */
static uint32_t scan(berth_obstacle_slot_t *slot, const berth_plan_t *plan,
                     const berth_reference_t *reference, uint32_t budget) {
    berth_obstacle_memory_t *memory = &slot->memory;
    uint32_t ahead = (uint32_t)offset(slot, reference);
    uint32_t used = 0;
    while (used < budget && ahead < BERTH_SCAN_AHEAD) {
        const uint32_t k = reference->index + ahead;
        if (!plan->closed && k >= plan->count) {
            break; /* the held pose cannot leave what it is in */
        }
        const berth_sample_t *sample = &plan->samples[k < plan->count ? k : k % plan->count];
        const bool is_outside = outside(&slot->obstacle, sample->x_m, sample->y_m);
        used++;
        if (memory->scan == SCAN_SEEKS_OUTSIDE && is_outside) {
            memory->scan = SCAN_FOUND;
            break; /* the cursor stays on the exit */
        }
        if (!is_outside) {
            memory->scan = SCAN_SEEKS_OUTSIDE;
        }
        ahead++;
        memory->cursor++;
    }
    return used;
}

/* Starts over where the scan has nothing to go on from. */
static void renew(berth_obstacle_slot_t *slot, const berth_reference_t *reference,
                  const berth_pose_t *pose) {
    berth_obstacle_memory_t *memory = &slot->memory;
    const bool passed = offset(slot, reference) < 0;
    bool restart = memory->scan == SCAN_NEW || (passed && memory->scan != SCAN_FOUND);
    if (passed && memory->scan == SCAN_FOUND) {
        restart = outside(&slot->obstacle, pose->x_m, pose->y_m);
    }
    if (restart) {
        memory->scan = SCAN_SEEKS_INSIDE;
        memory->cursor = reference->total;
    }
}

void lookahead_start(berth_avoid_t *avoid, berth_obstacles_t *obstacles, const berth_plan_t *plan,
                     const berth_reference_t *reference) {
    avoid->scan_next = 0;
    avoid->turning = 0;
    for (uint32_t i = 0; i < obstacles->count; i++) {
        berth_obstacle_slot_t *slot = &obstacles->slots[i];
        slot->memory =
            (berth_obstacle_memory_t){.scan = SCAN_SEEKS_INSIDE, .cursor = reference->total};
        (void)scan(slot, plan, reference, BERTH_SCAN_AHEAD);
    }
}

void lookahead_advance(berth_avoid_t *avoid, berth_obstacles_t *obstacles, const berth_plan_t *plan,
                       const berth_reference_t *reference, const berth_pose_t *pose) {
    const uint32_t slots = obstacles->count < SLOTS_PER_STEP ? obstacles->count : SLOTS_PER_STEP;
    uint32_t budget = 2u * obstacles->count;
    budget = budget < BERTH_SCAN_PER_STEP ? BERTH_SCAN_PER_STEP : budget;
    budget = budget > BERTH_SCAN_PER_STEP_MAX ? BERTH_SCAN_PER_STEP_MAX : budget;
    for (uint32_t i = 0; i < slots && budget > 0; i++) {
        if (avoid->scan_next >= obstacles->count) {
            avoid->scan_next = 0;
        }
        berth_obstacle_slot_t *slot = &obstacles->slots[avoid->scan_next];
        renew(slot, reference, pose);
        if (slot->memory.scan != SCAN_FOUND) {
            budget -= scan(slot, plan, reference, budget);
        }
        avoid->scan_next++;
    }
}

bool lookahead_exit(const berth_obstacle_slot_t *slot, const berth_plan_t *plan,
                    const berth_reference_t *reference, berth_sample_t *beyond) {
    if (slot->memory.scan != SCAN_FOUND) {
        return false;
    }
    int32_t k = (int32_t)slot->memory.cursor; /* an open plan counts samples from its start */
    if (plan->closed) {
        /* from the current sample; backwards, over laps even, where the reference has passed the
         * exit while the robot stays by the obstacle */
        const int32_t count = (int32_t)plan->count;
        k = (int32_t)reference->index + offset(slot, reference);
        k = k < 0 ? k % count + count : k;
    }
    *beyond = plan_sample_inline(plan, (uint32_t)k);
    return true;
}
