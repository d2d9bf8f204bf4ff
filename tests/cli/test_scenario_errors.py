"""Malformed scenarios and references, each through `berth-sim run`: exit status 2, one message that
names file, line, key and allowed range, and nothing written."""

import math
import os
import re
import subprocess

import pytest

SIM = os.environ["BERTH_SIM"]

GOOD = """\
name: good
period_s: 0.05
duration_s: 10
reference:
  shape: circle
  closed: false
robot:
  wheel_radius_m: 0.05
  track_m: 0.30
  v_max_mps: 0.8
  omega_max_radps: 3
  wheel_speed_max_radps: 100
start: {x_m: 0.8, y_m: -0.2, theta_rad: 1.2}
mpc:
  horizon: 20
  q: [10, 40, 1]
  r: [0.5, 0.1]
  discretization: euler
avoidance:
  strategy: combined
  skirt_m: 0.02
  v_creep_mps: 0.05
obstacles:
  - {x_m: 0.073, y_m: 1.027, hard_m: 0.1, conservative_m: 0.2, regulated_m: 0.4}
  - x_m: -0.947
    y_m: -0.25
    hard_m: 0.1
    conservative_m: 0.2
    regulated_m: 0.4
plant:
  tau_s: 0
  a_max_mps2: 0
  alpha_max_radps2: 0
  pose_noise_m: 0
  heading_noise_rad: 0
"""


def run(tmp_path, scenario, name="scenario.yaml"):
    """Runs a scenario given as text or bytes, with every kind of output asked for."""
    out = tmp_path / "out"
    out.mkdir(exist_ok=True)
    path = tmp_path / name
    path.write_bytes(scenario if isinstance(scenario, bytes) else scenario.encode())
    return out, subprocess.run(
        [SIM, "run", str(path), "--log", str(out / "log.csv")],
        capture_output=True, text=True, timeout=60, cwd=out)


def check_refused(out, result, *, file, line, key, allowed):
    """file:line: key: what (allowed: ...), as one line."""
    assert result.returncode == 2, result
    assert result.stdout == ""
    message = result.stderr.rstrip("\n")
    assert "\n" not in message, message
    found = re.search(rf"(?:^|[ /]){re.escape(file)}:(\d+): (.+?): .*\(allowed: (.+)\)$", message)
    assert found, message
    assert int(found[1]) == line, message
    assert found[2] == key, message
    assert allowed in found[3], message
    assert list(out.iterdir()) == []


def test_the_good_scenario_runs(tmp_path):
    out, result = run(tmp_path, GOOD)
    assert result.returncode == 0, result
    assert (out / "log.csv").exists()


# What replaces what in GOOD, then where and what the message says.
BAD_NUMBER = {
    "unit": "2.7m", "nan": "nan", "nan-yaml": ".nan", "infinite": ".inf", "minus-infinite": "-.inf",
    "huge": "1e99", "overflow": "1e999", "hexadecimal": "0x10", "octal": "0o7", "empty": "",
    "tilde": "~", "word": "fast", "bool": "true", "underscore": "1_0", "two-points": "1.2.3",
    "comma": "0,5", "sexagesimal": "1:30", "exponent": "1e", "quoted": '"0.5"', "single": "'0.5'",
    "two": "0.5 0.6", "percent": "5%",
}

