"""Trouble on a real CAN interface while the robot runs: it carries on, or stops and says why.

The programs are those built with sanitizers, where there are.
"""

import subprocess
import time

import pytest

from can_lines import BUSES, run, send, tool
from drive_sim import PROGRAM as DRIVE_PROGRAM
from robot_pair import Pair, Process, sanitized

BUS = BUSES[-1]
PROGRAMS = {"board": sanitized("board"), "robot": sanitized("robot")}
# An emulated machine with sanitizers may stand still for a moment; that is not what is tested.
PATIENT = ["--feedback-timeout", "1000", "--heartbeat-timeout", "1500", "--enable-timeout", "20000",
           "--late", "2000"]
RUNNING_S = 6


def pair(scenario="circle", duration_s=120, drive="odrive"):
    return Pair(BUS, drive, scenario, programs=PROGRAMS,
                both=["--set", f"duration_s={duration_s}"], board=PATIENT, robot=["--timeout", "20"])


def run_calmly(duration_s):
    """The results of a run in which the machine did not stand still for so long that the drives'
    own watchdogs (250 ms) had a reason to stop; the third time it counts whatever it was."""
    for _ in range(3):
        with pair(duration_s=duration_s) as running:
            board, robot = running.finish()
        if board[1]["late_max_us"] < 150000:
            break
        print(f"a control step was {board[1]['late_max_us']} us late: once more")
    return board, robot


def ip(*arguments):
    status, _, error = run(tool("ip"), *arguments)
    assert status == 0, error


@pytest.fixture(autouse=True)
def bus_is_up():
    yield
    ip("link", "set", BUS, "up")


def stopped(result, fault, side=""):
    status, board, error = result
    assert (status, board["fault"], board["fault_side"]) == (1, fault, side), error
    assert board["state"] == "fault"


def unharmed(result):
    """The robot has not touched anything."""
    _, robot, _ = result
    assert robot["collisions"] == 0 and robot["min_clearance_m"] > 0


def test_bus_off_stops_it():
    with pair() as running:
        time.sleep(RUNNING_S)
        send(BUS, "20000040#0008000000000000")
        board, robot = running.finish()
    stopped(board, "bus-off")
    assert board[1]["error_frames"] >= 1
    unharmed(robot)


@pytest.mark.parametrize("drive", ["odrive", "vesc", "cia402"])
def test_interface_down_stops_it_and_the_drives_stop_themselves(drive):
    with pair(drive=drive) as running:
        time.sleep(RUNNING_S)
        ip("link", "set", BUS, "down")
        time.sleep(3)
        ip("link", "set", BUS, "up")
        board, robot = running.finish()
    stopped(board, "CAN interface down or failing")
    unharmed(robot)
    stops = [side["watchdog_stops"] for side in robot[1]["bus"]["drives"]]
    assert min(stops) >= 1, "both drives' own watchdogs"


class DriveProcess:
    """berth-drive-sim on the bus, with orders."""

    def __init__(self, node):
        self.process = subprocess.Popen([DRIVE_PROGRAM, f"socketcan:{BUS}", "odrive", str(node)],
                                        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout.readline() == "ready\n"

    def order(self, text):
        self.process.stdin.write(text + "\n")
        self.process.stdin.flush()
        return self.process.stdout.readline().split()

    def close(self):
        self.process.stdin.close()
        self.process.wait(timeout=30)


@pytest.fixture
def drives():
    both = [DriveProcess(0), DriveProcess(1)]
    yield both
    for drive in both:
        drive.close()


@pytest.mark.parametrize("order, fault", [
    ("trouble mute-heartbeat 1", "no heartbeat in time"),
    ("trouble mute-feedback 1", "no speed feedback in time"),
    ("trouble dead 1", "no speed feedback in time"),
    ("fail 40", "the drive reports an error"),
])
def test_trouble_with_one_drive_stops_both(drives, order, fault):
    board = Process(PROGRAMS["board"], BUS, "odrive", "circle", "--set", "duration_s=120", *PATIENT)
    time.sleep(RUNNING_S)
    speed_before = float(drives[0].order("status")[1])
    assert drives[1].order(order) == ["ok"]
    result = board.finish(60)
    stopped(result, fault, "right drive: ")
    assert abs(speed_before) > 0.1, "the other one was turning"
    target = float(drives[0].order("status")[1])
    assert target == 0.0, "and has been told to stop"


def test_a_flood_of_foreign_frames_changes_nothing():
    """At the rate of a full 1 Mbit/s bus. The kernel's filter keeps them away."""
    flood = subprocess.Popen([tool("cangen"), BUS, "-g", "0.13", "-I", "7F0", "-L", "8", "-D", "r",
                              "-i"])
    try:
        board, robot = run_calmly(15)
        assert flood.poll() is None, "cangen goes on"
    finally:
        flood.kill()
        flood.wait()
    assert (board[0], board[1]["fault"]) == (0, ""), board[2]
    assert (board[1]["foreign"], board[1]["rx_lost"], board[1]["tx_dropped"]) == (0, 0, 0)
    assert robot[0] == 0
    unharmed(robot)


@pytest.mark.parametrize("identifier, options", [
    ("001", ["-L", "4"]),                 # heartbeat of the left drive, too short
    ("009", ["-L", "7"]),                 # encoder estimates of the left drive, too short
    ("029", ["-L", "8", "-D", "0000C07F0000C07F"]),  # NaN from the right drive
    ("04B20000", ["-e", "-L", "8"]),      # a command, too long
    ("04B20100", ["-e", "-L", "3"]),      # a pose fix, too short
])
def test_malformed_frames_of_our_own_ids_are_counted(identifier, options):
    noise = subprocess.Popen([tool("cangen"), BUS, "-g", "5", "-I", identifier, "-i", *options])
    try:
        board, robot = run_calmly(8)
    finally:
        noise.kill()
        noise.wait()
    assert (board[0], board[1]["fault"]) == (0, ""), board[2]
    assert board[1]["malformed"] >= 100
    assert robot[0] == 0
    unharmed(robot)


def test_random_frames_of_our_own_ids_do_no_harm():
    """Whatever they say: the robot keeps within bounds or stops, and no program crashes."""
    noise = [subprocess.Popen([tool("cangen"), BUS, "-g", "20", "-I", identifier, "-i", *options])
             for identifier, options in (("001", []), ("009", []), ("021", []), ("029", []),
                                         ("04B20000", ["-e"]), ("04B20200", ["-e"]))]
    try:
        with pair(duration_s=10) as running:
            board, robot = running.finish()
    finally:
        for process in noise:
            process.kill()
            process.wait()
    assert board[0] in (0, 1) and board[1]["state"] in ("idle", "fault")
    assert (board[0] == 0) == (board[1]["fault"] == "")
    assert robot[1] is None or robot[1]["collisions"] == 0
