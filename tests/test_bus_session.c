/* The firmware and the simulated robot on one virtual bus: the experiments must come out as in the
 * plain run, and whatever goes wrong must end with a standing robot and the right reason.
 */
#include "can_fault.h"
#include "session.h"
#include "support.h"

#include "unity.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

static scenario_t scenario;
static run_plan_t plan;
static bus_setup_t setup;
static session_config_t config;
static session_result_t result;
static scenario_error_t error;

void setUp(void) {
    plan = (run_plan_t){.samples = NULL};
    bus_setup_init(&setup, false);
    TEST_ASSERT_TRUE(bus_setup_finish(&setup, &error));
    config = (session_config_t){.scenario = &scenario, .plan = &plan, .seed = 1, .setup = &setup};
}

void tearDown(void) {
    run_plan_free(&plan);
}

static void experiment(const char *name) {
    run_plan_free(&plan);
    TEST_ASSERT_TRUE(scenario_builtin(name, &scenario));
}

static void strategy(const char *name) {
    snprintf(scenario.avoidance.strategy, sizeof scenario.avoidance.strategy, "%s", name);
}

static void make_plan(void) {
    run_plan_free(&plan);
    TEST_ASSERT_TRUE_MESSAGE(run_plan_make(&scenario, &plan, &error), error.text);
}

static void run(void) {
    make_plan();
    TEST_ASSERT_TRUE_MESSAGE(session_run(&config, &result, &error), error.text);
}

static run_summary_t plain(void) {
    run_summary_t summary;
    make_plan();
    TEST_ASSERT_TRUE(run_scenario(&scenario, &plan, config.seed, NULL, &summary, &error));
    return summary;
}

/* What must hold of every run in which nothing goes wrong. */
static void check_good(const char *what) {
    TEST_ASSERT_EQUAL_STRING_MESSAGE("idle", session_end_text(result.end), what);
    TEST_ASSERT_EQUAL_STRING_MESSAGE("done", bus_robot_phase_text(result.robot.phase), what);
    TEST_ASSERT_TRUE_MESSAGE(session_good(&result), what);
    TEST_ASSERT_EQUAL_INT_MESSAGE(0, result.robot.summary.collisions, what);
    TEST_ASSERT_EQUAL_UINT_MESSAGE(0, session_dropped(&result), what);
    TEST_ASSERT_EQUAL_UINT32_MESSAGE(0, result.board.late, what);
    TEST_ASSERT_EQUAL_UINT32_MESSAGE(0, result.board.missed, what);
    TEST_ASSERT_EQUAL_UINT32_MESSAGE(0, result.board.malformed, what);
    TEST_ASSERT_EQUAL_UINT32_MESSAGE(0, result.board.foreign, what);
    TEST_ASSERT_EQUAL_UINT32_MESSAGE(0, result.board.commands_refused, what);
    TEST_ASSERT_EQUAL_UINT_MESSAGE(0, result.robot.malformed, what);
    TEST_ASSERT_EQUAL_UINT8_MESSAGE(BERTH_FAULT_NONE, result.board.fault, what);
    TEST_ASSERT_EQUAL_UINT8_MESSAGE(BERTH_SUPERVISOR_IDLE, result.robot.state, what);
    for (int side = 0; side < 2; side++) {
        TEST_ASSERT_EQUAL_UINT_MESSAGE(0, result.robot.drives[side].watchdog_stops, what);
        TEST_ASSERT_EQUAL_UINT_MESSAGE(0, result.robot.drives[side].malformed, what);
        TEST_ASSERT_EQUAL_UINT32_MESSAGE(0, result.drives[side].malformed, what);
        TEST_ASSERT_EQUAL_UINT32_MESSAGE(0, result.drives[side].saturated, what);
    }
    const long periods = lround(scenario.duration_s / scenario.period_s);
    TEST_ASSERT_EQUAL_INT_MESSAGE(periods, result.robot.summary.steps, what);
    /* idle means: last heard below the supervisor's standing_radps; from there wheels with lag run
     * out, or what little was commanded before the stop still has its way */
    TEST_ASSERT_TRUE_MESSAGE(fabs(result.robot.speed_mps) < 0.05, what);
}

