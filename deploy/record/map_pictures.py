"""Pictures of a run: the world with the robots' paths, and the errors of each robot's map."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import IO, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray
from PIL import Image

from deploy.record import colors
from deploy.record.colors import Color
from deploy.record.map_errors import (
    DIFFERENCES,
    ERRORS,
    SCAN_DIFFERENCES,
    compare,
    share_correct,
)
from deploy.record.number_texts import counted, percent
from deploy.record.records import Records
from deploy.record.ticks import round_number
from deploy.scenario.plan import Plan
from protocol.grid import Grid
from worldsim.atomic_files import write_whole
from worldsim.maps import Map

Rgb = tuple[float, float, float]

CELLS = ListedColormap(["#c3c7cc", "#ffffff", "#20242a"])
"""Unknown, free, occupied."""
MAP_ERRORS = ListedColormap([tuple(part / 255 for part in color) for color in colors.MAP_ERRORS])

PAGE_WIDTH, PAGE_SHAPE = 14.4, 1.4
"""Width of the picture of all maps in inches, and its approximate ratio of width to height."""
HEAD, FOOT, MARGIN, TITLE = 0.4, 0.8, 0.4, 0.22
"""Space in inches above and below all panels, for the tick labels at the left, and for the title of a panel."""
SPACING = ((6, 1, 0.28), (30, 2, 0.28), (90, 3, 0.14), (math.inf, 5, 0.1))
"""Per maximum number of robots: size of the two large panels in robot panels, and the gap between panels in inches."""
NAME_LENGTH = 40
"""Characters of a map's name in a title at most."""
LETTER = 0.52
"""Average width of a letter / font size."""
SHADES = 24
"""Number of shades along a path."""


def rgb(color: Color) -> Rgb:
    """Convert a color for matplotlib."""
    red, green, blue = color
    return red / 255, green / 255, blue / 255


def robot_rgb(robot: int) -> Rgb:
    """The color of a robot, for matplotlib."""
    return rgb(colors.robot_color(robot))


def save(path: Path, figure: Figure, dpi: int) -> None:
    """Write a figure atomically, in the format of the file's suffix."""
    kind = path.suffix[1:] or "png"
    if kind == "png":
        write_whole(path, lambda file: _write_png(file, figure, dpi))
    else:
        write_whole(path, lambda file: figure.savefig(file, format=kind, dpi=dpi))


def _write_png(file: IO[bytes], figure: Figure, dpi: int) -> None:
    """Write a figure as a PNG without transparency; `Figure.savefig` writes larger files and takes longer."""
    canvas = FigureCanvasAgg(figure)
    figure.set_dpi(dpi)
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    picture.save(file, "PNG", dpi=(dpi, dpi), compress_level=4)


def shortened(name: str, most: int = NAME_LENGTH) -> str:
    """A name without its middle if it is longer than `most` characters."""
    half = (most - 1) // 2
    return name if len(name) <= most else f"{name[:half]}\N{HORIZONTAL ELLIPSIS}{name[-half:]}"


def draw_map(path: Path, world_map: Map) -> None:
    """Draw a map with meters on its axes."""
    tall = min(7 * world_map.height / world_map.width, 14.0)
    figure = Figure(figsize=(7, tall + 0.6), layout="constrained")
    axes = figure.add_subplot()
    show_grid(axes, world_map, world_map.cells)
    figure.suptitle(
        f"{shortened(world_map.name)}: {world_map.width} x {world_map.height} cells of "
        f"{world_map.resolution:g} m", fontsize=11,
    )  # fmt: skip
    save(path, figure, dpi=110)


