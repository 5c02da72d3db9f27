"""How things look on the dashboard: the colours of robots, cells and packets, and maps as small pictures."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

from protocol.packets import ALL_KINDS

Color = tuple[int, int, int]

ROBOTS: tuple[Color, ...] = (
    (214, 39, 40), (31, 119, 180), (44, 160, 44), (255, 127, 14), (148, 103, 189),
    (0, 158, 168), (227, 86, 180), (140, 86, 75), (150, 150, 0), (70, 70, 200),
)  # fmt: skip
"""Robots' colours, in turn: to be told apart, and read on white as well as on black."""

INK, PAPER, GREY = (20, 24, 30), (255, 255, 255), (128, 134, 142)
IN_RANGE, SIGNAL, ALARM = (120, 150, 190), (0, 190, 90), (240, 60, 50)
"""Robots that can hear each other, that talk just now; the budget's line, and what is lost."""

CELLS: tuple[Color, ...] = ((176, 182, 190), PAPER, (20, 24, 30))
"""Unknown, free, occupied."""


@dataclass(frozen=True)
class Group:
    """Packet kinds that serve one end: in words, which kinds, in which colour."""

    words: str
    kinds: tuple[str, ...]
    color: Color


GROUPS: dict[str, Group] = {
    "vertices": Group("corners of outlines", ("ins", "rep", "del"), (70, 140, 255)),
    "objects": Group("new and gone outlines", ("em", "chg", "rm"), (255, 160, 40)),
    "scans": Group("raw laser scans", ("scan",), (80, 200, 255)),
    "looks": Group("looks and surprises", ("look",), (40, 190, 200)),
    "handshakes": Group("handshakes", ("conn",), (215, 110, 235)),
    "targets": Group("targets, places", ("targ", "pose"), (70, 210, 120)),
    "saves": Group("ends of updates", ("save",), (170, 175, 182)),
}
"""What the bytes on the air are for."""

assert sorted(kind for group in GROUPS.values() for kind in group.kinds) == sorted(ALL_KINDS)


def robot_color(robot: int) -> Color:
    """The colour that stands for a robot."""
    return ROBOTS[robot % len(ROBOTS)]


def map_picture(width: int, height: int, cells: bytes) -> bytes:
    """Return a PNG picture of a grid as `protocol.messages.grid_to_bytes` writes it.

    Its rows are those of a PNG with four colours as they are, so nothing is unpacked on the way.
    """
    row = -(-width // 4)
    rows = b"".join(b"\0" + cells[row * y : row * (y + 1)] for y in range(height))
    palette = bytes(value for color in (*CELLS, ALARM) for value in color)
    return (
        b"\x89PNG\r\n\x1a\n"
        + _chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 2, 3, 0, 0, 0))
        + _chunk(b"PLTE", palette)
        + _chunk(b"IDAT", zlib.compress(rows, 6))
        + _chunk(b"IEND", b"")
    )


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
