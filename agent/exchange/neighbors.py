"""Who is in whose range, as robots that gossip say of themselves (docs/protocol.md; ours, of no paper).

Who hears others must know who else did: so each says who has come into its range and who has left it, as long as
somebody in range has not heard so. All are in range of all until they say otherwise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]


class Neighbors:
    """What one robot knows of all ranges, and what others know of its own.

    Parameters
    ----------
    robot : int
        One's own number.
    robots : int
    """

    def __init__(self, robot: int, robots: int) -> None:
        self._robot = robot
        self._near: Mask = ~np.eye(robots, dtype=np.bool_)
        """``_near[peer, other]``: whether `other` is in range of a peer, as that one said."""
        self._told: Mask = np.arange(robots) != np.full((robots, 1), robot)
        """``_told[peer, other]``: whether `other` is in one's own range, as a peer has been told."""

    def news(self, peers: list[int]) -> list[tuple[int, bool]]:
        """Of whom somebody in range should hear, and whether each is here or has left; `peers` are those in range."""
        here = np.zeros(len(self._near), np.bool_)
        here[peers] = True
        news = self._told[peers] ^ here
        news[range(len(peers)), peers] = False
        return [(other, bool(here[other])) for other in np.flatnonzero(news.any(axis=0)).tolist()]

    def told(self, peers: list[int], other: int, here: bool) -> None:
        """Peers have heard whether another robot is in one's own range."""
        self._told[peers, other] = here

    def says(self, peer: int, other: int, here: bool) -> None:
        """A peer says whether another robot is in its range."""
        self._near[peer, other] = here

    def are_near(self, peer: int, other: int) -> bool:
        """Whether a robot is in range of a peer, as far as that one has said."""
        return bool(self._near[peer, other])

    def hearers(self, peer: int) -> Mask:
        """Who but oneself hears what a peer says."""
        hearers: Mask = self._near[peer].copy()
        hearers[self._robot] = False
        return hearers

    def begins_anew(self, peer: int) -> None:
        """A peer knows nothing any more, and has said nothing yet."""
        self._near[peer] = np.arange(len(self._near)) != peer
        self._told[peer] = np.arange(len(self._near)) != self._robot
