/* Smaller and larger of two numbers. Private to firmware/src. */
#ifndef BERTH_SRC_SCALAR_H
#define BERTH_SRC_SCALAR_H

static inline float minimum(float a, float b) {
    return a < b ? a : b;
}

static inline float maximum(float a, float b) {
    return a > b ? a : b;
}

#endif
