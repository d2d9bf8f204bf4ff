"""The ODrive that python-can plays: what the tests of berth-board may rely on.

On vcan0 where there is one (bus tests), on python-can's virtual bus elsewhere.
"""

import math
import os
import struct
import time

import can
import pytest

import odrive_peer
from odrive_peer import CLOSED_LOOP, IDLE, Axis, OdrivePeer
from peer import Motor, wait_until

ON_VCAN = "BERTH_VCAN" in os.environ


def open_bus():
    if ON_VCAN:
        return can.Bus(interface="socketcan", channel=os.environ["BERTH_VCAN"])
    return can.Bus(interface="virtual", channel="odrive")


def closed_loop_axis(**options):
    axis = Axis(5, 0.0, **options)
    assert axis.receive(0x18, b"", 0.0)
    assert axis.receive(0x0B, struct.pack("<II", 2, 1), 0.0)
    assert axis.receive(0x0D, struct.pack("<ff", 0.0, 0.0), 0.0)
    assert axis.receive(0x07, struct.pack("<I", 8), 0.0)
    assert (axis.state, axis.error) == (CLOSED_LOOP, 0)
    return axis


def test_motor_follows_with_its_lag():
    motor = Motor(lag_s=0.1)
    motor.advance(0.0)
    motor.torque = True
    motor.target = 2.0
    motor.advance(0.1)
    assert motor.speed == pytest.approx(2.0 * (1.0 - math.exp(-1.0)))
    assert motor.turns == pytest.approx(2.0 * 0.1 - motor.speed * 0.1)
    one_step, motor_steps = motor.turns, Motor(lag_s=0.1)
    motor_steps.advance(0.0)
    motor_steps.torque, motor_steps.target = True, 2.0
    for index in range(1, 11):
        motor_steps.advance(index * 0.01)
    assert motor_steps.turns == pytest.approx(one_step)


def test_velocity_command_turns_the_motor():
    axis = closed_loop_axis()
    now_s = 0.0
    for _ in range(100):
        now_s += 0.01
        assert axis.receive(0x0D, struct.pack("<ff", -1.5, 0.0), now_s)
    assert axis.motor.speed == pytest.approx(-1.5, abs=1e-3)
    frames = dict(axis.due(now_s))
    assert struct.unpack("<ff", frames[0x09]) == pytest.approx(
        (axis.motor.turns, axis.motor.speed), rel=1e-6
    )
    assert frames[0x01] == struct.pack("<IB", 0, CLOSED_LOOP) + bytes(3)


def test_watchdog_takes_the_torque_off():
    axis = closed_loop_axis(watchdog_s=0.1)
    axis.receive(0x0D, struct.pack("<ff", 1.0, 0.0), 0.05)
    axis.step(0.14)
    assert axis.state == CLOSED_LOOP
    axis.step(0.16)
    assert (axis.state, axis.error, axis.motor.torque) == (IDLE, 0x800, False)
    axis.receive(0x07, struct.pack("<I", 8), 0.2)
    assert axis.state == IDLE
    axis.receive(0x18, b"", 0.3)
    assert axis.error == 0
    axis.step(0.3)
    assert axis.error == 0x800, "clearing does not feed"
    axis.step(5.0)
    assert abs(axis.motor.speed) < 1e-3


def test_emergency_stop_and_what_ends_it():
    axis = closed_loop_axis()
    axis.receive(0x02, b"", 0.01)
    assert (axis.state, axis.error) == (IDLE, 0x4000)
    axis.receive(0x0D, struct.pack("<ff", 1.0, 0.0), 0.02)
    axis.receive(0x18, b"", 0.03)
    axis.receive(0x07, struct.pack("<I", 8), 0.04)
    assert (axis.state, axis.error) == (CLOSED_LOOP, 0)