def maps_figure(plan: Plan, records: Records, summary: dict[str, Any]) -> Figure:
    """Draw the world with all paths, and the errors of the team's and of each robot's map, on one page.

    A robot's map is its planning grid; the team's map is the union of the self-explored grids.
    """
    robots = sorted(records.planning)
    figure, (world, team, *panels) = _page(len(robots), plan.map.height / plan.map.width)
    show_grid(world, plan.map, plan.map.cells)
    draw_paths(world, plan, records)
    what, like, differences = _reference(plan)
    _set_title(world, f"{what} and the robots' paths", 11)
    seen = records.team_map(summary["refuted_maps"])
    reachable = plan.reachable
    _show_errors(team, plan, compare(seen, plan.map.cells, reachable))
    team.tick_params(bottom=False, left=False, labelbottom=False, labelleft=False)
    share = f": {percent(summary['coverage'])}" if plan.has_truth else ""
    _set_title(team, f"seen by the team{share}", 11)
    width = panels[0].get_position().width * PAGE_WIDTH if panels else 0
    size = min(11.0, 3.2 + 3.0 * width)
    is_short = size <= 8 or width < LETTER * 7 / 72 * len(f"robot 0: 100.0 % {like}, finished first")
    for panel, robot in zip(panels, robots, strict=True):
        is_first = robot == summary["first_robot"]
        errors = compare(records.planning[robot], plan.map.cells, reachable)
        _show_errors(panel, plan, errors)
        for axis in (panel.xaxis, panel.yaxis):
            axis.set_visible(False)
        panel.spines[:].set(linewidth=0.6, color="#9aa1a9")
        right = percent(share_correct(errors, reachable))
        if is_short:
            title = f"{robot}: {right}" + (" \N{CHECK MARK}" if is_first else "")
        else:
            title = f"robot {robot}: {right} {like}" + (", finished first" if is_first else "")
        _set_title(panel, title, size, color=rgb(colors.text_color(robot)))
    bandwidth = summary["bandwidth"]
    medium = bandwidth if isinstance(bandwidth, str) else f"{bandwidth:,} bytes per step"
    top = 1 - 0.26 / figure.get_figheight()
    figure.suptitle(
        f"{shortened(plan.map.name)}: {counted(summary['robots'], 'robot')}, {summary['map_encoding']}, {medium}; "
        f"{counted(summary['steps'], 'step')}, {summary['bytes']['total']:,} B transmitted",
        y=top, va="center",
    )  # fmt: skip
    _draw_legend(figure, records, differences)
    return figure


def _reference(plan: Plan) -> tuple[str, str, dict[int, str]]:
    """Return what robots' maps are compared with, what cells are called that agree, and the differences."""
    if not plan.has_truth:
        return "the team's map", "as the team's", DIFFERENCES
    if plan.recording is not None:
        return "the map of all scans", "equal", SCAN_DIFFERENCES
    return "the world", "correct", ERRORS


def area_name(plan: Plan) -> str:
    """Return what shares of the explored area refer to."""
    what, *_ = _reference(plan)
    return "the reachable area" if what == "the world" else what


def show_grid(axes: Axes, world_map: Map, grid: Grid) -> None:
    """Show a grid of the world's cells, with meters on the axes."""
    _show(axes, grid, CELLS, world_map)
    axes.tick_params(labelsize=7)
    axes.set_xlabel("m", fontsize=7, labelpad=1)


def _set_title(axes: Axes, title: str, size: float, **style: Any) -> None:
    """Set the title above a panel, as wide as the panel at most.

    Its height and an estimate of its width are given, as matplotlib lays out all texts to find them.
    """
    size = min(size, axes.get_position().width * PAGE_WIDTH * 72 / (LETTER * len(title)))
    axes.set_title(title, y=1.0, pad=4, fontsize=size, **style)


def draw_paths(axes: Axes, plan: Plan, records: Records) -> None:
    """Draw the robots' paths: pale at the start, a dot every `mark_steps`, the robot's number at the end."""
    every = mark_steps(records.step)
    figure = axes.get_figure()
    assert isinstance(figure, Figure)
    place = axes.get_position()
    size = min(1.5, max(place.width * figure.get_figwidth(), place.height * figure.get_figheight()) / 3.6)
    paths = list(_paths(plan, records))
    lines: list[NDArray[np.float64]] = []
    shades: list[NDArray[np.float64]] = []
    for robot, steps, places in paths:
        color = np.array(robot_rgb(robot))
        bounds = np.linspace(0, len(places) - 1, min(SHADES, len(places)) + 1).round().astype(int)
        parts = [places[a : b + 1] for a, b in pairwise(bounds)]
        lines += parts
        shades.append(1 - np.outer(np.linspace(0.45, 1.0, len(parts)), 1 - color))
        marks = places[steps % every == 0]
        axes.plot(*marks.T, "o", color=color, markersize=2.4 * size, markeredgewidth=0, zorder=3)
    if not paths:
        return
    axes.add_collection(
        LineCollection(lines, colors=np.concatenate(shades), linewidths=size, capstyle="round", zorder=2)
    )
    axes.plot(
        *np.array([places[0] for *_, places in paths]).T, "s", markersize=2.4 * size, markerfacecolor="white",
        markeredgecolor="black", markeredgewidth=0.7, zorder=4,
    )  # fmt: skip
    for robot, _, places in paths:
        axes.plot(
            *places[-1], "o", markersize=8.5 * size, color=robot_rgb(robot), markeredgecolor="white",
            markeredgewidth=0.5, zorder=5 + robot / 1000,
        )  # fmt: skip
        axes.text(
            places[-1, 0], places[-1, 1], str(robot), color="white", fontweight="bold", ha="center",
            fontsize=(6.5, 5.5, 4.2)[len(str(robot)) - 1] * size, va="center_baseline", zorder=5.0005 + robot / 1000,
        )  # fmt: skip


