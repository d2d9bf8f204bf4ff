/* The ODrive and VESC drives of the firmware and the simulated ones, frame by frame in virtual
 * time. The two sides were written from the protocols' documents and share no code, so what one of
 * them has read wrongly shows here.
 *
 * Each 100 us the bus carries one frame at most, the one with the lowest identifier first. Frames
 * can be lost or doubled to order, and those for the firmware can be held back until the end of
 * the control period, as a busy processor does.
 */
#include "support.h"

#include "berth/drive_odrive.h"
#include "berth/drive_vesc.h"
#include "bus/drive_sim.h"

#include "unity.h"

#include <math.h>

#define TICK_US 100
#define PERIOD_US 10000
#define WATCHDOG_US 100000
#define WHEEL_TAU_S 0.05
#define COAST_TAU_S 0.3
#define RAD_PER_TURN 6.283185307179586
#define POLE_PAIRS 7
#define NEVER UINT32_MAX
#define ERROR_WATCHDOG 0x01000000u
#define HELD_MAX 256u

typedef struct {
    drive_sim_kind_t kind;
    int8_t sign;
    float gear;
    bool late; /* frames reach the firmware at the end of the period, with their own times */
} setup_t;

typedef struct {
    setup_t setup;
    berth_drive_t drive;
    berth_outbox_t outbox;
    drive_sim_t *sim;
    int64_t now_us;
    double angle_rad, speed_radps;
    double offset_rad; /* what the drive's encoder tells beyond the angle */
    double travel_rad; /* what the firmware has told */
    double fastest_radps;
    uint32_t frames; /* that were on the bus */
    uint32_t lose, twice;
    bool silent; /* no cycle any more */
    berth_can_frame_t held[HELD_MAX];
    uint32_t held_count;
} pair_t;

static pair_t pair;

static const setup_t setups[] = {
    {DRIVE_SIM_ODRIVE, 1, 1.0f, false},  {DRIVE_SIM_ODRIVE, -1, 12.5f, false},
    {DRIVE_SIM_ODRIVE, 1, 5.0f, true},   {DRIVE_SIM_VESC, 1, 1.0f, false},
    {DRIVE_SIM_VESC, -1, 12.5f, false},  {DRIVE_SIM_VESC, -1, 5.0f, true},
    {DRIVE_SIM_ODRIVE, -1, 0.5f, false}, {DRIVE_SIM_VESC, 1, 40.0f, true},
};
#define SETUPS (sizeof setups / sizeof setups[0])

static berth_drive_config_t drive_config(const setup_t *setup) {
    return (berth_drive_config_t){
        .protocol = setup->kind == DRIVE_SIM_ODRIVE ? &berth_drive_odrive : &berth_drive_vesc,
        .node = 17,
        .sign = setup->sign,
        .gear_ratio = setup->gear,
        .pole_pairs = POLE_PAIRS,
        .period_us = PERIOD_US,
        .feedback_timeout_us = 60000,
        .heartbeat_timeout_us = 90000,
        .enable_timeout_us = 1000000,
    };
}

static drive_sim_config_t sim_config(const setup_t *setup) {
    return (drive_sim_config_t){
        .kind = setup->kind,
        .node = 17,
        .sign = setup->sign,
        .gear_ratio = (double)setup->gear,
        .pole_pairs = POLE_PAIRS,
        .feedback_us = 10000,
        .heartbeat_us = 20000,
        .watchdog_us = WATCHDOG_US,
    };
}

static void start(const setup_t *setup) {
    drive_sim_destroy(pair.sim);
    pair = (pair_t){.setup = *setup, .lose = NEVER, .twice = NEVER};
    const berth_drive_config_t config = drive_config(setup);
    const drive_sim_config_t other = sim_config(setup);
    berth_refusal_t refusal;
    TEST_ASSERT_EQUAL(BERTH_OK, berth_drive_init(&pair.drive, &config, &refusal));
    berth_outbox_reset(&pair.outbox);
    pair.sim = drive_sim_create(&other, 0);
    TEST_ASSERT_NOT_NULL(pair.sim);
}

void setUp(void) {}

