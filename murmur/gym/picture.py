"""The picture of an environment: the true map, pale where the team has not been, with robots and their targets."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from deploy.record.colors import CELLS, GREY, PAPER, robot_color
from murmur.gym.episode import Episode
from protocol.grid import UNKNOWN

SIDE = 480
"""Least length of the longer side, in pixels."""

VEIL = 0.6
"""Share of grey in cells that the team has not seen."""

RENDER_MODES = ("rgb_array",)


def picture(episode: Episode) -> NDArray[np.uint8]:
    """Draw the current step as an array of shape (height, width, 3)."""
    truth = episode.plan.map.cells
    colors = np.array(CELLS, np.float64)[truth]
    unseen = episode.team_map() == UNKNOWN
    colors[unseen] = (1 - VEIL) * colors[unseen] + VEIL * np.array(GREY)
    scale = max(1, -(-SIDE // max(truth.shape)))
    image = Image.fromarray(colors.astype(np.uint8).repeat(scale, 0).repeat(scale, 1))
    draw = ImageDraw.Draw(image)
    radius = max(4, 2 * scale)

    def disc(x: float, y: float, radius: float, **colors: Any) -> None:
        """Draw a disc around the center of a cell."""
        across, down = scale * (x + 0.5), scale * (y + 0.5)
        draw.ellipse((across - radius, down - radius, across + radius, down + radius), **colors)

    for robot in episode.active:
        if (target := episode.target(robot)) is not None:
            disc(*target, radius / 2, fill=robot_color(robot))
    for robot, place in episode.places().items():
        disc(*place, radius, fill=robot_color(robot), outline=PAPER)
    return np.asarray(image)
