"""Runs an image on an emulated board.

usage: emulate.py [--timeout SECONDS] [--icount SHIFT] [--serial BACKEND] [--skip-if-too-large]
                  BOARD IMAGE [NAME=VALUE...]

The board's console goes to standard output, and the exit status is the program's. The program finds
NAME=VALUE in its environment. --icount: virtual time from the number of instructions, 2^SHIFT ns
each, so that a run is always the same. --serial: the second serial port (see qemu -serial).
--skip-if-too-large: an image that does not fit into the board's memory is counted as one ignored test
that says so, instead of being run.
"""

import argparse
import struct
import subprocess
import sys
from pathlib import Path

ARM = "qemu-system-arm"
RISCV = "qemu-system-riscv32"
# Emulator, its options, and the end of RAM. RISC-V without a double-precision unit.
BOARDS = {
    "mps2-an385": (ARM, ["-M", "mps2-an385"], 0x20400000),
    "mps2-an386": (ARM, ["-M", "mps2-an386"], 0x20400000),
    "mps2-an500": (ARM, ["-M", "mps2-an500"], 0x20400000),
    "mps2-an505": (ARM, ["-M", "mps2-an505"], 0x38400000),
    "microbit": (ARM, ["-M", "microbit"], 0x20004000),
    "virt": (RISCV, ["-M", "virt", "-cpu", "rv32,d=false", "-bios", "none", "-m", "64M"], 0x82400000),
}
STATUS_TIMEOUT = 124


def command(board, image, environment=(), icount=None, serial=None):
    """The emulator's command line. The console is the first serial port."""
    emulator, machine, _ = BOARDS[board]
    semihosting = ["enable=on", "target=native", "arg=image", *(f"arg={e}" for e in environment)]
    line = [emulator, *machine, "-display", "none", "-monitor", "none", "-serial", "stdio"]
    if serial is not None:
        line += ["-serial", serial]
    if icount is not None:
        line += ["-icount", f"shift={icount},sleep=off"]
    return [*line, "-semihosting-config", ",".join(semihosting), "-kernel", str(image)]


def memory_end(image):
    """The highest address that an ELF file's segments take."""
    data = Path(image).read_bytes()
    offset, _, _, _, size, count = struct.unpack_from("<IIIHHH", data, 28)
    ends = []
    for index in range(count):
        kind, _, address, _, _, length, _, _ = struct.unpack_from("<8I", data, offset + index * size)
        ends += [address + length] if kind == 1 else []
    return max(ends)


def excess(board, image):
    """Bytes by which an image is too large for the board's RAM; 0 when it fits."""
    return max(0, memory_end(image) - BOARDS[board][2])


def run(board, image, environment=(), timeout=120, **options):
    """(status, output) of a run, with the output as text."""
    line = command(board, image, environment, **options)
    try:
        done = subprocess.run(
            line, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            timeout=timeout, check=False,
        )
    except subprocess.TimeoutExpired as late:
        text = (late.stdout or b"").decode("utf-8", "replace")
        return STATUS_TIMEOUT, f"{text}\nemulate: no end after {timeout} s\n"
    return done.returncode, done.stdout.decode("utf-8", "replace")


def main(arguments):
    parser = argparse.ArgumentParser(usage=__doc__.split("\n\n")[1].removeprefix("usage: "))
    parser.add_argument("--timeout", type=float, default=120)
    parser.add_argument("--icount", type=int)
    parser.add_argument("--serial")
    parser.add_argument("--skip-if-too-large", action="store_true")
    parser.add_argument("board", choices=BOARDS)
    parser.add_argument("image")
    parser.add_argument("environment", nargs="*")
    given = parser.parse_args(arguments)
    too_large = excess(given.board, given.image)
    if too_large and given.skip_if_too_large:
        name = Path(given.image).stem
        print(f"{name}:0:all:IGNORE: {too_large} bytes too large for the RAM of {given.board}")
        print("\n-----------------------\n1 Tests 0 Failures 1 Ignored \nOK")
        return 0
    status, output = run(
        given.board, given.image, given.environment, given.timeout,
        icount=given.icount, serial=given.serial,
    )
    sys.stdout.write(output)
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
