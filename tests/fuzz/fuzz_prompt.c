/* The drive boards' prompt: any bytes typed, over a line that is slow, loses bytes, or is not read.
 * A byte of 255 is none typed: the next one says what happens instead. What must hold: what is
 * written is text; the board stays as board_watch.c wants it; lines and answers stay within their
 * room.
 */
#include "board_watch.h"
#include "fuzz.h"
#include "fuzz_plan.h"
#include "input.h"
#include "prompt.h"

#define RUNS_MAX 3000

typedef struct {
    input_t in;
    berth_board_t board;
    berth_board_config_t config;
    watch_t watch;
    prompt_t prompt;
    size_t room; /* bytes that one write takes */
    bool lose;
    bool silent; /* the drives say nothing */
    berth_can_mode_t mode;
    int64_t now_us;
    int runs;
    bool special; /* a byte of 255 was read */
} world_t;

static byte_stream_outcome_t line_read(void *context, uint8_t *bytes, size_t room, size_t *count) {
    world_t *world = context;
    *count = 0;
    if (world->lose) {
        world->lose = false;
        return BYTE_STREAM_FAILED;
    }
    FUZZ_CHECK(room > 0, "there is room to read");
    while (*count < room && world->in.left > 0 && !world->special) {
        const uint8_t byte = in_u8(&world->in);
        world->special = byte == 255;
        if (!world->special) {
            bytes[(*count)++] = byte;
        }
    }
    return *count > 0 ? BYTE_STREAM_DONE : BYTE_STREAM_AGAIN;
}

static byte_stream_outcome_t line_write(void *context, const uint8_t *bytes, size_t length,
                                        size_t *count) {
    world_t *world = context;
    *count = length < world->room ? length : world->room;
    for (size_t i = 0; i < *count; i++) {
        FUZZ_CHECK(bytes[i] < 0x7f && (bytes[i] >= ' ' || strchr("\r\n\b\a", bytes[i]) != NULL) &&
                       bytes[i] != '\0',
                   "what is written is text");
    }
    return *count > 0 ? BYTE_STREAM_DONE : BYTE_STREAM_AGAIN;
}

static void bus_state(void *context, berth_can_state_t *state) {
    *state = (berth_can_state_t){.mode = ((world_t *)context)->mode, .error_frames = UINT32_MAX};
}

/* Both drives say that their wheels stand. */
static void hear_drives(world_t *world) {
    for (uint32_t node = 1; node <= 2 && !world->silent; node++) {
        const berth_can_frame_t frame = {
            .id = 9u << 8 | node, .extended = true, .length = 8, .time_us = world->now_us};
        watch_given(&world->watch, &frame);
        berth_board_receive(&world->board, &frame, world->now_us);
        watch_call(&world->watch);
    }
}

static void send_all(world_t *world) {
    const berth_can_frame_t *frame;
    while ((frame = berth_board_front(&world->board)) != NULL) {
        watch_sent(&world->watch, frame, world->now_us);
        berth_board_sent(&world->board, world->now_us);
    }
}

static void run(world_t *world) {
    world->now_us += 10000;
    world->runs++;
    hear_drives(world);
    berth_board_step(&world->board, world->now_us);
    watch_step(&world->watch, world->now_us);
    watch_call(&world->watch);
    watch_command(&world->watch, BERTH_COMMAND_RESET); /* may be what was typed */
    prompt_run(&world->prompt, world->now_us);
    watch_call(&world->watch);
    FUZZ_CHECK(world->prompt.length <= PROMPT_LINE_MAX &&
                   world->prompt.out_start <= world->prompt.out_end &&
                   world->prompt.out_end <= PROMPT_OUT_MAX,
               "lines and answers fit");
    send_all(world);
}

static void happen(world_t *world) {
    const uint8_t what = in_u8(&world->in);
    world->special = false;
    switch (what % 6u) {
    case 0:
        world->lose = true;
        break;
    case 1:
        world->room = what / 6u;
        break;
    case 2:
        world->silent = !world->silent;
        break;
    case 3:
        world->mode = (berth_can_mode_t)(what / 6u % 4u);
        berth_board_bus(&world->board, world->mode, false, world->now_us);
        watch_call(&world->watch);
        break;
    case 4:
        prompt_say(&world->prompt, "word", "a text of some length");
        break;
    default:
        for (int i = 0; i < what && world->runs < RUNS_MAX; i++) {
            run(world);
        }
        break;
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static world_t world;
    static const byte_stream_api_t stream = {line_read, line_write};
    static const berth_can_api_t can = {.state = bus_state};
    const berth_can_t bus = {&can, &world};
    berth_refusal_t refusal;
    world = (world_t){.in = {data, size}, .room = 1000};
    world.config = berth_board_config_default(0.05f, 0.3f, FUZZ_PERIOD_US);
    for (uint8_t side = 0; side < 2; side++) {
        world.config.drives[side].protocol = &berth_drive_vesc;
        world.config.drives[side].node = (uint8_t)(1 + side);
    }
    FUZZ_CHECK(berth_board_init(&world.board, fuzz_plan(true), &world.config, 0, &refusal) ==
                   BERTH_OK,
               "the board is set up");
    watch_begin(&world.watch, &world.board, &world.config, 0);
    prompt_init(&world.prompt, &world.board, &bus, (byte_stream_t){&stream, &world});
    while ((world.in.left > 0 || world.special) && world.runs < RUNS_MAX) {
        run(&world);
        if (world.special) {
            happen(&world);
        }
    }
    run(&world);
    return 0;
}
