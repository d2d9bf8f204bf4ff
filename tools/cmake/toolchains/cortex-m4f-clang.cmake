# Cortex-M4F with clang. The C library and the linker are gcc's, which chooses the library's variant.
set(CMAKE_SYSTEM_NAME Generic)
set(CMAKE_SYSTEM_PROCESSOR arm)
set(CMAKE_C_COMPILER clang-19)
set(CMAKE_C_COMPILER_TARGET thumbv7em-none-eabihf)

set(berth_link_cpu "-mcpu=cortex-m4 -mthumb -mfpu=fpv4-sp-d16 -mfloat-abi=hard")
execute_process(
    COMMAND arm-none-eabi-gcc -print-file-name=libc.a
    OUTPUT_VARIABLE libc OUTPUT_STRIP_TRAILING_WHITESPACE COMMAND_ERROR_IS_FATAL ANY)
get_filename_component(berth_libc_folder ${libc} DIRECTORY)
get_filename_component(berth_libc_headers ${berth_libc_folder}/../include REALPATH)

# Enums as short as in gcc's libraries.
set(berth_cpu "-mcpu=cortex-m4 -mthumb -mfpu=fpv4-sp-d16 -mfloat-abi=hard -fshort-enums -isystem ${berth_libc_headers}")
set(CMAKE_C_LINK_EXECUTABLE
    "arm-none-eabi-gcc ${berth_link_cpu} <CMAKE_C_LINK_FLAGS> <LINK_FLAGS> <OBJECTS> -o <TARGET> <LINK_LIBRARIES>")
include(${CMAKE_CURRENT_LIST_DIR}/bare-metal.cmake)
