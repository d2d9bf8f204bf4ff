#include "drive_says.h"

#include <string.h>

static uint32_t le(const uint8_t *data, uint32_t count) {
    uint32_t value = 0;
    for (uint32_t i = 0; i < count; i++) {
        value |= (uint32_t)data[i] << (8 * i);
    }
    return value;
}

static double as_signed(uint32_t value) {
    return value < 0x80000000u ? (double)value : (double)value - 4294967296.0;
}

static bool odrive(const berth_drive_t *drive, const berth_can_frame_t *frame, said_t *said) {
    if (frame->extended || frame->id >> 5 != drive->config.node) {
        return false;
    }
    float speed;
    switch (frame->id & 31u) {
    case 0x0D: /* input velocity, without torque */
        memcpy(&speed, frame->data, sizeof speed);
        said->speed = true;
        said->motor_rps = (double)speed;
        return frame->length == 8 && le(frame->data + 4, 4) == 0;
    case 0x07: /* axis state: idle or closed loop */
        said->enables = le(frame->data, 4) == 8;
        return frame->length == 4 && (said->enables || le(frame->data, 4) == 1);
    case 0x0B: /* velocity control, passed through */
        return frame->length == 8 && le(frame->data, 4) == 2 && le(frame->data + 4, 4) == 1;
    case 0x02: /* emergency stop */
    case 0x18: /* clear errors */
        return frame->length == 0;
    default:
        return false;
    }
}

static bool vesc(const berth_drive_t *drive, const berth_can_frame_t *frame, said_t *said) {
    if (!frame->extended || (frame->id & 0xffu) != drive->config.node || frame->length != 4) {
        return false;
    }
    const uint32_t value = (uint32_t)frame->data[0] << 24 | (uint32_t)frame->data[1] << 16 |
                           (uint32_t)frame->data[2] << 8 | frame->data[3];
    const double per_rps = 60.0 * drive->config.pole_pairs;
    switch (frame->id >> 8) {
    case 3: /* electrical speed */
        said->speed = true;
        said->motor_rps = as_signed(value) / per_rps;
        said->quantum_rps = 1.0 / per_rps;
        return true;
    case 0: /* duty */
    case 1: /* current */
        return value == 0;
    default:
        return false;
    }
}

static bool cia402(const berth_drive_t *drive, const berth_can_frame_t *frame, said_t *said) {
    const uint32_t node = drive->config.node;
    const double per_rps = (double)drive->config.velocity_units_per_rps;
    if (frame->extended) {
        return false;
    }
    if (frame->id == 0x200 + node) { /* controlword and target velocity */
        said->speed = true;
        said->motor_rps = as_signed(le(frame->data + 2, 4)) / per_rps;
        said->quantum_rps = 1.0 / per_rps;
        said->enables = le(frame->data, 2) != 0 && le(frame->data, 2) != 2;
        return frame->length == 6;
    }
    if (frame->id == 0x600 + node) { /* a request; a controlword by it never gives torque */
        const bool word = le(frame->data + 1, 2) == 0x6040;
        return frame->length == 8 &&
               (!word || le(frame->data + 4, 4) == 0 || le(frame->data + 4, 4) == 2);
    }
    if (frame->id == 0) { /* network management, for this node alone */
        return frame->length == 2 && frame->data[1] == node;
    }
    return (frame->id == 0x80 && frame->length == 0) ||
           (frame->id == 0x700u + drive->config.master_node && frame->length == 1);
}

bool drive_says(const berth_drive_t *drive, const berth_can_frame_t *frame, said_t *said) {
    const berth_drive_protocol_t *protocol = drive->config.protocol;
    *said = (said_t){.speed = false};
    if (protocol == &berth_drive_odrive) {
        return odrive(drive, frame, said);
    }
    return protocol == &berth_drive_vesc ? vesc(drive, frame, said) : cia402(drive, frame, said);
}
