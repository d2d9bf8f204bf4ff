"""What the firmware costs on a microcontroller, as a table in Markdown.

usage: target_cost.py [--check | --write] [BUILD...]

BUILD: folders of cross builds (build/cortex-m4f and so on; all that exist without one). Runs each
build's cost image in emulation, where time counts instructions, reads the linker's maps for flash,
and the compiler's call graph for stack. Prints the table of README.md with the columns of these
builds; --write puts it there (all builds are needed). --check compares the columns with the page (within 2 %),
and the Cortex-M4F with tools/budgets/target.json; exits with 1 when either differs.
"""

import argparse
import json
import re
import sys
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import emulate
import target_stack

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "README.md"
BUDGET = ROOT / "tools/budgets/target.json"
BEGIN, END = "<!-- target costs: begin -->\n", "<!-- target costs: end -->\n"
# Build, board of the cost image, heading.
TARGETS = {
    "cortex-m4f": ("mps2-an386", "M4F"),
    "cortex-m7": ("mps2-an500", "M7"),
    "cortex-m33": ("mps2-an505", "M33"),
    "cortex-m3": ("mps2-an385", "M3"),
    "cortex-m0plus": ("mps2-an385", "M0+"),
    "rv32imafc": ("virt", "RV32"),
}
MAIN = "cortex-m4f"
M4F = ["-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard"]
PROTOCOLS = ("odrive", "vesc", "cia402")
STACK_OF = {
    "stack.bound.controller.step": "berth_controller_step",
    "stack.bound.board.step": "berth_board_step",
    "stack.bound.board.receive": "berth_board_receive",
    "stack.bound.link": "berth_link_run",
}

# Heading of a group, then rows: what, figures (joined by " / ").
ROWS = [
    ("**Instructions at -O2**", None),
    ("tracking law, pose and row to (v, omega): median / most", ["law.median", "law.max"]),
    ("reference, one sample on", ["reference.median"]),
    ("avoidance, each active obstacle, heading free", ["avoid.active"]),
    ("avoidance, each active obstacle, while turning", ["avoid.turning"]),
    ("avoidance, each inactive obstacle", ["avoid.inactive"]),
    ("look-ahead, each sample that it looks at", ["lookahead.sample"]),
    ("limits and wheel speeds: median / most", ["limits.median", "limits.max"]),
    ("**control step**, 8 obstacles: median / most", ["step.median", "step.max"]),
    ("of these, steps with 2 active: median / most", ["step.two.median", "step.two.max"]),
    ("gain K_k, Euler, N = 10 / 20 / 40", [f"gain.euler.{n}" for n in (10, 20, 40)]),
    ("gain K_k, zero-order hold, N = 10 / 20 / 40", [f"gain.zoh.{n}" for n in (10, 20, 40)]),
    ("odometry, one advance", ["odometry.median"]),
    ("pose, status, error into a frame",
     [f"message.encode.{what}" for what in ("pose", "status", "error")]),
    ("pose fix, obstacle, command out of a frame",
     [f"message.decode.{what}" for what in ("pose", "obstacle", "command")]),
    *[row for protocol in PROTOCOLS for row in (
        (f"{protocol}: a command into a frame / a frame into speed and travel, medians",
         [f"drive.cycle.{protocol}.median", f"drive.receive.{protocol}.median"]),
        (f"{protocol}: board's control step: median / most / the first, which starts the plan",
         [f"board.step.{protocol}.median", f"board.step.{protocol}.max",
          f"board.start.{protocol}.max"]),
        (f"{protocol}: a call between control steps: median",
         [f"board.between.{protocol}.median"]),
        (f"{protocol}: a frame received by the board: a drive's / pose fix / another's",
         [f"frame.drive.{protocol}.median", f"frame.fix.{protocol}.median",
          f"frame.foreign.{protocol}"]),
    )],
    ("**Bytes of flash**", None),
    ("controller, Euler alone, obstacles fixed, -Os", ["flash.small"]),
    ("controller with all it has: -Os / -O2", ["flash.controller.Os", "flash.controller.O2"]),
    *[(f"whole board with {protocol}: -Os / -O2",
       [f"flash.{protocol}.Os", f"flash.{protocol}.O2"]) for protocol in PROTOCOLS],
    ("a sample of the plan with its gain", ["plan.sample"]),
    ("**Bytes of RAM**", None),
    ("controller with room for 16 obstacles", ["ram.controller"]),
    ("of it, an obstacle", ["ram.slot"]),
    ("board: controller, two drives, outbox and all", ["ram.board"]),
    ("of it: a drive, outbox, odometry, supervisor",
     ["ram.drive", "ram.outbox", "ram.odometry", "ram.supervisor"]),
    ("workspace of the constrained tracker", ["ram.constrained"]),
    ("**Bytes of stack**", None),
    ("painted, the call's arguments included: controller's set-up / step",
     ["stack.controller.init", "stack.controller.step"]),
    ("painted: board's set-up / step / receive, cia402",
     ["stack.board.init", "stack.board.step", "stack.board.receive"]),
    ("worst by call graph: controller's step",
     ["stack.bound.controller.step"]),
    ("worst by call graph: board's step / receive, link's run",
     ["stack.bound.board.step", "stack.bound.board.receive", "stack.bound.link"]),
]


