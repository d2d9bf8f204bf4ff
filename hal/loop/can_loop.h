/* can_loop.h - a CAN bus inside one process, in virtual time.
 *
 * Nodes are attached to the bus and each gets a berth_can_t. Frames take the time that their bits
 * take on a real wire (check sum, stuff bits, intermission), and at each instant at which the bus
 * is free the waiting nodes arbitrate bit by bit as on the wire. Faults can be ordered: lost, late,
 * doubled, altered and corrupted frames, bus-off, interfaces down, cut wires, a node that babbles.
 *
 * Time stands still unless can_loop_run moves it. Whoever runs the participants does this:
 *
 *     now = min(can_loop_deadline(&loop), deadlines of the participants);
 *     can_loop_run(&loop, now);
 *     run every participant that is due at now; they send and receive at now;
 *
 * Frames handed over at one instant arbitrate together, whatever the order of the calls: the bus
 * starts none of them before time moves on. Inside, time is in nanoseconds; outside, an instant is
 * the first whole microsecond at which a thing has happened, so nothing is seen before it is there.
 *
 * Same calls, same results: there is no clock, no thread and no random number but the seeded one.
 *
 * Memory: one plain struct, the caller's (about 100 kB with these capacities), no heap. It must not
 * be moved or copied once nodes are attached. One context; functions called from the observer or
 * from the fault hook may read the loop, not change it.
 *
 * What a real bus has and this one does not: propagation and oscillator tolerance; overload frames;
 * error flags of unequal length; two nodes that send the same identifier with different data
 * collide on a real bus, here the node with the lower number goes first.
 */
#ifndef CAN_LOOP_H
#define CAN_LOOP_H

#include "berth_hal/can.h"
#include "berth_hal/clock.h"

#include <stdbool.h>
#include <stdint.h>

/* MISRA T1 in this file. */

