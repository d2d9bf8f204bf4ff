# Plans that berth-gen writes during a build, when it is for another machine than this one.
include(ExternalProject)

set(BERTH_GEN "" CACHE FILEPATH "berth-gen of this machine; empty: it is built for it")

# berth_add_plan(SYMBOL BASE ARGUMENTS...): BASE.c and BASE.h, with the plan SYMBOL; the arguments
# are berth-gen's.
function(berth_add_plan symbol base)
    if(BERTH_GEN)
        set(program ${BERTH_GEN})
        set(builder ${BERTH_GEN})
    else()
        set(folder ${PROJECT_BINARY_DIR}/this-machine)
        set(program ${folder}/tools/berth-gen)
        set(builder berth_gen_of_this_machine)
        if(NOT TARGET ${builder})
            ExternalProject_Add(${builder}
                SOURCE_DIR ${PROJECT_SOURCE_DIR}
                BINARY_DIR ${folder}
                CMAKE_ARGS -DCMAKE_BUILD_TYPE=Release -DBERTH_BUILD_TESTS=OFF -DBERTH_INSTALL=OFF
                BUILD_COMMAND ${CMAKE_COMMAND} --build <BINARY_DIR> --target berth-gen
                BUILD_ALWAYS ON
                BUILD_BYPRODUCTS ${program}
                INSTALL_COMMAND "")
        endif()
    endif()
    add_custom_command(OUTPUT ${base}.c ${base}.h
        COMMAND ${program} --format c --name ${symbol} -o ${base}.c ${ARGN}
        DEPENDS ${builder} ${program}
        VERBATIM)
endfunction()
