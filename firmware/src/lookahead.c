#include "lookahead.h"

/* Slots that a step looks at to find one with something to scan for. */
#define LOOKS_PER_STEP 4u

enum { SCAN_NEW = 0, SCAN_SEEKS_INSIDE, SCAN_SEEKS_OUTSIDE, SCAN_FOUND };

_Static_assert(BERTH_SCAN_AHEAD > 0u && BERTH_SCAN_AHEAD <= 32767u,
               "offsets from the current sample are compared as signed numbers");
_Static_assert(BERTH_OBSTACLES_MAX < 256u, "slots are numbered in 8 bits");
_Static_assert(BERTH_SCAN_PER_STEP_MIN > 0u && BERTH_SCAN_PER_STEP_MAX <= 32u,
               "the look-ahead's share of a step is bounded by contract");

static bool outside(const berth_obstacle_t *obstacle, float x_m, float y_m) {
    const float dx = obstacle->x_m - x_m;
    const float dy = obstacle->y_m - y_m;
    return dx * dx + dy * dy > obstacle->regulated_m * obstacle->regulated_m;
}

/* Offset of the cursor from the current sample; negative once the reference has passed it. The
 * counter wraps at 2^32, which the difference survives. */
static int32_t offset(const berth_obstacle_slot_t *slot, const berth_reference_t *reference) {
    const uint32_t ahead = slot->memory.cursor - reference->total;
    return (int32_t)ahead;
}

/* First sample from k on, before end, that is not outside (or not inside); end when there is none.
 * This loop is most of what the look-ahead costs. */
static inline uint32_t first_unlike(const berth_obstacle_t *obstacle, const berth_sample_t *samples,
                                    uint32_t k, uint32_t end, bool are_outside) {
    const float x = obstacle->x_m;
    const float y = obstacle->y_m;
    const float square = obstacle->regulated_m * obstacle->regulated_m;
    uint32_t i = k;
    for (; i < end; i++) {
        const float dx = x - samples[i].x_m;
        const float dy = y - samples[i].y_m;
        const bool is_outside = dx * dx + dy * dy > square;
        if (is_outside != are_outside) {
            break;
        }
    }
    return i;
}

/* Scans on until the exit, the horizon, the plan's last row or the budget is reached. Returns by
 * how many samples the cursor has moved. */
static uint32_t scan(berth_obstacle_slot_t *slot, const berth_plan_t *plan,
                     const berth_reference_t *reference, uint32_t budget) {
    berth_obstacle_memory_t *memory = &slot->memory;
    const uint32_t ahead = (uint32_t)offset(slot, reference);
    uint32_t k = reference->index + ahead;
    if (k >= plan->count) {
        if (!plan->closed) {
            return 0; /* the held pose after the end cannot leave what it is in */
        }
        k %= plan->count;
    }
    uint32_t run = ahead < BERTH_SCAN_AHEAD ? BERTH_SCAN_AHEAD - ahead : 0u;
    run = run < budget ? run : budget;
    const uint32_t first = k;
    uint32_t end = k + run;
    end = end < plan->count ? end : plan->count;
    if (memory->scan == SCAN_SEEKS_INSIDE) {
        k = first_unlike(&slot->obstacle, plan->samples, k, end, true);
        if (k < end) {
            memory->scan = SCAN_SEEKS_OUTSIDE;
        }
    }
    if (memory->scan == SCAN_SEEKS_OUTSIDE) {
        k = first_unlike(&slot->obstacle, plan->samples, k, end, false);
    }
    memory->cursor += k - first;
    if (k < end) {
        memory->scan = SCAN_FOUND; /* the cursor stays on the exit */
    }
    return k - first;
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
        uint32_t used = 1;
        for (uint32_t left = BERTH_SCAN_AHEAD; left > 0u && used > 0u; left -= used) {
            used = slot->memory.scan == SCAN_FOUND ? 0u : scan(slot, plan, reference, left);
        }
    }
}

void lookahead_advance(berth_avoid_t *avoid, berth_obstacles_t *obstacles, const berth_plan_t *plan,
                       const berth_reference_t *reference, const berth_pose_t *pose) {
    const uint32_t count = obstacles->count;
    const uint32_t looks = count < LOOKS_PER_STEP ? count : LOOKS_PER_STEP;
    uint32_t next = avoid->scan_next;
    for (uint32_t i = 0; i < looks; i++) {
        next = next < count ? next : 0u;
        berth_obstacle_slot_t *slot = &obstacles->slots[next];
        next++;
        renew(slot, reference, pose);
        if (slot->memory.scan != SCAN_FOUND) {
            /* by the slot's next turn the reference has gone on by count samples at most */
            uint32_t budget = 2u * count;
            budget = budget > BERTH_SCAN_PER_STEP_MIN ? budget : BERTH_SCAN_PER_STEP_MIN;
            budget = budget < BERTH_SCAN_PER_STEP_MAX ? budget : BERTH_SCAN_PER_STEP_MAX;
            (void)scan(slot, plan, reference, budget);
            break;
        }
    }
    avoid->scan_next = (uint8_t)next;
}

const berth_sample_t *lookahead_exit(const berth_obstacle_slot_t *slot, const berth_plan_t *plan,
                                     const berth_reference_t *reference) {
    if (slot->memory.scan != SCAN_FOUND) {
        return NULL;
    }
    uint32_t k = slot->memory.cursor; /* an open plan counts samples from its start */
    if (plan->closed) {
        /* from the current sample; backwards, over laps even, where the reference has passed the
         * exit while the robot stays by the obstacle */
        const int32_t count = (int32_t)plan->count;
        const int32_t rest = offset(slot, reference) % count;
        k = reference->index + (uint32_t)(rest < 0 ? rest + count : rest);
        k = k < plan->count ? k : k - plan->count;
    }
    if (k >= plan->count) {
        return NULL;
    }
    return &plan->samples[k];
}
