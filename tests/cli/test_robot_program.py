"""berth-robot against a board made of a few lines of Python, over a socket in the Lawicel protocol.

The board here commands what the test says; what is looked at is the robot's side: frames, the run's
begin and end, the summary, the exit status. Times are real.
"""

import json
import math
import os
import signal
import socket
import struct
import subprocess
import threading
import time

import pytest

from simulator import COLUMNS, SUMMARY_KEYS, read_log

ROBOT = os.environ["BERTH_ROBOT"]
LEFT, RIGHT, ADDRESS = 5, 6, 9
PERIOD_S = 0.05
IDLE, ARMED, RUNNING, STOPPING, FAULT = 0, 2, 3, 4, 5
STATUS, POSE_FIX, OBSTACLE = 0x18B200, 0x04B201, 0x04B202


class Board:
    """The other end of the line, connected to a robot that listens at path."""

    def __init__(self, path):
        self.frames = []  # (time, id, extended, data)
        self.line = socket.socket(socket.AF_UNIX)
        deadline = time.monotonic() + 20
        while True:
            try:
                self.line.connect(str(path))
                break
            except OSError:
                assert time.monotonic() < deadline, "the robot does not listen"
                time.sleep(0.01)
        self.reader = threading.Thread(target=self.read, daemon=True)
        self.reader.start()

    def close(self):
        try:
            self.line.shutdown(socket.SHUT_RDWR)
        except OSError:
            pass
        self.line.close()

    def read(self):
        text = b""
        while True:
            try:
                piece = self.line.recv(4096)
            except OSError:
                return
            if not piece:
                return
            *lines, text = (text + piece).split(b"\r")
            for line in lines:
                if line[:1] in b"tT" and line:
                    digits = 8 if line[:1] == b"T" else 3
                    data = bytes.fromhex(line[digits + 2 :].decode())
                    self.frames.append(
                        (time.monotonic(), int(line[1 : digits + 1], 16), digits == 8, data)
                    )

    def send(self, identifier, data, extended=False):
        head = f"T{identifier:08X}" if extended else f"t{identifier:03X}"
        self.line.sendall(f"{head}{len(data)}{data.hex().upper()}\r".encode())

    def enable(self):
        for node in (LEFT, RIGHT):
            self.send(node << 5 | 0x0B, struct.pack("<II", 2, 1))
            self.send(node << 5 | 0x07, struct.pack("<I", 8))

    def wheels(self, turns_per_s):
        for node in (LEFT, RIGHT):
            self.send(node << 5 | 0x0D, struct.pack("<ff", turns_per_s, 0))

    def status(self, state, total=0, fault=0):
        data = bytes([state, fault]) + total.to_bytes(3, "little") + bytes([0, 0xFF, 0xFF])
        self.send(STATUS << 8 | ADDRESS, data, extended=True)

    def drive(self, periods, turns_per_s=0.5):
        """A run of so many periods, all straight on."""
        self.enable()
        begin = time.monotonic()
        for k in range(periods):
            self.wheels(turns_per_s)
            self.status(RUNNING, k)
            time.sleep(max(0.0, begin + (k + 1) * PERIOD_S - time.monotonic()))

    def of_kind(self, kind):
        return [frame for frame in self.frames if frame[1] == kind << 8 | ADDRESS and frame[2]]

    def wait_for(self, kind, count=1):
        deadline = time.monotonic() + 20
        while len(self.of_kind(kind)) < count:
            assert time.monotonic() < deadline, f"kind {kind:x} does not come"
            time.sleep(0.01)


