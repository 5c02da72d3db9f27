"""The memo table of results shared by robots."""

from __future__ import annotations

from agent.memo_cache import NO_CACHE, MemoCache


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


def test_the_disabled_cache_keeps_nothing() -> None:
    assert [NO_CACHE.get("same", lambda each=each: each) for each in range(2)] == [0, 1]
