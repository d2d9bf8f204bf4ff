/* Private to firmware/src. */
#ifndef BERTH_SRC_SMALL_H
#define BERTH_SRC_SMALL_H

/* Keeps a function that is called from several places one piece of code: off the hot path, flash is
 * worth more than the call. */
#if defined(__GNUC__)
#define SMALL __attribute__((noinline))
#else
#define SMALL
#endif

#endif
