#include "robot.h"

#include "berth/board.h"
#include "berth/message.h"
#include "berth/supervisor.h"
#include "refusal.h"
#include "run_meter.h"

#include <math.h>
#include <stdlib.h>

/* With lag, the plant is moved in pieces no longer than this: a command is then in force from the
 * instant on at which it was taken, as nearly as the plant's own parts are short. */
#define PIECE_US 5000

/* No motor turns faster, whatever it is told. */
#define WHEEL_MAX_RADPS 1.0e4

#define NEVER INT64_MAX
#define OWN_MAX 64u
#define FIXES_MAX 16u

_Static_assert(BUS_ROBOT_LATENCY_PERIODS < FIXES_MAX, "measured fixes wait in a ring");
_Static_assert(SCENARIO_OBSTACLES_MAX < OWN_MAX, "all obstacles are announced at once");

/* Where the frame that front gave comes from. */
typedef enum { FROM_NOBODY, FROM_OWN, FROM_LEFT, FROM_RIGHT } source_t;

typedef struct {
    berth_pose_t pose;
    int64_t due_us;
} fix_t;

struct bus_robot {
    bus_robot_config_t config;
    bus_robot_result_t result;
    plant_t plant;
    run_meter_t meter;
    run_summary_t idle_summary; /* of the time outside the run: its clearance alone counts */
    drive_sim_t *drives[2];
    int64_t now_us;        /* what the plant has been moved to */
    int64_t period_end_us; /* of the row that is under way; NEVER outside the run */
    int64_t measure_us;    /* of the next pose fix */
    int64_t announce_us;
    berth_mode_t mode;                 /* last told */
    double v_cmd_mps, omega_cmd_radps; /* what the drives want */
    long steps;                        /* of a whole run */
    run_row_t row;
    fix_t fixes[FIXES_MAX]; /* measured, to be sent */
    unsigned fix_first, fix_count;
    berth_can_frame_t own[OWN_MAX];
    unsigned own_first, own_count;
    source_t source, last_drive;
    double speed_max_radps; /* the drives' own limit */
    bus_robot_order_t orders[BUS_ROBOT_ORDERS_MAX];
    unsigned order_count;
};

/* --- the plant --------------------------------------------------------------------------- */

/* The speed that a wheel is driven at. */
static double wanted_radps(const bus_robot_t *robot, int side) {
    const drive_sim_t *drive = robot->drives[side];
    const double target_radps = drive_sim_enabled(drive) ? drive_sim_target_radps(drive) : 0.0;
    return fmax(-robot->speed_max_radps, fmin(robot->speed_max_radps, target_radps));
}

static void take_targets(bus_robot_t *robot) {
    const double radius_m = robot->config.scenario->robot.wheel_radius_m;
    const double wheel[2] = {wanted_radps(robot, BERTH_LEFT), wanted_radps(robot, BERTH_RIGHT)};
    robot->v_cmd_mps = 0.5 * radius_m * (wheel[BERTH_RIGHT] + wheel[BERTH_LEFT]);
    robot->omega_cmd_radps =
        radius_m * (wheel[BERTH_RIGHT] - wheel[BERTH_LEFT]) / robot->config.scenario->robot.track_m;
}

bus_robot_wheels_t bus_robot_wheels(const bus_robot_t *robot) {
    bus_robot_wheels_t wheels = {
        .wanted_radps = {wanted_radps(robot, BERTH_LEFT), wanted_radps(robot, BERTH_RIGHT)},
    };
    plant_wheel_speeds(&robot->plant, robot->config.scenario->robot.wheel_radius_m,
                       &wheels.speed_radps[BERTH_LEFT], &wheels.speed_radps[BERTH_RIGHT]);
    return wheels;
}

void bus_robot_limit(bus_robot_t *robot, double speed_max_radps) {
    robot->speed_max_radps =
        speed_max_radps > 0.0 ? fmin(speed_max_radps, WHEEL_MAX_RADPS) : WHEEL_MAX_RADPS;
    take_targets(robot);
}

