# Cortex-M0+ (and M0): ARMv6-M, float32 in software.
set(berth_cpu "-mcpu=cortex-m0plus -mthumb")
include(${CMAKE_CURRENT_LIST_DIR}/arm-none-eabi.cmake)
