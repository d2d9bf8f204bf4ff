# Plans that berth-gen writes during the build, linked into test_generated: every combination of
# shape, discretization and end.
set(generated_dir ${CMAKE_CURRENT_BINARY_DIR}/generated)
file(MAKE_DIRECTORY ${generated_dir})
foreach(shape circle eight)
    foreach(discretization euler zoh)
        foreach(end open closed)
            set(plan plan_${shape}_${discretization}_${end})
            add_custom_command(
                OUTPUT ${generated_dir}/${plan}.c ${generated_dir}/${plan}.h
                COMMAND berth-gen --format c --name ${plan} -o ${generated_dir}/${plan}.c
                    --discretization ${discretization} --${end} ${shape}
                DEPENDS berth-gen
                VERBATIM)
            target_sources(test_generated PRIVATE ${generated_dir}/${plan}.c)
        endforeach()
    endforeach()
endforeach()
target_include_directories(test_generated PRIVATE ${generated_dir})
