/* The CANopen wheel drive and the simulated one on one bus, frame by frame in virtual time. The two
 * were written from the standard by different hands and share no code, so what one of them has read
 * wrongly shows here.
 *
 * The bus carries one frame each 200 us, the one with the lowest identifier first, as arbitration
 * has it. A frame can be lost or doubled to order.
 */
#include "berth/drive_cia402.h"
#include "support.h"

#include "bus/drive_sim.h"
#include "cia402_rig.h"

#include "unity.h"

#include <math.h>
#include <stdio.h>

#define TICK_US 200
#define WHEEL_TAU_S 0.004
#define COAST_TAU_S 1.0
#define NEVER UINT32_MAX

typedef struct {
    rig_t rig;
    drive_sim_t *sim;
    double angle_rad;
    double speed_radps;
    double travel_rad; /* what the firmware has told */
    double off_rad;    /* largest difference of the two at a control period */
    uint32_t ticks;
    uint32_t frames; /* that were on the bus */
    uint32_t lose;   /* this one gets lost */
    uint32_t twice;  /* this one comes twice */
    uint32_t step_ticks;
    uint32_t statusword; /* last one on the bus */
    uint32_t nmt_state;
    bool silent; /* no cycle and no sync any more */
} pair_t;

static pair_t pair;

static drive_sim_config_t sim_config(const berth_drive_config_t *config) {
    return (drive_sim_config_t){
        .kind = DRIVE_SIM_CIA402,
        .node = config->node,
        .sign = config->sign,
        .gear_ratio = (double)config->gear_ratio,
        .counts_per_turn = config->counts_per_turn,
        .velocity_units_per_rps = (double)config->velocity_units_per_rps,
    };
}

static void start(berth_drive_config_t config) {
    drive_sim_destroy(pair.sim);
    pair = (pair_t){.lose = NEVER, .twice = NEVER, .step_ticks = 1};
    rig_init(&pair.rig, config);
    const drive_sim_config_t other = sim_config(&config);
    pair.sim = drive_sim_create(&other, pair.rig.now_us);
    TEST_ASSERT_NOT_NULL(pair.sim);
}

void setUp(void) {
    start(rig_config());
}

void tearDown(void) {
    drive_sim_destroy(pair.sim);
    pair.sim = NULL;
}

/* --- the bus -------------------------------------------------------------------------------- */

static void look(const berth_can_frame_t *frame) {
    if (frame->id == 0x180u + pair.rig.drive.config.node) {
        pair.statusword = (uint32_t)frame->data[0] | (uint32_t)frame->data[1] << 8;
    } else if (frame->id == 0x700u + pair.rig.drive.config.node) {
        pair.nmt_state = frame->data[0];
    }
}

static void to_firmware(const berth_can_frame_t *frame) {
    look(frame);
    (void)berth_drive_receive(&pair.rig.drive, frame, pair.rig.now_us);
}

static void to_sim(const berth_can_frame_t *frame) {
    (void)drive_sim_receive(pair.sim, frame, pair.rig.now_us);
}

static void carry_one(void) {
    const berth_can_frame_t *ours = berth_outbox_front(&pair.rig.outbox);
    const berth_can_frame_t *theirs = drive_sim_front(pair.sim);
    if (ours == NULL && theirs == NULL) {
        return;
    }
    const bool from_us = theirs == NULL || (ours != NULL && ours->id < theirs->id);
    const berth_can_frame_t frame = from_us ? *ours : *theirs;
    if (from_us) {
        berth_outbox_pop(&pair.rig.outbox);
    } else {
        drive_sim_sent(pair.sim);
    }
    const uint32_t number = pair.frames++;
    const int times = number == pair.lose ? 0 : number == pair.twice ? 2 : 1;
    for (int i = 0; i < times; i++) {
        if (from_us) {
            to_sim(&frame);
        } else {
            to_firmware(&frame);
        }
    }
}

