#!/usr/bin/env python3
"""Plays ODrives on a CAN bus, with python-can: written from the published CANSimple protocol
(firmware 0.5), sharing nothing with Berth's own code.

    odrive_peer.py --interface socketcan --channel vcan0 --node 0 --node 1

or, within a test:

    with OdrivePeer(can.Bus(interface="virtual", channel="x"), nodes=[0, 1]) as peer:
        peer.axes[0].motor.speed

Ids are 11-bit, node << 5 | command; numbers little endian.

    in   0x02 emergency stop   0x07 requested state, uint32   0x0B control mode, input mode, uint32
         0x0D velocity, torque, float32   0x18 clear errors
    out  0x01 heartbeat: error uint32, state uint8, three bytes of flags, each 100 ms
         0x09 encoder: turns, turns/s, float32, each 10 ms

As in the drive, the watchdog counts as soon as it is switched on, whether the axis is idle or not,
and only a velocity command, or entering closed loop, feeds it. An axis with an error does not enter
closed loop, and leaves it at once.
"""

import argparse
import struct
import time

import can

from peer import Motor, Runner

ESTOP, HEARTBEAT, REQUESTED_STATE, ENCODER = 0x02, 0x01, 0x07, 0x09
CONTROLLER_MODE, INPUT_VELOCITY, CLEAR_ERRORS = 0x0B, 0x0D, 0x18
IDLE, CLOSED_LOOP = 1, 8
VELOCITY_CONTROL, PASSTHROUGH = 2, 1
# Axis errors.
INVALID_STATE, WATCHDOG_EXPIRED, ESTOP_REQUESTED = 0x1, 0x800, 0x4000
HEARTBEAT_S, ENCODER_S = 0.1, 0.01


class Axis:
    """One axis. Times are arguments, so that it can be tested without a clock."""

    def __init__(self, node, now_s, watchdog_s=0.1, speed_limit=20.0):
        self.node = node
        self.watchdog_s = watchdog_s
        self.speed_limit = speed_limit
        self.power_on(now_s)

    def power_on(self, now_s):
        self.motor = Motor()
        self.state = IDLE
        self.error = 0
        self.modes = (3, 1)  # position control, as the drive starts
        self.fed_s = now_s
        self.heartbeat_s = now_s
        self.encoder_s = now_s
        self.mute_heartbeat = False
        self.mute_encoder = False
        self.commands = 0
        self.malformed = 0
        self.motor.advance(now_s)

    def fail(self, error):
        self.error |= error
        self.state = IDLE
        self.motor.torque = False

    def request(self, state, now_s):
        if state == CLOSED_LOOP and not self.error:
            self.state = CLOSED_LOOP
            self.fed_s = now_s
            self.motor.torque = True
            self.motor.target = 0.0
        elif state == IDLE:
            self.state = IDLE
            self.motor.torque = False
        else:
            self.fail(INVALID_STATE)

    def set_velocity(self, velocity, now_s):
        self.fed_s = now_s
        self.commands += 1
        if self.modes == (VELOCITY_CONTROL, PASSTHROUGH):
            self.motor.target = max(-self.speed_limit, min(self.speed_limit, velocity))

    def receive(self, command, data, now_s):
        """One frame for this axis. False: of a wrong length, or no command of a master's."""
        layouts = {
            ESTOP: "",
            REQUESTED_STATE: "<I",
            CONTROLLER_MODE: "<II",
            INPUT_VELOCITY: "<ff",
            CLEAR_ERRORS: "",
        }
        layout = layouts.get(command)
        if layout is None or len(data) != struct.calcsize(layout):
            self.malformed += 1
            return False
        values = struct.unpack(layout, data)
        self.step(now_s)
        if command == ESTOP:
            self.fail(ESTOP_REQUESTED)
        elif command == REQUESTED_STATE:
            self.request(values[0], now_s)
        elif command == CONTROLLER_MODE:
            self.modes = values
        elif command == INPUT_VELOCITY:
            self.set_velocity(values[0], now_s)
        else:
            self.error = 0
        return True

    def step(self, now_s):
        self.motor.advance(now_s)
        if self.watchdog_s and now_s - self.fed_s > self.watchdog_s:
            self.fail(WATCHDOG_EXPIRED)

    def due(self, now_s):
        """The frames to send now, as (command, data)."""
        self.step(now_s)
        frames = []
        if now_s >= self.heartbeat_s:
            self.heartbeat_s = max(self.heartbeat_s + HEARTBEAT_S, now_s)
            flags = bytes([self.error != 0, 0, 0])
            frames.append((HEARTBEAT, struct.pack("<IB", self.error, self.state) + flags))
        if now_s >= self.encoder_s:
            self.encoder_s = max(self.encoder_s + ENCODER_S, now_s)
            frames.append((ENCODER, struct.pack("<ff", self.motor.turns, self.motor.speed)))
        muted = {HEARTBEAT: self.mute_heartbeat, ENCODER: self.mute_encoder}
        return [frame for frame in frames if not muted[frame[0]]]

    def deadline(self):
        return min(self.heartbeat_s, self.encoder_s)


class OdrivePeer:
    """Some axes on one bus, which it shuts down at its end."""

    def __init__(self, bus, nodes, watchdog_s=0.1):
        now_s = time.monotonic()
        self.bus = bus
        mine = [{"can_id": node << 5, "can_mask": 0x7E0, "extended": False} for node in nodes]
        bus.set_filters(mine)
        self.axes = {node: Axis(node, now_s, watchdog_s) for node in nodes}
        self.runner = Runner(self.poll)

    def poll(self, most_s):
        """Sends what is due, and waits for a frame until something else is."""
        now_s = time.monotonic()
        for axis in self.axes.values():
            for command, data in axis.due(now_s):
                self.bus.send(
                    can.Message(
                        arbitration_id=axis.node << 5 | command, is_extended_id=False, data=data
                    )
                )
        deadline_s = min(axis.deadline() for axis in self.axes.values())
        wait_s = max(0.0, min(most_s, deadline_s - time.monotonic()))
        message = self.bus.recv(wait_s)
        # Frames that have piled up while this process was not running were all on the bus already.
        while message is not None:
            self.receive(message)
            message = self.bus.recv(0.0)

    def receive(self, message):
        if message.is_extended_id or message.is_error_frame or message.is_remote_frame:
            return
        axis = self.axes.get(message.arbitration_id >> 5)
        if axis:
            axis.receive(message.arbitration_id & 0x1F, bytes(message.data), time.monotonic())

    def __enter__(self):
        self.runner.start()
        return self

    def __exit__(self, *unused):
        self.runner.stop()
        self.bus.shutdown()


def main():
    parser = argparse.ArgumentParser(description="Plays ODrives on a CAN bus.")
    parser.add_argument("--interface", default="socketcan")
    parser.add_argument("--channel", default="vcan0")
    parser.add_argument("--node", type=int, action="append", required=True)
    parser.add_argument("--watchdog", type=float, default=0.1, metavar="S", help="0: none")
    options = parser.parse_args()
    bus = can.Bus(interface=options.interface, channel=options.channel)
    peer = OdrivePeer(bus, options.node, options.watchdog)
    try:
        while True:
            peer.poll(0.5)
    except KeyboardInterrupt:
        bus.shutdown()


if __name__ == "__main__":
    main()
