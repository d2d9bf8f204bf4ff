/* can_open.h - a CAN bus from a word of the command line.
 *
 *     socketcan:NAME   the interface NAME of this machine (vcan0, can0)
 *     slcan:PATH       Lawicel frames over PATH: a tty, a pty, or a unix socket (see stream.h)
 *
 *     can_port_t port;
 *     char error[CAN_OPEN_ERROR_MAX];
 *     if (!can_open(&port, "socketcan:vcan0", filters, 3, error, sizeof error))
 *         ... print error ...
 *     realtime_init(&timer, &port.wait);
 *     berth_link_init(&link, &board, &port.can);
 */
#ifndef BERTH_HAL_CAN_OPEN_H
#define BERTH_HAL_CAN_OPEN_H

#include "berth_hal/can.h"
#include "realtime.h"
#include "slcan.h"
#include "socketcan.h"
#include "stream.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define CAN_OPEN_ERROR_MAX 256u

typedef enum { CAN_PORT_CLOSED, CAN_PORT_SOCKETCAN, CAN_PORT_SLCAN } can_port_kind_t;

/* A port must not be moved while it is open: can and wait point into it. */
typedef struct {
    berth_can_t can;      /* the bus */
    realtime_wait_t wait; /* what to sleep on */
    can_port_kind_t kind; /* and from here can_open.c's own, but to be read for statistics */
    socketcan_t socketcan;
    stream_t stream;
    slcan_t slcan;
    berth_can_filter_t filters[SOCKETCAN_FILTERS_MAX];
} can_port_t;

/* The frames wanted: at most SOCKETCAN_FILTERS_MAX filters, which are copied; none at all: every
 * frame. False with a sentence in error (what, where, why, what is allowed), and the port is
 * closed. */
bool can_open(can_port_t *port, const char *spec, const berth_can_filter_t *filters,
              uint32_t filter_count, char *error, size_t error_size);

/* The descriptor to wait on now, or -1. The same as port->wait tells. */
int can_fd(can_port_t *port);

/* Harmless when repeated. */
void can_close(can_port_t *port);

#ifdef __cplusplus
}
#endif

#endif
