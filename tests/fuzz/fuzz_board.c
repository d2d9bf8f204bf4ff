/* The whole board, with two simulated drives or none, against an adversary: any frame, any time,
 * any command, a bus that blocks, loses, alters and fails. What must hold is in board_watch.c; what
 * is checked here besides: the wheels' drives have no speed left after a fault, and the same input
 * gives the same frames.
 *
 * FUZZ_LEFT and FUZZ_RIGHT: the drives' protocols, DRIVE_SIM_ODRIVE, _VESC or _CIA402.
 *
 * Input: a head that chooses the configuration, then operations of one byte and their arguments.
 */
#include "board_watch.h"
#include "bus/drive_sim.h"
#include "fuzz.h"
#include "fuzz_plan.h"
#include "input.h"

#include <stddef.h>

#define RUNS_MAX 2000 /* of the board in one input */
#define GRAIN_US 100  /* what a frame takes at least */
#define AGAIN_MAX 3   /* steps at one instant */

typedef struct {
    input_t in;
    berth_board_t board;
    berth_plan_t plan;
    berth_constrained_t workspace;
    watch_t watch;
    berth_board_config_t config;
    drive_sim_t *sims[2];
    double angle_rad[2];
    float slip[2]; /* what a wheel makes of the speed that its drive wants */
    int64_t now_us;
    int runs;
    bool blocked;       /* no frame leaves */
    int drop;           /* so many frames of the board are lost */
    int64_t trouble_us; /* when frames were last blocked or lost, or a drive was in trouble */
    int64_t fault_us;   /* since when the board is in fault */
    int64_t stamp_us;   /* what received frames' own times are off by */
    uint8_t alter_at;   /* which byte of the next feedback is altered, and how */
    uint8_t alter;
} world_t;

/* --- the configuration ------------------------------------------------------------------------ */

static const berth_drive_protocol_t *protocol_of(drive_sim_kind_t kind) {
    switch (kind) {
    case DRIVE_SIM_ODRIVE:
        return &berth_drive_odrive;
    case DRIVE_SIM_VESC:
        return &berth_drive_vesc;
    default:
        return &berth_drive_cia402;
    }
}

typedef struct {
    size_t offset;
    size_t size;
} field_t;

#define FIELD(member)                                                                              \
    {offsetof(berth_board_config_t, member), sizeof(((berth_board_config_t *)NULL)->member)}

/* Everything that may have any value: the check, not the type, refuses what is bad. */
static const field_t fields[] = {
    FIELD(drives[0].node), /* these two not where protocols are mixed: their identifiers overlap */
    FIELD(drives[1].node),
    FIELD(controller.limits.wheel_radius_m),
    FIELD(controller.limits.track_m),
    FIELD(controller.limits.v_max_mps),
    FIELD(controller.limits.omega_max_radps),
    FIELD(controller.limits.wheel_speed_max_radps),
    FIELD(controller.limits.a_max_mps2),
    FIELD(controller.limits.alpha_max_radps2),
    FIELD(controller.avoid.skirt_m),
    FIELD(controller.avoid.v_creep_mps),
    FIELD(controller.avoid.tau_s),
    FIELD(controller.avoid.a_brake_mps2),
    FIELD(controller.avoid.sigma_pose_m),
    FIELD(controller.tracker.rim_change_max_mps2),
    FIELD(drives[0].sign),
    FIELD(drives[0].gear_ratio),
    FIELD(drives[0].pole_pairs),
    FIELD(drives[0].mode),
    FIELD(drives[0].master_node),
    FIELD(drives[0].counts_per_turn),
    FIELD(drives[0].velocity_units_per_rps),
    FIELD(drives[0].feedback_timeout_us),
    FIELD(drives[1].heartbeat_timeout_us),
    FIELD(drives[1].enable_timeout_us),
    FIELD(drives[1].gear_ratio),
    FIELD(odometry.fix_gain),
    FIELD(odometry.fix_jump_m),
    FIELD(odometry.fix_jump_rad),
    FIELD(supervisor.fix_timeout_us),
    FIELD(supervisor.period_late_us),
    FIELD(supervisor.transmit_timeout_us),
    FIELD(supervisor.arm_timeout_us),
    FIELD(supervisor.stop_timeout_us),
    FIELD(supervisor.standing_radps),
    FIELD(supervisor.following_radps),
    FIELD(supervisor.following_us),
    FIELD(regions.body_m),
    FIELD(regions.conservative_m),
    FIELD(regions.regulated_m),
    FIELD(address),
    FIELD(telemetry_periods),
};

