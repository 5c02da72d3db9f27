"""Forged and damaged log entries: the team recovers, and no honest robot is blamed.

A forger with valid credentials attributes entries to another robot in one frame, or a bit of one frame flips although
the checksum holds. Both happen once per run.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest
from msgspec.structs import replace

from agent.encodings.predictive import PredictiveEncoding
from agent.encodings.update_packets import fragments
from agent.predictive.history import History
from agent.replication.control_packets import header
from agent.robot import Robot
from deploy.record.summary import summarize
from deploy.run.in_memory import MemoryRun
from deploy.scenario import plan as plans
from deploy.scenario.scenario import parse
from protocol import keys as names
from protocol import packet_codec, packet_index, packets
from protocol.bus import Bus, Message
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.message_codec import pack, unpack
from protocol.messages import EVERYONE, OutgoingFrame, RelayUpdate, RobotFrames, RoundReport

AUTHOR, VICTIM, FORGER = 0, 1, 3

MOST = 48
"""Bytes of the longest forged frame: the medium carries 50 per step."""

Forge = Callable[[Robot, np.random.Generator], bytes]
"""Returns a frame in which a robot attributes entries to `AUTHOR`; empty if it cannot forge any yet."""


def old_entry(robot: Robot, _rng: np.random.Generator) -> bytes:
    """An entry that the author wrote earlier."""
    written = packet_index.split(robot.replication.logs[AUTHOR].read(0))
    return header(AUTHOR, len(written)) + written[len(written) // 2] if len(written) > 4 else b""


def random_bytes(robot: Robot, rng: np.random.Generator) -> bytes:
    """A well-formed entry with random content, most of which can be decoded."""
    log = robot.replication.logs[AUTHOR]
    number = len(decoded(robot)) % packets.UPDATE_NUMBERS
    update = packet_codec.encode([packets.Update(number, rng.bytes(30))])
    return header(AUTHOR, len(log)) + update if len(log) > 4 else b""


def walls(grid: Grid, distance: Grid) -> None:
    """The author claims walls in unknown cells nearby, and around itself."""
    grid[(distance < 20) & (grid == UNKNOWN) | (distance > 4) & (distance < 6)] = OCCUPIED


def free_space(grid: Grid, distance: Grid) -> None:
    """The author claims that everything nearby is free."""
    grid[distance < 35] = FREE


def inverted(grid: Grid, distance: Grid) -> None:
    """The author claims walls where the map is free nearby, and free cells where it has walls."""
    near, before = (distance < 7) & (distance > 0), grid.copy()
    grid[near & (before == FREE)], grid[near & (before == OCCUPIED)] = OCCUPIED, FREE


def decoded(robot: Robot) -> list[Any]:
    """The updates of the author's map that a robot has decoded."""
    encoding = robot._encoding
    assert isinstance(encoding, PredictiveEncoding)
    history = encoding._histories[AUTHOR]
    return history.between(0, len(history))


def observation(falsify: Callable[[Grid, Grid], None]) -> Forge:
    """A forger of a scan of the author, encoded as the author would encode it after a falsified observation.

    The falsified area shrinks until the frame fits.
    """

    def forge(robot: Robot, _rng: np.random.Generator) -> bytes:
        return next(filter(None, (attempt(robot, shrinking) for shrinking in (1, 2, 3, 5))), b"")

    def attempt(robot: Robot, shrinking: int) -> bytes:
        encoding, updates = robot._encoding, decoded(robot)
        assert isinstance(encoding, PredictiveEncoding)
        if len(updates) < 5:
            return b""
        histories = list(encoding._histories)
        histories[AUTHOR] = History()
        stream = encoding._stream(AUTHOR, histories)
        for update in updates:
            stream.decode(update.message)
            stream.commit()
        assert stream.pose is not None
        (x, y), grid = stream.pose, robot.planning.copy()
        height, width = grid.shape
        rows, columns = np.mgrid[:height, :width]
        falsify(grid, shrinking * np.hypot(columns - x, rows - y))
        grid[y, x] = FREE
        box = max(0, x - 35), max(0, y - 35), min(width, x + 36), min(height, y + 36)
        encoded = stream.encode(grid, [(x, y)], box, most=36)
        if encoded is None:
            return b""
        entries = b"".join(fragments(encoded[0], len(updates), 63))
        frame = header(AUTHOR, len(robot.replication.logs[AUTHOR])) + entries
        return frame if len(frame) <= MOST else b""

    return forge


FORGERIES: dict[str, Forge] = {
    "an old entry": old_entry,
    "random bytes": random_bytes,
    "walls": observation(walls),
    "free space": observation(free_space),
    "inverted": observation(inverted),
}


class Forger:
    """The forger's end of the bus: one of its frames is replaced by a forged one."""

    def __init__(self, bus: Bus, robot: Callable[[], Robot | None], forge: Forge, seed: int) -> None:
        self.receive, self.close = bus.receive, bus.close
        self._bus, self._robot, self._forge = bus, robot, forge
        self._rng = np.random.default_rng(seed)
        self._first = 25 + seed % 40
        self.done = False

    def put(self, key: str, payload: bytes) -> None:
        robot, sent = self._robot(), unpack(payload) if not self.done else None
        if (
            isinstance(sent, RobotFrames)
            and sent.round == 0
            and sent.step >= self._first
            and robot is not None
        ):
            forged = self._forge(robot, self._rng)
            if forged:
                self.done = True
                payload = pack(replace(sent, frames=[OutgoingFrame(EVERYONE, forged)], priority=255))
        self._bus.put(key, payload)


