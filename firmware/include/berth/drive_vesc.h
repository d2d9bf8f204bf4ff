/* berth/drive_vesc.h - a wheel on a VESC, by its own CAN protocol (CAN mode "VESC").
 *
 *     config.protocol = &berth_drive_vesc;
 *     config.node = 11;                            VESC ID, 0 to 254
 *     config.pole_pairs = 7;                       of the motor: magnets / 2
 *
 * The fields mode, master_node, has_position, counts_per_turn and velocity_units_per_rps are not
 * looked at.
 *
 * Frames have 29-bit ids, packet << 8 | node, and big endian numbers. Speeds are electrical, ERPM =
 * motor rpm * pole pairs:
 *
 *     to the drive     0  set duty           int32 duty * 100000: always 0, which brakes
 *                      1  set current        int32 mA: always 0, which releases the motor
 *                      3  set speed          int32 ERPM
 *     from the drive   9  status 1           int32 ERPM, int16 current * 10, int16 duty * 1000
 *                     27  status 5           int32 tachometer, int16 supply * 10, 2 bytes spare
 *
 * To be set in the drive beforehand (VESC Tool), and written there:
 *
 *     - motor detection done, so that a speed command turns the motor; "Invert Motor Direction"
 * off, or sign in the configuration chosen to suit
 *     - App Settings, General: VESC ID; CAN Baud Rate 1M; CAN Mode VESC; App to Use: none that
 *       drives the motor as well
 *     - CAN Status Message Mode with 1 and 5 (or 1 alone: then travel comes from the speed); Rate:
 * at least 1 / control period (100 Hz where it is 10 ms). Both time-outs of the configuration must
 * be several times longer.
 *     - App Settings, General, Timeout: 100 ms or so, longer than two control periods: the drive's
 *       own watchdog, fed by each command. Timeout Brake Current: what stops the wheel then, in A.
 *       With 0 there it rolls to a stand; WITH TIMEOUT 0 NOTHING STOPS IT WHEN THE BUS IS LOST.
 *     - Motor Settings, PID Controllers, Speed: Minimum ERPM as small as the motor runs smoothly.
 *       Below it the drive releases the motor instead of controlling its speed (900 ERPM by
 *       default, much for a robot): with sensors it can be a tenth of that. Allow Braking on.
 *     - Max ERPM, both directions: somewhat above the fastest wheel speed * gear ratio * pole pairs
 * * 60 / (2 pi), as the last defence against a wrong command
 *
 * A VESC has no enable: it counts as ENABLED once a status 1 has come that was sent after enabling
 * began, and its own time-out is what stops it. Status 1 is the feedback and the sign of life in
 * one. The code of BERTH_DRIVE_FAULT_ENABLE is always BERTH_VESC_NO_STATUS (bit rate, VESC ID,
 * status mode, power?). The drive's own faults (over-voltage, over-current, temperature) are not on
 * the bus: the drive then releases the motor for its fault stop time, which shows as a wheel that
 * does not follow (see supervisor.h).
 *
 * Speed 0 while ENABLED or STARTING is set speed 0. The quick stop, STOPPED and FAULT are set duty
 * 0 in each cycle: that shorts the motor within the drive's current limits, so it brakes whatever
 * Minimum ERPM is, and holds weakly when it stands. The emergency stop is the same: the protocol
 * has nothing harder. Disabling: set current 0, the motor is released.
 *
 * Position: the tachometer, 6 steps an electrical turn, so 1 / (6 pole pairs) motor turns a step;
 * differences are taken modulo 2^32. Status 5 is good with 8 bytes, and with 6, where the spare
 * ones are left out. A speed beyond 1000 motor turns/s can not be: commands saturate there,
 * feedback is malformed.
 *
 * Constant cost, no allocation; context as in drive.h.
 */
#ifndef BERTH_DRIVE_VESC_H
#define BERTH_DRIVE_VESC_H

#include "berth/drive.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The code of BERTH_DRIVE_FAULT_ENABLE. */
#define BERTH_VESC_NO_STATUS 1u

/* Fastest speed of the motor that is commanded or believed, turns/s. */
#define BERTH_VESC_SPEED_MAX_RPS 1000.0f

#ifdef __cplusplus
}
#endif

#endif
