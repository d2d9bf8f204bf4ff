/* What newlib and picolibc ask of a system, for images that use their streams, heap or
 * environment. The environment is what the emulator's command line has of the form NAME=VALUE. */
#include "semihosting.h"
#include "start.h"

#include <errno.h>
#include <stdio.h>
#include <string.h>

#define COMMAND_LINE_BYTES 256
#define ENVIRONMENT_MAX 8

extern char **environ;

static char command_line[COMMAND_LINE_BYTES];
static char *environment[ENVIRONMENT_MAX + 1];

static void read_environment(void) {
    int count = 0;
    semihosting_command_line(command_line, sizeof command_line);
    for (char *word = strtok(command_line, " "); word != NULL; word = strtok(NULL, " ")) {
        if (strchr(word, '=') != NULL && count < ENVIRONMENT_MAX) {
            environment[count++] = word;
        }
    }
    environ = environment;
}

void *sbrk(ptrdiff_t increment);

static char *heap = board_heap_start;

void *sbrk(ptrdiff_t increment) {
    if (increment > board_heap_end - heap || increment < board_heap_start - heap) {
        errno = ENOMEM;
        return (void *)-1;
    }
    char *before = heap;
    heap += increment;
    return before;
}

#if defined(__PICOLIBC__)

static int put(char byte, FILE *stream) {
    (void)stream;
    board_write(&byte, 1);
    return 0;
}

static FILE console = FDEV_SETUP_STREAM(put, NULL, NULL, _FDEV_SETUP_WRITE);
FILE *const stdout = &console;
FILE *const stderr = &console;
FILE *const stdin = &console;

void board_before_main(void) {
    read_environment();
}

int kill(int process, int signal);
int getpid(void);
_Noreturn void _exit(int status);

int kill(int process, int signal) {
    (void)process;
    board_exit(BOARD_STATUS_FAULT + signal);
}

int getpid(void) {
    return 1;
}

_Noreturn void _exit(int status) {
    board_exit(status);
}

#else

#include <sys/stat.h>

void *_sbrk(ptrdiff_t increment);
int _write(int file, const char *bytes, int count);
int _read(int file, char *bytes, int count);
int _close(int file);
int _fstat(int file, struct stat *status);
int _isatty(int file);
int _lseek(int file, int offset, int origin);
int _kill(int process, int signal);
int _getpid(void);
_Noreturn void _exit(int status);

void *_sbrk(ptrdiff_t increment) {
    return sbrk(increment);
}

int _write(int file, const char *bytes, int count) {
    (void)file;
    board_write(bytes, (size_t)count);
    return count;
}

int _read(int file, char *bytes, int count) {
    (void)file;
    (void)bytes;
    (void)count;
    return 0;
}

int _close(int file) {
    (void)file;
    return 0;
}

int _fstat(int file, struct stat *status) {
    (void)file;
    *status = (struct stat){.st_mode = S_IFCHR};
    return 0;
}

int _isatty(int file) {
    (void)file;
    return 1;
}

int _lseek(int file, int offset, int origin) {
    (void)file;
    (void)offset;
    (void)origin;
    return 0;
}

int _kill(int process, int signal) {
    (void)process;
    board_exit(BOARD_STATUS_FAULT + signal);
}

int _getpid(void) {
    return 1;
}

_Noreturn void _exit(int status) {
    board_exit(status);
}

/* A small buffer, so that a small board needs no kilobyte of heap for it. */
void board_before_main(void) {
    static char buffer[80];
    setvbuf(stdout, buffer, _IOLBF, sizeof buffer);
    read_environment();
}

void board_after_main(void) {
    fflush(stdout);
}

#endif
