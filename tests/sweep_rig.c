#include "sweep_rig.h"

#include "candump.h"
#include "support.h"

#include "unity.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#define BAD_PRINTED_MAX 12u

static scenario_t scenario;
static run_plan_t plan;
static sweep_outcome_t plain[SWEEP_KINDS];
static sweep_call_t plain_calls[SWEEP_KINDS][SWEEP_CALLS_MAX];

static struct {
    unsigned cases, carried_on, stopped, bad;
    unsigned reasons[256];
    double clearance_m, rms_m, peak_m, way_m;
    int64_t obeyed_us, stop_us, twitch_us;
} tally;

static void clear_tally(void) {
    memset(&tally, 0, sizeof tally);
    tally.clearance_m = HUGE_VAL;
}

const char *sweep_kind_name(drive_sim_kind_t kind) {
    return bus_setup_drive_name(kind);
}

const sweep_outcome_t *sweep_plain(drive_sim_kind_t kind) {
    return &plain[kind];
}

sweep_call_t sweep_call(drive_sim_kind_t kind, uint64_t k) {
    return plain_calls[kind][k];
}

uint32_t sweep_random(sweep_t *sweep, uint32_t count) {
    sweep->random = sweep->random * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
    return (uint32_t)(sweep->random >> 33) % count;
}

/* --- the tap: what the board hands over ---------------------------------------------------- */

static uint32_t get_u32_le(const uint8_t *data) {
    return (uint32_t)data[0] | (uint32_t)data[1] << 8 | (uint32_t)data[2] << 16 |
           (uint32_t)data[3] << 24;
}

static bool ours(uint32_t node) {
    return node == 1 || node == 2;
}

/* Does this frame set a wheel going, or lets it? */
static bool moves(drive_sim_kind_t kind, const berth_can_frame_t *frame) {
    switch (kind) {
    case DRIVE_SIM_ODRIVE: {
        const uint32_t speed = get_u32_le(frame->data) & 0x7fffffffu;
        const bool closed_loop = (frame->id & 0x1fu) == 0x07 && get_u32_le(frame->data) == 8;
        return !frame->extended && ours(frame->id >> 5) &&
               (((frame->id & 0x1fu) == 0x0d && speed != 0) || closed_loop);
    }
    case DRIVE_SIM_VESC:
        return frame->extended && ours(frame->id & 0xffu) && frame->id >> 8 <= 3 &&
               get_u32_le(frame->data) != 0;
    case DRIVE_SIM_CIA402: {
        const bool command = ours(frame->id - 0x200u);
        const bool word_by_sdo =
            ours(frame->id - 0x600u) && frame->data[1] == 0x40 && frame->data[2] == 0x60;
        const uint32_t word = command ? frame->data[0] : frame->data[4];
        return !frame->extended && ((command && get_u32_le(frame->data + 2) != 0) ||
                                    ((command || word_by_sdo) && (word & 0x0fu) == 0x0fu));
    }
    default:
        return false;
    }
}

static void note_call(sweep_t *sweep, unsigned kind) {
    const uint64_t number = sweep->out->calls++;
    uint32_t *before = &sweep->of_kind[kind];
    if (sweep->calls != NULL && number < SWEEP_CALLS_MAX) {
        sweep->calls[number] =
            (sweep_call_t){(uint8_t)kind, (uint8_t)berth_board_status(&sweep->parts->board)->state,
                           (uint16_t)*before};
    }
    (*before)++;
}

static berth_can_outcome_t tap_send(void *context, const berth_can_frame_t *frame) {
    sweep_t *sweep = context;
    note_call(sweep, CAN_FAULT_SEND);
    const berth_can_outcome_t outcome = sweep->inner.api->send(sweep->inner.context, frame);
    if (outcome == BERTH_CAN_DONE && moves(sweep->what->kind, frame) &&
        berth_board_status(&sweep->parts->board)->state == BERTH_SUPERVISOR_FAULT) {
        sweep->out->late_commands++;
    }
    return outcome;
}

