"""What the firmware costs on this processor: as README.md tells it, and within the budgets."""

import subprocess

import pytest

from target import BOARDS, BUILD, ROOT

import target_cost
import target_stack

GNU = BUILD.name in target_cost.TARGETS


@pytest.fixture(scope="module")
def figures():
    if GNU:
        return target_cost.measure(BUILD.name, BUILD)
    return target_cost.run_image(BUILD, BOARDS[0])


def test_image_counts_everything(figures):
    """It ends by itself, after it has checked its counter against a loop counted by hand."""
    assert figures["step.count"] == 1500
    assert figures["step.two.count"] > 10
    assert figures["law.median"] < figures["step.median"] < figures["step.max"]
    for protocol in target_cost.PROTOCOLS:
        assert figures[f"board.step.{protocol}.count"] > 1500
        assert figures[f"board.step.{protocol}.median"] > figures["step.median"]


def test_page_and_budgets(figures):
    if not GNU:
        return  # the page tells of gcc alone
    assert target_cost.problems({BUILD.name: figures}, {BUILD.name: BUILD}) == []


def test_what_is_worse_is_found(figures):
    if not GNU:
        return
    for name in ("law.median", "step.max", "flash.small", "ram.controller"):
        worse = {**figures, name: 10 * figures[name]}
        found = target_cost.problems({BUILD.name: worse}, {BUILD.name: BUILD})
        assert any("README.md" in line for line in found), name
        over = any(line.startswith(f"{name}:") and "OVER" in line for line in found)
        assert over == (BUILD.name == target_cost.MAIN), name


def test_painted_stack_is_within_the_bound(figures):
    """Painting includes what the caller pushes: its own registers and the call's arguments."""
    if BUILD.name == target_cost.MAIN:
        for part in ("controller.step", "board.step", "board.receive"):
            assert figures[f"stack.{part}"] <= figures[f"stack.bound.{part}"] + 24, part


def graph_of(folder, monkeypatch, source):
    (folder / "one.c").write_text(source)
    monkeypatch.setattr(target_stack, "SOURCES", folder)
    return target_stack.CallGraph("arm-none-eabi-gcc", target_cost.M4F)


ARRAY = "void use(volatile char *p);\nvoid use(volatile char *p) { *p = 1; }\n"


def test_stack_adds_up(tmp_path, monkeypatch):
    graph = graph_of(tmp_path, monkeypatch, ARRAY + "void f(void);\n"
                     "void f(void) { volatile char a[200]; use(a); use(a + 1); }\n")
    assert 200 <= graph.depth("f") <= 232


@pytest.mark.parametrize("source", [
    "int f(int n);\nint f(int n) { volatile int a[4] = {n}; return n > 0 ? f(n - 1) + f(n - 2) + a[1] : 0; }\n",
    ARRAY + "void f(int n);\nvoid f(int n) { volatile char a[n]; use(a); }\n",
    "void f(void (*g)(void));\nvoid f(void (*g)(void)) { g(); g(); }\n",
    "void g(void);\nvoid f(void);\nvoid f(void) { g(); g(); }\n",
], ids=["recursion", "no bound", "pointer", "unknown"])
def test_stack_refuses_what_it_cannot_bound(tmp_path, monkeypatch, source):
    with pytest.raises(SystemExit):
        graph_of(tmp_path, monkeypatch, source).depth("f")


def test_command_prints_the_table():
    if not GNU:
        return
    done = subprocess.run(
        [ROOT / ".venv/bin/python", "-B", ROOT / "tools/lib/target_cost.py", "--check", BUILD],
        capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr
    assert done.stdout.startswith("| | budget |")
