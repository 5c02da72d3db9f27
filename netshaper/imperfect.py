"""The radio as it is (docs/radios.md): frames are lost, late, damaged or doubled, and robots have limits of their own.

Nobody learns what became of a frame but who hears it. So an exchange has one phase only, in which robots say all that
they have to say, also what they have to say to what they heard before; replies come in the next exchange:

    offers    all robots say their targets (first exchange), and frames for one robot or for all
    (played)  targets go on the air first, then confirmations, then all else, the most urgent first; each frame takes
              of the air what it needs, and what has come to its hearers by now is handed over

Senders are told what of theirs was on the air, not whether it was heard. A frame that does not fit closes nothing: a
shorter one may still use the rest.
"""

from __future__ import annotations

from typing import NamedTuple

from netshaper.airtime import Airtime, cut_into_frames, least
from netshaper.channel import DAMAGED, LOSS, Channel, Reception, with_sum
from netshaper.frames import is_broadcast, read_confirmed, wrong_in_news
from netshaper.gossip_radio import GossipRadio
from netshaper.ledger import CAUSES, EVERYONE
from netshaper.medium import ANSWER, BROADCAST, DATA, NEWS, UNLIMITED
from netshaper.radio import Frame, Outgoing, Radio, RadioSettings
from protocol import packet_index
from protocol.packets import Check

CARRIED, BUDGET, LIMIT, FULL = (CAUSES.index(cause) for cause in ("", "budget", "limit", "full"))

_WORDS = {LOSS: "lost to", DAMAGED: "damaged at", FULL: "too much for"}


class _Said(NamedTuple):
    """A frame that a robot wants on the air: `number` counts what it says in this exchange."""

    sender: int
    receiver: int
    number: int
    frame: int
    map: int
    payload: bytes


class _Coming(NamedTuple):
    """What a robot hears once its time has come."""

    due: int
    receiver: int
    sender: int
    payload: bytes
    broadcast: bool


def radio(settings: RadioSettings) -> Radio:
    """The radio of a run: what is put on the air is heard, or it is as radios are."""
    if not settings.perfect:
        return ImperfectRadio(settings)
    return GossipRadio(settings) if settings.gossip else Radio(settings)


