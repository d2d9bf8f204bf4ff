"""berth-sim campaign: the clearance and recovery that Berth promises, over many random scenes.

BERTH_TEST_EFFORT=short runs a fiftieth of the scenes.
"""

import csv
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


# --- rows, plants that are drawn, the bus ------------------------------------------------------

ROW_COLUMNS = (
    "seed,shape,obstacles,overlap,tau_s,a_max_mps2,pose_noise_m,heading_noise_rad,slip,pose_delay_s,"
    "watchdog_s,untold,needed_m,given_m,violation,collisions,min_clearance_m,rms_position_error_m,"
    "peak_position_error_m,final_position_error_m,avoidance_time_s,track_s,regulated_s,"
    "conservative_turn_s,conservative_go_s,blocked_s,standing_s,recovery_time_s,control_effort,"
    "steps,recovered,blocked,drive,fault,fault_s,fault_lasts_s,end,stopped_s,reason,wrong").split(",")
DRAWN = ["--plant", "drawn", "--set", "robot.v_max_mps=0.6"]
UNTOLD = ["--plant", "untold", "--set", "robot.v_max_mps=0.6"]
BUS = ["--bus", "loop", "--set", "robot.v_max_mps=0.5"]


def rows_of(tmp_path, *arguments, status=0):
    """The totals and the rows, as dictionaries of text."""
    path = tmp_path / "rows.csv"
    totals = campaign(*arguments, "--rows", path, status=status)
    with open(path, newline="", encoding="ascii") as file:
        table = csv.DictReader(file)
        assert table.fieldnames == ROW_COLUMNS
        return totals, list(table)


@pytest.mark.parametrize("extra", [[], REAL_DRIVES, DRAWN], ids=str)
def test_rows_are_the_totals(tmp_path, extra):
    totals, rows = rows_of(tmp_path, "--runs", 200, "--seed", 40, *extra)
    assert [int(row["seed"]) for row in rows] == list(range(40, 240))
    assert min(float(row["min_clearance_m"]) for row in rows) == totals["worst_clearance_m"]
    assert sum(int(row["recovered"]) for row in rows) == totals["recovered"]
    assert sum(int(row["steps"]) for row in rows) == totals["steps"]
    for mode in MODES:
        assert sum(float(row[f"{mode}_s"]) for row in rows) == pytest.approx(
            totals["mode_time_s"][mode])
    for row in rows:
        assert float(row["violation"]) < 0.0 < float(row["given_m"]) - float(row["needed_m"])
        assert (row["drive"], row["fault"], row["wrong"]) == ("", "", "")


def test_a_row_is_the_run_of_its_scene(tmp_path):
    _, rows = rows_of(tmp_path, "--runs", 3, "--seed", 11, *DRAWN)
    for row in rows:
        scene = tmp_path / "scene.yaml"
        assert sim("campaign", "--seed", row["seed"], *DRAWN, "--scene", scene).returncode == 0
        one = summary("run", scene, "--seed", row["seed"])
        for key in ("min_clearance_m", "rms_position_error_m", "control_effort", "collisions"):
            assert float(row[key]) == one[key]
        assert (row["recovery_time_s"] == "") == (one["recovery_time_s"] is None)


def test_rows_do_not_depend_on_jobs_nor_on_parts(tmp_path):
    whole = tmp_path / "whole.csv"
    campaign("--runs", 60, "--seed", 5, *DRAWN, "--jobs", 7, "--rows", whole)
    parts = []
    for seed in (5, 25, 45):
        path = tmp_path / f"{seed}.csv"
        campaign("--runs", 20, "--seed", seed, *DRAWN, "--jobs", 1, "--rows", path)
        parts += path.read_text().splitlines()[0 if seed == 5 else 1:]
    assert whole.read_text().splitlines() == parts


def test_drawn_plants_use_their_ranges(tmp_path):
    _, rows = rows_of(tmp_path, "--runs", 400, "--seed", 1, *DRAWN)
    ranges = {"tau_s": (0, 0.1), "a_max_mps2": (2, 5), "pose_noise_m": (0, 0.005),
              "heading_noise_rad": (0, 0.005), "slip": (0, 0.05), "pose_delay_s": (0, 0.1)}
    for key, (least, most) in ranges.items():
        values = [float(row[key]) for row in rows]
        assert least <= min(values) < least + 0.05 * (most - least)
        assert most >= max(values) > most - 0.05 * (most - least)
    for row in rows[:50]:
        v, slip = 0.6, 1.0 + float(row["slip"])
        delay = 0.05 + float(row["tau_s"]) + float(row["pose_delay_s"])
        needed = slip * (v * delay + v * v / (2.0 * float(row["a_max_mps2"])))
        needed += 3.0 * float(row["pose_noise_m"])
        assert float(row["needed_m"]) == pytest.approx(needed)
        assert float(row["given_m"]) == pytest.approx(needed + 0.01)


def test_no_collision_with_drawn_plants(capsys):
    result = campaign("--runs", runs(50000), "--seed", 1, *DRAWN)
    report(capsys, "lag, limits, noise, slip and late poses", result)
    assert result["collisions"] == 0
    assert result["worst_clearance_m"] > 0.0
    assert result["recovered"] > 0.9 * result["runs"]


