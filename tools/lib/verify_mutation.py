"""Changes the firmware in one place at a time and sees whether the unit tests notice.

usage: verify_mutation.py [--out FILE] [--short | --minutes M | --judge] [--module NAME]... [--again] [--jobs N]

universalmutator makes the mutants with the rules of tests/mutation/c.rules. Each is compiled alone
into a shared object which takes the place of the firmware's own functions in the unit tests' programs
(preset gcc-mutation). It is killed when one of its module's tests fails or crashes, uses far more
processor time than it should, or runs into one of gcc's checks for undefined behaviour, under which
the sanitizers' presets run the same tests. Where a test includes the changed file itself, it is
compiled anew. Mutants whose object code at -O2 is that of the original are left out: nothing can tell
them apart.

Survivors have to be in tests/mutation/survivors.txt with a reason. Without --short and --minutes
every mutant is tried. --module limits it to some modules, --again to those that survived last time.
--judge tries nothing: it holds what the last run found against the register as it is now, as long as
neither the sources nor the tests have changed.
"""

import argparse
import hashlib
import json
import math
import os
import random
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from cmake_build import build
from mutants import Register, block, judge, mutants_of, table

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ROOT / "firmware" / "src"
BUILD = ROOT / "build" / "gcc-mutation"
OUT = ROOT / "build" / "verify"
RULES = ROOT / "tests" / "mutation" / "c.rules"
REGISTER = ROOT / "tests" / "mutation" / "survivors.txt"
LAST = OUT / "mutation-last.json"  # what was found, and in what
SEED = 20261
SHORT_SAMPLE = 90
# A test that has not ended after so long was not given the processor: that decides nothing.
WALL_S = 900.0
CFLAGS = ["-std=c11", "-fPIC", "-fno-math-errno", "-ffp-contract=off", "-w",
          f"-I{ROOT}/firmware/include", f"-I{ROOT}/hal/include", "-iquote", str(SOURCES)]
CHECKED = ["-O1", "-fsanitize=undefined,float-divide-by-zero,float-cast-overflow",
           "-fsanitize-undefined-trap-on-error"]

# Module: the files that are changed, and the tests that have to notice, the quickest first.
AVOID = ("test_avoid_edges", "test_avoid", "test_avoid_reference", "test_lookahead", "test_controller",
         "test_clearance", "test_obstacles")
DRIVE = ("test_drive_edges", "test_drive", "test_drive_pairs", "test_board")
MODULES = {
    "avoid": (("avoid.c", "lookahead.c"), AVOID),
    "tracker": (("tracker.c", "tracker_inline.h", "error.c", "error_inline.h"),
                ("test_error_tracker", "test_controller")),
    "riccati": (("riccati.c", "riccati_core.h"), ("test_riccati", "test_constrained")),
    "limits": (("limits.c",), ("test_limits_edges", "test_limits", "test_controller", "test_validation")),
    "supervisor": (("supervisor.c",), ("test_supervisor_edges", "test_supervisor", "test_board")),
    "drive": (("drive.c",), ("test_drive_odrive", "test_drive_vesc", "test_drive_cia402", *DRIVE)),
    "odrive": (("drive_odrive.c",), ("test_drive_odrive", *DRIVE)),
    "vesc": (("drive_vesc.c",), ("test_drive_vesc", *DRIVE)),
    "cia402": (("drive_cia402.c", "cia402_state.c", "cia402_sdo.c"),
               ("test_drive_cia402_edges", "test_drive_cia402", "test_drive_cia402_pair", *DRIVE)),
}
# Of a header with several users: one of them, and a test that needs no other. It is tried first, since
# that takes less to compile.
ALONE = {"riccati_core.h": ("riccati.c", "test_riccati")}
# Files that tests include, and those tests.
INCLUDED = {"riccati_core.h": ("test_riccati",)}


def all_mutants(modules):
    return [mutant for module in modules for name in MODULES[module][0]
            for mutant in mutants_of(module, SOURCES / name, RULES)]


