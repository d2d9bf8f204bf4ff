/* The drive boards' prompt, over a line that the test holds. */
#include "berth/board.h"
#include "prompt.h"
#include "support.h"

#include "unity.h"

#include <string.h>

static support_plan_t plan;
static berth_board_t board;
static prompt_t prompt;
static berth_can_mode_t bus_mode;

static struct {
    char in[4096];
    size_t in_start, in_end;
    char out[65536];
    size_t out_end;
    size_t room; /* bytes that one write takes */
    bool lose;   /* the next read tells of a loss */
} line;

static byte_stream_outcome_t line_read(void *context, uint8_t *bytes, size_t room, size_t *count) {
    (void)context;
    *count = 0;
    if (line.lose) {
        line.lose = false;
        return BYTE_STREAM_FAILED;
    }
    while (*count < room && line.in_start < line.in_end) {
        bytes[(*count)++] = (uint8_t)line.in[line.in_start++];
    }
    return *count > 0 ? BYTE_STREAM_DONE : BYTE_STREAM_AGAIN;
}

static byte_stream_outcome_t line_write(void *context, const uint8_t *bytes, size_t length,
                                        size_t *count) {
    (void)context;
    *count = length < line.room ? length : line.room;
    TEST_ASSERT_TRUE(line.out_end + *count < sizeof line.out);
    memcpy(&line.out[line.out_end], bytes, *count);
    line.out_end += *count;
    line.out[line.out_end] = '\0';
    return *count > 0 ? BYTE_STREAM_DONE : BYTE_STREAM_AGAIN;
}

static void bus_state(void *context, berth_can_state_t *state) {
    (void)context;
    *state = (berth_can_state_t){
        .mode = bus_mode, .rx_lost = 1, .tx_dropped = 2, .error_frames = UINT32_MAX, .restarts = 4};
}

static int64_t now_us;

static void run(int times) {
    for (int i = 0; i < times; i++) {
        now_us += 1000;
        prompt_run(&prompt, now_us);
    }
}

static void clear(void) {
    line.out_end = 0;
    line.out[0] = '\0';
}

/* Types it, and gives what the board wrote. */
static const char *type(const char *text) {
    clear();
    line.in_start = 0;
    line.in_end = strlen(text);
    memcpy(line.in, text, line.in_end);
    run((int)line.in_end + 5);
    return line.out;
}

static void expect(const char *part) {
    TEST_ASSERT_NOT_NULL_MESSAGE(strstr(line.out, part), line.out);
}

void setUp(void) {
    static const byte_stream_api_t stream = {line_read, line_write};
    static const berth_can_api_t can = {NULL, NULL, bus_state};
    berth_refusal_t refusal;
    support_plan(&plan, SUPPORT_EIGHT, 100, false);
    berth_board_config_t config = berth_board_config_default(0.05f, 0.3f, plan.plan.period_us);
    config.drives[BERTH_LEFT].protocol = &berth_drive_odrive;
    config.drives[BERTH_RIGHT].protocol = &berth_drive_odrive;
    config.drives[BERTH_RIGHT].node = 1;
    now_us = 0;
    TEST_ASSERT_EQUAL_INT(BERTH_OK,
                          berth_board_init(&board, &plan.plan, &config, now_us, &refusal));
    memset(&line, 0, sizeof line);
    line.room = sizeof line.out;
    bus_mode = BERTH_CAN_ERROR_ACTIVE;
    prompt_init(&prompt, &board, &(berth_can_t){&can, NULL}, (byte_stream_t){&stream, NULL});
    run(1);
}

void tearDown(void) {}

static void test_starts_with_a_prompt(void) {
    TEST_ASSERT_EQUAL_STRING("> ", line.out);
}

static void test_echo_and_backspace(void) {
    TEST_ASSERT_EQUAL_STRING("hepl\b \b\b \blp", type("hepl\b\x7flp"));
    type("\r");
    expect("estop");
    TEST_ASSERT_EQUAL_STRING("", type("\b\b\b"));
    TEST_ASSERT_EQUAL_STRING("\r\n> ", type("\r"));
    TEST_ASSERT_EQUAL_STRING("", type("\x01\x1b\x80\xff\t"));
}

static void test_status(void) {
    static const char *const modes[] = {"up", "error passive", "BUS-OFF", "DOWN"};
    for (int i = 0; i < 4; i++) {
        char expected[80] = "can ";
        bus_mode = (berth_can_mode_t)i;
        strcat(expected, modes[i]);
        strcat(expected, ", rx lost 1, tx dropped 2, errors 4294967295, restarts 4\r\n");
        type("status  \r");
        expect("state idle\r\n");
        expect(expected);
        expect("pose unknown\r\n");
        expect("left off, received 0\r\n");
        expect("right off, received 0\r\n");
    }
}

static void pose_is(const char *command, float x_m, float y_m, float theta_rad) {
    type(command);
    expect("ok\r\n");
    const berth_pose_t *pose = &board.odometry.pose;
    TEST_ASSERT_FLOAT_WITHIN(1e-4f, x_m, pose->x_m);
    TEST_ASSERT_FLOAT_WITHIN(1e-4f, y_m, pose->y_m);
    TEST_ASSERT_FLOAT_WITHIN(1e-4f, theta_rad, pose->theta_rad);
}

