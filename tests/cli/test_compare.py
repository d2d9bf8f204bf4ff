"""berth-sim compare: the same scenario under several strategies."""

import json
import os

import pytest
from simulator import STRATEGIES, SUMMARY_KEYS, sim, summary


def test_each_strategy_gets_what_run_gives_it():
    result = summary("compare", "eight", "--strategies", "combined,adaptive", "--seed", "5",
                     "--set", "plant.pose_noise_m=0.001")
    assert list(result) == ["scenario", "seed", "strategies"]
    assert (result["scenario"], result["seed"]) == ("eight", 5)
    assert list(result["strategies"]) == ["combined", "adaptive"]
    for strategy, one in result["strategies"].items():
        alone = summary("run", "eight", "--strategy", strategy, "--seed", "5",
                        "--set", "plant.pose_noise_m=0.001")
        assert list(one) == SUMMARY_KEYS + ["stopped_time_s"]
        for key in SUMMARY_KEYS:
            assert key == "wall_s" or one[key] == alone[key]


def test_stopped_time_is_what_the_log_shows(tmp_path):
    from simulator import columns
    one = summary("compare", "circle", "--strategies", "conservative")["strategies"]["conservative"]
    summary("run", "circle", "--strategy", "conservative", "--log", tmp_path / "log.csv")
    log = columns(tmp_path / "log.csv")
    standing = sum(abs(v) < 1e-3 <= abs(vr) for v, vr in zip(log["v_cmd"], log["v_r"]))
    assert standing > 0
    assert one["stopped_time_s"] == pytest.approx(0.05 * standing)


def test_all_strategies_side_by_side():
    result = sim("compare", "circle", "--strategies", ",".join(STRATEGIES))
    assert (result.returncode, result.stderr) == (1, "")  # two of them do not avoid
    lines = result.stdout.splitlines()
    assert lines[2].split() == STRATEGIES
    collisions = next(line for line in lines if line.startswith("collisions"))
    assert collisions.split()[1:] == ["3", "0", "0", "0", "0", "3", "0"]
    assert len({len(line) for line in lines[2:]}) == 1  # columns line up


def test_any_collision_is_1_and_none_is_0():
    assert sim("compare", "circle", "--strategies", "combined,none").returncode == 1
    assert sim("compare", "circle", "--strategies", "combined,conservative").returncode == 0


@pytest.mark.parametrize("arguments, fragments", [
    (("circle",), ["--strategies is missing"]),
    ((), ["SCENARIO is missing"]),
    (("circle", "--strategies", "combined,luck"), ["'luck'", *STRATEGIES]),
    (("circle", "--strategies", "combined,,none"), ["''", "combined"]),
    (("circle", "--strategies", ""), ["''", "combined"]),
    (("circle", "--strategies", "combined,combined"), ["'combined'", "twice"]),
    (("circel", "--strategies", "combined"), ["'circel'", "circle, eight or a YAML file"]),
    (("circle", "--strategies", "combined", "--log", "x"), ["--log"]),
    (("circle", "--strategies", "combined", "--seed", "x"), ["--seed", "'x'"]),
    (("circle", "--strategies", "combined", "--set", "a=1"), ["--set", "a"]),
], ids=str)
def test_bad_usage_is_2_and_says_what_and_what_is_allowed(tmp_path, arguments, fragments):
    result = sim("compare", *arguments, cwd=tmp_path)
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr.startswith("berth-sim compare: ")
    for fragment in fragments:
        assert fragment in result.stderr
    assert os.listdir(tmp_path) == []


def test_a_strategy_that_refuses_is_named_and_leaves_nothing(tmp_path):
    """normal can run with regions that are too narrow for Berth's theorem; combined cannot."""
    narrow = ("--set", "obstacles.0.conservative_m=0.13")
    assert sim("run", "circle", "--strategy", "normal", *narrow).returncode in (0, 1)
    result = sim("compare", "circle", "--strategies", "normal,combined", *narrow, "--figures",
                 tmp_path)
    assert (result.returncode, result.stdout) == (2, "")
    assert "strategy combined" in result.stderr and "conservative_m" in result.stderr
    assert os.listdir(tmp_path) == []


def test_json_is_all_there_is_on_stdout():
    result = sim("compare", "circle", "--strategies", "combined", "--json")
    assert result.stdout.endswith("}\n") and json.loads(result.stdout)
