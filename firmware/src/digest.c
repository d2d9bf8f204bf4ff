#include "berth/digest.h"

#include "bytes.h"

static uint32_t add_word(uint32_t crc, uint32_t word) {
    crc ^= word;
    for (int bit = 0; bit < 32; bit++) {
        crc = (crc >> 1) ^ ((crc & 1u) != 0u ? 0xedb88320u : 0u);
    }
    return crc;
}

static uint32_t add_words(uint32_t crc, const uint32_t *words, uint32_t count) {
    for (uint32_t i = 0; i < count; i++) {
        crc = add_word(crc, words[i]);
    }
    return crc;
}

static uint32_t add_floats(uint32_t crc, const float *values, uint32_t count) {
    for (uint32_t i = 0; i < count; i++) {
        crc = add_word(crc, bits_from_float(values[i]));
    }
    return crc;
}

#define ADD_WORDS(crc, words) add_words(crc, words, (uint32_t)(sizeof(words) / sizeof(words)[0]))
#define ADD_FLOATS(crc, values)                                                                    \
    add_floats(crc, values, (uint32_t)(sizeof(values) / sizeof(values)[0]))

static uint32_t add_controller(uint32_t crc, const berth_controller_t *controller) {
    const berth_limits_config_t *limits = &controller->limits_config;
    const berth_avoid_config_t *avoid = &controller->avoid.config;
    const float values[] = {
        limits->wheel_radius_m,
        limits->track_m,
        limits->v_max_mps,
        limits->omega_max_radps,
        limits->a_max_mps2,
        limits->alpha_max_radps2,
        limits->wheel_speed_max_radps,
        avoid->skirt_m,
        avoid->v_creep_mps,
        avoid->tau_s,
        avoid->a_brake_mps2,
        avoid->sigma_pose_m,
        controller->tracker.rim_change_max_mps2,
    };
    crc = ADD_FLOATS(crc, values);
    const uint32_t words[] = {controller->tracker.api != NULL, avoid->paced};
    return ADD_WORDS(crc, words);
}

static uint32_t add_obstacles(uint32_t crc, const berth_obstacles_t *obstacles) {
    for (uint32_t i = 0; i < obstacles->count; i++) {
        const berth_obstacle_t *obstacle = &obstacles->slots[i].obstacle;
        const float values[] = {obstacle->x_m, obstacle->y_m, obstacle->hard_m,
                                obstacle->conservative_m, obstacle->regulated_m};
        if (obstacles->slots[i].id == BERTH_OBSTACLE_STATIC) {
            crc = ADD_FLOATS(crc, values);
        }
    }
    return crc;
}

/* The frames that a protocol wants tell it from the others, without linking them. */
static uint32_t add_filters(uint32_t crc, const berth_drive_t *drive) {
    berth_can_filter_t filters[BERTH_DRIVE_FILTERS_MAX];
    const uint32_t count = berth_drive_filters(drive, filters);
    for (uint32_t i = 0; i < count; i++) {
        const uint32_t words[] = {filters[i].id, filters[i].mask, filters[i].extended};
        crc = ADD_WORDS(crc, words);
    }
    return crc;
}

static uint32_t add_drive(uint32_t crc, const berth_drive_t *drive) {
    const berth_drive_config_t *config = &drive->config;
    const uint32_t words[] = {
        config->node,
        config->sign < 0 ? 1u : 0u,
        config->pole_pairs,
        config->mode,
        config->master_node,
        config->has_position,
        config->counts_per_turn,
        config->period_us,
        config->feedback_timeout_us,
        config->heartbeat_timeout_us,
        config->enable_timeout_us,
    };
    const float values[] = {config->gear_ratio, config->velocity_units_per_rps};
    crc = ADD_WORDS(crc, words);
    crc = ADD_FLOATS(crc, values);
    return add_filters(crc, drive);
}

static uint32_t add_supervisor(uint32_t crc, const berth_supervisor_config_t *supervisor) {
    const uint32_t words[] = {
        supervisor->fix_timeout_us, supervisor->period_late_us,  supervisor->transmit_timeout_us,
        supervisor->arm_timeout_us, supervisor->stop_timeout_us, supervisor->following_us,
    };
    const float values[] = {supervisor->standing_radps, supervisor->following_radps};
    crc = ADD_WORDS(crc, words);
    return ADD_FLOATS(crc, values);
}

uint32_t berth_board_digest(const berth_board_t *board) {
    const berth_odometry_config_t *odometry = &board->odometry.config;
    const uint32_t words[] = {board->plan_crc, board->address, board->telemetry_periods};
    const float values[] = {
        odometry->fix_gain,    odometry->fix_jump_m,          odometry->fix_jump_rad,
        board->regions.body_m, board->regions.conservative_m, board->regions.regulated_m,
    };
    uint32_t crc = ADD_WORDS(UINT32_MAX, words);
    crc = ADD_FLOATS(crc, values);
    crc = add_controller(crc, &board->controller);
    crc = add_drive(crc, &board->drives[BERTH_LEFT]);
    crc = add_drive(crc, &board->drives[BERTH_RIGHT]);
    crc = add_supervisor(crc, &board->supervisor.config);
    crc = add_obstacles(crc, &board->controller.obstacles);
    return ~crc;
}
