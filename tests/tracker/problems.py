"""Tracking problems with limits, and their optimum in double precision.

A problem is solved in its stacked form: E = F e + G U, with U expressed in the rims' travel z, so
that the limits are a box; scipy's bounded least squares shares nothing with the Riccati passes.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear


@dataclass
class Problem:
    kind: str
    period_s: float
    track_m: float
    rim_mps: float
    q: np.ndarray
    r: np.ndarray
    error: np.ndarray
    v: np.ndarray  # of the reference, one for each stage
    omega: np.ndarray
    change_mps2: float = 0.0
    last: tuple = (0.0, 0.0)

    def __post_init__(self):
        """What the program reads is float32; the reference solves the same numbers."""
        for name in ("period_s", "track_m", "rim_mps", "change_mps2"):
            setattr(self, name, float(np.float32(getattr(self, name))))
        for name in ("q", "r", "error", "v", "omega"):
            setattr(self, name, np.asarray(getattr(self, name), np.float32).astype(float))
        self.last = tuple(float(np.float32(value)) for value in self.last)

    @property
    def horizon(self):
        return len(self.v)

    def line(self):
        values = [self.period_s, self.track_m, self.rim_mps, *self.q, *self.r, *self.error,
                  self.change_mps2, *self.last]
        for pair in zip(self.v, self.omega):
            values += pair
        return f"{self.horizon} " + " ".join(f"{value:.9g}" for value in values)

    def rims(self):
        """M of z = M u."""
        half = self.track_m / 2
        return np.array([[1.0, half], [1.0, -half]])

    def box(self):
        """Lower and upper bounds of all z, stage by stage, right wheel first."""
        v = self.v.copy()
        v[0] *= np.cos(self.error[2])
        base = np.stack([v, self.omega], axis=1) @ self.rims().T
        low = np.full(base.shape, -self.rim_mps)
        high = np.full(base.shape, self.rim_mps)
        if self.change_mps2 > 0:
            last = self.rims() @ np.array(self.last)
            change = self.change_mps2 * self.period_s
            low[0] = np.clip(last - change, -self.rim_mps, self.rim_mps)
            high[0] = np.clip(last + change, -self.rim_mps, self.rim_mps)
        return (base - high).ravel(), (base - low).ravel()

    def stacked(self):
        """(matrix, target): the cost of z is |matrix z - target|^2."""
        n = self.horizon
        free = self.error.copy()
        inputs = np.zeros((3, 2 * n))
        to_u = np.linalg.inv(self.rims())
        b = self.period_s * np.array([[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]]) @ to_u
        rows, target = [], []
        weight = np.sqrt(self.q)[:, None]
        for i in range(n):
            turn, way = self.period_s * self.omega[i], self.period_s * self.v[i]
            a = np.array([[1.0, turn, 0.0], [-turn, 1.0, way], [0.0, 0.0, 1.0]])
            free = a @ free
            inputs = a @ inputs
            inputs[:, 2 * i : 2 * i + 2] += b
            rows.append(weight * inputs)
            target.append(-weight[:, 0] * free)
        effort = np.sqrt(self.r)[:, None] * to_u
        rows.append(np.kron(np.eye(n), effort))
        target.append(np.zeros(2 * n))
        return np.vstack(rows), np.concatenate(target)

    def optimum(self):
        """All z in double precision."""
        matrix, target = self.stacked()
        result = lsq_linear(matrix, target, self.box(), method="bvls", tol=1e-14, max_iter=2000)
        return result.x

    def cost(self, z):
        matrix, target = self.stacked()
        return float(np.sum((matrix @ z - target) ** 2))

    def residual(self, z):
        """Of the optimality conditions: how far a rim would move, alone, to lower the cost, m/s."""
        matrix, target = self.stacked()
        low, high = self.box()
        step = matrix.T @ (matrix @ z - target) / np.sum(matrix * matrix, axis=0)
        return float(np.max(np.abs(np.clip(z - step, low, high) - z)))

    def z_of_twist(self, v, omega):
        first = np.array([self.v[0] * np.cos(self.error[2]), self.omega[0]])
        return self.rims() @ (first - np.array([v, omega]))


def wander(random, n, mean, spread, rate):
    """A smooth random sequence around a mean."""
    steps = random.normal(0.0, 1.0, n)
    out = np.empty(n)
    value = random.normal(0.0, 1.0)
    for i in range(n):
        value += rate * (steps[i] - value)
        out[i] = mean + spread * value
    return out


def draw(random, kind):
    """One problem of a kind: feasible, infeasible, corner, one_wheel, both_wheels, change, wide."""
    n = int(random.choice([1, 2, 5, 10, 20, 20, 20, 40]))
    period = float(random.choice([0.02, 0.05, 0.05, 0.1]))
    track = random.uniform(0.15, 0.6)
    rim = random.uniform(0.3, 1.5)
    q = np.array([10.0, 40.0, 1.0]) * 10 ** random.uniform(-0.7, 0.7, 3)
    r = np.array([0.5, 0.1]) * 10 ** random.uniform(-0.7, 0.7, 2)
    error = random.normal(0.0, 1.0, 3) * np.array([0.2, 0.2, 0.4]) * 10 ** random.uniform(-1, 0.5)
    fast = rim * random.uniform(0.2, 0.9)
    turn = random.uniform(-1.0, 1.0) * (rim - fast) * 2 / track
    extra = {}
    if kind == "infeasible":
        fast = rim * random.uniform(1.0, 1.6)
        turn = random.uniform(-1.0, 1.0) * rim * 2 / track
    elif kind == "one_wheel":
        fast = rim * random.uniform(0.3, 0.9)
        turn = random.choice([-1, 1]) * (rim * random.uniform(1.05, 1.6) - fast) * 2 / track
    elif kind == "both_wheels":
        fast, turn = rim * random.choice([-1, 1]) * random.uniform(1.05, 2.0), 0.0
        error *= 0.3
    v = wander(random, n, fast, 0.1 * rim, 0.3)
    # half a radian a period: beyond that the linear model of a turn means nothing
    omega = np.clip(wander(random, n, turn, 0.2 * rim / track, 0.3), -0.5 / period, 0.5 / period)
    if kind == "corner":
        # standing or straight references exactly at the limit, errors zero or along one axis
        fast = rim * random.choice([0.0, 1.0, -1.0])
        v, omega = np.full(n, fast), np.zeros(n)
        error *= random.choice([0, 1], 3) * random.choice([1e-4, 1.0])
    elif kind == "change":
        extra = {"change_mps2": random.uniform(0.2, 5.0)}
        last = np.linalg.inv([[1, track / 2], [1, -track / 2]]) @ random.uniform(-rim, rim, 2)
        extra["last"] = tuple(last)
    elif kind == "wide":
        error *= 10
    return Problem(kind, period, track, rim, q, r, error, v, omega, **extra)


KINDS = ("feasible", "infeasible", "corner", "one_wheel", "both_wheels", "change", "wide")


def draw_all(seed, count):
    random = np.random.default_rng(seed)
    return [draw(random, KINDS[i % len(KINDS)]) for i in range(count)]
