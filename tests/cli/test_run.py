"""berth-sim run: its log, its summary, its exit status, and what it refuses."""

import json
import math
import os
import stat

import pytest
from simulator import COLUMNS, MODES, STRATEGIES, SUMMARY_KEYS, columns, read_log, sim, summary

RECOVERED_M = 0.05
STANDARD = """
name: standard
period_s: 0.05
duration_s: 2
reference: {shape: circle, closed: false}
robot: {wheel_radius_m: 0.05, track_m: 0.3, v_max_mps: 0.8, omega_max_radps: 3}
start: {x_m: 1, y_m: -0.1, theta_rad: 1.5}
mpc: {horizon: 20, q: [10, 40, 1], r: [0.5, 0.1], discretization: euler}
avoidance: {strategy: combined, skirt_m: 0.02, v_creep_mps: 0.05}
obstacles: []
plant: {tau_s: 0, a_max_mps2: 0, alpha_max_radps2: 0, pose_noise_m: 0, heading_noise_rad: 0}
"""


# --- log -------------------------------------------------------------------------------------

@pytest.mark.parametrize("scenario, rows", [("circle", 600), ("eight", 900)])
def test_log_has_the_columns_and_a_row_a_period(tmp_path, scenario, rows):
    result = summary("run", scenario, "--log", tmp_path / "log.csv")
    header, table = read_log(tmp_path / "log.csv")
    assert header == COLUMNS
    assert len(table) == rows == result["steps"]
    assert {len(row) for row in table} == {len(COLUMNS)}
    for k, row in enumerate(table):
        assert row[0] == f"{k * 0.05:.9g}"


def test_log_values_are_numbers_with_nine_digits(tmp_path):
    summary("run", "eight", "--log", tmp_path / "log.csv")
    header, table = read_log(tmp_path / "log.csv")
    for row in table:
        for name, text in zip(header, row):
            if name == "mode":
                assert text in MODES
            else:
                assert text == f"{float(text):.9g}"


def test_log_ends_with_a_newline_and_has_no_carriage_returns(tmp_path):
    summary("run", "circle", "--log", tmp_path / "log.csv")
    data = (tmp_path / "log.csv").read_bytes()
    assert data.endswith(b"\n") and not data.endswith(b"\n\n") and b"\r" not in data


def test_without_obstacles_clearance_is_infinite_in_the_log_and_null_in_the_summary(tmp_path):
    (tmp_path / "s.yaml").write_text(STANDARD)
    result = summary("run", tmp_path / "s.yaml", "--log", tmp_path / "log.csv")
    assert result["min_clearance_m"] is None
    assert set(columns(tmp_path / "log.csv")["clearance"]) == {math.inf}


def test_log_is_written_when_the_run_collides(tmp_path):
    summary("run", "circle", "--strategy", "none", "--log", tmp_path / "log.csv", status=1)
    assert len(read_log(tmp_path / "log.csv")[1]) == 600


def test_log_replaces_an_older_one_and_keeps_a_link(tmp_path):
    (tmp_path / "real.csv").write_text("old\n")
    (tmp_path / "link.csv").symlink_to("real.csv")
    summary("run", "circle", "--log", tmp_path / "link.csv")
    assert (tmp_path / "link.csv").is_symlink()
    assert read_log(tmp_path / "real.csv")[0] == COLUMNS
    assert sorted(os.listdir(tmp_path)) == ["link.csv", "real.csv"]


def test_log_gets_the_permissions_of_any_new_file(tmp_path):
    summary("run", "circle", "--log", tmp_path / "log.csv")
    (tmp_path / "other").touch()
    mode = stat.S_IMODE((tmp_path / "log.csv").stat().st_mode)
    assert mode == stat.S_IMODE((tmp_path / "other").stat().st_mode)


def test_a_pipe_is_written_in_place():
    result = sim("run", "circle", "--log", "/dev/stderr", "--json")
    assert result.returncode == 0
    assert result.stderr.startswith(",".join(COLUMNS) + "\n") and result.stderr.count("\n") == 601
    assert json.loads(result.stdout)["steps"] == 600


# --- log and summary agree -------------------------------------------------------------------

CASES = [("circle", "conservative"), ("circle", "none"), ("circle", "normal"),
         ("eight", "combined"), ("eight", "adaptive"), ("eight", "kanayama_avoid")]


@pytest.fixture(scope="module", params=CASES, ids="-".join)
def run(request, tmp_path_factory):
    """(log by column, summary) of one run."""
    scenario, strategy = request.param
    path = tmp_path_factory.mktemp("run") / "log.csv"
    status = 1 if strategy == "none" else 0
    result = summary("run", scenario, "--strategy", strategy, "--log", path, status=status)
    return columns(path), result


