"""A finished run as a sequence of pictures, one per step: the frames of films, and of the slider in a report.

The upper part shows the true map with the robots, grayed where no robot knows anything yet, and the map of each robot,
with axes in meters, a scale bar and a legend. The lower part shows the explored area over time and the use of the
budget, up to the step.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from functools import cache, cached_property
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from deploy.after.archive import Archive
from deploy.after.figures import draw_explored, draw_load, show_steps
from deploy.after.frame_legend import draw_axes, draw_legend, font
from deploy.record.colors import CELLS, GREY, IN_RANGE, INK, PAPER, SIGNAL, mix, robot_color, text_color
from deploy.record.map_pictures import shortened
from deploy.record.number_texts import counted, percent
from protocol.grid import FREE, UNKNOWN, Grid, Mask
from worldsim.maps import to_cell

WIDTH = 1280
MARGIN, LABEL, HEAD = 14, 20, 40
"""Points around and between panels, above a panel, and above all panels."""
AXIS = 30
"""Points for the figures of the axis beside the true map."""
WORLD_SHARE, CHARTS_SHAPE = 0.44, 0.21
"""Width of the true map / width of the frame; height / width of the curves."""
FINE = 2
"""Factor by which lines are drawn larger before they are reduced, to smooth them."""
MANY_LINKS = 30
"""More links with data are drawn thin, so that they do not hide the robots' paths."""
VEIL = 0.32
"""Opacity of the gray over cells that no robot knows."""

Place = tuple[float, float]


