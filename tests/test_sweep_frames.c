/* Each frame on the wire in turn is lost, late, doubled, corrupted or altered: see sweep_rig.h for
 * what must come of it.
 */
#include "sweep_rig.h"

#include "support.h"

#include "unity.h"

#include <stdio.h>

static sweep_outcome_t out;

void setUp(void) {}

void tearDown(void) {}

/* A frame that tells an old state of a drive, or sets it to one, ends in one of these. */
#define STATE                                                                                      \
    (SWEEP_DRIVE(BERTH_DRIVE_FAULT_DEVICE) | SWEEP_DRIVE(BERTH_DRIVE_FAULT_DISABLED) |             \
     SWEEP_DRIVE(BERTH_DRIVE_FAULT_EMERGENCY) | SWEEP_DRIVE(BERTH_DRIVE_FAULT_FEEDBACK) |          \
     SWEEP_DRIVE(BERTH_DRIVE_FAULT_HEARTBEAT))

/* And in one of these, while a drive is set up. */
#define SETUP                                                                                      \
    (SWEEP_DRIVE(BERTH_DRIVE_FAULT_SETUP) | SWEEP_DRIVE(BERTH_DRIVE_FAULT_SETUP_SILENT) |          \
     SWEEP_DRIVE(BERTH_DRIVE_FAULT_ENABLE))

static void sweep_frames(const sweep_case_t *usual, const char *title) {
    support_random_start();
    const uint32_t stride = 100 / support_runs(100);
    for (int kind = 0; kind < SWEEP_KINDS; kind++) {
        const uint64_t frames = sweep_plain((drive_sim_kind_t)kind)->frames;
        for (uint64_t i = support_index(stride); i < frames; i += stride) {
            char name[80];
            sweep_case_t what = *usual;
            what.kind = (drive_sim_kind_t)kind;
            what.has_frame = true;
            what.frame = i;
            what.seed = support_index(UINT32_MAX);
            snprintf(name, sizeof name, "%s, frame %u, seed %u", title, (unsigned)i,
                     (unsigned)what.seed);
            sweep_run(&what, name, &out);
        }
    }
    sweep_report(title);
}

static void sweep_action(can_loop_action_t action, uint64_t reasons, const char *title) {
    sweep_case_t what = sweep_case(DRIVE_SIM_ODRIVE);
    what.may_misread = action.delay_us > SWEEP_PERIOD_US; /* an old status */
    what.action = action;
    what.rms_m = 0.03; /* 15 to 25 % of the undisturbed run's */
    what.peak_m = 0.1;
    what.may_stop = reasons != 0;
    what.reasons = reasons;
    sweep_frames(&what, title);
}

static void test_lost(void) {
    sweep_action((can_loop_action_t){.deaf = CAN_LOOP_EVERYBODY}, 0, "frame lost");
    sweep_action((can_loop_action_t){.deaf = 1u << SESSION_NODE_BOARD}, 0,
                 "frame lost on the board");
}

static void test_doubled(void) {
    sweep_action((can_loop_action_t){.copies = 1}, 0, "frame doubled");
}

static void test_corrupted(void) {
    sweep_action((can_loop_action_t){.corrupt = true}, 0, "frame corrupted, sent again");
}

static void test_late(void) {
    sweep_action((can_loop_action_t){.delay_us = 3000}, 0, "frame 3 ms late");
    sweep_action((can_loop_action_t){.delay_us = 30000}, STATE | SETUP, "frame 30 ms late");
    sweep_action((can_loop_action_t){.delay_us = 300000}, STATE | SETUP, "frame 300 ms late");
    sweep_action((can_loop_action_t){.delay_us = 300000, .stamp_on_wire = true}, STATE | SETUP,
                 "frame 300 ms late and stamped so");
}

static void test_altered(void) {
    sweep_case_t what = sweep_case(DRIVE_SIM_ODRIVE);
    what.flip = true;
    what.may_stop = true;
    what.may_misread = true;
    what.may_run_out = true;
    what.reasons = STATE | SETUP | SWEEP_REASON(BERTH_FAULT_POSE_UNKNOWN);
    what.rms_m = 0.03;
    what.peak_m = 0.1;
    sweep_frames(&what, "frame altered");
}

int main(void) {
    UNITY_BEGIN();
    sweep_begin(2.0);
    RUN_TEST(test_lost);
    RUN_TEST(test_doubled);
    RUN_TEST(test_corrupted);
    RUN_TEST(test_late);
    RUN_TEST(test_altered);
    sweep_end();
    return UNITY_END();
}
