"""berth-sim campaign: the clearance and recovery that Berth promises, over many random scenes.

BERTH_TEST_EFFORT=short runs a fiftieth of the scenes.
"""

import json
import os
import pty
import subprocess

import pytest
from simulator import MODES, STRATEGIES, sim, summary

SHORT = os.environ.get("BERTH_TEST_EFFORT") == "short"
KEYS = ["runs", "collisions", "worst_clearance_m", "recovered", "blocked", "steps", "wall_s",
        "mode_time_s", "bad_seeds"]
# Drives that need time to obey, and a pose that is not exact. The conservative radii widen with it.
REAL_DRIVES = [argument for key in
               ("plant.tau_s=0.05", "plant.a_max_mps2=3", "robot.v_max_mps=0.6",
                "plant.pose_noise_m=0.003", "plant.heading_noise_rad=0.003")
               for argument in ("--set", key)]


def runs(full):
    return full // 50 if SHORT else full


def campaign(*arguments, status=0):
    """The JSON summary of a campaign, which may take longer than a run."""
    result = subprocess.run([os.environ["BERTH_SIM"], "campaign", *map(str, arguments), "--json"],
                            capture_output=True, text=True, timeout=900, check=False)
    assert (result.returncode, result.stderr) == (status, "")
    return json.loads(result.stdout)


def report(capsys, name, result):
    share = 100.0 * result["recovered"] / result["runs"]
    with capsys.disabled():
        print(f"\n{name}: {result['runs']} runs, {result['collisions']} collisions, "
              f"worst clearance {result['worst_clearance_m']:.4f} m, {share:.3f} % recovered, "
              f"{result['blocked']} blocked")


def test_no_collision_with_ideal_drives(capsys):
    result = campaign("--runs", runs(100000), "--seed", 1)
    report(capsys, "ideal drives, obstacles overlapping as drawn", result)
    assert result["runs"] == runs(100000)
    assert result["collisions"] == 0
    assert result["worst_clearance_m"] > 0.0
    avoiding = sum(result["mode_time_s"].values()) - result["mode_time_s"]["track"]
    assert avoiding > 0.1 * result["mode_time_s"]["track"]  # there was something to avoid


# The wheels' limits well above what the scenes ask of them, and below it.
@pytest.mark.parametrize("wheels", ["16", "8"])
def test_no_collision_with_the_constrained_tracker(capsys, wheels):
    result = campaign("--runs", runs(20000), "--seed", 1, "--set", "mpc.constrained=true",
                      "--set", f"robot.wheel_speed_max_radps={wheels}")
    report(capsys, f"constrained tracker, wheels up to {wheels} rad/s", result)
    assert result["collisions"] == 0
    assert result["worst_clearance_m"] > 0.0


@pytest.mark.parametrize("strategy", ["conservative", "combined", "kanayama_avoid"])
def test_no_collision_among_overlapping_obstacles(strategy):
    result = campaign("--runs", runs(10000), "--seed", 3, "--overlap", "demand",
                      "--strategy", strategy)
    assert result["collisions"] == 0
    assert result["worst_clearance_m"] > 0.0


def test_recovery_among_separate_obstacles(capsys):
    result = campaign("--runs", runs(50000), "--seed", 2, "--overlap", "forbid")
    report(capsys, "ideal drives, separate obstacles", result)
    assert result["collisions"] == 0
    least = 0.99 if SHORT else 0.999  # a thousand runs cannot tell one in a thousand
    assert result["recovered"] >= least * result["runs"]
    assert len(result["bad_seeds"]) == result["runs"] - result["recovered"]


def test_no_collision_with_real_drives(capsys):
    result = campaign("--runs", runs(20000), "--seed", 4, *REAL_DRIVES)
    report(capsys, "drives with lag and limits, noisy pose", result)
    assert result["runs"] == runs(20000)
    assert result["collisions"] == 0
    assert result["worst_clearance_m"] > 0.0
    assert result["recovered"] > 0.9 * result["runs"]


def test_tracking_alone_collides():
    """The scenes are ones in which it takes avoidance not to collide."""
    result = campaign("--runs", 500, "--seed", 1, "--strategy", "none", status=1)
    assert result["collisions"] > 400
    assert result["worst_clearance_m"] < 0.0
    assert len(result["bad_seeds"]) >= result["collisions"]


def test_json_keys():
    result = campaign("--runs", 20, "--seed", 9)
    assert list(result) == KEYS
    assert list(result["mode_time_s"]) == MODES
    assert result["runs"] == 20
    assert 20 * 600 <= result["steps"] <= 20 * 900
    assert sum(result["mode_time_s"].values()) == pytest.approx(0.05 * result["steps"])


def without_time(result):
    return {key: value for key, value in result.items() if key != "wall_s"}


@pytest.mark.parametrize("extra", [[], REAL_DRIVES, ["--strategy", "none"]], ids=str)
def test_totals_do_not_depend_on_jobs(extra):
    status = 1 if "none" in extra else 0
    one = campaign("--runs", 300, "--seed", 5, "--jobs", 1, *extra, status=status)
    for jobs in (2, 5, 16):
        more = campaign("--runs", 300, "--seed", 5, "--jobs", jobs, *extra, status=status)
        assert without_time(more) == without_time(one)


def test_more_jobs_than_runs():
    assert without_time(campaign("--runs", 2, "--jobs", 64)) == without_time(
        campaign("--runs", 2, "--jobs", 1))


