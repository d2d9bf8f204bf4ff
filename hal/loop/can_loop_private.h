/* can_loop_private.h - what the two halves of the loop bus share. */
#ifndef CAN_LOOP_PRIVATE_H
#define CAN_LOOP_PRIVATE_H

#include "can_loop.h"

#define CAN_LOOP_PASSIVE_AT 128u

/* Is the node on the bus at all? */
bool can_loop_present(const can_loop_node_t *node);

/* The transmit error counter, with what a cut wire adds to it. */
uint32_t can_loop_node_tec(const can_loop_node_t *node);

/* Puts a frame into the receive queue, or counts why not. */
void can_loop_take(can_loop_node_t *node, const berth_can_frame_t *frame);

/* The node withdraws from the bus (mode BUS_OFF or DOWN): drops what waits. */
void can_loop_withdraw(can_loop_node_t *node, berth_can_mode_t mode);

/* The node is back, error active. */
void can_loop_return(can_loop_node_t *node, int64_t at_ns);

/* If the node is just sending, its frame ends now in an error frame. */
void can_loop_abort(can_loop_t *loop, uint32_t node);

#endif
