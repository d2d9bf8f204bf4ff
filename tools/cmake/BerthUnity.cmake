# Unity, from the first of: UNITY_SOURCE_DIR; what tools/fetch-unity fetched; upstream.
set(UNITY_SOURCE_DIR "" CACHE PATH "Folder of a Unity checkout (holds unity.c or src/unity.c)")

set(unity_folder ${UNITY_SOURCE_DIR})
if(NOT unity_folder AND EXISTS ${PROJECT_SOURCE_DIR}/.cache/unity/unity.c)
    set(unity_folder ${PROJECT_SOURCE_DIR}/.cache/unity)
endif()
if(NOT unity_folder)
    include(FetchContent)
    # Only the two files are wanted, not upstream's targets: SOURCE_SUBDIR names a folder without a
    # CMakeLists.txt.
    FetchContent_Declare(unity
        GIT_REPOSITORY https://github.com/ThrowTheSwitch/Unity.git
        GIT_TAG v2.6.0
        GIT_SHALLOW ON
        SOURCE_SUBDIR src)
    FetchContent_MakeAvailable(unity)
    set(unity_folder ${unity_SOURCE_DIR})
endif()
if(EXISTS ${unity_folder}/src/unity.c)
    string(APPEND unity_folder /src)
endif()
if(NOT EXISTS ${unity_folder}/unity.c)
    message(FATAL_ERROR "no unity.c in ${unity_folder}: run tools/fetch-unity, or set UNITY_SOURCE_DIR")
endif()

add_library(unity STATIC ${unity_folder}/unity.c)
target_include_directories(unity SYSTEM PUBLIC ${unity_folder})
target_compile_definitions(unity PUBLIC UNITY_INCLUDE_DOUBLE UNITY_SUPPORT_64)
