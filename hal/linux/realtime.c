#include "realtime.h"

#include <errno.h>
#include <poll.h>
#include <sched.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <time.h>

#define NS_PER_US 1000
#define US_PER_S 1000000

/* ---- Histogram ---------------------------------------------------------------------------------
 */

#define LINEAR_BINS 16u /* one microsecond each */
#define OCTAVE_BINS 8u  /* 2^OCTAVE_SHIFT */
#define OCTAVE_SHIFT 3u
#define FIRST_OCTAVE 4u /* 16 us and more */
#define LAST_OCTAVE 24u /* everything from here in one bin */

_Static_assert(REALTIME_BINS == LINEAR_BINS + (LAST_OCTAVE - FIRST_OCTAVE) * OCTAVE_BINS + 1u,
               "16 linear bins, 8 in each of 20 octaves, and one for the rest");

static uint32_t bin_of(uint64_t value) {
    if (value < LINEAR_BINS) {
        return (uint32_t)value;
    }
    if (value >> LAST_OCTAVE != 0u) {
        return REALTIME_BINS - 1u;
    }
    uint32_t octave = FIRST_OCTAVE;
    while (value >> (octave + 1u) != 0u) {
        octave++;
    }
    const uint32_t part = (uint32_t)(value >> (octave - OCTAVE_SHIFT)) & (OCTAVE_BINS - 1u);
    return LINEAR_BINS + (octave - FIRST_OCTAVE) * OCTAVE_BINS + part;
}

int64_t realtime_bin_low_us(uint32_t bin) {
    if (bin < LINEAR_BINS) {
        return bin;
    }
    const uint32_t octave = FIRST_OCTAVE + (bin - LINEAR_BINS) / OCTAVE_BINS;
    const uint32_t part = (bin - LINEAR_BINS) % OCTAVE_BINS;
    return (int64_t)(OCTAVE_BINS + part) << (octave - OCTAVE_SHIFT);
}

void realtime_histogram_add(realtime_histogram_t *histogram, int64_t late_us) {
    const int64_t value = late_us > 0 ? late_us : 0;
    histogram->count++;
    histogram->bins[bin_of((uint64_t)value)]++;
    if (value > histogram->max_us) {
        histogram->max_us = value;
    }
}

/* The rank of a quantile: the least number of values that make up the share, at least one. */
static uint64_t rank_of(uint64_t count, double share) {
    /* A little less, so that 0.07 of 100, which is 7.000000000000001 in binary, is 7. */
    const double wanted = share * (double)count * (1.0 - 1e-12);
    if (!(wanted > 1.0)) {
        return 1u;
    }
    if (wanted >= (double)count) {
        return count;
    }
    const uint64_t whole = (uint64_t)wanted;
    return (double)whole < wanted ? whole + 1u : whole;
}

int64_t realtime_histogram_quantile(const realtime_histogram_t *histogram, double share) {
    if (histogram->count == 0u) {
        return 0;
    }
    const uint64_t rank = rank_of(histogram->count, share);
    uint64_t below = 0;
    for (uint32_t bin = 0; bin + 1u < REALTIME_BINS; bin++) {
        below += histogram->bins[bin];
        if (below >= rank) {
            const int64_t high_us = realtime_bin_low_us(bin + 1u) - 1;
            return high_us < histogram->max_us ? high_us : histogram->max_us;
        }
    }
    return histogram->max_us;
}

static void print_summary(const realtime_histogram_t *histogram, FILE *out) {
    fprintf(out, "late_us: count %llu, median %lld, p99 %lld, max %lld\n",
            (unsigned long long)histogram->count,
            (long long)realtime_histogram_quantile(histogram, 0.5),
            (long long)realtime_histogram_quantile(histogram, 0.99), (long long)histogram->max_us);
}

void realtime_histogram_print(const realtime_histogram_t *histogram, FILE *out) {
    print_summary(histogram, out);
    for (uint32_t bin = 0; bin < REALTIME_BINS; bin++) {
        if (histogram->bins[bin] != 0u) {
            fprintf(out, "%10lld us and more: %llu\n", (long long)realtime_bin_low_us(bin),
                    (unsigned long long)histogram->bins[bin]);
        }
    }
}

/* ---- Clock -------------------------------------------------------------------------------------
 */

/* Before the deadline, waiting for frames gives way to waiting for the exact time. */
#define EXACT_US 100

/* A descriptor that reports an error and has nothing to read is not asked again before. */
#define ERROR_PAUSE_US 1000

/* Later deadlines are waited for in pieces: the caller is told to expect early returns. */
#define WAIT_MAX_US (INT64_C(3600) * US_PER_S)