EDITS = {
    # unknown keys
    "unknown-top": ("name: good", "name: good\nspeed: 1", 2, "speed", "name, period_s"),
    "unknown-section": ("plant:", "planet:", 30, "planet", "name, period_s"),
    "unknown-robot": ("  track_m:", "  track_mm:", 9, "robot.track_mm", "track_m"),
    "unknown-start": ("theta_rad: 1.2", "theta: 1.2", 13, "start.theta", "x_m, y_m, theta_rad"),
    "unknown-mpc": ("  horizon:", "  horizn:", 15, "mpc.horizn", "horizon, q, r"),
    "unknown-avoidance": ("  skirt_m:", "  skirt:", 21, "avoidance.skirt", "skirt_m"),
    "unknown-reference": ("  closed:", "  close:", 6, "reference.close", "shape, file, closed"),
    "unknown-obstacle": ("    hard_m:", "    radius_m:", 27, "obstacles.1.radius_m", "hard_m"),
    "unknown-plant": ("  tau_s:", "  tau_ms:", 31, "plant.tau_ms", "tau_s"),
    "unknown-merge": ("  shape: circle", "  <<: circle", 5, "reference.<<", "shape"),
    "unknown-empty": ("name: good", "name: good\n'': 1", 2, "''", "name, period_s"),
    "unknown-case": ("  track_m:", "  Track_m:", 9, "robot.Track_m", "track_m"),
    "key-is-a-list": ("name: good", "[a, b]: good", 1, "scenario", "name"),
    "key-is-a-mapping": ("  shape: circle", "  ? {a: b}\n  : circle", 5, "reference", "shape"),
    # missing keys
    "missing-name": ("name: good\n", "", 1, "name", "1 to 255"),
    "missing-period": ("period_s: 0.05\n", "", 1, "period_s", "0.001 to 1"),
    "missing-duration": ("duration_s: 10\n", "", 1, "duration_s", "0.001 to 100000"),
    "missing-shape": ("  shape: circle\n", "", 4, "reference.shape", "exactly one of shape"),
    "missing-radius": ("  wheel_radius_m: 0.05\n", "", 7, "robot.wheel_radius_m", "0.001 to 10"),
    "missing-track": ("  track_m: 0.30\n", "", 7, "robot.track_m", "0.01 to 10"),
    "missing-v": ("  v_max_mps: 0.8\n", "", 7, "robot.v_max_mps", "0.001 to 100"),
    "missing-omega": ("  omega_max_radps: 3\n", "", 7, "robot.omega_max_radps", "0.001 to 100"),
    "missing-start-y": (", y_m: -0.2", "", 13, "start.y_m", "-1000 to 1000"),
    "missing-horizon": ("  horizon: 20\n", "", 14, "mpc.horizon", "1 to 200"),
    "missing-q": ("  q: [10, 40, 1]\n", "", 14, "mpc.q", "3 numbers"),
    "missing-r": ("  r: [0.5, 0.1]\n", "", 14, "mpc.r", "2 numbers"),
    "missing-obstacle-x": ("{x_m: 0.073, ", "{", 24, "obstacles.0.x_m", "-1000 to 1000"),
    "missing-obstacle-g": ("    regulated_m: 0.4\n", "", 25, "obstacles.1.regulated_m",
                           "0.001 to 100"),
    # keys given twice
    "duplicate-top": ("duration_s: 10", "duration_s: 10\nname: again", 4, "name", "once"),
    "duplicate-robot": ("  v_max_mps: 0.8", "  v_max_mps: 0.8\n  track_m: 0.3", 11,
                        "robot.track_m", "once"),
    "duplicate-obstacle": ("    hard_m: 0.1", "    hard_m: 0.1\n    x_m: 1", 28,
                           "obstacles.1.x_m", "once"),
    "duplicate-section": ("plant:", "mpc:", 30, "mpc", "once"),
    "shape-and-file": ("  shape: circle", "  shape: circle\n  file: a.csv", 6, "reference.file",
                       "exactly one of shape"),
    # the wrong kind
    "name-is-a-list": ("name: good", "name: [good]", 1, "name", "1 to 255"),
    "name-is-a-mapping": ("name: good", "name: {good: 1}", 1, "name", "1 to 255"),
    "number-is-a-list": ("  track_m: 0.30", "  track_m: [0.30]", 9, "robot.track_m", "0.01 to 10"),
    "number-is-a-mapping": ("  track_m: 0.30", "  track_m: {m: 0.3}", 9, "robot.track_m",
                            "0.01 to 10"),
    "section-is-a-value": ("reference:\n  shape: circle\n  closed: false", "reference: circle", 4,
                           "reference", "a mapping of shape, file, closed"),
    "section-is-empty": ("reference:\n  shape: circle\n  closed: false", "reference:", 4,
                         "reference", "a mapping of shape"),
    "section-is-a-list": ("start: {x_m: 0.8, y_m: -0.2, theta_rad: 1.2}", "start: [0.8, -0.2, 1.2]",
                          13, "start", "a mapping of x_m, y_m, theta_rad"),
    "q-is-a-number": ("[10, 40, 1]", "10", 16, "mpc.q", "a list of 3 numbers"),
    "q-is-a-mapping": ("[10, 40, 1]", "{a: 10}", 16, "mpc.q", "a list of 3 numbers"),
    "q-is-short": ("[10, 40, 1]", "[10, 40]", 16, "mpc.q", "a list of 3 numbers"),
    "q-is-long": ("[10, 40, 1]", "[10, 40, 1, 2]", 16, "mpc.q", "a list of 3 numbers"),
    "q-is-empty": ("[10, 40, 1]", "[]", 16, "mpc.q", "a list of 3 numbers"),
    "q-is-nested": ("[10, 40, 1]", "[10, [40], 1]", 16, "mpc.q.1", "each 0 to 1000000"),
    "q-has-a-text": ("[10, 40, 1]", "[10, 40, x]", 16, "mpc.q.2", "each 0 to 1000000"),
    "obstacle-is-a-number": ("  - {x_m: 0.073, y_m: 1.027, hard_m: 0.1, conservative_m: 0.2, "
                             "regulated_m: 0.4}", "  - 1", 24, "obstacles.0",
                             "a mapping of x_m, y_m"),
    "bool-is-yes": ("closed: false", "closed: yes", 6, "reference.closed", "true or false"),
    "bool-is-one": ("closed: false", "closed: 1", 6, "reference.closed", "true or false"),
    "bool-is-quoted": ("closed: false", "closed: 'false'", 6, "reference.closed", "true or false"),
    # unknown words
    "shape": ("shape: circle", "shape: square", 5, "reference.shape", "circle or eight"),
    "strategy": ("strategy: combined", "strategy: luck", 20, "avoidance.strategy", "combined"),
    "discretization": ("discretization: euler", "discretization: tustin", 18,
                       "mpc.discretization", "euler or zoh"),
    "constrained-maybe": ("discretization: euler", "constrained: maybe", 18, "mpc.constrained",
                          "true or false"),
    "constrained-zoh": ("discretization: euler", "discretization: zoh\n  constrained: true", 18,
                        "mpc.discretization", "euler"),
    "constrained-far": ("horizon: 20", "horizon: 41\n  constrained: true", 15, "mpc.horizon",
                        "1 to 40"),
    "name-empty": ("name: good", "name:", 1, "name", "1 to 255"),
    "name-long": ("name: good", f"name: {'x' * 256}", 1, "name", "1 to 255"),
    "name-with-tab": ("name: good", 'name: "a\\tb"', 1, "name", "1 to 255"),
    "name-with-zero": ("name: good", 'name: "a\\0b"', 1, "name", "1 to 255"),
    # out of range
    "period-short": ("period_s: 0.05", "period_s: 0.0009", 2, "period_s", "0.001 to 1"),
    "period-long": ("period_s: 0.05", "period_s: 1.1", 2, "period_s", "0.001 to 1"),
    "period-fraction": ("period_s: 0.05", "period_s: 0.0333333333", 2, "period_s",
                        "a whole number of microseconds"),
    "duration-negative": ("duration_s: 10", "duration_s: -1", 3, "duration_s", "0.001 to 100000"),
    "duration-below-period": ("duration_s: 10", "duration_s: 0.04", 3, "duration_s",
                              "0.05 to 50000"),
    "duration-too-many": ("duration_s: 10", "duration_s: 60000", 3, "duration_s", "0.05 to 50000"),
    "radius-zero": ("wheel_radius_m: 0.05", "wheel_radius_m: 0", 8, "robot.wheel_radius_m",
                    "0.001 to 10"),
    "track-in-millimetres": ("track_m: 0.30", "track_m: 300", 9, "robot.track_m", "0.01 to 10"),
    "v-negative": ("v_max_mps: 0.8", "v_max_mps: -0.8", 10, "robot.v_max_mps", "0.001 to 100"),
    "omega-large": ("omega_max_radps: 3", "omega_max_radps: 101", 11, "robot.omega_max_radps",
                    "0.001 to 100"),
    "wheel-speed-zero": ("wheel_speed_max_radps: 100", "wheel_speed_max_radps: 0", 12,
                         "robot.wheel_speed_max_radps", "0.001 to 10000"),
    "start-far": ("start: {x_m: 0.8", "start: {x_m: 1001", 13, "start.x_m", "-1000 to 1000"),
    "start-in-degrees": ("theta_rad: 1.2", "theta_rad: 90", 13, "start.theta_rad",
                         "-6.28318531 to 6.28318531"),
    "horizon-zero": ("horizon: 20", "horizon: 0", 15, "mpc.horizon", "a whole number, 1 to 200"),
    "horizon-long": ("horizon: 20", "horizon: 201", 15, "mpc.horizon", "a whole number, 1 to 200"),
    "horizon-fraction": ("horizon: 20", "horizon: 20.5", 15, "mpc.horizon", "a whole number"),
    "q-negative": ("[10, 40, 1]", "[10, -40, 1]", 16, "mpc.q.1", "each 0 to 1000000"),
    "r-zero": ("[0.5, 0.1]", "[0.5, 0]", 17, "mpc.r.1", "each 1e-06 to 1000000"),
    "skirt-negative": ("skirt_m: 0.02", "skirt_m: -0.02", 21, "avoidance.skirt_m", "0 to 10"),
    "creep-zero": ("v_creep_mps: 0.05", "v_creep_mps: 0", 22, "avoidance.v_creep_mps",
                   "0.001 to 100"),
    "obstacle-far": ("y_m: 1.027", "y_m: -1e4", 24, "obstacles.0.y_m", "-1000 to 1000"),
    "hard-zero": ("    hard_m: 0.1", "    hard_m: 0", 27, "obstacles.1.hard_m", "0.001 to 100"),
    "conservative-is-hard": ("    conservative_m: 0.2", "    conservative_m: 0.1", 28,
                             "obstacles.1.conservative_m", "above 0.1, to 100"),
    "conservative-below-hard": ("    conservative_m: 0.2", "    conservative_m: 0.05", 28,
                                "obstacles.1.conservative_m", "above 0.1, to 100"),
    "regulated-below-skirt": ("    regulated_m: 0.4", "    regulated_m: 0.21", 29,
                              "obstacles.1.regulated_m", "0.22 to 100"),
    "tau-negative": ("tau_s: 0", "tau_s: -0.1", 31, "plant.tau_s", "0 to 10"),
    "acceleration-tiny": ("a_max_mps2: 0", "a_max_mps2: 1e-9", 32, "plant.a_max_mps2",
                          "0, or 0.001 to 1000"),
    "noise-large": ("pose_noise_m: 0", "pose_noise_m: 1.5", 34, "plant.pose_noise_m", "0 to 1"),
    "slip-large": ("tau_s: 0", "slip: 0.6", 31, "plant.slip", "0 to 0.5"),
    "pose-delay-long": ("tau_s: 0", "pose_delay_s: 0.6", 31, "plant.pose_delay_s", "0 to 0.5"),
    "watchdog-negative": ("tau_s: 0", "watchdog_s: -1", 31, "plant.watchdog_s", "0 to 10"),
    "untold-large": ("tau_s: 0", "untold: 1.1", 31, "plant.untold", "0 to 1"),
    "heading-noise-large": ("heading_noise_rad: 0", "heading_noise_rad: 3.2", 35,
                            "plant.heading_noise_rad", "0 to 3.14159265"),
    # what YAML has and scenarios have not
    "anchor": ("shape: circle", "shape: &s circle", 5, "yaml", "plain keys and values"),
    "anchored-section": ("robot:", "robot: &r", 7, "yaml", "plain keys and values"),
    "alias": ("shape: circle", "shape: *s", 5, "yaml", "plain keys and values"),
    "tag": ("track_m: 0.30", "track_m: !!float 0.30", 9, "yaml", "plain keys and values"),
    "own-tag": ("mpc:", "mpc: !weights", 14, "yaml", "plain keys and values"),
    "second-document": ("  heading_noise_rad: 0\n", "  heading_noise_rad: 0\n---\nname: b\n", 36,
                        "yaml", "one"),
    "no-colon": ("period_s: 0.05", "period_s 0.05", 3, "yaml", "YAML"),
    "tab-indent": ("  shape: circle", "\tshape: circle", 5, "yaml", "YAML"),
    "open-bracket": ("[10, 40, 1]", "[10, 40, 1", 16, "mpc.q.2", "a list of 3 numbers"),
    "lone-bracket": ("[10, 40, 1]", "[10, 40, 1]]", 16, "yaml", "YAML"),
    "open-quote": ("heading_noise_rad: 0", 'heading_noise_rad: "0', 36, "yaml", "YAML"),
    "bad-indent": ("  track_m: 0.30", " track_m: 0.30", 9, "yaml", "YAML"),
    "control-character": ("shape: circle", "shape: cir\x01cle", 5, "yaml", "UTF-8"),
}


