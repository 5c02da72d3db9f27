"""Figures of a finished run, modeled on those of the thesis: maps over time, and the radio traffic.

maps over time     planning maps, and the outlines that each robot sends (Figure A.2)
approximation      one robot's own map and its approximation over time (Figure 4.8)
channel load       explored area over time; bytes that were transmitted, and that were not; undelivered log entries
                   (Figures 6.17, 6.18)
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike, NDArray

from deploy.after.archive import Archive
from deploy.dashboard.shapes import outline_strips
from deploy.record.colors import GROUPS, text_color
from deploy.record.map_pictures import area_name, rgb, robot_rgb, save, show_grid
from deploy.record.number_texts import percent
from protocol.budget import WORD_FOR_UNLIMITED
from protocol.grid import FREE

MAPS_OVER_TIME, APPROXIMATION, CHANNEL_LOAD = "maps-over-time.png", "approximation.png", "channel-load.png"
MOST_ROBOTS = 8
"""Maximum number of columns, one per robot, in the picture of maps over time."""
MOST_CURVES = 10
"""Maximum number of robots with a curve each."""
MOST_HEADROOM = 10
"""A figure has a line at the budget if the budget is at most this many times the bytes of the busiest step."""
MOMENTS = 6
LEAST_WIDTH = 3.6
"""Inches of the picture of maps over time at least: as wide as its title."""
LEAST_ROW = 0.75
"""Inches of a row in the picture of maps over time at least: as high as the label beside it."""
MOST_ROW, LEAST_COLUMN = 5.0, 0.75
"""Inches of a row of maps at most, which matters for tall maps, and of a column at least, as wide as its title."""
COMPARED = ("#20242a", "#d9730d", "#1f77b4", "#2ca02c")
"""Colors of compared runs."""
RED = "#d62728"

Curves = dict[int, NDArray[np.float64]]
"""By robot: a value per step, from step 1; NaN where the robot has none."""


def write_figures(archive: Archive, folder: Path) -> list[Path]:
    """Draw all figures for which a run has data; return the files."""
    folder.mkdir(exist_ok=True)
    figures: dict[str, Figure] = {CHANNEL_LOAD: channel_load(archive)}
    if archive.maps.steps(0):
        figures[MAPS_OVER_TIME] = maps_over_time(archive)
        if archive.maps.maps_held(0):
            figures[APPROXIMATION] = approximation(archive)
    for name, figure in figures.items():
        save(folder / name, figure, dpi=100)
    return [folder / name for name in figures]


def maps_over_time(archive: Archive) -> Figure:
    """Draw planning maps, one column per robot, one row per point in time; in red the outlines that each sends."""
    robots = range(min(MOST_ROBOTS, archive.plan.scenario.robots))
    moments = _moments(archive.last_step)
    shape = archive.plan.map.height / archive.plan.map.width
    wide = max(1.45, 11 / len(robots)) if len(robots) > 3 else 3.2
    wide = max(min(wide, MOST_ROW / shape), LEAST_COLUMN)
    row = min(max(wide * shape, LEAST_ROW), MOST_ROW)
    size = max(wide * len(robots) + 0.4, LEAST_WIDTH), (row + 0.1) * len(moments) + 0.7
    figure = Figure(figsize=size, layout="constrained")
    axes = np.atleast_2d(figure.subplots(len(moments), len(robots), squeeze=False))
    for row, step in enumerate(moments):
        for robot in robots:
            panel = axes[row, robot]
            grid = archive.maps.planning(robot, step)
            if grid is None:
                panel.set_axis_off()
                continue
            _draw(panel, archive, grid, archive.maps.outlines(robot, robot, step))
            panel.set(xticks=[], yticks=[], xlabel="")
        axes[row, 0].set_ylabel(f"step {step}")
    for robot in robots:
        axes[0, robot].set_title(f"robot {robot}", color=rgb(text_color(robot)), fontsize=min(12, 10 * wide))
    every = archive.plan.scenario.robots
    whose = (
        "Each robot's planning map"
        if len(robots) == every
        else f"Planning maps of robots 0 to {robots[-1]} of {every}"
    )
    sent = ",\nand (red) the approximation that a robot sends" if archive.maps.maps_held(0) else ""
    figure.suptitle(f"{whose}{sent}")
    return figure


def approximation(archive: Archive) -> Figure:
    """Draw the own map of robot 0 over time, and its approximation of it.

    White outside the red line, and grey inside it, are the errors of the approximation at that step.
    """
    moments = _moments(archive.last_step)
    shape = archive.plan.map.height / archive.plan.map.width
    figure = Figure(figsize=(11, 2 * (min(11 / 3 * shape, MOST_ROW) + 0.3) + 0.6), layout="constrained")
    for panel, step in zip(figure.subplots(2, 3).ravel(), moments, strict=False):
        own = archive.maps.own(0, step)
        if own is None:
            panel.set_axis_off()
            continue
        outlines = archive.maps.outlines(0, 0, step)
        _draw(panel, archive, own, outlines, width=1.2)
        corners = len(outlines) // 8
        panel.set_title(f"step {step}: {corners} corners", fontsize=9)
    figure.suptitle("Robot 0's own map, and (red) its approximation of it")
    return figure


def channel_load(archive: Archive) -> Figure:
    """Draw three panels over time: the explored area, transmitted bytes by traffic type, and bytes not transmitted.

    Teams of up to `MOST_CURVES` robots have a curve per robot; larger ones have the median, the middle half and the
    extremes.
    """
    figure = Figure(figsize=(11, 9), layout="constrained")
    explored, load, wait = figure.subplots(3, 1, sharex=True, height_ratios=[4, 3, 2.5])
    draw_explored(explored, archive)
    draw_load(load, archive)
    packets = _draw_waiting(wait, archive)
    for axes in (load, wait, packets):
        axes.set_ylim(0, max(1.0, axes.get_ylim()[1]))
    for panel, other in ((explored, None), (load, None), (wait, packets)):
        panel.grid(alpha=0.25)
        lines, labels = panel.get_legend_handles_labels()
        if other is not None:
            more_lines, more_labels = other.get_legend_handles_labels()
            lines, labels = lines + more_lines, labels + more_labels
        if lines:
            panel.legend(
                lines, labels, loc="upper left", bbox_to_anchor=(1.1, 1.03), fontsize=8, frameon=False
            )
    wait.set_xlabel("step")
    show_steps(wait, archive.last_step)
    return figure


def show_steps(panel: Axes, last: int) -> None:
    """Set the limits of an axis of steps, from the left of the bar of step 1 to the right of the last one."""
    panel.set_xlim(0.5, last + 0.5)
    panel.xaxis.set_major_locator(MaxNLocator("auto", steps=[1, 2, 5, 10], integer=True, min_n_ticks=1))


def compared(archives: dict[str, Archive]) -> Figure:
    """Draw the explored area of several runs over time, and below it the bytes that they transmitted."""
    figure = Figure(figsize=(11, 7), layout="constrained")
    explored, load = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
    budgets = {archive.plan.scenario.bandwidth for archive in archives.values()}
    for number, (name, archive) in enumerate(archives.items()):
        color = COMPARED[number % len(COMPARED)]
        steps, at = np.unique(archive.steps["step"], return_index=True)
        explored.plot(
            steps, 100 * archive.steps["team_seen"][at], _mark(archive), color=color, linewidth=2, label=name
        )
        carried = _per_step(archive.ledger, archive.ledger["carried"].astype(bool), archive.last_step)
        load.stairs(carried, _edges(archive), color=color, linewidth=1, baseline=None,
                    label=f"{name}: {carried.sum():,.0f} B in total")  # fmt: skip
    if len(budgets) == 1 and WORD_FOR_UNLIMITED not in budgets:
        budget = float(*budgets)
        if _is_far_above(np.array([budget]), np.array([load.dataLim.y1])):
            load.plot(
                [], [], color=RED, linewidth=1.2, label=f"budget: {budget:,.0f} bytes per step, far above"
            )
        else:
            load.axhline(budget, color=RED, linewidth=1.2, label="budget")
    areas = " or ".join(dict.fromkeys(area_name(archive.plan) for archive in archives.values()))
    explored.set(title="Explored", ylabel=f"% of {areas}, seen by the team", ylim=(0, 102))
    ylim = 0, max(1.0, load.get_ylim()[1])
    load.set(title="Transmitted", xlabel="step", ylabel="bytes per step", ylim=ylim)
    for panel in (explored, load):
        panel.grid(alpha=0.25)
        panel.legend(loc="lower right" if panel is explored else "best", fontsize=9)
    show_steps(load, max(archive.last_step for archive in archives.values()))
    return figure


def draw_explored(panel: Axes, archive: Archive) -> None:
    """Draw the area that the team has seen over time, and the area on each robot's map."""
    first = archive.steps
    steps, at = np.unique(first["step"], return_index=True)
    panel.plot(
        steps,
        100 * first["team_seen"][at],
        _mark(archive),
        color="black",
        linewidth=2.2,
        label="seen by the team",
    )
    reachable = archive.plan.reachable
    curves: Curves = {}
    for robot in range(archive.plan.scenario.robots):
        changed = archive.maps.steps(robot)
        grids = [archive.maps.planning(robot, step) for step in changed]
        known = [100 * float((grid[reachable] == FREE).mean()) for grid in grids if grid is not None]
        curves[robot] = _per_lived_step(archive, robot, changed, known)
    _draw_curves(panel, curves, "on the map of", _mark(archive))
    panel.set(title="Explored", ylabel=f"% of {area_name(archive.plan)}", ylim=(0, 102))


