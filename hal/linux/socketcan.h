/* socketcan.h - a CAN bus of Linux: one raw socket on one interface.
 *
 *     socketcan_t bus;
 *     char error[160];
 *     if (!socketcan_open(&bus, "can0", filters, 3, error, sizeof error))
 *         ... print error ...
 *     berth_can_t can = socketcan_can(&bus);
 *
 * One thread. Nothing blocks, except that opening the socket and asking for a restart may wait for
 * the kernel's network configuration lock, which somebody's `ip link` holds for a moment; both
 * happen only while the bus is down or off.
 *
 * Receive. Only the ids asked for come through the kernel's filter, and all error frames. time_us
 * is when the kernel got the frame, on CLOCK_MONOTONIC; where the adapter stamps frames, its stamps
 * are mapped onto that clock (see stamp.h). Stamps never go backwards. In the first
 * moments after the first socket on the machine asks for stamps, the kernel stamps on fetching.
 *
 * Send. DONE: the kernel has queued it. AGAIN: its queue is full (ENOBUFS, EAGAIN), or
 * SOCKETCAN_IN_FLIGHT_MAX frames wait for their confirmation. The socket receives its own frames
 * back when they have gone out, and counts them; they are never handed out. A frame that is not
 * confirmed within a second, or not before the bus goes off or down, is counted in tx_dropped. The
 * confirmation passes the kernel's filter as well: an id that is sent for the first time is added
 * to it, up to SOCKETCAN_SENT_IDS_MAX of them; frames with yet others are sent, but not tracked.
 * Frames of other nodes with an id that is ours to send are counted (statistics.foreign) and not
 * handed out. What the kernel has queued goes out when the bus can take it again, old as it is:
 * keep its queue short (`ip link set can0 txqueuelen 10`, the default of real interfaces).
 *
 * Down. ENETDOWN, ENODEV, ENXIO and whatever else the socket fails with: FAILED, mode DOWN. send,
 * receive and state look for the interface by its name, every 50 ms at most, and open a new socket
 * when it is there and up, even if it was deleted and made again: one restart is counted.
 *
 * Bus-off. Told by an error frame. send and receive answer FAILED. It is left
 *  - when the controller tells that it was restarted (by `restart-ms` of the interface, by
 * somebody's `ip link set can0 type can restart`, or at our request);
 *  - at our request: the interface is asked for a restart 100 ms after bus-off, then once a second
 *    (needs CAP_NET_ADMIN). Where restart-ms is set, or rights are missing, the kernel refuses,
 * which statistics.restart_errno tells;
 *  - when a frame comes in from the bus 500 ms or more after the report: a controller that is off
 *    receives nothing, so the report is out of date. For interfaces without restart (vcan, where
 *    bus-off is a rehearsal) only this and socketcan_restart help. Frames that come in before are
 *    dropped and counted: they may have been in the queue when the bus went off;
 *  - when the interface goes down and up.
 *
 * Whoever drives something latches the fault (the board's supervisor does): that the bus is back
 * must not start a motor.
 *
 * Error passive is entered and left by the controller's error frames, and left by a restart.
 */
#ifndef BERTH_HAL_SOCKETCAN_H
#define BERTH_HAL_SOCKETCAN_H

#include "berth_hal/can.h"
#include "stamp.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define SOCKETCAN_FILTERS_MAX 64u
#define SOCKETCAN_SENT_IDS_MAX 64u
#define SOCKETCAN_IN_FLIGHT_MAX 32u
#define SOCKETCAN_NAME_MAX 15u       /* characters of an interface's name */
#define SOCKETCAN_RECEIVE_MAX 64u    /* messages read in one call of receive, at most */
#define SOCKETCAN_RETRY_US 50000     /* between two looks for an interface that is down */
#define SOCKETCAN_CONFIRM_US 1000000 /* for a frame to be confirmed */
#define SOCKETCAN_RESTART_FIRST_US 100000
#define SOCKETCAN_RESTART_US 1000000
#define SOCKETCAN_STALE_US 500000

