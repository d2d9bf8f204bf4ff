# What all processors without an operating system share.
#
# One section a function, so that an image holds only what it calls. The folders of this machine are
# cut out of debugging information and __FILE__, so that the same sources give the same bytes
# wherever they lie.
set(CMAKE_TRY_COMPILE_TARGET_TYPE STATIC_LIBRARY)
set(CMAKE_C_FLAGS_INIT "${berth_cpu} -ffunction-sections -fdata-sections")
foreach(folder ${CMAKE_SOURCE_DIR} ${CMAKE_BINARY_DIR})
    file(REAL_PATH ${folder} real_folder)
    string(APPEND CMAKE_C_FLAGS_INIT
        " -ffile-prefix-map=${folder}=. -ffile-prefix-map=${real_folder}=.")
endforeach()
set(CMAKE_FIND_ROOT_PATH_MODE_PROGRAM NEVER)
set(CMAKE_FIND_ROOT_PATH_MODE_LIBRARY ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_INCLUDE ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_PACKAGE ONLY)