def test_a_bad_run_is_repeated_by_its_seed():
    whole = campaign("--runs", 40, "--seed", 70, "--strategy", "none", status=1)
    for seed in whole["bad_seeds"][:5]:
        alone = campaign("--runs", 1, "--seed", seed, "--strategy", "none", status=1)
        assert (alone["collisions"], alone["bad_seeds"]) == (1, [seed])


@pytest.mark.parametrize("seed", [1, 2, 168, 906, 123456789012345])
@pytest.mark.parametrize("extra", [[], REAL_DRIVES, ["--overlap", "demand"],
                                   ["--set", "avoidance.skirt_m=0.5"],
                                   ["--strategy", "conservative"]], ids=str)
def test_written_scene_is_the_run(tmp_path, seed, extra):
    """Bit for bit, through the decimal numbers of the file."""
    scene = tmp_path / "scene.yaml"
    totals = campaign("--runs", 1, "--seed", seed, *extra)
    written = sim("campaign", "--runs", 1, "--seed", seed, *extra, "--scene", scene)
    assert (written.returncode, written.stdout, written.stderr) == (0, "", "")
    one = summary("run", scene, "--seed", seed)
    assert one["min_clearance_m"] == totals["worst_clearance_m"]
    assert one["collisions"] == totals["collisions"]
    assert one["steps"] == totals["steps"]
    assert one["mode_time_s"] == pytest.approx(totals["mode_time_s"])
    assert (one["final_position_error_m"] < 0.05) == (totals["recovered"] == 1)


def test_written_scene_is_the_same_each_time(tmp_path):
    for name in ("one.yaml", "two.yaml"):
        assert sim("campaign", "--seed", 8, "--scene", tmp_path / name).returncode == 0
    assert (tmp_path / "one.yaml").read_bytes() == (tmp_path / "two.yaml").read_bytes()
    assert sim("campaign", "--seed", 9, "--scene", tmp_path / "two.yaml").returncode == 0
    assert (tmp_path / "one.yaml").read_bytes() != (tmp_path / "two.yaml").read_bytes()


def test_table_for_people():
    result = sim("campaign", "--runs", 30, "--strategy", "none", "--seed", 1)
    assert result.returncode == 1
    assert result.stderr == ""  # no progress bar where there is no terminal
    words = [line.split() for line in result.stdout.splitlines() if line]
    assert ["runs", "30"] in words
    assert [line[0] for line in words if line[0] in MODES and line[2:3] == ["s"]] == MODES
    assert any(line[0] == "--seed" and "collided" in line for line in words)


def test_progress_bar_on_a_terminal():
    ours, theirs = pty.openpty()
    result = subprocess.run([os.environ["BERTH_SIM"], "campaign", "--runs", "50"], stderr=theirs,
                            stdout=subprocess.PIPE, timeout=120, check=False)
    os.close(theirs)
    shown = os.read(ours, 100000).decode()
    os.close(ours)
    assert result.returncode == 0
    assert shown.endswith("50 of 50 runs\r\n")
    assert "#" * 40 in shown


@pytest.mark.parametrize("arguments, fragments", [
    (["--runs", "0"], ["--runs", "'0'", "1 to 1000000000"]),
    (["--runs", "-5"], ["--runs", "'-5'"]),
    (["--runs", "1e3"], ["--runs", "'1e3'"]),
    (["--runs", "1000000001"], ["--runs", "'1000000001'"]),
    (["--jobs", "0"], ["--jobs", "'0'", "1 to 1024"]),
    (["--jobs", "two"], ["--jobs", "'two'"]),
    (["--seed", "-1"], ["--seed", "'-1'"]),
    (["--seed", "0x10"], ["--seed", "'0x10'"]),
    (["--overlap", "some"], ["--overlap", "'some'", "any, demand, forbid"]),
    (["--strategy", "luck"], ["'luck'", *STRATEGIES]),
    (["--set", "robot.v_max_mps"], ["--set", "robot.v_max_mps"]),
    (["--set", "robot.wings=2"], ["--set", "robot.wings"]),
    (["--set", "robot.v_max_mps=fast"], ["robot.v_max_mps", "fast"]),
    (["--set", "robot.v_max_mps=-1"], ["robot.v_max_mps", "-1"]),
    (["--set", "reference.shape=eight"], ["reference.shape", "drawn for each run"]),
    (["--set", "obstacles.0.hard_m=0.1"], ["obstacles.0.hard_m", "drawn for each run"]),
    (["--set", "start.x_m=0"], ["start.x_m", "drawn for each run"]),
    (["--set", "robot.omega_max_radps=40"], ["robot.omega_max_radps"]),
    (["--set", "plant.tau_s=9"], ["no scene fits"]),
    (["--set", "duration_s=10.5"], ["duration_s", "more than 10.5 s"]),
    (["--seed", "9223372036854775807", "--runs", "2"], ["--seed", "9223372036854775808"]),
    (["--bogus"], ["--bogus"]),
    (["circle"], ["'circle'"]),
], ids=str)
def test_bad_usage(arguments, fragments):
    result = sim("campaign", *arguments)
    assert (result.returncode, result.stdout) == (2, "")
    for fragment in fragments:
        assert fragment in result.stderr


def test_scene_that_cannot_be_written(tmp_path):
    path = tmp_path / "nowhere" / "scene.yaml"
    result = sim("campaign", "--scene", path)
    assert (result.returncode, result.stdout) == (2, "")
    assert str(path) in result.stderr
    assert not path.parent.exists()
