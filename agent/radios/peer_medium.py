"""The core of a radio without a relay: it gives a robot the events that a relay would send, and seals its frames.

A relay knows who is in range, and tells each robot which bytes were on the air. Here each robot decides by itself:

    event of the relay             here
    Open, robots in range          teammates received within the neighbor timeout
    Open, budget                   what the pacing allows now (`agent.radios.pacing`); 0 while a frame is on the air
    Broadcasts, deliveries         the frames that arrived since the last step, opened and checked
    RoundReport, bytes on the air  all bytes of a frame that was scheduled; only reports of peers tell what arrived

One frame at most is sent per step. It holds the robot's broadcast (pose, target, digest) and its gossip together:

    u8          bytes of the broadcast
    broadcast
    gossip      up to the end

An empty payload is a hello, which a robot sends after some time of silence, so that others know that it is in range.
A payload of one zero byte is a farewell: the sender has ended. It is then out of range, until it starts again.
Robots must gossip and require acknowledgments (`agent.settings.Settings`), since this medium may lose any frame.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from msgspec.structs import replace

from agent.radios.neighbors import Neighbors
from agent.radios.pacing import Pacer
from agent.radios.sealing import OVERHEAD, Opener, Sealer
from protocol.budget import Budget
from protocol.messages import (
    EVERYONE,
    Broadcasts,
    Close,
    Delivery,
    MediumEvent,
    Open,
    RobotFrames,
    RoundReport,
    SendReport,
)
from protocol.nanoseconds import SECOND
from protocol.packet_index import fitting

LENGTH_FIELD = 1
MAX_BROADCAST = 255

FRAME_OVERHEAD = OVERHEAD + LENGTH_FIELD
"""Bytes of a frame besides the robot's packets."""

FAREWELL = bytes(LENGTH_FIELD)
"""The payload of a farewell: no broadcast, and no gossip."""

WORTHWHILE = 6 * FRAME_OVERHEAD
"""Bytes for which a frame waits, unless the radio's frames are shorter: so overhead is a sixth of a full frame."""

MAX_WAITING = 256
"""Frames kept until the end of a step; further ones are dropped."""


class FrameRecord(NamedTuple):
    """A frame that this robot sent, or received and accepted; for its ledger and capture.

    `size`: bytes of the sealed frame. `broadcast`, `gossip`: the robot's packets, empty for a hello and a farewell.
    """

    time: int
    step: int
    sender: int
    session: int
    counter: int
    size: int
    broadcast: bytes
    gossip: bytes


@dataclass(frozen=True)
class Timing:
    """Durations, in nanoseconds."""

    neighbor_timeout: int
    """A teammate counts as in range until this time after its last frame has passed."""
    hello: int
    """Silence after which a robot sends a frame without packets."""
    interval: int
    """Minimum time between two frames of a robot; packets wait for each other, and share the overhead of a frame."""

    def __post_init__(self) -> None:
        if not 0 <= self.interval <= self.hello < self.neighbor_timeout:
            seconds = [f"{each / SECOND:g}" for each in (self.interval, self.hello, self.neighbor_timeout)]
            raise ValueError(
                f"interval_s = {seconds[0]}, hello_s = {seconds[1]}, neighbor_timeout_s = {seconds[2]}: the interval "
                "must not exceed the silence before a hello, which must be shorter than the timeout"
            )


