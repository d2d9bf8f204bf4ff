# Bare-metal Arm with gcc and newlib. Included by the file of a processor, which sets berth_cpu.
set(CMAKE_SYSTEM_NAME Generic)
set(CMAKE_SYSTEM_PROCESSOR arm)
set(CMAKE_C_COMPILER arm-none-eabi-gcc)
include(${CMAKE_CURRENT_LIST_DIR}/bare-metal.cmake)
