"""berth-board on a real CAN interface with drives that nobody here wrote the protocol stack of: an
ODrive played with python-can, CiA 402 drives played with canopen. candump records; cantools decodes.

Times are real and the machine may be emulated and busy: time-outs are long, and what is asserted
does not depend on how late a step was.
"""

import functools
import json
import math
import os
import signal
import subprocess
import time
from pathlib import Path

import can
import canopen
import cantools
import pytest

from can_lines import BUSES, tool
from cia402_peer import ENABLED, FAULT, QUICK_STOP, SWITCH_ON_DISABLED, Cia402Peer
from cia402_peer import object_dictionary
from odrive_peer import IDLE, OdrivePeer
from peer import wait_until

BUS = BUSES[1]
ROOT = Path(os.environ["BERTH_SOURCE_DIR"])
LEFT, RIGHT = 0, 1  # as in tools/odrive.dbc
WHEEL_M, TRACK_M = 0.05, 0.30  # of the circle
PATIENT = ["--feedback-timeout", "5000", "--heartbeat-timeout", "5000", "--enable-timeout", "60000"]
# A peer in Python must not keep the board waiting, and a step may come three periods late.
PATIENT += ["--priority", "50", "--set", "period_s=0.1"]
CANOPEN = ["--velocity-units", "60", "--counts-per-turn", "4096"]


class Starved(Exception):
    """The board did not get the processor in time, and said so: the machine's fault."""


def patiently(test):
    """Runs a test with drives as after power-on; again, up to twice, when the board was starved."""

    @functools.wraps(test)
    def attempts(*arguments, **fixtures):
        for attempt in range(3):
            for axis in fixtures.get("odrives", ()):
                axis.power_on(time.monotonic())
            for drive in fixtures.get("cia402", ()):
                drive.motor.turns = drive.motor.speed = 0.0
                drive.boot()
            try:
                return test(*arguments, **fixtures)
            except Starved as starved:
                print(f"attempt {attempt + 1}: {starved}")
        raise AssertionError("the board was starved three times")

    return attempts


