#!/usr/bin/env python3
"""First inputs for the fuzz targets: seeds.py FOLDER [RECORD] writes FOLDER/TARGET/seed_NAME.bin.

RECORD is a file from `berth-sim run circle --bus loop --set duration_s=3 --record RECORD`.

They lead the fuzzer to where it would take long to find by itself: a board that is armed and runs.
The bytes are those that the targets read; see each target's operations.
"""

import itertools
import math
import struct
import sys
from pathlib import Path

RUN_MS, RUN_LONG, JUMP, COMMAND, COMMAND_FRAME, POSE = 0, 2, 3, 4, 5, 6
WANTED, ANY, BUS, TROUBLE, DISTURB, OBSTACLE, FIX, BACKWARDS = 7, 9, 10, 11, 12, 13, 14, 15
ARM, START, STOP, EMERGENCY, RESET = 1, 2, 3, 4, 5


def place(value, low, high):
    """A float between two others, as in_some_float reads it."""
    return bytes([0]) + struct.pack("<H", round((value - low) / (high - low) * 65535))


def pose(x, y, theta):
    return place(x, 0.0, 0.6) + place(y, -0.5, 0.5) + place(theta, -3.2, 3.2)


def long_run(seconds):
    return bytes([RUN_LONG, round(seconds / 0.02) - 1])


def command(code):
    return bytes([COMMAND, code])


def obstacle(number, x, y, radius, ttl_ms):
    return (bytes([OBSTACLE, number]) + place(x, -1.5, 1.5) + place(y, -1.5, 1.5) + place(radius, 0.0, 0.3)
            + struct.pack("<H", ttl_ms))


def board_seeds():
    """(name, bytes): sessions with every kind of end."""
    put = bytes([POSE]) + pose(0.3, 0.0, 1.57)
    running = put + command(ARM) + long_run(2.0) + command(START) + long_run(2.0)
    again = command(RESET) + put + command(ARM) + long_run(3.0) + command(START) + long_run(1.0)
    ends = {
        "stop": command(STOP) + long_run(1.0),
        "emergency": bytes([COMMAND_FRAME, EMERGENCY]) + long_run(2.0) + again,
        "busoff": bytes([BUS, 2]) + long_run(1.0) + bytes([BUS, 0]) + long_run(1.0) + again,
        "failed": bytes([BUS, 4]) + long_run(1.0) + bytes([BUS, 0]) + again,
        "blocked": bytes([DISTURB, 0]) + long_run(1.0) + bytes([DISTURB, 0]) + long_run(1.0) + again,
        "stopblocked": bytes([DISTURB, 0]) + bytes([RUN_MS, 60]) + command(STOP) + bytes([RUN_MS, 30, DISTURB, 0])
        + long_run(1.0),
        "dropped": bytes([DISTURB, 1, 200]) + long_run(2.0) + again,
        "late": bytes([JUMP, 20, 0, 0]) + long_run(1.0) + again,
        "backwards": bytes([BACKWARDS, 3, 0, 0]) + long_run(1.0) + again,
        "slip": bytes([DISTURB, 4, 0, 0, 0]) + long_run(2.0) + command(STOP) + long_run(4.0) + again,
        "fix": bytes([FIX]) + pose(0.28, 0.1, 1.7) + long_run(1.0) + bytes([FIX]) + pose(0.0, 0.3, 3.0)
        + long_run(2.0),
        "obstacle": obstacle(7, 0.0, 0.35, 0.05, 60000) + long_run(3.0) + obstacle(7, 0.0, 0.0, 0.0, 0)
        + long_run(2.0),
        "plan": command(STOP) + long_run(1.0) + bytes([DISTURB, 5]) + again,
        "crowd": b"".join(obstacle(n, 1.4, 1.0, 0.05, 60000) for n in range(17)) + long_run(1.0) + again,
    }
    for side, (name, bits) in itertools.product(
            (0, 1), {"mute": 4, "heartbeat": 2, "dead": 8, "fail": 32}.items()):
        code = bytes([1]) if bits == 32 else b""
        ends[f"{name}{side}"] = (bytes([TROUBLE, bits | side]) + code + long_run(2.0)
                                 + bytes([TROUBLE, side]) + long_run(1.0) + again)
    for name, end in ends.items():
        yield name, bytes([0x01, 0x04]) + running + end
    for flags in (0x00, 0x02, 0x06, 0x11, 0x20, 0x33, 0x34):
        for more in (0x04, 0x50, 0xe9, 0x83):
            yield f"start{flags:02x}{more:02x}", (bytes([flags, more]) + (obstacle_head() if flags & 4 else b"")
                                                  + running + long_run(4.0) + ends["stop"])
    edge = bytes([POSE, 255]) + struct.pack("<f", 999.9999) + place(0.0, -0.5, 0.5) + place(3.14, -3.2, 3.2)
    yield "edge", (bytes([0x01, 0x04]) + edge + command(ARM) + long_run(2.0) + bytes([DISTURB, 4, 0, 0, 0])
                   + bytes([DISTURB, 4, 1, 0, 0]) + command(START) + long_run(3.0) + again)
    yield "armblocked", (bytes([0x01, 0x04]) + put + bytes([DISTURB, 0]) + command(ARM) + bytes([RUN_MS, 29])
                         + command(EMERGENCY) + bytes([DISTURB, 0]) + long_run(1.0) + again)
    yield "nodes", bytes([0x81, 0x04, 1, 1, 1, 0, 0, 0]) + running
    yield "fixes", (bytes([0x09, 0x04]) + put + command(ARM) + long_run(0.3) + command(START) + long_run(0.3)
                    + bytes([FIX]) + pose(0.3, 0.1, 1.8) + long_run(2.0) + again)
    yield "refused", put + bytes([0x40, 0x04]) + command(ARM) + long_run(5.0)
    yield "setup", bytes([0, 4, TROUBLE, 16, TROUBLE, 17]) + put + command(ARM) + long_run(5.0)
    yield "silent", bytes([0x40, 0x08]) + put + command(ARM) + bytes([WANTED, 3, 8]) + bytes(range(8)) + long_run(5.0)


