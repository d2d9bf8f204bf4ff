"""Mutants of C sources, the register of those that survive, and what the two together claim.

A mutant is one line changed by one rule (see tests/mutation/c.rules). It is known by its file and
by the line before and after. Where a line occurs more than once, so do its mutants: the register
then lists one entry for each that survives.
"""

import contextlib
import io
import re
from collections import Counter
from dataclasses import dataclass

from universalmutator.mutator import mutants_regexp


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


def mutants_of(module, path, rules):
    text = path.read_text()
    lines = text.splitlines(keepends=True)
    bare = [line.rstrip() + "\n" for line in blank_comments(text).splitlines()]
    with contextlib.redirect_stdout(io.StringIO()):
        found = mutants_regexp(bare, [str(rules)], ignorePatterns=[], ignoreStringOnly=True)
    for number, after, *_ in found:
        changed = lines[:number - 1] + [after] + lines[number:]
        before = " ".join(bare[number - 1].split())
        yield Mutant(module, path.name, number, before, " ".join(after.split()), "".join(changed))


class Register:
    """Known survivors: how many of each key, of which kind, and why."""

    def __init__(self, text, name="the register"):
        self.count = Counter()
        self.kind = {}
        kind, file, before = None, None, None
        for number, line in enumerate(text.splitlines(), 1):
            if not line.strip() or line.startswith("#"):
                continue
            head = re.match(r"(equivalent|alive): \S", line)
            if head:
                kind, file, before = head.group(1), None, None
            elif kind and re.match(r"  \w+\.[ch]$", line):
                file, before = line.strip(), None
            elif file and line.startswith("  - "):
                before = line[4:]
            elif before and line.startswith("  + "):
                self.add((file, before, line[4:]), kind, f"{name}, line {number}")
            else:
                raise SystemExit(f"{name}, line {number}: not understood: {line}")

    def add(self, key, kind, where):
        if self.kind.setdefault(key, kind) != kind:
            raise SystemExit(f"{where}: listed as equivalent and as alive: {key[2]}")
        self.count[key] += 1

    def equivalent(self, key):
        return self.kind.get(key) == "equivalent"


def judge(results, register, everything):
    """What was found, against the register. results: [(mutant, kind)] of those that were tried,
    where kind is killed, alive, same (object code), busy (undecided) or invalid (does not compile);
    everything: all mutants of all files.

    An entry is stale when the sources have no such mutant, or all of its key were tried and fewer
    survived than are listed."""
    kinds = Counter(kind for _, kind in results)
    alive = Counter(mutant.key() for mutant, kind in results if kind == "alive")
    tried = Counter(mutant.key() for mutant, _ in results)
    there = Counter(mutant.key() for mutant in everything)
    equivalent = sum(min(n, register.count[key]) for key, n in alive.items() if register.equivalent(key))
    return {
        "kinds": kinds,
        "equivalent": equivalent,
        "valid": kinds["killed"] + kinds["alive"] + kinds["busy"] - equivalent,
        "unlisted": sorted((alive - register.count).elements()),
        "stale": sorted(key for key, n in register.count.items() if n > there[key] - tried[key] + alive[key]),
    }


def table(results, register):
    """Counts for each file, as lines of Markdown."""
    rows = ["| file | mutants | killed | equivalent | survivors |", "|---|---:|---:|---:|---:|"]
    for name in sorted({mutant.file for mutant, _ in results}):
        found = judge([(mutant, kind) for mutant, kind in results if mutant.file == name], register, [])
        kinds, equivalent = found["kinds"], found["equivalent"]
        left = kinds["alive"] + kinds["busy"] - equivalent
        total = kinds["killed"] + kinds["same"] + equivalent + left
        rows.append(f"| {name} | {total} | {kinds['killed']} | {kinds['same'] + equivalent} | {left} |")
    return rows


def block(keys):
    """As the register wants them, under a reason that is still to be found."""
    lines, file, before = [], None, None
    for key in keys:
        if key[0] != file:
            lines.append(f"  {key[0]}")
        if key[:2] != (file, before):
            lines.append(f"  - {key[1]}")
        lines.append(f"  + {key[2]}")
        file, before = key[:2]
    return "\n".join(lines)
