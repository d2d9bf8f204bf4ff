/* berth/berth.h - everything. Start at controller.h. */
#ifndef BERTH_BERTH_H
#define BERTH_BERTH_H

#include "berth/angle.h"
#include "berth/avoid.h"
#include "berth/controller.h"
#include "berth/error.h"
#include "berth/limits.h"
#include "berth/obstacles.h"
#include "berth/reference.h"
#include "berth/result.h"
#include "berth/riccati.h"
#include "berth/tracker.h"
#include "berth/types.h"

#endif
