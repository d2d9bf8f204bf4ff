#include "node_model.h"

#include "can_text.h"

#include "unity.h"

#include <string.h>

void node_bus_add(node_bus_t *bus, node_t node) {
    TEST_ASSERT_TRUE(bus->count < NODE_BUS_MAX);
    bus->nodes[bus->count++] = node;
}

/* "0" is dominant; a frame that ends earlier has a dominant bit where the other goes on. */
static bool more_urgent(const berth_can_frame_t *a, const berth_can_frame_t *b) {
    const can_text_t ta = can_text_arbitration(a);
    const can_text_t tb = can_text_arbitration(b);
    const int order = strcmp(ta.text, tb.text);
    TEST_ASSERT_TRUE_MESSAGE(order != 0, "two nodes send the same id");
    return order < 0;
}

static bool acknowledged(const node_bus_t *bus, uint32_t sender) {
    for (uint32_t i = 0; i < bus->count; i++) {
        if (i != sender && bus->nodes[i].ops->is_on(bus->nodes[i].context)) {
            return true;
        }
    }
    return false;
}

static void each_other(node_bus_t *bus, uint32_t sender, const berth_can_frame_t *frame) {
    for (uint32_t i = 0; i < bus->count; i++) {
        const node_t *node = &bus->nodes[i];
        if (i == sender || !node->ops->is_on(node->context)) {
            continue;
        }
        if (frame != NULL) {
            node->ops->hear(node->context, frame);
        } else {
            node->ops->hear_error(node->context, NODE_ERROR_STUFF);
        }
    }
}

bool node_bus_step(node_bus_t *bus) {
    berth_can_frame_t frames[NODE_BUS_MAX];
    bool offers[NODE_BUS_MAX] = {false};
    uint32_t winner = NODE_BUS_MAX;
    for (uint32_t i = 0; i < bus->count; i++) {
        const node_t *node = &bus->nodes[i];
        offers[i] = node->ops->is_on(node->context) && node->ops->offer(node->context, &frames[i]);
        if (offers[i] && (winner == NODE_BUS_MAX || more_urgent(&frames[i], &frames[winner]))) {
            winner = i;
        }
    }
    for (uint32_t i = 0; i < bus->count; i++) {
        if (offers[i] && i != winner) {
            bus->nodes[i].ops->lost_arbitration(bus->nodes[i].context);
        }
    }
    bool through = false;
    if (winner < NODE_BUS_MAX) {
        const node_t *sender = &bus->nodes[winner];
        if (bus->destroy > 0) {
            bus->destroy--;
            sender->ops->failed(sender->context, NODE_ERROR_BIT0);
            each_other(bus, winner, NULL);
        } else if (!acknowledged(bus, winner)) {
            sender->ops->failed(sender->context, NODE_ERROR_ACKNOWLEDGE);
        } else {
            through = true;
            if (bus->observe != NULL) {
                bus->observe(bus->observer, winner, &frames[winner]);
            }
            sender->ops->sent(sender->context);
            each_other(bus, winner, &frames[winner]);
        }
    }
    /* The end of a frame, and the pause after it, are 11 recessive bits at least. */
    for (uint32_t i = 0; i < bus->count; i++) {
        bus->nodes[i].ops->idle(bus->nodes[i].context, 1);
    }
    return through;
}