static void turn_wheel(void) {
    const double step_s = TICK_US * 1e-6;
    const bool held = drive_sim_enabled(pair.sim);
    const double wanted = held ? drive_sim_target_radps(pair.sim) : 0.0;
    const double before = pair.speed_radps;
    pair.speed_radps += (wanted - before) * step_s / (held ? WHEEL_TAU_S : COAST_TAU_S);
    pair.angle_rad += 0.5 * (before + pair.speed_radps) * step_s;
    drive_sim_motion(pair.sim, pair.angle_rad, pair.speed_radps);
}

static void control_period(void) {
    rig_t *rig = &pair.rig;
    if (!pair.silent) {
        berth_drive_cycle(&rig->drive, rig->now_us, &rig->outbox);
        berth_drive_sync(&rig->drive, rig->now_us, &rig->outbox);
    }
    pair.travel_rad += (double)berth_drive_travel(&rig->drive, rig->now_us);
    pair.off_rad = fmax(pair.off_rad, fabs(pair.travel_rad - pair.angle_rad));
}

static void tick(void) {
    pair.rig.now_us += TICK_US;
    if (pair.ticks % (pair.rig.drive.config.period_us / TICK_US) == 0) {
        control_period();
    }
    if (pair.ticks % pair.step_ticks == 0) {
        rig_step(&pair.rig);
    }
    turn_wheel();
    drive_sim_step(pair.sim, pair.rig.now_us);
    carry_one();
    pair.ticks++;
}

static void run_for(int64_t time_us) {
    for (int64_t left_us = time_us; left_us > 0; left_us -= TICK_US) {
        tick();
    }
}

static bool run_until(berth_drive_state_t state, int64_t time_us) {
    for (int64_t left_us = time_us; left_us > 0; left_us -= TICK_US) {
        if (rig_status(&pair.rig)->state == state) {
            return true;
        }
        tick();
    }
    return rig_status(&pair.rig)->state == state;
}

static const char *situation(void) {
    static char text[160];
    const berth_drive_status_t *status = rig_status(&pair.rig);
    (void)snprintf(text, sizeof text, "%s, %s, code 0x%X, statusword 0x%04X, NMT state %u",
                   berth_drive_state_text(status->state), berth_drive_fault_text(status->fault),
                   (unsigned)status->code, (unsigned)pair.statusword, (unsigned)pair.nmt_state);
    return text;
}

static void enable(void) {
    rig_enable(&pair.rig);
    if (!run_until(BERTH_DRIVE_ENABLED, pair.rig.drive.config.enable_timeout_us)) {
        TEST_FAIL_MESSAGE(situation());
    }
    TEST_ASSERT_TRUE(drive_sim_enabled(pair.sim));
    TEST_ASSERT_EQUAL_HEX32(0x27, pair.statusword & 0x6Fu);
}

static void follows(double speed_radps) {
    berth_drive_command(&pair.rig.drive, (float)speed_radps);
    run_for(100000);
    TEST_ASSERT_DOUBLE_WITHIN(0.01, speed_radps, pair.speed_radps);
    TEST_ASSERT_DOUBLE_WITHIN(0.01, speed_radps, (double)rig_status(&pair.rig)->velocity_radps);
}

static void expect_fault(berth_drive_fault_t fault, uint32_t code, int64_t time_us) {
    if (!run_until(BERTH_DRIVE_FAULT, time_us)) {
        TEST_FAIL_MESSAGE(situation());
    }
    rig_expect_fault(&pair.rig, fault, code);
}

static void expect_stand(int64_t time_us) {
    run_for(time_us);
    TEST_ASSERT_DOUBLE_WITHIN(0.02, 0.0, pair.speed_radps);
}

/* --- another master before us --------------------------------------------------------------- */

static void say_to_sim(const char *text) {
    const berth_can_frame_t frame = rig_frame(text);
    to_sim(&frame);
    run_for(2000);
}

