"""Functions stay small: these are the figures that are claimed, without exceptions.

Tests are held to the same length; a model of a controller is one switch over its registers."""

import lizard
import pytest

from tree import ROOT, files, name

LENGTH_MAX = 60
COMPLEXITY_MAX = 15
PARAMETERS_MAX = 6
TEST_COMPLEXITY_MAX = 20
TEST_PARAMETERS_MAX = 8


def python_script(path):
    return not path.suffix and path.read_bytes().startswith(b"#!/usr/bin/env python")


def sources(*folders):
    found = []
    for folder in folders:
        found += files(".c", ".h", ".py", under=ROOT / folder)
        found += [path for path in files("", under=ROOT / folder) if python_script(path)]
    return found


def functions(path):
    text = path.read_text()
    shown = str(path) if path.suffix else f"{path}.py"
    return lizard.analyze_file.analyze_source_code(shown, text).function_list


def over(path, complexity_max, parameters_max):
    return [
        f"{function.name}: {function.length} lines, complexity "
        f"{function.cyclomatic_complexity}, {function.parameter_count} parameters"
        for function in functions(path)
        if function.length > LENGTH_MAX
        or function.cyclomatic_complexity > complexity_max
        or function.parameter_count > parameters_max
    ]


@pytest.mark.parametrize("path", sources("firmware", "hal", "host_sim", "tools"), ids=name)
def test_function_budgets(path):
    assert over(path, COMPLEXITY_MAX, PARAMETERS_MAX) == []


@pytest.mark.parametrize("path", sources("tests"), ids=name)
def test_budgets_of_tests(path):
    assert over(path, TEST_COMPLEXITY_MAX, TEST_PARAMETERS_MAX) == []


def test_functions_are_seen():
    assert len(functions(ROOT / "firmware" / "src" / "controller.c")) > 3
