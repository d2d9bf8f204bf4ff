"""A scene as berth-sim describes it: obstacles, and for each run its log and summary."""

import csv
import dataclasses
import json
import pathlib

import numpy as np

MODES = ("track", "regulated", "conservative_turn", "conservative_go", "blocked")


@dataclasses.dataclass(frozen=True)
class Run:
    strategy: str
    stem: pathlib.Path  # where figures of this run alone go, without their ending
    summary: dict
    mode: np.ndarray  # names, one a period
    columns: dict  # the log's other columns by name

    def __getitem__(self, column):
        return self.columns[column]

    @property
    def position_error(self):
        return np.hypot(self["x_r"] - self["x"], self["y_r"] - self["y"])

    def stretches(self):
        """(mode, first row, row after the last) of each stretch in one mode."""
        changes = np.flatnonzero(self.mode[1:] != self.mode[:-1]) + 1
        bounds = [0, *changes.tolist(), len(self.mode)]
        return [(self.mode[a], a, b) for a, b in zip(bounds, bounds[1:])]


@dataclasses.dataclass(frozen=True)
class Scene:
    name: str
    stem: pathlib.Path  # where the figures go, without their ending
    period: float
    skirt: float
    obstacles: list
    runs: list


def _read_log(path):
    with open(path, newline="", encoding="utf-8") as file:
        rows = csv.reader(file)
        header = next(rows)
        table = list(zip(*rows))
    if not table:
        raise ValueError(f"{path}: no rows")
    named = dict(zip(header, table))
    mode = np.array(named.pop("mode"))
    columns = {name: np.array(values, dtype=float) for name, values in named.items()}
    columns["clearance"][~np.isfinite(columns["clearance"])] = np.nan
    return mode, columns


def load(path):
    """Reads the JSON file; the logs lie beside it."""
    path = pathlib.Path(path)
    with open(path, encoding="utf-8") as file:
        data = json.load(file)
    runs = []
    for entry in data["runs"]:
        log = path.parent / entry["log"]
        runs.append(Run(entry["strategy"], log.with_suffix(""), entry["summary"], *_read_log(log)))
    return Scene(data["name"], path.with_suffix(""), data["period_s"], data["skirt_m"],
                 data["obstacles"], runs)