static void former_master_operates(void) {
    run_for(50000);
    say_to_sim("605#2F60600003000000");
    say_to_sim("605#23FF600000800000"); /* 8 motor turns/s */
    say_to_sim("605#2B40600006000000");
    say_to_sim("605#2B40600007000000");
    say_to_sim("605#2B4060000F000000");
    run_for(50000);
    TEST_ASSERT_TRUE(drive_sim_enabled(pair.sim));
    TEST_ASSERT_TRUE(pair.speed_radps > 4.0);
}

/* --- tests ---------------------------------------------------------------------------------- */

static void test_enables_from_power_on(void) {
    enable(); /* the boot-up message comes while the first request waits */
    follows(3.0);
    TEST_ASSERT_EQUAL_UINT32(0, rig_status(&pair.rig)->malformed);
    TEST_ASSERT_EQUAL(0, drive_sim_counters(pair.sim).malformed);
    TEST_ASSERT_EQUAL(0, drive_sim_counters(pair.sim).overruns);
}

static void test_enables_from_every_state(void) {
    run_for(50000); /* switch on disabled */
    enable();

    setUp();
    run_for(50000);
    say_to_sim("605#2B40600006000000"); /* ready to switch on */
    enable();

    setUp();
    run_for(50000);
    say_to_sim("605#2B40600006000000");
    say_to_sim("605#2B40600007000000"); /* switched on */
    enable();

    setUp();
    former_master_operates(); /* operation enabled, and turning */
    rig_enable(&pair.rig);
    run_for(100000);
    TEST_ASSERT_FALSE(rig_status(&pair.rig)->state == BERTH_DRIVE_ENABLED);
    TEST_ASSERT_DOUBLE_WITHIN(0.05, 0.0, pair.speed_radps); /* before all else it is stopped */
    TEST_ASSERT_TRUE(run_until(BERTH_DRIVE_ENABLED, 2000000));
    follows(-2.0);

    setUp();
    former_master_operates();
    say_to_sim("605#2B5A600006000000");
    say_to_sim("605#2B40600002000000"); /* quick stop active */
    enable();

    setUp();
    former_master_operates();
    drive_sim_fail(pair.sim, 0x2310); /* fault reaction active */
    enable();

    setUp();
    former_master_operates();
    drive_sim_fail(pair.sim, 0x2310);
    run_for(1000000); /* fault */
    enable();
    follows(1.0);
}

static void test_enables_from_every_nmt_state(void) {
    static const char *const commands[] = {"000#0105", "000#0205", "000#8005", "000#8105",
                                           "000#8205", "000#0100", "000#0200"};
    for (uint32_t i = 0; i < sizeof commands / sizeof commands[0]; i++) {
        setUp();
        run_for(50000);
        say_to_sim(commands[i]);
        enable();
        follows(1.0);
    }
}

