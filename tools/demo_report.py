#!/usr/bin/env python3
"""Prints what the two experiments are to show, and whether they did.

    demo_report.py DIR/circle_compare.json DIR/eight_compare.json

The files, and the logs beside them, are what `berth-sim compare --figures DIR` leaves. Every verdict
is computed from them.
"""

import csv
import json
import math
import pathlib
import sys

RECOVERED_M = 0.05  # as near to the reference as counts as tracking again
SEPARATE_S = 5.0  # so long without avoidance, and the same obstacle is met anew
MODES = ("regulated", "conservative_turn", "conservative_go", "blocked")

ROWS = (
    ("collisions", "d", lambda s: s["collisions"]),
    ("minimum clearance, m", ".4f", lambda s: s["min_clearance_m"]),
    ("position error, RMS, m", ".4f", lambda s: s["rms_position_error_m"]),
    ("position error, peak, m", ".4f", lambda s: s["peak_position_error_m"]),
    ("avoidance in control, s", ".2f", lambda s: s["avoidance_time_s"]),
    *((f"  {mode.replace('_', ', ')}, s", ".2f", lambda s, mode=mode: s["mode_time_s"][mode])
      for mode in MODES),
    ("standing, s", ".2f", lambda s: s["stopped_time_s"]),
    ("recovery after avoidance, s", ".2f", lambda s: s["recovery_time_s"]),
    ("control effort", ".4f", lambda s: s["control_effort"]),
)


def load(path):
    """The scene, with its runs by strategy and each run's log as a list of rows."""
    path = pathlib.Path(path)
    scene = json.loads(path.read_text(encoding="utf-8"))
    runs = {}
    for run in scene["runs"]:
        with open(path.parent / run["log"], newline="", encoding="utf-8") as file:
            run["rows"] = [{key: value if key == "mode" else float(value)
                            for key, value in row.items()} for row in csv.DictReader(file)]
        runs[run["strategy"]] = run
    return dict(scene, runs=runs)


def table(scene):
    width = max(12, *(len(name) for name in scene["runs"])) + 2
    lines = [f"{'':28}" + "".join(f"{name:>{width}}" for name in scene["runs"])]
    for label, form, value in ROWS:
        values = [value(run["summary"]) for run in scene["runs"].values()]
        cells = (f"{'never' if v is None else format(v, form):>{width}}" for v in values)
        lines.append(f"{label:28}" + "".join(cells))
    return lines


def encounters(run, obstacles):
    """(obstacle's number, first and last row of avoidance near it), in order of time."""
    found = []
    for index, row in enumerate(run["rows"]):
        if row["mode"] == "track":
            continue
        gaps = [math.hypot(o["x_m"] - row["x"], o["y_m"] - row["y"]) - o["hard_m"]
                for o in obstacles]
        nearest = gaps.index(min(gaps)) + 1
        if (found and found[-1][0] == nearest
                and row["t"] - run["rows"][found[-1][2]]["t"] < SEPARATE_S):
            found[-1][2] = index
        else:
            found.append([nearest, index, index])
    return found


def resumptions(run, obstacles):
    """(obstacle's number, seconds until the robot tracked again near its reference, or None)."""
    rows, met = run["rows"], encounters(run, obstacles)
    result = []
    for number, (obstacle, _, last) in enumerate(met):
        end = met[number + 1][1] if number + 1 < len(met) else len(rows)
        back = next((row for row in rows[last + 1:end]
                     if math.hypot(row["e1"], row["e2"]) < RECOVERED_M), None)
        result.append((obstacle, None if back is None else back["t"] - rows[last]["t"]))
    return result


def no_collision(run):
    summary = run["summary"]
    return (summary["collisions"] == 0, f"{run['strategy']} does not collide",
            f"{summary['collisions']} collisions, least clearance {summary['min_clearance_m']:.4f} m")


def resumed(run, obstacles):
    times = resumptions(run, obstacles)
    said = ", ".join(f"obstacle {o}: {'not' if t is None else f'after {t:.2f} s'}"
                     for o, t in times)
    return (bool(times) and all(t is not None for _, t in times),
            f"{run['strategy']} tracks again after each obstacle (error below {RECOVERED_M} m)",
            said or "it met no obstacle")


def less_avoidance(run, other):
    mine, its = run["summary"]["avoidance_time_s"], other["summary"]["avoidance_time_s"]
    return (mine < its, f"{run['strategy']} spends less time under avoidance than "
            f"{other['strategy']}", f"{mine:.2f} s against {its:.2f} s")


def no_full_stop(run):
    stopped = run["summary"]["stopped_time_s"]
    return (stopped == 0, f"{run['strategy']} never stops while its reference moves",
            f"stood for {stopped:.2f} s")


def side_by_side(run, other):
    parts, good = [], True
    for one in (run, other):
        rms = one["summary"]["rms_position_error_m"]
        peak = one["summary"]["peak_position_error_m"]
        good = good and rms is not None and peak is not None
        if good:
            parts.append(f"{one['strategy']} {rms:.4f} m and {peak:.4f} m")
    return good, "RMS and peak position errors side by side", ", ".join(parts)


def circle_verdicts(scene):
    conservative, normal = scene["runs"]["conservative"], scene["runs"]["normal"]
    return [no_collision(conservative), resumed(conservative, scene["obstacles"]),
            less_avoidance(conservative, normal)]


def eight_verdicts(scene):
    combined, adaptive = scene["runs"]["combined"], scene["runs"]["adaptive"]
    return [no_collision(combined), no_full_stop(combined), side_by_side(combined, adaptive)]


def report(title, scene, verdicts):
    lines = ["", title, "=" * len(title), *table(scene), "", "To show:"]
    for good, claim, numbers in verdicts:
        lines += [f"  {'yes' if good else 'NO ':3}  {claim}", f"       {numbers}"]
    return lines


def main(arguments):
    if len(arguments) != 3:
        print("usage: demo_report.py CIRCLE.json EIGHT.json", file=sys.stderr)
        return 2
    circle, eight = load(arguments[1]), load(arguments[2])
    lines = report("Circle: conservative against normal", circle, circle_verdicts(circle))
    lines += report("Figure eight: combined against adaptive", eight, eight_verdicts(eight))
    lines += ["", "The layouts follow the published experiments (three equal obstacles on a circle,",
              "three different ones on a figure eight, 0.2 m avoidance distance). Their other",
              "numbers are not available: speeds, weights, radii and places are this project's own."]
    print("\n".join(lines))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv))
