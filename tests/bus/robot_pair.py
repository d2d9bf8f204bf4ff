"""berth-board and berth-robot as two processes on one CAN interface."""

import json
import os
import signal
import subprocess
import time
from pathlib import Path

BUILD = Path(os.environ["BERTH_BUILD_DIR"])
SANITIZED = BUILD.parent / "clang-asan"
PROGRAMS = {"board": os.environ["BERTH_BOARD"], "robot": os.environ["BERTH_ROBOT"],
            "sim": os.environ["BERTH_SIM"]}

def ids(drive):
    """Node numbers: those that the databases in tools/ have, where the protocol allows 0."""
    left = 1 if drive == "cia402" else 0
    return ["--left", str(left), "--right", str(left + 1)]


def sanitized(name):
    """A program of the build with sanitizers, where it was made, else the usual one."""
    path = SANITIZED / "host_sim" / f"berth-{name}"
    return str(path) if path.is_file() else PROGRAMS[name]


class Process:
    """One of the programs, with its summary as JSON."""

    def __init__(self, program, bus, drive, scenario, *arguments):
        self.process = subprocess.Popen(
            [program, "--can", f"socketcan:{bus}", "--drive", drive, *ids(drive), scenario, "--json",
             *map(str, arguments)],
            text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL)

    def finish(self, timeout):
        """(exit status, summary, error output); the process is gone afterwards."""
        try:
            out, self.error = self.process.communicate(timeout=timeout)
        except subprocess.TimeoutExpired:
            self.process.kill()
            out, self.error = self.process.communicate()
        assert "AddressSanitizer" not in self.error and "runtime error" not in self.error, self.error
        return self.process.returncode, json.loads(out) if out else None, self.error

    def interrupt(self):
        self.process.send_signal(signal.SIGINT)


class Pair:
    """A robot and, once it listens, a board."""

    def __init__(self, bus, drive, scenario, board=(), robot=(), programs=PROGRAMS, both=()):
        self.robot = Process(programs["robot"], bus, drive, scenario, *both, *robot)
        time.sleep(1.0)
        self.board = Process(programs["board"], bus, drive, scenario, *both, *board)

    def finish(self, timeout=120):
        board = self.board.finish(timeout)
        return board, self.robot.finish(timeout)

    def __enter__(self):
        return self

    def __exit__(self, *unused):
        for one in (self.board, self.robot):
            if one.process.poll() is None:
                one.process.kill()
                one.process.communicate()


def in_process(scenario, *arguments):
    """The summary of the same run without a bus."""
    done = subprocess.run([PROGRAMS["sim"], "run", scenario, "--json", *arguments], text=True,
                          capture_output=True, check=True, timeout=60)
    return json.loads(done.stdout)
