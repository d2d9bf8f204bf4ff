#include "berth/obstacles.h"

#include "check.h"

void berth_obstacles_clear(berth_obstacles_t *obstacles) {
    obstacles->count = 0;
    obstacles->earliest_us = BERTH_OBSTACLE_FOREVER;
}

berth_error_t berth_obstacle_check(const berth_obstacle_t *obstacle, berth_refusal_t *refusal) {
    static const check_rule_t rules[] = {
        {BERTH_FIELD_OBSTACLE_X, false, CHECK_AT(berth_obstacle_t, x_m), -BERTH_POSITION_MAX_M,
         BERTH_POSITION_MAX_M},
        {BERTH_FIELD_OBSTACLE_Y, false, CHECK_AT(berth_obstacle_t, y_m), -BERTH_POSITION_MAX_M,
         BERTH_POSITION_MAX_M},
        {BERTH_FIELD_OBSTACLE_HARD, false, CHECK_AT(berth_obstacle_t, hard_m), BERTH_RADIUS_MIN_M,
         BERTH_RADIUS_MAX_M},
    };
    const bool good = check_rules(obstacle, rules, CHECK_COUNT(rules), refusal) &&
                      check_value(BERTH_FIELD_OBSTACLE_CONSERVATIVE, obstacle->conservative_m,
                                  obstacle->hard_m, BERTH_RADIUS_MAX_M, refusal) &&
                      check_value(BERTH_FIELD_OBSTACLE_REGULATED, obstacle->regulated_m,
                                  obstacle->conservative_m, BERTH_RADIUS_MAX_M, refusal);
    return good ? BERTH_OK : BERTH_ERROR_CONFIG;
}

/* Memory of all zeros is what avoidance takes for an obstacle that it has not seen yet. */
static berth_error_t append(berth_obstacles_t *obstacles, const berth_obstacle_t *obstacle,
                            uint16_t id, int64_t expires_us) {
    if (obstacles->count >= BERTH_OBSTACLES_MAX) {
        return BERTH_ERROR_CAPACITY;
    }
    obstacles->slots[obstacles->count] =
        (berth_obstacle_slot_t){.expires_us = expires_us, .obstacle = *obstacle, .id = id};
    obstacles->count++;
    return BERTH_OK;
}

berth_error_t berth_obstacles_add(berth_obstacles_t *obstacles, const berth_obstacle_t *obstacle) {
    return append(obstacles, obstacle, BERTH_OBSTACLE_STATIC, BERTH_OBSTACLE_FOREVER);
}

/* Place of the obstacle with this id; count when there is none. */
static uint32_t find(const berth_obstacles_t *obstacles, uint16_t id) {
    uint32_t place = 0;
    while (place < obstacles->count && obstacles->slots[place].id != id) {
        place++;
    }
    return place;
}

static bool moved(const berth_obstacle_t *from, const berth_obstacle_t *to) {
    const float dx = to->x_m - from->x_m;
    const float dy = to->y_m - from->y_m;
    return dx * dx + dy * dy >= to->hard_m * to->hard_m;
}

berth_error_t berth_obstacles_put(berth_obstacles_t *obstacles, uint16_t id,
                                  const berth_obstacle_t *obstacle, int64_t expires_us) {
    if (id > BERTH_OBSTACLE_ID_MAX) {
        return BERTH_ERROR_ARGUMENT;
    }
    const uint32_t place = find(obstacles, id);
    if (place < obstacles->count) {
        berth_obstacle_slot_t *slot = &obstacles->slots[place];
        if (moved(&slot->obstacle, obstacle)) {
            slot->memory = (berth_obstacle_memory_t){0};
        }
        slot->obstacle = *obstacle;
        slot->expires_us = expires_us;
    } else {
        const berth_error_t error = append(obstacles, obstacle, id, expires_us);
        if (error != BERTH_OK) {
            return error;
        }
    }
    if (expires_us < obstacles->earliest_us) {
        obstacles->earliest_us = expires_us;
    }
    return BERTH_OK;
}

/* Shifts the rest down. Avoidance numbers slots only to take them in turn, so no more than a turn
 * is missed. */
void berth_obstacles_remove(berth_obstacles_t *obstacles, uint16_t id) {
    if (id > BERTH_OBSTACLE_ID_MAX) {
        return;
    }
    const uint32_t place = find(obstacles, id);
    if (place >= obstacles->count) {
        return;
    }
    obstacles->count--;
    for (uint32_t i = place; i < obstacles->count; i++) {
        obstacles->slots[i] = obstacles->slots[i + 1u];
    }
}

uint32_t berth_obstacles_expire(berth_obstacles_t *obstacles, int64_t now_us) {
    if (now_us < obstacles->earliest_us) {
        return 0;
    }
    uint32_t kept = 0;
    int64_t earliest_us = BERTH_OBSTACLE_FOREVER;
    for (uint32_t i = 0; i < obstacles->count; i++) {
        const int64_t expires_us = obstacles->slots[i].expires_us;
        if (expires_us != BERTH_OBSTACLE_FOREVER && expires_us <= now_us) {
            continue;
        }
        if (kept != i) {
            obstacles->slots[kept] = obstacles->slots[i];
        }
        kept++;
        earliest_us = expires_us < earliest_us ? expires_us : earliest_us;
    }
    const uint32_t expired = obstacles->count - kept;
    obstacles->count = kept;
    obstacles->earliest_us = earliest_us;
    return expired;
}
