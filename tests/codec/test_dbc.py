"""tools/*.dbc and the codecs of Berth's own frames must describe the same bytes.

cantools, which reads the DBC and knows nothing of Berth, encodes and decodes random and extreme
values of every signal of every message; tests/codec/berth_codec.c does the same with our codecs.
"""

import math
import os
import random
import re
import struct
import subprocess
from pathlib import Path

import cantools
import pytest

ROOT = Path(os.environ["BERTH_SOURCE_DIR"])
PROGRAM = Path(os.environ["BERTH_BUILD_DIR"]) / "tests" / "berth-codec"
SEED = int(os.environ.get("BERTH_TEST_SEED", "20240917"))
CASES = 500 if os.environ.get("BERTH_TEST_EFFORT") == "short" else 6000

HEADING = 31416
POSE = [("X", 10000, 24), ("Y", 10000, 24), ("Theta", 10000, 16)]
# kind: message and its float signals, in the order of the struct: name, units in 1, bits
REALS = {
    "pose": ("Pose", POSE),
    "pose_fix": ("PoseFix", POSE),
    "obstacle": ("Obstacle", [("X", 100, 16), ("Y", 100, 16), ("Radius", 100, 8)]),
    "status": ("Status", [("Clearance", 1000, 16)]),
    "error": (
        "TrackingError",
        [("E1", 1000, 16), ("E2", 1000, 16), ("E3", 10000, 16), ("Speed", 1000, 16)],
    ),
}
KINDS = ["command", *REALS]
STATUS = ["State", "Mode", "Fault", "Total", "Active", "Finished", "Braking", "Limited"]
STATUS_BITS = [4, 4, 8, 24, 5, 1, 1, 1]


def load(name):
    return cantools.database.load_file(ROOT / "tools" / f"{name}.dbc", strict=True)


@pytest.fixture(scope="module")
def dbc():
    return load("berth")


@pytest.fixture(scope="module")
def rng():
    print(f"seed {SEED} (BERTH_TEST_SEED)")
    return random.Random(SEED)


