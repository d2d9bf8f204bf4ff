#!/usr/bin/env python3
"""Draws the figures of a scene that `berth-sim run|compare --figures DIR` has written.

    plot.py DIR/NAME.json

Leaves PDF, SVG and PNG beside it: NAME (all panels in one), NAME_path, NAME_errors,
NAME_velocities, NAME_clearance and NAME_mode; with several runs they are laid over each other, and
each run also has its own figure.
"""

import dataclasses
import sys

import panels
import scene as scenes
import style

PAGE = 7.2  # text width of a page, inches
COLUMN = 3.5  # width of one of two columns


def _legend_below(figure, handles, columns):
    figure.legend(handles=handles, loc="outside lower center", ncols=columns)


def _draw_path(axes, scene):
    if len(scene.runs) == 1:
        panels.path_by_mode(axes, scene, scene.runs[0])
        return panels.mode_handles(scene.runs[0])
    panels.path_overlay(axes, scene)
    return panels.strategy_handles(scene)


def _path_size(scene):
    """Height over width of what the path panel shows."""
    figure = style.new_figure(1, 1)
    axes = figure.subplots()
    _draw_path(axes, scene)
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    return (high - low) / (right - left)


def path(scene):
    figure = style.new_figure(COLUMN + 1.0, (COLUMN + 0.5) * _path_size(scene) + 1.1)
    handles = _draw_path(figure.subplots(), scene)
    _legend_below(figure, handles + panels.scenery_handles(scene), 3)
    return figure


def _over_time(scene, drawers, height=1.25, handles=()):
    """Panels on top of each other with one time axis."""
    figure = style.new_figure(COLUMN + 1.3, height * len(drawers) + 0.6)
    rows = figure.subplots(len(drawers), 1, sharex=True, squeeze=False)[:, 0]
    for axes, draw in zip(rows, drawers):
        draw(axes)
    panels.last_of_column(rows[-1])
    figure.align_ylabels(rows)
    if handles:
        _legend_below(figure, list(handles), 4)
    return figure


def _line_handles(scene, reference):
    handles = panels.strategy_handles(scene, dashes=False) if len(scene.runs) > 1 else []
    if reference:
        handles = handles + panels.scenery_handles(scene)[:1]
    if len(scene.runs) == 1:
        handles = handles + panels.shade_handles(scene.runs[0])
    return handles


def errors(scene):
    return _over_time(scene, [lambda axes, c=c: panels.error(axes, scene, c)
                              for c in ("e1", "e2", "e3")], handles=_line_handles(scene, False))


def velocities(scene):
    return _over_time(scene, [lambda axes, c=c: panels.velocity(axes, scene, c)
                              for c in ("v", "omega")], height=1.5,
                      handles=_line_handles(scene, True))


def clearance(scene):
    return _over_time(scene, [lambda axes: panels.clearance(axes, scene)], height=1.9,
                      handles=_line_handles(scene, False))


def mode(scene):
    if len(scene.runs) == 1:
        return _over_time(scene, [lambda axes: panels.mode_steps(axes, scene, scene.runs[0])],
                          height=1.3)
    return _over_time(scene, [lambda axes: panels.mode_bands(axes, scene)],
                      height=0.28 * len(scene.runs) + 0.3, handles=panels.all_mode_handles(scene))


def _right_column(figure, scene):
    """The panels that share the time axis on the right of the overview."""
    alone = len(scene.runs) == 1
    drawers = [lambda axes, c=c: panels.error(axes, scene, c) for c in ("e1", "e2", "e3")]
    if not alone:
        drawers = [lambda axes: panels.clearance(axes, scene)]
    drawers += [lambda axes, c=c: panels.velocity(axes, scene, c) for c in ("v", "omega")]
    drawers.append(lambda axes: panels.mode_steps(axes, scene, scene.runs[0]) if alone
                   else panels.mode_bands(axes, scene))
    ratios = [1.0] * (len(drawers) - 1) + [0.9 if alone else 0.08 + 0.15 * len(scene.runs)]
    rows = figure.subplots(len(drawers), 1, sharex=True, height_ratios=ratios)
    for axes, draw_panel in zip(rows, drawers):
        draw_panel(axes)
    panels.last_of_column(rows[-1])
    figure.align_ylabels(rows[:-1])
    if not alone:
        figure.legend(handles=panels.all_mode_handles(scene), loc="outside lower center", ncols=3)


def overview(scene):
    """Everything on a page."""
    path_height = (PAGE / 2 - 0.6) * _path_size(scene) + 0.5
    below, legend = 1.5, 0.85
    height = max(5.2, path_height + below + legend)
    figure = style.new_figure(PAGE, height)
    left, right = figure.subfigures(1, 2, width_ratios=(1.0, 1.02))
    top, bottom = left.subplots(2, 1, height_ratios=(path_height, height - legend - path_height))
    handles = _draw_path(top, scene)
    (panels.clearance if len(scene.runs) == 1 else panels.position_error)(bottom, scene)
    panels.last_of_column(bottom)
    left.legend(handles=handles + panels.scenery_handles(scene), loc="outside lower center", ncols=2)
    _right_column(right, scene)
    return figure


SINGLES = {
    "path": path,
    "errors": errors,
    "velocities": velocities,
    "clearance": clearance,
    "mode": mode,
}


def draw(scene):
    style.save(overview(scene), scene.stem)
    for name, make in SINGLES.items():
        style.save(make(scene), f"{scene.stem}_{name}")
    if len(scene.runs) > 1:
        for run in scene.runs:
            alone = dataclasses.replace(scene, runs=[run])
            style.save(overview(alone), run.stem)


def main(arguments):
    if len(arguments) != 2:
        print("usage: plot.py SCENE.json", file=sys.stderr)
        return 2
    style.apply()
    draw(scenes.load(arguments[1]))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv))
