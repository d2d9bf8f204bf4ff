"""Proves that no public function of firmware/ has a run-time error, with Frama-C's Eva.

    tools/verify proofs                          all proofs, some minutes on two cores
    tools/lib/verify_proofs.py --out FILE [--only NAME] [--keep FOLDER]

A proof is a program in tests/proof that calls public functions with all values that their headers
allow, and more. The analyser goes through all that it can do and finds each index out of bounds,
read of what is not initialised, division by zero, overflow of a signed integer or of a conversion,
and comparison of unrelated pointers that it cannot rule out. Everything open counts as an alarm.
Loops are annotated with their bounds (proof_loops.py), which are proved on the way.
"""

import argparse
import csv
import json
import os
import re
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import proof_bounds
import proof_loops

ROOT = Path(__file__).resolve().parents[2]
PROOFS = ROOT / "tests/proof"
INCLUDES = (ROOT / "firmware/include", ROOT / "hal/include", PROOFS)
COMMAND = "tools/verify proofs"

# The analyser keeps the ways through these functions apart, so that what was tested is not forgotten.
APART = """main berth_controller_init init_tracker berth_constrained_init berth_board_init init_parts
    init_drives check_regions berth_drive_init berth_odometry_init berth_supervisor_init
    berth_controller_step check_step berth_controller_add_obstacle berth_controller_put_obstacle
    check_obstacle planned_side lookahead_exit find control drive_clamp drive_to_int timely
    berth_board_step berth_board_receive berth_board_command berth_board_bus berth_board_sent
    control_0 add_filters berth_drive_filters filters
    take_fix take_obstacle take_command berth_message_decode_pose berth_message_decode_obstacle
    berth_message_decode_command""".split()
# control_0 is the controller's, after the board's. And what these leave behind when they return zero
# (or false) is kept apart from what they leave otherwise.
BY_RESULT = """berth_controller_init init_tracker berth_constrained_init berth_board_init init_parts
    init_drives check_regions berth_drive_init berth_odometry_init berth_supervisor_init check_step
    check_obstacle lookahead_exit timely berth_message_decode_pose berth_message_decode_obstacle
    berth_message_decode_command""".split()
EVA = ["-eva", "-eva-precision", "0", "-eva-ilevel", "48", "-eva-plevel", "60", "-eva-min-loop-unroll", "1",
       "-eva-slevel-function", ",".join(f"{name}:20" for name in APART),
       "-eva-split-return-function",
       ",".join([*(f"{name}:0" for name in BY_RESULT), "berth_drive_filters:4:5", "filters:4:5"]),
       "-inline-calls", "look", "-metrics", "-metrics-eva-cover",
       "-eva-msg-key=-initial-state,-final-states"]
# Ranges of finite floats: tests of one value tell of others that are equal to it.
FINITE = ("-eva-slevel", "60", "-eva-domains", "symbolic-locations,equality",
          "-eva-equality-through-calls", "formals", f"-cpp-extra-args=-include{PROOFS / 'fabs.h'}")
CLOSED = {"Valid", "Dead", "Considered valid"}
DRIVES = ("odrive", "vesc", "cia402")


@dataclass
class Proof:
    """One run of the analyser."""

    name: str
    program: str
    defines: tuple = ()
    machine: tuple = ("-machdep", "gcc_x86_32", "-cpp-extra-args=-msse2,-mfpmath=sse")
    floats: str = "none"  # special values that are alarms
    more: tuple = ()      # further options


def board(left, right, *more):
    sides = (f"LEFT=berth_drive_{left}", f"RIGHT=berth_drive_{right}")
    return Proof(" ".join(("board", left, right)), "board.c", (*sides, *more))


