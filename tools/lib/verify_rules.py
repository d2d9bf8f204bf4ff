"""MISRA C, clang-tidy, the compilers' analysers and widest warnings, and the budgets of functions.

  python tools/lib/verify_rules.py --out FILE [--short | --minutes M]

The short form looks at the firmware and the portable HAL with clang-tidy and the compilers, the long
one also at hal/linux, hal/mps2, the simulator and the tools. MISRA C and the budgets are whole in
both. The time is what it takes.
"""

import argparse
import json
import re
import sys
from pathlib import Path

import lizard

import rules_compilers
import rules_misra

ROOT = Path(__file__).resolve().parents[2]
COMMAND = "tools/verify rules"
SHORT_FOLDERS = ("firmware/src/", "hal/loop/", "hal/slcan/", "hal/blank/", "hal/stm32/")
BUDGETS = {"lines": 60, "complexity": 15, "parameters": 6}
GATE = "tests/gates/test_budgets.py"
GATE_LIMIT = re.compile(r"^(?:LENGTH|COMPLEXITY|PARAMETERS)_MAX = (\d+)$", re.MULTILINE)


def claim(name, text, figure, holds, exact=True):
    return {"id": name, "claim": text, "figure": figure, "command": COMMAND, "holds": bool(holds), "exact": exact}


def show(title, lines):
    print(f"{title}: {len(lines)}", flush=True)
    for line in lines[:50]:
        print(f"  {line}", flush=True)


def misra_claims():
    verdict = rules_misra.judge(ROOT)
    show("MISRA C: findings without an entry", verdict.open)
    show("MISRA C: register and sources", verdict.wrong)
    for number, entry in verdict.entries.items():
        print(f"  {number:<4} {', '.join(entry.rules):<30} {verdict.covered[number]} places")
    deviations = [number for number in verdict.entries if number[0] == "D"]
    notes = [f"MISRA C: the {len(deviations)} deviations cover {verdict.places('D')} places in the firmware and the "
             f"portable HAL, false alarms of the tool {verdict.places('T')}; "
             "[the register](../rules/deviations.md) says why each is safe. Most are: "
             + ", ".join(f"{number} {count}" for number, count in verdict.covered.most_common(4)) + "."]
    return [claim("misra", "MISRA C:2012 as far as cppcheck knows it: firmware and portable HAL have no finding that "
                  "no numbered deviation covers, and no deviation from a mandatory rule",
                  f"{len(verdict.open)} open; {len(deviations)} deviations", not verdict.open),
            claim("misra-register", "No entry of the register is stale, unused, unknown or unmentioned in the sources",
                  f"{len(verdict.wrong)} mistakes", not verdict.wrong)], notes


def selected(entries, short):
    return {file: entry for file, entry in entries.items() if not short or file.startswith(SHORT_FOLDERS)}


def tidy_claims(clang, arm, scope):
    found = rules_compilers.tidy(ROOT, clang, "clang") | rules_compilers.tidy(ROOT, arm, "arm")
    sources = [path for folder in ("firmware", "hal", "host_sim", "tools")
               for path in (ROOT / folder).rglob("*.[ch]")]
    count, bare = rules_compilers.suppressions(ROOT, sources)
    show("clang-tidy", sorted(found))
    show("NOLINT without a check or a reason", bare)
    return [claim("tidy", f"clang-tidy, with clang's analyser, over {scope}: no finding; each exception names its "
                  "check and its reason", f"{len(found)} findings, {rules_compilers.tidy_checks(ROOT)} checks, "
                  f"{count} exceptions", not found and not bare)]


