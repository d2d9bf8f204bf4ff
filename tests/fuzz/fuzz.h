/* What every fuzz target shares: its entry, and how it says that something does not hold.
 *
 * A target is one file with LLVMFuzzerTestOneInput. It is linked twice: with libFuzzer (option
 * BERTH_BUILD_FUZZERS, preset clang-fuzz), which looks for inputs that reach new code; and with
 * replay_main.c in every build, which runs the inputs of the tree again.
 */
#ifndef BERTH_TESTS_FUZZ_H
#define BERTH_TESTS_FUZZ_H

#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

/* One input. Always 0. Does not return when something does not hold. */
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static inline void fuzz_check(int holds, const char *claim, const char *file, int line) {
    if (!holds) {
        (void)fflush(stdout);
        (void)fprintf(stderr, "%s:%d: does not hold: %s\n", file, line, claim);
        abort();
    }
}

/* Prints the claim and aborts when the condition is false. */
#define FUZZ_CHECK(condition, claim) fuzz_check((condition) ? 1 : 0, claim, __FILE__, __LINE__)

#endif