class Frames:
    """The frames of a run, each `width` pixels wide."""

    def __init__(self, archive: Archive, width: int = WIDTH) -> None:
        self._archive = archive
        self._robots = range(archive.plan.scenario.robots)
        self._reachable = archive.plan.reachable
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
        """The frame of a step, RGB; after the end of the run, the frame of its last step."""
        step = min(step, self.last_step)
        frame = Image.new("RGB", self.size, PAPER)
        draw = ImageDraw.Draw(frame)
        self._write_head(draw, step)
        known = self._draw_robots_maps(frame, draw, step)
        frame.paste(self._world(step, known), self._world_at)
        world, (left, _) = self._archive.plan.map, self._world_at
        draw_axes(draw, world, self._world_at, self._world_size, self._scale)
        draw_legend(draw, world, (left, self._legend_at), self._world_size[0], self._scale)
        self._draw_charts(frame, step)
        return frame

    def _place(self) -> None:
        """Compute the position of each panel, for this map and this number of robots."""
        px, shape = self._px, self._archive.plan.map.height / self._archive.plan.map.width
        side = round(WORLD_SHARE * self._width)
        wide = side if shape <= 1 else round(side / shape)
        tall = round(wide * shape)
        left, top = px(AXIS), px(HEAD) + px(LABEL)
        self._world_at, self._world_size = (left, top), (wide, tall)
        grid_left = left + wide + px(MARGIN)
        free = self._width - grid_left - px(MARGIN), max(tall, round(0.2 * self._width)) + px(LABEL)
        many = len(self._robots)

        def panel_width(columns: int) -> float:
            rows = -(-many // columns)
            return min(free[0] / columns - px(MARGIN) / 2, (free[1] / rows - px(LABEL)) / shape)

        columns = max(range(1, many + 1), key=panel_width)
        self._panel_width = max(4, int(panel_width(columns)))
        across = (free[0] + px(MARGIN) / 2) / columns
        down = self._panel_width * shape + px(LABEL)
        self._thumbs_at = [
            (round(grid_left + (k % columns) * across), round(px(HEAD) + (k // columns) * down + px(LABEL)))
            for k in self._robots
        ]
        self._legend_at = top + max(tall + px(LABEL), free[1] - px(LABEL)) + px(LABEL)
        self._charts_top = self._legend_at + px(LABEL)
        self._height = self._charts_top + round(CHARTS_SHAPE * self._width)

    def _px(self, points: float) -> int:
        return round(points * self._scale)

    def _write_head(self, draw: ImageDraw.ImageDraw, step: int) -> None:
        scenario, px = self._archive.plan.scenario, self._px
        limit = scenario.bandwidth
        medium = limit if isinstance(limit, str) else f"{limit:,} bytes per step"
        title = (
            f"{shortened(self._archive.summary['map'])}: {counted(scenario.robots, 'robot')}, "
            f"{shortened(scenario.strategy, 20)}, "
            f"{scenario.map_encoding}, {medium}"
        )
        draw.text((px(MARGIN), px(24)), title, INK, font(px(15)), "lm")
        now = f"step {step} of {self.last_step}, {step * scenario.step_s:g} s"
        draw.text((self._width - px(MARGIN), px(24)), now, INK, font(px(15), bold=True), "rm")
        seen = float(self._archive.rows_of(step)["team_seen"].max(initial=0.0))
        plan = self._archive.plan
        what = "the building" if plan.recording is None else "the map of all scans"
        what = what if plan.has_truth else "the team's map at the end"
        letters = font(px(12))
        for label in (f"{what}: {percent(seen, 0)} seen", f"{percent(seen, 0)} seen", percent(seen, 0)):
            if letters.getlength(label) <= self._world_size[0]:
                break
        draw.text((self._world_at[0], px(HEAD + LABEL / 2)), label, INK, letters, "lm")

    def _draw_robots_maps(self, frame: Image.Image, draw: ImageDraw.ImageDraw, step: int) -> Mask:
        """Draw each robot's map; return the cells that any robot knows."""
        known: Mask = np.zeros(self._archive.plan.map.cells.shape, np.bool_)
        px = self._px
        rows = self._archive.rows_of(step)
        here = {int(robot): k for k, robot in enumerate(rows["robot"])}
        for robot, (left, top) in zip(self._robots, self._thumbs_at, strict=True):
            grid = self._archive.maps.planning(robot, step)
            picture, share = self._thumb(robot, grid, step)
            if grid is not None:
                known |= grid != UNKNOWN
            frame.paste(picture, (left, top))
            draw.rectangle(
                (left - 1, top - 1, left + picture.width, top + picture.height), outline=mix(GREY, PAPER, 0.4)
            )
            text = f"robot {robot}: {percent(share, 0)}" if self._panel_width > px(110) else f"{robot}"
            letters = font(px(12 if self._panel_width > px(60) else 9))
            draw.text((left, top - px(LABEL / 2)), text, text_color(robot), letters, "lm")
            if robot in here:
                x, y = self._cell(rows["x"][here[robot]], rows["y"][here[robot]])
                size = self._panel_width / self._archive.plan.map.width
                disc = _disc(robot, max(3, px(3.2)), numbered=False)
                frame.paste(disc, _centred(disc, left + size * x, top + size * y), disc)
        return known

    def _thumb(self, robot: int, grid: Grid | None, step: int) -> tuple[Image.Image, float]:
        """A robot's map in its panel's size, and its share of the reachable cells; cached until it changes."""
        changed = bisect_right(self._archive.maps.steps(robot), step)
        kept = self._thumbs.get(robot)
        if kept is None or kept[0] != changed:
            shown = grid if grid is not None else np.zeros_like(self._archive.plan.map.cells)
            share = float((shown[self._reachable] == FREE).mean())
            kept = changed, _picture(_PALETTE[shown], self._panel_width), share
            self._thumbs[robot] = kept
        return kept[1], kept[2]

    def _world(self, step: int, known: Mask) -> Image.Image:
        """The true map with paths, targets, links and robots."""
        cells = _PALETTE[self._archive.plan.map.cells].astype(np.float64)
        cells[~known] = cells[~known] * (1 - VEIL) + np.array(GREY) * VEIL
        panel = _picture(cells.astype(np.uint8), FINE * self._world_size[0])
        draw = ImageDraw.Draw(panel)
        size = FINE * self._world_size[0] / self._archive.plan.map.width
        thin = max(1, round(FINE * self._scale))

        def at(x: float, y: float) -> Place:
            column, row = self._cell(x, y)
            return size * column, size * row

        rows = self._archive.rows_of(step)
        places = {int(r): at(x, y) for r, x, y in zip(rows["robot"], rows["x"], rows["y"], strict=True)}
        for robot in self._robots:
            track = self._tracks[robot]
            until = int(np.searchsorted(track["step"], step, "right"))
            path = [at(x, y) for x, y in zip(track["x"][:until], track["y"][:until], strict=True)]
            if len(path) > 1:
                draw.line(path, robot_color(robot), thin, joint="curve")
        busy = {
            (min(pair), max(pair)) for pair in self._archive.links.get(step, ()) if places.keys() >= set(pair)
        }
        for color, width, pairs in (
            (IN_RANGE, thin, self._archive.in_range(step) - busy),
            (SIGNAL, 2 * thin if len(busy) <= MANY_LINKS else thin, busy),
        ):
            for pair in sorted(pairs):
                draw.line([places[robot] for robot in pair], color, width)
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

    def _cell(self, x: float, y: float) -> Place:
        """A position in cells from the upper left corner."""
        column, row = to_cell(self._archive.plan.map, x, y)
        return column + 0.5, row + 0.5

    @cached_property
    def _tracks(self) -> dict[int, dict[str, NDArray[Any]]]:
        return {robot: self._archive.of_robot(robot) for robot in self._robots}

    def _draw_charts(self, frame: Image.Image, step: int) -> None:
        """Draw the curves, pale after the step."""
        charts, spans = self._charts
        frame.paste(charts, (0, self._charts_top))
        draw = ImageDraw.Draw(frame, "RGBA")
        for left, right, top, bottom in spans:
            x = min(right, left + (right - left) * (step / self.last_step))  # rounding may exceed it
            up, down = self._charts_top + top, self._charts_top + bottom
            draw.rectangle((x, up, right, down), (255, 255, 255, 205))
            draw.line([(x, up), (x, down)], (*INK, 255), max(1, self._px(1.4)))

    @cached_property
    def _charts(self) -> tuple[Image.Image, list[tuple[float, float, float, float]]]:
        """The curves of the whole run, and the bounds of their panels: left, right, top, bottom."""
        dpi = 100.0
        wide, tall = self.size[0] / dpi, (self.size[1] - self._charts_top) / dpi
        with matplotlib.rc_context({"font.size": 8.5 * self._scale, "axes.titlesize": 9.5 * self._scale}):
            figure = Figure(figsize=(wide, tall), dpi=dpi, layout="constrained")
            explored, load = figure.subplots(1, 2, width_ratios=[1, 1])
            draw_explored(explored, self._archive)
            draw_load(load, self._archive)
            for panel in (explored, load):
                show_steps(panel, self.last_step)
                panel.grid(alpha=0.25)
                panel.set_xlabel("step")
            load.set_ylim(0, max(1.0, load.get_ylim()[1]))
            explored.set(title="Explored: by the team (thick), and on each robot's map", ylabel="%")
            handles, labels = load.get_legend_handles_labels()
            figure.legend(handles, labels, loc="outside lower right", ncols=len(labels), frameon=False)
            from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415  needed for films only

            canvas = FigureCanvasAgg(figure)
            canvas.draw()
        picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
        boxes = [panel.get_window_extent() for panel in (explored, load)]
        return picture, [(b.x0, b.x1, picture.height - b.y1, picture.height - b.y0) for b in boxes]


def side_by_side(frames: list[Frames], step: int) -> Image.Image:
    """The frames of several runs at one step, from left to right; a finished run keeps its last frame."""
    width, height = sum(each.size[0] for each in frames), max(each.size[1] for each in frames)
    picture = Image.new("RGB", (width, height), PAPER)
    left = 0
    for each in frames:
        picture.paste(each.at(step), (left, 0))
        left += each.size[0]
    return picture


_PALETTE: NDArray[np.uint8] = np.array(CELLS, np.uint8)


def _picture(cells: NDArray[np.uint8], width: int) -> Image.Image:
    """Colored cells as a picture of a width in pixels; cells are drawn sharp if each has at least two pixels."""
    height = max(1, round(width * cells.shape[0] / cells.shape[1]))
    picture = Image.fromarray(cells)
    sharp = width >= 2 * cells.shape[1]
    return picture.resize((width, height), Image.Resampling.NEAREST if sharp else Image.Resampling.BOX)


def _centred(picture: Image.Image, x: float, y: float) -> tuple[int, int]:
    return round(x - picture.width / 2), round(y - picture.height / 2)


@cache
def _disc(robot: int, radius: int, *, numbered: bool) -> Image.Image:
    """A robot's disc on a transparent background, with its number if `numbered`."""
    fine, side = 4, 2 * radius + 2
    disc = Image.new("RGBA", (fine * side, fine * side))
    draw = ImageDraw.Draw(disc)
    draw.ellipse((0, 0, fine * side - 1, fine * side - 1), (*PAPER, 255))
    draw.ellipse((fine, fine, fine * (side - 1) - 1, fine * (side - 1) - 1), (*robot_color(robot), 255))
    if numbered:
        letters = font(round(fine * radius * (1.35, 1.1, 0.8)[len(str(robot)) - 1]), bold=True)
        draw.text((fine * side / 2, fine * side / 2), str(robot), PAPER, letters, "mm")
    return disc.resize((side, side), Image.Resampling.LANCZOS)