/* What the encoders see. */
static void tell_motion(bus_robot_t *robot) {
    const double radius_m = robot->config.scenario->robot.wheel_radius_m;
    const bus_robot_wheels_t wheels = bus_robot_wheels(robot);
    double angle[2];
    plant_wheels(&robot->plant, radius_m, &angle[BERTH_LEFT], &angle[BERTH_RIGHT]);
    for (int side = 0; side < 2; side++) {
        drive_sim_motion(robot->drives[side], angle[side], wheels.speed_radps[side]);
    }
}

static bool running(const bus_robot_t *robot) {
    return robot->result.phase == BUS_ROBOT_RUNNING;
}

static void finish(bus_robot_t *robot, bus_robot_phase_t phase) {
    if (running(robot)) {
        run_meter_finish(&robot->meter);
        robot->result.run_fault = robot->result.fault;
        robot->meter.summary = &robot->idle_summary;
        robot->result.phase = phase;
        robot->period_end_us = NEVER;
    }
}

static void set_period_end(bus_robot_t *robot, long number) {
    const int64_t end_us =
        robot->result.run_us + (int64_t)(number + 1) * robot->config.plan->period_us;
    robot->period_end_us = end_us > robot->now_us ? end_us : robot->now_us + 1;
}

static void end_period(bus_robot_t *robot) {
    const strategy_output_t output = {robot->v_cmd_mps, robot->omega_cmd_radps, robot->mode};
    const run_sink_t *sink = robot->config.sink;
    run_meter_period(&robot->meter, &output, &robot->row);
    if (sink != NULL) {
        sink->on_row(sink->context, &robot->row);
    }
    const long next = robot->meter.number + 1;
    if (next >= robot->steps) {
        finish(robot, BUS_ROBOT_DONE);
        return;
    }
    set_period_end(robot, next);
    run_meter_row(&robot->meter, &robot->plant, next, &robot->row);
}

static void move(bus_robot_t *robot, int64_t to_us) {
    run_meter_move(&robot->meter, &robot->plant, robot->v_cmd_mps, robot->omega_cmd_radps,
                   1.0e-6 * (double)(to_us - robot->now_us));
    robot->now_us = to_us;
    if (robot->meter.summary->min_clearance_m < robot->result.clearance_m) {
        robot->result.clearance_m = robot->meter.summary->min_clearance_m;
    }
}

/* Moves the plant with the present command. Periods that end at to_us are ended. */
static void advance(bus_robot_t *robot, int64_t to_us) {
    while (robot->now_us < to_us) {
        int64_t end_us = to_us;
        if (!robot->plant.ideal && end_us > robot->now_us + PIECE_US) {
            end_us = robot->now_us + PIECE_US;
        }
        if (end_us > robot->period_end_us) {
            end_us = robot->period_end_us;
        }
        move(robot, end_us);
        if (robot->now_us == robot->period_end_us) {
            end_period(robot);
        }
    }
    tell_motion(robot);
}

/* --- frames out -------------------------------------------------------------------------- */

static void put_own(bus_robot_t *robot, const berth_can_frame_t *frame) {
    if (robot->own_count == OWN_MAX) {
        robot->result.lost++;
        return;
    }
    robot->own[(robot->own_first + robot->own_count) % OWN_MAX] = *frame;
    robot->own_count++;
}

static void measure(bus_robot_t *robot) {
    const int64_t period_us = robot->config.fix_period_us;
    const fix_t fix = {plant_measure(&robot->plant),
                       robot->measure_us + robot->config.fix_latency_us};
    robot->fixes[(robot->fix_first + robot->fix_count) % FIXES_MAX] = fix;
    robot->fix_count++;
    robot->measure_us += period_us;
}

static int64_t fix_due_us(const bus_robot_t *robot) {
    return robot->fix_count > 0 ? robot->fixes[robot->fix_first].due_us : NEVER;
}

static void send_fix(bus_robot_t *robot) {
    berth_can_frame_t frame;
    berth_message_encode_pose(&frame, BERTH_MESSAGE_POSE_FIX, robot->config.address,
                              &robot->fixes[robot->fix_first].pose);
    put_own(robot, &frame);
    robot->fix_first = (robot->fix_first + 1) % FIXES_MAX;
    robot->fix_count--;
    robot->result.fixes++;
}

