"""What goes wrong on the board, on the emulated Cortex-M4F with the robot simulated around it: each
ends in a fault that is kept, with its reason, and both wheels are told to stop before anything
else, where anything can still be said."""

import json
import random
import struct
import subprocess
import sys
import time
from contextlib import contextmanager

import can
import cantools

from pil import HOST, ROOT, Image, PtyWire, SocketWire, again_when_disturbed

sys.path.insert(0, str(ROOT / "tests" / "bus"))
from odrive_peer import CLOSED_LOOP, IDLE, INPUT_VELOCITY, REQUESTED_STATE, OdrivePeer  # noqa: E402
from peer import wait_until  # noqa: E402

SEED = 20240917
STATUS = 0x18B20000
STATE_FAULT = 5
DBC = cantools.database.load_file(ROOT / "tools" / "berth.dbc")
NODES = (1, 2)


def robot(path):
    """The drives and the robot, as a program at the end of a line."""
    line = [HOST / "berth-robot", "--can", f"slcan:{path}", "--drive", "odrive", "--left", "1"]
    line += ["--right", "2", "circle", "--json"]
    return subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@contextmanager
def driving(tmp_path, *options, until="state running"):
    """Image, wire and robot, from the moment that the console says so."""
    with Image(tmp_path, "PATIENT=1", "SELF=1", *options) as image:
        image.wait_for("live")
        with SocketWire(image, tmp_path / "robot") as wire:
            program = robot(tmp_path / "robot")
            try:
                if until:
                    image.wait_for(until)
                yield image, wire, program
            finally:
                program.kill()
                program.communicate()


def speeds(frames):
    """[(position, node, turns/s)] of the speed commands."""
    found = []
    for position, (identifier, data) in enumerate(frames):
        if identifier < 0x800 and identifier & 0x1F == INPUT_VELOCITY:
            assert len(data) == 8
            found.append((position, identifier >> 5, struct.unpack_from("<f", data)[0]))
    return found


def assert_stopped_first(frames):
    """Between the last command to move and the first word of the fault, both wheels were told to
    stop; and never to move again."""
    told = next(
        position
        for position, (identifier, data) in enumerate(frames)
        if identifier == STATUS and data[0] & 15 == STATE_FAULT
    )
    commands = speeds(frames)
    last = max((position for position, _, speed in commands if speed != 0.0), default=-1)
    assert last < told
    stopped = {node for position, node, speed in commands if last < position < told and speed == 0.0}
    assert stopped == set(NODES), (last, told)


def assert_kept(image, wire, fault):
    """The fault stays, though its cause may be gone, and so does the reason."""
    time.sleep(1.0)
    assert image.new.empty(), image.new.queue
    last = [data for identifier, data in wire.frames() if identifier == STATUS][-1]
    status = DBC.decode_message(STATUS, last, decode_choices=False)
    assert (status["State"], status["Fault"]) == (STATE_FAULT, fault)


def told_faults(wire, since=0.0):
    """The reasons in the status frames of the fault."""
    return [
        data[1]
        for identifier, data in wire.frames(since)
        if identifier == STATUS and data[0] & 15 == STATE_FAULT
    ]


def was_moving(wire):
    return any(speed > 0.3 for _, _, speed in speeds(wire.frames()))


@again_when_disturbed
def test_stack_overflow_is_told_and_the_drives_stop_by_themselves(tmp_path):
    with driving(tmp_path, "BREAK=stack") as (image, wire, program):
        image.wait_for("FAULT memory")
        image.wait_for("stack overflow")
        status, lines = image.rest()
        assert status == 128 and lines[-1] == "END OF FAULT"
        assert was_moving(wire)
        output, _ = program.communicate(timeout=60)
        result = json.loads(output)["bus"]
        assert [drive["watchdog_stops"] for drive in result["drives"]] == [1, 1]


@again_when_disturbed
def test_missed_ticks_are_a_fault(tmp_path):
    """The line is quiet meanwhile, lest the port lose bytes: that would be another fault."""
    with driving(tmp_path, "BREAK=late") as (image, wire, program):
        wire.to_board = lambda data: b""
        image.wait_for("state fault: control step too late")
        assert_kept(image, wire, 5)
        assert was_moving(wire)
        assert_stopped_first(wire.frames())


