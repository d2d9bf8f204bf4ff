/* One drive of each protocol by itself: any configuration, frames, commands and times in any order,
 * with a simulated drive at the other end or none. What must hold: states change only as drive.h
 * says, a fault keeps its reason, counters add up, no speed is commanded but while ENABLED, numbers
 * are finite, and the drive wants to run again later than now.
 */
#include "berth/reference.h"
#include "bus/drive_sim.h"
#include "drive_says.h"
#include "fuzz.h"
#include "input.h"

#include <stddef.h>

#define STEPS_MAX 4000
#define PERIOD_US 20000

typedef struct {
    input_t in;
    berth_drive_t drive;
    berth_outbox_t outbox;
    drive_sim_t *sim;
    double angle_rad;
    int64_t now_us;
    int64_t cycle_us;
    uint32_t taken, dropped;
    int steps;
    int drop;
    bool full;  /* the outbox is not emptied */
    bool stale; /* some of it is older than the drive's state */
} world_t;

static const berth_drive_protocol_t *const protocols[] = {&berth_drive_odrive, &berth_drive_vesc,
                                                          &berth_drive_cia402};
static const drive_sim_kind_t kinds[] = {DRIVE_SIM_ODRIVE, DRIVE_SIM_VESC, DRIVE_SIM_CIA402};

static void choose_config(world_t *world, uint8_t flags, berth_drive_config_t *config) {
    *config = (berth_drive_config_t){
        .protocol = protocols[flags % 3u],
        .node = 3,
        .sign = (flags & 64u) != 0 ? -1 : 1,
        .gear_ratio = 2.0f,
        .pole_pairs = 7,
        .mode = (flags & 32u) != 0 ? 9 : 3,
        .master_node = 127,
        .has_position = (flags & 16u) == 0,
        .counts_per_turn = 4096,
        .velocity_units_per_rps = 4096.0f,
        .period_us = PERIOD_US,
        .feedback_timeout_us = 100000,
        .heartbeat_timeout_us = 500000,
        .enable_timeout_us = 2000000,
    };
    if ((flags & 128u) == 0) {
        return;
    }
    config->node = in_u8(&world->in);
    config->sign = (int8_t)(in_u8(&world->in) % 5 - 2);
    config->gear_ratio = in_some_float(&world->in, 0.001f, 1000.0f);
    config->pole_pairs = in_u8(&world->in);
    config->mode = (flags & 8u) != 0 ? in_u8(&world->in) : config->mode;
    config->counts_per_turn = in_u32(&world->in);
    config->velocity_units_per_rps = in_some_float(&world->in, 0.001f, 1.0e8f);
    config->feedback_timeout_us = in_u32(&world->in);
    config->heartbeat_timeout_us = in_u32(&world->in);
    config->enable_timeout_us = in_u32(&world->in);
    config->period_us = 1000u + in_u32(&world->in) % 999001u; /* from a checked plan */
}

static void make_sim(world_t *world, uint8_t flags) {
    const berth_drive_config_t *drive = &world->drive.config;
    const drive_sim_config_t config = {
        .kind = kinds[flags % 3u],
        .node = drive->node,
        .sign = drive->sign,
        .gear_ratio = (double)drive->gear_ratio,
        .pole_pairs = drive->pole_pairs,
        .counts_per_turn = drive->counts_per_turn,
        .velocity_units_per_rps = (double)drive->velocity_units_per_rps,
        .feedback_us = 10000,
        .heartbeat_us = 100000,
        .watchdog_us = 200000,
    };
    world->sim = drive_sim_create(&config, world->now_us);
}

/* --- what must hold --------------------------------------------------------------------------- */

/* Bits of the states that one may become. */
#define TO(state) (1u << (unsigned)BERTH_DRIVE_##state)

typedef struct {
    berth_drive_status_t status;
    unsigned allowed;
} before_t;

static before_t before(const world_t *world, unsigned off, unsigned starting, unsigned enabled,
                       unsigned stopped) {
    const unsigned allowed[] = {off, starting, enabled, stopped, TO(FAULT)};
    return (before_t){world->drive.status, allowed[world->drive.status.state]};
}

