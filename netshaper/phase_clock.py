"""Clocks of the medium: when a phase of a step ends although robots have not answered (docs/clocks.md).

No clock reads the time: the caller passes it in, in integer nanoseconds.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable

from netshaper.settings import RadioSettings
from protocol.messages import Missed

PHASES = ("offers", "answers", "data")
"""The phases of a round of handshakes; other rounds have only the first one."""

Phase = tuple[int, int, str]
"""Step, round and name of a phase; the name is empty while the medium is closed."""


class PhaseClock:
    """The barrier: a phase ends when all robots that it concerns have answered."""

    waits = True
    """Whether a phase waits for robots."""

    def deadline(self, phase: Phase, now_ns: int) -> int | None:
        """Return the time at which the phase ends, in nanoseconds; None: it has no deadline."""
        return None

    def missed(self, phase: Phase) -> Collection[int]:
        """Return the robots that do not answer in time in this phase, which has just begun; at most once."""
        return ()


class WallPhases(PhaseClock):
    """Phases by the wall clock, in steps of `step_ns` nanoseconds.

    The first phase, in which robots process their scans, may take a third of a step, and all others another third. The
    last third is left for the robots' plans. Time that a phase does not use goes to the next ones.
    """

    waits = False

    def __init__(self, step_ns: int, settings: RadioSettings) -> None:
        self._step_ns = step_ns
        self._per_round = len(PHASES) if settings.handshakes else 1
        self._phases = settings.rounds * self._per_round
        self._step = 0
        self._begun_ns = 0

    def deadline(self, phase: Phase, now_ns: int) -> int | None:
        """Return the time at which the phase ends; the first call of a step is its beginning."""
        step, number, name = phase
        if step != self._step:
            self._step, self._begun_ns = step, now_ns
        if not name:
            return None
        before = number * self._per_round + PHASES.index(name)
        return self._begun_ns + self._step_ns * (self._phases + before) // (3 * self._phases)


class RecordedPhases(PhaseClock):
    """Repeats a run by the wall clock: phases do not wait for the robots that did not answer in time in that run."""

    def __init__(self, record: Iterable[Missed]) -> None:
        self._robots: dict[Phase, Collection[int]] = {
            (missed.step, missed.round, missed.phase): missed.robots
            for missed in record
            if missed.phase in PHASES
        }

    def missed(self, phase: Phase) -> Collection[int]:
        """Return the robots that did not answer in time in this phase; at most once."""
        return self._robots.pop(phase, ())
