# How every C file of this tree is compiled.
#
# -ffp-contract=off: a fused multiply-add rounds once where * and + round twice. Without it every
# target computes the same bits from the same inputs. The libraries carry the flag themselves, so
# that they keep the promise in whatever project they are built.
set(berth_exact_float -ffp-contract=off)

add_library(berth_warnings INTERFACE)
target_compile_options(berth_warnings INTERFACE
    -Wall -Wextra -Wpedantic -Wconversion -Wshadow -Wdouble-promotion -Wfloat-conversion
    -Wstrict-prototypes -Wmissing-prototypes -Wvla $<$<BOOL:${BERTH_WERROR}>:-Werror>)

# The rules for one target: C11 without extensions, exact floating point, warnings. None of it
# reaches those who link the target.
function(berth_compile target)
    set_target_properties(${target} PROPERTIES
        C_STANDARD 11 C_STANDARD_REQUIRED ON C_EXTENSIONS OFF)
    target_compile_options(${target} PRIVATE ${berth_exact_float})
    target_link_libraries(${target} PRIVATE $<BUILD_INTERFACE:berth_warnings>)
endfunction()
