"""A CANopen master that others wrote (the packages python-can and canopen, with its CiA 402
profile) walks the simulated drive through its states.
"""

import math
import time

import canopen
import pytest
from canopen.objectdictionary import (
    INTEGER8,
    INTEGER16,
    INTEGER32,
    UNSIGNED8,
    UNSIGNED16,
    UNSIGNED32,
    VISIBLE_STRING,
    ODArray,
    ODRecord,
    ODVariable,
)
from canopen.profiles.p402 import BaseNode402
from canopen.sdo import SdoAbortedError, SdoCommunicationError

from drive_sim import Drive

NODE = 9
MASTER = 0x10
SYNC_S = 0.02
UNITS = 4096.0 / (2.0 * math.pi)  # of a rad/s


def add_variable(dictionary, index, kind, name):
    variable = ODVariable(name, index)
    variable.data_type = kind
    dictionary.add_object(variable)


def add_members(holder, *kinds):
    for sub, kind in enumerate(kinds):
        member = ODVariable(f"{holder.name} {sub}", holder.index, sub)
        member.data_type = kind
        holder.add_member(member)
    return holder


def object_dictionary():
    dictionary = canopen.ObjectDictionary()
    for index, kind in {
        0x1000: UNSIGNED32, 0x1001: UNSIGNED8, 0x1008: VISIBLE_STRING, 0x1017: UNSIGNED16,
        0x603F: UNSIGNED16, 0x6040: UNSIGNED16, 0x6041: UNSIGNED16, 0x605A: INTEGER16,
        0x6060: INTEGER8, 0x6061: INTEGER8, 0x6064: INTEGER32, 0x606C: INTEGER32,
        0x6083: UNSIGNED32, 0x60FF: INTEGER32, 0x6502: UNSIGNED32, 0x6099: UNSIGNED32,
    }.items():
        add_variable(dictionary, index, kind, f"{index:04X}")
    dictionary.add_object(add_members(ODArray("1016", 0x1016), UNSIGNED8, UNSIGNED32))
    dictionary.add_object(add_members(ODRecord("1018", 0x1018), UNSIGNED8, *[UNSIGNED32] * 4))
    sent = (UNSIGNED8, UNSIGNED32, UNSIGNED8, UNSIGNED16, UNSIGNED8, UNSIGNED16)
    for number in range(4):
        for base, kinds in {
            0x1400: sent[:3],
            0x1600: (UNSIGNED8, *[UNSIGNED32] * 8),
            0x1800: sent,
            0x1A00: (UNSIGNED8, *[UNSIGNED32] * 8),
        }.items():
            index = base + number
            dictionary.add_object(add_members(ODRecord(f"{index:04X}", index), *kinds))
    return dictionary


def wait_until(condition, timeout=20.0):
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, "it does not come to pass"
        time.sleep(0.005)


def emergency(node, code):
    """An emergency message that has come or comes; emcy.wait may begin too late."""
    wait_until(lambda: code in [entry.code for entry in node.emcy.log])
    return next(entry for entry in node.emcy.log if entry.code == code)


@pytest.fixture
def drive(tmp_path):
    drive = Drive("cia402", NODE, tmp_path)
    yield drive
    drive.close()


@pytest.fixture
def network(drive):
    network = canopen.Network()
    network.connect(**drive.bus)
    yield network
    network.sync.stop()
    network.disconnect()


@pytest.fixture
def node(network):
    """Booted afresh, so that no frame was lost before anybody listened."""
    node = BaseNode402(NODE, object_dictionary())
    # A loaded machine, or an emulated one, may be slow to run this process.
    node.TIMEOUT_CHECK_TPDO = 2.0
    node.TIMEOUT_SWITCH_STATE_SINGLE = 5.0
    node.TIMEOUT_SWITCH_STATE_FINAL = 10.0
    node.TIMEOUT_SWITCH_OP_MODE = 5.0
    node.sdo.RESPONSE_TIMEOUT = 2.0
    network.add_node(node)
    told = []
    node.nmt.add_heartbeat_callback(told.append)
    node.nmt.state = "RESET"
    wait_until(lambda: 0 in told)  # the boot-up message; wait_for_bootup may begin too late
    # That may have been the message of the boot before. Past NOT READY TO SWITCH ON, too.
    wait_until(lambda: is_switch_on_disabled(node), timeout=20.0)
    return node


def is_switch_on_disabled(node):
    try:
        return node.sdo[0x6041].raw & 0x4F == 0x40
    except SdoCommunicationError:
        return False


def set_up(node, network):
    """Control and status words and the mode, with speeds, on SYNC; operational, SYNC running."""
    node.tpdo.read()
    node.rpdo.read()
    sent, received = node.tpdo[1], node.rpdo[1]
    sent.clear()
    for index in (0x6041, 0x606C, 0x6061):
        sent.add_variable(index)
    received.clear()
    for index in (0x6040, 0x60FF, 0x6060):
        received.add_variable(index)
    for pdo in (sent, received):
        pdo.trans_type = 1
        pdo.enabled = True
    sent.save()
    received.save()
    node.setup_402_state_machine()
    node.nmt.state = "OPERATIONAL"
    network.sync.start(SYNC_S)
    # The RPDO is written by SYNC's rhythm, as a drive of this kind expects it.
    received.start(SYNC_S)
    assert sent.wait_for_reception(5.0) is not None


