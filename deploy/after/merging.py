"""The stages of merging, as Figure 5.6 of the thesis draws them, for one robot at one step of a finished run.

A robot merges the outlines received from its teammates with its own map: outside objects filled with unknown cells,
their boundaries, inside objects one by one, their boundaries, and at last its own map.
"""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from agent.outline.five_stages import UNDEFINED, five_stages
from agent.outline.polygons import Polygons
from agent.viewer_feed import SHOWN_EVERY, polygons_of
from deploy.after.archive import Archive
from deploy.record.map_pictures import CELLS
from deploy.scenario.scenario import ScenarioError
from protocol.grid import UNKNOWN, Grid

MERGING = "merging.png"

_MARGIN = 3
"""Cells shown around the known area."""

_COLORS = ListedColormap([*CELLS.colors, "#d9c6e8"])  # type: ignore[misc]
"""Unknown, free, occupied, undefined."""


def merging(archive: Archive, robot: int, step: int) -> Figure:
    """Draw how a robot merges maps at a step, or at the last step before it at which the robot reported its maps.

    Raises ScenarioError if there is no such robot or step, or the run does not exchange polygons.
    """
    scenario, last = archive.plan.scenario, archive.last_step
    if scenario.map_encoding != "polygons":
        raise ScenarioError(f"stages: only polygons are merged in stages, not {scenario.map_encoding}")
    if robot >= scenario.robots:
        raise ScenarioError(f"robot = {robot}: must be at most {scenario.robots - 1}")
    reported = step if step == last else step - step % SHOWN_EVERY
    if not 1 <= step <= last or (own := archive.maps.own(robot, reported)) is None:
        raise ScenarioError(f"stages = {step}: robot {robot} reports maps from step {SHOWN_EVERY} to {last}")
    received = {
        map_id: polygons_of(archive.maps.outlines(robot, map_id, reported), own.shape)
        for map_id in archive.maps.maps_held(robot)
        if map_id % scenario.robots != robot
    }
    return stages_figure(robot, own, received, reported)


def stages_figure(robot: int, own: Grid, received: dict[int, Polygons], step: int) -> Figure:
    """Draw the stages of one robot's planning map, from its own map and the outlines `received`, by map."""
    stages = five_stages(own, list(received.values()))
    shown = (
        ("own map", own),
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
    sources = ", ".join(map(str, received)) or "no teammate"
    figure.suptitle(
        f"Step {step}: robot {robot} merges its map with outlines received from {sources} (violet: undefined)"
    )
    return figure


def _known(grid: Grid) -> tuple[slice, slice]:
    """The known part of a grid, with a margin; the whole grid if nothing is known."""
    ys, xs = np.nonzero(grid != UNKNOWN)
    if not len(ys):
        return slice(0, grid.shape[0]), slice(0, grid.shape[1])
    return (
        slice(max(0, int(ys.min()) - _MARGIN), int(ys.max()) + _MARGIN + 1),
        slice(max(0, int(xs.min()) - _MARGIN), int(xs.max()) + _MARGIN + 1),
    )


def _show(panel: Axes, grid: Grid) -> None:
    panel.imshow(grid, cmap=_COLORS, vmin=0, vmax=UNDEFINED, interpolation="nearest")
    panel.set(xticks=[], yticks=[])
