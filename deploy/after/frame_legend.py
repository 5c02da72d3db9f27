"""What makes a frame of a film readable without its caption: axes in meters, a scale bar, and a legend."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import matplotlib
from PIL import ImageDraw, ImageFont

from deploy.record.colors import CELLS, GREY, IN_RANGE, INK, PAPER, SIGNAL, mix, robot_color
from deploy.record.ticks import tick_values
from worldsim.maps import Map

SMALL = 10
"""Points of the letters of axes and legend."""
LABEL = 40
"""Points from the label of a tick to that of the next at least."""
GAP = 22
"""Points between two entries of the legend."""

Pixel = tuple[int, int]


def draw_axes(draw: ImageDraw.ImageDraw, world: Map, at: Pixel, size: Pixel, scale: float) -> None:
    """Draw axes in meters along the left and lower side of a map; its picture has a place and a size in pixels."""
    (left, top), (wide, tall) = at, size
    per_meter = wide / (world.width * world.resolution)
    x0, y0 = world.origin[:2]
    letters, tick = font(round(SMALL * scale)), round(4 * scale)
    across = tick_values(x0, x0 + world.width * world.resolution, max(1, min(6, wide / (LABEL * scale))))
    for x in across:
        column = left + per_meter * (x - x0)
        draw.line([(column, top + tall), (column, top + tall + tick)], GREY, 1)
        text = f"{x:g} m" if x == across[-1] else f"{x:g}"
        draw.text((column, top + tall + 1.5 * tick), text, INK, letters, "ma")
    up = tick_values(
        y0, y0 + world.height * world.resolution, max(1, min(6 * tall / wide, tall / (LABEL * scale)))
    )
    for y in up:
        row = top + tall - per_meter * (y - y0)
        draw.line([(left - tick, row), (left, row)], GREY, 1)
        draw.text((left - 1.5 * tick, row), f"{y:g}", INK, letters, "rm")


def draw_legend(draw: ImageDraw.ImageDraw, world: Map, at: Pixel, wide: int, scale: float) -> None:
    """Draw a scale bar for a map `wide` pixels wide, and what the colors mean, in one line centered at row `at[1]`."""
    letters = font(round(SMALL * scale))
    left, row = float(at[0]), at[1]
    high = 4 * scale
    meters = tick_values(0, world.width * world.resolution, 5)[1]  # about a fifth of the map's width
    length = meters * wide / (world.width * world.resolution)
    draw.line([(left, row), (left + length, row)], INK, max(1, round(2 * scale)))
    for end in (left, left + length):
        draw.line([(end, row - high), (end, row + high)], INK, max(1, round(scale)))

    def write(text: str, place: float) -> float:
        draw.text((place, row), text, INK, letters, "lm")
        return place + letters.getlength(text) + GAP * scale

    left = write(f"{meters:g} m", left + length + 6 * scale)
    for text, color in zip(("unknown", "free", "wall"), CELLS, strict=True):
        box = (left, row - high, left + 2 * high, row + high)
        draw.rectangle(box, color, mix(GREY, PAPER, 0.2))
        left = write(text, left + 2 * high + 5 * scale)
    for text, color, width in (("received data", SIGNAL, 2), ("in range", IN_RANGE, 1)):
        draw.line([(left, row), (left + 16 * scale, row)], color, max(1, round(width * scale)))
        left = write(text, left + 21 * scale)
    for text, radius in (("robot, with its number", 5), ("target", 3)):
        spread = radius * scale
        draw.ellipse((left, row - spread, left + 2 * spread, row + spread), robot_color(0))
        left = write(text, left + 2 * spread + 5 * scale)


@cache
def font(size: int, *, bold: bool = False) -> ImageFont.FreeTypeFont:
    """The font of frames in a size in pixels."""
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(Path(matplotlib.get_data_path(), "fonts", "ttf", name)), max(1, size))
