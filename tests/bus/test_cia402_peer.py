"""The CiA 402 drives that canopen plays, against canopen's own master for the profile: what the
tests of berth-board may rely on.

On vcan0 where there is one (bus tests), on python-can's virtual bus elsewhere.
"""

import os
import struct
import time

import canopen
import pytest
from canopen.profiles.p402 import BaseNode402
from canopen.sdo import SdoAbortedError

from cia402_peer import (
    ENABLED,
    FAULT,
    QUICK_STOP,
    READY,
    SWITCH_ON_DISABLED,
    SWITCHED_ON,
    Cia402Peer,
    StateMachine,
    object_dictionary,
)
from peer import wait_until

BUS = ("socketcan", os.environ["BERTH_VCAN"]) if "BERTH_VCAN" in os.environ else ("virtual", "cia402")
MASTER = 100


@pytest.mark.parametrize(
    "state, word, expected",
    [
        (SWITCH_ON_DISABLED, 0x06, READY),
        (SWITCH_ON_DISABLED, 0x07, SWITCH_ON_DISABLED),
        (SWITCH_ON_DISABLED, 0x0F, SWITCH_ON_DISABLED),
        (READY, 0x07, SWITCHED_ON),
        (READY, 0x0F, SWITCHED_ON),
        (READY, 0x02, SWITCH_ON_DISABLED),
        (READY, 0x00, SWITCH_ON_DISABLED),
        (SWITCHED_ON, 0x0F, ENABLED),
        (SWITCHED_ON, 0x06, READY),
        (SWITCHED_ON, 0x02, SWITCH_ON_DISABLED),
        (ENABLED, 0x07, SWITCHED_ON),
        (ENABLED, 0x06, READY),
        (ENABLED, 0x02, QUICK_STOP),
        (ENABLED, 0x00, SWITCH_ON_DISABLED),
        (ENABLED, 0x0F, ENABLED),
        (QUICK_STOP, 0x0F, ENABLED),
        (QUICK_STOP, 0x00, SWITCH_ON_DISABLED),
        (QUICK_STOP, 0x02, QUICK_STOP),
        (FAULT, 0x0F, FAULT),
        (FAULT, 0x00, FAULT),
        (FAULT, 0x80, SWITCH_ON_DISABLED),
    ],
)
def test_transitions(state, word, expected):
    machine = StateMachine()
    machine.state = state
    machine.control(word)
    assert machine.state == expected


def test_fault_reset_needs_an_edge():
    machine = StateMachine()
    machine.control(0x80)
    machine.state = FAULT
    machine.control(0x80)
    assert machine.state == FAULT
    machine.control(0x00)
    machine.control(0x80)
    assert machine.state == SWITCH_ON_DISABLED


@pytest.fixture(scope="module")
def peer():
    with Cia402Peer(*BUS, nodes=[1, 2]) as drives:
        yield drives


@pytest.fixture(scope="module")
def network():
    with canopen.Network() as network:
        network.connect(interface=BUS[0], channel=BUS[1])
        yield network


class Master(BaseNode402):
    """A master's view of a drive, that sends SYNC and a receive PDO periodically."""

    def __init__(self, number):
        super().__init__(number, object_dictionary(number))
        self.sync = None

    def cycle(self, period_s=0.02):
        self.rpdo[1].start(period_s)
        self.sync = self.network.send_periodic(0x080, b"", period_s)

    def halt(self):
        self.rpdo[1].stop()
        if self.sync:
            self.sync.stop()


@pytest.fixture
def master(peer, network):
    """Of drive 1, which has just booted."""
    node = Master(1)
    node.sdo.RESPONSE_TIMEOUT = 3.0
    network.add_node(node)
    told = []
    node.nmt.add_heartbeat_callback(told.append)
    node.nmt.state = "RESET"
    wait_until(lambda: 0 in told, what="the boot-up message")
    peer.drives[1].mute_heartbeat = peer.drives[1].refuse_setup = False
    yield node
    node.halt()
    node.remove_network()


def configure(node, mode=9):
    node.sdo[0x6060].raw = mode
    node.sdo[0x1017].raw = 100
    for pdo in [*node.tpdo.values(), *node.rpdo.values()]:
        pdo.read()
        pdo.clear()
        pdo.enabled = False
        pdo.trans_type = 1
    for entry in (0x6041, 0x606C, 0x6061):
        node.tpdo[1].add_variable(entry)
    node.tpdo[2].add_variable(0x6064)
    for entry in (0x6040, 0x60FF):
        node.rpdo[1].add_variable(entry)
    for pdo in (node.tpdo[1], node.tpdo[2], node.rpdo[1]):
        pdo.enabled = True
    for pdo in (node.tpdo[1], node.tpdo[2], node.rpdo[1]):
        pdo.save()


def operate(node):
    node.TIMEOUT_SWITCH_STATE_SINGLE = node.TIMEOUT_SWITCH_STATE_FINAL = 10.0
    node.TIMEOUT_CHECK_TPDO = 5.0
    configure(node)
    node.setup_402_state_machine(read_pdos=False)
    node.nmt.state = "OPERATIONAL"
    node.cycle()
    node.state = "OPERATION ENABLED"