class PeerMedium:
    """One robot's end of the medium, with sealed frames of at most `frame_bytes` bytes.

    `accepted` is called with sender and frame number before the content of an accepted frame is used, to store it.
    """

    def __init__(
        self,
        robot: int,
        frame_bytes: int,
        sealer: Sealer,
        opener: Opener,
        pacer: Pacer,
        timing: Timing,
        accepted: Callable[[int, int], object] = lambda _sender, _number: None,
    ) -> None:
        self.records: list[FrameRecord] = []
        """Frames since this list was last emptied."""
        self._robot = robot
        self._longest_broadcast = min(MAX_BROADCAST, frame_bytes - FRAME_OVERHEAD)
        self._worthwhile = min(frame_bytes, WORTHWHILE)
        self._sealer = sealer
        self._opener = opener
        self._pacer = pacer
        self._timing = timing
        self.neighbors = Neighbors(timing.neighbor_timeout)
        """Which teammates are in range, and which have ended."""
        self._accepted = accepted
        self._step = 0
        self._space = 0
        """Bytes of packets that may be sent in this step; 0 if they are not worth a frame yet."""
        self._last_sent: int | None = None
        """When the last frame was scheduled."""
        self._due: deque[tuple[int, bytes]] = deque()
        """Sealed frames to send, and when."""
        self._received: list[FrameRecord] = []
        self._sent = RoundReport(0, 0, [], [], [], broadcast_sent=False)

    @property
    def dropped(self) -> dict[str, int]:
        """Received frames that were dropped, by reason (`agent.radios.sealing.Reason`)."""
        return {str(reason): count for reason, count in self._opener.dropped.items()}

    # --- the robot's side

    def begin_step(self, step: int, now: int) -> Open:
        """Begin a step; return the event that lets the robot send."""
        self._step = step
        self._sent = RoundReport(step, 0, [], [], [], broadcast_sent=False)
        waits = self._due or self._silence(now) < self._timing.interval
        room = 0 if waits else self._pacer.room(now)
        self._space = room - FRAME_OVERHEAD if room >= self._worthwhile else 0
        return Open(step, 0, self.neighbors.current(now), Budget(self._space))

    def submit(self, frames: RobotFrames, now: int) -> None:
        """Take a robot's answer to `begin_step`, and schedule its frame; ValueError if it does not gossip."""
        broadcast, gossip = frames.broadcast, b""
        if len(broadcast) > min(self._longest_broadcast, self._space):
            broadcast = b""
        sent = []
        for position, frame in enumerate(frames.frames):
            if frame.receiver != EVERYONE or position:
                raise ValueError(
                    "without a relay, a robot sends one frame per step, to all: dissemination = gossip"
                )
            gossip = fitting(frame.payload, self._space - len(broadcast))
            sent.append(SendReport(position, len(gossip)))
        self._sent = RoundReport(self._step, 0, [], sent, [], broadcast_sent=bool(broadcast))
        if broadcast or gossip:
            self._schedule(bytes([len(broadcast)]) + broadcast + gossip, broadcast, gossip, now)
        elif self._is_hello_due(now):
            self._schedule(b"", b"", b"", now)

    def say_farewell(self, now: int) -> bool:
        """Schedule a frame that tells teammates that this robot has ended; return False if it may not send one yet."""
        if self._due or self._pacer.room(now) < OVERHEAD + len(FAREWELL):
            return False
        self._schedule(FAREWELL, b"", b"", now)
        return True

    def end_step(self) -> list[MediumEvent]:
        """End a step; return what the robot received in it, and what was sent."""
        received, self._received = self._received, []
        broadcasts = [Delivery(each.sender, each.broadcast) for each in received if each.broadcast]
        gossip = [Delivery(each.sender, each.gossip) for each in received if each.gossip]
        step = self._step
        events: list[MediumEvent] = [Broadcasts(step, broadcasts)] if broadcasts else []
        return [*events, replace(self._sent, deliveries=gossip), Close(step)]

    # --- the transport's side

    def deadline(self) -> int | None:
        """Return when to call `poll` next; None if there is nothing to send."""
        return self._due[0][0] if self._due else None

    def poll(self, now: int) -> list[bytes]:
        """Return the sealed frames to send now."""
        frames = []
        while self._due and self._due[0][0] <= now:
            frames.append(self._due.popleft()[1])
        return frames

    def receive(self, frame: bytes, now: int) -> None:
        """Take a received frame; drop and count it if it is not a new one of a teammate."""
        opened = self._opener.open(frame)
        if opened is None:
            return
        sender, session, counter, payload = opened
        self._accepted(sender, self._opener.highest(sender))
        if payload == FAREWELL:
            self.neighbors.farewell(sender, session)
        else:
            self.neighbors.received(sender, session, now)
        end = LENGTH_FIELD + payload[0] if payload else 0
        if end > len(payload):
            self._opener.dropped["malformed"] += 1
        elif len(self._received) >= MAX_WAITING:
            self._opener.dropped["too many"] += 1
        else:
            broadcast, gossip = payload[LENGTH_FIELD:end], payload[end:]
            self._received.append(
                FrameRecord(now, self._step, sender, session, counter, len(frame), broadcast, gossip)
            )
            self.records.append(self._received[-1])

    def _is_hello_due(self, now: int) -> bool:
        """Return whether this robot has been silent for long, and could have sent packets if it had any.

        A robot that may not send a whole frame yet sends no hello: hellos would use up its budget.
        """
        return self._space > 0 and self._silence(now) >= self._timing.hello

    def _silence(self, now: int) -> int:
        """Return the time since this robot's last frame."""
        return self._timing.hello if self._last_sent is None else now - self._last_sent

    def _schedule(self, payload: bytes, broadcast: bytes, gossip: bytes, now: int) -> None:
        """Seal a frame, and put it into the queue."""
        session, counter = self._sealer.session, self._sealer.counter
        sealed = self._sealer.seal(payload)
        self._last_sent = self._pacer.schedule(len(sealed), now)
        self._due.append((self._last_sent, sealed))
        self.records.append(
            FrameRecord(
                self._last_sent, self._step, self._robot, session, counter, len(sealed), broadcast, gossip
            )
        )
