/* bxcan_model.h - what the bxCAN controller does when its registers are read and written, from the
 * reference manual's description (RM0090). It shares nothing with the driver: offsets and bits are
 * its own.
 *
 * Modes (initialisation, normal, sleep) and their handshake; the three mailboxes with their states,
 * priorities and aborts; FIFO 0 with three places, its release, lock and overrun; filter banks of
 * 32 bits by mask or list, shared between two controllers; error counters, error codes, bus-off
 * with both recoveries; the interrupt lines. Not: time-triggered mode, loop-back, silent mode,
 * FIFO 1, banks of 16 bits, wake-up: using them counts as a violation.
 *
 * What the manual forbids, or leaves without effect, is counted in violations: writing a mailbox
 * that is not empty, the bit timing outside initialisation, filters outside their initialisation,
 * reading an empty FIFO, asking to send more than 8 bytes.
 */
#ifndef BERTH_TESTS_BXCAN_MODEL_H
#define BERTH_TESTS_BXCAN_MODEL_H

#include "io_model.h"
#include "node_model.h"

#include <stdbool.h>
#include <stdint.h>

#define BXCAN_MODEL_BYTES 0x320u
#define BXCAN_MODEL_FIFO 3u

typedef enum { BX_SLEEP, BX_INIT, BX_NORMAL } bx_mode_t;
typedef enum { BX_EMPTY, BX_PENDING, BX_ON_WIRE } bx_box_state_t;

typedef struct {
    bx_box_state_t state;
    bool abort; /* asked for while on the wire */
    uint32_t words[4];
} bx_box_t;

typedef struct bxcan_model {
    /* What the test may set. */
    uint32_t mode_delay;         /* reads of MSR until a change of mode shows */
    bool mode_stuck;             /* ... never */
    bool bus_dominant;           /* no recessive bits: initialisation cannot be left */
    uint32_t release_delay;      /* reads of RF0R until a release shows */
    struct bxcan_model *filters; /* whose banks count; itself unless it is the second controller */

    /* What the test may look at. */
    uint32_t violations;
    const char *violation; /* the last one */
    uint32_t overruns;     /* frames lost for want of room in the FIFO */
    uint32_t heard, filtered;
    uint32_t tec, rec;

    bx_mode_t mode;
    uint32_t delay_left;
    uint32_t mcr, tsr, ier, btr, fmr, fm1r, fs1r, ffa1r, fa1r;
    uint32_t lec;
    bool erri, boff, fovr;
    uint32_t recovery; /* sequences of recessive bits still missing */
    bool recovering;
    uint32_t banks[56];
    bx_box_t boxes[3];
    uint32_t fifo[BXCAN_MODEL_FIFO][4];
    uint32_t fmp;
    bool releasing;
    uint32_t release_left;
} bxcan_model_t;

/* As after reset. */
void bxcan_model_init(bxcan_model_t *model);
void bxcan_model_map(bxcan_model_t *model, const volatile void *block);

node_t bxcan_model_node(bxcan_model_t *model);

/* The two interrupt lines. */
bool bxcan_model_fifo_line(const bxcan_model_t *model);
bool bxcan_model_status_line(const bxcan_model_t *model);

/* Sets the transmit error counter, with all that follows from it. */
void bxcan_model_set_tec(bxcan_model_t *model, uint32_t tec);

#endif