static void check_like_plain(const char *what) {
    const run_summary_t alone = plain();
    run();
    check_good(what);
    const double ratio = result.robot.summary.rms_position_error_m / alone.rms_position_error_m;
    char text[160];
    snprintf(text, sizeof text, "%s: RMS error %.4f m on the bus, %.4f m without", what,
             result.robot.summary.rms_position_error_m, alone.rms_position_error_m);
    TEST_ASSERT_TRUE_MESSAGE(ratio > 0.8 && ratio < 1.2, text);
}

static const drive_sim_kind_t kinds[] = {DRIVE_SIM_ODRIVE, DRIVE_SIM_VESC, DRIVE_SIM_CIA402};
static const char *const experiments[] = {"circle", "eight"};

static void choose(drive_sim_kind_t kind) {
    bus_setup_init(&setup, false);
    setup.drive = kind;
    TEST_ASSERT_TRUE_MESSAGE(bus_setup_finish(&setup, &error), error.text);
}

/* --- the experiments --------------------------------------------------------------------- */

static void test_experiments_come_out_as_without_the_bus(void) {
    for (size_t e = 0; e < 2; e++) {
        for (size_t k = 0; k < 3; k++) {
            static const char *const names[] = {"combined", "conservative"};
            for (size_t s = 0; s < 2; s++) {
                char what[64];
                experiment(experiments[e]);
                strategy(names[s]);
                choose(kinds[k]);
                snprintf(what, sizeof what, "%s, %s, %s", experiments[e], names[s],
                         bus_setup_drive_name(kinds[k]));
                check_like_plain(what);
            }
        }
    }
}

static void test_drives_with_lag_and_limits(void) {
    for (size_t e = 0; e < 2; e++) {
        for (size_t k = 0; k < 3; k++) {
            char what[64];
            experiment(experiments[e]);
            scenario.robot.v_max_mps = 0.5;
            scenario.plant.tau_s = 0.02;
            scenario.plant.a_max_mps2 = 20.0;
            scenario.plant.alpha_max_radps2 = 200.0;
            choose(kinds[k]);
            snprintf(what, sizeof what, "%s with lag, %s", experiments[e],
                     bus_setup_drive_name(kinds[k]));
            check_like_plain(what);
        }
    }
}

/* Fixes are blended with odometry, so noise does less than without the bus: no worse is asked. */
static void test_noisy_fixes(void) {
    for (size_t e = 0; e < 2; e++) {
        for (uint64_t seed = 1; seed <= 5; seed++) {
            experiment(experiments[e]);
            scenario.plant.pose_noise_m = 0.003;
            scenario.plant.heading_noise_rad = 0.005;
            config.seed = seed;
            const run_summary_t alone = plain();
            run();
            check_good("noise");
            TEST_ASSERT_TRUE(result.robot.summary.rms_position_error_m <
                             1.2 * alone.rms_position_error_m);
            TEST_ASSERT_TRUE(result.robot.pose_error_m < 0.02);
        }
    }
}

/* Nothing about the drives may show in the robot's motion. */
static void test_setups_that_turn_the_wheels_alike(void) {
    bus_setup_t setups[7];
    for (size_t i = 0; i < 7; i++) {
        bus_setup_init(&setups[i], false);
    }
    setups[0].sign[BERTH_LEFT] = -1;
    setups[0].gear_ratio = 12.5;
    setups[1].node[BERTH_LEFT] = 40;
    setups[1].node[BERTH_RIGHT] = 0;
    setups[1].address = 255;
    setups[2].drive = DRIVE_SIM_VESC;
    setups[2].sign[BERTH_LEFT] = setups[2].sign[BERTH_RIGHT] = -1;
    setups[2].gear_ratio = 20.0;
    setups[2].pole_pairs = 4;
    setups[3].drive = DRIVE_SIM_CIA402;
    setups[3].mode = 9;
    setups[3].gear_ratio = 30.0;
    setups[4].drive = DRIVE_SIM_CIA402;
    setups[4].position = false;
    setups[4].given |= 1u << (BUS_SETUP_UNITS - BUS_SETUP_DRIVE);
    setups[4].velocity_units_per_rps = 600.0; /* 0.1 rpm */
    setups[4].gear_ratio = 10.0;
    setups[5].drive = DRIVE_SIM_CIA402;
    setups[5].sign[BERTH_RIGHT] = -1;
    setups[5].counts_per_turn = 65536;
    setups[5].master = 3;
    setups[6].fix_period_us = 0; /* dead reckoning */
    for (size_t i = 0; i < 7; i++) {
        char what[32];
        experiment("circle");
        setup = setups[i];
        TEST_ASSERT_TRUE_MESSAGE(bus_setup_finish(&setup, &error), error.text);
        snprintf(what, sizeof what, "set-up %u", (unsigned)i);
        check_like_plain(what);
        /* cia402 is asked for feedback once a period, at SYNC: a period's change of speed */
        const double bound_m =
            setup.drive == DRIVE_SIM_CIA402 ? 0.8 * scenario.period_s + 0.005 : 0.01;
        TEST_ASSERT_TRUE_MESSAGE(result.robot.pose_error_m < bound_m, what);
    }
}