LONGEST = "board cia402 cia402"  # left out of the short form
PROOFS_RUN = (
    Proof("controller", "controller.c"),
    board("cia402", "cia402", "BERTH_OBSTACLES_MAX=2"),
    board("odrive", "vesc", "BERTH_OBSTACLES_MAX=2", "LINK"),
    Proof("avoidance", "avoidance.c"),
    *(Proof(f"drive {name}", "drive.c", (f"PROTOCOL=berth_drive_{name}",)) for name in DRIVES),
    Proof("parts", "parts.c"),
    Proof("plans", "plans.c"),
    Proof("values", "values.c"),
    Proof("refusals", "refusals.c"),
    Proof("constrained", "constrained.c"),
    Proof("finite", "finite.c", floats="non-finite", more=FINITE),
)

# Errors planted in the sources: file, text, what takes its place, the proof that must not hold then.
PLANTED = (
    ("outbox.c", "index < BERTH_OUTBOX_MAX ? index", "index <= BERTH_OUTBOX_MAX ? index", "parts"),
    ("odometry.c", "now_us > odometry->fix_us ? now_us - odometry->fix_us : 0", "now_us - odometry->fix_us",
     "parts"),
    ("plan_inline.h", "k % plan->count", "k % (plan->count - 1u)", "plans"),
    ("avoid.c", "index < plan->count ? plan", "index <= plan->count ? plan", "avoidance"),
    ("message.c", "if (shift < 63u)", "if (shift < 65u)", "values"),
    ("drive.c", "value == value ? value : 0.0f", "value", "drive vesc"),
    ("cia402.h", "config->period_us + BERTH_CIA402_SYNC_US - 1u", "config->period_us", "drive cia402"),
)


@dataclass
class Outcome:
    proof: Proof
    alarms: int = 0
    open: list = field(default_factory=list)      # what is not proved, as text
    reached: dict = field(default_factory=dict)   # function -> (statements reached, of)
    contracts: set = field(default_factory=set)   # functions whose stated preconditions were proved
    bounds: set = field(default_factory=set)      # (file, line) of the loops' bounds proved


def command(proof, sources, report):
    includes = ",".join(f"-I{path}" for path in INCLUDES)
    return ["frama-c", "-c11", *proof.machine, f"-cpp-extra-args=-w,{includes}",
            *(f"-cpp-extra-args=-D{define}" for define in proof.defines),
            "-kernel-warn-key", "parser:conditional-feature=inactive", "-warn-special-float", proof.floats,
            *EVA, *proof.more, "-report-csv", str(report), str(PROOFS / proof.program),
            *(str(path) for path in sorted(sources.glob("*.c")))]


def read_report(outcome, report):
    for row in csv.DictReader(report.read_text().splitlines(), delimiter="\t", quoting=csv.QUOTE_NONE):
        status, kind, text = row["status"], row["property kind"], row["property"]
        if status not in CLOSED:
            outcome.open.append(f"{row['file']}:{row['line']} {row['function']}: {kind}: {text}")
        elif status == "Valid" and kind == "user assertion":
            outcome.bounds.add((row["file"], int(row["line"])))
        elif status == "Valid" and kind.startswith("precondition of berth_"):
            outcome.contracts.add(kind.removeprefix("precondition of "))


def read_log(outcome, log):
    found = re.search(r"^  (\d+) alarms? generated by the analysis", log, re.M)
    if found is None:
        outcome.open.append("the analysis did not come to its end: " + log[-1500:])
        outcome.alarms = 1
        return
    outcome.alarms = int(found[1])
    for name, reached, of in re.findall(r"^  (\w+): (\d+) stmts out of (\d+) ", log, re.M):
        outcome.reached[name] = int(reached), int(of)
    rows = proof_loops.unrolled()
    for file, line in re.findall(r"\[eva:loop-unroll:partial\] \S*?([\w.]+):(\d+):", log):
        if (file, int(line)) in rows:
            outcome.open.append(f"{file}:{line}: the loop goes on beyond its bound")
    errors = re.search(r"by the Eva analyzer: +(\d+) errors?", log)
    if errors and int(errors[1]) > 0:
        outcome.open.append(f"{errors[1]} errors of the analyser")


