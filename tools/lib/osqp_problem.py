"""Writes OSQP's generated code for the constrained tracker's problem.

osqp_problem.py HORIZON FOLDER: the solver's sources go to FOLDER, with osqp_problem.h, which says
where the numbers are that change from step to step. Variables are e_1 ... e_N, u_0 ... u_{N-1}.
"""

import sys
from pathlib import Path

import numpy as np
import osqp
import scipy.sparse as sparse

PERIOD_S = 0.05
HALF_TRACK_M = 0.15
Q = [10.0, 40.0, 1.0]
R = [0.5, 0.1]
TOLERANCE = 1e-4
# Stands where turn and way will be, so that the entries exist and can be found again.
TURN, WAY = 0.011, 0.022


def matrices(n):
    """(P, A) of min x'Px/2, low <= A x <= high; A_0 e_0 is in the bounds."""
    weights = np.concatenate([np.tile(Q, n), np.tile(R, n)])
    rows = sparse.lil_matrix((5 * n, 5 * n))
    transition = np.array([[1, TURN, 0], [-TURN, 1, WAY], [0, 0, 1]])
    inputs = PERIOD_S * np.array([[1, 0], [0, 0], [0, 1]])
    rims = np.array([[1, HALF_TRACK_M], [1, -HALF_TRACK_M]])
    for i in range(n):
        state, effort = 3 * i, 3 * n + 2 * i
        rows[state : state + 3, state : state + 3] = np.eye(3)
        if i > 0:
            rows[state : state + 3, state - 3 : state] = -transition
        rows[state : state + 3, effort : effort + 2] = -inputs
        rows[effort : effort + 2, effort : effort + 2] = rims
    a = rows.tocsc()
    a.eliminate_zeros()
    a.sort_indices()
    return sparse.diags(2 * weights, format="csc"), a


def positions(a, n):
    """Where -turn, turn and -way of the stages 1 to N - 1 are among A's values."""
    found = []
    for i in range(1, n):
        for row, column in ((0, 1), (1, 0), (1, 2)):
            column += 3 * (i - 1)
            span = slice(a.indptr[column], a.indptr[column + 1])
            found.append(a.indptr[column] + int(np.where(a.indices[span] == 3 * i + row)[0][0]))
    return found


def main():
    n, folder = int(sys.argv[1]), Path(sys.argv[2])
    p, a = matrices(n)
    bound = np.ones(5 * n)
    solver = osqp.OSQP()
    solver.setup(p, np.zeros(5 * n), a, -bound, bound, eps_abs=TOLERANCE, eps_rel=TOLERANCE,
                 max_iter=4000, check_termination=10, verbose=False)
    solver.codegen(str(folder), parameters="matrices", use_float=True, force_rewrite=True)
    index = ", ".join(map(str, positions(a, n)))
    (folder / "osqp_problem.h").write_text(
        f"#define N {n}\n#define ROWS {5 * n}\n"
        f"static const OSQPInt turning_index[{3 * (n - 1)}] = {{{index}}};\n")


if __name__ == "__main__":
    main()
