"""Which maps are offered to whom: what is news to a teammate, and of that what is worth a handshake now."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from protocol.kernels import kernel

POLICIES = ("backoff", "thesis")
"""When maps are offered. ``thesis``: in every exchange all maps, to all for whom they are news. ``backoff``:
at most one map to each teammate, the robot's own if it is news, else, after a step's first exchange, the one
with most news; where steps have only one exchange these take turns; after a refusal twice as long a wait. And in a
crowd (`CROWD`) to no more teammates than the medium could carry answers of, in turn."""

CROWD = 16
"""Robots in range of each other from which on, ``backoff``, handshakes are bounded by what the medium can carry: all
of these could make 240 offers an exchange, which with their answers are 960 bytes."""

Table = NDArray[np.int64]


def all_news(
    own_map: int, peers: Sequence[int], own_maps: Table, known: Table, held: Table
) -> list[tuple[int, int]]:
    """All maps to all for whom they are news, the robot's own first: the thesis' policy."""
    news = known < held
    return [
        (peer, map_id)
        for peer in peers
        for map_id in (own_map, *(each for each in range(len(held)) if each not in (own_map, own_maps[peer])))
        if news[peer, map_id]
    ]


@kernel(
    "void(int64[:,::1], int64[:,::1], int64[::1], int64[::1], int64[::1], int64, int64, int64, boolean, int64[::1])"
)
def choose_offers(
    known: Table,
    due: Table,
    held: Table,
    peers: Table,
    own_maps: Table,
    own_map: int,
    now: int,
    round_number: int,
    only_first: bool,
    chosen: Table,
) -> None:
    """Choose for each peer the map to offer it, by the rule ``backoff``; -1: none."""
    turn_of_others = round_number != 0 or (only_first and now % 2 == 0)
    for each in range(len(peers)):
        peer = peers[each]
        own = held[own_map] > known[peer, own_map] and now >= due[peer, own_map]
        chosen[each] = own_map if own else -1
        if (own and not only_first) or not turn_of_others:
            continue
        most = 0
        for map_id in range(len(held)):
            news = held[map_id] - known[peer, map_id]
            if news > most and map_id not in (own_map, own_maps[peer]) and now >= due[peer, map_id]:
                most = news
                chosen[each] = map_id
