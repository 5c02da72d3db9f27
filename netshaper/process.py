"""The relay's shell: it turns bus messages into calls of `Radio`, and answers into messages.

It also keeps the list of participants present: it tells the world to begin once all have joined, and to continue
without a robot that died. A viewer may join and leave; the run does not wait for it.
"""

from __future__ import annotations

from collections import Counter, defaultdict

from msgspec.structs import replace

from netshaper.medium import Account
from netshaper.radio import Outgoing, Radio
from netshaper.settings import RadioSettings
from protocol import keys as names
from protocol import rights
from protocol.bus import Bus, Message
from protocol.errors import ProtocolError
from protocol.fields import MOST_WORD, clip
from protocol.keys import Keys
from protocol.messages import (
    Back,
    Begin,
    Change,
    Close,
    Configure,
    End,
    Fault,
    FaultEvent,
    Lost,
    MediumEvent,
    PhaseDelivery,
    Positions,
    RadioReport,
    Record,
    RelayUpdate,
    RobotFrames,
    Shutdown,
    Stop,
    Watched,
    pack,
)
from protocol.packets import Held, Offer, Passed, Target
from protocol.rights import MAX_PROTOCOL_ERRORS, TOO_MANY_ERRORS

ENDED = "its process ended"
"""Why a robot is lost that has left the bus."""

LEAST_FRAME, MOST_FRAME = 64, 1 << 24
"""Bytes of a frame that are taken from a robot besides the budget, at least; and where there is none."""

BESIDES = Held.size + Offer.size + Passed.size + Target.size
"""Bytes that may be said of a map, or of where its robot is, whatever room there is."""


