# How tests are registered.
#
# Every test runs with these in its environment:
#   BERTH_SOURCE_DIR, BERTH_BUILD_DIR   this tree and the build's folder
#   BERTH_SIM, BERTH_GEN                the programs, when they are built
#   BERTH_CC                            the build's C compiler
#   BERTH_TEST_EFFORT                   full; short under sanitizers and for extra builds
set(BERTH_TEST_EFFORT full CACHE STRING "full, or short: fewer random runs in the tests")
set_property(CACHE BERTH_TEST_EFFORT PROPERTY STRINGS full short)

set(berth_test_environment
    BERTH_SOURCE_DIR=${PROJECT_SOURCE_DIR}
    BERTH_BUILD_DIR=${PROJECT_BINARY_DIR}
    BERTH_CC=${CMAKE_C_COMPILER}
    BERTH_TEST_EFFORT=${BERTH_TEST_EFFORT})
if(TARGET berth-sim)
    list(APPEND berth_test_environment BERTH_SIM=$<TARGET_FILE:berth-sim>)
endif()
if(TARGET berth-gen)
    list(APPEND berth_test_environment BERTH_GEN=$<TARGET_FILE:berth-gen>)
endif()

# berth_add_test(NAME [SOURCES extra.c ...] LIBS lib ... [LABELS label ...] [TIMEOUT seconds])
# One Unity executable from NAME.c. Sources with a relative path lie beside this file.
function(berth_add_test name)
    cmake_parse_arguments(PARSE_ARGV 1 arg "" "TIMEOUT" "SOURCES;LIBS;LABELS")
    if(NOT arg_TIMEOUT)
        set(arg_TIMEOUT 120)
    endif()
    add_executable(${name} ${name}.c ${arg_SOURCES})
    target_link_libraries(${name} PRIVATE ${arg_LIBS} unity)
    target_compile_definitions(${name} PRIVATE _GNU_SOURCE)
    berth_compile(${name})
    add_test(NAME ${name} COMMAND ${name})
    set_tests_properties(${name} PROPERTIES
        LABELS "unit;${arg_LABELS}" TIMEOUT ${arg_TIMEOUT}
        ENVIRONMENT "${berth_test_environment}")
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
