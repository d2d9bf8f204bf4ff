/* The parts of the simulated CiA 402 drive, and what they ask of each other. Private to them.
 *
 *   drive_sim_canopen.c  NMT, heartbeats, emergency messages, and who gets which frame
 *   drive_sim_objects.c  the object dictionary
 *   drive_sim_sdo.c      the SDO server
 *   drive_sim_pdo.c      PDOs and SYNC
 *   drive_sim_cia402.c   the device profile: state machine, ramps, feedback
 *
 * Functions that may refuse return an SDO abort code, 0 for done.
 */
#ifndef HOST_SIM_BUS_DRIVE_SIM_CANOPEN_H
#define HOST_SIM_BUS_DRIVE_SIM_CANOPEN_H

#include "drive_sim.h"
#include "drive_sim_timer.h"

#define CANOPEN_PDOS 4u
#define CANOPEN_MAPPED 8u /* objects in a PDO, at most */

#define CANOPEN_ABORT_TOGGLE UINT32_C(0x05030000)
#define CANOPEN_ABORT_COMMAND UINT32_C(0x05040001)
#define CANOPEN_ABORT_READ_ONLY UINT32_C(0x06010002)
#define CANOPEN_ABORT_NO_OBJECT UINT32_C(0x06020000)
#define CANOPEN_ABORT_NO_MAPPING UINT32_C(0x06040041)
#define CANOPEN_ABORT_PDO_LENGTH UINT32_C(0x06040042)
#define CANOPEN_ABORT_LENGTH UINT32_C(0x06070010)
#define CANOPEN_ABORT_NO_SUB UINT32_C(0x06090011)
#define CANOPEN_ABORT_RANGE UINT32_C(0x06090030)
#define CANOPEN_ABORT_STATE UINT32_C(0x08000022)

typedef enum {
    CANOPEN_INITIALISING = 0,
    CANOPEN_STOPPED = 4,
    CANOPEN_OPERATIONAL = 5,
    CANOPEN_PRE_OPERATIONAL = 127
} canopen_nmt_t;

/* The objects that are plain numbers; PDO parameters live in canopen_pdo_t. */
typedef enum {
    OBJECT_DEVICE_TYPE,
    OBJECT_ERROR_REGISTER,
    OBJECT_HISTORY,
    OBJECT_HISTORY_1,
    OBJECT_HISTORY_2,
    OBJECT_HISTORY_3,
    OBJECT_HISTORY_4,
    OBJECT_SYNC_ID,
    OBJECT_NAME,
    OBJECT_EMERGENCY_ID,
    OBJECT_CONSUMERS,
    OBJECT_CONSUMER,
    OBJECT_PRODUCER,
    OBJECT_IDENTITY,
    OBJECT_VENDOR,
    OBJECT_PRODUCT,
    OBJECT_REVISION,
    OBJECT_SERIAL,
    OBJECT_BEHAVIOURS,
    OBJECT_BEHAVIOUR,
    OBJECT_ABORT_CONNECTION,
    OBJECT_ERROR_CODE,
    OBJECT_CONTROLWORD,
    OBJECT_STATUSWORD,
    OBJECT_QUICK_STOP_OPTION,
    OBJECT_FAULT_OPTION,
    OBJECT_MODE,
    OBJECT_MODE_DISPLAY,
    OBJECT_POSITION,
    OBJECT_VELOCITY_DEMAND,
    OBJECT_VELOCITY,
    OBJECT_VELOCITY_WINDOW,
    OBJECT_VELOCITY_THRESHOLD,
    OBJECT_ACCELERATION,
    OBJECT_DECELERATION,
    OBJECT_QUICK_STOP_DECELERATION,
    OBJECT_RESOLUTION,
    OBJECT_INCREMENTS,
    OBJECT_TURNS,
    OBJECT_INTERPOLATION,
    OBJECT_INTERPOLATION_VALUE,
    OBJECT_INTERPOLATION_INDEX,
    OBJECT_TARGET_VELOCITY,
    OBJECT_SUPPORTED_MODES,
    OBJECT_COUNT,
    OBJECT_NONE = OBJECT_COUNT
} canopen_object_t;

typedef struct {
    /* Parameters. */
    uint32_t cob_id;
    uint8_t type;
    uint16_t inhibit_100us;
    uint16_t event_ms;
    uint8_t count;
    uint32_t map[CANOPEN_MAPPED];
    /* Received: the data of the last frame, waiting for SYNC. */
    bool waiting;
    uint8_t data[8];
    /* Sent: the part of the data whose change is an event, as last sent; SYNCs since. */
    bool told;
    uint8_t key[8];
    uint8_t syncs;
    bool due;
    int64_t quiet_until_us;
    drive_sim_timer_t event;
} canopen_pdo_t;

