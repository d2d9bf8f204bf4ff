"""Measures which lines, branches and conditions of firmware, portable HAL and STM32 drivers the tests reach.

    tools/verify --short coverage      the same figures as the long form, in under a minute

The preset clang-coverage is built, its unit tests run, and what llvm-cov exports is compared with
tests/coverage/exceptions.toml. Nothing may be missed without an exception, and each exception must
name something that is missed. Missed things are printed in the form that the file wants.

- line: one that llvm-cov counts.
- branch: one outcome, true or false, of a condition, or of a case of a switch.
- condition: one operand of a decision with && or ||. It is covered when two runs of the decision
  differ in it alone and in the outcome (unique-cause MC/DC, masked operands aside).

Several copies of an inline function count as one. The compiler leaves out a decision with more than
six conditions, and one like a || !(b && c), with no more than a warning: that each && and || of the
sources is in a measured decision is checked by counting them.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections import Counter, defaultdict
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
PRESET = "clang-coverage"
BUILD = ROOT / "build" / PRESET
PROFILES = BUILD / "profiles"
EXCEPTIONS = ROOT / "tests" / "coverage" / "exceptions.toml"
COMMAND = "tools/verify --short coverage"

MEASURED = (
    "firmware/include", "firmware/src", "hal/blank", "hal/include", "hal/loop", "hal/slcan",
    "hal/linux/stamp.c", "hal/linux/stamp.h", "hal/stm32")

# Compiles the sources a second time in another way; the two cannot be added up.
OTHER_BUILD = "test_without_zoh"

KINDS = ("line", "branch", "condition")
PLURALS = {"line": "lines", "branch": "branches", "condition": "conditions"}


class Thing(NamedTuple):
    """A line, a branch or a condition, by what is written there."""

    kind: str
    file: str
    function: str
    line: str
    what: str
    number: int


# ---- Measuring ---------------------------------------------------------------------------------


def run(*command, **options):
    print("+", " ".join(str(part) for part in command[:6]), flush=True)
    return subprocess.run([str(part) for part in command], cwd=ROOT, **{"check": True, **options})


def output_of(*command):
    return run(*command, stdout=subprocess.PIPE, text=True).stdout


# Unity's tests alone: replaying a fuzzer's inputs runs much and asserts little.
SELECTION = ("--preset", PRESET, "-L", "^unit$", "-R", "^test_", "-E", f"^{OTHER_BUILD}$")


def build():
    """Builds the programs of the tests, and returns their paths."""
    run("cmake", "--preset", PRESET, stdout=subprocess.DEVNULL)
    listing = json.loads(output_of("ctest", *SELECTION, "--show-only=json-v1"))
    names = sorted(test["name"] for test in listing["tests"])
    run("cmake", "--build", "--preset", PRESET, "--parallel", os.cpu_count() or 1, "--target", *names,
        "--", "--quiet")
    listing = json.loads(output_of("ctest", *SELECTION, "--show-only=json-v1"))
    return sorted(Path(test["command"][0]) for test in listing["tests"])


def run_tests():
    shutil.rmtree(PROFILES, ignore_errors=True)
    PROFILES.mkdir()
    environment = {key: value for key, value in os.environ.items() if key != "BERTH_TEST_SEED"}
    environment["LLVM_PROFILE_FILE"] = str(PROFILES / "%p-%m.profraw")
    result = run("ctest", *SELECTION, "--parallel", os.cpu_count() or 1, env=environment, check=False,
                 stdout=subprocess.PIPE, text=True)
    if result.returncode != 0:
        print(result.stdout)
        raise SystemExit("verify_coverage: a test has failed")


def measured_files():
    """The sources that are measured, relative to the tree's root."""
    found = []
    for place in MEASURED:
        path = ROOT / place
        found += [path] if path.is_file() else [*path.rglob("*.c"), *path.rglob("*.h")]
    return sorted(str(path.relative_to(ROOT)) for path in found)


def export(programs):
    """What llvm-cov knows: its JSON and its list of lines."""
    profile = PROFILES / "all.profdata"
    run("llvm-profdata-19", "merge", "-sparse", *PROFILES.glob("*.profraw"), "-o", profile)
    objects = [str(programs[0])]
    for program in programs[1:]:
        objects += ["-object", str(program)]
    arguments = [*objects, f"-instr-profile={profile}", "-sources", *measured_files()]
    data = json.loads(output_of("llvm-cov-19", "export", *arguments))["data"][0]
    return data, output_of("llvm-cov-19", "export", "-format=lcov", *arguments)


# ---- What there is, and what is missed ---------------------------------------------------------


