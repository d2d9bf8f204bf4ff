/* berth/berth.h - everything. Start at controller.h for the control loop alone, at board.h for the
 * whole of a drive board.
 *
 * The code keeps to MISRA C:2012 but for numbered deviations, each explained and counted in
 * tools/rules/deviations.md of the source tree. MISRA D1, D2, D3, D4, D5, D6, D7, D8, T7 hold
 * everywhere; where others do, a comment says so. */
#ifndef BERTH_BERTH_H
#define BERTH_BERTH_H

#include "berth/angle.h"
#include "berth/avoid.h"
#include "berth/board.h"
#include "berth/constrained.h"
#include "berth/controller.h"
#include "berth/digest.h"
#include "berth/drive.h"
#include "berth/error.h"
#include "berth/limits.h"
#include "berth/link.h"
#include "berth/message.h"
#include "berth/obstacles.h"
#include "berth/odometry.h"
#include "berth/outbox.h"
#include "berth/reference.h"
#include "berth/result.h"
#include "berth/riccati.h"
#include "berth/supervisor.h"
#include "berth/tracker.h"
#include "berth/types.h"

#endif
