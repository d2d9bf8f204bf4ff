/* node_model.h - a bus that joins models of CAN controllers, a frame at a time.
 *
 * No bits, but the arbitration is by them: the most urgent of the frames offered wins. Frames that
 * nobody acknowledges fail. Errors come to order.
 */
#ifndef BERTH_TESTS_NODE_MODEL_H
#define BERTH_TESTS_NODE_MODEL_H

#include "berth_hal/can.h"

#include <stdbool.h>
#include <stdint.h>

/* Last error codes: the same numbers in bxCAN's LEC and in FDCAN's PSR. */
typedef enum {
    NODE_ERROR_STUFF = 1,
    NODE_ERROR_FORM = 2,
    NODE_ERROR_ACKNOWLEDGE = 3,
    NODE_ERROR_BIT1 = 4,
    NODE_ERROR_BIT0 = 5,
    NODE_ERROR_CRC = 6
} node_error_t;

typedef struct {
    /* On the bus: it receives, acknowledges, and may send. */
    bool (*is_on)(void *context);
    /* The frame that it would send now. It counts as being on the wire until one of the next
     * three. */
    bool (*offer)(void *context, berth_can_frame_t *frame);
    void (*sent)(void *context);
    void (*failed)(void *context, node_error_t error);
    void (*lost_arbitration)(void *context);
    void (*hear)(void *context, const berth_can_frame_t *frame);
    void (*hear_error)(void *context, node_error_t error);
    /* So many times 11 recessive bits. */
    void (*idle)(void *context, uint32_t sequences);
} node_ops_t;

typedef struct {
    const node_ops_t *ops;
    void *context;
} node_t;

#define NODE_BUS_MAX 6u

typedef struct {
    node_t nodes[NODE_BUS_MAX];
    uint32_t count;
    uint32_t destroy; /* so many of the next frames are destroyed by an error */
    void (*observe)(void *context, uint32_t sender, const berth_can_frame_t *frame);
    void *observer;
} node_bus_t;

void node_bus_add(node_bus_t *bus, node_t node);

/* One frame on the wire, or an idle bus. Returns true when a frame got through. */
bool node_bus_step(node_bus_t *bus);

#endif