def position_errors(log):
    return [math.hypot(xr - x, yr - y)
            for x, y, xr, yr in zip(log["x"], log["y"], log["x_r"], log["y_r"])]


def test_position_errors_agree(run):
    log, result = run
    errors = position_errors(log)
    rms = math.sqrt(sum(e * e for e in errors) / len(errors))
    assert result["rms_position_error_m"] == pytest.approx(rms, rel=1e-6)
    assert result["peak_position_error_m"] == pytest.approx(max(errors), rel=1e-6)
    assert result["final_position_error_m"] == pytest.approx(errors[-1], abs=1e-7)


def test_times_by_mode_agree(run):
    log, result = run
    for mode in MODES:
        assert result["mode_time_s"][mode] == pytest.approx(0.05 * log["mode"].count(mode))
    avoiding = sum(mode != "track" for mode in log["mode"])
    assert result["avoidance_time_s"] == pytest.approx(0.05 * avoiding)
    assert sum(result["mode_time_s"].values()) == pytest.approx(0.05 * result["steps"])


def test_clearance_and_collisions_agree(run):
    log, result = run
    assert result["min_clearance_m"] == pytest.approx(min(log["clearance"]), rel=1e-8)
    assert (result["collisions"] > 0) == (min(log["clearance"]) < 0)


def test_control_effort_agrees(run):
    log, result = run
    effort = 0.05 * sum((v - vr) ** 2 + (w - wr) ** 2 for v, vr, w, wr in
                        zip(log["v_cmd"], log["v_r"], log["omega_cmd"], log["omega_r"]))
    assert result["control_effort"] == pytest.approx(effort, rel=1e-6)


def test_recovery_time_agrees(run):
    log, result = run
    avoiding = [k for k, mode in enumerate(log["mode"]) if mode != "track"]
    far = [k for k, error in enumerate(position_errors(log)) if error >= RECOVERED_M]
    expected = 0.05 * max(0, far[-1] - avoiding[-1]) if avoiding else 0.0
    assert result["recovery_time_s"] == pytest.approx(expected)


def test_tracking_error_is_the_pose_seen_from_the_robot(run):
    log, _ = run
    for k, theta in enumerate(log["theta"]):
        dx, dy = log["x_r"][k] - log["x"][k], log["y_r"][k] - log["y"][k]
        assert log["e1"][k] == pytest.approx(math.cos(theta) * dx + math.sin(theta) * dy, abs=1e-7)
        assert log["e2"][k] == pytest.approx(math.cos(theta) * dy - math.sin(theta) * dx, abs=1e-7)
        turned = (log["theta_r"][k] - theta + math.pi) % (2 * math.pi) - math.pi
        assert math.cos(log["e3"][k] - turned) == pytest.approx(1.0, abs=1e-12)


def test_each_command_moves_the_robot_to_the_next_row(run):
    """The ideal robot: rows are joined by the arc of the command held between them."""
    log, _ = run
    for k in range(len(log["t"]) - 1):
        v, omega, theta = log["v_cmd"][k], log["omega_cmd"][k], log["theta"][k]
        half = 0.5 * omega * 0.05
        chord = v * 0.05 * (math.sin(half) / half if abs(half) > 1e-9 else 1.0)
        assert log["x"][k + 1] == pytest.approx(log["x"][k] + chord * math.cos(theta + half),
                                                abs=1e-7)
        assert log["y"][k + 1] == pytest.approx(log["y"][k] + chord * math.sin(theta + half),
                                                abs=1e-7)


def test_recovery_is_null_when_the_run_ends_too_soon():
    result = summary("run", "circle", "--strategy", "conservative", "--set", "duration_s=5.5")
    assert result["avoidance_time_s"] > 0 and result["recovery_time_s"] is None


# --- summary ---------------------------------------------------------------------------------

def test_summary_has_exactly_its_keys():
    result = summary("run", "circle")
    assert list(result) == SUMMARY_KEYS
    assert list(result["mode_time_s"]) == MODES
    assert isinstance(result["collisions"], int) and isinstance(result["steps"], int)


def test_table_shows_the_summary():
    result = summary("run", "eight")
    table = sim("run", "eight")
    assert (table.returncode, table.stderr) == (0, "")
    lines = dict(line.rsplit(None, 1) for line in table.stdout.splitlines()[3:])
    assert lines["collisions"] == "0"
    assert lines["position error, RMS, m"] == f"{result['rms_position_error_m']:.4f}"
    assert lines["avoidance in control, s"] == f"{result['avoidance_time_s']:.2f}"
    assert lines["minimum clearance, m"] == f"{result['min_clearance_m']:.4f}"


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_every_strategy_runs_by_name(strategy):
    status = 1 if strategy in ("none", "kanayama") else 0
    assert summary("run", "circle", "--strategy", strategy, status=status)["steps"] == 600