static void test_travel_is_the_wheels_own(void) {
    support_random_start();
    for (int variant = 0; variant < 8; variant++) {
        berth_drive_config_t config = rig_config();
        config.has_position = (variant & 1) != 0;
        config.sign = (variant & 2) != 0 ? -1 : 1;
        config.mode = (variant & 4) != 0 ? 3 : 9;
        config.gear_ratio = (float)support_uniform(1.0, 50.0);
        config.velocity_units_per_rps = (float)support_uniform(1000.0, 100000.0);
        start(config);
        /* counts wrap soon */
        pair.angle_rad = 2147483648.0 / 4096.0 / (double)config.gear_ratio * 6.283185307179586;
        enable();
        const double angle = pair.angle_rad;
        const double travel = pair.travel_rad;
        double distance = 0.0;
        double before = 0.0;
        double changes = 0.0; /* sum of squares of the speed's changes */
        for (uint32_t i = 0; i < support_runs(300); i++) {
            const double speed = support_uniform(-15.0, 15.0);
            changes += (speed - before) * (speed - before);
            before = speed;
            berth_drive_command(&pair.rig.drive, (float)speed);
            run_for((int64_t)support_uniform(1000.0, 200000.0));
            distance += fabs(speed) * 0.1;
        }
        berth_drive_command(&pair.rig.drive, 0.0f);
        expect_stand(200000);
        rig_expect_state(&pair.rig, BERTH_DRIVE_ENABLED);
        const double error = (pair.travel_rad - travel) - (pair.angle_rad - angle);
        printf("%s, mode %u: travel off by %.6f rad in %.0f\n",
               config.has_position ? "position" : "speed alone", config.mode, error, distance);
        /* From the speed alone: a ramp begins and ends somewhere between two SYNCs, each of which
         * takes at most an eighth of the change times their distance, with either sign. */
        const double corner = 1.0e-6 * BERTH_CIA402_SYNC_US / 8.0 * sqrt(2.0 * changes);
        const double speed_alone = config.mode == 9 ? 1.0e-4 : 4.0 * corner;
        /* with the position, a count at either end (drive.h) */
        const double count = 6.283185307179586 / 4096.0 / (double)config.gear_ratio;
        const double bound = config.has_position ? 2.0 * count + 1.0e-4 : speed_alone;
        TEST_ASSERT_DOUBLE_WITHIN(bound, 0.0, error);
    }
}

/* With a long control period too, what the control step knows is at most one SYNC old: the wheel's
 * speed changes by 20 rad/s at once, which the measured one tells 10 ms later. */
static void test_feedback_is_fresh_in_long_periods(void) {
    for (int variant = 0; variant < 2; variant++) {
        berth_drive_config_t config = rig_config();
        config.period_us = 50000;
        config.feedback_timeout_us = 200000;
        config.has_position = variant == 1;
        start(config);
        enable();
        for (int i = 0; i < 20; i++) {
            berth_drive_command(&pair.rig.drive, i % 2 == 0 ? 10.0f : -10.0f);
            run_for(200000);
        }
        rig_expect_state(&pair.rig, BERTH_DRIVE_ENABLED);
        printf("off by %.6f rad at most\n", pair.off_rad);
        TEST_ASSERT_TRUE(pair.off_rad > 0.0);
        TEST_ASSERT_DOUBLE_WITHIN(20.0 * 0.0105, 0.0, pair.off_rad);
    }
}

static void test_loss_of_our_heartbeat_stops_the_wheel(void) {
    enable();
    follows(8.0);
    pair.silent = true;
    run_for(250000);
    TEST_ASSERT_TRUE(fabs(pair.speed_radps) > 7.9); /* the drive still waits for us */
    expect_stand(200000);
    TEST_ASSERT_EQUAL(1, drive_sim_counters(pair.sim).watchdog_stops);
    pair.silent = false;
    run_for(100000);
    rig_expect_state(&pair.rig, BERTH_DRIVE_FAULT);
    TEST_ASSERT_DOUBLE_WITHIN(0.02, 0.0, pair.speed_radps); /* and it does not start again */
    berth_drive_reset(&pair.rig.drive);
    enable();
    follows(2.0);
}

static void test_device_faults_and_resets(void) {
    static const uint32_t codes[] = {0x1000, 0x2310, 0x3210, 0x4310, 0x7305, 0xFF01};
    enable();
    for (uint32_t i = 0; i < sizeof codes / sizeof codes[0]; i++) {
        follows(5.0);
        drive_sim_fail(pair.sim, codes[i]);
        expect_fault(BERTH_DRIVE_FAULT_EMERGENCY, codes[i], 20000);
        expect_stand(1000000);
        TEST_ASSERT_FALSE(drive_sim_enabled(pair.sim));
        berth_drive_reset(&pair.rig.drive);
        enable();
    }
}