static void alter_config(world_t *world) {
    const size_t first = FUZZ_LEFT == FUZZ_RIGHT ? 0 : 2;
    const size_t choice = sizeof fields / sizeof fields[0] - first;
    for (uint32_t count = in_u8(&world->in) % 4u; count > 0; count--) {
        const field_t *field = &fields[first + in_u8(&world->in) % choice];
        const uint32_t bits = in_u32(&world->in);
        memcpy((char *)&world->config + field->offset, &bits, field->size);
    }
}

static void choose_config(world_t *world, uint8_t flags, uint8_t more) {
    berth_board_config_t *config = &world->config;
    *config = berth_board_config_default(0.05f, 0.3f, FUZZ_PERIOD_US);
    config->address = 5;
    config->telemetry_periods = (uint16_t)((more >> 2) & 3u);
    for (uint8_t side = 0; side < 2; side++) {
        berth_drive_config_t *drive = &config->drives[side];
        drive->protocol = protocol_of(side == 0 ? FUZZ_LEFT : FUZZ_RIGHT);
        drive->node = (uint8_t)(1 + side);
        drive->sign = (more & 16u) != 0 && side == 0 ? -1 : 1;
        drive->gear_ratio = (more & 16u) != 0 ? 4.0f : 1.0f;
        drive->mode = (more & 64u) != 0 ? 9 : 3;
        drive->has_position = (more & 128u) == 0;
    }
    if ((flags & 2u) != 0) {
        config->controller.tracker = berth_constrained_tracker(&world->workspace);
    }
    if ((flags & 8u) != 0) {
        config->supervisor.fix_timeout_us = 700000;
    }
    if ((flags & 16u) != 0) {
        config->supervisor.following_radps = 3.0f;
    }
    if ((flags & 32u) != 0) {
        config->controller.limits.a_max_mps2 = 1.0f;
        config->controller.avoid.a_brake_mps2 = 1.0f;
        config->regions.conservative_m = 0.6f;
    }
    if ((more & 32u) != 0) {
        config->controller.limits.wheel_speed_max_radps = 5.0f;
    }
    if ((flags & 128u) != 0) {
        alter_config(world);
    }
}

static bool make_sims(world_t *world) {
    for (int side = 0; side < 2; side++) {
        const berth_drive_config_t *drive = &world->config.drives[side];
        const drive_sim_config_t config = {
            .kind = side == 0 ? FUZZ_LEFT : FUZZ_RIGHT,
            .node = drive->node,
            .sign = drive->sign,
            .gear_ratio = (double)drive->gear_ratio,
            .pole_pairs = drive->pole_pairs,
            .counts_per_turn = drive->counts_per_turn,
            .velocity_units_per_rps = (double)drive->velocity_units_per_rps,
            .feedback_us = 25000,
            .heartbeat_us = 100000,
            .watchdog_us = 200000,
        };
        world->sims[side] = drive_sim_create(&config, world->now_us);
        if (world->sims[side] == NULL) {
            return false;
        }
    }
    return true;
}

static void add_obstacle(world_t *world) {
    const float x = in_some_float(&world->in, -1.0f, 1.0f);
    const float y = in_some_float(&world->in, -1.0f, 1.0f);
    const float hard = in_some_float(&world->in, 0.0f, 0.3f);
    const berth_obstacle_t obstacle = {x, y, hard, hard + 0.2f, hard + 0.5f};
    berth_refusal_t refusal;
    const berth_error_t error = berth_board_add_obstacle(&world->board, &obstacle, &refusal);
    FUZZ_CHECK(error == BERTH_OK || error < 0, "an obstacle is taken or refused");
}

/* All calls of a board whose configuration was refused do nothing. */
static void check_refused(world_t *world) {
    berth_board_t *board = &world->board;
    const berth_can_frame_t frame = in_frame(&world->in);
    const berth_pose_t pose = {0.0f, 0.0f, 0.0f};
    const berth_obstacle_t obstacle = {1.0f, 1.0f, 0.1f, 1.0f, 2.0f};
    berth_refusal_t refusal;
    berth_board_receive(board, &frame, 0);
    berth_board_bus(board, BERTH_CAN_BUS_OFF, true, 0);
    berth_board_command(board, BERTH_COMMAND_ARM, 0);
    berth_board_step(board, 1000000);
    FUZZ_CHECK(berth_board_set_pose(board, &pose, 0) == BERTH_ERROR_STATE &&
                   berth_board_add_obstacle(board, &obstacle, &refusal) == BERTH_ERROR_STATE,
               "a board that was refused takes nothing");
    FUZZ_CHECK(berth_board_front(board) == NULL &&
                   berth_board_deadline(board) == BERTH_TIME_MAX_US &&
                   berth_board_status(board)->state == BERTH_SUPERVISOR_IDLE,
               "a board that was refused does nothing");
}

