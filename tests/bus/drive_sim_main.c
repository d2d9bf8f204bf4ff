/* berth-drive-sim: one simulated wheel drive on a bus, in real time, for masters that others wrote.
 *
 *     berth-drive-sim BUS odrive|vesc|cia402 NODE
 *
 * BUS as for berth-board. The wheel follows the drive's wish with a lag, and runs out by itself
 * when the drive releases it. Orders come in on standard input, a line each; the end of the input
 * ends the program:
 *
 *     fail CODE                 the drive reports an error of its own (hexadecimal)
 *     trouble NAME 0|1          dead, mute-heartbeat, mute-feedback, refuse-setup
 *     status                    answered with: enabled target speed angle commands stops malformed
 *                               (rad and s)
 */
#include "bus/drive_sim.h"
#include "can_open.h"

#include <errno.h>
#include <inttypes.h>
#include <math.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#define TICK_US INT64_C(2000)
#define FOLLOW_S 0.03
#define RUN_OUT_S 0.3
#define LINE_MAX_BYTES 128

typedef struct {
    can_port_t port;
    drive_sim_t *sim;
    drive_sim_trouble_t trouble;
    int64_t wheel_us;
    double angle_rad, speed_radps;
    char line[LINE_MAX_BYTES];
    size_t filled;
} rig_t;

static void turn_wheel(rig_t *rig, int64_t now_us) {
    const double elapsed_s = (double)(now_us - rig->wheel_us) * 1e-6;
    rig->wheel_us = now_us;
    const double tau_s = drive_sim_enabled(rig->sim) ? FOLLOW_S : RUN_OUT_S;
    const double target = drive_sim_target_radps(rig->sim);
    const double off = rig->speed_radps - target;
    const double left = exp(-elapsed_s / tau_s);
    rig->angle_rad += target * elapsed_s + off * tau_s * (1.0 - left);
    rig->speed_radps = target + off * left;
    drive_sim_motion(rig->sim, rig->angle_rad, rig->speed_radps);
}

static void exchange_frames(rig_t *rig) {
    berth_can_frame_t frame;
    const berth_can_t *can = &rig->port.can;
    while (can->api->receive(can->context, &frame) == BERTH_CAN_DONE) {
        (void)drive_sim_receive(rig->sim, &frame, frame.time_us);
    }
    const int64_t now_us = realtime_now_us();
    turn_wheel(rig, now_us);
    drive_sim_step(rig->sim, now_us);
    const berth_can_frame_t *front;
    while ((front = drive_sim_front(rig->sim)) != NULL &&
           can->api->send(can->context, front) == BERTH_CAN_DONE) {
        drive_sim_sent(rig->sim);
    }
}

static bool *trouble_named(rig_t *rig, const char *name) {
    if (strcmp(name, "dead") == 0) {
        return &rig->trouble.dead;
    }
    if (strcmp(name, "mute-heartbeat") == 0) {
        return &rig->trouble.mute_heartbeat;
    }
    if (strcmp(name, "mute-feedback") == 0) {
        return &rig->trouble.mute_feedback;
    }
    return strcmp(name, "refuse-setup") == 0 ? &rig->trouble.refuse_setup : NULL;
}

static void print_status(const rig_t *rig) {
    const drive_sim_counters_t counters = drive_sim_counters(rig->sim);
    printf("%d %.9g %.9g %.9g %lu %lu %lu\n", drive_sim_enabled(rig->sim) ? 1 : 0,
           drive_sim_target_radps(rig->sim), rig->speed_radps, rig->angle_rad, counters.commands,
           counters.watchdog_stops, counters.malformed);
}

