"""Figures of a finished run, modelled on those of the thesis: maps over time, and the radio traffic.

maps over time     planning maps, and the outlines that each robot sends (Figure A.2)
approximation      how one robot's approximation follows what it has seen itself (Figure 4.8)
channel load       what is explored over time, and over the same steps bytes on the air, bytes that did not
                   fit, packets not sent yet (Figures 6.17, 6.18)
"""

from __future__ import annotations

import math
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
from deploy.record.map_pictures import rgb, robot_color, save, show_grid
from deploy.record.snapshots import Snapshots
from deploy.scenario.tables import UNLIMITED
from netshaper.ledger import CAUSES
from protocol.grid import FREE

MAPS_OVER_TIME, APPROXIMATION, CHANNEL_LOAD = "maps-over-time.png", "approximation.png", "channel-load.png"
MOST_ROBOTS = 8
"""Maximum number of robots that a picture has columns for."""
MOST_CURVES = 10
"""Robots up to which each has a curve of its own."""
MOMENTS = 6
COMPARED = ("#20242a", "#d9730d", "#1f77b4", "#2ca02c")
"""Colours of runs that are compared."""
RED = "#d62728"

Curves = dict[int, tuple[NDArray[Any], NDArray[Any]]]
"""Of each robot steps, and values at them."""


def write_figures(archive: Archive, folder: Path, snapshots: Snapshots | None) -> list[Path]:
    """Draw all figures that can be drawn of a run; return the files."""
    folder.mkdir(exist_ok=True)
    figures: dict[str, Figure] = {CHANNEL_LOAD: channel_load(archive, snapshots)}
    if snapshots is not None and snapshots.told_steps(0):
        figures[MAPS_OVER_TIME] = maps_over_time(archive, snapshots)
        if snapshots.has_outlines:
            figures[APPROXIMATION] = approximation(archive, snapshots)
    for name, figure in figures.items():
        save(folder / name, figure, dpi=100)
    return [folder / name for name in figures]


def maps_over_time(archive: Archive, snapshots: Snapshots) -> Figure:
    """Planning maps, one column per robot, one row per point in time; in red the outlines that each sends."""
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
    told = ", and (red) the approximation that it sends" if snapshots.has_outlines else ""
    figure.suptitle(f"Each robot's planning map{told}")
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
    """What is explored over time, below it the use of the budget by purpose, and what had to wait.

    Teams of up to `MOST_CURVES` have a curve each; of larger ones the median, the middle half and the extremes
    are drawn.
    """
    figure = Figure(figsize=(11, 9), layout="constrained")
    explored, load, wait = figure.subplots(3, 1, sharex=True, height_ratios=[4, 3, 2.5])
    draw_explored(explored, archive, snapshots)
    draw_load(load, archive)
    told = _draw_waiting(wait, archive)
    for axes in (load, wait, told):
        axes.set_ylim(0, max(1.0, axes.get_ylim()[1]))
    explored.set_ylim(0, 102)
    for panel, other in ((explored, None), (load, None), (wait, told)):
        panel.grid(alpha=0.25)
        panel.margins(x=0)
        handles = [
            both
            for axes in (panel, other)
            if axes
            for both in zip(*axes.get_legend_handles_labels(), strict=True)
        ]
        if handles:
            lines, words = zip(*handles, strict=True)
            panel.legend(
                lines, words, loc="upper left", bbox_to_anchor=(1.1, 1.03), fontsize=8, frameon=False
            )
    wait.set_xlabel("step")
    return figure


def compared(archives: dict[str, Archive]) -> Figure:
    """What the teams of several runs have seen over time, and below it what they put on the air."""
    figure = Figure(figsize=(11, 7), layout="constrained")
    explored, load = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
    budgets = {archive.plan.scenario.bandwidth for archive in archives.values()}
    for number, (name, archive) in enumerate(archives.items()):
        color = COMPARED[number % len(COMPARED)]
        steps, at = np.unique(archive.steps["step"], return_index=True)
        explored.plot(steps, 100 * archive.steps["team_seen"][at], color=color, linewidth=2, label=name)
        carried = _per_step(archive.ledger, archive.ledger["carried"].astype(bool), archive.last_step)
        total = carried.sum() / 1000
        load.step(np.arange(1, len(carried) + 1), carried, color=color, linewidth=1, where="mid",
                  label=f"{name}: {total:.0f} kB in all")  # fmt: skip
    if len(budgets) == 1 and UNLIMITED not in budgets:
        load.axhline(float(*budgets), color=RED, linewidth=1.2, label="budget")
    explored.set_title("Explored")
    explored.set_ylabel("% of what can be reached, seen by the team")
    explored.set_ylim(0, 102)
    load.set_title("On the air")
    load.set_ylabel("bytes a step")
    load.set_ylim(0, max(1.0, load.get_ylim()[1]))
    load.set_xlabel("step")
    for panel in (explored, load):
        panel.grid(alpha=0.25)
        panel.margins(x=0)
        panel.legend(loc="lower right" if panel is explored else "best", fontsize=9)
    return figure


