"""The stages of merging, as Figure 5.6 of the thesis draws them, at one step of a finished run.

A robot's planning grid follows from what teammates have told of their maps and from what it has seen itself:
outside objects filled with unknown, their boundaries, inside objects one by one, their boundaries, its own map.
"""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from agent.outline.five_stages import UNDEFINED, five_stages
from agent.robot import Robot
from deploy.after.archive import Archive
from deploy.record.map_pictures import CELLS
from deploy.run.repeat import robots_at, why_unrepeatable
from deploy.scenario.scenario import ScenarioError
from protocol.grid import UNKNOWN, Grid

MERGING = "merging.png"

_MARGIN = 3
"""Cells shown around what is known."""

_COLORS = ListedColormap([*CELLS.colors, "#d9c6e8"])  # type: ignore[misc]
"""Unknown, free, occupied, undefined."""


def merging(archive: Archive, robot: int, step: int) -> Figure:
    """Draw how a robot's planning grid comes about at a step; the run is repeated in memory up to there.

    Raises
    ------
    ScenarioError
        The run cannot be repeated, there is no such robot or step, or no polygons travel in it.
    """
    scenario, last = archive.plan.scenario, archive.last_step
    if scenario.map_encoding != "polygons":
        raise ScenarioError(f"stages: only polygons are merged in stages, not {scenario.map_encoding}")
    if reason := why_unrepeatable(archive.summary):
        raise ScenarioError(f"{archive.directory}: this run cannot be repeated: {reason}")
    if not 1 <= step <= last:
        raise ScenarioError(f"stages = {step}: the run has the steps 1 to {last}")
    robot_settings = {mind.settings.robot: mind for mind in robots_at(archive.plan, step)}
    if robot not in robot_settings:
        raise ScenarioError(
            f"robot = {robot}: at step {step} there are {', '.join(map(str, sorted(robot_settings)))}"
        )
    return stages_figure(robot_settings[robot], step)


def stages_figure(mind: Robot, step: int) -> Figure:
    """Draw the stages of one robot's planning grid, and what it has seen itself."""
    me = mind.settings.robot
    told = {peer: polygons for peer, polygons in sorted(mind.polygons.items()) if peer != me}
    stages = five_stages(mind.own, list(told.values()))
    shown = (
        ("what it has seen itself", mind.own),
        ("(a) outside objects filled", stages.outside_filled),
        ("(b) their boundaries", stages.outside_bounded),
        ("(c), (d) inside objects, one by one", stages.inside_filled),
        ("(e) their boundaries", stages.inside_bounded),
        ("(f) with its own map", stages.complete),
    )
    rows, columns = _known(stages.complete)
    shape = (rows.stop - rows.start) / (columns.stop - columns.start)
    figure = Figure(figsize=(11, 2 * (11 / 3 * shape + 0.3) + 0.7), layout="constrained")
    for panel, (title, grid) in zip(figure.subplots(2, 3).ravel(), shown, strict=True):
        _show(panel, grid[rows, columns])
        panel.set_title(title, fontsize=10)
    makers = ", ".join(map(str, told)) or "nobody"
    figure.suptitle(
        f"Step {step}: how robot {me}'s planning grid follows from what it holds of {makers} (violet: undefined)"
    )
    return figure


def _known(grid: Grid) -> tuple[slice, slice]:
    """The part of a grid in which something is known, with a margin; all of it if nothing is."""
    ys, xs = np.nonzero(grid != UNKNOWN)
    if not len(ys):
        return slice(0, grid.shape[0]), slice(0, grid.shape[1])
    return (
        slice(max(0, int(ys.min()) - _MARGIN), int(ys.max()) + _MARGIN + 1),
        slice(max(0, int(xs.min()) - _MARGIN), int(xs.max()) + _MARGIN + 1),
    )


def _show(panel: Axes, grid: Grid) -> None:
    panel.imshow(grid, cmap=_COLORS, vmin=0, vmax=UNDEFINED, interpolation="nearest")
    panel.set_xticks([])
    panel.set_yticks([])
