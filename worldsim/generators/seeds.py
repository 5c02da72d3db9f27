"""Seeds of training and of test: what is learned or chosen from runs must not depend on test seeds.

The rule holds for the seed of a generated map (``map_seed``) and for that of a run (``seed``). Seeds below
`FIRST_TEST_SEED` are training seeds: weights, tables, and thresholds are chosen on them. All others are test seeds:
they only measure the result. Programs that learn or search call `check_training_seeds` first.
"""

from __future__ import annotations

from collections.abc import Iterable

FIRST_TEST_SEED = 1000


def is_test_seed(seed: int) -> bool:
    """Return whether a seed is reserved for tests."""
    return seed >= FIRST_TEST_SEED


def first_test_seeds(count: int) -> list[int]:
    """Return the first `count` test seeds."""
    return list(range(FIRST_TEST_SEED, FIRST_TEST_SEED + count))


def check_training_seeds(seeds: Iterable[int]) -> None:
    """Raise ValueError that names the first test seed among `seeds`, if there is one."""
    for seed in seeds:
        if is_test_seed(seed):
            raise ValueError(
                f"seed {seed}: is a test seed, on which nothing may be tuned; use training seeds, below "
                f"{FIRST_TEST_SEED}"
            )
