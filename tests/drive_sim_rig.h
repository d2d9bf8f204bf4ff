/* Shared by the tests of the simulated drives: frames as literal bytes, in and out.
 *
 * The bytes in these tests are worked out by hand from the protocols' documents; nothing here packs
 * or unpacks a number.
 */
#ifndef BERTH_TESTS_DRIVE_SIM_RIG_H
#define BERTH_TESTS_DRIVE_SIM_RIG_H

#include "bus/drive_sim.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define RIG_TWO_PI 6.283185307179586

/* The bytes of a frame, and how many: RIG_BYTES(1, 2, 3). */
#define RIG_BYTES(...)                                                                             \
    (const uint8_t[]){__VA_ARGS__}, (uint8_t)sizeof((const uint8_t[]){__VA_ARGS__})

extern drive_sim_t *rig_sim;
extern int64_t rig_now_us;

void rig_create(const drive_sim_config_t *config); /* at time 0 */
void rig_destroy(void);

/* A data frame to the drive, now. Returns whether it was the drive's. */
bool rig_standard(uint32_t id, const uint8_t *data, uint8_t length);
bool rig_extended(uint32_t id, const uint8_t *data, uint8_t length);
bool rig_remote(uint32_t id, bool extended, uint8_t length);

/* Lets time pass in steps at the drive's deadlines. */
void rig_run(int64_t time_us);

/* The drive's oldest frame must be this one; it is taken. */
void rig_expect_standard(uint32_t id, const uint8_t *data, uint8_t length);
void rig_expect_extended(uint32_t id, const uint8_t *data, uint8_t length);
void rig_expect_nothing(void);
unsigned rig_drop(void); /* takes all that wait; returns how many */

/* Turns the wheel: angle in wheel turns, speed in wheel turns/s. */
void rig_wheel(double turns, double turns_per_s);

void rig_trouble(drive_sim_trouble_t trouble);

/* Frames of random id, length and bytes, most of them near this drive's ids. */
void rig_hostile(uint32_t frames);

#endif