/* The disc in whole centimetres, upwards, and larger by what rounding may move it. */
static void announce(bus_robot_t *robot) {
    const scenario_t *scenario = robot->config.scenario;
    for (size_t i = 0; i < scenario->obstacle_count; i++) {
        const scenario_obstacle_t *obstacle = &scenario->obstacles[i];
        const double x_m = 0.01 * rint(100.0 * obstacle->x_m);
        const double y_m = 0.01 * rint(100.0 * obstacle->y_m);
        const double moved_m = hypot(x_m - obstacle->x_m, y_m - obstacle->y_m);
        const double radius_m = fmax(obstacle->hard_m - robot->config.body_m, 0.0) + moved_m;
        const berth_message_obstacle_t message = {
            .id = (uint8_t)i,
            .x_m = (float)x_m,
            .y_m = (float)y_m,
            .radius_m = (float)(0.01 * ceil(100.0 * radius_m - 1.0e-6)),
            .ttl_ms = BUS_ROBOT_ANNOUNCE_TTL_MS,
        };
        berth_can_frame_t frame;
        berth_message_encode_obstacle(&frame, robot->config.address, &message);
        put_own(robot, &frame);
        robot->result.announcements++;
    }
    robot->announce_us += BUS_ROBOT_ANNOUNCE_US;
}

/* Our own frames first, then the drives' in turn. */
const berth_can_frame_t *bus_robot_front(bus_robot_t *robot) {
    const berth_can_frame_t *left = drive_sim_front(robot->drives[BERTH_LEFT]);
    const berth_can_frame_t *right = drive_sim_front(robot->drives[BERTH_RIGHT]);
    if (robot->own_count > 0) {
        robot->source = FROM_OWN;
        return &robot->own[robot->own_first];
    }
    if (left != NULL && (right == NULL || robot->last_drive != FROM_LEFT)) {
        robot->source = FROM_LEFT;
        return left;
    }
    robot->source = right != NULL ? FROM_RIGHT : FROM_NOBODY;
    return right;
}

void bus_robot_sent(bus_robot_t *robot) {
    switch (robot->source) {
    case FROM_OWN:
        robot->own_first = (robot->own_first + 1) % OWN_MAX;
        robot->own_count--;
        break;
    case FROM_LEFT:
    case FROM_RIGHT:
        drive_sim_sent(robot->drives[robot->source == FROM_LEFT ? BERTH_LEFT : BERTH_RIGHT]);
        robot->last_drive = robot->source;
        break;
    case FROM_NOBODY:
    default:
        break;
    }
    robot->source = FROM_NOBODY;
}

/* --- what the board tells ---------------------------------------------------------------- */

static void begin_run(bus_robot_t *robot, uint32_t total, int64_t at_us) {
    const int64_t period_us = robot->config.plan->period_us;
    bus_robot_result_t *result = &robot->result;
    result->run_us = at_us - (int64_t)total * period_us;
    if ((long)total >= robot->steps) {
        return; /* somebody started it long ago */
    }
    result->phase = BUS_ROBOT_RUNNING;
    run_meter_begin(&robot->meter, robot->config.scenario, robot->config.plan, &result->summary);
    run_meter_row(&robot->meter, &robot->plant, (long)total, &robot->row);
    set_period_end(robot, (long)total);
}

/* Of two statuses the one that was less late tells better when the reference began: the periods
 * from here on end so much earlier. */
static void align(bus_robot_t *robot, uint32_t total, int64_t at_us) {
    bus_robot_result_t *result = &robot->result;
    const int64_t begin_us = at_us - (int64_t)total * robot->config.plan->period_us;
    const int64_t late_us = result->run_us - begin_us;
    if (late_us <= 0 || late_us >= robot->config.plan->period_us) {
        return; /* a whole period: not lateness, but a board that skipped some */
    }
    result->run_us = begin_us;
    set_period_end(robot, robot->meter.number);
}

/* A board that stops by itself after the scenario's periods says so about when the last one ends
 * here. */