#ifdef __cplusplus
extern "C" {
#endif

/* Capacities. Part of the layout: the library and its users must agree. */
#ifndef CAN_LOOP_NODES_MAX
#define CAN_LOOP_NODES_MAX 16u /* 1 to 32 */
#endif
#ifndef CAN_LOOP_TX_MAX
#define CAN_LOOP_TX_MAX 32u /* frames that wait to be sent, per node */
#endif
#ifndef CAN_LOOP_RX_MAX
#define CAN_LOOP_RX_MAX 128u /* frames that wait to be fetched, per node */
#endif
#ifndef CAN_LOOP_FILTERS_MAX
#define CAN_LOOP_FILTERS_MAX 32u /* receive filters, per node */
#endif
#ifndef CAN_LOOP_RULES_MAX
#define CAN_LOOP_RULES_MAX 16u /* fault rules */
#endif
#ifndef CAN_LOOP_LATE_MAX
#define CAN_LOOP_LATE_MAX 256u /* deliveries that a fault holds back */
#endif

#define CAN_LOOP_BIT_RATE 1000000u
#define CAN_LOOP_NEVER INT64_MAX
#define CAN_LOOP_TIME_MAX_US INT64_C(4000000000000000) /* 126 years */
#define CAN_LOOP_ANY_NODE UINT32_MAX
#define CAN_LOOP_EVERYBODY UINT32_MAX

/* What happens to one frame on the wire. All zero: nothing. */
typedef struct {
    uint32_t deaf;      /* bit n: node n does not get it. CAN_LOOP_EVERYBODY: lost on the wire. The
                           sender takes it for sent in either case. */
    int64_t delay_us;   /* everybody gets it that much later, later frames overtaking it */
    bool stamp_on_wire; /* a late frame is stamped with its time on the wire, not with the later one
                           at which it is there */
    uint8_t copies;     /* the sender puts it on the wire so many times more, as after an error that
                           only it saw; for frames of its queue, once each */
    uint8_t flip[BERTH_CAN_DATA_MAX]; /* the data are altered by this (exclusive or), unnoticed */
    bool corrupt; /* a bit error: an error frame, error counters, and the frame is sent again */
    uint32_t error_bit; /* the error frame begins after so many bits of the frame; 0 or too many:
                           after the ACK delimiter, as a wrong check sum does */
} can_loop_action_t;

/* Asked at the start of each frame on the wire. index counts starts from 0, repetitions included;
 * node is the sender. What it answers comes on top of the rules. */
typedef can_loop_action_t (*can_loop_fault_t)(void *context, uint64_t index, uint32_t node,
                                              const berth_can_frame_t *frame);

/* Frames to which an action is done: those of node that pass the filter, but for the first skip,
 * count of them (0: no end), each with the given probability. */
typedef struct {
    uint32_t node; /* the sender, or CAN_LOOP_ANY_NODE */
    bool filtered; /* does filter count? */
    berth_can_filter_t filter;
    uint64_t skip;
    uint64_t count;
    double probability; /* 0 to 1 */
    can_loop_action_t action;
} can_loop_rule_t;

/* What was on the wire, told at its end. */
typedef struct {
    uint64_t index;          /* as in can_loop_fault_t */
    uint32_t node;           /* the sender */
    int64_t start_ns;        /* SOF */
    int64_t end_ns;          /* last bit of EOF or of the error delimiter */
    bool error;              /* an error frame ended it; it will be sent again */
    berth_can_frame_t frame; /* as sent; time_us is end_ns in whole microseconds, upwards */
} can_loop_event_t;

typedef void (*can_loop_observer_t)(void *context, const can_loop_event_t *event);

/* Of one node. For each frame that another node has sent, one of received, filtered, overflow,
 * absent, deafened and late_lost grows by one (or the frame is still held back by a delay). For
 * each frame taken by send, one of sent and dropped grows (or it still waits). */
typedef struct {
    uint64_t sent;      /* got onto the wire without error; includes copies and babble */
    uint64_t copies;    /* of these, copies ordered by a fault */
    uint64_t babbled;   /* of these, babble */
    uint64_t dropped;   /* taken by send, never on the wire without error */
    uint64_t refused;   /* sends answered AGAIN */
    uint64_t received;  /* put into the receive queue */
    uint64_t filtered;  /* not wanted */
    uint64_t overflow;  /* receive queue full */
    uint64_t absent;    /* node down, bus-off or its wire cut */
    uint64_t deafened;  /* a fault said so */
    uint64_t late_lost; /* too many frames held back at once */
    uint64_t errors;    /* error frames seen */
    uint64_t restarts;  /* returns from bus-off or down */
} can_loop_counters_t;

typedef struct can_loop can_loop_t;

/* The rest of this file's structs is private: read it through the functions. */
typedef struct {
    berth_can_frame_t frame;
    int64_t queued_ns;
    uint32_t rank;
    uint32_t bits;
    uint8_t copies; /* still to be sent after this one */
    bool is_copy;
} can_loop_waiting_t;

typedef struct {
    can_loop_t *loop;
    uint32_t number;
    berth_can_mode_t mode; /* ERROR_ACTIVE, BUS_OFF or DOWN; passive follows from the counters */
    bool cut;
    uint32_t tec, rec;
    int64_t since_ns;   /* on the bus since; hears no frame that began before */
    int64_t suspend_ns; /* no frame before this */
    int64_t recover_ns; /* end of the recovery from bus-off; CAN_LOOP_NEVER: not asked for */
    int64_t auto_ns;    /* recovery begins so long after bus-off; CAN_LOOP_NEVER: not by itself */
    can_loop_waiting_t tx[CAN_LOOP_TX_MAX];
    berth_can_frame_t rx[CAN_LOOP_RX_MAX];
    uint32_t tx_first, tx_count, tx_depth;
    uint32_t rx_first, rx_count, rx_depth;
    berth_can_filter_t filters[CAN_LOOP_FILTERS_MAX];
    uint32_t filter_count;
    can_loop_waiting_t babble;
    int64_t babble_until_ns;
    can_loop_counters_t counters;
} can_loop_node_t;

typedef struct {
    can_loop_rule_t rule;
    uint64_t seen; /* frames that it was asked about */
} can_loop_ordered_t;

typedef struct {
    berth_can_frame_t frame;
    int64_t due_ns;
    uint32_t node;
} can_loop_late_t;

typedef struct {
    bool active;
    bool acknowledged;
    bool babble;
    can_loop_action_t action;
    can_loop_event_t event;
} can_loop_wire_t;

struct can_loop {
    int64_t now_ns;
    int64_t bit_ns;
    int64_t idle_ns;  /* the bus is free from here on */
    int64_t busy_ns;  /* all that was ever started, up to idle_ns */
    uint64_t started; /* frames */
    uint64_t frames;  /* of these, ended without error */
    uint64_t random;
    can_loop_wire_t wire;
    can_loop_node_t nodes[CAN_LOOP_NODES_MAX];
    uint32_t node_count;
    can_loop_ordered_t rules[CAN_LOOP_RULES_MAX];
    uint32_t rule_count;
    can_loop_late_t late[CAN_LOOP_LATE_MAX];
    uint32_t late_count;
    can_loop_fault_t fault;
    void *fault_context;
    can_loop_observer_t observer;
    void *observer_context;
};

/* An empty bus at time now_us, 0 to CAN_LOOP_TIME_MAX_US. bit_rate in bit/s, 1000 to 1000000, a
 * divisor of 10^9 (all usual rates but 83,333 are); seed for the rules' probabilities. False, and
 * nothing done, where that is broken. */
bool can_loop_init(can_loop_t *loop, uint32_t bit_rate, int64_t now_us, uint64_t seed);

/* Attaches a node and gives its bus. Its number is the count of those attached before it. False
 * when all places are taken. The node is up and error active, receives everything, and has the
 * largest queues.
 *
 * Through the bus: send answers AGAIN when the queue is full and FAILED while the node is bus-off
 * or down, or for a frame that breaks the contract. receive answers FAILED while bus-off or down;
 * what was received before is kept and comes afterwards, with its old time stamps. */
bool can_loop_attach(can_loop_t *loop, berth_can_t *can);

/* Moves time to until_us and does all that happens until then, in its order. What ends at until_us
 * is done; what could start at until_us has not started yet. Nothing for an until_us in the past or
 * beyond CAN_LOOP_TIME_MAX_US (so that running to the deadline of an empty bus does no harm).
 * Cost: the frames in between times the nodes. */
void can_loop_run(can_loop_t *loop, int64_t until_us);

/* When something ends next (a frame, a delay, a recovery), if nobody sends anything meanwhile and
 * no fault lengthens it: run the loop no later than this to be on time. CAN_LOOP_NEVER when there
 * is nothing. Cost: one arbitration. */
int64_t can_loop_deadline(const can_loop_t *loop);

int64_t can_loop_now_us(const can_loop_t *loop);

/* A clock of this virtual time. sleep_until_us returns at once and moves nothing: time is moved by
 * whoever runs the loop, so code that waits by sleeping does not work here. */
berth_clock_t can_loop_clock(can_loop_t *loop);

/* Depths of a node's queues, 1 to their capacities (else clamped to it). Frames beyond are dropped
 * and counted. */
void can_loop_depths(can_loop_t *loop, uint32_t number, uint32_t tx, uint32_t rx);

/* Adds a receive filter; a node with filters gets only frames that one of them wants. False when
 * there is no place left. can_loop_filter_clear: everything again. */
bool can_loop_filter(can_loop_t *loop, uint32_t node, const berth_can_filter_t *filter);
void can_loop_filter_clear(can_loop_t *loop, uint32_t number);

/* Faults by rule, by hook. A rule is refused (false) when there is no place left or when its
 * probability is not in 0 to 1. */
bool can_loop_rule(can_loop_t *loop, const can_loop_rule_t *rule);
void can_loop_rules_clear(can_loop_t *loop);
void can_loop_fault(can_loop_t *loop, can_loop_fault_t fault, void *context);

/* The interface is switched off and on. Off: waiting frames are dropped and counted; a frame that
 * it is just sending ends in an error frame. On: error active. */
void can_loop_down(can_loop_t *loop, uint32_t number);
void can_loop_up(can_loop_t *loop, uint32_t number);

/* The controller withdraws, as when its transmit error counter passes 255; waiting frames are
 * dropped and counted. It comes back 128 * 11 bit times after can_loop_recover, or by itself that
 * long after delay_us where can_loop_auto_recover has set one (negative: not by itself). */
void can_loop_bus_off(can_loop_t *loop, uint32_t number);
void can_loop_recover(can_loop_t *loop, uint32_t number);
void can_loop_auto_recover(can_loop_t *loop, uint32_t number, int64_t delay_us);

/* The wire between the node and the bus is cut, or mended. The node neither hears nor is heard; it
 * is error passive once it has tried to send, since nobody acknowledges. */
void can_loop_cut(can_loop_t *loop, uint32_t number, bool cut);

/* The node sends this frame over and over, as fast as the bus lets it, until until_us; its own
 * frames wait meanwhile. False for a frame that breaks the contract. */
bool can_loop_babble(can_loop_t *loop, uint32_t node, const berth_can_frame_t *frame,
                     int64_t until_us);

/* Is told of every frame on the wire. NULL: nobody. */
void can_loop_observe(can_loop_t *loop, can_loop_observer_t observer, void *context);

/* Counters and what waits; node must be an attached one's number. Waiting to be sent: the one under
 * way counts, a copy that a fault has ordered does not. */
const can_loop_counters_t *can_loop_counters(const can_loop_t *loop, uint32_t node);
uint32_t can_loop_waiting(const can_loop_t *loop, uint32_t node);
uint32_t can_loop_held(const can_loop_t *loop);   /* deliveries held back */
uint64_t can_loop_frames(const can_loop_t *loop); /* ended without error */
uint32_t can_loop_tec(const can_loop_t *loop, uint32_t node);
uint32_t can_loop_rec(const can_loop_t *loop, uint32_t node);

/* Time for which the bus was busy since the start, ns: frames, error frames and intermissions, up
 * to now. The load of a window is the difference of two of these over the time between. */
int64_t can_loop_busy_ns(const can_loop_t *loop);

/* Load between two instants, 0 to 1: since_us and busy_ns taken at the window's begin. 0 for an
 * empty window. Since the start: the instant of can_loop_init and 0. */
double can_loop_load(const can_loop_t *loop, int64_t since_us, int64_t busy_ns);

#ifdef __cplusplus
}
#endif

#endif
