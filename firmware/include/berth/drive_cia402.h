/* berth/drive_cia402.h - wheel drives that speak CANopen with the drive profile CiA 402.
 *
 *     config.protocol = &berth_drive_cia402;
 *
 * Sources: CiA 301 (CANopen application layer and communication profile) for NMT, SDO, PDO, SYNC,
 * EMCY and heartbeat; CiA 402-2 and 402-3 (drives and motion control; also IEC 61800-7-201) for
 * the state machine and the objects from 0x6000.
 *
 * SET IN THE DRIVE BEFOREHAND, with its maker's tool: node number and bit rate; motor, encoder,
 * current and speed limits; the ramps 0x6083, 0x6084 (mode 3) and the quick stop ramp 0x6085, hard
 * enough to stop within what the planner assumes; the unit of velocity, so that it agrees with
 * velocity_units_per_rps. PDO and SDO identifiers, SYNC (0x1005: 0x080, 0x1019: 0, no counter) and
 * the emergency identifier (0x1014) keep the defaults of CiA 301. Only one master on the bus.
 *
 * CONFIGURATION (berth_drive_config_t): node 1 to 127; master_node 1 to 127 and not node; mode 3
 * (profile velocity: the drive's ramps apply) or 9 (cyclic synchronous velocity: our command each
 * period is its set point); counts_per_turn counts only with has_position; heartbeat_timeout_us at
 * least 3000 and at least two control periods, since our own heartbeat comes once a period.
 *
 * ENABLING does all of the following again each time, within enable_timeout_us:
 *  1. NMT "enter pre-operational" to the node. Not a reset: that would take the drive's boot time,
 *     and a boot-up message is our sign that a drive has lost its settings. (While enabling it
 *     starts the set-up anew: the drive has just been switched on.)
 *  2. Expedited SDO downloads, in this order, little endian. Each may take 100 ms and is asked 3
 *     times, each repetition after another NMT "enter pre-operational". (o): optional, a drive that
 *     says that it has no such object or sub-index is taken as it is.
 *       0x6040      controlword 2: quick stop, whatever state a former master left behind
 *       0x1017      producer heartbeat, a third of heartbeat_timeout_us. Then the heartbeat is
 *                   waited for until it says pre-operational, and NMT is repeated each 100 ms
 *       0x6040      controlword 0: disable voltage, for drives that change their mode or mapping
 *                   only so. A wheel that is still too fast for the quick stop runs out now
 *       0x1016:1    consumer heartbeat: master_node, heartbeat_timeout_us
 *       0x6060      mode of operation
 *       0x6007 (o)  abort connection option: 3, quick stop when our heartbeat is lost
 *       0x605A (o)  quick stop option: 6, down the quick stop ramp, and stay under torque
 *       0x60C2:1, :2 (o)  interpolation period, mode 9 only
 *       0x1400, 0x1600    RPDO1: controlword 0x6040, target velocity 0x60FF; synchronous (type 1)
 *       0x1800, 0x1A00    TPDO1: statusword 0x6041, actual velocity 0x606C; synchronous
 *       0x1801, 0x1A01    TPDO2: actual position 0x6064, synchronous, with has_position; without it
 *                         TPDO2 is switched off (o)
 *       0x1802, 0x1803 (o)  TPDO3 and TPDO4 are switched off
 *     A PDO is changed as CiA 301 has it: COB-ID with bit 31 (invalid), transmission type, number
 *     of mapped objects 0, the objects, their number, COB-ID valid. RPDO2 to 4 are left alone: no
 *     frame of ours has their identifiers.
 *  3. NMT "start", repeated each 100 ms until the heartbeat says operational.
 *  4. The 402 state machine, by one RPDO each period, from whatever the statusword tells: fault:
 *     reset by rising edges of controlword bit 7, at least 20 ms each level, until it is gone;
 *     then shutdown, switch on, enable operation. Operation that we have not enabled, and an
 *     active quick stop, are left by disable voltage first.
 *  5. With operation enabled and the speed zero, SDO upload of the mode display 0x6061, as often
 *     and as long as any request: only the mode asked for makes the drive ENABLED. Not before,
 *     because some drives tell another mode until then.
 *
 * EACH PERIOD: berth_drive_cycle puts RPDO1 (0x200 + node: controlword, target velocity) and
 * berth_drive_sync puts SYNC (0x080), on which all drives obey and answer at once, and our
 * heartbeat (0x700 + master_node: operational). Both are for the whole bus, so sync puts them in
 * every state of the drive it is called with. Where the period is longer than
 * BERTH_CIA402_SYNC_US, berth_drive_step puts more SYNCs, evenly, so that feedback is never older
 * than that when a control step wants it; 0x60C2 is the time between two SYNCs. Drives of one
 * period in one outbox share them. The drive's watchdog is our heartbeat: when it is
 * lost for heartbeat_timeout_us, the drive does what 0x6007 says. Drives without that object do
 * what their maker has decided: try it, wheels off the ground.
 *
 * STOP: controlword 2 and zero speed by RPDO1, at once with a SYNC of its own, and by SDO, which is
 * heard even by a drive that is not operational; then by RPDO1 each period (by SDO too where the
 * heartbeat says that the drive is not operational, by SDO alone where its PDOs are not set up).
 * With 0x605A = 6 the drive stands under torque, else as its own option says.
 * EMERGENCY STOP: the same, and controlword 0 (disable voltage) once the wheel is measured to turn
 * at less than BERTH_CIA402_STANDING_RADPS.
 * DISABLE: controlword 0 by RPDO1 and a SYNC, by SDO, and NMT "enter pre-operational".
 *
 * FEEDBACK: velocity from TPDO1; travel from the differences of TPDO2's counts, modulo 2^32. The
 * quantum of the position is 1 / counts_per_turn. The time of a feedback is that of its frame.
 *
 * FAULTS and their codes:
 *   FEEDBACK      no TPDO1 within feedback_timeout_us: SYNC or the drive's TPDO is lost
 *   HEARTBEAT     no heartbeat of the drive's within heartbeat_timeout_us
 *   EMERGENCY     an emergency message; code: its error code (CiA 301: 0x1000 generic, 0x2xxx
 *                 current, 0x3xxx voltage, 0x4xxx temperature, 0x5xxx hardware, 0x6xxx software,
 *                 0x7xxx additional modules, 0x8130 heartbeat lost, 0x8xxx other monitoring,
 *                 0x9xxx external, 0xFxxx additional functions). Code 0 says that errors are gone:
 *                 no fault. Not while enabling before the drive was seen free of faults: that is
 *                 what the fault reset is for
 *   DEVICE        the statusword says fault (or that the reaction to one runs), or said so until
 *                 enable_timeout_us whatever was reset; code: error code of the last emergency
 *                 message, 0 when there was none
 *   DISABLED      BERTH_CIA402_CODE_NMT + NMT state: the heartbeat says that it is not operational
 *                 any more (0: it has booted anew); BERTH_CIA402_CODE_STATUS + statusword: it left
 *                 operation enabled
 *   ENABLE        code as of DISABLED, with what was told last: the NMT state waited for did not
 *                 come (NMT state 0: none was told), or operation did not become enabled. Where it
 *                 was still being set up: index << 8 | sub-index of the present request
 *   SETUP         code: SDO abort code, or BERTH_CIA402_CODE_MODE + the mode that 0x6061 tells
 *   SETUP_SILENT  code: index << 8 | sub-index
 *
 * SDO abort codes that drives send most: 0x05040001 command unknown, 0x06010000 access not
 * supported, 0x06010002 read only, 0x06020000 no such object, 0x06040041 object cannot be mapped,
 * 0x06040042 mapping longer than the PDO, 0x06040043 parameters incompatible (another 0x1016 entry
 * names master_node already), 0x06070010 length of the type does not match, 0x06090011 no such
 * sub-index, 0x06090030 value out of range (a mode that the drive does not have), 0x08000000
 * general, 0x08000020 cannot be stored, 0x08000021 because of local control, 0x08000022 because of
 * the present device state.
 *
 * COUNTERS: saturated: target velocity beyond int32. malformed: a wrong length, a remote frame, an
 * NMT state or an SDO command that does not exist or does not fit, a speed above 1e9 turns/s, a
 * position that jumps. Answers to what was not asked
 * (late ones, after a repetition) are good and mean nothing.
 *
 * Frames each period: RPDO1 and our heartbeat; each SYNC: itself, TPDO1, with has_position TPDO2.
 */
#ifndef BERTH_DRIVE_CIA402_H
#define BERTH_DRIVE_CIA402_H

#include "berth/drive.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A request of the set-up: how long an answer may take, and how often it is asked. */
#define BERTH_CIA402_ANSWER_US 100000
#define BERTH_CIA402_TRIES 3u

/* How often an NMT command is repeated until the heartbeat says that it was obeyed, and for how
 * long at least each level of the fault reset bit is held. */
#define BERTH_CIA402_NMT_REPEAT_US 100000
#define BERTH_CIA402_RESET_HOLD_US 20000

/* Longest time between two SYNCs while the drive's PDOs are ours. */
#define BERTH_CIA402_SYNC_US 10000u

/* A wheel below this stands, for the end of an emergency stop. */
#define BERTH_CIA402_STANDING_RADPS 0.1f

/* What a fault's code is counted from: see above. */
#define BERTH_CIA402_CODE_NMT 0x10000u
#define BERTH_CIA402_CODE_STATUS 0x20000u
#define BERTH_CIA402_CODE_MODE 0x60610000u

#ifdef __cplusplus
}
#endif

#endif
