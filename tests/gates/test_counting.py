"""The overall count: each case counts, and a runner that died counts as a failure."""

import sys

import pytest

from tree import ROOT

sys.path.insert(0, str(ROOT / "tools" / "lib"))

import count_tests  # noqa: E402

CTEST = """<?xml version="1.0"?>
<testsuite name="x" tests="1" failures="0">
  <testcase name="t" status="{status}">{detail}<system-out>{output}</system-out></testcase>
</testsuite>
"""
DETAIL = {
    "fail": '<failure message=""/>',
    "absent": '<skipped message="Unable to find executable"/>',
    "skip": '<skipped message="SKIP_RETURN_CODE=77"/>',
}


@pytest.mark.parametrize(
    "status, output, expected",
    [
        ("run", "x.c:1:test_a:PASS\n-----\n3 Tests 0 Failures 1 Ignored \nOK\n", [2, 0, 1]),
        ("fail", "-----\n3 Tests 2 Failures 0 Ignored \nFAIL\n", [1, 2, 0]),
        ("fail", "-----\n3 Tests 0 Failures 0 Ignored \nOK\nleak\n", [3, 1, 0]),
        ("fail", "Segmentation fault", [0, 1, 0]),
        ("run", "..s [100%]\n2 passed, 1 skipped in 0.10s\n", [2, 0, 1]),
        ("fail", "1 failed, 2 passed, 1 error in 61.02s (0:01:01)\n", [2, 2, 0]),
        ("run", "anything else", [1, 0, 0]),
        ("disabled", "Disabled", [0, 0, 1]),
        ("absent", "Unable to find executable", [0, 1, 0]),
        ("skip", "", [0, 0, 1]),
    ],
)
def test_ctest_case(tmp_path, status, output, expected):
    path = tmp_path / "ctest.xml"
    detail = DETAIL.get(status, "")
    status = "notrun" if status in ("absent", "skip") else status
    path.write_text(CTEST.format(status=status, detail=detail, output=output))
    assert count_tests.count_file(path) == expected


def test_pytest_file(tmp_path):
    path = tmp_path / "pytest.xml"
    path.write_text(
        '<testsuites><testsuite tests="9" failures="2" errors="1" skipped="1"/></testsuites>'
    )
    assert count_tests.count_file(path) == [5, 3, 1]


def test_missing_or_broken_file_is_a_failure(tmp_path, capsys):
    broken = tmp_path / "broken.xml"
    broken.write_text("<testsuite>")
    assert count_tests.main([str(tmp_path / "none.xml"), str(broken)]) == 1
    assert capsys.readouterr().out == "0 passed, 2 failed, 0 skipped\n"


def test_a_run_without_tests_is_a_failure(tmp_path):
    path = tmp_path / "empty.xml"
    path.write_text('<testsuite name="x" tests="0"></testsuite>')
    assert count_tests.count_file(path) == [0, 1, 0]
