/* The firmware's board on this machine: made from a scenario and options, and written down so that
 * it can be made again. */
#ifndef HOST_SIM_BUS_BOARD_HOST_H
#define HOST_SIM_BUS_BOARD_HOST_H

#include "berth/board.h"
#include "bus_setup.h"
#include "run.h"
#include "scenario.h"

#include <argp.h>

/* What the board is told beyond the scenario and the drives. */
typedef struct {
    uint32_t fix_timeout_ms; /* 0: dead reckoning is allowed */
    double following_radps;  /* 0: not watched */
    uint32_t late_ms;        /* 0: three periods */
} board_options_t;

/* Keys of its options, beyond the programs' own and bus_setup.h's. */
enum { BOARD_FIX_TIMEOUT = 0x500, BOARD_FOLLOWING, BOARD_LATE };

/* {&board_options_argp, 0, "Supervision:", 0} among the children; its input is board_options_t. */
extern const struct argp board_options_argp;

/* Everything that a board on this machine is made of. */
typedef struct {
    scenario_t scenario;
    bus_setup_t setup;
    board_options_t options;
} board_recipe_t;

/* A board with its plan. Must not move. */
typedef struct {
    run_plan_t plan;
    berth_board_t board;
    berth_constrained_t workspace; /* used where the scenario asks for it */
} board_host_t;

/* Makes the board, IDLE, first step due at now_us, with the scenario's obstacles. False with *error
 * filled, and nothing to free. */
bool board_host_make(board_host_t *host, const board_recipe_t *recipe, int64_t now_us,
                     scenario_error_t *error);
void board_host_free(board_host_t *host);

/* The recipe as text: a line for each option, an empty line, the scenario. On the heap; NULL with
 * *error filled. */
char *board_recipe_text(const board_recipe_t *recipe, scenario_error_t *error);

/* Reads such a text; name stands for it in messages. False with *error filled. */
bool board_recipe_parse(const char *name, const char *text, board_recipe_t *recipe,
                        scenario_error_t *error);

#endif
