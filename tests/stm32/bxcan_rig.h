/* bxcan_rig.h - a bxCAN driver on its model, with its interrupts and a clock. */
#ifndef BERTH_TESTS_BXCAN_RIG_H
#define BERTH_TESTS_BXCAN_RIG_H

#include "bxcan.h"
#include "bxcan_model.h"
#include "rig_clock.h"

#include "unity.h"

#include <string.h>

/* Memory for the register blocks: only their addresses count. */
static bxcan_regs_t bxcan_rig_blocks[NODE_BUS_MAX];

typedef struct {
    bxcan_model_t model;
    bxcan_t driver;
    berth_can_t can;
    bxcan_regs_t *block;
    bxcan_config_t config;
} bxcan_rig_t;

static inline void bxcan_rig_init(bxcan_rig_t *rig, uint32_t number) {
    memset(rig, 0, sizeof *rig);
    bxcan_model_init(&rig->model);
    rig->block = &bxcan_rig_blocks[number];
    bxcan_model_map(&rig->model, rig->block);
    rig->config = bxcan_config_default(rig->block, rig_clock(), 42000000);
}

static inline void bxcan_rig_open(bxcan_rig_t *rig, const berth_can_filter_t *filters,
                                  uint32_t count) {
    TEST_ASSERT_EQUAL_INT(STM32_CAN_OK, bxcan_open(&rig->driver, &rig->config, filters, count));
    rig->can = bxcan_can(&rig->driver);
}

/* What the interrupt controller does. */
static inline void bxcan_rig_interrupts(bxcan_rig_t *rig) {
    for (int i = 0; i < 10; i++) {
        if (bxcan_model_fifo_line(&rig->model)) {
            bxcan_receive_interrupt(&rig->driver);
        } else if (bxcan_model_status_line(&rig->model)) {
            bxcan_status_interrupt(&rig->driver);
        } else {
            return;
        }
    }
    TEST_FAIL_MESSAGE("an interrupt that does not end");
}

#endif