# --- compiling ------------------------------------------------------------------------------------


def users_of(name):
    """The sources to compile for a changed file: itself, or all that include the header."""
    if name.endswith(".c"):
        return [name]
    return sorted(path.name for path in SOURCES.glob("*.c") if f'#include "{name}"' in path.read_text())


def compile_files(folder, names, output, options):
    """False when the compiler refuses."""
    command = ["gcc", *CFLAGS, *options, "-o", str(output), *(str(folder / name) for name in names)]
    return subprocess.run(command, capture_output=True).returncode == 0


def lay_out(place, name, text):
    """The changed file and what is compiled with it, in a tree of their own. Returns its folder."""
    folder = place / "firmware" / "src"
    folder.mkdir(parents=True)
    for user in users_of(name):
        if user != name:
            shutil.copy(SOURCES / user, folder / user)
    (folder / name).write_text(text)
    return folder


def object_code(name, text):
    """A digest of the code at -O2, without names of files or lines; None when it does not compile."""
    with tempfile.TemporaryDirectory() as place:
        folder = lay_out(Path(place), name, text)
        digest = hashlib.sha256()
        for user in users_of(name):
            output = folder / "code.s"
            if not compile_files(folder, [user], output, ["-O2", "-S", "-fno-ident", "-g0"]):
                return None
            digest.update(re.sub(rb"\t\.file[^\n]*\n", b"", output.read_bytes()))
        return digest.digest()


def compile_test(place, name):
    """A test that includes the changed file, compiled in the tree where that is. None: refused."""
    folder = place / "tests"
    folder.mkdir(exist_ok=True)
    shutil.copy(ROOT / "tests" / f"{name}.c", folder)
    program = folder / name
    libraries = ["tests/libtest_support.a", "tests/libunity.a", "host_sim/libsim_core.a", "firmware/libberth.so"]
    command = ["gcc", *CFLAGS, "-O1", "-D_GNU_SOURCE", "-DUNITY_INCLUDE_DOUBLE", "-DUNITY_SUPPORT_64",
               f"-I{ROOT}/tests", f"-I{ROOT}/host_sim", "-isystem", f"{ROOT}/.cache/unity",
               str(folder / f"{name}.c"), "-o", str(program), f"-Wl,-rpath,{BUILD}/firmware",
               *(str(BUILD / library) for library in libraries), "-lm"]
    return program if subprocess.run(command, capture_output=True).returncode == 0 else None


# --- trying ---------------------------------------------------------------------------------------


