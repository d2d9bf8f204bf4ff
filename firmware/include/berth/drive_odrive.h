/* berth/drive_odrive.h - a wheel on an ODrive, by its CANSimple protocol (firmware 0.5 and 0.6).
 *
 *     config.protocol = &berth_drive_odrive;
 *     config.node = 3;                             axis.config.can.node_id, 0 to 62
 *
 * The fields pole_pairs, mode, master_node, has_position, counts_per_turn and
 * velocity_units_per_rps are not looked at.
 *
 * Frames have 11-bit ids, node << 5 | command, and little endian numbers:
 *
 *     to the drive    0x02  emergency stop       no data
 *                     0x07  axis state           uint32: 8 closed loop, 1 idle
 *                     0x0B  controller mode      uint32 2 (velocity), uint32 1 (passthrough)
 *                     0x0D  input velocity       float32 turns/s, float32 torque (always 0)
 *                     0x18  clear errors         no data
 *     from the drive  0x01  heartbeat            uint32 error, uint8 axis state, up to 3 bytes more
 *                     0x09  encoder estimates    float32 turns, float32 turns/s
 *
 * To be set in the drive beforehand, and saved there (names of firmware 0.6; those of 0.5 are
 * alike):
 *
 *     - motor and encoder calibrated, so that closed loop control starts at once
 *     - can.config.baud_rate = 1000000; axis0.config.can.node_id, one for each axis
 *     - axis0.config.can.heartbeat_msg_rate_ms = 20 or so. heartbeat_timeout_us must be several
 *       times longer: the drive's default of 100 ms needs 350000 and more.
 *     - axis0.config.can.encoder_msg_rate_ms = the control period or shorter (10 where it is 10 ms)
 *     - axis0.config.enable_watchdog = True; axis0.config.watchdog_timeout = 0.1: the drive's own
 *       watchdog, fed by the velocity command of each control period. It must be longer than two
 *       control periods. WITHOUT IT NOTHING STOPS THE WHEEL WHEN THE BUS IS LOST. When it bites the
 *       drive goes idle: the wheel has no torque and rolls to a stand.
 *     - axis0.controller.config.vel_limit: somewhat above the fastest wheel speed times the gear
 *       ratio, in turns/s; vel_limit_tolerance so that ordinary overshoot is no error
 *
 * Enabling: clear errors (on a drive with two axes that clears both's), controller mode, velocity
 * 0; 10 ms later mode and velocity once more, and axis state 8. So no single lost frame lets the
 * drive enter closed loop with an old mode or an old speed. Errors are always cleared, because a
 * drive whose watchdog is on has let it bite while nobody drove. A heartbeat with state 8 and no
 * error that was sent after that makes the drive ENABLED. Until then it all is repeated each 260
 * ms, up to enable_timeout_us. Then the fault is BERTH_DRIVE_FAULT_DEVICE with the drive's error,
 * where it tells one, or BERTH_DRIVE_FAULT_ENABLE with how far it came as the code:
 *
 *     1   no heartbeat has been heard: bit rate, node number, wiring, power
 *     2   heartbeats, but the axis does not go to state 8: calibrated?
 *     3   state 8, but no encoder estimates: encoder_msg_rate_ms is 0?
 *
 * While ENABLED or STOPPED a heartbeat with an error is BERTH_DRIVE_FAULT_DEVICE (the code is the
 * drive's own axis error: names are in the drive's manual, and differ between 0.5 and 0.6), one
 * without error but with another state than 8 is BERTH_DRIVE_FAULT_DISABLED (the code is the
 * state).
 *
 * Quick stop: velocity 0 at once, kept by each cycle. Emergency stop: velocity 0, and the emergency
 * stop message: the drive takes the torque off and stays so until its errors are cleared, which the
 * next enabling does. The error and the state that follow from it are no fault. Disabling: idle.
 *
 * Position. Travel comes from differences of the turns while |turns| is at most 65536; a float32
 * resolves 1/256 turn there. Beyond it the speed alone counts. A speed beyond 1000 turns/s can
 * not be: commands saturate there, feedback is malformed.
 *
 * Constant cost, no allocation; context as in drive.h.
 */
#ifndef BERTH_DRIVE_ODRIVE_H
#define BERTH_DRIVE_ODRIVE_H

#include "berth/drive.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Codes of BERTH_DRIVE_FAULT_ENABLE. */
typedef enum {
    BERTH_ODRIVE_NO_HEARTBEAT = 1,
    BERTH_ODRIVE_NOT_IN_CLOSED_LOOP = 2,
    BERTH_ODRIVE_NO_FEEDBACK = 3
} berth_odrive_progress_t;

/* Fastest speed of the motor that is commanded or believed, turns/s. */
#define BERTH_ODRIVE_SPEED_MAX_RPS 1000.0f

/* Positions count up to this, in turns. */
#define BERTH_ODRIVE_TURNS_MAX 65536.0f

#ifdef __cplusplus
}
#endif

#endif
