"""Seeds of training and of test."""

from __future__ import annotations

import pytest

from worldsim.generators.seeds import check_training_seeds, first_test_seeds, is_test_seed


def test_seeds_from_a_thousand_on_are_test_seeds() -> None:
    assert [seed for seed in (0, 1, 999, 1000, 1001, 2**40) if is_test_seed(seed)] == [1000, 1001, 2**40]
    assert first_test_seeds(3) == [1000, 1001, 1002]


def test_a_search_is_told_which_seed_it_must_not_use() -> None:
    check_training_seeds(range(1000))
    with pytest.raises(ValueError, match=r"seed 1003: is a test seed, .* use training seeds, below 1000"):
        check_training_seeds([0, 1003, 2000])
