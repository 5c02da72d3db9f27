"""The author's end of a log: it collects the changes of this robot's grid, and decides when to encode an update."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Generic, TypeVar

from agent.mapping.estimator import Int8Grid
from agent.predictive.history import DecodedUpdate
from agent.predictive.stream import Stream
from protocol.grid import Grid
from protocol.range_scans import RangeScan
from protocol.scans import GridChange, Scan

AnyStream = TypeVar("AnyStream", bound=Stream)


class Author(ABC, Generic[AnyStream]):
    """Encodes this robot's changes into its stream."""

    def __init__(self, stream: AnyStream) -> None:
        self.stream = stream
        self.urgency: float | None = None
        """How much the last update changes the plans of teammates, per byte; None: updates have no ranks."""

    @property
    def is_full(self) -> bool:
        """Whether the last update ended at its limit, so that later changes do not belong to it."""
        return False

    @property
    @abstractmethod
    def has_changes(self) -> bool:
        """Whether changes may have to be encoded."""

    def has_news(self, own: Grid, log_odds: Int8Grid, received: Grid, *, delivered: bool) -> bool:
        """Return whether teammates lack changes that would change their plans; `delivered`: they hold the whole log.

        The grids are those of `is_due`.
        """
        return False

    @abstractmethod
    def add(self, scan: Scan | RangeScan, change: GridChange) -> None:
        """Add the changes of a step, which may be none; call it in each step."""

    @abstractmethod
    def is_due(self, own: Grid, log_odds: Int8Grid, received: Grid) -> bool:
        """Return whether an update should be encoded in this step.

        `own` and `received`, uint8 arrays of shape (h, w), are the self-explored grid, and what all received logs and
        this robot's own log report. `log_odds`, int8 of the same shape, tells how certain each cell of `own` is.
        """

    @abstractmethod
    def encode(self, own: Grid, log_odds: Int8Grid, most: float) -> tuple[bytes, DecodedUpdate] | None:
        """Encode an update of about `most` bytes at most, and return its message; None if there is nothing to send."""

    def retract(self) -> None:
        """Take back the last update, which no other log depends on: its changes wait again."""
        self.stream.rollback()

    def restart(self, stream: AnyStream, withdrawn: Sequence[DecodedUpdate]) -> None:
        """Continue with another stream, which lacks the last updates of the log: their changes wait again."""
        self.stream = stream
