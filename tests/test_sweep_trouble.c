/* Drives, wires and interfaces fail, and strangers talk, at each 50th millisecond of a run: see
 * sweep_rig.h for what must come of it.
 */
#include "sweep_rig.h"

#include "support.h"

#include "unity.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

static sweep_outcome_t out;

static void reset_depth(void);

void setUp(void) {
    reset_depth();
}

void tearDown(void) {}

#define DRIVE(fault) SWEEP_DRIVE(BERTH_DRIVE_FAULT_##fault)
#define REASON(fault) SWEEP_REASON(BERTH_FAULT_##fault)

/* Neither side hears the other any more; the drive that stops by itself for that may say so. */
#define APART                                                                                      \
    (DRIVE(FEEDBACK) | DRIVE(HEARTBEAT) | DRIVE(ENABLE) | DRIVE(SETUP_SILENT) | REASON(TRANSMIT) | \
     REASON(ARM_TIMEOUT))
#define BY_ITSELF (DRIVE(DEVICE) | DRIVE(DISABLED) | DRIVE(EMERGENCY))

/* A bus that takes many frames ahead, as an operating system's does, and one with the three
 * mailboxes of many a CAN controller. */
#define MAILBOXES 3u
static uint32_t tx_depth;

static void reset_depth(void) {
    tx_depth = 0;
}

static sweep_case_t usual(drive_sim_kind_t kind) {
    sweep_case_t what = sweep_case(kind);
    what.tx_depth = tx_depth;
    return what;
}

/* Calls one(kind, at) for each kind and each 50th millisecond of its run. */
static void sweep_time(void (*one)(drive_sim_kind_t kind, int64_t at_us), const char *title) {
    support_random_start();
    const uint32_t stride = 100 / support_runs(100);
    for (int kind = 0; kind < SWEEP_KINDS; kind++) {
        const uint32_t steps =
            (uint32_t)(sweep_plain((drive_sim_kind_t)kind)->result.end_us / SWEEP_PERIOD_US);
        for (uint32_t i = support_index(stride); i < steps; i += stride) {
            /* anywhere in it: everything of ours happens at whole periods */
            one((drive_sim_kind_t)kind,
                1 + (int64_t)i * SWEEP_PERIOD_US + (int64_t)support_index(SWEEP_PERIOD_US));
        }
    }
    sweep_report(title);
}

/* Trouble that goes away, and errors of drives, only make arming take longer. */
static bool arming(drive_sim_kind_t kind, int64_t at_us) {
    return at_us < sweep_plain(kind)->result.armed_us;
}

/* Is there too little of the run left for this to be found out? */
static bool too_late(drive_sim_kind_t kind, int64_t at_us, int64_t takes_us) {
    return at_us + takes_us > sweep_plain(kind)->result.end_us - SWEEP_PERIOD_US;
}

/* --- drives ------------------------------------------------------------------------------ */

static void trouble_at(drive_sim_kind_t kind, int64_t at_us, const bus_robot_order_t *order,
                       int64_t takes_us, uint64_t reasons, const char *name) {
    char text[80];
    for (int side = 0; side < 2; side++) {
        sweep_case_t what = usual(kind);
        what.orders[0] = *order;
        what.orders[0].at_us = at_us;
        what.orders[0].side = side;
        what.may_stop = reasons != 0;
        what.may_carry_on = reasons == 0 || too_late(kind, at_us, takes_us);
        what.reasons = reasons;
        what.sides = side == BERTH_LEFT ? SWEEP_LEFT : SWEEP_RIGHT;
        snprintf(text, sizeof text, "%s %s at %.1f ms", side == BERTH_LEFT ? "left" : "right", name,
                 1.0e-3 * (double)at_us);
        sweep_run(&what, text, &out);
    }
}

static void dead_at(drive_sim_kind_t kind, int64_t at_us) {
    const bus_robot_order_t order = {.trouble = {.dead = true}};
    trouble_at(kind, at_us, &order, 120000, APART, "dead");
}

