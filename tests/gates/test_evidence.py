"""The page of evidence and the README's quotes are what the stored figures say; tools/verify can fail."""

import json
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import pytest

from tree import ROOT

sys.path.insert(0, str(ROOT / "tools" / "lib"))
import verify  # noqa: E402

GOOD = {"id": "a", "claim": "c", "figure": "1 of 1", "command": "x", "holds": True, "exact": True}


def test_page_is_what_the_figures_say():
    assert verify.PAGE.read_text() == verify.page_text(), "tools/verify --page"


def test_readme_quotes_the_page():
    assert verify.README.read_text() == verify.readme_text(), "tools/verify --page"


@pytest.mark.parametrize("name", [part[0] for part in verify.PARTS])
def test_every_part_is_there_and_has_figures(name):
    assert verify.script_of(name).exists()
    result = verify.stored(name)
    assert result is not None and result["claims"], f"tools/verify --write {name}"
    assert [claim["id"] for claim in result["claims"] if not claim["holds"]] == []


def test_every_quote_has_a_claim():
    claims = {claim["id"] for name, _, _ in verify.PARTS for claim in verify.stored(name)["claims"]}
    assert [quote for quote, _ in verify.QUOTES if quote not in claims] == []


def test_ids_are_unique():
    ids = [claim["id"] for name, _, _ in verify.PARTS for claim in verify.stored(name)["claims"]]
    assert len(ids) == len(set(ids))


@pytest.fixture
def parts(tmp_path, monkeypatch):
    """One part, "toy", whose script the test writes; evidence and build go to a folder of the test's."""
    monkeypatch.setattr(verify, "PARTS", (("toy", "A toy", 1.0),))
    monkeypatch.setattr(verify, "BUILD", tmp_path)
    monkeypatch.setattr(verify, "EVIDENCE", tmp_path / "evidence")
    monkeypatch.setattr(verify, "script_of", lambda name: tmp_path / f"{name}.py")
    return tmp_path


def run(folder, monkeypatch, result, status=0, options=("--short",)):
    body = f"import json, sys\nopen(sys.argv[2], 'w').write(json.dumps({result!r}))\nsys.exit({status})\n"
    (folder / "toy.py").write_text(body)
    monkeypatch.setattr(sys, "argv", ["verify", "--junit", str(folder / "out.xml"), *options])
    return verify.main()


def failures(folder):
    top = ElementTree.parse(folder / "out.xml").getroot()
    return {case.get("name"): case.find("failure").get("message") for case in top.iter("testcase")
            if case.find("failure") is not None}


def store(folder, **changes):
    (folder / "evidence").mkdir()
    text = json.dumps({"claims": [dict(GOOD, **changes)], "notes": []})
    (folder / "evidence" / "toy.json").write_text(text)


def test_a_claim_that_holds_passes(parts, monkeypatch):
    store(parts)
    assert run(parts, monkeypatch, {"claims": [GOOD]}) == 0
    assert failures(parts) == {}


def test_a_claim_that_does_not_hold_fails(parts, monkeypatch):
    store(parts)
    assert run(parts, monkeypatch, {"claims": [dict(GOOD, holds=False)]}) == 1
    assert failures(parts) == {"a": "does not hold"}


def test_another_exact_figure_than_on_the_page_fails(parts, monkeypatch):
    store(parts, figure="2 of 2")
    assert run(parts, monkeypatch, {"claims": [GOOD]}) == 1
    assert "'2 of 2'" in failures(parts)["a"]


def test_a_figure_that_depends_on_the_time_may_differ(parts, monkeypatch):
    store(parts, figure="2 of 2")
    assert run(parts, monkeypatch, {"claims": [dict(GOOD, exact=False)]}) == 0


@pytest.mark.parametrize("result", [{"claims": []}, {}, {"claims": [{"id": "a"}]}], ids=["empty", "none", "keys"])
def test_a_part_without_claims_fails(parts, monkeypatch, result):
    assert run(parts, monkeypatch, result) == 1
    assert "no usable result" in failures(parts)["runs"]


def test_a_part_that_breaks_fails(parts, monkeypatch):
    store(parts)
    assert run(parts, monkeypatch, {"claims": [GOOD]}, status=3) == 1
    assert failures(parts) == {"runs": "ended with status 3"}


def test_bad_usage_is_2():
    for arguments in (["nothing"], ["--minutes", "0"], ["--minutes", "nan"], ["--short", "--write"]):
        done = subprocess.run([sys.executable, "-B", str(ROOT / "tools" / "lib" / "verify.py"), *arguments],
                              capture_output=True, text=True)
        assert done.returncode == 2 and done.stderr, arguments