def draw_load(panel: Axes, archive: Archive) -> None:
    """Draw transmitted bytes by traffic type and step, and their share of the budget."""
    ledger, last, edges = archive.ledger, archive.last_step, _edges(archive)
    carried = {
        name: _per_step(ledger, np.isin(ledger["kind"], group.kinds) & ledger["carried"], last)
        for name, group in GROUPS.items()
    }
    shown = {name: values for name, values in carried.items() if values.any()}
    below = np.zeros(last)
    for name, values in shown.items():
        panel.stairs(
            below + values, edges, baseline=below, fill=True, color=rgb(GROUPS[name].color), linewidth=0,
            label=GROUPS[name].label,
        )  # fmt: skip
        below = below + values
    budgets = archive.budgets[1:]
    title = "Transmitted"
    if np.isfinite(budgets).any():
        few = f": {budgets[0]:,.0f} bytes per step" if len(set(budgets.tolist())) == 1 else ""
        if _is_far_above(budgets, below):
            panel.plot([], [], color=RED, linewidth=1.2, label=f"budget{few}, far above")
        else:
            panel.stairs(budgets, edges, baseline=None, color=RED, linewidth=1.2, label=f"budget{few}")
    if np.isfinite(budgets).all():
        used = sum(values.sum() for values in carried.values()) / max(1.0, budgets.sum())
        title += f": {percent(used, 0) if used >= 0.01 else 'less than 1 %'} of the budget"
    if len(set(budgets.tolist())) == 1 and 0 < budgets[0] < math.inf:
        hundredth = budgets[0] / 100
        scales = (lambda size: size / hundredth), (lambda share: share * hundredth)
        share = panel.secondary_yaxis("right", functions=scales)
        share.set_ylabel("% of the budget")
    panel.set(title=title, ylabel="bytes per step")


