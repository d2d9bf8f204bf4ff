/* A simulated wheel drive on the bus: what a motor controller with one of the three protocols does,
 * as seen from the other side than firmware/src/drive_*.c. Written from the protocols, not from the
 * firmware, so that a mistake in one does not hide in the other: it shares no code with it.
 *
 * Passive, like the firmware: frames and time in, frames and the next deadline out. The wheel
 * itself is the robot's business: it asks for the speed that the drive wants to turn at, and tells
 * the encoder what the wheel really did.
 *
 * What a master may trip over, because real drives do so:
 *
 *   odrive   keeps its last input velocity: closed loop without a fresh one moves the wheel at the
 *            old speed. Errors stay, and keep it idle, until they are cleared. The watchdog runs
 *            in closed loop alone.
 *   vesc     has no armed state: any command moves the wheel, also after a time-out. A failure of
 *            its own makes it deaf for 0.5 s. It has no heartbeat to mute.
 *   cia402   hears nothing for 10 ms after power-on and reset node, then sends its boot-up message,
 *            and is ready to be switched on 5 ms later. Watches its master's heartbeat from the
 *            first one on, once object 0x1016 says so; losing it is a fault while enabled (object
 *            0x6007 tells otherwise), with emergency 0x8130, and leaves operational. Takes PDOs'
 *            parameters only while the PDO is off. Its ramps start at 1000 motor turns/s2.
 */
#ifndef HOST_SIM_BUS_DRIVE_SIM_H
#define HOST_SIM_BUS_DRIVE_SIM_H

#include "berth_hal/can.h"

#include <stdbool.h>
#include <stdint.h>

typedef enum { DRIVE_SIM_ODRIVE, DRIVE_SIM_VESC, DRIVE_SIM_CIA402 } drive_sim_kind_t;

typedef struct {
    drive_sim_kind_t kind;
    uint8_t node;
    int sign;                      /* +1, or -1: the motor is mounted the other way round */
    double gear_ratio;             /* motor turns per wheel turn */
    unsigned pole_pairs;           /* vesc */
    uint32_t counts_per_turn;      /* encoder counts per motor turn: cia402's 0x6064 */
    double velocity_units_per_rps; /* cia402: of 0x60FF and 0x606C per motor turn/s */
    int64_t feedback_us;  /* period of cyclic feedback (odrive, vesc); cia402 answers SYNC */
    int64_t heartbeat_us; /* period of the heartbeat (odrive; cia402 has it set by SDO) */
    int64_t watchdog_us;  /* time without a command after which the wheel is stopped by the
                             drive itself; 0: none. cia402: see its heartbeat consumer */
} drive_sim_config_t;

/* Faults to order. */
typedef struct {
    bool mute_heartbeat; /* no heartbeat any more */
    bool mute_feedback;  /* no speed or position any more */
    bool dead;           /* neither hears nor says anything; the wheel runs out */
    bool refuse_setup;   /* cia402: SDO downloads are aborted with 0x08000022 */
} drive_sim_trouble_t;

typedef struct drive_sim drive_sim_t;

/* On the heap; NULL when out of memory. Released with drive_sim_destroy. */
drive_sim_t *drive_sim_create(const drive_sim_config_t *config, int64_t now_us);
void drive_sim_destroy(drive_sim_t *sim);

/* A frame from the bus; at_us is when it was on the wire. False: not this drive's. */
bool drive_sim_receive(drive_sim_t *sim, const berth_can_frame_t *frame, int64_t at_us);

/* Runs what is due at now_us (heartbeat, feedback, watchdog). Frames to send wait in the drive. */
void drive_sim_step(drive_sim_t *sim, int64_t now_us);
int64_t drive_sim_deadline(const drive_sim_t *sim);

/* The oldest frame that the drive wants to send, or NULL; and the note that it has been sent. */
const berth_can_frame_t *drive_sim_front(const drive_sim_t *sim);
void drive_sim_sent(drive_sim_t *sim);

/* Does the drive hold torque, and the wheel speed that it wants to turn at, rad/s, positive
 * forward. Without torque the wheel runs out. */
bool drive_sim_enabled(const drive_sim_t *sim);
double drive_sim_target_radps(const drive_sim_t *sim);

/* What the wheel did: its angle since the start and its speed, both positive forward. */
void drive_sim_motion(drive_sim_t *sim, double angle_rad, double speed_radps);

/* Orders trouble, and makes the drive report an error of its own (odrive: axis error bits; vesc:
 * has none, the drive just stops; cia402: error code, with EMCY) and disable itself. */
void drive_sim_trouble(drive_sim_t *sim, const drive_sim_trouble_t *trouble);
void drive_sim_fail(drive_sim_t *sim, uint32_t code);

/* Counters for the tests. */
typedef struct {
    unsigned long received, sent, malformed;
    unsigned long watchdog_stops; /* the drive stopped the wheel by itself */
    unsigned long commands;       /* speed commands obeyed */
    unsigned long overruns;       /* frames lost because too many waited to be sent */
} drive_sim_counters_t;
drive_sim_counters_t drive_sim_counters(const drive_sim_t *sim);

#endif