class Source:
    """The text of the measured files, and which function a line belongs to."""

    def __init__(self, data):
        self.lines = {name: (ROOT / name).read_text().splitlines() for name in measured_files()}
        self.functions = defaultdict(dict)
        for function in data["functions"]:
            name = relative(function["filenames"][0])
            if name in self.lines:
                first, _, last, *_ = function["regions"][0]
                self.functions[name][first, last] = function["name"].split(":")[-1]

    def function_at(self, name, line):
        found = [text for (first, last), text in self.functions[name].items() if first <= line <= last]
        return found[0] if found else ""

    def text_at(self, name, line):
        return self.lines[name][line - 1].strip()

    def between(self, name, place):
        """The text of a range, on one line."""
        first, start, last, end = place
        lines = self.lines[name][first - 1 : last]
        lines[-1] = lines[-1][: end - 1]
        lines[0] = lines[0][start - 1 :]
        return " ".join(line.strip() for line in lines)

    def thing(self, kind, name, line, what):
        return Thing(kind, name, self.function_at(name, line), self.text_at(name, line), what, line)


def relative(path):
    try:
        return str(Path(path).relative_to(ROOT))
    except ValueError:
        return path


def lines_of(lcov, source):
    """Each counted line of a function, with whether it was run; not the macros that it uses."""
    found = {}
    name = ""
    for row in lcov.splitlines():
        if row.startswith("SF:"):
            name = relative(row[3:])
        elif row.startswith("DA:"):
            line, count = row[3:].split(",")[:2]
            thing = source.thing("line", name, int(line), "")
            if thing.function:
                found[thing] = int(count) > 0
    return found


def merged_branches(data, source):
    """Counts of both outcomes by place, of all copies of a function together."""
    counts = defaultdict(lambda: [0, 0])
    for function in data["functions"]:
        for branch in function["branches"]:
            name = relative(function["filenames"][branch[6]])
            if name in source.lines:
                both = counts[name, tuple(branch[:4])]
                both[0] += branch[4]
                both[1] += branch[5]
    return counts


def branches_of(counts, source):
    """Each outcome of each condition, with whether it was seen. A place may have two equal texts."""
    found = {}
    for (name, place), both in counts.items():
        text = source.between(name, place)
        for outcome, count in zip(("true", "false"), both):
            thing = source.thing("branch", name, place[0], f"{text} {outcome}")
            found[thing, place] = count > 0
    return found


def merged_decisions(data, source):
    """Which conditions of each decision are covered, by place; one copy of a function is enough."""
    found = {}
    for function in data["functions"]:
        name = relative(function["filenames"][0])
        if name not in source.lines:
            continue
        for record in function["mcdc_records"]:
            before = found.get((name, tuple(record[:4])), [False] * len(record[6]))
            found[name, tuple(record[:4])] = [a or b for a, b in zip(before, record[6], strict=True)]
    return found


def inside(inner, outer):
    return outer[:2] <= inner[:2] and inner[2:] <= outer[2:]


def operands(name, decision, count, decisions, branches):
    """The places of a decision's conditions, in the order of the text."""
    nested = [place for other, place in decisions
              if other == name and place != decision and inside(place, decision)]
    places = sorted(
        place for other, place in branches
        if other == name and inside(place, decision) and not any(inside(place, deeper) for deeper in nested))
    return places if len(places) == count else [decision] * count


def conditions_of(decisions, branches, source):
    """Each condition, with whether it was shown to decide alone."""
    found = {}
    for (name, decision), covered in decisions.items():
        places = operands(name, decision, len(covered), decisions, branches)
        for index, (place, good) in enumerate(zip(places, covered)):
            thing = source.thing("condition", name, decision[0], source.between(name, place))
            found[thing, decision, index] = good
    return found


def operators_in(text):
    """How many && and || the code has, comments, strings, preprocessor and assertions aside."""
    text = re.sub(r"/\*.*?\*/|//[^\n]*", " ", text, flags=re.DOTALL)
    text = re.sub(r'"(?:\\.|[^"\\\n])*"|\'(?:\\.|[^\'\\\n])*\'', " ", text)
    text = re.sub(r"^[ \t]*#(?:[^\n]*\\\n)*[^\n]*", " ", text, flags=re.MULTILINE)
    text = re.sub(r"_Static_assert\b.*?;", " ", text, flags=re.DOTALL)
    return len(re.findall(r"&&|\|\|", text))


# ---- Exceptions --------------------------------------------------------------------------------


def load_exceptions():
    """The exceptions as a list of (number, reason, {(kind, file, function, line, what)})."""
    table = tomllib.loads(EXCEPTIONS.read_text())
    found = []
    for entry in table.get("exception", []):
        keys = set()
        where = entry["file"], entry["function"]
        keys.update(("line", *where, text, "") for text in entry.get("lines", []))
        keys.update(("branch", *where, entry["at"], text) for text in entry.get("branches", []))
        keys.update(("condition", *where, entry["at"], text) for text in entry.get("conditions", []))
        unknown = set(entry) - {"number", "file", "function", "at", "lines", "branches", "conditions", "reason"}
        if unknown or not keys or len(entry["reason"]) < 20:
            raise ValueError(f"{EXCEPTIONS.name}: number {entry['number']}: unknown keys {sorted(unknown)}, "
                             "nothing named, or no reason")
        found.append((entry["number"], entry["reason"], keys))
    if [number for number, _, _ in found] != list(range(1, len(found) + 1)):
        raise ValueError(f"{EXCEPTIONS.name}: the numbers are not 1, 2, 3 and so on")
    return found


