"""Different compilers, optimisation levels, word sizes and processors must compute the same bits.

Compares the builds of the presets below, which tools/test makes before it runs this file. Those of
other processors run in emulation.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(os.environ["BERTH_SOURCE_DIR"])
BUILD = ROOT / "build"
REFERENCE = "gcc-release"
TARGETS = {
    "cortex-m0plus": ("microbit", "mps2-an385"),
    "cortex-m3": ("mps2-an385",),
    "cortex-m4f": ("mps2-an386",),
    "cortex-m4f-clang": ("mps2-an386",),
    "cortex-m7": ("mps2-an500",),
    "cortex-m33": ("mps2-an505",),
    "rv32imafc": ("virt",),
}
MODES = {"track", "regulated", "conservative_turn", "conservative_go", "blocked"}

sys.path.insert(0, str(ROOT / "tools" / "lib"))
import emulate


def bits(preset):
    program = BUILD / preset / "tests" / "berth-bits"
    return subprocess.run([program], capture_output=True, text=True, check=True).stdout


@pytest.fixture(scope="module")
def expected():
    return bits(REFERENCE)


def log(preset, scenario, folder):
    program = BUILD / preset / "host_sim" / "berth-sim"
    path = folder / f"{preset}-{scenario}.csv"
    noise = ["--set", "plant.pose_noise_m=0.003", "--set", "plant.tau_s=0.01"]
    subprocess.run(
        [program, "run", scenario, "--seed", "7", "--log", path, *noise],
        capture_output=True,
        timeout=60,
    )
    return path.read_bytes()


@pytest.mark.parametrize(
    "preset",
    ["clang-release", "gcc-debug", "clang-debug", "gcc-32", "gcc-asan", "clang-asan"],
)
def test_firmware_bits(preset, expected):
    assert bits(preset) == expected


@pytest.mark.parametrize("library", ["O2", "Os"])
@pytest.mark.parametrize(
    "preset, board", [(preset, board) for preset, boards in TARGETS.items() for board in boards]
)
def test_target_bits(preset, board, library, expected):
    image = BUILD / preset / "tests" / "target" / f"{board}-bits-{library}.elf"
    status, text = emulate.run(board, image)
    assert status == 0, text
    assert text == expected


def test_every_mode_and_every_part_was_met(expected):
    steps = re.findall(r"(\w+)=(\d+)", expected)
    assert {mode for mode, _ in steps} == MODES
    assert sum(int(count) for _, count in steps) >= 10000
    assert min(int(count) for _, count in steps) >= 100
    assert len(re.findall(r"^\w+ [0-9a-f]{16}$", expected, re.MULTILINE)) == 13
    passes = int(re.search(r"^passes (\w+)$", expected, re.MULTILINE).group(1), 16)
    assert passes & 2 and passes & ~6, "the constrained tracker takes few passes and many"
    assert all(int(count) > 10 for count in re.findall(r"^enabled (\d+)$", expected, re.MULTILINE))


@pytest.mark.parametrize("scenario", ["circle", "eight"])
@pytest.mark.parametrize("preset", ["clang-release", "gcc-debug", "clang-debug", "gcc-asan"])
def test_simulator_logs(preset, scenario, tmp_path):
    expected = log(REFERENCE, scenario, tmp_path)
    assert expected.count(b"\n") > 100
    assert log(preset, scenario, tmp_path) == expected
