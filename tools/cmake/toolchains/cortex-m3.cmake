# Cortex-M3: ARMv7-M, float32 in software.
set(berth_cpu "-mcpu=cortex-m3 -mthumb")
include(${CMAKE_CURRENT_LIST_DIR}/arm-none-eabi.cmake)
