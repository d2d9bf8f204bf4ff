"""The bus tests' runner and tools/vcan-shell, with the emulator played by a script: what was planned
counts, whatever happens to the machine."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tree import ROOT

sys.path.insert(0, str(ROOT / "tools" / "lib"))

import bus_tests  # noqa: E402
import count_tests  # noqa: E402
import vcan_common  # noqa: E402
import vcan_direct  # noqa: E402
import vcan_guest  # noqa: E402
import vcan_shell  # noqa: E402

JOB = {
    "name": "bus_x",
    "pytest_file": None,
    "folder": ".",
    "environment": ["BERTH_X=a=b"],
    "labels": ["bus"],
    "timeout": 20.0,
}


@pytest.fixture
def results(tmp_path):
    return bus_tests.Results(tmp_path / "results.jsonl")


def counted(tmp_path, cases):
    path = tmp_path / "bus.xml"
    bus_tests.write_junit(path, cases)
    return count_tests.count_file(path)


def run_script(results, script, **changes):
    job = {**JOB, "command": ["sh", "-c", script], **changes}
    bus_tests.run_program(job, results)
    return results.read()[-1]


def test_program_passes_with_its_cases_counted(results, tmp_path):
    entry = run_script(results, "test $BERTH_X = a=b && echo '3 Tests 0 Failures 1 Ignored '")
    assert entry["outcome"] == "passed"
    assert counted(tmp_path, [entry]) == [2, 0, 1]


@pytest.mark.parametrize(
    "script, text",
    [
        ("exit 3", "exit status 3"),
        ("kill -SEGV $$", "exit status -11"),
        ("echo before; sleep 60", "timed out"),
        ("echo '3 Tests 0 Failures 0 Ignored '; printf '\\1\\377'; exit 1", "exit status 1"),
    ],
)
def test_program_fails(script, text, results, tmp_path):
    entry = run_script(results, script, timeout=1.0)
    assert entry["outcome"] == "failed"
    assert text in entry["output"]
    assert counted(tmp_path, [entry])[1] == 1


def test_program_that_is_not_there_fails(results, tmp_path):
    bus_tests.run_program({**JOB, "command": ["/no/such/program"]}, results)
    assert counted(tmp_path, results.read()) == [0, 1, 0]


PYTEST_FILE = """
import os, pytest
def test_good(): assert os.environ["BERTH_X"] == "a=b"
def test_bad(): assert 1 == 2
@pytest.mark.skip(reason="no reason")
def test_skipped(): pass
@pytest.fixture
def broken():
    yield
    raise ValueError("torn down")
