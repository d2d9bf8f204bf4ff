"""Adds up the test cases in JUnit files of ctest and pytest.

usage: count_tests.py FILE.xml...

One ctest entry is a whole program here: the cases within it are read from the closing line of
Unity or pytest in its output. Prints "N passed, N failed, N skipped". A file that is missing or
unreadable counts as one failure, because its runner did not get as far as writing it.
"""

import re
import sys
import xml.etree.ElementTree as ElementTree

UNITY = re.compile(r"^(\d+) Tests (\d+) Failures (\d+) Ignored", re.MULTILINE)
PYTEST = re.compile(r"^(?:=+ )?((?:\d+ [a-z]+(?:, )?)+) in [\d.]+s", re.MULTILINE)
PYTEST_WORDS = {
    "passed": 0,
    "xpassed": 0,
    "failed": 1,
    "error": 1,
    "errors": 1,
    "skipped": 2,
    "xfailed": 2,
}


def cases_in_output(text):
    """(passed, failed, skipped) from the last closing line in a program's output, or None."""
    unity = UNITY.findall(text)
    if unity:
        tests, failures, ignored = map(int, unity[-1])
        return [tests - failures - ignored, failures, ignored]
    closing = PYTEST.findall(text)
    if closing:
        counts = [0, 0, 0]
        for number, word in re.findall(r"(\d+) ([a-z]+)", closing[-1]):
            if word in PYTEST_WORDS:
                counts[PYTEST_WORDS[word]] += int(number)
        return counts
    return None


def ctest_outcome(case):
    """0 passed, 1 failed, 2 skipped. A program that could not be started is "notrun" to ctest, as
    one that asked to be skipped is; only the message tells them apart."""
    status = case.get("status")
    skipped = case.find("skipped")
    if status == "disabled":
        return 2
    if status == "notrun":
        asked = skipped is not None and (skipped.get("message") or "").startswith("SKIP_")
        return 2 if asked else 1
    return 0 if status == "run" else 1


def count_ctest_case(case):
    outcome = ctest_outcome(case)
    single = [int(outcome == index) for index in range(3)]
    if outcome == 2:
        return single
    counts = cases_in_output(case.findtext("system-out") or "") or single
    if outcome == 1 and counts[1] == 0:
        counts[1] = 1  # a crash, a time-out or a sanitizer's report after the last case
    return counts


def count_pytest_suite(suite):
    tests, failures, errors, skipped = (
        int(suite.get(key, "0")) for key in ("tests", "failures", "errors", "skipped")
    )
    failed = failures + errors
    return [max(0, tests - failed - skipped), failed, skipped]


def count_file(path):
    try:
        top = ElementTree.parse(path).getroot()
    except (OSError, ElementTree.ParseError):
        return [0, 1, 0]
    if top.tag == "testsuites":
        rows = [count_pytest_suite(suite) for suite in top.iter("testsuite")]
    else:
        rows = [count_ctest_case(case) for case in top.iter("testcase")]
    return [sum(column) for column in zip(*rows)] if rows else [0, 1, 0]


def main(paths):
    totals = [sum(column) for column in zip(*map(count_file, paths))]
    print("{} passed, {} failed, {} skipped".format(*totals))
    return 1 if totals[1] else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
