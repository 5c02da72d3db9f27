"""A finished run as a sequence of pictures, one a step: the frames of films, and of the slider on a report's page.

On top the true map with the robots, under a veil where no robot knows anything yet, and beside it the maps of all
robots; below what is explored over time and the use of the budget, up to the step.
"""

from __future__ import annotations

import math
from functools import cache, cached_property
from itertools import combinations
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from deploy.after.archive import Archive
from deploy.after.figures import draw_explored, draw_load
from deploy.record.colors import CELLS, GREY, IN_RANGE, INK, PAPER, SIGNAL, mix, robot_color
from deploy.record.map_pictures import counted
from deploy.record.snapshots import Snapshots
from netshaper.ledger import EVERYONE
from protocol.grid import FREE, UNKNOWN, Grid

WIDTH = 1280
MARGIN, LABEL, HEAD = 14, 20, 40
"""Points around and between panels, over a panel, and over all of them."""
WORLD_SHARE, CHARTS_SHAPE = 0.44, 0.17
"""The width of the true map over the frame's; height over width of the curves."""
FINE = 2
"""Lines are drawn so many times larger, and then reduced."""
VEIL = 0.32

Place = tuple[float, float]


class Frames:
    """The frames of a run.

    Parameters
    ----------
    archive : Archive
        The run.
    snapshots : Snapshots or None
        The robots' maps over time; without them their panels stay grey.
    width : int
        Of a frame, in pixels.
    """

    def __init__(self, archive: Archive, snapshots: Snapshots | None, width: int = WIDTH) -> None:
        self._archive = archive
        self._snapshots = snapshots
        self._robots = range(archive.plan.scenario.robots)
        self._reachable = archive.plan.make_world().reachable
        self._scale = width / WIDTH
        self._width = width
        self._place()
        self._thumbs: dict[int, tuple[int, Image.Image, float]] = {}

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of all frames in pixels, even numbers."""
        return self._width // 2 * 2, self._height // 2 * 2

    @property
    def last_step(self) -> int:
        """The last step of the run."""
        return self._archive.last_step

    def at(self, step: int) -> Image.Image:
        """The frame of a step, RGB; after the end of the run that of its last step."""
        step = min(step, self.last_step)
        frame = Image.new("RGB", self.size, PAPER)
        draw = ImageDraw.Draw(frame)
        self._write_head(draw, step)
        known = self._draw_robots_maps(frame, draw, step)
        frame.paste(self._world(step, known), self._world_at)
        self._draw_charts(frame, step)
        return frame

    def _place(self) -> None:
        """Find the place of everything, for this map and this number of robots."""
        px, shape = self._px, self._archive.plan.map.height / self._archive.plan.map.width
        side = round(WORLD_SHARE * self._width)
        wide = side if shape <= 1 else round(side / shape)
        tall = round(wide * shape)
        left, top = px(MARGIN), px(HEAD) + px(LABEL)
        self._world_at, self._world_size = (left, top), (wide, tall)
        grid_left = left + wide + px(MARGIN)
        room = self._width - grid_left - px(MARGIN), max(tall, round(0.2 * self._width)) + px(LABEL)
        many = len(self._robots)

        def unit(columns: int) -> float:
            rows = -(-many // columns)
            return min(room[0] / columns - px(MARGIN) / 2, (room[1] / rows - px(LABEL)) / shape)

        columns = max(range(1, many + 1), key=unit)
        self._unit = max(4, int(unit(columns)))
        across = (room[0] + px(MARGIN) / 2) / columns
        down = self._unit * shape + px(LABEL)
        self._thumbs_at = [
            (round(grid_left + (k % columns) * across), round(px(HEAD) + (k // columns) * down + px(LABEL)))
            for k in self._robots
        ]
        self._charts_top = top + max(tall, room[1] - px(LABEL)) + px(MARGIN)
        self._height = self._charts_top + round(CHARTS_SHAPE * self._width)

    def _px(self, points: float) -> int:
        return round(points * self._scale)

    def _write_head(self, draw: ImageDraw.ImageDraw, step: int) -> None:
        scenario, px = self._archive.plan.scenario, self._px
        medium = (
            scenario.bandwidth
            if isinstance(scenario.bandwidth, str)
            else f"{scenario.bandwidth} bytes a step"
        )
        what = (
            f"{self._archive.summary['map']}: {counted(scenario.robots, 'robot')}, {scenario.strategy}, "
            f"{scenario.map_encoding}, {medium}"
        )
        draw.text((px(MARGIN), px(24)), what, INK, _font(px(15)), "lm")
        now = f"step {step} of {self.last_step}"
        draw.text((self._width - px(MARGIN), px(24)), now, INK, _font(px(15), bold=True), "rm")
        seen = float(self._now(step)["team_seen"].max(initial=0.0))
        said = f"the building: {100 * seen:.0f} % seen"
        draw.text((self._world_at[0], px(HEAD + LABEL / 2)), said, INK, _font(px(12)), "lm")

    def _draw_robots_maps(
        self, frame: Image.Image, draw: ImageDraw.ImageDraw, step: int
    ) -> NDArray[np.bool_]:
        """Draw each robot's map; return which cells any of them knows."""
        known: NDArray[np.bool_] = np.zeros(self._archive.plan.map.cells.shape, np.bool_)
        px = self._px
        rows = self._now(step)
        here = {int(robot): k for k, robot in enumerate(rows["robot"])}
        for robot, (left, top) in zip(self._robots, self._thumbs_at, strict=True):
            grid = self._snapshots.planning(robot, step) if self._snapshots is not None else None
            picture, share = self._thumb(robot, grid, step)
            if grid is not None:
                known |= grid != UNKNOWN
            frame.paste(picture, (left, top))
            draw.rectangle(
                (left - 1, top - 1, left + picture.width, top + picture.height), outline=mix(GREY, PAPER, 0.4)
            )
            text = f"robot {robot}: {100 * share:.0f} %" if self._unit > px(110) else f"{robot}"
            font = _font(px(12 if self._unit > px(60) else 9))
            draw.text((left, top - px(LABEL / 2)), text, robot_color(robot), font, "lm")
            if robot in here:
                x, y = self._cell(rows["x"][here[robot]], rows["y"][here[robot]])
                size = self._unit / self._archive.plan.map.width
                disc = _disc(robot, max(3, px(3.2)), numbered=False)
                frame.paste(disc, _centred(disc, left + size * x, top + size * y), disc)
        return known

    def _thumb(self, robot: int, grid: Grid | None, step: int) -> tuple[Image.Image, float]:
        """A robot's map in its panel's size, and its share of the reachable cells; kept until it changes."""
        told = max((s for s in self._told(robot) if s <= step), default=0)
        kept = self._thumbs.get(robot)
        if kept is None or kept[0] != told:
            shown = grid if grid is not None else np.zeros_like(self._archive.plan.map.cells)
            share = float((shown[self._reachable] == FREE).mean())
            kept = told, _picture(_PALETTE[shown], self._unit), share
            self._thumbs[robot] = kept
        return kept[1], kept[2]

    def _told(self, robot: int) -> list[int]:
        return self._snapshots.told_steps(robot) if self._snapshots is not None else []

    def _world(self, step: int, known: NDArray[np.bool_]) -> Image.Image:
        """The true map with ways, targets, links and robots."""
        cells = _PALETTE[self._archive.plan.map.cells].astype(np.float64)
        if self._snapshots is not None:
            cells[~known] = cells[~known] * (1 - VEIL) + np.array(GREY) * VEIL
        panel = _picture(cells.astype(np.uint8), FINE * self._world_size[0])
        draw = ImageDraw.Draw(panel)
        size = FINE * self._world_size[0] / self._archive.plan.map.width
        thin = max(1, round(FINE * self._scale))

        def at(x: float, y: float) -> Place:
            column, row = self._cell(x, y)
            return size * column, size * row

        rows = self._now(step)
        places = {int(r): at(x, y) for r, x, y in zip(rows["robot"], rows["x"], rows["y"], strict=True)}
        for robot in self._robots:
            mine = self._tracks[robot]
            until = int(np.searchsorted(mine["step"], step, "right"))
            way = [at(x, y) for x, y in zip(mine["x"][:until], mine["y"][:until], strict=True)]
            if len(way) > 1:
                draw.line(way, robot_color(robot), thin, joint="curve")
        for pair in combinations(sorted(places), 2):
            busy = pair in self._talks.get(step, ())
            if busy or self._in_range(rows, *pair):
                draw.line([places[k] for k in pair], SIGNAL if busy else IN_RANGE, thin * (2 if busy else 1))
        for robot, x, y in zip(rows["robot"], rows["target_x"], rows["target_y"], strict=True):
            if not math.isnan(x):
                color, (across, down), radius = robot_color(int(robot)), at(x, y), 3 * thin
                draw.line([places[int(robot)], (across, down)], color, thin)
                draw.ellipse((across - radius, down - radius, across + radius, down + radius), color)
        panel = panel.reduce(FINE)
        for robot, (x, y) in places.items():
            disc = _disc(robot, max(5, self._px(9)), numbered=True)
            panel.paste(disc, _centred(disc, x / FINE, y / FINE), disc)
        ImageDraw.Draw(panel).rectangle(
            (0, 0, panel.width - 1, panel.height - 1), outline=mix(GREY, PAPER, 0.4)
        )
        return panel

    def _in_range(self, rows: dict[str, NDArray[Any]], a: int, b: int) -> bool:
        (first,), (second,) = (np.flatnonzero(rows["robot"] == robot) for robot in (a, b))
        x, y = rows["x"], rows["y"]
        away = math.dist((x[first], y[first]), (x[second], y[second]))
        return away <= self._archive.range_m(int(rows["step"][first]))

    def _now(self, step: int) -> dict[str, NDArray[Any]]:
        """The rows of a step."""
        steps = self._archive.steps
        first, end = np.searchsorted(steps["step"], (step, step + 1))
        return {name: column[first:end] for name, column in steps.items()}

    def _cell(self, x: float, y: float) -> Place:
        """A position in cells from the upper left corner."""
        world = self._archive.plan.map
        return (x - world.origin[0]) / world.resolution, world.height - (
            y - world.origin[1]
        ) / world.resolution

    @cached_property
    def _tracks(self) -> dict[int, dict[str, NDArray[Any]]]:
        return {robot: self._archive.of_robot(robot) for robot in self._robots}

    @cached_property
    def _talks(self) -> dict[int, set[tuple[int, int]]]:
        """Which robots carried anything to each other, by step."""
        ledger = self._archive.ledger
        rows = ledger["carried"].astype(bool) & (ledger["receiver"] != EVERYONE)
        talks: dict[int, set[tuple[int, int]]] = {}
        columns = (ledger[name][rows].tolist() for name in ("step", "sender", "receiver"))
        for step, sender, receiver in zip(*columns, strict=True):
            talks.setdefault(step, set()).add((min(sender, receiver), max(sender, receiver)))
        return talks

    def _draw_charts(self, frame: Image.Image, step: int) -> None:
        """The curves up to the step, what comes later pale."""
        charts, spans = self._charts
        frame.paste(charts, (0, self._charts_top))
        draw = ImageDraw.Draw(frame, "RGBA")
        for left, right, top, bottom in spans:
            last = max(1, self.last_step)
            x = left + (right - left) * (step - 1) / max(1, last - 1)
            up, down = self._charts_top + top, self._charts_top + bottom
            draw.rectangle((x, up, right, down), (255, 255, 255, 205))
            draw.line([(x, up), (x, down)], (*INK, 255), max(1, self._px(1.4)))

    @cached_property
    def _charts(self) -> tuple[Image.Image, list[tuple[float, float, float, float]]]:
        """The curves of the whole run, and where their panels lie: left, right, top, bottom."""
        dpi = 100.0
        wide, tall = self.size[0] / dpi, (self.size[1] - self._charts_top) / dpi
        with matplotlib.rc_context({"font.size": 8.5 * self._scale, "axes.titlesize": 9.5 * self._scale}):
            figure = Figure(figsize=(wide, tall), dpi=dpi, layout="constrained")
            explored, load = figure.subplots(1, 2, width_ratios=[1, 1])
            draw_explored(explored, self._archive, self._snapshots)
            draw_load(load, self._archive)
            for panel in (explored, load):
                panel.set_xlim(1, max(2, self.last_step))
                panel.set_ylim(0, max(1.0, panel.get_ylim()[1]))
                panel.grid(alpha=0.25)
            explored.set_ylabel("%")
            from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415  needed for films only

            canvas = FigureCanvasAgg(figure)
            canvas.draw()
        picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
        boxes = [panel.get_window_extent() for panel in (explored, load)]
        return picture, [(b.x0, b.x1, picture.height - b.y1, picture.height - b.y0) for b in boxes]


