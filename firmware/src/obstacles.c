#include "berth/obstacles.h"

#include "check.h"

void berth_obstacles_clear(berth_obstacles_t *obstacles) {
    obstacles->count = 0;
}

berth_error_t berth_obstacle_check(const berth_obstacle_t *obstacle, berth_refusal_t *refusal) {
    static const check_rule_t rules[] = {
        {BERTH_FIELD_OBSTACLE_X, false, offsetof(berth_obstacle_t, x_m), -BERTH_POSITION_MAX_M,
         BERTH_POSITION_MAX_M},
        {BERTH_FIELD_OBSTACLE_Y, false, offsetof(berth_obstacle_t, y_m), -BERTH_POSITION_MAX_M,
         BERTH_POSITION_MAX_M},
        {BERTH_FIELD_OBSTACLE_HARD, false, offsetof(berth_obstacle_t, hard_m), BERTH_RADIUS_MIN_M,
         BERTH_RADIUS_MAX_M},
    };
    const bool good = check_rules(obstacle, rules, CHECK_COUNT(rules), refusal) &&
                      check_value(BERTH_FIELD_OBSTACLE_CONSERVATIVE, obstacle->conservative_m,
                                  obstacle->hard_m, BERTH_RADIUS_MAX_M, refusal) &&
                      check_value(BERTH_FIELD_OBSTACLE_REGULATED, obstacle->regulated_m,
                                  obstacle->conservative_m, BERTH_RADIUS_MAX_M, refusal);
    return good ? BERTH_OK : BERTH_ERROR_CONFIG;
}

berth_error_t berth_obstacles_add(berth_obstacles_t *obstacles, const berth_obstacle_t *obstacle) {
    if (obstacles->count >= BERTH_OBSTACLES_MAX) {
        return BERTH_ERROR_CAPACITY;
    }
    obstacles->slots[obstacles->count] = (berth_obstacle_slot_t){
        .expires_us = BERTH_OBSTACLE_FOREVER, .obstacle = *obstacle, .id = BERTH_OBSTACLE_STATIC};
    obstacles->count++;
    return BERTH_OK;
}
