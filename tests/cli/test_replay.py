"""Records of a board, done again: every frame that was sent is sent again, or the place is named."""

import json
import re

import can
import cantools
import pytest

from simulator import ROOT, sim

DRIVES = ["odrive", "vesc", "cia402"]


def record(path, *arguments, scenario="circle"):
    result = sim("run", scenario, "--bus", "loop", "--record", path, "--set", "duration_s=6",
                 *arguments)
    assert (result.returncode, result.stderr) == (0, "")
    return path.read_text().splitlines(keepends=True)


def replay(path, status=0):
    result = sim("replay", path, "--json")
    assert (result.returncode, result.stderr) == (status, "")
    return json.loads(result.stdout)


@pytest.mark.parametrize("drive", DRIVES)
def test_a_record_is_done_again_bit_for_bit(drive, tmp_path):
    path = tmp_path / "run.log"
    lines = record(path, "--drive", drive, "--set", "plant.pose_noise_m=0.002", "--seed", "5")
    result = replay(path)
    sent = sum(line.endswith(" T\n") for line in lines)
    received = sum(line.endswith(" R\n") for line in lines)
    assert result["same"] is True and result["difference"] is None and result["cut"] is False
    assert (result["sent"], result["received"]) == (sent, received)
    assert sent > 300 and result["state"] == "idle"


@pytest.mark.parametrize("extra", [
    ("--left", "7", "--right", "3", "--gear", "12.5", "--invert", "both", "--address", "200"),
    ("--fix-period", "0"),
    ("--obstacles", "bus"),
    ("--feedback-timeout", "250", "--heartbeat-timeout", "700", "--enable-timeout", "3000"),
    ("--drive", "vesc", "--pole-pairs", "11"),
    ("--drive", "cia402", "--counts-per-turn", "65536", "--velocity-units", "60", "--mode", "9",
     "--master", "3"),
    ("--drive", "cia402", "--no-position", "--invert", "left"),
])
def test_the_set_up_is_in_the_record(extra, tmp_path):
    path = tmp_path / "run.log"
    record(path, *extra)
    assert replay(path)["same"] is True


def change(lines, number, old, new):
    """The lines with the first data byte of one of them changed."""
    assert re.search(old, lines[number])
    changed = lines.copy()
    changed[number] = re.sub(old, new, lines[number], count=1)
    return changed


def frames(lines, direction):
    return [number for number, line in enumerate(lines) if line.endswith(f" {direction}\n")]


def test_a_changed_frame_is_named(tmp_path):
    path = tmp_path / "run.log"
    lines = record(path)
    sent = frames(lines, "T")
    which = len(sent) // 2
    number = sent[which]
    old = re.search(r"#(\w*)", lines[number])[1]
    new = ("1" if old[0] == "0" else "0") + old[1:]
    changed = lines.copy()
    changed[number] = lines[number].replace("#" + old, "#" + new)
    path.write_text("".join(changed))
    difference = replay(path, status=1)["difference"]
    assert difference["frame"] == which + 1
    assert difference["line"] == number + 1
    assert new in difference["what"] and old in difference["what"]
    text = sim("replay", path)
    assert text.returncode == 1
    assert text.stdout.startswith(f"{path}:{number + 1}: differs at sent frame {which + 1}: ")


@pytest.mark.parametrize("direction", ["T", "R"])
def test_a_missing_or_doubled_frame_is_found(direction, tmp_path):
    path = tmp_path / "run.log"
    lines = record(path)
    number = frames(lines, direction)[200]
    path.write_text("".join(lines[:number] + lines[number + 1:]))
    assert replay(path, status=1)["difference"]["line"] >= number + 1
    path.write_text("".join(lines[:number + 1] + lines[number:]))
    if direction == "T":
        assert replay(path, status=1)["difference"]["line"] >= number + 1


