/* Runs inputs again, without libFuzzer: replay FOLDER-OR-FILE...
 *
 * Each file of each folder is one input. Ends like a Unity program, with the number of inputs; an
 * input that shows something wrong ends the process, and its name is the last one printed. A folder
 * that is not there holds none; without any input at all the run fails.
 */
#include "fuzz.h"

#include <dirent.h>
#include <stdbool.h>
#include <string.h>

static int runs;

static uint8_t *read_all(const char *path, size_t *size) {
    FILE *file = fopen(path, "rb");
    if (file == NULL) {
        return NULL;
    }
    uint8_t *bytes = NULL;
    *size = 0;
    for (size_t room = 4096;; room *= 2) {
        uint8_t *grown = realloc(bytes, room);
        if (grown == NULL) {
            free(bytes);
            (void)fclose(file);
            return NULL;
        }
        bytes = grown;
        *size += fread(bytes + *size, 1, room - *size, file);
        if (*size < room) {
            break;
        }
    }
    (void)fclose(file);
    return bytes;
}

/* In a block of just its size, so that a sanitizer sees a read beyond it. */
static bool run_file(const char *path) {
    size_t size = 0;
    uint8_t *read = read_all(path, &size);
    uint8_t *exact = malloc(size > 0 ? size : 1);
    const bool good = read != NULL && exact != NULL;
    if (good) {
        if (size > 0) {
            memcpy(exact, read, size);
        }
        (void)printf("%s\n", path);
        (void)fflush(stdout);
        (void)LLVMFuzzerTestOneInput(exact, size);
        runs++;
    } else {
        (void)fprintf(stderr, "%s: cannot read\n", path);
    }
    free(exact);
    free(read);
    return good;
}

static int visible(const struct dirent *entry) {
    return entry->d_name[0] != '.';
}

static bool run_folder(const char *path, struct dirent **entries, int count) {
    bool good = true;
    for (int i = 0; i < count; i++) {
        char name[1024];
        (void)snprintf(name, sizeof name, "%s/%s", path, entries[i]->d_name);
        good = run_file(name) && good;
        free(entries[i]);
    }
    free(entries);
    return good;
}

int main(int argc, char **argv) {
    bool good = true;
    for (int i = 1; i < argc; i++) {
        struct dirent **entries = NULL;
        const int count = scandir(argv[i], &entries, visible, alphasort);
        if (count >= 0) {
            good = run_folder(argv[i], entries, count) && good;
            continue;
        }
        FILE *file = fopen(argv[i], "rb");
        if (file != NULL) {
            (void)fclose(file);
            good = run_file(argv[i]) && good;
        }
    }
    (void)printf("%d Tests %d Failures 0 Ignored\n", runs, good ? 0 : 1);
    return good && runs > 0 ? 0 : 1;
}