@again_when_disturbed
def test_a_plan_that_changed_is_not_armed(tmp_path):
    with driving(tmp_path, "BREAK=plan", until=None) as (image, wire, program):
        image.wait_for("state fault: the plan has changed since it was checked")
        assert_kept(image, wire, 12)
        assert_stopped_first(wire.frames())
        assert not was_moving(wire)
        requests = {data for identifier, data in wire.frames() if identifier & 0x1F == REQUESTED_STATE}
        assert bytes([CLOSED_LOOP, 0, 0, 0]) not in requests


@again_when_disturbed
def test_garbage_on_the_line_is_a_fault(tmp_path):
    rng = random.Random(SEED)
    with driving(tmp_path) as (image, wire, program):
        wait_until(lambda: was_moving(wire), 20, "motion")
        wire.to_board = lambda data: rng.randbytes(len(data))
        image.wait_for("drive: no ")
        wait_until(lambda: told_faults(wire), 20, "the fault's status")
        fault = told_faults(wire)[0]
        assert fault >= 32
        assert_kept(image, wire, fault)
        assert_stopped_first(wire.frames())


@again_when_disturbed
def test_a_host_that_hangs_is_a_fault(tmp_path):
    """It neither reads nor writes. All queues fill: the socket's, the port's, the line's, the
    board's own."""
    with driving(tmp_path) as (image, wire, program):
        wait_until(lambda: was_moving(wire), 20, "motion")
        wire.to_board = lambda data: b""
        wire.reading = False
        image.wait_for("state fault: frames do not leave in time")
        resumed = time.monotonic()
        wire.reading = True
        wait_until(lambda: told_faults(wire, resumed), 20, "the fault's status")
        assert_kept(image, wire, 8)
        assert_stopped_first(wire.frames())


class Listening(OdrivePeer):
    """ODrives, and beside them somebody who sends frames to the board and hears all of its own."""

    def __init__(self, bus):
        super().__init__(bus, NODES, watchdog_s=5.0)
        bus.set_filters(None)
        self.to_send = []
        self.heard = []

    def poll(self, most_s):
        while self.to_send:
            self.bus.send(self.to_send.pop(0))
        super().poll(most_s)

    def receive(self, message):
        super().receive(message)
        if message.is_extended_id:
            self.heard.append(message)

    def tell(self, name, **signals):
        message = DBC.get_message_by_name(name)
        data = message.encode(signals)
        self.to_send.append(can.Message(arbitration_id=message.frame_id, is_extended_id=True, data=data))

    def command(self, code):
        self.tell("Command", Command=code, Complement=255 - code)

    def decoded(self, name):
        message = DBC.get_message_by_name(name)
        return [
            message.decode(bytes(heard.data), decode_choices=False)
            for heard in self.heard
            if heard.arbitration_id == message.frame_id
        ]

    def wait_for_state(self, state):
        wait_until(
            lambda: (told := self.decoded("Status")) and told[-1]["State"] == state, 30, f"state {state}"
        )


def test_python_can_operates_the_board(tmp_path):
    with Image(tmp_path, "PATIENT=1") as image:
        image.wait_for("live")
        with PtyWire(image) as wire:
            bus = can.Bus(interface="slcan", channel=wire.end, bitrate=1000000, sleep_after_open=0.2)
            with Listening(bus) as peer:
                peer.wait_for_state(0)
                peer.tell("PoseFix", X=0.9, Y=-0.1, Theta=1.5)
                wait_until(lambda: peer.decoded("Pose"), 20, "a pose")
                assert peer.decoded("Pose")[-1] == {"X": 0.9, "Y": -0.1, "Theta": 1.5}
                peer.command(1)
                peer.wait_for_state(2)
                assert [axis.state for axis in peer.axes.values()] == [CLOSED_LOOP] * 2
                peer.command(2)
                peer.wait_for_state(3)
                wait_until(lambda: max(a.motor.turns for a in peer.axes.values()) > 3.0, 20, "motion")
                assert peer.decoded("TrackingError")[-1]["Speed"] > 0.0
                peer.command(3)
                peer.wait_for_state(0)
                wait_until(lambda: all(a.state == IDLE for a in peer.axes.values()), 20, "idle axes")
                assert all(axis.error == 0 and axis.malformed == 0 for axis in peer.axes.values())
        assert [line for line in image.lines if "fault" in line] == []
