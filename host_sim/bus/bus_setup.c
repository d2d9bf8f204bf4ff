#include "bus_setup.h"

#include "number.h"
#include "refusal.h"
#include "robot.h"
#include "strategy_common.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* The simulated drives' own habits: what controllers of these kinds come with. */
#define SIM_FEEDBACK_US 10000
#define SIM_HEARTBEAT_US 100000
#define SIM_WATCHDOG_US 250000

/* For cia402 it is also the time after which a drive stops because it does not hear us. */
#define CIA402_HEARTBEAT_US 200000

/* Beyond the least C - R for obstacles from the bus, and their G - C. */
#define REGION_MARGIN_M 0.01
#define REGION_REGULATED_M 0.2

static const struct argp_option option_table[] = {
    {"drive", BUS_SETUP_DRIVE, "PROTOCOL", 0, "odrive, vesc or cia402 (odrive)", 0},
    {"left", BUS_SETUP_LEFT, "ID", 0, "Node of the left wheel's drive (1)", 0},
    {"right", BUS_SETUP_RIGHT, "ID", 0, "Node of the right wheel's drive (2)", 0},
    {"gear", BUS_SETUP_GEAR, "RATIO", 0, "Motor turns per wheel turn, 0.001 to 1000 (1)", 0},
    {"invert", BUS_SETUP_INVERT, "SIDE", 0,
     "Whose motor turns backwards for forward: none, left, right or both (none)", 0},
    {"pole-pairs", BUS_SETUP_POLE_PAIRS, "N", 0, "vesc: of the motor, 1 to 100 (7)", 0},
    {"counts-per-turn", BUS_SETUP_COUNTS, "N", 0,
     "cia402: position counts per motor turn, 1 to 16777216 (4096)", 0},
    {"velocity-units", BUS_SETUP_UNITS, "U", 0,
     "cia402: units of the velocity objects per motor turn/s, 0.001 to 1e8 (counts-per-turn: "
     "counts/s; 60 for rpm)",
     0},
    {"mode", BUS_SETUP_MODE, "3|9", 0,
     "cia402: 3 profile velocity, 9 cyclic synchronous velocity (3)", 0},
    {"master", BUS_SETUP_MASTER, "ID", 0, "cia402: the board's own node, 1 to 127 (127)", 0},
    {"no-position", BUS_SETUP_NO_POSITION, NULL, 0, "cia402: the drive tells no position", 0},
    {"feedback-timeout", BUS_SETUP_FEEDBACK_TIMEOUT, "MS", 0,
     "Without speed feedback for so long: fault, 1 to 10000 (100, or three periods)", 0},
    {"heartbeat-timeout", BUS_SETUP_HEARTBEAT_TIMEOUT, "MS", 0,
     "Without a heartbeat for so long: fault, 1 to 10000 (500, or three periods; cia402: 200, and "
     "the "
     "drives stop when they do not hear the board for so long)",
     0},
    {"enable-timeout", BUS_SETUP_ENABLE_TIMEOUT, "MS", 0,
     "Not enabled after so long: fault, 1 to 60000 (5000)", 0},
    {"address", BUS_SETUP_ADDRESS, "N", 0, "Of this robot in Berth's own frames, 0 to 255 (0)", 0},
    {"obstacles", BUS_SETUP_OBSTACLES, "plan|bus", 0,
     "Who tells the board of the scenario's obstacles: its plan, or the robot over the bus (plan)",
     0},
    {0},
};

static const struct argp_option robot_table[] = {
    {"fix-period", BUS_SETUP_FIX_PERIOD, "MS", 0,
     "Between two pose fixes, 1 to 60000, or 0 for dead reckoning (100)", 0},
    {"fix-latency", BUS_SETUP_FIX_LATENCY, "MS", 0,
     "From a measured pose until its fix is sent, 0 to 15 fix periods (0)", 0},
    {0},
};

static const char *const drive_names[] = {
    [DRIVE_SIM_ODRIVE] = "odrive",
    [DRIVE_SIM_VESC] = "vesc",
    [DRIVE_SIM_CIA402] = "cia402",
};
#define DRIVE_KINDS (sizeof drive_names / sizeof drive_names[0])

