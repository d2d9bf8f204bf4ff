/* Counters that stay at their largest value. Private to firmware/src. */
#ifndef BERTH_SRC_COUNT_H
#define BERTH_SRC_COUNT_H

#include <stdint.h>

/* Not inline: whether a call or three instructions is better is for the compiler to say. */
static void count(uint32_t *counter) {
    if (*counter < UINT32_MAX) {
        (*counter)++;
    }
}

#endif
