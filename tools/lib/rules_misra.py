"""MISRA C:2012 by cppcheck, held against the register of deviations, for tools/lib/verify_rules.py.

judge(ROOT) runs cppcheck over the firmware and the portable HAL for a 64-bit machine and a 32-bit Arm
and returns a Verdict; planted() shows that each kind of mistake is found. tools/rules/deviations.md
says how sources refer to the register.
"""

import re
import subprocess
import tempfile
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

FOLDERS = ("firmware/src", "hal/loop", "hal/slcan", "hal/blank", "hal/stm32", "hal/mps2")
INCLUDES = ("firmware/include", "hal/include", *FOLDERS[1:])
PLATFORMS = ("unix64", "arm32-wchar_t4")
REGISTER = "tools/rules/deviations.md"
EVERYWHERE = "firmware/include/berth/berth.h"
MANDATORY = {"9.1", "12.5", "13.6", "17.3", "17.4", "17.6", "19.1", "21.13", "21.17", "21.18", "21.19",
             "21.20", "22.2", "22.4", "22.5", "22.6"}

HEADING = re.compile(r"^### ([DT]\d+): (rules?|check) ([\w., ]+), (advisory|required|false alarm), "
                     r"(everywhere|headers|tagged)$", re.MULTILINE)
ANY_HEADING = re.compile(r"^### .*$", re.MULTILINE)
TAG = re.compile(r"MISRA ([DT]\d+(?:, [DT]\d+)*)( in this file)?")
BIT_OPERATORS = ("<<", ">>", "&", "|", "^", "~")
TEMPLATE = "{file}|{line}|{column}|{id}|{message}"


@dataclass(frozen=True)
class Finding:
    file: str
    line: int
    column: int
    rule: str  # "12.1" or the name of a check

    def __str__(self):
        return f"{self.file}:{self.line}:{self.column}: {self.rule}"


@dataclass
class Entry:
    number: str
    rules: tuple
    where: str


@dataclass
class Verdict:
    entries: dict
    covered: Counter = field(default_factory=Counter)
    wrong: list = field(default_factory=list)
    open: list = field(default_factory=list)

    def places(self, letter):
        return sum(count for number, count in self.covered.items() if number[0] == letter)


class Tree:
    """Lines of the checked files, and where they refer to the register."""

    def __init__(self, texts):
        self.lines = {name: text.split("\n") for name, text in texts.items()}
        self.everywhere = set()
        self.in_file = set()  # (number, file)
        self.at = {}  # (number, file, line of the tag) -> lines that it covers
        for name, text in texts.items():
            if name == EVERYWHERE:
                self.everywhere = set(re.findall(r"\b[DT]\d+\b", text))
                continue
            for number, line in enumerate(self.lines[name], 1):
                self._read_line(name, number, line)
        headers = "\n".join(text for name, text in texts.items() if name.endswith(".h"))
        self.declared = set(re.findall(r"\b(\w+)\(", headers))

    def _read_line(self, name, number, line):
        match = TAG.search(line)
        if match is None:
            return
        for tag in match[1].split(", "):
            if match[2]:
                self.in_file.add((tag, name))
            else:
                self.at[(tag, name, number)] = self._reach(name, number)

    def _reach(self, name, number):
        """The tag's own line; the statement below, when the comment stands alone."""
        lines = self.lines[name]
        reach = {number}
        if lines[number - 1].lstrip().startswith("/*"):
            for below in range(number + 1, min(number + 6, len(lines) + 1)):
                reach.add(below)
                if lines[below - 1].rstrip().endswith((";", "{", "*/")):
                    break
        return reach

    def numbers(self):
        return self.everywhere | {tag for tag, _ in self.in_file} | {tag for tag, _, _ in self.at}

    def text_at(self, finding):
        return self.lines[finding.file][finding.line - 1][finding.column - 1:]


def read_register(text):
    entries = {}
    for number, _, rules, category, where in HEADING.findall(text):
        entries[number] = Entry(number, tuple(rules.split(", ")), where)
        if (category == "false alarm") != (number[0] == "T"):
            raise ValueError(f"{number}: T is for false alarms, D for deviations")
        if number[0] == "D" and MANDATORY & set(rules.split(", ")):
            raise ValueError(f"{number}: no deviation from a mandatory rule")
    unread = [line for line in ANY_HEADING.findall(text) if not HEADING.match(line)]
    if unread or not entries:
        raise ValueError(f"headings that say nothing: {unread}")
    return entries


def holds_for(entry, finding, tree):
    """Whether an entry for the whole project covers the finding."""
    if finding.rule == "12.1":
        return not tree.text_at(finding).startswith(BIT_OPERATORS) or tree.text_at(finding)[:2] in ("&&", "||")
    if entry.where == "headers" and finding.rule == "8.7":
        match = re.search(r"(\w+)$", tree.text_at(finding).partition("(")[0])
        return match is not None and match[1] in tree.declared
    return entry.where == "everywhere" or finding.file.endswith(".h")


