"""Functions stay small: these are the figures that are claimed, without exceptions."""

import lizard
import pytest

from tree import ROOT, files, name

LENGTH_MAX = 60
COMPLEXITY_MAX = 15
PARAMETERS_MAX = 6


def python_script(path):
    return not path.suffix and path.read_bytes().startswith(b"#!/usr/bin/env python")


def sources():
    found = []
    for folder in ("firmware", "hal", "host_sim", "tools"):
        found += files(".c", ".h", ".py", under=ROOT / folder)
        found += [path for path in files("", under=ROOT / folder) if python_script(path)]
    return found


def functions(path):
    text = path.read_text()
    shown = str(path) if path.suffix else f"{path}.py"
    return lizard.analyze_file.analyze_source_code(shown, text).function_list


@pytest.mark.parametrize("path", sources(), ids=name)
def test_function_budgets(path):
    over = [
        f"{function.name}: {function.length} lines, complexity "
        f"{function.cyclomatic_complexity}, {function.parameter_count} parameters"
        for function in functions(path)
        if function.length > LENGTH_MAX
        or function.cyclomatic_complexity > COMPLEXITY_MAX
        or function.parameter_count > PARAMETERS_MAX
    ]
    assert over == []


def test_functions_are_seen():
    assert len(functions(ROOT / "firmware" / "src" / "controller.c")) > 3
