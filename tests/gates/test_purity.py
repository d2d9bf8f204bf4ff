"""What the compiled firmware needs from outside, holds in RAM and computes with."""

import platform
import re

import pytest

from tree import BUILD, run

LIBRARY = BUILD / "firmware" / "libberth.a"

# sqrtf and fabsf are the contract's; the others are calls that a compiler makes of its own accord
# for copies and comparisons of structs, and every freestanding toolchain has them.
ALLOWED = {"sqrtf", "fabsf", "memcpy", "memset", "memmove", "memcmp"}

# Scalar and packed arithmetic on double, and conversions to it.
DOUBLE = re.compile(
    r"\t(v?(?:add|sub|mul|div|sqrt|min|max|u?comi)[sp]d|v?cvts[is]2sd|v?cvt\w+2pd|fld[lt]?|fstp?[lt]?)\s"
)


def undefined_symbols():
    defined, undefined = set(), set()
    for line in run("nm", LIBRARY).splitlines():
        fields = line.split()
        if len(fields) == 2 and fields[0] == "U":
            undefined.add(fields[1])
        elif len(fields) == 3:
            defined.add(fields[2])
    assert "berth_controller_step" in defined
    return undefined - defined


def test_nothing_is_called_but_square_root_and_copies():
    assert undefined_symbols() - ALLOWED == set()


def test_no_writable_data():
    """All state is the caller's: no object has bytes in .data or .bss. Tables of pointers are in
    .data.rel.ro in position-independent code, and in .rodata on a microcontroller."""
    writable = re.compile(r"^(\.t?(?:data|bss)(?!\.rel\.ro)\S*)\s+(\d+)", re.MULTILINE)
    sections = writable.findall(run("size", "-A", LIBRARY))
    assert len(sections) > 10
    assert [section for section in sections if section[1] != "0"] == []


@pytest.mark.skipif(platform.machine() != "x86_64", reason="knows x86-64 instructions only")
def test_no_double_arithmetic():
    listing = run("objdump", "--disassemble", "--no-show-raw-insn", LIBRARY)
    assert re.search(r"\tv?mulss\s", listing), "float arithmetic is there to be seen"
    assert sorted(set(DOUBLE.findall(listing))) == []
