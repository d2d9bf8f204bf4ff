"""Every loop of the firmware has its bound in tests/proof/loops.md, and what only counts is told from what does not."""

import sys
from pathlib import Path

import pytest
from tree import ROOT

sys.path.insert(0, str(ROOT / "tools/lib"))
import proof_loops

COUNTING = [
    ("for (int i = 0; i < end; i++)", ["    sum += i;"]),
    ("for (int j = i; j >= 0; j--)", ["    read(j);"]),
    ("for (uint32_t left = 400; left > 0u && used > 0u; left -= used)", ["    used = scan(left);"]),
    ("while (i < end)", ["    add(i);", "    i++;"]),
    ("for (;;)", ["    add(i);", "    if (i == 0) {", "        return;", "    }", "    i--;"]),
]
OTHERS = [
    ("for (int i = 0; i < end; i++)", ["    i--;"]),
    ("for (int i = 0; i < end; i++)", ["    i = 0;"]),
    ("for (int i = 0; other < end; i++)", ["    add(i);"]),
    ("for (int i = 0; i != end; i += 2)", ["    add(i);"]),
    ("for (uint32_t left = 400; left > 0u; left -= used)", ["    used = scan(left);"]),
    ("while (i < end)", ["    add(i);"]),
    ("for (;;)", ["    add(i);", "    i--;"]),
]


@pytest.mark.parametrize("loop, body", COUNTING)
def test_what_counts(loop, body):
    assert proof_loops.counts(loop, body)


@pytest.mark.parametrize("loop, body", OTHERS)
def test_what_does_not_count(loop, body):
    assert not proof_loops.counts(loop, body)


def test_every_loop_has_a_bound(tmp_path):
    proof_loops.annotate(tmp_path)
    copies = "".join(path.read_text() for path in tmp_path.iterdir())
    assert copies.count("assert bound:") == len(proof_loops.asserted())
    assert copies.count("loop unroll") == len(proof_loops.unrolled())


def test_a_loop_without_a_bound_is_refused(tmp_path, monkeypatch):
    rows = proof_loops.table()
    rows.pop(next(key for key in rows if key[0] == "avoid.c"))
    monkeypatch.setattr(proof_loops, "table", lambda: rows)
    with pytest.raises(SystemExit, match="no bound for this loop"):
        proof_loops.annotate(tmp_path)


def test_a_bound_without_its_loop_is_refused(tmp_path, monkeypatch):
    rows = {**proof_loops.table(), ("avoid.c", "while (true)"): (1, "unroll")}
    monkeypatch.setattr(proof_loops, "table", lambda: rows)
    with pytest.raises(SystemExit, match="has no such loop"):
        proof_loops.annotate(tmp_path)


def test_a_loop_on_two_lines_is_refused(tmp_path):
    path = Path(tmp_path) / "two.c"
    path.write_text("void f(void) {\n    for (int i = 0;\n         i < 2; i++) {\n    }\n}\n")
    with pytest.raises(SystemExit, match="1 loops, of which 0"):
        proof_loops.loops(path)
