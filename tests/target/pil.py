"""The drive board's image in the emulator, with its second serial port as a socket here, and what
the tests put between that and a peer."""

import functools
import os
import queue
import re
import select
import socket
import subprocess
import threading
import time
import tty

from target import BUILD, ROOT
import emulate  # found by target

BOARD = "mps2-an386"
IMAGE = BUILD / "firmware" / "boards" / "pil" / f"pil-{BOARD}.elf"
# The programs for this machine.
HOST = ROOT / "build" / "gcc-release" / "host_sim"
# Frames on the line; answers stand between them.
LINE = re.compile(r"(t[0-9A-F]{3}|T[0-9A-F]{8})([0-8])([0-9A-F]*)\r")


class Disturbed(AssertionError):
    """Another fault: most likely, the machine did not let one side run for a quarter of a second, and
    a drive's watchdog noticed."""


def again_when_disturbed(test):
    """Up to five attempts, each in a folder of its own."""

    @functools.wraps(test)
    def attempts(tmp_path):
        for attempt in range(5):
            folder = tmp_path / str(attempt)
            folder.mkdir()
            try:
                return test(folder)
            except Disturbed as error:
                why = error
        raise why

    return attempts


class Image:
    """The image running, and the lines of its console as they come."""

    def __init__(self, folder, *options):
        self.path = folder / "line"
        serial = f"unix:{self.path},server=on,wait=off"
        line = emulate.command(BOARD, IMAGE, options, serial=serial)
        self.lines = []
        self.new = queue.Queue()
        self.process = subprocess.Popen(
            line, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, text=True
        )
        self.thread = threading.Thread(target=self.read, daemon=True)
        self.thread.start()

    def read(self):
        for line in self.process.stdout:
            self.new.put(line.rstrip())
        self.new.put(None)

    def wait_for(self, text, timeout=60):
        """The first line, from where the last call ended, that has this text in it."""
        deadline = time.monotonic() + timeout
        while True:
            try:
                line = self.new.get(timeout=max(0.01, deadline - time.monotonic()))
            except queue.Empty:
                raise AssertionError(f"no '{text}' within {timeout} s; there was {self.lines}") from None
            assert line is not None, f"no '{text}' before the end; there was {self.lines}"
            self.lines.append(line)
            if text in line:
                return line
            if "state fault" in line:
                raise Disturbed(f"{line}, not '{text}'")

    def rest(self, timeout=60):
        """(exit status, all lines), once the program has ended."""
        status = self.process.wait(timeout)
        self.thread.join(timeout)
        while (line := self.new.get(timeout=1)) is not None:
            self.lines.append(line)
        return status, self.lines

    def connect(self):
        deadline = time.monotonic() + 30
        while True:
            try:
                line = socket.socket(socket.AF_UNIX)
                line.connect(str(self.path))
                return line
            except OSError:
                line.close()
                assert time.monotonic() < deadline and self.process.poll() is None
                time.sleep(0.02)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self.thread.join(10)
        self.process.stdout.close()


class Wire:
    """Carries bytes between the image and a peer, until told to do something else with them.

    to_board: function from the bytes read to those passed on. heard: all that the image has said, in
    pieces (time, bytes). reading: while False, nothing is fetched from the image."""

    def __init__(self, image):
        self.board = image.connect()
        self.to_board = lambda data: data
        self.reading = True
        self.heard = []
        self.stop = threading.Event()
        self.thread = threading.Thread(target=self.run, daemon=True)

    def run(self):
        """Until the image ends. A peer that has gone is missed by nobody."""
        there = True
        while not self.stop.is_set():
            sources = [self.peer_fd()] if there else []
            sources += [self.board.fileno()] if self.reading else []
            ready = select.select(sources, [], [], 0.02)[0]
            try:
                if self.board.fileno() in ready and not self.from_board(there):
                    return
                if there and self.peer_fd() in ready:
                    data = self.read_peer()
                    there = bool(data)
                    self.board.sendall(self.to_board(data))
            except (BrokenPipeError, ConnectionResetError):
                there = False

    def from_board(self, there):
        data = self.board.recv(4096)
        self.heard.append((time.monotonic(), data))
        if data and there:
            self.write_peer(data)
        return bool(data)

    def frames(self, since=0.0):
        """(id, data) of the image's frames that were heard after a time, in order."""
        text = b"".join(data for at, data in self.heard if at >= since).decode("ascii", "replace")
        found = []
        for identifier, length, data in LINE.findall(text):
            if len(data) == 2 * int(length):
                found.append((int(identifier[1:], 16), bytes.fromhex(data)))
        return found

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.stop.set()
        self.thread.join(10)
        self.board.close()
        self.close_peer()


class SocketWire(Wire):
    """The peer is a program that connects to a unix socket."""

    def __init__(self, image, path):
        super().__init__(image)
        self.path = path
        self.listener = socket.socket(socket.AF_UNIX)
        self.listener.bind(str(path))
        self.listener.listen(1)
        self.peer = None

    def run(self):
        self.listener.settimeout(30)
        self.peer, _ = self.listener.accept()
        super().run()

    def peer_fd(self):
        return self.peer.fileno()

    def read_peer(self):
        return self.peer.recv(4096)

    def write_peer(self, data):
        self.peer.sendall(data)

    def close_peer(self):
        self.listener.close()
        if self.peer:
            self.peer.close()


class PtyWire(Wire):
    """The peer opens a tty: its name is end."""

    def __init__(self, image):
        super().__init__(image)
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        self.end = os.ttyname(self.slave)

    def peer_fd(self):
        return self.master

    def read_peer(self):
        return os.read(self.master, 4096)

    def write_peer(self, data):
        os.write(self.master, data)

    def close_peer(self):
        os.close(self.master)
        os.close(self.slave)