@pytest.mark.parametrize("edit", EDITS.values(), ids=EDITS.keys())
def test_edits(tmp_path, edit):
    old, new, line, key, allowed = edit
    assert GOOD.count(old) == 1
    out, result = run(tmp_path, GOOD.replace(old, new))
    check_refused(out, result, file="scenario.yaml", line=line, key=key, allowed=allowed)


@pytest.mark.parametrize("text", BAD_NUMBER.values(), ids=BAD_NUMBER.keys())
def test_what_is_no_number(tmp_path, text):
    out, result = run(tmp_path, GOOD.replace("  v_max_mps: 0.8", f"  v_max_mps: {text}"))
    check_refused(out, result, file="scenario.yaml", line=10, key="robot.v_max_mps",
                  allowed="0.001 to 100")


WHOLE = {
    "empty": (b"", 1, "scenario", "a mapping"),
    "comment-only": (b"# nothing\n", 2, "scenario", "a mapping"),
    "a-list": (b"- 1\n- 2\n", 1, "scenario", "a mapping"),
    "a-word": (b"circle\n", 1, "scenario", "a mapping"),
    "empty-mapping": (b"{}\n", 1, "name", "1 to 255"),
    "latin-1": (GOOD.encode().replace(b"circle", b"c\xe9rcle"), 5, "yaml", "UTF-8"),
    "utf-16": (GOOD.encode("utf-16"), 1, "yaml", "UTF-8"),
    "binary": (bytes(range(256)), 1, "yaml", "UTF-8"),
    "zero-bytes": (GOOD.encode() + b"\0\0\0", 36, "yaml", "UTF-8"),
    "deep": (b"name: " + b"[" * 1000, 1, "name", "1 to 255"),
    "obstacles-are-a-number": (re.sub(r"obstacles:\n(  .*\n)+", "obstacles: 2\n", GOOD).encode(), 23,
                               "obstacles", "a list of 0 to 16 obstacles"),
    "obstacles-are-nothing": (re.sub(r"obstacles:\n(  .*\n)+", "obstacles:\n", GOOD).encode(), 23,
                              "obstacles", "a list of 0 to 16 obstacles"),
    "obstacles-are-a-mapping": (GOOD.encode().replace(b"  - {", b"  a: {").split(b"  - x_m")[0], 24,
                                "obstacles", "a list of 0 to 16 obstacles"),
}