def test_teardown(broken): pass
"""


def run_pytest_file(tmp_path, results, text, timeout=20.0):
    path = tmp_path / "test_sample.py"
    path.write_text(text)
    bus_tests.run_pytest([{**JOB, "pytest_file": str(path), "timeout": timeout}], results)
    plan = [{**JOB, "pytest_file": str(path)}]
    return {
        case["name"].rpartition("::")[2]: case for case in bus_tests.complete(plan, results.read())
    }


def test_pytest_cases_are_recorded_one_by_one(tmp_path, results):
    cases = run_pytest_file(tmp_path, results, PYTEST_FILE)
    assert {name: case["outcome"] for name, case in cases.items()} == {
        "test_good": "passed",
        "test_bad": "failed",
        "test_skipped": "skipped",
        "test_teardown": "failed",
    }
    assert "assert 1 == 2" in cases["test_bad"]["output"]
    assert "torn down" in cases["test_teardown"]["output"]
    assert counted(tmp_path, cases.values()) == [1, 2, 1]


def test_a_file_that_cannot_be_imported_fails(tmp_path, results):
    cases = run_pytest_file(tmp_path, results, "import no_such_module\n")
    assert counted(tmp_path, cases.values())[1] >= 1


def test_a_case_that_hangs_or_dies_takes_the_rest_down_but_all_count(tmp_path, results):
    text = "import time, os\ndef test_a(): pass\ndef test_b(): {}\ndef test_c(): pass\n"
    cases = run_pytest_file(tmp_path, results, text.format("time.sleep(60)"), timeout=1.0)
    outcomes = {name: case["outcome"] for name, case in cases.items()}
    assert outcomes == {"test_a": "passed", "test_b": "failed", "test_c": "failed"}
    results.path.unlink()
    cases = run_pytest_file(tmp_path, results, text.format("os._exit(0)"))
    assert {name: case["outcome"] for name, case in cases.items()} == outcomes


def test_what_has_no_result_fails(tmp_path, results):
    plan = [JOB, {**JOB, "name": "bus_y", "pytest_file": "test_y.py"}]
    assert counted(tmp_path, bus_tests.complete(plan, results.read())) == [0, 2, 0]
    results.add(job="bus_y", collected="test_y.py::test_1")
    with results.path.open("a") as file:
        file.write('{"job": "bus_y", "name": "half a li')
    assert counted(tmp_path, bus_tests.complete(plan, results.read())) == [0, 2, 0]


class Shell:
    """Plays tools/vcan-shell: writes some results and ends with a status."""

    def __init__(self, status, entries):
        self.status = status
        self.entries = entries

    def __call__(self, command, **unused):
        Path(command[-1]).write_text("".join(json.dumps(entry) + "\n" for entry in self.entries))
        return subprocess.CompletedProcess(command, self.status)


GOOD = {"job": "bus_x", "name": "bus_x", "outcome": "passed", "seconds": 1.0, "output": ""}
BAD = {**GOOD, "outcome": "failed", "output": "reason"}
END = {"finished": True}


@pytest.mark.parametrize(
    "status, entries, expected",
    [
        (0, [GOOD, END], [1, 0, 0]),
        (1, [BAD, END], [0, 1, 0]),
        (125, [], [0, 2, 0]),
        (124, [GOOD], [1, 1, 0]),
        (0, [GOOD], [1, 1, 0]),
        (0, [], [0, 2, 0]),
        (0, [BAD, END], [0, 2, 0]),
        (1, [GOOD, END], [1, 1, 0]),
    ],
)
def test_a_machine_that_fails_is_a_failure(status, entries, expected, tmp_path, monkeypatch):
    monkeypatch.setattr(bus_tests.subprocess, "run", Shell(status, entries))
    junit = tmp_path / "bus.xml"
    passed = bus_tests.run_outside([JOB], junit)
    assert count_tests.count_file(junit) == expected
    assert passed == (expected[1] == 0)


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """A search path with a vng of our own, and a kernel."""
    programs = tmp_path / "bin"
    programs.mkdir()

    def vng(script):
        for name in ("vng", *vcan_guest.NEEDED):
            path = programs / name
            path.write_text(f"#!/bin/sh\n{script}\n")
            path.chmod(0o755)

    monkeypatch.setattr(vcan_guest, "search_path", lambda: f"{programs}:/usr/bin:/bin")
    monkeypatch.setattr(vcan_guest.platform, "machine", lambda: "x86_64")
    kernel = tmp_path / "vmlinuz"
    kernel.touch()
    return vng, kernel


def emulate(machine, script, *options):
    vng, kernel = machine
    vng(script)
    arguments = ["--emulate", "--kernel", str(kernel), *options, "--", "true"]
    return vcan_shell.main(arguments)


@pytest.mark.parametrize("status", [0, 1, 77, 255])
def test_status_and_output_come_through(status, machine, capfdbinary):
    script = f"cat; printf 'a\\377'; printf b >&2; exit {status}"
    assert emulate(machine, script) == status
    assert capfdbinary.readouterr() == (b"a\xff", b"b")


def test_the_emulator_is_told_all(machine, tmp_path, capfd, monkeypatch):
    monkeypatch.setenv("BERTH_SAMPLE", "it's $HOME\n\"two\" lines")
    monkeypatch.chdir(tmp_path)
    script = 'printf "%s\\n" "$@"; for last; do :; done; cat ${last#sh }'
    assert emulate(machine, script, "--buses", "3", "--rw", str(tmp_path)) == 0
    told = capfd.readouterr().out
    assert f"--rwdir={tmp_path}" in told
    assert "--disable-kvm" in told
    assert "for name in vcan0 vcan1 vcan2; do" in told
    assert "export BERTH_VCAN=vcan0\nexport BERTH_VCAN_BUSES=3\n" in told
    assert told.endswith("\nexec true\n")
    exports = [line for line in told.splitlines() if line.startswith("export ")]
    assert "export BERTH_SAMPLE='it'\"'\"'s $HOME" in exports


def test_a_machine_that_hangs_is_ended_with_all_it_started(machine, tmp_path, capfd):
    script = f"trap '' TERM; sleep 300 & echo $! >{tmp_path}/pid; wait; sleep 300"
    start = time.monotonic()
    assert emulate(machine, script, "--timeout", "0.5") == vcan_common.STOPPED
    assert time.monotonic() - start < 20.0
    assert "stopped after 0.5 s" in capfd.readouterr().err
    with pytest.raises(ProcessLookupError):
        for _ in range(50):
            os.kill(int((tmp_path / "pid").read_text()), 0)
            time.sleep(0.1)


def test_a_machine_that_does_not_come_up_is_booted_anew(machine, tmp_path, capfd, monkeypatch):
    monkeypatch.setattr(vcan_guest, "BOOT_PROCESSOR_S", 0.5)
    marked = 'for last; do :; done; mark=$(sed -n "s/^: >//p" ${last#sh })'
    spin = f"test -e {tmp_path}/second || {{ : >{tmp_path}/second; while :; do :; done; }}"
    assert emulate(machine, f"{marked}\n{spin}\n: >$mark; echo up; exit 5") == 5
    told = capfd.readouterr()
    assert told.out == "up\n"
    assert told.err == "vcan-shell: the emulated machine does not come up: ended\n"


def test_a_machine_that_never_comes_up_is_given_up(machine, capfd, monkeypatch):
    monkeypatch.setattr(vcan_guest, "BOOT_S", 0.2)
    assert emulate(machine, "sleep 60") == vcan_common.CANNOT_RUN
    assert "did not come up, 3 times" in capfd.readouterr().err


def test_a_busy_command_is_no_hung_machine(machine, tmp_path, monkeypatch):
    monkeypatch.setattr(vcan_guest, "BOOT_PROCESSOR_S", 0.3)
    monkeypatch.setattr(vcan_guest, "BOOT_S", 0.3)
    marked = 'for last; do :; done; mark=$(sed -n "s/^: >//p" ${last#sh }); : >$mark'
    busy = "i=0; while [ $i -lt 800000 ]; do i=$((i+1)); done"
    assert emulate(machine, f"{marked}\n{busy}; exit 3") == 3


def test_what_is_missing_is_named(machine, capfd, monkeypatch):
    monkeypatch.setattr(vcan_guest, "search_path", lambda: "/nowhere")
    assert emulate(machine, "") == vcan_common.CANNOT_RUN
    message = capfd.readouterr().err
    for package in (*vcan_guest.NEEDED.values(), "virtme-ng", "tools/setup test"):
        assert package in message


def test_a_shell_needs_a_terminal(monkeypatch, capfd):
    monkeypatch.setattr(vcan_guest.os, "isatty", lambda descriptor: False)
    assert vcan_shell.main(["--emulate"]) == vcan_common.CANNOT_RUN
    assert "terminal" in capfd.readouterr().err


@pytest.mark.parametrize("options", [["--buses", "0"], ["--buses", "x"], ["--timeout", "nan"]])
def test_bad_options_are_refused(options):
    with pytest.raises(SystemExit) as end:
        vcan_shell.main([*options, "--", "true"])
    assert end.value.code == 2


def test_the_newest_kernel_that_has_vcan(tmp_path):
    boot, modules = tmp_path / "boot", tmp_path / "modules"
    boot.mkdir()
    with pytest.raises(vcan_common.Trouble, match="linux-image-amd64"):
        vcan_guest.newest_kernel(boot, modules)
    for version in ("6.1.0-9-amd64", "6.1.0-10-amd64", "6.1.0-11-cloud-amd64"):
        (boot / f"vmlinuz-{version}").touch()
        can = modules / version / "kernel" / "drivers" / "net" / "can"
        can.mkdir(parents=True)
        if "cloud" not in version:
            (can / "vcan.ko.xz").touch()
    assert vcan_guest.newest_kernel(boot, modules).name == "vmlinuz-6.1.0-10-amd64"


def test_the_state_of_an_interface(tmp_path):
    for name, kind, flags in (("vcan0", 280, "0xc1"), ("vcan1", 280, "0x80"), ("vcan2", 1, "0x1")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "type").write_text(f"{kind}\n")
        (tmp_path / name / "flags").write_text(f"{flags}\n")
    states = [vcan_direct.state(name, tmp_path) for name in ("vcan0", "vcan1", "vcan3")]
    assert states == ["up", "down", "absent"]
    with pytest.raises(vcan_common.Trouble, match="vcan2"):
        vcan_direct.state("vcan2", tmp_path)


@pytest.fixture
def here(monkeypatch):
    """The running kernel: what is there, who we are, and which commands work."""

    def set_up(states, root, kernel_has_vcan=True, works=lambda command: True):
        monkeypatch.setattr(vcan_direct, "state", lambda name: states.get(name, "absent"))
        monkeypatch.setattr(vcan_direct, "as_root", lambda: root)
        monkeypatch.setattr(vcan_direct, "kernel_offers_vcan", lambda: kernel_has_vcan)
        done = []

        def succeeds(command):
            done.append([Path(word).name if word.startswith("/") else word for word in command])
            return works(done[-1])

        monkeypatch.setattr(vcan_direct, "succeeds", succeeds)
        return done

    return set_up


def test_interfaces_that_are_up_need_no_root(here):
    done = here({"vcan0": "up", "vcan1": "up"}, root=None)
    plan, _ = vcan_direct.plan(2, private=False)
    with plan:
        assert plan.wrap(["x"]) == ["x"]
    assert done == []


@pytest.mark.parametrize("kernel_has_vcan", [True, False])
def test_without_root_the_kernel_is_emulated_and_the_reason_told(kernel_has_vcan, here):
    here({"vcan0": "up"}, None, kernel_has_vcan)
    plan, why_not = vcan_direct.plan(2, private=False)
    assert plan is None
    assert why_not.surprising == kernel_has_vcan
    assert ("root" in why_not.text) == kernel_has_vcan


def test_what_was_made_is_removed_and_no_more(here):
    done = here({"vcan0": "up", "vcan1": "down"}, root=["sudo", "-n"])
    plan, _ = vcan_direct.plan(3, private=False)
    made = [command[2:] for command in done if "ip" in command]
    assert made == [
        ["ip", "link", "set", "vcan1", "txqueuelen", "1000", "up"],
        ["ip", "link", "add", "vcan2", "type", "vcan"],
        ["ip", "link", "set", "vcan2", "txqueuelen", "1000", "up"],
    ]
    del done[:]
    with plan:
        assert done == []
    assert [command[2:] for command in done] == [
        ["ip", "link", "del", "vcan2"],
        ["ip", "link", "set", "vcan1", "down"],
    ]


def test_a_kernel_without_vcan_leaves_nothing_behind(here):
    done = here({}, [], works=lambda command: command[:3] != ["ip", "link", "add"])
    assert vcan_direct.plan(2, private=False)[0] is None
    assert ["ip", "link", "del", "vcan0"] not in done
    done = here({}, [], works=lambda command: command[:4] != ["ip", "link", "add", "vcan1"])
    assert vcan_direct.plan(2, private=False)[0] is None
    assert done[-1] == ["ip", "link", "del", "vcan0"]


def test_private_interfaces_keep_the_environment_under_sudo(here):
    here({"vcan0": "up"}, root=["sudo", "-n"])
    plan, _ = vcan_direct.plan(1, private=True)
    command = plan.wrap(["program", "argument"])
    assert command[:3] == ["sudo", "-n", "--preserve-env"]
    assert "--net" in command and command[-2:] == ["program", "argument"]
