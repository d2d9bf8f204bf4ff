"""Mistakes put into the product on purpose are shown by the fuzz targets' inputs (planted.c)."""

import os
import subprocess
from pathlib import Path

import pytest

BUILD = Path(os.environ["BERTH_BUILD_DIR"]) / "tests" / "fuzz"
INPUTS = Path(os.environ["BERTH_SOURCE_DIR"]) / "tests" / "fuzz"

# Mistake, target, and what must be said not to hold.
PLANTS = (
    ("no_stop", "board_odrive", {"no drive is enabled in a fault"}),
    ("no_clear", "board_odrive", {"no torque is asked for after a fault", "no older status follows a fault"}),
    ("no_range", "board_odrive", {"all numbers are finite", "a commanded speed is finite"}),
    ("no_count", "board_vesc", {"received, malformed and foreign add up to the frames given",
                                "steps and missed ones add up to the time"}),
    ("no_watchdog", "board_vesc", {"drives under torque are heard of in time", "the next deadline is ahead"}),
    ("no_limits", "controller", {"a command is within the robot's limits"}),
    ("no_avoidance", "controller", {"a robot that does what it is told stays clear"}),
)


def replay(program, target):
    return subprocess.run([BUILD / f"replay_{program}", INPUTS / "corpus" / target, INPUTS / "regressions" / target],
                          capture_output=True, text=True, errors="replace")


@pytest.mark.parametrize("plant, target, claims", PLANTS, ids=[plant[0] for plant in PLANTS])
def test_mistake_is_shown(plant, target, claims):
    done = replay(f"planted_{plant}", target)
    assert done.returncode != 0
    said = [line.partition("does not hold: ")[2] for line in done.stderr.splitlines() if "does not hold: " in line]
    assert set(said) & claims or "runtime error: " in done.stderr, done.stderr[-2000:]


def test_every_mistake_is_tried():
    source = (INPUTS / "planted.c").read_text()
    assert {f"PLANT_{plant.upper()}" for plant, _, _ in PLANTS} == {
        word.rstrip(")") for line in source.splitlines() if "defined(" in line
        for word in line.replace("defined(", " ").split() if word.startswith("PLANT_")}
