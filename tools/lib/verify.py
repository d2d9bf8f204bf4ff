"""Runs the parts of tools/verify and writes the page of evidence, which the README's first screen quotes.

A part is tools/lib/verify_NAME.py. It is called with --out FILE and --short, or --minutes M, prints
its progress, and writes FILE: {"claims": [{"id", "claim", "figure", "command", "holds"}], "notes": [...]}.

- id: a word, unique among all parts.
- figure: short, without dates, times of day or paths. It is the same in each run if "exact" is true;
  then the figure in tools/evidence must be equal, else the page tells of another tree.
- short: a claim that only the short form makes carries "short": true and is not written.
- notes: lines of Markdown below the part's table on the page.

The part exits with 0 also when a claim does not hold; any other status means that it broke.
"""

import argparse
import json
import subprocess
import sys
import time
import xml.etree.ElementTree as ElementTree
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
EVIDENCE = ROOT / "tools" / "evidence"
PAGE = EVIDENCE / "evidence.md"
README = ROOT / "README.md"
BEGIN, END = "<!-- evidence: begin -->\n", "<!-- evidence: end -->\n"
BUILD = ROOT / "build" / "verify"

# Name, title, share of a given time.
PARTS = (
    ("proofs", "No run-time error, proved", 0.10),
    ("coverage", "Coverage by tests", 0.05),
    ("mutation", "Mutants killed by tests", 0.30),
    ("fuzz", "Fuzzing", 0.30),
    ("rules", "MISRA C, analysers, budgets of functions", 0.05),
    ("campaigns", "Campaigns", 0.15),
    ("recovery", "Recovery under dynamics", 0.05),
    ("safety", "Fault tree", 0.0),
)
# What the README's first screen quotes: id of a claim, and what is said of its figure.
QUOTES = (
    ("proof-alarms",
     "run-time errors by static analysis: any float bits, any frame, any time; what is assumed is on the page"),
    ("coverage-mcdc", "conditions shown to decide by tests (MC/DC)"),
    ("mutation-score", "mutants killed"),
    ("fuzz-crashes", "fuzzing with sanitizers"),
    ("misra", "MISRA C:2012"),
    ("campaign-ideal", "random scenes, exact drives"),
    ("campaign-dynamics", "random scenes with drive lag, noise, slip and late poses"),
    ("safety-tree", "fault tree from each hardware failure to the stop"),
)
CLAIM_KEYS = ("id", "claim", "figure", "command", "holds")


def script_of(name):
    return ROOT / "tools" / "lib" / f"verify_{name}.py"


def available():
    return [part for part in PARTS if script_of(part[0]).exists()]


def refuse(text):
    print(f"verify: {text}", file=sys.stderr)
    raise SystemExit(2)


def positive_minutes(text):
    value = float(text)
    if not 0 < value < 1e5:
        raise argparse.ArgumentTypeError(f"{text}: minutes must be above 0 and below 100000")
    return value


def arguments():
    parser = argparse.ArgumentParser(prog="tools/verify", add_help=False, allow_abbrev=False)
    parser.add_argument("parts", nargs="*", metavar="PART")
    length = parser.add_mutually_exclusive_group()
    length.add_argument("--short", action="store_true")
    length.add_argument("--minutes", type=positive_minutes)
    parser.add_argument("--list", action="store_true")
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--page", action="store_true")
    parser.add_argument("--junit", type=Path)
    options = parser.parse_args()
    names = [name for name, _, _ in available()]
    for part in options.parts:
        if part not in names:
            refuse(f"{part}: no such part; there are {', '.join(names)}")
    if options.write and options.short:
        refuse("--write needs the long forms: leave out --short")
    options.parts = options.parts or names
    return options


def checked_result(path, name):
    """What the part wrote, or an error that says what is missing."""
    result = json.loads(path.read_text())
    for claim in result["claims"]:
        for key in CLAIM_KEYS:
            if key not in claim:
                raise ValueError(f"a claim of {name} has no {key}")
    if not result["claims"]:
        raise ValueError(f"{name} claims nothing")
    return result


def run_part(name, options, share):
    """Runs one part; returns its result and what went wrong, or None."""
    out = BUILD / f"{name}.json"
    out.unlink(missing_ok=True)
    command = [sys.executable, "-B", str(script_of(name)), "--out", str(out)]
    if options.short:
        command.append("--short")
    elif options.minutes is not None:
        command += ["--minutes", f"{options.minutes * share:g}"]
    with open(BUILD / f"{name}.log", "w") as log:
        process = subprocess.Popen(
            command, cwd=ROOT, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, text=True, errors="replace")
        for line in process.stdout:
            log.write(line)
            log.flush()
            if not options.short:
                print("    " + line, end="", flush=True)
        status = process.wait()
    if status != 0:
        return None, f"ended with status {status}"
    try:
        return checked_result(out, name), None
    except (OSError, ValueError, KeyError, TypeError) as error:
        return None, f"left no usable result: {error}"


def stored(name):
    try:
        return json.loads((EVIDENCE / f"{name}.json").read_text())
    except FileNotFoundError:
        return None


