#!/usr/bin/env python3
"""Plays CANopen wheel drives with the drive profile CiA 402. The communication (SDO server, NMT,
heartbeat, PDO packing) is the canopen package's; the object dictionary and the state machine are
written here from the profile, sharing nothing with Berth's own code.

    cia402_peer.py --interface socketcan --channel vcan0 --node 1 --node 2

or, within a test:

    with Cia402Peer("virtual", "x", nodes=[1, 2]) as peer:
        peer.drives[1].motor.speed

What a drive has: profile and cyclic synchronous velocity (0x6060: 3, 9; the ramps are
the motor's lag), two receive and four
transmit PDOs with free mapping, sent and obeyed on SYNC, heartbeat producer (0x1017) and one
consumer (0x1016:1) whose loss is an EMCY 0x8130 and what 0x6007 says, quick stop by 0x605A,
EMCY, fault reset. SDO downloads that a drive refuses get the abort codes of CiA 301.
"""

import argparse
import struct
import threading
import time

import can
import canopen
from canopen.objectdictionary import (
    INTEGER8,
    INTEGER16,
    INTEGER32,
    UNSIGNED8,
    UNSIGNED16,
    UNSIGNED32,
    ODRecord,
    ODVariable,
    ObjectDictionary,
)
from canopen.sdo import SdoAbortedError

from peer import Motor

SWITCH_ON_DISABLED, READY, SWITCHED_ON, ENABLED, QUICK_STOP, FAULT = (
    "switch on disabled",
    "ready to switch on",
    "switched on",
    "operation enabled",
    "quick stop active",
    "fault",
)
STATUS_BITS = {
    SWITCH_ON_DISABLED: 0x0240,
    READY: 0x0221,
    SWITCHED_ON: 0x0233,
    ENABLED: 0x0237,
    QUICK_STOP: 0x0217,
    FAULT: 0x0208,
}
MODES = (3, 9)
INVALID = 1 << 31
LINK_LOST = 0x8130
ABORT_RANGE, ABORT_STATE, ABORT_MAPPING, ABORT_LENGTH = (
    0x06090030,
    0x08000022,
    0x06040041,
    0x06040042,
)
# Index: name, type, access, value at power-on, may be mapped.
OBJECTS = {
    0x1000: ("device type", UNSIGNED32, "ro", 0x00020192, False),
    0x1001: ("error register", UNSIGNED8, "ro", 0, True),
    0x1017: ("producer heartbeat time", UNSIGNED16, "rw", 0, False),
    0x6007: ("abort connection option code", INTEGER16, "rw", 1, False),
    0x603F: ("error code", UNSIGNED16, "ro", 0, True),
    0x6040: ("controlword", UNSIGNED16, "rww", 0, True),
    0x6041: ("statusword", UNSIGNED16, "ro", 0, True),
    0x605A: ("quick stop option code", INTEGER16, "rw", 2, False),
    0x6060: ("modes of operation", INTEGER8, "rww", 0, True),
    0x6061: ("modes of operation display", INTEGER8, "ro", 0, True),
    0x6064: ("position actual value", INTEGER32, "ro", 0, True),
    0x606C: ("velocity actual value", INTEGER32, "ro", 0, True),
    0x6083: ("profile acceleration", UNSIGNED32, "rw", 1000, False),
    0x6084: ("profile deceleration", UNSIGNED32, "rw", 1000, False),
    0x6085: ("quick stop deceleration", UNSIGNED32, "rw", 1000, False),
    0x60FF: ("target velocity", INTEGER32, "rww", 0, True),
    0x6502: ("supported drive modes", UNSIGNED32, "ro", 1 << 2 | 1 << 8, False),
}


def variable(index, subindex, name, kind, access, value, mappable=False):
    entry = ODVariable(name, index, subindex)
    entry.data_type = kind
    entry.access_type = access
    entry.default = value
    entry.pdo_mappable = mappable
    return entry


def record(index, name, members):
    """members: (sub-index, name, type, access, value at power-on)"""
    entry = ODRecord(name, index)
    for subindex, label, kind, access, value in members:
        entry.add_member(variable(index, subindex, label, kind, access, value))
    return entry


