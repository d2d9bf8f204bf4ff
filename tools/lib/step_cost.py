"""Instructions of one closed-loop step by function, counted by callgrind.

step_cost.py [--check]: prints the table; with --check also compares the total with the budget in
tools/budgets/host.json and the figures in README.md, and exits with status 1 when the budget is
exceeded or the page is off by more than 5 %. BERTH_SIM names the program;
without it the gcc-release preset's is taken.
"""

import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BUDGET = ROOT / "tools/budgets/host.json"
SHOWN = 14  # functions in the table
# Functions by what they are part of, from the first folder in their source file's path.
PARTS = {"firmware": "firmware", "host_sim": "simulator"}


def simulator():
    default = ROOT / "build/gcc-release/host_sim/berth-sim"
    path = Path(os.environ.get("BERTH_SIM", default))
    if not path.is_file():
        sys.exit(f"step_cost: {path} is missing; build the gcc-release preset first")
    return path


def count(program, runs, seed):
    """Returns (steps, {(function, part): instructions})."""
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "callgrind.out"
        command = ["valgrind", "--tool=callgrind", f"--callgrind-out-file={output}",
                   str(program), "campaign", "--runs", str(runs), "--seed", str(seed),
                   "--jobs", "1", "--json"]
        run = subprocess.run(command, capture_output=True, text=True, check=False)
        if run.returncode != 0:
            sys.exit(f"step_cost: {' '.join(command)}\n{run.stderr}")
        listing = subprocess.run(["callgrind_annotate", "--threshold=100", str(output)],
                                 capture_output=True, text=True, check=True).stdout
    return json.loads(run.stdout)["steps"], parse(listing)


def parse(listing):
    """Lines such as '12,345 ( 1.2%)  /path/file.c:function [object]'."""
    functions = {}
    line_form = re.compile(r"^\s*([\d,]+) \(\s*[\d.]+%\)\s+(\S*?):(\S+)")
    for line in listing.splitlines():
        match = line_form.match(line)
        if not match or "PROGRAM TOTALS" in line:
            continue
        instructions = int(match.group(1).replace(",", ""))
        path, function = match.group(2), match.group(3).split("'")[0]
        part = next((name for folder, name in PARTS.items() if f"{folder}/" in path), "C library")
        key = (function, part)
        functions[key] = functions.get(key, 0) + instructions
    return functions


def page_figures():
    """(all, firmware) as README.md has them."""
    line = re.search(r"^\| x86-64 instructions[^|]*\| ([\d,]+); ([\d,]+) \|",
                     (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
    if line is None:
        sys.exit("step_cost: README.md has no line on instructions of a step")
    return [int(figure.replace(",", "")) for figure in line.groups()]


def show(steps, functions):
    total = sum(functions.values())
    print(f"Instructions a closed-loop step (x86-64, callgrind, {steps} steps):\n")
    print(f"  {'all':<34}{'':<12}{total / steps:9.1f}  100.0 %")
    by_part = {}
    for (_, part), instructions in functions.items():
        by_part[part] = by_part.get(part, 0) + instructions
    for part, instructions in sorted(by_part.items(), key=lambda item: -item[1]):
        print(f"  {part:<46}{instructions / steps:9.1f}  {100 * instructions / total:5.1f} %")
    print()
    ranked = sorted(functions.items(), key=lambda item: -item[1])
    for (function, part), instructions in ranked[:SHOWN]:
        share = 100 * instructions / total
        print(f"  {function:<34}{part:<12}{instructions / steps:9.1f}  {share:5.1f} %")
    return total / steps, by_part.get("firmware", 0) / steps


def main():
    check = sys.argv[1:] == ["--check"]
    budget = json.loads(BUDGET.read_text())
    per_step, firmware = show(*count(simulator(), budget["runs"], budget["seed"]))
    limit = budget["instructions_per_step_max"]
    verdict = "within" if per_step <= limit else "OVER"
    print(f"\n{per_step:.1f} instructions a step: {verdict} the budget of {limit} "
          f"({BUDGET.relative_to(ROOT)})")
    page = page_figures()
    stale = any(abs(figure / measured - 1.0) > 0.05
                for figure, measured in zip(page, (per_step, firmware)))
    if stale:
        print(f"README.md has {page[0]} and {page[1]}: more than 5 % off")
    return 1 if check and (per_step > limit or stale) else 0


if __name__ == "__main__":
    sys.exit(main())
