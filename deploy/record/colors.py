"""Colors of robots and packets, the same on the dashboard and in all pictures, and of cells."""

from __future__ import annotations

from dataclasses import dataclass

from protocol.packets import ALL_KINDS

Color = tuple[int, int, int]

ROBOTS: tuple[Color, ...] = (
    (214, 39, 40), (0, 158, 168), (70, 70, 200), (255, 127, 14), (148, 103, 189),
    (140, 86, 75), (31, 119, 180), (44, 160, 44), (227, 86, 180), (150, 150, 0),
)  # fmt: skip
"""Colors of robots in turn: readable on white and on black; color-blind readers distinguish the first six."""

READABLE = 0.3
"""Largest luminance of text on white: its contrast is 3 : 1 then."""

INK, PAPER, GREY = (20, 24, 30), (255, 255, 255), (128, 134, 142)
IN_RANGE, SIGNAL, ALARM = (176, 184, 196), (70, 82, 104), (240, 60, 50)
"""Links of robots in range of each other; links that carried data in this step; losses."""

TEAM, QUIET = (138, 132, 118), (172, 178, 186)
"""Data of the whole team; robots other than the selected one. Both are visible on white and on black."""

CELLS: tuple[Color, ...] = ((176, 182, 190), PAPER, (20, 24, 30))
"""Unknown, free, occupied; `deploy.record.map_pictures` has paler ones, as paths lie on them."""

FALSE_WALL, UNSEEN, WRONG_FREE = (226, 40, 40), (255, 200, 92), (40, 110, 235)
MAP_ERRORS: tuple[Color, ...] = ((222, 225, 229), PAPER, (84, 90, 98), FALSE_WALL, UNSEEN, WRONG_FREE)
"""Errors of a map in strong colors, correct cells in pale ones, in the order of `deploy.record.map_errors`."""


@dataclass(frozen=True)
class Group:
    """Packet types of one purpose, with a description and a color."""

    label: str
    kinds: tuple[str, ...]
    color: Color


GROUPS: dict[str, Group] = {
    "vertices": Group("corners of outlines", ("ins", "rep", "del"), (208, 148, 82)),
    "objects": Group("new and removed outlines", ("em", "chg", "rm"), (46, 112, 60)),
    "scans": Group("raw laser scans", ("scan",), (208, 148, 82)),
    "updates": Group("map updates", ("update",), (208, 148, 82)),
    "control": Group("replication control", ("conn",), (184, 148, 184)),
    "targets": Group("targets, poses", ("targ", "pose"), (176, 88, 140)),
    "saves": Group("ends of updates", ("save",), (148, 166, 100)),
    "sums": Group("checksums", ("sum",), (52, 178, 130)),
}
"""Purposes of the transmitted bytes, in colors that no robot has; the three encodings of maps share one color."""

assert sorted(kind for group in GROUPS.values() for kind in group.kinds) == sorted(ALL_KINDS)


def robot_color(robot: int) -> Color:
    """The color of a robot: `ROBOTS`, then darker, then paler shades; thirty in total."""
    color, turn = ROBOTS[robot % len(ROBOTS)], robot // len(ROBOTS) % 3
    return (color, mix(color, INK, 0.4), mix(color, PAPER, 0.35))[turn]


def text_color(robot: int) -> Color:
    """A robot's color for text on white: pale ones are darkened."""
    color = robot_color(robot)
    while _luminance(color) > READABLE:
        color = mix(color, INK, 0.1)
    return color


def _luminance(color: Color) -> float:
    """The relative luminance of a color, 0 to 1 (WCAG 2.1)."""
    parts = [part / 255 for part in color]
    red, green, blue = (x / 12.92 if x <= 0.03928 else ((x + 0.055) / 1.055) ** 2.4 for x in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def mix(color: Color, other: Color, share: float) -> Color:
    """Mix a share of another color into a color."""
    red, green, blue = (
        round(own * (1 - share) + added * share) for own, added in zip(color, other, strict=True)
    )
    return red, green, blue
