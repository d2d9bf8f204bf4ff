/* A form of fabsf through which the analyser sees what a test of the result tells of the argument.
 * That -0 stays -0 makes no difference to what the proofs are about. */
#ifndef BERTH_TESTS_PROOF_FABS_H
#define BERTH_TESTS_PROOF_FABS_H

#include <math.h>

#define fabsf(x) ((x) < 0.0f ? -(x) : (x))

#endif