class Flipper:
    """The victim's end of the bus: a bit of one received frame flips."""

    def __init__(self, bus: Bus, seed: int) -> None:
        self.put, self.close = bus.put, bus.close
        self._bus = bus
        self._rng = np.random.default_rng(seed)
        self._first = 25 + seed % 40
        self.done = False

    def receive(self, timeout_s: float | None = None) -> Message | None:
        message = self._bus.receive(timeout_s)
        received = unpack(message.payload) if message is not None and not self.done else None
        if message is None or not isinstance(received, RelayUpdate):
            return message
        return message._replace(
            payload=pack(RelayUpdate([self._damaged(event) for event in received.events]))
        )

    def _damaged(self, event: Any) -> Any:
        if (
            self.done
            or not isinstance(event, RoundReport)
            or event.step < self._first
            or not event.deliveries
        ):
            return event
        self.done = True
        first, *others = event.deliveries
        frame = bytearray(first.payload)
        frame[int(self._rng.integers(len(frame)))] ^= 1 << int(self._rng.integers(8))
        return replace(event, deliveries=[replace(first, payload=bytes(frame)), *others])


class Outcome(NamedTuple):
    """What a run ended with."""

    steps: int
    bytes: int
    wrong: int
    """Wrong cells in the planning grids of the robots that do not lie."""
    distrusted: set[int]
    """Robots that others distrust."""
    finished: bool
    happened: bool
    """Whether the forgery or the flip took place."""


def play(seed: int, bandwidth: int, disturbance: str = "", **settings: Any) -> Outcome:
    """Explore the office with four robots, disturbed once."""
    given = {
        "map": "office",
        "robots": 4,
        "bandwidth": bandwidth,
        "seed": seed,
        "bus": "memory",
        "digests": True,
    }
    plan = plans.make(parse(given | settings))
    ends: list[Forger | Flipper] = []

    def wrap(name: str, bus: Bus) -> Bus:
        if disturbance == "flip" and name == names.robot(VICTIM):
            ends.append(Flipper(bus, seed))
        elif disturbance in FORGERIES and name == names.robot(FORGER):
            ends.append(Forger(bus, lambda: run.agents[FORGER].robot, FORGERIES[disturbance], seed))
        else:
            return bus
        return ends[-1]

    run = MemoryRun(plan, wrap=wrap)
    records = run.complete()
    summary = summarize(plan, records, 1.0)
    truth = np.where(plan.map.cells == FREE, FREE, OCCUPIED)
    robots = [agent.robot for agent in run.agents if agent.robot is not None]
    honest = [robot for robot in robots if robot.settings.robot != FORGER or disturbance not in FORGERIES]
    wrong = sum(int(((robot.planning != truth) & (robot.planning != UNKNOWN)).sum()) for robot in honest)
    distrusted = set().union(*(robot.replication.replica.distrusted for robot in honest))
    happened = all(end.done for end in ends)
    return Outcome(
        summary["steps"], summary["bytes"]["total"], wrong, distrusted, summary["finished"], happened
    )


undisturbed = cache(play)


@pytest.mark.parametrize("disturbance", ["flip", *FORGERIES])
def test_a_team_recovers_from_a_forged_frame_or_a_flipped_bit(disturbance: str) -> None:
    outcome, calm = play(300, 1000, disturbance), undisturbed(300, 1000)
    assert outcome.happened
    assert outcome.finished
    assert outcome.wrong == 0
    assert outcome.distrusted <= {FORGER}
    assert outcome.bytes < 1.5 * calm.bytes


@pytest.mark.long
@pytest.mark.parametrize("disturbance", ["flip", *FORGERIES])
@pytest.mark.parametrize("bandwidth", [50, 1000])
def test_one_forged_frame_costs_few_steps_and_bytes(bandwidth: int, disturbance: str) -> None:
    seeds = range(300, 310)
    outcomes = [play(seed, bandwidth, disturbance) for seed in seeds]
    calm = [undisturbed(seed, bandwidth) for seed in seeds]
    assert all(outcome.happened and outcome.finished for outcome in outcomes)
    assert sum(outcome.wrong for outcome in outcomes) == 0
    assert not any(outcome.distrusted - {FORGER} for outcome in outcomes)
    assert sum(outcome.steps for outcome in outcomes) <= 1.05 * sum(each.steps for each in calm)
    assert sum(outcome.bytes for outcome in outcomes) <= 1.2 * sum(each.bytes for each in calm)


@pytest.mark.long
@pytest.mark.parametrize("bandwidth", [50, 1000])
def test_digests_cost_at_most_a_byte_per_step(bandwidth: int) -> None:
    seeds = range(300, 310)
    calm = [undisturbed(seed, bandwidth) for seed in seeds]
    without = [play(seed, bandwidth, digests=False) for seed in seeds]
    steps = sum(each.steps for each in calm)
    assert abs(steps / sum(each.steps for each in without) - 1) <= 0.01
    assert sum(each.bytes for each in calm) - sum(each.bytes for each in without) <= steps