void tearDown(void) {
    drive_sim_destroy(pair.sim);
    pair.sim = NULL;
}

/* --- the bus and the wheel ---------------------------------------------------------------------
 */

static void to_firmware(berth_can_frame_t frame) {
    frame.time_us = pair.now_us;
    if (pair.setup.late) {
        TEST_ASSERT_TRUE(pair.held_count < HELD_MAX);
        pair.held[pair.held_count++] = frame;
    } else {
        TEST_ASSERT_TRUE(berth_drive_receive(&pair.drive, &frame, frame.time_us));
    }
}

static void give_held(void) {
    for (uint32_t i = 0; i < pair.held_count; i++) {
        const berth_can_frame_t *frame = &pair.held[i];
        TEST_ASSERT_TRUE(berth_drive_receive(&pair.drive, frame, frame->time_us));
    }
    pair.held_count = 0;
}

static void carry_one(void) {
    const berth_can_frame_t *ours = berth_outbox_front(&pair.outbox);
    const berth_can_frame_t *theirs = drive_sim_front(pair.sim);
    if (ours == NULL && theirs == NULL) {
        return;
    }
    const bool from_us = theirs == NULL || (ours != NULL && ours->id < theirs->id);
    const berth_can_frame_t frame = from_us ? *ours : *theirs;
    if (from_us) {
        berth_outbox_pop(&pair.outbox);
    } else {
        drive_sim_sent(pair.sim);
    }
    const uint32_t number = pair.frames++;
    const int times = number == pair.lose ? 0 : number == pair.twice ? 2 : 1;
    for (int i = 0; i < times; i++) {
        if (from_us) {
            (void)drive_sim_receive(pair.sim, &frame, pair.now_us);
        } else {
            to_firmware(frame);
        }
    }
}

static void turn_wheel(void) {
    const double step_s = TICK_US * 1.0e-6;
    const bool held = drive_sim_enabled(pair.sim);
    const double wanted = held ? drive_sim_target_radps(pair.sim) : 0.0;
    const double before = pair.speed_radps;
    pair.speed_radps += (wanted - before) * step_s / (held ? WHEEL_TAU_S : COAST_TAU_S);
    pair.angle_rad += 0.5 * (before + pair.speed_radps) * step_s;
    pair.fastest_radps = fmax(pair.fastest_radps, fabs(pair.speed_radps));
    drive_sim_motion(pair.sim, pair.angle_rad + pair.offset_rad, pair.speed_radps);
}

static void control_period(void) {
    pair.travel_rad += (double)berth_drive_travel(&pair.drive, pair.now_us);
    give_held();
    if (!pair.silent) {
        berth_drive_cycle(&pair.drive, pair.now_us, &pair.outbox);
    }
}

static void tick(void) {
    pair.now_us += TICK_US;
    if (pair.now_us % PERIOD_US == 0) {
        control_period();
    }
    if (berth_drive_deadline(&pair.drive) <= pair.now_us) {
        berth_drive_step(&pair.drive, pair.now_us, &pair.outbox);
    }
    turn_wheel();
    drive_sim_step(pair.sim, pair.now_us);
    carry_one();
}

static void run_for(int64_t time_us) {
    for (int64_t left_us = time_us; left_us > 0; left_us -= TICK_US) {
        tick();
    }
}

static const berth_drive_status_t *status(void) {
    return berth_drive_status(&pair.drive);
}

static void run_until(berth_drive_state_t state, int64_t time_us) {
    const int64_t end_us = pair.now_us + time_us;
    while (status()->state != state && pair.now_us < end_us) {
        tick();
    }
    TEST_ASSERT_EQUAL(state, status()->state);
}

static void enable(void) {
    berth_drive_enable(&pair.drive, pair.now_us);
    run_until(BERTH_DRIVE_ENABLED, 400000);
}

static void start_enabled(const setup_t *setup) {
    start(setup);
    run_for(50000); /* frames are there before anybody asks */
    enable();
    (void)berth_drive_travel(&pair.drive, pair.now_us);
    pair.travel_rad = 0.0;
    pair.angle_rad = 0.0;
}