def test_p402_master_drives_the_motor_and_stops_it(peer, master):
    drive = peer.drives[1]
    operate(master)
    assert drive.machine.state == ENABLED
    master.rpdo[1][0x60FF].raw = -120  # rpm, 2 turns/s
    wait_until(lambda: abs(drive.motor.speed + 2.0) < 0.02, what="the speed")
    wait_until(lambda: abs(master.tpdo[1][0x606C].raw + 120) < 3, what="its feedback")
    before = master.tpdo[2][0x6064].raw
    time.sleep(0.5)
    master.tpdo[2].wait_for_reception(5)
    moved = (master.tpdo[2][0x6064].raw - before) / 4096
    assert -4.0 < moved < -0.8
    assert drive.malformed == 0

    master.state = "QUICK STOP ACTIVE"
    wait_until(lambda: drive.machine.state == SWITCH_ON_DISABLED, what="the quick stop's end")
    assert abs(drive.motor.speed) < 0.05


def test_quick_stop_option_6_keeps_the_torque(peer, master):
    drive = peer.drives[1]
    master.sdo[0x605A].raw = 6
    operate(master)
    master.state = "QUICK STOP ACTIVE"
    time.sleep(0.3)
    assert (drive.machine.state, drive.motor.torque) == (QUICK_STOP, True)


def test_a_fault_is_told_by_emcy_and_reset(peer, master):
    drive = peer.drives[1]
    operate(master)
    drive.fail(0x2310)
    wait_until(lambda: master.state == "FAULT", what="the statusword")
    wait_until(lambda: [entry.code for entry in master.emcy.log] == [0x2310], what="EMCY")
    assert master.sdo[0x603F].raw == 0x2310
    assert not drive.motor.torque
    master.reset_from_fault()
    wait_until(lambda: drive.machine.state == ENABLED, what="operation enabled")
    assert [entry.code for entry in master.emcy.log] == [0x2310, 0]


@pytest.mark.parametrize("option, expected", [(0, ENABLED), (1, FAULT), (2, SWITCH_ON_DISABLED)])
def test_the_masters_heartbeat_is_watched(option, expected, peer, master, network):
    drive = peer.drives[1]
    master.sdo[0x6007].raw = option
    master.sdo[0x1016][1].raw = MASTER << 16 | 2000
    operate(master)
    for _ in range(8):
        network.send_message(0x700 + MASTER, b"\x05")
        time.sleep(0.1)
    assert drive.machine.state == ENABLED
    wait_until(lambda: 0x8130 in [entry.code for entry in master.emcy.log], what="EMCY 0x8130")
    time.sleep(0.1)
    assert drive.machine.state == expected


def test_the_heartbeat_tells_the_nmt_state(peer, master):
    master.sdo[0x1017].raw = 50
    for state in ("PRE-OPERATIONAL", "OPERATIONAL", "STOPPED"):
        master.nmt.state = state
        wait_until(lambda: master.nmt.wait_for_heartbeat(5) == state, what=state)
    peer.drives[1].mute_heartbeat = True
    time.sleep(0.3)
    with pytest.raises(canopen.nmt.NmtError):
        master.nmt.wait_for_heartbeat(0.5)


def test_pdos_are_silent_outside_operational(peer, master):
    drive = peer.drives[1]
    configure(master)
    received = drive.received_pdos
    master.cycle()
    assert master.tpdo[1].wait_for_reception(0.5) is None
    assert drive.received_pdos == received
    assert drive.machine.state == SWITCH_ON_DISABLED
    master.nmt.state = "OPERATIONAL"
    assert master.tpdo[1].wait_for_reception(5) is not None


def test_a_short_pdo_is_counted(peer, master, network):
    drive = peer.drives[1]
    configure(master)
    master.nmt.state = "OPERATIONAL"
    before = drive.malformed
    network.send_message(0x201, b"\x0f\x00")
    wait_until(lambda: drive.malformed == before + 1, what="the count")


def aborts(action, code):
    with pytest.raises(SdoAbortedError) as error:
        action()
    assert error.value.code == code


def test_downloads_that_are_refused(peer, master):
    sdo = master.sdo
    aborts(lambda: sdo.download(0x6060, 0, b"\x01"), 0x06090030)
    aborts(lambda: sdo.download(0x6041, 0, b"\0\0"), 0x06010002)
    aborts(lambda: sdo.download(0x1234, 0, b"\0"), 0x06020000)
    aborts(lambda: sdo.download(0x1016, 9, bytes(4)), 0x06090011)
    aborts(lambda: sdo.download(0x6040, 0, b"\0"), 0x06070010)
    aborts(lambda: sdo.download(0x1A00, 1, struct.pack("<I", 0x10170010)), 0x06040041)
    configure(master)
    aborts(lambda: sdo.download(0x1A00, 0, b"\0"), 0x08000022)
    assert sdo.upload(0x6061, 0) == b"\x09"
    peer.drives[1].refuse_setup = True
    aborts(lambda: sdo.download(0x1017, 0, b"\x64\0"), 0x08000022)


def test_drives_are_independent(peer, master):
    operate(master)
    assert peer.drives[1].machine.state == ENABLED
    assert peer.drives[2].machine.state == SWITCH_ON_DISABLED
    peer.drives[2].fail(0x1000)
    time.sleep(0.1)
    assert peer.drives[1].machine.state == ENABLED
    peer.drives[2].machine.state = SWITCH_ON_DISABLED
