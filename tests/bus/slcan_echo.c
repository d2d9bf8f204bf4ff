/* For test_slcan_peer.py: a bus over a tty, at which each frame received is sent back with the next
 * id. Ends after an end of file on standard input, and prints its counters.
 *
 * usage: slcan-echo host|adapter PATH
 */
#include "can_open.h"

#include <poll.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#define LINGER_US 300000

static can_port_t port;

static bool over(void) {
    struct pollfd item = {.fd = STDIN_FILENO, .events = POLLIN};
    char byte;
    return poll(&item, 1, 0) > 0 && read(STDIN_FILENO, &byte, 1) == 0;
}

static void echo_all(void) {
    berth_can_frame_t frame;
    while (port.can.api->receive(port.can.context, &frame) == BERTH_CAN_DONE) {
        const uint32_t max = frame.extended ? BERTH_CAN_EXTENDED_MAX : BERTH_CAN_STANDARD_MAX;
        frame.id = frame.id == max ? 0u : frame.id + 1u;
        (void)port.can.api->send(port.can.context, &frame);
    }
}

static void print_counters(void) {
    berth_can_state_t state;
    port.can.api->state(port.can.context, &state);
    const slcan_counts_t counts = slcan_counts(&port.slcan);
    printf("{\"received\": %u, \"sent\": %u, \"commands\": %u, \"malformed\": %u, \"unsaid\": %u, "
           "\"mode\": %d, \"tx_dropped\": %u, \"error_frames\": %u, \"restarts\": %u}\n",
           counts.received, counts.sent, counts.commands, counts.malformed, counts.unsaid,
           (int)state.mode, state.tx_dropped, state.error_frames, state.restarts);
}

int main(int argc, char **argv) {
    char spec[128];
    char error[CAN_OPEN_ERROR_MAX];
    if (argc != 3) {
        return 2;
    }
    (void)snprintf(spec, sizeof spec, "slcan:%s", argv[2]);
    if (!can_open(&port, spec, NULL, 0, error, sizeof error)) {
        fprintf(stderr, "%s\n", error);
        return 2;
    }
    if (strcmp(argv[1], "adapter") == 0) {
        slcan_config_t config = port.slcan.config;
        config.role = SLCAN_ADAPTER;
        slcan_init(&port.slcan, &config);
    }
    realtime_t timer;
    realtime_init(&timer, &port.wait);
    const berth_clock_t clock = realtime_clock(&timer);
    /* What was written before the end may still be on its way. */
    int64_t end_us = INT64_MAX;
    while (realtime_now_us() < end_us) {
        echo_all();
        clock.api->sleep_until_us(clock.context, realtime_now_us() + 10000);
        if (end_us == INT64_MAX && over()) {
            end_us = realtime_now_us() + LINGER_US;
        }
    }
    print_counters();
    can_close(&port);
    return 0;
}
