/* The example of every board: the whole firmware of a drive board drives around a circle, past an
 * obstacle, with a plan in flash. It arms, starts, stops at the plan's end, and tells on the
 * console what it saw; the last line begins with "done: " when all went well.
 *
 * There is a stand-in for the bus and the robot (stand_in.h). For a board of your own, hand
 * berth_link_init the bus of your port instead, and feed the watchdog where the loop says so.
 */
#include "berth/berth.h"
#include "berth/link.h"
#include "board.h"
#include "example_plan.h"
#include "stand_in.h"

#if defined(EXAMPLE_BOARD_CAN_SLEEP)
#include "mps2_board.h"
#endif

#define TIME_OUT_US 60000000 /* from the start until the wheels are off again */

static berth_board_t board;
static berth_link_t link;
static stand_in_t robot;

/* What the loop has seen. */
static struct {
    bool driven;           /* the plan has been followed to its end */
    float least_m;         /* clearance while running */
    uint32_t steps_before; /* control steps before the start */
    uint32_t late_before;  /* of these, late: arming reads the whole plan */
} seen = {.least_m = BERTH_RADIUS_MAX_M};

static const berth_pose_t start_pose = {.x_m = 0.95f, .y_m = -0.10f, .theta_rad = 1.4f};
static const berth_obstacle_t obstacle = {
    .x_m = -0.67f, .y_m = -0.78f, .hard_m = 0.10f, .conservative_m = 0.20f, .regulated_m = 0.40f};

/* --- Time ------------------------------------------------------------------------------------- */

#if defined(EXAMPLE_BOARD_CAN_SLEEP)
#define example_clock board_clock
#else
/* Where a board cannot sleep until a deadline, it may come back at once. */
static int64_t now_us(void *context) {
    (void)context;
    return board_now_us();
}

static void sleep_until_us(void *context, int64_t deadline_us) {
    (void)context;
    (void)deadline_us;
}

static berth_clock_t example_clock(void) {
    static const berth_clock_api_t api = {now_us, sleep_until_us};
    return (berth_clock_t){&api, NULL};
}
#endif

/* --- Console ---------------------------------------------------------------------------------- */

static void put_number(int32_t value) {
    char text[11];
    size_t at = sizeof text;
    uint32_t rest = value < 0 ? 0u - (uint32_t)value : (uint32_t)value;
    do {
        text[--at] = (char)('0' + rest % 10u);
        rest /= 10u;
    } while (rest != 0);
    if (value < 0) {
        text[--at] = '-';
    }
    board_write(text + at, sizeof text - at);
}

static void put(const char *before, int32_t value, const char *after) {
    board_puts(before);
    put_number(value);
    board_puts(after);
}

static int32_t mm(float metres) {
    const float value = 1000.0f * metres;
    return (int32_t)(value < 0.0f ? value - 0.5f : value + 0.5f);
}

/* --- The drive board -------------------------------------------------------------------------- */

static berth_error_t set_up(int64_t now, berth_refusal_t *refusal) {
    berth_board_config_t config = berth_board_config_default(
        STAND_IN_WHEEL_RADIUS_M, STAND_IN_TRACK_M, example_plan.period_us);
    config.drives[BERTH_LEFT].protocol = &berth_drive_odrive;
    config.drives[BERTH_LEFT].node = STAND_IN_LEFT_NODE;
    config.drives[BERTH_RIGHT].protocol = &berth_drive_odrive;
    config.drives[BERTH_RIGHT].node = STAND_IN_RIGHT_NODE;
    berth_error_t error = berth_board_init(&board, &example_plan, &config, now, refusal);
    if (error == BERTH_OK) {
        error = berth_board_add_obstacle(&board, &obstacle, refusal);
    }
    return error == BERTH_OK ? berth_board_set_pose(&board, &start_pose, now) : error;
}

static void look(void) {
    const float clearance_m = berth_board_control(&board)->clearance_m;
    if (clearance_m < seen.least_m) {
        seen.least_m = clearance_m;
    }
    seen.driven = berth_board_control(&board)->finished;
}