static void drive_at(float radps, int64_t time_us) {
    berth_drive_command(&pair.drive, radps);
    run_for(time_us);
}

static void expect_fault(berth_drive_fault_t fault, uint32_t code) {
    TEST_ASSERT_EQUAL(BERTH_DRIVE_FAULT, status()->state);
    TEST_ASSERT_EQUAL(fault, status()->fault);
    TEST_ASSERT_EQUAL_HEX32(code, status()->code);
}

static void expect_following(float radps) {
    drive_at(radps, 600000);
    TEST_ASSERT_EQUAL(BERTH_DRIVE_ENABLED, status()->state);
    TEST_ASSERT_DOUBLE_WITHIN(0.02 + 0.001 * fabs((double)radps), (double)radps, pair.speed_radps);
    TEST_ASSERT_FLOAT_WITHIN(0.2f, radps, status()->velocity_radps);
}

static void expect_standing(void) {
    run_for(10 * 300000);
    TEST_ASSERT_DOUBLE_WITHIN(0.01, 0.0, pair.speed_radps);
}

/* Two steps of the position, and what the speeds may be rounded by. */
static double slack_rad(void) {
    const double gear = fabs((double)pair.setup.gear);
    const double quantum = pair.setup.kind == DRIVE_SIM_VESC ? 1.0 / (6.0 * POLE_PAIRS) : 1.0e-5;
    return 2.0 * quantum / gear * RAD_PER_TURN + 1.0e-3;
}

/* --- following ---------------------------------------------------------------------------------
 */

static void test_it_enables_and_stands(void) {
    for (uint32_t i = 0; i < SETUPS; i++) {
        start_enabled(&setups[i]);
        TEST_ASSERT_TRUE(pair.now_us < 200000);
        run_for(500000);
        TEST_ASSERT_TRUE(drive_sim_enabled(pair.sim));
        TEST_ASSERT_EQUAL_DOUBLE(0.0, pair.fastest_radps);
        TEST_ASSERT_EQUAL(0, status()->malformed);
        TEST_ASSERT_EQUAL(0, drive_sim_counters(pair.sim).malformed);
        TEST_ASSERT_TRUE(status()->position_used);
    }
}

static void follow_random_speeds(const setup_t *setup) {
    start_enabled(setup);
    for (uint32_t change = 0; change < 40; change++) {
        berth_drive_command(&pair.drive, (float)support_uniform(-12.0, 12.0));
        for (uint32_t period = 0; period < 1 + support_index(40); period++) {
            run_for(PERIOD_US);
            /* at most 480 rad/s^2, not seen for two periods at most */
            TEST_ASSERT_DOUBLE_WITHIN(slack_rad() + 0.1, pair.angle_rad, pair.travel_rad);
        }
    }
    drive_at(0.0f, 1000000);
    TEST_ASSERT_DOUBLE_WITHIN(slack_rad(), pair.angle_rad, pair.travel_rad);
    TEST_ASSERT_EQUAL(BERTH_DRIVE_ENABLED, status()->state);
    TEST_ASSERT_EQUAL(0, status()->malformed);
    TEST_ASSERT_EQUAL(0, status()->saturated);
    TEST_ASSERT_TRUE(pair.fastest_radps > 5.0);
    TEST_ASSERT_EQUAL(0, drive_sim_counters(pair.sim).malformed);
    TEST_ASSERT_EQUAL(0, drive_sim_counters(pair.sim).watchdog_stops);
}

static void test_it_follows_and_travel_is_the_wheels_angle(void) {
    support_random_start();
    for (uint32_t run = 0; run < support_runs(20); run++) {
        for (uint32_t i = 0; i < SETUPS; i++) {
            follow_random_speeds(&setups[i]);
        }
    }
}

/* The drive starts its position anew while the wheel turns. */
static void test_a_new_zero_of_the_encoder_is_no_travel(void) {
    for (uint32_t i = 0; i < SETUPS; i++) {
        start_enabled(&setups[i]);
        drive_at(5.0f, 500000);
        pair.offset_rad = 1000.0;
        run_for(500000);
        pair.offset_rad = -2000.0;
        run_for(500000);
        drive_at(0.0f, 1000000);
        TEST_ASSERT_EQUAL(2, status()->malformed);
        TEST_ASSERT_DOUBLE_WITHIN(2.0 * slack_rad() + 0.02, pair.angle_rad, pair.travel_rad);
    }
}