/* False: the configuration was refused. */
static bool begin(world_t *world) {
    const uint8_t flags = in_u8(&world->in);
    const uint8_t more = in_u8(&world->in);
    static const int64_t begins_us[] = {0, 1000000, INT64_C(1) << 40, BERTH_TIME_MAX_US - 10000000};
    berth_refusal_t refusal;
    world->now_us = begins_us[more & 3u];
    choose_config(world, flags, more);
    world->plan = *fuzz_plan((flags & 1u) != 0);
    const berth_error_t error =
        berth_board_init(&world->board, &world->plan, &world->config, world->now_us, &refusal);
    if (error != BERTH_OK) {
        check_refused(world);
        return false;
    }
    watch_begin(&world->watch, &world->board, &world->config, world->now_us);
    if ((flags & 64u) == 0 && !make_sims(world)) {
        return false;
    }
    if ((flags & 4u) != 0) {
        add_obstacle(world);
    }
    world->slip[0] = world->slip[1] = 1.0f;
    world->trouble_us = world->fault_us = INT64_MIN / 2;
    return true;
}

/* --- calls of the board, each watched --------------------------------------------------------- */

static void note_call(world_t *world) {
    const bool was = world->watch.latched;
    watch_call(&world->watch);
    if (world->watch.latched && !was) {
        world->fault_us = world->now_us;
    }
}

static void give(world_t *world, const berth_can_frame_t *frame) {
    watch_given(&world->watch, frame);
    berth_board_receive(&world->board, frame, world->now_us);
    note_call(world);
}

/* A deadline that has passed already means: once more. Not for ever. */
static void step(world_t *world, int64_t now_us) {
    const bool good = now_us >= world->board.last_us && now_us < BERTH_TIME_MAX_US;
    for (int i = 0; i == 0 || (good && berth_board_deadline(&world->board) <= now_us); i++) {
        FUZZ_CHECK(i < AGAIN_MAX, "the next deadline is ahead");
        berth_board_step(&world->board, now_us);
        watch_step(&world->watch, now_us);
        note_call(world);
    }
    world->runs++;
}

static void send_to_drives(world_t *world, const berth_can_frame_t *frame) {
    if (world->drop > 0) {
        world->drop--;
        world->trouble_us = world->now_us;
        return;
    }
    for (int side = 0; side < 2; side++) {
        if (world->sims[side] != NULL) {
            (void)drive_sim_receive(world->sims[side], frame, world->now_us);
        }
    }
}

static void send_all(world_t *world) {
    if (world->blocked) {
        world->trouble_us = world->now_us;
        return;
    }
    const berth_can_frame_t *frame;
    for (uint32_t i = 0; (frame = berth_board_front(&world->board)) != NULL; i++) {
        FUZZ_CHECK(i < BERTH_OUTBOX_MAX, "the outbox has an end");
        const berth_can_frame_t sent = *frame;
        watch_sent(&world->watch, &sent, world->now_us);
        berth_board_sent(&world->board, world->now_us);
        send_to_drives(world, &sent);
    }
}

static void hear_drives(world_t *world) {
    for (int side = 0; side < 2; side++) {
        const berth_can_frame_t *front;
        while (world->sims[side] != NULL && (front = drive_sim_front(world->sims[side])) != NULL) {
            berth_can_frame_t frame = *front;
            drive_sim_sent(world->sims[side]);
            frame.time_us = world->now_us - world->stamp_us;
            if (world->alter != 0 && frame.length > 0) {
                frame.data[world->alter_at % frame.length] ^= world->alter;
                world->alter = 0;
            }
            give(world, &frame);
        }
    }
}

static void move_wheels(world_t *world, int64_t time_us) {
    for (int side = 0; side < 2; side++) {
        if (world->sims[side] != NULL) {
            const double speed =
                drive_sim_target_radps(world->sims[side]) * (double)world->slip[side];
            world->angle_rad[side] += speed * 1.0e-6 * (double)time_us;
            drive_sim_motion(world->sims[side], world->angle_rad[side], speed);
        }
    }
}

/* As long as a drive may take to stop by itself, when all frames that tell it to were lost. */
static int64_t settle_us(const world_t *world) {
    const berth_drive_config_t *drives = world->config.drives;
    return 700000 + (int64_t)drives[0].heartbeat_timeout_us + drives[1].heartbeat_timeout_us;
}

