/* An input as a file that a program can open by its path, without touching a disk. */
#ifndef BERTH_TESTS_FUZZ_MEMORY_FILE_H
#define BERTH_TESTS_FUZZ_MEMORY_FILE_H

#include "fuzz.h"

#include <sys/mman.h>
#include <unistd.h>

typedef struct {
    int fd;
    char path[32];
} memory_file_t;

static inline void memory_file_add(const memory_file_t *file, const void *data, size_t size) {
    FUZZ_CHECK(write(file->fd, data, size) == (ssize_t)size, "memory takes an input");
}

static inline memory_file_t memory_file_open(void) {
    memory_file_t file = {.fd = memfd_create("input", 0)};
    FUZZ_CHECK(file.fd >= 0, "there are files in memory");
    (void)snprintf(file.path, sizeof file.path, "/proc/self/fd/%d", file.fd);
    return file;
}

static inline void memory_file_close(const memory_file_t *file) {
    (void)close(file->fd);
}

#endif
