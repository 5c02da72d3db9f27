"""Splitting frequency: the fineness of the approximations that the radio has capacity for (thesis, section 5.3).

The edits of r robots must reach r - 1 others each: s splits per step at d bytes per split cost r (r - 1) d s bytes. Two
robots, spread evenly over the environment, can communicate with probability p (Eq. 5.6), and only a fraction u of the
bandwidth b is planned with, because objects emerge and robots meet in bursts. So (Eq. 5.5)

    s = b p u / (r (r - 1) d)

The sample runs of the thesis (Figures 4.8, 6.18, A.2) fix s.
"""

from __future__ import annotations

START_BYTES = 11.0
"""Initial d: bytes of a `Change` and an `Insert`."""

START_SPLITS = 20
"""Weight of the initial d in the running mean, in splits."""


class SplitAllowance:
    """Integer number of splits for each step; fractions are carried over.

    `robots` is the size of the team, r, `bandwidth` its bytes per step, b (None: unlimited), of which the fraction
    `medium_use`, u, is planned with. `reach`, `width` and `height` are the communication range, which may be infinite,
    and the size of the environment, in one unit. `bytes_per_split` is the mean d; None: that of the costs reported by
    `spent`. `fixed` splits per step do not depend on the bandwidth; None: by Eq. 5.5.
    """

    def __init__(
        self,
        robots: int,
        bandwidth: float | None,
        reach: float,
        width: float,
        height: float,
        medium_use: float = 0.5,
        bytes_per_split: float | None = None,
        fixed: float | None = None,
    ) -> None:
        self._team = robots * (robots - 1)
        self._planned: float | None = None
        if bandwidth is not None and robots > 1:
            in_range = min(1.0, reach / width * (reach / height) * (self._team / 2))  # Eq. 5.6
            self._planned = bandwidth * in_range * medium_use
        self._given = bytes_per_split
        self._fixed = fixed
        self._splits = START_SPLITS
        self._bytes = START_SPLITS * START_BYTES
        self._carried = 0.0

    @property
    def bytes_per_split(self) -> float:
        """Current d, in bytes."""
        return self._bytes / self._splits if self._given is None else self._given

    @property
    def frequency(self) -> float | None:
        """Splits per step, s (Eq. 5.5); None: unlimited, for one robot or unlimited bandwidth."""
        if self._fixed is not None or self._planned is None:
            return self._fixed
        return self._planned / (self._team * self.bytes_per_split)

    def next_step(self) -> int | None:
        """Return the number of edges to split in this step; None: split until the approximation is exact."""
        if self.frequency is None:
            return None
        self._carried += self.frequency
        splits = int(self._carried)
        self._carried -= splits
        return splits

    def spent(self, splits: int, size: int) -> None:
        """Report that `splits` splits added `size` bytes to the edits of the repair."""
        self._splits += splits
        self._bytes += size
