"""Changes the firmware in one place at a time and sees whether the unit tests notice.

usage: verify_mutation.py [--out FILE] [--short | --minutes M] [--module NAME]... [--again] [--jobs N]

universalmutator makes the mutants with the rules of tests/mutation/c.rules. Each is compiled alone
into a shared object which takes the place of the firmware's own functions in the unit tests' programs
(preset gcc-mutation), and is killed when one of its module's tests fails, crashes or does not end.
Mutants whose object code at -O2 is that of the original are left out: nothing can tell them apart.

Survivors have to be in tests/mutation/survivors.txt with a reason. Without --short and --minutes
every mutant is tried. --module limits it to some modules, --again to those that survived last time.
"""

import argparse
import contextlib
import hashlib
import io
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from universalmutator.mutator import mutants_regexp

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ROOT / "firmware" / "src"
BUILD = ROOT / "build" / "gcc-mutation"
OUT = ROOT / "build" / "verify"
RULES = ROOT / "tests" / "mutation" / "c.rules"
REGISTER = ROOT / "tests" / "mutation" / "survivors.txt"
LAST = OUT / "mutation-survivors.json"
SEED = 20261
SHORT_SAMPLE = 90
CFLAGS = ["-std=c11", "-fPIC", "-fno-math-errno", "-ffp-contract=off", "-w",
          f"-I{ROOT}/firmware/include", f"-I{ROOT}/hal/include", "-iquote", str(SOURCES)]

# Module: the files that are changed, and the tests that have to notice, the quickest first.
AVOID = ("test_avoid", "test_avoid_reference", "test_lookahead", "test_controller", "test_clearance", "test_obstacles")
DRIVE = ("test_drive", "test_drive_pairs", "test_board")
MODULES = {
    "avoid": (("avoid.c", "lookahead.c"), AVOID),
    "tracker": (("tracker.c", "tracker_inline.h", "error.c", "error_inline.h"),
                ("test_error_tracker", "test_controller")),
    "riccati": (("riccati.c", "riccati_core.h"), ("test_riccati", "test_constrained")),
    "limits": (("limits.c",), ("test_limits", "test_controller", "test_validation")),
    "supervisor": (("supervisor.c",), ("test_supervisor", "test_board")),
    "drive": (("drive.c",), ("test_drive_odrive", "test_drive_vesc", "test_drive_cia402", *DRIVE)),
    "odrive": (("drive_odrive.c",), ("test_drive_odrive", *DRIVE)),
    "vesc": (("drive_vesc.c",), ("test_drive_vesc", *DRIVE)),
    "cia402": (("drive_cia402.c", "cia402_state.c", "cia402_sdo.c"),
               ("test_drive_cia402", "test_drive_cia402_pair", *DRIVE)),
}


@dataclass(frozen=True)
class Mutant:
    module: str
    file: str
    line: int
    before: str
    after: str
    text: str  # the whole file, changed

    def key(self):
        return (self.file, self.before, self.after)


def blank_comments(text):
    """The same lines without comments and with strings left alone."""
    def blank(match):
        found = match.group(0)
        return found if found.startswith('"') else re.sub(r"[^\n]", " ", found)
    return re.sub(r'"(?:\\.|[^"\\])*"|/\*.*?\*/|//[^\n]*', blank, text, flags=re.DOTALL)


def mutants_of(module, name):
    text = (SOURCES / name).read_text()
    lines = text.splitlines(keepends=True)
    bare = [line.rstrip() + "\n" for line in blank_comments(text).splitlines()]
    with contextlib.redirect_stdout(io.StringIO()):
        found = mutants_regexp(bare, [str(RULES)], ignorePatterns=[], ignoreStringOnly=True)
    for number, after, *_ in found:
        changed = lines[:number - 1] + [after] + lines[number:]
        before = " ".join(bare[number - 1].split())
        yield Mutant(module, name, number, before, " ".join(after.split()), "".join(changed))


def all_mutants(modules):
    return [mutant for module in modules for name in MODULES[module][0] for mutant in mutants_of(module, name)]


def users_of(name):
    """The sources to compile for a changed file: itself, or all that include the header."""
    if name.endswith(".c"):
        return [name]
    return sorted(path.name for path in SOURCES.glob("*.c") if f'#include "{name}"' in path.read_text())


def compile_files(folder, names, output, options):
    """False when the compiler refuses."""
    command = ["gcc", *CFLAGS, *options, "-o", str(output), *(str(folder / name) for name in names)]
    return subprocess.run(command, capture_output=True).returncode == 0


def lay_out(folder, name, text):
    """The changed file and what is compiled with it, in a folder of their own."""
    for user in users_of(name):
        if user != name:
            shutil.copy(SOURCES / user, folder / user)
    (folder / name).write_text(text)