static before_t same_state(const world_t *world) {
    return before(world, TO(OFF), TO(STARTING), TO(ENABLED), TO(STOPPED));
}

static before_t may_advance(const world_t *world) {
    return before(world, TO(OFF), TO(STARTING) | TO(ENABLED) | TO(FAULT), TO(ENABLED) | TO(FAULT),
                  TO(STOPPED) | TO(FAULT));
}

static void check_frame(const world_t *world, const berth_can_frame_t *frame) {
    said_t said;
    FUZZ_CHECK(drive_says(&world->drive, frame, &said), "every frame is one of the protocol's");
    FUZZ_CHECK(!frame->remote && frame->length <= BERTH_CAN_DATA_MAX, "a data frame");
    if (said.speed && said.motor_rps != 0.0) {
        FUZZ_CHECK(isfinite(said.motor_rps), "a commanded speed is finite");
        FUZZ_CHECK(world->drive.status.state == BERTH_DRIVE_ENABLED || world->stale,
                   "no speed is commanded but while ENABLED");
        const double wanted =
            (double)world->drive.command_radps * (double)world->drive.motor_turns_per_rad;
        FUZZ_CHECK(world->stale ||
                       fabs(said.motor_rps) <= fabs(wanted) * 1.0001 + said.quantum_rps + 1.0e-40,
                   "no more than the command");
    }
    FUZZ_CHECK(!said.enables || world->stale || world->drive.status.state == BERTH_DRIVE_STARTING ||
                   world->drive.status.state == BERTH_DRIVE_ENABLED,
               "no torque is asked for when it is not wanted");
}

static void send_all(world_t *world) {
    const berth_can_frame_t *frame;
    while (!world->full && (frame = berth_outbox_front(&world->outbox)) != NULL) {
        const berth_can_frame_t sent = *frame;
        check_frame(world, &sent);
        berth_outbox_pop(&world->outbox);
        if (world->drop > 0) {
            world->drop--;
        } else if (world->sim != NULL) {
            (void)drive_sim_receive(world->sim, &sent, world->now_us);
        }
    }
    world->stale = world->full;
}

static void check_numbers(const berth_drive_t *drive) {
    const float values[] = {drive->status.velocity_radps, drive->command_radps, drive->travel_rad,
                            drive->gap_rad, drive->fastest_radps};
    FUZZ_CHECK(finite_all(values, sizeof values / sizeof values[0]), "all numbers are finite");
}

static void after(world_t *world, before_t was) {
    const berth_drive_status_t *status = berth_drive_status(&world->drive);
    FUZZ_CHECK((was.allowed & 1u << (unsigned)status->state) != 0, "states change as they may");
    FUZZ_CHECK((status->state == BERTH_DRIVE_FAULT) == (status->fault != BERTH_DRIVE_FAULT_NONE),
               "a fault has its reason");
    if (was.status.state == BERTH_DRIVE_FAULT && status->state == BERTH_DRIVE_FAULT) {
        FUZZ_CHECK(was.status.fault == status->fault && was.status.code == status->code,
                   "the first reason is kept");
    }
    FUZZ_CHECK(
        status->received >= was.status.received && status->malformed >= was.status.malformed &&
            status->saturated >= was.status.saturated && status->refused >= was.status.refused,
        "counters only grow");
    FUZZ_CHECK(status->state == BERTH_DRIVE_ENABLED || status->state == BERTH_DRIVE_STARTING ||
                   world->drive.command_radps == 0.0f || status->state == was.status.state ||
                   status->state == BERTH_DRIVE_OFF,
               "a drive that stops has no command left");
    check_numbers(&world->drive);
    send_all(world);
}

static bool matches(const world_t *world, const berth_can_frame_t *frame) {
    berth_can_filter_t filters[BERTH_DRIVE_FILTERS_MAX];
    const uint32_t count = berth_drive_filters(&world->drive, filters);
    FUZZ_CHECK(count <= BERTH_DRIVE_FILTERS_MAX, "the filters fit");
    for (uint32_t i = 0; i < count; i++) {
        if (filters[i].extended == frame->extended &&
            (frame->id & filters[i].mask) == (filters[i].id & filters[i].mask)) {
            return true;
        }
    }
    return false;
}