class Tests:
    """The unit tests' programs, how much time they take, and which noticed most of late."""

    def __init__(self, modules):
        self.lock = threading.Lock()
        self.order = {module: list(MODULES[module][1]) for module in modules}
        self.seconds = {}
        self.environment = dict(os.environ, BERTH_TEST_EFFORT="100", BERTH_SOURCE_DIR=str(ROOT),
                                BERTH_BUILD_DIR=str(BUILD))

    def run(self, program, library, cpu_s):
        """passes, fails or busy. Processor time is limited and not time: that of an endless loop is
        the same however much else the machine has to do."""
        command = ["prlimit", f"--cpu={cpu_s}", "--core=0", "env", f"LD_PRELOAD={library}", str(program)]
        try:
            done = subprocess.run(command, env=self.environment, cwd=BUILD, timeout=WALL_S,
                                  stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        except subprocess.TimeoutExpired:
            return "busy"
        return "passes" if done.returncode == 0 else "fails"

    def limit(self, name):
        return math.ceil(0.5 + 10.0 * self.seconds[name])

    def measure(self):
        """Every test must pass with unchanged functions that are put in the same way."""
        with tempfile.TemporaryDirectory() as place:
            for module, names in self.order.items():
                library = Path(place) / f"{module}.so"
                sources = [user for name in MODULES[module][0] for user in users_of(name)]
                if not compile_files(SOURCES, sorted(set(sources)), library, [*CHECKED, "-shared"]):
                    raise SystemExit(f"{module} does not compile")
                for name in names:
                    before = resource.getrusage(resource.RUSAGE_CHILDREN)
                    if self.run(BUILD / "tests" / name, library, 300) != "passes":
                        raise SystemExit(f"{name} fails with unchanged functions of {module}")
                    after = resource.getrusage(resource.RUSAGE_CHILDREN)
                    seconds = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
                    self.seconds[name] = max(self.seconds.get(name, 0.0), seconds)

    def noticed(self, module, library):
        """killed, alive or busy. The test that fails is the first to be tried next time."""
        kind = "alive"
        for name in self.order[module]:
            outcome = self.run(BUILD / "tests" / name, library, self.limit(name))
            if outcome == "fails":
                with self.lock:  # a new list: others may be walking along the old one
                    self.order[module] = [name] + [other for other in self.order[module] if other != name]
                return "killed"
            if outcome == "busy":
                kind = "busy"
        return kind


def noticed_alone(mutant, tests, folder, library):
    """killed, invalid or None: by the test that needs only one of the header's users."""
    if mutant.file not in ALONE:
        return None
    user, name = ALONE[mutant.file]
    if not compile_files(folder, [user], library, [*CHECKED, "-shared"]):
        return "invalid"
    return "killed" if tests.run(BUILD / "tests" / name, library, tests.limit(name)) == "fails" else None


def noticed_anew(mutant, tests, place, library):
    """The same by tests that include the changed file."""
    for name in INCLUDED.get(mutant.file, ()):
        program = compile_test(place, name)
        outcome = tests.run(program, library, tests.limit(name)) if program else "fails"
        if outcome != "passes":
            return "killed" if outcome == "fails" else outcome
    return "alive"


def outcome(mutant, tests, originals):
    """invalid, same, alive, busy or killed."""
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        folder = lay_out(place, mutant.file, mutant.text)
        library = folder / "mutant.so"
        kind = noticed_alone(mutant, tests, folder, library)
        if kind is not None:
            return kind
        if not compile_files(folder, users_of(mutant.file), library, [*CHECKED, "-shared"]):
            return "invalid"
        kind = tests.noticed(mutant.module, library)
        if kind == "alive":
            kind = noticed_anew(mutant, tests, place, library)
    if kind == "alive" and object_code(mutant.file, mutant.text) == originals[mutant.file]:
        return "same"
    return kind


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
            mutant, kind = result
            if kind in ("alive", "busy"):
                print(f"{kind}: {mutant.file}:{mutant.line}\n  - {mutant.before}\n  + {mutant.after}")
            if len(results) % 100 == 0:
                print(f"{len(results)} of {len(mutants)}, {time.monotonic() - start:.0f} s", flush=True)
    return results


# --- telling --------------------------------------------------------------------------------------


def explain(found, register):
    """What to do about survivors that are not listed and entries that are no longer true."""
    if found["unlisted"]:
        print(f"\n{len(found['unlisted'])} survivors are not in {REGISTER.name}. For each, write a test that fails\n"
              "with it and add that to MODULES; or, where no input shows it, list it under a line\n"
              '"equivalent: why"; or, where none is to hold it, under "alive: why":')
        print(block(found["unlisted"]))
    if found["stale"]:
        print(f"\n{len(found['stale'])} entries of {REGISTER.name} are no longer true: there is no such line any\n"
              "more, or a test has come to notice. Take them out:")
        print(block(found["stale"]))
    wrong = [key for key in found["unlisted"] if key in register.count]
    if wrong:
        print(f"\nOf these, {len(set(wrong))} are listed, but not as often as they survive.")


def claims_of(found, complete):
    kinds, valid, equivalent = found["kinds"], found["valid"], found["equivalent"]
    score = 100.0 * kinds["killed"] / max(valid, 1)
    kind = "mutants" if complete else f"mutants of a sample (seed {SEED})"
    busy = f", {kinds['busy']} undecided" if kinds["busy"] else ""
    return [
        {"id": "mutation-score", "short": not complete, "exact": complete, "holds": valid > 0 and score >= 95.0,
         "claim": "At least 95 % of the mutants of avoidance, tracker, gain, limits, supervisor and drive protocols "
                  "that are not equivalent are killed by the unit tests",
         "figure": f"{score:.1f} %: {kinds['killed']:,} of {valid:,} {kind}{busy}; "
                   f"{kinds['same'] + equivalent:,} more are equivalent",
         "command": "tools/verify mutation"},
        {"id": "mutation-survivors", "short": not complete, "exact": complete,
         "holds": not found["unlisted"] and not found["stale"],
         "claim": "Every survivor is listed with a reason in `tests/mutation/survivors.txt`",
         "figure": f"{kinds['alive'] - equivalent} survivors and {equivalent} that are equivalent, "
                   f"{len(found['unlisted'])} unlisted, {len(found['stale'])} stale",
         "command": "tools/verify mutation"},
    ]


def digest():
    """Of all that decides what a mutant comes to: the firmware, the rules, and the tests."""
    found = hashlib.sha256(RULES.read_bytes())
    tests = [ROOT / "tests" / f"{name}.c" for _, names in MODULES.values() for name in names]
    for path in sorted({*SOURCES.glob("*.[ch]"), *tests}):
        found.update(path.read_bytes() if path.exists() else b"")
    return found.hexdigest()


def keep(results, before):
    found = [[*mutant.key(), mutant.line, kind] for mutant, kind in results]
    LAST.write_text(json.dumps({"digest": before, "found": found}) + "\n")


def kept(everything):
    """The results of the last run, for --judge."""
    last = json.loads(LAST.read_text())
    if last["digest"] != digest():
        raise SystemExit("sources or tests have changed since the last run")
    there = {(*mutant.key(), mutant.line): mutant for mutant in everything}
    return [(there[tuple(entry[:4])], entry[4]) for entry in last["found"]]


def arguments(argv):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--short", action="store_true")
    parser.add_argument("--minutes", type=float)
    parser.add_argument("--module", action="append", choices=sorted(MODULES))
    parser.add_argument("--again", action="store_true")
    parser.add_argument("--judge", action="store_true")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    return parser.parse_args(argv)


def chosen(options, mutants):
    mutants = list(mutants)
    random.Random(SEED).shuffle(mutants)
    if options.short:
        return mutants[:SHORT_SAMPLE]
    if options.again:
        last = {tuple(entry[:3]) for entry in json.loads(LAST.read_text())["found"] if entry[4] in ("alive", "busy")}
        return [mutant for mutant in mutants if mutant.key() in last]
    return mutants


def run(options, everything):
    """The results, kept for --again and --judge but for those of a sample."""
    modules = options.module or list(MODULES)
    before = digest()
    build("gcc-mutation", *sorted({name for _, names in MODULES.values() for name in names}))
    tests = Tests(modules)
    tests.measure()
    originals = {name: object_code(name, (SOURCES / name).read_text())
                 for module in modules for name in MODULES[module][0]}
    mutants = chosen(options, [mutant for mutant in everything if mutant.module in modules])
    end = time.monotonic() + (options.minutes * 60.0 if options.minutes else 1e9)
    results = try_all(mutants, tests, originals, options.jobs, end)
    if before != digest():
        raise SystemExit("sources or tests have changed during the run")
    if not options.short:
        keep(results, before)
    return results


def main(argv=None):
    options = arguments(argv)
    register = Register(REGISTER.read_text(), REGISTER.name)
    everything = all_mutants(MODULES)
    OUT.mkdir(parents=True, exist_ok=True)
    results = kept(everything) if options.judge else run(options, everything)
    found = judge(results, register, everything)
    explain(found, register)
    claims = claims_of(found, len(results) == len(everything))
    for claim in claims:
        print(f"{claim['id']}: {claim['figure']}")
    if options.out:
        options.out.write_text(json.dumps({"claims": claims, "notes": table(results, register)}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
