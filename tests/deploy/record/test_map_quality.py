"""The quality of maps: F1 of walls within one cell, and maps that noise alone cannot explain."""

from __future__ import annotations

import numpy as np
import pytest

from deploy.record.map_quality import is_refuted, wall_f1
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid


def room(wall: int = 5) -> Grid:
    """Return a room of 40 x 30 cells inside walls, the left one in column `wall`."""
    truth = np.full((40, 50), UNKNOWN, np.uint8)
    truth[5:35, wall : wall + 32] = OCCUPIED
    truth[6:34, wall + 1 : wall + 31] = FREE
    return truth


def test_walls_within_one_cell_count_as_found() -> None:
    truth = room()
    reachable = truth == FREE
    assert wall_f1(truth, truth, reachable) == 1
    assert wall_f1(room(wall=6), truth, reachable) == 1
    displaced = wall_f1(room(wall=8), truth, reachable)
    assert displaced is not None
    assert displaced < 0.9


def test_f1_combines_precision_and_recall() -> None:
    truth = room()
    half = truth.copy()
    half[:20][half[:20] == OCCUPIED] = UNKNOWN
    recall = 0.5
    assert wall_f1(half, truth, truth == FREE) == pytest.approx(2 * recall / (1 + recall), abs=0.02)
    assert wall_f1(np.zeros_like(truth), truth, truth == FREE) is None


def test_noise_does_not_refute_a_map_but_a_false_room_does() -> None:
    truth = room()
    reachable = truth == FREE
    everything = int(reachable.sum())
    noisy, false = room(wall=7), np.full_like(truth, FREE)
    assert not is_refuted(truth, truth, reachable, everything, noisy=False)
    assert is_refuted(noisy, truth, reachable, everything, noisy=False)
    assert not is_refuted(noisy, truth, reachable, everything, noisy=True)
    assert is_refuted(false, truth, reachable, everything, noisy=True)
