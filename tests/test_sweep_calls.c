/* The k-th call that the board makes of its bus fails, in each way that the HAL's contract allows,
 * alone and as the first of a burst: see sweep_rig.h for what must come of it.
 */
#include "sweep_rig.h"

#include "support.h"

#include "unity.h"

#include <stdio.h>

#define CALLS 2000u
#define BURST_STEP 5u

/* A way to fail, and the reasons that are right for it once it lasts. */
typedef struct {
    const char *name;
    uint32_t calls;
    berth_can_outcome_t outcome;
    berth_can_mode_t mode;
    bool fatal;    /* one call alone stops every board that is not idle */
    bool harmless; /* and this, however long it lasts, none */
    uint64_t reasons;
} way_t;

/* What comes of a bus on which nothing is heard, or on which the drives hear nothing. */
#define DEAF                                                                                       \
    (SWEEP_DRIVE(BERTH_DRIVE_FAULT_FEEDBACK) | SWEEP_DRIVE(BERTH_DRIVE_FAULT_HEARTBEAT) |          \
     SWEEP_DRIVE(BERTH_DRIVE_FAULT_ENABLE) | SWEEP_DRIVE(BERTH_DRIVE_FAULT_SETUP_SILENT) |         \
     SWEEP_REASON(BERTH_FAULT_ARM_TIMEOUT))

static const way_t ways[] = {
    {"send again", CAN_FAULT_SEND, BERTH_CAN_AGAIN, BERTH_CAN_ERROR_ACTIVE, false, false,
     SWEEP_REASON(BERTH_FAULT_TRANSMIT)},
    {"send failed", CAN_FAULT_SEND, BERTH_CAN_FAILED, BERTH_CAN_ERROR_ACTIVE, true, false,
     SWEEP_REASON(BERTH_FAULT_BUS_DOWN)},
    {"receive again", CAN_FAULT_RECEIVE, BERTH_CAN_AGAIN, BERTH_CAN_ERROR_ACTIVE, false, false,
     DEAF},
    {"receive failed", CAN_FAULT_RECEIVE, BERTH_CAN_FAILED, BERTH_CAN_ERROR_ACTIVE, true, false,
     SWEEP_REASON(BERTH_FAULT_BUS_DOWN)},
    {"error passive", CAN_FAULT_STATE, BERTH_CAN_AGAIN, BERTH_CAN_ERROR_PASSIVE, false, true, 0},
    {"bus-off", CAN_FAULT_STATE, BERTH_CAN_AGAIN, BERTH_CAN_BUS_OFF, true, false,
     SWEEP_REASON(BERTH_FAULT_BUS_OFF)},
    {"down", CAN_FAULT_STATE, BERTH_CAN_AGAIN, BERTH_CAN_DOWN, true, false,
     SWEEP_REASON(BERTH_FAULT_BUS_DOWN)},
    {"all failed", CAN_FAULT_ANY, BERTH_CAN_FAILED, BERTH_CAN_DOWN, true, false,
     SWEEP_REASON(BERTH_FAULT_BUS_DOWN)},
    {"all again", CAN_FAULT_ANY, BERTH_CAN_AGAIN, BERTH_CAN_ERROR_PASSIVE, false, false,
     DEAF | SWEEP_REASON(BERTH_FAULT_TRANSMIT)},
};
#define WAYS (sizeof ways / sizeof ways[0])

static sweep_outcome_t out;

void setUp(void) {}

void tearDown(void) {}

static bool idle(sweep_call_t call) {
    return call.state == BERTH_SUPERVISOR_IDLE;
}

static void fail_at(drive_sim_kind_t kind, uint64_t k, const way_t *way, uint64_t count) {
    char name[80];
    const sweep_call_t call = sweep_call(kind, k);
    sweep_case_t what = sweep_case(kind);
    what.call = (can_fault_order_t){way->calls, way->calls == CAN_FAULT_ANY ? k : call.before,
                                    count, way->outcome, way->mode};
    what.reasons = way->reasons;
    /* retries come each half millisecond: less than this changes no control step */
    what.may_stop = !way->harmless && (way->fatal || count > 10);
    what.may_carry_on = !way->fatal || idle(call);
    what.stop_us += count > 10 ? SWEEP_WATCHDOG_US : 0; /* nobody can tell the drives */
    snprintf(name, sizeof name, "%s, call %u for %u", way->name, (unsigned)k, (unsigned)count);
    sweep_run(&what, name, &out);
}

/* Each k in turn; every tenth, from a random one on, in a short run. */
static void sweep_calls(uint64_t count, uint32_t step, const char *title) {
    support_random_start();
    const uint32_t stride = step * (CALLS / support_runs(CALLS));
    for (size_t kind = 0; kind < SWEEP_KINDS; kind++) {
        for (uint32_t k = support_index(stride); k < CALLS; k += stride) {
            for (size_t w = 0; w < WAYS; w++) {
                const bool all = ways[w].calls == CAN_FAULT_ANY && count > 1;
                if (all || sweep_call((drive_sim_kind_t)kind, k).kind == ways[w].calls) {
                    fail_at((drive_sim_kind_t)kind, k, &ways[w], count);
                }
            }
        }
    }
    sweep_report(title);
}

static void test_each_call_fails_once(void) {
    sweep_calls(1, 1, "one call fails");
}

static void test_ten_calls_fail(void) {
    sweep_calls(10, BURST_STEP, "ten calls fail");
}

static void test_two_hundred_calls_fail(void) {
    sweep_calls(200, BURST_STEP, "two hundred calls fail");
}

static void test_calls_fail_for_ever(void) {
    sweep_calls(CAN_FAULT_FOREVER, BURST_STEP, "all calls fail from one on");
}

int main(void) {
    UNITY_BEGIN();
    sweep_begin(3.0);
    RUN_TEST(test_each_call_fails_once);
    RUN_TEST(test_ten_calls_fail);
    RUN_TEST(test_two_hundred_calls_fail);
    RUN_TEST(test_calls_fail_for_ever);
    sweep_end();
    return UNITY_END();
}