static void leave_run(bus_robot_t *robot, uint8_t fault, int64_t at_us) {
    const int64_t half_us = robot->config.plan->period_us / 2;
    if (running(robot) && fault == BERTH_FAULT_NONE && robot->meter.number == robot->steps - 1 &&
        at_us >= robot->period_end_us - half_us) {
        end_period(robot);
    }
    finish(robot, BUS_ROBOT_LEFT);
}

static void hear_status(bus_robot_t *robot, const berth_message_status_t *status, int64_t at_us) {
    bus_robot_result_t *result = &robot->result;
    result->statuses++;
    result->status_us = at_us;
    result->state = status->state;
    result->fault = status->fault;
    robot->mode = status->mode < RUN_MODES ? (berth_mode_t)status->mode : BERTH_MODE_BLOCKED;
    if (result->phase == BUS_ROBOT_WAITING && status->state == BERTH_SUPERVISOR_RUNNING) {
        begin_run(robot, status->total, at_us);
    } else if (running(robot) && status->state == BERTH_SUPERVISOR_RUNNING) {
        align(robot, status->total, at_us);
    } else if (status->state != BERTH_SUPERVISOR_RUNNING) {
        leave_run(robot, status->fault, at_us);
    }
}

static void hear_pose(bus_robot_t *robot, const berth_pose_t *pose) {
    robot->result.poses++;
    const double error_m =
        hypot((double)pose->x_m - robot->plant.x_m, (double)pose->y_m - robot->plant.y_m);
    if (running(robot) && error_m > robot->result.pose_error_m) {
        robot->result.pose_error_m = error_m;
    }
}

static void hear_board(bus_robot_t *robot, const berth_can_frame_t *frame, int64_t at_us) {
    const uint8_t address = robot->config.address;
    bus_robot_result_t *result = &robot->result;
    berth_message_status_t status;
    berth_message_error_t error;
    berth_pose_t pose;
    bool good = true;
    if (berth_message_is(frame, BERTH_MESSAGE_STATUS, address)) {
        good = berth_message_decode_status(frame, &status);
        if (good) {
            hear_status(robot, &status, at_us);
        }
    } else if (berth_message_is(frame, BERTH_MESSAGE_POSE, address)) {
        good = berth_message_decode_pose(frame, &pose);
        if (good) {
            hear_pose(robot, &pose);
        }
    } else if (berth_message_is(frame, BERTH_MESSAGE_ERROR, address)) {
        good = berth_message_decode_error(frame, &error);
        result->errors += good ? 1 : 0;
    }
    result->malformed += good ? 0 : 1;
}

/* --- events ------------------------------------------------------------------------------ */

static void run_orders(bus_robot_t *robot, int64_t now_us) {
    unsigned done = 0;
    while (done < robot->order_count && robot->orders[done].at_us <= now_us) {
        const bus_robot_order_t *order = &robot->orders[done];
        if (order->fail != 0) {
            drive_sim_fail(robot->drives[order->side], order->fail);
        } else {
            drive_sim_trouble(robot->drives[order->side], &order->trouble);
        }
        done++;
    }
    robot->order_count -= done;
    for (unsigned i = 0; i < robot->order_count; i++) {
        robot->orders[i] = robot->orders[i + done];
    }
}

static int64_t least(int64_t a, int64_t b) {
    return a < b ? a : b;
}

static int64_t silence_due_us(const bus_robot_t *robot) {
    return running(robot) ? robot->result.status_us + robot->config.silence_us : NEVER;
}

int64_t bus_robot_deadline(const bus_robot_t *robot) {
    int64_t due_us = least(robot->measure_us, robot->announce_us);
    due_us = least(due_us, fix_due_us(robot));
    due_us = least(due_us, robot->period_end_us);
    due_us = least(due_us, silence_due_us(robot));
    for (int side = 0; side < 2; side++) {
        due_us = least(due_us, drive_sim_deadline(robot->drives[side]));
    }
    return robot->order_count > 0 ? least(due_us, robot->orders[0].at_us) : due_us;
}