def ask(lines):
    """All answers of one run."""
    run = subprocess.run([PROGRAM], input="\n".join(lines) + "\n", capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    answers = run.stdout.splitlines()
    assert len(answers) == len(lines)
    return answers


def single(value):
    """The nearest float32."""
    try:
        return struct.unpack("<f", struct.pack("<f", value))[0]
    except OverflowError:
        return math.copysign(math.inf, value)


def bits(value):
    return struct.pack(">f", value).hex()


def from_bits(text):
    return struct.unpack(">f", bytes.fromhex(text))[0]


def message_of(dbc, kind):
    return dbc.get_message_by_name("Command" if kind == "command" else REALS[kind][0])


def random_real(rng, name, per_unit, width):
    """Float32 values: all over the range, between two numbers, at the ends, extreme, not finite."""
    most = 2 ** (width - 1) / per_unit
    if name in ("Theta", "E3"):
        most = math.pi  # beyond, berth_wrap decides: see test_headings_are_wrapped
    choice = rng.randrange(10)
    if choice < 4:
        value = rng.uniform(-most, most)
    elif choice < 6:
        value = (rng.randrange(-int(most * per_unit), int(most * per_unit)) + 0.5) / per_unit
    elif choice == 6:
        value = rng.choice([-1, 1]) * 10 ** rng.uniform(-45, 0)
    elif choice == 7 and most != math.pi:
        value = rng.choice([-1, 1]) * rng.choice([1, 2, 256, 1e30]) * most
        value += rng.uniform(-3, 3) / per_unit
    elif choice == 8:
        value = rng.choice([0.0, -0.0, 0.5 / per_unit, 1 / 32, -3 / 32, 1.0])
    else:
        value = rng.choice([math.nan, math.inf, -math.inf, rng.uniform(-most, most)])
    value = single(value)
    if most == math.pi and abs(value) > 3.1415925:
        value = 0.0
    return value


def expected_physical(name, value, signal, per_unit):
    """What the header says becomes of a value; None where it has no number of its own."""
    signed = signal.is_signed
    most = 2 ** (signal.length - 1) - 1 if signed else 2**signal.length - 1
    if name == "Clearance":
        most -= 1
    if not math.isfinite(value):
        return {"Radius": most / per_unit, "Clearance": 0.0}.get(name)
    return min(max(value, -most / per_unit if signed else 0.0), most / per_unit)


def cantools_bytes(message, numbers, reals, table):
    """reals: physical values, None for not finite. Encoded by cantools alone."""
    data = dict(numbers)
    holes = {}
    for name, _, width in table:
        if reals[name] is None:
            holes[name] = -(2 ** (width - 1))
        data[name] = 0 if reals[name] is None else reals[name]
    encoded = message.encode(data, strict=False)
    if holes:
        raw = message.decode(encoded, scaling=False, decode_choices=False)
        encoded = message.encode({**raw, **holes}, scaling=False, strict=False)
    return encoded


def random_numbers(rng, kind):
    """The signals that are not floats."""
    if kind == "obstacle":
        ttl_ms = rng.choice([0, 1, 65535, rng.randrange(65536)])
        return {"Id": rng.randrange(256), "TimeToLive": ttl_ms}
    if kind == "status":
        sizes = [2**n for n in STATUS_BITS]
        return {
            name: rng.choice([0, size - 1, rng.randrange(size)])
            for name, size in zip(STATUS, sizes)
        }
    return {}


def encode_line(kind, address, numbers, values):
    reals = [bits(value) for value in values]
    if kind == "obstacle":
        words = [numbers["Id"], *reals, numbers["TimeToLive"]]
    else:
        words = [*numbers.values(), *reals]
    return " ".join(str(word) for word in ["encode", kind, address, *words])


@pytest.mark.parametrize("kind", REALS)
def test_encoding_equals_cantools(dbc, rng, kind):
    message = message_of(dbc, kind)
    table = REALS[kind][1]
    lines, expected = [], []
    for _ in range(CASES):
        address = rng.randrange(256)
        numbers = random_numbers(rng, kind)
        values = {name: random_real(rng, name, per, width) for name, per, width in table}
        reals = {
            name: expected_physical(name, values[name], message.get_signal_by_name(name), per)
            for name, per, _ in table
        }
        if kind == "status" and numbers["Active"] == 0:
            reals["Clearance"] = 65.535
        encoded = cantools_bytes(message, numbers, reals, table)
        lines.append(encode_line(kind, address, numbers, values.values()))
        expected.append(f"{message.frame_id | address:x} {message.length} {encoded.hex()}")
    assert message.is_extended_frame and message.frame_id & 0xFF == 0
    wrong = [case for case in zip(lines, ask(lines), expected) if case[1] != case[2]]
    assert wrong == []


def decoded_words(kind, physical):
    """The answer of berth-codec for what cantools decoded, with floats as numbers."""
    reals = [physical[name] for name, _, _ in REALS[kind][1]]
    if kind == "obstacle":
        return [physical["Id"], physical["TimeToLive"]], reals
    if kind == "status":
        none = physical["Clearance"] > 65.5345
        return [physical[name] for name in STATUS], [-1.0 if none else reals[0]]
    return [], reals


def must_refuse(kind, raw):
    if kind == "status":
        return raw["State"] > 5 or raw["Mode"] > 4
    for name, _, width in REALS[kind][1]:
        most = 2 ** (width - 1) - 1
        if name in ("Theta", "E3"):
            most = HEADING
        elif name in ("X", "Y"):
            most -= 1  # the ends mean further out
        elif name == "Radius":
            continue
        if abs(raw[name]) > most:
            return True
    return False


def random_raw(rng, signal):
    low = -(2 ** (signal.length - 1)) if signal.is_signed else 0
    high = 2 ** (signal.length - 1) - 1 if signal.is_signed else 2**signal.length - 1
    if signal.name in ("Theta", "E3") and rng.random() < 0.8:
        return rng.choice([-HEADING, HEADING, rng.randint(-HEADING, HEADING)])
    if signal.name in ("State", "Mode") and rng.random() < 0.8:
        return rng.randint(0, 4)
    if rng.random() < 0.15:
        return min(rng.choice([low, low + 1, low + 2, high, high - 1, 0]), high)
    return rng.randint(low, high)


def compare_decoded(kind, answer, physical):
    numbers, reals = decoded_words(kind, physical)
    words = answer.split()
    assert [int(word) for word in words[: len(numbers)]] == numbers
    ours = [from_bits(word) for word in words[len(numbers) :]]
    assert len(ours) == len(reals)
    for mine, theirs in zip(ours, reals):
        # cantools multiplies in double, so its value may lie on the other side of a tie
        assert abs(mine - theirs) <= 2.0**-24 * abs(theirs) * (1 + 1e-6)


@pytest.mark.parametrize("kind", REALS)
def test_decoding_equals_cantools(dbc, rng, kind):
    message = message_of(dbc, kind)
    lines, raws = [], []
    for _ in range(CASES):
        raw = {signal.name: random_raw(rng, signal) for signal in message.signals}
        raws.append(raw)
        lines.append(f"decode {kind} {message.encode(raw, scaling=False, strict=False).hex()}")
    refused = 0
    for line, answer, raw in zip(lines, ask(lines), raws):
        assert (answer == "refused") == must_refuse(kind, raw), (line, answer)
        if answer == "refused":
            refused += 1
            continue
        physical = message.decode(bytes.fromhex(line.split()[2]), decode_choices=False)
        compare_decoded(kind, answer, physical)
    assert refused < CASES, "some are good"
    assert refused > 0, "and some are not"


@pytest.mark.parametrize("kind", REALS)
def test_each_number_survives_a_round_trip(dbc, rng, kind):
    """Decode, then encode: the same bytes."""
    message = message_of(dbc, kind)
    signals = message.signals
    raws = [{signal.name: random_raw(rng, signal) for signal in signals} for _ in range(CASES)]
    for raw in raws:
        for name in ("Theta", "E3"):
            if abs(raw.get(name, 0)) == HEADING:  # beyond pi: comes back with the other sign
                raw[name] //= 2
    if kind == "status":
        for raw in raws:  # the two say the same thing
            raw["Active"] = raw["Active"] if raw["Clearance"] < 65535 else 0
            raw["Clearance"] = raw["Clearance"] if raw["Active"] > 0 else 65535
    data = [message.encode(raw, scaling=False, strict=False).hex() for raw in raws]
    answers = ask([f"decode {kind} {text}" for text in data])
    kept = [(text, words.split()) for text, words in zip(data, answers) if words != "refused"]
    lines = []
    for _, words in kept:
        if kind == "obstacle":
            words = [words[0], *words[2:], words[1]]
        lines.append(" ".join(["encode", kind, "0", *words]))
    assert [answer.split()[2] for answer in ask(lines)] == [text for text, _ in kept]
    assert len(kept) > CASES / 10


def test_headings_are_wrapped(rng):
    """Beyond pi the codec wraps by itself, to 2e-6 rad."""
    angles = [single(rng.uniform(-50, 50)) for _ in range(CASES)]
    zero = bits(0.0)
    lines = [f"encode pose_fix 0 {zero} {zero} {bits(angle)}" for angle in angles]
    lines += [f"encode error 0 {zero} {zero} {bits(angle)} {zero}" for angle in angles]
    for place, answer in enumerate(ask(lines)):
        data = bytes.fromhex(answer.split()[2])
        raw = struct.unpack_from("<h", data, 6 if place < len(angles) else 4)[0]
        off = math.remainder(raw / 10000 - angles[place % len(angles)], 2 * math.pi)
        assert abs(off) <= 0.5e-4 + 3e-6
        assert abs(raw) <= HEADING


def test_commands(dbc):
    """Each of 256 numbers with each of 256 complements."""
    message = message_of(dbc, "command")
    count = len(message.get_signal_by_name("Command").choices)
    lines = [f"decode command {code:02x}{check:02x}" for code in range(256) for check in range(256)]
    for line, answer in zip(lines, ask(lines)):
        code, check = bytes.fromhex(line.split()[2])
        good = code < count and code ^ check == 0xFF
        assert answer == (str(code) if good else "refused"), line
    for code, answer in enumerate(ask([f"encode command 7 {code}" for code in range(count)])):
        encoded = message.encode({"Command": code, "Complement": 255 - code})
        assert answer == f"{message.frame_id | 7:x} 2 {encoded.hex()}"
    for answer in ask([f"encode command 7 {code}" for code in (count, 255, 256, 4294967295)]):
        assert answer.split()[2] == "00ff"


def test_wrong_lengths_are_refused(dbc):
    """No length but the right one, whatever the bytes."""
    for kind in KINDS:
        good = message_of(dbc, kind).length
        lengths = [n for n in range(1, 9) if n != good]
        lines = [f"decode {kind} {fill * n}" for n in lengths for fill in ("00", "ff", "01")]
        assert set(ask(lines)) == {"refused"}


def enum(header, prefix):
    """{value: name without prefix} of the numbered constants of a header."""
    text = (ROOT / "firmware" / "include" / "berth" / header).read_text(encoding="utf-8")
    found = re.findall(rf"^\s+BERTH_{prefix}_(\w+) = (\d+)", text, re.MULTILINE)
    assert found
    return {int(value): name for name, value in found}


def table(dbc, message, signal):
    choices = dbc.get_message_by_name(message).get_signal_by_name(signal).choices
    return {value: str(choice) for value, choice in choices.items()}


def test_value_tables_are_the_headers_enums(dbc):
    assert table(dbc, "Command", "Command") == enum("message.h", "COMMAND")
    assert table(dbc, "Status", "State") == enum("supervisor.h", "SUPERVISOR")
    assert table(dbc, "Status", "Mode") == enum("avoid.h", "MODE")
    faults = enum("supervisor.h", "FAULT")
    sides = {value: name for value, name in faults.items() if name in ("LEFT", "RIGHT")}
    assert len(sides) == 2
    expected = {value: name for value, name in faults.items() if value not in sides}
    for base, side in sides.items():
        for value, name in enum("drive.h", "DRIVE_FAULT").items():
            if value > 0:
                expected[base + value] = f"{side}_{name}"
    assert table(dbc, "Status", "Fault") == expected


def test_ids_are_the_headers_kinds(dbc):
    text = (ROOT / "firmware" / "include" / "berth" / "message.h").read_text(encoding="utf-8")
    kinds = dict(re.findall(r"#define BERTH_MESSAGE_(\w+) (0x\w+)u", text))
    names = {"ERROR": "TrackingError"}
    expected = {
        names.get(kind, kind.title().replace("_", "")): int(value, 16) << 8
        for kind, value in kinds.items()
    }
    assert {message.name: message.frame_id for message in dbc.messages} == expected


@pytest.mark.parametrize("name", ["berth", "odrive", "vesc"])
def test_databases_are_complete(name):
    for message in load(name).messages:
        assert message.comment and message.senders
        for signal in message.signals:
            assert signal.minimum is not None and signal.maximum is not None
            assert signal.minimum < signal.maximum
            assert signal.receivers and signal.receivers != message.senders


def test_special_numbers_have_names(dbc):
    """Whoever looks at the bus sees that a value is none."""
    for kind, (name, signals) in REALS.items():
        for signal, _, width in signals:
            if signal == "Radius":
                continue
            special = 65535 if signal == "Clearance" else -(2 ** (width - 1))
            assert special in dbc.get_message_by_name(name).get_signal_by_name(signal).choices, kind


@pytest.mark.parametrize("node", [0, 1])
def test_odrive_frames(node):
    """Against the protocol: id = node << 5 | command, little endian."""
    base = node << 5
    database = load("odrive")
    assert all(not message.is_extended_frame for message in database.messages)
    sent = {
        (base | 0x02, "Estop", b""): {},
        (base | 0x07, "SetAxisState", struct.pack("<I", 8)): {"RequestedState": 8},
        (base | 0x0B, "SetControllerMode", struct.pack("<II", 2, 1)): {
            "ControlMode": 2,
            "InputMode": 1,
        },
        (base | 0x0D, "SetInputVelocity", struct.pack("<ff", -1.5, 0.25)): {
            "Velocity": -1.5,
            "TorqueFeedForward": 0.25,
        },
        (base | 0x18, "ClearErrors", b""): {},
    }
    for (frame_id, name, data), values in sent.items():
        message = database.get_message_by_name(f"Axis{node}_{name}")
        assert message.frame_id == frame_id and message.encode(values) == data
    decode = database.decode_message
    estimates = struct.pack("<ff", 1234.5, -0.125)
    assert decode(base | 0x09, estimates) == {"Position": 1234.5, "Velocity": -0.125}
    beat = struct.pack("<IBBBB", 0x80000001, 8, 1, 2, 3)
    expected = {"Error": 0x80000001, "State": "CLOSED_LOOP_CONTROL"}
    assert decode(base | 0x01, beat) == expected


@pytest.mark.parametrize("node", [0, 1])
def test_vesc_frames(node):
    """Against the protocol: 29-bit id = packet << 8 | node, big endian."""
    database = load("vesc")
    assert all(message.is_extended_frame for message in database.messages)
    commands = [
        ("SetDuty", 0, "Duty", -0.75, -75000),
        ("SetCurrent", 1, "Current", -12.345, -12345),
        ("SetCurrentBrake", 2, "Current", 12.345, 12345),
        ("SetErpm", 3, "Speed", -70000, -70000),
    ]
    for name, packet, signal, value, raw in commands:
        message = database.get_message_by_name(f"Motor{node}_{name}")
        assert message.frame_id == packet << 8 | node
        assert message.encode({signal: value}) == struct.pack(">i", raw)
    status = database.decode_message(9 << 8 | node, struct.pack(">ihh", -70000, -123, 456))
    assert status == pytest.approx({"Speed": -70000, "Current": -12.3, "Duty": 0.456})
    status = database.decode_message(27 << 8 | node, struct.pack(">ihh", -70000, 241, 0))
    assert status == pytest.approx({"Tachometer": -70000, "InputVoltage": 24.1})
