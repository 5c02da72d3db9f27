"""Figures of a finished run, modelled on those of the thesis: maps over time, and the radio traffic.

maps over time     planning maps and the approximation that each robot sends (Figure A.2)
approximation      how one robot's approximation follows what it has seen itself (Figure 4.8)
channel load       bytes a step, bytes that did not fit, packets not sent yet (Figures 6.17, 6.18), and the
                   explored area over the same steps
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from deploy.after.archive import Archive
from deploy.after.recast_scans import Lasers
from deploy.dashboard.shapes import outline_strips
from deploy.record.colors import GROUPS
from deploy.record.map_pictures import robot_color, save, show_grid
from deploy.record.snapshots import Snapshots
from deploy.scenario.scenario import UNLIMITED
from netshaper.ledger import CAUSES
from protocol.grid import FREE

MAPS_OVER_TIME, APPROXIMATION, CHANNEL_LOAD = "maps-over-time.png", "approximation.png", "channel-load.png"
MOST_ROBOTS = 8
"""Maximum number of robots that a picture has columns for."""
MOMENTS = 6
RED = "#d62728"


def write_figures(
    archive: Archive, folder: Path, tell: Callable[[str], object] = lambda _: None
) -> list[Path]:
    """Draw all figures that can be drawn of a run; return the files."""
    folder.mkdir(exist_ok=True)
    snapshots = archive.snapshots(tell)
    figures: dict[str, Figure] = {CHANNEL_LOAD: channel_load(archive, snapshots)}
    if snapshots is not None and snapshots.told_steps(0):
        figures[MAPS_OVER_TIME] = maps_over_time(archive, snapshots)
        if snapshots.has_outlines:
            figures[APPROXIMATION] = approximation(archive, snapshots)
    for name, figure in figures.items():
        save(folder / name, figure, dpi=100)
    return [folder / name for name in figures]


def maps_over_time(archive: Archive, snapshots: Snapshots) -> Figure:
    """Planning maps, one column per robot, one row per point in time; in red what each sends of its own map."""
    robots = range(min(MOST_ROBOTS, archive.plan.scenario.robots))
    moments = _moments(archive.last_step)
    shape = archive.plan.map.height / archive.plan.map.width
    wide = max(1.45, 11 / len(robots)) if len(robots) > 3 else 3.2
    figure = Figure(
        figsize=(wide * len(robots) + 0.4, (wide * shape + 0.1) * len(moments) + 0.7), layout="constrained"
    )
    axes = np.atleast_2d(figure.subplots(len(moments), len(robots), squeeze=False))
    for row, step in enumerate(moments):
        for robot in robots:
            panel = axes[row, robot]
            grid = snapshots.planning(robot, step)
            if grid is None:
                panel.set_axis_off()
                continue
            _draw(panel, archive, grid, snapshots.outlines(robot, robot, step))
            _bare(panel)
        axes[row, 0].set_ylabel(f"step {step}")
    for robot in robots:
        axes[0, robot].set_title(f"robot {robot}", color=robot_color(robot))
    figure.suptitle("Each robot's planning map, and (red) the approximation that it sends")
    return figure


def approximation(archive: Archive, snapshots: Snapshots, robot: int = 0) -> Figure:
    """What a robot has seen itself, and its approximation of that.

    White outside the red line, and grey inside it, are the errors of the approximation at that step.
    """
    moments = _moments(archive.last_step)
    own = Lasers(archive).own_grids(robot, moments)
    shape = archive.plan.map.height / archive.plan.map.width
    figure = Figure(figsize=(11, 2 * (11 / 3 * shape + 0.3) + 0.6), layout="constrained")
    for panel, step in zip(figure.subplots(2, 3).ravel(), moments, strict=False):
        if step not in own:
            panel.set_axis_off()
            continue
        outlines = snapshots.outlines(robot, robot, step)
        _draw(panel, archive, own[step], outlines, width=1.2)
        corners = len(outlines) // 8
        panel.set_title(f"step {step}: {corners} corners", fontsize=9)
    figure.suptitle(f"What robot {robot} has seen itself, and (red) its approximation of it")
    return figure


def channel_load(archive: Archive, snapshots: Snapshots | None) -> Figure:
    """Bytes on the air by kind and step, bytes that did not fit, and the explored area over the same steps."""
    figure = Figure(figsize=(11, 8), layout="constrained")
    load, wait, explored = figure.subplots(3, 1, sharex=True, height_ratios=[3, 2, 2])
    ledger, last = archive.ledger, archive.last_step
    steps = np.arange(1, last + 1)
    carried = {
        group.words: _per_step(ledger, np.isin(ledger["kind"], group.kinds) & ledger["carried"], last)
        for group in GROUPS.values()
    }
    shown = {words: values for words, values in carried.items() if values.any()}
    colors = [tuple(part / 255 for part in group.color) for group in GROUPS.values() if group.words in shown]
    if shown:
        load.stackplot(steps, *shown.values(), labels=list(shown), colors=colors, step="mid", linewidth=0)
    budget = archive.plan.scenario.bandwidth
    if budget != UNLIMITED:
        load.axhline(float(budget), color=RED, linewidth=1.2, label=f"budget: {budget} bytes a step")
    load.set_ylabel("bytes a step")
    load.set_title("Load of the channel")
    cut = _per_step(ledger, ledger["cause"] == CAUSES[CAUSES.index("budget")], last)
    wait.fill_between(steps, cut, step="mid", color="#bbbbbb", label="bytes that did not fit into the step")
    wait.set_ylabel("bytes a step")
    told = wait.twinx()
    for robot in range(archive.plan.scenario.robots):
        mine = archive.of_robot(robot)
        told.plot(mine["step"], mine["backlog"], color=robot_color(robot), linewidth=0.9)
    for axes in (load, wait, told):
        axes.set_ylim(0, max(1.0, axes.get_ylim()[1]))
    told.set_ylabel("packets not sent yet\n(colours: robots)")
    wait.set_title("Waiting")
    _draw_explored(explored, archive, snapshots)
    for panel in (load, wait, explored):
        if panel.get_legend_handles_labels()[0]:
            panel.legend(loc="upper left", bbox_to_anchor=(1.1, 1.0), fontsize=8, frameon=False)
        panel.grid(alpha=0.25)
        panel.margins(x=0)
    explored.set_xlabel("step")
    return figure


def _draw_explored(panel: Axes, archive: Archive, snapshots: Snapshots | None) -> None:
    first = archive.steps
    steps, at = np.unique(first["step"], return_index=True)
    panel.plot(steps, 100 * first["team_seen"][at], color="black", linewidth=2, label="seen by the team")
    if snapshots is not None:
        reachable = archive.plan.make_world().reachable
        for robot in range(archive.plan.scenario.robots):
            told = snapshots.told_steps(robot)
            grids = [snapshots.planning(robot, step) for step in told]
            known = [100 * float((grid[reachable] == FREE).mean()) for grid in grids if grid is not None]
            label = "on each robot's map" if robot == 0 else None
            panel.plot(told, known, color=robot_color(robot), linewidth=0.9, label=label)
    panel.set_ylabel("% of what can be reached")
    panel.set_title("Explored")


def _per_step(ledger: dict[str, NDArray[Any]], rows: NDArray[np.bool_], last: int) -> NDArray[np.float64]:
    """Bytes of the chosen rows in each step from 1 on."""
    total = np.bincount(ledger["step"][rows], weights=ledger["bytes"][rows], minlength=last + 1)
    return total[1 : last + 1].astype(np.float64)


def _moments(last: int) -> list[int]:
    """Steps to show: evenly spaced, including the last one."""
    return sorted({max(1, round(last * k / MOMENTS)) for k in range(1, MOMENTS + 1)})


def _draw(
    panel: Axes, archive: Archive, grid: NDArray[np.uint8], outlines: bytes, width: float = 0.8
) -> None:
    show_grid(panel, archive.plan.map, grid)
    strips = [strip * (1, -1) for strip in outline_strips(archive.plan.map, outlines)]
    panel.add_collection(LineCollection(strips, colors=RED, linewidths=width))


def _bare(panel: Axes) -> None:
    panel.set_xticks([])
    panel.set_yticks([])
    panel.set_xlabel("")
