"""Splitting frequency: how finely to approximate so that the radio can carry it (thesis, section 5.3).

All that r robots refine must reach the r - 1 others of each: s splits a step at d bytes a split cost
r (r - 1) d s bytes. Robots are in touch with probability p, and only a part u of the medium is planned
with, for objects emerge and robots meet in bursts. So (Eq. 5.5)

    s = b p u / (r (r - 1) d)

The thesis' sample runs (Figures 4.8, 6.18, A.2) give s itself.
"""

from __future__ import annotations

from dataclasses import dataclass

START_BYTES = 11.0
"""d before anything is measured: a `Change` and an `Insert`."""

START_SPLITS = 20
"""As many splits of `START_BYTES` are thought to have been seen before the first one."""


@dataclass(frozen=True)
class Splitting:
    """Parameters of the splitting frequency.

    Attributes
    ----------
    robots : int
        Size of the team, r.
    bandwidth : float or None
        Bytes a step for the whole team, b; None: unlimited.
    reach : float
        Communication range c, in the unit of `width` and `height`; may be infinite.
    width, height : float
        Sides of the world.
    medium_use : float
        Part u of the medium that is planned with.
    bytes_per_split : float or None
        Mean bytes that a split causes, d; None: measured as the run goes.
    fixed : float or None
        Splits a step, whatever the medium carries; None: by Eq. 5.5.
    """

    robots: int
    bandwidth: float | None
    reach: float
    width: float
    height: float
    medium_use: float = 0.5
    bytes_per_split: float | None = None
    fixed: float | None = None

    def __post_init__(self) -> None:
        if self.robots < 1:
            raise ValueError(f"a team of {self.robots} robots: at least 1")
        for name in ("bandwidth", "reach", "width", "height", "medium_use", "bytes_per_split", "fixed"):
            value = getattr(self, name)
            if value is None or value > 0 or (value == 0 and name in ("bandwidth", "reach")):
                continue
            raise ValueError(f"{name} is {value:g}: it must be above 0")

    @property
    def touch(self) -> float:
        """Probability p that some two robots can talk, if they are spread evenly over the world (Eq. 5.6)."""
        pairs = self.robots * (self.robots - 1) / 2
        return min(1.0, self.reach / self.width * (self.reach / self.height) * pairs)

    def frequency(self, bytes_per_split: float) -> float | None:
        """Splits a step, s; None where nothing limits them: one robot, or unlimited bandwidth (Eq. 5.5)."""
        if self.fixed is not None:
            return self.fixed
        if self.bandwidth is None or self.robots == 1:
            return None
        team = self.robots * (self.robots - 1)
        return self.bandwidth * self.touch * self.medium_use / (team * bytes_per_split)


class SplitAllowance:
    """Hands out whole splits step by step; fractions are carried over.

    Parameters
    ----------
    splitting : Splitting
        Parameters. Where ``bytes_per_split`` is None, d is the running mean of what is reported by `spent`.
    """

    def __init__(self, splitting: Splitting) -> None:
        self._splitting = splitting
        self._splits = START_SPLITS
        self._bytes = START_SPLITS * START_BYTES
        self._carried = 0.0

    @property
    def bytes_per_split(self) -> float:
        """d as it stands, in bytes."""
        given = self._splitting.bytes_per_split
        return self._bytes / self._splits if given is None else given

    def next_step(self) -> int | None:
        """Return how many edges to split in this step; None: until the approximation is exact."""
        frequency = self._splitting.frequency(self.bytes_per_split)
        if frequency is None:
            return None
        self._carried += frequency
        splits = int(self._carried)
        self._carried -= splits
        return splits

    def spent(self, splits: int, size: int) -> None:
        """Report that `splits` splits took `size` bytes of edits: those beyond what repair alone took."""
        self._splits += splits
        self._bytes += size
