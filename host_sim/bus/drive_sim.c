#include "drive_sim_inner.h"

#include <math.h>
#include <stdlib.h>

static const double TWO_PI = 6.283185307179586;

static const drive_sim_protocol_t *protocol_of(drive_sim_kind_t kind) {
    switch (kind) {
    case DRIVE_SIM_ODRIVE:
        return &drive_sim_odrive;
    case DRIVE_SIM_VESC:
        return &drive_sim_vesc;
    case DRIVE_SIM_CIA402:
        return &drive_sim_cia402;
    default:
        return NULL;
    }
}

drive_sim_t *drive_sim_create(const drive_sim_config_t *config, int64_t now_us) {
    const drive_sim_protocol_t *protocol = protocol_of(config->kind);
    drive_sim_t *sim = protocol == NULL ? NULL : calloc(1, sizeof *sim);
    if (sim == NULL) {
        return NULL;
    }
    sim->config = *config;
    sim->protocol = protocol;
    sim->now_us = now_us;
    protocol->power_on(sim);
    return sim;
}

void drive_sim_destroy(drive_sim_t *sim) {
    free(sim);
}

static void pass_time(drive_sim_t *sim, int64_t now_us) {
    if (now_us > sim->now_us) {
        sim->now_us = now_us;
    }
}

bool drive_sim_receive(drive_sim_t *sim, const berth_can_frame_t *frame, int64_t at_us) {
    pass_time(sim, at_us);
    if (sim->trouble.dead) {
        return false;
    }
    sim->protocol->expire(sim);
    if (!sim->protocol->receive(sim, frame)) {
        return false;
    }
    sim->counters.received++;
    return true;
}

void drive_sim_step(drive_sim_t *sim, int64_t now_us) {
    pass_time(sim, now_us);
    if (!sim->trouble.dead) {
        sim->protocol->expire(sim);
        sim->protocol->step(sim);
    }
}

int64_t drive_sim_deadline(const drive_sim_t *sim) {
    return sim->trouble.dead ? INT64_MAX : sim->protocol->deadline(sim);
}

const berth_can_frame_t *drive_sim_front(const drive_sim_t *sim) {
    return sim->waiting == 0 ? NULL : &sim->queue[sim->first];
}

void drive_sim_sent(drive_sim_t *sim) {
    if (sim->waiting > 0) {
        sim->first = (sim->first + 1) % DRIVE_SIM_QUEUE;
        sim->waiting--;
        sim->counters.sent++;
    }
}

bool drive_sim_enabled(const drive_sim_t *sim) {
    return !sim->trouble.dead && sim->protocol->enabled(sim);
}

/* Motor turns per radian of the wheel. */
static double motor_per_rad(const drive_sim_t *sim) {
    return (sim->config.sign < 0 ? -1.0 : 1.0) * sim->config.gear_ratio / TWO_PI;
}

double drive_sim_target_radps(const drive_sim_t *sim) {
    return drive_sim_enabled(sim) ? sim->protocol->target_rps(sim) / motor_per_rad(sim) : 0.0;
}

void drive_sim_motion(drive_sim_t *sim, double angle_rad, double speed_radps) {
    sim->motor_turns = angle_rad * motor_per_rad(sim);
    sim->motor_rps = speed_radps * motor_per_rad(sim);
}

void drive_sim_trouble(drive_sim_t *sim, const drive_sim_trouble_t *trouble) {
    const bool was_dead = sim->trouble.dead;
    sim->trouble = *trouble;
    if (trouble->dead) {
        sim->waiting = 0;
    } else if (was_dead) {
        sim->protocol->power_on(sim);
    }
}

void drive_sim_fail(drive_sim_t *sim, uint32_t code) {
    if (!sim->trouble.dead) {
        sim->protocol->fail(sim, code);
    }
}

drive_sim_counters_t drive_sim_counters(const drive_sim_t *sim) {
    return sim->counters;
}

void drive_sim_put(drive_sim_t *sim, const berth_can_frame_t *frame) {
    if (sim->waiting == DRIVE_SIM_QUEUE) {
        sim->counters.overruns++;
        return;
    }
    sim->queue[(sim->first + sim->waiting) % DRIVE_SIM_QUEUE] = *frame;
    sim->waiting++;
}

void drive_sim_timer_start(drive_sim_timer_t *timer, int64_t period_us, int64_t now_us) {
    timer->period_us = period_us;
    timer->due_us = now_us + period_us;
}

bool drive_sim_timer_take(drive_sim_timer_t *timer, int64_t now_us) {
    if (timer->period_us <= 0 || now_us < timer->due_us) {
        return false;
    }
    timer->due_us += timer->period_us * ((now_us - timer->due_us) / timer->period_us + 1);
    return true;
}

int64_t drive_sim_timer_deadline(const drive_sim_timer_t *timer, int64_t deadline_us) {
    return timer->period_us > 0 && timer->due_us < deadline_us ? timer->due_us : deadline_us;
}

int32_t drive_sim_wrap(double value) {
    if (!isfinite(value)) {
        return 0;
    }
    double rest = fmod(floor(value), 4294967296.0);
    if (rest < 0.0) {
        rest += 4294967296.0;
    }
    return rest < 2147483648.0 ? (int32_t)rest : (int32_t)(rest - 4294967296.0);
}

void drive_sim_put_le(uint8_t *data, uint32_t value, unsigned count) {
    for (unsigned i = 0; i < count; i++) {
        data[i] = (uint8_t)((value >> (8 * i)) & 0xffu);
    }
}

uint32_t drive_sim_get_le(const uint8_t *data, unsigned count) {
    uint32_t value = 0;
    for (unsigned i = 0; i < count; i++) {
        value |= (uint32_t)data[i] << (8 * i);
    }
    return value;
}

void drive_sim_put_be(uint8_t *data, uint32_t value, unsigned count) {
    for (unsigned i = 0; i < count; i++) {
        data[i] = (uint8_t)((value >> (8 * (count - 1 - i))) & 0xffu);
    }
}

uint32_t drive_sim_get_be(const uint8_t *data, unsigned count) {
    uint32_t value = 0;
    for (unsigned i = 0; i < count; i++) {
        value = value << 8 | data[i];
    }
    return value;
}