static void test_fixes_that_come_late_are_survived(void) {
    experiment("circle");
    setup.fix_latency_us = 50000;
    run();
    check_good("latency");
    TEST_ASSERT_TRUE(result.robot.pose_error_m < 0.05);
}

static void test_rows_are_the_plain_runs(void) {
    experiment("circle");
    run();
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-9, 30.0,
                              result.robot.summary.mode_time_s[BERTH_MODE_TRACK] +
                                  result.robot.summary.avoidance_time_s);
    /* the reference began when the board started to run, less than a period after the command */
    const int64_t late_us = result.robot.run_us - SESSION_BEGIN_US - result.started_us;
    TEST_ASSERT_TRUE(late_us >= 0 && late_us <= plan.plan.period_us + 5000);
}

static void test_a_session_is_much_faster_than_real_time(void) {
    experiment("circle");
    run();
    TEST_ASSERT_TRUE(result.wall_s < 3.0); /* of 30 s; usually 0.01 s, but not under sanitizers */
}

/* --- the same each time ------------------------------------------------------------------ */

typedef struct {
    uint64_t digest;
    uint64_t count;
} trace_t;

static void add(trace_t *trace, uint64_t value) {
    for (int i = 0; i < 8; i++) {
        trace->digest = (trace->digest ^ (value & 0xffu)) * 0x100000001b3u; /* FNV-1a */
        value >>= 8;
    }
}

static void on_frame(void *context, const can_loop_event_t *event) {
    trace_t *trace = context;
    uint64_t data = 0;
    for (int i = 0; i < 8; i++) {
        data = data << 8 | event->frame.data[i];
    }
    add(trace, (uint64_t)event->end_ns);
    add(trace, (uint64_t)event->frame.id << 8 | event->frame.length);
    add(trace, data);
    trace->count++;
}

static void observe(void *context, session_parts_t *parts) {
    can_loop_observe(&parts->loop, on_frame, context);
}

static trace_t trace_of(uint64_t seed) {
    trace_t trace = {0xcbf29ce484222325u, 0};
    config.seed = seed;
    config.prepare = observe;
    config.context = &trace;
    run();
    TEST_ASSERT_EQUAL_UINT64(result.frames, trace.count);
    return trace;
}

static void test_the_same_seed_gives_the_same_frames(void) {
    for (size_t k = 0; k < 3; k++) {
        experiment("circle");
        scenario.plant.pose_noise_m = 0.002;
        scenario.plant.tau_s = 0.02;
        choose(kinds[k]);
        const trace_t first = trace_of(1);
        const run_summary_t summary = result.robot.summary;
        const trace_t other = trace_of(2);
        const trace_t again = trace_of(1);
        TEST_ASSERT_EQUAL_HEX64(first.digest, again.digest);
        TEST_ASSERT_TRUE(first.digest != other.digest);
        TEST_ASSERT_EQUAL_DOUBLE(summary.rms_position_error_m,
                                 result.robot.summary.rms_position_error_m);
        TEST_ASSERT_EQUAL_DOUBLE(summary.control_effort, result.robot.summary.control_effort);
    }
}

/* --- obstacles --------------------------------------------------------------------------- */

static void test_a_blind_board_collides_as_without_the_bus(void) {
    experiment("circle");
    strategy("none");
    const run_summary_t alone = plain();
    run();
    TEST_ASSERT_EQUAL_INT(3, alone.collisions);
    TEST_ASSERT_EQUAL_INT(3, result.robot.summary.collisions);
    TEST_ASSERT_DOUBLE_WITHIN(0.01, alone.min_clearance_m, result.robot.summary.min_clearance_m);
    TEST_ASSERT_FALSE(session_good(&result));
}

