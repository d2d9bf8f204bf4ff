"""The constrained tracker against bounded least squares in double precision.

berth-constrained solves a problem a line, from a cold start, and prints the iterate after each
pass. scipy's lsq_linear solves the same problem in its stacked form.
"""

import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from problems import KINDS, Problem, draw_all

PROGRAM = Path(os.environ["BERTH_BUILD_DIR"]) / "tests" / "berth-constrained"
SHORT = os.environ.get("BERTH_TEST_EFFORT") == "short"
SEED = int(os.environ.get("BERTH_TEST_SEED", "20240917"))
COUNT = 1050 if SHORT else 10500
INPUT_LIMIT = 1e-4
RESIDUAL_LIMIT = 1e-4
PASSES_MAX = 8
# Of all problems, those that 8 passes from a cold start do not finish: all have long horizons.
STOPPED_SHARE = 0.01


class Answer:
    def __init__(self, problem, line):
        fields = line.split()
        self.passes, self.stopped, self.limited = (int(field) for field in fields[:3])
        self.first = problem.z_of_twist(float(fields[3]), float(fields[4]))
        inputs = np.array([float(field) for field in fields[5:]]).reshape(-1, problem.horizon, 2)
        self.iterates = [(one @ problem.rims().T).ravel() for one in inputs]


def solve(problems):
    text = "".join(problem.line() + "\n" for problem in problems)
    run = subprocess.run([PROGRAM], input=text, capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stderr
    lines = run.stdout.splitlines()
    assert len(lines) == len(problems)
    return [Answer(problem, line) for problem, line in zip(problems, lines)]


@pytest.fixture(scope="module")
def solved():
    print(f"seed {SEED} (BERTH_TEST_SEED)")
    problems = draw_all(SEED, COUNT)
    return list(zip(problems, solve(problems)))


@pytest.fixture(scope="module")
def optima(solved):
    return [problem.optimum() for problem, _ in solved]


def test_the_reference_itself_is_optimal(solved, optima):
    worst = max(problem.residual(z) for (problem, _), z in zip(solved, optima))
    assert worst < 1e-8


def test_first_input_is_the_optimum(solved, optima):
    table = {kind: [0, 0, 0, 0.0] for kind in KINDS}
    for (problem, answer), z in zip(solved, optima):
        row = table[problem.kind]
        row[0] += 1
        row[1] += answer.limited
        row[2] += answer.stopped
        if not answer.stopped:
            row[3] = max(row[3], float(np.max(np.abs(answer.first - z[:2]))))
    for kind, (count, limited, stopped, worst) in table.items():
        print(f"{kind}: {count} problems, {limited} limited, {stopped} stopped, worst {worst:.2e}")
    assert max(row[3] for row in table.values()) <= INPUT_LIMIT
    assert sum(row[2] for row in table.values()) <= STOPPED_SHARE * len(solved)
    # all kinds have to exercise the limits
    assert all(row[1] >= 0.3 * row[0] for row in table.values())


def test_optimality_residual(solved):
    residuals = [problem.residual(answer.iterates[-1]) for problem, answer in solved
                 if answer.limited and not answer.stopped]
    print(f"worst residual {max(residuals):.2e} of {len(residuals)}")
    assert len(residuals) > len(solved) / 2
    assert max(residuals) <= RESIDUAL_LIMIT


def test_the_cost_never_rises(solved):
    rises = []
    for problem, answer in solved:
        costs = [problem.cost(z) for z in answer.iterates]
        # inputs are float32: 1e-7 m/s of rounding, times slopes of 1e-4 in the smallest problems
        rises += [after - before - 2e-6 * before for before, after in zip(costs, costs[1:])]
    assert len(rises) > len(solved) / 4
    assert max(rises) <= 1e-11


def test_every_iterate_is_feasible(solved):
    for problem, answer in solved:
        low, high = problem.box()
        for z in answer.iterates:
            beyond = np.max(np.maximum(low - z, z - high))
            assert beyond <= 1e-6 * (problem.rim_mps + np.max(np.abs(z)))


def test_passes(solved):
    counts = np.bincount([answer.passes for _, answer in solved], minlength=PASSES_MAX + 1)
    print("problems by passes from 1:", *counts[1:])
    assert len(counts) == PASSES_MAX + 1
    assert counts[0] == 0
    assert counts[1] + counts[2] > 0.6 * len(solved)


def test_wheels_that_stay_saturated():
    """Both wheels, and one, at their limits in every stage: the optimum is the limit itself."""
    n = 20
    weights = {"q": [10, 40, 1], "r": [0.5, 0.1]}
    fast = Problem("both", 0.05, 0.3, 0.5, error=[1, 0, 0], v=[0.8] * n, omega=[0] * n, **weights)
    turning = Problem("one", 0.05, 0.3, 0.5, error=[0.1, 0.3, 0.5], v=[0.6] * n, omega=[1] * n,
                      **weights)
    for problem, answer in zip((fast, turning), solve([fast, turning])):
        z = problem.optimum()
        low, high = problem.box()
        at_limit = np.minimum(z - low, high - z).reshape(n, 2) < 1e-9
        assert at_limit.all(axis=0).any()
        assert not answer.stopped
        assert np.max(np.abs(answer.iterates[-1] - z)) < INPUT_LIMIT


@pytest.mark.parametrize("error", [[0, 0, 0], [1e-6, 0, 0], [0, 1e-6, 0], [0, 0, -1e-6]])
def test_references_exactly_at_the_limit(error):
    n = 20
    problem = Problem("edge", 0.05, 0.3, 0.5, [10, 40, 1], [0.5, 0.1], error, [0.5] * n, [0] * n)
    answer = solve([problem])[0]
    assert not answer.stopped
    assert np.max(np.abs(answer.first - problem.optimum()[:2])) < 1e-5


@pytest.mark.parametrize("line", ["41", "20 0.05 0.3", "x"])
def test_the_program_refuses_what_is_not_a_problem(line):
    run = subprocess.run([PROGRAM], input=line + "\n", capture_output=True, text=True, timeout=30)
    assert run.stdout == ""
