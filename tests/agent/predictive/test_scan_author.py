"""Ranks of updates of scans on narrow media."""

from __future__ import annotations

import numpy as np

from agent.predictive.history import History
from agent.predictive.scan_author import ScanAuthor
from agent.predictive.scan_stream import ScanStream
from protocol.grid import FREE, Grid, ray_table
from protocol.scans import Change, Scan

SIDE = 120


def author_of(own: Grid, *, ranks: bool) -> ScanAuthor:
    """Return the author of a robot that has seen all known cells in one scan."""
    scratch = np.empty((2 * own.size, 2), np.int32)
    stream = ScanStream(0, np.zeros_like(own), ray_table(50.0, 36), [History()], scratch, team=False)
    author = ScanAuthor(stream, wait_steps=1, ranks=ranks)
    author.add(Scan(60, 60, np.zeros(36, np.uint16)), Change(int((own == FREE).sum()), (0, 0, SIDE, SIDE)))
    return author


def test_an_update_is_the_more_urgent_the_more_cells_only_this_robot_knows() -> None:
    own = np.zeros((SIDE, SIDE), np.uint8)
    no_odds, received = np.zeros((SIDE, SIDE), np.int8), np.zeros_like(own)
    urgencies = []
    for half in (10, 20, 40):
        own[60 - half : 60 + half, 60 - half : 60 + half] = FREE
        author = author_of(own, ranks=True)
        assert author.is_due(own, no_odds, received)
        assert author.urgency is not None
        urgencies.append(author.urgency)
    assert urgencies == sorted(set(urgencies))
    received[:] = own
    received[60, 60] = 0
    author = author_of(own, ranks=True)
    assert author.is_due(own, no_odds, received)
    assert author.urgency is not None
    assert author.urgency < urgencies[0]


def test_updates_have_no_ranks_on_wider_media() -> None:
    own = np.full((SIDE, SIDE), FREE, np.uint8)
    author = author_of(own, ranks=False)
    assert author.is_due(own, np.zeros((SIDE, SIDE), np.int8), np.zeros_like(own))
    assert author.urgency is None