@pytest.mark.parametrize("case", WHOLE.values(), ids=WHOLE.keys())
def test_whole_files(tmp_path, case):
    text, line, key, allowed = case
    out, result = run(tmp_path, text)
    check_refused(out, result, file="scenario.yaml", line=line, key=key, allowed=allowed)


def test_too_many_obstacles(tmp_path):
    one = "  - {x_m: 50, y_m: 50, hard_m: 0.1, conservative_m: 0.2, regulated_m: 0.4}\n"
    head = GOOD.split("obstacles:\n")[0] + "obstacles:\n"
    out, result = run(tmp_path, head + one * 17)
    check_refused(out, result, file="scenario.yaml", line=40, key="obstacles", allowed="0 to 16")
    out, result = run(tmp_path, head + one * 16)
    assert result.returncode == 0, result


def test_a_nearest_key_is_suggested(tmp_path):
    _, result = run(tmp_path, GOOD.replace("  v_max_mps:", "  v_mx_mps:"))
    assert "did you mean robot.v_max_mps?" in result.stderr
    _, result = run(tmp_path, GOOD.replace("name: good", "name: good\nv_max: 1"))
    assert "did you mean robot.v_max_mps?" in result.stderr
    _, result = run(tmp_path, GOOD.replace("name: good", "name: good\nbanana: 1"))
    assert "did you mean" not in result.stderr


