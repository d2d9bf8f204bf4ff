"""The boards themselves: how a program ends, what a fault prints, the bus port's two ends."""

import re
import socket
import subprocess
import time

import pytest

from target import BOARDS, image
import emulate  # found by target

STATUS_FAULT = 128
RISCV = "virt"
# ARMv6-M has one fault for all.
ARMV6 = "cortex-m0plus" in str(image("x", "x"))
MPS2 = [board for board in BOARDS if board.startswith("mps2")]


def on(boards):
    """For each of these boards; a build without any does not have the test."""
    return pytest.mark.parametrize("board", boards) if boards else lambda _: None


def check(board, mode):
    return emulate.run(board, image(board, "check"), [f"BOARD_CHECK={mode}"], timeout=60)


def registers(text):
    return {name: int(value, 16) for name, value in re.findall(r"^(\w+) 0x(\w{8})$", text, re.M)}


def expected_fault(board, mode):
    if board == RISCV:
        return {"access": "access", "illegal": "illegal", "stack": "access"}[mode]
    if ARMV6:
        return "hard"
    stack = "usage" if board == "mps2-an505" else "memory"
    return {"access": "bus", "illegal": "usage", "divide": "usage", "stack": stack}[mode]


@pytest.mark.parametrize("board", BOARDS)
def test_exit_status_arrives(board):
    assert check(board, "exit")[0] == 7


def faults():
    """Divisions by zero trap where there is a divider, but for RISC-V. ARMv6-M cannot guard a stack
    on a board whose memory below RAM reads as zero."""
    for board in BOARDS:
        yield from ((board, "access"), (board, "illegal"))
        if not ARMV6 or board == "microbit":
            yield (board, "stack")
        if not ARMV6 and board != RISCV:
            yield (board, "divide")


@pytest.mark.parametrize("board, mode", list(faults()))
def test_faults_are_printed_and_end_the_program(board, mode):
    status, text = check(board, mode)
    assert status == STATUS_FAULT, text
    assert f"FAULT {expected_fault(board, mode)}\n" in text
    assert text.endswith("END OF FAULT\n")
    assert registers(text).get("sp"), text
    if mode == "stack":
        assert "stack overflow" in text
    else:
        assert registers(text)["pc"] & ~0x3FFFFF in (0, 0x10000000, 0x80000000), text


@on([board for board in MPS2 if not ARMV6])
def test_fault_registers_tell_the_cause(board):
    access = registers(check(board, "access")[1])
    assert access["bfar"] == 0x90000000
    assert access["cfsr"] & 0x8200 == 0x8200, "precise, and the address is valid"
    assert registers(check(board, "divide")[1])["cfsr"] == 1 << 25
    assert registers(check(board, "illegal")[1])["cfsr"] == 1 << 16


class BusPort:
    """A program whose second serial port is a socket here."""

    def __init__(self, board, mode, folder):
        path = folder / "bus"
        serial = f"unix:{path},server=on,wait=on"
        line = emulate.command(board, image(board, "check"), [f"BOARD_CHECK={mode}"], serial=serial)
        self.process = subprocess.Popen(line, stdout=subprocess.PIPE, stdin=subprocess.DEVNULL)
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.settimeout(30)
        for _ in range(600):
            try:
                self.socket.connect(str(path))
                break
            except OSError:
                time.sleep(0.05)

    def __enter__(self):
        assert self.process.stdout.readline() == b"ready\n"
        return self

    def __exit__(self, *_):
        self.socket.close()
        self.process.kill()
        self.process.wait()


@on(MPS2)
def test_bus_port_carries_every_byte(board, tmp_path):
    sent = bytes(5 + (i * 7919 + i // 250) % 250 for i in range(20000))
    with BusPort(board, "echo", tmp_path) as port:
        back = bytearray()
        for start in range(0, len(sent), 100):
            port.socket.sendall(sent[start : start + 100])
            while len(back) < start + 100:
                back += port.socket.recv(4096)
        assert back == sent
        port.socket.sendall(b"\x04")
        assert port.process.wait(timeout=30) == 0


@on(MPS2)
def test_bus_port_tells_a_loss_in_its_place(board, tmp_path):
    with BusPort(board, "overrun", tmp_path) as port:
        port.socket.sendall(bytes(i % 256 for i in range(2000)))
        lines = port.process.stdout.read().decode().splitlines()
    calls = [tuple(map(int, line.split())) for line in lines]
    assert calls == [*((0, 100, 99 + 100 * i & 255) for i in range(5)), (0, 11, 510 & 255),
                     (-1, 0, -1), (1, 0, -1)]