static void test_obstacles_told_over_the_bus_are_avoided(void) {
    for (size_t e = 0; e < 2; e++) {
        for (size_t k = 0; k < 3; k++) {
            experiment(experiments[e]);
            choose(kinds[k]);
            setup.announced = true;
            run();
            check_good("announced");
            TEST_ASSERT_EQUAL_UINT32(0, result.board.obstacles_refused);
            TEST_ASSERT_TRUE(result.robot.summary.avoidance_time_s > 0.0);
            TEST_ASSERT_TRUE(result.robot.announcements >= 3 * 150);
        }
    }
}

static void lose_obstacles(void *context, session_parts_t *parts) {
    (void)context;
    const can_loop_rule_t rule = {
        .node = SESSION_NODE_ROBOT,
        .filtered = true,
        .filter = {BERTH_MESSAGE_OBSTACLE << 8, BERTH_CAN_EXTENDED_MAX & ~0xffu, true},
        .probability = 1.0,
        .action = {.deaf = CAN_LOOP_EVERYBODY},
    };
    TEST_ASSERT_TRUE(can_loop_rule(&parts->loop, &rule));
}

static void test_without_those_frames_it_collides(void) {
    experiment("circle");
    setup.announced = true;
    config.prepare = lose_obstacles;
    run();
    TEST_ASSERT_EQUAL_INT(3, result.robot.summary.collisions);
}

static void test_a_board_that_ignores_obstacles_is_not_told_of_any(void) {
    experiment("circle");
    strategy("none");
    setup.announced = true;
    run();
    TEST_ASSERT_EQUAL_UINT(0, result.robot.announcements);
    TEST_ASSERT_EQUAL_INT(3, result.robot.summary.collisions);
}

/* --- configurations ---------------------------------------------------------------------- */

static void test_the_setup_is_what_the_board_gets(void) {
    berth_board_config_t board;
    experiment("eight");
    setup.drive = DRIVE_SIM_CIA402;
    setup.node[0] = 12;
    setup.node[1] = 13;
    setup.sign[1] = -1;
    setup.gear_ratio = 7.5;
    setup.mode = 9;
    setup.master = 99;
    setup.position = false;
    setup.counts_per_turn = 1000;
    setup.feedback_timeout_us = 222000;
    setup.heartbeat_timeout_us = 333000;
    setup.enable_timeout_us = 444000;
    setup.address = 77;
    setup.velocity_units_per_rps = 60.0;
    setup.given |= 1u << (BUS_SETUP_UNITS - BUS_SETUP_DRIVE);
    TEST_ASSERT_TRUE(bus_setup_finish(&setup, &error));
    TEST_ASSERT_TRUE(bus_setup_board_config(&setup, &scenario, 50000, &board, &error));
    for (int side = 0; side < 2; side++) {
        const berth_drive_config_t *drive = &board.drives[side];
        TEST_ASSERT_EQUAL_PTR(&berth_drive_cia402, drive->protocol);
        TEST_ASSERT_EQUAL_UINT8(12 + side, drive->node);
        TEST_ASSERT_EQUAL_INT8(side == 0 ? 1 : -1, drive->sign);
        TEST_ASSERT_EQUAL_FLOAT(7.5f, drive->gear_ratio);
        TEST_ASSERT_EQUAL_UINT8(9, drive->mode);
        TEST_ASSERT_EQUAL_UINT8(99, drive->master_node);
        TEST_ASSERT_FALSE(drive->has_position);
        TEST_ASSERT_EQUAL_UINT32(1000, drive->counts_per_turn);
        TEST_ASSERT_EQUAL_FLOAT(60.0f, drive->velocity_units_per_rps);
        TEST_ASSERT_EQUAL_UINT32(222000, drive->feedback_timeout_us);
        TEST_ASSERT_EQUAL_UINT32(333000, drive->heartbeat_timeout_us);
        TEST_ASSERT_EQUAL_UINT32(444000, drive->enable_timeout_us);
        const drive_sim_config_t sim = bus_setup_drive_sim(&setup, side);
        TEST_ASSERT_EQUAL_INT(DRIVE_SIM_CIA402, sim.kind);
        TEST_ASSERT_EQUAL_UINT8(drive->node, sim.node);
        TEST_ASSERT_EQUAL_INT(drive->sign, sim.sign);
        TEST_ASSERT_EQUAL_DOUBLE(60.0, sim.velocity_units_per_rps);
    }
    TEST_ASSERT_EQUAL_UINT8(77, board.address);
    TEST_ASSERT_EQUAL_FLOAT(0.8f, board.controller.limits.v_max_mps);
    /* without --velocity-units: counts/s */
    bus_setup_init(&setup, false);
    setup.counts_per_turn = 1000;
    TEST_ASSERT_TRUE(bus_setup_finish(&setup, &error));
    TEST_ASSERT_EQUAL_DOUBLE(1000.0, setup.velocity_units_per_rps);
}

