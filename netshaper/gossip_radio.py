"""The relay's mind where maps travel by gossip: one phase an exchange, and no connections.

    offers    all robots say their targets (first exchange), and news; targets go on the air first, then news,
              the most urgent first
    (played)  the news go on the air until the budget is spent; all in range hear them, and what was carried

A further exchange is opened while news are carried and something is left of the budget.
"""

from __future__ import annotations

from netshaper.frames import is_broadcast, wrong_in_news
from netshaper.ledger import EVERYONE
from netshaper.medium import NEWS
from netshaper.radio import Frame, Outgoing, Radio


class GossipRadio(Radio):
    """The radio of one run; as `Radio`, but for how maps travel."""

    def _end_offers(self) -> list[Outgoing]:
        """Put broadcasts and then news on the air, the most urgent first, and tell all what became of them."""
        broadcasts: list[tuple[int, bytes]] = []
        told: list[tuple[int, bytes]] = []
        for sender, said in sorted(self._spoken.items()):
            for receiver, payload in said.puts():
                if receiver == EVERYONE and is_broadcast(payload):
                    broadcasts.append((sender, payload))
                    continue
                problem = (
                    wrong_in_news(receiver, payload)
                    or self._too_long(payload)
                    or ("twice" if told and told[-1][0] == sender else "")
                )
                if sender in self._mute:
                    self._refuse(sender, receiver, NEWS, payload, "mute", "")
                elif problem:
                    reason = f"news are one broadcast of units: {problem}"
                    self._refuse(sender, receiver, NEWS, payload, "protocol", reason)
                else:
                    told.append((sender, payload))
        out = self._put_broadcasts_on_air(broadcasts, self._fair_share())
        order = self._drawn("back-off", told)
        order.sort(key=lambda item: self._shares.rank(item[0], self._priority(item[0])))
        hearers = {sender: self._hearers(sender) for sender, _ in order}
        sizes = self._medium.tell(self._round, [(s, payload, hearers[s]) for s, payload in order])
        carried = {sender: size for (sender, _), size in zip(order, sizes, strict=True)}
        for sender, size in carried.items():
            self._shares.book(sender, size)
        heard: dict[int, int] = {}
        for (sender, payload), size in zip(order, sizes, strict=True):
            if size:
                out.append(Frame(hearers[sender], sender, payload[:size]))
            for hearer in hearers[sender] if size else ():
                heard[hearer] = heard.get(hearer, 0) + 1
        for robot in sorted({*carried, *heard, *self._broadcast_carried} - self._dead):
            own = [carried[robot]] if robot in carried else []
            out.append(self._tell(robot, own, heard.get(robot, 0)))
        self._round += 1
        if any(sizes) and self._round < self.settings.rounds and self._medium.left:
            return out + self._open()
        return out + self._close()