static bool obey(rig_t *rig, const char *line) {
    char name[LINE_MAX_BYTES];
    unsigned value;
    if (strcmp(line, "status") == 0) {
        print_status(rig);
    } else if (sscanf(line, "fail %x", &value) == 1) {
        drive_sim_fail(rig->sim, value);
        puts("ok");
    } else if (sscanf(line, "trouble %100s %u", name, &value) == 2 &&
               trouble_named(rig, name) != NULL) {
        *trouble_named(rig, name) = value != 0;
        drive_sim_trouble(rig->sim, &rig->trouble);
        puts("ok");
    } else {
        fprintf(stderr, "berth-drive-sim: '%s' is no order\n", line);
        return false;
    }
    return fflush(stdout) == 0;
}

/* False at the end of the input, and when an order is not understood. */
static bool read_orders(rig_t *rig) {
    const ssize_t count =
        read(STDIN_FILENO, rig->line + rig->filled, sizeof rig->line - 1 - rig->filled);
    if (count <= 0) {
        return count < 0 && errno == EINTR;
    }
    rig->filled += (size_t)count;
    rig->line[rig->filled] = '\0';
    char *end;
    while ((end = strchr(rig->line, '\n')) != NULL) {
        *end = '\0';
        if (!obey(rig, rig->line)) {
            return false;
        }
        rig->filled -= (size_t)(end + 1 - rig->line);
        memmove(rig->line, end + 1, rig->filled + 1);
    }
    return rig->filled < sizeof rig->line - 1;
}

static void run(rig_t *rig) {
    for (;;) {
        exchange_frames(rig);
        const int64_t now_us = realtime_now_us();
        const int64_t due_us = drive_sim_deadline(rig->sim);
        const int64_t wait_us = due_us - now_us < TICK_US ? due_us - now_us : TICK_US;
        const struct timespec wait = {0, wait_us > 0 ? (long)wait_us * 1000L : 0L};
        struct pollfd ready[2] = {{.fd = STDIN_FILENO, .events = POLLIN},
                                  {.fd = can_fd(&rig->port), .events = POLLIN}};
        if (ppoll(ready, 2, &wait, NULL) > 0 && ready[0].revents != 0 && !read_orders(rig)) {
            return;
        }
    }
}

static bool kind_named(const char *name, drive_sim_kind_t *kind) {
    static const char *const names[] = {
        [DRIVE_SIM_ODRIVE] = "odrive", [DRIVE_SIM_VESC] = "vesc", [DRIVE_SIM_CIA402] = "cia402"};
    for (unsigned i = 0; i < sizeof names / sizeof names[0]; i++) {
        if (strcmp(name, names[i]) == 0) {
            *kind = (drive_sim_kind_t)i;
            return true;
        }
    }
    return false;
}

int main(int argc, char **argv) {
    static rig_t rig;
    drive_sim_config_t config = {.sign = 1,
                                 .gear_ratio = 1.0,
                                 .pole_pairs = 7,
                                 .counts_per_turn = 4096,
                                 .velocity_units_per_rps = 4096.0,
                                 .feedback_us = 10000,
                                 .heartbeat_us = 100000,
                                 .watchdog_us = 500000};
    char *end = NULL;
    const unsigned long node = argc == 4 ? strtoul(argv[3], &end, 0) : 256;
    if (node > 255 || *end != '\0' || !kind_named(argv[2], &config.kind)) {
        fprintf(stderr, "usage: berth-drive-sim BUS odrive|vesc|cia402 NODE\n");
        return 2;
    }
    config.node = (uint8_t)node;
    char error[CAN_OPEN_ERROR_MAX];
    if (!can_open(&rig.port, argv[1], NULL, 0, error, sizeof error)) {
        fprintf(stderr, "berth-drive-sim: %s\n", error);
        return 2;
    }
    rig.wheel_us = realtime_now_us();
    rig.sim = drive_sim_create(&config, rig.wheel_us);
    if (rig.sim != NULL) {
        puts("ready");
        fflush(stdout);
        run(&rig);
    }
    drive_sim_destroy(rig.sim);
    can_close(&rig.port);
    return 0;
}
