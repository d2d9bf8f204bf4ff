"""Instructions of the constrained tracker on a Cortex-M4F, over laps with kicks, and OSQP's beside.

constrained_cost.py [--check]: builds tools/bench for the emulated mps2-an386, runs it and prints
for horizons 10, 20 and 40 what a step takes, how far from optimal it is, and the tracking error
against the gain with its command clipped; then the same problems solved by OSQP's generated code,
which is made and built in build/bench. With --check only Berth's part is run, and compared with
tools/budgets/constrained.json; the exit status is 1 when a budget is exceeded.
"""

import json
import math
import subprocess
import sys
from pathlib import Path

import emulate

ROOT = Path(__file__).resolve().parents[2]
BENCH = ROOT / "tools/bench"
BUILD = ROOT / "build/bench"
BUDGET = ROOT / "tools/budgets/constrained.json"
HORIZONS = (10, 20, 40)
KINDS = ("calm", "kicked", "saturating")
FLAGS = ("-mcpu=cortex-m4 -mthumb -mfpu=fpv4-sp-d16 -mfloat-abi=hard -std=c11 -O2 "
         "-ffp-contract=off -fno-math-errno -ffunction-sections -fdata-sections "
         "-Wall -Wextra -Werror").split()
BOARDS = ROOT / "firmware/boards"
BOARD_SOURCES = [*(BOARDS / "common").glob("*.c"), BOARDS / "cortex_m/start.c",
                 BOARDS / "mps2/mps2_board.c", *(ROOT / "hal/mps2").glob("*.c")]
BOARD_FOLDERS = [BOARDS, BOARDS / "common", BOARDS / "cortex_m", BOARDS / "mps2", ROOT / "hal/mps2",
                 ROOT / "hal/slcan"]
LINK = ["-nostartfiles", "-Wl,--gc-sections", "-Wl,--no-warn-rwx-segments", f"-L{BOARDS / 'common'}",
        f"-T{BOARDS / 'mps2/low.ld'}"]
OSQP_FLAGS = ["-w", "-DOSQP_EMBEDDED_MODE=2"]


def run(*command, **options):
    try:
        done = subprocess.run([str(part) for part in command], capture_output=True, text=True,
                              check=False, **options)
    except FileNotFoundError:
        sys.exit(f"constrained_cost: {command[0]} is missing; run tools/setup test first")
    if done.returncode != 0:
        sys.exit(f"constrained_cost: {' '.join(map(str, command))}\n{done.stdout}{done.stderr}")
    return done.stdout


def build(name, sources, extra=()):
    """The image of a program in tools/bench, with what it shares and the firmware."""
    image = BUILD / f"{name}.elf"
    common = [BENCH / "laps.c", BENCH / "mps2_count.c", *BOARD_SOURCES,
              *sorted((ROOT / "firmware/src").glob("*.c"))]
    folders = [ROOT / "firmware/include", ROOT / "hal/include", BENCH, *BOARD_FOLDERS]
    run("arm-none-eabi-gcc", *FLAGS, *extra, *(f"-I{folder}" for folder in folders), *sources,
        *common, *LINK, "-lm", "-o", image)
    return image


def run_image(image):
    status, output = emulate.run("mps2-an386", image, timeout=900, icount=10)
    if status != 0:
        sys.exit(f"constrained_cost: {image}\n{output[-2000:]}")
    return output


def collect(text):
    """{(kind, horizon): (steps, cases)}: rows of numbers, of all shapes and seeds together."""
    found = {}
    steps = []
    for line in text.splitlines():
        fields = line.split()
        if fields[0] == "step":
            steps.append([int(field) for field in fields[1:]])
        elif fields[0] == "case":
            kept = found.setdefault((fields[1], int(fields[3])), ([], []))
            kept[0].extend(steps)
            kept[1].append([float(field) for field in fields[5:]])
            steps = []
        else:
            sys.exit(f"constrained_cost: {line}")
    return found


def share(values, part):
    """The value below which a part of all lies."""
    ranked = sorted(values)
    return ranked[min(len(ranked) - 1, math.ceil(part * len(ranked)) - 1)]


def spread(values):
    return f"{share(values, 0.5):9,d} {share(values, 0.99):9,d} {max(values):9,d}"