def pdo_records(number, node, is_transmit):
    parameters = (0x1800 if is_transmit else 0x1400) + number
    mapping = (0x1A00 if is_transmit else 0x1600) + number
    identifier = (0x180 if is_transmit else 0x200) + number * 0x100 + node
    kind = "transmit" if is_transmit else "receive"
    yield record(
        parameters,
        f"{kind} PDO {number + 1} parameters",
        [
            (0, "highest sub-index", UNSIGNED8, "ro", 2),
            (1, "COB-ID", UNSIGNED32, "rw", identifier | INVALID),
            (2, "transmission type", UNSIGNED8, "rw", 255),
        ],
    )
    entries = [(index, f"object {index}", UNSIGNED32, "rw", 0) for index in range(1, 5)]
    yield record(
        mapping,
        f"{kind} PDO {number + 1} mapping",
        [(0, "number of objects", UNSIGNED8, "rw", 0), *entries],
    )


def object_dictionary(node):
    dictionary = ObjectDictionary()
    dictionary.node_id = node
    for index, (name, kind, access, value, mappable) in OBJECTS.items():
        dictionary.add_object(variable(index, 0, name, kind, access, value, mappable))
    dictionary.add_object(
        record(
            0x1016,
            "consumer heartbeat time",
            [
                (0, "highest sub-index", UNSIGNED8, "ro", 1),
                (1, "first", UNSIGNED32, "rw", 0),
            ],
        )
    )
    dictionary.add_object(
        record(
            0x60C2,
            "interpolation time period",
            [
                (0, "highest sub-index", UNSIGNED8, "ro", 2),
                (1, "value", UNSIGNED8, "rw", 10),
                (2, "power of ten", INTEGER8, "rw", -3),
            ],
        )
    )
    for number in range(4):
        for entry in pdo_records(number, node, is_transmit=True):
            dictionary.add_object(entry)
        if number < 2:
            for entry in pdo_records(number, node, is_transmit=False):
                dictionary.add_object(entry)
    return dictionary


class StateMachine:
    """The power drive system's states, driven by controlwords."""

    def __init__(self):
        self.state = SWITCH_ON_DISABLED
        self.controlword = 0

    def control(self, word):
        """Takes one controlword: at most one transition."""
        rising = word & ~self.controlword
        self.controlword = word
        state = self.state
        if state == FAULT:
            if rising & 0x80:
                self.state = SWITCH_ON_DISABLED
        elif not word & 0x02:  # disable voltage
            self.state = SWITCH_ON_DISABLED
        elif not word & 0x04:  # quick stop
            if state in (READY, SWITCHED_ON):
                self.state = SWITCH_ON_DISABLED
            elif state == ENABLED:
                self.state = QUICK_STOP
        elif not word & 0x01:  # shutdown
            if state in (SWITCH_ON_DISABLED, SWITCHED_ON, ENABLED):
                self.state = READY
        elif state == READY:
            self.state = SWITCHED_ON
        elif word & 0x08:  # enable operation
            if state in (SWITCHED_ON, QUICK_STOP):
                self.state = ENABLED
        elif state == ENABLED:  # disable operation
            self.state = SWITCHED_ON