def own_functions():
    """Those of the proofs' programs."""
    names = set()
    for path in PROOFS.glob("*.[ch]"):
        names |= set(re.findall(r"^(?!\s)[\w *]+?(\w+)\([^;]*\) \{$", path.read_text(), re.M))
    return names


def demand_program_reached(outcome):
    """A call in a proof's program that the analyser does not come to proves nothing."""
    for name in own_functions() & outcome.reached.keys():
        some, of = outcome.reached[name]
        if some < of:
            outcome.open.append(f"{outcome.proof.program}: {of - some} statements of {name} are not reached")


def run(proof, sources, keep=None):
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.csv"
        done = subprocess.run(command(proof, sources, report), capture_output=True, text=True, cwd=PROOFS)
        outcome = Outcome(proof)
        read_log(outcome, done.stdout + done.stderr)
        demand_program_reached(outcome)
        if report.exists():
            read_report(outcome, report)
        if keep:
            (keep / f"{proof.name.replace(' ', '_')}.log").write_text(done.stdout + done.stderr)
    print(f"{proof.name}: {outcome.alarms} alarms, {len(outcome.open)} open", flush=True)
    for line in outcome.open[:20]:
        print(f"    {line}", flush=True)
    return outcome


def run_planted(planted, sources, folder):
    """True when the proof finds the planted error."""
    file, text, instead, name = planted
    place = Path(folder) / f"{file}.{name.replace(' ', '_')}.{abs(hash(text))}"
    place.mkdir()
    for path in sources.iterdir():
        (place / path.name).write_text(path.read_text())
    source = (place / file).read_text()
    if text not in source:
        raise SystemExit(f"verify_proofs: {file} has no longer: {text}")
    (place / file).write_text(source.replace(text, instead))
    proof = next(proof for proof in PROOFS_RUN if proof.name == name)
    outcome = run(proof, place)
    return outcome.alarms > 0 or bool(outcome.open)


def public_functions():
    """Declared in the public headers."""
    names = set()
    for header in sorted((ROOT / "firmware/include/berth").glob("*.h")):
        text = re.sub(r"/\*.*?\*/", "", header.read_text(), flags=re.S)
        text = re.sub(r"^#.*(?:\\\n.*)*", "", text, flags=re.M)
        names |= set(re.findall(r"^[\w *]*?\b(berth_\w+)\(", text, re.M))
    return names


def reached_statements(outcomes):
    """(reached, of) over the firmware's functions, each as the proof that sees most of it sees it."""
    own = own_functions()
    best = {}
    for outcome in outcomes:
        for name, (reached, of) in outcome.reached.items():
            if name not in own:
                best[name] = max(best.get(name, (0, of)), (reached, of))
    return best


def claim(name, text, figure, holds):
    return {"id": name, "claim": text, "figure": figure, "command": COMMAND, "holds": bool(holds), "exact": True}


def alarm_claims(outcomes):
    public = public_functions()
    best = reached_statements(outcomes)
    missing = sorted(public - best.keys())
    alarms = sum(max(outcome.alarms, len(outcome.open)) for outcome in outcomes)
    for name, (some, of) in sorted(best.items()):
        if some < of:
            print(f"{name}: {of - some} of {of} statements are not reached")
    reached = sum(pair[0] for pair in best.values())
    total = sum(pair[1] for pair in best.values())
    print(f"{reached} of {total} statements reached; public functions without a proof: {missing or 'none'}")
    return [
        claim("proof-alarms",
              "No run-time error in any public function: index, pointer, uninitialised read, division, shift, "
              "signed overflow, float to integer",
              f"{alarms} alarms; {len(public) - len(missing)} of {len(public)} public functions",
              alarms == 0 and not missing),
        claim("proof-reached", "Statements of the analysed functions that the proofs reach, as one proof sees each",
              f"at least {100 * reached // total} %", reached >= 0.98 * total),
    ]


