"""berth-board and berth-robot as two processes over a socket: the whole robot in real time.

Times are real, and machines are busy: timeouts are generous, and what is asserted does not depend
on how late a step was.
"""

import json
import os
import pty
import re
import signal
import socket
import subprocess
import time

import pytest

from simulator import sim

BOARD = os.environ["BERTH_BOARD"]
ROBOT = os.environ["BERTH_ROBOT"]
# A busy machine may stop either process for a while; that is not what is tested here.
PATIENT = ["--feedback-timeout", "5000", "--heartbeat-timeout", "3000", "--enable-timeout", "30000",
           "--set", "duration_s=4"]


def start(program, path, drive, *arguments):
    return subprocess.Popen([program, "--can", f"slcan:{path}", "--drive", drive, "--left", "3",
                             "--right", "4", "circle", *map(str, arguments)], text=True,
                            stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def pair(tmp_path, drive, board=(), robot=()):
    """A robot and a board on the two ends of a socket."""
    path = tmp_path / "bus"
    other = start(ROBOT, path, drive, "--set", "duration_s=4", "--json", *robot)
    deadline = time.monotonic() + 20
    while not path.exists():
        assert time.monotonic() < deadline and other.poll() is None
        time.sleep(0.01)
    return start(BOARD, path, drive, *PATIENT, *board), other


def finish(process, timeout=60):
    out, err = process.communicate(timeout=timeout)
    return process.returncode, out, err


@pytest.mark.parametrize("drive", ["odrive", "vesc", "cia402"])
def test_the_two_programs_run_a_scenario(drive, tmp_path):
    log = tmp_path / "record.log"
    board, robot = pair(tmp_path, drive, board=["--json", "--record", log])
    status, out, err = finish(board)
    robot_status, robot_out, robot_err = finish(robot)
    assert (status, err) == (0, "")
    assert (robot_status, robot_err) == (0, "")
    told = json.loads(out)
    assert told["state"] == "idle" and told["fault"] == ""
    assert told["steps"] > 40 and told["received"] > 400
    assert told["malformed"] == told["outbox_dropped"] == told["tx_dropped"] == 0
    assert told["commands_refused"] == 0 and told["foreign"] == 0
    assert json.loads(robot_out)["collisions"] == 0
    again = json.loads(sim("replay", log, "--json").stdout)
    assert again["same"] is True and again["sent"] > 100 and again["state"] == "idle"


def test_a_terminal_shows_how_it_is_going(tmp_path):
    """State, mode, error, clearance and bus load on one line, written over and over."""
    path = tmp_path / "bus"
    robot = start(ROBOT, path, "odrive", "--set", "duration_s=4", "--json")
    deadline = time.monotonic() + 20
    while not path.exists():
        assert time.monotonic() < deadline and robot.poll() is None
        time.sleep(0.01)
    terminal, end = pty.openpty()
    board = subprocess.Popen(
        [BOARD, "--can", f"slcan:{path}", "--drive", "odrive", "--left", "3", "--right", "4",
         "circle", *PATIENT], stdout=subprocess.DEVNULL, stderr=end)
    os.close(end)
    shown = b""
    while True:
        try:
            piece = os.read(terminal, 4096)
        except OSError:  # the other end is closed: the program is over
            break
        if not piece:
            break
        shown += piece
    os.close(terminal)
    assert board.wait(timeout=60) == 0
    finish(robot)
    lines = shown.decode().replace("\x1b[K", "").split("\r")
    running = [line for line in lines if line.startswith("running")]
    assert len(running) >= 5
    assert all(re.fullmatch(r"running +[a-z_]+ +error [\d.]+ m \| clearance (-|-?[\d.]+ m) \| "
                            r"bus +[\d.]+ % \| late \d+\s*", line) for line in running), running
    loads = [float(re.search(r"bus +([\d.]+) %", line)[1]) for line in running[1:]]
    assert 0.5 < max(loads) < 20


def test_an_interrupt_stops_the_robot(tmp_path):
    board, robot = pair(tmp_path, "odrive", board=["--set", "duration_s=60"])
    time.sleep(3)
    board.send_signal(signal.SIGINT)
    status, out, err = finish(board)
    assert (status, err) == (0, "")
    assert out.startswith("circle: done\n") and "control steps late" in out
    finish(robot)


def test_a_lost_peer_is_a_fault_with_its_reason(tmp_path):
    board, robot = pair(tmp_path, "odrive", board=["--set", "duration_s=60"])
    time.sleep(2)
    robot.kill()
    finish(robot)
    status, out, err = finish(board)
    assert status == 1
    assert "fault: CAN interface down or failing" in err
    assert out.startswith("circle: stopped by a fault: CAN interface down or failing\n")


def test_no_drives_is_a_fault_that_says_which(tmp_path):
    path = tmp_path / "bus"
    silent = socket.socket(socket.AF_UNIX)
    silent.bind(str(path))
    silent.listen()
    board = start(BOARD, path, "odrive", "--enable-timeout", "300")
    status, _, err = finish(board)
    silent.close()
    assert status == 1
    assert "fault: left drive: not enabled in time (code 0x1)" in err


@pytest.mark.parametrize("arguments, problem", [
    ([], "--drive is missing"),
    (["--drive", "odrive", "--left", "1", "--right", "2", "circle"], "--can is missing"),
    (["--can", "socketcan:vcan0", "circle"], "--drive is missing"),
    (["--can", "socketcan:vcan0", "--drive", "odrive", "--left", "1", "circle"], "--right is missing"),
    (["--can", "x", "--drive", "odrive", "--left", "1", "--right", "2", "circle"], "socketcan:"),
    (["--can", "socketcan:no-such-interface", "--drive", "odrive", "--left", "1", "--right", "2",
      "circle"], "--can: "),
    (["--can", "socketcan:nocan9", "--drive", "odrive", "--left", "1", "--right", "2", "circle"],
     "nocan9"),
    (["--can", "slcan:x", "--drive", "odrive", "--left", "1", "--right", "1", "circle"], "--right: 1"),
    (["--can", "slcan:x", "--drive", "servo", "--left", "1", "--right", "2", "circle"],
     "odrive, vesc, cia402"),
    (["--can", "slcan:x", "--drive", "odrive", "--left", "1", "--right", "2"], "SCENARIO is missing"),
    (["--can", "slcan:x", "--drive", "odrive", "--left", "1", "--right", "2", "nothing.yaml"],
     "nothing.yaml"),
    (["--can", "slcan:x", "--drive", "odrive", "--left", "1", "--right", "2", "circle", "--set",
      "robot.v_max_mps=-1"], "robot.v_max_mps"),
    (["--can", "slcan:x", "--drive", "odrive", "--left", "1", "--right", "2", "circle", "--set",
      "avoidance.strategy=normal"], "normal"),
    (["--can", "slcan:x", "--drive", "odrive", "--left", "1", "--right", "2", "circle", "--set",
      "plant.untold=0.1"], "plant.untold: 0.1 breaks the clearance condition"),
    (["--can", "slcan:x", "--drive", "odrive", "--left", "1", "--right", "2", "circle",
      "--priority", "100"], "1 to 99"),
    (["--can", "slcan:x", "--drive", "odrive", "--left", "1", "--right", "2", "circle",
      "--following", "nan"], "--following"),
    (["--can", "slcan:x", "--drive", "odrive", "--left", "1", "--right", "2", "circle",
      "--fix-timeout", "1e3"], "--fix-timeout"),
    (["--can", "slcan:x", "--drive", "odrive", "--left", "1", "--right", "2", "circle", "--time",
      "0"], "--time"),
])
def test_bad_usage(arguments, problem, tmp_path):
    result = subprocess.run([BOARD, *arguments], capture_output=True, text=True, timeout=20,
                            cwd=tmp_path, check=False)
    assert (result.returncode, result.stdout) == (2, "")
    assert problem in result.stderr, result.stderr
    assert list(tmp_path.iterdir()) == []


def test_help_names_every_option():
    text = subprocess.run([BOARD, "--help"], capture_output=True, text=True, timeout=20,
                          check=True).stdout
    for option in ("--can", "--drive", "--left", "--record", "--remote", "--fix-timeout",
                   "--following", "--priority", "--gear", "--invert"):
        assert option in text
