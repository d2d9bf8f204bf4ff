/* io_model.h - register accesses of the STM32 drivers, led to models of the peripherals.
 *
 * A model is mapped to the memory of its register block. Accesses elsewhere, or not to a whole
 * word, fail the test. A hook is called before each access, so that a test can let anything happen
 * between any two of them: an interrupt, a bus error.
 */
#ifndef BERTH_TESTS_IO_MODEL_H
#define BERTH_TESTS_IO_MODEL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef struct {
    uint32_t (*read)(void *context, uint32_t offset);
    void (*write)(void *context, uint32_t offset, uint32_t value);
} io_model_ops_t;

void io_model_reset(void);
void io_model_map(const volatile void *block, size_t size, const io_model_ops_t *ops,
                  void *context);

/* Called before each access, number counts them from 0. Not called from within itself. */
typedef void (*io_model_hook_t)(void *context, uint32_t number);
void io_model_hook(io_model_hook_t hook, void *context);

/* Called when the driver waits for an interrupt. */
void io_model_on_wait(void (*hook)(void *context), void *context);

uint32_t io_model_accesses(void);
bool io_model_masked(void);

#endif
