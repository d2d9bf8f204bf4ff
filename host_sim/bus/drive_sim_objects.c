/* The object dictionary of the simulated CiA 402 drive: one line for each object. */
#include "drive_sim_inner.h"

#include <math.h>

enum { WRITE = 1, RPDO = 2, TPDO = 4, EVENT = 8 };
typedef enum { U8, U16, U32, I8, I16, I32, TEXT } type_t;

typedef struct {
    uint16_t index;
    uint8_t sub;
    type_t type;
    unsigned flags;
    uint32_t initial;
    int64_t min, max; /* of values written */
} object_t;

#define FULL_I32 -2147483648LL, 2147483647
#define NO_RANGE 0, 0
#define MODES ((1u << 2) | (1u << 8)) /* profile velocity, cyclic synchronous velocity */

static const object_t objects[OBJECT_COUNT] = {
    /* Type 2: servo drive; 402: the device profile. */
    [OBJECT_DEVICE_TYPE] = {0x1000, 0, U32, 0, 0x00020192, NO_RANGE},
    [OBJECT_ERROR_REGISTER] = {0x1001, 0, U8, TPDO | EVENT, 0, NO_RANGE},
    [OBJECT_HISTORY] = {0x1003, 0, U8, WRITE, 0, 0, 0},
    [OBJECT_HISTORY_1] = {0x1003, 1, U32, 0, 0, NO_RANGE},
    [OBJECT_HISTORY_2] = {0x1003, 2, U32, 0, 0, NO_RANGE},
    [OBJECT_HISTORY_3] = {0x1003, 3, U32, 0, 0, NO_RANGE},
    [OBJECT_HISTORY_4] = {0x1003, 4, U32, 0, 0, NO_RANGE},
    [OBJECT_SYNC_ID] = {0x1005, 0, U32, WRITE, 0x80, 0x80, 0x80},
    [OBJECT_NAME] = {0x1008, 0, TEXT, 0, 0, NO_RANGE},
    [OBJECT_EMERGENCY_ID] = {0x1014, 0, U32, 0, 0x80, NO_RANGE},
    [OBJECT_CONSUMERS] = {0x1016, 0, U8, 0, 1, NO_RANGE},
    [OBJECT_CONSUMER] = {0x1016, 1, U32, WRITE, 0, 0, 0x007fffff},
    [OBJECT_PRODUCER] = {0x1017, 0, U16, WRITE, 0, 0, 65535},
    [OBJECT_IDENTITY] = {0x1018, 0, U8, 0, 4, NO_RANGE},
    [OBJECT_VENDOR] = {0x1018, 1, U32, 0, 0, NO_RANGE}, /* 0: none assigned */
    [OBJECT_PRODUCT] = {0x1018, 2, U32, 0, 402, NO_RANGE},
    [OBJECT_REVISION] = {0x1018, 3, U32, 0, 0x00010000, NO_RANGE},
    [OBJECT_SERIAL] = {0x1018, 4, U32, 0, 0, NO_RANGE},
    [OBJECT_BEHAVIOURS] = {0x1029, 0, U8, 0, 1, NO_RANGE},
    [OBJECT_BEHAVIOUR] = {0x1029, 1, U8, WRITE, 0, 0, 2},
    [OBJECT_ABORT_CONNECTION] = {0x6007, 0, I16, WRITE, 1, 0, 3},
    [OBJECT_ERROR_CODE] = {0x603f, 0, U16, TPDO | EVENT, 0, NO_RANGE},
    [OBJECT_CONTROLWORD] = {0x6040, 0, U16, WRITE | RPDO | TPDO, 0, 0, 65535},
    [OBJECT_STATUSWORD] = {0x6041, 0, U16, TPDO | EVENT, 0, NO_RANGE},
    [OBJECT_QUICK_STOP_OPTION] = {0x605a, 0, I16, WRITE, 2, 0, 7},
    [OBJECT_FAULT_OPTION] = {0x605e, 0, I16, WRITE, 2, 0, 3},
    [OBJECT_MODE] = {0x6060, 0, I8, WRITE | RPDO | TPDO, 0, 0, 9},
    [OBJECT_MODE_DISPLAY] = {0x6061, 0, I8, TPDO | EVENT, 0, NO_RANGE},
    [OBJECT_POSITION] = {0x6064, 0, I32, TPDO, 0, NO_RANGE},
    [OBJECT_VELOCITY_DEMAND] = {0x606b, 0, I32, TPDO, 0, NO_RANGE},
    [OBJECT_VELOCITY] = {0x606c, 0, I32, TPDO, 0, NO_RANGE},
    [OBJECT_VELOCITY_WINDOW] = {0x606d, 0, U16, WRITE, 0, 0, 65535},
    [OBJECT_VELOCITY_THRESHOLD] = {0x606f, 0, U16, WRITE, 0, 0, 65535},
    [OBJECT_ACCELERATION] = {0x6083, 0, U32, WRITE | RPDO, 0, 1, 4294967295},
    [OBJECT_DECELERATION] = {0x6084, 0, U32, WRITE | RPDO, 0, 1, 4294967295},
    [OBJECT_QUICK_STOP_DECELERATION] = {0x6085, 0, U32, WRITE | RPDO, 0, 1, 4294967295},
    [OBJECT_RESOLUTION] = {0x608f, 0, U8, 0, 2, NO_RANGE},
    [OBJECT_INCREMENTS] = {0x608f, 1, U32, 0, 0, NO_RANGE},
    [OBJECT_TURNS] = {0x608f, 2, U32, 0, 1, NO_RANGE},
    /* Interpolation time period, 10 * 10^-3 s; no effect on the ramp here. */
    [OBJECT_INTERPOLATION] = {0x60c2, 0, U8, 0, 2, NO_RANGE},
    [OBJECT_INTERPOLATION_VALUE] = {0x60c2, 1, U8, WRITE, 10, 1, 255},
    [OBJECT_INTERPOLATION_INDEX] = {0x60c2, 2, I8, WRITE, 0xfd, -6, 0},
    [OBJECT_TARGET_VELOCITY] = {0x60ff, 0, I32, WRITE | RPDO | TPDO, 0, FULL_I32},
    [OBJECT_SUPPORTED_MODES] = {0x6502, 0, U32, 0, MODES, NO_RANGE},
};

