/* can_wire.h - a classical CAN 2.0 frame as it stands on the wire: its bits, its check sum, its
 * length and its rank in arbitration.
 *
 * Written from ISO 11898-1. A data or remote frame is, in this order:
 *
 *   standard  SOF, id 11, RTR, IDE = 0, r0, DLC 4, data, CRC 15
 *   extended  SOF, base id 11, SRR = 1, IDE = 1, id 18, RTR, r1, r0, DLC 4, data, CRC 15
 *
 * all of which is stuffed: after five equal bits, stuff bits included, one opposite bit follows.
 * Then, unstuffed: CRC delimiter, ACK slot, ACK delimiter, EOF 7; and an intermission of 3 before
 * the next frame. Dominant is 0, recessive is 1.
 *
 * Pure functions; frames must satisfy can_wire_valid.
 */
#ifndef CAN_WIRE_H
#define CAN_WIRE_H

#include "berth_hal/can.h"

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Bit times after the stuffed part. */
#define CAN_WIRE_CRC_DELIMITER 1u
#define CAN_WIRE_ACK 2u /* slot and delimiter */
#define CAN_WIRE_EOF 7u
#define CAN_WIRE_INTERMISSION 3u
#define CAN_WIRE_TAIL (CAN_WIRE_CRC_DELIMITER + CAN_WIRE_ACK + CAN_WIRE_EOF)

/* An error frame: two superposed flags of 6, as when one node sees the error first, and the
 * delimiter of 8. */
#define CAN_WIRE_ERROR_FRAME 20u

/* What else follows the rules of the bus. */
#define CAN_WIRE_SUSPEND 8u            /* an error passive node waits so long after its frame */
#define CAN_WIRE_RECOVERY (128u * 11u) /* recessive bits before a bus-off node may come back */

/* The longest stuffed part: an extended frame of 8 bytes has 118 bits and at most 29 stuffed. */
#define CAN_WIRE_STUFFED_MAX 147u

/* Is the identifier in its range, and the length at most 8? */
bool can_wire_valid(const berth_can_frame_t *frame);

/* The 15-bit check sum (polynomial x15+x14+x10+x8+x7+x4+x3+1) over SOF to the last data bit. */
uint16_t can_wire_crc(const berth_can_frame_t *frame);

/* Writes the stuffed part, SOF to CRC, a bit a byte, and returns how many bits these are.
 * About 1000 operations. */
uint32_t can_wire_stuffed(const berth_can_frame_t *frame, uint8_t bits[CAN_WIRE_STUFFED_MAX]);

/* Bit times of the whole frame, SOF to the last bit of EOF; without the intermission. */
uint32_t can_wire_bits(const berth_can_frame_t *frame);

/* The arbitration field as a number, most significant bit first on the wire: of two frames that
 * start together, the one with the smaller number stays. Frames with the same number have the same
 * identifier, format and type. */
uint32_t can_wire_rank(const berth_can_frame_t *frame);

#ifdef __cplusplus
}
#endif

#endif