def test_identity_and_aborts(node):
    assert node.sdo[0x1000].raw == 0x00020192
    assert node.sdo[0x1008].raw == "simulated CiA 402 wheel drive"
    assert node.sdo[0x1018][4].raw == NODE
    with pytest.raises(SdoAbortedError) as aborted:
        _ = node.sdo[0x6099].raw
    assert aborted.value.code == 0x06020000
    with pytest.raises(SdoAbortedError) as aborted:
        node.sdo[0x6041].raw = 1
    assert aborted.value.code == 0x06010002
    with pytest.raises(SdoAbortedError) as aborted:
        node.sdo[0x6060].raw = 8
    assert aborted.value.code == 0x06090030
    with pytest.raises(SdoAbortedError) as aborted:
        node.sdo.download(0x6060, 0, b"\x03\x00")
    assert aborted.value.code == 0x06070010
    with pytest.raises(SdoAbortedError) as aborted:
        node.sdo.download(0x1017, 0, b"\x00" * 12)  # by segments
    assert aborted.value.code == 0x05040001


def test_heartbeat_of_the_drive(node):
    node.sdo[0x1017].raw = 50
    assert node.nmt.wait_for_heartbeat(5) == "PRE-OPERATIONAL"
    node.nmt.state = "OPERATIONAL"
    wait_until(lambda: node.nmt.wait_for_heartbeat(5) == "OPERATIONAL")
    node.nmt.state = "STOPPED"
    wait_until(lambda: node.nmt.wait_for_heartbeat(5) == "STOPPED")


@pytest.mark.parametrize("mode", ["PROFILED VELOCITY", "CYCLIC SYNCHRONOUS VELOCITY"])
def test_through_all_states(node, network, drive, mode):
    set_up(node, network)
    node.op_mode = mode
    assert node.op_mode == mode
    assert node.state == "SWITCH ON DISABLED"
    node.state = "READY TO SWITCH ON"
    node.state = "SWITCHED ON"
    assert drive.status()["enabled"] == 0
    node.state = "OPERATION ENABLED"
    assert drive.status()["enabled"] == 1

    node.rpdo[1][0x60FF].raw = round(5.0 * UNITS)
    wait_until(lambda: abs(node.tpdo[1][0x606C].raw - 5.0 * UNITS) < 10)
    status = drive.status()
    assert status["target"] == pytest.approx(5.0, abs=1e-3)
    assert status["speed"] == pytest.approx(5.0, abs=0.02)
    assert node.sdo[0x6064].raw > 0

    node.rpdo[1][0x60FF].raw = round(-3.0 * UNITS)
    wait_until(lambda: abs(node.tpdo[1][0x606C].raw + 3.0 * UNITS) < 10)

    # Quick stop: option 2 ends in switch on disabled.
    node.controlword = 0x02
    wait_until(lambda: node.state == "SWITCH ON DISABLED")
    assert drive.status()["enabled"] == 0
    assert drive.status()["malformed"] == 0


def test_quick_stop_that_stays(node, network, drive):
    set_up(node, network)
    node.sdo[0x605A].raw = 6
    node.op_mode = "CYCLIC SYNCHRONOUS VELOCITY"
    node.state = "OPERATION ENABLED"
    node.rpdo[1][0x60FF].raw = round(5.0 * UNITS)
    wait_until(lambda: drive.status()["speed"] > 4.0)
    node.state = "QUICK STOP ACTIVE"
    wait_until(lambda: abs(drive.status()["speed"]) < 0.05)
    assert node.state == "QUICK STOP ACTIVE"
    node.state = "OPERATION ENABLED"
    wait_until(lambda: drive.status()["speed"] > 4.0)


def test_fault_and_its_reset(node, network, drive):
    set_up(node, network)
    node.op_mode = "PROFILED VELOCITY"
    node.state = "OPERATION ENABLED"
    node.rpdo[1][0x60FF].raw = round(5.0 * UNITS)
    wait_until(lambda: drive.status()["speed"] > 4.0)
    drive.fail(0x2310)
    assert emergency(node, 0x2310).register == 0x03
    wait_until(lambda: node.state == "FAULT")
    wait_until(lambda: drive.status()["enabled"] == 0)
    assert node.sdo[0x603F].raw == 0x2310
    node.rpdo[1][0x60FF].raw = 0
    node.reset_from_fault()
    assert node.state == "OPERATION ENABLED"
    assert node.sdo[0x603F].raw == 0
    assert node.emcy.active == []
    assert drive.status()["enabled"] == 1


def test_drive_stops_when_the_master_falls_silent(node, network, drive):
    set_up(node, network)
    node.sdo[0x1016][1].raw = MASTER << 16 | 500
    heartbeat = network.send_periodic(0x700 + MASTER, b"\x05", 0.05)
    node.op_mode = "CYCLIC SYNCHRONOUS VELOCITY"
    node.state = "OPERATION ENABLED"
    node.rpdo[1][0x60FF].raw = round(5.0 * UNITS)
    wait_until(lambda: drive.status()["speed"] > 4.0)
    time.sleep(1.0)
    assert drive.status()["stops"] == 0
    heartbeat.stop()
    emergency(node, 0x8130)
    wait_until(lambda: drive.status()["enabled"] == 0)
    assert drive.status()["target"] == 0.0
    assert drive.status()["stops"] == 1


def test_drive_that_refuses_its_set_up(node, drive):
    drive.trouble("refuse-setup")
    with pytest.raises(SdoAbortedError) as aborted:
        node.sdo[0x6060].raw = 3
    assert aborted.value.code == 0x08000022