class RelayNode:
    """One run's relay; `done` once all participants have been told to shut down and have left.

    With `captures` it reports the frames themselves as well, for who writes them down.
    """

    def __init__(self, bus: Bus, keys: Keys, settings: RadioSettings, *, captures: bool = True) -> None:
        self.done = False
        self.going_home = False
        """Whether all have been told that the run is over; participants that stay anyway are not waited for."""
        self._bus = bus
        self._keys = keys
        self._radio = Radio(settings)
        self._captures = captures
        robots = self._robots = [names.robot(number) for number in range(settings.robots)]
        self._besides = max(LEAST_FRAME, settings.maps * BESIDES)
        self._hears_at = [keys.radio_rx(robot, names.RELAY) for robot in robots]
        self._expected = {names.WORLD, names.RECORDER, *robots}
        self._present: set[str] = set()
        self._watched = False
        self._begun = False
        self._ended = False
        self._settings: dict[int, bytes] = {}
        """Each robot's `Configure` message, for when it joins."""
        self._events: defaultdict[int, list[MediumEvent]] = defaultdict(list)
        """Events that each robot has not been sent yet."""
        self._protocol_errors: Counter[str] = Counter()
        """How often each participant has made no sense in this step."""

    @property
    def _most_bytes(self) -> int:
        """Of a frame: what is longer is not looked at."""
        limit = self._radio.settings.budget.limit
        return MOST_FRAME if limit is None else limit + self._besides

    def missing(self) -> list[str]:
        """Participants that have not joined yet; empty once the run has begun."""
        return [] if self._begun else sorted(self._expected - self._present)

    @property
    def phase(self) -> tuple[object, ...]:
        """What the relay waits for."""
        return self._begun, self._ended, self.going_home, len(self._present), self._radio.phase

    def waiting_for(self) -> list[int]:
        """Robots whose messages the relay is waiting for."""
        return self._radio.waiting_for()

    def handle(self, message: Message) -> None:
        """Take one message from the bus."""
        key, payload = message
        plane, _, sender, _ = names.parts(key)
        if plane == "presence":
            self._presence(sender, came=payload == b"1")
        else:
            try:
                self._take(sender, rights.read(key, payload), payload)
            except ProtocolError as error:
                self._fault(sender, str(error))
        if self._radio.protocol_errors:
            self._report_faults()
        self.done = self.going_home and not self._present

    def give_up_on(self, robot: int, cause: str) -> None:
        """Continue without a robot."""
        name = names.robot(robot)
        if name in self._present:
            self._present.discard(name)
            self._events.pop(robot, None)
            self._report(Lost(robot, cause))
            self._bus.put(self._keys.control(names.WORLD, names.RELAY), pack(Lost(robot, cause)))
            self._send(self._radio.lost(robot))

    def _presence(self, who: str, *, came: bool) -> None:
        if who == names.VIEW:
            self._watched = came
            for name in sorted(self._present - {names.RECORDER}):
                self._bus.put(self._keys.control(name, names.RELAY), pack(Watched(came)))
        elif came:
            self._present.add(who)
            if self._watched and who != names.RECORDER:
                self._bus.put(self._keys.control(who, names.RELAY), pack(Watched(here=True)))
            if names.is_robot(who):
                self._configure(names.number(who))
            if not self._begun and self._expected <= self._present:
                self._begun = True
                self._bus.put(self._keys.control(names.WORLD, names.RELAY), pack(Begin()))
            elif self._begun and who[:1] == "r":
                self._come_back(names.number(who))
        elif self.going_home or not (self._begun or who in (names.WORLD, names.RECORDER)):
            self._present.discard(who)
        elif who == names.WORLD:
            self._present.discard(who)
            self.break_off("the world died")
        elif who == names.RECORDER:
            self._present.discard(who)
            self.break_off("the laboratory died")
            self._go_home()
        else:
            self.give_up_on(names.number(who), ENDED)

    def _configure(self, robot: int) -> None:
        """Send a robot its settings once both are here: the robot and its settings."""
        name = names.robot(robot)
        if name in self._present and robot in self._settings:
            self._bus.put(self._keys.control(name, names.RELAY), self._settings[robot])

    def _come_back(self, robot: int) -> None:
        """A robot that was gone has joined again; it takes part from the next step on."""
        self._radio.back(robot)
        self._report(Back(robot))
        self._bus.put(self._keys.control(names.WORLD, names.RELAY), pack(Back(robot)))

    def _take(self, sender: str, said: object, payload: bytes) -> None:
        """Take what somebody says; ProtocolError if it makes no sense."""
        if isinstance(said, RobotFrames):
            self._check_lengths(said)
            self._send(self._radio.submit(names.number(sender), said))
        elif isinstance(said, Positions):
            self._protocol_errors.clear()
            cells = dict(zip(said.robots, zip(said.x, said.y, strict=True), strict=True))
            opening = self._radio.begin(said.step, cells, said.mute, said.deaf)
            for change in self._radio.changed:
                self._report(change)
            self._radio.changed.clear()
            self._send(opening)
        elif isinstance(said, Configure):
            self._settings[said.robot] = payload
            self._configure(said.robot)
        elif isinstance(said, End):
            self._end(said)
        elif isinstance(said, Lost):
            self.give_up_on(said.robot, said.cause)
        elif isinstance(said, Stop | FaultEvent):
            self._bus.put(self._keys.control(names.WORLD, names.RELAY), payload)
        elif isinstance(said, Change):
            self._radio.change(said)
        elif isinstance(said, Shutdown):
            self._go_home()

    def break_off(self, reason: str) -> None:
        """End the run, for something without which it cannot be is gone."""
        if not self._ended:
            self._end(End(-1, reason, -1))

    def _end(self, end: End) -> None:
        """Tell the robots and the laboratory that the run is over; their maps follow."""
        self._ended = True
        for name in sorted(self._present - {names.WORLD, names.RECORDER}):
            self._bus.put(self._keys.control(name, names.RELAY), pack(end))
        self._report(end)

    def _go_home(self) -> None:
        for name in sorted(self._present | ({names.VIEW} if self._watched else set())):
            self._bus.put(self._keys.control(name, names.RELAY), pack(Shutdown()))
        self.going_home = True

    def _check_lengths(self, submitted: RobotFrames) -> None:
        """Raise ProtocolError if a frame is longer than any frame that could be carried."""
        replies = submitted.replies
        longest = max(
            len(submitted.broadcast),
            len(replies.decline),
            *[len(frame.payload) for frame in submitted.frames],
            *[len(reply.answer) for reply in replies.offers],
            *map(len, replies.loads),
        )
        if longest > self._most_bytes:
            reason = f"a frame of {longest} bytes, where {self._most_bytes} are the most that can be carried"
            raise ProtocolError("RobotFrames", 0, reason)

    def _send(self, outgoing: list[Outgoing]) -> None:
        """Send robots their events, in one message each.

        Events of phases in which the relay has answered for a robot wait for the next one that concerns it.
        """
        accounts: list[Account] = []
        for item in outgoing:
            if isinstance(item, Account):
                accounts.append(item)
            else:
                self._events[item.robot].append(item.event)
        for robot in sorted(self._events):
            if not _can_wait(self._events[robot][-1]):
                self._bus.put(self._hears_at[robot], pack(RelayUpdate(self._events.pop(robot))))
        for account in accounts:
            self._bus.put(self._keys.control(names.WORLD, names.RELAY), pack(Close(account.step)))
            self._report(account.report(captures=self._captures))

    def _report_faults(self) -> None:
        for robot, reason in self._radio.protocol_errors:
            self._fault(names.robot(robot), reason)
        self._radio.protocol_errors.clear()

    def _fault(self, who: str, reason: str) -> None:
        self._protocol_errors[who] += 1
        if self._protocol_errors[who] <= MAX_PROTOCOL_ERRORS:
            self._report(Fault(who[:MOST_WORD], clip(reason)))
        elif who in self._robots:
            self.give_up_on(names.number(who), TOO_MANY_ERRORS)

    def _report(self, message: Record) -> None:
        """Tell the laboratory, and the viewer if there is one; frames on the air are only for the former."""
        self._bus.put(self._keys.control(names.RECORDER, names.RELAY), pack(message))
        if self._watched:
            seen = replace(message, frames=b"") if isinstance(message, RadioReport) else message
            self._bus.put(self._keys.control(names.VIEW, names.RELAY), pack(seen))


def _can_wait(event: MediumEvent) -> bool:
    """Return whether a robot need not act on an event, since the relay has answered for it."""
    return isinstance(event, PhaseDelivery) and event.answered_by_relay
