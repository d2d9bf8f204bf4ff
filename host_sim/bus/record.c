#include "record.h"

#include "refusal.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>

/* A record of a board that lost its power is good up to its last second. */
#define FLUSH_US 1000000

bool record_open(record_t *record, const char *path, const char *channel, scenario_error_t *error) {
    *record = (record_t){.file = NULL};
    if (strlen(channel) >= sizeof record->channel || strcspn(channel, " \n") != strlen(channel) ||
        strcmp(channel, RECORD_CHANNEL) == 0) {
        return refuse(error,
                      "--record: '%.40s' cannot name the bus in a log (allowed: at most %d "
                      "characters, no blanks, not '" RECORD_CHANNEL "')",
                      channel, CANDUMP_CHANNEL_MAX - 1);
    }
    strcpy(record->channel, channel);
    record->path = strdup(path);
    record->file = record->path != NULL ? fopen(path, "w") : NULL;
    if (record->file == NULL) {
        const int reason = errno;
        free(record->path);
        *record = (record_t){.file = NULL};
        return refuse(error, "--record: cannot write %.200s: %s", path, strerror(reason));
    }
    return true;
}

static void put_event(record_t *record, uint32_t id, const void *data, size_t length,
                      int64_t now_us) {
    berth_can_frame_t frame = {.time_us = now_us, .id = id, .length = (uint8_t)length};
    if (length > 0) {
        memcpy(frame.data, data, length);
    }
    candump_print(record->file, RECORD_CHANNEL, &frame, CANDUMP_UNKNOWN);
}

static berth_can_outcome_t send(void *context, const berth_can_frame_t *frame) {
    record_t *record = context;
    const berth_can_outcome_t outcome = record->inner.api->send(record->inner.context, frame);
    if (outcome == BERTH_CAN_DONE) {
        berth_can_frame_t sent = *frame;
        sent.time_us = record->now_us;
        candump_print(record->file, record->channel, &sent, CANDUMP_SENT);
    } else {
        put_event(record, outcome == BERTH_CAN_AGAIN ? RECORD_SEND_AGAIN : RECORD_SEND_FAILED, NULL,
                  0, record->now_us);
    }
    return outcome;
}

static berth_can_outcome_t receive(void *context, berth_can_frame_t *frame) {
    record_t *record = context;
    const berth_can_outcome_t outcome = record->inner.api->receive(record->inner.context, frame);
    if (outcome == BERTH_CAN_DONE) {
        if (frame->time_us < 0) {
            frame->time_us = 0; /* which the line can hold */
        }
        candump_print(record->file, record->channel, frame, CANDUMP_RECEIVED);
    } else if (outcome != BERTH_CAN_AGAIN) {
        put_event(record, RECORD_RECEIVE_FAILED, NULL, 0, record->now_us);
    }
    return outcome;
}

static void state(void *context, berth_can_state_t *out) {
    record_t *record = context;
    record->inner.api->state(record->inner.context, out);
    if (!record->mode_known || out->mode != record->mode) {
        const uint8_t mode = (uint8_t)out->mode;
        put_event(record, RECORD_MODE, &mode, 1, record->now_us);
        record->mode = out->mode;
        record->mode_known = true;
    }
}

static const berth_can_api_t api = {send, receive, state};

berth_can_t record_can(record_t *record, const berth_can_t *inner) {
    record->inner = *inner;
    return (berth_can_t){&api, record};
}

void record_setup(record_t *record, const char *text, int64_t now_us) {
    size_t left = strlen(text);
    while (left > 0) {
        const size_t part = left < BERTH_CAN_DATA_MAX ? left : BERTH_CAN_DATA_MAX;
        put_event(record, RECORD_SETUP, text, part, now_us);
        text += part;
        left -= part;
    }
}

/* This machine is little endian or the next lines would not say what the header does. */
_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "records are little endian");

void record_init(record_t *record, uint32_t plan_crc, int64_t now_us) {
    put_event(record, RECORD_INIT, &plan_crc, sizeof plan_crc, now_us);
}

void record_pose(record_t *record, const berth_pose_t *pose, int64_t now_us) {
    const float place[2] = {pose->x_m, pose->y_m};
    put_event(record, RECORD_PUT, place, sizeof place, now_us);
    put_event(record, RECORD_PUT_HEADING, &pose->theta_rad, sizeof pose->theta_rad, now_us);
}

void record_command(record_t *record, berth_command_code_t command, int64_t now_us) {
    const uint8_t code = (uint8_t)command;
    put_event(record, RECORD_COMMAND, &code, 1, now_us);
}

void record_run(record_t *record, int64_t now_us) {
    record->now_us = now_us;
    if (now_us >= record->flush_us) {
        record->flush_us = now_us + FLUSH_US;
        (void)fflush(record->file);
    }
    put_event(record, RECORD_RUN, NULL, 0, now_us);
}

bool record_close(record_t *record, scenario_error_t *error) {
    if (record->file == NULL) {
        return true;
    }
    errno = 0;
    bool good = ferror(record->file) == 0;
    good = fclose(record->file) == 0 && good;
    const int reason = errno;
    if (!good) {
        (void)refuse(error, "--record: cannot write all of %.200s: %s", record->path,
                     reason != 0 ? strerror(reason) : "write error");
    }
    free(record->path);
    *record = (record_t){.file = NULL};
    return good;
}
