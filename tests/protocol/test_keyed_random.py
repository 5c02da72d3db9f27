"""Random numbers by purpose: the same on every machine, and independent of each other."""

from __future__ import annotations

from typing import Any

import pytest

from protocol.keyed_random import keyed_random


def test_the_same_purpose_draws_the_same_numbers() -> None:
    one, other = (keyed_random(3, "contention", 7, 1).integers(0, 2**62, 8).tolist() for _ in range(2))
    assert one == other


@pytest.mark.parametrize("other", [(4, "contention", 7, 1), (3, "targets", 7, 1), (3, "contention", 71)])
def test_another_seed_purpose_or_number_draws_others(other: Any) -> None:
    assert keyed_random(3, "contention", 7, 1).random() != keyed_random(*other).random()


def test_adjacent_numbers_are_separated_in_the_key() -> None:
    near: Any = [(1, "a", 1, 11), (1, "a", 11, 1), (11, "a", 11), (1, "a", 111)]
    assert len({keyed_random(*key).random() for key in near}) == 4


def test_the_draws_are_the_golden_ones() -> None:
    assert keyed_random(0, "start").integers(0, 1000, 6).tolist() == [636, 939, 386, 271, 334, 558]
    assert keyed_random(7, "contention", 12, 1).permutation(8).tolist() == [4, 1, 7, 5, 2, 0, 6, 3]