def _draw_waiting(panel: Axes, archive: Archive) -> Axes:
    """Draw bytes that were not transmitted; return a second axis with each robot's undelivered log entries.

    With gossip, poses and targets have a share of the budget, so that some are refused although budget is left.
    """
    cut = _per_step(archive.ledger, archive.ledger["cause"] == "budget", archive.last_step)
    shares = "\nor the share of poses and targets" if archive.plan.radio.gossip else ""
    panel.stairs(
        cut, _edges(archive), fill=True, color="#c9ccd1", label=f"bytes over the step's budget{shares}"
    )
    panel.set(title="Not transmitted", ylabel="bytes per step")
    entries = panel.twinx()
    rows = {robot: archive.of_robot(robot) for robot in range(archive.plan.scenario.robots)}
    backlogs = {
        robot: _per_lived_step(archive, robot, own["step"], own["backlog"]) for robot, own in rows.items()
    }
    _draw_curves(entries, backlogs, "log entries of", _mark(archive))
    entries.set_ylabel("undelivered log entries")
    return entries


def _is_far_above(budgets: NDArray[np.float64], carried: NDArray[np.float64]) -> bool:
    """Return whether bars of the carried bytes would be too low to be seen below a line of the budgets."""
    return bool(0 < MOST_HEADROOM * carried.max(initial=0.0) < budgets.min())


def _edges(archive: Archive) -> NDArray[np.float64]:
    """The edges between the bars of steps."""
    return np.arange(archive.last_step + 1, dtype=np.float64) + 0.5


def _mark(archive: Archive) -> str:
    """The format of curves: a line, or a dot for a run of one step."""
    return "-" if archive.last_step > 1 else "o"


def _draw_curves(panel: Axes, curves: Curves, label: str, mark: str) -> None:
    """Draw a curve per robot, or the distribution over many robots."""
    table = np.stack(list(curves.values()))
    every = np.arange(1, table.shape[1] + 1)
    if len(curves) <= MOST_CURVES:
        for robot, values in curves.items():
            panel.plot(
                every, values, mark, color=robot_rgb(robot), linewidth=1.0, label=f"{label} robot {robot}"
            )
        return
    known = np.isfinite(table).any(axis=0)
    shares = np.full((5, len(every)), np.nan)
    shares[:, known] = np.nanpercentile(table[:, known], [0, 25, 50, 75, 100], axis=0)
    low, lower, middle, upper, high = shares
    color = robot_rgb(1)
    every_robot = f"{label} all {len(curves)} robots"
    panel.fill_between(every, low, high, color=color, alpha=0.13, linewidth=0, label=every_robot)
    panel.fill_between(every, lower, upper, color=color, alpha=0.3, linewidth=0, label="middle half")
    panel.plot(every, middle, mark, color=color, linewidth=1.4, label="median")


def _per_lived_step(archive: Archive, robot: int, steps: ArrayLike, values: ArrayLike) -> NDArray[np.float64]:
    """A robot's values at some steps, interpolated over each of its lives; NaN while it was dead.

    After the last value of a life, the curve continues with it; before the first, there is none.
    """
    at, known = np.asarray(steps), np.asarray(values, np.float64)
    lived = archive.of_robot(robot)["step"]
    curve = np.full(archive.last_step + 1, np.nan)
    for life in np.split(lived, np.flatnonzero(np.diff(lived) > 1) + 1):
        within = np.isin(at, life)
        if within.any():
            curve[life] = np.interp(life, at[within], known[within], left=np.nan)
    return curve[1:]


def _per_step(ledger: dict[str, NDArray[Any]], rows: NDArray[np.bool_], last: int) -> NDArray[np.float64]:
    """Bytes of the chosen rows in each step, from step 1."""
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
