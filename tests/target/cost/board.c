/* The whole board on a bus with two simulated drives of each protocol: its control step, what it
 * does with a received frame, and a call between control steps. */
#include "cost.h"
#include "counter.h"
#include "drive_sim.h"

#include "berth/board.h"
#include "berth/drive_cia402.h"
#include "berth/drive_odrive.h"
#include "berth/drive_vesc.h"

#include <stdio.h>

#define PERIOD_US 50000
#define FIX_US 100000
#define RUN_US 45000000

typedef struct {
    const char *name;
    const berth_drive_protocol_t *protocol;
    drive_sim_kind_t kind;
} protocol_t;

static const protocol_t protocols[] = {
    {"odrive", &berth_drive_odrive, DRIVE_SIM_ODRIVE},
    {"vesc", &berth_drive_vesc, DRIVE_SIM_VESC},
    {"cia402", &berth_drive_cia402, DRIVE_SIM_CIA402},
};

static support_plan_t shape;
static berth_board_t board;
static drive_sim_t *sims[2];
static support_pose_t robot;
static double angles[2];
static int64_t fix_us;
static bool running;

static berth_board_config_t config;
static berth_refusal_t refusal;
static berth_error_t result;

/* Paints the stack instead of counting. */
static struct {
    bool on;
    int64_t now_us;
    const berth_can_frame_t *frame;
    uint32_t init, step, receive; /* most bytes */
} paint;

static cost_series_t step, start, between, feedback, fix, cycle, receive;

static int64_t least(int64_t a, int64_t b) {
    return a < b ? a : b;
}

static void paint_init(void) {
    result = berth_board_init(&board, &shape.plan, &config, 0, &refusal);
}

static void paint_step(void) {
    berth_board_step(&board, paint.now_us);
}

static void paint_receive(void) {
    berth_board_receive(&board, paint.frame, paint.now_us);
}

static void keep_most(uint32_t *most, uint32_t bytes) {
    *most = bytes > *most ? bytes : *most;
}

static void make(const protocol_t *protocol, const cost_experiment_t *experiment) {
    config = berth_board_config_default(0.05f, 0.3f, PERIOD_US);
    support_plan(&shape, experiment->shape, experiment->count, false);
    support_fill_gains(&shape);
    for (int side = 0; side < 2; side++) {
        const drive_sim_config_t sim = {
            .kind = protocol->kind,
            .node = (uint8_t)(1 + side),
            .sign = 1,
            .gear_ratio = 1.0,
            .pole_pairs = 7,
            .counts_per_turn = 4096,
            .velocity_units_per_rps = 4096.0,
            .feedback_us = 10000,
            .heartbeat_us = 100000,
            .watchdog_us = 250000,
        };
        config.drives[side].protocol = protocol->protocol;
        config.drives[side].node = (uint8_t)(1 + side);
        sims[side] = drive_sim_create(&sim, 0);
        angles[side] = 0.0;
    }
    robot = experiment->start;
    fix_us = 0;
    keep_most(&paint.init, cost_stack_of(paint_init));
    cost_require(result, "board");
    for (int i = 0; i < 8; i++) {
        cost_require(berth_board_add_obstacle(&board, &experiment->obstacles[i], &refusal),
                     "obstacle");
    }
    const berth_pose_t pose = support_measure(robot);
    cost_require(berth_board_set_pose(&board, &pose, 0), "pose");
}

/* The wheels do what the drives want at once. */
static void move(int64_t from_us, int64_t to_us) {
    const double time_s = 1.0e-6 * (double)(to_us - from_us);
    double rim[2];
    for (int side = 0; side < 2; side++) {
        const double speed = drive_sim_target_radps(sims[side]);
        angles[side] += speed * time_s;
        rim[side] = 0.05 * speed;
        drive_sim_motion(sims[side], angles[side], speed);
    }
    robot = support_move(robot, 0.5 * (rim[0] + rim[1]), (rim[1] - rim[0]) / 0.3, time_s);
}

static void hear(const berth_can_frame_t *frame, int64_t now_us, cost_series_t *series) {
    if (paint.on) {
        paint.now_us = now_us;
        paint.frame = frame;
        keep_most(&paint.receive, cost_stack_of(paint_receive));
        return;
    }
    const uint32_t begin = counter_now();
    berth_board_receive(&board, frame, now_us);
    const uint32_t instructions = counter_since(begin);
    if (running) {
        cost_add(series, instructions);
    }
}

static void hear_drive(drive_sim_t *sim, int64_t now_us) {
    for (const berth_can_frame_t *front; (front = drive_sim_front(sim)) != NULL;
         drive_sim_sent(sim)) {
        berth_can_frame_t frame = *front;
        frame.time_us = now_us;
        if (running) {
            static berth_drive_t drive;
            drive = board.drives[sim == sims[1]];
            const uint32_t begin = counter_now();
            (void)berth_drive_receive(&drive, &frame, now_us);
            cost_add(&receive, counter_since(begin));
        }
        hear(&frame, now_us, &feedback);
    }
}

