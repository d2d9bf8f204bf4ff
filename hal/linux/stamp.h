/* stamp.h - the kernel's and the adapter's time stamps on the monotonic clock. Pure functions.
 *
 * The kernel stamps frames on the wall clock, which may be set at any time; an adapter stamps them
 * on a clock of its own, with an unknown start and some drift.
 */
#ifndef BERTH_HAL_STAMP_H
#define BERTH_HAL_STAMP_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define STAMP_AGE_MAX_US 10000000 /* a frame that waited longer is not believed */
#define STAMP_AHEAD_MAX_US 50000  /* nor an adapter that is so much before the kernel */
#define STAMP_DRIFT_SHIFT 13      /* the offset may grow by 2^-13 (122 ppm) of the time passed */

/* A wall clock stamp, given both clocks as they are now. A stamp from the future, or one older than
 * STAMP_AGE_MAX_US (the clock was set in between), becomes now. */
int64_t stamp_from_wall(int64_t stamp_us, int64_t wall_now_us, int64_t monotonic_now_us);

/* The offset from an adapter's clock to ours: the least difference seen, since delays only add to
 * it, with room for drift. */
typedef struct {
    bool set;
    int64_t offset_us;
    int64_t granted_us; /* growth for drift has been added up to this time */
} stamp_map_t;

/* An adapter's stamp, given when the kernel got the frame (on the monotonic clock): never later
 * than that. When it would lie more than STAMP_AHEAD_MAX_US before, the adapter's clock has jumped:
 * the map starts again. */
int64_t stamp_from_adapter(stamp_map_t *map, int64_t stamp_us, int64_t received_us);

#ifdef __cplusplus
}
#endif

#endif
