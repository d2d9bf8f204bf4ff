#include "stream.h"

#include "realtime.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <sys/file.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <termios.h>
#include <unistd.h>

#define BACKLOG 4

/* The kernel doubles it, and takes about 0.8 kB of it for each short write: some 40 frames. */
#define SEND_QUEUE_BYTES 16384

/* A dot, a process id, NUL: publish_at. */
#define SUFFIX_MAX 12u

_Static_assert(STREAM_PATH_MAX + SUFFIX_MAX <= sizeof(((struct sockaddr_un *)0)->sun_path),
               "a path and its temporary neighbour fit a socket's address");

static bool fail(char *error, size_t error_size, const char *path, const char *why) {
    (void)snprintf(error, error_size, "%s: %s", path, why);
    return false;
}

/* Closes and keeps errno, which says why. */
static void close_quietly(int *fd) {
    const int kept = errno;
    if (*fd >= 0) {
        (void)close(*fd);
    }
    *fd = -1;
    errno = kept;
}

/* ---- The three kinds ---------------------------------------------------------------------------
 */

static bool make_raw(int fd) {
    struct termios settings;
    if (tcgetattr(fd, &settings) != 0) {
        return false;
    }
    cfmakeraw(&settings);
    settings.c_cflag |= CLOCAL | CREAD;
    settings.c_cflag &= ~(tcflag_t)CRTSCTS;
    /* With VMIN 1, nothing to read is EAGAIN, and 0 bytes read is a hang-up. */
    settings.c_cc[VMIN] = 1;
    settings.c_cc[VTIME] = 0;
    return tcsetattr(fd, TCSANOW, &settings) == 0;
}

static int open_tty(const char *path) {
    int fd = open(path, O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC);
    if (fd >= 0 && !make_raw(fd)) {
        close_quietly(&fd);
    }
    return fd;
}

static struct sockaddr_un address_of(const char *path) {
    struct sockaddr_un address = {.sun_family = AF_UNIX};
    (void)snprintf(address.sun_path, sizeof address.sun_path, "%s", path);
    return address;
}

