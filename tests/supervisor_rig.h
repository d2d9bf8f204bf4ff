/* A supervisor that stands ready, for its tests. */
#ifndef BERTH_TESTS_SUPERVISOR_RIG_H
#define BERTH_TESTS_SUPERVISOR_RIG_H

#include "berth/supervisor.h"

#include "unity.h"

static berth_supervisor_t supervisor;
static berth_supervisor_config_t config;
static berth_supervisor_inputs_t inputs;
static berth_refusal_t refusal;

static inline void init(void) {
    TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_supervisor_init(&supervisor, &config, &refusal));
}

void setUp(void) {
    config = (berth_supervisor_config_t){
        .fix_timeout_us = 300000,
        .period_late_us = 150000,
        .transmit_timeout_us = 100000,
        .arm_timeout_us = 1000000,
        .stop_timeout_us = 500000,
        .standing_radps = 0.2f,
        .following_radps = 2.0f,
        .following_us = 200000,
    };
    inputs = (berth_supervisor_inputs_t){
        .drives_enabled = true, .standing = true, .pose_known = true, .fix_age_us = 0};
    init();
}

void tearDown(void) {}

static inline void command(berth_command_code_t code, int64_t now_us) {
    berth_supervisor_command(&supervisor, code, true, now_us);
}

#endif