/* Past 65536 turns an ODrive's float32 tells no position any more. */
static void test_far_from_zero_the_speed_tells_the_travel(void) {
    start(&setups[0]);
    pair.offset_rad = 65533.0 * RAD_PER_TURN;
    run_for(50000);
    enable();
    pair.travel_rad = 0.0;
    pair.angle_rad = 0.0;
    drive_at(10.0f, 1000000);
    TEST_ASSERT_TRUE(status()->position_used);
    drive_at(10.0f, 3000000);
    TEST_ASSERT_FALSE(status()->position_used);
    drive_at(0.0f, 1000000);
    TEST_ASSERT_EQUAL(0, status()->malformed);
    TEST_ASSERT_DOUBLE_WITHIN(0.06, pair.angle_rad, pair.travel_rad);
}

/* --- frames lost and doubled --------------------------------------------------------------------
 */

/* One frame of enabling and the first seconds goes wrong: nothing moves before it is told to, it
 * gets there, and follows. */
static void one_frame_wrong(const setup_t *setup, uint32_t lose, uint32_t twice) {
    start(setup);
    pair.lose = lose;
    pair.twice = twice;
    run_for(50000);
    enable();
    TEST_ASSERT_EQUAL_DOUBLE(0.0, pair.fastest_radps);
    drive_at(6.0f, 600000);
    TEST_ASSERT_EQUAL(BERTH_DRIVE_ENABLED, status()->state);
    TEST_ASSERT_DOUBLE_WITHIN(0.05, 6.0, pair.speed_radps);
    TEST_ASSERT_EQUAL(0, status()->malformed);
}

static void test_one_frame_lost_or_doubled(void) {
    for (uint32_t i = 0; i < SETUPS; i++) {
        for (uint32_t frame = 0; frame < 200; frame++) {
            one_frame_wrong(&setups[i], frame, NEVER);
            one_frame_wrong(&setups[i], NEVER, frame);
        }
        TEST_ASSERT_TRUE(pair.frames > 150);
    }
}

/* The drive was left in closed loop at speed, in its watchdog's time, by a board that was reset. */
static void test_a_drive_that_was_left_running_is_caught(void) {
    for (uint32_t i = 0; i < SETUPS; i++) {
        start_enabled(&setups[i]);
        drive_at(8.0f, 600000);
        berth_refusal_t refusal;
        const berth_drive_config_t config = drive_config(&pair.setup);
        TEST_ASSERT_EQUAL(BERTH_OK, berth_drive_init(&pair.drive, &config, &refusal));
        berth_outbox_reset(&pair.outbox);
        run_for(20000);
        enable();
        run_for(600000);
        TEST_ASSERT_DOUBLE_WITHIN(0.01, 0.0, pair.speed_radps);
        expect_following(3.0f);
    }
}

/* --- stopping -----------------------------------------------------------------------------------
 */

static void test_without_cycles_the_drives_own_watchdog_stops_the_wheel(void) {
    for (uint32_t i = 0; i < SETUPS; i++) {
        start_enabled(&setups[i]);
        drive_at(8.0f, 600000);
        pair.silent = true;
        run_for(WATCHDOG_US - 2 * PERIOD_US);
        TEST_ASSERT_EQUAL(0, drive_sim_counters(pair.sim).watchdog_stops);
        run_for(3 * PERIOD_US);
        TEST_ASSERT_EQUAL(1, drive_sim_counters(pair.sim).watchdog_stops);
        TEST_ASSERT_FALSE(drive_sim_enabled(pair.sim));
        expect_standing();
        if (setups[i].kind == DRIVE_SIM_ODRIVE) {
            expect_fault(BERTH_DRIVE_FAULT_DEVICE, ERROR_WATCHDOG);
        }
        berth_drive_disable(&pair.drive, &pair.outbox);
        berth_drive_reset(&pair.drive);
        pair.silent = false;
        enable();
        run_for(100000);
        TEST_ASSERT_DOUBLE_WITHIN(0.01, 0.0, pair.speed_radps);
        expect_following(3.0f);
    }
}