static berth_can_outcome_t tap_receive(void *context, berth_can_frame_t *frame) {
    sweep_t *sweep = context;
    note_call(sweep, CAN_FAULT_RECEIVE);
    return sweep->inner.api->receive(sweep->inner.context, frame);
}

static void tap_state(void *context, berth_can_state_t *state) {
    sweep_t *sweep = context;
    note_call(sweep, CAN_FAULT_STATE);
    sweep->inner.api->state(sweep->inner.context, state);
}

static const berth_can_api_t tap = {tap_send, tap_receive, tap_state};

/* --- the wire ------------------------------------------------------------------------------ */

static can_loop_action_t on_start(void *context, uint64_t index, uint32_t node,
                                  const berth_can_frame_t *frame) {
    sweep_t *sweep = context;
    const sweep_case_t *what = sweep->what;
    sweep->out->frames = index + 1;
    if (!what->has_frame || index != what->frame) {
        return (can_loop_action_t){.deaf = 0};
    }
    sweep->out->node = node;
    sweep->out->frame = *frame;
    can_loop_action_t action = what->action;
    if (what->flip && frame->length > 0) {
        action.flip[sweep_random(sweep, frame->length)] = (uint8_t)(1 + sweep_random(sweep, 255));
    }
    return action;
}

static void on_end(void *context, const can_loop_event_t *event) {
    const sweep_t *sweep = context;
    const int64_t at_us = event->frame.time_us - SESSION_BEGIN_US;
    if (event->node == SESSION_NODE_BOARD && !event->error && sweep->out->fault_us >= 0 &&
        at_us > sweep->out->fault_us + sweep->what->wire_us &&
        moves(sweep->what->kind, &event->frame)) {
        sweep->out->late_wire++;
    }
}

/* --- a session ----------------------------------------------------------------------------- */

static void on_prepare(void *context, session_parts_t *parts) {
    sweep_t *sweep = context;
    const sweep_case_t *what = sweep->what;
    sweep->parts = parts;
    sweep->last = bus_robot_pose(parts->robot);
    sweep->last_us = SESSION_BEGIN_US;
    sweep->inner = parts->can;
    if (what->call.calls != 0) {
        sweep->inner = can_fault_init(&sweep->fault, &parts->can);
        TEST_ASSERT_TRUE(can_fault_order(&sweep->fault, &what->call));
    }
    parts->can = (berth_can_t){&tap, sweep};
    if (what->tx_depth > 0) {
        can_loop_depths(&parts->loop, SESSION_NODE_BOARD, what->tx_depth, CAN_LOOP_RX_MAX);
    }
    can_loop_fault(&parts->loop, on_start, sweep);
    can_loop_observe(&parts->loop, on_end, sweep);
    for (uint32_t i = 0; i < what->strangers; i++) {
        TEST_ASSERT_TRUE(can_loop_attach(&parts->loop, &sweep->strangers[i]));
    }
    for (size_t i = 0; i < 2; i++) {
        bus_robot_order_t order = what->orders[i];
        if (order.at_us > 0) {
            order.at_us += SESSION_BEGIN_US;
            TEST_ASSERT_TRUE(bus_robot_order(parts->robot, &order));
        }
    }
    /* the drives' own limits, as whoever sets them up should set them */
    bus_robot_limit(parts->robot,
                    1.05 *
                        (scenario.robot.v_max_mps +
                         0.5 * scenario.robot.track_m * scenario.robot.omega_max_radps) /
                        scenario.robot.wheel_radius_m);
}

static void watch_wheels(sweep_t *sweep, int64_t now_us) {
    sweep_outcome_t *out = sweep->out;
    const bus_robot_wheels_t wheels = bus_robot_wheels(sweep->parts->robot);
    const bus_robot_result_t *result = bus_robot_result(sweep->parts->robot);
    bool turning = false;
    for (int side = 0; side < 2; side++) {
        const unsigned long commands = result->drives[side].commands;
        turning = turning || fabs(wheels.speed_radps[side]) > 1.0e-9;
        if (commands != sweep->commands[side] || wheels.wanted_radps[side] == 0.0) {
            sweep->commands[side] = commands;
            sweep->command_us[side] = now_us;
        }
        const int64_t obeyed_us = now_us - sweep->command_us[side];
        if (obeyed_us > out->obeyed_us) {
            out->obeyed_us = obeyed_us;
        }
    }
    const int64_t since_us = now_us - SESSION_BEGIN_US;
    if (turning) {
        out->moved_us = since_us;
        if (out->fault_us >= 0 && since_us > out->fault_us + sweep->what->stop_us) {
            out->twitch_us += now_us - sweep->last_us;
        }
    }
    sweep->last_us = now_us;
}