/* What a person at the buttons would do. True when all is driven and the torque is off. */
static bool operate(int64_t now) {
    const berth_board_status_t *status = berth_board_status(&board);
    switch (status->state) {
    case BERTH_SUPERVISOR_IDLE:
        if (!seen.driven) {
            berth_board_command(&board, BERTH_COMMAND_ARM, now);
        }
        return seen.driven;
    case BERTH_SUPERVISOR_ARMED:
        seen.steps_before = status->steps;
        seen.late_before = status->late;
        berth_board_command(&board, BERTH_COMMAND_START, now);
        break;
    case BERTH_SUPERVISOR_RUNNING:
        if (status->steps > seen.steps_before) {
            look();
        }
        if (seen.driven) {
            berth_board_command(&board, BERTH_COMMAND_STOP, now);
        }
        break;
    default:
        break;
    }
    return false;
}

static void tell_state(void) {
    static berth_supervisor_state_t told = BERTH_SUPERVISOR_IDLE;
    const berth_board_status_t *status = berth_board_status(&board);
    if (status->state != told) {
        told = status->state;
        board_puts(berth_supervisor_state_text(told));
        if (told == BERTH_SUPERVISOR_FAULT) {
            board_puts(": ");
            board_puts(berth_fault_side_text(status->fault));
            board_puts(berth_fault_text(status->fault));
        }
        board_puts("\n");
    }
}

/* What to look at first on a board of your own too. */
static void tell_figures(void) {
    const berth_board_status_t *status = berth_board_status(&board);
    put("", (int32_t)status->steps, " control steps, late: ");
    put("", (int32_t)(status->late - seen.late_before), " running, ");
    put("", (int32_t)seen.late_before, " arming; latest ");
    put("", (int32_t)status->latest_us, " us\n");
    put("stack ", (int32_t)board_stack_used(), " of ");
    put("", (int32_t)board_stack_size(), " bytes; board ");
    put("", (int32_t)sizeof board, " bytes; plan ");
    put("", (int32_t)example_plan.count, " samples\n");
    put("clearance ", mm(seen.least_m), " mm; odometry off by ");
    put("", mm(robot.pose.x_m - status->pose.x_m), ", ");
    put("", mm(robot.pose.y_m - status->pose.y_m), " mm\n");
}

static int end(bool over) {
    const berth_sample_t *last = &example_plan.samples[example_plan.count - 1];
    const int32_t x_mm = mm(robot.pose.x_m - last->x_m);
    const int32_t y_mm = mm(robot.pose.y_m - last->y_m);
    const bool good = over && berth_board_status(&board)->fault == BERTH_FAULT_NONE &&
                      seen.least_m > 0.0f && robot.bites == 0;
    tell_figures();
    put(good ? "done: " : "FAILED: ", x_mm, ", ");
    put("", y_mm, " mm from the end of the plan\n");
    return good ? 0 : 1;
}

int main(void) {
    const berth_clock_t clock = example_clock();
    const int64_t began_us = clock.api->now_us(clock.context);
    berth_refusal_t refusal = {0};
    const berth_error_t error = set_up(began_us, &refusal);
    if (error != BERTH_OK) {
        board_puts("FAILED: ");
        board_puts(berth_error_text(error));
        board_puts(": ");
        board_puts(berth_field_text(refusal.field));
        board_puts("\n");
        return 1;
    }
    stand_in_open(&robot, clock, &start_pose);
    const berth_can_t can = stand_in_can(&robot);
    berth_link_init(&link, &board, &can);

    bool over = false;
    int64_t now = began_us;
    while (!over && now < began_us + TIME_OUT_US) {
        now = clock.api->now_us(clock.context);
        berth_link_run(&link, now);
        over = operate(now);
        tell_state();
        /* The watchdog is fed here, and nowhere else. */
        const int64_t due_us = berth_link_deadline(&link);
        const int64_t robot_us = stand_in_due(&robot);
        clock.api->sleep_until_us(clock.context, due_us < robot_us ? due_us : robot_us);
    }
    return end(over);
}