@pytest.mark.parametrize("modes", [(3, 1), (1, 1), (2, 2), (0, 0)])
def test_velocity_means_nothing_in_other_modes(modes):
    axis = closed_loop_axis()
    axis.receive(0x0B, struct.pack("<II", *modes), 0.0)
    axis.receive(0x0D, struct.pack("<ff", 1.0, 0.0), 0.0)
    assert axis.motor.target == 0.0


@pytest.mark.parametrize(
    "command, data",
    [(0x0D, bytes(7)), (0x0D, b""), (0x07, bytes(8)), (0x18, b"\0"), (0x02, b"\0"), (0x1F, b"")],
)
def test_malformed_frames_are_counted_and_change_nothing(command, data):
    axis = closed_loop_axis()
    assert not axis.receive(command, data, 0.01)
    assert (axis.malformed, axis.state, axis.error) == (1, CLOSED_LOOP, 0)


def test_rates():
    axis = Axis(5, 0.0, watchdog_s=0.0)
    sent = [command for tick in range(1000) for command, _ in axis.due(tick * 0.001)]
    assert sent.count(0x01) == 10
    assert sent.count(0x09) == 100
    axis.mute_heartbeat = True
    assert {command for tick in range(1000, 1300) for command, _ in axis.due(tick * 0.001)} == {0x09}


def send(bus, node, command, data=b""):
    identifier = node << 5 | command
    bus.send(can.Message(arbitration_id=identifier, is_extended_id=False, data=data))


def test_two_axes_on_a_bus():
    """A master that enables both, drives one for a while and falls silent. The time-out is long and
    the bounds are wide, since the machine may be emulated and busy."""
    with open_bus() as master, OdrivePeer(open_bus(), [3, 7], watchdog_s=3.0) as peer:
        start_s = time.monotonic()
        left, right = peer.axes[3], peer.axes[7]
        for node in (3, 7):
            send(master, node, odrive_peer.CLEAR_ERRORS)
            send(master, node, odrive_peer.CONTROLLER_MODE, struct.pack("<II", 2, 1))
            send(master, node, odrive_peer.INPUT_VELOCITY, struct.pack("<ff", 0.0, 0.0))
            send(master, node, odrive_peer.REQUESTED_STATE, struct.pack("<I", 8))
        wait_until(lambda: {left.state, right.state} == {CLOSED_LOOP}, what="closed loop")

        seen = {}
        end_s = time.monotonic() + 1.0
        while time.monotonic() < end_s:
            send(master, 3, odrive_peer.INPUT_VELOCITY, struct.pack("<ff", 2.0, 0.0))
            send(master, 7, odrive_peer.INPUT_VELOCITY, struct.pack("<ff", 0.0, 0.0))
            until_s = time.monotonic() + 0.02
            while (message := master.recv(max(0.0, until_s - time.monotonic()))) is not None:
                seen.setdefault(message.arbitration_id, []).append(bytes(message.data))
        elapsed_s = time.monotonic() - start_s
        assert left.motor.speed == pytest.approx(2.0, abs=0.05)
        assert right.motor.speed == 0.0
        assert set(seen) == {3 << 5 | 1, 3 << 5 | 9, 7 << 5 | 1, 7 << 5 | 9}
        heartbeats, encoder = seen[3 << 5 | 1], seen[3 << 5 | 9]
        assert 2 <= len(heartbeats) <= elapsed_s * 10 + 2
        assert 20 <= len(encoder) <= elapsed_s * 100 + 2
        assert struct.unpack_from("<IB", heartbeats[-1]) == (0, CLOSED_LOOP)
        turns, speed = struct.unpack("<ff", encoder[-1])
        assert speed == pytest.approx(2.0, abs=0.1)
        assert 0.5 < turns < 2.0 * elapsed_s

        wait_until(lambda: left.state == IDLE and right.state == IDLE, what="the watchdog")
        assert left.error == 0x800
        wait_until(lambda: abs(left.motor.speed) < 0.2, what="running out")
