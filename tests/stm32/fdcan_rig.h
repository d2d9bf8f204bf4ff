/* fdcan_rig.h - an FDCAN driver on its model, with its interrupt and a clock. */
#ifndef BERTH_TESTS_FDCAN_RIG_H
#define BERTH_TESTS_FDCAN_RIG_H

#include "fdcan.h"
#include "fdcan_model.h"
#include "rig_clock.h"

#include "unity.h"

#include <string.h>

/* Memory for registers and message RAM: only their addresses count. */
static fdcan_regs_t fdcan_rig_blocks[NODE_BUS_MAX];
static fdcan_ram_t fdcan_rig_rams[NODE_BUS_MAX];

typedef struct {
    fdcan_model_t model;
    fdcan_t driver;
    berth_can_t can;
    fdcan_config_t config;
} fdcan_rig_t;

static inline void fdcan_rig_init(fdcan_rig_t *rig, uint32_t number) {
    memset(rig, 0, sizeof *rig);
    fdcan_model_init(&rig->model);
    fdcan_model_map(&rig->model, &fdcan_rig_blocks[number], &fdcan_rig_rams[number]);
    rig->config = fdcan_config_default(&fdcan_rig_blocks[number], &fdcan_rig_rams[number],
                                       rig_clock(), 170000000);
}

static inline void fdcan_rig_open(fdcan_rig_t *rig, const berth_can_filter_t *filters,
                                  uint32_t count) {
    TEST_ASSERT_EQUAL_INT(STM32_CAN_OK, fdcan_open(&rig->driver, &rig->config, filters, count));
    rig->can = fdcan_can(&rig->driver);
}

/* What the interrupt controller does. */
static inline void fdcan_rig_interrupts(fdcan_rig_t *rig) {
    for (int i = 0; i < 10; i++) {
        if (!fdcan_model_line(&rig->model)) {
            return;
        }
        fdcan_interrupt(&rig->driver);
    }
    TEST_FAIL_MESSAGE("an interrupt that does not end");
}

#endif