/* What a protocol's nodes may be. */
static const struct {
    unsigned least, most;
} node_range[DRIVE_KINDS] = {
    [DRIVE_SIM_ODRIVE] = {0, 62},
    [DRIVE_SIM_VESC] = {0, 254},
    [DRIVE_SIM_CIA402] = {1, 127},
};

const char *bus_setup_drive_name(drive_sim_kind_t drive) {
    return drive_names[drive];
}

void bus_setup_init(bus_setup_t *setup, bool required) {
    *setup = (bus_setup_t){
        .required = required,
        .drive = DRIVE_SIM_ODRIVE,
        .node = {1, 2},
        .sign = {1, 1},
        .gear_ratio = 1.0,
        .pole_pairs = 7,
        .counts_per_turn = 4096,
        .mode = 3,
        .master = 127,
        .position = true,
        .fix_period_us = BUS_ROBOT_FIX_PERIOD_US,
    };
}

static uint32_t bit(int option) {
    return 1u << (unsigned)(option - BUS_SETUP_DRIVE);
}

bool bus_setup_given(const bus_setup_t *setup, int option) {
    return (setup->given & bit(option)) != 0;
}

static const char *option_name(int option) {
    return option < BUS_SETUP_FIX_PERIOD ? option_table[option - BUS_SETUP_DRIVE].name
                                         : robot_table[option - BUS_SETUP_FIX_PERIOD].name;
}

const char *bus_setup_any_given(const bus_setup_t *setup) {
    for (int option = BUS_SETUP_DRIVE; option < BUS_SETUP_END; option++) {
        if (bus_setup_given(setup, option)) {
            return option_name(option);
        }
    }
    return NULL;
}

/* --- values ------------------------------------------------------------------------------ */

static bool refuse_value(int option, const char *text, const char *allowed,
                         scenario_error_t *error) {
    char excerpt[REFUSAL_EXCERPT_MAX];
    return refuse(error, "--%s: '%s' is not possible (allowed: %s)", option_name(option),
                  refusal_excerpt(text, excerpt, sizeof excerpt), allowed);
}

static bool take_count(int option, const char *text, uint32_t least, uint32_t most,
                       scenario_error_t *error, uint32_t *out) {
    uint64_t value = 0;
    if (!number_parse_count(text, most, &value) || value < least) {
        char allowed[64];
        snprintf(allowed, sizeof allowed, "an integer from %u to %u", (unsigned)least,
                 (unsigned)most);
        return refuse_value(option, text, allowed, error);
    }
    *out = (uint32_t)value;
    return true;
}

static bool take_number(int option, const char *text, double least, double most,
                        scenario_error_t *error, double *out) {
    double value = 0.0;
    if (!number_parse(text, &value) || value < least || value > most) {
        char allowed[NUMBER_RANGE_TEXT_MAX];
        number_range_text(least, most, allowed, sizeof allowed);
        return refuse_value(option, text, allowed, error);
    }
    *out = value;
    return true;
}

static bool take_timeout(int option, const char *text, uint32_t most_ms, scenario_error_t *error,
                         uint32_t *out_us) {
    uint32_t value_ms = 0;
    if (!take_count(option, text, 1, most_ms, error, &value_ms)) {
        return false;
    }
    *out_us = value_ms * 1000u;
    return true;
}

static bool take_fix_time(int option, const char *text, scenario_error_t *error, int64_t *out_us) {
    uint32_t value_ms = 0;
    if (!take_count(option, text, 0, 60000, error, &value_ms)) {
        return false;
    }
    *out_us = 1000 * (int64_t)value_ms;
    return true;
}

/* Which of the words, or count. */
static size_t find_word(const char *text, const char *const *words, size_t count) {
    size_t i = 0;
    while (i < count && strcmp(words[i], text) != 0) {
        i++;
    }
    return i;
}

static bool take_drive(bus_setup_t *setup, const char *text, scenario_error_t *error) {
    const size_t kind = find_word(text, drive_names, DRIVE_KINDS);
    if (kind == DRIVE_KINDS) {
        return refuse_value(BUS_SETUP_DRIVE, text, "odrive, vesc, cia402", error);
    }
    setup->drive = (drive_sim_kind_t)kind;
    return true;
}

