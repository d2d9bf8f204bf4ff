"""The mutation check finds a planted survivor and an endless loop, and its claims fall with it."""

import json
import subprocess
import sys

import pytest

from tree import ROOT

sys.path.insert(0, str(ROOT / "tools" / "lib"))

import mutants  # noqa: E402
import verify_mutation as mutation  # noqa: E402

SOURCE = """
unsigned thing(unsigned a);

unsigned thing(unsigned a) {
    while (a > 100u) {
        a -= 100u; /* left out: an endless loop */
    }
    return a < 10u ? 1u : 2u;
}
"""

# 10 itself is not tried.
TEST = """
unsigned thing(unsigned a);

int main(void) {
    static const unsigned cases[][2] = {{5, 1}, {9, 1}, {11, 2}, {100, 2}, {101, 1}, {209, 1}, {211, 2}};
    for (unsigned i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        if (thing(cases[i][0]) != cases[i][1]) {
            return 1;
        }
    }
    return 0;
}
"""

SURVIVORS = """  thing.c
  - return a < 10u ? 1u : 2u;
  + return a < (10u + 1u) ? 1u : 2u;
  + return a <= 10u ? 1u : 2u;
"""


def compile_c(*arguments):
    subprocess.run(["gcc", "-O1", *map(str, arguments)], check=True)


@pytest.fixture(name="project")
def fixture_project(tmp_path, monkeypatch):
    """One source with one test, in the place of the firmware. Returns what runs the check."""
    build = tmp_path / "build"
    (build / "tests").mkdir(parents=True)
    (tmp_path / "thing.c").write_text(SOURCE)
    (tmp_path / "test.c").write_text(TEST)
    compile_c("-shared", "-fPIC", tmp_path / "thing.c", "-o", build / "libthing.so")
    compile_c(tmp_path / "test.c", build / "libthing.so", f"-Wl,-rpath,{build}", "-o", build / "tests" / "test_thing")
    for name, value in {
        "SOURCES": tmp_path, "BUILD": build, "OUT": tmp_path, "LAST": tmp_path / "last.json",
        "REGISTER": tmp_path / "register.txt", "MODULES": {"thing": (("thing.c",), ("test_thing",))},
        "INCLUDED": {}, "ALONE": {}, "build": lambda *_: None,
    }.items():
        monkeypatch.setattr(mutation, name, value)

    def check(register, *arguments):
        (tmp_path / "register.txt").write_text(register)
        assert mutation.main(["--jobs", "2", "--out", str(tmp_path / "out.json"), *arguments]) == 0
        claims = json.loads((tmp_path / "out.json").read_text())["claims"]
        return {claim["id"]: claim for claim in claims}

    return check


def test_a_planted_survivor_is_found_and_has_to_be_listed(project, capsys):
    claims = project("")
    assert not claims["mutation-survivors"]["holds"]
    assert claims["mutation-survivors"]["figure"].startswith("2 survivors and 0 that are equivalent, 2 unlisted")
    assert SURVIVORS in capsys.readouterr().out  # to be pasted into the register
    score = claims["mutation-score"]
    assert score["exact"] and not score["holds"] and not score["figure"].startswith("100")

    judged = project("alive: nobody tries it\n" + SURVIVORS, "--judge")
    assert judged["mutation-survivors"]["holds"] and judged["mutation-score"] == score
    again = project("alive: nobody tries it\n" + SURVIVORS, "--again")
    assert again["mutation-survivors"]["holds"]
    assert again["mutation-survivors"]["figure"].startswith("2 survivors and 0 that are equivalent, 0 unlisted")
    assert not again["mutation-score"]["exact"]


def test_what_was_found_in_other_sources_is_not_judged(project, tmp_path):
    project("")
    (tmp_path / "thing.c").write_text(SOURCE + "\n")
    with pytest.raises(SystemExit):
        project("", "--judge")


def test_what_is_listed_as_equivalent_does_not_count_and_what_is_killed_is_stale(project, capsys):
    killed = "alive: it once was\n  thing.c\n  - a -= 100u;\n  + ;\n"
    claims = project("equivalent: nobody asks for 10\n" + SURVIVORS + killed)
    assert claims["mutation-score"]["figure"].startswith("100.0 %")
    assert claims["mutation-score"]["holds"]
    assert not claims["mutation-survivors"]["holds"]
    assert claims["mutation-survivors"]["figure"].endswith("0 unlisted, 1 stale")
    assert "no longer true" in capsys.readouterr().out


# --- judging, without running anything ---

A = mutants.Mutant("m", "a.c", 1, "x = 0;", ";", "")
TWIN = mutants.Mutant("m", "a.c", 9, "x = 0;", ";", "")
ENTRY = "alive: why\n  a.c\n  - x = 0;\n  + ;\n"


def judged(results, register, everything=(A, TWIN)):
    return mutants.judge(results, mutants.Register(register), list(everything))


def test_each_of_equal_lines_is_listed_by_itself():
    both = [(A, "alive"), (TWIN, "alive")]
    assert judged(both, "")["unlisted"] == [A.key()] * 2
    assert judged(both, ENTRY)["unlisted"] == [A.key()]
    assert judged(both, ENTRY + ENTRY)["unlisted"] == []
    one = [(A, "alive"), (TWIN, "killed")]
    assert judged(one, ENTRY)["unlisted"] == judged(one, ENTRY)["stale"] == []
    assert judged(one, ENTRY + ENTRY)["stale"] == [A.key()]


def test_a_sample_calls_nothing_stale_that_it_has_not_tried():
    assert judged([(A, "killed")], ENTRY)["stale"] == []
    assert judged([(A, "killed"), (TWIN, "killed")], ENTRY)["stale"] == [A.key()]
    assert judged([], ENTRY, [])["stale"] == [A.key()]  # there is no such line


def test_what_was_not_decided_is_not_killed():
    found = judged([(A, "busy"), (TWIN, "killed")], "")
    assert (found["kinds"]["killed"], found["valid"]) == (1, 2)


@pytest.mark.parametrize("text", [
    "  a.c\n", "alive: why\n  - x\n", "alive: why\n  a.c\n  + x\n", "alive:\n", "dead: why\n",
    ENTRY + "alive: more\n  - y\n", ENTRY + ENTRY.replace("alive", "equivalent"),
])
def test_a_register_that_is_not_understood_is_refused(text):
    with pytest.raises(SystemExit):
        mutants.Register(text)


def test_the_register_of_the_tree_is_of_lines_that_are_there():
    there = {mutant.key() for mutant in mutation.all_mutants(mutation.MODULES)}
    register = mutants.Register(mutation.REGISTER.read_text())
    assert [key for key in register.count if key not in there] == []