def mark_steps(last: int) -> int:
    """Steps between two dots on a path: a round number, for about ten dots per run."""
    return int(round_number(max(1.0, last / 10)))


def _paths(plan: Plan, records: Records) -> Iterator[tuple[int, NDArray[np.int64], NDArray[np.float64]]]:
    """For each robot its steps and positions, shape (n, 2), in meters in the map's frame."""
    if not records.world:
        return
    poses = [report.pose_rows for report in records.world]
    steps = np.repeat([report.step for report in records.world], [len(of_step) for of_step in poses])
    track = np.concatenate(poses)
    cell, (left, bottom, _) = plan.map.resolution, plan.map.origin
    x = left + track[:, 1] / 1000 + cell / 2
    y = bottom + cell * (plan.map.height - 0.5) - track[:, 2] / 1000
    for robot in range(records.robots):
        own = track[:, 0] == robot
        if own.any():
            yield robot, steps[own], np.column_stack([x[own], y[own]])


def _page(robots: int, shape: float) -> tuple[Figure, list[Axes]]:
    """A page with two large panels and one panel per robot, for maps of ratio `shape` of height to width."""
    _, large, gap = next(row for row in SPACING if robots <= row[0])
    taken = robots + 2 * large * large

    def size(columns: int) -> tuple[int, float]:
        """Number of rows, and height of the page, for a number of columns."""
        rows = max(large, -(-taken // columns))
        side = PAGE_WIDTH / columns - gap
        return rows, rows * (side * shape + TITLE + gap) + HEAD + FOOT

    def penalty(columns: int) -> float:
        rows, height = size(columns)
        return abs(math.log(PAGE_WIDTH / height / PAGE_SHAPE)) + 1 - taken / (rows * columns)

    columns = min(range(2 * large, 2 * large + robots + 2), key=penalty)
    rows, height = size(columns)
    figure = Figure(figsize=(PAGE_WIDTH, height))
    panel_width, panel_height = PAGE_WIDTH / columns - gap, (height - HEAD - FOOT) / rows - TITLE - gap
    grid = figure.add_gridspec(
        rows, columns, wspace=gap / panel_width, hspace=(TITLE + gap) / panel_height, left=MARGIN / PAGE_WIDTH,
        right=1 - gap / PAGE_WIDTH, top=1 - (HEAD + TITLE) / height, bottom=FOOT / height,
    )  # fmt: skip
    places = [grid[:large, :large], grid[:large, large : 2 * large]]
    places += [grid[r, c] for r in range(rows) for c in range(columns) if r >= large or c >= 2 * large]
    return figure, [figure.add_subplot(place, anchor="N") for place in places[: 2 + robots]]


def _draw_legend(figure: Figure, records: Records, differences: dict[int, str]) -> None:
    """Draw the legend of all panels at the bottom of the page; `differences` names colors of map errors."""
    start: dict[str, Any] = {"markeredgecolor": "black", "markerfacecolor": "white", "markersize": 4}
    disc: dict[str, Any] = {"markerfacecolor": "#555555", "markeredgewidth": 0}
    every = mark_steps(records.step)
    dots = "every step" if every == 1 else f"every {every} steps"
    handles = [
        Line2D([], [], marker="s", label="start", color="none", **start),
        Line2D([], [], marker="o", label="end", color="none", markersize=8, **disc),
        Line2D([], [], marker="o", label=dots, color="none", markersize=3, **disc),
        *(Patch(color=rgb(colors.MAP_ERRORS[error]), label=text) for error, text in differences.items()),
        Patch(facecolor=rgb(colors.MAP_ERRORS[2]), label="wall"),
    ]  # fmt: skip
    figure.legend(
        handles=handles, loc="lower center", ncols=len(handles), fontsize=9, frameon=False,
        bbox_to_anchor=(0.5, 0.04 / figure.get_figheight()),
    )  # fmt: skip


def _show_errors(axes: Axes, plan: Plan, errors: NDArray[np.uint8]) -> None:
    _show(axes, errors, MAP_ERRORS, plan.map)


def _show(axes: Axes, cells: NDArray[np.uint8], palette: ListedColormap, world_map: Map) -> None:
    """Show cells in the colors of a palette; they are colored before they are enlarged, which is faster."""
    cell, (left, bottom, _) = world_map.resolution, world_map.origin
    extent = left, left + cell * world_map.width, bottom, bottom + cell * world_map.height
    axes.imshow(
        cells, cmap=palette, vmin=0, vmax=palette.N - 1, extent=extent, interpolation="nearest",
        interpolation_stage="rgba",
    )  # fmt: skip
