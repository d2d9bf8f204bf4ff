# Install rules: the library with its headers, for find_package and for pkg-config, and the
# programs when they were built.
include(CMakePackageConfigHelpers)

install(TARGETS berth berth_hal EXPORT berth ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR})
install(DIRECTORY firmware/include/berth hal/include/berth_hal DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}
    FILES_MATCHING PATTERN "*.h")
install(FILES LICENSE DESTINATION ${CMAKE_INSTALL_DATADIR}/licenses/berth)
foreach(program berth-sim berth-gen berth-board berth-robot)
    if(TARGET ${program})
        install(TARGETS ${program} RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR})
    endif()
endforeach()

set(config_folder ${CMAKE_INSTALL_LIBDIR}/cmake/berth)
install(EXPORT berth NAMESPACE berth:: FILE berthTargets.cmake DESTINATION ${config_folder})
configure_package_config_file(tools/cmake/berthConfig.cmake.in
    ${PROJECT_BINARY_DIR}/berthConfig.cmake
    INSTALL_DESTINATION ${config_folder} NO_SET_AND_CHECK_MACRO)
# Before 1.0 the interface may change with every minor version.
write_basic_package_version_file(${PROJECT_BINARY_DIR}/berthConfigVersion.cmake
    COMPATIBILITY SameMinorVersion)
install(FILES ${PROJECT_BINARY_DIR}/berthConfig.cmake
    ${PROJECT_BINARY_DIR}/berthConfigVersion.cmake
    DESTINATION ${config_folder})

# The prefix is written relative to where the .pc file lies, so that the package can be moved.
set(pc_folder ${CMAKE_INSTALL_LIBDIR}/pkgconfig)
file(RELATIVE_PATH pc_to_prefix ${CMAKE_INSTALL_FULL_LIBDIR}/pkgconfig ${CMAKE_INSTALL_PREFIX})
configure_file(tools/cmake/berth.pc.in ${PROJECT_BINARY_DIR}/berth.pc @ONLY)
install(FILES ${PROJECT_BINARY_DIR}/berth.pc DESTINATION ${pc_folder})
