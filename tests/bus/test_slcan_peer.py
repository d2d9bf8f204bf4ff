"""python-can's slcan interface at the other end of a line to ours, in both of our roles."""

import json
import os
import random
import select
import subprocess
import threading
import tty
from pathlib import Path

import can
import pytest

PROGRAM = Path(os.environ["BERTH_BUILD_DIR"]) / "tests" / "slcan-echo"
SEED = int(os.environ.get("BERTH_TEST_SEED", "20240917"))
FRAMES = 100 if os.environ.get("BERTH_TEST_EFFORT") == "short" else 500
ACTIVE, DOWN = 0, 3


class Cable:
    """Two ptys joined at their masters: each end has a name to be opened."""

    def __init__(self):
        pairs = [os.openpty() for _ in range(2)]
        for _, slave in pairs:
            tty.setraw(slave)
        self.masters = [master for master, _ in pairs]
        self.slaves = [slave for _, slave in pairs]
        self.ends = [os.ttyname(slave) for slave in self.slaves]
        self.stop = threading.Event()
        self.thread = threading.Thread(target=self.pump)
        self.thread.start()

    def pump(self):
        other = {self.masters[0]: self.masters[1], self.masters[1]: self.masters[0]}
        while not self.stop.is_set():
            for master in select.select(self.masters, [], [], 0.05)[0]:
                os.write(other[master], os.read(master, 4096))

    def close(self):
        self.stop.set()
        self.thread.join()
        for handle in self.masters + self.slaves:
            os.close(handle)


@pytest.fixture
def cable():
    made = Cable()
    yield made
    made.close()


def start(role, path):
    return subprocess.Popen([PROGRAM, role, path], stdin=subprocess.PIPE, stdout=subprocess.PIPE)


def counters(program):
    output, _ = program.communicate(timeout=10)
    assert program.returncode == 0
    return json.loads(output)


def random_message(rng):
    extended = rng.random() < 0.5
    remote = rng.random() < 0.25
    length = rng.randrange(9)
    return can.Message(
        arbitration_id=rng.randrange(1 << (29 if extended else 11)),
        is_extended_id=extended,
        is_remote_frame=remote,
        dlc=length,
        data=None if remote else rng.randbytes(length),
    )


def receive(bus):
    message = bus.recv(timeout=5)
    assert message is not None, "no echo"
    return message


def expect_echo(sent, got):
    ids = 1 << (29 if sent.is_extended_id else 11)
    assert got.arbitration_id == (sent.arbitration_id + 1) % ids
    assert got.is_extended_id == sent.is_extended_id
    assert got.is_remote_frame == sent.is_remote_frame
    assert got.dlc == sent.dlc
    if not sent.is_remote_frame:
        assert got.data == sent.data


@pytest.mark.parametrize("role", ["host", "adapter"])
def test_every_kind_of_frame_goes_there_and_back(cable, role):
    print(f"seed {SEED} (BERTH_TEST_SEED)")
    rng = random.Random(SEED)
    program = start(role, cable.ends[0])
    with can.Bus(
        interface="slcan", channel=cable.ends[1], bitrate=1000000, sleep_after_open=0.2
    ) as bus:
        assert bus.get_version(5) == (10, 13)
        assert bus.get_serial_number(5) == "B001"
        for _ in range(FRAMES):
            message = random_message(rng)
            bus.send(message)
            expect_echo(message, receive(bus))
        burst = [random_message(rng) for _ in range(10)]
        for message in burst:
            bus.send(message)
        for message in burst:
            expect_echo(message, receive(bus))
    # It closed the channel: an adapter is down, a host has another host that is silent.
    got = counters(program)
    assert got["received"] == got["sent"] == FRAMES + 10
    assert got["mode"] == (DOWN if role == "adapter" else ACTIVE)
    assert got["tx_dropped"] == got["error_frames"] == got["malformed"] == got["unsaid"] == 0
    assert got["commands"] >= 6


def test_an_adapter_that_is_closed_and_opened_again(cable):
    program = start("adapter", cable.ends[0])
    for _ in range(2):
        with can.Bus(
            interface="slcan", channel=cable.ends[1], bitrate=500000, sleep_after_open=0.2
        ) as bus:
            message = can.Message(arbitration_id=0x10, is_extended_id=False, data=[1, 2])
            bus.send(message)
            expect_echo(message, receive(bus))
    got = counters(program)
    assert got["received"] == 2
    # Each time it opens the channel twice around the bit rate; the second is refused.
    assert got["restarts"] == 1
    assert got["mode"] == DOWN


def test_an_adapter_that_only_listens_to_us(cable):
    program = start("adapter", cable.ends[0])
    with can.Bus(
        interface="slcan", channel=cable.ends[1], bitrate=1000000, sleep_after_open=0.2,
        listen_only=True,
    ) as bus:
        bus.send(can.Message(arbitration_id=0x10, is_extended_id=False))
        assert bus.recv(timeout=0.3) is None
    assert counters(program)["received"] == 0