def compiler_claims(clang, gcc, scope):
    analyzed = rules_compilers.gcc_analyzer(ROOT, gcc)
    wide = rules_compilers.gcc_wide(ROOT, gcc) | rules_compilers.clang_wide(ROOT, clang)
    claims = []
    for name, kind, found, text in (
            ("gcc-analyzer", "analyzer", analyzed, f"gcc's analyser over {scope}: no finding"),
            ("wide-warnings", "wide", wide, "gcc with "
             f"{len(rules_compilers.GCC_WIDE)} more warnings than it is built with, and clang with all "
             f"but {len(rules_compilers.CLANG_WIDE) - 1}, over {scope}: none")):
        left, stale, given = rules_compilers.without_false_alarms(found, kind)
        show(name, left)
        stale = [key for key in stale if key[0] in gcc]
        show(f"{name}: listed, but not given", stale)
        claims.append(claim(name, text, f"{len(left)} findings; false alarms listed: {len(given)}",
                            not left and not stale))
    return claims


def functions_of(folder):
    for path in sorted((ROOT / folder).rglob("*")):
        if path.suffix in (".c", ".h", ".py"):
            yield from lizard.analyze_file(str(path)).function_list


def budget_claims():
    worst, over, rows = dict.fromkeys(BUDGETS, 0), [], []
    for folder in ("firmware", "hal", "host_sim", "tools"):
        most, count = dict.fromkeys(BUDGETS, 0), 0
        for one in functions_of(folder):
            figures = {"lines": one.length, "complexity": one.cyclomatic_complexity,
                       "parameters": one.parameter_count}
            count += 1
            most = {key: max(most[key], figures[key]) for key in BUDGETS}
            if any(figures[key] > BUDGETS[key] for key in BUDGETS):
                over.append(f"{one.filename}: {one.name} {figures}")
        worst = {key: max(worst[key], most[key]) for key in BUDGETS}
        rows.append(f"{folder} {count} functions, at most {most['lines']} lines, complexity "
                    f"{most['complexity']}, {most['parameters']} parameters")
        print(f"  {rows[-1]}")
    show("functions over budget", over)
    limits = ", ".join(f"{value} {key}" if key != "complexity" else f"complexity {value}"
                       for key, value in BUDGETS.items())
    gate = [int(value) for value in GATE_LIMIT.findall((ROOT / GATE).read_text())]
    figure = f"{len(over)} over; worst {worst['lines']}, {worst['complexity']}, {worst['parameters']}"
    return [claim("function-budgets", f"No function of the product has more than {limits}; the gate in {GATE} has "
                  "the same limits", figure, not over and gate == list(BUDGETS.values()), exact=False)], [
                      "Functions: " + "; ".join(rows) + "."]


def planted_claims():
    misra = rules_misra.planted(ROOT)
    compilers = rules_compilers.planted(ROOT)
    found, planted = misra[0] + compilers[0], misra[1] + compilers[1]
    return [claim("rules-can-fail", "Mistakes planted in files of their own are found: of MISRA C, of the register, "
                  "for clang-tidy and for both compilers", f"{found} of {planted}", found == planted)]


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--out", type=Path, required=True)
    length = parser.add_mutually_exclusive_group()
    length.add_argument("--short", action="store_true")
    length.add_argument("--minutes", type=float)
    options = parser.parse_args()
    clang, gcc, arm = rules_compilers.databases(ROOT)
    arm = {} if options.short else arm
    clang, gcc = selected(clang, options.short), selected(gcc, options.short)
    scope = "the firmware and the portable HAL" if options.short else "firmware, HAL, simulator and tools"
    part = tidy_claims(clang, arm, scope) + compiler_claims(clang, gcc, scope)
    for one in part if options.short else []:
        one.update(id=one["id"] + "-short", short=True)
    misra, notes = misra_claims()
    budgets, rows = budget_claims()
    coverage = ["But for the budgets, none of these looks at firmware/boards, which are examples; hal/mps2, "
                "which is for one processor, is seen by MISRA C and clang-tidy alone, hal/linux by all but MISRA C."]
    claims = misra + part + budgets + planted_claims()
    options.out.write_text(json.dumps({"claims": claims, "notes": notes + rows + coverage}, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
