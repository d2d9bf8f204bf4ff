"""can-utils as a peer: its programs, run for a moment."""

import os
import re
import shutil
import subprocess
import time
from pathlib import Path

BUSES = [f"vcan{index}" for index in range(int(os.environ.get("BERTH_VCAN_BUSES", "1")))]


def tool(name):
    path = shutil.which(name, path=os.environ.get("PATH", "") + ":/usr/sbin:/sbin")
    assert path, f"{name} is not installed"
    return path


def run(*command, timeout=30):
    """(exit status, output, error output)"""
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=timeout, stdin=subprocess.DEVNULL
    )
    return done.returncode, done.stdout, done.stderr


def send(bus, *frames):
    for frame in frames:
        status, _, error = run(tool("cansend"), bus, frame)
        assert status == 0, f"cansend {bus} {frame}: {error}"


class Dump:
    """candump on some interfaces, from the moment it is entered. It ends after count frames. An
    interface may be given with candump's filters."""

    def __init__(self, *buses, count=None):
        limit = ["-n", str(count)] if count else []
        self.command = [tool("candump"), "-L", *limit, *buses]

    def __enter__(self):
        self.process = subprocess.Popen(
            self.command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self.wait_until_listening()
        return self

    def wait_until_listening(self):
        """It has opened all its sockets when it waits for frames in the kernel."""
        waits_in = Path(f"/proc/{self.process.pid}/wchan")
        deadline = time.monotonic() + 20.0
        while time.monotonic() < deadline:
            assert self.process.poll() is None, self.process.stderr.read()
            if re.search("poll|select", waits_in.read_text()):
                return
            time.sleep(0.02)
        raise AssertionError("candump does not come to listen")

    def __exit__(self, *unused):
        if self.process.poll() is None:
            self.process.terminate()
        self.process.communicate()

    def lines(self, timeout=20):
        """What it has seen, as (interface, "ID#DATA"), once it ends by itself after its count."""
        output, _ = self.process.communicate(timeout=timeout)
        return [tuple(line.split()[1:3]) for line in output.splitlines()]
