"""Runs the tests on real CAN interfaces, all in one go: on an emulated kernel a boot takes longer
than most tests.

usage: bus_tests.py [-k PATTERN] [--list] [--junit FILE] BUILD...

BUILD is a build folder: the tests that its ctest has with the label bus. The first one's programs
and pytest files are run, of the others only the programs. PATTERN selects by ctest name. Prints one
line a case with its seconds. In the JUnit file each planned test counts: one whose result is
missing, because the machine died or could not be had, is a failure.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ElementTree
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# Enough on a machine with much else to do: only a machine that hangs takes as long.
BOOT_S = 600
LONGEST_S = 3600
# Shown in the failure of each test that was planned but has no result.
NOT_RUN = "no result: the bus tests ended before it, see the log"
UNITY = re.compile(r"^\d+ Tests \d+ Failures \d+ Ignored", re.MULTILINE)
XML_REFUSES = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd]")


def describe(test, build):
    """What running one of ctest's tests takes."""
    properties = {entry["name"]: entry["value"] for entry in test.get("properties", [])}
    command = test.get("command", [])
    file = command[-1] if command and command[-1].endswith(".py") else None
    return {
        "name": test["name"] if build is None else f"{test['name']} ({build})",
        "command": command,
        "pytest_file": file,
        "folder": properties.get("WORKING_DIRECTORY", "."),
        "environment": properties.get("ENVIRONMENT", []),
        "labels": properties.get("LABELS", []),
        "timeout": float(properties.get("TIMEOUT", 120)),
    }


def planned(builds, pattern):
    """The tests to run, in order. A regular expression like ctest's own, so -R is left to it."""
    plan = []
    for index, build in enumerate(builds):
        command = ["ctest", "--test-dir", build, "--show-only=json-v1", "-L", "^bus$"]
        if pattern:
            command += ["-R", pattern]
        listing = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        tests = json.loads(listing)["tests"]
        label = Path(build).name if index else None
        jobs = [describe(test, label) for test in tests]
        plan += [job for job in jobs if index == 0 or not job["pytest_file"]]
    return sorted(plan, key=lambda job: job["pytest_file"] is not None)


class Results:
    """One JSON object a line, written at once: what is there survives the machine's end."""

    def __init__(self, path):
        self.path = Path(path)

    def add(self, **entry):
        with self.path.open("a") as file:
            file.write(json.dumps(entry) + "\n")
        if "outcome" in entry:
            show(entry)

    def read(self):
        if not self.path.exists():
            return []
        entries = []
        for line in self.path.read_text().splitlines():
            try:
                entries.append(json.loads(line))
            except ValueError:  # the machine ended while it was written
                break
        return entries


def show(entry):
    within = UNITY.findall(entry["output"])
    detail = f": {within[-1]}" if within else ""
    print(f"{entry['outcome']:7} {entry['seconds']:7.2f} s  {entry['name']}{detail}", flush=True)
    if entry["outcome"] == "failed":
        print("\n".join("    " + line for line in entry["output"].splitlines()), flush=True)