class ImperfectRadio(Radio):
    """The radio of one run; as `Radio`, but for what becomes of frames."""

    def __init__(self, settings: RadioSettings) -> None:
        super().__init__(settings)
        options = settings.options
        self._air = Airtime(
            settings.budget,
            settings.robots,
            reuse=options.reuse,
            send=settings.send or [options.send_bytes] * settings.robots,
            receive=settings.receive or [options.receive_bytes] * settings.robots,
            duty_cycle=options.duty_cycle,
        )
        self._channel = Channel(options, settings.seed, settings.robots)
        self._tail = Check.size if options.sums else 0
        self._coming: list[_Coming] = []

    def _next_step(self) -> None:
        super()._next_step()
        self._air.next_step(self._reach)
        self._channel.next_step(self._step)

    def _set_budget(self, budget: int) -> None:
        super()._set_budget(budget)
        self._air.set_budget(budget)

    def _room(self, robot: int) -> int:
        return self._air.room(robot)

    def _too_long(self, payload: bytes) -> str:
        most = self.settings.options.frame_bytes
        size = packet_index.longest(payload) + self._tail if most else 0
        return (
            f"a packet of {size} bytes with its checksum, where a frame holds {most}" if size > most else ""
        )

    def _end_offers(self) -> list[Outgoing]:
        """Put all on the air, hand over what has come by now, and tell each robot what of its own was carried."""
        broadcasts, said = self._heed()
        share = self._fair_share() if self.settings.gossip else UNLIMITED
        for each in self._drawn("targets", broadcasts):
            self._put_broadcast(each, share)
        carried: dict[int, dict[int, int]] = {}
        order = self._drawn("contention", said)
        order.sort(key=lambda s: (s.frame != ANSWER, self._shares.rank(s.sender, self._priority(s.sender))))
        for each in order:
            size = carried.setdefault(each.sender, {})[each.number] = self._put(each)
            self._shares.book(each.sender, size)
        out, heard = self._hand_over()
        for robot in sorted({*self._spoken, *heard} - self._dead):
            puts = self._spoken[robot].puts() if robot in self._spoken else ()
            own = [
                carried.get(robot, {}).get(number, 0)
                for number, (receiver, payload) in enumerate(puts)
                if not (receiver == EVERYONE and is_broadcast(payload))
            ]
            if own or heard.get(robot) or robot in self._broadcast_carried:
                out.append(self._tell(robot, own, heard.get(robot, 0)))
        self._round += 1
        busy = any(size for sizes in carried.values() for size in sizes.values()) or bool(heard)
        if busy and self._round < self.settings.rounds and any(map(self._room, self._reach)):
            return out + self._open()
        return out + self._close()

    def _heed(self) -> tuple[list[_Said], list[_Said]]:
        """Broadcasts of targets and poses, and all else that was said; what makes no sense is refused."""
        broadcasts: list[_Said] = []
        frames: list[_Said] = []
        for sender, said in sorted(self._spoken.items()):
            told: set[int] = set()
            for number, (receiver, payload) in enumerate(said.puts()):
                target = receiver == EVERYONE and is_broadcast(payload)
                frame, map_id, problem = BROADCAST, -1, ""
                if target and (self._round or sender in self._broadcast_carried):
                    problem = "broadcast something other than a target or a pose, at the start of a step"
                elif not target:
                    frame, map_id, problem = self._read(receiver, payload)
                    problem = problem or self._too_long(payload) or ("twice" if receiver in told else "")
                    told.add(receiver)
                if receiver != EVERYONE and receiver not in self._reach.get(sender, ()):
                    self._refuse(sender, receiver, frame, payload, "range", "")
                elif problem:
                    self._refuse(sender, receiver, frame, payload, "protocol", problem)
                elif sender in self._mute:
                    self._refuse(sender, receiver, frame, payload, "mute", "")
                elif receiver in self._dead or receiver in self._deaf:
                    self._refuse(sender, receiver, frame, payload, "lost", "")
                else:
                    if target:
                        self._broadcast_carried[sender] = False
                    one = _Said(sender, receiver, number, frame, map_id, payload)
                    (broadcasts if target else frames).append(one)
        return broadcasts, frames

    def _read(self, receiver: int, payload: bytes) -> tuple[int, int, str]:
        """Return what kind of frame it is, which map it is about, and what is wrong with it."""
        if self.settings.gossip:
            return NEWS, -1, wrong_in_news(receiver, payload)
        return read_confirmed(receiver, payload, self.settings.maps)

    def _put_broadcast(self, said: _Said, share: int) -> None:
        """Put a target or a pose on the air, behind the first as long as they have not had their share."""
        if self._waits(said.payload, share):
            self._medium.leave_out(self._round, said.sender, said.payload)
        else:
            self._broadcast_carried[said.sender] = self._put(said) > 0

    def _put(self, said: _Said) -> int:
        """Put a frame on the air as far as there is room; return the bytes of its packets that were carried."""
        sender, receiver = said.sender, said.receiver
        shared, own = self._air.shared(sender), self._air.own(sender)
        room, most = least(shared, own), self.settings.options.frame_bytes
        frames, rest = cut_into_frames(said.payload, room, most, self._tail)
        if rest and said.frame not in (DATA, NEWS):
            frames, rest = [], said.payload
        summed = [with_sum(frame) for frame in frames] if self._tail else frames
        size = sum(map(len, summed))
        self._air.book(sender, size)
        self._medium.carried += size
        hearers = [receiver]
        if receiver == EVERYONE:
            hearers = self._hearers(sender)
        got: dict[int, Reception] = {}
        if frames:
            carry = self._channel.carry
            receptions = carry(self._step, self._round, sender, said.number, summed, hearers)
            for hearer, reception in zip(hearers, receptions, strict=True):
                got[hearer] = self._take(hearer, reception)
                self._queue(said, hearer, got[hearer])
        for index, frame in enumerate(summed):
            self._note(said, frame, index, got)
        if rest:
            cause = BUDGET if room == shared else LIMIT
            self._medium.predictiveings.add(
                self._round, -1, said.frame, sender, receiver, said.map, cause, rest
            )
        return sum(map(len, frames))

    def _take(self, hearer: int, reception: Reception) -> Reception:
        """What a robot takes of what it hears, if it cannot take any number of bytes."""
        for index, frame in enumerate(reception.frames):
            if not self._air.takes(hearer, len(frame) + self._tail):
                return Reception(reception.frames[:index], FULL, reception.delays)
        return reception

    def _queue(self, said: _Said, hearer: int, got: Reception) -> None:
        payload = b"".join(got.frames)
        if payload:
            for delay in got.delays:
                self._coming.append(
                    _Coming(self._step + delay, hearer, said.sender, payload, said.frame == BROADCAST)
                )

    def _note(self, said: _Said, frame: bytes, index: int, got: dict[int, Reception]) -> None:
        """Note a frame that was on the air, who heard it, and what happened to it on the way to others."""
        heard = [hearer for hearer, reception in got.items() if index < len(reception.frames)]
        missed = {hearer: reception.cause for hearer, reception in got.items() if hearer not in heard}
        verdict = max(missed.values()) if missed and not heard else CARRIED
        words = [f"{_WORDS[cause]} r{hearer}" for hearer, cause in missed.items()] if heard else []
        for hearer in heard:
            delay, *again = got[hearer].delays
            if delay:
                words.append(f"heard by r{hearer} in step {self._step + delay}")
            if again:
                words.append(f"twice by r{hearer}")
        self._medium.predictiveings.add(
            self._round, -1, said.frame, said.sender, said.receiver, said.map, verdict, frame, heard,
            "" if verdict else ", ".join(words),
        )  # fmt: skip

    def _hand_over(self) -> tuple[list[Outgoing], dict[int, int]]:
        """What has come by now, targets first, and how many other frames each robot hears."""
        now = [each for each in self._coming if each.due <= self._step]
        self._coming = [each for each in self._coming if each.due > self._step]
        out: list[Outgoing] = []
        heard: dict[int, int] = {}
        for each in sorted(now, key=lambda each: not each.broadcast):
            if each.receiver in self._reach and each.receiver not in self._dead | self._deaf:
                out.append(Frame((each.receiver,), each.sender, each.payload))
                if not each.broadcast:
                    heard[each.receiver] = heard.get(each.receiver, 0) + 1
        return out, heard