static void test_quick_stop_holds_and_is_left_by_enabling(void) {
    for (uint32_t i = 0; i < SETUPS; i++) {
        start_enabled(&setups[i]);
        drive_at(8.0f, 600000);
        berth_drive_stop(&pair.drive, &pair.outbox);
        run_for(2 * TICK_US + PERIOD_US);
        TEST_ASSERT_TRUE(drive_sim_enabled(pair.sim));
        TEST_ASSERT_EQUAL_DOUBLE(0.0, drive_sim_target_radps(pair.sim));
        drive_at(8.0f, 1000000); /* not obeyed */
        TEST_ASSERT_EQUAL(BERTH_DRIVE_STOPPED, status()->state);
        TEST_ASSERT_DOUBLE_WITHIN(0.01, 0.0, pair.speed_radps);
        TEST_ASSERT_EQUAL(0, drive_sim_counters(pair.sim).watchdog_stops);
        enable();
        expect_following(-4.0f);
    }
}

static void test_emergency_stop_holds_and_is_left_by_enabling(void) {
    for (uint32_t i = 0; i < SETUPS; i++) {
        start_enabled(&setups[i]);
        drive_at(8.0f, 600000);
        berth_drive_emergency_stop(&pair.drive, &pair.outbox);
        run_for(2 * TICK_US + PERIOD_US);
        TEST_ASSERT_EQUAL_DOUBLE(0.0, drive_sim_target_radps(pair.sim));
        drive_at(8.0f, 3000000);
        TEST_ASSERT_EQUAL(BERTH_DRIVE_STOPPED, status()->state);
        TEST_ASSERT_DOUBLE_WITHIN(0.01, 0.0, pair.speed_radps);
        TEST_ASSERT_EQUAL(setups[i].kind != DRIVE_SIM_ODRIVE, drive_sim_enabled(pair.sim));
        enable();
        expect_following(-4.0f);
    }
}

static void test_disabling_takes_the_torque_off(void) {
    for (uint32_t i = 0; i < SETUPS; i++) {
        start_enabled(&setups[i]);
        drive_at(8.0f, 600000);
        berth_drive_cycle(&pair.drive, pair.now_us, &pair.outbox); /* still waits to be sent */
        berth_drive_disable(&pair.drive, &pair.outbox);
        run_for(PERIOD_US);
        TEST_ASSERT_FALSE(drive_sim_enabled(pair.sim));
        expect_standing();
        TEST_ASSERT_EQUAL(BERTH_DRIVE_OFF, status()->state);
        enable();
        expect_following(2.0f);
    }
}

/* --- faults ------------------------------------------------------------------------------------
 */

static void order_trouble(const setup_t *setup, drive_sim_trouble_t trouble) {
    start_enabled(setup);
    drive_at(8.0f, 600000);
    drive_sim_trouble(pair.sim, &trouble);
}

/* The wheel stands after it, and a reset after the trouble leads back to work. */
static void expect_recovery(void) {
    expect_standing();
    const drive_sim_trouble_t none = {.dead = false};
    drive_sim_trouble(pair.sim, &none);
    berth_drive_disable(&pair.drive, &pair.outbox);
    berth_drive_reset(&pair.drive);
    run_for(100000);
    TEST_ASSERT_EQUAL(BERTH_DRIVE_OFF, status()->state);
    enable();
    expect_following(3.0f);
}

static void test_feedback_that_stops_is_a_fault(void) {
    for (uint32_t i = 0; i < SETUPS; i++) {
        order_trouble(&setups[i], (drive_sim_trouble_t){.mute_feedback = true});
        run_until(BERTH_DRIVE_FAULT, 60000 + 2 * PERIOD_US);
        expect_fault(BERTH_DRIVE_FAULT_FEEDBACK, 0);
        expect_recovery();
    }
}

