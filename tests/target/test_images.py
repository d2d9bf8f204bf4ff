"""What gets into an image with everything of the firmware, and what does not."""

import re

import pytest

from target import BOARDS, BUILD, image, run, tool

# Double precision in software: Arm's names, and gcc's.
SOFT_DOUBLE = re.compile(
    r"__aeabi_(c?d[a-z]\w*|[a-z]+2d|d2\w+)"
    r"|__(add|sub|mul|div|neg|eq|ne|lt|le|gt|ge|cmp|unord|fix\w*|float\w*|extend\w*|trunc\w*|pow\w*)"
    r"df\w*|__truncdf\w+|__extend\w+df2"
)
HEAP = re.compile(r"_?(malloc|calloc|realloc|free|sbrk)(_r)?")
STREAMS = re.compile(r"_?(v?(f|s|sn|as|d)?i?printf|f?puts|f?putc|putchar|fwrite|fflush)(_r)?")
TRANSCENDENTAL = re.compile(
    r"(__ieee754_)?(a?(sin|cos|tan)h?|atan2|exp[2m]?1?|log(10|2|1p|b)?|pow|hypot|cbrt|fmod"
    r"|remainder)[fl]?"
)
KINDS = {
    "soft double": SOFT_DOUBLE,
    "heap": HEAP,
    "streams": STREAMS,
    "transcendental": TRANSCENDENTAL,
}


def symbols(elf):
    return {line.split()[-1] for line in run(tool("nm"), elf).splitlines()}


@pytest.mark.parametrize("library", ["O2", "Os"])
@pytest.mark.parametrize("board", BOARDS)
def test_nothing_foreign_is_linked(board, library):
    names = symbols(image(board, f"whole-{library}"))
    assert {"berth_controller_step", "berth_board_step", "slcan_init"} <= names
    assert len([name for name in names if name.startswith("berth_")]) > 60
    foreign = {kind: sorted(filter(rule.fullmatch, names)) for kind, rule in KINDS.items()}
    assert foreign == {kind: [] for kind in KINDS}


def test_the_gate_sees_what_an_image_has():
    assert any(map(STREAMS.fullmatch, symbols(image(BOARDS[0], "bits-O2"))))


def test_the_gate_knows_the_names():
    for name in ("__aeabi_dadd", "__aeabi_f2d", "__aeabi_cdcmple", "__adddf3", "__extendsfdf2",
                 "__fixdfsi", "__floatsidf", "__truncdfsf2", "__aeabi_d2iz", "__ltdf2"):
        assert SOFT_DOUBLE.fullmatch(name), name
    for name in ("__aeabi_fadd", "__addsf3", "__aeabi_uldivmod", "__aeabi_f2iz", "__divdi3"):
        assert not SOFT_DOUBLE.fullmatch(name), name
    for name in ("sinf", "atan2f", "__ieee754_atan2f", "pow", "exp", "log10f", "fmodf"):
        assert TRANSCENDENTAL.fullmatch(name), name
    assert not TRANSCENDENTAL.fullmatch("sqrtf")


@pytest.mark.parametrize("library", ["firmware/libberth.a", "tests/target/libberth_Os.a",
                                     "hal/libhal_slcan.a", "hal/libhal_blank.a"])
def test_libraries_have_no_writable_data(library):
    listing = run(tool("size"), "-A", BUILD / library)
    assert ".text" in listing
    sections = re.findall(r"^(\.s?(?:data|bss)\S*)\s+(\d+)", listing, re.MULTILINE)
    assert [section for section in sections if section[1] != "0"] == []