/* One frame waits at most, so that the stranger sends as fast as its rank and its gap allow. */
static void flood(sweep_t *sweep, int64_t since_us) {
    const berth_can_t *can = &sweep->strangers[0];
    if (since_us >= sweep->flood_us || since_us < sweep->flooded_us + sweep->what->flood_gap_us ||
        can_loop_waiting(&sweep->parts->loop, SWEEP_STRANGER) > 0) {
        return;
    }
    berth_can_frame_t frame = {.length = 8};
    sweep->what->flood(sweep, &frame);
    (void)can->api->send(can->context, &frame);
    sweep->flooded_us = since_us;
}

static void on_instant(void *context, session_parts_t *parts, int64_t now_us) {
    sweep_t *sweep = context;
    sweep_outcome_t *out = sweep->out;
    const sweep_case_t *what = sweep->what;
    if (out->fault_us < 0 && berth_board_status(&parts->board)->state == BERTH_SUPERVISOR_FAULT) {
        out->fault_us = now_us - SESSION_BEGIN_US;
    }
    watch_wheels(sweep, now_us);
    const berth_pose_t pose = bus_robot_pose(parts->robot);
    if (out->acted_us >= 0) {
        out->way_m +=
            hypot((double)(pose.x_m - sweep->last.x_m), (double)(pose.y_m - sweep->last.y_m));
    }
    sweep->last = pose;
    flood(sweep, now_us - SESSION_BEGIN_US);
    while (sweep->act < SWEEP_ACTS_MAX && what->acts[sweep->act].act != NULL &&
           now_us >= SESSION_BEGIN_US + what->acts[sweep->act].at_us) {
        if (out->acted_us < 0) {
            out->acted_us = now_us - SESSION_BEGIN_US;
        }
        what->acts[sweep->act].act(sweep, now_us);
        sweep->act++;
    }
}

static void run_case(const sweep_case_t *what, sweep_outcome_t *out, sweep_call_t *calls) {
    bus_setup_t setup;
    scenario_error_t error;
    sweep_t sweep = {.what = what, .out = out, .random = what->seed, .calls = calls};
    bus_setup_init(&setup, false);
    setup.drive = what->kind;
    setup.heartbeat_timeout_us = SWEEP_WATCHDOG_US; /* which is cia402's watchdog */
    TEST_ASSERT_TRUE_MESSAGE(bus_setup_finish(&setup, &error), error.text);
    berth_board_config_t board;
    TEST_ASSERT_TRUE_MESSAGE(
        bus_setup_board_config(&setup, &scenario, SWEEP_PERIOD_US, &board, &error), error.text);
    board.supervisor.following_radps = what->following_radps;
    board.supervisor.following_us = 4 * SWEEP_PERIOD_US;
    *out = (sweep_outcome_t){.fault_us = -1, .acted_us = -1};
    const session_config_t config = {.scenario = &scenario,
                                     .plan = &plan,
                                     .seed = 1,
                                     .setup = &setup,
                                     .board = &board,
                                     .prepare = on_prepare,
                                     .instant = on_instant,
                                     .context = &sweep};
    TEST_ASSERT_TRUE_MESSAGE(session_run(&config, &out->result, &error), error.text);
    out->answered = what->call.calls != 0 ? can_fault_answered(&sweep.fault) : 0;
    out->carried_on = out->result.end == SESSION_IDLE;
}

void sweep_try(const sweep_case_t *what, sweep_outcome_t *out) {
    run_case(what, out, NULL);
}

/* --- what must come of it ------------------------------------------------------------------ */