int64_t realtime_now_us(void) {
    struct timespec now;
    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * US_PER_S + now.tv_nsec / NS_PER_US;
}

static struct timespec timespec_of(int64_t us) {
    return (struct timespec){.tv_sec = (time_t)(us / US_PER_S),
                             .tv_nsec = (long)(us % US_PER_S) * NS_PER_US};
}

static void sleep_exactly(int64_t deadline_us) {
    const struct timespec deadline = timespec_of(deadline_us);
    (void)clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &deadline, NULL);
}

static int64_t sooner(int64_t a_us, int64_t b_us) {
    return a_us < b_us ? a_us : b_us;
}

/* True: something may be there to receive. */
static bool wait_readable(const realtime_t *timer, int64_t until_us, int64_t now_us) {
    struct pollfd item = {.fd = timer->wait.fd(timer->wait.context), .events = POLLIN};
    if (item.fd < 0 || until_us <= now_us) {
        return false;
    }
    const struct timespec rest = timespec_of(until_us - now_us);
    if (ppoll(&item, 1, &rest, NULL) <= 0) {
        return false;
    }
    if ((item.revents & POLLIN) == 0) {
        sleep_exactly(sooner(until_us, realtime_now_us() + ERROR_PAUSE_US));
    }
    return true;
}

static void note_past(realtime_t *timer, int64_t late_us) {
    timer->past++;
    if (late_us > timer->past_max_us) {
        timer->past_max_us = late_us;
    }
}

static void sleep_until_us(void *context, int64_t deadline_us) {
    realtime_t *timer = context;
    int64_t now_us = realtime_now_us();
    if (deadline_us <= now_us) {
        note_past(timer, deadline_us < 0 ? now_us : now_us - deadline_us);
        return;
    }
    const int64_t target_us = sooner(deadline_us, now_us + WAIT_MAX_US);
    if (timer->wait.fd != NULL && wait_readable(timer, target_us - EXACT_US, now_us)) {
        timer->early++;
        return;
    }
    sleep_exactly(target_us);
    now_us = realtime_now_us();
    if (now_us >= deadline_us) {
        realtime_histogram_add(&timer->late, now_us - deadline_us);
    }
}

static int64_t now_us_of(void *context) {
    (void)context;
    return realtime_now_us();
}

void realtime_init(realtime_t *timer, const realtime_wait_t *wait) {
    memset(timer, 0, sizeof *timer);
    if (wait != NULL) {
        timer->wait = *wait;
    }
}

berth_clock_t realtime_clock(realtime_t *timer) {
    static const berth_clock_api_t api = {now_us_of, sleep_until_us};
    return (berth_clock_t){&api, timer};
}

void realtime_print(const realtime_t *timer, FILE *out) {
    print_summary(&timer->late, out);
    fprintf(out, "waits cut short: %llu, deadlines already past: %llu, by at most %lld us\n",
            (unsigned long long)timer->early, (unsigned long long)timer->past,
            (long long)timer->past_max_us);
}

/* ---- Rights ------------------------------------------------------------------------------------
 */

static int ask_priority(int priority) {
    const struct sched_param parameters = {.sched_priority = priority};
    return sched_setscheduler(0, SCHED_FIFO, &parameters) == 0 ? 0 : errno;
}

realtime_rights_t realtime_ask(int priority, bool lock) {
    realtime_rights_t rights = {0};
    (void)prctl(PR_SET_TIMERSLACK, 1UL, 0UL, 0UL, 0UL);
    if (priority != 0) {
        rights.priority_errno = ask_priority(priority);
        rights.priority = rights.priority_errno == 0 ? priority : 0;
    }
    if (lock) {
        rights.locked_errno = mlockall(MCL_CURRENT | MCL_FUTURE) == 0 ? 0 : errno;
        rights.locked = rights.locked_errno == 0;
    }
    return rights;
}

void realtime_rights_print(const realtime_rights_t *rights, FILE *out) {
    if (rights->priority != 0) {
        fprintf(out, "scheduling: SCHED_FIFO, priority %d\n", rights->priority);
    } else if (rights->priority_errno != 0) {
        fprintf(out, "scheduling: SCHED_FIFO refused (%s)\n", strerror(rights->priority_errno));
    } else {
        fprintf(out, "scheduling: SCHED_FIFO not asked for\n");
    }
    if (rights->locked) {
        fprintf(out, "memory: locked\n");
    } else if (rights->locked_errno != 0) {
        fprintf(out, "memory: locking refused (%s)\n", strerror(rights->locked_errno));
    } else {
        fprintf(out, "memory: locking not asked for\n");
    }
}
