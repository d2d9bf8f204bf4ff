/* controller_bxcan.h - bxCAN for test_controller_contract.c. */
#include "bxcan_rig.h"

typedef bxcan_rig_t ctl_rig_t;
typedef bxcan_diagnosis_t ctl_diagnosis_t;

#define CTL_RECOVERY 128u
#define CTL_STANDARD_MAX 28u /* filters, of both kinds together */
#define CTL_EXTENDED_MAX 28u
#define CTL_FILTERS_MAX 28u
#define CTL_LOOKS BXCAN_WAIT_LOOKS

#define ctl_init(rig) bxcan_rig_init(rig, 0)
#define ctl_open_result(rig, filters, count)                                                       \
    bxcan_open(&(rig)->driver, &(rig)->config, filters, count)
#define ctl_open bxcan_rig_open
#define ctl_can bxcan_can
#define ctl_interrupts bxcan_rig_interrupts
#define ctl_node(rig) bxcan_model_node(&(rig)->model)
#define ctl_set_tec(rig, tec) bxcan_model_set_tec(&(rig)->model, tec)
#define ctl_abort bxcan_abort
#define ctl_restart bxcan_restart
#define ctl_has_input bxcan_has_input
#define ctl_diagnosis bxcan_diagnosis
#define ctl_reset(rig) bxcan_model_init(&(rig)->model)
#define ctl_stick(rig, yes) ((rig)->model.mode_stuck = (yes))
#define ctl_delay(rig, reads) ((rig)->model.mode_delay = (reads))
#define ctl_map_dead(rig, ops, context)                                                            \
    io_model_map((rig)->block, sizeof *(rig)->block, ops, context)
