/* A robot among obstacles for the tests of avoidance: one pose, one plan, one step at a time.
 *
 * The rig's numbers are exact in binary (T = 1/8 s), so that a test can put a distance exactly on
 * a radius. omega_max T = 1.5 rad lets one step reach most free edges.
 */
#ifndef BERTH_TESTS_AVOID_RIG_H
#define BERTH_TESTS_AVOID_RIG_H

#include "berth/berth.h"

#include "unity.h"

#include <math.h>
#include <string.h>

#define RIG_PERIOD_US 125000u
#define RIG_PERIOD_S 0.125f
#define RIG_SAMPLES_MAX 64u

typedef struct {
    berth_avoid_t avoid;
    berth_limits_config_t limits;
    berth_obstacles_t obstacles;
    berth_sample_t samples[RIG_SAMPLES_MAX];
    berth_plan_t plan;
    berth_reference_t reference;
    berth_pose_t pose;
    berth_twist_t command; /* of the last step */
    berth_mode_t mode;
} rig_t;

static inline berth_avoid_config_t rig_avoid_config(void) {
    return (berth_avoid_config_t){.skirt_m = 0.125f, .v_creep_mps = 0.0625f};
}

/* One sample, far from everything: the plan asks for no side. */
static inline void rig_init(rig_t *rig, const berth_avoid_config_t *config) {
    berth_refusal_t refusal;
    *rig = (rig_t){
        .limits = {.wheel_radius_m = 0.05f,
                   .track_m = 0.3f,
                   .v_max_mps = 0.8f,
                   .omega_max_radps = 12.0f},
        .samples = {{.x_m = 500.0f, .v_mps = 0.25f}},
    };
    rig->plan = (berth_plan_t){
        .samples = rig->samples, .count = 1, .period_us = RIG_PERIOD_US, .closed = true};
    berth_obstacles_clear(&rig->obstacles);
    TEST_ASSERT_EQUAL_INT(
        BERTH_OK, berth_avoid_init(&rig->avoid, config, &rig->limits, RIG_PERIOD_US, &refusal));
    berth_reference_start(&rig->reference, &rig->plan, 0);
}

static inline void rig_start(rig_t *rig) {
    const berth_avoid_config_t config = rig_avoid_config();
    rig_init(rig, &config);
}

static inline void rig_add(rig_t *rig, float x_m, float y_m, const float radii_m[3]) {
    const berth_obstacle_t obstacle = {x_m, y_m, radii_m[0], radii_m[1], radii_m[2]};
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_obstacles_add(&rig->obstacles, &obstacle));
}

/* Obstacle at a distance from the origin, in a direction in degrees. */
static inline void rig_add_at(rig_t *rig, double distance_m, double direction_deg,
                              const float radii_m[3]) {
    const double direction = direction_deg * 3.14159265358979323846 / 180.0;
    rig_add(rig, (float)(distance_m * cos(direction)), (float)(distance_m * sin(direction)),
            radii_m);
}

static inline void rig_pose(rig_t *rig, float x_m, float y_m, float theta_rad) {
    rig->pose = (berth_pose_t){x_m, y_m, theta_rad};
}

static inline berth_mode_t rig_step(rig_t *rig, float v_mps, float omega_radps) {
    rig->command = (berth_twist_t){v_mps, omega_radps};
    rig->mode = berth_avoid_step(&rig->avoid, &rig->obstacles, &rig->plan, &rig->reference,
                                 &rig->pose, &rig->command);
    return rig->mode;
}

static inline void rig_expect_same_bits(float expected, float actual) {
    uint32_t expected_bits;
    uint32_t actual_bits;
    memcpy(&expected_bits, &expected, sizeof expected_bits);
    memcpy(&actual_bits, &actual, sizeof actual_bits);
    TEST_ASSERT_EQUAL_HEX32(expected_bits, actual_bits);
}

/* The last step passed its command unchanged, to the bit. */
static inline void rig_expect_passed(const rig_t *rig, float v_mps, float omega_radps) {
    TEST_ASSERT_EQUAL_INT(BERTH_MODE_TRACK, rig->mode);
    rig_expect_same_bits(v_mps, rig->command.v_mps);
    rig_expect_same_bits(omega_radps, rig->command.omega_radps);
}

/* Mode, speed to the bit, and the turn of the last step in degrees, within the angles' tolerance.
 */
static inline void rig_expect(const rig_t *rig, berth_mode_t mode, float v_mps, float turn_deg) {
    TEST_ASSERT_EQUAL_STRING(berth_mode_text(mode), berth_mode_text(rig->mode));
    rig_expect_same_bits(v_mps, rig->command.v_mps);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-3f, turn_deg,
                             rig->command.omega_radps * RIG_PERIOD_S * (180.0f / BERTH_PI));
}

#endif
