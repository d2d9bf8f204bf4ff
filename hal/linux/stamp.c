#include "stamp.h"

int64_t stamp_from_wall(int64_t stamp_us, int64_t wall_now_us, int64_t monotonic_now_us) {
    /* Compared before they are subtracted, so that no stamp overflows. */
    if (stamp_us > wall_now_us || stamp_us < wall_now_us - STAMP_AGE_MAX_US) {
        return monotonic_now_us;
    }
    const int64_t then_us = monotonic_now_us - (wall_now_us - stamp_us);
    return then_us > 0 ? then_us : 0;
}

int64_t stamp_from_adapter(stamp_map_t *map, int64_t stamp_us, int64_t received_us) {
    const int64_t difference_us = received_us - stamp_us;
    if (map->set && received_us > map->granted_us) {
        const int64_t growth_us = (received_us - map->granted_us) >> STAMP_DRIFT_SHIFT;
        map->offset_us += growth_us;
        map->granted_us += growth_us << STAMP_DRIFT_SHIFT;
    }
    const bool jumped = map->set && difference_us - map->offset_us > STAMP_AHEAD_MAX_US;
    if (!map->set || jumped || difference_us < map->offset_us) {
        map->offset_us = difference_us;
        map->granted_us = received_us;
    }
    map->set = true;
    return stamp_us + map->offset_us;
}