def check_no_file(out, result, name, allowed):
    assert result.returncode == 2, result
    assert result.stdout == ""
    assert name in result.stderr
    assert "(allowed: " in result.stderr and allowed in result.stderr
    assert list(out.iterdir()) == []


def test_files_that_cannot_be_read(tmp_path):
    out = tmp_path / "out"
    out.mkdir()

    def start(path):
        return subprocess.run([SIM, "run", str(path), "--log", str(out / "log.csv")],
                              capture_output=True, text=True, timeout=60)

    check_no_file(out, start(tmp_path / "absent.yaml"), "absent.yaml", "YAML file")
    check_no_file(out, start(tmp_path), tmp_path.name, "YAML file")
    large = tmp_path / "large.yaml"
    large.write_text(GOOD + "#" * (1 << 20))
    check_no_file(out, start(large), "large.yaml", "1048576 bytes")


# --- references -------------------------------------------------------------------------------

HEADER = "t,x,y,theta,v,omega"


def circle_rows(count=120, period=0.05):
    """Circle of radius 1 at 0.3 rad/s, as cells."""
    rows = []
    for k in range(count):
        t = period * k
        theta = math.remainder(0.3 * t + math.pi / 2, 2 * math.pi)
        rows.append([f"{t:.6f}", f"{math.cos(0.3 * t):.9f}", f"{math.sin(0.3 * t):.9f}",
                     f"{theta:.9f}", "0.3", "0.3"])
    return rows


