"""The memo table of results shared by robots."""

from __future__ import annotations

import numpy as np

from agent.memo_cache import NO_CACHE, Content, MemoCache


def test_a_shared_cache_computes_each_result_once() -> None:
    once, done = MemoCache(), []
    for _ in range(2):
        assert once.get("nothing", lambda: done.append(1)) is None
    assert done == [1]


def test_a_full_cache_drops_its_results() -> None:
    once = MemoCache(2)
    assert [once.get(key, lambda key=key: key) for key in (1, 2, 3)] == [1, 2, 3]
    assert once.get(1, lambda: "again") == "again"
    assert once.get(3, lambda: "again") == 3


def test_contents_are_equal_if_shapes_and_all_cells_are() -> None:
    grid = np.arange(15, dtype=np.uint8).reshape(3, 5)
    same = Content(grid.copy())
    assert same == Content(grid)
    assert hash(same) == hash(Content(grid))
    assert same not in (Content(grid.reshape(5, 3)), Content(grid, grid))
    for at in range(grid.size):
        other = grid.copy()
        other.flat[at] = 99
        assert Content(other) != same


def test_the_disabled_cache_keeps_nothing() -> None:
    assert [NO_CACHE.get("same", lambda each=each: each) for each in range(2)] == [0, 1]