def stale(name, result, writing):
    """Claims whose exact figure differs from the one on the page, as (id, what is wrong)."""
    if writing:
        return {}
    figures = {claim["id"]: claim["figure"] for claim in (stored(name) or {"claims": []})["claims"]}
    wrong = {}
    for claim in result["claims"]:
        if claim.get("exact") and not claim.get("short") and figures.get(claim["id"]) != claim["figure"]:
            wrong[claim["id"]] = (
                f"tools/evidence says {figures.get(claim['id'])!r}, measured {claim['figure']!r}: "
                f"tools/verify --write {name}")
    return wrong


def write_result(name, result):
    claims = [claim for claim in result["claims"] if not claim.get("short")]
    text = json.dumps({"claims": claims, "notes": result.get("notes", [])}, indent=1, ensure_ascii=False)
    EVIDENCE.mkdir(exist_ok=True)
    (EVIDENCE / f"{name}.json").write_text(text + "\n")


def page_text():
    lines = [
        "# Evidence",
        "",
        "What is claimed of Berth, the figure, and the command that prints it again. This page is",
        "written by `tools/verify --page` from the files beside it, which `tools/verify --write` fills;",
        "`tools/test` runs the short form of each part and fails when a figure that does not depend on",
        "the time given is another one. On a fresh machine each command installs what it needs.",
        "",
    ]
    for name, title, _ in PARTS:
        result = stored(name)
        if result is None:
            continue
        lines += [f"## {title}", "", "| claim | figure | command |", "|---|---|---|"]
        for claim in result["claims"]:
            figure = claim["figure"] if claim["holds"] else f"**does not hold:** {claim['figure']}"
            lines.append(f"| {claim['claim']} | {figure} | `{claim['command']}` |")
        lines.append("")
        if result.get("notes"):
            lines += [*result["notes"], ""]
    return "\n".join(lines).rstrip("\n") + "\n"


def quotes_text():
    claims = {claim["id"]: claim for name, _, _ in PARTS for claim in (stored(name) or {"claims": []})["claims"]}
    lines = ["| what | figure | again with |", "|---|---|---|"]
    for identity, what in QUOTES:
        if identity in claims:
            claim = claims[identity]
            figure = claim["figure"] if claim["holds"] else f"**does not hold:** {claim['figure']}"
            lines.append(f"| {what} | {figure} | `{claim['command']}` |")
    return "\n".join(lines) + "\n"


def readme_text():
    """The README with the quotes in their place."""
    text = README.read_text()
    if text.count(BEGIN) != 1 or text.count(END) != 1:
        raise SystemExit(f"README.md: needs one {BEGIN.strip()} and one {END.strip()}")
    head, rest = text.split(BEGIN)
    return head + BEGIN + quotes_text() + END + rest.split(END)[1]


def write_page():
    EVIDENCE.mkdir(exist_ok=True)
    for path, text in ((PAGE, page_text()), (README, readme_text())):
        whole = path.with_suffix(".part")  # so that an interrupt leaves no half page
        whole.write_text(text)
        whole.replace(path)


def junit(path, rows):
    """rows: (part, claim, None or what is wrong, seconds)."""
    failures = sum(1 for row in rows if row[2])
    suite = ElementTree.Element("testsuite", name="verify", tests=str(len(rows)), failures=str(failures),
                                errors="0", skipped="0")
    for part, claim, wrong, seconds in rows:
        case = ElementTree.SubElement(suite, "testcase", classname=part, name=claim, time=f"{seconds:.1f}")
        if wrong:
            ElementTree.SubElement(case, "failure", message=wrong)
    top = ElementTree.Element("testsuites")
    top.append(suite)
    path.parent.mkdir(parents=True, exist_ok=True)
    ElementTree.ElementTree(top).write(path, encoding="utf-8", xml_declaration=True)


def report_part(name, result, wrong):
    for claim in result["claims"]:
        problem = None if claim["holds"] else "does not hold"
        problem = problem or wrong.get(claim["id"])
        mark = "ok    " if problem is None else "FAILED"
        print(f"  {mark} {claim['id']:<28} {claim['figure']}", flush=True)
        if problem:
            print(f"         {claim['claim']}: {problem}")
        yield name, claim["id"], problem


def run_parts(options):
    rows = []
    shares = {name: share for name, _, share in PARTS}
    total = sum(shares[name] for name in options.parts) or 1.0
    for name in options.parts:
        print(f"{name}:", flush=True)
        start = time.monotonic()
        result, broken = run_part(name, options, shares[name] / total)
        seconds = time.monotonic() - start
        rows.append((name, "runs", broken, seconds))
        if broken:
            print(f"  FAILED {name} {broken}; log: build/verify/{name}.log")
            print("".join(f"    {line}\n" for line in (BUILD / f"{name}.log").read_text().splitlines()[-20:]))
            continue
        rows += [(*row, 0.0) for row in report_part(name, result, stale(name, result, options.write))]
        print(f"  in {seconds:.0f} s", flush=True)
        if options.write:
            write_result(name, result)
    return rows


def main():
    options = arguments()
    if options.list:
        for name, title, _ in available():
            print(f"{name:<12} {title}")
        return 0
    if options.page:
        write_page()
        return 0
    BUILD.mkdir(parents=True, exist_ok=True)
    rows = run_parts(options)
    if options.write:
        write_page()
    if options.junit:
        junit(options.junit, rows)
    failed = sum(1 for row in rows if row[2])
    print(f"{len(rows) - failed} passed, {failed} failed, 0 skipped")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
