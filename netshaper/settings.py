"""Settings of a run's radio."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

from netshaper.radio_options import MIN_FRAME, RadioOptions
from protocol import packets
from protocol.budget import UNLIMITED, Budget
from protocol.grid import Grid
from protocol.message_fields import MAX_FRAME
from protocol.messages import Change, FaultEvent
from protocol.nanoseconds import SECOND
from protocol.packets import Held, Offer, Passed, Target

MIN_EXTRA = 64
"""Minimum bytes that a frame may exceed the budget by."""

EXTRA_PER_MAP = Held.size + Offer.size + Passed.size + Target.size
"""Bytes of reports on a map, and of its robot's pose and target; a frame may exceed the budget by them."""


@dataclass(frozen=True)
class Saving:
    """The budget that can be saved: that of `steps` steps in total, and at least `least` bytes.

    By default, unused budget lapses at the end of the step.
    """

    steps: int = 1
    least: int = 0

    def capacity(self, rate: int) -> int:
        """Return the bytes that can be saved of `rate` bytes per step."""
        return max(self.steps * rate, self.least)


@dataclass(frozen=True, eq=False)
class RadioSettings:
    """Settings of a run's radio."""

    robots: int
    seed: int
    range_cells: float
    """Communication range in cells; infinite if all robots receive each other."""
    budget: Budget = UNLIMITED
    """Bytes per step that the team shares."""
    rounds: int = 2
    """Rounds per step (R)."""
    gossip: bool = False
    """Whether maps are broadcast; else robots offer them to each other."""
    incarnations: int = 1
    """Maximum number of starts of a robot. Each incarnation has a map of its own."""
    options: RadioOptions = field(default_factory=RadioOptions)
    cell_m: float = 1.0
    """Side of a cell in meters."""
    walls: Grid | None = None
    """The world's cells, if links depend on them."""
    send: tuple[int, ...] = ()
    """Bytes per step that each robot can send, 0 for no limit; empty if no robot has a limit."""
    receive: tuple[int, ...] = ()
    """Bytes per step that each robot can receive, in the same form."""
    changes: tuple[Change, ...] = ()
    """Scheduled changes of budget and range."""
    faults: tuple[FaultEvent, ...] = ()
    """Scheduled faults of radios (`protocol.faults.RADIO_KINDS`)."""
    step_ns: int | None = None
    """Duration of a step by the wall clock, in nanoseconds; None: phases wait for all robots."""

    @property
    def maps(self) -> int:
        """Maximum number of maps."""
        return self.robots * self.incarnations

    @cached_property
    def saving(self) -> Saving:
        """The part of unused budgets that later steps can use: none with the barrier.

        By the wall clock, steps may be short: a second's budget can be saved, and at least one frame, as in the field.
        """
        if self.step_ns is None:
            return Saving()
        return Saving(max(1, round(SECOND / self.step_ns)), self.options.frame_bytes or MIN_FRAME)

    @cached_property
    def max_frame_bytes(self) -> int:
        """Maximum bytes of a frame that a robot submits; the relay rejects longer ones."""
        limit = self.budget.limit
        if limit is None:
            return MAX_FRAME
        return (self.saving.capacity(limit) if limit else 0) + max(MIN_EXTRA, self.maps * EXTRA_PER_MAP)

    @cached_property
    def perfect(self) -> bool:
        """Whether the channel is lossless and the shared budget is the only limit."""
        return self.options.perfect and not any(self.send) and not any(self.receive)

    @cached_property
    def handshakes(self) -> bool:
        """Whether a round has three phases: offers, answers and data. Else robots send once per round."""
        return self.perfect and not self.gossip

    @property
    def frame_limit(self) -> Budget:
        """Maximum bytes of a frame."""
        return Budget(self.options.frame_bytes) if self.options.frame_bytes else UNLIMITED

    @property
    def checksum_bytes(self) -> int:
        """Bytes of the checksum behind each frame."""
        return packets.Check.size if self.options.sums else 0

    @property
    def packet_bytes(self) -> int | None:
        """Maximum bytes of a packet, so that a frame can hold it; None: no limit."""
        return self.options.frame_bytes - self.checksum_bytes if self.options.frame_bytes else None
