/* berth/obstacles.h - the fixed-capacity list of obstacles.
 *
 * An obstacle is a disc with three radii, all from its centre to the robot's centre: the hard one,
 * inside which is a collision; the conservative one; and the regulated one (see avoid.h). The list
 * is a plain struct that its owner clears and fills; each slot also holds what avoidance remembers
 * of its obstacle, so that a slot can be copied or dropped as a whole.
 */
#ifndef BERTH_OBSTACLES_H
#define BERTH_OBSTACLES_H

#include "berth/result.h"
#include "berth/types.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Capacity, 1 to 255. It bounds the worst case of a step: each active obstacle costs up to one pass
 * over the active ones when the heading is not free. It is part of the layout of the structs:
 * define it alike for the library and for all that includes this header. Up to 32 obstacles the
 * look-ahead of avoid.h keeps up with the reference. */
#ifndef BERTH_OBSTACLES_MAX
#define BERTH_OBSTACLES_MAX 16u
#endif

#define BERTH_RADIUS_MIN_M 0.001f
#define BERTH_RADIUS_MAX_M 100.0f

typedef struct {
    float x_m;
    float y_m;
    float hard_m;         /* R: obstacle + robot body + uncertainty */
    float conservative_m; /* C > R */
    float regulated_m;    /* G >= C + skirt; equal to it: conservative strategy alone */
} berth_obstacle_t;

/* What avoidance remembers of one obstacle. Private to avoid.c. */
typedef struct {
    uint32_t cursor; /* of the look-ahead, in samples since the start (reference.total): the next
                        sample to look at or, once found, the one beyond the obstacle */
    uint8_t scan;    /* state of the look-ahead */
    int8_t side;     /* side on which it is being passed: +1 left of it, -1 right, 0 open */
} berth_obstacle_memory_t;

/* Expiry of an obstacle that stays. */
#define BERTH_OBSTACLE_FOREVER INT64_MAX

/* Id of an obstacle that stays; those from the bus have 0 to BERTH_OBSTACLE_ID_MAX. */
#define BERTH_OBSTACLE_STATIC 0xffffu
#define BERTH_OBSTACLE_ID_MAX 255u

typedef struct {
    int64_t expires_us; /* BERTH_OBSTACLE_FOREVER: never */
    berth_obstacle_t obstacle;
    berth_obstacle_memory_t memory;
    uint16_t id;
} berth_obstacle_slot_t;

typedef struct {
    int64_t earliest_us; /* no obstacle expires before; may be too early, never too late */
    berth_obstacle_slot_t slots[BERTH_OBSTACLES_MAX];
    uint32_t count;
} berth_obstacles_t;

/* Empties the list. Must come before anything else. */
void berth_obstacles_clear(berth_obstacles_t *obstacles);

/* Validates one obstacle by itself: finite, in range, R <= C <= G. The clearance condition is
 * berth_avoid_check_obstacle's. Returns BERTH_OK, or BERTH_ERROR_CONFIG with *refusal filled
 * (refusal->index is left to the caller). */
BERTH_MUST_USE berth_error_t berth_obstacle_check(const berth_obstacle_t *obstacle,
                                                  berth_refusal_t *refusal);

/* Appends a checked obstacle that stays: it never expires, and no id replaces or removes it.
 * Returns BERTH_OK or BERTH_ERROR_CAPACITY. */
BERTH_MUST_USE berth_error_t berth_obstacles_add(berth_obstacles_t *obstacles,
                                                 const berth_obstacle_t *obstacle);

/* Puts a checked obstacle that expires: under an id that is in the list it takes the place of the
 * old one, else it is appended. What avoidance remembers of it is kept when it has moved by less
 * than its hard radius since it was last put, so that a jittering detection does not make the robot
 * change sides; else the look-ahead and the choice of side start over. id: 0 to
 * BERTH_OBSTACLE_ID_MAX. Returns BERTH_OK, BERTH_ERROR_ARGUMENT (another id) or
 * BERTH_ERROR_CAPACITY; after an error nothing has changed. O(count). */
BERTH_MUST_USE berth_error_t berth_obstacles_put(berth_obstacles_t *obstacles, uint16_t id,
                                                 const berth_obstacle_t *obstacle,
                                                 int64_t expires_us);

/* Removes the obstacle with this id, if there is one. The others keep their order, here and in
 * expire. O(count). */
void berth_obstacles_remove(berth_obstacles_t *obstacles, uint16_t id);

/* Removes those that expire at now_us or before. Returns how many. O(count); one comparison when
 * now_us is before earliest_us. */
uint32_t berth_obstacles_expire(berth_obstacles_t *obstacles, int64_t now_us);

#ifdef __cplusplus
}
#endif

#endif