/* Error frames, by class: one frame may belong to several. */
typedef struct {
    uint32_t tx_timeout;
    uint32_t lost_arbitration;
    uint32_t controller;
    uint32_t protocol;
    uint32_t transceiver;
    uint32_t no_acknowledge;
    uint32_t bus_off;
    uint32_t bus_error;
    uint32_t restarted;
} socketcan_errors_t;

/* Since socketcan_open; they stay at their largest value. */
typedef struct {
    uint32_t sent;       /* taken by send */
    uint32_t confirmed;  /* of those, seen going out: own echoes */
    uint32_t untracked;  /* of those, with ids beyond SOCKETCAN_SENT_IDS_MAX */
    uint32_t unknown;    /* unconfirmed, but their echo may have been lost in our own overflow */
    uint32_t late;       /* echoes of frames already given up */
    uint32_t queue_full; /* sends answered AGAIN */
    uint32_t refused;    /* sends of frames out of range */
    uint32_t received;   /* handed out */
    uint32_t foreign;    /* of others, with an id that only we should send */
    uint32_t discarded;  /* received while bus-off */
    uint32_t malformed;  /* messages that are no classical CAN frame */
    uint32_t opened;     /* sockets opened */
    uint32_t restarts_asked;
    int restart_errno; /* of the last of those; 0: granted, or none asked */
    int last_errno;    /* why the bus was last down or could not be opened */
    uint8_t tx_errors; /* the controller's error counters, as last reported */
    uint8_t rx_errors;
    bool hardware_stamps; /* the last frame's stamp came from the adapter */
    socketcan_errors_t errors;
} socketcan_statistics_t;

typedef struct {
    uint32_t id; /* in the kernel's form, with its flags */
    uint32_t overflow;
    int64_t sent_us;
} socketcan_slot_t;

/* The fields are socketcan.c's own. */
typedef struct {
    int fd; /* -1: no socket */
    uint32_t interface_index;
    bool down;
    bool off;     /* bus-off */
    bool passive; /* error passive */
    int64_t retry_us;
    int64_t off_us;     /* when bus-off was reported */
    int64_t restart_us; /* when to ask for a restart next */
    int64_t last_us;    /* stamp of the last frame */
    uint32_t overflow;  /* the socket's own count of lost messages */
    berth_can_state_t counters;
    socketcan_statistics_t statistics;
    stamp_map_t stamps;
    uint32_t filter_count, sent_id_count;
    uint32_t flight_at, flight_count;
    char name[SOCKETCAN_NAME_MAX + 1u];
    berth_can_filter_t filters[SOCKETCAN_FILTERS_MAX];
    uint32_t sent_ids[SOCKETCAN_SENT_IDS_MAX];
    socketcan_slot_t flight[SOCKETCAN_IN_FLIGHT_MAX]; /* a ring, oldest first */
} socketcan_t;

/* The frames wanted: at most SOCKETCAN_FILTERS_MAX filters, copied; none at all: every frame. False
 * with a sentence in error (what, where, why) for a name or filters out of range, an interface that
 * does not exist or is not CAN, a kernel without CAN. An interface that is down is no failure. */
bool socketcan_open(socketcan_t *bus, const char *name, const berth_can_filter_t *filters,
                    uint32_t filter_count, char *error, size_t error_size);

/* The bus; its context is bus. */
berth_can_t socketcan_can(socketcan_t *bus);

/* The descriptor to wait on, or -1 while there is none. It changes when the interface returns. */
int socketcan_fd(const socketcan_t *bus);

/* Asks the interface to leave bus-off, now. True if it was granted; the mode changes when the
 * controller reports. Also true, and error active at once, where the interface has no restart to
 * offer (vcan). False if the bus is not off, or the request was refused (statistics.restart_errno).
 */
bool socketcan_restart(socketcan_t *bus);

socketcan_statistics_t socketcan_statistics(const socketcan_t *bus);

/* Harmless when repeated. */
void socketcan_close(socketcan_t *bus);

#ifdef __cplusplus
}
#endif

#endif