static const char device_name[] = "simulated CiA 402 wheel drive";

const char *canopen_name(void) {
    return device_name;
}

static bool is_communication(const object_t *object) {
    return object->index < 0x2000;
}

/* value_rps motor turns/s as velocity units, whole and at least 1. */
static uint32_t units(const drive_sim_t *sim, double value_rps, double max) {
    return (uint32_t)fmin(fmax(round(value_rps * sim->config.velocity_units_per_rps), 1.0), max);
}

/* Quick enough not to be felt by a robot: 1000 motor turns/s a second, and twice that to stop. */
static void set_defaults_of_config(drive_sim_t *sim) {
    uint32_t *values = sim->state.cia402.objects;
    values[OBJECT_VELOCITY_WINDOW] = units(sim, 0.1, 65535.0);
    values[OBJECT_VELOCITY_THRESHOLD] = units(sim, 0.05, 65535.0);
    values[OBJECT_ACCELERATION] = units(sim, 1000.0, 4294967295.0);
    values[OBJECT_DECELERATION] = units(sim, 1000.0, 4294967295.0);
    values[OBJECT_QUICK_STOP_DECELERATION] = units(sim, 2000.0, 4294967295.0);
    values[OBJECT_INCREMENTS] = sim->config.counts_per_turn;
}

void canopen_objects_reset(drive_sim_t *sim, bool communication_only) {
    uint32_t *values = sim->state.cia402.objects;
    for (unsigned i = 0; i < OBJECT_COUNT; i++) {
        if (!communication_only || is_communication(&objects[i])) {
            values[i] = objects[i].initial;
        }
    }
    values[OBJECT_EMERGENCY_ID] += sim->config.node;
    values[OBJECT_SERIAL] = sim->config.node;
    if (!communication_only) {
        set_defaults_of_config(sim);
    }
    canopen_pdo_reset(sim);
}