/* What the clearance condition demands of obstacles from the bus, for slow drives too. */
static void test_regions_for_the_buss_obstacles(void) {
    berth_board_config_t board;
    experiment("eight");
    TEST_ASSERT_TRUE(bus_setup_board_config(&setup, &scenario, 50000, &board, &error));
    TEST_ASSERT_FLOAT_WITHIN(1.0e-5f, 0.8f * 0.05f + 0.01f, board.regions.conservative_m);
    TEST_ASSERT_EQUAL_FLOAT(0.2f, board.regions.regulated_m);
    scenario.plant.tau_s = 0.1;
    scenario.plant.a_max_mps2 = 2.0;
    scenario.plant.pose_noise_m = 0.01;
    TEST_ASSERT_TRUE(bus_setup_board_config(&setup, &scenario, 50000, &board, &error));
    TEST_ASSERT_FLOAT_WITHIN(1.0e-5f, 0.8f * 0.15f + 0.64f / 4.0f + 0.03f + 0.01f,
                             board.regions.conservative_m);
    strategy("conservative");
    TEST_ASSERT_TRUE(bus_setup_board_config(&setup, &scenario, 50000, &board, &error));
    TEST_ASSERT_EQUAL_FLOAT((float)scenario.avoidance.skirt_m, board.regions.regulated_m);
}

/* A late pose is a late fix, slip is for the localisation to find out, and the board is told both.
 */
static void test_late_poses_and_slip(void) {
    berth_board_config_t board;
    experiment("circle");
    scenario.obstacle_count = 0;
    setup.fix_latency_us = 120000;
    run();
    const bus_robot_result_t late = result.robot;
    experiment("circle");
    scenario.obstacle_count = 0;
    setup.fix_latency_us = 0;
    run();
    const bus_robot_result_t prompt = result.robot;
    setup.fix_latency_us = 20000;
    scenario.plant.pose_delay_s = 0.1;
    run();
    TEST_ASSERT_EQUAL_DOUBLE(late.summary.control_effort, result.robot.summary.control_effort);
    TEST_ASSERT_TRUE(late.pose_error_m > 0.03 && prompt.pose_error_m < 0.01);
    setup.fix_latency_us = 0;
    scenario.plant.pose_delay_s = 0.0;
    scenario.plant.slip = 0.2;
    run();
    check_good("slip");
    TEST_ASSERT_TRUE(result.robot.pose_error_m > 2.0 * prompt.pose_error_m);

    scenario.plant.pose_delay_s = 0.1;
    scenario.plant.watchdog_s = 0.25;
    TEST_ASSERT_TRUE(bus_setup_board_config(&setup, &scenario, 50000, &board, &error));
    TEST_ASSERT_FLOAT_WITHIN(1.0e-5f, 1.2f * 0.8f * (0.05f + 0.1f + 0.25f) + 0.01f,
                             board.regions.conservative_m);
    TEST_ASSERT_TRUE(bus_setup_fix_latency_us(&setup, &scenario) == 100000);
    setup.fix_period_us = 0;
    TEST_ASSERT_TRUE(bus_setup_fix_latency_us(&setup, &scenario) == 0);
}

/* --- refusals ---------------------------------------------------------------------------- */

static void check_refused(const char *fragment) {
    make_plan();
    error.text[0] = '\0';
    TEST_ASSERT_FALSE(session_run(&config, &result, &error));
    TEST_ASSERT_NOT_NULL_MESSAGE(strstr(error.text, fragment), error.text);
}

static void test_what_the_board_refuses_is_refused(void) {
    static const char *const others[] = {"normal", "adaptive", "kanayama", "kanayama_avoid"};
    for (size_t i = 0; i < 4; i++) {
        experiment("circle");
        strategy(others[i]);
        check_refused(others[i]);
    }
    experiment("circle");
    scenario.obstacles[1].conservative_m = 0.13;
    check_refused("obstacles.1.conservative_m");
    experiment("circle");
    make_plan();
    setup.gear_ratio = 5000.0;
    check_refused("left drive: ");
    setup.gear_ratio = 1.0;
    setup.node[BERTH_RIGHT] = setup.node[BERTH_LEFT];
    check_refused("right drive: ");
}