def draw_explored(panel: Axes, archive: Archive, snapshots: Snapshots | None) -> None:
    """What the team has seen over time, and what is on each robot's map."""
    first = archive.steps
    steps, at = np.unique(first["step"], return_index=True)
    panel.plot(steps, 100 * first["team_seen"][at], color="black", linewidth=2.2, label="seen by the team")
    if snapshots is not None:
        reachable = archive.plan.make_world().reachable
        curves: Curves = {}
        for robot in range(archive.plan.scenario.robots):
            told = snapshots.told_steps(robot)
            grids = [snapshots.planning(robot, step) for step in told]
            known = [100 * float((grid[reachable] == FREE).mean()) for grid in grids if grid is not None]
            curves[robot] = np.array(told), np.array(known)
        _draw_curves(panel, curves, "on the map of")
    panel.set_ylabel("% of what can be reached")
    panel.set_title("Explored")


def draw_load(panel: Axes, archive: Archive) -> None:
    """Bytes on the air by purpose and step, and what part of the budget that is."""
    ledger, last = archive.ledger, archive.last_step
    steps = np.arange(1, last + 1)
    carried = {
        name: _per_step(ledger, np.isin(ledger["kind"], group.kinds) & ledger["carried"], last)
        for name, group in GROUPS.items()
    }
    shown = {name: values for name, values in carried.items() if values.any()}
    if shown:
        panel.stackplot(
            steps, *shown.values(), labels=[GROUPS[name].title for name in shown],
            colors=[rgb(GROUPS[name].color) for name in shown], step="mid", linewidth=0,
        )  # fmt: skip
    budgets = archive.budgets[1:]
    title = "On the air"
    if np.isfinite(budgets).any():
        few = f": {budgets[0]:.0f} bytes a step" if len(set(budgets.tolist())) == 1 else ""
        panel.step(steps, budgets, where="mid", color=RED, linewidth=1.2, label=f"budget{few}")
    if np.isfinite(budgets).all():
        used = sum(values.sum() for values in carried.values()) / max(1.0, budgets.sum())
        title += f": {100 * used:.0f} % of the budget"
    if len(set(budgets.tolist())) == 1 and 0 < budgets[0] < math.inf:
        unit = budgets[0] / 100

        def to_share(size: Any) -> Any:
            return size / unit

        def to_size(share: Any) -> Any:
            return share * unit

        share = panel.secondary_yaxis("right", functions=(to_share, to_size))
        share.set_ylabel("% of the budget")
    panel.set_ylabel("bytes a step")
    panel.set_title(title)


def _draw_waiting(panel: Axes, archive: Archive) -> Axes:
    """Bytes that did not fit into a step, and each robot's packets not sent yet, on an axis that is returned."""
    last = archive.last_step
    cut = _per_step(archive.ledger, archive.ledger["cause"] == CAUSES[CAUSES.index("budget")], last)
    panel.fill_between(
        np.arange(1, last + 1), cut, step="mid", color="#c9ccd1", label="bytes that did not fit into the step"
    )
    panel.set_ylabel("bytes a step")
    panel.set_title("Waiting")
    told = panel.twinx()
    mine = {robot: archive.of_robot(robot) for robot in range(archive.plan.scenario.robots)}
    _draw_curves(told, {robot: (own["step"], own["backlog"]) for robot, own in mine.items()}, "packets of")
    told.set_ylabel("packets not sent yet")
    return told


def _draw_curves(panel: Axes, curves: Curves, words: str) -> None:
    """A curve for each robot, or for many of them what they have in common."""
    if len(curves) <= MOST_CURVES:
        for robot, (steps, values) in curves.items():
            panel.plot(steps, values, color=robot_color(robot), linewidth=1.0, label=f"{words} robot {robot}")
        return
    every = np.unique(np.concatenate([steps for steps, _ in curves.values()]))
    table = np.full((len(curves), len(every)), np.nan)
    for row, (steps, values) in zip(table, curves.values(), strict=True):
        if len(steps):
            row[:] = values[np.searchsorted(steps, every, "right").clip(1) - 1]
            row[(every < steps[0]) | (every > steps[-1])] = np.nan
    with np.errstate(all="ignore"):
        low, lower, middle, upper, high = np.nanpercentile(table, [0, 25, 50, 75, 100], axis=0)
    color = robot_color(1)
    label = f"{words} all {len(curves)} robots"
    panel.fill_between(every, low, high, color=color, alpha=0.13, linewidth=0, label=label)
    panel.fill_between(
        every, lower, upper, color=color, alpha=0.3, linewidth=0, label="the middle half of them"
    )
    panel.plot(every, middle, color=color, linewidth=1.4, label="their median")


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
