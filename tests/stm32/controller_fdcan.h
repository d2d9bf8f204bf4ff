/* controller_fdcan.h - FDCAN for test_controller_contract.c. */
#include "fdcan_rig.h"

typedef fdcan_rig_t ctl_rig_t;
typedef fdcan_diagnosis_t ctl_diagnosis_t;

#define CTL_RECOVERY 129u
#define CTL_STANDARD_MAX 28u /* filters */
#define CTL_EXTENDED_MAX 8u
#define CTL_FILTERS_MAX 36u
#define CTL_LOOKS FDCAN_WAIT_LOOKS

#define ctl_init(rig) fdcan_rig_init(rig, 0)
#define ctl_open_result(rig, filters, count)                                                       \
    fdcan_open(&(rig)->driver, &(rig)->config, filters, count)
#define ctl_open fdcan_rig_open
#define ctl_can fdcan_can
#define ctl_interrupts fdcan_rig_interrupts
#define ctl_node(rig) fdcan_model_node(&(rig)->model)
#define ctl_set_tec(rig, tec) fdcan_model_set_tec(&(rig)->model, tec)
#define ctl_abort fdcan_abort
#define ctl_restart fdcan_restart
#define ctl_has_input fdcan_has_input
#define ctl_diagnosis fdcan_diagnosis
#define ctl_reset(rig) fdcan_model_init(&(rig)->model)
#define ctl_stick(rig, yes) ((rig)->model.init_stuck = (yes))
#define ctl_delay(rig, reads) ((rig)->model.init_delay = (reads))
#define ctl_map_dead(rig, ops, context)                                                            \
    do {                                                                                           \
        io_model_map((rig)->config.regs, sizeof *(rig)->config.regs, ops, context);                \
        io_model_map((rig)->config.ram, sizeof *(rig)->config.ram, ops, context);                  \
    } while (false)