static void mute_feedback_at(drive_sim_kind_t kind, int64_t at_us) {
    const bus_robot_order_t order = {.trouble = {.mute_feedback = true}};
    trouble_at(kind, at_us, &order, 120000, APART, "without feedback");
}

static void mute_heartbeat_at(drive_sim_kind_t kind, int64_t at_us) {
    const bus_robot_order_t order = {.trouble = {.mute_heartbeat = true}};
    const bool has = kind != DRIVE_SIM_VESC;
    trouble_at(kind, at_us, &order, 300000, has ? APART : 0, "without heartbeat");
}

/* A vesc does not say so: see below. */
static void error_at(drive_sim_kind_t kind, int64_t at_us) {
    const bus_robot_order_t order = {.fail = 0x2310};
    if (kind != DRIVE_SIM_VESC && !arming(kind, at_us)) {
        trouble_at(kind, at_us, &order, 150000, BY_ITSELF, "error");
    }
}

/* A vesc that fails lets go of its wheel for half a second, and obeys again. The board, which is
 * told by nobody, sees the robot turn and steers against it; or it watches whether wheels follow.
 */
static void silent_error_at(drive_sim_kind_t kind, int64_t at_us) {
    for (size_t i = 0; kind == DRIVE_SIM_VESC && i < 4; i++) {
        char text[80];
        sweep_case_t what = usual(kind);
        const bool watched = i >= 2;
        what.orders[0] = (bus_robot_order_t){.at_us = at_us, .side = (int)(i & 1), .fail = 1};
        what.following_radps = watched ? 2.0f : 0.0f;
        what.may_stop = watched;
        what.reasons = REASON(FOLLOWING);
        what.may_carry_on = true; /* a wheel that was to stand misses nothing */
        what.rms_m = 0.08;
        what.peak_m = 0.15;
        snprintf(text, sizeof text, "%s lets go at %.1f ms", i & 1 ? "right" : "left",
                 1.0e-3 * (double)at_us);
        sweep_run(&what, text, &out);
    }
}

static void test_dead_drive(void) {
    sweep_time(dead_at, "a drive goes dead");
}

static void test_mute_feedback(void) {
    sweep_time(mute_feedback_at, "a drive's feedback stops");
}

static void test_mute_heartbeat(void) {
    sweep_time(mute_heartbeat_at, "a drive's heartbeat stops");
}

static void test_drive_error(void) {
    sweep_time(error_at, "a drive fails and says so");
}

static void test_silent_drive_error(void) {
    sweep_time(silent_error_at, "a drive fails and does not say so");
}

/* --- the bus ----------------------------------------------------------------------------- */

static void cut_board(sweep_t *sweep, int64_t now_us) {
    (void)now_us;
    can_loop_cut(&sweep->parts->loop, SESSION_NODE_BOARD, true);
}

static void cut_robot(sweep_t *sweep, int64_t now_us) {
    (void)now_us;
    can_loop_cut(&sweep->parts->loop, SESSION_NODE_ROBOT, true);
}

static void mend(sweep_t *sweep, int64_t now_us) {
    (void)now_us;
    can_loop_cut(&sweep->parts->loop, SESSION_NODE_BOARD, false);
    can_loop_cut(&sweep->parts->loop, SESSION_NODE_ROBOT, false);
}

static void board_off(sweep_t *sweep, int64_t now_us) {
    (void)now_us;
    can_loop_bus_off(&sweep->parts->loop, SESSION_NODE_BOARD);
}

static void board_recovers(sweep_t *sweep, int64_t now_us) {
    (void)now_us;
    can_loop_recover(&sweep->parts->loop, SESSION_NODE_BOARD);
}

static void robot_off(sweep_t *sweep, int64_t now_us) {
    (void)now_us;
    can_loop_bus_off(&sweep->parts->loop, SESSION_NODE_ROBOT);
}