typedef enum {
    CIA402_NOT_READY_TO_SWITCH_ON,
    CIA402_SWITCH_ON_DISABLED,
    CIA402_READY_TO_SWITCH_ON,
    CIA402_SWITCHED_ON,
    CIA402_OPERATION_ENABLED,
    CIA402_QUICK_STOP_ACTIVE,
    CIA402_FAULT_REACTION_ACTIVE,
    CIA402_FAULT
} cia402_state_t;

typedef struct {
    canopen_nmt_t nmt;
    int64_t boot_us; /* when initialising ends */
    uint32_t objects[OBJECT_COUNT];
    canopen_pdo_t rpdo[CANOPEN_PDOS], tpdo[CANOPEN_PDOS];
    drive_sim_timer_t producer;
    bool consumer_heard, consumer_lost;
    int64_t consumer_us; /* last heard */
    bool pdo_error;      /* a PDO was too short */
    bool error_told;     /* an emergency message is to be followed by one that says all is well */
    bool uploading;      /* a segmented upload is under way */
    bool toggle;
    unsigned uploaded;
    /* Device profile. */
    cia402_state_t state;
    int64_t ready_us;
    uint32_t controlword; /* the last one, for its edges */
    double setpoint;      /* of the speed, in velocity units, behind the ramp */
    int64_t ramp_us;      /* as of when */
    int64_t stand_us;     /* until when it waits for the wheel to stand */
} drive_sim_cia402_state_t;

/* Objects. */
void canopen_objects_reset(drive_sim_t *sim, bool communication_only);
canopen_object_t canopen_object(uint16_t index, uint8_t sub);
unsigned canopen_object_size(canopen_object_t object); /* bytes; 0: text */
bool canopen_object_mappable(canopen_object_t object, bool received);
bool canopen_object_is_event(canopen_object_t object);
int64_t canopen_number(const drive_sim_t *sim, canopen_object_t object);
/* Into an object that is a number: range, then the effect that writing has. */
uint32_t canopen_store(drive_sim_t *sim, canopen_object_t object, uint32_t value);
/* Any object, as SDO reads and writes them. size 0 in write: not told. */
uint32_t canopen_read(drive_sim_t *sim, uint32_t multiplexer, uint32_t *value, unsigned *size);
uint32_t canopen_write(drive_sim_t *sim, uint32_t multiplexer, uint32_t value, unsigned size);
const char *canopen_name(void);

/* PDO parameters: is the index one of theirs? Then the two functions serve it. */
bool canopen_pdo_owns(uint16_t index);
uint32_t canopen_pdo_read(drive_sim_t *sim, uint32_t multiplexer, uint32_t *value, unsigned *size);
uint32_t canopen_pdo_write(drive_sim_t *sim, uint32_t multiplexer, uint32_t value, unsigned size);
void canopen_pdo_reset(drive_sim_t *sim);
void canopen_pdo_start(drive_sim_t *sim); /* on entering operational */
bool canopen_pdo_receive(drive_sim_t *sim, const berth_can_frame_t *frame);
void canopen_pdo_sync(drive_sim_t *sim);
void canopen_pdo_events(drive_sim_t *sim); /* sends what has changed or is due */
int64_t canopen_pdo_deadline(const drive_sim_t *sim);

/* SDO. */
void canopen_sdo_receive(drive_sim_t *sim, const berth_can_frame_t *frame);

/* Network. */
void canopen_heartbeat_written(drive_sim_t *sim, canopen_object_t object);
void canopen_emergency(drive_sim_t *sim, uint16_t code);
void canopen_check_errors(drive_sim_t *sim); /* tells when the last error is gone */

/* Device profile. */
void cia402_reset(drive_sim_t *sim);
void cia402_written(drive_sim_t *sim, canopen_object_t object);
void cia402_refresh(drive_sim_t *sim); /* brings the read-only objects up to date */
void cia402_advance(drive_sim_t *sim); /* to now: ramps, ends of stops */
int64_t cia402_deadline(const drive_sim_t *sim);
bool cia402_enabled(const drive_sim_t *sim);
double cia402_target_rps(const drive_sim_t *sim);
void cia402_fault(drive_sim_t *sim, uint16_t code);
bool cia402_connection_lost(drive_sim_t *sim, uint16_t code); /* true: it became a fault */
uint8_t cia402_error_register(const drive_sim_t *sim);

#endif