/* --- trouble ----------------------------------------------------------------------------- */

/* An order of the robot's, and a moment for the board's bus. */
typedef struct {
    bus_robot_order_t order;
    int64_t at_us; /* since the reference began; the run is 30 s long */
    bool done;
    void (*act)(session_parts_t *parts, int64_t now_us);
    int64_t acted_us;
    int64_t stopped_us; /* when the board said fault */
    int64_t standing_us;
    double way_m; /* from the trouble on */
    berth_pose_t last;
} trouble_t;

static trouble_t trouble;

static bool now_is(session_parts_t *parts, int64_t now_us) {
    const int64_t run_us = bus_robot_result(parts->robot)->run_us;
    return run_us >= 0 && now_us >= run_us + trouble.at_us;
}

static void on_instant(void *context, session_parts_t *parts, int64_t now_us) {
    (void)context;
    if (!trouble.done && now_is(parts, now_us)) {
        trouble.done = true;
        trouble.acted_us = now_us;
        trouble.last = bus_robot_pose(parts->robot);
        trouble.act(parts, now_us);
    }
    if (!trouble.done) {
        return;
    }
    const berth_pose_t pose = bus_robot_pose(parts->robot);
    trouble.way_m +=
        hypot((double)(pose.x_m - trouble.last.x_m), (double)(pose.y_m - trouble.last.y_m));
    trouble.last = pose;
    if (trouble.stopped_us == 0 &&
        berth_board_status(&parts->board)->state == BERTH_SUPERVISOR_FAULT) {
        trouble.stopped_us = now_us;
    }
    if (bus_robot_result(parts->robot)->speed_mps != 0.0) {
        trouble.standing_us = 0;
    } else if (trouble.standing_us == 0) {
        trouble.standing_us = now_us;
    }
}

static void order_now(session_parts_t *parts, int64_t now_us) {
    trouble.order.at_us = now_us;
    TEST_ASSERT_TRUE(bus_robot_order(parts->robot, &trouble.order));
}

static void run_with(void (*act)(session_parts_t *parts, int64_t now_us), int64_t at_us) {
    const bus_robot_order_t order = trouble.order;
    trouble = (trouble_t){.order = order, .at_us = at_us, .act = act};
    config.instant = on_instant;
    run();
    TEST_ASSERT_TRUE(trouble.done);
}

static void check_fault(uint8_t fault, const char *what) {
    TEST_ASSERT_EQUAL_STRING_MESSAGE("fault", session_end_text(result.end), what);
    TEST_ASSERT_EQUAL_UINT8_MESSAGE(fault, result.board.fault, what);
    TEST_ASSERT_EQUAL_INT_MESSAGE(0, result.robot.summary.collisions, what);
    TEST_ASSERT_TRUE_MESSAGE(result.robot.clearance_m >= 0.0, what);
    TEST_ASSERT_EQUAL_DOUBLE_MESSAGE(0.0, result.robot.speed_mps, what);
    /* both wheels are told to stand within two periods of the board's finding out */
    TEST_ASSERT_TRUE_MESSAGE(trouble.stopped_us > 0, what);
    TEST_ASSERT_TRUE_MESSAGE(trouble.standing_us <= trouble.stopped_us + 100000, what);
}

static uint8_t drive_fault(int side, berth_drive_fault_t fault) {
    return (uint8_t)((int)(side == 0 ? BERTH_FAULT_LEFT : BERTH_FAULT_RIGHT) + (int)fault);
}

static void test_a_dead_drive_stops_both(void) {
    for (size_t k = 0; k < 3; k++) {
        for (int side = 0; side < 2; side++) {
            experiment("circle");
            choose(kinds[k]);
            trouble.order = (bus_robot_order_t){.side = side, .trouble = {.dead = true}};
            run_with(order_now, 3000000);
            TEST_ASSERT_EQUAL_INT(BUS_ROBOT_LEFT, result.robot.phase);
            TEST_ASSERT_TRUE(trouble.stopped_us - trouble.acted_us <= 200000);
            check_fault(drive_fault(side, BERTH_DRIVE_FAULT_FEEDBACK),
                        bus_setup_drive_name(kinds[k]));
        }
    }
}

