"""Stack of each firmware function: known when it is compiled, and small."""

import pytest

from tree import FIRMWARE, files, name, run

# Bytes of one function's frame on a 64-bit host at -O2; microcontrollers need less.
FRAME_MAX = 640


def frames(source, folder):
    run(
        *("gcc", "-std=c11", "-O2", "-ffp-contract=off", "-fno-math-errno", "-fstack-usage"),
        *("-I", FIRMWARE / "include", "-I", FIRMWARE.parent / "hal" / "include"),
        *("-c", source, "-o", folder / "object.o"),
    )
    rows = (folder / "object.su").read_text().splitlines()
    return [row.split("\t") for row in rows]


@pytest.mark.parametrize("source", files(".c", under=FIRMWARE / "src"), ids=name)
def test_frames_are_static_and_small(source, tmp_path):
    rows = frames(source, tmp_path)
    assert rows, "every source has a function"
    assert [row for row in rows if row[2] != "static" or int(row[1]) > FRAME_MAX] == []
