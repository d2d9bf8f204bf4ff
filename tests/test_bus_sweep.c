/* One thing goes wrong, at every moment of a session: each call of the board's bus in each way that
 * its contract allows, each frame lost, late, doubled or broken. In every case the robot does its
 * run or stops with the right reason, touches nothing, and no command stays in force for longer
 * than the drives' watchdogs let it.
 *
 * The run is short and begins in front of an obstacle, so that a board that went astray would hit.
 */
#include "can_fault.h"
#include "session.h"
#include "support.h"

#include "unity.h"

#include <math.h>
#include <stdio.h>

#define CALLS_MAX 2000u
#define RUN_S 4.0

/* The wheels stand so long after the board's fault at the latest: where it can still say so, and
 * where only the drives' own watchdogs know (cia402: heartbeat_timeout_us, a period of theirs and
 * the time to stop). */
#define STAND_TOLD_US 100000
#define STAND_UNTOLD_US 620000

static const drive_sim_kind_t kinds[] = {DRIVE_SIM_ODRIVE, DRIVE_SIM_VESC, DRIVE_SIM_CIA402};

static scenario_t scenario;
static run_plan_t plan;
static bus_setup_t setup;
static session_result_t result;

/* What goes wrong in this session. */
static bool by_call; /* else by frame */
static can_fault_order_t order;
static can_fault_t fault;
static uint64_t frame_number;
static can_loop_action_t action;

/* When the board found out, and when the robot came to stand for good. */
static int64_t fault_us, standing_us;

void setUp(void) {
    scenario_error_t error;
    TEST_ASSERT_TRUE(scenario_builtin("circle", &scenario));
    scenario.duration_s = RUN_S;
    scenario.start.x_m = 0.35;
    scenario.start.y_m = 1.05;
    scenario.start.theta_rad = -3.0;
    TEST_ASSERT_TRUE(run_plan_make(&scenario, &plan, &error));
}

void tearDown(void) {
    run_plan_free(&plan);
}

/* All of them, or one in so many that it takes a tenth of the time. */
static uint64_t stride(void) {
    return support_runs(10) == 10 ? 1 : 97;
}

static can_loop_action_t on_start(void *context, uint64_t index, uint32_t node,
                                  const berth_can_frame_t *frame) {
    (void)context;
    (void)node;
    (void)frame;
    return index == frame_number ? action : (can_loop_action_t){.deaf = 0};
}

static void prepare(void *context, session_parts_t *parts) {
    (void)context;
    fault_us = standing_us = -1;
    if (by_call) {
        parts->can = can_fault_init(&fault, &parts->can);
        TEST_ASSERT_TRUE(can_fault_order(&fault, &order));
    } else {
        can_loop_fault(&parts->loop, on_start, NULL);
    }
}

static void on_instant(void *context, session_parts_t *parts, int64_t now_us) {
    (void)context;
    if (fault_us < 0 && berth_board_status(&parts->board)->state == BERTH_SUPERVISOR_FAULT) {
        fault_us = now_us;
    }
    if (bus_robot_result(parts->robot)->speed_mps != 0.0) {
        standing_us = -1;
    } else if (standing_us < 0) {
        standing_us = now_us;
    }
}

static void run(drive_sim_kind_t kind) {
    scenario_error_t error;
    bus_setup_init(&setup, false);
    setup.drive = kind;
    TEST_ASSERT_TRUE(bus_setup_finish(&setup, &error));
    const session_config_t config = {.scenario = &scenario,
                                     .plan = &plan,
                                     .seed = 1,
                                     .setup = &setup,
                                     .prepare = prepare,
                                     .instant = on_instant};
    TEST_ASSERT_TRUE_MESSAGE(session_run(&config, &result, &error), error.text);
}

/* How a session may end. */
typedef struct {
    bool fault_allowed;
    uint8_t faults[4]; /* the right reasons; all zero: any */
    int64_t stand_us;
} verdict_t;

static bool right_reason(const verdict_t *verdict, uint8_t found) {
    bool any = true;
    for (int i = 0; i < 4; i++) {
        any = any && verdict->faults[i] == 0;
        if (verdict->faults[i] != 0 && verdict->faults[i] == found) {
            return true;
        }
    }
    return any && found != BERTH_FAULT_NONE;
}

static void judge(const verdict_t *verdict, const char *what) {
    char text[200];
    snprintf(text, sizeof text, "%s: ended %s, run %s, fault %u, clearance %.4f m", what,
             session_end_text(result.end), bus_robot_phase_text(result.robot.phase),
             (unsigned)result.board.fault, result.robot.clearance_m);
    TEST_ASSERT_TRUE_MESSAGE(result.robot.clearance_m >= 0.0, text);
    TEST_ASSERT_EQUAL_INT_MESSAGE(0, result.robot.summary.collisions, text);
    TEST_ASSERT_EQUAL_DOUBLE_MESSAGE(0.0, result.robot.speed_mps, text);
    if (result.end == SESSION_FAULT) {
        TEST_ASSERT_TRUE_MESSAGE(verdict->fault_allowed, text);
        TEST_ASSERT_TRUE_MESSAGE(right_reason(verdict, result.board.fault), text);
        TEST_ASSERT_TRUE_MESSAGE(standing_us - fault_us <= verdict->stand_us, text);
    } else {
        TEST_ASSERT_TRUE_MESSAGE(session_good(&result), text);
    }
}

/* --- calls ------------------------------------------------------------------------------- */