/* A while after a fault, with nothing in the way, no drive wants to turn its wheel. */
static void check_drives_stopped(const world_t *world) {
    const int64_t since_us =
        world->fault_us > world->trouble_us ? world->fault_us : world->trouble_us;
    if (!world->watch.latched || world->now_us - since_us < settle_us(world)) {
        return;
    }
    for (int side = 0; side < 2; side++) {
        FUZZ_CHECK(world->sims[side] == NULL || drive_sim_target_radps(world->sims[side]) == 0.0,
                   "the wheels stop after a fault");
    }
}

static int64_t next_event(const world_t *world) {
    int64_t next_us = berth_board_deadline(&world->board);
    for (int side = 0; side < 2; side++) {
        if (world->sims[side] != NULL) {
            const int64_t due_us = drive_sim_deadline(world->sims[side]);
            next_us = due_us < next_us ? due_us : next_us;
        }
    }
    return next_us > world->now_us + GRAIN_US ? next_us : world->now_us + GRAIN_US;
}

static void run_to(world_t *world, int64_t until_us) {
    if (until_us > BERTH_TIME_MAX_US) {
        until_us = BERTH_TIME_MAX_US;
    }
    while (world->now_us < until_us && world->runs < RUNS_MAX) {
        int64_t next_us = next_event(world);
        next_us = next_us < until_us ? next_us : until_us;
        move_wheels(world, next_us - world->now_us);
        world->now_us = next_us;
        for (int side = 0; side < 2; side++) {
            if (world->sims[side] != NULL) {
                drive_sim_step(world->sims[side], world->now_us);
            }
        }
        hear_drives(world);
        step(world, world->now_us);
        send_all(world);
        check_drives_stopped(world);
    }
}

/* --- operations ------------------------------------------------------------------------------- */

static void op_command(world_t *world) {
    const uint8_t code = in_u8(&world->in) % 7u;
    watch_command(&world->watch, (berth_command_code_t)code);
    berth_board_command(&world->board, (berth_command_code_t)code, world->now_us);
    note_call(world);
    send_all(world);
}

static void op_command_frame(world_t *world) {
    berth_can_frame_t frame;
    berth_message_encode_command(&frame, world->config.address,
                                 (berth_command_code_t)(in_u8(&world->in) % 7u));
    frame.time_us = world->now_us - world->stamp_us;
    give(world, &frame);
    send_all(world);
}

static berth_pose_t some_pose(world_t *world) {
    berth_pose_t pose;
    pose.x_m = in_some_float(&world->in, 0.0f, 0.6f);
    pose.y_m = in_some_float(&world->in, -0.5f, 0.5f);
    pose.theta_rad = in_some_float(&world->in, -3.2f, 3.2f);
    return pose;
}

static void op_set_pose(world_t *world) {
    const berth_pose_t pose = some_pose(world);
    const berth_supervisor_state_t state = world->board.supervisor.state;
    const berth_error_t error = berth_board_set_pose(&world->board, &pose, world->now_us);
    FUZZ_CHECK(error != BERTH_OK ||
                   (state != BERTH_SUPERVISOR_RUNNING && state != BERTH_SUPERVISOR_STOPPING),
               "a robot in motion is not put elsewhere");
    note_call(world);
}

static void op_fix(world_t *world) {
    const berth_pose_t pose = some_pose(world);
    berth_can_frame_t frame;
    berth_message_encode_pose(&frame, BERTH_MESSAGE_POSE_FIX, world->config.address, &pose);
    frame.time_us = world->now_us - world->stamp_us;
    give(world, &frame);
}

static void op_obstacle(world_t *world) {
    berth_message_obstacle_t obstacle;
    obstacle.id = in_u8(&world->in);
    obstacle.x_m = in_some_float(&world->in, -1.5f, 1.5f);
    obstacle.y_m = in_some_float(&world->in, -1.5f, 1.5f);
    obstacle.radius_m = in_some_float(&world->in, 0.0f, 0.3f);
    obstacle.ttl_ms = in_u16(&world->in);
    berth_can_frame_t frame;
    berth_message_encode_obstacle(&frame, world->config.address, &obstacle);
    frame.time_us = world->now_us - world->stamp_us;
    give(world, &frame);
    send_all(world);
}

/* A frame that the board wants, with any content. */
static void op_wanted_frame(world_t *world) {
    berth_can_filter_t filters[BERTH_BOARD_FILTERS_MAX];
    const uint32_t count = berth_board_filters(&world->board, filters);
    FUZZ_CHECK(count > 0 && count <= BERTH_BOARD_FILTERS_MAX, "the filters fit");
    const berth_can_filter_t *filter = &filters[in_u8(&world->in) % count];
    berth_can_frame_t frame = {.id = filter->id, .extended = filter->extended};
    in_body(&world->in, &frame);
    frame.time_us = world->now_us - world->stamp_us;
    give(world, &frame);
    send_all(world);
}

