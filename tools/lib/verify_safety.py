"""Checks the fault tree of firmware/safety.md: every leaf's tests exist and pass, no fault is missing.

usage: verify_safety.py [--out FILE] [--short | --minutes M]

A test is `program::function` (Unity, from tests/) or `tests/.../file.py::function` (pytest). The Unity
programs among them are built (preset gcc-release) and run here, with the tests' short effort. Those in
Python need emulated boards or CAN interfaces, and are run by tools/test: here they only have to exist.
Each fault code of the headers has to be in the tree. All this takes seconds, so there is no short form.
"""

import argparse
import json
import os
import re
import subprocess
import sys
from pathlib import Path

from cmake_build import build

ROOT = Path(__file__).resolve().parents[2]
NOTES = ROOT / "firmware" / "safety.md"
BUILD = ROOT / "build" / "gcc-release"
HEADERS = ROOT / "firmware" / "include" / "berth"

LEAF = re.compile(r"^\| ([A-Z]\d+) \|(.*)\|$", re.MULTILINE)
TEST = re.compile(r"`([\w/.]+)::(\w+)`")
FAULTS = re.compile(r"typedef enum \{([^}]*)\} berth_(?:drive_)?fault_t;")
# Not faults: nothing, the end of the enumeration, and what a side adds to a drive's fault.
NO_FAULTS = {"BERTH_FAULT_NONE", "BERTH_DRIVE_FAULT_NONE", "BERTH_DRIVE_FAULT_COUNT", "BERTH_FAULT_LEFT",
             "BERTH_FAULT_RIGHT"}
# One source, compiled for each controller.
PROGRAMS = {"test_controller_contract": ("test_bxcan_contract", "test_fdcan_contract")}


def leaves_of(text):
    """{id: the row's other cells}; an id that is there twice is an error."""
    leaves = {}
    for name, row in LEAF.findall(text):
        if name in leaves:
            raise SystemExit(f"{NOTES.name}: leaf {name} is there twice")
        leaves[name] = row
    return leaves


def fault_codes():
    text = (HEADERS / "supervisor.h").read_text() + (HEADERS / "drive.h").read_text()
    names = re.findall(r"^ +(BERTH_\w+)", "\n".join(FAULTS.findall(text)), re.MULTILINE)
    return sorted(set(names) - NO_FAULTS)


def missing_codes(leaves, codes):
    """Codes that no leaf names."""
    named = set(re.findall(r"`(BERTH_\w+)`", "\n".join(leaves.values())))
    return [code for code in codes if code not in named]


def source_of(program):
    if program.endswith(".py"):
        path = ROOT / program
        return path if path.is_file() else None
    found = list((ROOT / "tests").rglob(f"{program}.c"))
    return found[0] if len(found) == 1 else None


def absent(tests):
    """Those of (program, function) that are not defined, or not called by their program."""
    wrong = []
    for program, function in tests:
        source = source_of(program)
        pattern = rf"^def {function}\(" if program.endswith(".py") else rf"\bRUN_TEST\({function}\b"
        if source is None or not re.search(pattern, source.read_text(), re.MULTILINE):
            wrong.append(f"{program}::{function}")
    return wrong


def path_of(program):
    return next(path for path in (BUILD / "tests" / program, BUILD / "tests" / "stm32" / program) if path.exists())


def passed_functions(program):
    """The functions that the program reports as passed."""
    environment = dict(os.environ, BERTH_TEST_EFFORT="short", BERTH_SOURCE_DIR=str(ROOT), BERTH_BUILD_DIR=str(BUILD))
    done = subprocess.run([str(path_of(program))], cwd=BUILD, env=environment, stdin=subprocess.DEVNULL,
                          capture_output=True, text=True, timeout=600)
    print(f"{program}: status {done.returncode}, {done.stdout.strip().splitlines()[-2:-1]}", flush=True)
    return set(re.findall(r"^[^:\n]+:\d+:(\w+):PASS$", done.stdout, re.MULTILINE))


def failing(tests):
    """Those of (program, function) that do not pass here, in any program made of their source."""
    programs = {name: PROGRAMS.get(name, (name,)) for name, _ in tests}
    build("gcc-release", *sorted({program for made in programs.values() for program in made}))
    passed = {program: passed_functions(program) for made in programs.values() for program in made}
    return [f"{name}::{function}" for name, function in tests
            if not all(function in passed[program] for program in programs[name])]


def claims_of(leaves, codes):
    tests = sorted(set(TEST.findall("\n".join(leaves.values()))))
    bare = [name for name, row in leaves.items() if not TEST.search(row)]
    wrong, missing = absent(tests), missing_codes(leaves, codes)
    for title, found in (("without a test", bare), ("no such test", wrong), ("not in the tree", missing)):
        for name in found:
            print(f"{title}: {name}")
    here = [test for test in tests if not test[0].endswith(".py") and f"{test[0]}::{test[1]}" not in wrong]
    failed = failing(here)
    for name in failed:
        print(f"does not pass: {name}")
    return [
        {"id": "safety-tree", "exact": True, "holds": not (bare or wrong or missing),
         "claim": "Each leaf of the fault tree in `firmware/safety.md` names tests that exist and are run; "
                  "each fault of the firmware is in the tree",
         "figure": f"{len(leaves)} leaves, {len(tests)} tests, {len(codes) - len(missing)} of {len(codes)} faults",
         "command": "tools/verify safety"},
        {"id": "safety-tests", "exact": True, "holds": len(here) > 0 and not failed,
         "claim": "The tests of the leaves pass: these here, the others (emulated boards, CAN interfaces) with "
                  "`tools/test`",
         "figure": f"{len(here) - len(failed)} of {len(here)} pass, {len(tests) - len(here)} others",
         "command": "tools/verify safety"},
    ]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--short", action="store_true")
    parser.add_argument("--minutes", type=float)
    options = parser.parse_args()
    claims = claims_of(leaves_of(NOTES.read_text()), fault_codes())
    for claim in claims:
        print(f"{claim['id']}: {claim['figure']}")
    if options.out:
        options.out.write_text(json.dumps({"claims": claims, "notes": []}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
