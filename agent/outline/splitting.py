"""Splitting frequency: the fineness of the approximations that the radio has capacity for (thesis, section 5.3).

The edits of r robots must reach r - 1 others each: s splits per step at d bytes per split cost r (r - 1) d s bytes. Two
robots can communicate with probability p, and only a fraction u of the bandwidth b is planned with, because objects
emerge and robots meet in bursts. So (Eq. 5.5)

    s = b p u / (r (r - 1) d)

The sample runs of the thesis (Figures 4.8, 6.18, A.2) fix s.
"""

from __future__ import annotations

from dataclasses import dataclass

START_BYTES = 11.0
"""Initial d: bytes of a `Change` and an `Insert`."""

START_SPLITS = 20
"""Weight of the initial d in the running mean, in splits."""


@dataclass(frozen=True)
class Splitting:
    """Parameters of the splitting frequency.

    Attributes
    ----------
    robots : int
        Size of the team, r.
    bandwidth : float or None
        Bytes per step for the whole team, b; None: unlimited.
    reach : float
        Communication range c, in the unit of `width` and `height`; may be infinite.
    width, height : float
        Size of the environment.
    medium_use : float
        Fraction u of the bandwidth that is planned with.
    bytes_per_split : float or None
        Mean bytes per split, d; None: measured during the run.
    fixed : float or None
        Splits per step, independent of the bandwidth; None: by Eq. 5.5.
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
        """Probability p that two robots can communicate, if they are spread evenly over the environment (Eq. 5.6)."""
        pairs = self.robots * (self.robots - 1) / 2
        return min(1.0, self.reach / self.width * (self.reach / self.height) * pairs)

    def frequency(self, bytes_per_split: float) -> float | None:
        """Return the splits per step, s (Eq. 5.5); None: unlimited, for one robot or unlimited bandwidth."""
        if self.fixed is not None:
            return self.fixed
        if self.bandwidth is None or self.robots == 1:
            return None
        team = self.robots * (self.robots - 1)
        return self.bandwidth * self.touch * self.medium_use / (team * bytes_per_split)


class SplitAllowance:
    """Integer number of splits for each step; fractions are carried over.

    Parameters
    ----------
    splitting : Splitting
        Parameters. If ``bytes_per_split`` is None, d is the running mean of the costs reported by `spent`.
    """

    def __init__(self, splitting: Splitting) -> None:
        self._splitting = splitting
        self._splits = START_SPLITS
        self._bytes = START_SPLITS * START_BYTES
        self._carried = 0.0

    @property
    def bytes_per_split(self) -> float:
        """Current d, in bytes."""
        given = self._splitting.bytes_per_split
        return self._bytes / self._splits if given is None else given

    def next_step(self) -> int | None:
        """Return the number of edges to split in this step; None: split until the approximation is exact."""
        frequency = self._splitting.frequency(self.bytes_per_split)
        if frequency is None:
            return None
        self._carried += frequency
        splits = int(self._carried)
        self._carried -= splits
        return splits

    def spent(self, splits: int, size: int) -> None:
        """Report that `splits` splits added `size` bytes to the edits of the repair."""
        self._splits += splits
        self._bytes += size
