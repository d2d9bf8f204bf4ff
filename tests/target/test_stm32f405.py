"""The drive board's image in emulation, at its prompt. The emulated chip has no CAN and no crystal.

Its time goes ten times too fast, because the image believes in 16 MHz and the emulator in 168."""

import os
import select
import subprocess
import time

import pytest

from target import BUILD, run, tool

IMAGE = BUILD / "firmware" / "boards" / "stm32f405" / "berth-stm32f405.elf"
PATIENCE_S = 60


class Console:
    """The serial line of an emulated board."""

    def __init__(self):
        self.process = subprocess.Popen(
            [
                "qemu-system-arm", "-M", "netduinoplus2", "-display", "none", "-monitor", "none",
                "-serial", "stdio", "-semihosting-config", "enable=on,target=native",
                "-kernel", str(IMAGE),
            ],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )
        self.text = ""

    def wait_for(self, wanted):
        """All text up to what is wanted; what follows it is kept."""
        end = time.monotonic() + PATIENCE_S
        while wanted not in self.text:
            left = end - time.monotonic()
            ready, _, _ = select.select([self.process.stdout], [], [], max(left, 0))
            chunk = os.read(self.process.stdout.fileno(), 4096) if ready else b""
            assert chunk, f"no {wanted!r} in {self.text!r}"
            self.text += chunk.decode("ascii")
        before, _, self.text = self.text.partition(wanted)
        return before + wanted

    def type(self, text):
        """A character at a time, as a person does: the emulated port has no queue."""
        for character in text:
            self.process.stdin.write(character.encode())
            self.process.stdin.flush()
            time.sleep(0.01)

    def ask(self, line):
        """The answer to a command."""
        self.type(line + "\r")
        self.wait_for(line + "\r\n")
        return self.wait_for("> ").removesuffix("> ")

    def close(self):
        self.process.kill()
        self.process.wait()


@pytest.fixture
def console():
    board = Console()
    yield board
    board.close()


def test_boots_to_its_prompt_and_says_what_is_missing(console):
    start = console.wait_for("> ")
    assert "berth on stm32f405" in start
    assert "clock: INTERNAL, 16 MHz: the crystal does not start" in start
    assert "WATCHDOG" not in start
    assert "can: not opened without the crystal" in console.wait_for("> ")


def test_status_tells_that_the_bus_is_down(console):
    console.wait_for("crystal\r\n> ")
    answer = console.ask("status")
    assert "state idle\r\n" in answer
    assert "can DOWN, rx lost 0, tx dropped 0, errors 0, restarts 0\r\n" in answer
    assert "pose unknown\r\n" in answer
    assert "left off" in answer and "right off" in answer


def test_arming_without_a_bus_ends_in_the_fault_that_says_so(console):
    console.wait_for("crystal\r\n> ")
    console.ask("pose 100 -200 300")
    assert "pose 100 -200 mm, 300 mrad" in console.ask("status")
    console.type("arm\r")
    console.wait_for("state fault: CAN interface down or failing\r\n> ")
    assert "refused" in console.ask("start")
    assert "refused" in console.ask("reset")
    assert "state fault: CAN interface down or failing\r\n" in console.ask("status")


def test_control_steps_go_on(console):
    console.wait_for("crystal\r\n> ")

    def steps():
        answer = console.ask("status")
        return int(answer.partition("steps ")[2].partition(",")[0])

    first = steps()
    time.sleep(0.5)
    assert steps() > first


def test_nonsense_is_answered(console):
    console.wait_for("crystal\r\n> ")
    assert "unknown: try help" in console.ask("fly")
    assert "three integers" in console.ask("pose 1 2")
    assert "estop" in console.ask("help")
    console.type("x" * 60 + "\r")
    console.wait_for("too long\r\n> ")
    assert "state idle" in console.ask("status")


def test_the_image_holds_no_heap_and_no_formatted_output():
    symbols = run(tool("nm"), IMAGE)
    names = {line.split()[-1] for line in symbols.splitlines()}
    unwanted = {"malloc", "_malloc_r", "printf", "vfprintf", "_vfprintf_r", "snprintf", "strtof",
                "__aeabi_dmul", "__aeabi_dadd", "__aeabi_f2d", "sinf", "cosf"}
    assert names & unwanted == set()
    assert "berth_board_step" in names and "bxcan_open" in names


def test_plan_and_program_fit_the_chip():
    fields = run(tool("size"), IMAGE).splitlines()[1].split()
    text, data, bss = map(int, fields[:3])
    assert text + data <= 1024 * 1024 and bss + data <= 128 * 1024
    assert data == 0
    print(f"flash {text} bytes, RAM {bss} bytes, both stacks (10 KiB) included")