def compare(missed, exceptions):
    """What is wrong, as (kind, text): missed without an exception; exceptions of what is not missed."""
    excused = {key for _, _, keys in exceptions for key in keys}
    wrong = [(thing.kind, described(thing)) for thing in missed if thing[:5] not in excused]
    there = {thing[:5] for thing in missed}
    for number, _, keys in exceptions:
        wrong += [(key[0], f"exception {number} matches nothing that is missed: {key}")
                  for key in sorted(keys - there)]
    twice = [key for key, count in Counter(key for _, _, keys in exceptions for key in keys).items() if count > 1]
    wrong += [(key[0], f"excepted twice: {key}") for key in twice]
    return wrong


def described(thing):
    text = f"missed {thing.kind}: {thing.file}:{thing.number} in {thing.function}: {thing.line}"
    return text + (f"\n    {thing.what}" if thing.what else "")


def claims_of(groups, wrong, excused, decisions):
    titles = {
        "line": ("coverage-lines", "The tests run every line of the firmware, the portable HAL and the STM32 drivers",
                 "lines"),
        "branch": ("coverage-branches", "They take every branch both ways", "branches"),
        "condition": ("coverage-mcdc", "They show that each condition of each decision decides alone (MC/DC)",
                      f"conditions in {len(decisions):,} decisions"),
    }
    claims = []
    for kind in KINDS:
        name, claim, noun = titles[kind]
        found = groups[kind]
        figure = (f"{sum(found.values()):,} of {len(found):,} {noun} "
                  f"({excused[kind]} exception{'' if excused[kind] == 1 else 's'})")
        claims.append({
            "id": name, "claim": claim, "figure": figure, "command": COMMAND,
            "holds": not any(bad == kind for bad, _ in wrong), "exact": True})
    return claims


def notes_of(exceptions):
    lines = [
        "Measured with clang-19 in `firmware/src`, `firmware/include`, `hal/include`, `hal/loop`, `hal/slcan`,",
        "`hal/blank`, `hal/linux/stamp.c` and, against models of the registers, `hal/stm32`, by the unit tests",
        "alone: no program, no bus, no board. Not in the figures: what is for Linux or for an emulated board alone",
        "(`hal/linux` but for `stamp.c`, `hal/mps2`, `firmware/boards`), and the few lines that the firmware has",
        "instead where parts are compiled out. The exceptions, from `tests/coverage/exceptions.toml`:",
        "",
    ]
    return lines + [f"{number}. {' '.join(reason.split())}" for number, reason, _ in exceptions]


def check_operators(decisions, source):
    """Every && and || is in a decision that was measured."""
    wrong = []
    for name, lines in source.lines.items():
        there = operators_in("\n".join(lines))
        measured = sum(len(covered) - 1 for (other, _), covered in decisions.items() if other == name)
        if there != measured:
            wrong.append(("condition", f"{name}: {there} operators && and ||, {measured} measured"))
    return wrong


def measure():
    programs = build()
    run_tests()
    data, lcov = export(programs)
    source = Source(data)
    counts = merged_branches(data, source)
    decisions = merged_decisions(data, source)
    groups = {
        "line": lines_of(lcov, source),
        "branch": branches_of(counts, source),
        "condition": conditions_of(decisions, counts, source),
    }
    return source, groups, decisions


def missed_in(groups):
    missed = [thing for thing, good in groups["line"].items() if not good]
    for kind in KINDS[1:]:
        missed += [key[0] for key, good in groups[kind].items() if not good]
    return sorted(missed, key=lambda thing: (thing.file, thing.number, KINDS.index(thing.kind), thing.what))


def main():
    parser = argparse.ArgumentParser(allow_abbrev=False)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--short", action="store_true")
    parser.add_argument("--minutes", type=float)
    options = parser.parse_args()
    source, groups, decisions = measure()
    missed = missed_in(groups)
    exceptions = load_exceptions()
    wrong = compare(missed, exceptions) + check_operators(decisions, source)
    for _, text in wrong:
        print(text)
    excused = Counter(kind for _, _, keys in exceptions for kind in (key[0] for key in keys))
    claims = claims_of(groups, wrong, excused, decisions)
    for claim in claims:
        print(f"{claim['id']}: {claim['figure']}")
    options.out.write_text(json.dumps({"claims": claims, "notes": notes_of(exceptions)}, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