static uint64_t reason_of(uint8_t fault) {
    if (fault >= BERTH_FAULT_RIGHT) {
        return SWEEP_DRIVE((unsigned)fault - (unsigned)BERTH_FAULT_RIGHT);
    }
    return fault >= BERTH_FAULT_LEFT ? SWEEP_DRIVE((unsigned)fault - (unsigned)BERTH_FAULT_LEFT)
                                     : SWEEP_REASON(fault);
}

static uint32_t side_of(uint8_t fault) {
    return fault >= BERTH_FAULT_RIGHT ? SWEEP_RIGHT : SWEEP_LEFT;
}

static const char *broken_stop(const sweep_case_t *what, const sweep_outcome_t *out) {
    const uint8_t fault = out->result.board.fault;
    if (!what->may_stop) {
        return "has stopped";
    }
    if ((what->reasons & reason_of(fault)) == 0 ||
        (what->sides != 0 && fault >= BERTH_FAULT_LEFT && (what->sides & side_of(fault)) == 0)) {
        return "has stopped with the wrong reason";
    }
    if (out->twitch_us > what->twitch_us) {
        return "wheels turn too long after the fault";
    }
    if (out->late_commands > 0 || out->late_wire > 0) {
        return "a command after the fault";
    }
    return out->result.robot.speed_mps != 0.0 ? "moves at the end" : NULL;
}

static const char *broken_run(const sweep_case_t *what, const sweep_outcome_t *out) {
    const run_summary_t *summary = &out->result.robot.summary;
    const run_summary_t *alone = &plain[what->kind].result.robot.summary;
    if (!what->may_carry_on) {
        return "has carried on";
    }
    if (out->fault_us >= 0) {
        return "has been in fault, and was idle at the end";
    }
    if (out->result.robot.phase != BUS_ROBOT_DONE && !what->may_misread) {
        return "has not done the whole run";
    }
    if (summary->rms_position_error_m > alone->rms_position_error_m + what->rms_m) {
        return "RMS error too large";
    }
    if (summary->peak_position_error_m > alone->peak_position_error_m + what->peak_m) {
        return "peak error too large";
    }
    return fabs(out->result.robot.speed_mps) > 0.01 && !what->may_run_out ? "moves at the end"
                                                                          : NULL;
}

static const char *broken(const sweep_case_t *what, const sweep_outcome_t *out) {
    if (out->result.robot.clearance_m <= what->clearance_m ||
        out->result.robot.summary.collisions > 0) {
        return "too near to the obstacle";
    }
    if (out->obeyed_us > what->obey_us) {
        return "a command was obeyed for too long";
    }
    if (out->result.end == SESSION_FAULT) {
        return broken_stop(what, out);
    }
    return out->carried_on ? broken_run(what, out) : "has never ended";
}

static void count(const sweep_case_t *what, const sweep_outcome_t *out) {
    const run_summary_t *summary = &out->result.robot.summary;
    const run_summary_t *alone = &plain[what->kind].result.robot.summary;
    tally.cases++;
    tally.clearance_m = fmin(tally.clearance_m, out->result.robot.clearance_m);
    tally.obeyed_us = out->obeyed_us > tally.obeyed_us ? out->obeyed_us : tally.obeyed_us;
    if (out->carried_on) {
        tally.carried_on++;
        tally.rms_m =
            fmax(tally.rms_m, summary->rms_position_error_m - alone->rms_position_error_m);
        tally.peak_m =
            fmax(tally.peak_m, summary->peak_position_error_m - alone->peak_position_error_m);
    } else if (out->result.end == SESSION_FAULT) {
        tally.stopped++;
        tally.reasons[out->result.board.fault]++;
        const int64_t stop_us = out->moved_us - out->fault_us;
        if (out->twitch_us == 0 && stop_us > tally.stop_us) {
            tally.stop_us = stop_us;
        }
        tally.twitch_us = out->twitch_us > tally.twitch_us ? out->twitch_us : tally.twitch_us;
    }
}