class Drive:
    """One drive: a LocalNode of canopen's, a state machine and a motor."""

    def __init__(self, network, number, units_per_rps, counts_per_turn):
        self.network = network
        self.units_per_rps = units_per_rps
        self.counts_per_turn = counts_per_turn
        self.lock = threading.RLock()
        self.machine = StateMachine()
        self.motor = Motor()
        self.error_code = 0
        self.mode = 0
        self.target = 0.0
        self.master = None  # (node, timeout in seconds, time of its last heartbeat or None)
        self.mute_heartbeat = False
        self.refuse_setup = False
        self.received_pdos = 0
        self.malformed = 0
        self.receive_ids = {}
        self.node = network.create_node(number, object_dictionary(number))
        self.node.add_read_callback(self.on_read)
        self.node.add_write_callback(self.on_write)
        network.subscribe(0x000, self.on_nmt)
        network.subscribe(0x080, self.on_sync)

    def boot(self):
        """Power-on, or an NMT reset: all settings are lost."""
        with self.lock:
            self.node.data_store.clear()
            for pdo in [*self.node.tpdo.values(), *self.node.rpdo.values()]:
                pdo.enabled = False
            for identifier in self.receive_ids:
                self.network.unsubscribe(identifier, self.on_receive_pdo)
            self.receive_ids.clear()
            self.machine = StateMachine()
            self.motor.torque = False
            self.error_code = 0
            self.mode = 0
            self.target = 0.0
            self.watch(0)
        self.node.nmt.stop_heartbeat()
        self.node.nmt.state = "INITIALISING"
        self.node.nmt.state = "PRE-OPERATIONAL"

    def on_nmt(self, unused_id, data, unused_time):
        if len(data) == 2 and data[1] in (0, self.node.id) and data[0] in (129, 130):
            self.boot()

    def on_read(self, index, subindex, od):
        with self.lock:
            values = {
                0x1001: int(self.error_code != 0),
                0x603F: self.error_code,
                0x6041: STATUS_BITS[self.machine.state],
                0x6061: self.mode,
                0x6064: self.position(),
                0x606C: round(self.motor.speed * self.units_per_rps),
            }
        return values.get(index)

    def position(self):
        counts = int(self.motor.turns * self.counts_per_turn)
        return (counts + (1 << 31)) % (1 << 32) - (1 << 31)

    def on_write(self, index, subindex, od, data):
        """Before a value is stored: refuses it by an exception, or acts on it."""
        value = od.decode_raw(data)
        if self.refuse_setup and index != 0x6040:
            raise SdoAbortedError(ABORT_STATE)
        with self.lock:
            if index == 0x6040:
                self.control(value)
            elif index == 0x6060:
                if value not in MODES:
                    raise SdoAbortedError(ABORT_RANGE)
                self.mode = value
            elif index == 0x60FF:
                self.set_target(value)
            elif index == 0x1016 and subindex == 1:
                self.watch(value)
            elif 0x1400 <= index < 0x1C00:
                self.set_pdo(index, subindex, value)

    def watch(self, value):
        node, milliseconds = value >> 16 & 0x7F, value & 0xFFFF
        if self.master:
            self.network.unsubscribe(0x700 + self.master[0], self.on_heartbeat)
        self.master = (node, milliseconds / 1000, None) if node and milliseconds else None
        if self.master:
            self.network.subscribe(0x700 + node, self.on_heartbeat)

    def on_heartbeat(self, unused_id, data, unused_time):
        with self.lock:
            if self.master and len(data) == 1:
                self.master = (*self.master[:2], time.monotonic())

    def set_pdo(self, index, subindex, value):
        is_transmit = bool(index & 0x800)
        number = (index & 0x1FF) + 1
        pdo = (self.node.tpdo if is_transmit else self.node.rpdo)[number]
        if index & 0x200:
            self.check_mapping(pdo, index, subindex, value)
        elif subindex == 1:
            if pdo.enabled and not value & INVALID:
                raise SdoAbortedError(ABORT_RANGE)  # only an invalid PDO may be changed
            self.enable_pdo(pdo, index, value, is_transmit)

    def check_mapping(self, pdo, index, subindex, value):
        """CiA 301: the mapping of a valid PDO is fixed, and so are its entries while they count."""
        stored = self.node.data_store.get(index, {})
        if pdo.enabled or (subindex and stored.get(0, b"\0")[0]):
            raise SdoAbortedError(ABORT_STATE)
        if subindex:
            entry = OBJECTS.get(value >> 16)
            if not entry or not entry[4] or value >> 8 & 0xFF:
                raise SdoAbortedError(ABORT_MAPPING)
        elif value:
            if value > 4:
                raise SdoAbortedError(ABORT_RANGE)
            sizes = [stored.get(entry, bytes(4))[0] for entry in range(1, value + 1)]
            if 0 in sizes or sum(sizes) > 64:
                raise SdoAbortedError(ABORT_LENGTH)

    def enable_pdo(self, pdo, index, value, is_transmit):
        pdo.enabled = not value & INVALID
        pdo.cob_id = value & 0x7FF
        self.receive_ids = {key: kept for key, kept in self.receive_ids.items() if kept is not pdo}
        if not pdo.enabled:
            return
        pdo.trans_type = self.node.get_data(index, 2)[0]
        mapping = index + 0x200
        pdo.clear()
        for entry in range(1, self.node.get_data(mapping, 0)[0] + 1):
            packed = struct.unpack("<I", self.node.get_data(mapping, entry))[0]
            pdo.add_variable(packed >> 16, packed >> 8 & 0xFF, packed & 0xFF)
        if not is_transmit:
            self.receive_ids[pdo.cob_id] = pdo
            self.network.subscribe(pdo.cob_id, self.on_receive_pdo)

    def on_receive_pdo(self, identifier, data, timestamp):
        with self.lock:
            pdo = self.receive_ids.get(identifier)
            if pdo is None or self.node.nmt.state != "OPERATIONAL":
                return
            if len(data) < len(pdo.data):
                self.malformed += 1
                return
            self.received_pdos += 1
            pdo.on_message(identifier, bytearray(data), timestamp)
            if pdo.trans_type > 240:
                self.obey(pdo)

    def obey(self, pdo):
        for entry in pdo:
            if entry.index == 0x6040:
                self.control(entry.raw)
            elif entry.index == 0x60FF:
                self.set_target(entry.raw)
            elif entry.index == 0x6060 and entry.raw in MODES:
                self.mode = entry.raw

    def on_sync(self, unused_id, data, unused_time):
        if self.node.nmt.state != "OPERATIONAL":
            return
        with self.lock:
            for pdo in self.receive_ids.values():
                if pdo.trans_type <= 240 and pdo.is_received:
                    pdo.is_received = False
                    self.obey(pdo)
            self.motor.advance(time.monotonic())
            for pdo in self.node.tpdo.values():
                if pdo.enabled and 1 <= (pdo.trans_type or 0) <= 240:
                    for entry in pdo:
                        entry.raw = self.on_read(entry.index, 0, None)
                    pdo.transmit()

    def set_target(self, units):
        self.motor.advance(time.monotonic())
        self.target = units / self.units_per_rps
        if self.machine.state == ENABLED and self.mode in MODES:
            self.motor.target = self.target

    def control(self, word):
        before = self.machine.state
        self.motor.advance(time.monotonic())
        self.machine.control(word)
        after = self.machine.state
        if before == FAULT and after != FAULT:
            self.error_code = 0
            self.node.emcy.reset()
        self.act(before, after)

    def act(self, before, after):
        self.motor.torque = after in (ENABLED, QUICK_STOP)
        if after != before:
            self.motor.target = self.target if after == ENABLED and self.mode in MODES else 0.0

    def fail(self, code):
        """An error of the drive's own: EMCY, and no torque."""
        with self.lock:
            before, self.machine.state = self.machine.state, FAULT
            self.error_code = code
            self.motor.advance(time.monotonic())
            self.act(before, FAULT)
            self.node.emcy.send(code, 1)

    def poll(self):
        """What needs no frame to happen: the end of a quick stop, the master's silence."""
        with self.lock:
            self.motor.advance(time.monotonic())
            if self.machine.state == QUICK_STOP and abs(self.motor.speed) < 0.01:
                if self.option(0x605A) in (1, 2, 3, 4):
                    self.machine.state = SWITCH_ON_DISABLED
                    self.act(QUICK_STOP, SWITCH_ON_DISABLED)
            if self.master and self.master[2] is not None:
                if time.monotonic() - self.master[2] > self.master[1]:
                    self.master = (*self.master[:2], None)
                    self.lose_link()
        if self.mute_heartbeat:
            self.node.nmt.stop_heartbeat()

    def option(self, index):
        return struct.unpack("<h", self.node.get_data(index, 0))[0]

    def lose_link(self):
        option = self.option(0x6007)
        before = self.machine.state
        if option == 1:
            self.fail(LINK_LOST)
            return
        self.node.emcy.send(LINK_LOST, 1)
        if option in (2, 3) and before == ENABLED:
            self.machine.state = QUICK_STOP if option == 3 else SWITCH_ON_DISABLED
            self.act(before, self.machine.state)