canopen_object_t canopen_object(uint16_t index, uint8_t sub) {
    unsigned i = 0;
    while (i < OBJECT_COUNT && !(objects[i].index == index && objects[i].sub == sub)) {
        i++;
    }
    return (canopen_object_t)i;
}

static bool index_exists(uint16_t index) {
    for (unsigned i = 0; i < OBJECT_COUNT; i++) {
        if (objects[i].index == index) {
            return true;
        }
    }
    return false;
}

unsigned canopen_object_size(canopen_object_t object) {
    static const unsigned sizes[] = {
        [U8] = 1, [U16] = 2, [U32] = 4, [I8] = 1, [I16] = 2, [I32] = 4, [TEXT] = 0};
    return sizes[objects[object].type];
}

bool canopen_object_mappable(canopen_object_t object, bool received) {
    return (objects[object].flags & (received ? RPDO : TPDO)) != 0;
}

bool canopen_object_is_event(canopen_object_t object) {
    return (objects[object].flags & EVENT) != 0;
}

static int64_t number(type_t type, uint32_t value) {
    switch (type) {
    case I8:
        return (int8_t)(value & 0xffu);
    case I16:
        return (int16_t)(value & 0xffffu);
    case I32:
        return (int32_t)value;
    default:
        return (int64_t)value;
    }
}

int64_t canopen_number(const drive_sim_t *sim, canopen_object_t object) {
    return number(objects[object].type, sim->state.cia402.objects[object]);
}

static bool supported(canopen_object_t object, int64_t value) {
    if (object == OBJECT_MODE) {
        return value == 0 || ((MODES >> (value - 1)) & 1u) != 0;
    }
    return object != OBJECT_QUICK_STOP_OPTION || value != 4;
}

uint32_t canopen_store(drive_sim_t *sim, canopen_object_t object, uint32_t value) {
    const int64_t told = number(objects[object].type, value);
    if (told < objects[object].min || told > objects[object].max || !supported(object, told)) {
        return CANOPEN_ABORT_RANGE;
    }
    sim->state.cia402.objects[object] = value;
    canopen_heartbeat_written(sim, object);
    cia402_written(sim, object);
    return 0;
}

static uint16_t index_of(uint32_t multiplexer) {
    return (uint16_t)(multiplexer & 0xffffu);
}

static uint8_t sub_of(uint32_t multiplexer) {
    return (uint8_t)(multiplexer >> 16 & 0xffu);
}

static uint32_t find(uint32_t multiplexer, canopen_object_t *object) {
    *object = canopen_object(index_of(multiplexer), sub_of(multiplexer));
    if (*object != OBJECT_NONE) {
        return 0;
    }
    return index_exists(index_of(multiplexer)) ? CANOPEN_ABORT_NO_SUB : CANOPEN_ABORT_NO_OBJECT;
}

uint32_t canopen_read(drive_sim_t *sim, uint32_t multiplexer, uint32_t *value, unsigned *size) {
    if (canopen_pdo_owns(index_of(multiplexer))) {
        return canopen_pdo_read(sim, multiplexer, value, size);
    }
    canopen_object_t object;
    const uint32_t abort_code = find(multiplexer, &object);
    if (abort_code == 0) {
        cia402_refresh(sim);
        *value = sim->state.cia402.objects[object];
        *size = canopen_object_size(object);
    }
    return abort_code;
}

uint32_t canopen_write(drive_sim_t *sim, uint32_t multiplexer, uint32_t value, unsigned size) {
    if (canopen_pdo_owns(index_of(multiplexer))) {
        return canopen_pdo_write(sim, multiplexer, value, size);
    }
    canopen_object_t object;
    const uint32_t abort_code = find(multiplexer, &object);
    if (abort_code != 0) {
        return abort_code;
    }
    if ((objects[object].flags & WRITE) == 0) {
        return CANOPEN_ABORT_READ_ONLY;
    }
    const unsigned wanted = canopen_object_size(object);
    if (size != 0 && size != wanted) {
        return CANOPEN_ABORT_LENGTH;
    }
    return canopen_store(sim, object, wanted == 4 ? value : value & ((1u << (8 * wanted)) - 1u));
}