def csv_text(rows, header=HEADER):
    return "\n".join([header] + [",".join(row) for row in rows]) + "\n"


def run_reference(tmp_path, text, closed="false"):
    reference = tmp_path / "path.csv"
    reference.write_bytes(text if isinstance(text, bytes) else text.encode())
    scenario = GOOD.replace("shape: circle", "file: path.csv").replace(
        "closed: false", f"closed: {closed}")
    return run(tmp_path, scenario)


def test_the_good_reference_runs(tmp_path):
    _, result = run_reference(tmp_path, csv_text(circle_rows()))
    assert result.returncode == 0, result


def cell(row, column, text):
    """A good reference with one other cell; row 0 stands in line 2."""
    rows = circle_rows()
    rows[row][column] = text
    return csv_text(rows)


def scaled(column, factor):
    rows = circle_rows()
    for row in rows:
        row[column] = str(float(row[column]) * factor)
    return csv_text(rows)


def without(row):
    rows = circle_rows()
    del rows[row]
    return csv_text(rows)


REFERENCES = {
    "header-missing": (csv_text(circle_rows(), "0,1,0,1.5708,0.3,0.3"), 1, "column 1 (t)", HEADER),
    "header-order": (csv_text(circle_rows(), "t,y,x,theta,v,omega"), 1, "column 1 (t)", HEADER),
    "header-spaces": (csv_text(circle_rows(), "t, x, y, theta, v, omega"), 1, "column 1 (t)", HEADER),
    "header-semicolons": (csv_text(circle_rows(), "t;x;y;theta;v;omega"), 1, "column 1 (t)", HEADER),
    "file-empty": ("", 1, "column 1 (t)", HEADER),
    "no-rows": (HEADER + "\n", 2, "column 1 (t)", "1 to 1000000"),
    "few-columns": (HEADER + "\n0,1,0,1.5708,0.3\n", 2, "column 6 (omega)", HEADER),
    "many-columns": (HEADER + "\n0,1,0,1.5708,0.3,0.3,1\n", 2, "column 7", HEADER),
    "blank-line": (csv_text(circle_rows()[:5]) + "\n" + ",".join(circle_rows()[5]) + "\n", 7,
                   "column 1 (t)", HEADER),
    "comment": (csv_text(circle_rows()[:5]) + "# end\n", 7, "column 1 (t)", "0 to 1000000"),
    "cell-empty": (cell(3, 1, ""), 5, "column 2 (x)", "-1000 to 1000"),
    "cell-word": (cell(3, 2, "north"), 5, "column 3 (y)", "-1000 to 1000"),
    "cell-nan": (cell(4, 1, "nan"), 6, "column 2 (x)", "-1000 to 1000"),
    "cell-infinite": (cell(4, 4, "inf"), 6, "column 5 (v)", "-100 to 100"),
    "cell-overflow": (cell(4, 5, "1e999"), 6, "column 6 (omega)", "-100 to 100"),
    "cell-unit": (cell(4, 4, "0.3m/s"), 6, "column 5 (v)", "-100 to 100"),
    "cell-hexadecimal": (cell(4, 4, "0x1p-2"), 6, "column 5 (v)", "-100 to 100"),
    "cell-space": (cell(4, 4, " 0.3"), 6, "column 5 (v)", "-100 to 100"),
    "cell-quoted": (cell(4, 4, '"0.3"'), 6, "column 5 (v)", "-100 to 100"),
    "x-far": (cell(7, 1, "1000.5"), 9, "column 2 (x)", "-1000 to 1000"),
    "theta-large": (cell(7, 3, "1e6"), 9, "column 4 (theta)", "-1000 to 1000"),
    "v-large": (cell(7, 4, "-101"), 9, "column 5 (v)", "-100 to 100"),
    "omega-large": (cell(7, 5, "101"), 9, "column 6 (omega)", "-100 to 100"),
    "time-late": (cell(0, 0, "0.05"), 2, "column 1 (t)", "0 within 1e-06"),
    "time-negative": (cell(0, 0, "-0.05"), 2, "column 1 (t)", "0 to 1000000"),
    "time-gap": (without(20), 22, "column 1 (t)", "1 within 1e-06"),
    "time-jitter": (cell(20, 0, "1.00001"), 22, "column 1 (t)", "1 within 1e-06"),
    "time-twice": (cell(20, 0, "0.95"), 22, "column 1 (t)", "1 within 1e-06"),
    "other-period": (csv_text(circle_rows(period=0.1)), 3, "column 1 (t)", "0.05 within 1e-06"),
    "v-ten-percent": (scaled(4, 1.1), 2, "column 5 (v)", " to "),
    "omega-ten-percent": (scaled(5, 0.9), 2, "column 6 (omega)", " to "),
    "v-in-one-row": (cell(30, 4, "0.35"), 32, "column 5 (v)", " to "),
    "omega-in-one-row": (cell(30, 5, "-0.3"), 32, "column 6 (omega)", " to "),
    "omega-sign": (scaled(5, -1), 2, "column 6 (omega)", " to "),
    "mirrored": (scaled(3, -1), 2, "column 5 (v)", " to "),
    "zero-byte": (cell(5, 1, "1\x000"), 7, "column 1 (t)", "printable"),
    "long-line": (cell(5, 1, "1" * 600), 7, "column 1 (t)", "printable"),
    "binary": (bytes(range(256)), 1, "column 1 (t)", HEADER),
}