def test_what_the_board_heard_matters(tmp_path):
    """A feedback frame with another speed leads to another command later."""
    path = tmp_path / "run.log"
    lines = record(path)
    heard = [n for n in frames(lines, "R") if re.search(r" 0(29|49)#", lines[n])]
    number = heard[len(heard) // 2]
    changed = lines.copy()
    changed[number] = re.sub(r"#\w{8}", "#0000C842", lines[number])
    path.write_text("".join(changed))
    assert replay(path, status=1)["difference"]["line"] > number


def test_a_record_that_was_cut_is_good_up_to_there(tmp_path):
    path = tmp_path / "run.log"
    lines = record(path)
    text = "".join(lines)
    cuts = 0
    for share in range(30, 100, 5):
        for shift in range(0, 40, 13):
            path.write_text(text[:len(text) * share // 100 + shift])
            result = replay(path)
            assert result["same"] is True
            cuts += result["cut"]
    assert cuts > 0


@pytest.mark.parametrize("text, problem", [
    ("", "no record"),
    ("hello\n", ":1: no time"),
    ("(1.000000) can0 123#00\n", "no record"),
    ("(1.000000) berth 000#\n", "no record"),
    ("(1.000000) berth 010#0A0A\n", "options are not good|set-up is not whole|empty|name"),
    ("(1.000000) berth 010#2D2D780A0A\n", "options are not good"),
])
def test_what_is_no_record_is_refused(text, problem, tmp_path):
    path = tmp_path / "bad.log"
    path.write_text(text)
    result = sim("replay", path)
    assert (result.returncode, result.stdout) == (2, "")
    assert re.search(problem, result.stderr), result.stderr
    assert str(path) in result.stderr


def test_garbage_within_a_record_is_refused_with_its_line(tmp_path):
    path = tmp_path / "run.log"
    lines = record(path)
    lines[500] = "what is this\n"
    path.write_text("".join(lines))
    result = sim("replay", path)
    assert result.returncode == 2
    assert f"{path}:501: no time" in result.stderr


def test_another_reference_is_noticed(tmp_path):
    csv = tmp_path / "path.csv"
    rows = ["t,x,y,theta,v,omega"] + [f"{0.05 * k:.2f},{0.01 * k:.2f},0,0,0.2,0"
                                      for k in range(120)]
    csv.write_text("\n".join(rows) + "\n")
    scene = tmp_path / "scene.yaml"
    scene.write_text("name: line\nperiod_s: 0.05\nduration_s: 6\nreference: {file: path.csv}\n"
                     "robot: {wheel_radius_m: 0.05, track_m: 0.3, v_max_mps: 0.8, "
                     "omega_max_radps: 3}\n")
    path = tmp_path / "run.log"
    record(path, scenario=scene)
    assert replay(path)["same"] is True
    csv.write_text("\n".join(rows).replace(",0.06,0,0,0.2,0", ",0.0601,0,0,0.2,0") + "\n")
    result = sim("replay", path)
    assert result.returncode == 2 and "the plan is not the one" in result.stderr
    csv.unlink()
    assert sim("replay", path).returncode == 2


def test_usage(tmp_path):
    assert "FILE is missing" in sim("replay").stderr
    assert "more than one FILE" in sim("replay", "a", "b").stderr
    missing = sim("replay", tmp_path / "none.log")
    assert missing.returncode == 2 and "No such file" in missing.stderr
    assert "with --bus loop" in sim("run", "circle", "--record", tmp_path / "x").stderr
    bad = sim("run", "circle", "--bus", "loop", "--record", tmp_path / "no" / "x")
    assert bad.returncode == 2 and "cannot write" in bad.stderr
    full = sim("run", "circle", "--bus", "loop", "--record", "/dev/full")
    assert full.returncode == 2 and "cannot write all" in full.stderr


def test_other_tools_read_the_record(tmp_path):
    """python-can reads every line; cantools knows every frame of ours and of the drives."""
    path = tmp_path / "run.log"
    lines = record(path, "--left", "0", "--right", "1")
    messages = list(can.CanutilsLogReader(str(path)))
    assert len(messages) == len(lines)
    berth = cantools.database.load_file(ROOT / "tools/berth.dbc")
    odrive = cantools.database.load_file(ROOT / "tools/odrive.dbc")
    decoded = set()
    for message in messages:
        if message.channel != "loop":
            assert message.channel == "berth"
            continue
        database = berth if message.is_extended_id else odrive
        frame = database.get_message_by_frame_id(message.arbitration_id)
        assert frame.length == len(message.data) or frame.name.startswith("Heartbeat")
        frame.decode(bytes(message.data))
        decoded.add(frame.name)
    assert len(decoded) >= 10, decoded
