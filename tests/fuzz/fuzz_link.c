/* A board and its drives behind link.h, on a bus that answers what it likes: room or none, failed,
 * frames or none, any mode. What must hold: what board_watch.c checks; a failed bus is a fault in
 * the same run; outcomes are counted; a flood does not keep the board from its step; and the link
 * does not want to run for ever at one instant.
 */
#include "berth/link.h"
#include "board_watch.h"
#include "bus/drive_sim.h"
#include "can_fault.h"
#include "fuzz.h"
#include "fuzz_plan.h"
#include "input.h"

#define RUNS_MAX 2000
#define AGAIN_MAX 5

typedef struct {
    input_t in;
    berth_board_t board;
    berth_board_config_t config;
    berth_link_t link;
    can_fault_t fault;
    berth_can_t can; /* with the faults, and then counted */
    watch_t watch;
    drive_sim_t *sims[2];
    double angle_rad[2];
    berth_can_frame_t flood;
    uint32_t flooding; /* so many more of these frames are there */
    int64_t now_us;
    uint32_t sends_again, failures, receives;
    bool failed; /* in the present run */
    int runs;
} world_t;

/* --- the bus itself: two drives, and a flood -------------------------------------------------- */

static berth_can_outcome_t inner_send(void *context, const berth_can_frame_t *frame) {
    world_t *world = context;
    watch_sent(&world->watch, frame, world->now_us);
    for (int side = 0; side < 2; side++) {
        (void)drive_sim_receive(world->sims[side], frame, world->now_us);
    }
    return BERTH_CAN_DONE;
}

static berth_can_outcome_t inner_receive(void *context, berth_can_frame_t *frame) {
    world_t *world = context;
    if (world->flooding > 0) {
        world->flooding--;
        *frame = world->flood;
        return BERTH_CAN_DONE;
    }
    for (int side = 0; side < 2; side++) {
        const berth_can_frame_t *front = drive_sim_front(world->sims[side]);
        if (front != NULL) {
            *frame = *front;
            frame->time_us = world->now_us;
            drive_sim_sent(world->sims[side]);
            return BERTH_CAN_DONE;
        }
    }
    return BERTH_CAN_AGAIN;
}

static void inner_state(void *context, berth_can_state_t *state) {
    (void)context;
    *state = (berth_can_state_t){.mode = BERTH_CAN_ERROR_ACTIVE};
}

/* --- around it and the faults: what the link is told ------------------------------------------ */

static berth_can_outcome_t outer_send(void *context, const berth_can_frame_t *frame) {
    world_t *world = context;
    const berth_can_outcome_t outcome = world->can.api->send(world->can.context, frame);
    world->sends_again += outcome == BERTH_CAN_AGAIN ? 1u : 0u;
    world->failures += outcome == BERTH_CAN_FAILED ? 1u : 0u;
    world->failed = world->failed || outcome == BERTH_CAN_FAILED;
    return outcome;
}

static berth_can_outcome_t outer_receive(void *context, berth_can_frame_t *frame) {
    world_t *world = context;
    const berth_can_outcome_t outcome = world->can.api->receive(world->can.context, frame);
    world->receives++;
    world->failures += outcome == BERTH_CAN_FAILED ? 1u : 0u;
    world->failed = world->failed || outcome == BERTH_CAN_FAILED;
    if (outcome == BERTH_CAN_DONE) {
        watch_given(&world->watch, frame);
    }
    return outcome;
}

static void outer_state(void *context, berth_can_state_t *state) {
    world_t *world = context;
    world->can.api->state(world->can.context, state);
}

static void run_once(world_t *world) {
    world->receives = 0;
    world->failed = false;
    berth_link_run(&world->link, world->now_us);
    world->runs++;
    FUZZ_CHECK(world->receives <= BERTH_LINK_RECEIVE_MAX, "a run receives so many frames at most");
    FUZZ_CHECK(world->link.send_again == world->sends_again &&
                   world->link.failures == world->failures,
               "the link counts what the bus answers");
    const berth_supervisor_state_t state = world->board.supervisor.state;
    FUZZ_CHECK(!world->failed || state == BERTH_SUPERVISOR_FAULT || state == BERTH_SUPERVISOR_IDLE,
               "a bus that fails is a fault in the same run");
    watch_call(&world->watch);
    watch_step(&world->watch, world->now_us);
}

static void run(world_t *world) {
    int again = 0;
    do {
        run_once(world);
        again = world->link.more ? 0 : again + 1;
        FUZZ_CHECK(again <= AGAIN_MAX, "the next deadline is ahead");
    } while (berth_link_deadline(&world->link) <= world->now_us && world->runs < RUNS_MAX);
}

