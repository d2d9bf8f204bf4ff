/* Timers of the simulated drives. Private to drive_sim*.c. */
#ifndef HOST_SIM_BUS_DRIVE_SIM_TIMER_H
#define HOST_SIM_BUS_DRIVE_SIM_TIMER_H

#include <stdbool.h>
#include <stdint.h>

/* Something that happens each period; never where the period is not positive. */
typedef struct {
    int64_t period_us;
    int64_t due_us;
} drive_sim_timer_t;

/* Starts a timer: first due one period from now. */
void drive_sim_timer_start(drive_sim_timer_t *timer, int64_t period_us, int64_t now_us);
/* Is it due? Then it is due next in the first period to come, however many were missed. */
bool drive_sim_timer_take(drive_sim_timer_t *timer, int64_t now_us);
/* The earlier of deadline_us and the timer. */
int64_t drive_sim_timer_deadline(const drive_sim_timer_t *timer, int64_t deadline_us);

#endif