/* Any frame at all, with any time. */
static void op_any_frame(world_t *world) {
    berth_can_frame_t frame = in_frame(&world->in);
    const uint8_t how = in_u8(&world->in);
    frame.time_us = (how & 1u) != 0 ? (int64_t)in_u64(&world->in) : world->now_us;
    if ((how & 2u) != 0) {
        frame.length = in_u8(&world->in); /* more than a frame can have, from a bad platform */
    }
    give(world, &frame);
    send_all(world);
}

static void op_bus(world_t *world) {
    const uint8_t how = in_u8(&world->in);
    berth_board_bus(&world->board, (berth_can_mode_t)(how & 3u), (how & 4u) != 0, world->now_us);
    note_call(world);
    send_all(world);
}

static void op_trouble(world_t *world) {
    const uint8_t what = in_u8(&world->in);
    drive_sim_t *sim = world->sims[what & 1u];
    world->trouble_us = world->now_us;
    if (sim == NULL) {
        return;
    }
    if ((what & 32u) != 0) {
        drive_sim_fail(sim, in_u8(&world->in));
        return;
    }
    const drive_sim_trouble_t trouble = {
        .mute_heartbeat = (what & 2u) != 0,
        .mute_feedback = (what & 4u) != 0,
        .dead = (what & 8u) != 0,
        .refuse_setup = (what & 16u) != 0,
    };
    drive_sim_trouble(sim, &trouble);
}

static void op_jump(world_t *world) {
    const int64_t span_us = in_span(&world->in);
    if (span_us <= BERTH_TIME_MAX_US - world->now_us) {
        move_wheels(world, span_us < 1000000 ? span_us : 1000000);
        world->now_us += span_us;
    }
    step(world, world->now_us);
    send_all(world);
}

static void op_backwards(world_t *world) {
    const int64_t span_us = in_span(&world->in);
    step(world, world->now_us - span_us);
    send_all(world);
}

static void op_disturb(world_t *world) {
    switch (in_u8(&world->in) % 6u) {
    case 5: /* a bit of the plan in memory turns over */
        world->plan.mpc.q[1] = 41.0f;
        break;
    case 0:
        world->blocked = !world->blocked;
        break;
    case 1:
        world->drop = in_u8(&world->in);
        break;
    case 2:
        world->stamp_us = in_span(&world->in) - 1000;
        break;
    case 3:
        world->alter_at = in_u8(&world->in);
        world->alter = in_u8(&world->in);
        break;
    default:
        world->slip[in_u8(&world->in) & 1u] = in_float(&world->in, -1.0f, 2.0f);
        break;
    }
}

static void operate(world_t *world) {
    switch (in_u8(&world->in) % 16u) {
    case 0:
    case 1:
        run_to(world, world->now_us + 1000 * (1 + (int64_t)in_u8(&world->in)));
        break;
    case 2:
        run_to(world, world->now_us + 20000 * (1 + (int64_t)in_u8(&world->in)));
        break;
    case 3:
        op_jump(world);
        break;
    case 4:
        op_command(world);
        break;
    case 5:
        op_command_frame(world);
        break;
    case 6:
        op_set_pose(world);
        break;
    case 7:
    case 8:
        op_wanted_frame(world);
        break;
    case 9:
        op_any_frame(world);
        break;
    case 10:
        op_bus(world);
        break;
    case 11:
        op_trouble(world);
        break;
    case 12:
        op_disturb(world);
        break;
    case 13:
        op_obstacle(world);
        break;
    case 14:
        op_fix(world);
        break;
    default:
        op_backwards(world);
        break;
    }
}

/* Memory has any content at first: nothing may depend on it. */
static uint32_t play(const uint8_t *data, size_t size, int memory) {
    static world_t world;
    memset(&world.board, memory, sizeof world.board);
    memset(&world.workspace, memory, sizeof world.workspace);
    world = (world_t){.in = {data, size}, .board = world.board, .workspace = world.workspace};
    if (begin(&world)) {
        while (world.in.left > 0 && world.runs < RUNS_MAX) {
            operate(&world);
        }
    }
    drive_sim_destroy(world.sims[0]);
    drive_sim_destroy(world.sims[1]);
    return world.watch.digest;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    const uint32_t digest = play(data, size, 0);
    if (size > 0 && data[size - 1] % 8u == 0) {
        FUZZ_CHECK(play(data, size, 0xA5) == digest, "the same input gives the same frames");
    }
    return 0;
}
