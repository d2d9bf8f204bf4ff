#include "output_file.h"

#include <errno.h>
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static bool refuse(scenario_error_t *error, const char *path, int reason) {
    snprintf(error->text, sizeof error->text, "%s: cannot write: %s", path, strerror(reason));
    return false;
}

/* The file that a path means: a link is followed, so that renaming does not replace the link. */
static char *resolved(const char *path) {
    char *real = realpath(path, NULL);
    return real != NULL ? real : strdup(path);
}

static int open_temporary(output_file_t *out) {
    const size_t size = strlen(out->path) + 32;
    out->temporary = malloc(size);
    if (out->temporary == NULL) {
        return -1;
    }
    snprintf(out->temporary, size, "%s.%ld.tmp", out->path, (long)getpid());
    return open(out->temporary, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
}

static void forget(output_file_t *out) {
    free(out->path);
    free(out->temporary);
    *out = (output_file_t){0};
}

bool output_file_open(output_file_t *out, const char *path, scenario_error_t *error) {
    struct stat status;
    const bool exists = stat(path, &status) == 0;
    *out = (output_file_t){0};
    if (path[0] == '\0') {
        return refuse(error, "(empty path)", ENOENT);
    }
    if (exists && S_ISDIR(status.st_mode)) {
        return refuse(error, path, EISDIR);
    }
    if (exists && access(path, W_OK) != 0) {
        return refuse(error, path, errno);
    }
    const bool in_place = exists && !S_ISREG(status.st_mode);
    out->path = in_place ? strdup(path) : resolved(path);
    if (out->path == NULL) {
        return refuse(error, path, ENOMEM);
    }
    const int fd = in_place ? open(path, O_WRONLY | O_CLOEXEC) : open_temporary(out);
    out->file = fd < 0 ? NULL : fdopen(fd, "w");
    if (out->file == NULL) {
        refuse(error, path, errno);
        if (fd >= 0) {
            close(fd);
        }
        forget(out);
        return false;
    }
    return true;
}

bool output_file_commit(output_file_t *out, scenario_error_t *error) {
    errno = 0;
    const bool written = ferror(out->file) == 0;
    const bool closed = fclose(out->file) == 0;
    out->file = NULL;
    if (written && closed && (out->temporary == NULL || rename(out->temporary, out->path) == 0)) {
        forget(out);
        return true;
    }
    /* NOLINTNEXTLINE(clang-analyzer-unix.Errno): it was 0, and what failed last has set it */
    refuse(error, out->path, errno != 0 ? errno : EIO);
    output_file_discard(out);
    return false;
}

void output_file_discard(output_file_t *out) {
    if (out->file != NULL) {
        fclose(out->file);
    }
    if (out->temporary != NULL) {
        unlink(out->temporary);
    }
    forget(out);
}
