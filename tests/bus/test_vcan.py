"""The interfaces that tools/vcan-shell promises, seen by can-utils and by tools/vcan-shell."""

import os
import re
import socket
from pathlib import Path

import pytest

from can_lines import BUSES, Dump, run, send, tool

SHELL = Path(os.environ["BERTH_SOURCE_DIR"]) / "tools" / "vcan-shell"


def vcan_shell(*arguments):
    return run("/usr/bin/python3", "-I", "-S", SHELL, *arguments, timeout=60)


def links():
    """The flags of each CAN interface by name."""
    status, output, error = run(tool("ip"), "-o", "link", "show", "type", "vcan")
    assert status == 0, error
    return dict(re.findall(r"^\d+: (\w+): <(.*?)>", output, re.MULTILINE))


def test_as_many_interfaces_as_promised_and_all_up():
    assert os.environ["BERTH_VCAN"] == BUSES[0]
    found = links()
    assert len(BUSES) >= 2
    assert set(BUSES) <= set(found)
    assert [bus for bus in BUSES if "UP" not in found[bus].split(",")] == []


def test_a_frame_crosses_one_bus_and_no_other():
    with Dump(BUSES[0], BUSES[1], count=2) as dump:
        send(BUSES[1], "123#0102030405060708")
        send(BUSES[0], "1F334455#")
        assert dump.lines() == [
            (BUSES[1], "123#0102030405060708"),
            (BUSES[0], "1F334455#"),
        ]


def test_remote_and_error_frames_cross():
    with Dump(f"{BUSES[0]},0:0,#FFFFFFFF", count=2) as dump:
        send(BUSES[0], "123#R3", "20000040#0008000000000000")
        lines = dump.lines()
    assert lines[0] == (BUSES[0], "123#R3")
    assert lines[1] == (BUSES[0], "20000040#0008000000000000")


def test_many_frames_arrive_in_order():
    frames = [f"{index:03X}#{index * 257:08X}" for index in range(20)]
    with Dump(BUSES[0], count=len(frames)) as dump:
        send(BUSES[0], *frames)
        assert [frame for _, frame in dump.lines()] == frames


def test_an_interface_can_be_taken_down_and_up():
    bus = BUSES[-1]
    sender = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    with sender:
        sender.bind((bus,))
        frame = bytes.fromhex("2301000001000000 1100000000000000")
        assert run(tool("ip"), "link", "set", bus, "down")[0] == 0
        try:
            with pytest.raises(OSError, match="down"):
                sender.send(frame)
        finally:
            assert run(tool("ip"), "link", "set", bus, "up")[0] == 0
        assert sender.send(frame) == len(frame)


def test_vcan_shell_passes_output_and_status_on():
    script = "echo out; echo err >&2; exit 255"
    assert vcan_shell("--", "sh", "-c", script) == (255, "out\n", "err\n")


def test_vcan_shell_tells_of_signals_time_and_missing_commands():
    assert vcan_shell("--", "sh", "-c", "kill -TERM $$")[0] == 128 + 15
    status, _, error = vcan_shell("--timeout", "0.5", "--", "sleep", "30")
    assert (status, "stopped after 0.5 s" in error) == (124, True)
    status, _, error = vcan_shell("--", "no-such-command")
    assert (status, "no-such-command" in error) == (127, True)


def test_vcan_shell_removes_what_it_made_and_only_that():
    before = links()
    more = len(BUSES) + 2
    script = "ip -o link show type vcan | wc -l; echo $BERTH_VCAN $BERTH_VCAN_BUSES; cansend vcan5 001#"
    status, output, error = vcan_shell("--buses", str(more), "--", "sh", "-c", script)
    assert (status, error) == (0, "")
    assert output == f"{more}\n{BUSES[0]} {more}\n"
    assert links() == before


def test_vcan_shell_puts_an_interface_down_again_that_was_down():
    assert run(tool("ip"), "link", "set", BUSES[-1], "down")[0] == 0
    try:
        status, _, error = vcan_shell("--buses", str(len(BUSES)), "--", "cansend", BUSES[-1], "001#")
        assert (status, error) == (0, "")
        assert "UP" not in links()[BUSES[-1]].split(",")
    finally:
        assert run(tool("ip"), "link", "set", BUSES[-1], "up")[0] == 0


def test_private_interfaces_are_not_the_others():
    with Dump(BUSES[0], count=1) as dump:
        script = f"ip -o link show type vcan | wc -l; cansend {BUSES[0]} 007#AA"
        status, output, error = vcan_shell("--private", "--buses", "2", "--", "sh", "-c", script)
        assert (status, output, error) == (0, "2\n", "")
        send(BUSES[0], "007#BB")
        assert dump.lines() == [(BUSES[0], "007#BB")]
    assert set(BUSES) <= set(links())
