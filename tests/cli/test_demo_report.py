"""The demo's report: each verdict follows from the figures that it is given."""

import copy
import csv
import json
import math
import subprocess
import sys

import pytest
from simulator import COLUMNS, MODES, ROOT

REPORT = ROOT / "tools" / "demo_report.py"
PERIOD = 0.05


def made_up_summary(**changes):
    return {"collisions": 0, "min_clearance_m": 0.1, "rms_position_error_m": 0.05,
            "peak_position_error_m": 0.3, "final_position_error_m": 0.0, "avoidance_time_s": 2.0,
            "mode_time_s": {mode: 1.0 for mode in MODES}, "recovery_time_s": 1.0,
            "control_effort": 3.0, "steps": 400, "stopped_time_s": 0.0, **changes}


def row(k, x, error, mode):
    values = dict.fromkeys(COLUMNS, 0.0)
    values.update(t=k * PERIOD, x=x, e1=error, mode=mode)
    return [values[name] for name in COLUMNS]


def made_up_log(path, obstacles_x, recovers=(True, True)):
    """Drives along x. Avoids within 0.3 m of each obstacle; the error is 0.2 m there and for
    1 s more, or for good."""
    rows, bad_until = [], -1.0
    with open(path, "w", newline="", encoding="ascii") as file:
        for k in range(400):
            t, x = k * PERIOD, 0.5 * k * PERIOD
            near = [i for i, o in enumerate(obstacles_x) if abs(o - x) < 0.3]
            if near:
                bad_until = t + 0.98 if recovers[near[0]] else math.inf
            error = 0.2 if t < bad_until else 0.001
            rows.append(row(k, x, error, "conservative_turn" if near else "track"))
        csv.writer(file).writerows([COLUMNS, *rows])


def scene(strategies, summaries):
    return {"name": "made up", "obstacles": [
        {"x_m": x, "y_m": 0.0, "hard_m": 0.1, "conservative_m": 0.2, "regulated_m": 0.4}
        for x in (3.0, 6.0)],
            "runs": [{"strategy": name, "log": f"{name}.csv", "summary": summary}
                     for name, summary in zip(strategies, summaries)]}


@pytest.fixture
def experiments(tmp_path):
    """Two made-up experiments that show all that they are to show."""
    for name in ("conservative", "normal", "combined", "adaptive"):
        made_up_log(tmp_path / f"{name}.csv", (3.0, 6.0))
    return {"folder": tmp_path,
            "circle": scene(("conservative", "normal"),
                            (made_up_summary(), made_up_summary(avoidance_time_s=4.0))),
            "eight": scene(("combined", "adaptive"), (made_up_summary(), made_up_summary()))}


def report(experiments):
    paths = []
    for name in ("circle", "eight"):
        path = experiments["folder"] / f"{name}_compare.json"
        path.write_text(json.dumps(experiments[name]))
        paths.append(path)
    result = subprocess.run([sys.executable, REPORT, *paths], capture_output=True, text=True,
                            check=False, timeout=60)
    assert (result.returncode, result.stderr) == (0, "")
    return result.stdout


def verdicts(text):
    lines = [line.strip() for line in text.splitlines()]
    return [line.split()[0] for line in lines if line.startswith(("yes ", "NO "))]


def test_all_is_shown(experiments):
    text = report(experiments)
    assert verdicts(text) == ["yes"] * 6
    assert "this project's own" in text


def change(experiments, name, run, **values):
    changed = copy.deepcopy(experiments)
    changed[name]["runs"][run]["summary"].update(values)
    return changed


@pytest.mark.parametrize("name, run, values, wrong, said", [
    ("circle", 0, {"collisions": 1, "min_clearance_m": -0.02}, 0, "1 collisions"),
    ("circle", 0, {"avoidance_time_s": 4.0}, 2, "4.00 s against 4.00 s"),
    ("circle", 0, {"avoidance_time_s": 9.5}, 2, "9.50 s against 4.00 s"),
    ("eight", 0, {"collisions": 2, "min_clearance_m": -0.1}, 3, "2 collisions"),
    ("eight", 0, {"stopped_time_s": 0.05}, 4, "stood for 0.05 s"),
    ("eight", 1, {"rms_position_error_m": None}, 5, "combined 0.0500 m"),
])
def test_what_is_not_shown_is_a_no(experiments, name, run, values, wrong, said):
    text = report(change(experiments, name, run, **values))
    assert verdicts(text) == ["NO" if i == wrong else "yes" for i in range(6)]
    assert said in text


@pytest.mark.parametrize("recovers, first, second", [
    ((True, False), "after 1.00 s", "not"),
    ((False, True), "not", "after 1.00 s"),
    ((False, False), "not", "not"),
])
def test_tracking_that_is_not_resumed_is_a_no(experiments, recovers, first, second):
    made_up_log(experiments["folder"] / "conservative.csv", (3.0, 6.0), recovers)
    text = report(experiments)
    assert verdicts(text) == ["yes", "NO", "yes", "yes", "yes", "yes"]
    assert f"obstacle 1: {first}, obstacle 2: {second}" in text


def test_no_obstacle_met_shows_nothing(experiments):
    made_up_log(experiments["folder"] / "conservative.csv", (99.0, 99.0))
    assert verdicts(report(experiments))[1] == "NO"


def test_the_table_has_the_strategies_side_by_side(experiments):
    text = report(change(experiments, "circle", 1, recovery_time_s=None, control_effort=12.34567))
    lines = text.splitlines()
    assert ["conservative", "normal"] in [line.split() for line in lines]
    assert next(line for line in lines if line.startswith("recovery")).split()[-2:] == ["1.00",
                                                                                        "never"]
    assert next(line for line in lines if line.startswith("control")).split()[-1] == "12.3457"


def test_bad_usage_is_2():
    result = subprocess.run([sys.executable, REPORT], capture_output=True, text=True, check=False,
                            timeout=60)
    assert result.returncode == 2 and "usage" in result.stderr