static int unix_socket(void) {
    return socket(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
}

/* A peer that stands still must not find seconds of old frames when it goes on. */
static void keep_queue_short(int fd) {
    const int bytes = SEND_QUEUE_BYTES;
    (void)setsockopt(fd, SOL_SOCKET, SO_SNDBUF, &bytes, sizeof bytes);
}

static int connect_to(const char *path) {
    const struct sockaddr_un address = address_of(path);
    int fd = unix_socket();
    if (fd >= 0 && connect(fd, (const struct sockaddr *)&address, sizeof address) != 0) {
        close_quietly(&fd);
    }
    if (fd >= 0) {
        keep_queue_short(fd);
    }
    return fd;
}

static int listen_at(const char *path) {
    const struct sockaddr_un address = address_of(path);
    int fd = unix_socket();
    if (fd < 0) {
        return -1;
    }
    if (bind(fd, (const struct sockaddr *)&address, sizeof address) != 0) {
        close_quietly(&fd);
        return -1;
    }
    if (listen(fd, BACKLOG) != 0) {
        close_quietly(&fd);
        (void)unlink(path);
    }
    return fd;
}

/* Makes the socket elsewhere and gives it the name when it listens, so that whoever finds it there
 * can connect, and of two processes only one gets the name (the other has EEXIST). */
static int publish_at(const char *path) {
    char other[STREAM_PATH_MAX + SUFFIX_MAX];
    (void)snprintf(other, sizeof other, "%.96s.%u", path, (unsigned)getpid());
    int fd = listen_at(other);
    if (fd >= 0 && link(other, path) != 0) {
        close_quietly(&fd);
    }
    const int kept = errno;
    (void)unlink(other);
    errno = kept;
    return fd;
}

/* ---- Opening -----------------------------------------------------------------------------------
 */

static bool open_listener(stream_t *stream) {
    struct stat status;
    stream->listener = publish_at(stream->path);
    if (stream->listener < 0) {
        return false;
    }
    stream->kind = STREAM_LISTEN;
    if (stat(stream->path, &status) == 0) {
        stream->device = status.st_dev;
        stream->inode = status.st_ino;
    }
    return true;
}

/* A socket that refuses is dead: it was listening before it got its name. */
static bool open_socket(stream_t *stream, const struct stat *seen) {
    stream->kind = STREAM_CONNECT;
    stream->fd = connect_to(stream->path);
    if (stream->fd >= 0) {
        return true;
    }
    struct stat status;
    if (errno != ECONNREFUSED || stat(stream->path, &status) != 0 ||
        status.st_ino != seen->st_ino || status.st_dev != seen->st_dev) {
        return false;
    }
    return unlink(stream->path) == 0 && open_listener(stream);
}

static bool open_character_device(stream_t *stream, char *error, size_t error_size) {
    stream->kind = STREAM_TTY;
    stream->fd = open_tty(stream->path);
    if (stream->fd >= 0) {
        return true;
    }
    return fail(error, error_size, stream->path, errno == ENOTTY ? "not a tty" : strerror(errno));
}

static bool open_kind(stream_t *stream, char *error, size_t error_size) {
    struct stat status;
    if (stat(stream->path, &status) != 0) {
        if (errno == ENOENT && open_listener(stream)) {
            return true;
        }
        /* Somebody else was faster: it is a socket to connect to now. */
        if (errno != EEXIST || stat(stream->path, &status) != 0) {
            return fail(error, error_size, stream->path, strerror(errno));
        }
    }
    if (S_ISCHR(status.st_mode)) {
        return open_character_device(stream, error, error_size);
    }
    if (!S_ISSOCK(status.st_mode)) {
        return fail(
            error, error_size, stream->path,
            "neither a tty nor a socket (allowed: a tty, a pty, a unix socket, or nothing)");
    }
    return open_socket(stream, &status) || fail(error, error_size, stream->path, strerror(errno));
}

/* Processes that open the same path look and act one after the other: the folder is locked
 * meanwhile, for microseconds. -1: it cannot be, and there is no such protection. */
static int lock_folder(const char *path) {
    char folder[STREAM_PATH_MAX + 1u];
    (void)snprintf(folder, sizeof folder, "%s", path);
    char *end = strrchr(folder, '/');
    if (end == folder) {
        end++;
    }
    if (end != NULL) {
        *end = '\0';
    }
    const int fd = open(end != NULL ? folder : ".", O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (fd >= 0) {
        (void)flock(fd, LOCK_EX);
    }
    return fd;
}

bool stream_open(stream_t *stream, const char *path, char *error, size_t error_size) {
    *stream = (stream_t){.fd = -1, .listener = -1};
    const size_t length = strlen(path);
    if (length == 0u) {
        return fail(error, error_size, "stream", "no path given");
    }
    if (length > STREAM_PATH_MAX) {
        (void)snprintf(error, error_size, "%.40s...: path of %zu characters (at most %u)", path,
                       length, STREAM_PATH_MAX);
        return false;
    }
    memcpy(stream->path, path, length + 1u);
    int lock = lock_folder(path);
    const bool good = open_kind(stream, error, error_size);
    close_quietly(&lock);
    if (!good) {
        stream->kind = STREAM_CLOSED;
    }
    return good;
}

/* ---- In use ------------------------------------------------------------------------------------
 */

static void lose(stream_t *stream) {
    close_quietly(&stream->fd);
    stream->losses += stream->losses < UINT32_MAX ? 1u : 0u;
    stream->retry_us = realtime_now_us() + STREAM_RETRY_US;
}

/* A listener's accept costs little and needs no pause. */
static void look_for_peer(stream_t *stream) {
    if (stream->kind == STREAM_LISTEN) {
        stream->fd = accept4(stream->listener, NULL, NULL, SOCK_NONBLOCK | SOCK_CLOEXEC);
        if (stream->fd >= 0) {
            keep_queue_short(stream->fd);
        }
        return;
    }
    const int64_t now_us = realtime_now_us();
    if (now_us < stream->retry_us) {
        return;
    }
    stream->retry_us = now_us + STREAM_RETRY_US;
    stream->fd = stream->kind == STREAM_TTY ? open_tty(stream->path) : connect_to(stream->path);
}

static bool has_peer(stream_t *stream) {
    if (stream->fd < 0 && stream->kind != STREAM_CLOSED) {
        look_for_peer(stream);
    }
    return stream->fd >= 0;
}

static byte_stream_outcome_t outcome_of(stream_t *stream, ssize_t done, size_t *count) {
    if (done > 0) {
        *count = (size_t)done;
        return BYTE_STREAM_DONE;
    }
    if (done < 0 && (errno == EAGAIN || errno == EWOULDBLOCK || errno == EINTR)) {
        return BYTE_STREAM_AGAIN;
    }
    lose(stream);
    return BYTE_STREAM_FAILED;
}

static byte_stream_outcome_t read_some(void *context, uint8_t *bytes, size_t room, size_t *count) {
    stream_t *stream = context;
    *count = 0;
    if (!has_peer(stream)) {
        return BYTE_STREAM_FAILED;
    }
    return outcome_of(stream, read(stream->fd, bytes, room), count);
}

static ssize_t write_to(const stream_t *stream, const uint8_t *bytes, size_t length) {
    if (stream->kind == STREAM_TTY) {
        return write(stream->fd, bytes, length);
    }
    return send(stream->fd, bytes, length, MSG_NOSIGNAL);
}

static byte_stream_outcome_t write_some(void *context, const uint8_t *bytes, size_t length,
                                        size_t *count) {
    stream_t *stream = context;
    *count = 0;
    if (!has_peer(stream)) {
        return BYTE_STREAM_FAILED;
    }
    return outcome_of(stream, write_to(stream, bytes, length), count);
}

byte_stream_t stream_bytes(stream_t *stream) {
    static const byte_stream_api_t api = {read_some, write_some};
    return (byte_stream_t){&api, stream};
}

int stream_fd(const stream_t *stream) {
    return stream->fd >= 0 ? stream->fd : stream->listener;
}

void stream_close(stream_t *stream) {
    struct stat status;
    close_quietly(&stream->fd);
    stream->kind = STREAM_CLOSED;
    if (stream->listener < 0) {
        return;
    }
    close_quietly(&stream->listener);
    /* Only our own: another process may have put its socket there since. */
    if (stat(stream->path, &status) == 0 && status.st_dev == stream->device &&
        status.st_ino == stream->inode) {
        (void)unlink(stream->path);
    }
}
