/* What the parts of drive_cia402 share. Private to firmware/src. */
#ifndef BERTH_SRC_CIA402_H
#define BERTH_SRC_CIA402_H

#include "berth/drive_cia402.h"
#include "drive_protocol.h"

/* How far enabling has come. From NODE on the drive's PDOs are ours. */
enum {
    CIA402_NONE = 0,  /* nothing is known of the drive */
    CIA402_SETUP = 1, /* requests of the set-up */
    CIA402_HALT = 2,  /* among them: waits until the node says pre-operational */
    CIA402_NODE = 3,  /* waits until the node says operational */
    CIA402_RUN = 4,   /* the 402 state machine counts */
    CIA402_CHECK = 5  /* and so does the answer to the last request */
};

/* Function codes of the default identifiers, CiA 301. The node is added. */
enum {
    CIA402_ID_NMT = 0x000, /* without node */
    CIA402_ID_SYNC = 0x080,
    CIA402_ID_EMERGENCY = 0x080,
    CIA402_ID_TPDO1 = 0x180,
    CIA402_ID_RPDO1 = 0x200,
    CIA402_ID_TPDO2 = 0x280,
    CIA402_ID_ANSWER = 0x580,
    CIA402_ID_REQUEST = 0x600,
    CIA402_ID_HEARTBEAT = 0x700
};

enum {
    CIA402_NMT_BOOT_UP = 0,
    CIA402_NMT_STOPPED = 4,
    CIA402_NMT_OPERATIONAL = 5,
    CIA402_NMT_PREOPERATIONAL = 127
};

enum { CIA402_NMT_START = 1, CIA402_NMT_ENTER_PREOPERATIONAL = 128 };

enum {
    CIA402_WORD_DISABLE_VOLTAGE = 0x0000,
    CIA402_WORD_QUICK_STOP = 0x0002,
    CIA402_WORD_SHUTDOWN = 0x0006,
    CIA402_WORD_SWITCH_ON = 0x0007,
    CIA402_WORD_ENABLE = 0x000F,
    CIA402_WORD_FAULT_RESET = 0x0080
};

/* cia402_sdo.c: the set-up. start: from its first request. check: the last one, which only a drive
 * in operation can answer; from RUN to CHECK and back. step: in STARTING. */
void cia402_setup_start(berth_drive_t *drive, int64_t at_us);
void cia402_setup_check(berth_drive_t *drive, int64_t at_us);
void cia402_setup_step(berth_drive_t *drive, int64_t now_us, berth_outbox_t *outbox);
drive_frame_t cia402_answer(berth_drive_t *drive, const berth_can_frame_t *frame, int64_t at_us);
uint32_t cia402_setup_object(const berth_drive_t *drive); /* index << 8 | sub of the request */

void cia402_put_nmt(const berth_drive_t *drive, uint8_t command, berth_outbox_t *outbox);
void cia402_put_word_by_sdo(const berth_drive_t *drive, uint16_t word, berth_outbox_t *outbox);

/* SYNCs in a control period, and the time between two of them. */
static inline uint32_t cia402_syncs(const berth_drive_config_t *config) {
    return (config->period_us + BERTH_CIA402_SYNC_US - 1u) / BERTH_CIA402_SYNC_US;
}

static inline uint32_t cia402_sync_period_us(const berth_drive_config_t *config) {
    return config->period_us / cia402_syncs(config);
}

/* cia402_state.c: the 402 state machine. */
drive_frame_t cia402_status(berth_drive_t *drive, const berth_can_frame_t *frame, int64_t at_us);
uint16_t cia402_word(berth_drive_t *drive, int64_t now_us);
bool cia402_fault_told(const berth_drive_t *drive);

#endif
