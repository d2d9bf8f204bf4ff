"""The panels that figures are put together from. Each draws into the axes that it is given."""

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.markers import MarkerStyle
from matplotlib.patches import Circle, Patch
from matplotlib.transforms import Affine2D

import scene as scenes
import style

ARROWS = 7  # direction marks along a path
STANDING = 0.005  # metres that a stretch moves at least to show as a line
TALLEST, FLATTEST = 1.2, 0.5  # height over width of the path's panel
RINGS = (
    # radius, label, line
    ("conservative_m", "conservative radius", {"linestyle": "solid", "linewidth": 0.8}),
    ("skirt_m", "skirt", {"linestyle": (0, (1, 1.3)), "linewidth": 0.9}),
    ("regulated_m", "regulated radius", {"linestyle": (0, (6, 2, 1.2, 2)), "linewidth": 0.7}),
)


# --- path ------------------------------------------------------------------------------------

def _draw_obstacles(axes, scene):
    for obstacle in scene.obstacles:
        centre = (obstacle["x_m"], obstacle["y_m"])
        radii = dict(obstacle, skirt_m=obstacle["conservative_m"] + scene.skirt)
        axes.add_patch(Circle(centre, obstacle["hard_m"], facecolor=style.HARD, edgecolor="none",
                              zorder=2))
        for key, _, line in RINGS:
            axes.add_patch(Circle(centre, radii[key], fill=False, edgecolor=style.RING, zorder=2,
                                  **line))


def _one_lap(run):
    """Rows of the reference's first lap: drawn twice, dashes would close up."""
    turned = np.angle(np.exp(1j * (run["theta_r"] - run["theta_r"][0])))
    distance = np.hypot(run["x_r"] - run["x_r"][0], run["y_r"] - run["y_r"][0])
    step = distance[1] if len(distance) > 1 else 0.0
    back = np.flatnonzero((distance <= step) & (np.abs(turned) < 0.1))
    back = back[back > 2]
    return slice(0, int(back[0]) + 1 if len(back) else len(distance))


def _draw_reference(axes, run):
    lap = _one_lap(run)
    axes.plot(run["x_r"][lap], run["y_r"][lap], color=style.REFERENCE, linewidth=0.9,
              linestyle=(0, (4, 2.5)), zorder=3)


def _draw_start(axes, run, colour):
    axes.plot(run["x"][0], run["y"][0], marker="o", markersize=5, markerfacecolor="white",
              markeredgecolor=colour, markeredgewidth=1.1, zorder=7)


def _draw_stops(axes, run):
    """A dot for each stretch of a mode that does not move the robot: a line would not show."""
    for mode, first, end in run.stretches():
        last = min(end, len(run.mode) - 1)
        moved = np.hypot(run["x"][last] - run["x"][first], run["y"][last] - run["y"][first])
        if mode != "track" and moved < STANDING:
            axes.plot(run["x"][first], run["y"][first], marker="o", markersize=4, zorder=6,
                      color=style.MODE_COLOURS[mode], markeredgewidth=0)


def _draw_directions(axes, run, colours):
    """Arrow heads at equal distances along the path, so that none pile up where it stands."""
    travelled = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(run["x"]), np.diff(run["y"])))))
    marks = travelled[-1] * (np.arange(ARROWS) + 0.5) / ARROWS
    for row in np.minimum(np.searchsorted(travelled, marks), len(travelled) - 1):
        turned = Affine2D().rotate(run["theta"][row])
        head = MarkerStyle(">", transform=turned)
        axes.plot(run["x"][row], run["y"][row], marker=head, markersize=5.5, color=colours(row),
                  markeredgewidth=0, zorder=6)


def _extent(scene, columns, key):
    """Middle and size of what there is to see along one axis."""
    low = min(np.min(run[column]) for run in scene.runs for column in columns)
    high = max(np.max(run[column]) for run in scene.runs for column in columns)
    for obstacle in scene.obstacles:
        low = min(low, obstacle[key] - obstacle["regulated_m"])
        high = max(high, obstacle[key] + obstacle["regulated_m"])
    return 0.5 * (low + high), 1.08 * (high - low)


def _finish_path(axes, scene):
    x, width = _extent(scene, ("x", "x_r"), "x_m")
    y, height = _extent(scene, ("y", "y_r"), "y_m")
    # a panel that is neither a strip nor a tower, nor empty when the robot never moves
    width = max(width, height / TALLEST, 0.1)
    height = max(height, width * FLATTEST)
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlim(x - 0.5 * width, x + 0.5 * width)
    axes.set_ylim(y - 0.5 * height, y + 0.5 * height)
    axes.set_xlabel("$x$ (m)")
    axes.set_ylabel("$y$ (m)")


def path_by_mode(axes, scene, run):
    _draw_obstacles(axes, scene)
    _draw_reference(axes, run)
    for mode, first, end in run.stretches():
        # one row more than the stretch, so that the line has no gaps
        axes.plot(run["x"][first:end + 1], run["y"][first:end + 1], linewidth=1.5,
                  color=style.MODE_COLOURS[mode], solid_capstyle="round", zorder=5)
    _draw_stops(axes, run)
    _draw_directions(axes, run, lambda row: style.MODE_COLOURS[run.mode[row]])
    _draw_start(axes, run, style.MODE_COLOURS[run.mode[0]])
    _finish_path(axes, scene)


def path_overlay(axes, scene):
    _draw_obstacles(axes, scene)
    _draw_reference(axes, scene.runs[0])
    for run in scene.runs:
        line = style.strategy_line(run.strategy)
        axes.plot(run["x"], run["y"], linewidth=1.4, zorder=5, **line)
        _draw_directions(axes, run, lambda row, colour=line["color"]: colour)
    _draw_start(axes, scene.runs[0], style.BLACK)
    _finish_path(axes, scene)


