"""Different compilers, optimisation levels and word sizes must compute the same bits.

Compares the builds of the presets below, which tools/test makes before it runs this file.
"""

import os
import subprocess
from pathlib import Path

import pytest

BUILD = Path(os.environ["BERTH_SOURCE_DIR"]) / "build"
REFERENCE = "gcc-release"


def bits(preset):
    program = BUILD / preset / "tests" / "berth-bits"
    return subprocess.run([program], capture_output=True, text=True, check=True).stdout


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
def test_firmware_bits(preset):
    expected = bits(REFERENCE)
    assert bits(preset) == expected
    passes = int(expected.split("passes ")[1].split()[0], 16)
    assert passes & 2 and passes & ~6, "the constrained tracker must take few passes and many"
    modes = int(expected.split("modes ")[1].split()[0])
    assert modes & 1 and modes & ~1, "the run must both track and avoid"


@pytest.mark.parametrize("scenario", ["circle", "eight"])
@pytest.mark.parametrize("preset", ["clang-release", "gcc-debug", "clang-debug", "gcc-asan"])
def test_simulator_logs(preset, scenario, tmp_path):
    expected = log(REFERENCE, scenario, tmp_path)
    assert expected.count(b"\n") > 100
    assert log(preset, scenario, tmp_path) == expected