static void test_a_heartbeat_that_stops_is_a_fault(void) {
    for (uint32_t i = 0; i < SETUPS; i++) {
        if (setups[i].kind == DRIVE_SIM_ODRIVE) { /* a VESC's feedback is its heartbeat */
            order_trouble(&setups[i], (drive_sim_trouble_t){.mute_heartbeat = true});
            run_until(BERTH_DRIVE_FAULT, 90000 + 2 * PERIOD_US);
            expect_fault(BERTH_DRIVE_FAULT_HEARTBEAT, 0);
            expect_recovery();
        }
    }
}

static void test_a_dead_drive_is_a_fault(void) {
    for (uint32_t i = 0; i < SETUPS; i++) {
        order_trouble(&setups[i], (drive_sim_trouble_t){.dead = true});
        run_until(BERTH_DRIVE_FAULT, 60000 + 2 * PERIOD_US);
        expect_fault(BERTH_DRIVE_FAULT_FEEDBACK, 0);
        expect_recovery();
    }
}

/* Too short to be missed: only its state tells. A VESC goes on as if nothing had been. */
static void test_a_drive_that_restarts_is_noticed(void) {
    for (uint32_t i = 0; i < SETUPS; i++) {
        order_trouble(&setups[i], (drive_sim_trouble_t){.dead = true});
        run_for(5000);
        const drive_sim_trouble_t none = {.dead = false};
        drive_sim_trouble(pair.sim, &none);
        run_for(60000);
        if (setups[i].kind == DRIVE_SIM_ODRIVE) {
            expect_fault(BERTH_DRIVE_FAULT_DISABLED, 1);
            expect_recovery();
        } else {
            expect_following(8.0f);
        }
    }
}

static void test_an_error_of_the_drive(void) {
    for (uint32_t i = 0; i < SETUPS; i++) {
        start_enabled(&setups[i]);
        drive_at(8.0f, 600000);
        drive_sim_fail(pair.sim, 0x1000);
        run_for(100000);
        TEST_ASSERT_FALSE(drive_sim_enabled(pair.sim));
        if (setups[i].kind == DRIVE_SIM_ODRIVE) {
            expect_fault(BERTH_DRIVE_FAULT_DEVICE, 0x1000);
            expect_recovery();
        } else { /* nothing on the bus tells, but the speed does */
            TEST_ASSERT_EQUAL(BERTH_DRIVE_ENABLED, status()->state);
            TEST_ASSERT_TRUE(status()->velocity_radps < 7.0f);
        }
    }
}

static void test_a_drive_that_is_not_there(void) {
    for (uint32_t i = 0; i < SETUPS; i++) {
        start(&setups[i]);
        const drive_sim_trouble_t dead = {.dead = true};
        drive_sim_trouble(pair.sim, &dead);
        berth_drive_enable(&pair.drive, pair.now_us);
        run_until(BERTH_DRIVE_FAULT, 1100000);
        expect_fault(BERTH_DRIVE_FAULT_ENABLE, 1);
        expect_recovery();
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_it_enables_and_stands);
    RUN_TEST(test_it_follows_and_travel_is_the_wheels_angle);
    RUN_TEST(test_a_new_zero_of_the_encoder_is_no_travel);
    RUN_TEST(test_far_from_zero_the_speed_tells_the_travel);
    RUN_TEST(test_one_frame_lost_or_doubled);
    RUN_TEST(test_a_drive_that_was_left_running_is_caught);
    RUN_TEST(test_without_cycles_the_drives_own_watchdog_stops_the_wheel);
    RUN_TEST(test_quick_stop_holds_and_is_left_by_enabling);
    RUN_TEST(test_emergency_stop_holds_and_is_left_by_enabling);
    RUN_TEST(test_disabling_takes_the_torque_off);
    RUN_TEST(test_feedback_that_stops_is_a_fault);
    RUN_TEST(test_a_heartbeat_that_stops_is_a_fault);
    RUN_TEST(test_a_dead_drive_is_a_fault);
    RUN_TEST(test_a_drive_that_restarts_is_noticed);
    RUN_TEST(test_an_error_of_the_drive);
    RUN_TEST(test_a_drive_that_is_not_there);
    return UNITY_END();
}