static bool take_invert(bus_setup_t *setup, const char *text, scenario_error_t *error) {
    static const char *const sides[] = {"none", "left", "right", "both"};
    const size_t side = find_word(text, sides, 4);
    if (side == 4) {
        return refuse_value(BUS_SETUP_INVERT, text, "none, left, right, both", error);
    }
    setup->sign[BERTH_LEFT] = side == 1 || side == 3 ? -1 : 1;
    setup->sign[BERTH_RIGHT] = side == 2 || side == 3 ? -1 : 1;
    return true;
}

static bool take_mode(bus_setup_t *setup, const char *text, scenario_error_t *error) {
    if (strcmp(text, "3") != 0 && strcmp(text, "9") != 0) {
        return refuse_value(BUS_SETUP_MODE, text, "3, 9", error);
    }
    setup->mode = (unsigned)(text[0] - '0');
    return true;
}

static bool take_obstacles(bus_setup_t *setup, const char *text, scenario_error_t *error) {
    if (strcmp(text, "plan") != 0 && strcmp(text, "bus") != 0) {
        return refuse_value(BUS_SETUP_OBSTACLES, text, "plan, bus", error);
    }
    setup->announced = text[0] == 'b';
    return true;
}

/* Options that are one byte. */
static bool take_byte(int option, const char *text, uint8_t least, uint8_t most,
                      scenario_error_t *error, uint8_t *out) {
    uint32_t value = 0;
    if (!take_count(option, text, least, most, error, &value)) {
        return false;
    }
    *out = (uint8_t)value;
    return true;
}

static bool take_timing(bus_setup_t *setup, int option, const char *text, scenario_error_t *error) {
    switch (option) {
    case BUS_SETUP_FEEDBACK_TIMEOUT:
        return take_timeout(option, text, 10000, error, &setup->feedback_timeout_us);
    case BUS_SETUP_HEARTBEAT_TIMEOUT:
        return take_timeout(option, text, 10000, error, &setup->heartbeat_timeout_us);
    case BUS_SETUP_FIX_PERIOD:
        return take_fix_time(option, text, error, &setup->fix_period_us);
    case BUS_SETUP_FIX_LATENCY:
        return take_fix_time(option, text, error, &setup->fix_latency_us);
    default:
        return take_timeout(option, text, 60000, error, &setup->enable_timeout_us);
    }
}

static bool take_option(bus_setup_t *setup, int option, const char *text, scenario_error_t *error) {
    switch (option) {
    case BUS_SETUP_DRIVE:
        return take_drive(setup, text, error);
    case BUS_SETUP_LEFT:
        return take_byte(option, text, 0, 254, error, &setup->node[BERTH_LEFT]);
    case BUS_SETUP_RIGHT:
        return take_byte(option, text, 0, 254, error, &setup->node[BERTH_RIGHT]);
    case BUS_SETUP_GEAR:
        return take_number(option, text, 0.001, 1000.0, error, &setup->gear_ratio);
    case BUS_SETUP_INVERT:
        return take_invert(setup, text, error);
    case BUS_SETUP_POLE_PAIRS:
        return take_count(option, text, 1, 100, error, &setup->pole_pairs);
    case BUS_SETUP_COUNTS:
        return take_count(option, text, 1, 16777216, error, &setup->counts_per_turn);
    case BUS_SETUP_UNITS:
        return take_number(option, text, 0.001, 1.0e8, error, &setup->velocity_units_per_rps);
    case BUS_SETUP_MODE:
        return take_mode(setup, text, error);
    case BUS_SETUP_MASTER:
        return take_byte(option, text, 1, 127, error, &setup->master);
    case BUS_SETUP_NO_POSITION:
        setup->position = false;
        return true;
    case BUS_SETUP_ADDRESS:
        return take_byte(option, text, 0, 255, error, &setup->address);
    case BUS_SETUP_OBSTACLES:
        return take_obstacles(setup, text, error);
    default:
        return take_timing(setup, option, text, error);
    }
}

/* --- the line as a whole ----------------------------------------------------------------- */

/* The one protocol that an option is for; DRIVE_KINDS: for all. */
static size_t option_protocol(int option) {
    switch (option) {
    case BUS_SETUP_POLE_PAIRS:
        return DRIVE_SIM_VESC;
    case BUS_SETUP_COUNTS:
    case BUS_SETUP_UNITS:
    case BUS_SETUP_MODE:
    case BUS_SETUP_MASTER:
    case BUS_SETUP_NO_POSITION:
        return DRIVE_SIM_CIA402;
    default:
        return DRIVE_KINDS;
    }
}

