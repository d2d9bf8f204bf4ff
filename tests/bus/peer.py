"""What the peers share: a wheel with some inertia, and a thread that runs a peer."""

import math
import threading
import time


class Motor:
    """A motor with a speed loop: the speed follows its target with a time constant, and runs out
    slower without torque. Turns and turns/s, of the motor."""

    def __init__(self, lag_s=0.02, coast_s=0.3):
        self.lag_s = lag_s
        self.coast_s = coast_s
        self.torque = False
        self.target = 0.0
        self.speed = 0.0
        self.turns = 0.0
        self.at_s = None

    def advance(self, now_s):
        """Brings speed and turns up to now, exactly for a target that was constant until now."""
        elapsed = 0.0 if self.at_s is None else max(0.0, now_s - self.at_s)
        self.at_s = now_s
        target = self.target if self.torque else 0.0
        constant = self.lag_s if self.torque else self.coast_s
        decay = math.exp(-elapsed / constant)
        self.turns += target * elapsed + (self.speed - target) * constant * (1.0 - decay)
        self.speed = target + (self.speed - target) * decay


class Runner:
    """Runs a peer's poll(seconds) in a thread until the end of the with block. What goes wrong in
    the thread is raised there."""

    def __init__(self, poll):
        self.poll = poll
        self.stopping = threading.Event()
        self.error = None
        self.thread = threading.Thread(target=self.run, daemon=True)

    def run(self):
        try:
            while not self.stopping.is_set():
                self.poll(0.05)
        except Exception as error:  # raised again by stop
            self.error = error

    def start(self):
        self.thread.start()

    def stop(self):
        self.stopping.set()
        self.thread.join(20.0)
        assert not self.thread.is_alive()
        if self.error:
            raise self.error


def wait_until(condition, timeout_s=20.0, what="that"):
    """Polls a condition; its last value when it became true, an error when it never does."""
    deadline = time.monotonic() + timeout_s
    while not (value := condition()):
        assert time.monotonic() < deadline, f"{what} did not come within {timeout_s:g} s"
        time.sleep(0.005)
    return value
