#include "io_model.h"

#include "stm32_io.h"

#include "unity.h"

#define MAPS_MAX 8u

typedef struct {
    uintptr_t start;
    size_t size;
    const io_model_ops_t *ops;
    void *context;
} map_t;

static map_t maps[MAPS_MAX];
static uint32_t map_count;
static io_model_hook_t hook;
static void *hook_context;
static bool in_hook;
static void (*wait_hook)(void *context);
static void *wait_context;
static uint32_t accesses;
static uint32_t masked;

void io_model_reset(void) {
    map_count = 0;
    hook = NULL;
    wait_hook = NULL;
    in_hook = false;
    accesses = 0;
    masked = 0;
}

void io_model_map(const volatile void *block, size_t size, const io_model_ops_t *ops,
                  void *context) {
    TEST_ASSERT_TRUE(map_count < MAPS_MAX);
    maps[map_count++] = (map_t){(uintptr_t)block, size, ops, context};
}

void io_model_hook(io_model_hook_t called, void *context) {
    hook = called;
    hook_context = context;
    accesses = 0;
}

void io_model_on_wait(void (*called)(void *context), void *context) {
    wait_hook = called;
    wait_context = context;
}

uint32_t io_model_accesses(void) {
    return accesses;
}

bool io_model_masked(void) {
    return masked != 0;
}

static const map_t *find(const volatile uint32_t *address) {
    const uintptr_t at = (uintptr_t)address;
    for (uint32_t i = 0; i < map_count; i++) {
        if (at >= maps[i].start && at - maps[i].start < maps[i].size) {
            TEST_ASSERT_EQUAL_UINT32(0, (at - maps[i].start) % 4u);
            return &maps[i];
        }
    }
    TEST_FAIL_MESSAGE("an access where no model is");
    return NULL;
}

static void before_access(void) {
    const uint32_t number = accesses++;
    if (hook != NULL && !in_hook) {
        in_hook = true;
        hook(hook_context, number);
        in_hook = false;
    }
}

uint32_t stm32_io_read(const volatile uint32_t *address) {
    const map_t *map = find(address);
    before_access();
    return map->ops->read(map->context, (uint32_t)((uintptr_t)address - map->start));
}

void stm32_io_write(volatile uint32_t *address, uint32_t value) {
    const map_t *map = find(address);
    before_access();
    map->ops->write(map->context, (uint32_t)((uintptr_t)address - map->start), value);
}

void stm32_io_wait(void) {
    TEST_ASSERT_NOT_NULL_MESSAGE(wait_hook, "the driver waits where nothing happens");
    wait_hook(wait_context);
}

uint32_t stm32_io_mask(void) {
    return masked++;
}

void stm32_io_unmask(uint32_t before) {
    masked = before;
}