typedef struct {
    const char *name;
    can_fault_order_t order;
    verdict_t verdict;
} way_t;

static const way_t ways[] = {
    {"send has no room", {CAN_FAULT_SEND, 0, 1, BERTH_CAN_AGAIN, 0}, {.fault_allowed = false}},
    {"send fails",
     {CAN_FAULT_SEND, 0, 1, BERTH_CAN_FAILED, 0},
     {true, {BERTH_FAULT_BUS_DOWN}, STAND_TOLD_US}},
    {"nothing received", {CAN_FAULT_RECEIVE, 0, 1, BERTH_CAN_AGAIN, 0}, {.fault_allowed = false}},
    {"receive fails",
     {CAN_FAULT_RECEIVE, 0, 1, BERTH_CAN_FAILED, 0},
     {true, {BERTH_FAULT_BUS_DOWN}, STAND_TOLD_US}},
    {"error passive",
     {CAN_FAULT_STATE, 0, 1, BERTH_CAN_AGAIN, BERTH_CAN_ERROR_PASSIVE},
     {.fault_allowed = false}},
    {"bus-off",
     {CAN_FAULT_STATE, 0, 1, BERTH_CAN_AGAIN, BERTH_CAN_BUS_OFF},
     {true, {BERTH_FAULT_BUS_OFF}, STAND_TOLD_US}},
    {"down",
     {CAN_FAULT_STATE, 0, 1, BERTH_CAN_AGAIN, BERTH_CAN_DOWN},
     {true, {BERTH_FAULT_BUS_DOWN}, STAND_TOLD_US}},
    {"no room any more",
     {CAN_FAULT_SEND, 0, CAN_FAULT_FOREVER, BERTH_CAN_AGAIN, 0},
     {true, {BERTH_FAULT_TRANSMIT}, STAND_UNTOLD_US}},
    {"send fails for good",
     {CAN_FAULT_SEND, 0, CAN_FAULT_FOREVER, BERTH_CAN_FAILED, 0},
     {true, {BERTH_FAULT_BUS_DOWN}, STAND_UNTOLD_US}},
    {"nothing received any more",
     {CAN_FAULT_RECEIVE, 0, CAN_FAULT_FOREVER, BERTH_CAN_AGAIN, 0},
     {true, {0}, STAND_TOLD_US}},
    {"receive fails for good",
     {CAN_FAULT_RECEIVE, 0, CAN_FAULT_FOREVER, BERTH_CAN_FAILED, 0},
     {true, {BERTH_FAULT_BUS_DOWN}, STAND_UNTOLD_US}},
};

static void sweep_calls(drive_sim_kind_t kind) {
    by_call = true;
    for (size_t way = 0; way < sizeof ways / sizeof ways[0]; way++) {
        unsigned long stopped = 0;
        for (uint64_t k = way % stride(); k < CALLS_MAX; k += stride()) {
            char what[96];
            order = ways[way].order;
            order.first = k;
            run(kind);
            snprintf(what, sizeof what, "%s, %s at call %u", bus_setup_drive_name(kind),
                     ways[way].name, (unsigned)k);
            judge(&ways[way].verdict, what);
            stopped += result.end == SESSION_FAULT ? 1 : 0;
            if (can_fault_answered(&fault) == 0) {
                break; /* there is no k-th call in this session, so none after it */
            }
        }
        /* what may stop it does, somewhere: the calls were met */
        TEST_ASSERT_EQUAL_MESSAGE(ways[way].verdict.fault_allowed, stopped > 0, ways[way].name);
    }
}

static void test_every_call_fails_odrive(void) {
    sweep_calls(DRIVE_SIM_ODRIVE);
}

static void test_every_call_fails_vesc(void) {
    sweep_calls(DRIVE_SIM_VESC);
}

static void test_every_call_fails_cia402(void) {
    sweep_calls(DRIVE_SIM_CIA402);
}

/* --- frames ------------------------------------------------------------------------------ */

static const struct {
    const char *name;
    can_loop_action_t action;
} accidents[] = {
    {"lost", {.deaf = CAN_LOOP_EVERYBODY}},
    {"lost to the board", {.deaf = 1u << SESSION_NODE_BOARD}},
    {"20 ms late", {.delay_us = 20000}},
    {"200 ms late", {.delay_us = 200000, .stamp_on_wire = true}},
    {"doubled", {.copies = 1}},
    {"broken", {.corrupt = true}},
};

static void test_every_frame_has_an_accident(void) {
    static const verdict_t verdict = {true, {0}, STAND_TOLD_US};
    by_call = false;
    for (size_t k = 0; k < 3; k++) {
        for (size_t a = 0; a < sizeof accidents / sizeof accidents[0]; a++) {
            frame_number = UINT64_MAX;
            run(kinds[k]);
            const uint64_t frames = result.frames;
            TEST_ASSERT_GREATER_THAN_UINT64(1000, frames);
            action = accidents[a].action;
            for (uint64_t number = a % stride(); number < frames; number += stride()) {
                char what[96];
                frame_number = number;
                run(kinds[k]);
                snprintf(what, sizeof what, "%s, frame %u %s", bus_setup_drive_name(kinds[k]),
                         (unsigned)number, accidents[a].name);
                judge(&verdict, what);
            }
        }
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_every_call_fails_odrive);
    RUN_TEST(test_every_call_fails_vesc);
    RUN_TEST(test_every_call_fails_cia402);
    RUN_TEST(test_every_frame_has_an_accident);
    return UNITY_END();
}
