#!/usr/bin/env python3
"""Draws what margin there is: how often a robot collides that is worse than its firmware was told, and
how near robots come that are as told.

    violation.py VIOLATION.parquet IDEAL.parquet DYNAMICS.parquet LATE.parquet FIGURE.png

The files are those of `tools/campaign'. On the left the collision rate over the violation of the
clearance condition, the part of the demanded C - R that is missing. Bars are 95 % intervals (Wilson);
an arrow is a bin without a collision, from the upper end of its interval. On the right, of robots that
meet the condition, the part of the runs in which the least clearance is below a value; each line ends
at the worst run.
"""

import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet
from matplotlib.ticker import FuncFormatter

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "lib"))

import style  # noqa: E402
from campaign_table import wilson  # noqa: E402

BIN = 5.0  # % of violation
RUNS_MIN = 100  # in a bin
POINTS = 2000  # of a line
CAMPAIGNS = (("exact drives and poses", style.BLUE, "solid"),
             ("lag, limits, noise, slip", style.ORANGE, (0, (5, 1.4))),
             ("the same, poses up to 0.2 s late", style.PURPLE, (0, (3, 1, 1, 1))))


def load(path, *columns):
    table = pyarrow.parquet.read_table(path, columns=list(columns))
    return [table[column].to_numpy() for column in columns]


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


def draw_violation(axes, path):
    violation, collisions = load(path, "violation", "collisions")
    rows = list(binned(100.0 * violation, collisions > 0, BIN))
    axes.set_xlim(rows[0][0] - BIN, rows[-1][0] + BIN)
    draw_rates(axes, rows, style.VERMILION)
    axes.set_yscale("log")
    low, _ = axes.get_ylim()
    axes.set_ylim(max(low, 1e-6), 1.0)
    axes.axvspan(axes.get_xlim()[0], 0.0, color="#E8F3EC", zorder=0, linewidth=0)
    axes.axvline(0.0, color=style.GREEN, linewidth=1.0, zorder=1)
    axes.text(0.0, 0.97, " condition met to the left", transform=axes.get_xaxis_transform(), color=style.GREEN,
              fontsize=8, va="top", ha="left")
    axes.set_xlabel("missing of the demanded C \N{MINUS SIGN} R, %")
    axes.set_ylabel("runs that collide")


def draw_clearance(axes, paths):
    for path, (name, colour, dashes) in zip(paths, CAMPAIGNS):
        clearance, = load(path, "min_clearance_m")
        clearance = 1000.0 * np.sort(clearance)
        picked = np.unique(np.round(np.geomspace(1, len(clearance), POINTS)).astype(int))
        axes.plot(clearance[picked - 1], picked / len(clearance), color=colour, linestyle=dashes, label=name)
        axes.plot(clearance[0], 1.0 / len(clearance), marker="o", markersize=3.2, color=colour)
    axes.set_yscale("log")
    axes.set_xlim(-15.0, 200.0)
    axes.axvspan(axes.get_xlim()[0], 0.0, color="#F6E4DC", zorder=0, linewidth=0)
    axes.axvline(0.0, color=style.VERMILION, linewidth=1.0, zorder=1)
    axes.set_xlabel("least clearance of a run, mm")
    axes.set_ylabel("runs that come nearer")
    axes.legend(loc="lower right", fontsize=7.5)


def draw(violation, campaigns):
    figure = style.new_figure(7.2, 2.9)
    left, right = figure.subplots(1, 2)
    draw_violation(left, violation)
    draw_clearance(right, campaigns)
    for axes in (left, right):
        axes.yaxis.set_major_formatter(FuncFormatter(lambda rate, _: f"{100.0 * rate:g} %"))
    return figure


def main():
    if len(sys.argv) != 6 or not sys.argv[5].endswith(".png"):
        print("violation.py: usage: violation.py VIOLATION IDEAL DYNAMICS LATE FIGURE.png", file=sys.stderr)
        return 2
    style.apply()
    try:
        style.save(draw(sys.argv[1], sys.argv[2:5]), sys.argv[5].removesuffix(".png"), ("png",))
    except (OSError, KeyError, ValueError) as error:
        print(f"violation.py: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
