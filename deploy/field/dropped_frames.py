"""Why a robot drops frames or messages, and what its user can do: advice that is given once per reason."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from agent.radios.sealing import Reason

SEVERAL = 3
"""Frames dropped for a reason before it is explained: a radio may damage single ones."""

SEVERAL_REPLAYED = 10
"""The same for frames that were received before: a network may repeat some."""

_EQUAL = "the version of Murmur, robots, starts, map_encoding and its options, tolerance, and [grid]"

ADVICE: Mapping[Reason, str] = {
    "unknown sender": "drops frames of robots beyond the size of its team, {robots}: all robots need the same `robots`",
    "own number": "drops frames of another robot with its own number, {robot}: give each robot of a team another "
    "`robot`, and each team a key of its own",
    "replayed": "drops frames with numbers that it has received before: two other robots have the same `robot` and "
    "key, so give each another `robot`, and each team a key of its own; or a session file was lost or restored, so "
    "create a new key; or a stranger sends recorded frames again, without effect",
    "not authentic": "drops frames that are not authentic: the sender has another key, or settings that differ from "
    f"this robot's. These must be equal: {_EQUAL}; with map_encoding scans or slam-toolbox, also the lasers",
}
"""What to say of each reason that the user's settings may cause."""


class DropAdvice:
    """Explains reasons that have not been explained yet, to the user of one robot."""

    def __init__(self, robot: int, robots: int) -> None:
        self._robot, self._robots = robot, robots
        self._given: set[str] = set()

    def new(self, dropped: Mapping[str, int]) -> Iterator[str]:
        """Yield advice on frames that were dropped since the start, by reason (`PeerMedium.dropped`)."""
        for reason, text in ADVICE.items():
            several = SEVERAL_REPLAYED if reason == "replayed" else SEVERAL
            if dropped.get(reason, 0) >= several and reason not in self._given:
                self._given.add(reason)
                yield text.format(robot=self._robot, robots=self._robots)


CONTRADICTION = (
    "robots of one team contradict each other about a map, so that maps may lack parts: the record directory of a "
    "robot was removed or replaced during the mission, or two robots have the same `robot`; stop all robots, and "
    "start the mission again with a new record.folder on each"
)
"""What to say of malformed messages in frames that are authentic: the senders have the same settings and code."""


class ErrorReporter:
    """Shows each error in a teammate's message, and after the first one, what its user can do."""

    def __init__(self, say: Callable[[str], object]) -> None:
        self._say = say
        self._is_explained = False

    def __call__(self, text: str) -> None:
        """Take an error as text."""
        self._say(text)
        if not self._is_explained:
            self._is_explained = True
            self._say(CONTRADICTION)