/* All that is due at this instant, which the plant has reached. */
static void run_instant(bus_robot_t *robot) {
    const int64_t now_us = robot->now_us;
    run_orders(robot, now_us);
    for (int side = 0; side < 2; side++) {
        drive_sim_step(robot->drives[side], now_us);
    }
    if (robot->measure_us <= now_us) {
        measure(robot);
    }
    if (fix_due_us(robot) <= now_us) {
        send_fix(robot);
    }
    if (robot->announce_us <= now_us) {
        announce(robot);
    }
    if (silence_due_us(robot) <= now_us) {
        finish(robot, BUS_ROBOT_SILENT);
    }
    take_targets(robot);
}

/* A robot that was kept from running for a while sends the latest of what it has to say. */
static void skip_missed(bus_robot_t *robot, int64_t now_us) {
    const int64_t period_us = robot->config.fix_period_us;
    if (period_us > 0 && robot->measure_us < now_us - period_us) {
        robot->measure_us += (now_us - robot->measure_us) / period_us * period_us;
    }
    if (robot->announce_us < now_us - BUS_ROBOT_ANNOUNCE_US) {
        robot->announce_us = now_us;
    }
}

void bus_robot_step(bus_robot_t *robot, int64_t now_us) {
    skip_missed(robot, now_us);
    for (;;) {
        const int64_t due_us = bus_robot_deadline(robot);
        if (due_us > now_us) {
            break;
        }
        advance(robot, due_us);
        run_instant(robot);
    }
    if (now_us > robot->now_us) {
        advance(robot, now_us);
    }
}

void bus_robot_receive(bus_robot_t *robot, const berth_can_frame_t *frame) {
    const int64_t at_us = frame->time_us > robot->now_us ? frame->time_us : robot->now_us;
    bus_robot_step(robot, at_us);
    for (int side = 0; side < 2; side++) {
        (void)drive_sim_receive(robot->drives[side], frame, at_us);
    }
    take_targets(robot);
    if (frame->time_us >= robot->result.status_us) { /* else overtaken on its way */
        hear_board(robot, frame, at_us);
    }
}

/* --- what it listens to ------------------------------------------------------------------- */

#define ODRIVE_NODE_MASK 0x7e0u       /* node << 5 | command */
#define VESC_NODE_MASK 0xffu          /* packet << 8 | node */
#define CANOPEN_NODE_MASK 0x7fu       /* function << 7 | node */
#define CANOPEN_BROADCAST_MASK 0x77fu /* NMT and SYNC: function 0 or 1, node 0 */
#define CANOPEN_HEARTBEAT 0x700u
#define CANOPEN_FUNCTION_MASK 0x780u

static berth_can_filter_t drive_filter(const drive_sim_config_t *drive) {
    switch (drive->kind) {
    case DRIVE_SIM_VESC:
        return (berth_can_filter_t){drive->node, VESC_NODE_MASK, true};
    case DRIVE_SIM_CIA402:
        return (berth_can_filter_t){drive->node, CANOPEN_NODE_MASK, false};
    default:
        return (berth_can_filter_t){(uint32_t)drive->node << 5, ODRIVE_NODE_MASK, false};
    }
}

uint32_t bus_robot_filters(const drive_sim_config_t drives[2], uint8_t address,
                           berth_can_filter_t filters[BUS_ROBOT_FILTERS_MAX]) {
    static const uint32_t kinds[] = {BERTH_MESSAGE_STATUS, BERTH_MESSAGE_POSE, BERTH_MESSAGE_ERROR};
    uint32_t count = 0;
    for (size_t i = 0; i < 3; i++) {
        filters[count++] =
            (berth_can_filter_t){kinds[i] << 8 | address, BERTH_CAN_EXTENDED_MAX, true};
    }
    bool canopen = false;
    for (int side = 0; side < 2; side++) {
        filters[count++] = drive_filter(&drives[side]);
        canopen = canopen || drives[side].kind == DRIVE_SIM_CIA402;
    }
    if (canopen) { /* to all nodes; and whose heartbeats are watched is not known beforehand */
        filters[count++] = (berth_can_filter_t){0, CANOPEN_BROADCAST_MASK, false};
        filters[count++] = (berth_can_filter_t){CANOPEN_HEARTBEAT, CANOPEN_FUNCTION_MASK, false};
    }
    return count;
}