/* --- calls ------------------------------------------------------------------------------------ */

static void give(world_t *world, const berth_can_frame_t *frame, int64_t at_us) {
    const before_t was = may_advance(world);
    const bool taken = berth_drive_receive(&world->drive, frame, at_us);
    world->taken += taken ? 1u : 0u;
    FUZZ_CHECK(!taken || matches(world, frame), "a drive takes no frame that it filters out");
    FUZZ_CHECK(world->drive.status.received + world->drive.status.malformed == world->taken,
               "received and malformed add up to the frames taken");
    after(world, was);
}

static void step(world_t *world) {
    const before_t was = may_advance(world);
    berth_drive_step(&world->drive, world->now_us, &world->outbox);
    FUZZ_CHECK(berth_drive_deadline(&world->drive) > world->now_us ||
                   world->now_us == BERTH_TIME_MAX_US,
               "the next deadline is ahead");
    after(world, was);
    world->steps++;
}

static void cycle(world_t *world) {
    const before_t was = same_state(world);
    berth_drive_cycle(&world->drive, world->now_us, &world->outbox);
    berth_drive_sync(&world->drive, world->now_us, &world->outbox);
    after(world, was);
    world->cycle_us = world->now_us + world->drive.config.period_us;
}

static void hear(world_t *world) {
    const berth_can_frame_t *front;
    while (world->sim != NULL && (front = drive_sim_front(world->sim)) != NULL) {
        const berth_can_frame_t frame = *front;
        drive_sim_sent(world->sim);
        give(world, &frame, world->now_us);
    }
}

static int64_t earlier(int64_t a, int64_t b) {
    return a < b ? a : b;
}

static void run_to(world_t *world, int64_t until_us) {
    until_us = earlier(until_us, BERTH_TIME_MAX_US);
    while (world->now_us < until_us && world->steps < STEPS_MAX) {
        int64_t next_us = earlier(berth_drive_deadline(&world->drive), world->cycle_us);
        next_us = world->sim != NULL ? earlier(next_us, drive_sim_deadline(world->sim)) : next_us;
        next_us = next_us > world->now_us + 100 ? next_us : world->now_us + 100;
        next_us = earlier(next_us, until_us);
        const int64_t time_us = next_us - world->now_us;
        world->now_us = next_us;
        if (world->sim != NULL) {
            const double speed = drive_sim_target_radps(world->sim);
            world->angle_rad += speed * 1.0e-6 * (double)time_us;
            drive_sim_motion(world->sim, world->angle_rad, speed);
            drive_sim_step(world->sim, world->now_us);
        }
        hear(world);
        step(world);
        if (world->now_us >= world->cycle_us) {
            cycle(world);
        }
    }
}

static void op_states(world_t *world, uint8_t which) {
    before_t was = same_state(world);
    switch (which % 5u) {
    case 0:
        was = before(world, TO(STARTING), TO(STARTING), TO(ENABLED), TO(STARTING));
        berth_drive_enable(&world->drive, world->now_us);
        break;
    case 1:
        was = before(world, TO(OFF), TO(OFF), TO(OFF), TO(OFF));
        berth_drive_disable(&world->drive, &world->outbox);
        break;
    case 2:
        was = before(world, TO(OFF), TO(STOPPED), TO(STOPPED), TO(STOPPED));
        berth_drive_stop(&world->drive, &world->outbox);
        break;
    case 3:
        was = before(world, TO(OFF), TO(STOPPED), TO(STOPPED), TO(STOPPED));
        berth_drive_emergency_stop(&world->drive, &world->outbox);
        break;
    default:
        was.allowed |= was.status.state == BERTH_DRIVE_FAULT ? TO(OFF) : 0u;
        berth_drive_reset(&world->drive);
        FUZZ_CHECK(world->drive.status.state != BERTH_DRIVE_FAULT, "a reset forgets a fault");
        break;
    }
    after(world, was);
}

