/* berth/digest.h - one number for all that decides what a board does, to tell whether two boards
 * are set up alike: an image in flash and the simulation of it, say.
 */
#ifndef BERTH_DIGEST_H
#define BERTH_DIGEST_H

#include "berth/board.h"

#ifdef __cplusplus
extern "C" {
#endif

/* CRC-32 (IEEE 802.3) over the plan's CRC, the whole configuration with its floats' bits, and the
 * obstacles that stay, of an initialised board. The same on every processor. The code of a tracker
 * or a protocol of one's own does not count, only that it is there. Some 10,000 instructions. */
uint32_t berth_board_digest(const berth_board_t *board);

#ifdef __cplusplus
}
#endif

#endif
