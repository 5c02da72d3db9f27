"""Draw the pictures of docs/concepts.md: python docs/pictures.py [FOLDER].

``python docs/pictures.py gallery FILE.png`` draws the paths of a team with each strategy instead (docs/strategies.md).
``python docs/pictures.py noisy FILE.png`` draws maps of noisy lasers (docs/real-sensors.md).
``python docs/pictures.py maps FILE.png`` draws a map of each kind of building (docs/maps.md).
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from numpy.typing import NDArray

from agent.outline.contour import contours
from agent.outline.polygons import SIDE_X, SIDE_Y, Polygons
from agent.strategies.registry import strategies
from deploy.record.colors import ALARM, CELLS, GROUPS, Color, robot_color
from deploy.record.map_pictures import draw_paths, show_grid
from deploy.run.in_memory import MemoryRun
from deploy.scenario import plan
from deploy.scenario.scenario import parse
from murmur import Step, steps
from worldsim import generators

AFTER = 80
"""The step in the pictures."""
BUDGET = 250
"""Bytes per step."""
SHADES = ListedColormap(np.array(CELLS) / 255)


def main(folder: Path) -> None:
    """Draw all pictures into a folder."""
    folder.mkdir(exist_ok=True)
    taken = {name: _taken(name) for name in ("polygons", "predictive")}
    _save(outline(taken["polygons"][-1]), folder / "outline.png")
    _save(knowledge(taken["polygons"][-1]), folder / "knowledge.png")
    _save(sent(taken), folder / "bytes.png")


def _taken(map_encoding: str) -> list[Step]:
    run = steps(
        map="office", map_encoding=map_encoding, strategy="meier", robots=3, range=12, bandwidth=BUDGET
    )
    return [next(run) for _ in range(AFTER)]


def outline(step: Step) -> plt.Figure:
    """One robot's grid, the exact contour of its free space, and the polygons that it sends."""
    robot = step.robots[0]
    figure, panels = plt.subplots(1, 3, figsize=(10.5, 4), layout="constrained")
    exact, approximation = contours(robot.own, robot.cell), robot.polygons[0]
    for axes, title, polygons in zip(
        panels,
        (
            "own grid of robot 0",
            f"its exact contour: {len(exact.x)} points",
            f"polygons sent: {len(approximation.x)} vertices",
        ),
        (None, exact, approximation),
        strict=True,
    ):
        _draw(axes, robot.own, title)
        if polygons is not None:
            for x, y in _rings(polygons):
                axes.plot(x, y, color=_rgb(robot_color(0)), linewidth=1.2, marker="o", markersize=1.5)
    return figure


def knowledge(step: Step) -> plt.Figure:
    """Each robot's planning map."""
    figure, panels = plt.subplots(1, len(step.robots), figsize=(10.5, 4), layout="constrained")
    for axes, robot in zip(panels, step.robots.values(), strict=True):
        _draw(axes, robot.planning, f"planning map of robot {robot.number}")
        axes.plot(*robot.cell, "o", color=_rgb(robot_color(robot.number)), markersize=7)
        if robot.target is not None:
            axes.plot(*robot.target, "x", color=_rgb(robot_color(robot.number)), markersize=7)
    return figure


def sent(runs: dict[str, list[Step]]) -> plt.Figure:
    """Bytes of each step by purpose, and the budget; a panel for each run."""
    figure, panels = plt.subplots(
        len(runs), figsize=(10.5, 2.6 * len(runs)), sharex=True, layout="constrained"
    )
    for axes, (title, taken) in zip(panels, runs.items(), strict=True):
        numbers = [step.number for step in taken]
        below = np.zeros(len(taken))
        for group in GROUPS.values():
            size = np.array([_bytes(step, group.kinds) for step in taken])
            if size.any():
                axes.bar(numbers, size, bottom=below, label=group.label, color=_rgb(group.color), width=1.0)
                below += size
        axes.axhline(BUDGET, color=_rgb(ALARM), linewidth=1)
        axes.set(xlim=(0.5, len(taken) + 0.5), ylim=(0, 1.7 * BUDGET), ylabel="bytes transmitted")
        axes.set_title(f"{title}: {below.mean():.0f} bytes per step", loc="left")
        axes.legend(frameon=False, loc="upper right", ncols=3)
        axes.spines[["top", "right"]].set_visible(False)
    panels[-1].set_xlabel("step")
    return figure


