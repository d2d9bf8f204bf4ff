"""The rules of the coverage check: nothing missed without an exception, no exception for nothing."""

import sys

import pytest

from tree import ROOT

sys.path.insert(0, str(ROOT / "tools" / "lib"))

import verify_coverage as coverage  # noqa: E402

LINE = coverage.Thing("line", "a.c", "f", "return 1;", "", 7)
BRANCH = coverage.Thing("branch", "a.c", "f", "if (a && b) {", "b true", 6)
CONDITION = coverage.Thing("condition", "a.c", "f", "if (a && b) {", "b", 6)
ENTRY = """
[[exception]]
number = 1
file = "a.c"
function = "f"
at = "if (a && b) {"
lines = ["return 1;"]
branches = ["b true"]
conditions = ["b"]
reason = "b is false wherever a is true: see above."
"""


@pytest.fixture(name="load")
def fixture_load(tmp_path, monkeypatch):
    def load(text):
        path = tmp_path / "exceptions.toml"
        path.write_text(text)
        monkeypatch.setattr(coverage, "EXCEPTIONS", path)
        return coverage.load_exceptions()

    return load


def test_all_that_is_missed_is_excepted(load):
    assert coverage.compare([LINE, BRANCH, CONDITION], load(ENTRY)) == []


@pytest.mark.parametrize("thing", [LINE, BRANCH, CONDITION], ids=lambda thing: thing.kind)
def test_missed_without_an_exception(thing):
    wrong = coverage.compare([thing], [])
    assert [kind for kind, _ in wrong] == [thing.kind]


@pytest.mark.parametrize("thing", [LINE, BRANCH, CONDITION], ids=lambda thing: thing.kind)
def test_an_exception_for_what_is_covered(load, thing):
    """Or for what is not in the sources any more, or stands elsewhere there."""
    rest = {LINE, BRANCH, CONDITION} - {thing}
    wrong = coverage.compare(rest, load(ENTRY))
    assert [kind for kind, _ in wrong] == [thing.kind]
    moved = thing._replace(function="g")
    assert len(coverage.compare([*rest, moved], load(ENTRY))) == 2


def test_lines_may_move(load):
    assert coverage.compare([LINE._replace(number=70), BRANCH, CONDITION], load(ENTRY)) == []


@pytest.mark.parametrize(
    "old, new",
    [
        ("number = 1", "number = 2"),
        ("b is false wherever a is true: see above.", "because"),
        ("lines =", "line ="),
        ('at = "if (a && b) {"\nlines = ["return 1;"]\nbranches = ["b true"]\nconditions = ["b"]', ""),
    ],
)
def test_malformed(load, old, new):
    assert old in ENTRY
    with pytest.raises((ValueError, KeyError)):
        load(ENTRY.replace(old, new))


def test_excepted_twice(load):
    second = ENTRY.replace("number = 1", "number = 2")
    assert len(coverage.compare([LINE, BRANCH, CONDITION], load(ENTRY + second))) == 3


def test_operators():
    code = """
#define BOTH(a, b) ((a) && \\
                    (b))
_Static_assert(1 && 2, "a && b; c");
/* a && b */ // c || d
if (a && (b || c) && d != '"' && e != "||") {
"""
    assert coverage.operators_in(code) == 4


def test_the_exceptions_of_the_tree_are_well_formed():
    for number, _, keys in coverage.load_exceptions():
        for kind, file, _, line, what in keys:
            text = " ".join((ROOT / file).read_text().split())
            assert kind in coverage.KINDS and " ".join(line.split()) in text, number
            assert what.removesuffix(" true").removesuffix(" false") in text, number