static bool check_given(const bus_setup_t *setup, scenario_error_t *error) {
    for (int option = BUS_SETUP_DRIVE; option < BUS_SETUP_END; option++) {
        const size_t protocol = option_protocol(option);
        const bool given = bus_setup_given(setup, option);
        if (given && protocol != DRIVE_KINDS && protocol != setup->drive) {
            return refuse(error, "--%s is not for --drive %s (allowed: with --drive %s)",
                          option_name(option), drive_names[setup->drive], drive_names[protocol]);
        }
        if (!given && setup->required && option <= BUS_SETUP_RIGHT) {
            return refuse(error, "--%s is missing (allowed: %s)", option_name(option),
                          option == BUS_SETUP_DRIVE ? "odrive, vesc, cia402"
                                                    : "a drive's node number");
        }
    }
    return true;
}

static bool check_nodes(const bus_setup_t *setup, scenario_error_t *error) {
    const unsigned least = node_range[setup->drive].least;
    const unsigned most = node_range[setup->drive].most;
    for (int side = 0; side < 2; side++) {
        const unsigned node = setup->node[side];
        const char *name = side == BERTH_LEFT ? "left" : "right";
        if (node < least || node > most) {
            return refuse(error, "--%s: %u is no %s node (allowed: %u to %u)", name, node,
                          drive_names[setup->drive], least, most);
        }
        if (setup->drive == DRIVE_SIM_CIA402 && node == setup->master) {
            return refuse(error, "--%s: %u is the board's own node (allowed: not --master)", name,
                          node);
        }
    }
    if (setup->node[BERTH_LEFT] == setup->node[BERTH_RIGHT]) {
        return refuse(error, "--right: %u is the left drive's node (allowed: another one)",
                      (unsigned)setup->node[BERTH_RIGHT]);
    }
    return true;
}

bool bus_setup_finish(bus_setup_t *setup, scenario_error_t *error) {
    if (!bus_setup_given(setup, BUS_SETUP_UNITS)) {
        setup->velocity_units_per_rps = setup->counts_per_turn;
    }
    if (setup->fix_latency_us > BUS_ROBOT_LATENCY_PERIODS * setup->fix_period_us) {
        return refuse(error, "--fix-latency: %lld ms (allowed: 0 to %lld, %d fix periods)",
                      (long long)setup->fix_latency_us / 1000,
                      (long long)setup->fix_period_us * BUS_ROBOT_LATENCY_PERIODS / 1000,
                      BUS_ROBOT_LATENCY_PERIODS);
    }
    return check_given(setup, error) && check_nodes(setup, error);
}

static error_t parse_option(int key, char *argument, struct argp_state *state) {
    bus_setup_t *setup = state->input;
    scenario_error_t error;
    bool good = true;
    if (key == ARGP_KEY_END) {
        good = bus_setup_finish(setup, &error);
    } else if (key >= BUS_SETUP_DRIVE && key < BUS_SETUP_END) {
        setup->given |= bit(key);
        good = take_option(setup, key, argument, &error);
    } else {
        return ARGP_ERR_UNKNOWN;
    }
    if (!good) {
        argp_error(state, "%s", error.text);
    }
    return 0;
}

static error_t parse_robot_option(int key, char *argument, struct argp_state *state) {
    return key == ARGP_KEY_END ? ARGP_ERR_UNKNOWN : parse_option(key, argument, state);
}

const struct argp bus_setup_argp = {.options = option_table, .parser = parse_option};
const struct argp bus_setup_robot_argp = {.options = robot_table, .parser = parse_robot_option};

/* --- and back ----------------------------------------------------------------------------- */

static void print_drives(const bus_setup_t *setup, int option, FILE *file) {
    static const char *const sides[2][2] = {{"none", "left"}, {"right", "both"}};
    switch (option) {
    case BUS_SETUP_DRIVE:
        fputs(drive_names[setup->drive], file);
        break;
    case BUS_SETUP_INVERT:
        fputs(sides[setup->sign[BERTH_RIGHT] < 0][setup->sign[BERTH_LEFT] < 0], file);
        break;
    case BUS_SETUP_OBSTACLES:
        fputs(setup->announced ? "bus" : "plan", file);
        break;
    default: {
        char text[NUMBER_TEXT_MAX];
        number_text(option == BUS_SETUP_GEAR ? setup->gear_ratio : setup->velocity_units_per_rps,
                    text, sizeof text);
        fputs(text, file);
        break;
    }
    }
}

