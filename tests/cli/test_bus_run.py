"""berth-sim run --bus loop: board and robot on the virtual bus, from the command line."""

import math

import pytest

from simulator import COLUMNS, MODES, SUMMARY_KEYS, columns, read_log, sim, summary

DRIVES = ["odrive", "vesc", "cia402"]
BUS_KEYS = ["end", "frames", "sent", "received", "dropped", "load", "load_peak", "armed_s", "board",
            "drive", "run", "state", "fault", "fault_text", "clearance_m", "pose_error_m",
            "statuses", "malformed", "fixes", "announcements", "lost", "drives"]


def on_bus(scenario, *arguments, **options):
    return summary("run", scenario, "--bus", "loop", *arguments, **options)


# --- the experiments -------------------------------------------------------------------------

@pytest.mark.parametrize("scenario", ["circle", "eight"])
@pytest.mark.parametrize("drive", DRIVES)
def test_an_experiment_comes_out_as_without_the_bus(scenario, drive):
    plain = summary("run", scenario)
    result = on_bus(scenario, "--drive", drive)
    bus = result["bus"]
    assert result["collisions"] == 0 and result["steps"] == plain["steps"]
    assert result["rms_position_error_m"] == pytest.approx(plain["rms_position_error_m"], rel=0.2)
    assert (bus["drive"], bus["end"], bus["run"], bus["state"]) == (drive, "idle", "done", "idle")
    assert (bus["dropped"], bus["fault"], bus["malformed"]) == (0, 0, 0)
    assert (bus["board"]["late"], bus["board"]["missed"]) == (0, 0)
    assert 0.005 < bus["load"] <= bus["load_peak"] < 0.2
    assert result["wall_s"] < 3


def test_the_summary_has_its_keys_and_one_more():
    result = on_bus("circle")
    assert list(result) == [*SUMMARY_KEYS, "bus"]
    assert list(result["bus"]) == BUS_KEYS
    assert len(result["bus"]["drives"]) == 2
    assert list(result["mode_time_s"]) == MODES


def test_a_plain_run_says_nothing_of_a_bus():
    assert list(summary("run", "circle")) == SUMMARY_KEYS
    assert "bus load" not in sim("run", "circle").stdout


def test_frames_add_up():
    bus = on_bus("circle")["bus"]
    drives = bus["drives"]
    assert bus["received"] == sum(d["sent"] for d in drives) + bus["fixes"]
    assert bus["frames"] == bus["sent"] + bus["received"]
    assert bus["board"]["received"] == bus["received"]


def test_table_shows_the_bus():
    result = sim("run", "circle", "--bus", "loop", "--drive", "vesc")
    assert (result.returncode, result.stderr) == (0, "")
    lines = dict(line.rsplit(None, 1) for line in result.stdout.splitlines()[3:] if line)
    bus = on_bus("circle", "--drive", "vesc")["bus"]
    assert lines["collisions"] == "0"
    assert lines["drives"] == "vesc" and lines["session ended"] == "idle"
    assert lines["frames on the bus"] == str(bus["frames"])
    assert lines["  dropped"] == "0"
    assert lines["bus load at 1 Mbit/s, %"] == f"{100 * bus['load']:.2f}"


# --- the log ---------------------------------------------------------------------------------

@pytest.mark.parametrize("drive", DRIVES)
def test_log_and_summary_agree(tmp_path, drive):
    result = on_bus("circle", "--drive", drive, "--log", tmp_path / "log.csv")
    header, rows = read_log(tmp_path / "log.csv")
    log = columns(tmp_path / "log.csv")
    assert header == COLUMNS and len(rows) == 600 == result["steps"]
    errors = [math.hypot(xr - x, yr - y)
              for x, y, xr, yr in zip(log["x"], log["y"], log["x_r"], log["y_r"])]
    rms = math.sqrt(sum(e * e for e in errors) / len(errors))
    assert result["rms_position_error_m"] == pytest.approx(rms, rel=1e-6)
    assert result["min_clearance_m"] == pytest.approx(min(log["clearance"]), rel=1e-8)
    for mode in MODES:
        assert result["mode_time_s"][mode] == pytest.approx(0.05 * log["mode"].count(mode))
    assert [row[0] for row in rows] == [f"{k * 0.05:.9g}" for k in range(600)]


def test_the_same_seed_gives_the_same_log(tmp_path):
    noise = ("--set", "plant.pose_noise_m=0.003")
    for name, seed in (("a", 7), ("b", 7), ("c", 8)):
        on_bus("circle", *noise, "--seed", seed, "--log", tmp_path / name)
    logs = {name: (tmp_path / name).read_bytes() for name in "abc"}
    assert logs["a"] == logs["b"] != logs["c"]


# --- the drives' options ---------------------------------------------------------------------

SAME = [
    ("--left", 17, "--right", 4),
    ("--invert", "left"),
    ("--invert", "both", "--gear", 12.5),
    ("--drive", "vesc", "--pole-pairs", 14, "--gear", 10),
    ("--drive", "cia402", "--mode", 9, "--master", 9),
    ("--drive", "cia402", "--no-position", "--velocity-units", 600, "--gear", 10),
    ("--drive", "cia402", "--counts-per-turn", 65536, "--invert", "right"),
    ("--address", 200),
    ("--fix-period", 0),
    ("--fix-period", 20, "--fix-latency", 20),
    ("--feedback-timeout", 300, "--heartbeat-timeout", 900, "--enable-timeout", 9000),
    ("--obstacles", "bus"),
]