def scenery_handles(scene):
    handles = [
        Line2D([], [], color=style.REFERENCE, linewidth=0.9, linestyle=(0, (4, 2.5)),
               label="reference"),
        Line2D([], [], color="none", marker="o", markersize=5, markerfacecolor="white",
               markeredgecolor=style.BLACK, label="start"),
    ]
    if scene.obstacles:
        handles.append(Patch(facecolor=style.HARD, label="hard disc"))
        handles += [Line2D([], [], color=style.RING, label=label, **line)
                    for _, label, line in RINGS]
    return handles


def mode_handles(run):
    return [Line2D([], [], color=style.MODE_COLOURS[mode], linewidth=1.8,
                   label=style.MODE_NAMES[mode])
            for mode in scenes.MODES if mode in run.mode]


def shade_handles(run):
    return [Patch(facecolor=style.MODE_COLOURS[mode], alpha=0.3, label=style.MODE_NAMES[mode])
            for mode in scenes.MODES[1:] if mode in run.mode]


def strategy_handles(scene, dashes=True):
    handles = []
    for run in scene.runs:
        line = style.strategy_line(run.strategy)
        if not dashes:
            line["linestyle"] = "solid"
        handles.append(Line2D([], [], linewidth=1.6, label=run.strategy, **line))
    return handles


# --- over time -------------------------------------------------------------------------------

def shade_modes(axes, scene, run):
    """A light band wherever avoidance is in control."""
    for mode, first, end in run.stretches():
        if mode != "track":
            axes.axvspan(run["t"][first], run["t"][end - 1] + scene.period, linewidth=0,
                         facecolor=style.MODE_COLOURS[mode], alpha=0.16, zorder=0)


def _time_limits(axes, scene):
    axes.set_xlim(0.0, scene.runs[0]["t"][-1] + scene.period)


def last_of_column(axes):
    axes.set_xlabel("time $t$ (s)")


def _series(axes, scene, column, label):
    """One line a run: by strategy when there are several."""
    if len(scene.runs) == 1:
        shade_modes(axes, scene, scene.runs[0])
    axes.axhline(0.0, color="#9A9A9A", linewidth=0.5, zorder=1)
    for run in scene.runs:
        colour = style.strategy_colour(run.strategy) if len(scene.runs) > 1 else style.BLUE
        values = run.position_error if column == "position" else run[column]
        axes.plot(run["t"], values, zorder=4, color=colour, linewidth=1.0)
    axes.set_ylabel(label)
    _time_limits(axes, scene)


def error(axes, scene, column):
    _series(axes, scene, column, {"e1": "$e_1$ (m)", "e2": "$e_2$ (m)", "e3": "$e_3$ (rad)"}[column])


def position_error(axes, scene):
    _series(axes, scene, "position", "position error (m)")
    axes.set_ylim(bottom=0.0)


def clearance(axes, scene):
    _series(axes, scene, "clearance", "clearance (m)")
    finite = [run["clearance"] for run in scene.runs if np.any(np.isfinite(run["clearance"]))]
    low = min((np.nanmin(values) for values in finite), default=0.0)
    # far from all obstacles the distance is of no interest
    axes.set_ylim(min(0.0, low) - 0.05, max(0.6, low + 0.1))
    if not finite:
        axes.text(0.5, 0.5, "no obstacles", transform=axes.transAxes, ha="center", va="center",
                  color=style.REFERENCE)
    axes.axhline(0.0, color=style.BLACK, linewidth=0.8, zorder=3)


def velocity(axes, scene, column):
    label = {"v": "$v$ (m/s)", "omega": r"$\omega$ (rad/s)"}[column]
    reference = scene.runs[0]
    _series(axes, scene, column + "_cmd", label)
    axes.plot(reference["t"], reference[column + "_r"], color=style.REFERENCE, linewidth=0.9,
              linestyle=(0, (4, 2.5)), zorder=5)


def mode_steps(axes, scene, run):
    """One row a mode, filled while the run is in it."""
    for row, mode in enumerate(scenes.MODES):
        bars = [(run["t"][a], run["t"][b - 1] + scene.period - run["t"][a])
                for name, a, b in run.stretches() if name == mode]
        axes.broken_barh(bars, (row - 0.34, 0.68), facecolor=style.MODE_COLOURS[mode], linewidth=0)
    axes.set_yticks(range(len(scenes.MODES)), [style.MODE_TICKS[mode] for mode in scenes.MODES])
    axes.set_ylim(len(scenes.MODES) - 0.45, -0.55)
    axes.tick_params(axis="y", length=0)
    axes.grid(False, axis="y")
    _time_limits(axes, scene)


def mode_bands(axes, scene):
    """One row a run, coloured by mode."""
    for row, run in enumerate(scene.runs):
        for mode, a, b in run.stretches():
            width = run["t"][b - 1] + scene.period - run["t"][a]
            axes.broken_barh([(run["t"][a], width)], (row - 0.34, 0.68),
                             facecolor=style.MODE_GREYS[mode], linewidth=0)
    axes.set_yticks(range(len(scene.runs)), [run.strategy for run in scene.runs])
    axes.set_ylim(len(scene.runs) - 0.45, -0.55)
    axes.tick_params(axis="y", length=0)
    axes.grid(False, axis="y")
    _time_limits(axes, scene)


def all_mode_handles(scene):
    seen = set().union(*(set(run.mode.tolist()) for run in scene.runs))
    return [Patch(facecolor=style.MODE_GREYS[mode], label=style.MODE_NAMES[mode])
            for mode in scenes.MODES if mode in seen]
