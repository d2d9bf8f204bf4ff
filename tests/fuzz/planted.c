/* One mistake at a time, put into a source of the product when it is compiled: the inputs of the
 * tree must show each, or what the targets check is worth nothing. PLANT_... says which one.
 */
#if defined(PLANT_NO_STOP) /* a fault does not stop the drives */
#include "berth/board.h"
#define berth_drive_stop(drive, outbox) ((void)(drive), (void)(outbox))
#include "../../firmware/src/board.c"

#elif defined(PLANT_NO_CLEAR) /* what waited to be sent follows the stop */
#include "berth/board.h"
#define berth_outbox_clear(outbox) ((void)(outbox))
#include "../../firmware/src/board.c"

#elif defined(PLANT_NO_RANGE) /* any bits are a speed */
#include "../../firmware/src/check.h"
#define check_range(value, minimum, maximum) ((void)(value), (void)(minimum), (void)(maximum), true)
#include "../../firmware/src/drive_odrive.c"

#elif defined(PLANT_NO_COUNT) /* nothing is counted */
#include "../../firmware/src/count.h"
#define count(counter) ((counter) == NULL ? (count)(counter) : (void)0)
#include "../../firmware/src/board.c"

#elif defined(PLANT_NO_WATCHDOG) /* the drives' timers do not run */
#include "berth/board.h"
#define berth_drive_step(drive, now_us, outbox) ((void)(drive), (void)(now_us), (void)(outbox))
#include "../../firmware/src/board.c"

#elif defined(PLANT_NO_LIMITS) /* commands are as the tracker wants them */
#include "berth/limits.h"
#define berth_limits_apply(limits, config, period_s, keep_omega, command)                          \
    ((void)(limits), (void)(config), (void)(period_s), (void)(keep_omega), (void)(command),        \
     (uint8_t)0)
#include "../../firmware/src/controller.c"

#elif defined(PLANT_NO_AVOIDANCE) /* obstacles do not matter */
#include "berth/avoid.h"
#define berth_avoid_step(avoid, obstacles, plan, reference, pose, command)                         \
    ((void)(avoid), (void)(obstacles), (void)(plan), (void)(reference), (void)(pose),              \
     (void)(command), BERTH_MODE_TRACK)
#include "../../firmware/src/controller.c"

#else
#error "no mistake was chosen"
#endif
