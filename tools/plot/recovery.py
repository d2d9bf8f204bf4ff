#!/usr/bin/env python3
"""Draws how soon the robot is back on its path, before and since avoidance reckons with delay.

    recovery.py BENCH FIGURE.png

BENCH is bench_recovery (see tools/bench/recovery.c). On top the share of encounters that are over, over
the time since avoidance first acted; below one encounter on the figure eight, which the robot rounds
too early before, and then follows the reference back into.
"""

import math
import subprocess
import sys

import style
from matplotlib.patches import Circle

LAG, SEED, RUNS = "0.1", "1", "1000"
PANELS = (("circle", "3", "circle, three obstacles a lap"), ("eight", "3", "figure eight, three obstacles a lap"))
RULES = (("before", "before", style.VERMILION), ("paced", "now", style.BLUE))
EXAMPLE = ("eight", "1", "42")
EXAMPLE_S = (1.5, 11.0)
VIEW_M = 1.5  # half the width of the example's window


def bench(binary, *arguments):
    return subprocess.run([binary, *arguments], check=True, stdout=subprocess.PIPE, text=True).stdout.splitlines()


def times_away(binary, shape, obstacles, rule):
    """Of each encounter; infinite where the next came first."""
    away = []
    for line in bench(binary, shape, obstacles, LAG, rule, SEED, RUNS):
        columns = line.split(",")
        time = float(columns[2]) + float(columns[3])
        away.append(math.inf if math.isnan(time) else time)
    return sorted(away)


def draw_shares(axes, binary, panel):
    shape, obstacles, title = panel
    for rule, label, colour in RULES:
        away = times_away(binary, shape, obstacles, rule)
        shares = [1.0 - i / len(away) for i in range(len(away))]
        axes.step(away, shares, where="post", color=colour, label=label)
    axes.set_yscale("log")
    axes.set_xlim(0.0, 18.0)
    axes.set_ylim(1.0e-4, 1.1)
    axes.set_title(title)
    axes.set_xlabel("time since avoidance began, s")


def trace(binary, rule):
    shape, obstacles, seed = EXAMPLE
    lines = [line.split(",") for line in bench(binary, shape, obstacles, LAG, rule, seed, "trace")]
    discs = [[float(value) for value in line[1:]] for line in lines if line[0] == "obstacle"]
    rows = [[float(value) for value in line] for line in lines if line[0] != "obstacle"]
    return discs, [row for row in rows if EXAMPLE_S[0] <= row[0] <= EXAMPLE_S[1]]


def draw_path(axes, binary, rule, label, colour):
    discs, rows = trace(binary, rule)
    for x, y, hard, conservative, regulated in discs:
        axes.add_patch(Circle((x, y), hard, color=style.HARD, alpha=0.5, linewidth=0))
        for radius, dashes in ((conservative, "solid"), (regulated, (0, (2, 2)))):
            axes.add_patch(Circle(
                (x, y), radius, fill=False, edgecolor=style.RING, linestyle=dashes, linewidth=0.7))
    axes.plot([row[6] for row in rows], [row[7] for row in rows], color=style.REFERENCE, linewidth=0.8,
              linestyle=(0, (4, 2)), label="reference")
    axes.plot([row[1] for row in rows], [row[2] for row in rows], color=colour, label=label)
    seconds = [row for row in rows if abs(row[0] - round(row[0])) < 1.0e-6]
    axes.plot([row[1] for row in seconds], [row[2] for row in seconds], ".", color=colour, markersize=4)
    axes.plot([row[6] for row in seconds], [row[7] for row in seconds], ".", color=style.REFERENCE, markersize=3)
    axes.set_aspect("equal")
    axes.set_xlim(discs[0][0] - VIEW_M, discs[0][0] + VIEW_M)
    axes.set_ylim(discs[0][1] - VIEW_M * 0.85, discs[0][1] + VIEW_M * 0.85)
    axes.set_xlabel("x, m")
    axes.legend(loc="upper left")


def main():
    if len(sys.argv) != 3 or not sys.argv[2].endswith(".png"):
        sys.exit(__doc__.strip())
    binary, figure_path = sys.argv[1:]
    style.apply()
    figure = style.new_figure(7.2, 6.0)
    (left, right), (below_left, below_right) = figure.subplots(2, 2)
    for axes, panel in zip((left, right), PANELS, strict=True):
        draw_shares(axes, binary, panel)
    left.set_ylabel("share not yet back within 5 cm")
    left.legend(loc="lower left")
    for axes, (rule, label, colour) in zip((below_left, below_right), RULES, strict=True):
        draw_path(axes, binary, rule, f"{label}, a dot a second", colour)
    below_left.set_ylabel("y, m")
    style.save(figure, figure_path.removesuffix(".png"), ("png",))


if __name__ == "__main__":
    main()
