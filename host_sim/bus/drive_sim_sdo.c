/* The SDO server: expedited transfers both ways, segmented uploads for the one text. Other
 * transfers are refused as an unknown command, as CiA 301 lets a simple device do.
 */
#include "drive_sim_inner.h"

#include <string.h>

enum {
    DOWNLOAD_SEGMENT = 0,
    DOWNLOAD = 1,
    UPLOAD = 2,
    UPLOAD_SEGMENT = 3,
    ABORT = 4
}; /* what the client asks for, in the first byte's upper three bits */

enum { SCS_DOWNLOADED = 0x60, SCS_UPLOAD = 0x40, SCS_ABORT = 0x80 };
enum { EXPEDITED = 0x02, SIZE_TOLD = 0x01, TOGGLE = 0x10 };

#define SEGMENT 7u

static berth_can_frame_t response(const drive_sim_t *sim, uint8_t command, uint32_t multiplexer) {
    berth_can_frame_t frame = {.id = 0x580u + sim->config.node, .length = 8};
    frame.data[0] = command;
    drive_sim_put_le(&frame.data[1], multiplexer, 3);
    return frame;
}

static void refuse(drive_sim_t *sim, uint32_t multiplexer, uint32_t abort_code) {
    berth_can_frame_t frame = response(sim, SCS_ABORT, multiplexer);
    drive_sim_put_le(&frame.data[4], abort_code, 4);
    sim->state.cia402.uploading = false;
    drive_sim_put(sim, &frame);
}

/* A download that is not expedited: what is wrong with the object comes first. */
static uint32_t refusal_of_segments(drive_sim_t *sim, uint32_t multiplexer) {
    uint32_t value;
    unsigned size;
    const uint32_t abort_code = canopen_read(sim, multiplexer, &value, &size);
    return abort_code != 0 ? abort_code : CANOPEN_ABORT_COMMAND;
}

static void download(drive_sim_t *sim, const uint8_t *data, uint32_t multiplexer) {
    uint32_t abort_code;
    if (sim->trouble.refuse_setup) {
        abort_code = CANOPEN_ABORT_STATE;
    } else if ((data[0] & EXPEDITED) == 0) {
        abort_code = refusal_of_segments(sim, multiplexer);
    } else {
        const unsigned size = (data[0] & SIZE_TOLD) != 0 ? 4u - (data[0] >> 2 & 3u) : 0u;
        const uint32_t value = drive_sim_get_le(&data[4], size == 0 ? 4 : size);
        abort_code = canopen_write(sim, multiplexer, value, size);
    }
    if (abort_code != 0) {
        refuse(sim, multiplexer, abort_code);
        return;
    }
    const berth_can_frame_t frame = response(sim, SCS_DOWNLOADED, multiplexer);
    drive_sim_put(sim, &frame);
}

static void upload(drive_sim_t *sim, uint32_t multiplexer) {
    uint32_t value = 0;
    unsigned size = 0;
    const uint32_t abort_code = canopen_read(sim, multiplexer, &value, &size);
    if (abort_code != 0) {
        refuse(sim, multiplexer, abort_code);
        return;
    }
    drive_sim_cia402_state_t *state = &sim->state.cia402;
    berth_can_frame_t frame = response(sim, (uint8_t)SCS_UPLOAD | (uint8_t)SIZE_TOLD, multiplexer);
    if (size == 0) {
        state->uploading = true;
        state->toggle = false;
        state->uploaded = 0;
        drive_sim_put_le(&frame.data[4], (uint32_t)strlen(canopen_name()), 4);
    } else {
        frame.data[0] = (uint8_t)(frame.data[0] | EXPEDITED | (4u - size) << 2);
        drive_sim_put_le(&frame.data[4], value, size);
    }
    drive_sim_put(sim, &frame);
}

static void upload_segment(drive_sim_t *sim, const uint8_t *data) {
    drive_sim_cia402_state_t *state = &sim->state.cia402;
    const uint32_t multiplexer = 0x1008;
    if (!state->uploading) {
        refuse(sim, 0, CANOPEN_ABORT_COMMAND);
        return;
    }
    if (((data[0] & TOGGLE) != 0) != state->toggle) {
        refuse(sim, multiplexer, CANOPEN_ABORT_TOGGLE);
        return;
    }
    const unsigned left = (unsigned)strlen(canopen_name()) - state->uploaded;
    const unsigned count = left < SEGMENT ? left : SEGMENT;
    const bool last = count == left;
    berth_can_frame_t frame = response(sim, 0, 0);
    frame.data[0] =
        (uint8_t)((state->toggle ? TOGGLE : 0u) | (SEGMENT - count) << 1 | (last ? 1u : 0u));
    memcpy(&frame.data[1], canopen_name() + state->uploaded, count);
    state->uploaded += count;
    state->toggle = !state->toggle;
    state->uploading = !last;
    drive_sim_put(sim, &frame);
}

void canopen_sdo_receive(drive_sim_t *sim, const berth_can_frame_t *frame) {
    if (frame->length != 8 || frame->remote) {
        sim->counters.malformed++;
        return;
    }
    const uint32_t multiplexer = drive_sim_get_le(&frame->data[1], 3);
    switch (frame->data[0] >> 5) {
    case DOWNLOAD:
        sim->state.cia402.uploading = false;
        download(sim, frame->data, multiplexer);
        return;
    case UPLOAD:
        sim->state.cia402.uploading = false;
        upload(sim, multiplexer);
        return;
    case UPLOAD_SEGMENT:
        upload_segment(sim, frame->data);
        return;
    case ABORT:
        sim->state.cia402.uploading = false;
        return;
    case DOWNLOAD_SEGMENT:
        refuse(sim, 0, CANOPEN_ABORT_COMMAND);
        return;
    default:
        refuse(sim, multiplexer, CANOPEN_ABORT_COMMAND);
        return;
    }
}