class Board:
    """berth-board, and a candump beside it that is written to a file."""

    def __init__(self, folder, drive, left, right, *arguments):
        self.record = folder / "candump.log"
        with self.record.open("w") as file:
            self.candump = subprocess.Popen([tool("candump"), "-L", BUS], stdout=file)
        command = [os.environ["BERTH_BOARD"], "--can", f"socketcan:{BUS}", "--drive", drive]
        command += ["--left", str(left), "--right", str(right), "circle", "--json", *PATIENT]
        self.process = subprocess.Popen(
            [*command, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )

    def __enter__(self):
        return self

    def __exit__(self, *unused):
        for process in (self.process, self.candump):
            if process.poll() is None:
                process.kill()
            process.wait()
        self.process.stdout.close()
        self.process.stderr.close()

    def wait_until(self, condition, what):
        def holds():
            if self.process.poll() is not None:
                self.told(self.process.stderr.read())
                raise AssertionError(f"berth-board ended with {self.process.returncode}")
            return condition()

        wait_until(holds, 60, what)

    def finish(self):
        """(exit status, summary, error output)"""
        out, error = self.process.communicate(timeout=90)
        self.told(error)
        return self.process.returncode, json.loads(out) if out else None, error

    def told(self, error):
        if "control step too late" in error:
            raise Starved(error)
        print(error)

    def frames(self):
        """(id, data) in order, of what candump has written by now."""
        self.candump.terminate()
        self.candump.wait()
        found = []
        for line in self.record.read_text().splitlines():
            identifier, _, data = line.split()[2].partition("#")
            found.append((int(identifier, 16), len(identifier) > 3, bytes.fromhex(data)))
        return found


def database(name):
    return cantools.database.load_file(ROOT / "tools" / f"{name}.dbc", strict=True)


def decode(frames, *names):
    """[(message name, signals)]; a frame that no database knows, or cannot decode, is an error."""
    known = {}
    for name in names:
        for message in database(name).messages:
            known[message.frame_id, message.is_extended_frame] = message
    decoded = []
    for identifier, is_extended, data in frames:
        message = known[identifier, is_extended]
        signals = message.decode(data, decode_choices=False, allow_truncated=False)
        assert message.length == len(data)
        decoded.append((message.name, signals))
    return decoded


def heading_from(left_turns, right_turns):
    return 2.0 * math.pi * WHEEL_M * (right_turns - left_turns) / TRACK_M


def wrapped(angle):
    return math.remainder(angle, 2.0 * math.pi)


def assert_pose_agrees(poses, left_turns, right_turns):
    """The board's heading by its own odometry, and by what the motors did."""
    turned = poses[-1]["Theta"] - poses[0]["Theta"]
    assert abs(wrapped(turned - heading_from(left_turns, right_turns))) < 0.05
    assert 0.3 < math.pi * WHEEL_M * (left_turns + right_turns) < 3.0


@pytest.fixture
def odrives():
    bus = can.Bus(interface="socketcan", channel=BUS)
    with OdrivePeer(bus, [LEFT, RIGHT], watchdog_s=5.0) as peer:
        yield peer.axes[LEFT], peer.axes[RIGHT]


def rehearse(peer):
    """A set-up by canopen's own master, without haste: what an emulated Python does for the first
    time may take longer than a drive has for an answer."""
    with canopen.Network() as network:
        network.connect(interface="socketcan", channel=BUS)
        for number in peer.drives:
            node = network.add_node(number, object_dictionary(number))
            node.sdo.RESPONSE_TIMEOUT = 20.0
            node.sdo[0x6040].raw = 2
            node.sdo[0x1017].raw = 100
            node.sdo[0x1016][1].raw = 127 << 16 | 5000
            node.sdo[0x6060].raw = 3
            assert node.sdo[0x6061].raw == 3
            for pdo, entry in ((node.tpdo[1], 0x6041), (node.rpdo[1], 0x6040)):
                pdo.read()
                pdo.clear()
                pdo.add_variable(entry)
                pdo.trans_type, pdo.enabled = 1, True
                pdo.save()
            node.nmt.state = "OPERATIONAL"
            network.send_message(0x080, b"")
            network.send_message(0x200 + number, b"\x02\x00")
            network.send_message(0x080, b"")
            wait_until(lambda drive=peer.drives[number]: drive.received_pdos > 0)


@pytest.fixture(scope="module")
def canopen_network():
    with Cia402Peer("socketcan", BUS, nodes=[1, 2], units_per_rps=60.0) as peer:
        rehearse(peer)
        yield peer


@pytest.fixture
def cia402(canopen_network):
    return canopen_network.drives[1], canopen_network.drives[2]


def odrive_board(folder, *arguments):
    return Board(folder, "odrive", LEFT, RIGHT, *arguments)


def cia402_board(folder, *arguments):
    return Board(folder, "cia402", 1, 2, *CANOPEN, *arguments)


def moving(drives, least_rps=0.3):
    return lambda: all(abs(drive.motor.speed) > least_rps for drive in drives)


def still(drives):
    return lambda: all(abs(drive.motor.speed) < 0.05 for drive in drives)


@patiently
def test_odrives_follow_and_every_frame_is_decoded(odrives, tmp_path):
    with odrive_board(tmp_path, "--set", "duration_s=5") as board:
        status, summary, error = board.finish()
        states = [(axis.state, axis.error, axis.malformed) for axis in odrives]
        assert (status, error) == (0, "")
        assert (summary["state"], summary["fault"]) == ("idle", "")
        assert summary["malformed"] == summary["tx_dropped"] == summary["rx_lost"] == 0
        decoded = decode(board.frames(), "odrive", "berth")
    assert states == [(IDLE, 0, 0), (IDLE, 0, 0)]
    left, right = odrives
    assert left.commands > 40
    assert_pose_agrees(
        [signals for name, signals in decoded if name == "Pose"],
        left.motor.turns,
        right.motor.turns,
    )
    names = {name for name, _ in decoded}
    assert {"Status", "TrackingError", "Axis0_SetInputVelocity", "Axis1_Heartbeat"} <= names


@patiently
def test_odrives_stop_by_themselves_when_the_board_dies(odrives, tmp_path):
    with odrive_board(tmp_path) as board:
        board.wait_until(moving(odrives), "motion")
        board.process.kill()
        wait_until(lambda: all(axis.state == IDLE for axis in odrives), 20, "the watchdog")
        assert [axis.error for axis in odrives] == [0x800, 0x800]
        wait_until(still(odrives), 20, "running out")


@pytest.mark.parametrize(
    "trouble, reason", [("heartbeat", "heartbeat"), ("error", "error (code 0x40)")]
)
@patiently
def test_trouble_in_one_odrive_stops_both(trouble, reason, odrives, tmp_path):
    left, right = odrives
    with odrive_board(tmp_path) as board:
        board.wait_until(moving(odrives), "motion")
        if trouble == "heartbeat":
            right.mute_heartbeat = True
        else:
            right.fail(0x40)
        status, _, error = board.finish()
        assert (left.state, left.error) == (IDLE, 0), "by command, not by its watchdog"
        assert status == 1
        assert "right drive" in error and reason in error
        wait_until(still(odrives), 20, "a stand")


@patiently
def test_an_interrupt_stops_the_odrives(odrives, tmp_path):
    with odrive_board(tmp_path) as board:
        board.wait_until(moving(odrives), "motion")
        board.process.send_signal(signal.SIGINT)
        status, summary, error = board.finish()
        assert [axis.error for axis in odrives] == [0, 0]
        assert (status, error, summary["state"]) == (0, "", "idle")
        wait_until(still(odrives), 20, "a stand")


@pytest.mark.parametrize("mode", ["3", "9"])
@patiently
def test_cia402_drives_follow(mode, cia402, tmp_path):
    with cia402_board(tmp_path, "--mode", mode, "--set", "duration_s=5") as board:
        status, summary, error = board.finish()
        assert (status, error) == (0, "")
        assert (summary["state"], summary["fault"]) == ("idle", "")
        assert summary["malformed"] == summary["tx_dropped"] == 0
        ours = [frame for frame in board.frames() if frame[1]]
    left, right = cia402
    assert (left.mode, right.mode) == (int(mode), int(mode))
    assert (left.machine.state, right.machine.state) == (SWITCH_ON_DISABLED, SWITCH_ON_DISABLED)
    assert (left.malformed, right.malformed, left.error_code, right.error_code) == (0, 0, 0, 0)
    poses = [signals for name, signals in decode(ours, "berth") if name == "Pose"]
    assert_pose_agrees(poses, left.motor.turns, right.motor.turns)


@patiently
def test_cia402_drives_stop_by_themselves_when_the_board_dies(cia402, tmp_path):
    with cia402_board(tmp_path, "--heartbeat-timeout", "2000") as board:
        board.wait_until(moving(cia402), "motion")
        board.process.kill()
        wait_until(
            lambda: all(drive.machine.state == QUICK_STOP for drive in cia402), 20, "quick stop"
        )
        wait_until(still(cia402), 20, "a stand")


@patiently
def test_an_emergency_message_stops_both_cia402_drives(cia402, tmp_path):
    left, right = cia402
    with cia402_board(tmp_path) as board:
        board.wait_until(moving(cia402), "motion")
        left.fail(0x2310)
        status, summary, error = board.finish()
        assert status == 1
        assert "left drive" in error and "emergency message" in error and "(code 0x2310)" in error
        assert summary["fault_code"] == 0x2310
        wait_until(still(cia402), 20, "a stand")
        assert left.machine.state == FAULT
        assert right.machine.state != ENABLED
        assert right.error_code == 0


@patiently
def test_a_cia402_drive_that_refuses_its_set_up_is_told(cia402, tmp_path):
    cia402[1].refuse_setup = True
    try:
        with cia402_board(tmp_path) as board:
            status, _, error = board.finish()
            assert status == 1
            assert "right drive" in error and "refused" in error and "(code 0x8000022)" in error
        assert not any(drive.motor.torque for drive in cia402)
    finally:
        cia402[1].refuse_setup = False
