"""Every program, command and scenario in README.md works and prints what the page says."""

import os
import pathlib
import re
import shlex
import subprocess

import pytest
import simulator

ROOT = simulator.ROOT
README = (ROOT / "README.md").read_text(encoding="utf-8")
FLAGS = ["-std=c11", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow",
         "-Wdouble-promotion", "-Wfloat-conversion", "-Werror", "-ffp-contract=off"]


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)


def console_cases():
    """(command, expected output) of each command in a console block."""
    cases = []
    for block in blocks("console"):
        for part in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
            command, _, output = part.partition("\n")
            cases.append((command, output))
    return cases


def run(command, folder):
    """Runs one command line of the page; the programs are the build's own."""
    words = shlex.split(command)
    words[0] = {"berth-sim": os.environ["BERTH_SIM"], "berth-gen": os.environ["BERTH_GEN"]}[words[0]]
    return subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=300,
                          check=False)


def test_the_page_has_what_these_tests_take_from_it():
    assert len(blocks("c")) == 1
    assert len(blocks("sh")) == 1
    assert len(blocks("yaml")) == 1
    assert len(console_cases()) >= 2


def test_the_control_loop_compiles_and_runs(tmp_path):
    """The plan by the page's own command, then the program, with the firmware's sources."""
    for command in blocks("sh")[0].splitlines():
        generated = run(command, tmp_path)
        assert (generated.returncode, generated.stderr) == (0, "")
    (tmp_path / "main.c").write_text(blocks("c")[0])
    program = tmp_path / "loop"
    compiled = subprocess.run(
        [os.environ["BERTH_CC"], *FLAGS, f"-I{ROOT}/firmware/include",
         f"-I{ROOT}/hal/include", f"-I{tmp_path}",
         str(tmp_path / "main.c"), str(tmp_path / "circle.c"),
         *map(str, sorted((ROOT / "firmware/src").glob("*.c"))), "-lm", "-o", str(program)],
        capture_output=True, text=True, timeout=120, check=False)
    assert (compiled.returncode, compiled.stderr) == (0, "")
    done = subprocess.run([program], capture_output=True, text=True, timeout=30, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    match = re.fullmatch(r"track, (-?[\d.]+) m ahead, (-?[\d.]+) m to the left, "
                         r"least clearance ([\d.]+) m\n", done.stdout)
    assert match, done.stdout
    assert abs(float(match[1])) < 0.01 and abs(float(match[2])) < 0.01
    assert float(match[3]) > 0.04


@pytest.mark.parametrize("command, expected", console_cases())
def test_a_command_prints_what_the_page_shows(command, expected, tmp_path):
    done = run(command, tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.strip() == expected.strip()


def test_the_scenario_runs(tmp_path):
    scenario = tmp_path / "aisle.yaml"
    scenario.write_text(blocks("yaml")[0])
    summary = simulator.summary("run", scenario)
    assert summary["collisions"] == 0
    assert summary["final_position_error_m"] < 0.05


def test_links_and_paths_exist():
    """Files that the page names, with or without a link."""
    named = set(re.findall(r"\]\((?!http)([^)#]+)\)", README))
    named |= {word for word in re.findall(r"`([\w./-]+)`", README)
              if word.split("/")[0] in ("firmware", "hal", "host_sim", "tools", "tests") and "/" in word}
    assert len(named) >= 5
    missing = [name for name in sorted(named) if not (ROOT / pathlib.Path(name)).exists()]
    assert missing == []
