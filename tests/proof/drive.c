/* One wheel's drive, from init on, in any order of calls. */
#include "scene.h"

#ifndef PROTOCOL
#define PROTOCOL berth_drive_odrive
#endif

static berth_drive_t drive;
static berth_outbox_t outbox;

static void call_any(void) {
    const int64_t now_us = any_time();
    berth_can_filter_t filters[BERTH_DRIVE_FILTERS_MAX];
    const berth_can_frame_t frame = any_frame();
    switch (Frama_C_interval(0, 14)) {
    case 0:
        berth_drive_enable(&drive, now_us);
        break;
    case 1:
        berth_drive_disable(&drive, &outbox);
        break;
    case 2:
        berth_drive_stop(&drive, &outbox);
        break;
    case 3:
        berth_drive_emergency_stop(&drive, &outbox);
        break;
    case 4:
        berth_drive_reset(&drive);
        break;
    case 5:
        berth_drive_command(&drive, any_float());
        break;
    case 6:
        berth_drive_cycle(&drive, now_us, &outbox);
        break;
    case 7:
        berth_drive_sync(&drive, now_us, &outbox);
        break;
    case 8:
        (void)berth_drive_receive(&drive, &frame, any_time());
        break;
    case 9:
        berth_drive_step(&drive, now_us, &outbox);
        break;
    case 10:
        (void)berth_drive_deadline(&drive);
        break;
    case 11:
        (void)berth_drive_travel(&drive, any_time());
        break;
    case 12:
        (void)berth_drive_filters(&drive, filters);
        break;
    case 13:
        (void)berth_outbox_front(&outbox);
        berth_outbox_pop(&outbox);
        break;
    default:
        berth_outbox_clear(&outbox);
        (void)berth_drive_status(&drive);
        (void)berth_drive_state_text(ANY_ENUM(berth_drive_state_t));
        (void)berth_drive_fault_text(ANY_ENUM(berth_drive_fault_t));
        break;
    }
}

static void call_all(void) {
    /*@ widen_hints global:"all", HINTS; */
    while (any_bool()) {
        call_any();
    }
}

int main(void) {
    const berth_drive_config_t config = any_drive_config(&PROTOCOL);
    berth_refusal_t refusal;
    berth_outbox_reset(&outbox);
    if (berth_drive_init(&drive, &config, &refusal) == BERTH_OK) {
        call_all();
    }
    return 0;
}
