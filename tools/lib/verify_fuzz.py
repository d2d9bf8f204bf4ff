"""Part fuzz of tools/verify: libFuzzer on everything that takes bytes from outside.

usage: verify_fuzz.py --out FILE [--short | --minutes M]     runs the targets of tests/fuzz
       verify_fuzz.py --merge                                takes what was found into the tree's corpora
       verify_fuzz.py --reach                                what the tree's corpora reach, by llvm-cov

Builds preset clang-fuzz, gives every target its share of the time, two at once, and adds up
executions and hours. New inputs are kept in build/fuzz/corpus for the next run. An input that shows
something wrong is left in build/fuzz/crashes; the output says how to run it again.
"""

import argparse
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from cmake_build import build

ROOT = Path(__file__).resolve().parents[2]
BUILD = ROOT / "build" / "clang-fuzz"
PROGRAMS = BUILD / "tests" / "fuzz"
TESTS = ROOT / "tests" / "fuzz"
WORK = ROOT / "build" / "fuzz"
REACH = ROOT / "build" / "fuzz-reach"

JOBS = 2
SHORT_S = 2
DEFAULT_MINUTES = 120
COMMAND = "tools/verify --minutes 30 fuzz"
INPUT_MAX = {"gen_csv": 2048, "scenario": 2048, "replay": 4096}
# What the board's targets are there for, in the table of what is reached.
REACHED = ("board.c", "board_telemetry.c", "supervisor.c", "drive.c", "drive_odrive.c", "drive_vesc.c",
           "drive_cia402.c", "cia402_sdo.c", "cia402_state.c", "odometry.c", "controller.c", "avoid.c",
           "obstacles.c", "limits.c", "constrained.c", "message.c", "link.c", "outbox.c")


def run(command, **options):
    """A tool that has to succeed; what it says otherwise."""
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, errors="replace", **options)
    if done.returncode != 0:
        print(done.stdout[-4000:] + done.stderr[-4000:])
        raise SystemExit(f"{' '.join(map(str, command))}: status {done.returncode}")
    return done.stdout


def targets():
    return [line.removeprefix("fuzz_") for line in (PROGRAMS / "fuzzers.txt").read_text().split()]


def folders(target, short=False):
    """Where a target's inputs are: what was found, then the tree's. A short run has no time to begin
    with all that was ever found."""
    found = WORK / ("short" if short else "corpus") / target
    if short:
        shutil.rmtree(found, ignore_errors=True)
    found.mkdir(parents=True, exist_ok=True)
    return [str(found), *tree_folders(target)]


def tree_folders(target):
    tree = [TESTS / kind / target for kind in ("corpus", "regressions")]
    return [str(folder) for folder in tree if folder.is_dir()]


def options(target):
    words = [f"-max_len={INPUT_MAX.get(target, 512)}", "-timeout=25", "-rss_limit_mb=2048"]
    dictionary = TESTS / f"{target}.dict"
    return words + ([f"-dict={dictionary}"] if dictionary.exists() else [])


def number_after(text, word):
    found = re.findall(rf"{re.escape(word)}\s*(\d+)", text)
    return int(found[-1]) if found else 0