static void robot_recovers(sweep_t *sweep, int64_t now_us) {
    (void)now_us;
    can_loop_recover(&sweep->parts->loop, SESSION_NODE_ROBOT);
}

static void board_down(sweep_t *sweep, int64_t now_us) {
    (void)now_us;
    can_loop_down(&sweep->parts->loop, SESSION_NODE_BOARD);
}

static void board_up(sweep_t *sweep, int64_t now_us) {
    (void)now_us;
    can_loop_up(&sweep->parts->loop, SESSION_NODE_BOARD);
}

typedef struct {
    const char *name;
    void (*begins)(sweep_t *sweep, int64_t now_us);
    void (*ends)(sweep_t *sweep, int64_t now_us);
    int64_t takes_us; /* until it is found out, at the longest */
    uint64_t reasons;
} break_t;

static const break_t breaks[] = {
    {"the board's wire is cut", cut_board, mend, 120000, APART | BY_ITSELF},
    {"the robot's wire is cut", cut_robot, mend, 120000, APART | BY_ITSELF},
    {"the board is bus-off", board_off, board_recovers, 0, REASON(BUS_OFF)},
    {"the robot is bus-off", robot_off, robot_recovers, 120000, APART | BY_ITSELF},
    {"the board's interface is down", board_down, board_up, 0, REASON(BUS_DOWN)},
};
#define BREAKS (sizeof breaks / sizeof breaks[0])

/* 0: it does not end. 2 ms and 20 ms: too short for the feedback's watchdog. */
static const int64_t lasts_us[] = {0, 2000, 20000, 150000, 600000};

/* What the bus had taken before it was stuck leaves when it is free again, in its order: commands
 * that are old by then, telemetry, which lets all that the drives have to say go first, and the
 * stop. A vesc obeys the first until it hears the last. */
static void await_end(sweep_case_t *what, int64_t last_us) {
    what->wire_us += last_us + 2000;
    what->twitch_us = 25000;
}

static void break_at(drive_sim_kind_t kind, int64_t at_us) {
    for (size_t b = 0; b < BREAKS; b++) {
        for (size_t l = 0; l < sizeof lasts_us / sizeof lasts_us[0]; l++) {
            char text[96];
            const break_t *broken = &breaks[b];
            const int64_t last_us = lasts_us[l];
            sweep_case_t what = usual(kind);
            /* the board looks once a period at least */
            const bool found =
                last_us == 0 || (last_us > broken->takes_us && last_us > SWEEP_PERIOD_US);
            what.acts[0] = (sweep_act_t){at_us, broken->begins};
            if (last_us > 0) {
                what.acts[1] = (sweep_act_t){at_us + last_us, broken->ends};
            }
            what.may_stop = true;
            what.may_carry_on = !found || too_late(kind, at_us, broken->takes_us) ||
                                (last_us > 0 && arming(kind, at_us));
            what.reasons = broken->reasons;
            what.stop_us += SWEEP_WATCHDOG_US;
            await_end(&what, last_us);
            snprintf(text, sizeof text, "%s at %.1f ms for %.1f ms", broken->name,
                     1.0e-3 * (double)at_us, 1.0e-3 * (double)last_us);
            sweep_run(&what, text, &out);
        }
    }
}

static void test_bus_broken(void) {
    sweep_time(break_at, "the bus is cut, off or down");
    tx_depth = MAILBOXES;
    sweep_time(break_at, "the bus is cut, off or down; three mailboxes");
}

/* --- strangers ---------------------------------------------------------------------------- */

/* It goes before all others, or behind them. */
static const berth_can_frame_t loud = {.id = 0x001, .length = 8};
static const berth_can_frame_t meek = {.id = 0x1fffffff, .extended = true, .length = 8};

static void babble(sweep_t *sweep, const berth_can_frame_t *frame, int64_t until_us) {
    TEST_ASSERT_TRUE(can_loop_babble(&sweep->parts->loop, SWEEP_STRANGER, frame, until_us));
}