def cover(entry, finding, tree):
    """The reference that covers the finding, or None."""
    if entry.where != "tagged":
        covers = entry.number in tree.everywhere and holds_for(entry, finding, tree)
        return entry.number if covers else None
    if (entry.number, finding.file) in tree.in_file:
        return (entry.number, finding.file)
    for place, lines in tree.at.items():
        if place[:2] == (entry.number, finding.file) and finding.line in lines:
            return place
    return None


def compare(findings, tree, entries):
    """What the register covers, and everything that does not fit."""
    verdict = Verdict(entries)
    used = set()
    for finding in sorted(findings, key=str):
        references = [(entry.number, cover(entry, finding, tree)) for entry in entries.values()
                      if finding.rule in entry.rules]
        references = [pair for pair in references if pair[1] is not None]
        if not references:
            verdict.open.append(str(finding))
            continue
        verdict.covered[references[0][0]] += 1
        used.add(references[0][1])
    for number in sorted(tree.numbers() - set(entries)):
        verdict.wrong.append(f"{number} is in a source, not in {REGISTER}")
    for number in sorted(set(entries) - tree.numbers()):
        verdict.wrong.append(f"{number}: no source refers to it")
    for number in sorted(set(entries) - set(verdict.covered)):
        verdict.wrong.append(f"{number} covers nothing")
    for place in sorted((tree.in_file | set(tree.at)) - used, key=str):
        verdict.wrong.append(f"{place[0]} covers nothing in {place[1]}")
    for number, entry in entries.items():
        if (number in tree.everywhere) != (entry.where != "tagged"):
            verdict.wrong.append(f"{number}: {EVERYWHERE} and the register disagree on where it holds")
    return verdict


def run_cppcheck(root, platform, sources, includes):
    """Findings of one run; raises when cppcheck itself fails."""
    with tempfile.TemporaryDirectory() as scratch:
        command = [root / ".venv/bin/cppcheck", "--enable=style", "--addon=misra", "--std=c11", "-q",
                   f"--platform={platform}", "--check-level=exhaustive", "-j2",
                   f"--cppcheck-build-dir={scratch}", f"--template={TEMPLATE}",
                   "--suppress=missingIncludeSystem", *(f"-I{folder}" for folder in includes), *sources]
        done = subprocess.run([str(word) for word in command], cwd=root, capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"cppcheck: {done.stderr or done.stdout}")
    findings = set()
    for line in done.stderr.splitlines():
        file, number, column, rule, _ = line.split("|", 4)
        if rule != "checkersReport":
            findings.add(Finding(file, int(number), int(column), rule.removeprefix("misra-c2012-")))
    return findings


def checked_files(root):
    folders = [*FOLDERS, "firmware/include/berth", "hal/include/berth_hal"]
    return sorted(path for folder in folders for path in (root / folder).glob("*.[ch]"))


def judge(root):
    findings = set()
    for platform in PLATFORMS:
        findings |= run_cppcheck(root, platform, FOLDERS, INCLUDES)
    texts = {str(path.relative_to(root)): path.read_text() for path in checked_files(root)}
    return compare(findings, Tree(texts), read_register((root / REGISTER).read_text()))


PLANTED = """#include <stdlib.h>
static int mixed(int *number, unsigned count) {
    short *half = (short *)number;
    char *heap = malloc(017);
    if (count)
        return half[0] < count | heap[0] << 40;
    goto end;
end:
    switch (count) { case 1: break; }
    return 0;
}
int (*use)(int *, unsigned) = mixed;
"""
PLANTED_RULES = {"7.1", "10.4", "11.3", "10.1", "14.4", "15.1", "15.6", "16.4", "21.3", "12.1"}


def planted(root):
    """(found, planted): violations, and mistakes in references to the register."""
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "planted.c"
        path.write_text(PLANTED)
        findings = run_cppcheck(root, "unix64", [path], [])
    entries = {"D1": Entry("D1", ("12.1",), "everywhere"), "D2": Entry("D2", ("1.1",), "tagged"),
               "D3": Entry("D3", ("1.2",), "tagged")}
    texts = {str(path): PLANTED + "/* MISRA D2, D9 in this file. */\n", EVERYWHERE: "/* MISRA D1 */"}
    verdict = compare(findings, Tree(texts), entries)
    open_rules = {line.rsplit(" ", 1)[1] for line in verdict.open}
    mistakes = ("D9 is in a source", "D3: no source", "D2 covers nothing in", "D3 covers nothing")
    found = len(PLANTED_RULES & open_rules)
    found += sum(any(text.startswith(start) for text in verdict.wrong) for start in mistakes)
    return found, len(PLANTED_RULES) + len(mistakes)