class Robot:
    def __init__(self, folder, *arguments, scenario="circle"):
        self.path = folder / "bus"
        self.process = subprocess.Popen(
            [ROBOT, "--can", f"slcan:{self.path}", "--drive", "odrive", "--left", str(LEFT),
             "--right", str(RIGHT), "--address", str(ADDRESS), "--json", *map(str, arguments),
             scenario],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def end(self, status, error=""):
        out, err = self.process.communicate(timeout=60)
        assert (self.process.returncode, err) == (status, error)
        return json.loads(out)


@pytest.fixture
def start(tmp_path):
    """Starts a robot and a board on its line; both are gone after the test."""
    parts = []

    def start_both(*arguments, **options):
        robot = Robot(tmp_path, *arguments, **options)
        parts.append(robot)
        board = Board(robot.path)
        parts.append(board)
        return robot, board

    yield start_both
    for part in reversed(parts):
        if isinstance(part, Board):
            part.close()
        elif part.process.poll() is None:
            part.process.kill()
            part.process.communicate()


SHORT = ("--set", "duration_s=1", "--set", "obstacles=[]")


def test_a_whole_run(start, tmp_path):
    robot, board = start(*SHORT, "--log", tmp_path / "log.csv")
    board.wait_for(POSE_FIX)
    board.drive(21)
    board.wheels(0.0)
    board.status(IDLE)
    result = robot.end(0)
    bus = result["bus"]
    assert list(result) == [*SUMMARY_KEYS, "bus"]
    assert (result["steps"], result["collisions"]) == (20, 0)
    assert (bus["run"], bus["state"], bus["fault"], bus["dropped"]) == ("done", "idle", 0, 0)
    assert bus["statuses"] == 22
    assert bus["timing"]["waits"] > 50
    # 0.5 turns/s of a wheel of 0.05 m, on the heading of 1.2
    header, rows = read_log(tmp_path / "log.csv")
    assert header == COLUMNS and len(rows) == 20
    first, last = ([float(x) for x in row[1:3]] for row in (rows[0], rows[-1]))
    speed = 0.5 * 2 * math.pi * 0.05
    way = math.dist(first, last)
    assert way == pytest.approx(19 * PERIOD_S * speed, abs=0.02)
    assert math.atan2(last[1] - first[1], last[0] - first[0]) == pytest.approx(1.2, abs=0.02)


def test_fixes_and_feedback_come_at_their_pace(start):
    robot, board = start(*SHORT, "--fix-period", 50)
    board.wait_for(POSE_FIX, 41)
    fixes = board.of_kind(POSE_FIX)
    assert fixes[40][0] - fixes[0][0] == pytest.approx(2.0, abs=0.5)
    x = int.from_bytes(fixes[0][3][0:3], "little", signed=True)
    y = int.from_bytes(fixes[0][3][3:6], "little", signed=True)
    theta = int.from_bytes(fixes[0][3][6:8], "little", signed=True)
    assert (x, y, theta) == (8000, -2000, 12000)
    feedback = [f for f in board.frames if f[1] == LEFT << 5 | 0x09]
    assert 150 < len(feedback) < 260
    robot.process.send_signal(signal.SIGINT)
    robot.end(1, "berth-robot: interrupted\n")


def test_obstacles_are_told_when_asked_for(start):
    robot, board = start("--obstacles", "bus")
    board.wait_for(OBSTACLE, 6)
    assert sorted({frame[3][0] for frame in board.of_kind(OBSTACLE)}) == [0, 1, 2]
    robot.process.send_signal(signal.SIGTERM)
    robot.end(1, "berth-robot: interrupted\n")


def test_a_collision_is_1(start):
    """Straight on from 10 cm before an obstacle."""
    robot, board = start("--set", "duration_s=1", "--set", "start.x_m=-0.17", "--set",
                         "start.y_m=1.027", "--set", "start.theta_rad=0")
    board.wait_for(POSE_FIX)
    board.drive(21, turns_per_s=1.0)
    board.wheels(0.0)
    board.status(IDLE)
    result = robot.end(1)
    assert result["collisions"] == 1 and result["min_clearance_m"] < -0.05
    assert result["bus"]["run"] == "done"


def test_a_collision_after_the_run_is_1_too(start):
    robot, board = start("--set", "duration_s=1", "--set", "start.x_m=-0.12", "--set",
                         "start.y_m=1.027", "--set", "start.theta_rad=0")
    board.wait_for(POSE_FIX)
    board.drive(21, turns_per_s=0.0)
    for _ in range(10):
        board.wheels(2.0)
        board.status(STOPPING, 20)
        time.sleep(PERIOD_S)
    board.wheels(0.0)
    board.status(IDLE)
    result = robot.end(1)
    assert result["collisions"] == 0 and result["min_clearance_m"] > 0
    assert result["bus"]["clearance_m"] < 0


def test_a_board_in_fault_is_1_and_the_fault_is_told(start):
    robot, board = start(*SHORT)
    board.wait_for(POSE_FIX)
    board.drive(5)
    board.wheels(0.0)
    board.status(FAULT, 5, 6)
    result = robot.end(1)
    assert result["steps"] in (4, 5)
    assert result["bus"]["run"] == "left"
    assert (result["bus"]["fault"], result["bus"]["state"]) == (6, "fault")


def test_a_board_that_falls_silent_is_1(start):
    robot, board = start(*SHORT, "--set", "duration_s=20")
    board.wait_for(POSE_FIX)
    board.drive(5)
    result = robot.end(1)
    assert result["bus"]["run"] == "silent"
    # the drives' own watchdogs stop the wheels
    assert [drive["watchdog_stops"] for drive in result["bus"]["drives"]] == [1, 1]


def test_a_line_that_is_lost_and_found_again(start):
    robot, board = start(*SHORT)
    board.wait_for(POSE_FIX)
    board.close()
    time.sleep(0.5)
    again = Board(robot.path)
    try:
        again.wait_for(POSE_FIX)
        again.drive(21)
        again.wheels(0.0)
        again.status(IDLE)
        assert robot.end(0)["bus"]["can"]["failures"] > 0
    finally:
        again.close()


def test_without_a_board_it_gives_up(tmp_path):
    began = time.monotonic()
    robot = Robot(tmp_path, "--timeout", 1, "--log", tmp_path / "log.csv")
    result = robot.end(1, f"berth-robot: no board is heard on slcan:{robot.path}\n")
    assert 0.9 < time.monotonic() - began < 15
    assert (result["steps"], result["bus"]["run"]) == (0, "waiting")
    assert len(read_log(tmp_path / "log.csv")[1]) == 0
    assert not robot.path.exists()


BASE = ("--drive", "odrive", "--left", "1", "--right", "2")
BAD_USAGE = [
    (("circle",), ["--drive is missing"]),
    (("--drive", "odrive", "circle"), ["--left is missing"]),
    (("--drive", "odrive", "--left", "1", "circle"), ["--right is missing"]),
    ((*BASE, "circle"), ["--can is missing", "socketcan:", "slcan:"]),
    ((*BASE, "--can", "slcan:x"), ["SCENARIO is missing"]),
    ((*BASE, "--can", "slcan:x", "circle", "eight"), ["more than one SCENARIO", "'eight'"]),
    ((*BASE, "--can", "can0", "circle"), ["--can", "'can0'", "socketcan:", "slcan:"]),
    ((*BASE, "--can", "slcan:none/x", "circle"), ["--can", "none/x"]),
    ((*BASE, "--can", "slcan:x", "circel"), ["'circel'", "circle, eight or a YAML file"]),
    ((*BASE, "--can", "slcan:x", "--set", "speed=1", "circle"), ["--set", "speed"]),
    ((*BASE, "--can", "slcan:x", "--seed", "-1", "circle"), ["--seed", "'-1'"]),
    ((*BASE, "--can", "slcan:x", "--timeout", "0", "circle"), ["--timeout", "'0'", "1 to 86400"]),
    ((*BASE, "--can", "slcan:x", "--left", "2", "circle"), ["--right", "2"]),
    ((*BASE, "--can", "slcan:x", "--log", "none/log", "circle"), ["none/log"]),
    ((*BASE, "--can", "slcan:x", "--set", "avoidance.strategy=adaptive", "circle"),
     ["'adaptive'", "none, conservative, combined"]),
]


@pytest.mark.parametrize("arguments, fragments", BAD_USAGE, ids=lambda v: " ".join(v)[-50:])
def test_bad_usage_is_2_and_says_what_and_what_is_allowed(tmp_path, arguments, fragments):
    result = subprocess.run([ROBOT, *arguments], cwd=tmp_path, capture_output=True, text=True,
                            timeout=60, check=False)
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr.startswith("berth-robot: ")
    for fragment in fragments:
        assert fragment in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_help_names_every_option():
    result = subprocess.run([ROBOT, "--help"], capture_output=True, text=True, timeout=60,
                            check=False)
    assert (result.returncode, result.stderr) == (0, "")
    for word in ("--can", "--drive", "--left", "--right", "--json", "--log", "--seed", "--set",
                 "--timeout", "--fix-period", "--obstacles", "SCENARIO", "Exit status"):
        assert word in result.stdout
    assert max(map(len, result.stdout.splitlines())) <= 100
