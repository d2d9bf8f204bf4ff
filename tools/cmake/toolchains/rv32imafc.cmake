# RISC-V, 32 bits, with a float32 unit: gcc and picolibc.
set(CMAKE_SYSTEM_NAME Generic)
set(CMAKE_SYSTEM_PROCESSOR riscv32)
set(CMAKE_C_COMPILER riscv64-unknown-elf-gcc)
set(berth_cpu "--specs=picolibc.specs -march=rv32imafc -mabi=ilp32f -mcmodel=medany -msmall-data-limit=0")
include(${CMAKE_CURRENT_LIST_DIR}/bare-metal.cmake)
