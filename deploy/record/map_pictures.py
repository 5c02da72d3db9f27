"""Pictures of a run: the world with the robots' paths, and each robot's map at the end."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray

from deploy.record import colors
from deploy.record.records import Records
from deploy.scenario.plan import Plan
from protocol.grid import Grid
from worldsim.atomic_files import write_whole
from worldsim.maps import Map

CELLS = ListedColormap(["#c3c7cc", "#ffffff", "#20242a"])
"""Unknown, free, occupied."""
COLUMNS = 4


def robot_color(robot: int) -> tuple[float, ...]:
    """The colour of a robot in all pictures."""
    return tuple(part / 255 for part in colors.robot_color(robot))


def save(path: Path, figure: Figure, dpi: int) -> None:
    """Write a figure atomically, in the format of the file's suffix."""
    write_whole(path, lambda file: figure.savefig(file, format=path.suffix[1:] or "png", dpi=dpi))


def draw_map(path: Path, world_map: Map) -> None:
    """Draw a map with metres on its axes."""
    figure = Figure(figsize=(7, 7 * world_map.height / world_map.width + 0.6), layout="constrained")
    axes = figure.add_subplot()
    show_grid(axes, world_map, world_map.cells)
    axes.set_title(
        f"{world_map.name}: {world_map.width} x {world_map.height} cells of {world_map.resolution:g} m"
    )
    save(path, figure, dpi=110)


def draw_maps(path: Path, plan: Plan, records: Records, summary: dict[str, Any]) -> None:
    """Write the picture of `maps_figure` to a file."""
    save(path, maps_figure(plan, records, summary), dpi=110)


def maps_figure(plan: Plan, records: Records, summary: dict[str, Any]) -> Figure:
    """Draw the world with all paths, the team's map, and each robot's planning grid, in one figure."""
    robots = sorted(records.planning)
    panels = 2 + len(robots)
    columns = min(COLUMNS, panels)
    rows = -(-panels // columns)
    shape = plan.map.height / plan.map.width
    figure = Figure(figsize=(3.6 * columns, rows * (3.4 * shape + 0.5) + 0.5), layout="constrained")
    axes = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    show_grid(axes[0], plan.map, plan.map.cells)
    draw_paths(axes[0], plan, records)
    axes[0].set_title("the world and the ways driven")
    team = np.maximum.reduce([records.own[robot] for robot in sorted(records.own)])
    show_grid(axes[1], plan.map, team)
    axes[1].set_title(f"what the team has seen: {100 * summary['coverage']:.1f} %")
    for panel, robot in zip(axes[2:], robots, strict=False):
        show_grid(panel, plan.map, records.planning[robot])
        first = ", done first" if robot == summary["first_robot"] else ""
        panel.set_title(f"robot {robot}'s planning map{first}", color=robot_color(robot))
    for panel in axes[panels:]:
        panel.set_axis_off()
    bandwidth = summary["bandwidth"]
    medium = bandwidth if isinstance(bandwidth, str) else f"{bandwidth} bytes a step"
    figure.suptitle(
        f"{plan.map.name}: {summary['robots']} robots, {summary['exchange']}, {medium}; "
        f"{summary['steps']} steps, {summary['bytes']['total'] / 1000:.0f} kB on the air"
    )
    return figure


def show_grid(axes: Axes, world_map: Map, grid: Grid) -> None:
    """Show a grid of the world's cells, with metres on the axes."""
    cell, (left, bottom, _) = world_map.resolution, world_map.origin
    extent = (left, left + cell * world_map.width, bottom, bottom + cell * world_map.height)
    axes.imshow(grid, cmap=CELLS, vmin=0, vmax=2, extent=extent, interpolation="nearest")
    axes.tick_params(labelsize=7)
    axes.set_xlabel("m", fontsize=7)


def draw_paths(axes: Axes, plan: Plan, records: Records) -> None:
    """Draw the paths of the robots, in metres."""
    poses: list[NDArray[np.int32]] = [
        np.frombuffer(report.poses, "<i4").reshape(-1, 4) for report in records.world
    ]
    if not poses:
        return
    cell, (left, bottom, _) = plan.map.resolution, plan.map.origin
    track = np.concatenate(poses)
    for robot in range(records.robots):
        own = track[track[:, 0] == robot]
        x = left + own[:, 1] / 1000 + cell / 2
        y = bottom + cell * (plan.map.height - 0.5) - own[:, 2] / 1000
        axes.plot(x, y, color=robot_color(robot), linewidth=0.9, label=f"{robot}")
        axes.plot(x[-1:], y[-1:], "o", color=robot_color(robot), markersize=4)