static void test_a_drive_that_fails_stops_both(void) {
    static const berth_drive_fault_t faults[] = {BERTH_DRIVE_FAULT_DEVICE, BERTH_DRIVE_FAULT_NONE,
                                                 BERTH_DRIVE_FAULT_EMERGENCY};
    for (size_t k = 0; k < 3; k += 2) { /* a vesc cannot say so */
        experiment("circle");
        choose(kinds[k]);
        trouble.order = (bus_robot_order_t){.side = 1, .fail = 0x2310};
        run_with(order_now, 3000000);
        TEST_ASSERT_TRUE(trouble.stopped_us - trouble.acted_us <= 150000);
        check_fault(drive_fault(1, faults[k]), bus_setup_drive_name(kinds[k]));
        TEST_ASSERT_EQUAL_HEX32(0x2310, result.drives[1].code);
    }
}

static void test_a_mute_heartbeat_stops_both(void) {
    for (size_t k = 0; k < 3; k += 2) { /* a vesc has none */
        experiment("circle");
        choose(kinds[k]);
        trouble.order = (bus_robot_order_t){.side = 0, .trouble = {.mute_heartbeat = true}};
        run_with(order_now, 3000000);
        TEST_ASSERT_TRUE(trouble.stopped_us - trouble.acted_us <= 650000);
        check_fault(drive_fault(0, BERTH_DRIVE_FAULT_HEARTBEAT), bus_setup_drive_name(kinds[k]));
    }
}

static void board_down(session_parts_t *parts, int64_t now_us) {
    (void)now_us;
    can_loop_down(&parts->loop, SESSION_NODE_BOARD);
}

static void board_off(session_parts_t *parts, int64_t now_us) {
    (void)now_us;
    can_loop_bus_off(&parts->loop, SESSION_NODE_BOARD);
}

/* The board cannot say anything any more: the drives' own watchdogs stop the wheels. */
static void test_without_the_bus_the_drives_stop_by_themselves(void) {
    for (size_t k = 0; k < 3; k++) {
        for (int i = 0; i < 2; i++) {
            experiment("circle");
            choose(kinds[k]);
            run_with(i == 0 ? board_down : board_off, 3000000);
            const char *what = bus_setup_drive_name(kinds[k]);
            TEST_ASSERT_EQUAL_STRING_MESSAGE("fault", session_end_text(result.end), what);
            TEST_ASSERT_EQUAL_UINT8_MESSAGE(i == 0 ? BERTH_FAULT_BUS_DOWN : BERTH_FAULT_BUS_OFF,
                                            result.board.fault, what);
            TEST_ASSERT_TRUE_MESSAGE(trouble.stopped_us - trouble.acted_us <= 50000, what);
            TEST_ASSERT_TRUE_MESSAGE(trouble.standing_us > 0, what);
            /* odrive and vesc: the simulated drive's watchdog; cia402: heartbeat_timeout_us */
            TEST_ASSERT_TRUE_MESSAGE(trouble.standing_us - trouble.acted_us <= 600000, what);
            TEST_ASSERT_TRUE_MESSAGE(result.robot.clearance_m >= 0.0, what);
            TEST_ASSERT_EQUAL_UINT_MESSAGE(1, result.robot.drives[0].watchdog_stops, what);
            TEST_ASSERT_EQUAL_UINT_MESSAGE(1, result.robot.drives[1].watchdog_stops, what);
        }
    }
}

static void emergency(session_parts_t *parts, int64_t now_us) {
    berth_board_command(&parts->board, BERTH_COMMAND_EMERGENCY_STOP, now_us);
}

static void test_an_emergency_stop_stops_at_once(void) {
    for (size_t k = 0; k < 3; k++) {
        experiment("circle");
        choose(kinds[k]);
        run_with(emergency, 3012345);
        TEST_ASSERT_EQUAL_INT64(trouble.acted_us, trouble.stopped_us);
        TEST_ASSERT_TRUE(trouble.standing_us - trouble.acted_us <= 100000);
        TEST_ASSERT_TRUE(trouble.way_m < 0.05);
        check_fault(BERTH_FAULT_EMERGENCY_STOP, bus_setup_drive_name(kinds[k]));
    }
}

/* Drives that never answer: the board says so and never runs. */
static void kill_drives(void *context, session_parts_t *parts) {
    (void)context;
    for (int side = 0; side < 2; side++) {
        const bus_robot_order_t order = {
            .at_us = SESSION_BEGIN_US, .side = side, .trouble = {.dead = true}};
        TEST_ASSERT_TRUE(bus_robot_order(parts->robot, &order));
    }
}

