"""What the bus costs: instructions of the board's work by kind, and how full the bus is.

bus_cost.py [--check]: runs the circle at 100 Hz on the virtual bus with each drive protocol and
prints, for each, x86-64 instructions (counted by callgrind, host build) of one received frame, of
one control step with all that it sends, and of a call between control steps (timers, watchdogs);
frames a second; and the load of a 1 Mbit/s bus, stuff bits included. With --check also compares them with
tools/budgets/bus.json and with the table in README.md, and exits with status 1 when a budget is
exceeded or the page is off by more than 5 %. BERTH_SIM names the program; without it the
gcc-release preset's is taken.
"""

import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BUDGET = ROOT / "tools/budgets/bus.json"
DRIVES = ["odrive", "vesc", "cia402"]
SECONDS = 10
RATE_HZ = 100
RUN = ["run", "circle", "--bus", "loop", "--json", "--set", f"period_s={1 / RATE_HZ:g}",
       "--set", f"duration_s={SECONDS}"]
FIGURES = ["frame", "step", "run", "frames_per_s", "load_percent"]
UNITS = {"frame": "instructions a received frame", "step": "instructions a control step",
         "run": "instructions a call between control steps",
         "frames_per_s": "frames a second on the bus", "load_percent": "bus load, %"}


def simulator():
    path = Path(os.environ.get("BERTH_SIM", ROOT / "build/gcc-release/host_sim/berth-sim"))
    if not path.is_file():
        sys.exit(f"bus_cost: {path} is missing; build the gcc-release preset first")
    return path


def profile(program, drive, folder):
    """(summary, {function: (inclusive instructions, calls)})."""
    output = Path(folder) / f"{drive}.out"
    command = ["valgrind", "--tool=callgrind", f"--callgrind-out-file={output}", str(program), *RUN,
               "--drive", drive]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    if run.returncode != 0:
        sys.exit(f"bus_cost: {' '.join(command)}\n{run.stderr}")
    listing = subprocess.run(["callgrind_annotate", "--inclusive=yes", "--threshold=100",
                              "--tree=none", str(output)], capture_output=True, text=True,
                             check=True).stdout
    return json.loads(run.stdout), inclusive(listing), calls(output.read_text())


def inclusive(listing):
    """Inclusive instructions by function."""
    form = re.compile(r"^\s*([\d,]+) \(\s*[\d.]+%\)\s+\S*?:(\w+)", re.MULTILINE)
    found = {}
    for count, function in form.findall(listing):
        found.setdefault(function, int(count.replace(",", "")))
    return found


def calls(text):
    """How often each function was called, from callgrind's own file with its compressed names."""
    names = dict(re.findall(r"^c?fn=\((\d+)\) (\S+)", text, re.MULTILINE))
    found = {}
    for number, count in re.findall(r"^cfn=\((\d+)\)[^\n]*\ncalls=(\d+)", text, re.MULTILINE):
        found[names[number]] = found.get(names[number], 0) + int(count)
    return found


def measure(program, drive, folder):
    summary, cost, called = profile(program, drive, folder)
    bus = summary["bus"]
    steps = bus["board"]["steps"]
    received = called["berth_board_receive"]
    frame = cost["berth_board_receive"] / received
    step = cost["tick"] / steps
    idle = (cost["berth_board_step"] - cost["tick"]) / called["berth_board_step"]
    time_s = steps / RATE_HZ
    return {"frame": frame, "step": step, "run": idle, "frames_per_s": bus["frames"] / time_s,
            "load_percent": 100 * bus["load"]}


def show(measured):
    print(f"Circle at {RATE_HZ} Hz on the virtual bus, 1 Mbit/s (x86-64 instructions, callgrind):\n")
    print(f"  {'':<52}" + "".join(f"{drive:>10}" for drive in DRIVES))
    for figure in FIGURES:
        digits = 1 if figure == "load_percent" else 0
        values = "".join(f"{measured[drive][figure]:>10.{digits}f}" for drive in DRIVES)
        print(f"  {UNITS[figure]:<52}{values}")


def page_row(text, label):
    """The three figures of a row of README.md's table."""
    row = re.search(rf"^\| {re.escape(label)} \|([^\n]*)\|$", text, re.MULTILINE)
    if row is None:
        sys.exit(f"bus_cost: README.md has no row '{label}'")
    return [float(cell.replace(",", "").replace("%", "")) for cell in row[1].split("|")]


def problems(measured, budget):
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    found = []
    for figure in FIGURES:
        for drive, told in zip(DRIVES, page_row(text, UNITS[figure])):
            value = measured[drive][figure]
            if value > budget[figure]:
                found.append(f"{drive}: {value:.1f} {UNITS[figure]}: OVER the budget of "
                             f"{budget[figure]} ({BUDGET.relative_to(ROOT)})")
            if abs(told / value - 1) > 0.05:
                found.append(f"{drive}: README.md has {told:g} {UNITS[figure]}: more than 5 % off "
                             f"{value:.1f}")
    return found


def main():
    check = sys.argv[1:] == ["--check"]
    with tempfile.TemporaryDirectory() as folder:
        measured = {drive: measure(simulator(), drive, folder) for drive in DRIVES}
    show(measured)
    if not check:
        return 0
    found = problems(measured, json.loads(BUDGET.read_text()))
    print("\n" + ("\n".join(found) if found else "within the budgets, and as the page has it"))
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