static void test_trouble_on_the_drives_side(void) {
    enable();
    follows(5.0);
    drive_sim_trouble(pair.sim, &(drive_sim_trouble_t){.mute_heartbeat = true});
    expect_fault(BERTH_DRIVE_FAULT_HEARTBEAT, 0, 310000);
    expect_stand(100000);

    setUp();
    enable();
    follows(5.0);
    drive_sim_trouble(pair.sim, &(drive_sim_trouble_t){.mute_feedback = true});
    expect_fault(BERTH_DRIVE_FAULT_FEEDBACK, 0, 61000);
    expect_stand(100000);

    setUp();
    enable();
    follows(5.0);
    drive_sim_trouble(pair.sim, &(drive_sim_trouble_t){.dead = true});
    expect_fault(BERTH_DRIVE_FAULT_FEEDBACK, 0, 61000);
    drive_sim_trouble(pair.sim, &(drive_sim_trouble_t){.dead = false}); /* boots */
    berth_drive_reset(&pair.rig.drive);
    enable();

    setUp();
    run_for(50000);
    drive_sim_trouble(pair.sim, &(drive_sim_trouble_t){.refuse_setup = true});
    rig_enable(&pair.rig);
    expect_fault(BERTH_DRIVE_FAULT_SETUP, 0x08000022u, 100000);

    setUp();
    drive_sim_trouble(pair.sim, &(drive_sim_trouble_t){.dead = true});
    rig_enable(&pair.rig);
    expect_fault(BERTH_DRIVE_FAULT_SETUP_SILENT, 0x604000u, 400000);
}

static void test_another_master_interferes(void) {
    static const struct {
        const char *frame;
        uint32_t code;
    } cases[] = {{"000#8005", 0x1007Fu},
                 {"000#0205", 0x10004u},
                 {"000#8105", 0x10000u},
                 {"000#8205", 0x10000u}};
    for (uint32_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        setUp();
        enable();
        follows(5.0);
        const berth_can_frame_t frame = rig_frame(cases[i].frame);
        to_sim(&frame);
        if (!run_until(BERTH_DRIVE_FAULT, 310000)) {
            TEST_FAIL_MESSAGE(situation());
        }
        const berth_drive_fault_t fault = rig_status(&pair.rig)->fault;
        TEST_ASSERT_TRUE(fault == BERTH_DRIVE_FAULT_FEEDBACK ||
                         fault == BERTH_DRIVE_FAULT_DISABLED ||
                         fault == BERTH_DRIVE_FAULT_EMERGENCY);
        if (fault == BERTH_DRIVE_FAULT_DISABLED) {
            TEST_ASSERT_EQUAL_HEX32(cases[i].code, rig_status(&pair.rig)->code);
        }
    }
    setUp(); /* pre-operational drives hear no PDO: the quick stop comes by SDO */
    enable();
    follows(5.0);
    const berth_can_frame_t frame = rig_frame("000#8005");
    to_sim(&frame);
    TEST_ASSERT_TRUE(run_until(BERTH_DRIVE_FAULT, 310000));
    expect_stand(150000);
}

static void test_stop_emergency_and_disable(void) {
    enable();
    follows(8.0);
    berth_drive_stop(&pair.rig.drive, &pair.rig.outbox);
    expect_stand(60000);
    run_for(200000);
    rig_expect_state(&pair.rig, BERTH_DRIVE_STOPPED);
    TEST_ASSERT_EQUAL_HEX32(0x07, pair.statusword & 0x6Fu);
    TEST_ASSERT_TRUE(drive_sim_enabled(pair.sim)); /* holds the wheel */
    enable();
    follows(-8.0);
    berth_drive_emergency_stop(&pair.rig.drive, &pair.rig.outbox);
    expect_stand(60000);
    run_for(100000);
    rig_expect_state(&pair.rig, BERTH_DRIVE_STOPPED);
    TEST_ASSERT_EQUAL_HEX32(0x40, pair.statusword & 0x4Fu);
    enable();
    follows(1.0);
    berth_drive_disable(&pair.rig.drive, &pair.rig.outbox);
    run_for(2000);
    TEST_ASSERT_FALSE(drive_sim_enabled(pair.sim));
    run_for(200000);
    TEST_ASSERT_EQUAL_UINT32(127, pair.nmt_state);
    rig_expect_state(&pair.rig, BERTH_DRIVE_OFF);
    pair.silent = true; /* idle boards may be silent: what the drive says of it is no fault now */
    run_for(1000000);
    pair.silent = false;
    enable();
    follows(1.0);
}