/* Options that are whole numbers. False: it is none of them. */
static bool whole_number(const bus_setup_t *setup, int option, uint32_t *value) {
    switch (option) {
    case BUS_SETUP_LEFT:
    case BUS_SETUP_RIGHT:
        *value = setup->node[option - BUS_SETUP_LEFT];
        return true;
    case BUS_SETUP_POLE_PAIRS:
        *value = setup->pole_pairs;
        return true;
    case BUS_SETUP_COUNTS:
        *value = setup->counts_per_turn;
        return true;
    case BUS_SETUP_MODE:
        *value = setup->mode;
        return true;
    case BUS_SETUP_MASTER:
        *value = setup->master;
        return true;
    case BUS_SETUP_FEEDBACK_TIMEOUT:
        *value = setup->feedback_timeout_us / 1000;
        return true;
    case BUS_SETUP_HEARTBEAT_TIMEOUT:
        *value = setup->heartbeat_timeout_us / 1000;
        return true;
    case BUS_SETUP_ENABLE_TIMEOUT:
        *value = setup->enable_timeout_us / 1000;
        return true;
    case BUS_SETUP_ADDRESS:
        *value = setup->address;
        return true;
    default:
        return false;
    }
}

void bus_setup_print(const bus_setup_t *setup, FILE *file) {
    for (int option = BUS_SETUP_DRIVE; option < BUS_SETUP_FIX_PERIOD; option++) {
        uint32_t value = 0;
        if (!bus_setup_given(setup, option)) {
            continue;
        }
        fprintf(file, "--%s", option_name(option));
        if (whole_number(setup, option, &value)) {
            fprintf(file, "=%u", (unsigned)value);
        } else if (option != BUS_SETUP_NO_POSITION) {
            fputc('=', file);
            print_drives(setup, option, file);
        }
        fputc('\n', file);
    }
}

/* --- configurations ---------------------------------------------------------------------- */

static const berth_drive_protocol_t *protocol_of(drive_sim_kind_t drive) {
    switch (drive) {
    case DRIVE_SIM_VESC:
        return &berth_drive_vesc;
    case DRIVE_SIM_CIA402:
        return &berth_drive_cia402;
    default:
        return &berth_drive_odrive;
    }
}

static void fill_drive(const bus_setup_t *setup, int side, berth_drive_config_t *drive) {
    drive->protocol = protocol_of(setup->drive);
    drive->node = setup->node[side];
    drive->sign = (int8_t)setup->sign[side];
    drive->gear_ratio = (float)setup->gear_ratio;
    drive->pole_pairs = (uint8_t)setup->pole_pairs;
    drive->mode = (uint8_t)setup->mode;
    drive->master_node = setup->master;
    drive->has_position = setup->position;
    drive->counts_per_turn = setup->counts_per_turn;
    drive->velocity_units_per_rps = (float)setup->velocity_units_per_rps;
    if (setup->feedback_timeout_us > 0) {
        drive->feedback_timeout_us = setup->feedback_timeout_us;
    }
    if (setup->drive == DRIVE_SIM_CIA402 && drive->heartbeat_timeout_us > CIA402_HEARTBEAT_US &&
        3 * drive->period_us <= CIA402_HEARTBEAT_US) {
        drive->heartbeat_timeout_us = CIA402_HEARTBEAT_US;
    }
    if (setup->heartbeat_timeout_us > 0) {
        drive->heartbeat_timeout_us = setup->heartbeat_timeout_us;
    }
    if (setup->enable_timeout_us > 0) {
        drive->enable_timeout_us = setup->enable_timeout_us;
    }
}

void bus_setup_refusal_text(berth_error_t error, const berth_refusal_t *refusal,
                            scenario_error_t *out) {
    if (error != BERTH_ERROR_CONFIG || refusal->field < BERTH_FIELD_DRIVE_NODE) {
        strategy_refusal_text(error, refusal, out);
        return;
    }
    const bool drive = refusal->field <= BERTH_FIELD_ENABLE_TIMEOUT;
    const char *side = refusal->index == BERTH_LEFT ? "left drive: " : "right drive: ";
    (void)snprintf(out->text, sizeof out->text, "%s%s is %.6g (allowed: %.6g to %.6g)",
                   drive ? side : "", berth_field_text(refusal->field), (double)refusal->value,
                   (double)refusal->minimum, (double)refusal->maximum);
}