def test_a_plant_worse_than_told_collides_the_more_the_worse(tmp_path):
    totals, rows = rows_of(tmp_path, "--runs", 4000, "--seed", 1, *UNTOLD, status=1)
    assert totals["collisions"] > 50
    collided = [[], []]
    for row in rows:
        needed, given = float(row["needed_m"]), float(row["given_m"])
        untold = float(row["untold"])
        assert given == pytest.approx(0.01 + 0.03 + (1.0 - untold) * (needed - 0.03), abs=1e-3)
        assert float(row["violation"]) == pytest.approx(1.0 - given / needed)
        if float(row["violation"]) <= 0.0:
            assert row["collisions"] == "0"
        else:
            collided[float(row["violation"]) > 0.4].append(row["collisions"] != "0")
    rates = [sum(part) / len(part) for part in collided]
    assert rates[1] > 3.0 * rates[0]


def test_no_collision_with_very_late_poses(capsys, tmp_path):
    """A heading that is up to 0.6 rad old, near obstacles too."""
    result, rows = rows_of(tmp_path, "--runs", runs(50000), "--seed", 1, "--plant", "late",
                           "--set", "robot.v_max_mps=0.6")
    report(capsys, "poses up to 0.2 s late", result)
    delays = [float(row["pose_delay_s"]) for row in rows]
    assert 0.0 <= min(delays) < 0.01 and 0.19 < max(delays) <= 0.2
    assert result["collisions"] == 0


@pytest.mark.parametrize("drive", ["odrive", "vesc", "cia402", None])
def test_no_collision_on_the_bus(tmp_path, drive):
    chosen = [] if drive is None else ["--drive", drive]
    totals, rows = rows_of(tmp_path, "--runs", 12, "--seed", 1, *BUS, *chosen)
    assert (totals["collisions"], totals["stopped"], totals["wrong"]) == (0, 0, 0)
    assert {row["drive"] for row in rows} <= ({drive} if drive else {"odrive", "vesc", "cia402"})
    assert {(row["fault"], row["end"], row["reason"]) for row in rows} == {("none", "idle", "")}
    assert {row["watchdog_s"] for row in rows} == {"0.25"}


def test_faults_on_the_bus_stop_with_a_reason_or_do_no_harm(tmp_path):
    totals, rows = rows_of(tmp_path, "--runs", runs(1500) + 100, "--seed", 1, *BUS, "--plant", "drawn",
                           "--faults")
    assert (totals["collisions"], totals["wrong"]) == (0, 0)
    stopped = [row for row in rows if row["reason"]]
    assert totals["stopped"] == len(stopped) > 0.4 * len(rows)
    assert len({row["fault"] for row in rows}) >= 13
    assert len({row["reason"] for row in rows}) >= 8
    for row in stopped:
        assert row["end"] == "fault"
        assert row["fault_s"] == "" or float(row["stopped_s"]) >= float(row["fault_s"])


@pytest.mark.parametrize("seed, options, wrong", [
    (1, ["--strategy", "none"], "collided"),
    # a watchdog that bites between two messages; and one that sleeps
    (1, ["--drive", "odrive", "--feedback-timeout", "2"], "stopped with the wrong reason"),
    (70, ["--drive", "odrive", "--faults", "--feedback-timeout", "10000",
          "--heartbeat-timeout", "10000"], "carried on"),
], ids=str)
def test_what_is_wrong_on_the_bus_is_found(tmp_path, seed, options, wrong):
    totals, rows = rows_of(tmp_path, "--runs", 10, "--seed", seed, *BUS, *options, status=1)
    found = [int(row["seed"]) for row in rows if row["wrong"] == wrong]
    assert found and totals["wrong"] >= len(found)
    assert set(found) <= set(totals["bad_seeds"])
    again, _ = rows_of(tmp_path, "--runs", 1, "--seed", found[0], *BUS, *options, status=1)
    assert (again["wrong"], again["bad_seeds"]) == (1, [found[0]])


def test_bus_totals_for_people():
    result = sim("campaign", "--runs", 3, *BUS, "--faults")
    words = [line.rsplit(maxsplit=1) for line in result.stdout.splitlines() if line]
    assert ["stopped by a fault", "not as it must be"] == [
        word[0] for word in words if word[0] in ("stopped by a fault", "not as it must be")]


def test_rows_that_cannot_be_written(tmp_path):
    path = tmp_path / "nowhere" / "rows.csv"
    result = sim("campaign", "--runs", 1, "--rows", path)
    assert (result.returncode, result.stdout) == (2, "")
    assert str(path) in result.stderr


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
    (["--plant", "mine"], ["--plant", "'mine'", "base, drawn, untold, late"]),
    (["--plant", "drawn", "--set", "plant.tau_s=0.1"], ["plant.tau_s", "drawn for each run"]),
    (["--rows", "x.csv", "--runs", "10000001"], ["--rows", "10000001", "10000000"]),
    (["--faults"], ["--faults", "--bus loop"]),
    (["--bus", "can0"], ["--bus", "'can0'", "loop"]),
    (["--drive", "odrive"], ["--drive", "--bus loop"]),
    (["--bus", "loop", "--strategy", "normal"], ["normal", "none, conservative, combined"]),
    (["--bus", "loop", "--pole-pairs", "7"], ["--pole-pairs", "--drive vesc"]),
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