@pytest.mark.parametrize("options", SAME, ids=lambda v: " ".join(map(str, v)))
def test_however_the_drives_are_the_robot_goes_the_same_way(options):
    result = on_bus("circle", *options)
    assert (result["collisions"], result["bus"]["dropped"]) == (0, 0)
    plain = summary("run", "circle")["rms_position_error_m"]
    assert result["rms_position_error_m"] == pytest.approx(plain, rel=0.2)


def test_obstacles_come_over_the_bus():
    assert on_bus("circle")["bus"]["announcements"] == 0
    assert on_bus("circle", "--obstacles", "bus")["bus"]["announcements"] >= 450


def test_a_blind_board_collides_and_the_status_is_1():
    result = on_bus("circle", "--strategy", "none", status=1)
    assert result["collisions"] == 3 and result["min_clearance_m"] < 0
    assert result["bus"]["end"] == "idle"


def test_a_fault_is_told_and_the_status_is_1():
    """Feedback comes each 10 ms, so 1 ms without is a fault as soon as the drives are enabled."""
    result = sim("run", "circle", "--bus", "loop", "--feedback-timeout", 1)
    assert (result.returncode, result.stderr) == (1, "")
    assert "fault: left drive: " in result.stdout
    bus = on_bus("circle", "--feedback-timeout", 1, status=1)["bus"]
    assert (bus["end"], bus["run"], bus["state"]) == ("fault", "waiting", "fault")
    assert bus["fault"] != 0 and bus["fault_text"].startswith("left drive: ")


# --- bad usage -------------------------------------------------------------------------------

BAD_USAGE = [
    (("--bus", "can0"), ["--bus", "'can0'", "loop"]),
    (("--bus",), ["--bus", "requires an argument"]),
    (("--drive", "vesc"), ["--drive", "--bus loop"]),
    (("--fix-period", "10"), ["--fix-period", "--bus loop"]),
    (("--bus", "loop", "--drive", "servo"), ["--drive", "'servo'", "odrive, vesc, cia402"]),
    (("--bus", "loop", "--left", "63"), ["--left", "63", "0 to 62"]),
    (("--bus", "loop", "--left", "-1"), ["--left", "'-1'", "0 to 254"]),
    (("--bus", "loop", "--left", "1x"), ["--left", "'1x'"]),
    (("--bus", "loop", "--drive", "vesc", "--right", "255"), ["--right", "'255'", "254"]),
    (("--bus", "loop", "--drive", "cia402", "--left", "0"), ["--left", "0", "1 to 127"]),
    (("--bus", "loop", "--drive", "cia402", "--master", "2"), ["--right", "2", "--master"]),
    (("--bus", "loop", "--left", "2"), ["--right", "2", "left"]),
    (("--bus", "loop", "--pole-pairs", "7"), ["--pole-pairs", "odrive", "vesc"]),
    (("--bus", "loop", "--drive", "vesc", "--mode", "3"), ["--mode", "vesc", "cia402"]),
    (("--bus", "loop", "--drive", "vesc", "--pole-pairs", "0"), ["--pole-pairs", "'0'", "1 to 100"]),
    (("--bus", "loop", "--drive", "cia402", "--mode", "4"), ["--mode", "'4'", "3, 9"]),
    (("--bus", "loop", "--drive", "cia402", "--velocity-units", "0"), ["--velocity-units", "'0'"]),
    (("--bus", "loop", "--gear", "nan"), ["--gear", "'nan'", "0.001 to 1000"]),
    (("--bus", "loop", "--gear", "1001"), ["--gear", "'1001'", "0.001 to 1000"]),
    (("--bus", "loop", "--invert", "up"), ["--invert", "'up'", "none, left, right, both"]),
    (("--bus", "loop", "--address", "256"), ["--address", "'256'", "0 to 255"]),
    (("--bus", "loop", "--feedback-timeout", "0"), ["--feedback-timeout", "'0'", "1 to 10000"]),
    (("--bus", "loop", "--obstacles", "no"), ["--obstacles", "'no'", "plan, bus"]),
    (("--bus", "loop", "--fix-period", "10", "--fix-latency", "151"), ["--fix-latency", "150"]),
    (("--bus", "loop", "--strategy", "adaptive"), ["'adaptive'", "none, conservative, combined"]),
]


@pytest.mark.parametrize("arguments, fragments", BAD_USAGE, ids=lambda v: " ".join(v)[:50])
def test_bad_usage_is_2_and_says_what_and_what_is_allowed(tmp_path, arguments, fragments):
    log = () if arguments == ("--bus",) else ("--log", tmp_path / "log.csv")
    result = sim("run", "circle", *log, *arguments, cwd=tmp_path)
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr.startswith("berth-sim run: ")
    for fragment in fragments:
        assert fragment in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_help_names_the_options_of_the_bus():
    result = sim("run", "--help")
    assert (result.returncode, result.stderr) == (0, "")
    for word in ("--bus", "--drive", "--left", "--right", "--gear", "--invert", "--pole-pairs",
                 "--counts-per-turn", "--velocity-units", "--mode", "--obstacles", "--fix-period"):
        assert word in result.stdout
    assert max(map(len, result.stdout.splitlines())) <= 100
