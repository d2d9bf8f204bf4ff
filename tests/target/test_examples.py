"""The example of every board: it drives its plan past the obstacle, in time, and says so."""

import re

import pytest

from target import BOARDS, BUILD
from test_images import KINDS, symbols
import emulate  # found by target

# One instruction in 32 ns: some 31 million a second, as a small microcontroller has them.
SHIFT = 5
FIGURES = re.compile(
    r"(?P<steps>\d+) control steps, late: (?P<late>\d+) running, (?P<arming>\d+) arming; "
    r"latest (?P<latest>\d+) us\n"
    r"stack (?P<used>\d+) of (?P<stack>\d+) bytes; board (?P<board>\d+) bytes; "
    r"plan (?P<samples>\d+) samples\n"
    r"clearance (?P<clearance>-?\d+) mm; odometry off by (?P<dx>-?\d+), (?P<dy>-?\d+) mm\n"
    r"done: (?P<x>-?\d+), (?P<y>-?\d+) mm from the end of the plan\n"
)


def example(board):
    return BUILD / "firmware" / "boards" / "example" / f"example-{board}.elf"


@pytest.mark.parametrize("board", BOARDS)
def test_drives_its_plan_to_the_end(board):
    assert emulate.excess(board, example(board)) == 0, "it fits into the board's RAM"
    status, text = emulate.run(board, example(board), icount=SHIFT, timeout=110)
    print(text)
    assert status == 0, text
    states, found = text.split("\n")[:4], FIGURES.search(text)
    assert states == ["arming", "running", "stopping", "idle"]
    assert found and found.end() == len(text), text
    value = {name: int(number) for name, number in found.groupdict().items()}
    assert value["samples"] == 400 and 400 < value["steps"] < 420
    assert value["late"] == 0 and value["arming"] <= 1 and value["latest"] < 50000
    assert 500 < value["used"] < min(value["stack"], 2048)
    assert value["board"] < 4096
    assert 50 < value["clearance"] < 300, "the obstacle was met, and passed"
    assert abs(value["x"]) < 30 and abs(value["y"]) < 30
    assert abs(value["dx"]) <= 2 and abs(value["dy"]) <= 2


@pytest.mark.parametrize("board", BOARDS)
def test_holds_only_what_it_needs(board):
    names = symbols(example(board))
    assert {"example_plan", "berth_board_step", "berth_link_run", "berth_drive_odrive"} <= names
    assert not {"berth_drive_vesc", "berth_drive_cia402"} & names, "other protocols"
    foreign = {kind: sorted(filter(rule.fullmatch, names)) for kind, rule in KINDS.items()}
    assert foreign == {kind: [] for kind in KINDS}
