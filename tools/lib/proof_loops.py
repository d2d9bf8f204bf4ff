"""The loops of firmware/src and their bounds, which tests/proof/loops.md states.

annotate() copies the sources for the analyser, with an annotation before each loop: the number of
iterations that it is to unroll, or an assertion about the loop's end, which the analyser proves. A
loop without a bound in the table is an error, and so is a bound without its loop.
"""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ROOT / "firmware/src"
TABLE = ROOT / "tests/proof/loops.md"
LOOP = re.compile(r"^(\s*)((?:for|while) \(.*\)) \{$")


def table():
    """(file, loop) -> (bound, how)."""
    rows = {}
    for line in TABLE.read_text().splitlines():
        cells = [cell.strip() for cell in line.strip("|").split(" | ")]
        if len(cells) != 4 or not cells[2].isdigit():
            continue
        file, loop, bound, how = cells
        rows[file, loop] = int(bound), how
    return rows


def loops(path):
    """(line number from 0, loop) for each loop of a source."""
    lines = path.read_text().splitlines()
    found = [(number, match[2]) for number, line in enumerate(lines) if (match := LOOP.match(line))]
    keywords = sum(len(re.findall(r"\b(?:for|while|do|goto)\b *[({;]", line)) for line in lines
                   if not re.match(r"\s*(?:/?\*|//)", line))
    if keywords != len(found):
        raise SystemExit(f"{path.name}: {keywords} loops, of which {len(found)} are written as one line")
    return found


def annotation(bound, how):
    """What the analyser is told before the loop."""
    proof, _, extra = how.partition("; ")
    notes = [f"dynamic_split {extra.removeprefix('split ')};"] if extra else []
    if proof == "unroll":
        notes.append(f"loop unroll {bound};")
    else:
        notes.append(f"assert bound: {proof.removeprefix('count ')} <= {bound};")
    return " ".join(f"/*@ {note} */" for note in notes)


def body_of(lines, number):
    """The lines of the loop that begins at this line, found by its indentation."""
    indent = len(lines[number]) - len(lines[number].lstrip())
    end = next(n for n in range(number + 1, len(lines)) if lines[n].startswith(" " * indent + "}"))
    return lines[number + 1:end]


def head_of(loop, body):
    """(condition, counter, share, rest of the body) of a loop whose counter goes up or down by one, or
    down by a share, in its head or in the last line of its body."""
    match = re.match(r"for \([^;]*; ([^;]+); (\w+)(?:\+\+|--| -= (\w+))\)$", loop)
    if match:
        return match[1], match[2], match[3], body
    match = re.match(r"(?:while \((.*)\)|for \(;;\))$", loop)
    last = re.match(r"\s*(\w+)(?:\+\+|--);$", body[-1])
    return (match[1], last[1], None, body[:-1]) if match and last else (None, None, None, body)


def counts(loop, body):
    """True when the loop can only go up or down by one until its condition, or a test in its body,
    ends it: so it does not repeat more often than from zero to its end, or from its beginning to
    zero."""
    condition, counter, share, rest = head_of(loop, body)
    text = "\n".join(rest).replace(f"{counter} = forward_plain(w, {counter},", "")  # only goes on
    if counter is None or re.search(rf"(?<![\w.>]){counter}\b *(?:[-+*/%&|^]?=[^=]|\+\+|--)", text):
        return False
    if share:
        return all(re.search(rf"\b{word} > 0u?\b", condition) for word in (counter, share))
    if condition:
        return re.search(rf"\b{counter} (?:<|<=|>|>=) ", condition) is not None
    return re.search(rf"if \({counter} (?:== 0|<= 1u)\) {{\n\s*(?:return|break);", text) is not None


def nearest(lines, number, text):
    """The line nearest to this one that reads so."""
    places = [n for n, line in enumerate(lines) if line.strip() == text]
    if not places:
        raise SystemExit(f"{TABLE.name}: no such line: {text}")
    return min(places, key=lambda n: abs(n - number))


def note_loop(lines, number, loop, bound, how):
    """Puts the annotation before the loop, or before the nearest line above or below that reads as
    what stands after "at"."""
    how, _, place = how.partition(" at ")
    if place:
        number, loop = nearest(lines, number, place), place
    lines[number] = lines[number].replace(loop, f"{annotation(bound, how)} {loop}", 1)


def annotate(folder):
    """Writes the annotated copies of all sources into the folder."""
    rows = table()
    folder.mkdir(parents=True, exist_ok=True)
    used = set()
    for path in sorted([*SOURCES.glob("*.c"), *SOURCES.glob("*.h")]):
        source = path.read_text().splitlines()
        lines = source.copy()
        for number, loop in loops(path):
            key = (path.name, loop)
            if key not in rows:
                raise SystemExit(f"{path.name}:{number + 1}: no bound for this loop in {TABLE.name}: {loop}")
            used.add(key)
            if rows[key][1].startswith("count ") and not counts(loop, body_of(source, number)):
                raise SystemExit(f"{path.name}:{number + 1}: this loop does not just count: {loop}")
            note_loop(lines, number, loop, *rows[key])
        (folder / path.name).write_text("\n".join(lines) + "\n")
    for file, loop in rows.keys() - used:
        raise SystemExit(f"{TABLE.name}: {file} has no such loop: {loop}")


def all_loops():
    """(file, line, loop) of every loop."""
    return [(path.name, number + 1, loop)
            for path in sorted([*SOURCES.glob("*.c"), *SOURCES.glob("*.h")]) for number, loop in loops(path)]


def unrolled():
    """(file, line) of the loops that the analyser has to unroll to their end."""
    rows = table()
    return {(file, line) for file, line, loop in all_loops() if rows[file, loop][1].startswith("unroll")}


def asserted():
    """(file, line) of the lines with an assertion about a loop's bound."""
    rows = table()
    found = set()
    for file, line, loop in all_loops():
        how = rows[file, loop][1]
        if how.startswith("count "):
            place = how.partition(" at ")[2]
            lines = (SOURCES / file).read_text().splitlines()
            found.add((file, nearest(lines, line - 1, place) + 1 if place else line))
    return found


START = re.compile(r"(?!_Static_assert)[A-Za-z_][\w *]*?\b(\w+)\(")


def functions(lines):
    """Names of the functions that a source defines, in order."""
    names = []
    for number, line in enumerate(lines):
        start = START.match(line)
        if start:
            head = next(text for text in lines[number:] if text.endswith((";", "{", "}", "\\")))
            names += [start[1]] if head.endswith("{") else []
    return names


def function_at(lines, number):
    """The function that a line is in."""
    return next(start[1] for line in reversed(lines[:number]) if (start := START.match(line)))


def contracts():
    """Functions whose headers state a precondition."""
    names = set()
    for header in sorted((ROOT / "firmware/include/berth").glob("*.h")):
        names |= set(re.findall(r"@ requires[^/]*\*/\n[\w *]*?\b(berth_\w+)\(", header.read_text()))
    return names
