/* fdcan_model.h - what the FDCAN controller of an STM32G4 does when its registers and message RAM
 * are read and written, from the reference manual's description (RM0440). It shares nothing with
 * the driver: offsets and bits are its own.
 *
 * Initialisation and configuration mode with what they protect and reset; the three transmit
 * buffers as FIFO or queue, with put index, requests, cancellations; FIFO 0 with three places,
 * blocking or overwriting; standard and extended filters of all types but "priority"; PSR and ECR
 * with what reading them resets; bus-off, which stops the controller by itself; interrupt flags.
 * Not: flexible data rate, FIFO 1, transmit events, time stamps, test modes: using them counts as a
 * violation.
 *
 * What the manual forbids is counted in violations: protected registers outside configuration mode,
 * requests for a buffer that is pending, writing a pending buffer, acknowledging what is not there,
 * reading an element that is not received, more than 8 bytes.
 */
#ifndef BERTH_TESTS_FDCAN_MODEL_H
#define BERTH_TESTS_FDCAN_MODEL_H

#include "io_model.h"
#include "node_model.h"

#include <stdbool.h>
#include <stdint.h>

#define FDCAN_MODEL_BYTES 0x104u
#define FDCAN_MODEL_RAM_WORDS 212u

typedef struct {
    /* What the test may set. */
    uint32_t init_delay; /* reads of CCCR until a change of INIT shows */
    bool init_stuck;     /* ... never */
    bool bus_dominant;   /* no recessive bits: it stays synchronizing */
    bool lazy_cancel;    /* cancellations are not carried out while the controller stands */
    bool garbled;        /* what was offered or received is number 3, which does not exist */
    bool restricted;     /* ASM: as after a failed access to the message RAM */

    /* What the test may look at. */
    uint32_t violations;
    const char *violation;
    uint32_t lost;
    uint32_t tec, rec;

    uint32_t ram[FDCAN_MODEL_RAM_WORDS];
    bool init, init_wanted, cce;
    uint32_t delay_left;
    uint32_t nbtp, rxgfc, xidam, txbc, ir, ie, ils, ile;
    uint32_t lec;
    bool boff, synchronized;
    uint32_t recovery;
    uint32_t pending, occurred, finished, cancelling;
    uint32_t offered;            /* by the put index, since they were asked for */
    int on_wire;                 /* buffer; -1: none */
    uint32_t order[3], requests; /* of FIFO mode: when each was asked for */
    uint32_t fill, get;
    bool element_read[3];
} fdcan_model_t;

/* As after reset; the message RAM holds anything. */
void fdcan_model_init(fdcan_model_t *model);
void fdcan_model_map(fdcan_model_t *model, const volatile void *block, const volatile void *ram);

node_t fdcan_model_node(fdcan_model_t *model);

/* Interrupt line 0. */
bool fdcan_model_line(const fdcan_model_t *model);

/* Sets the transmit error counter, with all that follows from it. */
void fdcan_model_set_tec(fdcan_model_t *model, uint32_t tec);

#endif
