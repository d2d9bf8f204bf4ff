/* Numbers in frames: little and big endian, without casts of pointers. Private to firmware/src. */
#ifndef BERTH_SRC_BYTES_H
#define BERTH_SRC_BYTES_H

#include <stdint.h>

/* MISRA D12 in this file. */

static inline void put_u16_le(uint8_t *data, uint16_t value) {
    data[0] = (uint8_t)value;
    data[1] = (uint8_t)(value >> 8);
}

static inline void put_u24_le(uint8_t *data, uint32_t value) {
    put_u16_le(data, (uint16_t)value);
    data[2] = (uint8_t)(value >> 16);
}

static inline void put_u32_le(uint8_t *data, uint32_t value) {
    put_u16_le(data, (uint16_t)value);
    put_u16_le(&data[2], (uint16_t)(value >> 16));
}

static inline void put_u32_be(uint8_t *data, uint32_t value) {
    data[0] = (uint8_t)(value >> 24);
    data[1] = (uint8_t)(value >> 16);
    data[2] = (uint8_t)(value >> 8);
    data[3] = (uint8_t)value;
}

static inline uint16_t get_u16_le(const uint8_t *data) {
    return (uint16_t)(data[0] | ((uint32_t)data[1] << 8));
}

static inline uint32_t get_u24_le(const uint8_t *data) {
    return get_u16_le(data) | ((uint32_t)data[2] << 16);
}

static inline uint32_t get_u32_le(const uint8_t *data) {
    return get_u16_le(data) | ((uint32_t)get_u16_le(&data[2]) << 16);
}

static inline uint16_t get_u16_be(const uint8_t *data) {
    return (uint16_t)(((uint32_t)data[0] << 8) | data[1]);
}

static inline uint32_t get_u32_be(const uint8_t *data) {
    return ((uint32_t)get_u16_be(data) << 16) | get_u16_be(&data[2]);
}

/* Two's complement without a conversion that the language leaves to the compiler. */
static inline int32_t signed_u32(uint32_t value) {
    /* MISRA D10 */
    return value <= (uint32_t)INT32_MAX ? (int32_t)value : -(int32_t)(UINT32_MAX - value) - 1;
}

static inline int32_t signed_u24(uint32_t value) {
    const uint32_t raised = value ^ 0x800000u;
    return (int32_t)raised - 0x800000;
}

static inline int16_t signed_u16(uint16_t value) {
    const uint32_t raised = (uint32_t)value ^ 0x8000u;
    return (int16_t)((int32_t)raised - 0x8000);
}

/* A float32 travels as its IEEE 754 bits. */
static inline float float_from_bits(uint32_t bits) {
    union {
        uint32_t bits;
        float value;
    } word = {bits};
    return word.value;
}

static inline uint32_t bits_from_float(float value) {
    union {
        float value;
        uint32_t bits;
    } word = {value};
    return word.bits;
}

#endif