def fuzz(target, seconds, short):
    """One target for so long: a row of the table."""
    crashes = WORK / "crashes" / target
    crashes.mkdir(parents=True, exist_ok=True)
    command = [PROGRAMS / f"fuzz_{target}", f"-max_total_time={max(1, round(seconds))}",
               "-print_final_stats=1", f"-artifact_prefix={crashes}/", *options(target),
               *folders(target, short)]
    with open(WORK / f"{target}.log", "w+", errors="replace") as log:
        process = subprocess.Popen(command, cwd=WORK, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        log.seek(0)
        said = log.read()
    row = {
        "target": target,
        "seconds": usage.ru_utime + usage.ru_stime,
        "executions": number_after(said, "stat::number_of_executed_units:"),
        "edges": number_after(said, "cov:"),
        "crashed": process.returncode != 0,
    }
    print(f"{target:<14} {row['executions']:>10} executions in {row['seconds']:.0f} s of a core, {row['edges']} edges"
          f"{', CRASH' if row['crashed'] else ''}", flush=True)
    if row["crashed"]:
        explain(target, said)
    return row


def explain(target, text):
    """Why a target stopped, and how to see it again."""
    reasons = re.findall(r"^.*(?:does not hold|runtime error|ERROR:|SUMMARY:).*$", text, re.MULTILINE)
    print("\n".join(f"    {line}" for line in reasons[:6]) or text[-2000:])
    for path in re.findall(r"Test unit written to (\S+)", text):
        print(f"    again: {PROGRAMS.relative_to(ROOT)}/fuzz_{target} {path}")
        print(f"    keep it as tests/fuzz/regressions/{target}/NAME.bin, then mend what it shows")


def fuzz_all(seconds, short):
    """seconds: of the clock, for all targets together."""
    names = targets()
    share = seconds * JOBS / len(names)
    with ThreadPoolExecutor(JOBS) as pool:
        return list(pool.map(lambda name: fuzz(name, share, short), names))


def planted():
    """How many of the mistakes put in on purpose are shown: (shown, tried)."""
    environment = {**os.environ, "BERTH_SOURCE_DIR": str(ROOT), "BERTH_BUILD_DIR": str(BUILD)}
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", TESTS / "test_fuzz_oracles.py",
         "-k", "test_mistake_is_shown"],
        cwd=ROOT, env=environment, capture_output=True, text=True)
    passed = number_before(done.stdout, "passed")
    failed = number_before(done.stdout, "failed") + number_before(done.stdout, "error")
    if failed or not passed:
        print(done.stdout[-3000:])
    return passed, passed + failed


def number_before(text, word):
    found = re.findall(rf"(\d+) {word}", text)
    return int(found[-1]) if found else 0


def inputs(kind):
    return len(list((TESTS / kind).glob("*/*.bin")))


def claims(rows, short):
    executions = sum(row["executions"] for row in rows)
    hours = sum(row["seconds"] for row in rows) / 3600.0
    crashed = [row["target"] for row in rows if row["crashed"]]
    shown, tried = planted()
    ran = all(row["executions"] > 0 for row in rows)
    figure = f"{executions:,} executions of {len(rows)} targets in {hours:.2f} core hours, "
    figure += f"{len(crashed)} crashes" + (f" ({', '.join(crashed)})" if crashed else "")
    return [
        {
            "id": "fuzz-crashes",
            "claim": "No input from outside crashes anything or breaks a promise: whole boards with each drive "
                     "protocol, drives, controller, constrained tracker, frames, link, virtual bus, SLCAN, the "
                     "prompt, CSV, scenarios, candump logs, records; sanitizers on",
            "figure": figure,
            "command": COMMAND,
            "holds": not crashed and ran,
            **({"short": True} if short else {}),
        },
        {
            "id": "fuzz-inputs",
            "claim": "What fuzzing reached, and each input that showed a mistake, found or put in on purpose, is run "
                     "again by every host build's tests",
            "figure": f"{inputs('corpus')} inputs, {inputs('regressions')} of mistakes",
            "command": "tools/verify --short fuzz",
            "holds": inputs("corpus") > 0,
            "exact": True,
        },
        {
            "id": "fuzz-oracles",
            "claim": "The targets see mistakes: those put into the firmware on purpose are shown by the inputs",
            "figure": f"{shown} of {tried}",
            "command": "tools/verify --short fuzz",
            "holds": shown == tried and tried > 0,
            "exact": True,
        },
    ]


def table(rows):
    lines = ["| target | executions | core seconds | edges |", "|---|---|---|---|"]
    for row in rows:
        lines.append(f"| {row['target']} | {row['executions']:,} | {row['seconds']:.0f} | {row['edges']} |")
    return lines


# --- the tree's corpora ---------------------------------------------------------------------------