def run_program(job, results):
    environment = {**os.environ, **dict(item.split("=", 1) for item in job["environment"])}
    start = time.monotonic()
    try:
        done = subprocess.run(
            job["command"],
            cwd=job["folder"],
            env=environment,
            timeout=job["timeout"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            check=False,
        )
        output, status = done.stdout.decode(errors="replace"), done.returncode
    except subprocess.TimeoutExpired as late:
        output = (late.stdout or b"").decode(errors="replace")
        output, status = output + f"\ntimed out after {job['timeout']:g} s\n", None
    except OSError as error:
        output, status = str(error), None
    if status not in (0, None):
        output += f"\nexit status {status}\n"
    results.add(
        job=job["name"],
        name=job["name"],
        outcome="failed" if status != 0 else "passed",
        seconds=time.monotonic() - start,
        output=output,
    )


class Reporter:
    """A pytest plugin that records each case as soon as it is known."""

    def __init__(self, jobs, results):
        self.jobs = {str(Path(job["pytest_file"]).resolve()): job["name"] for job in jobs}
        self.results = results
        self.files = {}
        self.cases = {}

    def job_of(self, node):
        return self.files.get(node.partition("::")[0], "?")

    def pytest_collection_finish(self, session):
        for item in session.items:
            file = item.nodeid.partition("::")[0]
            self.files[file] = self.jobs.get(str(item.path.resolve()), "?")
            self.results.add(job=self.files[file], collected=item.nodeid)

    def pytest_collectreport(self, report):
        if report.failed:
            self.results.add(
                job="?", name=report.nodeid, outcome="failed", seconds=0, output=report.longreprtext
            )

    def pytest_runtest_logreport(self, report):
        case = self.cases.setdefault(
            report.nodeid, {"outcome": "passed", "seconds": 0.0, "output": ""}
        )
        case["seconds"] += report.duration
        if report.failed or (report.skipped and case["outcome"] == "passed"):
            case["outcome"] = report.outcome
        if not report.passed:
            case["output"] += report.longreprtext + "\n"
        if report.when == "teardown":
            if case["outcome"] == "failed":
                case["output"] += "".join(f"{name}\n{text}\n" for name, text in report.sections)
            job = self.job_of(report.nodeid)
            self.results.add(job=job, name=report.nodeid, **case)


def run_pytest(jobs, results):
    """All files in one child: starting Python is slow in emulation, and a fork is not."""
    child = os.fork()
    if child:
        return os.waitpid(child, 0)
    status = 70
    try:
        os.environ.update(item.split("=", 1) for job in jobs for item in job["environment"])
        import pytest

        longest = max(job["timeout"] for job in jobs)
        options = ["-p", "no:cacheprovider", "-p", "no:terminal", f"--rootdir={ROOT}"]
        options += ["-o", f"faulthandler_timeout={longest}"]
        options += ["-o", "faulthandler_exit_on_timeout=true"]
        files = [job["pytest_file"] for job in jobs]
        status = pytest.main(options + files, plugins=[Reporter(jobs, results)])
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(int(status))


def run_inside(plan_file, result_file):
    """What runs where the interfaces are."""
    plan = json.loads(Path(plan_file).read_text())
    results = Results(result_file)
    for job in plan:
        if not job["pytest_file"]:
            run_program(job, results)
    files = [job for job in plan if job["pytest_file"]]
    if files:
        run_pytest(files, results)
    results.add(finished=True)
    bad = [entry for entry in results.read() if entry.get("outcome") == "failed"]
    return 1 if bad else 0


def complete(plan, entries):
    """The results, and a failure for each planned test, and each collected case, without one."""
    cases = [entry for entry in entries if "outcome" in entry]
    seen = {entry["name"] for entry in cases}
    jobs = {entry["job"] for entry in cases}
    lost = [entry["collected"] for entry in entries if "collected" in entry]
    lost = [(name, name) for name in lost if name not in seen]
    known = jobs | {entry["job"] for entry in entries if "collected" in entry}
    lost += [(job["name"], job["name"]) for job in plan if job["name"] not in known]
    for job, name in lost:
        cases.append(
            {"job": job, "name": name, "outcome": "failed", "seconds": 0.0, "output": NOT_RUN}
        )
    return cases


def write_junit(path, cases):
    """In ctest's form: the cases of a Unity program are counted from its output."""
    suite = ElementTree.Element("testsuite", name="bus", tests=str(len(cases)))
    for case in cases:
        status = {"passed": "run", "failed": "fail", "skipped": "notrun"}[case["outcome"]]
        entry = ElementTree.SubElement(
            suite, "testcase", name=case["name"], status=status, time=f"{case['seconds']:.3f}"
        )
        text = XML_REFUSES.sub("?", case["output"])
        if case["outcome"] == "failed":
            ElementTree.SubElement(entry, "failure", message="")
        if case["outcome"] == "skipped":
            ElementTree.SubElement(entry, "skipped", message=f"SKIP_ {text}")
        ElementTree.SubElement(entry, "system-out").text = text
    ElementTree.ElementTree(suite).write(path, encoding="unicode", xml_declaration=True)


def buses_of(plan):
    pairs = [item.split("=", 1) for job in plan for item in job["environment"]]
    return max((int(value) for key, value in pairs if key == "BERTH_VCAN_BUSES"), default=1)


def reason(output):
    """The line that tells most: pytest's first error, Unity's first failure, or the last."""
    lines = output.strip().splitlines() or ["?"]
    telling = [line for line in lines if line.startswith("E  ") or ":FAIL" in line]
    return (telling or lines[-1:])[0].strip()


def run_outside(plan, junit):
    """Runs the plan where there are interfaces, and accounts for all of it. True when all passed."""
    build = ROOT / "build"
    build.mkdir(exist_ok=True)
    python = ROOT / ".venv" / "bin" / "python"
    timeout = min(LONGEST_S, BOOT_S + sum(job["timeout"] for job in plan))
    with tempfile.TemporaryDirectory(prefix="bus-", dir=build) as folder:
        plan_file, result_file = Path(folder) / "plan.json", Path(folder) / "results.jsonl"
        plan_file.write_text(json.dumps(plan))
        command = [ROOT / "tools" / "vcan-shell", "--private", "--buses", str(buses_of(plan))]
        command += ["--timeout", str(timeout), "--", python, "-B", __file__]
        command += ["--inside", plan_file, result_file]
        status = subprocess.run(command, stdin=subprocess.DEVNULL, check=False).returncode
        entries = Results(result_file).read()
    cases = complete(plan, entries)
    if status not in (0, 1) or not any("finished" in entry for entry in entries):
        output = f"tools/vcan-shell ended with status {status}, before the tests did"
        cases.append(
            {"job": "", "name": "bus tests", "outcome": "failed", "seconds": 0.0, "output": output}
        )
    elif status != any(case["outcome"] == "failed" for case in cases):
        output = f"exit status {status} did not come through as the results say"
        cases.append(
            {"job": "", "name": "bus status", "outcome": "failed", "seconds": 0.0, "output": output}
        )
    write_junit(junit, cases)
    failed = [case for case in cases if case["outcome"] == "failed"]
    for case in failed:
        print(f"FAILED {case['name']}: {reason(case['output'])}")
    return not failed


def main(arguments):
    parser = argparse.ArgumentParser(description="Runs the tests on real CAN interfaces.")
    parser.add_argument("-k", metavar="PATTERN", default="")
    parser.add_argument("--list", action="store_true", help="only print the names")
    parser.add_argument("--junit", metavar="FILE", default=ROOT / "build" / "bus.xml")
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("builds", nargs="+", metavar="BUILD")
    options = parser.parse_args(arguments)
    if options.inside:
        return run_inside(*options.builds)
    plan = planned(options.builds, options.k)
    if options.list:
        print("".join(f"{job['name']}\n" for job in plan), end="")
        return 0
    if not plan:
        print("no bus test matches", file=sys.stderr)
        return 2
    return 0 if run_outside(plan, options.junit) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
