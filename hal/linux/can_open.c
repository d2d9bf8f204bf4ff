#include "can_open.h"

#include <stdio.h>
#include <string.h>

static const char socketcan_word[] = "socketcan:";
static const char slcan_word[] = "slcan:";

static int fd_of(void *context) {
    return can_fd(context);
}

static int64_t now_us_of(void *context) {
    (void)context;
    return realtime_now_us();
}

/* The line only reads the time. */
static void no_sleep(void *context, int64_t deadline_us) {
    (void)context;
    (void)deadline_us;
}

static bool open_socketcan(can_port_t *port, const char *name, uint32_t filter_count, char *error,
                           size_t error_size) {
    if (!socketcan_open(&port->socketcan, name, port->filters, filter_count, error, error_size)) {
        return false;
    }
    port->can = socketcan_can(&port->socketcan);
    port->kind = CAN_PORT_SOCKETCAN;
    return true;
}

static bool open_slcan(can_port_t *port, const char *path, uint32_t filter_count, char *error,
                       size_t error_size) {
    static const berth_clock_api_t clock = {now_us_of, no_sleep};
    char reason[CAN_OPEN_ERROR_MAX];
    if (!stream_open(&port->stream, path, reason, sizeof reason)) {
        (void)snprintf(error, error_size, "slcan: %.200s", reason);
        return false;
    }
    const slcan_config_t config = {.role = SLCAN_HOST,
                                   .stream = stream_bytes(&port->stream),
                                   .clock = {&clock, NULL},
                                   .filters = port->filters,
                                   .filter_count = filter_count};
    slcan_init(&port->slcan, &config);
    port->can = slcan_can(&port->slcan);
    port->kind = CAN_PORT_SLCAN;
    return true;
}

bool can_open(can_port_t *port, const char *spec, const berth_can_filter_t *filters,
              uint32_t filter_count, char *error, size_t error_size) {
    memset(port, 0, sizeof *port);
    if (filter_count > SOCKETCAN_FILTERS_MAX || (filters == NULL && filter_count > 0u)) {
        (void)snprintf(error, error_size, "CAN bus: %u filters (0 to %u are allowed)",
                       (unsigned)filter_count, SOCKETCAN_FILTERS_MAX);
        return false;
    }
    if (filter_count > 0u) {
        memcpy(port->filters, filters, filter_count * sizeof *filters);
    }
    port->wait = (realtime_wait_t){fd_of, port};
    if (strncmp(spec, socketcan_word, sizeof socketcan_word - 1u) == 0) {
        return open_socketcan(port, spec + sizeof socketcan_word - 1u, filter_count, error,
                              error_size);
    }
    if (strncmp(spec, slcan_word, sizeof slcan_word - 1u) == 0) {
        return open_slcan(port, spec + sizeof slcan_word - 1u, filter_count, error, error_size);
    }
    (void)snprintf(error, error_size,
                   "CAN bus '%.60s': unknown (allowed: socketcan:INTERFACE, such as "
                   "socketcan:can0, or slcan:PATH with a tty, a pty or a unix socket)",
                   spec);
    return false;
}

int can_fd(can_port_t *port) {
    if (port->kind == CAN_PORT_SOCKETCAN) {
        return socketcan_fd(&port->socketcan);
    }
    return port->kind == CAN_PORT_SLCAN ? stream_fd(&port->stream) : -1;
}

void can_close(can_port_t *port) {
    if (port->kind == CAN_PORT_SOCKETCAN) {
        socketcan_close(&port->socketcan);
    } else if (port->kind == CAN_PORT_SLCAN) {
        stream_close(&port->stream);
    }
    port->kind = CAN_PORT_CLOSED;
}