static void count_cycle(int64_t now_us) {
    static berth_drive_t drive;
    static berth_outbox_t outbox;
    drive = board.drives[0];
    outbox = board.outbox;
    const uint32_t begin = counter_now();
    berth_drive_command(&drive, 3.0f);
    berth_drive_cycle(&drive, now_us, &outbox);
    cost_add(&cycle, counter_since(begin));
}

static void count_step(int64_t now_us) {
    const uint32_t steps = board.status.steps;
    const bool starting = board.starting;
    const uint32_t begin = counter_now();
    berth_board_step(&board, now_us);
    const uint32_t instructions = counter_since(begin);
    if (!running || board.status.state != BERTH_SUPERVISOR_RUNNING) {
        return;
    }
    if (board.status.steps == steps) {
        cost_add(&between, instructions);
    } else {
        cost_add(starting ? &start : &step, instructions);
    }
}

static void act(int64_t now_us) {
    if (running && now_us >= board.tick_us) {
        count_cycle(now_us);
    }
    if (paint.on) {
        paint.now_us = now_us;
        keep_most(&paint.step, cost_stack_of(paint_step));
    } else {
        count_step(now_us);
    }
    for (const berth_can_frame_t *frame; (frame = berth_board_front(&board)) != NULL;
         berth_board_sent(&board, now_us)) {
        for (int side = 0; side < 2; side++) {
            (void)drive_sim_receive(sims[side], frame, now_us);
        }
    }
}

static void tell_pose(int64_t now_us) {
    const berth_pose_t pose = support_measure(robot);
    berth_can_frame_t frame;
    fix_us += FIX_US;
    berth_message_encode_pose(&frame, BERTH_MESSAGE_POSE_FIX, 0, &pose);
    frame.time_us = now_us;
    hear(&frame, now_us, &fix);
}

static int64_t next_us(int64_t now_us) {
    int64_t due_us = least(berth_board_deadline(&board), fix_us);
    due_us = least(due_us, least(drive_sim_deadline(sims[0]), drive_sim_deadline(sims[1])));
    return due_us > now_us ? due_us : now_us + 1;
}

/* What a person at the buttons does. */
static void operate(int64_t now_us) {
    if (now_us == 0) {
        berth_board_command(&board, BERTH_COMMAND_ARM, now_us);
    }
    if (board.status.state == BERTH_SUPERVISOR_ARMED) {
        berth_board_command(&board, BERTH_COMMAND_START, now_us);
    }
    running = board.status.state == BERTH_SUPERVISOR_RUNNING;
    if (board.status.state == BERTH_SUPERVISOR_FAULT) {
        cost_fail(berth_fault_text(board.status.fault));
    }
}

static void run(const protocol_t *protocol, const cost_experiment_t *experiment) {
    int64_t now_us = 0;
    running = false;
    make(protocol, experiment);
    while (now_us < RUN_US) {
        for (int side = 0; side < 2; side++) {
            drive_sim_step(sims[side], now_us);
            hear_drive(sims[side], now_us);
        }
        if (now_us >= fix_us) {
            tell_pose(now_us);
        }
        act(now_us);
        operate(now_us);
        const int64_t before_us = now_us;
        now_us = next_us(now_us);
        move(before_us, now_us);
    }
    if (!running) {
        cost_fail("the board does not run");
    }
    drive_sim_destroy(sims[0]);
    drive_sim_destroy(sims[1]);
}

static void print(const char *part, const char *protocol, cost_series_t *series) {
    char name[40];
    snprintf(name, sizeof name, "%s.%s", part, protocol);
    cost_print_series(name, series);
}

static void foreign(const char *protocol) {
    const berth_can_frame_t frame = {.id = 0x7ee, .length = 8};
    char name[40];
    const uint32_t begin = counter_now();
    berth_board_receive(&board, &frame, board.last_us);
    const uint32_t instructions = counter_since(begin);
    snprintf(name, sizeof name, "frame.foreign.%s", protocol);
    cost_print(name, instructions);
}

void cost_board(void) {
    for (size_t i = 0; i < sizeof protocols / sizeof protocols[0]; i++) {
        for (int which = 0; which < 2; which++) {
            run(&protocols[i], &cost_experiments[which]);
        }
        print("board.step", protocols[i].name, &step);
        print("board.start", protocols[i].name, &start);
        print("board.between", protocols[i].name, &between);
        print("frame.drive", protocols[i].name, &feedback);
        print("frame.fix", protocols[i].name, &fix);
        print("drive.cycle", protocols[i].name, &cycle);
        print("drive.receive", protocols[i].name, &receive);
        foreign(protocols[i].name);
    }
    paint.on = true;
    run(&protocols[2], &cost_experiments[1]);
    cost_print("stack.board.init", paint.init);
    cost_print("stack.board.step", paint.step);
    cost_print("stack.board.receive", paint.receive);
}
