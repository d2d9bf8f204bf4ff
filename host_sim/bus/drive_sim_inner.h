/* What the simulated drives share. Private to drive_sim*.c.
 *
 * Inside, everything is the motor's: turns and turns/s, positive the way that the motor counts.
 * drive_sim.c turns the wheel's motion into that and back. A protocol sees now_us, which never goes
 * back, and puts frames with drive_sim_put.
 */
#ifndef HOST_SIM_BUS_DRIVE_SIM_INNER_H
#define HOST_SIM_BUS_DRIVE_SIM_INNER_H

#include "drive_sim.h"
#include "drive_sim_canopen.h"
#include "drive_sim_timer.h"

#define DRIVE_SIM_QUEUE 32u /* frames that may wait to be sent */

typedef struct {
    void (*power_on)(drive_sim_t *sim);
    void (*expire)(drive_sim_t *sim); /* watchdogs, before a frame and before step */
    bool (*receive)(drive_sim_t *sim, const berth_can_frame_t *frame);
    void (*step)(drive_sim_t *sim);
    int64_t (*deadline)(const drive_sim_t *sim);
    bool (*enabled)(const drive_sim_t *sim);
    double (*target_rps)(const drive_sim_t *sim);
    void (*fail)(drive_sim_t *sim, uint32_t code);
} drive_sim_protocol_t;

extern const drive_sim_protocol_t drive_sim_odrive;
extern const drive_sim_protocol_t drive_sim_vesc;
extern const drive_sim_protocol_t drive_sim_cia402;

typedef struct {
    uint32_t errors;        /* axis error bits, kept until cleared */
    uint32_t disarm_reason; /* the bits that ended the last closed loop */
    uint8_t axis_state;
    uint8_t procedure_result;
    uint32_t control_mode;
    uint32_t input_mode;
    float input_velocity_rps;
    int64_t fed_us;
    drive_sim_timer_t heartbeat, feedback;
} drive_sim_odrive_state_t;

typedef struct {
    bool running; /* holds torque */
    double erpm;  /* that it wants */
    int64_t fed_us;
    int64_t fault_until_us; /* deaf to commands until then */
    drive_sim_timer_t feedback;
} drive_sim_vesc_state_t;

struct drive_sim {
    drive_sim_config_t config;
    const drive_sim_protocol_t *protocol;
    drive_sim_trouble_t trouble;
    drive_sim_counters_t counters;
    int64_t now_us;
    double motor_turns;
    double motor_rps;
    berth_can_frame_t queue[DRIVE_SIM_QUEUE];
    unsigned first, waiting;
    union {
        drive_sim_odrive_state_t odrive;
        drive_sim_vesc_state_t vesc;
        drive_sim_cia402_state_t cia402;
    } state;
};

/* Puts a frame into the queue; one too many is lost and counted. */
void drive_sim_put(drive_sim_t *sim, const berth_can_frame_t *frame);

/* floor(value) as a counter of 32 bits has it, wrapped around. */
int32_t drive_sim_wrap(double value);

/* Little and big endian numbers of count bytes, at most 4. */
void drive_sim_put_le(uint8_t *data, uint32_t value, unsigned count);
uint32_t drive_sim_get_le(const uint8_t *data, unsigned count);
void drive_sim_put_be(uint8_t *data, uint32_t value, unsigned count);
uint32_t drive_sim_get_be(const uint8_t *data, unsigned count);

#endif
