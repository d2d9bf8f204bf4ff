/* What is on the bus: the drive options that berth-sim, berth-board and berth-robot share, and the
 * configurations that follow from them and a scenario, for the board and for the simulated drives.
 *
 *     bus_setup_t setup;
 *     bus_setup_init(&setup, true);
 *     in the program's parser: case ARGP_KEY_INIT: state->child_inputs[0] = &setup;
 *     with {&bus_setup_argp, 0, "Drives:", 0} among its argp children
 *
 * The parser refuses bad values with one line that names the option, what it got and what is
 * allowed, and ends the process as argp does (status argp_err_exit_status). At the end of the line
 * it fills in the protocol's defaults, so that all of *setup means something.
 */
#ifndef HOST_SIM_BUS_BUS_SETUP_H
#define HOST_SIM_BUS_BUS_SETUP_H

#include "berth/board.h"
#include "drive_sim.h"
#include "scenario.h"

#include <argp.h>

/* Keys of the options, beyond those of characters and of the programs' own (below 0x400). */
enum {
    BUS_SETUP_DRIVE = 0x400,
    BUS_SETUP_LEFT,
    BUS_SETUP_RIGHT,
    BUS_SETUP_GEAR,
    BUS_SETUP_INVERT,
    BUS_SETUP_POLE_PAIRS,
    BUS_SETUP_COUNTS,
    BUS_SETUP_UNITS,
    BUS_SETUP_MODE,
    BUS_SETUP_MASTER,
    BUS_SETUP_NO_POSITION,
    BUS_SETUP_FEEDBACK_TIMEOUT,
    BUS_SETUP_HEARTBEAT_TIMEOUT,
    BUS_SETUP_ENABLE_TIMEOUT,
    BUS_SETUP_ADDRESS,
    BUS_SETUP_OBSTACLES,
    BUS_SETUP_FIX_PERIOD, /* of bus_setup_robot_argp, from here on */
    BUS_SETUP_FIX_LATENCY,
    BUS_SETUP_END
};

typedef struct {
    bool required;                 /* --drive, --left and --right must be given */
    uint32_t given;                /* bit n: option BUS_SETUP_DRIVE + n was given */
    drive_sim_kind_t drive;        /* odrive */
    uint8_t node[2];               /* left 1, right 2 */
    int sign[2];                   /* +1 each */
    double gear_ratio;             /* motor turns per wheel turn: 1 */
    unsigned pole_pairs;           /* vesc: 7 */
    uint32_t counts_per_turn;      /* cia402, of the motor: 4096 */
    double velocity_units_per_rps; /* cia402: counts_per_turn, which is counts/s */
    unsigned mode;                 /* cia402: 3 */
    uint8_t master;                /* cia402: 127 */
    bool position;                 /* cia402: 0x6064 is mapped */
    uint32_t feedback_timeout_us;  /* these three: 0, which leaves the board's own */
    uint32_t heartbeat_timeout_us;
    uint32_t enable_timeout_us;
    uint8_t address; /* of Berth's own frames: 0 */
    bool announced;  /* --obstacles bus: the board is not given the scenario's obstacles, the robot
                        tells them over the bus */
    int64_t fix_period_us;  /* of the robot's pose fixes: 100 ms; 0: none */
    int64_t fix_latency_us; /* 0 */
} bus_setup_t;

extern const struct argp bus_setup_argp;

/* What the simulated robot's localisation does, for the programs that have one. It goes beside
 * bus_setup_argp, with the same input. */
extern const struct argp bus_setup_robot_argp;

/* The defaults. required: as the struct's. */
void bus_setup_init(bus_setup_t *setup, bool required);

/* Writes the options that were given, one a line ("--drive=odrive"), but for those of the robot's
 * localisation, which the board knows nothing of. */
void bus_setup_print(const bus_setup_t *setup, FILE *file);

/* "odrive", "vesc", "cia402". */
const char *bus_setup_drive_name(drive_sim_kind_t drive);

/* Was this option on the line? */
bool bus_setup_given(const bus_setup_t *setup, int option);

/* The name of one that was, without the dashes; NULL: none. */
const char *bus_setup_any_given(const bus_setup_t *setup);

/* Fills in the defaults that depend on the protocol and checks what more than one option decides.
 * bus_setup_argp does it at the end of the line. False with *error filled. */
bool bus_setup_finish(bus_setup_t *setup, scenario_error_t *error);

/* The robot's body and uncertainty, of which the board is told when obstacles come over the bus:
 * what an announced obstacle's hard radius is larger than its disc. */
#define BUS_SETUP_BODY_M 0.05

/* The board's configuration for a scenario: limits and avoidance as in the plain run, supervisor
 * and odometry as berth_board_config_default has them, regions for obstacles from the bus that just
 * satisfy the clearance condition. False with *error filled. */
bool bus_setup_board_config(const bus_setup_t *setup, const scenario_t *scenario,
                            uint32_t period_us, berth_board_config_t *config,
                            scenario_error_t *error);

/* Can this strategy run on a board: none, conservative or combined? False with *error filled. */
bool bus_setup_strategy(const char *strategy, scenario_error_t *error);

/* Gives an initialised board the scenario's obstacles as the scenario's strategy wants them; none
 * where they are announced over the bus. False with *error filled. */
bool bus_setup_obstacles(const bus_setup_t *setup, const scenario_t *scenario, berth_board_t *board,
                         scenario_error_t *error);

/* Why the board refused its configuration, in one line. */
void bus_setup_refusal_text(berth_error_t error, const berth_refusal_t *refusal,
                            scenario_error_t *out);

/* From a pose fix's measurement until its frame is sent: the setup's latency and the plant's delay
 * of the pose. 0 without fixes. */
int64_t bus_setup_fix_latency_us(const bus_setup_t *setup, const scenario_t *scenario);

/* A simulated drive of this setup. side: BERTH_LEFT or BERTH_RIGHT. */
drive_sim_config_t bus_setup_drive_sim(const bus_setup_t *setup, int side);

#endif