static void babble_meekly(sweep_t *sweep, int64_t now_us) {
    babble(sweep, &meek, now_us + 400000);
}

static void babble_shortly(sweep_t *sweep, int64_t now_us) {
    babble(sweep, &loud, now_us + 40000);
}

static void babble_long(sweep_t *sweep, int64_t now_us) {
    babble(sweep, &loud, now_us + 400000);
}

static void babble_longest(sweep_t *sweep, int64_t now_us) {
    babble(sweep, &loud, now_us + 2000000);
}

static void babble_at(drive_sim_kind_t kind, int64_t at_us) {
    static void (*const how[])(sweep_t *sweep, int64_t now_us) = {babble_meekly, babble_shortly,
                                                                  babble_long, babble_longest};
    static const int64_t babbles_us[] = {0, 40000, 400000, 2000000};
    static const char *const names[] = {"meek", "40 ms loud", "400 ms loud", "2 s loud"};
    for (size_t i = 0; i < 4; i++) {
        char text[80];
        const bool meek_one = i == 0;
        const bool found = i >= 2;
        sweep_case_t what = usual(kind);
        what.strangers = 1;
        what.acts[0] = (sweep_act_t){at_us, how[i]};
        what.may_stop = !meek_one;
        what.may_carry_on = !found || too_late(kind, at_us, 120000) || arming(kind, at_us);
        what.reasons = APART | BY_ITSELF;
        what.stop_us += meek_one ? 0 : SWEEP_WATCHDOG_US;
        await_end(&what, babbles_us[i]);
        snprintf(text, sizeof text, "%s babble at %.1f ms", names[i], 1.0e-3 * (double)at_us);
        sweep_run(&what, text, &out);
    }
}

static void test_babble(void) {
    sweep_time(babble_at, "a stranger babbles");
    tx_depth = MAILBOXES;
    sweep_time(babble_at, "a stranger babbles; three mailboxes");
}

/* The frames that the board listens to, by kind of drive. */
static berth_can_frame_t heard_frame(sweep_t *sweep) {
    static const uint16_t canopen[] = {0x080, 0x180, 0x280, 0x580, 0x700};
    static const uint8_t odrive[] = {0x01, 0x09};
    static const uint8_t vesc[] = {9, 27};
    static const uint32_t berth[] = {BERTH_MESSAGE_COMMAND, BERTH_MESSAGE_POSE_FIX,
                                     BERTH_MESSAGE_OBSTACLE};
    const uint32_t node = 1 + sweep_random(sweep, 2);
    berth_can_frame_t frame = {.length = 8};
    if (sweep_random(sweep, 3) == 0) {
        frame.extended = true;
        frame.id = berth[sweep_random(sweep, 3)] << 8;
    } else if (sweep->what->kind == DRIVE_SIM_ODRIVE) {
        frame.id = node << 5 | odrive[sweep_random(sweep, 2)];
    } else if (sweep->what->kind == DRIVE_SIM_VESC) {
        frame.extended = true;
        frame.id = (uint32_t)vesc[sweep_random(sweep, 2)] << 8 | node;
    } else {
        frame.id = canopen[sweep_random(sweep, 5)] + node;
    }
    return frame;
}

/* What no receiver may take for good: a wrong length or type, or a number that is none. */
static void malformed(sweep_t *sweep, berth_can_frame_t *frame) {
    static const uint8_t nan_le[] = {0, 0, 0xc0, 0x7f};
    *frame = heard_frame(sweep);
    for (size_t i = 0; i < 8; i++) {
        frame->data[i] = (uint8_t)sweep_random(sweep, 256);
    }
    const bool estimates =
        !frame->extended && sweep->what->kind == DRIVE_SIM_ODRIVE && (frame->id & 0x1fu) == 0x09;
    switch (sweep_random(sweep, 3)) {
    case 0:
        frame->remote = true;
        frame->length = (uint8_t)sweep_random(sweep, 9);
        break;
    case 1:
        if (estimates) {
            memcpy(frame->data + 4 * sweep_random(sweep, 2), nan_le, 4);
            break;
        }
        frame->length = 0;
        break;
    default:
        frame->length = frame->extended && frame->id >> 8 == 27 ? 5 : 3;
        break;
    }
}