class Cia402Peer:
    """Some drives on one bus."""

    def __init__(self, interface, channel, nodes, units_per_rps=60.0, counts_per_turn=4096):
        self.network = canopen.Network()
        self.interface = interface
        self.channel = channel
        self.drives = {
            node: Drive(self.network, node, units_per_rps, counts_per_turn) for node in nodes
        }
        self.stopping = threading.Event()
        self.thread = threading.Thread(target=self.run, daemon=True)

    def run(self):
        while not self.stopping.wait(0.02):
            for drive in self.drives.values():
                drive.poll()

    def __enter__(self):
        self.network.connect(interface=self.interface, channel=self.channel)
        for drive in self.drives.values():
            drive.boot()
        self.thread.start()
        return self

    def __exit__(self, *unused):
        self.stopping.set()
        self.thread.join(20.0)
        for drive in self.drives.values():
            drive.node.nmt.stop_heartbeat()
        self.network.check()
        self.network.disconnect()


def main():
    parser = argparse.ArgumentParser(description="Plays CiA 402 drives on a CANopen bus.")
    parser.add_argument("--interface", default="socketcan")
    parser.add_argument("--channel", default="vcan0")
    parser.add_argument("--node", type=int, action="append", required=True)
    parser.add_argument("--units-per-rps", type=float, default=60.0)
    parser.add_argument("--counts-per-turn", type=int, default=4096)
    options = parser.parse_args()
    peer = Cia402Peer(
        options.interface,
        options.channel,
        options.node,
        options.units_per_rps,
        options.counts_per_turn,
    )
    try:
        with peer:
            while True:
                time.sleep(0.2)
                peer.network.check()
    except KeyboardInterrupt:
        pass
    except can.CanError as error:
        raise SystemExit(str(error)) from error


if __name__ == "__main__":
    main()