static void run_to(world_t *world, int64_t until_us) {
    while (world->now_us < until_us && world->runs < RUNS_MAX) {
        int64_t next_us = berth_link_deadline(&world->link);
        for (int side = 0; side < 2; side++) {
            const int64_t due_us = drive_sim_deadline(world->sims[side]);
            next_us = due_us < next_us ? due_us : next_us;
        }
        next_us = next_us > world->now_us + 200 ? next_us : world->now_us + 200;
        next_us = next_us < until_us ? next_us : until_us;
        for (int side = 0; side < 2; side++) {
            const double speed = drive_sim_target_radps(world->sims[side]);
            world->angle_rad[side] += speed * 1.0e-6 * (double)(next_us - world->now_us);
            drive_sim_motion(world->sims[side], world->angle_rad[side], speed);
            drive_sim_step(world->sims[side], next_us);
        }
        world->now_us = next_us;
        run(world);
    }
}

static void op_order(world_t *world) {
    const uint8_t what = in_u8(&world->in);
    const uint32_t calls = what & CAN_FAULT_ANY;
    const can_fault_order_t order = {
        .calls = calls,
        .first = (calls != 0 ? world->fault.counts[calls] : 0) + in_u8(&world->in),
        .count = (what & 128u) != 0 ? CAN_FAULT_FOREVER : in_u8(&world->in),
        .outcome = (what & 8u) != 0 ? BERTH_CAN_FAILED : BERTH_CAN_AGAIN,
        .mode = (berth_can_mode_t)(what >> 4 & 3u),
    };
    if (!can_fault_order(&world->fault, &order)) {
        can_fault_clear(&world->fault);
    }
}

static void op_command(world_t *world, uint8_t code) {
    watch_command(&world->watch, (berth_command_code_t)code);
    berth_board_command(&world->board, (berth_command_code_t)code, world->now_us);
    watch_call(&world->watch);
}

static void operate(world_t *world) {
    const uint8_t op = in_u8(&world->in);
    switch (op % 6u) {
    case 0:
        run_to(world, world->now_us + 1000 * (1 + (int64_t)in_u8(&world->in)));
        break;
    case 1:
        run_to(world, world->now_us + 20000 * (1 + (int64_t)in_u8(&world->in)));
        break;
    case 2:
        op_command(world, op / 6u % 6u);
        break;
    case 3:
        op_order(world);
        break;
    case 4:
        world->flood = in_frame(&world->in);
        world->flooding = in_u16(&world->in) % 1024u;
        break;
    default:
        world->now_us += in_span(&world->in) % 10000000;
        run(world);
        break;
    }
}

static bool begin(world_t *world) {
    static const berth_can_api_t inner = {inner_send, inner_receive, inner_state};
    static const berth_can_api_t outer = {outer_send, outer_receive, outer_state};
    const berth_can_t bus = {&inner, world};
    const berth_can_t told = {&outer, world};
    const bool vesc = (in_u8(&world->in) & 1u) != 0;
    berth_refusal_t refusal;
    world->config = berth_board_config_default(0.05f, 0.3f, FUZZ_PERIOD_US);
    for (uint8_t side = 0; side < 2; side++) {
        world->config.drives[side].protocol = vesc ? &berth_drive_vesc : &berth_drive_odrive;
        world->config.drives[side].node = (uint8_t)(1 + side);
        const drive_sim_config_t config = {
            .kind = vesc ? DRIVE_SIM_VESC : DRIVE_SIM_ODRIVE,
            .node = (uint8_t)(1 + side),
            .sign = 1,
            .gear_ratio = 1.0,
            .pole_pairs = 7,
            .feedback_us = 25000,
            .heartbeat_us = 100000,
            .watchdog_us = 200000,
        };
        world->sims[side] = drive_sim_create(&config, 0);
    }
    if (world->sims[0] == NULL || world->sims[1] == NULL ||
        berth_board_init(&world->board, fuzz_plan(true), &world->config, 0, &refusal) != BERTH_OK) {
        return false;
    }
    world->can = can_fault_init(&world->fault, &bus);
    berth_link_init(&world->link, &world->board, &told);
    watch_begin(&world->watch, &world->board, &world->config, 0);
    const berth_pose_t pose = {0.3f, 0.0f, 1.57f};
    return berth_board_set_pose(&world->board, &pose, 0) == BERTH_OK;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static world_t world;
    world = (world_t){.in = {data, size}};
    if (begin(&world)) {
        while (world.in.left > 0 && world.runs < RUNS_MAX) {
            operate(&world);
        }
    }
    drive_sim_destroy(world.sims[0]);
    drive_sim_destroy(world.sims[1]);
    return 0;
}
