/* What a frame to a drive means, read from the protocols and not from the firmware. */
#ifndef BERTH_TESTS_FUZZ_DRIVE_SAYS_H
#define BERTH_TESTS_FUZZ_DRIVE_SAYS_H

#include "berth/drive.h"

typedef struct {
    bool speed;         /* it commands a speed: */
    double motor_rps;   /* this one, */
    double quantum_rps; /* in steps of this */
    bool enables;       /* it asks the drive for torque, or to go on with it */
} said_t;

/* False: no frame that the firmware sends to this drive, or for all drives of its protocol. */
bool drive_says(const berth_drive_t *drive, const berth_can_frame_t *frame, said_t *said);

#endif