def gallery(path: Path) -> None:
    """Run the same scenario with each strategy, and draw one panel per strategy."""
    scenario = {
        "map": "office-obstacles", "robots": 3, "seed": 2, "map_encoding": "scans", "bandwidth": "unlimited",
        "bus": "memory", "sensor_range": 3.0, "speed": 0.5, "scanner_turn": 72,
    }  # fmt: skip
    plans = {name: plan.make(parse(scenario | {"strategy": name})) for name in strategies()}
    rows = -(-len(plans) // 4)
    figure, panels = plt.subplots(
        rows, 4, figsize=(14.4, 3.1 * rows), sharex=True, sharey=True, layout="constrained"
    )
    for axes, (name, made) in zip(panels.flat, plans.items(), strict=False):
        records = MemoryRun(made).complete()
        show_grid(axes, made.map, made.map.cells)
        draw_paths(axes, made, records)
        end = records.end
        done = end is not None and end.first >= 0
        axes.set_title(f"{name}: {records.step} steps" + ("" if done else ", stalled"), fontsize=10)
        axes.set_xlabel("")
    for axes in panels.flat[len(plans) :]:
        axes.set_axis_off()
    figure.savefig(path, dpi=80)


def noisy(path: Path) -> None:
    """Let teams with different lasers and encodings explore an office, and draw the map of a robot of each."""
    good = {"laser": {"preset": "utm-30lx"}, "pose": {"preset": "graph-slam"}}
    poor = {"laser": {"preset": "rplidar-a1"}, "pose": {"preset": "particle-filter"}, "people": {"number": 3}}
    teams: dict[str, dict[str, Any]] = {
        "exact sensors": {},
        "utm-30lx, graph-slam": good,
        "rplidar-a1, particle-filter, 3 people": poor,
        "utm-30lx, graph-slam: zstd-maps": good | {"map_encoding": "zstd-maps", "bandwidth": "unlimited"},
        "utm-30lx, graph-slam: slam-toolbox": good
        | {"map_encoding": "slam-toolbox", "bandwidth": "unlimited"},
    }
    figure, panels = plt.subplots(2, 3, figsize=(10.5, 8), layout="constrained")
    common = {"map": "office", "robots": 5, "bandwidth": 60, "dissemination": "gossip"}
    _draw(panels.flat[0], plan.make(parse(common)).map.cells, "the building")
    for axes, (title, team) in zip(panels.flat[1:], teams.items(), strict=True):
        size = 0
        for step in steps(**common | team):
            size += int(step.traffic.filter(step.traffic["carried"])["bytes"].sum())
        _draw(axes, step.robots[1].planning, f"{title}\n{step.number} steps, {size:,} bytes")
    figure.savefig(path, dpi=80)


def kinds(path: Path) -> None:
    """Draw the map of each kind of building with seed 0, with meters on the axes."""
    names = ("office", "wings", "mixed", "office-campus", "caves", "maze", "warehouse", "unstructured")
    figure, panels = plt.subplots(2, 4, figsize=(14.4, 6.6), layout="constrained")
    for axes, name in zip(panels.flat, names, strict=True):
        made = generators.make(name)
        show_grid(axes, made, made.cells)
        axes.set_title(name)
        axes.set(xlabel="", ylabel="")
    figure.savefig(path, dpi=80)


def _bytes(step: Step, kinds: tuple[str, ...]) -> int:
    rows = step.traffic
    return int(rows.filter(rows["carried"] & rows["kind"].is_in(kinds))["bytes"].sum())


def _rgb(color: Color) -> tuple[float, float, float]:
    red, green, blue = color
    return red / 255, green / 255, blue / 255


def _draw(axes: Axes, grid: NDArray[np.uint8], title: str) -> None:
    axes.imshow(grid, cmap=SHADES, vmin=0, vmax=2, interpolation="nearest")
    axes.set(title=title, xticks=[], yticks=[])


def _rings(polygons: Polygons) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Yield the closed line of each polygon, in cells."""
    x, y = polygons.x + SIDE_X[polygons.side] / 4, polygons.y + SIDE_Y[polygons.side] / 4
    for begin, end in zip(polygons.start[:-1], polygons.start[1:], strict=True):
        ring = [*range(begin, end), begin]
        yield x[ring], y[ring]


def _save(figure: plt.Figure, path: Path) -> None:
    figure.savefig(path, dpi=90)
    plt.close(figure)


OTHERS = {"gallery": gallery, "noisy": noisy, "maps": kinds}
"""Pictures of other pages, by the first word of the command."""

if __name__ == "__main__":
    arguments = sys.argv[1:] or [str(Path(__file__).parent / "concepts")]
    draw = OTHERS.get(arguments[0], main)
    draw(Path(arguments[-1]))