def object_code(name, text):
    """A digest of the code at -O2, without names of files or lines; None when it does not compile."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        lay_out(folder, name, text)
        digest = hashlib.sha256()
        for user in users_of(name):
            output = folder / "code.s"
            if not compile_files(folder, [user], output, ["-O2", "-S", "-fno-ident", "-g0"]):
                return None
            digest.update(re.sub(rb"\t\.file[^\n]*\n", b"", output.read_bytes()))
        return digest.digest()


class Tests:
    """The unit tests' programs, how long they take, and which noticed most of late."""

    def __init__(self, modules):
        self.lock = threading.Lock()
        self.order = {module: list(MODULES[module][1]) for module in modules}
        self.seconds = {}
        self.environment = dict(os.environ, BERTH_TEST_EFFORT="100", BERTH_SOURCE_DIR=str(ROOT),
                                BERTH_BUILD_DIR=str(BUILD))

    def run(self, name, library, limit_s):
        """True when the test passes with the library's functions."""
        environment = dict(self.environment, LD_PRELOAD=str(library)) if library else self.environment
        try:
            done = subprocess.run([str(BUILD / "tests" / name)], env=environment, cwd=BUILD, timeout=limit_s,
                                  stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        except subprocess.TimeoutExpired:
            return False
        return done.returncode == 0

    def measure(self):
        """Every test must pass with unchanged functions that are put in the same way."""
        with tempfile.TemporaryDirectory() as place:
            for module, names in self.order.items():
                library = Path(place) / f"{module}.so"
                sources = [user for name in MODULES[module][0] for user in users_of(name)]
                if not compile_files(SOURCES, sorted(set(sources)), library, ["-O1", "-shared"]):
                    raise SystemExit(f"{module} does not compile")
                for name in names:
                    start = time.monotonic()
                    if not self.run(name, library, 300):
                        raise SystemExit(f"{name} fails with unchanged functions of {module}")
                    self.seconds[name] = max(self.seconds.get(name, 0.0), time.monotonic() - start)

    def noticed_by(self, module, library):
        """The first test that fails, or None."""
        for name in list(self.order[module]):
            if not self.run(name, library, 5.0 + 10.0 * self.seconds[name]):
                with self.lock:
                    self.order[module].remove(name)
                    self.order[module].insert(0, name)
                return name
        return None


def outcome(mutant, tests, originals):
    """invalid, same, alive, or killed."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        lay_out(folder, mutant.file, mutant.text)
        library = folder / "mutant.so"
        if not compile_files(folder, users_of(mutant.file), library, ["-O1", "-shared"]):
            return "invalid"
        if tests.noticed_by(mutant.module, library):
            return "killed"
    return "same" if object_code(mutant.file, mutant.text) == originals[mutant.file] else "alive"


def register():
    """Known survivors: {(file, before, after): (kind, reason)}."""
    known, kind, reason, file, before = {}, None, None, None, None
    for number, line in enumerate(REGISTER.read_text().splitlines(), 1):
        if not line.strip() or line.startswith("#"):
            continue
        head = re.match(r"(equivalent|alive): (.+)", line)
        if head:
            kind, reason = head.groups()
        elif re.match(r"  \w+\.[ch]$", line):
            file = line.strip()
        elif line.startswith("  - "):
            before = line[4:]
        elif line.startswith("  + ") and kind and file and before:
            known[(file, before, line[4:])] = (kind, reason)
        else:
            raise SystemExit(f"{REGISTER.name}, line {number}: not understood: {line}")
    return known


def build():
    for command in (["cmake", "--preset", "gcc-mutation"],
                    ["cmake", "--build", "--preset", "gcc-mutation", "--parallel", "--target",
                     *sorted({name for _, names in MODULES.values() for name in names})]):
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
        if done.returncode != 0:
            print(done.stdout[-4000:] + done.stderr[-4000:])
            raise SystemExit("the tests do not build")


def try_all(mutants, tests, originals, jobs, end):
    """[(mutant, outcome)] of those that were tried before the time was over."""
    results, start = [], time.monotonic()

    def attempt(mutant):
        return (mutant, outcome(mutant, tests, originals)) if time.monotonic() < end else None

    with ThreadPoolExecutor(jobs) as pool:
        for result in pool.map(attempt, mutants):
            if result is None:
                continue
            results.append(result)
            if result[1] == "alive":
                print(f"alive: {result[0].file}:{result[0].line}\n  - {result[0].before}\n  + {result[0].after}")
            if len(results) % 100 == 0:
                print(f"{len(results)} of {len(mutants)}, {time.monotonic() - start:.0f} s", flush=True)
    return results


def judge(results, known, complete):
    """Counts, and the entries that are missing from the register or no longer true."""
    counts = Counter(kind for _, kind in results)
    alive = {mutant.key(): mutant for mutant, kind in results if kind == "alive"}
    equivalent = [key for key in alive if known.get(key, ("",))[0] == "equivalent"]
    n_equivalent = sum(1 for mutant, kind in results if kind == "alive" and mutant.key() in equivalent)
    unknown = [key for key in alive if key not in known]
    # a line that occurs twice can have one mutant that is killed and one that is not
    killed = {mutant.key() for mutant, kind in results if kind in ("killed", "same")} - set(alive)
    stale = [key for key in known if key in killed or (complete and key not in alive)]
    valid = counts["killed"] + counts["alive"] - n_equivalent
    return counts, n_equivalent, valid, unknown, stale


def claims_of(results, known, options, modules):
    complete = not options.short and not options.cut and not options.again and set(modules) == set(MODULES)
    counts, n_equivalent, valid, unknown, stale = judge(results, known, complete)
    score = 100.0 * counts["killed"] / max(valid, 1)
    left_out = counts["same"] + n_equivalent
    kind = "mutants" if complete else f"mutants of a sample (seed {SEED})"
    for text, keys in (("not in the register", unknown), ("in the register, but not alive", stale)):
        for key in keys:
            print(f"{text}: {key[0]}\n  - {key[1]}\n  + {key[2]}")
    listed = len(unknown) == 0 and len(stale) == 0
    survivors = counts["alive"] - n_equivalent
    return [
        {"id": "mutation-score", "short": not complete, "exact": complete, "holds": valid > 0 and score >= 95.0,
         "claim": "At least 95 % of the mutants of avoidance, tracker, gain, limits, supervisor and drive protocols "
                  "that are not equivalent are killed by the unit tests",
         "figure": f"{score:.1f} %: {counts['killed']:,} of {valid:,} {kind}; {left_out:,} more are equivalent",
         "command": "tools/verify mutation"},
        {"id": "mutation-survivors", "short": not complete, "exact": complete, "holds": listed,
         "claim": "Every survivor is listed with a reason in `tests/mutation/survivors.txt`",
         "figure": f"{survivors} survivors and {n_equivalent} that are equivalent, "
                   f"{len(unknown)} unlisted, {len(stale)} stale",
         "command": "tools/verify mutation"},
    ]


def notes_of(results, known):
    rows = ["| file | mutants | killed | equivalent | survivors |", "|---|---:|---:|---:|---:|"]
    for name in sorted({mutant.file for mutant, _ in results}):
        counts = Counter()
        for mutant, kind in results:
            if mutant.file == name:
                listed = known.get(mutant.key(), ("",))[0]
                counts["same" if kind == "alive" and listed == "equivalent" else kind] += 1
        total = counts["killed"] + counts["same"] + counts["alive"]
        rows.append(f"| {name} | {total} | {counts['killed']} | {counts['same']} | {counts['alive']} |")
    return rows


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--short", action="store_true")
    parser.add_argument("--minutes", type=float)
    parser.add_argument("--module", action="append", choices=sorted(MODULES))
    parser.add_argument("--again", action="store_true")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    return parser.parse_args()


def chosen(options, modules):
    mutants = all_mutants(modules)
    random.Random(SEED).shuffle(mutants)
    if options.short:
        return mutants[:SHORT_SAMPLE]
    if options.again:
        last = {tuple(key) for key in json.loads(LAST.read_text())}
        return [mutant for mutant in mutants if mutant.key() in last]
    return mutants


def main():
    options = arguments()
    modules = options.module or list(MODULES)
    known = register()
    OUT.mkdir(parents=True, exist_ok=True)
    build()
    tests = Tests(modules)
    tests.measure()
    originals = {name: object_code(name, (SOURCES / name).read_text())
                 for module in modules for name in MODULES[module][0]}
    mutants = chosen(options, modules)
    end = time.monotonic() + (options.minutes * 60.0 if options.minutes else 1e9)
    results = try_all(mutants, tests, originals, options.jobs, end)
    options.cut = len(results) < len(mutants)
    alive = sorted({mutant.key() for mutant, kind in results if kind == "alive"})
    if not options.short:
        LAST.write_text(json.dumps(alive, indent=1) + "\n")
    claims = claims_of(results, known, options, modules)
    for claim in claims:
        print(f"{claim['id']}: {claim['figure']}")
    if options.out:
        options.out.write_text(json.dumps({"claims": claims, "notes": notes_of(results, known)}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