def merge(target):
    """The fewest inputs that reach all edges that any input reaches."""
    new = WORK / "merge" / target
    shutil.rmtree(new, ignore_errors=True)
    new.mkdir(parents=True)
    run([PROGRAMS / f"fuzz_{target}", "-set_cover_merge=1", "-use_counters=0", *options(target), new,
         *folders(target)], stdin=subprocess.DEVNULL)
    tree = TESTS / "corpus" / target
    shutil.rmtree(tree, ignore_errors=True)
    tree.mkdir(parents=True)
    for path in new.iterdir():
        data = path.read_bytes()
        (tree / f"{hashlib.sha256(data).hexdigest()[:12]}.bin").write_bytes(data)
    files = list(tree.iterdir())
    print(f"{target:<14} {len(files)} inputs, {sum(path.stat().st_size for path in files)} bytes", flush=True)


# --- what they reach ------------------------------------------------------------------------------


def build_for_reach():
    flags = "-O1 -g -fprofile-instr-generate -fcoverage-mapping"
    run(["cmake", "-S", ".", "-B", REACH, "-G", "Ninja", "-DCMAKE_C_COMPILER=clang-19", "-DCMAKE_BUILD_TYPE=Reach",
         f"-DCMAKE_C_FLAGS_REACH={flags}"])
    programs = [f"replay_{target}" for target in targets()]
    run(["cmake", "--build", REACH, "--parallel", str(os.cpu_count()), "--target", *programs])


def reached(target):
    """{source: (lines, branches)} in percent, of what a target's inputs reach in the firmware."""
    program = REACH / "tests" / "fuzz" / f"replay_{target}"
    raw = REACH / f"{target}.profraw"
    data = REACH / f"{target}.profdata"
    run([program, *tree_folders(target)], env={**os.environ, "LLVM_PROFILE_FILE": str(raw)})
    run(["llvm-profdata-19", "merge", "-sparse", raw, "-o", data])
    summary = json.loads(run(["llvm-cov-19", "export", "-summary-only", f"-instr-profile={data}", program]))
    figures = {}
    for file in summary["data"][0]["files"]:
        path = Path(file["filename"])
        if path.is_relative_to(ROOT / "firmware" / "src"):
            figures[path.name] = (file["summary"]["lines"]["percent"], file["summary"]["branches"]["percent"])
    return figures


def reach_table():
    """What the inputs of the board's targets reach, in lines / branches."""
    build_for_reach()
    chosen = [name for name in targets() if name.startswith("board_")] + ["controller", "link"]
    figures = {name: reached(name) for name in chosen}
    lines = ["Reached by the tree's inputs, lines / branches in percent:", "",
             "| source | " + " | ".join(chosen) + " |", "|---" * (len(chosen) + 1) + "|"]
    for source in REACHED:
        cells = [figures[name].get(source) for name in chosen]
        texts = ["-" if cell is None or cell[0] == 0 else f"{cell[0]:.0f} / {cell[1]:.0f}" for cell in cells]
        lines.append(f"| {source} | " + " | ".join(texts) + " |")
    return lines


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--short", action="store_true")
    parser.add_argument("--minutes", type=float, default=DEFAULT_MINUTES)
    parser.add_argument("--merge", action="store_true")
    parser.add_argument("--reach", action="store_true")
    chosen = parser.parse_args()
    if not (chosen.out or chosen.merge or chosen.reach):
        parser.error("--out FILE, --merge or --reach")
    return chosen


def main():
    chosen = arguments()
    build("clang-fuzz")
    WORK.mkdir(parents=True, exist_ok=True)
    if chosen.merge:
        for target in targets():
            merge(target)
    if chosen.reach:
        print("\n".join(reach_table()))
    if chosen.out:
        seconds = SHORT_S * len(targets()) / JOBS if chosen.short else 60.0 * chosen.minutes
        rows = fuzz_all(seconds, chosen.short)
        notes = [] if chosen.short else [*table(rows), "", *reach_table()]
        chosen.out.write_text(json.dumps({"claims": claims(rows, chosen.short), "notes": notes}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