#define FLOOD_US 500000
static unsigned long malformed_counted;

static void flood_now(sweep_t *sweep, int64_t now_us) {
    sweep->flood_us = now_us - SESSION_BEGIN_US + FLOOD_US;
}

/* A few hundred a second leave the bus room and must do nothing at all. As fast as the bus takes
 * them, those that outrank the commands keep these from leaving. */
static void flood_at(drive_sim_kind_t kind, int64_t at_us) {
    for (size_t i = 0; i < 2; i++) {
        char text[80];
        const bool full = i == 1;
        sweep_case_t what = usual(kind);
        what.strangers = 1;
        what.flood = malformed;
        what.flood_gap_us = full ? 0 : 1000;
        what.acts[0] = (sweep_act_t){at_us, flood_now};
        what.seed = support_index(UINT32_MAX);
        what.may_stop = full;
        what.reasons = APART | BY_ITSELF;
        if (full) {
            what.stop_us += SWEEP_WATCHDOG_US;
            await_end(&what, FLOOD_US);
        }
        snprintf(text, sizeof text, "malformed frames, %s, at %.1f ms, seed %u",
                 full ? "at full rate" : "now and then", 1.0e-3 * (double)at_us,
                 (unsigned)what.seed);
        sweep_run(&what, text, &out);
        malformed_counted += out.result.board.malformed;
    }
}

static void test_malformed(void) {
    malformed_counted = 0;
    sweep_time(flood_at, "a stranger's malformed frames under our identifiers");
    tx_depth = MAILBOXES;
    sweep_time(flood_at, "a stranger's malformed frames; three mailboxes");
    printf("    %lu of them counted as such\n", malformed_counted);
    TEST_ASSERT_TRUE(malformed_counted > 200u * support_runs(100));
}

/* --- commands by frame --------------------------------------------------------------------- */

static berth_command_code_t code;       /* of the next case */
static can_loop_action_t code_accident; /* that happens to its frame */

static void send_code(sweep_t *sweep, int64_t now_us) {
    const can_loop_rule_t rule = {
        .node = SWEEP_STRANGER, .count = 1, .probability = 1.0, .action = code_accident};
    berth_can_frame_t frame;
    (void)now_us;
    TEST_ASSERT_TRUE(can_loop_rule(&sweep->parts->loop, &rule));
    berth_message_encode_command(&frame, 0, code);
    TEST_ASSERT_EQUAL_INT(BERTH_CAN_DONE,
                          sweep->strangers[0].api->send(sweep->strangers[0].context, &frame));
}

static void emergency_stop_at(drive_sim_kind_t kind, int64_t at_us) {
    static const can_loop_action_t accidents[] = {
        {.deaf = 0}, {.copies = 1}, {.delay_us = 30000}, {.corrupt = true}, {.deaf = UINT32_MAX}};
    for (size_t i = 0; i < sizeof accidents / sizeof accidents[0]; i++) {
        char text[80];
        const bool lost = accidents[i].deaf != 0;
        sweep_case_t what = usual(kind);
        code = BERTH_COMMAND_EMERGENCY_STOP;
        code_accident = accidents[i];
        what.strangers = 1;
        what.acts[0] = (sweep_act_t){at_us, send_code};
        what.may_stop = !lost;
        what.may_carry_on = lost || too_late(kind, at_us, 31000);
        what.reasons = REASON(EMERGENCY_STOP);
        snprintf(text, sizeof text, "emergency stop at %.1f ms, accident %u",
                 1.0e-3 * (double)at_us, (unsigned)i);
        sweep_run(&what, text, &out);
    }
}