bool bus_setup_board_config(const bus_setup_t *setup, const scenario_t *scenario,
                            uint32_t period_us, berth_board_config_t *config,
                            scenario_error_t *error) {
    *config = berth_board_config_default((float)scenario->robot.wheel_radius_m,
                                         (float)scenario->robot.track_m, period_us);
    config->controller = strategy_config(scenario);
    for (int side = 0; side < 2; side++) {
        fill_drive(setup, side, &config->drives[side]);
    }
    config->address = setup->address;
    berth_avoid_t avoid;
    berth_refusal_t refusal = {.field = BERTH_FIELD_NONE};
    berth_error_t result = berth_limits_check(&config->controller.limits, &refusal);
    if (result == BERTH_OK) {
        result = berth_avoid_init(&avoid, &config->controller.avoid, &config->controller.limits,
                                  period_us, &refusal);
    }
    if (result != BERTH_OK) {
        bus_setup_refusal_text(result, &refusal, error);
        return false;
    }
    const double skirt_m = scenario->avoidance.skirt_m;
    const bool conservative = strcmp(scenario->avoidance.strategy, "conservative") == 0;
    config->regions = (berth_board_regions_t){
        .body_m = (float)BUS_SETUP_BODY_M,
        .conservative_m = avoid.clearance_min_m + (float)REGION_MARGIN_M,
        .regulated_m = (float)(conservative ? skirt_m : fmax(REGION_REGULATED_M, skirt_m)),
    };
    return true;
}

bool bus_setup_strategy(const char *strategy, scenario_error_t *error) {
    if (strcmp(strategy, "none") == 0 || strcmp(strategy, "conservative") == 0 ||
        strcmp(strategy, "combined") == 0) {
        return true;
    }
    char excerpt[REFUSAL_EXCERPT_MAX];
    return refuse(error,
                  "strategy '%s' does not run on the board (allowed on the bus: none, "
                  "conservative, combined)",
                  refusal_excerpt(strategy, excerpt, sizeof excerpt));
}

bool bus_setup_obstacles(const bus_setup_t *setup, const scenario_t *scenario, berth_board_t *board,
                         scenario_error_t *error) {
    const char *strategy = scenario->avoidance.strategy;
    if (!bus_setup_strategy(strategy, error)) {
        return false;
    }
    if (setup->announced || strcmp(strategy, "none") == 0) {
        return true;
    }
    for (size_t i = 0; i < scenario->obstacle_count; i++) {
        berth_obstacle_t obstacle = strategy_obstacle(scenario, &scenario->obstacles[i]);
        if (strcmp(strategy, "conservative") == 0) {
            obstacle.regulated_m = obstacle.conservative_m + (float)scenario->avoidance.skirt_m;
        }
        berth_refusal_t refusal = {.field = BERTH_FIELD_NONE};
        const berth_error_t result = berth_board_add_obstacle(board, &obstacle, &refusal);
        if (result != BERTH_OK) {
            bus_setup_refusal_text(result, &refusal, error);
            return false;
        }
    }
    return true;
}

int64_t bus_setup_fix_latency_us(const bus_setup_t *setup, const scenario_t *scenario) {
    const int64_t delay_us = (int64_t)llround(1.0e6 * scenario->plant.pose_delay_s);
    return setup->fix_period_us > 0 ? setup->fix_latency_us + delay_us : 0;
}

drive_sim_config_t bus_setup_drive_sim(const bus_setup_t *setup, int side) {
    return (drive_sim_config_t){
        .kind = setup->drive,
        .node = setup->node[side],
        .sign = setup->sign[side],
        .gear_ratio = setup->gear_ratio,
        .pole_pairs = setup->pole_pairs,
        .counts_per_turn = setup->counts_per_turn,
        .velocity_units_per_rps = setup->velocity_units_per_rps,
        .feedback_us = SIM_FEEDBACK_US,
        .heartbeat_us = SIM_HEARTBEAT_US,
        .watchdog_us = SIM_WATCHDOG_US,
    };
}