# --- determinism -----------------------------------------------------------------------------

NOISE = ("--set", "plant.pose_noise_m=0.003", "--set", "plant.tau_s=0.05",
         "--set", "robot.v_max_mps=0.3", "--strategy", "none")


def log_bytes(path, *arguments):
    sim("run", "circle", "--log", path, *arguments)
    return path.read_bytes()


def test_the_same_seed_gives_the_same_log(tmp_path):
    first = log_bytes(tmp_path / "a", *NOISE, "--seed", "7")
    assert first == log_bytes(tmp_path / "b", *NOISE, "--seed", "7")
    assert first != log_bytes(tmp_path / "c", *NOISE, "--seed", "8")


def test_the_seed_is_1_when_none_is_given(tmp_path):
    assert log_bytes(tmp_path / "a", *NOISE) == log_bytes(tmp_path / "b", *NOISE, "--seed", "1")


# --- --set -----------------------------------------------------------------------------------

def test_set_changes_the_scenario_and_the_last_one_wins():
    steps = summary("run", "circle", "--set", "duration_s=1", "--set", "duration_s=2")["steps"]
    assert steps == 40


def test_set_applies_to_a_file_too(tmp_path):
    (tmp_path / "s.yaml").write_text(STANDARD)
    assert summary("run", tmp_path / "s.yaml")["steps"] == 40
    assert summary("run", tmp_path / "s.yaml", "--set", "period_s=0.1")["steps"] == 20


def test_the_strategy_option_wins_over_the_scenario():
    by_set = summary("run", "circle", "--set", "avoidance.strategy=conservative")
    by_option = summary("run", "circle", "--set", "avoidance.strategy=none", "--strategy",
                        "conservative")
    assert by_set.pop("wall_s") != by_option.pop("wall_s")
    assert by_set == by_option


# --- exit status -----------------------------------------------------------------------------

BAD_USAGE = [
    ((), ["no command", "run, compare, campaign, replay"]),
    (("walk",), ["'walk'", "run, compare, campaign, replay"]),
    (("--verbose",), ["'--verbose'", "allowed"]),
    (("run",), ["SCENARIO is missing", "circle, eight or a YAML file"]),
    (("run", "circel"), ["'circel'", "circle, eight or a YAML file"]),
    (("run", "circle", "eight"), ["more than one SCENARIO", "'eight'"]),
    (("run", "circle", "--frobnicate"), ["--frobnicate"]),
    (("run", "circle", "--log"), ["--log", "requires an argument"]),
    (("run", "circle", "--seed", "-1"), ["--seed", "'-1'", "0 to 9223372036854775807"]),
    (("run", "circle", "--seed", "1e3"), ["--seed", "'1e3'"]),
    (("run", "circle", "--seed", ""), ["--seed", "''"]),
    (("run", "circle", "--seed", "9223372036854775808"), ["--seed", "0 to 9223372036854775807"]),
    (("run", "circle", "--strategy", "luck"), ["'luck'", *STRATEGIES]),
    (("run", "circle", "--strategy", ""), ["''", "combined"]),
    (("run", "circle", "--set", "duration_s"), ["--set", "duration_s"]),
    (("run", "circle", "--set", "speed=1"), ["--set", "speed"]),
    (("run", "circle", "--set", "period_s=fast"), ["--set", "period_s", "fast"]),
    (("run", "circle", "--set", "robot.v_max_mps=-1"), ["--set", "robot.v_max_mps", "-1"]),
    (("run", "circle", "--set", "obstacles.0.conservative_m=0.13"), ["conservative_m", "0.04"]),
    (("run", "."), ["."]),
]


@pytest.mark.parametrize("arguments, fragments", BAD_USAGE, ids=lambda v: " ".join(v)[:40])
def test_bad_usage_is_2_and_says_what_and_what_is_allowed(tmp_path, arguments, fragments):
    log = ("--log", tmp_path / "log.csv") if arguments[:1] == ("run",) else ()
    result = sim(*arguments, *(log if arguments[-1:] != ("--log",) else ()), cwd=tmp_path)
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr.startswith("berth-sim")
    for fragment in fragments:
        assert fragment in result.stderr
    assert os.listdir(tmp_path) == []


def test_a_collision_is_1_and_still_reported():
    result = summary("run", "circle", "--strategy", "none", status=1)
    assert result["collisions"] == 3 and result["min_clearance_m"] < 0