/* How many frames enabling takes, and that it takes no frame in particular. */
static void test_any_one_frame_of_the_enabling_may_be_lost_or_doubled(void) {
    for (int from = 0; from < 2; from++) {
        setUp();
        run_for(50000);
        const uint32_t first = pair.frames;
        enable();
        const uint32_t count = pair.frames - first;
        printf("enabling: %u frames, %lld ms\n", count,
               (long long)(pair.rig.now_us - pair.rig.enabled_us) / 1000);
        TEST_ASSERT_TRUE(count > 70 && count < 400);
        for (uint32_t k = 0; k < count + 10; k++) {
            for (int doubled = 0; doubled < 2; doubled++) {
                setUp();
                if (from == 0) {
                    run_for(50000);
                } else {
                    former_master_operates();
                }
                *(doubled != 0 ? &pair.twice : &pair.lose) = pair.frames + k;
                enable();
                follows(2.0);
            }
        }
    }
}

static void test_any_one_frame_of_a_run_may_be_lost_or_doubled(void) {
    setUp();
    run_for(50000);
    enable();
    follows(5.0);
    const uint32_t first = pair.frames;
    run_for(500000);
    const uint32_t count = pair.frames - first;
    for (uint32_t k = 0; k < count; k++) {
        setUp();
        run_for(50000);
        enable();
        *(k % 2 != 0 ? &pair.twice : &pair.lose) = pair.frames + k;
        follows(5.0);
        run_for(500000);
        rig_expect_state(&pair.rig, BERTH_DRIVE_ENABLED);
    }
}

static void test_steps_may_come_late(void) {
    for (uint32_t ticks = 2; ticks < 500; ticks = ticks * 3 + 1) {
        setUp();
        pair.step_ticks = ticks;
        pair.rig.drive.config.enable_timeout_us = 20000000;
        enable();
        follows(4.0);
    }
}

static void test_a_fault_that_comes_again_at_each_reset(void) {
    former_master_operates();
    drive_sim_fail(pair.sim, 0x3210);
    run_for(1000000);
    rig_enable(&pair.rig);
    for (int i = 0; i < 30000 && rig_status(&pair.rig)->state == BERTH_DRIVE_STARTING; i++) {
        tick();
        if ((pair.statusword & 0x4Fu) == 0x40) {
            drive_sim_fail(pair.sim, 0x3210);
        }
    }
    rig_expect_state(&pair.rig, BERTH_DRIVE_FAULT);
    TEST_ASSERT_EQUAL_HEX32(0x3210, rig_status(&pair.rig)->code);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_enables_from_power_on);
    RUN_TEST(test_enables_from_every_state);
    RUN_TEST(test_enables_from_every_nmt_state);
    RUN_TEST(test_travel_is_the_wheels_own);
    RUN_TEST(test_feedback_is_fresh_in_long_periods);
    RUN_TEST(test_loss_of_our_heartbeat_stops_the_wheel);
    RUN_TEST(test_device_faults_and_resets);
    RUN_TEST(test_trouble_on_the_drives_side);
    RUN_TEST(test_another_master_interferes);
    RUN_TEST(test_stop_emergency_and_disable);
    RUN_TEST(test_any_one_frame_of_the_enabling_may_be_lost_or_doubled);
    RUN_TEST(test_any_one_frame_of_a_run_may_be_lost_or_doubled);
    RUN_TEST(test_steps_may_come_late);
    RUN_TEST(test_a_fault_that_comes_again_at_each_reset);
    return UNITY_END();
}