void sweep_run(const sweep_case_t *what, const char *name, sweep_outcome_t *out) {
    run_case(what, out, NULL);
    const char *wrong = broken(what, out);
    if (wrong != NULL) {
        char text[512];
        char frame[CANDUMP_FRAME_MAX] = "";
        const uint8_t fault = out->result.board.fault;
        if (what->has_frame) {
            (void)candump_frame_text(&out->frame, frame);
        }
        snprintf(text, sizeof text,
                 "%s, %s %s: %s (end %s, phase %s, fault %u %s%s at %.1f ms, moved until %.1f ms, "
                 "obeyed %.1f ms, clearance %.4f m, RMS %.4f m, peak %.4f m, late %u %u)",
                 sweep_kind_name(what->kind), name, frame, wrong, session_end_text(out->result.end),
                 bus_robot_phase_text(out->result.robot.phase), fault, berth_fault_side_text(fault),
                 berth_fault_text(fault), 1e-3 * (double)out->fault_us,
                 1e-3 * (double)out->moved_us, 1e-3 * (double)out->obeyed_us,
                 out->result.robot.clearance_m, out->result.robot.summary.rms_position_error_m,
                 out->result.robot.summary.peak_position_error_m, out->late_commands,
                 out->late_wire);
        if (tally.bad < BAD_PRINTED_MAX) {
            printf("%s\n", text);
        }
        tally.bad++;
    }
    count(what, out);
}

void sweep_report(const char *title) {
    printf("%s: %u cases, %u carried on, %u stopped; clearance at least %.3f m; at most %.4f m RMS "
           "and %.4f m peak more; obeyed %.1f ms, turned %.1f ms after the fault, twitched %.1f "
           "ms\n",
           title, tally.cases, tally.carried_on, tally.stopped, tally.clearance_m, tally.rms_m,
           tally.peak_m, 1e-3 * (double)tally.obeyed_us, 1e-3 * (double)tally.stop_us,
           1e-3 * (double)tally.twitch_us);
    for (unsigned fault = 0; fault < 256; fault++) {
        if (tally.reasons[fault] > 0) {
            printf("    %5u %s%s\n", tally.reasons[fault], berth_fault_side_text((uint8_t)fault),
                   berth_fault_text((uint8_t)fault));
        }
    }
    const unsigned bad = tally.bad;
    clear_tally();
    TEST_ASSERT_EQUAL_UINT_MESSAGE(0, bad, title);
}

/* --- set-up -------------------------------------------------------------------------------- */

sweep_case_t sweep_case(drive_sim_kind_t kind) {
    return (sweep_case_t){
        .kind = kind,
        .may_carry_on = true,
        .stop_us = 2 * SWEEP_PERIOD_US,
        .wire_us = 3000,
        .obey_us = SWEEP_WATCHDOG_US + 5000,
        .rms_m = 0.02,
        .peak_m = 0.05,
    };
}

void sweep_begin(double duration_s) {
    scenario_error_t error;
    TEST_ASSERT_TRUE(scenario_builtin("circle", &scenario));
    scenario.duration_s = duration_s;
    scenario.robot.v_max_mps = 0.5;
    scenario.start.x_m = 1.0;
    scenario.start.y_m = -0.02;
    scenario.start.theta_rad = 1.5;
    scenario.obstacles[0] = (scenario_obstacle_t){0.92, 0.42, 0.10, 0.27, 0.40};
    scenario.obstacle_count = 1;
    TEST_ASSERT_TRUE_MESSAGE(scenario_check(&scenario, &error), error.text);
    TEST_ASSERT_TRUE_MESSAGE(run_plan_make(&scenario, &plan, &error), error.text);
    for (int kind = 0; kind < SWEEP_KINDS; kind++) {
        const sweep_case_t what = sweep_case((drive_sim_kind_t)kind);
        run_case(&what, &plain[kind], plain_calls[kind]);
        TEST_ASSERT_NULL(broken(&what, &plain[kind]));
        TEST_ASSERT_TRUE(plain[kind].result.robot.summary.avoidance_time_s > 0.5);
    }
    clear_tally();
}

void sweep_end(void) {
    run_plan_free(&plan);
}