@pytest.mark.parametrize("path", ["missing/log.csv", ".", "file/log.csv", ""])
def test_a_log_that_cannot_be_opened_is_2_and_leaves_nothing(tmp_path, path):
    (tmp_path / "file").write_text("kept")
    result = sim("run", "circle", "--log", path, "--json", cwd=tmp_path)
    assert (result.returncode, result.stdout) == (2, "")
    assert "cannot write" in result.stderr and (path or "empty") in result.stderr
    assert os.listdir(tmp_path) == ["file"] and (tmp_path / "file").read_text() == "kept"


def test_a_log_that_cannot_be_written_is_1():
    result = sim("run", "circle", "--log", "/dev/full", "--json")
    assert (result.returncode, result.stdout) == (1, "")
    assert "/dev/full" in result.stderr and "No space left" in result.stderr


def test_a_full_disk_leaves_no_log(tmp_path):
    import resource

    def limit():
        import signal
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))

    (tmp_path / "log.csv").write_text("older\n")
    result = sim("run", "circle", "--log", tmp_path / "log.csv", preexec_fn=limit)
    assert (result.returncode, result.stdout) == (1, "")
    assert "cannot write" in result.stderr
    assert os.listdir(tmp_path) == ["log.csv"]
    assert (tmp_path / "log.csv").read_text() == "older\n"


@pytest.mark.parametrize("form", [["--json"], []])
def test_a_summary_that_cannot_be_printed_is_1(form):
    with open("/dev/full", "w", encoding="ascii") as full:
        import subprocess
        result = sim("run", "circle", *form, stdout=full, stderr=subprocess.PIPE)
    assert result.returncode == 1 and "cannot write the summary" in result.stderr


# --- help ------------------------------------------------------------------------------------

def test_help_names_every_command_and_status():
    result = sim("--help")
    assert (result.returncode, result.stderr) == (0, "")
    for word in ("run", "compare", "campaign", "circle", "eight", "YAML", "--version", "Exit status"):
        assert word in result.stdout


@pytest.mark.parametrize("command, options", [
    ("run", ["--strategy", "--seed", "--log", "--figures", "--json", "--set"]),
    ("compare", ["--strategies", "--seed", "--figures", "--json", "--set"]),
])
def test_help_of_a_command_names_every_option_and_strategy(command, options):
    result = sim(command, "--help")
    assert (result.returncode, result.stderr) == (0, "")
    for word in options + STRATEGIES + ["SCENARIO", "Exit status"]:
        assert word in result.stdout
    assert max(map(len, result.stdout.splitlines())) <= 100


def test_version_is_the_same_everywhere():
    result = sim("--version")
    assert result.returncode == 0
    name, version = result.stdout.split()
    assert name == "berth-sim" and version.count(".") == 2
    assert sim("run", "--version").stdout == result.stdout


def rms(*arguments):
    return summary("run", *arguments)["rms_position_error_m"]


@pytest.mark.parametrize("scenario", ["circle", "eight"])
def test_constrained_tracker_without_active_limits_gives_the_same_log(scenario, tmp_path):
    """From a start on the path, with wheels that can do all that is asked of them."""
    logs = []
    start = {"circle": ("1", "0", "1.5707963"), "eight": ("0", "0", "0.92729522")}[scenario]
    for constrained in ("false", "true"):
        path = tmp_path / f"{constrained}.csv"
        settings = [f"mpc.constrained={constrained}", f"start.x_m={start[0]}",
                    f"start.y_m={start[1]}", f"start.theta_rad={start[2]}", "obstacles=[]"]
        sim("run", scenario, "--log", path,
            *[argument for setting in settings for argument in ("--set", setting)])
        logs.append(path.read_text())
    rows = [[line.split(",") for line in log.splitlines()[1:]] for log in logs]
    assert len(rows[0]) > 500
    assert len(rows[0]) == len(rows[1])
    for one, other in zip(*rows):
        for a, b in zip(one, other):
            assert a == b or abs(float(a) - float(b)) <= 1e-4


@pytest.mark.parametrize(("scenario", "wheels"), [("circle", 6.5), ("eight", 10)])
def test_constrained_tracker_follows_more_than_the_wheels_can_better(scenario, wheels, capsys):
    arguments = [scenario, "--set", "obstacles=[]", "--set", f"robot.wheel_speed_max_radps={wheels}"]
    clipped = rms(*arguments)
    constrained = rms(*arguments, "--set", "mpc.constrained=true")
    with capsys.disabled():
        print(f"\n{scenario}, wheels up to {wheels} rad/s: RMS error {constrained:.4f} m "
              f"constrained, {clipped:.4f} m clipped")
    assert constrained < clipped
