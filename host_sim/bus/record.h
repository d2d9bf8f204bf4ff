/* Records everything that a board is told and does, so that it can be done again on the desk.
 *
 * The record is a log in candump's format, so that every tool that reads such logs reads it too:
 * the bus's frames under the bus's name, received ones with R and sent ones with T. What else the
 * firmware depends on stands between them as frames of a channel that is no bus, `berth`:
 *
 *     id   data                   what
 *     000                         the loop ran at this time (berth_link_run)
 *     001  mode                   state() tells this mode from here on
 *     002                         send answered AGAIN
 *     003                         send answered FAILED
 *     004                         receive answered FAILED
 *     005  command                a command from the program (berth_board_command)
 *     006  float32 x, y           the robot was put somewhere, first part
 *     007  float32 theta          and second part (berth_board_set_pose)
 *     008  uint32 crc             the board was set up at this time, with a plan of this CRC
 *     010  up to 8 characters     the next part of the set-up: options, an empty line, the scenario
 *
 * Numbers are little endian.
 */
#ifndef HOST_SIM_BUS_RECORD_H
#define HOST_SIM_BUS_RECORD_H

#include "berth/message.h"
#include "berth_hal/can.h"
#include "candump.h"
#include "scenario.h"

#include <stdio.h>

#define RECORD_CHANNEL "berth"

enum {
    RECORD_RUN = 0x000,
    RECORD_MODE = 0x001,
    RECORD_SEND_AGAIN = 0x002,
    RECORD_SEND_FAILED = 0x003,
    RECORD_RECEIVE_FAILED = 0x004,
    RECORD_COMMAND = 0x005,
    RECORD_PUT = 0x006,
    RECORD_PUT_HEADING = 0x007,
    RECORD_INIT = 0x008,
    RECORD_SETUP = 0x010
};

typedef struct {
    FILE *file;
    char *path;
    char channel[CANDUMP_CHANNEL_MAX];
    berth_can_t inner;
    berth_can_mode_t mode;
    bool mode_known;
    int64_t now_us;   /* of the present run */
    int64_t flush_us; /* when the file is next made safe */
} record_t;

/* Opens the file (it is replaced). False with *error filled, and nothing is left behind. */
bool record_open(record_t *record, const char *path, const char *channel, scenario_error_t *error);

/* The bus to hand to the board in place of this one, which must outlive it. The record must not
 * move from here on. */
berth_can_t record_can(record_t *record, const berth_can_t *inner);

/* The events, in the order in which they happen. record_run comes before berth_link_run. */
void record_setup(record_t *record, const char *text, int64_t now_us);
void record_init(record_t *record, uint32_t plan_crc, int64_t now_us);
void record_pose(record_t *record, const berth_pose_t *pose, int64_t now_us);
void record_command(record_t *record, berth_command_code_t command, int64_t now_us);
void record_run(record_t *record, int64_t now_us);

/* Writes what is left. False with *error filled when something could not be written (the disk is
 * full): the file ends early then. Safe on a zeroed struct. */
bool record_close(record_t *record, scenario_error_t *error);

#endif