static void test_emergency_stop_by_frame(void) {
    sweep_time(emergency_stop_at, "an emergency stop by frame: good, doubled, late, broken, lost");
}

/* A command that the state does not allow does nothing. */
static void wrong_command_at(drive_sim_kind_t kind, int64_t at_us) {
    static const berth_command_code_t codes[] = {BERTH_COMMAND_ARM, BERTH_COMMAND_RESET,
                                                 BERTH_COMMAND_START};
    for (size_t i = 0; i < 3 && !too_late(kind, at_us, SWEEP_PERIOD_US); i++) {
        char text[80];
        sweep_case_t what = usual(kind);
        code = codes[i];
        code_accident = (can_loop_action_t){.deaf = 0};
        what.strangers = 1;
        what.acts[0] = (sweep_act_t){at_us, send_code};
        snprintf(text, sizeof text, "command %u at %.1f ms", (unsigned)code,
                 1.0e-3 * (double)at_us);
        sweep_run(&what, text, &out);
        TEST_ASSERT_TRUE(out.result.board.commands_refused == 1);
    }
}

static void test_commands_out_of_place(void) {
    sweep_time(wrong_command_at, "a command that the state does not allow");
}

/* --- the drives' own watchdogs -------------------------------------------------------------- */

/* The wire is cut while the robot runs: nobody can tell the drives anything any more. */
static void test_without_the_bus_the_drives_stop(void) {
    for (int kind = 0; kind < SWEEP_KINDS; kind++) {
        for (size_t b = 0; b < BREAKS; b++) {
            sweep_case_t what = sweep_case((drive_sim_kind_t)kind);
            const int64_t at_us = 1505000; /* just after the commands have got through */
            what.acts[0] = (sweep_act_t){at_us, breaks[b].begins};
            what.may_stop = true;
            what.may_carry_on = false;
            what.reasons = breaks[b].reasons;
            what.stop_us += SWEEP_WATCHDOG_US;
            sweep_run(&what, breaks[b].name, &out);
            const double stop_ms = 1.0e-3 * (double)(out.moved_us - out.acted_us);
            printf("%s, %s: fault after %.1f ms (%s), wheels stand after %.1f ms and %.3f m\n",
                   sweep_kind_name(what.kind), breaks[b].name,
                   1.0e-3 * (double)(out.fault_us - out.acted_us),
                   berth_fault_text(out.result.board.fault), stop_ms, out.way_m);
            TEST_ASSERT_EQUAL_UINT(1, out.result.robot.drives[BERTH_LEFT].watchdog_stops);
            TEST_ASSERT_EQUAL_UINT(1, out.result.robot.drives[BERTH_RIGHT].watchdog_stops);
            TEST_ASSERT_TRUE(stop_ms > 1.0e-3 * (SWEEP_WATCHDOG_US - 2 * SWEEP_PERIOD_US));
            TEST_ASSERT_TRUE(stop_ms <= 1.0e-3 * SWEEP_WATCHDOG_US + 5.0);
            TEST_ASSERT_TRUE(out.way_m <= 0.5 * 1.0e-3 * stop_ms + 0.001); /* v_max */
        }
    }
    sweep_report("the drives' own watchdogs");
}

int main(void) {
    UNITY_BEGIN();
    sweep_begin(3.0);
    RUN_TEST(test_dead_drive);
    RUN_TEST(test_mute_feedback);
    RUN_TEST(test_mute_heartbeat);
    RUN_TEST(test_drive_error);
    RUN_TEST(test_silent_drive_error);
    RUN_TEST(test_bus_broken);
    RUN_TEST(test_babble);
    RUN_TEST(test_malformed);
    RUN_TEST(test_emergency_stop_by_frame);
    RUN_TEST(test_commands_out_of_place);
    RUN_TEST(test_without_the_bus_the_drives_stop);
    sweep_end();
    return UNITY_END();
}