static void test_without_drives_it_does_not_arm(void) {
    for (size_t k = 0; k < 3; k++) {
        experiment("circle");
        choose(kinds[k]);
        config.prepare = kill_drives;
        run();
        const char *what = bus_setup_drive_name(kinds[k]);
        TEST_ASSERT_EQUAL_STRING_MESSAGE("fault", session_end_text(result.end), what);
        TEST_ASSERT_EQUAL_INT64(-1, result.started_us);
        TEST_ASSERT_EQUAL_INT_MESSAGE(BUS_ROBOT_WAITING, result.robot.phase, what);
        TEST_ASSERT_TRUE_MESSAGE(result.board.fault != BERTH_FAULT_NONE, what);
        TEST_ASSERT_EQUAL_INT(0, result.robot.summary.steps);
    }
}

/* The k-th call of the board's bus fails. */
typedef struct {
    can_fault_t fault;
    can_fault_order_t order;
} injector_t;

static void inject(void *context, session_parts_t *parts) {
    injector_t *injector = context;
    parts->can = can_fault_init(&injector->fault, &parts->can);
    TEST_ASSERT_TRUE(can_fault_order(&injector->fault, &injector->order));
}

static void test_a_call_that_fails_stops_it_or_does_no_harm(void) {
    support_random_start();
    injector_t injector;
    config.prepare = inject;
    config.context = &injector;
    for (uint32_t i = 0; i < support_runs(60); i++) {
        char what[80];
        experiment("circle");
        scenario.duration_s = 8.0;
        choose(kinds[i % 3]);
        injector.order = (can_fault_order_t){
            .calls = 1u << support_index(3),
            .first = support_index(4000),
            .count = 1,
            .outcome = support_index(2) == 0 ? BERTH_CAN_AGAIN : BERTH_CAN_FAILED,
            .mode = BERTH_CAN_BUS_OFF,
        };
        run();
        snprintf(what, sizeof what, "%s, call %u of set %u", bus_setup_drive_name(kinds[i % 3]),
                 (unsigned)injector.order.first, (unsigned)injector.order.calls);
        TEST_ASSERT_TRUE_MESSAGE(result.robot.clearance_m >= 0.0, what);
        TEST_ASSERT_EQUAL_DOUBLE_MESSAGE(0.0, result.robot.speed_mps, what);
        if (result.end == SESSION_FAULT) {
            TEST_ASSERT_TRUE_MESSAGE(result.board.fault == BERTH_FAULT_BUS_OFF ||
                                         result.board.fault == BERTH_FAULT_BUS_DOWN,
                                     what);
        } else {
            TEST_ASSERT_TRUE_MESSAGE(session_good(&result), what);
        }
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_experiments_come_out_as_without_the_bus);
    RUN_TEST(test_drives_with_lag_and_limits);
    RUN_TEST(test_noisy_fixes);
    RUN_TEST(test_setups_that_turn_the_wheels_alike);
    RUN_TEST(test_fixes_that_come_late_are_survived);
    RUN_TEST(test_rows_are_the_plain_runs);
    RUN_TEST(test_a_session_is_much_faster_than_real_time);
    RUN_TEST(test_the_same_seed_gives_the_same_frames);
    RUN_TEST(test_a_blind_board_collides_as_without_the_bus);
    RUN_TEST(test_obstacles_told_over_the_bus_are_avoided);
    RUN_TEST(test_without_those_frames_it_collides);
    RUN_TEST(test_a_board_that_ignores_obstacles_is_not_told_of_any);
    RUN_TEST(test_the_setup_is_what_the_board_gets);
    RUN_TEST(test_regions_for_the_buss_obstacles);
    RUN_TEST(test_late_poses_and_slip);
    RUN_TEST(test_what_the_board_refuses_is_refused);
    RUN_TEST(test_a_dead_drive_stops_both);
    RUN_TEST(test_a_drive_that_fails_stops_both);
    RUN_TEST(test_a_mute_heartbeat_stops_both);
    RUN_TEST(test_without_the_bus_the_drives_stop_by_themselves);
    RUN_TEST(test_an_emergency_stop_stops_at_once);
    RUN_TEST(test_without_drives_it_does_not_arm);
    RUN_TEST(test_a_call_that_fails_stops_it_or_does_no_harm);
    return UNITY_END();
}