def bound_claims(outcomes):
    unproved = proof_loops.asserted() - set().union(*(outcome.bounds for outcome in outcomes))
    for file, line in sorted(unproved):
        print(f"{file}:{line}: no proof comes to this loop's bound")
    contracts = set().union(*(outcome.contracts for outcome in outcomes))
    stated = proof_loops.contracts()
    for name in sorted(stated - contracts):
        print(f"{name}: its precondition is not proved anywhere")
    return [
        claim("proof-contracts", "Functions with a stated precondition that all callers above are proved to keep",
              f"{len(contracts & stated)} of {len(stated)}", contracts >= stated),
        claim("proof-bounds",
              "Each loop has a stated bound, proved; each function's stack is known, without recursion, with "
              "calls through pointers resolved: tools/evidence/bounds.md",
              f"{len(proof_loops.all_loops())} loops", not unproved and proof_bounds.current()),
    ]


def claims_of(outcomes, found):
    return [
        *alarm_claims(outcomes),
        *bound_claims(outcomes),
        claim("proof-self-test", "Errors planted in the sources that the proofs find",
              f"{sum(found)} of {len(PLANTED)}", all(found)),
    ]


NOTES = (
    "Any float bits (NaN and infinities included), any frame, any time, plans of 1 to 1,000,000 samples of any bits "
    "and configurations of any bits but for the ranges that count for integers: plan count, period, horizon and "
    "discretization, and the drives' period. That the checks refuse what lies outside these is proved too "
    "(tests/proof/refusals.c).",
    "Assumed: pointers that a header demands are valid, a struct is set up by its init before other calls, bools "
    "hold 0 or 1, and a platform's three CAN functions do no more than answer. Machine: 32 bits, two's complement, "
    "IEEE 754 floats that round to nearest. The preconditions in the headers (`requires`) are what callers below "
    "the controller and the board have to keep.",
    "The boards' proofs (two cia402, which the short form leaves out; odrive and vesc with the loop of link.h) "
    "have 2 slots for obstacles, the controller's and avoidance's own 16; the board's tracker is the gain, the "
    "controller's both.",
    "NaN and infinity: with finite input in the ranges that validation demands, they are "
    "alarms too in wrap, sine and cosine up to 3 pi, arcsine, error, law, limits while avoiding and wheels "
    "(tests/proof/finite.c). Not shown by this analysis, which knows ranges but no relations: the scaling while "
    "tracking, arctangent, avoidance, Riccati recursion and the constrained tracker.",
)


def arguments():
    parser = argparse.ArgumentParser(prog="tools/lib/verify_proofs.py")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--short", action="store_true", help=f"without {LONGEST}; bounds.md is compared, not written")
    parser.add_argument("--minutes", type=float, help="not looked at: the proofs take what they take")
    parser.add_argument("--only", help="proofs whose names contain this")
    parser.add_argument("--keep", type=Path, help="where to leave the analyser's logs")
    return parser.parse_args()


def analyse(options):
    """Runs the proofs, and those with planted errors unless only some are wanted."""
    proofs = [proof for proof in PROOFS_RUN if (options.only or "") in proof.name]
    if options.short:
        proofs = [proof for proof in proofs if proof.name != LONGEST]
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(2 * os.cpu_count()) as pool:
        sources = Path(folder) / "src"
        proof_loops.annotate(sources)
        runs = [pool.submit(run, proof, sources, options.keep) for proof in proofs]
        planted = [] if options.only else [pool.submit(run_planted, row, sources, folder) for row in PLANTED]
        return [task.result() for task in runs], [task.result() for task in planted]


def main():
    options = arguments()
    if options.out and not options.short:
        proof_bounds.write()
    if options.keep:
        options.keep.mkdir(parents=True, exist_ok=True)
    outcomes, found = analyse(options)
    if options.out:
        result = {"claims": claims_of(outcomes, found), "notes": [f"- {note}" for note in NOTES]}
        options.out.write_text(json.dumps(result, indent=1))
        return 0
    return 1 if any(outcome.alarms or outcome.open for outcome in outcomes) else 0


if __name__ == "__main__":
    sys.exit(main())