static void test_poses(void) {
    pose_is("pose 1000 -2500 1571\r", 1.0f, -2.5f, 1.571f);
    pose_is("pose   -0   7 -3\r", 0.0f, 0.007f, -0.003f);
    static const char *const bad[] = {"pose \r",
                                      "pose 1\r",
                                      "pose 1 2\r",
                                      "pose 1 2 3 4\r",
                                      "pose 1 2 3x\r",
                                      "pose a 2 3\r",
                                      "pose 1 2 -\r",
                                      "pose 1.5 2 3\r",
                                      "pose 1 2 +3\r",
                                      "pose 1 2 3 , 4\r",
                                      "pose 99999999999999999999 2 3\r"};
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        type(bad[i]);
        TEST_ASSERT_NULL_MESSAGE(strstr(line.out, "ok"), bad[i]);
        TEST_ASSERT_FLOAT_WITHIN(1e-4f, 0.007f, board.odometry.pose.y_m);
    }
    type("pose 1000000000 0 0\r"); /* out of the board's range */
    TEST_ASSERT_NULL(strstr(line.out, "ok"));
}

static void test_commands_reach_the_board(void) {
    type("start\r");
    expect("refused\r\n");
    type("arm\r");
    expect("ok\r\n");
    TEST_ASSERT_EQUAL_INT(BERTH_SUPERVISOR_ARMING, board.supervisor.state);
    type("estop\r");
    expect("ok\r\n");
    TEST_ASSERT_EQUAL_INT(BERTH_SUPERVISOR_FAULT, board.supervisor.state);
    type("fly\r");
    expect("unknown");
    type("ARM\r");
    expect("unknown");
}

static void test_changes_are_told_and_the_line_stands_again(void) {
    type("sta");
    clear();
    berth_board_command(&board, BERTH_COMMAND_EMERGENCY_STOP, now_us);
    berth_board_step(&board, now_us + 1);
    run(3);
    expect("\rstate fault: ");
    TEST_ASSERT_EQUAL_STRING("\r\n> sta", &line.out[line.out_end - 7]);
    type("tus\r");
    expect("pose unknown");
}

static void test_long_lines_are_refused_whole(void) {
    char text[PROMPT_LINE_MAX + 20];
    memset(text, ' ', sizeof text);
    memcpy(text, "arm", 3);
    memcpy(&text[sizeof text - 2], "\r", 2);
    type(text);
    expect("too long\r\n> ");
    TEST_ASSERT_EQUAL_INT(BERTH_SUPERVISOR_IDLE, board.supervisor.state);
    type("arm\r");
    expect("ok");
}

/* Half a line is not a command. */
static void test_after_a_loss_the_line_is_dropped(void) {
    type("ar");
    line.lose = true;
    type("m\r");
    expect("too long");
    TEST_ASSERT_EQUAL_INT(BERTH_SUPERVISOR_IDLE, board.supervisor.state);
    line.lose = true;
    run(1);
    type("arm\r");
    expect("ok");
}

/* Nothing is read, and so nothing obeyed, while answers wait. */
static void test_a_line_that_takes_nothing_holds_commands_back(void) {
    line.room = 0;
    for (int i = 0; i < 5; i++) {
        type("help\rhelp\rhelp\rhelp\r");
    }
    type("arm\r");
    TEST_ASSERT_EQUAL_INT(BERTH_SUPERVISOR_IDLE, board.supervisor.state);
    TEST_ASSERT_TRUE(prompt.out_end <= PROMPT_OUT_MAX);
    line.room = 7;
    run(1000);
    TEST_ASSERT_EQUAL_INT(BERTH_SUPERVISOR_ARMING, board.supervisor.state);
}

static void test_any_bytes_at_any_speed(void) {
    static const char *const words[] = {"status", "pose ", "help", "-1", " ", "\r", "\b", "99999"};
    support_random_start();
    for (uint32_t i = 0; i < support_runs(20000); i++) {
        line.in_start = 0;
        line.in_end = 0;
        line.out_end = 0;
        line.room = support_index(3) == 0 ? 0 : support_index(300);
        line.lose = support_index(20) == 0;
        if (support_index(2) == 0) {
            strcpy(line.in, words[support_index(8)]);
            line.in_end = strlen(line.in);
        } else {
            for (; line.in_end < support_index(40); line.in_end++) {
                line.in[line.in_end] = (char)((int)support_index(256) - 128);
            }
        }
        prompt_say(&prompt, "x", "y");
        run(1 + (int)support_index(3));
        TEST_ASSERT_TRUE(prompt.length <= PROMPT_LINE_MAX && prompt.out_end <= PROMPT_OUT_MAX);
        TEST_ASSERT_EQUAL_INT(BERTH_SUPERVISOR_IDLE, board.supervisor.state);
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_starts_with_a_prompt);
    RUN_TEST(test_echo_and_backspace);
    RUN_TEST(test_status);
    RUN_TEST(test_poses);
    RUN_TEST(test_commands_reach_the_board);
    RUN_TEST(test_changes_are_told_and_the_line_stands_again);
    RUN_TEST(test_long_lines_are_refused_whole);
    RUN_TEST(test_after_a_loss_the_line_is_dropped);
    RUN_TEST(test_a_line_that_takes_nothing_holds_commands_back);
    RUN_TEST(test_any_bytes_at_any_speed);
    return UNITY_END();
}