def obstacle_head():
    return place(0.0, -1.0, 1.0) + place(0.4, -1.0, 1.0) + place(0.05, 0.0, 0.3)


SCENARIO = """name: "all of it"
period_s: 0.02
duration_s: 1.5e1
reference:
  shape: circle
  closed: true
robot: {wheel_radius_m: 0.06, track_m: 0.31, v_max_mps: 0.9, omega_max_radps: 4, wheel_speed_max_radps: 17.5}
start: {x_m: 1.25, y_m: -2.5, theta_rad: -3}
mpc:
  horizon: 35
  q: [1, 2.5, 0]
  r:
    - 0.25
    - 1e-6
  discretization: zoh
avoidance: {strategy: combined, skirt_m: 0.03, v_creep_mps: 0.1}
obstacles:
  - {x_m: 1, y_m: 2, hard_m: 0.1, conservative_m: 0.2, regulated_m: 0.5}
plant: {tau_s: 0.05, a_max_mps2: 3, alpha_max_radps2: 9, pose_noise_m: 0.003, heading_noise_rad: 0.01}
"""
ASSIGNMENTS = """=robot.v_max_mps=0.6
obstacles.0.hard_m=0.2
mpc.q=[10,40,1]
mpc.constrained=true
reference.shape=eight
avoidance.strategy=conservative
name=x
"""
SETUP = "s--drive=cia402\n--left=3\n--right=4\n--mode=9\n--fix-timeout=500\n--following=2.5\n--late=100\n\n"


def arc_csv(rows, period, v, omega):
    """An arc of a circle as berth-gen reads it."""
    lines = ["t,x,y,theta,v,omega"]
    for k in range(rows):
        angle = omega * period * k
        lines.append(f"{k * period:.9g},{v / omega * math.sin(angle):.9g},"
                     f"{v / omega * (1 - math.cos(angle)):.9g},{angle:.9g},{v},{omega}")
    return "\n".join(lines) + "\n"


def csv_seeds():
    arc = arc_csv(5, 0.05, 0.4, 0.5)
    return {
        "arc": b"\x00" + arc.encode(),
        "closed": b"\x01" + arc.encode(),
        "crlf": b"\x02" + arc.replace("\n", "\r\n").encode(),
        "still": b"\x00" + b"t,x,y,theta,v,omega\n0,1,1,0,0,0\n0.1,1,1,0,0,0\n",
        "number": b"#-1.5e-3",
        "list": b"# 1, 2.5 ,1e3",
    }


def candump_seeds():
    return {
        "lines": b"(1436509053.850870) vcan0 1E5#0102 R\n(0000000001.000000) can1 1234ABCD#R8 T\n",
        "long": b"(0000000001.000000) berth 010#2D2D64726976653D\n",
    }


def slcan_seeds():
    return {
        "standard": b"\x00t1232AABB",
        "extended": b"\x00T1234567881122334455667788ABCD",
        "remote": b"\x00r1238",
        "frames": b"\x01" + bytes(range(40)),
        "lockstep": b"\x02T1FFF000221020\rT1FFF00078\rt1232AABB\r",
        "adapter": b"\x03C\rS8\rZ1\rO\rV\rN\rF\rt1232AABB\rT0123456781FF1234\rr1230\rC\r",
        "host": b"\x07\r\a\rF00\rz\rt1232AABB\rZ\rt12\rF84\rttttttttttttttttttttttttttttttttttt\r",
    }


def record_seeds(path):
    """The events of a record, in a few lengths."""
    lines = [line for line in path.read_text().splitlines(keepends=True) if " 010#" not in line and " 008#" not in line]
    return {f"record{count}": b"e" + "".join(lines[:count]).encode() for count in (10, 40, 90)}


def all_seeds(record):
    board = dict(board_seeds())
    seeds = {f"board_{name}": board for name in ("odrive", "vesc", "cia402", "mixed")}
    seeds |= {"gen_csv": csv_seeds(), "candump": candump_seeds(), "slcan": slcan_seeds()}
    seeds["prompt"] = {
        "session": b"help\rstatus\rpose 300 0 1571\rarm\r\xff\x3bstart\r\xff\x3bstatus\rstop\r\xff\x3bstatus\r",
        "fault": b"pose 300 0 1571\rarm\r\xff\x3b\xff\x02\xff\x3bstatus\rreset\rarx\bm\r" + b"x" * 60 + b"\r",
    }
    seeds["scenario"] = {"all": SCENARIO.encode(), "set": ASSIGNMENTS.encode()}
    seeds["replay"] = {"setup": (SETUP + SCENARIO).encode(), **(record_seeds(record) if record else {})}
    return seeds


def main():
    record = Path(sys.argv[2]) if len(sys.argv) > 2 else None
    for target, seeds in all_seeds(record).items():
        folder = Path(sys.argv[1]) / target
        folder.mkdir(parents=True, exist_ok=True)
        for name, data in seeds.items():
            (folder / f"seed_{name}.bin").write_bytes(data)


if __name__ == "__main__":
    main()
