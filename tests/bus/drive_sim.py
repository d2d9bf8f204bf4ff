"""A simulated wheel drive as a process of its own, and a python-can bus to it.

Where there are CAN interfaces (BERTH_VCAN), both are on the first one. Elsewhere the drive's frames
come as Lawicel lines over a unix socket, and a bridge carries them to and from python-can's virtual
bus.
"""

import itertools
import os
import socket
import subprocess
import threading
from pathlib import Path

import can

PROGRAM = Path(os.environ["BERTH_BUILD_DIR"]) / "tests" / "berth-drive-sim"
channels = itertools.count()


def line_of(message):
    if message.is_extended_id:
        head = f"{'R' if message.is_remote_frame else 'T'}{message.arbitration_id:08X}"
    else:
        head = f"{'r' if message.is_remote_frame else 't'}{message.arbitration_id:03X}"
    return f"{head}{message.dlc}{bytes(message.data).hex().upper()}\r".encode()


def message_of(line):
    """None for what is no frame: the commands that set an adapter up."""
    if line[:1] not in "tTrR" or not line:
        return None
    digits = 8 if line[0] in "TR" else 3
    remote = line[0] in "rR"
    return can.Message(
        arbitration_id=int(line[1 : 1 + digits], 16),
        is_extended_id=digits == 8,
        is_remote_frame=remote,
        dlc=int(line[1 + digits]),
        data=None if remote else bytes.fromhex(line[2 + digits :]),
    )


class Bridge:
    """Between a unix socket with Lawicel lines and a bus of python-can."""

    def __init__(self, path, bus):
        self.bus = bus
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.connect(str(path))
        self.notifier = can.Notifier(bus, [self.to_drive], timeout=0.1)
        self.thread = threading.Thread(target=self.from_drive)
        self.thread.start()

    def to_drive(self, message):
        self.socket.sendall(line_of(message))

    def from_drive(self):
        rest = ""
        while received := self.socket.recv(4096):
            *lines, rest = (rest + received.decode("ascii")).split("\r")
            for line in lines:
                message = message_of(line)
                if message is not None:
                    self.bus.send(message)

    def close(self):
        self.notifier.stop()
        self.socket.shutdown(socket.SHUT_RDWR)
        self.thread.join()
        self.socket.close()
        self.bus.shutdown()


class Drive:
    """berth-drive-sim with its orders. bus: what a master gives to python-can or canopen."""

    def __init__(self, kind, node, folder):
        self.bridge = None
        interface = os.environ.get("BERTH_VCAN")
        if interface:
            self.bus = {"interface": "socketcan", "channel": interface}
            self.start(f"socketcan:{interface}", kind, node)
        else:
            self.bus = {"interface": "virtual", "channel": f"drive{next(channels)}"}
            path = folder / "line"
            self.start(f"slcan:{path}", kind, node)
            self.bridge = Bridge(path, can.Bus(**self.bus))

    def start(self, bus, kind, node):
        self.process = subprocess.Popen(
            [PROGRAM, bus, kind, str(node)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self.process.stdout.readline() == "ready\n"

    def order(self, text):
        self.process.stdin.write(text + "\n")
        self.process.stdin.flush()
        return self.process.stdout.readline().strip()

    def fail(self, code):
        assert self.order(f"fail {code:x}") == "ok"

    def trouble(self, name, on=True):
        assert self.order(f"trouble {name} {int(on)}") == "ok"

    def status(self):
        names = ("enabled", "target", "speed", "angle", "commands", "stops", "malformed")
        return dict(zip(names, map(float, self.order("status").split()), strict=True))

    def close(self):
        self.process.stdin.close()
        status = self.process.wait(timeout=20)
        self.process.stdout.close()
        if self.bridge:
            self.bridge.close()
        assert status == 0
