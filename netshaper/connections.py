"""Connections of a round of handshakes: each is one offer, its answer and its data, from one robot to another.

The relay collects the frames phase by phase and delivers each phase's frames together. In the end the medium carries
the connections one by one (`netshaper.medium`), and both ends get a report.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from netshaper.frame_log import Frame
from netshaper.ledger import ANSWER, DATA
from protocol.messages import ConnectionReport, Delivery


class Connections:
    """The connections of one round in the order in which they go on the air, as columns.

    Attributes
    ----------
    first : int
        The number of the first one.
    senders, receivers, maps : list of int
        The robot that offers a map, the robot that it is offered to, and the map.
    frames : three lists of Frame or None
        The offer, the answer and the data of each.
    lost : list of int
        The kind of the frame whose receiver could not receive it; -1 for none.
    """

    def __init__(self, first: int = 0, offers: Sequence[Frame] = ()) -> None:
        self.first = first
        self.senders = [offer.sender for offer in offers]
        self.receivers = [offer.receiver for offer in offers]
        self.maps = [offer.map_id for offer in offers]
        self.frames: tuple[list[Frame | None], list[Frame | None], list[Frame | None]]
        self.frames = list(offers), [None] * len(offers), [None] * len(offers)
        self.lost = [-1] * len(offers)

    def __len__(self) -> int:
        return len(self.senders)

    def ends(self, kind: int) -> tuple[list[int], list[int]]:
        """Return the senders and receivers of the frames of a kind."""
        return (self.receivers, self.senders) if kind == ANSWER else (self.senders, self.receivers)

    def deliveries(self, kind: int, receives: Callable[[int], bool]) -> dict[int, list[Delivery]]:
        """Return for each receiver the frames of a phase, in order; note those that a robot cannot receive."""
        senders, receivers = self.ends(kind)
        arrived: defaultdict[int, list[Delivery]] = defaultdict(list)
        for at, frame in enumerate(self.frames[kind]):
            if frame is None:
                continue
            if receives(receivers[at]):
                delivery = Delivery(senders[at], frame.payload, self.first + at, self.maps[at])
                arrived[receivers[at]].append(delivery)
            else:
                self.lost[at] = kind
        return arrived

    def reports(
        self, carried: NDArray[np.int64]
    ) -> tuple[dict[int, list[ConnectionReport]], dict[int, list[Delivery]]]:
        """Return for each robot the reports on its connections, and the data that arrived.

        `carried`: shape (connections, 3), the bytes of each frame that were on the air.
        """
        reports: defaultdict[int, list[ConnectionReport]] = defaultdict(list)
        arrived: defaultdict[int, list[Delivery]] = defaultdict(list)
        for at, (offer, answer, data) in enumerate(carried.tolist()):
            sender, receiver = self.senders[at], self.receivers[at]
            report = ConnectionReport(self.first + at, offer, answer, data)
            reports[sender].append(report)
            reports[receiver].append(report)
            frame = self.frames[DATA][at]
            if frame is not None and data:
                delivery = Delivery(sender, frame.payload[:data], self.first + at, self.maps[at])
                arrived[receiver].append(delivery)
        return reports, arrived
