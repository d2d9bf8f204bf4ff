/* Feeds a record (record.h) to the firmware again and compares every frame that it sends. */
#ifndef HOST_SIM_BUS_REPLAY_H
#define HOST_SIM_BUS_REPLAY_H

#include "scenario.h"

typedef struct {
    bool same;            /* every frame that was sent is sent again, and no other */
    unsigned long frame;  /* of the first difference: which sent frame, from 1 */
    unsigned long line;   /* and where it stands in the file */
    char difference[192]; /* in words */
    unsigned long runs;   /* of the loop */
    unsigned long received;
    unsigned long sent; /* frames compared, all equal */
    bool cut;           /* the record ends within a run: compared up to there */
    char state[64];     /* of the board at the end, with the fault if there is one */
} replay_result_t;

/* False with *error filled when the file cannot be read or is no record. */
bool replay_file(const char *path, replay_result_t *result, scenario_error_t *error);

#endif