def run_image(build, board):
    """The figures that the cost image prints."""
    image = build / "tests/target" / f"{board}-cost.elf"
    status, output = emulate.run(board, image, timeout=300, icount=10)
    figures = {name: int(value) for name, value in re.findall(r"^(\S+) (\d+)$", output, re.M)}
    if status != 0 or figures.pop("end", 0) != 1:
        sys.exit(f"target_cost: {image} ended with {status}:\n{output[-2000:]}")
    return figures


def derive(figures):
    """Costs of one more obstacle and of one more sample, from runs with more and fewer of them."""
    def slope(kind, few, many):
        most = figures[f"avoid.{kind}.{many}.mean"] - figures[f"avoid.{kind}.{few}.mean"]
        return -(-most // (many - few))

    # from two on the look-ahead stands, and what is left is the obstacle's own
    figures["avoid.active"] = slope("active", 2, 8)
    figures["avoid.turning"] = slope("turning", 1, 8)
    figures["avoid.inactive"] = slope("resting", 1, 8)
    # with n obstacles the look-ahead takes n samples a step: what is not the obstacle's own
    figures["lookahead.sample"] = slope("inactive", 1, 8) - figures["avoid.inactive"]


def flash(build, board, image):
    """Bytes of the firmware's code and constants in an image, by module."""
    text = (build / "tests/target" / f"{board}-flash-{image}.map").read_text()
    text = text[text.index("Linker script and memory map") :]
    modules = Counter()
    for size, module in re.findall(
        r"^ \.(?:text|s?rodata)\S*\s+0x[0-9a-f]+\s+0x([0-9a-f]+) \S*libberth\w*\.a\((\w+)\.c\.o",
        text, re.M,
    ):
        modules[module] += int(size, 16)
    if not modules:
        sys.exit(f"target_cost: nothing of the firmware in {image}")
    return modules


def measure(name, folder):
    board = TARGETS[name][0]
    figures = run_image(folder, board)
    derive(figures)
    figures["flash.small"] = flash(folder, board, "fixed-small").total()
    for image in ("controller", *PROTOCOLS):
        for kind in ("Os", "O2"):
            figures[f"flash.{image}.{kind}"] = flash(folder, board, f"{image}-{kind}").total()
    if name == MAIN:
        graph = target_stack.CallGraph("arm-none-eabi-gcc", M4F)
        figures.update({key: graph.depth(function) for key, function in STACK_OF.items()})
    return figures


def cell(figures, names):
    """The figures; nothing where they are not known for this target."""
    if not all(name in figures for name in names):
        return ""
    return " / ".join(f"{figures[name]:,}" for name in names)


def columns(measured):
    """Lines of the table by heading of the column: first what, budget, then the targets."""
    budget = json.loads(BUDGET.read_text())
    table = {"": [], "budget": []}
    for what, names in ROWS:
        table[""].append(what)
        limits = [f"{budget[name]:,}" if name in budget else "-" for name in names or ()]
        shown = " / ".join(limits) if any(limit != "-" for limit in limits) else ""
        table["budget"].append(shown)
    for name, (_, heading) in TARGETS.items():
        if name in measured:
            table[heading] = [cell(measured[name], names) if names else ""
                              for _, names in ROWS]
    return table


def markdown(table):
    head = list(table)
    lines = [f"| {' | '.join(head)} |", "|---|" + "---:|" * (len(head) - 1)]
    lines += [f"| {' | '.join(row)} |" for row in zip(*table.values())]
    return "\n".join(re.sub(r" +\|", " |", line) for line in lines) + "\n"


def modules_line(build):
    modules = flash(build, TARGETS[MAIN][0], "cia402-Os")
    parts = ", ".join(f"{module} {size:,}" for module, size in sorted(modules.items()))
    return f"Flash by module, whole board with cia402, Cortex-M4F, -Os: {parts}.\n"


def section(measured, builds):
    text = markdown(columns(measured))
    return text + "\n" + modules_line(builds[MAIN]) if MAIN in measured else text


def page_section():
    text = PAGE.read_text(encoding="utf-8")
    return text[text.index(BEGIN) + len(BEGIN) : text.index(END)]


def page_columns():
    rows = [line.strip("|").split("|") for line in page_section().splitlines() if "|" in line]
    cells = [[cell.strip() for cell in row] for row in rows]
    return {head: [row[i] for row in cells[2:]] for i, head in enumerate(cells[0])}


def alike(told, now):
    """The same text, with numbers that differ by 2 % at most: pages need not change with each byte."""
    numbers = [[int(n.replace(",", "")) for n in re.findall(r"\d[\d,]*\d|\d", text)]
               for text in (told, now)]
    words = [re.sub(r"[\d,]+", "", text) for text in (told, now)]
    return words[0] == words[1] and len(numbers[0]) == len(numbers[1]) and all(
        abs(a - b) <= max(2, 0.02 * b) for a, b in zip(*numbers))


def problems(measured, builds):
    found = []
    if MAIN in measured:
        for name, limit in json.loads(BUDGET.read_text()).items():
            if name != "what" and measured[MAIN][name] > limit:
                found.append(f"{name}: {measured[MAIN][name]} is OVER the budget of {limit}")
        told = re.search(r"^Flash by module.*\n", page_section(), re.M)
        if told is None or not alike(told[0], modules_line(builds[MAIN])):
            found.append("README.md has other sizes of modules")
    page = page_columns()
    for heading, lines in columns(measured).items():
        for (what, _), told, now in zip(ROWS, page.get(heading, [""] * len(ROWS)), lines):
            if not alike(told, now):
                found.append(f"README.md, column {heading!r}, {what}: {told!r}, measured {now!r}")
    return found


def write(measured, builds):
    if set(measured) != set(TARGETS):
        sys.exit(f"target_cost: --write needs all builds: {' '.join(TARGETS)}")
    text = PAGE.read_text(encoding="utf-8")
    before, rest = text.split(BEGIN)
    PAGE.write_text(before + BEGIN + section(measured, builds) + END + rest.split(END)[1],
                    encoding="utf-8")


def main(arguments):
    parser = argparse.ArgumentParser(usage=__doc__.split("\n\n")[1].removeprefix("usage: "))
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--write", action="store_true")
    parser.add_argument("builds", nargs="*", type=Path)
    given = parser.parse_args(arguments)
    folders = given.builds or [ROOT / "build" / name for name in TARGETS]
    builds = {folder.name: folder for folder in folders if folder.is_dir()}
    if not builds or not set(builds) <= set(TARGETS):
        sys.exit(f"target_cost: no builds, or others than {' '.join(TARGETS)}")
    measured = {name: measure(name, builds[name]) for name in TARGETS if name in builds}
    print(section(measured, builds), end="")
    if given.write:
        write(measured, builds)
    found = problems(measured, builds) if given.check else []
    print("\n".join(found))
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