def show_berth(found):
    print("Berth's constrained tracker, instructions of a step (Cortex-M4F, both shapes):\n")
    print(f"  {'laps':<11}{'N':>3}{'steps':>7}{'limited':>8}{'stopped':>8}  {'median':>9} {'99 %':>9}"
          f" {'worst':>9}{'no limit':>10}  passes  {'residual':>9}  RMS error, clipped")
    for (kind, n), (steps, cases) in found.items():
        passes = [step[1] for step in steps]
        free = max((step[0] for step in steps if not step[2]), default=0)
        rms, clipped = (sum(case[i] for case in cases) / len(cases) for i in (0, 1))
        print(f"  {kind:<11}{n:3}{len(steps):7}{sum(step[2] for step in steps):8}"
              f"{sum(step[3] for step in steps):8}  {spread([step[0] for step in steps])}{free:10,d}"
              f"   {share(passes, 0.5)} {share(passes, 0.99)} {max(passes)}  "
              f"{max(case[2] for case in cases):9.1e}  {rms:.4f} m, {clipped:.4f} m")


def show_osqp(found, berth):
    print("\nOSQP's generated code, float32, tolerance 1e-4, warm started, on the same problems:\n")
    print(f"  {'laps':<11}{'N':>3}  {'median':>9} {'99 %':>9} {'worst':>9}  {'median ratio':>12}"
          f"  {'iterations':>10}  {'residual':>9}  first command, from Berth's")
    for (kind, n), (steps, cases) in found.items():
        ours = share([step[0] for step in berth[kind, n][0]], 0.5)
        counts = [step[0] for step in steps]
        print(f"  {kind:<11}{n:3}  {spread(counts)}  {share(counts, 0.5) / ours:12.0f}"
              f"  {max(step[1] for step in steps):10}  {max(case[0] for case in cases):9.1e}"
              f"  {max(case[1] for case in cases):.1e} m/s")


def osqp_part(horizon):
    folder = BUILD / f"osqp_{horizon}"
    run(sys.executable, ROOT / "tools/lib/osqp_problem.py", horizon, folder)
    solver = [*sorted((folder / "src").glob("*.c")), folder / "workspace.c"]
    extra = [*OSQP_FLAGS, "-I", folder, "-I", folder / "inc/public", "-I", folder / "inc/private"]
    image = build(f"osqp_{horizon}", [BENCH / "osqp_laps.c", *solver], extra)
    return collect(run_image(image))


def over_budget(found):
    budget = json.loads(BUDGET.read_text(encoding="utf-8"))
    over = []
    for kind, limits in budget["instructions_max"].items():
        steps = found[kind, budget["horizon"]][0]
        counts = [step[0] for step in steps]
        measured = {"median": share(counts, 0.5), "worst": max(counts),
                    "no_limit": max((step[0] for step in steps if not step[2]), default=0)}
        over += [f"{kind}, {name}: {measured[name]} instead of {limit}"
                 for name, limit in limits.items() if measured[name] > limit]
    for (kind, n), (steps, cases) in found.items():
        if sum(step[3] for step in steps) > budget["stopped_max"]:
            over.append(f"{kind}, N = {n}: steps stopped before the optimum")
        if max(case[2] for case in cases) > budget["residual_max"]:
            over.append(f"{kind}, N = {n}: residual")
        if kind == "saturating" and sum(case[0] - case[1] for case in cases) >= 0.0:
            over.append(f"{kind}, N = {n}: no better than clipping")
    return over


def main():
    check = sys.argv[1:] == ["--check"]
    BUILD.mkdir(parents=True, exist_ok=True)
    berth = collect(run_image(build("constrained", [BENCH / "constrained_laps.c"])))
    show_berth(berth)
    over = over_budget(berth)
    for line in over:
        print(f"OVER the budget of {BUDGET.relative_to(ROOT)}: {line}")
    if not over:
        print(f"\nwithin the budgets of {BUDGET.relative_to(ROOT)}")
    if not check:
        found = {}
        for horizon in HORIZONS:
            found.update(osqp_part(horizon))
        show_osqp(found, berth)
    return 1 if check and over else 0


if __name__ == "__main__":
    sys.exit(main())
