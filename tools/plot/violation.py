#!/usr/bin/env python3
"""Draws how often a robot collides when it is worse than its firmware was told.

    violation.py VIOLATION.parquet LATE.parquet FIGURE.png

The files are those of `tools/campaign violation' and `tools/campaign late'. On the left the rate over
the violation of the clearance condition, the part of the demanded C - R that is missing; on the right
over the angle by which the known heading may be old, omega_max times the pose's delay. Bars are 95 %
intervals (Wilson); an arrow is a bin without a collision, from the upper end of its interval.
"""

import json
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet
from matplotlib.ticker import FuncFormatter

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "lib"))

import style  # noqa: E402
from campaign_table import wilson  # noqa: E402

OMEGA_MAX = 3.0  # of the campaign's scenes, unless it was set
LIMIT_RAD = 0.15
VIOLATION_BIN, ANGLE_BIN = 0.05, 0.05
RUNS_MIN = 100  # in a bin


def omega_max(arguments):
    """The last one that was set."""
    sets = [value.partition("=") for value in arguments]
    found = [float(value) for key, _, value in sets if key == "robot.omega_max_radps"]
    return found[-1] if found else OMEGA_MAX


def load(path, column):
    table = pyarrow.parquet.read_table(path, columns=[column, "collisions"])
    arguments = json.loads(table.schema.metadata[b"berth"])["arguments"]
    return table[column].to_numpy(), table["collisions"].to_numpy() > 0, arguments


def binned(values, collided, width):
    """(middle, hits, runs) of each bin with enough runs."""
    numbers = np.floor(np.round(values / width, 9)).astype(int)
    for number in np.unique(numbers):
        inside = numbers == number
        if inside.sum() >= RUNS_MIN:
            yield (number + 0.5) * width, int(collided[inside].sum()), int(inside.sum())


def draw_rates(axes, rows, colour):
    for middle, hits, runs in rows:
        low, high = wilson(hits, runs)
        if hits == 0:
            axes.annotate("", (middle, high / 3.0), (middle, high), annotation_clip=False,
                          arrowprops={"arrowstyle": "-|>,head_width=0.16,head_length=0.3", "color": style.GREY,
                                      "linewidth": 0.8, "shrinkA": 0, "shrinkB": 0})
            axes.plot(middle, high, marker="_", markersize=5, color=style.GREY)
            continue
        rate = hits / runs
        axes.errorbar(middle, rate, yerr=[[rate - low], [high - rate]], color=colour, marker="o", markersize=3.2,
                      linewidth=0.9, capsize=1.8, capthick=0.9)


def finish(axes, label, limit, name):
    axes.set_yscale("log")
    axes.set_xlabel(label)
    axes.axvspan(axes.get_xlim()[0], limit, color="#E8F3EC", zorder=0, linewidth=0)
    axes.axvline(limit, color=style.GREEN, linewidth=1.0, zorder=1)
    axes.text(limit, 0.97, f" {name}", transform=axes.get_xaxis_transform(), color=style.GREEN, fontsize=8,
              va="top", ha="left")


def draw(violation_path, late_path):
    violation, collided, _ = load(violation_path, "violation")
    delay, late_collided, arguments = load(late_path, "pose_delay_s")
    figure = style.new_figure(7.2, 2.9)
    left, right = figure.subplots(1, 2, sharey=True)
    rows = list(binned(100.0 * violation, collided, 100.0 * VIOLATION_BIN))
    left.set_xlim(rows[0][0] - 5.0, rows[-1][0] + 5.0)
    draw_rates(left, rows, style.VERMILION)
    finish(left, "missing of the demanded C \N{MINUS SIGN} R, %", 0.0, "condition met to the left")
    left.set_ylabel("runs that collide")
    rows = list(binned(omega_max(arguments) * delay, late_collided, ANGLE_BIN))
    right.set_xlim(0.0, rows[-1][0] + 0.5 * ANGLE_BIN)
    draw_rates(right, rows, style.BLUE)
    finish(right, r"$\omega_\mathrm{max}$ times the pose's delay, rad", LIMIT_RAD, "0.15 rad")
    low, _ = left.get_ylim()
    left.set_ylim(max(low, 1e-6), 1.0)
    left.yaxis.set_major_formatter(FuncFormatter(lambda rate, _: f"{100.0 * rate:g} %"))
    return figure


def main():
    if len(sys.argv) != 4 or not sys.argv[3].endswith(".png"):
        print(__doc__.partition("\n\n")[2].partition("\n\n")[0].strip(), file=sys.stderr)
        return 2
    style.apply()
    try:
        style.save(draw(sys.argv[1], sys.argv[2]), sys.argv[3].removesuffix(".png"), ("png",))
    except (OSError, KeyError, ValueError) as error:
        print(f"violation.py: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
