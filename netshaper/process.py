"""The relay process: it turns messages of the bus into calls of `Radio`, and the radio's events into messages.

It also keeps the list of participants. The world begins when the relay reports that all have joined, and continues
without a robot that the relay reports as lost. A viewer may join and leave; the run does not wait for it.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Collection

from msgspec.structs import replace

from netshaper.phase_clock import PhaseClock
from netshaper.radio import Radio
from netshaper.settings import RadioSettings
from protocol import keys as names
from protocol import messages, rights
from protocol.bus import Bus, Message
from protocol.errors import ProtocolError
from protocol.faults import RADIO_KINDS
from protocol.keys import Keys
from protocol.message_codec import pack
from protocol.message_fields import MAX_NAME, clip
from protocol.rights import MAX_PROTOCOL_ERRORS, MAX_STEP_BYTES, TOO_MANY_BYTES, TOO_MANY_ERRORS

ENDED = "its process ended"
"""Cause of the loss of a robot that has left the bus."""
DISCONNECTED = "its process ended, or its connection was cut and not restored"
"""Cause of the loss of a robot that has left the bus, and whose process may be alive."""


class RelayNode:
    """The relay of one run; `done` once all participants have received `Shutdown` and have left.

    `captures`: whether to report the frames themselves as well as the ledger. `resend` sends the last messages to a
    robot again. With it, the relay waits for a robot that has left the bus, until `give_up_on` is called: only its
    connection may have been cut. Without it, such a robot is lost at once. `may_return`: whether a lost robot may take
    part again, as a new incarnation. `clock` ends phases of the medium; by default, they wait for all robots.
    """

    def __init__(
        self,
        bus: Bus,
        keys: Keys,
        settings: RadioSettings,
        *,
        captures: bool = True,
        resend: Callable[[str], object] | None = None,
        may_return: bool = True,
        clock: PhaseClock | None = None,
    ) -> None:
        self.done = False
        self.away: set[int] = set()
        """Robots whose connections were cut and are not restored yet."""
        self._resend = resend
        self._may_return = may_return
        self._ending: set[int] = set()
        """Robots that a fault kills, and that have not left the bus yet."""
        self.shutting_down = False
        """Whether the relay has sent `Shutdown`; it does not wait for participants that stay."""
        self._bus = bus
        self._keys = keys
        self._radio = Radio(settings)
        self._clock = PhaseClock() if clock is None else clock
        self._captures = captures
        robots = [names.robot(number) for number in range(settings.robots)]
        self._keys_to_robots = [keys.radio_rx(robot, names.RELAY) for robot in robots]
        self._expected = {names.WORLD, names.RECORDER, *robots}
        self._present: set[str] = set()
        self._watched = False
        self._begun = False
        self.fault: str | None = None
        """Why the relay has broken off the run; empty if the world has ended it, None while it continues."""
        self._settings: dict[int, bytes] = {}
        """Each robot's `Configure` message, for when it joins."""
        self._protocol_errors: Counter[str] = Counter()
        """Protocol errors of each participant in this step."""
        self._submitted_bytes: Counter[str] = Counter()
        """Bytes of each robot's messages in this step."""

    def missing(self) -> list[str]:
        """Participants that have not joined yet; empty once the run has begun."""
        return [] if self._begun else sorted(self._expected - self._present)

    @property
    def phase(self) -> tuple[object, ...]:
        """The phase of the run; it changes whenever the relay makes progress."""
        return self._begun, self.fault, self.shutting_down, len(self._present), self._radio.phase

    def waiting_for(self) -> list[int]:
        """Robots whose messages the relay is waiting for."""
        return self._radio.waiting_for() if self._clock.waits else []

    def deadline(self, now_ns: int) -> int | None:
        """Return the time at which `tick` should be called, in nanoseconds; None: never."""
        return self._clock.deadline(self._radio.phase, now_ns)

    def tick(self, now_ns: int) -> None:
        """End the phase if its time is over. Call this when no message is waiting."""
        due = self.deadline(now_ns)
        if due is not None and now_ns >= due:
            self._continue_without(self._radio.waiting_for())

    def handle(self, message: Message) -> None:
        """Take one message from the bus."""
        key, payload = message
        plane, _, sender, _ = names.parts(key)
        if plane == "presence":
            self._presence(sender, came=payload == b"1")
        elif sender in self._present or not (self._begun and names.is_robot(sender)):
            try:
                self._take(sender, rights.read(key, payload), payload)
            except ProtocolError as error:
                self._report_error(sender, str(error))
        while missed := self._clock.missed(self._radio.phase):
            self._continue_without(missed)
        for robot, reason in self._radio.protocol_errors:
            self._report_error(names.robot(robot), reason)
        self._radio.protocol_errors.clear()
        self.done = self.shutting_down and not self._present

    def give_up_on(self, robot: int, cause: str) -> None:
        """Continue without a robot."""
        name = names.robot(robot)
        self.away.discard(robot)
        if name in self._present:
            self._present.discard(name)
            self._report(messages.Lost(robot, cause))
            self._put(names.WORLD, pack(messages.Lost(robot, cause)))
            self._radio.lost(robot)
            self._send_events()

    def _continue_without(self, robots: Collection[int]) -> None:
        """Continue the step without robots that miss this phase of the medium."""
        step, number, phase = self._radio.phase
        self._report(messages.Missed(step, phase, number, list(robots)))
        self._radio.skip(robots)
        self._send_events()

    def _presence(self, name: str, *, came: bool) -> None:
        """A participant has joined or left the bus."""
        if name == names.VIEW:
            self._watched = came
            for other in sorted(self._present - {names.RECORDER}):
                self._put(other, pack(messages.Watched(came)))
        elif came:
            self._join(name)
        else:
            self._leave(name)

    def _join(self, name: str) -> None:
        """Let a participant take part; refuse a robot that was lost and may not return."""
        robot = names.number(name) if names.is_robot(name) else None
        if robot in self.away:
            self._reconnect(robot)
            return
        if robot is not None and self._begun and not self._may_return:
            self._put(name, pack(messages.Shutdown()))
            self._report_error(name, "joined again after it was lost; it may not start again in this run")
            return
        if self._resend is not None and not self._begun:
            self._resend(name)
        self._present.add(name)
        if self._watched and name != names.RECORDER:
            self._put(name, pack(messages.Watched(here=True)))
        if robot is not None:
            self._configure(robot)
        if not self._begun and self._expected <= self._present:
            self._begun = True
            self._put(names.WORLD, pack(messages.Begin()))
        elif self._begun and robot is not None:  # it was lost, and takes part again from the next step on
            self._radio.back(robot)
            self._report(messages.Back(robot))
            self._put(names.WORLD, pack(messages.Back(robot)))

    def _leave(self, name: str) -> None:
        """End the run without world or recorder; continue without a robot, unless it may come back."""
        if self.shutting_down or not (self._begun or name in (names.WORLD, names.RECORDER)):
            self._present.discard(name)
        elif name == names.WORLD:
            self._present.discard(name)
            self.break_off("the world died")
        elif name == names.RECORDER:
            self._present.discard(name)
            self.break_off("the recorder died")
            self._shut_down()
        elif self._resend is None or names.number(name) in self._ending:
            self._ending.discard(names.number(name))
            self.give_up_on(names.number(name), ENDED)
        elif name in self._present:
            self.away.add(names.number(name))

    def _reconnect(self, robot: int) -> None:
        """Let a robot continue whose connection was cut: all ends send their last messages again."""
        name = names.robot(robot)
        self.away.discard(robot)
        if self._resend is not None:
            self._resend(name)
        restored = messages.Reconnected(robot)
        for other in (name, names.WORLD):
            self._put(other, pack(restored))
        self._report(restored)

    def _configure(self, robot: int) -> None:
        """Send a robot its settings once the robot has joined and the settings have arrived."""
        name = names.robot(robot)
        if name in self._present and robot in self._settings:
            self._put(name, self._settings[robot])

    def _take(self, sender: str, message: object, payload: bytes) -> None:
        """Take a message of a participant; ProtocolError if its frames are too long."""
        match message:
            case messages.RobotFrames():
                self._submit(sender, message, len(payload))
            case messages.Positions():
                self._begin_step(message)
            case messages.Configure():
                self._settings[message.robot] = payload
                self._configure(message.robot)
            case messages.End():
                self._end(message)
            case messages.Lost():
                self.give_up_on(message.robot, message.cause)
            case messages.FaultEvent() if sender == names.WORLD:
                self._ending.add(message.robot)
            case messages.Change():
                self._radio.change(message)
            case messages.FaultEvent() if (
                message.kind in RADIO_KINDS and message.robot < self._radio.settings.robots
            ):
                self._radio.change(message)
            case messages.Stop() | messages.FaultEvent():
                self._put(names.WORLD, payload)
            case messages.RequestMaps() if names.robot(message.robot) in self._present:
                self._put(names.robot(message.robot), payload)
            case messages.Shutdown():
                self._shut_down()

    def _submit(self, sender: str, submitted: messages.RobotFrames, size: int) -> None:
        """Give a robot's frames to the radio; give up on a robot that sends too many bytes in a step.

        Raises ProtocolError if a frame is longer than any frame that could be carried.
        """
        self._submitted_bytes[sender] += size
        if self._submitted_bytes[sender] > MAX_STEP_BYTES:
            self.give_up_on(names.number(sender), TOO_MANY_BYTES.format(MAX_STEP_BYTES))
            return
        most = self._radio.settings.max_frame_bytes
        if size > most:
            longest = max([len(submitted.broadcast), *[len(frame.payload) for frame in submitted.frames]])
            if longest > most:
                reason = f"a frame of {longest} bytes, where {most} are the most that can be carried"
                raise ProtocolError("RobotFrames", 0, reason)
        self._radio.submit(names.number(sender), submitted)
        self._send_events()

    def _begin_step(self, positions: messages.Positions) -> None:
        self._protocol_errors.clear()
        self._submitted_bytes.clear()
        cells = dict(zip(positions.robots, zip(positions.x, positions.y, strict=True), strict=True))
        self._radio.begin(positions.step, cells)
        for change in self._radio.changed:
            self._report(change)
        self._radio.changed.clear()
        self._send_events()

    def break_off(self, reason: str) -> None:
        """End the run because a process that it needs is gone."""
        if self.fault is None:
            self._end(messages.End(-1, reason, -1), reason)

    def _end(self, end: messages.End, fault: str = "") -> None:
        """Send the end of the run to the recorder, which then requests the robots' maps."""
        self.fault = fault
        self._report(end)

    def _shut_down(self) -> None:
        for name in sorted(self._present | ({names.VIEW} if self._watched else set())):
            self._put(name, pack(messages.Shutdown()))
        self.shutting_down = True

    def _send_events(self) -> None:
        """Send robots their events, in one message each, and report the step if it has ended."""
        if not self._radio.events and not self._radio.accounts:
            return
        events: defaultdict[int, list[messages.MediumEvent]] = defaultdict(list)
        for robot, event in self._radio.events:
            events[robot].append(event)
        self._radio.events.clear()
        for robot in sorted(events):
            self._bus.put(self._keys_to_robots[robot], pack(messages.RelayUpdate(events[robot])))
        accounts, self._radio.accounts = self._radio.accounts, []
        for account in accounts:
            self._put(names.WORLD, pack(messages.Close(account.step)))
            self._report(account.report(captures=self._captures, links=self._watched))

    def _put(self, name: str, payload: bytes) -> None:
        """Send a packed message to a participant on the control plane."""
        self._bus.put(self._keys.control(name, names.RELAY), payload)

    def _report_error(self, name: str, reason: str) -> None:
        """Report a protocol error; give up on a robot that causes too many in a step."""
        self._protocol_errors[name] += 1
        if self._protocol_errors[name] <= MAX_PROTOCOL_ERRORS:
            self._report(messages.ErrorReport(name[:MAX_NAME], clip(reason)))
        elif names.is_robot(name):
            self.give_up_on(names.number(name), TOO_MANY_ERRORS)

    def _report(self, message: messages.Record) -> None:
        """Send a message to the recorder, and to the viewer if there is one.

        Only the recorder gets the frames of a step, and only the viewer its links.
        """
        recorded = shown = message
        if isinstance(message, messages.RadioReport):
            recorded, shown = replace(message, links=b""), replace(message, frames=b"")
        self._put(names.RECORDER, pack(recorded))
        if self._watched:
            self._put(names.VIEW, pack(shown))
