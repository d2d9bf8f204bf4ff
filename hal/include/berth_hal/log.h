/* berth_hal/log.h - optional: where a platform writes lines for people.
 *
 * Never called by the control path; loops call it between steps, for events (a fault, a bus that
 * came back). A platform without one leaves the api pointer NULL.
 */
#ifndef BERTH_HAL_LOG_H
#define BERTH_HAL_LOG_H

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    /* One line, without its end. May block for as long as the platform's output does. Lines that
     * cannot be written are dropped. Never from an interrupt. */
    void (*line)(void *context, const char *text);
} berth_log_api_t;

typedef struct {
    const berth_log_api_t *api; /* NULL: no log */
    void *context;
} berth_log_t;

#ifdef __cplusplus
}
#endif

#endif