/* --- life -------------------------------------------------------------------------------- */

static bool check(const bus_robot_config_t *config, scenario_error_t *error) {
    if (config->fix_period_us < 0 || config->fix_period_us > 3600000000) {
        return refuse(error, "fix period: %lld us (allowed: 0 to 3600000000)",
                      (long long)config->fix_period_us);
    }
    if (config->fix_latency_us < 0 ||
        config->fix_latency_us > BUS_ROBOT_LATENCY_PERIODS * config->fix_period_us) {
        return refuse(error, "fix latency: %lld us (allowed: 0 to %d fix periods)",
                      (long long)config->fix_latency_us, BUS_ROBOT_LATENCY_PERIODS);
    }
    return true;
}

bus_robot_t *bus_robot_create(const bus_robot_config_t *config, int64_t now_us,
                              scenario_error_t *error) {
    if (!check(config, error)) {
        return NULL;
    }
    bus_robot_t *robot = calloc(1, sizeof *robot);
    if (robot == NULL) {
        (void)refuse(error, "out of memory");
        return NULL;
    }
    const scenario_t *scenario = config->scenario;
    robot->config = *config;
    robot->result = (bus_robot_result_t){.run_us = -1, .status_us = -1, .clearance_m = HUGE_VAL};
    robot->now_us = now_us;
    robot->speed_max_radps = WHEEL_MAX_RADPS;
    robot->period_end_us = NEVER;
    robot->measure_us = config->fix_period_us > 0 ? now_us : NEVER;
    robot->announce_us = config->announced && scenario->obstacle_count > 0 ? now_us : NEVER;
    robot->steps = lround(scenario->duration_s / scenario->period_s);
    plant_init(&robot->plant, scenario, config->seed);
    run_meter_begin(&robot->meter, scenario, config->plan, &robot->idle_summary);
    for (int side = 0; side < 2; side++) {
        robot->drives[side] = drive_sim_create(&config->drives[side], now_us);
        if (robot->drives[side] == NULL) {
            (void)refuse(error, "out of memory");
            bus_robot_destroy(robot);
            return NULL;
        }
    }
    take_targets(robot);
    tell_motion(robot);
    return robot;
}

void bus_robot_destroy(bus_robot_t *robot) {
    if (robot == NULL) {
        return;
    }
    for (int side = 0; side < 2; side++) {
        if (robot->drives[side] != NULL) {
            drive_sim_destroy(robot->drives[side]);
        }
    }
    free(robot);
}

void bus_robot_end(bus_robot_t *robot) {
    finish(robot, BUS_ROBOT_LEFT);
}

const bus_robot_result_t *bus_robot_result(bus_robot_t *robot) {
    for (int side = 0; side < 2; side++) {
        robot->result.drives[side] = drive_sim_counters(robot->drives[side]);
    }
    robot->result.speed_mps = robot->plant.v_mps;
    return &robot->result;
}

const char *bus_robot_phase_text(bus_robot_phase_t phase) {
    static const char *const texts[] = {
        [BUS_ROBOT_WAITING] = "waiting", [BUS_ROBOT_RUNNING] = "running", [BUS_ROBOT_DONE] = "done",
        [BUS_ROBOT_LEFT] = "left",       [BUS_ROBOT_SILENT] = "silent",
    };
    return texts[phase];
}

berth_pose_t bus_robot_pose(const bus_robot_t *robot) {
    return (berth_pose_t){(float)robot->plant.x_m, (float)robot->plant.y_m,
                          (float)robot->plant.theta_rad};
}

bool bus_robot_order(bus_robot_t *robot, const bus_robot_order_t *order) {
    unsigned place = robot->order_count;
    if (place == BUS_ROBOT_ORDERS_MAX) {
        return false;
    }
    while (place > 0 && robot->orders[place - 1].at_us > order->at_us) {
        robot->orders[place] = robot->orders[place - 1];
        place--;
    }
    robot->orders[place] = *order;
    robot->order_count++;
    return true;
}