static void op_command(world_t *world) {
    const before_t was = same_state(world);
    const float speed = in_some_float(&world->in, -20.0f, 20.0f);
    berth_drive_command(&world->drive, speed);
    const uint32_t refused = isfinite(speed) ? 0u : 1u;
    FUZZ_CHECK(world->drive.status.refused == was.status.refused + refused,
               "what is not finite is refused and counted");
    check_numbers(&world->drive);
    FUZZ_CHECK(world->drive.status.state == was.status.state, "a command changes no state");
}

static void op_wanted_frame(world_t *world) {
    berth_can_filter_t filters[BERTH_DRIVE_FILTERS_MAX];
    const uint32_t count = berth_drive_filters(&world->drive, filters);
    const berth_can_filter_t *filter = &filters[in_u8(&world->in) % count];
    berth_can_frame_t frame = {.id = filter->id, .extended = filter->extended};
    in_body(&world->in, &frame);
    give(world, &frame, world->now_us);
}

static void op_late_frame(world_t *world) {
    berth_can_frame_t frame = in_frame(&world->in);
    if ((world->in.left & 3u) == 0) {
        frame.length = in_u8(&world->in); /* more than a frame can have, from a bad platform */
    }
    const int64_t age_us = in_span(&world->in) % 1000000; /* no older, by board.h */
    give(world, &frame, world->now_us > age_us ? world->now_us - age_us : 0);
}

static void op_travel(world_t *world) {
    const before_t was = same_state(world);
    const float travel = berth_drive_travel(&world->drive, world->now_us);
    FUZZ_CHECK(isfinite(travel), "travel is finite");
    after(world, was);
}

static void op_trouble(world_t *world) {
    const uint8_t what = in_u8(&world->in);
    if (world->sim == NULL) {
        return;
    }
    if ((what & 32u) != 0) {
        drive_sim_fail(world->sim, what);
        return;
    }
    const drive_sim_trouble_t trouble = {
        .mute_heartbeat = (what & 2u) != 0,
        .mute_feedback = (what & 4u) != 0,
        .dead = (what & 8u) != 0,
        .refuse_setup = (what & 16u) != 0,
    };
    drive_sim_trouble(world->sim, &trouble);
}

static void operate(world_t *world) {
    const uint8_t op = in_u8(&world->in);
    switch (op % 12u) {
    case 0:
        op_states(world, op / 12u);
        break;
    case 1:
    case 2:
        run_to(world, world->now_us + 1000 * (1 + (int64_t)in_u8(&world->in)));
        break;
    case 3:
        run_to(world, world->now_us + 20000 * (1 + (int64_t)in_u8(&world->in)));
        break;
    case 4:
        op_command(world);
        break;
    case 5:
        cycle(world);
        break;
    case 6:
    case 7:
        op_wanted_frame(world);
        break;
    case 8:
        op_late_frame(world);
        break;
    case 9:
        op_travel(world);
        break;
    case 10:
        op_trouble(world);
        break;
    default:
        world->full = (op & 16u) != 0;
        world->stale = world->stale || world->full;
        world->drop = (op & 32u) != 0 ? in_u8(&world->in) : 0;
        world->now_us +=
            earlier((op & 64u) != 0 ? in_span(&world->in) : 0, BERTH_TIME_MAX_US - world->now_us);
        step(world);
        break;
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static world_t world;
    world = (world_t){.in = {data, size}};
    const uint8_t flags = in_u8(&world.in);
    const uint8_t more = in_u8(&world.in);
    berth_drive_config_t config;
    berth_refusal_t refusal;
    world.now_us = (more & 1u) != 0 ? BERTH_TIME_MAX_US - 5000000 : 1000;
    choose_config(&world, flags, &config);
    memset(&world.drive, 0xA5, sizeof world.drive);
    if (berth_drive_init(&world.drive, &config, &refusal) != BERTH_OK) {
        return 0;
    }
    if ((more & 2u) == 0) {
        make_sim(&world, flags);
    }
    berth_outbox_reset(&world.outbox);
    while (world.in.left > 0 && world.steps < STEPS_MAX) {
        operate(&world);
    }
    drive_sim_destroy(world.sim);
    return 0;
}