@pytest.mark.parametrize("case", REFERENCES.values(), ids=REFERENCES.keys())
def test_references(tmp_path, case):
    text, line, key, allowed = case
    out, result = run_reference(tmp_path, text)
    check_refused(out, result, file="path.csv", line=line, key=key, allowed=allowed)


def test_a_reference_that_does_not_close(tmp_path):
    out, result = run_reference(tmp_path, csv_text(circle_rows()), closed="true")
    check_refused(out, result, file="path.csv", line=121, key="column 2 (x)", allowed="0 to ")


def test_a_reference_that_is_not_there(tmp_path):
    out, result = run(tmp_path, GOOD.replace("shape: circle", "file: path.csv"))
    check_refused(out, result, file="scenario.yaml", line=5, key="reference.file",
                  allowed="readable CSV file")


def test_a_reference_path_that_is_too_long(tmp_path):
    out, result = run(tmp_path, GOOD.replace("shape: circle", f"file: {'x' * 255}"))
    check_refused(out, result, file="scenario.yaml", line=5, key="reference.file", allowed="255")


# --- what only the controller can tell --------------------------------------------------------

CONTROLLER = {
    "turn-per-period": (("omega_max_radps: 3", "omega_max_radps: 32"), "robot.omega_max_radps"),
    "clearance": (("    conservative_m: 0.2", "    conservative_m: 0.13"),
                  "obstacles.1.conservative_m"),
}


