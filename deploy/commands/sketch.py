"""Maps as text, two cells per character."""

from __future__ import annotations

import numpy as np
from rich.console import Console
from rich.text import Text

from protocol.grid import FREE, OCCUPIED, Grid

COLORS = ("grey50", "white", "black")
"""Colors of unknown, free and occupied cells."""

INK = {(2, 2): "█", (2, 1): "▀", (2, 0): "▀", (1, 2): "▄", (0, 2): "▄", (0, 0): "░"}
"""Characters for an upper and a lower cell without colors; free cells are blank."""

PLAIN = {(2, 2): "#", (2, 1): '"', (2, 0): '"', (1, 2): "_", (0, 2): "_", (0, 0): "."}
"""The same for an encoding without these characters."""


def sketch(grid: Grid, console: Console) -> Text:
    """Draw a grid with half-block characters, as wide as `console`, in colors if it supports them."""
    scale = max(1, -(-grid.shape[1] // max(20, console.width - 1)))
    whole = np.pad(grid, [(0, -grid.shape[0] % (2 * scale)), (0, -grid.shape[1] % scale)], mode="edge")
    blocks = whole.reshape(whole.shape[0] // scale, scale, whole.shape[1] // scale, scale)
    solid = (blocks == OCCUPIED).any(axis=(1, 3))
    free = (blocks == FREE).any(axis=(1, 3))
    shade = np.where(solid, 2, np.where(free, 1, 0))
    is_plain = not console.encoding.startswith("utf")
    colored = console.color_system is not None and not console.no_color and not is_plain
    text = Text()
    for upper, lower in zip(shade[::2].tolist(), shade[1::2].tolist(), strict=True):
        for pair in zip(upper, lower, strict=True):
            if colored:
                text.append("▀", style=f"{COLORS[pair[0]]} on {COLORS[pair[1]]}")
            else:
                text.append((PLAIN if is_plain else INK).get(pair, " "))
        text.append("\n")
    return text