def side_by_side(frames: list[Frames], step: int) -> Image.Image:
    """The frames of runs at the same step, from left to right; those of a run that is over stay as they are."""
    width, height = sum(each.size[0] for each in frames), max(each.size[1] for each in frames)
    picture = Image.new("RGB", (width, height), PAPER)
    left = 0
    for each in frames:
        picture.paste(each.at(step), (left, 0))
        left += each.size[0]
    return picture


_PALETTE: NDArray[np.uint8] = np.array(CELLS, np.uint8)


def _picture(cells: NDArray[np.uint8], width: int) -> Image.Image:
    """Coloured cells as a picture of a width in pixels, its cells square and sharp if there is room for them."""
    height = max(1, round(width * cells.shape[0] / cells.shape[1]))
    picture = Image.fromarray(cells)
    sharp = width >= 2 * cells.shape[1]
    return picture.resize((width, height), Image.Resampling.NEAREST if sharp else Image.Resampling.BOX)


def _centred(picture: Image.Image, x: float, y: float) -> tuple[int, int]:
    return round(x - picture.width / 2), round(y - picture.height / 2)


@cache
def _disc(robot: int, radius: int, *, numbered: bool) -> Image.Image:
    """A robot's disc, with its number if it is to be read; smooth, on nothing."""
    fine, side = 4, 2 * radius + 2
    disc = Image.new("RGBA", (fine * side, fine * side))
    draw = ImageDraw.Draw(disc)
    draw.ellipse((0, 0, fine * side - 1, fine * side - 1), (*PAPER, 255))
    draw.ellipse((fine, fine, fine * (side - 1) - 1, fine * (side - 1) - 1), (*robot_color(robot), 255))
    if numbered:
        font = _font(round(fine * radius * (1.35, 1.1, 0.8)[len(str(robot)) - 1]), bold=True)
        draw.text((fine * side / 2, fine * side / 2), str(robot), PAPER, font, "mm")
    return disc.resize((side, side), Image.Resampling.LANCZOS)


@cache
def _font(size: int, *, bold: bool = False) -> ImageFont.FreeTypeFont:
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(Path(matplotlib.get_data_path(), "fonts", "ttf", name)), size)