@pytest.mark.parametrize("case", CONTROLLER.values(), ids=CONTROLLER.keys())
def test_refused_by_the_controller(tmp_path, case):
    edit, key = case
    assert GOOD.count(edit[0]) == 1
    out, result = run(tmp_path, GOOD.replace(*edit))
    assert result.returncode == 2, result
    assert key in result.stderr and "(allowed: " in result.stderr, result.stderr
    assert list(out.iterdir()) == []


# --- --set ------------------------------------------------------------------------------------

SETS = {
    "no-value": ("robot.v_max_mps", "robot.v_max_mps", "KEY=VALUE"),
    "unknown": ("robot.speed=1", "robot.speed", "v_max_mps"),
    "no-number": ("robot.v_max_mps=0.6m", "robot.v_max_mps", "0.001 to 100"),
    "out-of-range": ("mpc.horizon=0", "mpc.horizon", "1 to 200"),
    "no-list": ("mpc.q=10", "mpc.q", "a list of 3 numbers"),
    "no-obstacle": ("obstacles.9.x_m=1", "obstacles.9", "obstacles.0 to obstacles.2"),
    "radii": ("obstacles.0.conservative_m=0.1", "obstacles.0.conservative_m", "above 0.1, to 100"),
    "duration": ("duration_s=0.01", "duration_s", "0.05 to 50000"),
}


@pytest.mark.parametrize("case", SETS.values(), ids=SETS.keys())
def test_sets(tmp_path, case):
    assignment, key, allowed = case
    result = subprocess.run(
        [SIM, "run", "circle", "--set", assignment, "--log", str(tmp_path / "log.csv")],
        capture_output=True, text=True, timeout=60)
    assert result.returncode == 2, result
    assert result.stdout == ""
    assert key in result.stderr and allowed in result.stderr, result.stderr
    assert list(tmp_path.iterdir()) == []
