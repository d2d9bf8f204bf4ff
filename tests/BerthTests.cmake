# How tests are registered.
#
# Every test runs with these in its environment:
#   BERTH_SOURCE_DIR, BERTH_BUILD_DIR   this tree and the build's folder
#   BERTH_SIM, BERTH_GEN, BERTH_BOARD, BERTH_ROBOT    the programs, when they are built
#   BERTH_CC                            the build's C compiler
#   BERTH_TEST_EFFORT                   full; short under sanitizers and for extra builds; or
#                                       a number n: the n-th part
set(BERTH_TEST_EFFORT full CACHE STRING "full, short or N (an N-th): fewer random runs in the tests")

set(berth_test_environment
    BERTH_SOURCE_DIR=${PROJECT_SOURCE_DIR}
    BERTH_BUILD_DIR=${PROJECT_BINARY_DIR}
    BERTH_CC=${CMAKE_C_COMPILER}
    BERTH_TEST_EFFORT=${BERTH_TEST_EFFORT})
foreach(program sim gen board robot)
    if(TARGET berth-${program})
        string(TOUPPER BERTH_${program} variable)
        list(APPEND berth_test_environment ${variable}=$<TARGET_FILE:berth-${program}>)
    endif()
endforeach()

# Tests on real CAN interfaces, label bus: also these, and BERTH_VCAN_BUSES interfaces vcan0, vcan1
# and so on, all up, which the test may take down or load as it likes. tools/test runs them where
# tools/vcan-shell provides that; elsewhere they fail.
#   BERTH_VCAN, BERTH_VCAN_BUSES        the first interface's name, and how many there are
set(BERTH_VCAN_BUSES 4)
set(berth_bus_environment BERTH_VCAN=vcan0 BERTH_VCAN_BUSES=${BERTH_VCAN_BUSES})

function(berth_add_unity_program name main)
    cmake_parse_arguments(PARSE_ARGV 2 arg "" "" "SOURCES;LIBS")
    add_executable(${name} ${main} ${arg_SOURCES})
    target_link_libraries(${name} PRIVATE ${arg_LIBS} unity)
    target_compile_definitions(${name} PRIVATE _GNU_SOURCE)
    berth_compile(${name})
endfunction()

# berth_add_test(NAME [SOURCES extra.c ...] LIBS lib ... [LABELS label ...] [TIMEOUT seconds])
# One Unity executable from NAME.c. Sources with a relative path lie beside this file.
function(berth_add_test name)
    cmake_parse_arguments(PARSE_ARGV 1 arg "" "TIMEOUT" "SOURCES;LIBS;LABELS")
    if(NOT arg_TIMEOUT)
        set(arg_TIMEOUT 120)
    endif()
    berth_add_unity_program(${name} ${name}.c SOURCES ${arg_SOURCES} LIBS ${arg_LIBS})
    add_test(NAME ${name} COMMAND ${name})
    set_tests_properties(${name} PROPERTIES
        LABELS "unit;${arg_LABELS}" TIMEOUT ${arg_TIMEOUT}
        ENVIRONMENT "${berth_test_environment}")
endfunction()

# berth_add_bus_test(NAME [SOURCES extra.c ...] LIBS lib ... [TIMEOUT seconds])
# One Unity executable from bus/NAME.c that needs real CAN interfaces.
function(berth_add_bus_test name)
    cmake_parse_arguments(PARSE_ARGV 1 arg "" "TIMEOUT" "SOURCES;LIBS")
    if(NOT arg_TIMEOUT)
        set(arg_TIMEOUT 120)
    endif()
    berth_add_unity_program(${name} bus/${name}.c SOURCES ${arg_SOURCES} LIBS ${arg_LIBS})
    add_test(NAME ${name} COMMAND ${name})
    set_tests_properties(${name} PROPERTIES
        LABELS bus TIMEOUT ${arg_TIMEOUT} RUN_SERIAL TRUE
        ENVIRONMENT "${berth_test_environment};${berth_bus_environment}")
endfunction()

# berth_add_pytest(NAME FILE.py [LABELS label ...] [TIMEOUT seconds])
# One pytest file, run with the tree's own Python environment.
function(berth_add_pytest name file)
    cmake_parse_arguments(PARSE_ARGV 2 arg "" "TIMEOUT" "LABELS")
    if(NOT arg_TIMEOUT)
        set(arg_TIMEOUT 300)
    endif()
    add_test(NAME ${name}
        COMMAND ${PROJECT_SOURCE_DIR}/.venv/bin/python -m pytest -q -p no:cacheprovider
            ${CMAKE_CURRENT_SOURCE_DIR}/${file})
    set_tests_properties(${name} PROPERTIES
        LABELS "pytest;${arg_LABELS}" TIMEOUT ${arg_TIMEOUT}
        ENVIRONMENT "${berth_test_environment};PYTHONDONTWRITEBYTECODE=1;MPLBACKEND=Agg")
endfunction()

# berth_add_bus_pytest(NAME FILE.py [TIMEOUT seconds])
# One pytest file that needs real CAN interfaces. No single test in it may take longer than TIMEOUT;
# tools/test runs all such files in one process.
function(berth_add_bus_pytest name file)
    cmake_parse_arguments(PARSE_ARGV 2 arg "" "TIMEOUT" "")
    if(NOT arg_TIMEOUT)
        set(arg_TIMEOUT 120)
    endif()
    berth_add_pytest(${name} ${file} TIMEOUT ${arg_TIMEOUT})
    set_tests_properties(${name} PROPERTIES LABELS bus RUN_SERIAL TRUE)
    set_property(TEST ${name} APPEND PROPERTY ENVIRONMENT ${berth_bus_environment})
endfunction()
