"""Writes tools/evidence/bounds.md: stack and loop bounds of each function of firmware/.

The stack is gcc's for a Cortex-M4F at -O2 (target_stack.py); the loops' bounds are those of
tests/proof/loops.md, which the proofs prove. A function that the compiler has put into its callers
alone has no stack of its own.
"""

import re
import sys

import proof_loops
import target_stack

PAGE = proof_loops.ROOT / "tools/evidence/bounds.md"
M4F = ["-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard"]
HEAD = """# Bounds of each function

Written by `tools/verify --write proofs`. Stack in bytes on a Cortex-M4F (gcc, -O2): the function's own, and the worst
with all that it calls, through pointers too, but for what lies behind a platform's functions. There is no
recursion. Loops: the most iterations of each, in the order of the source; no loop is without a bound.

| file | function | own stack | worst stack | loops |
|---|---|---|---|---|
"""


def loops_of(path):
    """function -> bounds of its loops."""
    rows = proof_loops.table()
    lines = path.read_text().splitlines()
    found = {}
    for number, loop in proof_loops.loops(path):
        name = proof_loops.function_at(lines, number)
        found.setdefault(name, []).append(rows[path.name, loop][0])
    return found


def rows():
    graph = target_stack.CallGraph("arm-none-eabi-gcc", M4F)
    for path in sorted([*proof_loops.SOURCES.glob("*.c"), *proof_loops.SOURCES.glob("*.h")]):
        loops = loops_of(path)
        lines = path.read_text().splitlines()
        for name in proof_loops.functions(lines):
            node = next((n for n in (f"{path}:{name}", name) if n in graph.frames), None)
            node = node or next((n for n in graph.frames if n.endswith(f"{path.name}:{name}")), None)
            stack = (graph.frames[node], graph.depth(node)) if node else ("in its callers", "")
            bounds = ", ".join(f"{bound:,}" for bound in loops.get(name, []))
            yield f"| {path.name} | {name} | {stack[0]} | {stack[1]} | {bounds} |"


def text():
    return HEAD + "\n".join(rows()) + "\n"


def write():
    PAGE.write_text(text())


def current():
    good = PAGE.exists() and PAGE.read_text() == text()
    if not good:
        print(f"{PAGE.name} is of another tree: tools/verify --write proofs")
    return good


if __name__ == "__main__":
    sys.stdout.write(text())
