/* stand_in.h - stands in for the CAN bus of a robot where there is none: two ODrives with their
 * wheels, and the robot that these move, behind Berth's contract for a bus.
 *
 *     stand_in_open(&robot, clock, &start);
 *     berth_can_t can = stand_in_can(&robot);
 *     each time round the main loop: wait no longer than until stand_in_due(&robot)
 *
 * Each drive sends its encoder estimates and its heartbeat each STAND_IN_PERIOD_US, obeys in closed
 * loop at once, and goes idle by its own watchdog when no speed command has come for
 * STAND_IN_WATCHDOG_US. All frames are taken; those that no drive understands change nothing.
 *
 * One context. Constant cost a call.
 */
#ifndef BERTH_BOARDS_STAND_IN_H
#define BERTH_BOARDS_STAND_IN_H

#include "berth/types.h"
#include "berth_hal/can.h"
#include "berth_hal/clock.h"

#include <stdbool.h>
#include <stdint.h>

#define STAND_IN_PERIOD_US 10000
#define STAND_IN_WATCHDOG_US 150000

#define STAND_IN_LEFT_NODE 1u
#define STAND_IN_RIGHT_NODE 2u
#define STAND_IN_WHEEL_RADIUS_M 0.05f
#define STAND_IN_TRACK_M 0.30f

typedef struct {
    float asked_rps; /* turns a second */
    float rps;
    float turns;
    bool closed_loop;
    int64_t fed_us; /* when the watchdog was fed last */
} stand_in_wheel_t;

typedef struct {
    berth_clock_t clock;
    stand_in_wheel_t wheels[2]; /* left, right */
    berth_pose_t pose;          /* where the robot is */
    int64_t next_us;            /* when the drives send next */
    uint32_t waiting;           /* one bit for each frame that has not been received */
    uint32_t bites;             /* of the drives' watchdogs */
} stand_in_t;

void stand_in_open(stand_in_t *robot, berth_clock_t clock, const berth_pose_t *start);
berth_can_t stand_in_can(stand_in_t *robot);

/* When there will be something to receive. */
int64_t stand_in_due(const stand_in_t *robot);

#endif
