/* slcan.h - a CAN bus over a line of bytes, in the Lawicel ASCII protocol (CAN232, CANUSB,
 * "slcan").
 *
 * One line a frame: t and T carry data with an 11 or a 29 bit id, r and R are remote frames, then
 * the id, the length digit, the data in hexadecimal, and a carriage return. USB adapters, Linux's
 * slcan, can-utils and python-can speak it.
 *
 *     static slcan_t line;
 *     const slcan_config_t config = {SLCAN_HOST, uart, clock, filters, 4};
 *     slcan_init(&line, &config);
 *     berth_can_t can = slcan_can(&line);
 *
 * The two roles:
 *
 *   SLCAN_HOST     we use an adapter. Closes, sets 1 Mbit/s and opens it (C, S8, O), at the start
 *                  and after each loss of the line, and asks for its status flags (F) twice a
 *                  second: they give error passive, lost frames and bus errors, and a refusal means
 *                  that the adapter was switched off and on again: it is opened anew. A peer that
 *                  sends commands itself (python-can, or another host like this one) gets answers.
 *                  It gets no BELL, which an adapter could not bear. Usable whenever the line is:
 *                  the protocol has no word for bus-off.
 *   SLCAN_ADAPTER  we are the adapter. Down until the peer opens the channel (O, or L to listen
 *                  only), and when it closes it. Its commands are answered: C, S0 to S8, s, O, L,
 *                  V, N, F, Z0, Z1, X1 and the frames; any other, and any in the wrong state, with
 *                  BELL. The bit rate is whatever is behind this line, so S is not obeyed.
 *
 * Down until the first call of receive, which finds the line, as it does after each loss.
 *
 * Received lines that are too long, have an id or a length out of range or anything after the data
 * but a time stamp of four digits are dropped and counted: in counts.malformed, and in error_frames
 * of the state, because on such a line they are what bus errors are on a bus. Both cases of
 * hexadecimal digits are read, upper case is written.
 *
 * The state's other counters: tx_dropped has frames that an adapter refused with BELL and those
 * that waited when the line was lost; rx_lost how often the adapter's flags told of an overrun;
 * restarts the returns from down.
 *
 * Portable C11: no heap, no recursion; about 700 bytes a line. send costs at most 40 bytes
 * formatted and two writes; receive parses until the first frame that passes the filters, at most
 * SLCAN_RECEIVE_BYTES a call. time_us of a received frame is when its line was parsed.
 */
#ifndef BERTH_HAL_SLCAN_H
#define BERTH_HAL_SLCAN_H

#include "berth_hal/can.h"
#include "berth_hal/clock.h"
#include "byte_stream.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* MISRA T1 in this file. */

#ifdef __cplusplus
extern "C" {
#endif

/* The longest line: T, 8 digits, a length, 16 digits, a time stamp of 4, and the return. */
#define SLCAN_LINE_MAX 31u

/* Bytes that wait to be written: 18 of the longest frames. */
#ifndef SLCAN_TRANSMIT_BYTES
#define SLCAN_TRANSMIT_BYTES 512u
#endif
#define SLCAN_CHUNK_BYTES 64u     /* read at once */
#define SLCAN_RECEIVE_BYTES 4096u /* parsed in one call of receive, at most */
#define SLCAN_POLL_US 500000      /* between two questions for the status flags */

typedef enum { SLCAN_HOST, SLCAN_ADAPTER } slcan_role_t;

typedef struct {
    slcan_role_t role;
    byte_stream_t stream;
    berth_clock_t clock;               /* now_us alone is used */
    const berth_can_filter_t *filters; /* frames wanted, read during use: must stay */
    uint32_t filter_count;             /* 0: all frames */
} slcan_config_t;

/* Since slcan_init; they stay at their largest value. */
typedef struct {
    uint32_t received;  /* frames handed out */
    uint32_t filtered;  /* frames that no filter wants */
    uint32_t sent;      /* frames taken by send */
    uint32_t commands;  /* commands of the peer, with the refused ones */
    uint32_t malformed; /* lines dropped */
    uint32_t refused;   /* BELL received */
    uint32_t unsaid;    /* answers that found no room */
    uint32_t setups;    /* times that an adapter was set up */
} slcan_counts_t;

/* The fields are slcan.c's own. */
typedef struct {
    slcan_config_t config;
    slcan_counts_t counts;
    berth_can_state_t state; /* its mode: error active or passive, when usable */
    bool lost;               /* the stream failed and has not worked since */
    bool open;               /* adapter: the peer has opened the channel. host: always */
    bool opened_before;
    bool listen_only;      /* adapter: the peer may not send */
    bool stamps;           /* adapter: the peer wants time stamps */
    bool skipping;         /* the line is too long: dropped up to its end */
    bool answered;         /* host: status flags came since they were asked for */
    bool bell;             /* host: a BELL came since then */
    uint8_t unsettled;     /* host: frames sent that the peer has not answered, up to 255 */
    uint8_t setup_answers; /* host: answers to the set-up that have not come yet */
    int64_t poll_us;       /* host: when to ask next */
    uint8_t line_length;
    uint8_t chunk_at, chunk_end;
    uint16_t transmit_at, transmit_end;
    char line[SLCAN_LINE_MAX];
    uint8_t chunk[SLCAN_CHUNK_BYTES];
    uint8_t transmit[SLCAN_TRANSMIT_BYTES];
} slcan_t;

/* The config is copied; what it points to must outlive the line. Nothing is written yet. */
void slcan_init(slcan_t *line, const slcan_config_t *config);

/* The bus; its context is the line. */
berth_can_t slcan_can(slcan_t *line);

slcan_counts_t slcan_counts(const slcan_t *line);

/* The codec by itself. The frame's length is at most 8 and its id within its range. Returns the
 * number of characters, the return included; no NUL is added. */
size_t slcan_encode(const berth_can_frame_t *frame, char line[SLCAN_LINE_MAX]);

/* A line without its return. False, and *frame as it was, if it is not exactly a frame, with or
 * without a time stamp. Bytes beyond the length are 0, time_us is 0. */
bool slcan_decode(const char *line, size_t length, berth_can_frame_t *frame);

#ifdef __cplusplus
}
#endif

#endif
